"""``RayMeshIntersector`` with the methods of trimesh's, answered exactly and in double precision.

>>> mesh.ray = trex.compat.trimesh.RayMeshIntersector(mesh)
>>> mesh.contains(points)

The first question builds a page file of the mesh in a temporary folder; so does the first after the mesh has changed.
Corners are moved to a lattice of 2^24 steps along the longest side of the mesh.
"""

from __future__ import annotations

import os
import tempfile
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from trimesh.caching import Cache, cache_decorator
from trimesh.ray.ray_util import contains_points

from .._files import build
from .._model import Hits, Model
from ..errors import InputEmptyError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

#: As fine as the fast arithmetic goes: a step is below what single precision tells apart.
_GRID_BITS = 24


class RayMeshIntersector:
    """Ray queries on a ``trimesh.Trimesh``.

    ``index_tri`` are indices of ``mesh.faces``. A crossing through an edge or a corner counts once. Faces without area
    are never hit.
    """

    def __init__(
        self,
        geometry: trimesh.Trimesh,
        scale_to_box: bool = True,
        *,
        memory_limit: int | str = "512MiB",
        threads: int | None = None,
    ) -> None:
        # `scale_to_box` is what other engines need for precision.
        self.mesh = geometry
        self._arguments = {"scale_to_box": scale_to_box, "memory_limit": memory_limit, "threads": threads}
        self._cache = Cache(id_function=self.mesh.__hash__)

    @cache_decorator
    def _built(self) -> _BuiltMesh | None:
        limit, threads = self._arguments["memory_limit"], self._arguments["threads"]
        try:
            return _BuiltMesh(self.mesh, limit, threads)
        except InputEmptyError:
            return None

    def intersects_location(
        self, ray_origins: ArrayLike, ray_directions: ArrayLike, multiple_hits: bool = True, **_: Any
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Where rays hit: locations (M, 3), ``index_ray`` (M,), ``index_tri`` (M,)."""
        index_tri, index_ray, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits=multiple_hits, return_locations=True
        )
        return locations, index_ray, index_tri

    def intersects_id(
        self,
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = None,
        return_locations: bool = False,
        **_: Any,
    ) -> tuple[NDArray[Any], ...]:
        """What rays hit: ``index_tri`` (M,), ``index_ray`` (M,), and with ``return_locations`` locations (M, 3).

        Sorted by ray, hits of one by distance; at most ``max_hits`` of each.
        """
        origins, directions, usable = _rays(ray_origins, ray_directions)
        built = self._built
        if built is None or not usable.any():
            t, triangle, ray = np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64)
        elif multiple_hits:
            hits = built.model.intersect_all(origins[usable], directions[usable])
            t, triangle, ray = hits.t_hit, hits.triangle, hits.ray
            if max_hits is not None:
                few = np.arange(len(ray)) - hits.first[:-1][ray] < max_hits
                t, triangle, ray = t[few], triangle[few], ray[few]
        else:
            hit = built.model.intersect(origins[usable], directions[usable])
            ray = np.flatnonzero(hit.triangle >= 0)
            t, triangle = hit.t_hit[ray], hit.triangle[ray]
        index_ray = np.flatnonzero(usable)[ray]
        index_tri = triangle if built is None else built.face_of_triangle[triangle]
        if not return_locations:
            return index_tri, index_ray
        return index_tri, index_ray, origins[index_ray] + t[:, None] * directions[index_ray]

    def intersects_first(self, ray_origins: ArrayLike, ray_directions: ArrayLike, **_: Any) -> NDArray[np.int64]:
        """The face that each ray hits first, (N,); -1 for none."""
        origins, directions, usable = _rays(ray_origins, ray_directions)
        faces = np.full(len(origins), -1, np.int64)
        built = self._built
        if built is not None and usable.any():
            hits: Hits = built.model.intersect(origins[usable], directions[usable])
            faces[usable] = np.where(hits.triangle >= 0, built.face_of_triangle[hits.triangle], -1)
        return faces

    def intersects_any(self, ray_origins: ArrayLike, ray_directions: ArrayLike, **_: Any) -> NDArray[np.bool_]:
        """Whether each ray hits anything, (N,)."""
        origins, directions, usable = _rays(ray_origins, ray_directions)
        found = np.zeros(len(origins), np.bool_)
        built = self._built
        if built is not None and usable.any():
            found[usable] = built.model.occluded(origins[usable], directions[usable])
        return found

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether the mesh, which should be closed, contains each point."""
        return contains_points(self, points)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_cache"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._cache = Cache(id_function=self.mesh.__hash__)

    def __copy__(self) -> RayMeshIntersector:
        return RayMeshIntersector(self.mesh, **self._arguments)

    def __deepcopy__(self, _: Any) -> RayMeshIntersector:
        return self.__copy__()


class _BuiltMesh:
    """The page file of a mesh, open, for as long as anybody asks."""

    def __init__(self, mesh: trimesh.Trimesh, memory_limit: int | str, threads: int | None) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="trex-")
        out = os.path.join(self._folder.name, "mesh.trex")
        arrays = [(np.asarray(mesh.vertices), np.asarray(mesh.faces))]
        build(arrays, out, memory_limit=memory_limit, threads=threads, voxels=False, grid_bits=_GRID_BITS)
        self.model = Model(out, memory_limit, threads)
        #: Int64 (M,): index into ``mesh.faces`` of each triangle of the file, which has an order of its own.
        self.face_of_triangle = _faces_of_triangles(mesh, self.model)


def _rays(
    origins: ArrayLike, directions: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Origins and unit directions, (N, 3), and which of them are rays at all."""
    origins, directions = (np.asarray(given, np.float64).reshape(-1, 3) for given in (origins, directions))
    if origins.shape != directions.shape:
        raise ValueError("Ray origin and direction don't match!")
    lengths = np.linalg.norm(directions, axis=1)
    usable = np.isfinite(origins).all(axis=1) & np.isfinite(lengths) & (lengths > 0)
    return origins, directions / np.where(usable, lengths, 1)[:, None], usable


def _faces_of_triangles(mesh: trimesh.Trimesh, model: Model) -> NDArray[np.int64]:
    """The face that each triangle of the model was: the one with the same corners on the lattice."""
    origin, step = model.lattice
    triangles = model.read_triangles(np.arange(model.triangle_count)).corners
    # As the build does it: nearest, ties to even.
    given = (np.asarray(corners).reshape(-1, 3) for corners in (mesh.triangles, triangles))
    steps = [np.rint((corners - origin) / step).astype(np.int64) for corners in given]
    _, corner_ids = np.unique(np.concatenate(steps), axis=0, return_inverse=True)
    keys = np.sort(corner_ids.reshape(-1, 3), axis=1)
    _, key_ids = np.unique(keys, axis=0, return_inverse=True)
    of_faces, of_triangles = np.split(key_ids.reshape(-1), [len(mesh.faces)])
    # Faces that lie on each other have one key: the first of the triangles is the first of the faces, and so on.
    face_order, triangle_order = (np.argsort(ids, kind="stable") for ids in (of_faces, of_triangles))
    sorted_faces, sorted_triangles = of_faces[face_order], of_triangles[triangle_order]
    first = np.searchsorted(sorted_faces, sorted_triangles)
    rank = np.arange(len(sorted_triangles)) - np.searchsorted(sorted_triangles, sorted_triangles)
    found = np.empty(len(of_triangles), np.int64)
    found[triangle_order] = face_order[first + rank]
    return found
