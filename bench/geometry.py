#!/usr/bin/env python3
"""What a mesh takes in a page file, beside Draco, meshoptimizer and a binary PLY that zstd has packed.

    python bench/geometry.py MESH.ply WORK_FOLDER TREX

MESH.ply is what `trex export` writes: positions and triangles alone. All but the PLY have positions of as many bits as
the lattice of the page file, of which all counts but the voxels: tree, tables and materials, too. meshoptimizer has
vertices and triangles in its own order; its streams are given with and without zstd behind them. Needs what
bench/attributes.py needs. Prints a document for `trex-bench record`.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import meshoptimizer
import numpy as np

from attributes import by_draco, in_own_order, packed, read, trex, vertex_stream


def by_meshoptimizer(places, faces):
    """Bytes of the streams of vertices and triangles, alone and with zstd behind."""
    corners, placed = in_own_order(faces, places)
    streams = [vertex_stream(placed), meshoptimizer.encode_index_buffer(corners, len(corners), len(places))]
    return sum(map(len, streams)), sum(map(packed, streams))


def main():
    mesh, work, command = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    vertices, faces = read(mesh)
    count = len(faces)
    file = str(work / "geometry.trex")
    trex(command, "build", str(mesh), "-o", file, "--overwrite", "--progress", "none")
    told = trex(command, "info", file)
    Path(file).unlink()
    bits = told["grid"]["bits"]
    low = vertices.min(axis=0).astype(np.float64)
    places = np.rint((vertices - low) / (vertices - low).max() * ((1 << bits) - 1)).astype(np.uint32)
    coded, coded_packed = by_meshoptimizer(np.ascontiguousarray(places), faces)
    print(
        json.dumps(
            {
                "scene": mesh.name,
                "triangle_count": count,
                "vertex_count": len(vertices),
                "lattice_bits": bits,
                "bytes_per_triangle": {
                    "trex": told["bytes_per_triangle"]["disk"],
                    "draco": by_draco(vertices, faces, bits) / count,
                    "meshoptimizer": coded / count,
                    "meshoptimizer_zstd": coded_packed / count,
                    "ply": mesh.stat().st_size / count,
                    "ply_zstd": packed(mesh.read_bytes()) / count,
                },
                "versions": {name: version(name) for name in ("DracoPy", "meshoptimizer", "zstandard")},
            }
        )
    )


main()
