"""Figures of a closed loop's steps, and of a calibration to every position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.quality import gap_jnd, rms
from rtcal.report.figures import (
    BLACK,
    BLUE,
    ORANGE,
    ROOM,
    band_axis,
    jnd_band,
    new_figure,
    shown,
    write_with_figures,
)
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.results import NUMBERS
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.loop.positions_result import PositionsResult
    from rtcal.loop.state import Loop
    from rtcal.simulators.geometry import Polyhedron

__all__ = ["path"]
__dir__ = __all__.copy


PLAN, SHIFTS = "plan.png", "shifts.png"
POSITION_FILES = (ROOM, NUMBERS, PLAN, SHIFTS)
"""Files of the folder of a calibration to every position."""
_MOST_NUMBERS = 200
"""Largest number of coefficients whose shifts are printed in their cells."""


@checked
def plan(
    result: PositionsResult,
    geometry: Polyhedron,
    sources: Mapping[str, Sequence[float]],
    receivers: Mapping[str, Sequence[float]],
) -> Any:
    """Return a plan of the room with its receivers coloured by their gap, before and after.

    A receiver's gap is the root mean square over parameters, bands and sources, in JND. It stands
    beside the receiver's name.

    Raises
    ------
    DataError
        If a receiver of the result has no position.
    """
    if missing := [r for _, r in result.pairs if r not in receivers]:
        raise DataError(f'receiver "{missing[0]}" of the result has no position')
    faces = [geometry.vertices[list(face)] for face in geometry.faces]
    return draw_plan(result.pairs, (result.gap_before, result.gap_after), faces, sources, receivers)


def draw_plan(
    pairs: Sequence[tuple[str, str]],
    before_and_after: tuple[Array, Array],
    faces: Sequence[Array],
    sources: Mapping[str, Any],
    receivers: Mapping[str, Any],
) -> Any:
    """Return the figure of `plan` from gaps in JND, each (n_parameters, n_pairs, n_bands)."""
    heard = list(dict.fromkeys(r for _, r in pairs))
    gaps = [_by_receiver(pairs, gap, heard) for gap in before_and_after]
    figure, axes = new_figure(6.2, 8.4, 2, 1)
    most = max(2.0, *(float(np.nanmax(gap)) for gap in gaps))
    points = np.array([receivers[r] for r in heard], dtype=float)
    drawn = None
    for panel, gap, when in zip(axes, gaps, ("before", "after"), strict=True):
        for face in faces:
            corners = np.vstack([face, face[:1]])
            panel.plot(corners[:, 0], corners[:, 1], color="0.75", linewidth=1)
        for name, place in sources.items():
            panel.plot(*place[:2], "^", color=ORANGE, markersize=9, label="source")
            _label(panel, place, shown(name, 12))
        drawn = panel.scatter(
            points[:, 0],
            points[:, 1],
            c=gap,
            cmap="cividis_r",
            vmin=0,
            vmax=most,
            s=110,
            edgecolors=BLACK,
            zorder=3,
            label="receiver: its gap in JND",
        )
        for name, place, value in zip(heard, points, gap, strict=True):
            _label(panel, place, f"{shown(name, 12)}: {value:.1f}")
        panel.set_aspect("equal")
        panel.set_title(f"{when} calibration: gap {rms(gap):.1f} JND")
        panel.set_ylabel("y / m")
    axes[1].set_xlabel("x / m")
    markers = dict(zip(*reversed(axes[0].get_legend_handles_labels()), strict=True))
    figure.legend(markers.values(), markers, loc="outside lower center", ncols=2, fontsize=9)
    figure.colorbar(drawn, ax=list(axes), label="Root mean square gap of a receiver / JND")
    return figure


@checked
def shifts(result: PositionsResult) -> Any:
    """Return the figure of how far each coefficient moved, in prior sigmas, by material and band."""
    return draw_shifts(result.shift, result.prior.materials, result.prior.centre_frequencies)


def draw_shifts(moved: Array, materials: Sequence[str], frequencies: Array) -> Any:
    """Return the figure of `shifts` from shifts in prior sigmas, (n_materials, n_bands)."""
    n_materials, n_bands = moved.shape
    figure, axes = new_figure(2.4 + 0.55 * n_bands, 1.6 + 0.32 * n_materials)
    reach = max(2.0, float(np.max(np.abs(moved))))
    image = axes.imshow(moved, cmap="RdBu_r", vmin=-reach, vmax=reach, aspect="auto")
    axes.set_yticks(range(n_materials), [shown(m, 30) for m in materials])
    labels = [f"{f:g}" for f in frequencies]
    axes.set_xticks(range(n_bands), labels, rotation=90 if n_bands > 10 else 0)
    axes.set_xlabel("Band centre frequency / Hz")
    if moved.size <= _MOST_NUMBERS:
        for (i, k), value in np.ndenumerate(moved):
            dark = abs(value) > 0.6 * reach
            axes.text(
                k,
                i,
                f"{value:+.1f}",
                ha="center",
                va="center",
                fontsize=9,
                color="white" if dark else BLACK,
            )
    figure.colorbar(image, ax=axes, label="Shift of α / prior σ")
    return figure


def _by_receiver(pairs: Sequence[tuple[str, str]], gap: Array, receivers: Sequence[str]) -> Array:
    """Return the root mean square gap of each receiver in JND, NaN without a value."""
    rows = [[i for i, (_, r) in enumerate(pairs) if r == name] for name in receivers]
    return np.array([rms(gap[:, row]) for row in rows])


def _label(panel: Any, place: Any, text: str) -> None:
    panel.annotate(
        text, (place[0], place[1]), xytext=(6, 6), textcoords="offset points", fontsize=9
    )


def write_positions(
    result: PositionsResult,
    folder: Path,
    geometry: Polyhedron,
    sources: Mapping[str, Sequence[float]],
    receivers: Mapping[str, Sequence[float]],
) -> list[Path]:
    """Write room, numbers and figures, all or none, and return their paths.

    Without matplotlib there are no figures, and a warning says so.

    Raises
    ------
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    draw = {
        PLAN: lambda: plan(result, geometry, sources, receivers),
        SHIFTS: lambda: shifts(result),
    }
    return write_with_figures(result, folder, draw)


_MARKERS = "o^vDPX<>"
_STYLES = ("-", "--", "-.", ":")


@checked
def path(loop: Loop) -> Any:
    """Return the figure of a loop's path, like Fig. 7 of Bellows & Katz (2025).

    Above: the measured T20 with its band of one JND, and the simulated T20 of the first, the
    intermediate and each band's best step. Below: each band's gap in JND over the simulations.

    Raises
    ------
    DataError
        If nothing has been simulated yet.
    """
    if not loop.steps:
        raise DataError("the loop has no simulation yet: there is no path to show")
    figure, (above, below) = new_figure(6.2, 7.6, 2, 1)
    f, wanted = loop.room.centre_frequencies, loop.wanted
    jnd_band(above, f, wanted)
    above.plot(f, wanted, color=BLACK, marker="o", markersize=4, label="measured")
    simulated = np.array([step.simulated for step in loop.steps])
    for number, times in enumerate(simulated[1:-1], start=2):
        above.plot(
            f,
            times,
            color="0.45",
            linestyle=":",
            linewidth=1,
            label="in between" if number == 2 else None,
        )
    above.plot(f, simulated[0], color=ORANGE, marker="s", linestyle="--", label="first simulation")
    above.plot(
        f,
        simulated[loop.best, np.arange(len(f))],
        color=BLUE,
        marker="o",
        markersize=10,
        markerfacecolor="none",
        label="nearest, by band",
    )
    band_axis(above, f)
    above.set_ylabel(f"{loop.matched.label.removeprefix('the ')} / s")
    above.set_ylim(bottom=0)
    above.set_title(shown(loop.room.name, 45))
    above.legend(fontsize=9)
    gaps = np.array([gap_jnd(times, wanted) for times in simulated])
    steps = np.arange(1, len(gaps) + 1)
    below.axhspan(-1, 1, color="0.85")
    below.axhline(0, color=BLACK, linewidth=0.8)
    greys = np.linspace(0.0, 0.6, len(f))
    for k, frequency in enumerate(f):
        blue = (greys[k], 0.25 + 0.65 * greys[k], 0.45 + 0.35 * greys[k])
        below.plot(
            steps,
            gaps[:, k],
            color=blue,
            marker=_MARKERS[k % len(_MARKERS)],
            linestyle=_STYLES[(k + k // len(_MARKERS)) % len(_STYLES)],
            label=f"{frequency:g} Hz",
        )
    below.set_xticks(steps)
    below.set_xlim(0.7, len(steps) + 0.3)
    reach = 1.2 * max(1.5, float(np.nanmax(np.abs(gaps), initial=0.0)))
    below.set_ylim(-reach, reach)
    below.set_xlabel("Simulation number")
    below.set_ylabel("Gap (simulated - measured) / JND")
    below.set_title("Gap by simulation (grey: within 1 JND)")
    below.legend(fontsize=9, ncols=2 if len(f) > 8 else 1)
    return figure
