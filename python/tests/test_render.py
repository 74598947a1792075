"""Pictures as arrays."""

from __future__ import annotations

import numpy as np
import pytest
from oracle import closest

import trex
from trex.errors import SceneFormatError, UsageError

CAMERA = {"position": [0.0, 0.0, 8.0], "target": np.zeros(3), "up": (0, 1, 0), "fov_y": 40}


def test_a_picture_is_an_array_and_the_same_at_any_limit(sphere_file):
    pictures = []
    for limit, threads in (("64MiB", 1), (1 << 30, 2)):
        with trex.open(sphere_file, memory_limit=limit, threads=threads) as model:
            pictures.append(model.render(resolution=(40, 30), spp=2, photons=20_000, seed=3))
    assert pictures[0].shape == (30, 40, 3) and pictures[0].dtype == np.float32
    assert np.isfinite(pictures[0]).all() and pictures[0].mean() > 0.01
    np.testing.assert_array_equal(*pictures)
    with trex.open(sphere_file) as model:
        other = model.render(resolution=(40, 30), spp=2, photons=20_000, seed=4)
    assert (other != pictures[0]).any()


def test_layers_are_those_of_rays_through_the_middles_of_pixels(model, sphere):
    arrays = model.render(
        camera=CAMERA, resolution=(24, 16), spp=1, integrator="direct", layers=("depth", "normal", "albedo", "triangle")
    )
    assert sorted(arrays) == ["albedo", "depth", "normal", "radiance", "triangle"]
    y, x = np.mgrid[0:16, 0:24] + 0.5
    half = np.tan(np.radians(20))
    directions = np.stack([(2 * x / 24 - 1) * half * 24 / 16, (1 - 2 * y / 16) * half, np.full_like(x, -1)], axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    expected, clear = closest(sphere.triangles, np.tile([0.0, 0, 8], (384, 1)), directions.reshape(-1, 3))
    depth, is_clear = arrays["depth"].ravel(), clear > 1e-3
    assert np.isfinite(expected).sum() > 50 and is_clear.sum() > 200
    np.testing.assert_allclose(depth[is_clear], expected[is_clear], rtol=1e-4)
    seen = np.isfinite(arrays["depth"])
    assert ((arrays["triangle"] >= 0) == seen).all() and (arrays["triangle"][~seen] == -1).all()
    np.testing.assert_allclose(np.linalg.norm(arrays["normal"][seen], axis=1), 1, atol=1e-5)
    assert not arrays["normal"][~seen].any() and (arrays["albedo"][seen] > 0).all()


def test_sections_and_hidden_materials_leave_parts_out(model):
    """A sphere of radius 2 cut at z = 0.5: a disc of radius sqrt(3.75) at depth 7.5 is seen, by an oracle of one line."""
    view = {"camera": CAMERA, "resolution": (33, 33), "spp": 1, "integrator": "direct", "layers": ["depth", "normal"]}
    cut = model.render(sections=[np.array([0, 0, 0.5, 0, 0, -2])], **view)
    np.testing.assert_allclose(cut["depth"][16, 16], 7.5, atol=1e-3)
    np.testing.assert_allclose(cut["normal"][16, 16], [0, 0, 1], atol=1e-5)
    whole = model.render(**view)
    np.testing.assert_allclose(whole["depth"][16, 16], 6, atol=0.02)
    only = model.render(only=model.materials[0], **view)
    np.testing.assert_array_equal(only["radiance"], whole["radiance"])
    for hidden in (model.materials[0], [model.materials[0]]):
        assert np.isinf(model.render(hide=hidden, **view)["depth"]).all()
    with pytest.raises(SceneFormatError, match="gold"):
        model.render(hide=["gold"], **view)
    for sections in ([[0, 0, 0, 0, 0, 0]], [[0, 0, 0, 0, 0, 1]] * 4):
        with pytest.raises(SceneFormatError):
            model.render(sections=sections, **view)
    for sections in ([1, 2, 3], [[0, 0, 1]], 7):
        with pytest.raises((SceneFormatError, UsageError)):
            model.render(sections=sections, **view)


def test_lights_are_those_that_are_given(model):
    """A directional light on a white diffuse surface straight on: radiance is albedo / pi x irradiance."""
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": [np.pi, 0, 0]}
    picture = model.render(
        camera=CAMERA,
        resolution=(33, 33),
        spp=4,
        integrator="direct",
        lights=[light],
        materials={model.materials[0]: {"kd": [0.5, 0.5, 0.5]}},
    )
    np.testing.assert_allclose(picture[16, 16], [0.5, 0, 0], atol=0.02)
    assert not picture[0, 0].any()


def test_what_is_no_scene_is_refused_with_its_key(model):
    for wrong, named in (
        ({"quality": "superb"}, "superb"),
        ({"spp": 0}, "spp"),
        ({"wrong_key": 3}, "wrong_key"),
        ({"camera": {"position": [0, 0, 1]}}, "position"),
        ({"materials": {"gold": {"kd": [1, 1, 1]}}}, "gold"),
        ({"lights": [{"type": "torch"}]}, "torch"),
        ({"resolution": (4, 100_000)}, "resolution"),
    ):
        with pytest.raises(SceneFormatError) as refused:
            model.render(**wrong)
        assert named in str(refused.value), (wrong, str(refused.value))
    for wrong in ({"layers": ["smell"]}, {"exposure": np.nan}, {"camera": {"target": object()}}):
        with pytest.raises(UsageError):
            model.render(**wrong)


def test_progress_of_a_picture_is_heard(model):
    heard = []
    model.render(resolution=(64, 64), spp=64, integrator="direct", progress=lambda *call: heard.append(call))
    assert heard and heard[-1][0] == "render" and heard[-1][1] == heard[-1][2] == 64 * 64 * 64
