"""Builds from iterators of arrays."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import trex
from trex.errors import InputEmptyError, InputRangeError, MemoryLimitError, UsageError


def test_an_iterator_gives_the_file_that_its_meshes_in_one_give(tmp_path):
    """Read once, in parts, of any types: the same bytes as of one mesh."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    trex.build([(mesh.vertices, mesh.faces)], tmp_path / "one.trex", voxels=64)
    taken = []

    def parts():
        for first in range(0, len(mesh.faces), 3000):
            faces = mesh.faces[first : first + 3000]
            taken.append(len(faces))
            vertices, where = np.unique(faces, return_inverse=True)
            kind = [np.int64, np.uint32, ">i4"][len(taken) % 3]
            yield mesh.vertices[vertices], where.reshape(-1, 3).astype(kind)
        yield np.empty((0, 3)), np.empty((0, 3), int)

    report = trex.build(parts(), tmp_path / "parts.trex", voxels=64)
    assert sum(taken) == report["input_triangle_count"] == report["triangle_count"] == 20480
    # The file's id is of its input, whose name is the same.
    assert (tmp_path / "parts.trex").read_bytes() == (tmp_path / "one.trex").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.trex", "parts.trex"]
    with trex.open(tmp_path / "parts.trex") as model:
        np.testing.assert_allclose(model.bounds, mesh.bounds, atol=1e-4)
        assert np.isfinite(model.intersect([0, 0, 0], mesh.triangles_center).t_hit).all()


def test_colours_become_materials(tmp_path):
    box = trimesh.creation.box(extents=[2, 2, 2])
    colours = np.zeros((12, 3), np.uint8)
    colours[box.face_normals[:, 2] > 0.5] = [255, 0, 0]
    trex.build([(box.vertices, box.faces, colours)], tmp_path / "bytes.trex", voxels=False)
    trex.build([(box.vertices, box.faces, (colours / 255.0))], tmp_path / "floats.trex", voxels=False)
    trex.build([(box.vertices, box.faces, colours.tolist())], tmp_path / "whole.trex", voxels=False)
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": [np.pi] * 3}
    for name in ("bytes.trex", "floats.trex", "whole.trex"):
        with trex.open(tmp_path / name) as model:
            assert sorted(model.materials[1:]) == ["#000000", "#ff0000"]
            hits = model.intersect([[0.1, 0.2, 5], [0.1, 0.2, -5]], [[0, 0, -1], [0, 0, 1]])
            assert [model.materials[index] for index in hits.material] == ["#ff0000", "#000000"]
            picture = model.render(
                camera={"position": [0, 0, 9], "target": [0, 0, 0]}, resolution=(9, 9), spp=1, integrator="direct",
                lights=[light],
            )
            np.testing.assert_allclose(picture[4, 4], [1, 0, 0], atol=1e-3)


def test_faces_may_lie_apart_by_any_number_of_bytes(tmp_path):
    box = trimesh.creation.box(extents=[2, 2, 2])
    rows = np.zeros(len(box.faces), np.dtype([("face", "<i8", 3), ("tag", "u1")]))
    rows["face"] = box.faces
    for name, faces in (("rows.trex", rows["face"]), ("other.trex", box.faces.astype(">i4")), ("plain.trex", box.faces)):
        trex.build([(box.vertices, faces)], tmp_path / name, voxels=False)
    pages = [(tmp_path / name).read_bytes()[4096:] for name in ("rows.trex", "other.trex", "plain.trex")]
    assert [len(page) for page in pages] == [len(pages[0])] * 3
    with trex.open(tmp_path / "rows.trex") as model:
        assert np.isfinite(model.intersect([0, 0, 0], box.triangles_center).t_hit).all()


def test_what_is_no_mesh_is_refused_and_leaves_nothing(tmp_path):
    vertices, faces = np.eye(3), [[0, 1, 2]]
    for kind, mesh in (
        (InputRangeError, (vertices, [[0, 1, 3]])),
        (InputRangeError, (vertices, [[0, 1, -1]])),
        (UsageError, (vertices, [[0.0, 1.0, 2.0]])),
        (UsageError, (vertices[:, :2], faces)),
        (UsageError, (vertices, [[0, 1, 2, 0]])),
        (UsageError, (vertices, faces, [[1, 2]])),
        (UsageError, (vertices, faces, [[0, 0, 256]])),
        (UsageError, (vertices,)),
        (UsageError, 17),
        (InputEmptyError, (vertices, np.empty((0, 3), int))),
        (InputEmptyError, (np.full((3, 3), np.nan), faces)),
    ):
        with pytest.raises(kind) as refused:
            trex.build(iter([mesh]), tmp_path / "no.trex")
        assert refused.value.where and refused.value.next_step, mesh
    with pytest.raises(MemoryLimitError):
        trex.build([(vertices, faces)], tmp_path / "no.trex", memory_limit="25MiB")

    def broken():
        yield vertices, faces
        raise LookupError("the source ended")

    with pytest.raises(LookupError, match="the source ended"):
        trex.build(broken(), tmp_path / "no.trex")
    assert not list(tmp_path.iterdir())
