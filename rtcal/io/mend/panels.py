"""Free panels: reflectors with two sides."""

from __future__ import annotations

import numpy as np

from rtcal.io.mend.faces import Face, Work
from rtcal.io.mend.mending import Mending
from rtcal.io.mend.overlays import lifted, new_points
from rtcal.io.mend.shapes import axes_of, normal_of, polygon_of, polygons_of

THICKNESS = 0.002
"""Thickness in m of a panel with two sides. A tracer needs it; its edges add 0.1 % to S at most."""


def add_slab(mend: Mending, shell: Work, face: Face, material: str, name: str) -> None:
    """Add a panel of two sides: a closed plate, as much narrower as its edges add to its area."""
    axes = axes_of(normal_of(mend.points[face]))
    inner = polygon_of(mend.points[face], axes).buffer(-THICKNESS / 2, join_style="mitre")
    for piece in polygons_of(inner):
        half = normal_of(mend.points[face]) * THICKNESS / 2
        corners = lifted(mend, np.array(piece.exterior.coords)[:-1], face, axes)
        front = new_points(mend, corners + half)
        back = new_points(mend, corners - half)
        shell.add(front, material, name)
        shell.add(back[::-1], material, f"{name} back")
        for k in range(len(front)):
            j = (k + 1) % len(front)
            shell.add((front[j], front[k], back[k], back[j]), material, f"{name} edge")
