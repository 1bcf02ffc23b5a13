"""Several variants of one room, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from rtcal.acoustics.change_files import Variant
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.prediction.assumptions import Assumptions
from rtcal.prediction.estimate import State
from rtcal.prediction.predicted import Prediction, predict
from rtcal.support.arguments import checked
from rtcal.support.results import Result


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Predictions(Result):
    """Predictions of several variants of one room; `compare` makes it.

    Attributes
    ----------
    predictions : tuple of Prediction
        One per variant.
    """

    record_kind: ClassVar[str] = "predictions 1"

    predictions: tuple[Prediction, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return each variant's `Prediction.to_dict`."""
        return {"variants": [prediction.to_dict() for prediction in self.predictions]}

    def __str__(self) -> str:
        return "\n\n\n".join(map(str, self.predictions))

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
) -> Predictions:
    """Predict T of several variants; the arguments and errors are those of `predict`.

    Raises DataError also where two variants have one name.

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
    return Predictions(
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
        )
    )


def refuse_repeated_names(variants: Sequence[Variant]) -> None:
    """Raise DataError if two variants have one name."""
    names = [variant.name for variant in variants]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise DataError(f'variants has "{twice}" twice; each has a name of its own')
