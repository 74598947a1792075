"""Arguments as users write them, brought to the one form that the library takes."""

from __future__ import annotations

import math
import os
import re
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from .errors import UsageError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

#: A path of the file system.
Path = Union[str, "os.PathLike[str]"]
#: Vertices (V, 3), faces (F, 3), and a colour of each face (F, 3).
Mesh = Union["tuple[ArrayLike, ArrayLike]", "tuple[ArrayLike, ArrayLike, ArrayLike]"]

_UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_UNITS |= {"KIB": 1 << 10, "MIB": 1 << 20, "GIB": 1 << 30, "TIB": 1 << 40}
_AMOUNT = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([A-Za-z]+)\s*")


def bytes_of(amount: int | str, where: str) -> int:
    """Bytes of ``"512MiB"``, ``"1.5GiB"``, ``"2GB"``, or of a whole number of them."""
    if isinstance(amount, (int, np.integer)) and not isinstance(amount, bool):
        count = int(amount)
    else:
        found = _AMOUNT.fullmatch(amount) if isinstance(amount, str) else None
        unit = _UNITS.get(found[2].upper()) if found else None
        if unit is None:
            raise UsageError(
                "this is no amount of memory", where, repr(amount), "give bytes, or an amount like '512MiB' or '2GB'"
            )
        count = math.floor(float(found[1]) * unit)
    if not 0 < count < 1 << 63:
        raise UsageError("the amount is out of range", where, repr(amount), "give an amount above 0")
    return count


def thread_count(threads: int | None) -> int | None:
    """The count of threads; ``None`` for one for each processor."""
    if threads is None or (isinstance(threads, (int, np.integer)) and 0 < threads <= 1024):
        return None if threads is None else int(threads)
    raise UsageError("this is no count of threads", "threads", repr(threads), "give a number in 1..=1024, or None")


def _native(values: ArrayLike, where: str) -> NDArray[Any]:
    """``values`` as float32 or float64 of this machine, copied only where they are neither."""
    try:
        array = np.asarray(values)
        if array.dtype not in (np.float32, np.float64):
            array = array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError("these are no numbers", where, str(error), "give an array of floats") from None
    return array if array.flags.aligned and array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def ray_arrays(origins: ArrayLike, directions: ArrayLike, t_max: ArrayLike) -> tuple[NDArray[Any], ...]:
    """Origins (N, 3), directions (N, 3) and ends (N,) of rays. Single ones count for all rays, without copies."""
    arrays = _native(origins, "origins"), _native(directions, "directions"), _native(t_max, "t_max")
    for array, name in zip(arrays[:2], ("origins", "directions")):
        if array.ndim not in (1, 2) or array.shape[-1] != 3:
            raise UsageError(f"{name} are no vectors", name, f"shape {array.shape}", "give an array of shape (N, 3)")
    if arrays[2].ndim > 1:
        raise UsageError("t_max is no list", "t_max", f"shape {arrays[2].shape}", "give a number or shape (N,)")
    counts = {len(array) for array, ndim in zip(arrays, (2, 2, 1)) if array.ndim == ndim}
    # An array of one row counts for all rays.
    counts = counts - {1} or {1}
    if len(counts) > 1:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise UsageError("the rays have different counts", "origins, directions, t_max", shapes, "give N of each, or 1")
    (count,) = counts
    shapes = (count, 3), (count, 3), (count,)
    return tuple(np.broadcast_to(array, shape) for array, shape in zip(arrays, shapes))


def triangle_ids(ids: ArrayLike, count: int) -> NDArray[np.uint32]:
    """Ids (N,) of triangles of a model that has so many."""
    array = np.asarray(ids)
    if array.ndim != 1 or not (np.issubdtype(array.dtype, np.integer) or array.size == 0):
        numbers = f"shape {array.shape}, {array.dtype}"
        raise UsageError("these are no ids of triangles", "ids", numbers, "give whole numbers of shape (N,)")
    outside = (array < 0) | (array >= count)
    if outside.any():
        row = int(np.argmax(outside))
        numbers = f"{array[row]}, of {count}"
        raise UsageError("the model has no such triangle", f"id {row} of {len(array)}", numbers, "give ids from 0 on")
    return array.astype(np.uint32)


def mesh_arrays(mesh: Mesh, number: int) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8] | None]:
    """Vertices, faces and colours of the mesh that an iterator gave as its ``number``th."""
    where = f"mesh {number}"
    if not isinstance(mesh, (tuple, list)) or len(mesh) not in (2, 3):
        numbers = f"{type(mesh).__name__}" + (f" of {len(mesh)}" if isinstance(mesh, (tuple, list)) else "")
        raise UsageError("this is no mesh", where, numbers, "give (vertices, faces) or (vertices, faces, colors)")
    vertices, faces = _native(mesh[0], where).astype(np.float64, copy=False), np.asarray(mesh[1])
    if not (faces.flags.aligned and faces.dtype.isnative):
        # Its rows may lie apart by no whole number of indices.
        faces = faces.astype(faces.dtype.newbyteorder("="))
    for array, name in ((vertices, "vertices"), (faces, "faces")):
        if array.size == 0:
            continue
        if array.ndim != 2 or array.shape[1] != 3:
            raise UsageError(f"{name} have no three columns", where, f"shape {array.shape}", "give shape (N, 3)")
    if faces.size and not np.issubdtype(faces.dtype, np.integer):
        raise UsageError("faces are no indices", where, f"{faces.dtype}", "give whole numbers")
    vertices, faces = vertices.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int64, copy=False)
    if len(mesh) == 2:
        return vertices, faces, None
    colors = np.asarray(mesh[2])
    if colors.shape != faces.shape:
        numbers = f"shape {colors.shape}, faces {faces.shape}"
        raise UsageError("there is not one colour a face", where, numbers, "give shape (F, 3)")
    if np.issubdtype(colors.dtype, np.integer):
        outside = (colors < 0) | (colors > 255)
        if outside.any():
            numbers = f"{colors[outside][0]}"
            raise UsageError("this is no colour", where, numbers, "give whole numbers up to 255, or floats up to 1")
        colors = colors.astype(np.uint8)
    else:
        # Floats are reflectance; the library takes 8 bits of sRGB, as most colours come.
        linear = np.clip(colors.astype(np.float64), 0, 1)
        srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
        colors = np.round(255 * srgb).astype(np.uint8)
    return vertices, faces, colors
