"""The figures of all results, and the folder of a calibration. No other module imports matplotlib.

The figures can be read in grey and by colour-blind readers: each line has its own marker and style,
each bar its own hatch, and the colours are Okabe and Ito's (2008).
"""

from __future__ import annotations

import io
import os
import textwrap
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.marks import gap_jnd, letters, rms
from rtcal.acoustics.observables import TARGET, parameter_label
from rtcal.acoustics.priors import NORMAL_90
from rtcal.files.disk import write_all, write_bytes
from rtcal.files.saved import NUMBERS
from rtcal.support import checks
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rtcal.acoustics.comparison import Comparison
    from rtcal.acoustics.room import Room
    from rtcal.calibration.result import CalibrationResult
    from rtcal.finder.finding import Finding
    from rtcal.finder.positions.places import Place
    from rtcal.finder.verification import Verification
    from rtcal.io.mend import Faces
    from rtcal.loop.closed import Loop
    from rtcal.loop.positions import PositionsResult
    from rtcal.modes.calibrate import ModesResult
    from rtcal.simulators.geometry import Polyhedron

__all__ = ["gap", "rendered", "reverberation_time", "save"]
__dir__ = __all__.copy

BLACK, ORANGE, BLUE, GREEN = "#000000", "#D55E00", "#0072B2", "#009E73"
MEASURED: dict[str, Any] = {"color": BLACK, "marker": "o", "linestyle": "none"}
BEFORE: dict[str, Any] = {"color": ORANGE, "marker": "s", "linestyle": "--"}
AFTER: dict[str, Any] = {"color": BLUE, "marker": "o", "markersize": 10, "markerfacecolor": "none"}
"""Styles of the lines for measured values, and for a model before and after its calibration."""
_LONGEST_NAME = 40
_MANY_BANDS = 10
MOST_PANELS = 12
"""Largest number of materials for which a figure draws a panel each; the page's table has more."""
_FEW = 6
_MOST_AXES = 10_000  # a panel takes 0.1 MB
ROOM, FIGURE, PLAN = "room.toml", "reverberation_time.png", "plan.png"
FILES = (ROOM, NUMBERS, FIGURE)
"""Names of the figures in the folder of a calibration."""
POSITION_FILES = (ROOM, NUMBERS, PLAN)
"""Names of the figures in the folder of a calibration to every position."""


def new_figure(
    width: float = 7.0, height: float = 4.2, rows: int = 1, columns: int = 1
) -> tuple[Any, Any]:
    """Return a new figure and its axes, for drawing without a screen.

    ``width`` and ``height`` are in inches. The figure has ``rows`` times ``columns`` axes, in the form
    of ``matplotlib.figure.Figure.subplots``. Raises MissingDependencyError if matplotlib is not
    installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingDependencyError(
            "figures need matplotlib: pip install 'rtcal[report]'"
        ) from error
    checks.positive("width", width, "in")
    checks.positive("height", height, "in")
    if checks.whole("rows", rows, 1) * checks.whole("columns", columns, 1) > _MOST_AXES:
        raise DataError(f"the figure would have more than {_MOST_AXES} panels")
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns)


def shown(name: str, longest: int = _LONGEST_NAME) -> str:
    r"""Return a name as a figure shows it: whole, in lines of at most ``longest`` characters.

    A dollar sign, which would begin a formula, is escaped.

    Examples
    --------
    >>> shown("a $10 panel")
    'a \\$10 panel'
    >>> shown("perforated gypsum board", 16)
    'perforated\ngypsum board'
    """
    line = "".join(c if c.isprintable() else "?" for c in name)
    return "\n".join(textwrap.wrap(line, longest) or [line]).replace("$", r"\$")


def of_materials(
    materials: Sequence[str],
    areas: Array,
    size: Array,
    frequencies: Array,
    draw: Callable[[Any, int], None],
    columns: int,
    pieces: Collection[str] = (),
) -> Any:
    """Return a figure with a small panel for each material, at most twelve, over the bands.

    If there are more materials, those with the largest ``size`` (n_materials,) are drawn. ``draw`` is a
    function that draws the panel of a material, from the panel's axes and the material's number.
    ``areas`` are in m², ``frequencies`` in Hz. The legend has at most ``columns`` columns.
    ``pieces`` are the names of materials whose ``areas`` are numbers of pieces.
    """
    chosen = np.sort(np.argsort(-size, kind="stable")[:MOST_PANELS])
    n = len(chosen)
    abreast = min(2 if n <= _FEW else 3, n)
    figure, every = _panels(n, abreast, 2.4 * -(-n // abreast) + 0.7, frequencies)
    for axes, i in zip(every, chosen, strict=True):
        axes.tick_params(labelsize=8.5)
        draw(axes, int(i))
        unit = "pieces" if materials[i] in pieces else "m²"
        axes.set_title(f"{shown(materials[i], 28)}, {areas[i]:.4g} {unit}", fontsize=9)
    _legend(figure, every[0], min(n, columns))
    return figure


def _panels(n: int, abreast: int, height: float, frequencies: Array) -> tuple[Any, list[Any]]:
    """Return a figure of this height in inches, and its n panels over few of the bands."""
    rows = -(-n // abreast)
    figure, grid = new_figure(max(5.0, 3.1 * abreast), height, rows, abreast)
    every = [*np.atleast_1d(grid).ravel()]
    for axes in every[n:]:
        axes.set_visible(False)
    few = frequencies[:: -(-len(frequencies) // 4)]
    for axes in every[:n]:
        band_axis(axes, frequencies)
        axes.set_xticks(few, [f"{f:g}" for f in few], rotation=0)
        axes.set_xlabel("Band / Hz", fontsize=9)
    return figure, every[:n]


def band_axis(axes: Axes, frequencies: Array, below: list[str] | None = None) -> None:
    """Make x a logarithmic axis with the bands' centre frequencies, each with its text of ``below``.

    ``axes`` are those of the figure, and ``frequencies`` are in Hz; ``below`` is None for no texts.
    """
    many = len(frequencies) > _MANY_BANDS
    labels = [f"{f:g}" for f in frequencies]
    if below is not None:
        labels = [f"{a}{' ' if many else chr(10)}{b}" for a, b in zip(labels, below, strict=True)]
    axes.set_xscale("log")
    axes.set_xticks(frequencies, labels, rotation=90 if many else 0)
    axes.minorticks_off()
    axes.set_xlabel("Band centre frequency / Hz")


def jnd_band(axes: Axes, frequencies: Array, measured: Array) -> None:
    """Draw measured T plus and minus one JND in grey; bands without T interrupt it.

    ``axes`` are those of the figure, ``frequencies`` the bands in Hz, and ``measured`` is T in s,
    (n_bands,).
    """
    low, high = (1 - TARGET.jnd) * measured, (1 + TARGET.jnd) * measured
    axes.fill_between(frequencies, low, high, color="0.85", label="measured ± 1 JND")
    axes.vlines(frequencies, low, high, color="0.85", linewidth=8)  # visible also for a single band


def _times_axes(axes: Axes, frequencies: Array, label: str, top: float | None = None) -> None:
    """Make axes those of times over the bands, from 0 to ``top``, with a legend."""
    band_axis(axes, frequencies)
    axes.set_ylim(bottom=0, top=top)
    axes.set_ylabel(f"{label} / s")
    axes.legend()


_UPRIGHT = 0.5  # largest vertical part of the normal of a wall


def _legend(figure: Any, axes: Axes, columns: int) -> None:
    """Add a legend below a figure, with each label once."""
    drawn = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(drawn.values(), drawn, loc="outside lower center", ncols=columns, fontsize=9)


def _outline(axes: Axes, geometry: Polyhedron) -> None:
    """Draw the walls of a room from above, to scale."""
    for face, normal in zip(geometry.faces, geometry.normals, strict=True):
        x, y, _ = geometry.vertices[[*face, face[0]]].T
        axes.plot(x, y, color="0.7", linewidth=int(abs(normal[2]) < _UPRIGHT), zorder=1)
    axes.set_aspect("equal")
    axes.set_xlabel("x / m")
    axes.set_ylabel("y / m")


def _note(axes: Axes, text: str, at: Any, offset: tuple[float, float], **style: Any) -> None:
    """Write a text in points beside a place."""
    axes.annotate(text, at, xytext=offset, textcoords="offset points", fontsize=9, **style)


def reverberation_time(result: CalibrationResult) -> Any:
    """Return the figure of T over frequency: measured with one JND, and before and after calibration.

    A letter below a band stands for a caution, which the axis label names. ``result`` is what
    `rtcal.calibrate` returns.
    """
    figure, axes = new_figure()
    f, measured = result.prior.centre_frequencies, result.measured
    error = np.nan_to_num(result.measured_uncertainty)
    jnd_band(axes, f, measured)
    axes.errorbar(
        f, measured, error, **MEASURED, capsize=3, label="measured, ± standard uncertainty"
    )
    axes.plot(f, result.reverberation_time_before, **BEFORE, label="model before calibration")
    axes.plot(f, result.reverberation_time_after, **AFTER, label="model after calibration")
    _times_axes(axes, f, "Reverberation time T")
    band_axis(axes, f, [letters(result.trust_marks, v) for v in f])
    if marks := [f"{m.letter} {m.title}".strip() for m in result.trust_marks]:
        key = f"\ncautions: {', '.join(dict.fromkeys(marks))}"
        axes.set_xlabel(axes.get_xlabel() + key)
    axes.set_title(shown(f"{result.prior.name}: {result.method}, {result.equation.name}", 70))
    return figure


def gap(result: CalibrationResult) -> Any:
    """Return the figure of modelled minus measured T in JND, before and after calibration.

    It has a bar for each band before and a dot after calibration. ``result`` is what `rtcal.calibrate`
    returns.
    """
    figure, axes = new_figure(7.0, 3.2)
    f = result.prior.centre_frequencies
    at = np.arange(len(f))
    axes.set_xticks(at, [f"{v:g}" for v in f], rotation=90 if len(f) > _MANY_BANDS else 0)
    axes.set_xlabel("Band centre frequency / Hz")
    axes.axhspan(-1, 1, color="0.85", label="within 1 JND (5 %)")
    axes.axhline(0, color=BLACK, linewidth=0.8)
    bars = {"facecolor": "#F5C9A6", "edgecolor": ORANGE, "hatch": "//"}
    axes.bar(at, result.gap_before, 0.5, **bars, label="model before calibration")
    dots = {"color": BLUE, "marker": "o", "linestyle": "none", "markersize": 8}
    axes.plot(at, result.gap_after, **dots, label="model after calibration")
    axes.set_ylabel("Deviation of T (model - measured) / JND")
    axes.set_title(shown(result.prior.name, 70))
    axes.legend()
    return figure


def disagreement(comparison: Comparison) -> Any:
    """Return the figure of a simulation's deviations in JND by band, for the six worst parameters."""
    c, f = comparison, comparison.run.room.centre_frequencies
    chosen = c.parameters[:_FEW]
    abreast = min(3, len(chosen))
    figure, every = _panels(len(chosen), abreast, 2.7 * -(-len(chosen) // abreast) + 0.6, f)
    for axes, p in zip(every, chosen, strict=True):
        axes.axhspan(-1, 1, color="0.85", label="1 JND")
        axes.axhline(0, color=BLACK, linewidth=0.8)
        off, (centre, open_) = c.deviation[p], c.coefficients[p]
        style = {"color": ORANGE, "linewidth": 7, "alpha": 0.3}
        axes.vlines(f, centre - 2 * open_, centre + 2 * open_, **style, label="coefficients")
        style = {"color": "0.4", "marker": ".", "markersize": 3, "linestyle": "none"}
        for pair in c.at_pairs.get(p, ()):
            axes.plot(f, pair, **style, label="pairs")
        error = 2 * np.nan_to_num(c.uncertainty[p])
        style = {"color": BLUE, "marker": "o", "linestyle": "--", "capsize": 3}
        axes.errorbar(f, off, yerr=error, **style, label="mean")
        axes.set_title(parameter_label(p), fontsize=10)
    every[0].set_ylabel("deviation / JND", fontsize=9)
    _legend(figure, every[0], 4)
    return figure


def coefficients(result: CalibrationResult) -> Any:
    """Return the figure of input and calibrated alpha by material and band, with 90 % intervals.

    If there are more than twelve materials, those with the largest absorption area are drawn. The
    interval of the input is alpha ± 1.645 sigma, limited to 0 to 1. ``result`` is what
    `rtcal.calibrate` returns.
    """
    room, bound = result.prior, result.active != 0
    size = np.max(room.areas[:, np.newaxis] * result.alpha, axis=1)
    model = "calibrated, 90 %", AFTER, result.alpha, result.interval
    figure = _of_alpha(room, size, [model], 2, bound)
    figure.suptitle("α by band (each panel has its own scale)", fontsize=11)
    return figure


def _of_alpha(
    room: Room,
    size: Array,
    models: Sequence[tuple[str, dict[str, Any], Array, tuple[Array, Array]]],
    columns: int,
    bound: NDArray[np.bool_] | None = None,
) -> Any:
    """Return the figure of alpha by material: of the input and of models, each with its interval.

    A model is its label, its style, alpha and both ends of the 90 % interval, (n_materials, n_bands).
    ``bound`` is True where the first model gets a star.
    """
    f = room.centre_frequencies
    apart = float(f[1] / f[0]) ** 0.12 if len(f) > 1 else 1.0
    wide = NORMAL_90 * room.sigma
    ends = (room.alpha - wide).clip(0), np.minimum(room.alpha + wide, room.most_alpha)
    every = [("input, 90 %", BEFORE, room.alpha, ends), *models]
    small = {"linestyle": "none", "markersize": 4, "markerfacecolor": "white", "capsize": 2}

    def draw(axes: Any, i: int) -> None:
        for k, (label, style, alpha, (low, high)) in enumerate(every):
            at = f * apart ** (k - len(models) / 2)
            bars = np.maximum([alpha[i] - low[i], high[i] - alpha[i]], 0)
            axes.errorbar(at, alpha[i], yerr=bars, **{**style, **small}, label=shown(label))
            if k == 1 and bound is not None:
                star = {"color": BLACK, "markersize": 11, "zorder": 5, "clip_on": False}
                places = at[bound[i]], alpha[i][bound[i]]
                (stars,) = axes.plot(*places, "*", **star, label="at a bound")
                stars.set_in_layout(False)
        axes.set_ylabel("α" if room.is_surface[i] else "m² per piece", fontsize=9)
        axes.set_ylim(0, None)
        axes.margins(y=0.1)

    return of_materials(room.materials, room.areas, size, f, draw, columns, room.pieces)


def plane(
    mu: Array,
    sigma: Array,
    areas: Array,
    target: float,
    alpha: Array,
    *,
    names: tuple[str, str] = ("1", "2"),
    correlation: float = 0.0,
    truth: Array | None = None,
    title: str = "",
) -> Any:
    """Return the figure of a calibration of two coefficients (Bellows & Katz 2025, Figs. 1 and 3).

    It shows ellipses of 1, 2 and 3 standard deviations ``sigma`` about the input coefficients ``mu``,
    the line of all coefficients that give the measured absorption area ``target`` in m², and the step
    from mu to the calibrated ``alpha`` on this line. ``correlation`` is that between both coefficients.
    ``truth`` are the true coefficients; None draws none. Arrays are (2,), and ``areas`` are in m².

    ``names`` are those of the two materials, and ``title`` is the text above the figure.
    """
    mu, sigma, areas, alpha = (np.asarray(v, dtype=float) for v in (mu, sigma, areas, alpha))
    figure, axes = new_figure(5.6, 5.9)
    turn = np.linspace(0, 2 * np.pi, 361)
    circle = np.array([np.cos(turn), np.sin(turn)])
    root = np.array([[1.0, 0.0], [correlation, np.sqrt(1 - correlation**2)]])
    for n, style in ((1, "-"), (2, "--"), (3, ":")):
        ellipse = mu[:, np.newaxis] + n * sigma[:, np.newaxis] * (root @ circle)
        axes.plot(*ellipse, color="0.45", linestyle=style, linewidth=1, label=f"input, {n} σ")
    points = np.array([alpha] if truth is None else [alpha, truth], dtype=float)
    reach = np.maximum(3.3 * sigma, 1.2 * np.abs(points - mu).max(axis=0)).clip(0.02)
    low, high = np.maximum(mu - reach, -0.02), np.minimum(mu + reach, 1.02)
    across = np.linspace(low[0], high[0], 2)
    line = (target - areas[0] * across) / areas[1]
    axes.plot(across, line, color=BLACK, linewidth=1.8, label="gives the measured T")
    axes.annotate(
        "", xy=alpha, xytext=mu, arrowprops={"arrowstyle": "->", "color": BLUE, "linewidth": 1.5}
    )
    square = {**BEFORE, "linestyle": "none", "markersize": 8, "markerfacecolor": "white"}
    axes.plot(*mu, **square, label="input")
    axes.plot(*alpha, "o", color=BLUE, markersize=8, label="calibrated")
    if truth is not None:
        axes.plot(*points[1], "*", color=GREEN, markersize=13, label="true")
    for end in (0.0, 1.0):
        axes.axvline(end, color=BLACK, linewidth=0.6, linestyle="-.")
        axes.axhline(end, color=BLACK, linewidth=0.6, linestyle="-.")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel(f"α of {shown(names[0], 30)}, {areas[0]:.4g} m²")
    axes.set_ylabel(f"α of {shown(names[1], 30)}, {areas[1]:.4g} m²")
    axes.set_title(title)
    figure.legend(loc="outside lower center", ncols=3, fontsize=9)
    return figure


def decays_of_modes(result: ModesResult) -> Any:
    """Return the figure of the modes' decay times over frequency: measured, before and after."""
    from rtcal.modes.room_modes import DECAY

    figure, axes = new_figure()
    f = result.modes.frequencies[result.used]
    t, relative = DECAY / result.measured, result.modes.decay_uncertainty[result.used]
    axes.errorbar(f, t, t * relative / result.measured, fmt="o", color=BLACK, label="measured")
    axes.plot(f, DECAY / result.before, "x", color=ORANGE, label="before")
    axes.plot(f, DECAY / result.after, "s", color=BLUE, fillstyle="none", label="after")
    axes.set_xlabel("frequency / Hz")
    axes.set_ylabel("T / s")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small")
    return figure


_MARKERS = "o^vDPX<>"
_STYLES = ("-", "--", "-.", ":")


def path(loop: Loop) -> Any:
    """Return the figure of the simulations of a closed loop, like Fig. 7 of Bellows & Katz (2025).

    The upper part has the measured T20 with one JND, and the simulated T20 of the first, the
    intermediate and each band's best step. The lower part has the deviation of each band in JND over
    the simulations. Raises DataError for a loop without a simulation.
    """
    if not loop.steps:
        raise DataError("the loop has no simulation yet, so there is nothing to draw")
    figure, (above, below) = new_figure(6.2, 7.6, 2, 1)
    f, wanted = loop.prior.centre_frequencies, loop.wanted
    simulated = np.array([step.simulated for step in loop.steps])
    jnd_band(above, f, wanted)
    above.plot(f, wanted, **MEASURED | {"linestyle": "-", "markersize": 4}, label="measured")
    for step, times in enumerate(simulated[1:-1], start=2):
        label = "in between" if step == 2 else None
        above.plot(f, times, color="0.45", linestyle=":", linewidth=1, label=label)
    above.plot(f, simulated[0], **BEFORE, label="first simulation")
    nearest = simulated[loop.best, np.arange(len(f))]
    above.plot(f, nearest, **AFTER, label="nearest, by band")
    _times_axes(above, f, loop.matched.label.removeprefix("the "))
    above.set_title(shown(loop.prior.name, 45))
    gaps = np.array([gap_jnd(times, wanted) for times in simulated])
    steps = np.arange(1, len(gaps) + 1)
    below.axhspan(-1, 1, color="0.85")
    below.axhline(0, color=BLACK, linewidth=0.8)
    greys = np.linspace(0.0, 0.6, len(f))
    for k, frequency in enumerate(f):
        blue = (greys[k], 0.25 + 0.65 * greys[k], 0.45 + 0.35 * greys[k])
        marker = _MARKERS[k % len(_MARKERS)]
        line = {"linestyle": _STYLES[(k + k // len(_MARKERS)) % len(_STYLES)], "marker": marker}
        below.plot(steps, gaps[:, k], color=blue, **line, label=f"{frequency:g} Hz")
    below.set_xticks(steps)
    below.set_xlim(0.7, len(steps) + 0.3)
    reach = 1.2 * max(1.5, float(np.nanmax(np.abs(gaps), initial=0.0)))
    below.set_ylim(-reach, reach)
    below.set_xlabel("Simulation number")
    below.set_ylabel("Deviation (simulated - measured) / JND")
    below.set_title("Deviation by simulation (grey: within 1 JND)")
    below.legend(fontsize=9, ncols=2 if len(f) > 8 else 1)
    return figure


_VARIANTS = ((ORANGE, "o"), (BLUE, "s"), (GREEN, "^"), ("#CC79A7", "D"), ("#E69F00", "v"))


def predicted_times(
    frequencies: Array,
    before: Array,
    variants: Sequence[tuple[str, Array, tuple[Array, Array]]],
    target: tuple[Array, Array] | None = None,
) -> Any:
    """Return the figure of T over frequency before a change, and with each variant of the change.

    ``frequencies`` in Hz and T ``before`` in s are (n_bands,). A variant is its name, its T, and both
    ends of the 90 % interval of T. ``target`` has both ends of the required range of T, NaN where there
    is no limit; None draws no range.
    """
    figure, axes = new_figure()
    top = 1.1 * max(float(np.nanmax(before)), *(float(ends[1].max()) for _, _, ends in variants))
    if target is not None:
        low, high = np.nan_to_num(target[0]), np.where(np.isnan(target[1]), top, target[1])
        bounded = np.isfinite(target[0]) | np.isfinite(target[1])
        width = 2**0.25
        for f, a, b in zip(frequencies[bounded], low[bounded], high[bounded], strict=True):
            axes.fill_between([f / width, f * width], [a, a], [b, b], color="0.87", linewidth=0)
        axes.fill_between([], [], [], color="0.87", label="target")
    axes.plot(frequencies, before, color=BLACK, linestyle="--", marker=".", label="before")
    for i, (name, mean, (low, high)) in enumerate(variants):
        colour, marker = _VARIANTS[i % len(_VARIANTS)]
        moved = frequencies * 1.03 ** (i - (len(variants) - 1) / 2)
        style = {"color": colour, "marker": marker, "capsize": 3, "linestyle": "-"}
        ends = np.maximum([mean - low, high - mean], 0.0)  # rounding, where nothing changes
        axes.errorbar(moved, mean, yerr=ends, **style, label=shown(name))
    _times_axes(axes, frequencies, "T", top)
    return figure


def change(finding: Finding) -> Any:
    """Return the figure of the change of the absorption area by band, with its interval.

    ``finding`` is what `rtcal.find` returns for two states.
    """
    k = finding.case.known
    figure, axes = new_figure()
    frequencies = finding.case.room.centre_frequencies[k]
    mean, low, high = finding.change[:, k]
    ends = np.maximum(np.array([mean - low, high - mean]), 0.0)
    axes.axhline(0, color=BLACK, linewidth=0.8)
    axes.errorbar(frequencies, mean, yerr=ends, color=BLUE, marker="s", capsize=3)
    band_axis(axes, frequencies)
    axes.set_ylabel("change of the absorption area / m²")
    return figure


_PLAIN: dict[str, Any] = {"color": GREEN, "marker": "^"}
_CORRECTED: dict[str, Any] = {"color": BLUE, "marker": "D"}
"""Marks of the calibration without the effect that was found, and of the one with it."""


def corrected_times(verification: Verification) -> Any:
    """Return the figure of T over frequency: measured, input, calibrated, and with the effect.

    ``verification`` is what `rtcal.finder.verify` returns.
    """
    from rtcal.finder.verification import reverberation_times
    from rtcal.report.finding_words import title

    finding = verification.finding
    f = finding.case.room.centre_frequencies
    times = reverberation_times(finding, *verification.calibrations)
    figure, axes = new_figure()
    jnd_band(axes, f, times["measured"])
    axes.plot(f, times["measured"], **MEASURED, label="measured")
    for name, style, label in (
        ("input", BEFORE, "input"),
        ("calibrated", {**_PLAIN, "linestyle": ":"}, "calibrated"),
        ("corrected", _CORRECTED, f"calibrated with {title(finding)}"),
    ):
        axes.plot(f, times[name], **style, fillstyle="none", label=shown(label))
    _times_axes(axes, f, "Reverberation time T")
    return figure


def corrected_shifts(verification: Verification) -> Any:
    """Return the figure of alpha as input and as calibrated, without and with a found effect.

    It has a panel for each material, with 90 % intervals. If there are more than `MOST_PANELS`
    materials, those whose absorption area changed most are drawn. ``verification`` is what
    `rtcal.finder.verify` returns.
    """
    room, models = verification.finding.case.room, verification.calibrations
    moved = np.max([np.abs(x.alpha - room.alpha).max(1) for x in models], axis=0) * room.areas
    labels = "calibrated, 90 %", f"calibrated with {verification.effect}, 90 %"
    drawn = [
        (label, style, x.alpha, x.interval)
        for label, style, x in zip(labels, (_PLAIN, _CORRECTED), models, strict=True)
    ]
    return _of_alpha(room, moved, drawn, 1)


_SHOWN = 0.02  # smallest probability of a surface that is written beside it
_BOX = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}


def likely_shares(finding: Finding) -> dict[str, float]:
    """Return the probability of each surface; 0 for all if none is likely to differ."""
    none = finding.verdict == "none" or not finding.likely_surfaces
    return {n: 0.0 if none else finding.surfaces.get(n, 0.0) for n in finding.case.faces}


def plan(finding: Finding, place: Place | None = None, axes: Any = None) -> Any:
    """Return the plan of a room with the pairs that disagree and the surfaces that may differ.

    A line joins source and receiver of a pair. It is darker for a larger root mean square deviation, in
    standard deviations. A more probable wall is more orange. Surfaces that the positions do not
    distinguish have the same letter. ``place`` is a proposed position for a further receiver; None
    draws none. ``axes`` are those to draw on; None means a new figure. ``finding`` is what `rtcal.find`
    returns for a comparison at positions.
    """
    from matplotlib.colors import to_rgb

    from rtcal.finder.positions.surfaces import kind
    from rtcal.report.finding_words import percent

    case, geometry, located = finding.case, finding.case.geometry, finding.located
    corners, probability = geometry.vertices[:, :2], likely_shares(finding)
    size, centre = np.ptp(corners, axis=0), (corners.min(axis=0) + corners.max(axis=0)) / 2
    groups = [g for g in finding.groups if max(probability[name] for name in g) >= _SHOWN]
    letter = {n: c for c, group in zip(ascii_uppercase, groups, strict=False) for n in group}
    some = any(chance >= _SHOWN for chance in probability.values())
    above = ["%: probability that it is this surface"] * some
    above += [
        f"({c}) cannot be distinguished by these positions" for c in sorted(set(letter.values()))
    ]
    if axes is None:
        _, axes = new_figure(6.5, float(np.clip(6.0 * size[1] / size[0], 3.0, 6.5)) + 1.8)
    _outline(axes, geometry)
    for name, faces in case.faces.items():
        chance = probability[name]
        if chance < _SHOWN:
            continue
        group = f" ({letter[name]})" if name in letter else ""
        label = f"{shown(name, 24)}{group}: {percent(chance)}"
        if kind(geometry, faces) != "wall":
            above.append(label)
            continue
        # Mixed with white: a wall of several faces would add up their opacities.
        orange = 1 - min(1.0, 0.15 + chance) * (1 - np.array(to_rgb(ORANGE)))
        for i in faces:
            x, y, _ = geometry.vertices[[*geometry.faces[i], geometry.faces[i][0]]].T
            axes.plot(x, y, color=orange, linewidth=7, zorder=2, solid_capstyle="butt")
        middle = np.average(
            [geometry.vertices[list(geometry.faces[i])].mean(axis=0)[:2] for i in faces],
            axis=0,
            weights=geometry.face_areas[faces],
        )
        # Into the room, so that no label of a side wall stands on the axis.
        side = 0 if abs(middle[0] - centre[0]) < 0.3 * size[0] else middle[0] - centre[0]
        align = {0: "center", -1: "left", 1: "right"}[int(np.sign(side))]
        axes.annotate(label, middle, fontsize=9, ha=align, va="center", bbox=_BOX, zorder=9)
    z = rms(finding.map, (0, 2))
    most = max(2.0, float(np.nanmax(z)))
    sources, receivers = case.simulator.sources, case.simulator.receivers
    for (source, receiver), value in zip(finding.pairs, z, strict=True):
        x, y, _ = np.array([sources[source], receivers[receiver]], dtype=float).T
        dark = min(value / most, 1.0)
        axes.plot(x, y, color=str(0.88 * (1 - dark)), linewidth=0.8 + 2.2 * dark, zorder=3)
    stands = [("source", "^", BLACK, *each) for each in sources.items()]
    stands += [("receiver", "o", BLUE, *each) for each in receivers.items()]
    if place is not None:
        stands.append(("further receiver", "*", GREEN, "measure here", place.point))
    if finding.verdict != "none" and located is not None and located.middle is not None:
        stands.append(("most probable part of its surface", "X", BLACK, "", located.middle))
    for what, marker, colour, name, point in stands:
        axes.plot(*point[:2], marker, color=colour, markersize=8, zorder=7, label=what)
        if name:
            _note(axes, shown(name, 12), point[:2], (6, 6), zorder=5, bbox=_BOX)
    darkest = f"{float(np.nanmax(z)):.1f} standard deviations"
    above += ["line: source to receiver;", f"the darkest pair disagrees by {darkest}"]
    axes.set_title("\n".join(above), fontsize=9, loc="left")
    _legend(axes.figure, axes, 3)
    return axes.figure


def bars(verification: Verification, axes: Any = None) -> Any:
    """Return the figure of mean deviations at held-out data: input, calibrated and corrected model.

    Whiskers show the range over the seeds of the simulator. ``axes`` may be None for new ones.
    ``verification`` is what `rtcal.finder.verify` returns.
    """
    if axes is None:
        _, axes = new_figure(5.2, 3.8)
    looks = (("0.7", ""), (BLUE, "//"), (GREEN, ".."))
    for x, (gaps, (colour, hatch)) in enumerate(zip(verification.by_seed, looks, strict=True)):
        mean, top = float(gaps.mean()), float(gaps.max())
        error = [[mean - float(gaps.min())], [top - mean]] if len(gaps) > 1 else None
        style = {"color": colour, "hatch": hatch, "edgecolor": BLACK}
        axes.bar(x, mean, width=0.6, yerr=error, capsize=4, **style)
        _note(axes, f"{mean:.2f}", (x, top), (0, 6), ha="center", bbox=_BOX)
    axes.axhline(1.0, color=BLACK, linestyle=":", linewidth=1)
    _note(axes, "1 JND", (1.5, 1.0), (0, 3), ha="center")
    names = [n.replace(" and", "\nand") for n in verification.models]
    axes.set_xticks(range(3), names)
    what = "data" if verification.finding.kind == "means" else "pairs"
    axes.set_ylabel(f"Mean deviation at {what} not fitted / JND")
    axes.margins(y=0.15)
    return axes.figure


def position_gaps(
    result: PositionsResult,
    geometry: Polyhedron,
    sources: Mapping[str, Sequence[float]],
    receivers: Mapping[str, Sequence[float]],
) -> Any:
    """Return plans of a room with receivers coloured by deviation, before and after calibration.

    The deviation of a receiver is the root mean square over parameters, bands and sources, in JND, and
    is written beside its name. ``result`` is the calibration, and ``geometry`` is the room's mesh.
    ``sources`` and ``receivers`` are positions (x, y, z) in m, by name. Raises DataError if a receiver
    of the result has no position.
    """
    names = list(dict.fromkeys(r for _, r in result.pairs))
    if missing := [name for name in names if name not in receivers]:
        raise DataError(f'receiver "{missing[0]}" of the result has no position')
    rows = [[i for i, (_, r) in enumerate(result.pairs) if r == name] for name in names]
    ends = result.gap_before, result.gap_after
    gaps = [np.array([rms(gap[:, row]) for row in rows]) for gap in ends]
    figure, axes = new_figure(6.2, 8.4, 2, 1)
    colours = {"cmap": "cividis_r", "vmin": 0, "vmax": max(2.0, float(np.nanmax(gaps)))}
    style = {**colours, "s": 110, "edgecolors": BLACK, "zorder": 3}
    points = np.array([receivers[r] for r in names], dtype=float)
    drawn = None
    for panel, gap, when in zip(axes, gaps, ("before", "after"), strict=True):
        _outline(panel, geometry)
        for name, place in sources.items():
            panel.plot(*place[:2], "^", color=ORANGE, markersize=9, label="source")
            _note(panel, shown(name, 12), place[:2], (6, 6))
        drawn = panel.scatter(*points.T[:2], c=gap, **style, label="receiver: its deviation in JND")
        for name, place, value in zip(names, points, gap, strict=True):
            _note(panel, f"{shown(name, 12)}: {value:.1f}", place[:2], (6, 6))
        panel.set_title(f"{when} calibration: deviation {rms(gap):.1f} JND")
    _legend(figure, axes[0], 2)
    figure.colorbar(drawn, ax=list(axes), label="Root mean square deviation of a receiver / JND")
    return figure


_RASTERIZED = 500
"""Number of faces of a room above which its picture is of dots, so that a page stays small."""
_MOST_NAMES = 40


def room(
    geometry: Polyhedron,
    colours: Sequence[str],
    views: Sequence[tuple[float, float, Sequence[int]]],
    stands: Sequence[tuple[str, str, Sequence[float], str]],
    scale: tuple[str, Sequence[str], tuple[float, float]],
) -> Any:
    """Return the figure of a room in which each face has its colour, seen from several sides.

    ``colours`` has one for each face. A view is (turn, tilt, faces): angles in radians about the z axis
    and above the horizontal, and the numbers of the faces that are drawn. ``stands`` are sources and
    receivers, each (kind, name, position in m, colour). ``scale`` is the colour bar: its label, its
    colours, and the values at its ends.
    """
    figure, _ = new_figure(6.6, 3.7)
    figure.clear()
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    corners = geometry.vertices
    low, high = corners.min(axis=0), corners.max(axis=0)
    for k, (turn, tilt, faces) in enumerate(views):
        options: dict[str, Any] = {"projection": "3d", "proj_type": "ortho"}
        axes = figure.add_subplot(1, len(views), k + 1, **options, computed_zorder=False)
        walls = Poly3DCollection(
            [corners[[*geometry.faces[i]]] for i in faces],
            zsort="max",
            facecolors=[colours[i] for i in faces],
            edgecolors="#4d4d4d",
            linewidths=0.4,
            clip_on=False,
        )
        walls.set_rasterized(len(faces) > _RASTERIZED)
        axes.add_collection3d(walls)
        for kind, name, (x, y, z), colour in stands:
            axes.plot([x, x], [y, y], [z, low[2]], color="0.5", linewidth=0.8)
            marker = "^" if kind == "source" else "o"
            axes.plot([x], [y], [z], marker, color=colour, markeredgecolor=BLACK)
            if len(stands) <= _MOST_NAMES:
                axes.text(x, y, z, f"  {shown(name, 12)}", fontsize=9)
        axes.view_init(np.degrees(tilt), np.degrees(turn) - 90)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        axes.set_box_aspect(np.maximum(high - low, 1e-3), zoom=0.95)
        axes.set_axis_off()
    label, shades, ends = scale
    mapped = ScalarMappable(Normalize(*ends), LinearSegmentedColormap.from_list(label, shades))
    bar = figure.colorbar(mapped, ax=figure.axes, location="bottom", aspect=40)
    bar.set_label(shown(label, 80), fontsize=9)
    return figure


def wireframe(mesh: Polyhedron | Faces, open_edges: Array | None = None) -> Any:
    """Return the figure of a mesh, as drawn or repaired.

    ``open_edges`` (n, 2, 3) are the ends in m of edges that are drawn in red; None draws none. Each
    material has its own shade; the legend names those with the largest areas.
    """
    from rtcal.simulators.geometry import Polyhedron

    if isinstance(mesh, Polyhedron):
        polygons = [mesh.vertices[list(face)] for face in mesh.faces]
    else:
        polygons = [np.asarray(polygon) for polygon in mesh.polygons]
    figure, _ = new_figure(9.0, 7.0)
    figure.clear()
    axes = figure.add_subplot(projection="3d")
    of_material: dict[str, list[Array]] = {}
    for polygon, material in zip(polygons, mesh.materials, strict=True):
        of_material.setdefault(material, []).append(np.concatenate([polygon, polygon[:1]]))
    for material, loops in of_material.items():
        between = np.full((1, 3), np.nan)
        line = np.concatenate([part for loop in loops for part in (loop, between)])
        axes.plot(*line.T, linewidth=0.6, label=shown(material))
    if open_edges is not None and len(open_edges):
        gaps = np.concatenate([np.concatenate([e, np.full((1, 3), np.nan)]) for e in open_edges])
        axes.plot(*gaps.T, color="red", linewidth=2, label=f"{len(open_edges)} open edges")
    corners = np.concatenate(polygons)
    axes.set_box_aspect(np.maximum(np.ptp(corners, axis=0), 1e-3), zoom=0.9)
    for axis in "xyz":
        getattr(axes, f"set_{axis}label")(f"{axis} / m")
    if len(of_material) <= 20:
        figure.legend(fontsize="x-small", loc="outside right upper")
    return figure


def rendered(figure: Figure, kind: str) -> bytes:
    """Return a figure as the bytes of a file of the given ``kind``: "png", "svg" or "pdf".

    The same figure always gives the same bytes.
    """
    import matplotlib

    _check_kind(kind, kind)
    stream = io.BytesIO()
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with warnings.catch_warnings(), matplotlib.rc_context({"svg.hashsalt": "rtcal"}):
        # Characters that the font lacks appear as boxes, without a warning.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        if (layout := figure.get_layout_engine()) is not None:
            layout.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(stream, format=kind, dpi=150, metadata=undated)
    return stream.getvalue()


def save(figure: Any, path: str | os.PathLike[str]) -> None:
    """Write a figure as a PNG, SVG or PDF file, by the ending of the path, whole or not at all."""
    kind = os.path.splitext(os.fspath(path))[1].lstrip(".").lower()
    _check_kind(kind, os.fspath(path))
    write_bytes(path, rendered(figure, kind))


def _check_kind(kind: str, place: str) -> None:
    if kind not in ("png", "svg", "pdf"):
        raise DataError(f'{place}: a figure must end in .png, .svg or .pdf, not ".{kind}"')


def write_folder(
    result: CalibrationResult | PositionsResult | ModesResult,
    folder: Path,
    draw: Mapping[str, Callable[[], Any]],
) -> list[Path]:
    """Write the room, the numbers and the figures of a result into a folder, all or none.

    ``draw`` has, by the name of each figure's file, the function that returns the figure. Without
    matplotlib no figures are written, and a warning is given.
    """
    contents = {
        folder / ROOM: result.room.to_text(folder).encode(),
        folder / NUMBERS: result.to_json(folder).encode(),
    }
    try:
        pictures = {name: rendered(figure(), "png") for name, figure in draw.items()}
        contents |= {folder / name: picture for name, picture in pictures.items()}
    except MissingDependencyError as error:
        warnings.warn(f"no figure{'s' * (len(draw) > 1)}: {error}", stacklevel=checks.stack_level())
    write_all(contents, folder)
    return list(contents)
