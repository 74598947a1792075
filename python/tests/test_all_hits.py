"""All hits of rays, and triangles by their ids."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import random_rays

import trex
from trex.errors import UsageError


def test_a_sphere_is_crossed_twice_or_not_at_all(model):
    origins, directions = random_rays(5000, seed=8)
    hits, closest = model.intersect_all(origins, directions), model.intersect(origins, directions)
    counts = np.diff(hits.first)
    assert set(np.unique(counts)) == {0, 2} and len(hits.first) == 5001 and hits.first[-1] == len(hits.t_hit)
    np.testing.assert_array_equal(counts > 0, np.isfinite(closest.t_hit))
    np.testing.assert_array_equal(hits.t_hit[hits.first[:-1][counts > 0]], closest.t_hit[counts > 0])
    assert (np.diff(hits.t_hit.reshape(-1, 2)) > 0).all()
    # In and out: against the ray, then along it.
    along = np.einsum("ij,ij->i", hits.normal, directions[hits.ray]).reshape(-1, 2)
    assert (along[:, 0] < 0).all() and (along[:, 1] > 0).all()


def test_lines_through_corners_and_edges_count_once(model, sphere):
    targets = np.concatenate([sphere.vertices, sphere.vertices[sphere.edges_unique].mean(axis=1)])
    for direction in ([1, 0, 0], [0, -1, 0], [0.3, 0.5, -1]):
        counts = np.diff(model.intersect_all(targets - 10 * np.asarray(direction), direction).first)
        assert set(np.unique(counts)) <= {0, 2} and (counts == 2).mean() > 0.9


def test_ends_count_and_no_rays_have_no_hits(model):
    assert np.diff(model.intersect_all([0, 0.1, 5], [0, 0, -1], [2.9, 5, np.inf]).first).tolist() == [0, 1, 2]
    none = model.intersect_all(np.empty((0, 3)), [0, 0, 1])
    assert none.first.tolist() == [0] and none.normal.shape == (0, 3)


def test_hits_lie_where_weights_and_corners_say(model):
    origins, directions = random_rays(3000, seed=9)
    hits = model.intersect(origins, directions)
    hit = hits.triangle >= 0
    corners, material = model.read_triangles(hits.triangle[hit])
    weighted = np.einsum("ij,ijk->ik", hits.barycentric[hit], corners)
    np.testing.assert_allclose(weighted, (origins + hits.t_hit[:, None] * directions)[hit], atol=2e-6)
    np.testing.assert_array_equal(material, hits.material[hit])
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    np.testing.assert_allclose(across, hits.normal[hit], atol=1e-6)


def test_triangles_are_those_that_went_in(model, sphere):
    corners = model.read_triangles(range(model.triangle_count)).corners

    def in_order(triangles: np.ndarray) -> np.ndarray:
        rows = np.sort(np.ascontiguousarray(np.round(triangles, 3) + 0.0).reshape(-1, 9), axis=1)
        return rows[np.lexsort(rows.T)]

    np.testing.assert_allclose(in_order(corners), in_order(sphere.triangles), atol=2e-3)
    np.testing.assert_allclose(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2,
        sphere.area,
        rtol=1e-4,
    )


@pytest.mark.parametrize("ids", [[-1], [1280], [[0]], [0.5], np.array([2**33])])
def test_what_is_no_id_is_refused(model, ids):
    with pytest.raises(UsageError):
        model.read_triangles(ids)
    assert len(model.read_triangles([]).material) == 0


def test_all_of_a_surface_under_a_small_limit(surface_file):
    with trex.open(surface_file, memory_limit="40MiB", threads=2) as model:
        ids = np.random.default_rng(1).permutation(model.triangle_count)
        corners = model.read_triangles(ids).corners
        assert np.isfinite(corners).all() and model.memory_bytes[1] <= 40 << 20
        np.testing.assert_allclose(corners.min(axis=(0, 1)), model.bounds[0], atol=1e-9)
        np.testing.assert_allclose(corners.max(axis=(0, 1)), model.bounds[1], atol=1e-9)
