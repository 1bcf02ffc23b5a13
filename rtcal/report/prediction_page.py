"""The page of predictions and designs, with its pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import observable, parameter_label
from rtcal.loop.positions_result import PositionsPrediction, PositionsPredictions
from rtcal.prediction import words
from rtcal.prediction.designed import Design, treatments_of
from rtcal.prediction.predicted import Prediction, Predictions
from rtcal.report.document import Heading, blocks, render, source
from rtcal.report.figures import BLACK, BLUE, GREEN, ORANGE, band_axis, new_figure, shown
from rtcal.support.blocks import Row, Table
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
        style = {"color": colour, "marker": marker, "capsize": 3, "linestyle": "-"}
        axes.errorbar(moved, mean, yerr=[mean - low, high - mean], **style, label=shown(name))
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
        style = {"color": str(greys[i]), "hatch": _HATCHES[i % len(_HATCHES)], "linewidth": 0.5}
        axes.bar(places, 100 * share, bottom=bottom, edgecolor=BLACK, **style, label=shown(name))
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


_ASSUMED = {
    "volume": "relative error of the volume",
    "areas": "relative error of each area",
    "common": "error of ln T before, where it was not measured",
    "factor": "standard deviation of ln of what the equation errs by of each material's absorption",
    "least": "the same, as an absorption coefficient",
    "evenness": "mean of u, the way from the equation (0) to Arau-Puchades' (1) and Fitzroy's (2)",
    "evenness_sigma": "standard deviation of u",
    "one_surface": "probability that all that is exchanged faces one axis, where nothing says which",
    "own": "relative error of a change between two measured states that no factor explains",
    "changed": "least sigma of a new material, at positions",
    "time": "relative uncertainty of a measured T that states none",
    "band_correlation": "correlation of the errors an octave apart",
}


def page(
    result: Prediction | Predictions | Design, heading: Heading, step: Callable[[], None]
) -> str:
    """Return the page as HTML; raises as `rtcal.report.page.page`."""
    found = result if isinstance(result, Design) else None
    if isinstance(result, Design):
        variants: Sequence[Prediction] = (result.prediction,)
    else:
        variants = result.predictions if isinstance(result, Predictions) else (result,)
    first = variants[0]
    frequencies = first.after.centre_frequencies
    aim = result.target if isinstance(result, Predictions) else None
    if found is not None:
        aim = found.model.target
    target = None if aim is None else (aim.low, aim.high)
    drawn = times(
        frequencies,
        first.time_before,
        [(v.name, v.mean, v.interval) for v in variants],
        target,
    )
    return render(
        "prediction.html",
        {
            "design": None if found is None else found.to_dict(),
            "treatments": None if found is None else treatments_of(found.to_dict()),
            "variants": [_variant(v, target, step) for v in variants],
            "compared": _compared(result),
            "times_rows": [Row(v.name, v.mean, ".2f") for v in variants]
            if len(variants) > 1
            else [],
            "aim": "" if aim is None else aim.source,
            "times": {
                "source": source(drawn, step),
                "alt": f"{first.before.name}: T before and after, by band",
                "caption": "T by band: before (dashed), and of each variant with its 90 % interval"
                + ("." if target is None else "; grey: the target."),
            },
            "frontier": None if found is None else _frontier(found, step),
            "assumed": [f"{_ASSUMED[n]}: {v:g}" for n, v in asdict(first.assumptions).items()],
            "basis": "",
            "equation": first.equation.name,
            "n_states": first.known.n_measured,
            "blocks": blocks(len(frequencies)),
            "labels": bands.labels(frequencies),
        },
        heading.completed(first.before.name, first.before.author),
    )


def page_at_positions(
    result: PositionsPrediction | PositionsPredictions, heading: Heading, step: Callable[[], None]
) -> str:
    """Return the page of predictions at every position as HTML; raises as `page`."""
    variants = result.predictions if isinstance(result, PositionsPredictions) else (result,)
    first = variants[0]
    frequencies, t = first.before.centre_frequencies, first.parameters[0]
    before = observable(t).natural(first.simulated_before[0, -1])
    drawn = times(frequencies, before, [(v.name, v.mean(t), v.interval(t)) for v in variants])
    means = [Row(v.name, v.mean(t), ".2f") for v in variants]
    return render(
        "prediction.html",
        {
            "variants": [_at_positions(v, step) for v in variants],
            "times": {
                "source": source(drawn, step),
                "alt": f"{first.before.name}: {parameter_label(t)} before and after, by band",
                "caption": f"{parameter_label(t)} by band, mean over {len(first.pairs)} pairs: before "
                "(dashed), and of each variant with its 90 % interval.",
            },
            "design": None,
            "frontier": None,
            "compared": None,
            "aim": "",
            "times_rows": means if len(variants) > 1 else [],
            "basis": f"{first.simulator}, {len(first.pairs)} pairs of source and receiver. Its error "
            "is that of its control runs, heard before and after the change.",
            "blocks": blocks(len(frequencies)),
            "labels": bands.labels(frequencies),
        },
        heading.completed(first.before.name, first.before.author),
    )


def _at_positions(variant: PositionsPrediction, step: Callable[[], None]) -> dict[str, Any]:
    drawn = parts(variant.before.centre_frequencies, variant.parts(variant.parameters[0]))
    return {
        "name": variant.name,
        "changes": [str(change) for change in variant.changes],
        "sentences": variant.sentences,
        "rows": variant.rows,
        "parts": {
            "source": source(drawn, step),
            "alt": f"{variant.name}: what the interval is made of, by band",
            "caption": f"What the interval of {parameter_label(variant.parameters[0])} is made of: "
            "shares of the variance of the mean over the pairs, the largest at the bottom.",
        },
    }


def _compared(result: Prediction | Predictions | Design) -> Table | None:
    """Return what is compared side by side; None of one prediction."""
    if isinstance(result, Prediction):
        return None
    if isinstance(result, Predictions):
        return result.costs_and_chances
    names = [t.name for t in result.model.treatments]
    rows = []
    for p, design in result.alternatives.items():
        if design is None:
            rows.append(Row(f"{p:g}", [*["–"] * len(names), "not to be had", "–", "–"]))
            continue
        bounded = design.model.target.bounded
        cells = [
            *(f"{area:.1f}" for area in design.areas),
            f"{design.cost:.0f}",
            f"{design.probability[bounded].min():.2f}",
            f"{design.probability_together:.2f}",
        ]
        rows.append(Row(f"{p:g}" + (" (this design)" if p == result.promised else ""), cells))
    columns = [*(f"{name} / m²" for name in names), "cost", "least band", "all bands"]
    return Table(columns, rows, "Cost by probability, side by side", corner="asked")


def _variant(
    variant: Prediction, target: tuple[Array, Array] | None, step: Callable[[], None]
) -> dict[str, Any]:
    record = variant.to_dict()
    rows = words.rows_of(record)
    if target is not None:
        rows += [
            Row("target: from / s", target[0], ".2f"),
            Row("to / s", target[1], ".2f"),
            Row("probability", variant.probability(*target), ".2f"),
        ]
    drawn = parts(variant.after.centre_frequencies, variant.parts)
    return {
        "name": variant.name,
        "changes": record["changes"],
        "sentences": record["sentences"],
        "rows": rows,
        "parts": {
            "source": source(drawn, step),
            "alt": f"{variant.name}: what the interval is made of, by band",
            "caption": "What the interval is made of: shares of the variance of ln T, the largest at "
            "the bottom.",
        },
    }


def _frontier(found: Design, step: Callable[[], None]) -> dict[str, str]:
    drawn = frontier(found.frontier, found.promised, found.cost)
    return {
        "source": source(drawn, step),
        "alt": "Cost against the probability that each band is in range",
        "caption": "Cost against the probability that each band is in range. Where nothing is enough "
        "it says “none”.",
    }
