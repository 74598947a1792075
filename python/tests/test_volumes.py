"""Surfaces of volumes."""

from __future__ import annotations

import numpy as np
import pytest

import trex
from trex.errors import UsageError

SIDE, RADIUS = 48, 15.5


def distances() -> np.ndarray:
    """How far the samples of a cube are inside of a ball, or outside of it (negative): z, y, x."""
    axis = np.arange(SIDE) - (SIDE - 1) / 2
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    return RADIUS - np.sqrt(x * x + y * y + z * z)


def radii(path) -> np.ndarray:
    with trex.open(path, memory_limit="128MiB") as model:
        corners = model.read_triangles(range(model.triangle_count)).corners
        return np.linalg.norm(corners - model.bounds.mean(axis=0), axis=-1)


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<i2"])
def test_a_ball_has_its_radius(tmp_path, dtype):
    samples = distances() if "f" in dtype else np.round(1000 * distances())
    samples.astype(dtype).tofile(tmp_path / "ball.raw")
    raw = {"size": (SIDE,) * 3, "dtype": dtype}
    report = trex.build(tmp_path / "ball.raw", tmp_path / "ball.trex", iso=0, raw=raw, voxels=False)
    assert report["triangle_count"] > 4000
    assert np.abs(radii(tmp_path / "ball.trex") - RADIUS).max() < 0.05


def test_several_values_are_several_materials(tmp_path):
    distances().astype("<f4").tofile(tmp_path / "ball.raw")
    raw = {"size": (SIDE,) * 3, "dtype": "f4", "spacing": (2, 2, 2)}
    trex.build(tmp_path / "ball.raw", tmp_path / "ball.trex", iso=[0, 5.5], raw=raw, voxels=False)
    with trex.open(tmp_path / "ball.trex") as model:
        assert model.materials == ["iso_0", "iso_5.5"]
        hits = model.intersect_all(model.bounds.mean(axis=0), [0.1, 0.2, 1.0])
        np.testing.assert_allclose(hits.t_hit * np.linalg.norm([0.1, 0.2, 1.0]), [20, 31], atol=0.1)
        assert list(hits.material) == [1, 0]


def test_what_is_no_volume_is_refused(tmp_path):
    (tmp_path / "a.raw").write_bytes(bytes(8))
    out = tmp_path / "a.trex"
    for arguments in (
        {"iso": "high"},
        {"iso": 1, "raw": {"size": (2, 2), "dtype": "u1"}},
        {"iso": 1, "raw": {"size": (2, 2, 2), "dtype": "complex64"}},
        {"iso": 1, "raw": {"size": (2, 2, 2), "dtype": "u1", "step": 1}},
        {"iso": 1, "raw": {"size": (2, 2, 2), "dtype": "u1", "spacing": (1, 0, 1)}},
    ):
        with pytest.raises(UsageError):
            trex.build(tmp_path / "a.raw", out, **arguments)
    with pytest.raises(trex.TrexError):
        trex.build(tmp_path / "a.raw", out, raw={"size": (2, 2, 2), "dtype": "u1"})
    assert not out.exists()
