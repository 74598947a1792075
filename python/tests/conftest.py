"""Meshes and page files that several tests need, made once."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

import trex

#: A sphere far from the origin, as maps and plants have it: single precision tells steps of 1/16 apart there.
FAR = np.array([1.0e6, -2.0e6, 3.0e6])


def pytest_configure() -> None:
    # The package that was built, not the folder beside the tests.
    assert os.environ.get("TREX_ANY_PACKAGE") or "site-packages" in trex.__file__, trex.__file__


@pytest.fixture(scope="session")
def sphere() -> trimesh.Trimesh:
    """A closed mesh of 1280 triangles around the origin."""
    return trimesh.creation.icosphere(subdivisions=3, radius=2.0)


@pytest.fixture(scope="session")
def sphere_file(sphere: trimesh.Trimesh, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its page file, with voxels."""
    folder = tmp_path_factory.mktemp("sphere")
    sphere.export(folder / "sphere.ply")
    trex.build(folder / "sphere.ply", folder / "sphere.trex", voxels=64)
    return folder / "sphere.trex"


@pytest.fixture(scope="session")
def surface_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An iso-surface of 200,000 triangles: some tens of pages, without voxels."""
    path = tmp_path_factory.mktemp("surface") / "surface.trex"
    trex.build("gen:isosurface:200k", path, voxels=False)
    return path


@pytest.fixture
def model(sphere_file: Path):
    """The sphere, open."""
    with trex.open(sphere_file, memory_limit="128MiB", threads=2) as model:
        yield model


def random_rays(count: int, seed: int = 1, reach: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """Rays from around the origin to near it."""
    random = np.random.default_rng(seed)
    origins = random.normal(size=(count, 3))
    origins *= reach / np.linalg.norm(origins, axis=1, keepdims=True)
    return origins, random.uniform(-2.5, 2.5, size=(count, 3)) - origins
