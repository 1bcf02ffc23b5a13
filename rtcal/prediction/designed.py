"""The cheapest treatments that meet a range of T with a stated probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.change_files import LEAST, Treatment, check_treatments
from rtcal.acoustics.changed_time import KnownRoom
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.targets import Target
from rtcal.prediction import words
from rtcal.prediction.design_model import DesignModel
from rtcal.prediction.predicted import Calibrated, Prediction, known_room
from rtcal.support import checks, text
from rtcal.support.errors import DataError, InfeasibleError
from rtcal.support.files import json_numbers
from rtcal.support.saved import Result
from rtcal.support.text import shortened
from rtcal.support.types import Array

FRONTIER = (0.8, 0.85, 0.9, 0.95)
"""Probabilities of `Design.frontier`."""
_BEST = 0.99
_HARDLY = 0.01
"""Probability below which a range is almost surely missed."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Design(Result):
    """The cheapest areas of the treatments, and what they give; `design` makes it.

    Attributes
    ----------
    model : DesignModel
        What may be done, the target, and what is known.
    promised : float
        The probability asked for, per band.
    areas : array (n_treatments,)
        m².
    """

    record_kind: ClassVar[str] = "design 1"

    model: DesignModel
    promised: float
    areas: Array

    @property
    def cost(self) -> float:
        """The cost of all treatments."""
        return float(self.model.prices @ self.areas)

    @cached_property
    def prediction(self) -> Prediction:
        """T of the treated room."""
        return self.model.prediction(self.areas)

    @cached_property
    def probability(self) -> Array:
        """Probability that T is in its range, (n_bands,); `prediction` states the same."""
        return self.prediction.probability(self.model.target.low, self.model.target.high)

    @cached_property
    def probability_together(self) -> float:
        """Probability that T is in its range in all bands at once."""
        return self.prediction.probability_together(self.model.target.low, self.model.target.high)

    @cached_property
    def alternatives(self) -> dict[float, Design | None]:
        """The design at several probabilities, this one among them; None where none is enough."""
        found: dict[float, Design | None] = {}
        for p in sorted({*FRONTIER, self.promised}):
            found[p] = self if p == self.promised else _cheapest(self.model, p)
        return found

    @property
    def frontier(self) -> dict[float, float]:
        """The cost at several probabilities; infinite where none is enough."""
        return {p: float("inf") if d is None else d.cost for p, d in self.alternatives.items()}

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text."""
        return {
            "room": self.model.before.name,
            "promised": self.promised,
            "cost": self.cost,
            "treatments": [
                {
                    "name": t.name,
                    "material": t.material_name,
                    "covers": t.covers or "",
                    "area": area,
                    "largest": t.largest,
                    "unit": t.unit,
                    "panels": None if t.unit is None else round(area / t.unit),
                    "cost": t.cost * area,
                }
                for t, area in zip(self.model.treatments, self.areas.tolist(), strict=True)
            ],
            "target": self.model.target.to_dict(),
            "probability": json_numbers(self.probability),
            "probability_together": self.probability_together,
            "frontier": {f"{p:g}": None if np.isinf(c) else c for p, c in self.frontier.items()},
            "prediction": self.prediction.to_dict(),
        }

    def __repr__(self) -> str:
        return (
            f'<Design of "{shortened(self.model.before.name)}": {self.areas.sum():.4g} m², cost '
            f"{self.cost:.4g}, probability {np.nanmin(self.probability):.2f} or more>"
        )

    def __str__(self) -> str:
        return text_of(self.to_dict())


def text_of(record: dict[str, Any]) -> str:
    """Return the text that ``print(design)`` shows, from `Design.to_dict`."""
    labels = bands.labels(record["prediction"]["centre_frequencies"])
    put = []
    for t in record["treatments"]:
        panels = "-" if t["panels"] is None else f"{t['panels']:d}"
        put.append((t["name"], [f"{t['area']:.1f}", panels, f"{t['cost']:.0f}"]))
    low, high = record["prediction"]["interval_90"]
    rows = [
        ("target from / s", record["target"]["low"], ".2f"),
        ("       to / s", record["target"]["high"], ".2f"),
        ("T before / s", record["prediction"]["reverberation_time_before"], ".2f"),
        ("T after / s", record["prediction"]["reverberation_time"], ".2f"),
        ("change / s", record["prediction"]["change_seconds"], "+.2f"),
        ("change / %", record["prediction"]["change_percent"], "+.0f"),
        ("90 %: from / s", low, ".2f"),
        ("      to / s", high, ".2f"),
        ("probability", record["probability"], ".2f"),
    ]
    numbers = [
        (name, [text.number(np.nan if v is None else v, form) for v in values])
        for name, values, form in rows
    ]
    nothing = text.wrapped(
        "Nothing is needed: T is in its range in every band with the probability asked for."
    )
    nothing = nothing if not any(t["area"] for t in record["treatments"]) else []
    frontier = ", ".join(
        f"{p}: {'not to be had' if cost is None else f'{cost:.0f}'}"
        for p, cost in record["frontier"].items()
    )
    return "\n".join(
        [
            *text.wrapped(f"{record['room']}: {record['target']['source']}"),
            *nothing,
            "",
            *text.table(put, header=("", ["m²", "panels", "cost"])),
            "",
            *text.table(numbers, header=("", labels)),
            "",
            *text.wrapped(f"Cost {record['cost']:.0f}. Cost by probability: {frontier}."),
            *text.wrapped(
                f"Probability that all bands are in range at once: "
                f"{record['probability_together']:.2f}. The probabilities are means over draws"
                + ("." if record["prediction"]["measured_states"] > 1 else ", at most 0.01 off.")
            ),
            *(line for each in record["prediction"]["sentences"] for line in text.wrapped(each)),
        ]
    )


def design(
    result: Calibrated | KnownRoom,
    treatments: Sequence[Treatment],
    target: Target,
    probability: float = LEAST,
    *,
    assumptions: Assumptions | None = None,
) -> Design:
    """Return the cheapest treatments with which T is in its range, in each band with a probability.

    The probabilities are those that `rtcal.prediction.predict` states for the same changes. Panels are
    whole. Where nothing is needed, nothing is placed. Of designs of one cost the one of less area is
    returned. See `rtcal.prediction.search` for the method.

    Parameters
    ----------
    result : CalibrationResult
        Of several configurations every measured T counts.
    treatments : sequence of Treatment
        Their order changes nothing; one that is listed twice counts once.
    target : Target
        A stated range, or `din_18041` or `ansi_s12_60`.
    probability : float
        Of each band, 0.8 to 0.99.
    assumptions : Assumptions, optional
        By default the usual ones.

    Raises
    ------
    DataError
        For a probability below 0.8 or above 0.99, or treatments that do not fit the room.
    InfeasibleError
        If no areas will do; the message says what can be had.
    SolverError
        If the program is not solved.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = rt.calibrate(room, measured)
    >>> panel = rt.Material("panel", [0.3, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)
    >>> on_ceiling = rt.prediction.Treatment("panels", panel, 40, cost=90, covers="ceiling")
    >>> none = float("nan")
    >>> target = rt.prediction.Target([none] * 6, [none, 1.2, 1.0, 1.0, 1.0, none])
    >>> found = rt.design(result, [on_ceiling], target)
    >>> print(29 < found.areas[0] < 32, bool((found.probability[1:5] > 0.79).all()))
    True True
    """
    if not LEAST <= checks.number("probability", probability) <= _BEST:
        raise DataError(
            f"probability = {probability:g} is not from {LEAST:g} to {_BEST:g}: below, "
            "which design is the cheapest is not sure"
        )
    model = design_model(result, treatments, target, assumptions)
    found = _cheapest(model, probability)
    if found is None:
        raise InfeasibleError(" ".join(can_be_had(model, probability)))
    return found


def design_model(
    result: Calibrated | KnownRoom,
    treatments: Sequence[Treatment],
    target: Target,
    assumptions: Assumptions | None = None,
) -> DesignModel:
    """Return what may be placed in a room, and what is known of it; raises DataError as `design`."""
    if isinstance(result, Room):
        raise DataError("result is a Room; it is not a calibration's result: calibrate it first")
    known = known_room(result)
    room = known.room
    if target.low.shape != (room.n_bands,):
        raise DataError(f"target has {len(target.low)} bands; the room has {room.n_bands}")
    return DesignModel(
        known,
        check_treatments(treatments, room),
        target,
        assumptions or Assumptions(),
    )


def _cheapest(model: DesignModel, probability: float) -> Design | None:
    """Return the cheapest design; None if there is none."""
    areas = model.cheapest(probability)
    return None if areas is None else Design(model=model, promised=probability, areas=areas)


def can_be_had(model: DesignModel, probability: float) -> list[str]:
    """Return what can be had where the design is infeasible, in sentences.

    The best probability of each band and of all, the least widening of the range, what parts of panels
    would allow, and what would narrow the interval.
    """
    labels, target = bands.labels(model.before.centre_frequencies), model.target
    said = [f"No areas of these treatments are in range with probability {probability:g}."]
    if any(t.unit is not None for t in model.treatments):
        free = replace(model, treatments=tuple(replace(t, unit=None) for t in model.treatments))
        if (found := _cheapest(free, probability)) is not None:
            areas = ", ".join(
                f"{area:.1f} m² of {t.name}"
                for t, area in zip(free.treatments, found.areas.tolist(), strict=True)
            )
            return [
                f"No whole panels are in range with probability {probability:g}.",
                f"Panels that may be cut would be, at a cost of {found.cost:.0f}: {areas}.",
            ]
    each = []
    for k in np.flatnonzero(target.bounded):
        here = np.arange(len(labels)) == k
        alone = Target(np.where(here, target.low, np.nan), np.where(here, target.high, np.nan))
        each.append(f"{labels[k]} {model.most_probable(alone)[1]:.2f}")
    said.append(f"Best probability of each band alone: {', '.join(each)}.")
    at, best = model.most_probable()
    if best < _HARDLY:
        said.append("With the best areas found, some band stays almost surely out of its range.")
    else:
        said.append(
            "With the best areas found, every band is in its range with a probability of "
            f"{best:.2f} or more, at a cost of {model.prices @ at:.0f}."
        )
    wider = model.widening(probability)
    if wider is None:
        said.append("No range about this one is met.")
    else:
        said.append(f"A range wider by {100 * (wider - 1):.0f} % at both ends is met.")
    parts = model.prediction(at).parts
    said.append(
        f"To narrow the interval, {words.advice(next(iter(parts)), model.known.n_measured)}."
    )
    return said
