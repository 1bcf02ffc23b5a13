"""An effect in one place, its probability and size; the sums over effects, families, surfaces."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rtcal.finder.case import NORMAL_90
from rtcal.finder.claim import most_probable_first, with_added
from rtcal.finder.effects.coupled_room import CoupledRoom
from rtcal.finder.finding import amount
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.posterior import PositionsHypotheses, Weights
from rtcal.finder.positions.shift import MEASUREMENT, UNKNOWN, ShiftHypothesis
from rtcal.finder.prior import COEFFICIENTS, NONE
from rtcal.support.files import json_numbers
from rtcal.support.types import Array

Point = tuple[float, float, float]
LOCATED = 0.5
"""Share of a candidate's probability from which a part of its surface is where it stands."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect in one place.

    Attributes
    ----------
    effect, family : str
    surface : str or None
        None for the whole room and for the measurement.
    place : str
        The surface's name; of the measurement's errors "receiver R1", "source S1" or "S1 to R1"; "" for
        the whole room.
    probability : float
    size, low, high : float
        Posterior mean and 90 % interval, in ``unit``; NaN for coefficients off together and for
        "unknown".
    unit : str
    parameters : mapping of str to float
        The most probable ones.
    spectrum : array (n_bands,) or (0,)
        Posterior mean alpha of what stands on the surface.
    parts : tuple of (middle, probability)
        Of a large surface: the middle (x, y, z) of each part in m, and the probability that it stands
        on this part alone. With the rest of its probability it is spread over the surface.
    """

    effect: str
    family: str
    probability: float
    surface: str | None = None
    place: str = ""
    size: float = math.nan
    low: float = math.nan
    high: float = math.nan
    unit: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    spectrum: Array = field(default_factory=lambda: np.zeros(0))
    parts: tuple[tuple[Point, float], ...] = ()

    @property
    def middle(self) -> Point | None:
        """Middle in m of the part that holds at least half of the probability; None without one."""
        middle, probability = max(self.parts, key=lambda part: part[1], default=(None, 0.0))
        return middle if probability >= LOCATED * self.probability else None

    @property
    def about(self) -> str:
        """The middle in words; "" without one."""
        if self.middle is None:
            return ""
        return f", most probably about ({', '.join(f'{x:.1f}' for x in self.middle)}) m"

    @property
    def title(self) -> str:
        """Effect and place, as a sentence names them."""
        if self.surface is not None:
            return f'{self.effect} on "{self.surface}"'
        return f"{self.effect} of {self.place}" if self.place else self.effect

    @property
    def can_be_added(self) -> bool:
        """Whether it stands on a surface and a room of one geometry can have it."""
        return self.surface is not None and self.effect != CoupledRoom.name

    @property
    def in_words(self) -> str:
        """Size with its interval; "" where there is none."""
        if not np.isfinite(self.size):
            return ""
        return amount(self.size, self.unit, (self.low, self.high))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            **{k: v for k, v in vars(self).items() if k not in _CONVERTED},
            **{k: json_numbers(getattr(self, k)) for k in ("size", "low", "high")},
            "parameters": dict(self.parameters),
            "spectrum": json_numbers(self.spectrum),
            "parts": [{"middle": list(m), "probability": p} for m, p in self.parts],
        }


_CONVERTED = ("size", "low", "high", "spectrum", "parameters", "parts")


_SPACING = 0.1
"""Standard deviation of ln size within the grid's distance, which is 0.26."""


@dataclass(frozen=True, eq=False)
class Summary:
    """Probabilities of everything that may be other than stated; see `PositionsFinding`.

    ``on_surfaces`` is the probability that something stands on a surface.
    """

    candidates: tuple[Candidate, ...]
    probabilities: dict[str, float]
    families: dict[str, float]
    surfaces: dict[str, float]
    on_surfaces: float


def summary_of(case: PositionsCase, hypotheses: PositionsHypotheses, posterior: Weights) -> Summary:
    """Return what the weights of a single set of residuals say."""
    total = float(posterior.total[0])
    names = list(case.faces)
    grouped: dict[tuple[str, int | None, str], list[tuple[ShiftHypothesis, Array]]] = {}
    for shift, logs in zip(hypotheses.shifts, posterior.shifts, strict=True):
        key = (shift.effect, shift.surface, shift.place)
        grouped.setdefault(key, []).append((shift, np.exp(logs[:, 0] - total)))
    candidates = [_candidate(case, members) for members in grouped.values()]
    places: dict[tuple[str, str], list[tuple[float, float, str]]] = {}
    for spread, log in zip(hypotheses.spreads, posterior.spreads, strict=True):
        chance = float(np.exp(log[0] - total))
        places.setdefault((spread.effect, spread.place), []).append(
            (chance, spread.size, spread.unit)
        )
    for (effect, place), members in places.items():
        candidates.append(_misplaced(effect, place, members))
    for effect, log in ((COEFFICIENTS, posterior.coefficients), (UNKNOWN, posterior.unknown)):
        chance = float(np.exp(log[0] - total))
        if chance > 0:
            candidates.append(Candidate(effect=effect, family=effect, probability=chance))
    candidates.sort(key=lambda c: -c.probability)
    probabilities = {NONE: float(np.exp(posterior.none[0] - total))}
    families = dict(probabilities)
    surfaces = dict.fromkeys(names, 0.0)
    for c in candidates:
        probabilities[c.effect] = probabilities.get(c.effect, 0.0) + c.probability
        families[c.family] = families.get(c.family, 0.0) + c.probability
        if c.surface is not None:
            surfaces[c.surface] += c.probability
    on_surfaces = sum(surfaces.values())
    shares = {n: p / on_surfaces if on_surfaces > 0 else 0.0 for n, p in surfaces.items()}
    return Summary(
        tuple(candidates),
        most_probable_first(probabilities),
        with_added(families),
        most_probable_first(shares),
        on_surfaces,
    )


def _shares(chances: Array) -> Array:
    """Return probabilities over their sum, equal ones where all are 0."""
    total = chances.sum()
    return chances / total if total > 0 else np.full(len(chances), 1 / len(chances))


def _candidate(case: PositionsCase, members: Sequence[tuple[ShiftHypothesis, Array]]) -> Candidate:
    """Return the candidate of an effect in one place: spread over a surface, and on its parts."""
    shift = members[0][0]
    chances = np.concatenate([some for _, some in members])
    sizes = np.concatenate([member.sizes for member, _ in members])
    total = float(chances.sum())
    share = _shares(chances)
    likely = int(np.argmax(share))
    signed = bool((sizes <= 0).any())
    scale = sizes if signed else np.log(sizes)
    mean = float(share @ scale)
    more = 0.0 if signed else _SPACING**2 + shift.size_error**2
    deviation = float(np.sqrt(share @ (scale - mean) ** 2 + more))
    ends = [mean, mean - NORMAL_90 * deviation, mean + NORMAL_90 * deviation]
    size, low, high = ends if signed else np.exp(ends).tolist()
    surface = None if shift.surface is None else list(case.faces)[shift.surface]
    return Candidate(
        effect=shift.effect,
        family=shift.family,
        surface=surface,
        place=surface or shift.place,
        probability=total,
        size=size,
        low=low,
        high=high,
        unit=shift.unit,
        parameters=[p for member, _ in members for p in member.parameters][likely],
        spectrum=np.asarray(share @ np.concatenate([member.spectra for member, _ in members])),
        parts=tuple(
            (case.divided.parts[member.part].middle, float(some.sum()))
            for member, some in members
            if member.part is not None
        ),
    )


def _misplaced(effect: str, place: str, members: Sequence[tuple[float, float, str]]) -> Candidate:
    """Return a candidate of the measurement: its sizes are those that are tried."""
    chances = np.array([chance for chance, _, _ in members])
    sizes = np.array([size for _, size, _ in members])
    total = float(chances.sum())
    share = _shares(chances)
    likely = sizes[share >= min(0.05, share.max())]
    size = float(np.clip(share @ sizes, likely.min(), likely.max()))
    return Candidate(
        effect=effect,
        family=MEASUREMENT,
        place=place,
        probability=total,
        size=size,
        low=float(likely.min()),
        high=float(likely.max()),
        unit=members[0][2],
    )
