"""The cheapest treatments that meet a range of T with a stated probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from scipy.special import ndtr, ndtri

from rtcal.acoustics import bands
from rtcal.acoustics.change_files import LEAST, Treatment, check_treatments
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.states import State
from rtcal.acoustics.targets import Target
from rtcal.prediction import words
from rtcal.prediction.design_model import DesignModel
from rtcal.prediction.predicted import JND, Prediction
from rtcal.support import checks, text
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError, InfeasibleError
from rtcal.support.files import json_numbers
from rtcal.support.results import Result
from rtcal.support.text import shortened
from rtcal.support.types import Array

FRONTIER = (0.8, 0.85, 0.9, 0.95)
"""Probabilities of `Design.frontier`."""
_BEST = 0.99
_PASSES = 6
_LACK = 0.001
"""Probability that a band may lack of the promised one."""
_SETTLED = 3e-4
"""Largest change of what is asked of the program in the last pass."""
_FAR = 1.05
"""Cost of the program's answer, over that of a design, from which it is not looked at further."""
_HARDLY = 0.01
"""Probability below which a range is almost surely missed."""
_TRIES = 8
_WIDEST = 20.0
"""Most JND by which a range is widened in search of a feasible one."""


@runtime_checkable
class Measured(Protocol):
    """A result whose states and room a design takes, such as a `CalibrationResult`."""

    @property
    def states(self) -> tuple[State, ...]:
        """The measured states."""

    @property
    def prior(self) -> Room:
        """The room before the calibration."""

    @property
    def equation(self) -> LinearEquation:
        """The equation that turned T into absorption."""


@dataclass(frozen=True)
class Known:
    """Measured states of a room without a calibration, for `design`."""

    states: tuple[State, ...]
    prior: Room
    equation: LinearEquation = field(default_factory=Eyring)


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
        """Probability that T is in its range, (n_bands,), from the whole posterior."""
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
        ("90 %: from / s", low, ".2f"),
        ("      to / s", high, ".2f"),
        ("probability", record["probability"], ".2f"),
    ]
    numbers = [
        (name, [text.number(np.nan if v is None else v, form) for v in values])
        for name, values, form in rows
    ]
    frontier = ", ".join(
        f"{p}: {'not to be had' if cost is None else f'{cost:.0f}'}"
        for p, cost in record["frontier"].items()
    )
    return "\n".join(
        [
            *text.wrapped(f"{record['room']}: {record['target']['source']}"),
            "",
            *text.table(put, header=("", ["m²", "panels", "cost"])),
            "",
            *text.table(numbers, header=("", labels)),
            "",
            *text.wrapped(f"Cost {record['cost']:.0f}. Cost by probability: {frontier}."),
            *text.wrapped(
                f"Probability that all bands are in range at once: "
                f"{record['probability_together']:.2f}."
            ),
            *(line for each in record["prediction"]["sentences"] for line in text.wrapped(each)),
        ]
    )


@checked
def design(
    result: Measured,
    treatments: Sequence[Treatment],
    target: Target,
    probability: float = LEAST,
    *,
    assumptions: Assumptions | None = None,
) -> Design:
    """Return the cheapest treatments with which T is in its range, in each band with a probability.

    A second-order cone program: the allowed standard deviation of the absorption is a concave function
    of its mean, and its chords are linear (Clarabel, by cvxpy).

    Parameters
    ----------
    result : CalibrationResult
        Its measured states are taken jointly.
    treatments : sequence of Treatment
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
    >>> print(18 < found.areas[0] < 23, bool((found.probability[1:5] > 0.79).all()))
    True True
    """
    if not LEAST <= checks.number("probability", probability) <= _BEST:
        raise DataError(
            f"probability = {probability:g} is not from {LEAST:g} to {_BEST:g}: below, the program "
            "finds no sure optimum"
        )
    if not isinstance(result, Measured):
        raise DataError(f"result = {checks.shown(result)} is not a calibration's result, or Known")
    room = result.prior
    if target.low.shape != (room.n_bands,):
        raise DataError(f"target has {len(target.low)} bands; the room has {room.n_bands}")
    model = DesignModel(
        tuple(result.states),
        room,
        check_treatments(treatments, room),
        target,
        result.equation,
        assumptions or Assumptions(),
    )
    found = _cheapest(model, probability)
    if found is None:
        raise InfeasibleError(" ".join(can_be_had(model, probability)))
    return found


def _cheapest(model: DesignModel, probability: float) -> Design | None:
    """Return the cheapest design that keeps the probability with the whole posterior; None if none.

    A surface that may be covered is less sure, also where little of it is: so fewer treatments may do
    with less. What an answer does not use is left out, and then one treatment after the other.
    """
    names = tuple(t.name for t in model.treatments)
    best, waiting, seen = None, [names], set()
    while waiting:
        used = waiting.pop()
        if not used or used in seen:
            continue
        seen.add(used)
        areas = _settled(model.of(used), probability, np.inf if best is None else best.cost)
        if areas is not None:
            put = dict(zip(used, areas.tolist(), strict=True))
            every = np.array([put.get(name, 0.0) for name in names])
            best = Design(model=model, promised=probability, areas=every)
            used = tuple(name for name in used if put[name] > 0)
            waiting.append(used)
        if areas is not None or (best is None and used == names):
            waiting += [tuple(n for n in used if n != name) for name in used]
    return best


def _settled(model: DesignModel, probability: float, dearest: float) -> Array | None:
    """Return the cheapest areas below a cost that keep the probability with the whole posterior.

    The program takes A as normal. Each pass asks of it what its last answer had of its own where the
    whole posterior had the promised probability, more or less.
    """
    bounded, best, x = model.target.bounded, None, None
    asked = np.full(model.before.n_bands, probability)
    for _ in range(_PASSES):
        found = model.cheapest(asked, start=x)
        # Where there is none, the normal A may be what forbids it.
        x = model.most_probable(asked)[0] if found is None else found
        cost = float(model.prices @ x)
        if found is not None and cost > _FAR * dearest:
            break
        exact = model.prediction(x).probability(model.target.low, model.target.high)
        if (probability - exact)[bounded].max() <= _LACK and cost < dearest:
            best, dearest = x, cost
        before = asked
        asked = np.where(
            bounded,
            ndtr(ndtri(probability) + _normal(model.probability(x)) - _normal(exact)),
            asked,
        )
        if np.abs(asked - before).max() <= _SETTLED:
            break
    return best


def _normal(probability: Array) -> Array:
    return np.asarray(ndtri(np.clip(probability, 1e-6, 1 - 1e-6)))


def can_be_had(model: DesignModel, probability: float) -> list[str]:
    """Return what can be had where the design is infeasible, in sentences.

    What the equation's error alone allows, the best probability that all bands can have, the least
    widening of the range, and what would narrow the interval.
    """
    frequencies, bounded = model.before.centre_frequencies, model.target.bounded
    x = np.zeros(len(model.treatments))
    alone = model.ranges(x).best()[1]
    said = [f"No areas of these treatments are in range with probability {probability:g}."]
    labels = bands.labels(frequencies)
    if (short := bounded & (alone < probability)).any():
        listed = ", ".join(f"{labels[k]} {alone[k]:.2f}" for k in np.flatnonzero(short))
        said.append(f"The equation's error alone allows: {listed}.")
    each = []
    for k in np.flatnonzero(bounded):
        here = np.arange(len(labels)) == k
        alone_in = Target(
            np.where(here, model.target.low, np.nan), np.where(here, model.target.high, np.nan)
        )
        each.append((labels[k], _best(model, probability, alone_in)[0]))
    listed = ", ".join(f"{label} {p:.2f}" for label, p in each)
    said.append(f"Best probability of each band alone: {listed}.")
    best, at = _best(model, probability, model.target)
    if best < _HARDLY:
        said.append("With the best areas found, some band stays almost surely out of its range.")
    else:
        said.append(
            "With the best areas found, every band is in its range with a probability of "
            f"{best:.2f} or more, at a cost of {model.prices @ at:.0f}."
        )
    widening = _widening(model, probability)
    if widening is None:
        said.append(f"A range wider by {_WIDEST:g} JND at both ends is not met either.")
    else:
        said.append(f"A range wider by {widening:.1f} JND at both ends is met.")
    parts = model.prediction(at).parts
    said.append(f"To narrow the interval, {words.advice(next(iter(parts)), len(model.states))}.")
    return said


def _best(model: DesignModel, probability: float, target: Target) -> tuple[float, Array]:
    """Return the largest probability that every band has, of the whole posterior, and the areas."""
    best, at = -1.0, np.zeros(0)
    asked: float | Array = probability
    for _ in range(2):
        x = model.most_probable(asked, target)[0]
        exact = model.prediction(x).probability(target.low, target.high)
        least = float(exact[target.bounded].min())
        best, at = (least, x) if least > best else (best, at)
        asked = ndtr(ndtri(probability) + _normal(model.probability(x, target)) - _normal(exact))
    return best, at


def _widening(model: DesignModel, probability: float) -> float | None:
    """Return by how many JND both ends must move for a design to exist, to 0.2; None above 20."""
    low, high = 0.0, 2 * _WIDEST
    for _ in range(_TRIES):
        middle = (low + high) / 2
        wider = model.target.widened(float(np.exp(JND * middle)))
        met = _best(model, probability, wider)[0] >= probability
        low, high = (low, middle) if met else (middle, high)
    return None if high > _WIDEST else high
