"""The page of predictions and designs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from rtcal.acoustics.observables import observable
from rtcal.acoustics.parameters import parameter_label
from rtcal.loop.positions_prediction import PositionsPrediction, PositionsPredictions
from rtcal.prediction.compared import Predictions
from rtcal.prediction.designed import Design
from rtcal.prediction.predicted import Prediction
from rtcal.report import prediction_figures
from rtcal.report.document import Heading, blocks, render, source
from rtcal.support.types import Array

_ASSUMED = {
    "volume": "relative error of the volume",
    "areas": "relative error of each area",
    "common": "error of ln T that the equation makes in all states alike",
    "own": "error of ln T that the equation makes in each state on its own",
    "changed": "least sigma of a material whose area changes",
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
    drawn = prediction_figures.times(
        frequencies,
        first.time_before,
        [(v.name, v.mean, v.interval) for v in variants],
        target,
    )
    return render(
        "prediction.html",
        {
            "design": None if found is None else found.to_dict(),
            "variants": [_variant(v, target, step) for v in variants],
            "compared": _compared(result),
            "times_rows": [(v.name, v.mean, 2, False) for v in variants]
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
            "n_states": len(first.states),
            "blocks": blocks(len(frequencies)),
            "labels": [f"{f:g} Hz" for f in frequencies],
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
    before = observable(t).natural(first.heard_before[0, -1])
    drawn = prediction_figures.times(
        frequencies, before, [(v.name, v.mean(t), v.interval(t)) for v in variants]
    )
    times = [(v.name, v.mean(t), 2, False) for v in variants]
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
            "times_rows": times if len(variants) > 1 else [],
            "basis": f"{first.simulator}, {len(first.pairs)} pairs of source and receiver. Its error "
            "is that of its control runs, heard before and after the change.",
            "blocks": blocks(len(frequencies)),
            "labels": [f"{f:g} Hz" for f in frequencies],
        },
        heading.completed(first.before.name, first.before.author),
    )


def _at_positions(variant: PositionsPrediction, step: Callable[[], None]) -> dict[str, Any]:
    rows = []
    for i, parameter in enumerate(variant.parameters):
        of, (low, high) = observable(parameter), variant.interval(parameter)
        unit = f" / {of.unit}" if of.unit else ""
        before = of.natural(variant.heard_before[i, -1])
        rows += [
            (f"{of.label} before{unit}", before, of.decimals, False),
            (f"{of.label} after{unit}", variant.mean(parameter), of.decimals, False),
            ("90 % interval: from", low, of.decimals, False),
            ("to", high, of.decimals, False),
        ]
    drawn = prediction_figures.parts(
        variant.before.centre_frequencies, variant.parts(variant.parameters[0])
    )
    return {
        "name": variant.name,
        "changes": [str(change) for change in variant.changes],
        "sentences": variant.sentences,
        "rows": rows,
        "parts": {
            "source": source(drawn, step),
            "alt": f"{variant.name}: what the interval is made of, by band",
            "caption": f"What the interval of {parameter_label(variant.parameters[0])} is made of: "
            "shares of the variance of the mean over the pairs, the largest at the bottom.",
        },
    }


def _compared(result: Prediction | Predictions | Design) -> dict[str, Any] | None:
    """Return what is compared side by side: the header and rows of text; None of one prediction."""
    if isinstance(result, Design):
        names = [t.name for t in result.model.treatments]
        rows = []
        for p, design in result.alternatives.items():
            if design is None:
                rows.append([f"{p:g}", *["–"] * len(names), "not to be had", "–", "–"])
                continue
            bounded = design.model.target.bounded
            rows.append(
                [
                    f"{p:g}" + (" (this design)" if p == result.promised else ""),
                    *(f"{area:.1f}" for area in design.areas),
                    f"{design.cost:.0f}",
                    f"{design.probability[bounded].min():.2f}",
                    f"{design.probability_together:.2f}",
                ]
            )
        header = ["Asked", *(f"{name} / m²" for name in names), "Cost", "Least band", "All bands"]
        return {"header": header, "rows": rows, "title": "Cost by probability, side by side"}
    if isinstance(result, Prediction):
        return None
    chances = result.chances()
    if not chances and all(cost is None for cost in result.costs):
        return None
    rows = [
        [made.name, "–" if cost is None else f"{cost:.0f}"]
        for made, cost in zip(result.predictions, result.costs, strict=True)
    ]
    header = ["Variant", "Cost"]
    if chances:
        header += ["Least band", "All bands"]
        rows = [
            [*row, *(f"{p:.2f}" for p in each)] for row, each in zip(rows, chances, strict=True)
        ]
    return {"header": header, "rows": rows, "title": "Cost and probability of the target"}


def _variant(
    variant: Prediction, target: tuple[Array, Array] | None, step: Callable[[], None]
) -> dict[str, Any]:
    low, high = variant.interval
    rows = [
        ("T before / s", variant.time_before, 2, False),
        ("T after / s", variant.mean, 2, False),
        ("90 % interval: from / s", low, 2, False),
        ("to / s", high, 2, False),
        ("change / JND", variant.change, 1, True),
        ("half width / JND", variant.half_width, 1, False),
    ]
    if target is not None:
        rows += [
            ("target: from / s", target[0], 2, False),
            ("to / s", target[1], 2, False),
            ("probability", variant.probability(*target), 2, False),
        ]
    record = variant.to_dict()
    drawn = prediction_figures.parts(variant.after.centre_frequencies, variant.parts)
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
    drawn = prediction_figures.frontier(found.frontier, found.promised, found.cost)
    return {
        "source": source(drawn, step),
        "alt": "Cost against the probability that each band is in range",
        "caption": "Cost against the probability that each band is in range. Where nothing is enough "
        "it says “none”.",
    }
