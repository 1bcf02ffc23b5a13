"""The page of predictions and designs: what their text has, beside pictures."""

from __future__ import annotations

from typing import Any

from rtcal.acoustics import bands
from rtcal.loop.predicted import PositionsPrediction
from rtcal.prediction.designed import Design
from rtcal.prediction.predicted import Prediction, Predictions
from rtcal.report import figures
from rtcal.report.document import Items, Page, Picture, Section, summary, tables
from rtcal.support import __version__
from rtcal.support.blocks import Note, Row, Table


def page(result: Prediction | PositionsPrediction | Predictions | Design) -> Page:
    """Return the page of predictions, by an equation or at every position, or of a design."""
    subject, target, beside = "what a change does to the reverberation time", None, list[Any]()
    variants = tuple[Any, ...]()
    if isinstance(result, Design):
        subject = "the cheapest treatments that meet a target"
        variants, target = (result.prediction,), result.model.target
        beside = [*tables(result.blocks()), _cheapest(result)]
    elif isinstance(result, Predictions):
        variants, target, beside = result.predictions, result.target, [*result.side_by_side()]
    else:
        variants = (result,)
    room = variants[0].before
    f, shown = room.centre_frequencies, [v.shown for v in variants]
    ends = None if target is None else (target.low, target.high)
    drawn = [(v.name, s.after, s.interval) for v, s in zip(variants, shown, strict=True)]
    caption = (
        f"{shown[0].name} by band: before (dashed), and of each variant with its 90 % interval"
    )
    picture = Picture(
        lambda: figures.predicted_times(f, shown[0].before, drawn, ends),
        f"{caption}{'.' if target is None else '; grey: the target.'}",
    )
    if isinstance(result, Design):
        first = summary(result.blocks(), picture)
    else:
        by_equation = [v for v in variants if isinstance(v, Prediction)]
        first = [Note(each) for v in by_equation[:1] for each in v.heads[:-1]]
        first += [Note(f"{v.name}: {v.headline}", kind="lead") for v in by_equation]
        first.append(picture)

    def of(variant: Any) -> list[Any]:
        """Return the blocks of a prediction below its title."""
        blocks = variant.blocks()[len(variant.heads) if isinstance(variant, Prediction) else 1 :]
        if isinstance(result, Design):  # which has said the rest
            blocks = [*tables(blocks)][1:]
        elif target is not None:
            blocks.append(Table(bands.labels(f), variant.within(target), "Target"))
        return [
            Section(variant.name, ""),
            Items(list(map(str, variant.changes))),
            *blocks,
        ]

    return Page(
        room.name,
        room.author,
        subject,
        [
            *first,
            *beside,
            *(block for variant in variants for block in of(variant)),
            Section("What was assumed", "assumed"),
            *(Items(b) if isinstance(b, list) else b for b in variants[0].assumed),
            Note(f"rtcal {__version__}."),
        ],
    )


def _cheapest(design: Design) -> Table:
    """Return the designs of several probabilities side by side."""
    names, rows = [t.name for t in design.model.treatments], []
    bounded = design.model.target.bounded
    for p, found in design.alternatives.items():
        cells = [*["–"] * len(names), "not possible", "–", "–"]
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
