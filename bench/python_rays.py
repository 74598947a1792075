#!/usr/bin/env python3
"""Rays from NumPy arrays: the Python package beside embreex (through trimesh) and Open3D, on the same mesh.

    python bench/python_rays.py speed MESH.ply MODEL.trex OUT [RAYS] [ROUNDS]    # MODEL.trex is built from MESH.ply
    python bench/python_rays.py closed OUT [OFFSET]

Needs trex-mesh, numpy, trimesh, embreex and open3d; `speed` also the Rust call beside, from `cargo build --release
-p trex-bench --example rays_asked`. OUT is a folder for a document of each engine. Each engine is a process of its own,
so that its memory is its own; engines take turns, and each figure is the median of the rounds, of that process's wall
time. `speed`: rays that a camera sends, and rays from places in the box in any direction. `closed`: a closed mesh, rays
from its inside through each of its corners and the middle of each of its edges, moved by OFFSET (10^6): rays that hit
nothing are lost, those that hit more than once are repeated; a surface is left once.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
import time

import numpy as np

ENGINES = ["trex", "rust", "trex-1-thread", "embreex", "open3d"]
RUST = os.path.join(os.path.dirname(__file__), "../target/release/examples/rays_asked")


class Trex:
    """The package on a page file."""

    def __init__(self, path, threads=None):
        import trex

        self.model = trex.open(path, memory_limit="2GiB", threads=threads)

    def first(self, origins, directions):
        hits = self.model.intersect(origins, directions)
        return hits.t_hit

    def all_counts(self, origins, directions):
        return np.diff(self.model.intersect_all(origins, directions).first)


class Embreex:
    """Embree through trimesh."""

    def __init__(self, path):
        import trimesh

        self.mesh = trimesh.load(path, process=False) if isinstance(path, str) else path
        self.engine = trimesh.ray.ray_pyembree.RayMeshIntersector(self.mesh)

    def first(self, origins, directions):
        triangle = self.engine.intersects_first(origins, directions)
        return np.where(triangle < 0, np.inf, 1.0)

    def all_counts(self, origins, directions):
        _, rays = self.engine.intersects_id(origins, directions, multiple_hits=True)
        return np.bincount(rays, minlength=len(origins))


class Open3d:
    """Open3D's scene of rays."""

    def __init__(self, path):
        import open3d as o3d

        self.o3d = o3d
        self.scene = o3d.t.geometry.RaycastingScene()
        if isinstance(path, str):
            self.scene.add_triangles(o3d.t.io.read_triangle_mesh(path))
        else:
            vertices = o3d.core.Tensor(np.asarray(path.vertices, np.float32))
            self.scene.add_triangles(vertices, o3d.core.Tensor(np.asarray(path.faces, np.uint32)))

    def rays(self, origins, directions):
        return self.o3d.core.Tensor(np.hstack([origins, directions]).astype(np.float32))

    def first(self, origins, directions):
        return self.scene.cast_rays(self.rays(origins, directions))["t_hit"].numpy()

    def all_counts(self, origins, directions):
        return self.scene.count_intersections(self.rays(origins, directions)).numpy()


def engine_of(name, mesh, model):
    if name.startswith("trex"):
        return Trex(model, threads=1 if name.endswith("1-thread") else None)
    return {"embreex": Embreex, "open3d": Open3d}[name](mesh)


def rays_of(bounds, count):
    """Origins and directions of both kinds, float64: of a camera, and from anywhere to anywhere."""
    lo, hi = np.asarray(bounds, float)
    random = np.random.default_rng(1)
    side = int(np.sqrt(count))
    centre, extent = (lo + hi) / 2, np.linalg.norm(hi - lo)
    eye = centre + extent * np.array([0.7, 0.5, 0.4])
    forward = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    u, v = np.meshgrid(np.linspace(-0.3, 0.3, side), np.linspace(-0.3, 0.3, side))
    seen = forward + u.reshape(-1, 1) * right + v.reshape(-1, 1) * up
    anywhere = random.normal(size=(side * side, 3))
    return {
        "camera": (np.broadcast_to(eye, seen.shape).copy(), seen),
        "random": (random.uniform(lo, hi, size=(side * side, 3)), anywhere),
    }


def serve(name, mesh, model, bounds, count):
    """A process of one engine: times a kind of rays for each line that it reads."""
    rays = rays_of(json.loads(bounds), int(count))
    begin = time.perf_counter()
    engine = engine_of(name, mesh, model)
    engine.first(*(array[:64] for array in rays["camera"]))
    opened = time.perf_counter() - begin
    for line in sys.stdin:
        kind = line.strip()
        begin = time.perf_counter()
        hits = np.isfinite(engine.first(*rays[kind])).sum()
        took = time.perf_counter() - begin
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        said = {"rays_per_s": len(rays[kind][0]) / took, "hits": int(hits), "opened_s": opened, "peak_rss_bytes": peak}
        print(json.dumps(said), flush=True)


def speed(mesh, model, output, count="1000000", rounds="5"):
    import trex

    with trex.open(model) as opened:
        bounds, triangles = np.asarray(opened.bounds).tolist(), opened.triangle_count
    os.makedirs(output, exist_ok=True)
    for kind, (origins, directions) in rays_of(bounds, int(count)).items():
        np.hstack([origins, directions]).astype("<f8").tofile(f"{output}/{kind}.f64")
    figures = {name: {} for name in ENGINES}
    peaks = {}
    for kind in ["camera", "random"]:
        processes = {}
        for name in ENGINES:
            arguments = [sys.executable, __file__, "serve", name, mesh, model, json.dumps(bounds), count]
            if name == "rust":
                arguments = [RUST, model, output]
            processes[name] = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        said = {name: [] for name in ENGINES}
        # The first round warms caches.
        for turn in range(int(rounds) + 1):
            for name in ENGINES[:: 1 if turn % 2 == 0 else -1]:
                processes[name].stdin.write(kind + "\n")
                processes[name].stdin.flush()
                answer = json.loads(processes[name].stdout.readline())
                if turn > 0:
                    said[name].append(answer)
        for name in ENGINES:
            processes[name].stdin.close()
            processes[name].wait()
            speeds = [answer["rays_per_s"] for answer in said[name]]
            figures[name][kind] = {
                "rays_per_s": statistics.median(speeds),
                "least_rays_per_s": min(speeds),
                "most_rays_per_s": max(speeds),
                "hits": said[name][-1]["hits"],
            }
            peaks[name] = {key: said[name][-1].get(key) for key in ["opened_s", "peak_rss_bytes"]}
            print(kind, name, figures[name][kind], peaks[name], file=sys.stderr)
    for name in ENGINES:
        keep(output, f"speed-{name}", {"triangle_count": triangles, **figures[name], **peaks[name]})
    for kind in ["camera", "random"]:
        os.remove(f"{output}/{kind}.f64")


def closed(output, offset="1e6"):
    """A sphere of triangles, far away: f32 has a step of 1/16 there, so it is 2,000 units wide."""
    import tempfile

    import trex
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=6, radius=1000.0)
    vertices = np.round(np.asarray(ball.vertices) * 16) / 16 + float(offset)
    ball = trimesh.Trimesh(vertices, ball.faces, process=False)
    middles = ball.vertices[ball.edges_unique].mean(axis=1)
    targets = np.vstack([ball.vertices, middles])
    origins = np.broadcast_to(np.full(3, float(offset)) + [16.0, 32.0, 48.0], targets.shape).copy()
    directions = targets - origins
    with tempfile.TemporaryDirectory() as folder:
        model = f"{folder}/ball.trex"
        trex.build([(vertices, ball.faces)], model, error=0.001)
        for name in ["trex", "embreex", "open3d"]:
            engine = engine_of(name, ball, model)
            counts = engine.all_counts(origins, directions)
            counted = {
                "ray_count": len(targets),
                "lost": int((~np.isfinite(engine.first(origins, directions))).sum()),
                "lost_of_all": int((counts == 0).sum()),
                "repeated": int((counts > 1).sum()),
            }
            print(name, counted, file=sys.stderr)
            keep(output, f"closed-{name}", {"triangle_count": len(ball.faces), **counted})


def keep(output, name, figures):
    """Writes the document of an engine."""
    from importlib.metadata import version

    versions = {package: version(package) for package in ["trimesh", "embreex", "open3d", "numpy"]}
    os.makedirs(output, exist_ok=True)
    with open(f"{output}/{name}.json", "w", encoding="utf-8") as file:
        json.dump({"schema": "trex.rays-python/1", **figures, "versions": versions}, file)


if __name__ == "__main__":
    {"speed": speed, "closed": closed, "serve": serve}[sys.argv[1]](*sys.argv[2:])
