"""Build, info, verify, and what a model says of itself."""

from __future__ import annotations

import numpy as np
import pytest

import trex
from trex.errors import InputUnreadableError, UsageError


def test_a_build_reports_and_the_file_says_the_same(sphere, sphere_file):
    info = trex.info(sphere_file)
    assert info["triangle_count"] == len(sphere.faces) and info["voxel_resolution"] == 64
    np.testing.assert_allclose(info["bounds"]["hi"], sphere.bounds[1], atol=1e-3)
    assert trex.info(sphere_file.with_suffix(".ply"))["face_count"] == len(sphere.faces)


def test_the_same_input_gives_the_same_bytes_and_an_output_is_not_replaced_unasked(sphere_file, tmp_path):
    mesh, out = sphere_file.with_suffix(".ply"), tmp_path / "again.trex"
    report = trex.build([mesh], out, voxels=64, threads=1, memory_limit="300MiB")
    assert out.read_bytes() == sphere_file.read_bytes()
    assert report["triangle_count"] == report["input_triangle_count"] == 1280
    with pytest.raises(UsageError, match="exists"):
        trex.build(mesh, out)
    trex.build(mesh, out, overwrite=True, voxels=False)
    assert trex.info(out)["voxel_resolution"] is None


def test_several_inputs_make_one_model(sphere_file, tmp_path):
    mesh = sphere_file.with_suffix(".ply")
    report = trex.build([mesh, "gen:soup:10k", mesh], tmp_path / "all.trex", voxels=False, error=1e-3)
    assert report["input_triangle_count"] == 2 * 1280 + 10_000 and report["error_bound"] <= 1e-3


def test_progress_is_heard_and_its_exception_ends_the_work(tmp_path):
    heard = []
    trex.build("gen:isosurface:300k", tmp_path / "a.trex", voxels=False, progress=lambda *call: heard.append(call))
    assert heard and all(done <= total or not total for _, done, total, _ in heard)
    assert len({phase for phase, *_ in heard}) > 1

    def refuse(*_):
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        trex.build("gen:isosurface:2M", tmp_path / "b.trex", progress=refuse)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.trex"]


def test_damage_is_an_answer_of_verify_and_an_exception_of_rays_and_pictures(sphere_file, tmp_path):
    assert trex.verify(sphere_file, level="deep")["verdict"] == "clean"
    damaged = tmp_path / "damaged.trex"
    content = bytearray(sphere_file.read_bytes())
    # The first page lies behind the superblock of 4 KiB.
    content[4096 + 9] ^= 1
    damaged.write_bytes(content)
    found = trex.verify(damaged)
    assert (found["verdict"], found["damage_count"]) == ("damaged", 1)
    assert found["damage"][0]["bounds"]["lo"] == trex.info(sphere_file)["bounds"]["lo"]
    with trex.open(damaged) as model, pytest.raises(trex.errors.DamagedError):
        model.intersect([0, 0, 5], [0, 0, -1])
    with trex.open(damaged) as model, pytest.raises(trex.errors.DamagedError):
        model.render(resolution=(64, 64), spp=1)
    # Voxels stand in for nothing.
    with trex.open(damaged) as model, model.live(resolution=(64, 64), lod_error=0) as live:
        with pytest.raises(trex.errors.DamagedError):
            for _ in live.frames(spp=1):
                pass


def test_what_is_no_argument_is_refused(sphere_file, tmp_path):
    mesh, out = sphere_file.with_suffix(".ply"), tmp_path / "no.trex"
    for wrong in (
        {"voxels": 100},
        {"voxels": (64, 128)},
        {"voxels": "many"},
        {"memory_limit": "12 parsecs"},
        {"memory_limit": 0},
        {"threads": 0},
        {"error": 1e-3, "grid_bits": 12},
        {"temp_dir": tmp_path / "nowhere"},
    ):
        with pytest.raises(UsageError) as refused:
            trex.build(mesh, out, **wrong)
        assert refused.value.where and refused.value.next_step, wrong
    with pytest.raises(UsageError):
        trex.build([], out)
    with pytest.raises(UsageError):
        trex.verify(sphere_file, level="slow")
    with pytest.raises(InputUnreadableError) as missing:
        trex.build(tmp_path / "none.ply", out)
    assert isinstance(missing.value, OSError) and "none.ply" in missing.value.where
    assert not list(tmp_path.iterdir())


def test_a_model_says_what_it_is_and_ends(sphere, sphere_file):
    with trex.open(sphere_file, memory_limit="128MiB") as model:
        np.testing.assert_allclose(model.bounds, sphere.bounds, atol=1e-3)
        assert model.triangle_count == 1280 and model.vertex_count >= len(sphere.vertices)
        assert model.bytes_per_triangle == sphere_file.stat().st_size / 1280
        shown = repr(model)
        assert "1,280 triangles" in shown and "128 MiB" in shown and str(sphere_file) in shown
    assert model.closed and "closed" in repr(model)
    model.close()
    with pytest.raises(UsageError, match="closed"):
        model.intersect([0, 0, 5], [0, 0, -1])
