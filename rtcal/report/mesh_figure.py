"""A mesh as a picture: its edges, and in red where it is open."""

from __future__ import annotations

from typing import Any

import numpy as np

from rtcal.io.mend import Faces
from rtcal.report import figures
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.types import Array


def wireframe(mesh: Polyhedron | Faces, open_edges: Array | None = None) -> Any:
    """Return the figure of a mesh, drawn or mended, with its open edges, (n, 2, 3) in m, in red.

    Each material has its own shade; the legend names those of the largest areas.
    """
    if isinstance(mesh, Polyhedron):
        polygons = [mesh.vertices[list(face)] for face in mesh.faces]
    else:
        polygons = [np.asarray(polygon) for polygon in mesh.polygons]
    figure, _ = figures.new_figure(9.0, 7.0)
    figure.clear()
    axes = figure.add_subplot(projection="3d")
    of_material: dict[str, list[Array]] = {}
    for polygon, material in zip(polygons, mesh.materials, strict=True):
        of_material.setdefault(material, []).append(np.concatenate([polygon, polygon[:1]]))
    for material, loops in of_material.items():
        between = np.full((1, 3), np.nan)
        line = np.concatenate([part for loop in loops for part in (loop, between)])
        axes.plot(*line.T, linewidth=0.6, label=figures.shown(material))
    if open_edges is not None and len(open_edges):
        gaps = np.concatenate([np.concatenate([e, np.full((1, 3), np.nan)]) for e in open_edges])
        axes.plot(*gaps.T, color="red", linewidth=2, label=f"{len(open_edges)} open edges")
    corners = np.concatenate(polygons)
    axes.set_box_aspect(np.maximum(np.ptp(corners, axis=0), 1e-3))
    for axis in "xyz":
        getattr(axes, f"set_{axis}label")(f"{axis} / m")
    if len(of_material) <= 20:
        axes.legend(fontsize="x-small", loc="upper left", bbox_to_anchor=(1.05, 1))
    return figure
