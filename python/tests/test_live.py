"""Pictures in frames, and what notebooks show."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import trex
from trex.errors import SceneFormatError, UsageError

CAMERA = {"position": [0.0, 0.0, 8.0], "target": [0, 0, 0], "up": (0, 1, 0), "fov_y": 40}


def test_frames_come_to_an_end_and_follow_changes(sphere_file):
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": [np.pi, np.pi, np.pi]}
    settings = {"integrator": "direct", "camera": CAMERA, "resolution": (33, 33), "lights": [light]}
    with trex.open(sphere_file) as model, model.live(t_max=0.05, **settings) as live:
        frames = list(live.frames(spp=2))
        assert frames[-1].progress == "done" and frames[0].picture.shape == (33, 33, 3)
        grey = frames[-1].picture[16, 16]
        np.testing.assert_allclose(grey, 0.7, atol=0.02)
        live.apply(materials={model.materials[0]: {"kd": [0.2, 0.4, 0.6]}})
        *_, last = live.frames(spp=2)
        np.testing.assert_allclose(last.picture[16, 16], [0.2, 0.4, 0.6], atol=0.02)
        live.apply(lights=[{**light, "irradiance": [0.0, np.pi, 0.0]}])
        *_, last = live.frames(spp=2)
        np.testing.assert_allclose(last.picture[16, 16], [0, 0.4, 0], atol=0.02)
        live.apply(camera={**CAMERA, "target": [50, 0, 8]})
        *_, last = live.frames(spp=1)
        assert not last.picture.any()
        with pytest.raises(SceneFormatError):
            live.apply(materials={"gold": {"kd": [1, 1, 1]}})
        with pytest.raises(SceneFormatError):
            live.apply(camera={"position": [0, 0, 1]})
    with pytest.raises(UsageError, match="closed"):
        live.frame()


def test_a_camera_has_all_keys_of_a_scene(sphere_file):
    """A direction was left out, and the session's own way up."""

    def seen(live):
        *_, last = live.frames(spp=1)
        return last.picture

    settings = {"integrator": "direct", "resolution": (32, 24), "light": "auto", "up": "+Z"}
    cameras = [{"direction": [0.1, -1, -0.2]}, {"position": [0, -8, 1], "target": [0, 0, 0]}]
    with trex.open(sphere_file) as model:
        for camera in cameras:
            with model.live(**settings, camera=camera) as live:
                expected = seen(live)
            with model.live(**settings) as live:
                assert not np.array_equal(seen(live), expected)
                live.apply(camera=camera)
                np.testing.assert_array_equal(seen(live), expected)


def test_parts_change_live_within_the_limit(sphere_file):
    """Each picture in the end is that of a session which began with these parts, at a limit that fits one of them."""
    settings = {"camera": CAMERA, "resolution": (33, 33), "photons": 10_000, "spp": 1}
    with trex.open(sphere_file, memory_limit="64MiB", threads=2) as model:
        name = model.materials[0]
        cases = [
            {"sections": [[0, 0, 0.5, 0, 0, -1]]},
            {"hide": name},
            {"sections": [[0, 0, 0.5, 0.1, 0, -1], [0, 0.2, 0, 0, 1, 0]], "only": [name]},
            {"sections": []},
        ]

        def end(live):
            *_, last = live.frames(spp=1)
            return last.picture

        def fresh(parts):
            with model.live(**settings, **parts) as live:
                return end(live)

        expected = [fresh(parts) for parts in cases]
        with model.live(**settings) as live:
            whole = end(live)
            for parts, picture in zip(cases, expected, strict=True):
                live.apply(**parts)
                np.testing.assert_array_equal(end(live), picture)
            np.testing.assert_array_equal(picture, whole)
            assert (expected[0] != whole).any() and not np.array_equal(expected[1], whole)
            with pytest.raises(SceneFormatError):
                live.apply(hide=["gold"])
            np.testing.assert_array_equal(end(live), whole)


def test_a_file_without_voxels_is_live_in_direct_light(surface_file):
    with trex.open(surface_file) as plain, plain.live(t_max=0.05, resolution=(32, 32)) as live:
        *_, last = live.frames(spp=1)
        assert last.progress == "done" and last.picture.any()


def test_what_cannot_be_live_is_refused(surface_file, model):
    with trex.open(surface_file) as plain, pytest.raises(SceneFormatError):
        plain.live(integrator="photon")
    for t_max in (0, -1, np.nan, 1e9):
        with pytest.raises(UsageError):
            model.live(t_max=t_max)


def test_a_notebook_shows_a_picture(model, surface_file):
    with trex.open(surface_file) as plain:
        for shown in (model._repr_png_(), plain._repr_png_()):
            assert shown.startswith(b"\x89PNG\r\n")
            assert struct.unpack(">II", shown[16:24]) == (480, 360)
    assert plain._repr_png_() is None
