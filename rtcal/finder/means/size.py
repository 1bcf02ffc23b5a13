"""The size of an effect: the best parameters, the size's interval, and how much it absorbs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
from scipy.special import logsumexp

from rtcal.finder.case import Case
from rtcal.finder.effects import Effect, Parameters
from rtcal.finder.effects.checks import changed_states
from rtcal.finder.finding import AbsorptionChange, End, Size
from rtcal.finder.means.evidence import NEGLIGIBLE
from rtcal.finder.means.room_states import state
from rtcal.finder.means.searched import Searched
from rtcal.finder.model import rates
from rtcal.support.types import Array

_AT_END = 2.0
"""Evidence in nats below that of the best size from which the last size that is tried is no end."""


def absorption_change(
    case: Case, effect: Effect, parameters: Parameters, size: Size | None
) -> AbsorptionChange | None:
    """Return what an effect of absorption changes in the first configuration; None for another."""
    if size is None or "absorption" not in effect.family:
        return None
    base = state(case, case.configurations[0])
    sets = [{**parameters, effect.size: s} for s in (size.mean, size.low, size.high)]
    without, *others = rates([base, *changed_states(effect, base, sets)])
    return AbsorptionChange((np.array(others) - without) / without.mean(), size.end)


def estimate_size(
    searched: Searched, name: str, *, precise: bool = True
) -> tuple[Parameters, Size | None]:
    """Return the effect's most probable parameters, and its size with a 90 % interval.

    Without ``precise``, the best set of the grid is taken, and the size is evaluated for it in wide
    steps. With it, a search improves the best set, and the size is evaluated in fine steps for it and
    for the three most probable sets of the other parameters.
    """
    predicted, effect = searched.predicted, searched.predicted.effects[name]
    rows = [i for i, n in enumerate(predicted.names) if n == name]
    likelihood = searched.evidence.by_hypothesis()[rows]
    grid = [predicted.parameters[i] for i in rows]

    def evaluated(thetas: Sequence[Parameters]) -> Array:
        return searched.under(effect, thetas).by_hypothesis()[1:]

    best = grid[int(np.argmax(likelihood))]
    if precise:
        best = _searched(grid, best, effect.discrete, evaluated)
    if not np.isfinite(effect.neutral):
        return best, None
    weights = predicted.weights[rows] * np.exp(likelihood - likelihood.max())
    weights = weights / weights.sum()
    by_others: dict[tuple[tuple[str, float], ...], float] = {}
    for theta, w in zip(grid, weights, strict=True):
        key = _others(theta, effect)
        by_others[key] = by_others.get(key, 0.0) + float(w)
    most = sorted(by_others, key=lambda k: -by_others[k])[:3]
    likely = list(dict.fromkeys([_others(best, effect), *most]))
    sizes = np.array([theta[effect.size] for theta in grid])
    logs = bool(sizes.min() > 0)
    low, high = float(sizes.min()), float(sizes.max())
    possible = effect.limits(searched.case.room).get(effect.size, (-np.inf, np.inf))
    if logs:
        first, last = np.log(low / 3), np.log(high * 3)
        ends = np.log(np.maximum(possible, low / 1e6))
    else:
        first, last, ends = low - 10, high + 10, np.array(possible)

    def size_of(x: Array) -> Array:
        return np.clip(np.exp(x), *possible) if logs else x

    def at(x: Array, kinds: Sequence[Any]) -> Array:
        return evaluated([{**dict(k), effect.size: float(s)} for k in kinds for s in size_of(x)])

    def steps(first: float, last: float, count: int) -> Array:
        return np.linspace(max(first, ends[0]), min(last, ends[1]), count)

    fine = steps(first, last, 25)
    log_p = at(fine, likely[:1])
    end: End = ""
    if high > effect.neutral and fine[-1] < ends[1] and log_p[-1] > log_p.max() - _AT_END:
        end = "least"
    elif low < effect.neutral and fine[0] > ends[0] and log_p[0] > log_p.max() - _AT_END:
        end = "most"
    if precise:
        likely_range = fine[log_p > log_p.max() - NEGLIGIBLE]
        step = fine[1] - fine[0] + 2.6 * effect.size_error
        fine = steps(likely_range[0] - step, likely_range[-1] + step, 37)
        log_p = at(fine, likely)
    else:
        likely = likely[:1]
    by_size = np.exp(log_p - logsumexp(log_p)).reshape(len(likely), len(fine)).sum(0)
    by_size = _widened(by_size, fine, effect.size_error)
    cumulated = np.cumsum(by_size) - 0.5 * by_size
    interval = [float(np.interp(q, cumulated, size_of(fine))) for q in (0.05, 0.95)]
    return best, Size(float(by_size @ size_of(fine)), interval[0], interval[1], effect.unit, end)


def _widened(p: Array, at: Array, spread: float) -> Array:
    """Return probabilities on an even grid, convolved with a normal distribution."""
    if spread == 0:
        return p
    kernel = np.exp(-0.5 * (np.subtract.outer(at, at) / spread) ** 2)
    # Probability that would leave the grid stays at its ends.
    return np.asarray(kernel / kernel.sum(0) @ p)


def _others(theta: Parameters, effect: Effect) -> tuple[tuple[str, float], ...]:
    return tuple((k, v) for k, v in theta.items() if k != effect.size)


def _searched(
    grid: Sequence[Parameters],
    start: Parameters,
    discrete: Sequence[str],
    evaluated: Callable[[Sequence[Parameters]], Array],
) -> Parameters:
    """Improve the grid's best parameters within the grid's range; discrete ones stay.

    Each round evaluates a lattice around the best, one step of the last lattice wide.
    """
    names = [k for k in start if k not in discrete and len({theta[k] for theta in grid}) > 1]
    if not names:
        return start
    values = np.array([[theta[k] for k in names] for theta in grid])
    logs = values.min(0) > 0
    scaled = np.log(np.where(logs, values, 1.0)) + np.where(logs, 0.0, values)
    low, width = scaled.min(0), np.ptp(scaled, axis=0)
    at = (scaled[grid.index(start)] - low) / width
    step = np.array([1 / (len(np.unique(column)) - 1) for column in values.T])

    def theta_of(x: Array) -> Parameters:
        values = low + width * x
        values = np.where(logs, np.exp(np.where(logs, values, 0.0)), values)
        return {**start, **dict(zip(names, values.tolist(), strict=True))}

    points, rounds = {1: (9, 3), 2: (5, 5)}.get(len(names), (3, 5))
    lattice = np.array(list(product(np.linspace(-1, 1, points), repeat=len(names))))
    for _ in range(rounds):
        candidates = np.unique(np.clip(at + lattice * step, 0, 1), axis=0)
        at = candidates[np.argmax(evaluated([theta_of(x) for x in candidates]))]
        step = step * 2 / (points - 1) if points > 3 else step / 2
    return theta_of(at)
