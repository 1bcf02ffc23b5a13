"""The page of predictions and designs: what their text has, beside pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rtcal.acoustics import bands
from rtcal.acoustics.observables import observable, parameter_label
from rtcal.loop.positions_result import PositionsPrediction, PositionsPredictions
from rtcal.prediction.designed import Design
from rtcal.prediction.predicted import Prediction, Predictions
from rtcal.report import figures
from rtcal.report.document import Items, Page, Picture, Section, tables
from rtcal.support import __version__
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.types import Array

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
_CHANGE = "what a change does to the reverberation time"


def page(result: Prediction | Predictions | Design) -> Page:
    """Return the page of predictions by an equation, or of a design."""
    variants: Sequence[Prediction]
    target, subject = None, _CHANGE
    summary: list[Any] = []
    beside: list[Any] = []
    if isinstance(result, Design):
        subject, variants, target = (
            "the cheapest treatments that meet a target",
            (result.prediction,),
            result.model.target,
        )
        summary, beside = [*result.blocks()], [_cheapest(result), _frontier(result)]
    elif isinstance(result, Predictions):
        variants, target, beside = result.predictions, result.target, [*result.side_by_side()]
    else:
        variants = (result,)
    first = variants[0]
    room, f = first.before, first.after.centre_frequencies
    ends = None if target is None else (target.low, target.high)
    drawn = [(v.name, v.mean, v.interval) for v in variants]
    caption = "T by band: before (dashed), and of each variant with its 90 % interval"
    n = first.known.n_measured

    def of(variant: Prediction) -> list[Block]:
        blocks = variant.blocks()
        if isinstance(result, Design):  # which has said the rest
            return [*tables(blocks)]
        chances = [] if ends is None else _chances(variant, ends)
        return [*blocks[1:], Table(bands.labels(f), chances, "Target")]

    return Page(
        room.name,
        room.author,
        subject,
        [
            Section("Summary", "summary"),
            *summary,
            Picture(
                lambda: figures.predicted_times(f, first.time_before, drawn, ends),
                f"{caption}{'.' if target is None else '; grey: the target.'}",
            ),
            *beside,
            *(
                block
                for v in variants
                for block in _variant(v.name, v.changes, of(v), f, v.parts, "ln T")
            ),
            Section("What was assumed", "assumed"),
            Note(
                f"{first.equation.name}'s equation, {n} measured state{'s' * (n != 1)}. Standard "
                "deviations, unless said otherwise:"
            ),
            Items([f"{_ASSUMED[k]}: {v:g}" for k, v in asdict(first.assumptions).items()]),
            *_remark(" and for the T before that is stated"),
        ],
    )


def page_at_positions(result: PositionsPrediction | PositionsPredictions) -> Page:
    """Return the page of predictions at every position."""
    variants = result.predictions if isinstance(result, PositionsPredictions) else (result,)
    first = variants[0]
    room, f, t, n = (
        first.before,
        first.before.centre_frequencies,
        first.parameters[0],
        len(first.pairs),
    )
    before = observable(t).natural(first.simulated_before[0, -1])
    drawn = [(v.name, v.mean(t), v.interval(t)) for v in variants]
    means = [Row(v.name, v.mean(t), ".2f") for v in variants] if len(variants) > 1 else []
    return Page(
        room.name,
        room.author,
        _CHANGE,
        [
            Section("Summary", "summary"),
            Picture(
                lambda: figures.predicted_times(f, before, drawn),
                f"{parameter_label(t)} by band, mean over {n} pairs: before (dashed), and of each "
                "variant with its 90 % interval.",
            ),
            Table(bands.labels(f), means, f"Side by side: {parameter_label(t)} / s"),
            *(
                block
                for v in variants
                for block in _variant(
                    v.name,
                    v.changes,
                    v.blocks()[1:],
                    f,
                    v.parts(t),
                    f"the mean of {parameter_label(t)} over the pairs",
                )
            ),
            Section("What was assumed", "assumed"),
            Note(
                f"{first.simulator}, {n} pairs of source and receiver. Its error is that of its "
                "control "
                "runs, heard before and after the change."
            ),
            *_remark(""),
        ],
    )


def _variant(
    name: str,
    changes: Sequence[Any],
    blocks: Sequence[Block],
    frequencies: Array,
    shares: dict[str, Array],
    of: str,
) -> list[Any]:
    """Return what a prediction prints below its title, and the figure of its interval's parts."""
    return [
        Section(name, ""),
        Items(list(map(str, changes))),
        *blocks,
        Picture(
            lambda: figures.parts(frequencies, shares),
            f"What the interval is made of: shares of the variance of {of}, the largest at the bottom.",
        ),
    ]


def _chances(variant: Prediction, target: tuple[Array, Array]) -> list[Row]:
    return [
        Row("target: from / s", target[0], ".2f"),
        Row("to / s", target[1], ".2f"),
        Row("probability", variant.probability(*target), ".2f"),
    ]


def _cheapest(design: Design) -> Table:
    """Return the designs of several probabilities side by side."""
    names, rows = [t.name for t in design.model.treatments], []
    bounded = design.model.target.bounded
    for p, found in design.alternatives.items():
        cells = [*["–"] * len(names), "not to be had", "–", "–"]
        if found is not None:
            cells = [
                *(f"{area:.1f}" for area in found.areas),
                f"{found.cost:.0f}",
                f"{found.probability[bounded].min():.2f}",
                f"{found.probability_together:.2f}",
            ]
        rows.append(Row(f"{p:g}{' (this design)' * (p == design.promised)}", cells))
    columns = [*(f"{name} / m²" for name in names), "cost", "least band", "all bands"]
    return Table(columns, rows, "Cost by probability, side by side", corner="asked")


def _frontier(design: Design) -> Picture:
    caption = "Cost against the probability that each band is in range"
    return Picture(
        lambda: figures.frontier(design.frontier, design.promised, design.cost),
        f"{caption}. Where nothing is enough it says “none”.",
        caption,
    )


def _remark(before: str) -> list[Note]:
    return [
        Note(
            f"The interval is for a measurement without error{before}, and as good as these "
            "numbers and "
            "the stated sigma. One JND of T is 5 % of it."
        ),
        Note(f"rtcal {__version__}."),
    ]
