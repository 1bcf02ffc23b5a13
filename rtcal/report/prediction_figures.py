"""Pictures of predictions and designs: T with its interval and its target, the parts, the frontier."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rtcal.report.figures import BLACK, BLUE, GREEN, ORANGE, band_axis, new_figure, shown
from rtcal.support.types import Array

_STYLES = ((ORANGE, "o"), (BLUE, "s"), (GREEN, "^"), ("#CC79A7", "D"), ("#E69F00", "v"))
_HATCHES = ("", "///", "...", "xxx", "\\\\\\", "+++", "ooo", "---")
_MOST_PARTS = 6


def times(
    frequencies: Array,
    before: Array,
    variants: Sequence[tuple[str, Array, tuple[Array, Array]]],
    target: tuple[Array, Array] | None = None,
) -> Any:
    """Return T(f) before, and of each variant with its 90 % interval, over the range of the target.

    Parameters
    ----------
    frequencies, before : array (n_bands,)
        Hz; T in s.
    variants : sequence of (name, T, (low, high))
    target : (low, high), optional
        T in s; NaN where an end is open.
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
        colour, marker = _STYLES[i % len(_STYLES)]
        moved = frequencies * 1.03 ** (i - (len(variants) - 1) / 2)
        axes.errorbar(
            moved,
            mean,
            yerr=np.array([mean - low, high - mean]),
            color=colour,
            marker=marker,
            capsize=3,
            linestyle="-",
            label=shown(name),
        )
    band_axis(axes, frequencies)
    axes.set_ylim(0, top)
    axes.set_ylabel("T / s")
    axes.legend(fontsize="small")
    return figure


def parts(frequencies: Array, shares: Mapping[str, Array]) -> Any:
    """Return the parts of the variance as stacked bars over the bands, the largest at the bottom."""
    figure, axes = new_figure(height=3.6)
    bottom = np.zeros(len(frequencies))
    places = np.arange(len(frequencies))
    named = list(shares.items())
    rest = np.sum([share for _, share in named[_MOST_PARTS:]], axis=0)
    drawn = named[:_MOST_PARTS] + ([("the rest", rest)] if len(named) > _MOST_PARTS else [])
    greys = np.linspace(0.35, 0.95, len(drawn))
    for i, (name, share) in enumerate(drawn):
        axes.bar(
            places,
            100 * share,
            bottom=bottom,
            color=str(greys[i]),
            hatch=_HATCHES[i % len(_HATCHES)],
            edgecolor=BLACK,
            linewidth=0.5,
            label=shown(name),
        )
        bottom = bottom + 100 * share
    axes.set_xticks(places, [f"{f:g}" for f in frequencies])
    axes.set_xlabel("Band centre frequency / Hz")
    axes.set_ylabel("share of the variance / %")
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def frontier(costs: Mapping[float, float], promised: float, cost: float) -> Any:
    """Return cost against probability; the design's point is filled."""
    figure, axes = new_figure(width=5.0, height=3.2)
    known = {p: c for p, c in costs.items() if np.isfinite(c)}
    axes.plot(list(known), list(known.values()), color=BLUE, marker="o", fillstyle="none")
    axes.plot([promised], [cost], color=ORANGE, marker="o", linestyle="", label="this design")
    for p in costs:
        if p not in known:
            axes.axvline(p, color="0.6", linestyle=":")
            place = {"xytext": (-3, 4), "textcoords": "offset points", "ha": "right"}
            axes.annotate("none", (p, 0), xycoords=("data", "axes fraction"), **place)
    axes.set_xlabel("probability of each band")
    axes.set_ylabel("cost")
    axes.set_ylim(0, 1.08 * max(known.values(), default=1.0) or 1.0)
    axes.legend(fontsize="small")
    return figure
