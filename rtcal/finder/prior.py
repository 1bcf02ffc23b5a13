"""The prior: which effect, how much of it, which coefficients, before anything was measured.

Every number of this page is an assumption. It decides where the data do not. The odds are an argument
of `rtcal.finder.find`; an effect states its own in its class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import HANDBOOK_SIGMA
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.model import State
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

NONE, COEFFICIENTS, UNKNOWN = "none", "coefficients", "unknown"
NO_EFFECT = 1 / 3
"""Prior probability that the model lacks no effect: who asks has a reason. In the development rooms of
the two test worlds nothing is missing in 0.38 and 0.26."""
UNKNOWN_ODDS = 1.0
"""Prior odds of an effect that no library has, against a listed effect of odds 1."""
OFF_TOGETHER = 0.2
"""Prior probability that coefficients of handbook uncertainty are off together. Catalogues agree to
some 30 % for a material, and a room's absorption area after them is off by 23 to 34 % in three
measured rooms (docs/discrepancy_study.md): more than independent errors of so many materials."""
EXPECTED = 0.7
"""Expected number of effects that a model lacks, where several are sought at once."""
SHARPER = 0.4
"""How much the power of the probabilities grows towards a sigma of 0: it is 1 at a handbook's sigma,
and 1.4 at 0. Where coefficients were measured, the most probable answer is right more often than
evidence times prior says: rooms err less than the evidence assumes, and the library has effects that
they do not have. Chosen on development rooms (`python -m benchmarks.calibrated probabilities`), as the
temperature of a classifier is (Guo, Pleiss, Sun & Weinberger 2017)."""


@dataclass(frozen=True)
class Prior:
    """Prior log probabilities of "none", "coefficients", "unknown" and each effect; they sum to 1.

    ``off`` is the probability that the coefficients are off together, whatever else is missing.
    ``sharpness`` is the power of the probabilities after the measurement (`sharpness`).
    """

    log_probability: Mapping[str, float]
    off: float
    sharpness: float = 1.0


def relative_sigma(room: Room) -> float:
    """Return the stated sigma of the coefficients over a handbook's, at most 1.

    It is sigma over alpha, both weighted by area and summed over bands, over `HANDBOOK_SIGMA`.
    """
    stated = float((room.areas @ room.sigma).sum() / max((room.areas @ room.alpha).sum(), 1e-12))
    return min(1.0, stated / HANDBOOK_SIGMA)


def off_together(room: Room) -> float:
    """Return the prior probability that the room's coefficients are off together.

    It is `OFF_TOGETHER` times the square of `relative_sigma`: who states a small sigma knows the
    coefficients from a measurement, and an error of all of them that exceeds it is improbable.
    """
    return OFF_TOGETHER * relative_sigma(room) ** 2


def sharpness(room: Room) -> float:
    """Return the power to which the probabilities are taken before they are made to sum to 1."""
    return 1.0 + SHARPER * (1.0 - relative_sigma(room))


def prior_of(
    room: Room, effects: Sequence[Effect], stated: Mapping[str, float], without: Sequence[str] = ()
) -> Prior:
    """Return the prior: the effects' own odds, or those that are ``stated`` by name."""
    off = off_together(room)
    if COEFFICIENTS in stated:
        off = stated[COEFFICIENTS] / (1 + stated[COEFFICIENTS])
    if COEFFICIENTS in without:
        off = 0.0
    no_effect = NO_EFFECT
    if NONE in stated:
        no_effect = stated[NONE] / (1 + stated[NONE])
    odds = {e.name: stated.get(e.name, e.prior_odds(room)) for e in effects}
    odds[UNKNOWN] = 0.0 if UNKNOWN in without else stated.get(UNKNOWN, UNKNOWN_ODDS)
    total = sum(odds.values())
    with np.errstate(divide="ignore"):
        table = {NONE: float(np.log(no_effect * (1 - off)))}
        table[COEFFICIENTS] = float(np.log(no_effect * off))
        table |= {k: float(np.log((1 - no_effect) * v / total)) for k, v in odds.items()}
    return Prior(table, off, sharpness(room))


def left_out_of(
    only: Sequence[str],
    without: Sequence[str],
    possible: Sequence[str],
    in_any_case: Sequence[str] = (),
) -> tuple[str, ...]:
    """Return the names that are not tried: those ``without``, and with ``only`` all others.

    ``in_any_case`` are tried beside ``only``. Raises DataError for a name that is not ``possible``,
    and where nothing is left.
    """
    named = {"only": checks.listed("only", only), "without": checks.listed("without", without)}
    for place, names in named.items():
        if unlisted := [n for n in names if n not in possible]:
            raise DataError(
                f'{place} has "{unlisted[0]}", which is not one of {", ".join(possible)}'
            )
    left = set(named["without"])
    if named["only"]:
        left |= {*possible} - {*named["only"], *in_any_case}
    if left >= {*possible}:
        raise DataError(_NONE_LEFT)
    return tuple(sorted(left))


_NONE_LEFT = "only and without leave no effect to try"


def chosen_effects(
    effects: Sequence[Effect], without: Sequence[str], only: Sequence[str]
) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """Return the effects to try, and the names that are left out; DataError for an unknown name."""
    possible = [*(e.name for e in effects), COEFFICIENTS, UNKNOWN]
    left = left_out_of(only, without, possible, [UNKNOWN])
    tried = tuple(e for e in effects if e.name not in left)
    if not tried:
        raise DataError(_NONE_LEFT)
    return tried, left


def checked_odds(effects: Sequence[Effect], prior: object) -> dict[str, float]:
    """Return the odds that a user states, by name; DataError for another name, or odds not above 0."""
    names = [*(e.name for e in effects), NONE, COEFFICIENTS, UNKNOWN]
    stated = {} if prior is None else checks.mapped("prior", prior)
    for name in stated:
        if name not in names:
            raise DataError(f'prior has "{name}", which is not one of {", ".join(names)}')
    return {name: checks.positive(f'prior["{name}"]', odds) for name, odds in stated.items()}


def grid_weights(effect: Effect, grid: Sequence[Parameters], state: State) -> Array:
    """Return the prior probability of each set of parameters given the effect, (n,); they sum to 1.

    It is the effect's density times the width of the set's cell: half of the distance between the
    neighbours on either side, in ln of a parameter that is above 0. So a grid twice as fine gives each
    point half of the weight, and the effect the same evidence.
    """
    weights = np.array([effect.density(theta, state) for theta in grid], dtype=float)
    for name in grid[0]:
        if name not in effect.discrete:
            weights *= _cells(np.array([theta[name] for theta in grid]))
    if not (np.isfinite(weights).all() and weights.min() >= 0 and weights.sum() > 0):
        raise DataError(f'effect "{effect.name}": density is not finite and 0 or more')
    return np.asarray(weights / weights.sum())


def _cells(values: Array) -> Array:
    """Return the width of each value's cell, (n,); 1 where all values are equal."""
    unique, place = np.unique(values, return_inverse=True)
    if len(unique) == 1:
        return np.ones(len(values))
    scaled = np.log(unique) if unique[0] > 0 else unique
    edges = np.concatenate([scaled[:1], 0.5 * (scaled[1:] + scaled[:-1]), scaled[-1:]])
    return np.asarray(np.diff(edges)[place])
