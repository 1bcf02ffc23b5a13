"""The page of predictions and designs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from rtcal.prediction.compared import Predictions
from rtcal.prediction.designed import Design
from rtcal.prediction.predicted import Prediction
from rtcal.report import prediction_figures
from rtcal.report.document import Heading, blocks, render, source

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
    target = None if found is None else (found.model.target.low, found.model.target.high)
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
            "variants": [_variant(v, found, step) for v in variants],
            "times": {
                "source": source(drawn, step),
                "alt": f"{first.before.name}: T before and after, by band",
                "caption": "T by band: before (dashed), and of each variant with its 90 % interval"
                + ("; grey: the target." if found is not None else "."),
            },
            "frontier": None if found is None else _frontier(found, step),
            "assumed": [f"{_ASSUMED[n]}: {v:g}" for n, v in asdict(first.assumptions).items()],
            "equation": first.equation.name,
            "n_states": len(first.states),
            "blocks": blocks(len(frequencies)),
            "labels": [f"{f:g} Hz" for f in frequencies],
        },
        heading.completed(first.before.name, first.before.author),
    )


def _variant(variant: Prediction, found: Design | None, step: Callable[[], None]) -> dict[str, Any]:
    low, high = variant.interval
    rows = [
        ("T before / s", variant.time_before, 2, False),
        ("T after / s", variant.mean, 2, False),
        ("90 % interval: from / s", low, 2, False),
        ("to / s", high, 2, False),
        ("change / JND", variant.change, 1, True),
        ("half width / JND", variant.half_width, 1, False),
    ]
    if found is not None:
        rows += [
            ("target: from / s", found.model.target.low, 2, False),
            ("to / s", found.model.target.high, 2, False),
            ("probability", found.probability, 2, False),
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
