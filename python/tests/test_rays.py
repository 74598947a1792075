"""Rays in arrays: against brute force in double precision, and against Embree through trimesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from conftest import FAR, random_rays
from oracle import closest

import trex
from trex.errors import UsageError


def test_hits_are_those_of_brute_force(model, sphere):
    origins, directions = random_rays(2000)
    expected, clear = closest(sphere.triangles, origins, directions)
    hits = model.intersect(origins, directions)
    is_clear = clear > 1e-3
    assert is_clear.sum() > 1000 and np.isfinite(expected).sum() > 500 and np.isinf(expected).sum() > 100
    assert (np.isfinite(hits.t_hit) == np.isfinite(expected))[is_clear].all()
    both = is_clear & np.isfinite(expected)
    np.testing.assert_allclose(hits.t_hit[both], expected[both], atol=4 * model.error_bound, rtol=1e-9)
    np.testing.assert_array_equal(model.occluded(origins, directions), np.isfinite(hits.t_hit))


def test_hits_are_those_of_embree(model, sphere):
    embree = trimesh.ray.ray_pyembree.RayMeshIntersector(sphere)
    origins, directions = random_rays(20_000, seed=2)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    faces, rays, points = embree.intersects_id(origins, directions, multiple_hits=False, return_locations=True)
    hits = model.intersect(origins, directions)
    missed = np.ones(len(origins), bool)
    missed[rays] = False
    # Embree is single precision: at the silhouette either may be right.
    assert (np.isinf(hits.t_hit) != missed).sum() < 20
    both = rays[np.isfinite(hits.t_hit[rays])]
    ours = origins + hits.t_hit[:, None] * directions
    theirs = np.empty_like(origins)
    theirs[rays] = points
    cosines = np.abs(np.einsum("ij,ij->i", hits.normal, directions))[both]
    # Corners moved to the lattice shift a hit along its ray, the more the flatter it comes in.
    off = np.linalg.norm(ours[both] - theirs[both], axis=1) * cosines
    assert off.max() < 2 * model.error_bound + 4e-6 and len(both) > 10_000


def test_a_hit_names_surface_material_and_weights(model, sphere):
    origins, directions = random_rays(1000, seed=3)
    hits = model.intersect(origins, directions)
    hit = np.isfinite(hits.t_hit)
    points = origins[hit] + hits.t_hit[hit, None] * directions[hit]
    # Seen from outside, the normals of a sphere look outward, as its points do.
    outward = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert (np.einsum("ij,ij->i", outward, hits.normal[hit]) > 0.98).all()
    assert (hits.material[hit] == 0).all() and len(model.materials) == 1
    assert ((0 <= hits.triangle[hit]) & (hits.triangle[hit] < model.triangle_count)).all()
    np.testing.assert_allclose(hits.barycentric[hit].sum(axis=1), 1, atol=1e-6)
    assert (hits.barycentric[hit] >= 0).all()
    miss = ~hit
    assert miss.any() and np.isinf(hits.t_hit[miss]).all()
    assert (hits.triangle[miss] == -1).all() and (hits.material[miss] == -1).all()
    assert not hits.normal[miss].any() and not hits.barycentric[miss].any()


def test_shapes_strides_and_precisions_give_the_same_answers(model):
    origins, directions = (array.astype(np.float32) for array in random_rays(500, seed=4))
    expected = model.intersect(origins.astype(np.float64), directions.astype(np.float64))
    assert np.isfinite(expected.t_hit).any()
    wide = np.zeros((1000, 7), np.float32)
    wide[::2, 1:7:2] = origins
    structured = np.zeros(500, dtype=[("pad", "u1"), ("origin", "<f4", 3)])
    structured["origin"] = origins
    same = [
        (origins, directions),
        (np.asfortranarray(origins), directions),
        (wide[::2, 1:7:2], directions),
        (wide[::2, 1:7:2].astype(">f8"), directions),
        (structured["origin"], directions.astype(np.float64)),
        (origins.tolist(), directions.tolist()),
        (origins[::-1][::-1], directions[::-1][::-1]),
    ]
    for given in same:
        found = model.intersect(*given)
        for ours, theirs in zip(found, expected):
            np.testing.assert_array_equal(ours, theirs)
    backward = model.intersect(origins[::-1], directions[::-1])
    np.testing.assert_array_equal(backward.t_hit, expected.t_hit[::-1])


def test_one_vector_counts_for_all_rays(model):
    hits = model.intersect([0, 0, 0], random_rays(10)[1])
    assert hits.t_hit.shape == (10,) and np.isfinite(hits.t_hit).all()
    assert model.intersect([0, 0, 5], [0, 0, -1]).t_hit.shape == (1,)
    np.testing.assert_allclose(model.intersect([0, 0, 5], [0, 0, -2]).t_hit, 1.5, atol=0.01)


def test_rays_end_where_they_are_told_to(model):
    ends = np.array([2.9, 3.1, np.inf], np.float32)
    found = np.isfinite(model.intersect([0, 0, 5], [0, 0, -1], ends).t_hit)
    np.testing.assert_array_equal(found, [False, True, True])
    np.testing.assert_array_equal(model.occluded([[0, 0, 5]], [[0, 0, -1]], 2.9), [False])


def test_no_rays_have_no_answers(model):
    hits = model.intersect(np.empty((0, 3)), np.empty((0, 3)))
    assert [array.shape for array in hits] == [(0,), (0,), (0, 3), (0, 3), (0,)]
    assert model.occluded(np.empty((0, 3)), [0, 0, 1]).shape == (0,)


@pytest.mark.parametrize(
    "rays",
    [
        ([[0, 0]], [[0, 0, 1]]),
        (np.zeros((2, 3)), np.ones((3, 3))),
        (np.zeros((2, 3)), np.ones((2, 3)), np.ones(3)),
        (np.zeros((1, 1, 3)), np.ones((1, 3))),
        ([["a", "b", "c"]], [[0, 0, 1]]),
        ([[0, 0, np.nan]], [[0, 0, 1]]),
        ([[0, 0, 0]], [[0, 0, 0]]),
        ([[0, 0, 0]], [[0, 0, 1]], 0.0),
    ],
)
def test_what_is_no_ray_is_refused(model, rays):
    with pytest.raises(UsageError) as refused:
        model.intersect(*rays)
    assert refused.value.where and refused.value.numbers and refused.value.next_step


def test_a_ray_that_is_refused_is_named_by_its_row(model):
    directions = np.ones((200_000, 3))
    directions[150_000] = 0
    with pytest.raises(UsageError) as refused:
        model.intersect([0, 0, 0], directions)
    assert refused.value.where == "ray 150000 of 200000"


def test_far_from_the_origin_nothing_is_lost(sphere, tmp_path):
    """Rays from inside of a closed mesh, through its corners and the middles of its edges, at coordinates of 10^6."""
    far = sphere.copy()
    far.apply_translation(FAR)
    # As OBJ: PLY of trimesh is single precision, which would crush the mesh itself.
    lines = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in far.vertices.tolist()]
    lines += [f"f {a} {b} {c}\n" for a, b, c in (far.faces + 1).tolist()]
    (tmp_path / "far.obj").write_text("".join(lines))
    trex.build(tmp_path / "far.obj", tmp_path / "far.trex", voxels=False)
    with trex.open(tmp_path / "far.trex", threads=2) as model:
        assert model.triangle_count == len(far.faces)
        targets = np.concatenate([far.vertices, far.vertices[far.edges_unique].mean(axis=1), far.triangles_center])
        hits = model.intersect(FAR, targets - FAR)
        assert np.isfinite(hits.t_hit).all()
        # The lattice moves corners by next to nothing, and coordinates are rounded to 2^-31.
        assert model.error_bound < 5e-5
        np.testing.assert_allclose(hits.t_hit, 1, atol=2 * model.error_bound)


def test_answers_do_not_depend_on_the_memory_limit_or_the_threads(surface_file):
    bounds = trex.info(surface_file)["bounds"]
    low, high = np.array(bounds["lo"]), np.array(bounds["hi"])
    random = np.random.default_rng(5)
    origins = random.uniform(low, high, size=(30_000, 3))
    directions = random.normal(size=(30_000, 3))
    found = []
    for limit, threads in (("40MiB", 1), ("512MiB", 2)):
        with trex.open(surface_file, memory_limit=limit, threads=threads) as model:
            found.append(model.intersect(origins, directions))
            assert model.memory_bytes[1] <= (40 if limit == "40MiB" else 512) << 20
    for small, large in zip(*found):
        np.testing.assert_array_equal(small, large)
    assert np.isfinite(found[0].t_hit).mean() > 0.5


def test_threads_call_one_model_at_a_time(model):
    from concurrent.futures import ThreadPoolExecutor

    origins, directions = random_rays(5000, seed=6)
    expected = model.intersect(origins, directions).t_hit
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: model.intersect(origins, directions).t_hit, range(8)):
            np.testing.assert_array_equal(found, expected)
