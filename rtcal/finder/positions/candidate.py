"""The candidates at positions, and the sums over effects, families, surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.finder.candidate import Candidate
from rtcal.finder.case import NORMAL_90
from rtcal.finder.claim import most_probable_first, with_added
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.posterior import PositionsHypotheses, Weights
from rtcal.finder.positions.shift import MEASUREMENT, UNKNOWN, ShiftHypothesis
from rtcal.finder.prior import COEFFICIENTS, NONE
from rtcal.support.types import Array

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
