"""The figures of where: the room with its surfaces, the plan, the map of disagreement, three bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from string import ascii_uppercase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.marks import rms
from rtcal.acoustics.observables import parameter_label
from rtcal.finder.positions.finding import Place, PositionsFinding
from rtcal.finder.positions.surfaces import Faces, kind
from rtcal.finder.positions.verification import MODELS, PositionsVerification
from rtcal.report.figures import BLACK, BLUE, GREEN, ORANGE, new_figure, number_map, shown
from rtcal.report.room_view import ABOVE, TURNS, axes_of
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.types import Array

_SHOWN = 0.02
"""Smallest probability of a surface that is written beside it."""
_MOST_ROWS = 24
"""Most pairs that have a row of their own in the map."""
_SIZE = 9
"""Size in points of all text: 7 px on a phone."""
_HATCHES = ("//", "\\\\", "..", "xx", "++")
_BOX = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}


def room(finding: PositionsFinding, place: Place | None = None) -> Any:
    """Return the room in an axonometric view, each surface as orange as it is probable.

    Surfaces that the positions do not tell apart have a common letter and hatch. ``place`` is a further
    receiver, as `rtcal.finder.positions.next_position` proposes it.
    """
    figure, axes = new_figure(6.5, 5.2)
    draw_room(axes, finding, place)
    return figure


def draw_room(axes: Any, finding: PositionsFinding, place: Place | None = None) -> None:
    """Draw the room in an axonometric view into axes; see `room`.

    Surfaces towards the reader are outlines, so that the room can be looked into.
    """
    case, geometry = finding.case, finding.case.geometry
    probability, letters = _probabilities(finding), _letters(finding)
    turn = _turn(geometry, case.faces, probability)
    flat, into = _projected(geometry.vertices, turn), axes_of(turn, ABOVE)[2]
    depth = geometry.vertices @ into
    of_face = {int(i): name for name, faces in case.faces.items() for i in faces}
    seen = geometry.normals @ into > 0
    every = range(len(geometry.faces))
    for i in sorted(every, key=lambda i: (not seen[i], -depth[[*geometry.faces[i]]].mean())):
        corners = flat[list(geometry.faces[i])]
        name = of_face.get(i, "")
        chance = probability.get(name, 0.0)
        if seen[i]:
            axes.fill(*corners.T, facecolor="0.97", edgecolor="none")
        axes.fill(
            *corners.T, facecolor=ORANGE, alpha=(0.9 if seen[i] else 0.3) * chance, linewidth=0
        )
        if seen[i] and chance >= _SHOWN and name in letters:
            hatch = _HATCHES[ascii_uppercase.index(letters[name]) % len(_HATCHES)]
            axes.fill(*corners.T, facecolor="none", edgecolor="0.45", hatch=hatch, linewidth=0)
    _outlines(axes, geometry, of_face, flat, seen)
    _stands(axes, finding, place, turn)
    above = _explained(probability, letters)
    for name, faces in case.faces.items():
        if (chance := probability[name]) < _SHOWN:
            continue
        if kind(geometry, faces) != "wall":  # its middle is where the positions are
            above.append(f"{_lettered(name, letters)}: {100 * chance:.0f} %")
            continue
        middle = _projected(_middle(geometry, faces)[np.newaxis], turn)[0]
        label = f"{_lettered(name, letters)}\n{100 * chance:.0f} %"
        style = {"ha": "center", "va": "center", "bbox": _BOX, "zorder": 9}
        axes.annotate(label, middle, fontsize=_SIZE, **style)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_title("\n".join(above), fontsize=_SIZE, loc="left")
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.02), "ncols": 3, "frameon": False}
    axes.legend(fontsize=_SIZE, **below)


def _probabilities(finding: PositionsFinding) -> dict[str, float]:
    """Return the probability of each surface, 0 where hardly anything stands on one."""
    none = finding.verdict == "none" or not finding.likely_surfaces
    return {n: 0.0 if none else finding.surfaces.get(n, 0.0) for n in finding.case.faces}


def _letters(finding: PositionsFinding) -> dict[str, str]:
    """Return a letter for the surfaces of each group that is in question."""
    chance = _probabilities(finding)
    groups = [g for g in finding.groups if max(chance[name] for name in g) >= _SHOWN]
    return {name: letter for letter, g in zip(ascii_uppercase, groups, strict=False) for name in g}


def _lettered(name: str, letters: Mapping[str, str]) -> str:
    return shown(name, 24) + (f" ({letters[name]})" if name in letters else "")


def _explained(probability: Mapping[str, float], letters: Mapping[str, str]) -> list[str]:
    """Return what percentages and letters say."""
    shares = any(chance >= _SHOWN for chance in probability.values())
    return ["%: probability that it is this surface"] * shares + [
        f"({letter}) not told apart by these positions" for letter in sorted(set(letters.values()))
    ]


def _outlines(
    axes: Any,
    geometry: Polyhedron,
    of_face: Mapping[int, str],
    flat: Array,
    seen: NDArray[np.bool_],
) -> None:
    """Draw the edges between surfaces; those of surfaces towards the reader alone are thin."""
    owners: dict[tuple[int, int], list[int]] = {}
    for i, face in enumerate(geometry.faces):
        for a, b in zip(face, [*face[1:], face[0]], strict=True):
            owners.setdefault((min(a, b), max(a, b)), []).append(i)
    for (a, b), faces in owners.items():
        names = {of_face.get(i, f"face {i}") for i in faces}
        if len(faces) > 1 and len(names) == 1:
            continue  # within one surface
        far = any(seen[i] for i in faces)
        axes.plot(
            *flat[[a, b]].T,
            color="0.35" if far else "0.5",
            linewidth=1.0 if far else 0.9,
            linestyle="-" if far else "--",
        )


def _stands(axes: Any, finding: PositionsFinding, place: Place | None, turn: float) -> None:
    """Draw sources, receivers and a proposed place, each on a line from the floor."""
    simulator = finding.case.simulator
    low = float(finding.case.geometry.vertices[:, 2].min())
    if (middle := _most_probable(finding)) is not None:
        x, y = _projected(np.array([middle]), turn)[0]
        _mark(axes, x, y, "X", BLACK)
    for name, point, marker, colour in _points(simulator.sources, simulator.receivers, place):
        foot = (point[0], point[1], low)
        x, y = _projected(np.array([point, foot]), turn).T
        axes.plot(x, y, color="0.6", linewidth=0.8, zorder=6)
        _mark(axes, x[0], y[0], marker, colour)
        axes.annotate(
            name,
            (x[0], y[0]),
            xytext=(5, 4),
            textcoords="offset points",
            fontsize=_SIZE,
            zorder=8,
        )


def _most_probable(finding: PositionsFinding) -> Sequence[float] | None:
    """Return the middle of the part on which something most probably stands; None without one."""
    located = finding.located
    return None if finding.verdict == "none" or located is None else located.middle


def _mark(axes: Any, x: float, y: float, marker: str, colour: str) -> None:
    """Draw what stands in the room; the first of a kind has a label."""
    kinds = {
        "^": "source",
        "o": "receiver",
        "*": "further receiver",
        "X": "most probable part of its surface",
    }
    label = kinds[marker]
    if label in axes.get_legend_handles_labels()[1]:
        label = "_" + label
    style = {"linestyle": "none", "markersize": 8, "zorder": 7, "label": label}
    axes.plot(x, y, marker=marker, color=colour, **style)


def _points(
    sources: Mapping[str, Any], receivers: Mapping[str, Any], place: Place | None
) -> list[tuple[str, Any, str, str]]:
    """Return name, place, marker and colour of all that stands in the room."""
    out = [(shown(n, 12), p, "^", BLACK) for n, p in sources.items()]
    out += [(shown(n, 12), p, "o", BLUE) for n, p in receivers.items()]
    if place is not None:
        out.append(("measure here", place.point, "*", GREEN))
    return out


def _turn(geometry: Polyhedron, faces: Mapping[str, Faces], chance: Mapping[str, float]) -> float:
    """Return the direction of view in which probable surfaces are seen from inside."""

    def seen(turn: float) -> float:
        into = axes_of(turn, ABOVE)[2]
        return sum(
            chance[name]
            * float(np.average(geometry.normals[of] @ into > 0, weights=geometry.face_areas[of]))
            for name, of in faces.items()
        )

    return float(max(TURNS, key=seen))


def _projected(points: Array, turn: float) -> Array:
    """Return points (n, 3) in the axonometric view, (n, 2)."""
    return np.asarray(points @ axes_of(turn, ABOVE)[:2].T)


def _middle(geometry: Polyhedron, faces: Faces) -> Array:
    """Return the middle of a surface's triangles, by area."""
    triangles = geometry.triangles[np.isin(geometry.triangle_faces, faces)]
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.asarray(np.average(triangles.mean(axis=1), axis=0, weights=areas))


def plan(finding: PositionsFinding, place: Place | None = None) -> Any:
    """Return the map on the plan: which pairs disagree, and which walls could mend it.

    A line joins source and receiver. It is as dark as the root mean square of the pair's residuals in
    standard deviations. Walls are as orange as they are probable. ``place`` is a further receiver.
    """
    case, geometry = finding.case, finding.case.geometry
    corners = geometry.vertices[:, :2]
    size, centre = np.ptp(corners, axis=0), (corners.min(axis=0) + corners.max(axis=0)) / 2
    probability, letters = _probabilities(finding), _letters(finding)
    above = _explained(probability, letters)
    figure, axes = new_figure(6.5, float(np.clip(6.0 * size[1] / size[0], 3.0, 6.5)) + 1.8)
    for name, faces in case.faces.items():
        chance = probability[name]
        wall = kind(geometry, faces) == "wall"
        for i in faces:
            x, y, _ = geometry.vertices[[*geometry.faces[i], geometry.faces[i][0]]].T
            axes.plot(x, y, color="0.6", linewidth=1 if wall else 0, zorder=1)
            if wall and chance >= _SHOWN:
                style = {"color": ORANGE, "alpha": min(1.0, 0.15 + chance), "linewidth": 7}
                axes.plot(x, y, zorder=2, solid_capstyle="butt", **style)
        if chance >= _SHOWN:
            label = f"{_lettered(name, letters)}: {100 * chance:.0f} %"
            if wall:
                middle = _middle(geometry, faces)[:2]
                # Into the room, so that no label of a side wall stands on the axis.
                side = 0 if abs(middle[0] - centre[0]) < 0.3 * size[0] else middle[0] - centre[0]
                align = {0: "center", -1: "left", 1: "right"}[int(np.sign(side))]
                style = {"ha": align, "va": "center", "bbox": _BOX, "zorder": 9}
                axes.annotate(label, middle, fontsize=_SIZE, **style)
            else:
                above.append(label)
    z = rms(finding.map, (0, 2))
    most = max(2.0, float(np.nanmax(z)))
    sources, receivers = case.simulator.sources, case.simulator.receivers
    for (source, receiver), value in zip(finding.pairs, z, strict=True):
        x, y, _ = np.array([sources[source], receivers[receiver]], dtype=float).T
        grey = str(0.88 * (1 - min(value / most, 1.0)))
        axes.plot(x, y, color=grey, linewidth=0.8 + 2.2 * min(value / most, 1.0), zorder=3)
    for name, point, marker, colour in _points(sources, receivers, place):
        _mark(axes, point[0], point[1], marker, colour)
        style = {"xytext": (6, 6), "textcoords": "offset points", "zorder": 5, "bbox": _BOX}
        axes.annotate(name, point[:2], fontsize=_SIZE, **style)
    axes.set_aspect("equal")
    axes.set_xlabel("x / m", fontsize=_SIZE)
    axes.set_ylabel("y / m", fontsize=_SIZE)
    axes.tick_params(labelsize=_SIZE)
    above.append(
        "line: source to receiver; the darkest pair disagrees by "
        f"{float(np.nanmax(z)):.1f} standard deviations"
    )
    axes.set_title("\n".join(above), fontsize=_SIZE, loc="left")
    handles, names = axes.get_legend_handles_labels()
    style = {"loc": "outside lower center", "ncols": 3, "frameon": False}
    figure.legend(handles, names, fontsize=_SIZE, **style)
    return figure


def disagreement(finding: PositionsFinding) -> Any:
    """Return the map as tables, in standard deviations: pairs by parameters, parameters by bands."""
    names = [parameter_label(p) for p in finding.parameters]
    frequencies = [f"{f:g}" for f in finding.case.room.centre_frequencies]
    of_pairs = rms(finding.map, (2,)).T
    of_bands = rms(finding.map, (1,))
    most = max(2.0, float(np.nanmax(of_pairs)), float(np.nanmax(of_bands)))
    rows = len(of_pairs) if len(of_pairs) <= _MOST_ROWS else 0
    figure, panels = new_figure(6.0, 2.2 + 0.3 * len(names) + 0.3 * rows, 2 if rows else 1)
    below = panels[1] if rows else panels
    image = _table(below, of_bands, names, frequencies, most)
    below.set_xlabel("Band centre frequency / Hz", fontsize=_SIZE)
    if rows:
        pairs = [shown(" to ".join(pair), 20) for pair in finding.pairs]
        _table(panels[0], of_pairs, pairs, names, most)
        panels[0].xaxis.tick_top()
    bar = figure.colorbar(image, ax=panels, location="bottom", aspect=40)
    bar.set_label("Disagreement / standard deviations", fontsize=_SIZE)
    bar.ax.tick_params(labelsize=_SIZE)
    return figure


def _table(axes: Any, z: Array, rows: Sequence[str], columns: Sequence[str], most: float) -> Any:
    """Draw a table of numbers, each on a ground that is as dark as it is large."""
    image = number_map(axes, z, rows, (0, most), "cividis_r", ".1f")
    axes.set_xticks(range(len(columns)), columns, fontsize=_SIZE)
    return image


def bars(verification: PositionsVerification) -> Any:
    """Return the three bars: the mean gap at held-out pairs as stated, calibrated, corrected."""
    figure, axes = new_figure(6.0, 3.8)
    draw_bars(axes, verification)
    return figure


def draw_bars(axes: Any, verification: PositionsVerification) -> None:
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
            f"{mean:.2f}",
            (x, float(gaps.max())),
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
        )
    axes.axhline(1.0, color=BLACK, linestyle=":", linewidth=1)
    axes.annotate("1 JND", (1.5, 1.0), xytext=(0, 3), textcoords="offset points", ha="center")
    axes.set_xticks(range(len(labels)), labels)
    axes.set_ylabel("Mean gap at pairs not fitted / JND")
    axes.margins(y=0.15)
