#!/usr/bin/env python3
"""What colours and normals take in a page file, beside meshoptimizer's and Draco's codecs on the same mesh.

    python bench/attributes.py MESH.ply FREQUENCY WORK_FOLDER TREX [ROUNDS]

MESH.ply is what `trex export` writes: positions and triangles alone. FREQUENCY is `low` or `high`.

- Colours are a function of the place: sums of waves of the lengths below, in parts of the model, `high` with those of
  some edges and with noise of four steps of 255 each way, as a camera has it.
- Normals are those of the mesh at its vertices, weighted by area: `high` as they are, `low` once each was replaced by
  the mean over its neighbours, for so many rounds.

Each codec gets the values as trex keeps them: three bytes of colour, normals in an octahedron of 10 bits a channel.
Draco gets the mesh with positions of as many bits as the lattice of the page file has, and takes what it grows by with
the attribute; meshoptimizer gets the vertices in its own order, for the vertex cache and then for fetching, and its
stream is given with and without zstd behind it. Needs numpy, meshoptimizer, DracoPy and zstandard. Prints a document
for `trex-bench record`. Builds with and without, rays and pictures of both files, take turns; speeds are ratios of
medians of the rounds, 1 being as fast as without. Shaded rays look colour and normal of each hit up, too.
"""

import json
import re
import statistics
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import DracoPy
import meshoptimizer
import numpy as np
import zstandard

# Waves: parts of the model's longest side, and of the median edge.
LOW_PARTS = [0.5, 0.23, 0.11]
HIGH_EDGES = [40.0, 17.0, 8.0]
HIGH_NOISE = 4
SMOOTH_ROUNDS = 16
NORMAL_BITS = 10
DRACO_LEVEL = 7
SEED = 1
RAYS = ["primary", "shadow", "incoherent"]
# Of the file with both, and what they are compared with.
SHADED = {"primary_shaded": "primary", "incoherent_shaded": "incoherent"}
PICTURE = ["--resolution", "512x512", "--spp", "8", "--overwrite"]


def read(path):
    """Vertices, n x 3, and triangles, m x 3, of a PLY that trex wrote; vertices of one place are one."""
    with open(path, "rb") as file:
        header = b""
        while not header.endswith(b"end_header\n"):
            header += file.readline()
        counts = [int(re.search(rb"element %s (\d+)" % kind, header)[1]) for kind in (b"vertex", b"face")]
        vertices = np.fromfile(file, "<f4", 3 * counts[0]).reshape(-1, 3)
        faces = np.fromfile(file, np.dtype([("count", "u1"), ("corners", "<u4", 3)]), counts[1])["corners"]
    key = np.ascontiguousarray(vertices).view([("", "<f4")] * 3).ravel()
    _, first, place = np.unique(key, return_index=True, return_inverse=True)
    # In the order in which they stood.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    faces = rank[place[faces]]
    same = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    return vertices[first[order]], faces[~same].astype(np.uint32)


def summed(values, index, count):
    """Sums rows of `values` by `index`."""
    return np.stack([np.bincount(index, channel, count) for channel in values.T], axis=-1)


def unit(vectors):
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)


def normals_of(vertices, faces, frequency):
    a, b, c = (vertices[faces[:, at]].astype(np.float64) for at in range(3))
    areas = np.cross(b - a, c - a)
    count = len(vertices)
    normals = unit(sum(summed(areas, faces[:, at], count) for at in range(3)))
    for _ in range(SMOOTH_ROUNDS if frequency == "low" else 0):
        of_faces = sum(normals[faces[:, at]] for at in range(3))
        normals = unit(sum(summed(of_faces, faces[:, at], count) for at in range(3)))
    return normals


def colours_of(vertices, faces, frequency):
    dice = np.random.default_rng(SEED)
    at = vertices.astype(np.float64) - vertices.min(axis=0)
    side = at.max()
    edge = np.median(np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1))
    lengths = [part * side for part in LOW_PARTS]
    if frequency == "high":
        lengths += [edges * edge for edges in HIGH_EDGES]
    colours = np.full((len(at), 3), 128.0)
    for length in lengths:
        strength = 26.0 if length >= LOW_PARTS[-1] * side else 12.0
        for channel in range(3):
            way = unit(dice.normal(size=(1, 3)))[0]
            colours[:, channel] += strength * np.sin(2 * np.pi * (at @ way) / length + dice.uniform(0, 7))
    if frequency == "high":
        colours += dice.integers(-HIGH_NOISE, HIGH_NOISE + 1, colours.shape)
    return np.clip(np.rint(colours), 0, 255).astype(np.uint8)


def octahedral(normals):
    """As docs/format.md has them: n x 2, 0 to 1022."""
    n = normals / np.abs(normals).sum(axis=1, keepdims=True)
    folded = (1 - np.abs(n[:, 1::-1])) * np.where(n[:, :2] >= 0, 1, -1)
    return np.rint(511 + 511 * np.where(n[:, 2:] >= 0, n[:, :2], folded)).astype(np.int16)


def write(path, vertices, faces, colours, normals):
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines += [f"element face {len(faces)}", "property list uchar uint vertex_indices", "end_header", ""]
    kind = np.dtype([("place", "<f4", 3), ("normal", "<f4", 3), ("colour", "u1", 3)])
    rows = np.empty(len(vertices), kind)
    rows["place"], rows["normal"], rows["colour"] = vertices, normals, colours
    corners = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<u4", 3)]))
    corners["count"], corners["corners"] = 3, faces
    with open(path, "wb") as file:
        file.write("\n".join(lines).encode())
        rows.tofile(file)
        corners.tofile(file)


def packed(stream):
    return len(zstandard.ZstdCompressor(level=19).compress(bytes(stream)))


def in_own_order(faces, values):
    """Corners of triangles and rows of `values` in the order of meshoptimizer: for the vertex cache, then fetching."""
    count = len(values)
    indices = np.ascontiguousarray(faces.ravel())
    ordered = np.zeros_like(indices)
    meshoptimizer.optimize_vertex_cache(ordered, indices, len(indices), count)
    remap = np.zeros(count, np.uint32)
    meshoptimizer.optimize_vertex_fetch_remap(remap, ordered, len(ordered), count)
    placed = np.empty_like(values)
    placed[remap] = values
    return np.ascontiguousarray(remap[ordered]), placed


def vertex_stream(rows):
    """The stream of `rows` of a multiple of four bytes."""
    meshoptimizer.encode_vertex_version(1)
    return meshoptimizer.encode_vertex_buffer(rows, len(rows), rows.strides[0])


def by_meshoptimizer(faces, values):
    """Bytes of `values`, alone and with zstd behind."""
    stream = vertex_stream(in_own_order(faces, values)[1])
    return len(stream), packed(stream)


def by_draco(vertices, faces, bits, **attribute):
    coded = DracoPy.encode(vertices, faces, quantization_bits=bits, compression_level=DRACO_LEVEL, **attribute)
    return len(coded)


def trex(command, *arguments):
    done = subprocess.run([command, *arguments, "--json"], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(arguments)}: {done.stderr}")
    return json.loads(done.stdout)


def main():
    mesh, frequency, work, command, *rounds = sys.argv[1:]
    rounds = int(rounds[0]) if rounds else 5
    work = Path(work)
    vertices, faces = read(mesh)
    count = len(faces)
    colours, normals = colours_of(vertices, faces, frequency), normals_of(vertices, faces, frequency)
    painted = work / "painted.ply"
    write(painted, vertices, faces, colours, normals)

    # Each way of building in turns; the last of each stays.
    drop, keep = "drop", "keep"
    ways = {"plain": (drop, drop), "colours": (keep, drop), "normals": (drop, keep), "both": (keep, keep)}
    files = {way: str(work / f"painted-{way}.trex") for way in ways}
    seconds = {way: [] for way in ways}
    for turn in range(rounds):
        for way in list(ways) if turn % 2 == 0 else list(ways)[::-1]:
            keeps = ["--colors", ways[way][0], "--normals", ways[way][1]]
            built = trex(command, "build", str(painted), "-o", files[way], "--overwrite", "--progress", "none", *keeps)
            seconds[way].append(built["phase_ms"]["total"] / 1e3)
    told = {way: trex(command, "info", file) for way, file in files.items()}
    kinds = {"plain": RAYS, "both": [*RAYS, *SHADED]}
    rays = {way: {kind: [] for kind in kinds[way]} for way in kinds}
    pictures = {way: [] for way in kinds}
    for turn in range(rounds):
        for way in list(rays) if turn % 2 == 0 else list(rays)[::-1]:
            traced = trex(command, "bench", "rays", files[way], "--resolution", "512x512", "--rounds", "1")
            for kind in kinds[way]:
                rays[way][kind].append(traced[kind]["per_core_s"])
            shown = trex(command, "render", files[way], "-o", str(work / "painted.png"), "--progress", "none", *PICTURE)
            pictures[way].append(shown["time_ms"])
    painted.unlink()
    (work / "painted.png").unlink()
    for file in files.values():
        Path(file).unlink()

    colour_rows = np.concatenate([colours, np.full((len(colours), 1), 255, np.uint8)], axis=1)
    normal_rows = np.ascontiguousarray(octahedral(normals))
    bits = told["plain"]["grid"]["bits"]
    plain = by_draco(vertices, faces, bits)
    share = {"colours": {}, "normals": {}}
    for name, rows, attribute in [
        ("colours", colour_rows, {"colors": colours}),
        ("normals", normal_rows, {"normals": np.ascontiguousarray(normals), "normal_quantization_bits": NORMAL_BITS}),
    ]:
        coded, packed = by_meshoptimizer(faces, rows)
        share[name] = {
            "trex": told["both"]["bytes_per_triangle"][name],
            "meshoptimizer": coded / count,
            "meshoptimizer_zstd": packed / count,
            "draco": (by_draco(vertices, faces, bits, **attribute) - plain) / count,
            "raw": {"colours": 3, "normals": 2.5}[name] * told["both"]["vertex_count"] / count,
        }
    ray_medians = {way: {kind: statistics.median(speeds) for kind, speeds in rays[way].items()} for way in rays}
    ray_speed = {k: ray_medians["both"][k] / ray_medians["plain"][SHADED.get(k, k)] for k in kinds["both"]}
    medians = {way: statistics.median(times) for way, times in seconds.items()}
    print(
        json.dumps(
            {
                "scene": Path(mesh).name,
                "frequency": frequency,
                "triangle_count": count,
                "vertex_count": len(vertices),
                "rounds": rounds,
                "bytes_per_triangle": {
                    **share,
                    "mesh": told["plain"]["bytes_per_triangle"]["disk"],
                    "mesh_with_both": told["both"]["bytes_per_triangle"]["disk"],
                },
                "pages": {way: values["page_count"] for way, values in told.items()},
                "build_seconds": medians,
                "speed": {way: medians["plain"] / medians[way] for way in ("colours", "normals", "both")},
                "ray_speed": ray_speed,
                "picture_speed": statistics.median(pictures["plain"]) / statistics.median(pictures["both"]),
                "versions": {name: version(name) for name in ("DracoPy", "meshoptimizer", "zstandard")},
            }
        )
    )


if __name__ == "__main__":
    main()
