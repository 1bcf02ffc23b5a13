"""The figures of a finding: the measured T, the residuals, the evidence, decay and shifts."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np

from rtcal.acoustics.observables import DecaySlope, of_kind
from rtcal.acoustics.priors import NORMAL_90
from rtcal.finder.claim import CLAIMED, SAID
from rtcal.finder.means.finding import MeansFinding, feature_names
from rtcal.finder.means.problem import state
from rtcal.finder.means.verification import MeansVerification, residual_map, reverberation_times
from rtcal.finder.prior import NONE
from rtcal.report.document import MOST, odds
from rtcal.report.figures import (
    BLACK,
    BLUE,
    GREEN,
    MOST_PANELS,
    ORANGE,
    band_axis,
    band_places,
    jnd_band,
    new_figure,
    number_map,
    panels,
    shown,
)
from rtcal.support.types import Array

__all__ = [
    "bends",
    "decay",
    "evidence",
    "probabilities",
    "residuals",
    "reverberation_time",
    "shifts",
]
__dir__ = __all__.copy

_STRONG = 4.0
"""Residual in standard deviations at which the colours of the map saturate."""
_BENT = 0.01
"""Least visible change of ln EDT/T20 or ln T30/T20 in a drawn decay."""


def reverberation_time(verification: MeansVerification) -> Any:
    """Return T(f) of the first configuration: measured, prior, plainly calibrated, corrected."""
    finding = verification.finding
    f, times = finding.case.room.centre_frequencies, reverberation_times(verification)[0]
    measured = times["measured"]
    figure, axes = new_figure()
    jnd_band(axes, f, measured)
    axes.plot(f, measured, color=BLACK, marker="o", linestyle="none", label="measured")
    for name, colour, marker, style, label in (
        ("prior", ORANGE, "s", "--", "prior"),
        ("plain", GREEN, "^", ":", "plainly calibrated"),
        ("corrected", BLUE, "D", "-", f"with {finding.title}, calibrated"),
    ):
        values = times[name]
        axes.plot(
            f,
            values,
            color=colour,
            marker=marker,
            linestyle=style,
            fillstyle="none",
            label=shown(label),
        )
    band_axis(axes, f)
    axes.set_ylabel("Reverberation time T / s")
    axes.set_ylim(bottom=0)
    axes.legend()
    return figure


def residuals(finding: MeansFinding, verification: MeansVerification | None = None) -> Any:
    """Return the residual map: feature by band and configuration; before, and after the effect."""
    maps = [("The model as stated", finding.residuals)]
    if verification is not None:
        maps.append((f"The model with {finding.title}", residual_map(verification)))
    f = finding.case.room.centre_frequencies
    rows = [
        (c, k)
        for c in range(len(finding.residuals))
        for k in range(finding.residuals.shape[1])
        if np.isfinite(finding.residuals[c, k]).any()
    ]
    names = [c.name for c in finding.case.configurations]
    several = len(names) > 1
    figure, axes = new_figure(6.4, 1.9 + 0.36 * len(rows) * len(maps), rows=len(maps))
    for axis, (title, table) in zip(np.atleast_1d(axes), maps, strict=True):
        cells = np.array([table[c, k] for c, k in rows])
        labels = [
            feature_names(finding.case.configurations[c].measured)[k]
            + (f" of {shown(names[c], 20)}" if several else "")
            for c, k in rows
        ]
        image = number_map(axis, cells, labels, (-_STRONG, _STRONG), "PuOr", "+.1f")
        band_places(axis, f)
        axis.set_xlabel("")  # it stands below the last map alone
        axis.set_title(shown(title), fontsize=9)
    # One colour bar for all maps, below them, since its label does not fit beside a flat map.
    all_cells = np.array([[table[c, k] for c, k in rows] for _, table in maps])
    beyond = np.array([np.nanmin(all_cells) < -_STRONG, np.nanmax(all_cells) > _STRONG])
    extend = {(1, 1): "both", (1, 0): "min", (0, 1): "max"}.get(tuple(beyond), "neither")
    figure.colorbar(
        image,
        ax=[*np.atleast_1d(axes)],
        label="(model - measured) / standard deviation",
        extend=extend,
        location="bottom",
        aspect=40,
    )
    axis.set_xlabel("Band centre frequency / Hz")
    return figure


def evidence(finding: MeansFinding) -> Any:
    """Return the evidence of every effect as bars, with the threshold."""
    names = list(finding.evidence)
    values = np.array([finding.evidence[n] for n in names])
    top = max(float(values.max()), finding.threshold)
    figure, axes = new_figure(6.4, 0.8 + 0.28 * len(names))
    at = np.arange(len(names))[::-1]
    is_candidate = [n in finding.names for n in names]
    # Bars of large negative evidence are cut, and marked by an arrow.
    low = -0.15 * top
    drawn = np.maximum(values, low)
    axes.barh(
        at,
        drawn,
        color=["#9DC6E0" if h else "0.85" for h in is_candidate],
        edgecolor=BLACK,
        hatch=["//" if h else "" for h in is_candidate],
    )
    behind = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}  # the threshold's line is cut
    for y, value, end in zip(at, values, drawn, strict=True):
        axes.annotate(
            odds(float(value)) if value < np.log(MOST) else "> 10⁶ to 1",
            (max(end, 0.0), y),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            bbox=behind,
        )
    cut = values < low
    if cut.any():
        axes.plot(
            np.full(cut.sum(), 0.85 * low),
            at[cut],
            color=BLACK,
            marker="<",
            linestyle="none",
            markersize=5,
            label="cut: the number is beyond the axis",
        )
    axes.axvline(
        finding.threshold,
        color=ORANGE,
        linestyle="--",
        label=f"threshold {odds(finding.threshold)}",
    )
    axes.axvline(0, color=BLACK, linewidth=0.8)
    axes.set_xlim(low, 1.15 * top)
    axes.set_yticks(at, [shown(n) for n in names])
    powers = np.arange(0, max(1, int(1.15 * top / np.log(10))) + 1)
    powers = powers[:: 1 + len(powers) // 8]
    axes.set_xticks(np.log(10) * powers, [f"$10^{{{k}}}$" if k > 1 else str(10**k) for k in powers])
    axes.set_xlabel("Odds to one against “nothing is missing”; hatched: candidates")
    axes.legend(loc="lower right")
    return figure


def bends(verification: MeansVerification) -> bool:
    """Whether the effect bends the decay: whether EDT/T20 or T30/T20 change visibly."""
    shapes = [model.features[:, 1:3] for model in (verification.plain, verification.corrected)]
    return bool(np.abs(shapes[1] - shapes[0]).max() > _BENT)


def probabilities(finding: MeansFinding) -> Any:
    """Return the figure of the probability of each effect that it is there at all."""
    names = [n for n, p in finding.probabilities.items() if p >= SAID and n != NONE]
    figure, axes = new_figure(6.0, 1.2 + 0.32 * max(len(names), 1))
    at = np.arange(len(names))[::-1]
    member = [n in finding.members for n in names]
    values = np.array([finding.probabilities[n] for n in names])
    axes.barh(
        at,
        100 * values,
        color=["#9DC6E0" if m else "0.85" for m in member],
        edgecolor=BLACK,
        hatch=["//" if m else "" for m in member],
    )
    for y, name, value in zip(at, names, values, strict=True):
        axes.text(100 * value, y, f" {finding.percent(name)}", va="center", fontsize=9)
    axes.axvline(100 * CLAIMED, color=ORANGE, linestyle="--", label="claimed from here on")
    axes.set_xlim(0, 115)
    axes.set_yticks(at, [shown(n) for n in names])
    axes.set_xlabel("Probability that it is there / %; hatched: the most probable set")
    axes.legend(loc="lower right")
    return figure


def decay(verification: MeansVerification) -> Any:
    """Return the decay of the band with the largest residual of shape: measured, plain, corrected."""
    finding = verification.finding
    case = finding.case
    first = case.configurations[0]
    shape = np.abs(finding.residuals[0, 1:3])
    band = int(np.nanargmax(np.nanmax(np.where(np.isfinite(shape), shape, -1), axis=0)))
    t20 = float(first.measured.decay_time().mean[band])
    t = np.linspace(0, 0.8 * t20, 200)
    figure, axes = new_figure()
    for slope, style in zip(of_kind(DecaySlope).values(), cycle(("--", ":", "-"))):
        value = float(first.measured.mean(slope.key)[band])
        if np.isfinite(value):
            levels = np.array([slope.upper, slope.lower])
            axes.plot(
                -levels / 60 * value,
                levels,
                color=BLACK,
                linestyle=style,
                linewidth=3,
                alpha=0.5,
                label=f"measured {slope.label} {value:.2f} s",
            )
    for model, colour, style, label in (
        (verification.plain, GREEN, "-.", "plainly calibrated"),
        (verification.corrected, BLUE, "-", f"with {finding.best_effect}"),
    ):
        axes.plot(
            t,
            _level(model.case, model.alpha, band, t),
            color=colour,
            linestyle=style,
            label=shown(label),
        )
    axes.set_ylim(-40, 1)
    axes.set_xlabel("Time / s")
    axes.set_ylabel(f"Level at {case.room.centre_frequencies[band]:g} Hz / dB")
    axes.legend()
    return figure


def _level(case: Any, alpha: Array, band: int, t: Array) -> Array:
    room_state = state(case, case.configurations[0], alpha)
    decayed = room_state.decay()
    weights, rates = decayed.weights[band], decayed.rates[band]
    left = (weights / rates * np.exp(-np.outer(t, rates))).sum(1)
    total = (weights / rates).sum()
    if room_state.floor_db is not None:
        density = 10 ** (room_state.floor_db / 10) * weights.sum()
        end = room_state.record * 6 * np.log(10) * total / weights.sum()
        left, total = left + density * np.maximum(end - t, 0), total + density * end
    return np.asarray(10 * np.log10(np.maximum(left / total, 1e-9)))


def shifts(verification: MeansVerification) -> Any:
    """Return each material's shift of alpha by band, plain and corrected, with 90 % intervals.

    The prior's interval is grey. If there are more than `MOST_PANELS` materials, the figure shows those
    whose absorption area moved most.
    """
    room = verification.finding.case.room
    models = (verification.plain, verification.corrected)
    moved = np.max([np.abs(x.alpha - room.alpha).max(1) for x in models], axis=0) * room.areas
    drawn = np.sort(np.argsort(-moved, kind="stable")[:MOST_PANELS])
    f = room.centre_frequencies
    figure, small = panels(len(drawn), f)
    for axes, i in zip(small, drawn, strict=True):
        wide = NORMAL_90 * room.sigma[i]
        ends = np.clip([room.alpha[i] - wide, room.alpha[i] + wide], 0, 1) - room.alpha[i]
        axes.fill_between(f, *ends, color="0.88", label="prior, 90 %")
        axes.axhline(0, color=BLACK, linewidth=0.8)
        for by, x, colour, marker, label in (
            (0.95, models[0], GREEN, "^", "plainly calibrated, 90 %"),
            (1.05, models[1], BLUE, "D", f"with {verification.finding.best_effect}, 90 %"),
        ):
            low, high = x.interval
            bars = [x.alpha[i] - low[i], high[i] - x.alpha[i]]
            axes.errorbar(
                f * by,
                x.alpha[i] - room.alpha[i],
                yerr=np.maximum(bars, 0),
                color=colour,
                marker=marker,
                markersize=4,
                linestyle="none",
                capsize=2,
                label=shown(label),
            )
        axes.set_ylabel("shift of α", fontsize=9)
        axes.set_title(f"{shown(room.materials[i], 25)}, {room.areas[i]:.4g} m²", fontsize=9)
    figure.legend(*small[0].get_legend_handles_labels(), loc="outside lower center", fontsize=9)
    return figure
