"""Several variants of one room, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from rtcal.acoustics import bands
from rtcal.acoustics.change_files import Variant, refuse_repeated_names
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.states import State
from rtcal.acoustics.targets import Target
from rtcal.prediction.predicted import Prediction, predict
from rtcal.support import text
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.files import json_numbers
from rtcal.support.results import Result


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Predictions(Result):
    """Predictions of several variants of one room; `compare` makes it.

    Attributes
    ----------
    predictions : tuple of Prediction
        One per variant.
    costs : tuple of float or None
        Of each variant.
    target : Target or None
        The range of T that they are compared with.
    """

    record_kind: ClassVar[str] = "predictions 1"

    predictions: tuple[Prediction, ...]
    costs: tuple[float | None, ...]
    target: Target | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return each variant's `Prediction.to_dict`, its cost, and the probability of the target."""
        record: dict[str, Any] = {
            "variants": [prediction.to_dict() for prediction in self.predictions],
            "costs": list(self.costs),
        }
        if self.target is not None:
            ends = self.target.low, self.target.high
            record["target"] = {
                **self.target.to_dict(),
                "probability": [json_numbers(p.probability(*ends)) for p in self.predictions],
                "probability_together": [p.probability_together(*ends) for p in self.predictions],
            }
        return record

    def __str__(self) -> str:
        return "\n\n\n".join([*map(str, self.predictions), *self._side_by_side()])

    def _side_by_side(self) -> list[str]:
        """Return a table of the variants' T, and of cost and probability where they are known."""
        if len(self.predictions) == 1 and self.target is None:
            return []
        labels = [bands.label(f) for f in self.predictions[0].after.centre_frequencies]
        rows = [(p.name, [f"{t:.2f}" for t in p.mean]) for p in self.predictions]
        lines = ["side by side: T / s", *text.table(rows, header=("", labels))]
        columns = {"cost": ["-" if c is None else f"{c:.0f}" for c in self.costs]}
        if self.target is not None:
            lines += ["", *text.wrapped(f"Target: {self.target.source}")]
            least, together = zip(*self.chances(), strict=True)
            columns["least band"] = [f"{p:.2f}" for p in least]
            columns["all bands"] = [f"{p:.2f}" for p in together]
        elif all(cost is None for cost in self.costs):
            return ["\n".join(lines)]
        each = [(p.name, [c[i] for c in columns.values()]) for i, p in enumerate(self.predictions)]
        return ["\n".join([*lines, *text.table(each, header=("", list(columns)))])]

    def chances(self) -> list[tuple[float, float]]:
        """Return of each variant the least probability of a band of the target, and that of all.

        Empty without a target.
        """
        if self.target is None:
            return []
        ends, bounded = (self.target.low, self.target.high), self.target.bounded
        return [
            (float(p.probability(*ends)[bounded].min()), p.probability_together(*ends))
            for p in self.predictions
        ]

    def __repr__(self) -> str:
        return f"<Predictions: {', '.join(p.name for p in self.predictions)}>"


@checked
def compare(
    states: Sequence[State],
    variants: Sequence[Variant],
    *,
    before: Room | None = None,
    equation: LinearEquation | None = None,
    assumptions: Assumptions | None = None,
    target: Target | None = None,
) -> Predictions:
    """Predict T of several variants; the arguments and errors are those of `predict`.

    A ``target`` is a range of T that they are compared with. Raises DataError also where two variants
    have one name, and for a target of other bands.

    Examples
    --------
    >>> import rtcal as rt
    >>> from rtcal.prediction import Open, State, Variant
    >>> room, measured = rt.datasets.bras_cr2()
    >>> state = State(room, measured.mean("t30"))
    >>> compare([state], [Variant("window open", (Open("windows", 2.0),))])
    <Predictions: window open>
    """
    refuse_repeated_names(variants)
    found = Predictions(
        predictions=tuple(
            predict(
                states,
                variant.changes,
                before=before,
                equation=equation,
                assumptions=assumptions,
                name=variant.name,
            )
            for variant in variants
        ),
        costs=tuple(variant.cost for variant in variants),
        target=target,
    )
    n_bands = found.predictions[0].after.n_bands if variants else 0
    if target is not None and target.low.shape != (n_bands,):
        raise DataError(f"target has {len(target.low)} bands; the room has {n_bands}")
    return found
