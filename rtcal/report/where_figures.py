"""The figures of where: the map of disagreement, the surfaces in an axonometric view, three bars."""

from __future__ import annotations

from typing import Any

import numpy as np

from rtcal.report.figures import BLACK, BLUE, GREEN, ORANGE, new_figure, shown
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.arguments import checked
from rtcal.support.types import Array
from rtcal.where.finding import Finding
from rtcal.where.surfaces import Faces, kind
from rtcal.where.verification import MODELS, Verification

_SHOWN = 0.02
"""Smallest probability of a surface that is written beside it."""
_TURN, _TILT = np.radians(35), np.radians(30)
"""Directions from which the axonometric view looks: round z, and down."""


@checked
def disagreement(finding: Finding) -> Any:
    """Return the map: which pairs, bands and parameters disagree, on the plan and as a table.

    A line joins source and receiver. It is as dark as the root mean square of the pair's residuals in
    standard deviations. Walls are as orange as they are probable.
    """
    figure, axes = new_figure(11.0, 5.0, 1, 2)
    _plan(axes[0], finding)
    z = np.sqrt(np.nanmean(finding.map**2, axis=1))
    most = max(2.0, float(np.nanmax(z)))
    image = axes[1].imshow(z, cmap="cividis_r", vmin=0, vmax=most, aspect="auto")
    axes[1].set_yticks(range(len(z)), [p.upper() for p in finding.parameters])
    frequencies = finding.case.room.centre_frequencies
    axes[1].set_xticks(range(len(frequencies)), [f"{f:g}" for f in frequencies])
    axes[1].set_xlabel("Band centre frequency / Hz")
    for (p, k), value in np.ndenumerate(z):
        if np.isfinite(value):
            dark = value > 0.6 * most
            axes[1].text(
                k, p, f"{value:.1f}", ha="center", va="center", color="white" if dark else BLACK
            )
    figure.colorbar(image, ax=axes[1], label="Disagreement / standard deviations")
    return figure


def _plan(axes: Any, finding: Finding) -> None:
    case, level = finding.case, list[str]()
    for name, faces in case.faces.items():
        probability = finding.surfaces.get(name, 0.0) if finding.verdict != "none" else 0.0
        wall = kind(case.geometry, faces) == "wall"
        for i in faces:
            corners = case.geometry.vertices[[*case.geometry.faces[i], case.geometry.faces[i][0]]]
            axes.plot(corners[:, 0], corners[:, 1], color="0.6", linewidth=1, zorder=1)
            if wall and probability >= _SHOWN:
                axes.plot(
                    corners[:, 0],
                    corners[:, 1],
                    color=ORANGE,
                    alpha=min(1.0, 0.15 + probability),
                    linewidth=6,
                    zorder=2,
                    solid_capstyle="butt",
                )
        if probability >= _SHOWN:
            label = f"{shown(name, 20)}: {100 * probability:.0f} %"
            if wall:
                middle = _middle(case.geometry, faces)
                axes.annotate(label, middle[:2], fontsize=8, ha="center", zorder=5)
            else:
                level.append(label)
    z = np.sqrt(np.nanmean(finding.map**2, axis=(0, 2)))
    most = max(2.0, float(np.nanmax(z)))
    sources, receivers = case.simulator.sources, case.simulator.receivers
    for (source, receiver), value in zip(finding.pairs, z, strict=True):
        ends = np.array([sources[source][:2], receivers[receiver][:2]])
        axes.plot(
            ends[:, 0], ends[:, 1], color=str(0.85 * (1 - min(value / most, 1.0))), linewidth=1.5
        )
    for points, marker, colour in ((sources, "^", ORANGE), (receivers, "o", BLUE)):
        for name, point in points.items():
            axes.plot(*point[:2], marker=marker, color=colour, markersize=8, zorder=4)
            axes.annotate(
                shown(name, 12), point[:2], xytext=(5, 5), textcoords="offset points", fontsize=8
            )
    axes.set_aspect("equal")
    axes.set_xlabel("\n".join(["x / m", *level]))
    axes.set_ylabel("y / m")
    axes.set_title(f"Residuals by pair: darkest {float(np.nanmax(z)):.1f} standard deviations")


@checked
def surfaces(finding: Finding) -> Any:
    """Return the room in an axonometric view, each surface as orange as it is probable."""
    figure, axes = new_figure(7.0, 5.5)
    draw_room(axes, finding)
    return figure


@checked
def draw_room(axes: Any, finding: Finding) -> None:
    """Draw the room in an axonometric view into axes; see `surfaces`."""
    case, geometry = finding.case, finding.case.geometry
    flat = project(geometry.vertices)
    depth = geometry.vertices @ _depth()
    order = sorted(
        range(len(geometry.faces)), key=lambda i: -float(depth[list(geometry.faces[i])].mean())
    )
    of_face = {int(i): name for name, faces in case.faces.items() for i in faces}
    for i in order:
        name = of_face.get(i)
        probability = 0.0
        if name is not None and finding.verdict != "none":
            probability = finding.surfaces.get(name, 0.0)
        corners = flat[list(geometry.faces[i])]
        axes.fill(
            corners[:, 0],
            corners[:, 1],
            facecolor=ORANGE,
            alpha=0.85 * probability,
            edgecolor="none",
        )
        axes.fill(corners[:, 0], corners[:, 1], facecolor="none", edgecolor="0.5", linewidth=0.8)
    for name, faces in case.faces.items():
        probability = finding.surfaces.get(name, 0.0) if finding.verdict != "none" else 0.0
        if probability >= _SHOWN:
            middle = project(_middle(geometry, faces)[np.newaxis])[0]
            label = f"{shown(name, 24)}\n{100 * probability:.0f} %"
            axes.annotate(label, middle, ha="center", va="center", fontsize=9)
    for points, marker, colour in (
        (case.simulator.sources, "^", ORANGE),
        (case.simulator.receivers, "o", BLUE),
    ):
        places = project(np.array(list(points.values()), dtype=float))
        axes.plot(places[:, 0], places[:, 1], linestyle="none", marker=marker, color=colour)
    axes.set_aspect("equal")
    axes.axis("off")


def project(points: Array) -> Array:
    """Return points (n, 3) in the axonometric view, (n, 2)."""
    right = np.array([np.cos(_TURN), np.sin(_TURN), 0.0])
    up = np.array([-np.sin(_TURN) * np.sin(_TILT), np.cos(_TURN) * np.sin(_TILT), np.cos(_TILT)])
    return np.stack([points @ right, points @ up], axis=1)


def _depth() -> Array:
    """Return the direction into the picture."""
    return np.array([-np.sin(_TURN) * np.cos(_TILT), np.cos(_TURN) * np.cos(_TILT), -np.sin(_TILT)])


def _middle(geometry: Polyhedron, faces: Faces) -> Array:
    corners = np.concatenate([geometry.vertices[list(geometry.faces[int(i)])] for i in faces])
    return np.asarray(corners.mean(axis=0))


@checked
def bars(verification: Verification) -> Any:
    """Return the three bars: the mean gap at held-out pairs as stated, calibrated, corrected."""
    figure, axes = new_figure(5.5, 3.6)
    draw_bars(axes, verification)
    return figure


@checked
def draw_bars(axes: Any, verification: Verification) -> None:
    """Draw the three bars into axes; whiskers are the range over the simulator's seeds."""
    labels = ("as stated", "calibrated", "corrected\nand calibrated")
    for x, (model, colour, hatch) in enumerate(
        zip(MODELS, ("0.7", BLUE, GREEN), ("", "//", ".."), strict=True)
    ):
        gaps = verification.gap(model)
        mean = float(gaps.mean())
        error = [[mean - float(gaps.min())], [float(gaps.max()) - mean]]
        axes.bar(
            x,
            mean,
            width=0.6,
            color=colour,
            hatch=hatch,
            edgecolor=BLACK,
            yerr=error if len(gaps) > 1 else None,
            capsize=4,
        )
        axes.annotate(
            f"{mean:.1f}", (x, mean), xytext=(0, 6), textcoords="offset points", ha="center"
        )
    axes.axhline(1.0, color=BLACK, linestyle=":", linewidth=1)
    axes.set_xticks(range(len(labels)), labels)
    axes.set_ylabel("Mean gap at pairs not fitted / JND")
    axes.margins(y=0.15)
