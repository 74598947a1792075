"""An open model: exact rays and pictures."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from . import _network, _trex
from ._arguments import Path, bytes_of, ray_arrays, thread_count, triangle_ids
from ._live import Live
from ._progress import ProgressArgument, receiver
from ._scene import Parts, scene_text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


#: Width and height of what a notebook shows, pixels.
_SHOWN_RESOLUTION = (480, 360)


class Hits(NamedTuple):
    """The closest hit of each of N rays. A ray that misses has ``t_hit`` inf, ids -1, and zeros."""

    #: Float64 (N,): the hit is at ``origin + t_hit * direction``.
    t_hit: NDArray[np.float64]
    #: Int64 (N,): id of the triangle in the page file, which has an order of its own.
    triangle: NDArray[np.int64]
    #: Float32 (N, 3): weights of the triangle's corners, which make 1.
    barycentric: NDArray[np.float32]
    #: Float32 (N, 3): unit normal of the side from which the corners go counter-clockwise.
    normal: NDArray[np.float32]
    #: Int32 (N,): index into ``Model.materials``.
    material: NDArray[np.int32]


class AllHits(NamedTuple):
    """All hits of each of N rays: those of ray ``i`` are the rows ``first[i]:first[i + 1]`` of the other arrays."""

    #: Int64 (N + 1,): rising; the last is M, the count of all hits.
    first: NDArray[np.int64]
    #: Float64 (M,), rising within a ray.
    t_hit: NDArray[np.float64]
    #: Int64 (M,).
    triangle: NDArray[np.int64]
    #: Float32 (M, 3).
    barycentric: NDArray[np.float32]
    #: Float32 (M, 3).
    normal: NDArray[np.float32]
    #: Int32 (M,).
    material: NDArray[np.int32]

    @property
    def ray(self) -> NDArray[np.int64]:
        """Int64 (M,): the ray of each hit."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))


class Triangles(NamedTuple):
    """Triangles of a model."""

    #: Float64 (N, 3, 3): three corners each, counter-clockwise seen from the side of the normal.
    corners: NDArray[np.float64]
    #: Int32 (N,): index into ``Model.materials``.
    material: NDArray[np.int32]


def open(path: Path, memory_limit: int | str = "512MiB", threads: int | None = None) -> Model:
    """Opens a page file of any size; ``path`` may be an ``http(s)://`` or ``s3://`` address (see :func:`trex.network`).

    ``memory_limit`` holds for all that trex takes for this model: the interpreter and your arrays are beside it.
    ``threads``: one for each processor, unless you say how many.
    """
    return Model(path, memory_limit, threads)


class Model:
    """An open page file. Threads may call one model at a time. Use it with ``with``, or call :meth:`close`."""

    def __init__(self, path: Path, memory_limit: int | str = "512MiB", threads: int | None = None) -> None:
        self._path = os.fspath(path)
        self._limit_bytes = bytes_of(memory_limit, "memory_limit")
        _network.apply()
        self._native = _trex.NativeModel(self._path, self._limit_bytes, thread_count(threads))
        self._info: dict[str, Any] = json.loads(self._native.info())

    def close(self) -> None:
        """Gives memory and threads back, once no call is under way. What is asked of it afterwards is refused."""
        self._native.close()

    def __enter__(self) -> Model:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        if self.closed:
            return f"<trex.Model {self._path!r}, closed>"
        lo, hi = (", ".join(f"{x:.10g}" for x in corner) for corner in self.bounds)
        return (
            f"<trex.Model {self._path!r}: {self.triangle_count:,} triangles, "
            f"{self.bytes_per_triangle:.2f} bytes a triangle, box ({lo}) to ({hi}), "
            f"limit {self._limit_bytes >> 20} MiB>"
        )

    @property
    def path(self) -> str:
        """Path of the page file, as given."""
        return self._path

    @property
    def closed(self) -> bool:
        """True once closed."""
        return self._native.closed

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Float64 (2, 3): least and greatest corner of the box around all triangles."""
        return np.array([self._info["bounds"]["lo"], self._info["bounds"]["hi"]], dtype=np.float64)

    @property
    def triangle_count(self) -> int:
        """Triangles that rays can hit."""
        return self._info["triangle_count"]

    @property
    def vertex_count(self) -> int:
        """Vertices, those that clusters share counted once a cluster."""
        return self._info["vertex_count"]

    @property
    def materials(self) -> list[str]:
        """Names of the materials, in order."""
        return self._native.materials()

    @property
    def bytes_per_triangle(self) -> float:
        """Bytes of the page file a triangle."""
        return self._info["bytes_per_triangle"]

    @property
    def error_bound(self) -> float:
        """Most that a vertex is away from the input's along an axis, model units."""
        return self._info["error_bound"]

    @property
    def lattice(self) -> tuple[NDArray[np.float64], float]:
        """Origin (3,) and step of the lattice that all corners lie on: origin + whole numbers * step."""
        return np.array(self._info["lattice_origin"], np.float64), self._info["lattice_step"]

    @property
    def memory_bytes(self) -> tuple[int, int]:
        """Bytes that are leased from the limit now, and the most that ever were."""
        return self._native.memory()

    def intersect(self, origins: ArrayLike, directions: ArrayLike, t_max: ArrayLike = np.inf) -> Hits:
        """The closest hit of each ray: exact, whatever pages have to be read for it.

        ``origins`` and ``directions``: (N, 3), float64 or float32, any strides, of any length but zero; a single vector
        counts for all rays. ``t_max``: where rays end, a number or (N,). What lies on an edge or a corner is hit, on a
        closed mesh never missed. Rays that go much the same way are faster in a row.
        """
        rays = ray_arrays(origins, directions, t_max)
        count = len(rays[0])
        hits = Hits(
            np.empty(count, np.float64),
            np.empty(count, np.int64),
            np.empty((count, 3), np.float32),
            np.empty((count, 3), np.float32),
            np.empty(count, np.int32),
        )
        self._native.intersect(*rays, *hits)
        return hits

    def occluded(self, origins: ArrayLike, directions: ArrayLike, t_max: ArrayLike = np.inf) -> NDArray[np.bool_]:
        """Whether each ray meets anything before ``t_max``, bool (N,). Arguments as of :meth:`intersect`."""
        rays = ray_arrays(origins, directions, t_max)
        answers = np.empty(len(rays[0]), np.bool_)
        self._native.occluded(*rays, answers)
        return answers

    def intersect_all(self, origins: ArrayLike, directions: ArrayLike, t_max: ArrayLike = np.inf) -> AllHits:
        """All hits of each ray, nearest first. Arguments as of :meth:`intersect`, which is several times faster.

        A crossing through an edge or a corner counts once: a line crosses a closed surface an even number of times.
        """
        return AllHits(*self._native.intersect_all(*ray_arrays(origins, directions, t_max)))

    def read_triangles(self, ids: ArrayLike) -> Triangles:
        """The triangles with these ids (N,), in their order: of hits, or ``range(triangle_count)``."""
        ids = triangle_ids(ids, self.triangle_count)
        triangles = Triangles(np.empty((len(ids), 3, 3), np.float64), np.empty(len(ids), np.int32))
        self._native.read_triangles(ids, *triangles)
        return triangles

    def render(
        self,
        *,
        camera: Mapping[str, Any] | None = None,
        resolution: tuple[int, int] | None = None,
        quality: str | None = None,
        spp: int | None = None,
        seed: int | None = None,
        layers: Iterable[str] = (),
        lights: Iterable[Mapping[str, Any]] | None = None,
        materials: Mapping[str, Mapping[str, Any]] | None = None,
        sections: Iterable[Iterable[float]] | None = None,
        hide: Iterable[str] | str | None = None,
        only: Iterable[str] | str | None = None,
        progress: ProgressArgument = None,
        **settings: Any,
    ) -> NDArray[np.float32] | dict[str, NDArray[Any]]:
        """A picture with all its light: float32 (H, W, 3), linear, row 0 at the top.

        ``camera`` (``position``, ``target``, ``up``, ``fov_x`` or ``fov_y``), ``lights``, ``materials`` and further
        ``settings`` (``integrator``, ``photons``, ``filter``, ...) are those of scene files, ``docs/scene.md``;
        ``resolution`` is (width, height). Without a camera the whole model is seen, without lights one sun and a sky.
        ``sections``, up to three planes as a point and a normal (x, y, z, x, y, z), cut away what lies behind them;
        materials named in ``hide`` are left out, beside those in ``only`` all others are.
        With ``layers``, some of ``"depth"``, ``"normal"``, ``"albedo"`` and ``"triangle"``, a dict of arrays, of which
        ``"radiance"`` is the picture. The same arguments give the same picture at any memory limit.
        """
        names = [layers] if isinstance(layers, str) else list(layers)
        render = {"resolution": resolution, "quality": quality, "spp": spp, "seed": seed, **settings}
        with receiver(progress) as called:
            scene = scene_text(camera, lights, materials, Parts(sections, hide, only), render)
            arrays = self._native.render(scene, names, called)
        return arrays if names else arrays["radiance"]

    def live(
        self,
        *,
        t_max: float = 0.1,
        camera: Mapping[str, Any] | None = None,
        resolution: tuple[int, int] = (640, 480),
        lights: Iterable[Mapping[str, Any]] | None = None,
        materials: Mapping[str, Mapping[str, Any]] | None = None,
        sections: Iterable[Iterable[float]] | None = None,
        hide: Iterable[str] | str | None = None,
        only: Iterable[str] | str | None = None,
        **settings: Any,
    ) -> Live:
        """A picture that is made in frames of up to ``t_max`` seconds, and changes while it is looked at.

        Arguments as of :meth:`render`; what is not said is chosen so that frames come soon. Of a file without voxels
        light is direct, and nothing stands in for pages that are missing.
        """
        parts = Parts(sections, hide, only)
        scene = scene_text(camera, lights, materials, parts, {"resolution": resolution, **settings})
        return Live(self._native.live(scene, float(t_max)))

    def _repr_png_(self) -> bytes | None:
        """What a notebook shows: a draft of the whole model."""
        if self.closed:
            return None
        render = {"resolution": _SHOWN_RESOLUTION, "quality": "draft"}
        if self._info["voxel_resolution"] is None:
            # Without voxels light is direct, which the library chooses where nothing is said.
            render = {"resolution": _SHOWN_RESOLUTION, "spp": 4}
        return self._native.render_png(scene_text(None, None, None, Parts(), render), None)
