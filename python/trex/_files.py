"""Files as a whole: build, info, verify."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Any, Literal

import numpy as np

from . import _network, _trex
from ._arguments import Mesh, Path, bytes_of, mesh_arrays, thread_count
from ._progress import ProgressArgument, receiver
from .errors import UsageError


def build(
    inputs: Path | Iterable[Path] | Iterable[Mesh],
    out: Path,
    *,
    memory_limit: int | str = "512MiB",
    threads: int | None = None,
    voxels: bool | int | tuple[int, int] = True,
    grid_bits: int | None = None,
    error: float | None = None,
    overwrite: bool = False,
    temp_dir: Path | None = None,
    iso: float | Iterable[float] = (),
    raw: Mapping[str, Any] | None = None,
    progress: ProgressArgument = None,
) -> dict[str, Any]:
    """Builds a page file from meshes, which need not fit in memory.

    ``inputs``: one or several of .ply, .obj, .stl, .gltf and .glb, and of volumes (.nrrd, .nhdr, .mhd, .mha, .raw),
    joined into one model; ``"gen:isosurface:20M"`` and its like are generated. Or an iterable of ``(vertices, faces)`` or ``(vertices, faces, colors)``: vertices
    (V, 3), indices of them (F, 3), and a colour a face (F, 3): uint8 as sRGB, floats from 0 to 1 as reflectance. It
    is read once and never held: its triangles are spooled to ``temp_dir``, 76 bytes each.

    ``voxels``: with all light (``True``), without (``False``), or so many leaves along the longest side (64, 256, 512
    or 1024), or a pair of these and of the finest (1, 4 or 16 times as many), as ``--voxels`` of the command.
    ``grid_bits`` or ``error`` say how fine the lattice is: bits along the longest side, or the most that a vertex may
    move. The file appears whole or not at all, the same at any limit and thread count.

    ``iso``: the value, or the values, of the surfaces of volumes: samples of this value or more are inside, and each
    surface is a material of its own, ``iso_VALUE``. ``raw`` says what .raw files hold: ``size``, the samples along each
    axis, those that lie side by side first; ``dtype``, as NumPy has it; and ``spacing``, (1, 1, 1) unless given.

    Returns counts, sizes and times, with the keys of ``trex build --json``.
    """
    given = iter([inputs] if isinstance(inputs, (str, os.PathLike)) else inputs)
    first = next(given, None)
    arguments = {
        "memory_limit": bytes_of(memory_limit, "memory_limit"),
        "threads": thread_count(threads),
        "voxels": _voxels(voxels),
        "grid_bits": grid_bits,
        "error": error,
        "overwrite": overwrite,
        "temp_dir": None if temp_dir is None else os.fspath(temp_dir),
        "iso": _numbers(iso, "iso"),
        "raw": None if raw is None else _raw_volume(raw),
    }
    with receiver(progress) as called:
        if first is None or isinstance(first, (str, os.PathLike)):
            paths = [] if first is None else [os.fspath(path) for path in chain([first], given)]
            return json.loads(_trex.build(paths, os.fspath(out), arguments, called))
        folder = arguments["temp_dir"] or os.path.dirname(os.fspath(out)) or "."
        spool = _trex.NativeSpool(folder, arguments["memory_limit"])
        for number, mesh in enumerate(chain([first], given)):
            spool.add(number, *mesh_arrays(mesh, number))
        return json.loads(_trex.build_spooled(spool, os.fspath(out), arguments, called))


def _numbers(values: float | Iterable[float], where: str) -> list[float]:
    try:
        return [float(value) for value in np.atleast_1d(np.asarray(values, np.float64))]
    except (TypeError, ValueError) as error:
        raise UsageError("these are no numbers", where, str(error), "give a number, or several") from None


def _raw_volume(raw: Mapping[str, Any]) -> tuple[list[int], str, bool, list[float]]:
    try:
        rest = set(raw) - {"size", "dtype", "spacing"}
        if rest:
            raise KeyError(f"{sorted(rest)} is none of size, dtype and spacing")
        size, dtype = [int(count) for count in raw["size"]], np.dtype(raw["dtype"])
        spacing = [float(step) for step in raw.get("spacing", (1, 1, 1))]
        if len(size) != 3 or len(spacing) != 3 or min(size) < 1 or not all(0 < step < np.inf for step in spacing):
            raise ValueError(f"size {size}, spacing {spacing}")
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(
            "this is no volume", "raw", str(error), "give size=(x, y, z), dtype and, if you like, spacing=(x, y, z)"
        ) from None
    return size, dtype.name, dtype.newbyteorder("=") != dtype, spacing


def _voxels(voxels: bool | int | tuple[int, int]) -> tuple[int, int] | None:
    if isinstance(voxels, bool):
        return None if voxels else (0, 0)
    pair = (voxels, voxels) if isinstance(voxels, int) else tuple(voxels)
    if len(pair) != 2 or not all(isinstance(side, int) and 0 < side < 1 << 32 for side in pair):
        raise UsageError(
            "these are no voxels", "voxels", repr(voxels), "give True, False, a resolution, or a pair of them"
        )
    return pair


def info(path: Path) -> dict[str, Any]:
    """What a page file (.trex) or a mesh file holds, from its tables or its header alone."""
    _network.apply()
    return json.loads(_trex.info(os.fspath(path)))


def verify(
    path: Path,
    *,
    level: Literal["quick", "hashes", "deep"] = "hashes",
    memory_limit: int | str = "512MiB",
    progress: ProgressArgument = None,
) -> dict[str, Any]:
    """Checks a page file: its structure (``"quick"``), each byte against its hash, or what is decoded too (``"deep"``).

    Returns a dict whose ``verdict`` is ``"clean"`` or ``"damaged"``, with ``damage_count`` and the first thousand of
    ``damage``: damage is an answer, no exception.
    """
    # What the server has is looked at, not what is kept of it.
    _network.apply(is_cached=False)
    with receiver(progress) as called:
        text = _trex.verify(os.fspath(path), level, bytes_of(memory_limit, "memory_limit"), called)
    found = json.loads(text)
    return {"verdict": "damaged" if found["damage_count"] else "clean", **found}
