"""The stand-in for trimesh's ray engines: trimesh's own ray tests, and what they leave out.

The regression tests that trimesh ships in its source package (``tests/test_ray_upstream.py`` and those of
``tests/test_ray.py`` that need no model files) run with our engine in the place of Embree's.
"""

from __future__ import annotations

import copy
import importlib.util
import pickle
import subprocess
import sys
import tarfile
import types
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.ray import ray_triangle

from trex.compat.trimesh import RayMeshIntersector

#: Tests that are not ours to pass, and why.
NOT_OURS = {
    # Model files that trimesh's source package does not hold.
    "test_issue_1362_many_rays_consistency": "needs featuretype.STL",
    "test_rays": "needs model files",
    "test_rps": "needs model files",
    "test_empty": "needs model files",
    "test_contains": "needs model files",
    "test_on_edge": "needs model files",
    "test_contain_single": "needs model files",
    "test_box": "needs model files",
    "test_contains_cavity": "needs a package of booleans",
    # One scale of six: the corners, moved to the lattice, may lie behind where the ray begins.
    "test_embree_duplicate_hits": "begins a ray exactly on a face",
}


@pytest.fixture(scope="module")
def trimesh_tests(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """trimesh's own tests, from its source package on PyPI."""
    folder = tmp_path_factory.mktemp("trimesh")
    name = f"trimesh=={trimesh.__version__}"
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--no-binary", ":all:", "-d", folder, name]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip(f"NOT RUN: PyPI gives no source package of {name}")
    with tarfile.open(next(folder.glob("*.tar.gz"))) as package:
        package.extractall(folder, filter="data")
    return next(folder.glob("trimesh-*/tests"))


def load(path: Path, generic: types.ModuleType):
    """A test file as a module, with `generic` as its helpers."""
    sys.modules["generic"] = generic
    spec = importlib.util.spec_from_file_location(f"trimesh_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def helpers() -> types.ModuleType:
    """What these tests take of trimesh's `generic`, without the model files that it wants."""
    generic = types.ModuleType("generic")
    generic.np, generic.trimesh, generic.log = np, trimesh, trimesh.util.log
    generic.random = np.random.default_rng(0).random
    return generic


def test_trimeshs_own_ray_tests_pass(trimesh_tests, monkeypatch, capsys):
    monkeypatch.setattr(trimesh.ray.ray_pyembree, "RayMeshIntersector", RayMeshIntersector)
    monkeypatch.setattr(ray_triangle, "RayMeshIntersector", RayMeshIntersector)
    passed, failed, left = [], [], []
    for name in ("test_ray_upstream.py", "test_ray.py"):
        module = load(trimesh_tests / name, helpers())
        for test, function in list(vars(module).items()):
            if not test.startswith("test_"):
                continue
            if test in NOT_OURS:
                left.append(f"{test} ({NOT_OURS[test]})")
                continue
            try:
                function()
                passed.append(test)
            except Exception as error:  # All of them are told.
                failed.append(f"{test}: {type(error).__name__}: {error}")
    with capsys.disabled():
        print(f"\n[{len(passed)} tests of trimesh pass; not run: {', '.join(left)}]")
    assert not failed, "\n".join(failed)
    assert len(passed) >= 15


def test_faces_are_those_of_the_plain_engine():
    mesh = trimesh.creation.torus(3, 1)
    mesh.merge_vertices()
    random = np.random.default_rng(2)
    origins = random.normal(size=(300, 3)) * 5
    directions = random.uniform(-2, 2, size=(300, 3)) - origins
    plain, engine = ray_triangle.RayMeshIntersector(mesh), RayMeshIntersector(mesh)
    for several in (False, True):
        expected = plain.intersects_id(origins, directions, multiple_hits=several)
        found = engine.intersects_id(origins, directions, multiple_hits=several)
        pairs = [set(zip(*(index.tolist() for index in indices))) for indices in (expected, found)]
        assert len(pairs[0]) > 100 and len(pairs[0] ^ pairs[1]) <= 2
    first = engine.intersects_first(origins, directions)
    assert (first >= 0).sum() > 50 and set(first[first >= 0]) <= set(range(len(mesh.faces)))
    np.testing.assert_array_equal(engine.intersects_any(origins, directions), first >= 0)


def test_faces_on_each_other_and_without_area():
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], float)
    faces = [[0, 1, 2], [0, 1, 3], [1, 2, 0], [0, 2, 1]]
    mesh = trimesh.Trimesh(square, faces, process=False)
    engine = RayMeshIntersector(mesh)
    index_tri, index_ray = engine.intersects_id([[0.2, 0.3, 1]], [[0, 0, -1]])
    assert sorted(index_tri) == [0, 2, 3] and index_ray.tolist() == [0, 0, 0]
    assert len(engine.intersects_id([[0.2, 0.3, 1]], [[0, 0, -1]], max_hits=2)[0]) == 2


def test_a_mesh_that_changes_is_built_again_and_copies_are_equal():
    mesh = trimesh.creation.box()
    engine = RayMeshIntersector(mesh, threads=1)
    ray = ([[0.2, 0.1, 5]], [[0, 0, -1]])
    assert engine.intersects_location(*ray, multiple_hits=False)[0][0, 2] == pytest.approx(0.5)
    mesh.apply_translation([0, 0, 1])
    for same in (engine, copy.copy(engine), copy.deepcopy(engine), pickle.loads(pickle.dumps(engine))):
        assert same.intersects_location(*ray, multiple_hits=False)[0][0, 2] == pytest.approx(1.5)


def test_what_is_no_ray_hits_nothing():
    engine = RayMeshIntersector(trimesh.creation.box())
    origins, directions = [[0, 0, 5], [0, 0, np.nan], [0.1, 0.2, 5]], [[0, 0, 0], [0, 0, -1], [0, 0, -1]]
    assert engine.intersects_any(origins, directions).tolist() == [False, False, True]
    assert engine.intersects_id(origins, directions)[1].tolist() == [2, 2]
    empty = RayMeshIntersector(trimesh.Trimesh())
    assert not empty.intersects_any(origins, directions).any()
    assert empty.intersects_first(origins, directions).tolist() == [-1, -1, -1]
    assert empty.intersects_location(origins, directions)[0].shape == (0, 3)
