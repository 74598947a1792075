"""Every ray against every triangle, in double precision: Möller and Trumbore, 1997."""

from __future__ import annotations

import numpy as np


def closest(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """t of the closest hit of each ray (inf: none), and how clearly the hit lies inside of its triangle."""
    a, edge_1, edge_2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    t_hit, inside = np.full(len(origins), np.inf), np.ones(len(origins))
    for ray, (origin, direction) in enumerate(zip(origins, directions)):
        p = np.cross(direction, edge_2)
        determinant = np.einsum("ij,ij->i", edge_1, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            from_a = origin - a
            q = np.cross(from_a, edge_1)
            u = np.einsum("ij,ij->i", from_a, p) / determinant
            v = (q @ direction) / determinant
            t = np.einsum("ij,ij->i", edge_2, q) / determinant
        least = np.minimum(np.minimum(u, v), 1 - u - v)
        is_hit = (least >= 0) & (t >= 0)
        # Near an edge the snap of a vertex may decide; whoever compares looks at hits that are clear.
        inside[ray] = np.min(np.abs(least[np.isfinite(least)]), initial=1.0)
        if is_hit.any():
            t_hit[ray] = t[is_hit].min()
    return t_hit, inside
