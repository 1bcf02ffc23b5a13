"""A room's absorption as a linear function of the treatments' areas, and the cheapest areas.

With the posterior of `rtcal.acoustics.states`, the absorption area of the treated surfaces is
A = w'a, w = S + U x, of the effective coefficients a = alpha exp(ln S error). The error of ln T that is
none of theirs (the equation's, and that of ln V) is regressed on them: a part beta'(a - mean) moves
with them, and is added to w as -q beta, with q = -1 / (d ln T / dA); the rest is independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtri

from rtcal.acoustics.change_files import Treatment
from rtcal.acoustics.changes import changed
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.states import Rooms, State, estimated_change, near_bounds, samples
from rtcal.acoustics.targets import Target
from rtcal.prediction.predicted import SAMPLES, Prediction, predict
from rtcal.prediction.program import TANGENTS, ProgramNumbers, Ranges, program
from rtcal.support.types import Array

_ROUNDS = 12
_SETTLED = 1e-4
"""Largest change of an area in the last round, in shares of the room's surface."""
_SLACK = 5e-4
"""What the exact probability may lack of the promised one: a tangent stands above g by so much."""
_LAST = 4
"""Tangents at the answers of the last rounds. The others are spread over the whole range of means."""
_INSIDE = 1e-4
"""Share of the range of means by which a tangent keeps off its ends, where it would be vertical."""
_MOST_NODES = 400
_WHOLE = 1e-6
"""Distance of a number of panels from a whole one that counts as rounding."""


@dataclass(frozen=True, eq=False)
class DesignModel:
    """The treatments that a room allows, and what is known of it."""

    states: tuple[State, ...]
    before: Room
    treatments: tuple[Treatment, ...]
    target: Target
    equation: LinearEquation
    assumptions: Assumptions

    def of(self, names: tuple[str, ...]) -> DesignModel:
        """Return the model with these treatments alone; what is known of it is kept."""
        if names not in self._some:
            used = tuple(t for t in self.treatments if t.name in names)
            self._some[names] = replace(self, treatments=used)
        return self._some[names]

    @cached_property
    def _some(self) -> dict[tuple[str, ...], DesignModel]:
        return {tuple(t.name for t in self.treatments): self}

    @cached_property
    def rooms(self) -> Rooms:
        """States, the room, and the room with a little of every treatment."""
        room = changed(self.before, [])
        for treatment in self.treatments:
            area = treatment.largest
            if treatment.covers is not None:
                has = room.areas[room.material_index(treatment.covers)]
                area = min(area, float(has) / 2)
            room = changed(room, treatment.change(area / 2))
        every = [*(state.room for state in self.states), self.before, room]
        return Rooms(every, self.equation, self.assumptions)

    @cached_property
    def areas(self) -> Array:
        """Areas of all materials before, (n_materials,)."""
        return np.asarray(self.rooms.areas[-2])

    @cached_property
    def steps(self) -> Array:
        """U: what 1 m² of each treatment does to the areas, (n_materials, n_treatments)."""
        out = np.zeros((len(self.rooms.materials), len(self.treatments)))
        for j, treatment in enumerate(self.treatments):
            out[self.rooms.materials.index(treatment.material_name), j] += 1
            if treatment.covers is not None:
                out[self.rooms.materials.index(treatment.covers), j] -= 1
        return out

    @cached_property
    def covering(self) -> tuple[Array, Array]:
        """Which treatments cover which surface, (n_surfaces, n_treatments), and its area in m²."""
        names = list(dict.fromkeys(t.covers for t in self.treatments if t.covers is not None))
        rows = np.array([[float(t.covers == n) for t in self.treatments] for n in names])
        areas = [float(self.before.areas[self.before.material_index(n)]) for n in names]
        if not names:  # the program has one row at least
            return np.zeros((1, len(self.treatments))), np.ones(1)
        return rows, np.array(areas)

    @cached_property
    def _known(self) -> tuple[Array, Array, Array, Array, Array]:
        """Mean and root of the covariance of a; beta; mean and sd of the independent error."""
        found = estimated_change(self.rooms, self.states)
        n, n_bands = len(self.rooms.materials), len(found.mode)
        factor = np.exp(found.mode[:, n + 1 : -2])
        # What is not of the surfaces: ln V, the air's ln m, and the equation's own error.
        others = [n, -2, -1]
        by_others = self.rooms.log_time(len(self.states), found.mode)[1][:, others]
        linear = np.zeros((n_bands, n + 1, self.rooms.size))
        linear[:, range(n), range(n)] = factor
        linear[:, range(n), range(n + 1, 2 * n + 1)] = found.mode[:, :n] * factor
        linear[:, n, others] = by_others
        covariance = linear @ found.covariance @ linear.swapaxes(1, 2)
        mean = found.mode[:, :n] * factor
        offset = (found.mode[:, others] * by_others).sum(axis=1)
        weights = np.broadcast_to(self.rooms.areas.max(axis=0), (n_bands, n))
        whole = np.sqrt(np.einsum("ki,kij,kj->k", weights, covariance[:, :n, :n], weights))
        for k in np.flatnonzero(near_bounds(self.rooms, found, weights, whole)).tolist():
            # The bounds cut the distribution: its moments are those of samples.
            drawn = samples(self.rooms, found, k, SAMPLES)
            a = drawn[:, :n] * np.exp(drawn[:, n + 1 : -2])
            error = drawn[:, others] @ by_others[k][:, np.newaxis]
            mean[k], offset[k] = a.mean(axis=0), error.mean()
            covariance[k] = np.cov(np.hstack([a, error]), rowvar=False)
        of_a = covariance[:, :n, :n]
        across = covariance[:, :n, n]
        beta = np.einsum("kij,kj->ki", np.linalg.pinv(of_a, hermitian=True), across)
        left = covariance[:, n, n] - np.einsum("ki,ki->k", beta, across)
        tau = np.sqrt(np.maximum(left, 0) + self.assumptions.own**2)
        value, vector = np.linalg.eigh(of_a)
        root = np.sqrt(np.maximum(value, 0))[:, :, np.newaxis] * vector.swapaxes(1, 2)
        return mean, root, beta, offset, tau

    def prediction(self, x: Array) -> Prediction:
        """Return T of the room with areas of the treatments in m²."""
        put = zip(self.treatments, x.tolist(), strict=True)
        return predict(
            self.states,
            [treatment.change(area) for treatment, area in put if area > 0],
            before=self.before,
            equation=self.equation,
            assumptions=self.assumptions,
            name="design",
        )

    @property
    def prices(self) -> Array:
        """Cost of 1 m² of each treatment, (n_treatments,)."""
        return np.array([t.cost for t in self.treatments], dtype=float)

    def ranges(self, x: Array, target: Target | None = None) -> Ranges:
        """Return the target's ranges in the room with these areas: its whole surface counts."""
        _, _, _, offset, tau = self._known
        whole = self.before.total_area + float(self.steps.sum(axis=0) @ x)
        if whole not in self._sized:
            areas = self.before.areas * (whole / self.before.total_area)
            self._sized[whole] = changed(self.before, []).replace(areas=areas)
        return Ranges(self._sized[whole], self.equation, target or self.target, offset, tau)

    @cached_property
    def _sized(self) -> dict[float, Room]:
        """The room with another whole surface in m²."""
        return {}

    def area(self, x: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation of A in m², (n_bands,) each, for areas x in m²."""
        mean, root, beta, _, _ = self._known
        w = self.areas + self.steps @ x
        m = mean @ w
        q = self._slope(m, x)
        sigma = np.linalg.norm(np.einsum("kij,kj->ki", root, w - q[:, np.newaxis] * beta), axis=1)
        return m, sigma

    def _slope(self, mean: Array, x: Array) -> Array:
        """Return q = -1 / (d ln T / dA) in m², (n_bands,)."""
        room = self.ranges(x).room
        step = 1e-5 * room.total_area
        mean = np.clip(mean, 2 * step, 0.999 * room.total_area)
        times = [self.equation.time(room, mean + s) for s in (-step, step)]
        return np.asarray(2 * step / np.log(times[0] / times[1]))

    def probability(self, x: Array, target: Target | None = None) -> Array:
        """Return the probability that T is in its range, (n_bands,)."""
        return self.ranges(x, target).probability(*self.area(x))

    def cheapest(
        self,
        probability: float | Array,
        target: Target | None = None,
        start: Array | None = None,
    ) -> Array | None:
        """Return the cheapest areas in m², whole panels where asked for; None if there are none.

        The ``probability`` is that of all bands, or one of each, (n_bands,).

        The slope of ln T and a free-standing treatment's surface depend on the answer: rounds follow
        from ``start`` until it no longer moves. Where the program of a round has no answer, the next
        one is linear at the most probable areas.
        """
        x, sought = self._upper / 2 if start is None else start, False
        means: tuple[Array, ...] = ()
        for _ in range(_ROUNDS):
            mean = self.area(x)[0]
            numbers = self.numbers(probability, x, mean, target, means)
            after = None if numbers is None else self._solve(numbers)
            if after is None and not sought:
                x, margin = self.most_probable(probability, target)
                if margin < 0:
                    return None
                means, sought = (self.area(x)[0],), True
                continue
            if after is None:
                break
            moved = float(np.max(np.abs(after - x))) / self.before.total_area
            x = after
            if moved < _SETTLED and self._lacks(probability, x, target) <= _SLACK:
                break
            means = (*means[1 - _LAST :], self.area(x)[0])
        if any(t.unit is not None for t in self.treatments):
            return self._whole_panels(probability, x, target)
        return x

    def most_probable(
        self, probability: float | Array, target: Target | None = None
    ) -> tuple[Array, float]:
        """Return the areas whose least margin is largest, and that margin, in standard deviations.

        The margin of a band is ndtri(P) - ndtri(probability). Panels need not be whole.
        """
        from scipy.optimize import minimize

        bounded, upper = (target or self.target).bounded, self._upper
        limits, largest = self.covering
        asked = ndtri(np.broadcast_to(probability, bounded.shape))

        def margins(shares: Array) -> Array:
            found = self.probability(shares * upper, target)
            return np.asarray((ndtri(np.clip(found, 1e-12, 1 - 1e-12)) - asked)[bounded])

        n, best = len(upper), (self._upper * 0, -np.inf)
        most = min(1.0, float(np.min(largest / np.maximum(limits @ upper, 1e-300))))
        for start in most * np.array([0.0, 0.25, 0.5, 1.0]):
            found = minimize(
                lambda v: -v[-1],
                np.append(np.full(n, start), margins(np.full(n, start)).min()),
                jac=lambda v: np.append(np.zeros(n), -1.0),
                bounds=[*[(0.0, 1.0)] * n, (None, None)],
                constraints=[
                    {"type": "ineq", "fun": lambda v: margins(v[:-1]) - v[-1]},
                    {"type": "ineq", "fun": lambda v: 1 - limits @ (v[:-1] * upper) / largest},
                ],
                method="SLSQP",
                options={"maxiter": 40, "ftol": 1e-5, "eps": 1e-5},
            )
            shares = np.clip(found.x[:-1], 0, 1)
            shares = shares / max(1.0, float(np.max(limits @ (shares * upper) / largest)))
            margin = float(margins(shares).min())
            if margin > best[1]:
                best = shares * upper, margin
        return best

    def _lacks(self, probability: float | Array, x: Array, target: Target | None) -> float:
        """Return what the worst band's probability lacks of the promised one; below 0 nothing."""
        ranges = self.ranges(x, target)
        lacking = probability - ranges.probability(*self.area(x))
        return float(lacking[ranges.target.bounded].max())

    def numbers(
        self,
        probability: float | Array,
        x: Array,
        at: Array,
        target: Target | None = None,
        means: Sequence[Array] = (),
    ) -> ProgramNumbers | None:
        """Return the program's numbers; None if the equation's error alone forbids the probability.

        ``x`` and ``at`` are the areas and the means at which the model is linear, ``means`` those of
        further tangents, at most 4.
        """
        ranges = self.ranges(x, target)
        whole = ranges.room.total_area
        mean, root, beta, _, _ = self._known
        gains = mean @ self.steps
        key = (
            np.asarray(probability).tobytes(),
            whole,
            ranges.target.low.tobytes(),
            ranges.target.high.tobytes(),
        )
        if key not in self._spans:
            reach = [
                mean @ self.areas + bound(gains, 0.0) @ self._upper
                for bound in (np.minimum, np.maximum)
            ]
            span = ranges.span(probability, reach[0], reach[1])
            n = TANGENTS - _LAST
            # Closer towards both ends, where g rises most steeply.
            places = (1 - np.cos(np.pi * (np.arange(n) + 0.5) / n))[:, np.newaxis] / 2
            self._spans[key] = span and (
                *span,
                *ranges.tangents_above(probability, span[0] + (span[1] - span[0]) * places),
            )
        kept = self._spans[key]
        if kept is None:
            return None
        first, last, intercept, slope = kept
        # Where there is no answer yet, the first tangent stands again.
        further = np.array([*means, *[first] * (_LAST - len(means))])
        off = _INSIDE * (last - first)
        cuts = ranges.tangents(probability, np.clip(further, first + off, last - off))
        q = self._slope(at, x)[:, np.newaxis]
        limits, largest = self.covering
        return ProgramNumbers(
            cost=self.prices,
            lower=np.zeros(len(self.treatments)),
            upper=self._upper,
            limits=limits,
            largest=largest,
            start=np.einsum("kij,kj->ki", root, self.areas - q * beta),
            steps=root @ self.steps,
            mean=mean @ self.areas,
            gains=gains,
            intercept=np.vstack([intercept, cuts[0]]).T,
            slope=np.vstack([slope, cuts[1]]).T,
            scale=whole,
        )

    @cached_property
    def _spans(self) -> dict[Any, tuple[Array, ...] | None]:
        """Range of means, and tangents over it, by probability, surface and target."""
        return {}

    @property
    def _upper(self) -> Array:
        return np.array(
            [
                t.largest if t.unit is None else t.unit * np.floor(t.largest / t.unit + _WHOLE)
                for t in self.treatments
            ]
        )

    def _solve(self, numbers: ProgramNumbers) -> Array | None:
        n_bands, n_rows, n_treatments = numbers.steps.shape
        return program(n_treatments, len(numbers.limits), n_bands, n_rows).solve(numbers)

    def _whole_panels(
        self, probability: float | Array, x: Array, target: Target | None
    ) -> Array | None:
        """Return the cheapest areas with whole panels, by branch and bound; None if there are none."""
        units = np.array([np.nan if t.unit is None else t.unit for t in self.treatments])
        cost = self.prices
        means: tuple[Array, ...] = (self.area(x)[0],)
        first = self.numbers(probability, x, means[0], target, means)
        best: Array | None = None
        waiting: list[tuple[Array, Array]] = []
        if first is not None:
            waiting = [(first.lower, first.upper)]
        for _ in range(_MOST_NODES):
            if first is None or not waiting:
                break
            lower, upper = waiting.pop()
            found = self._solve(replace(first, lower=lower, upper=upper))
            if found is None or (best is not None and cost @ found >= cost @ best - 1e-9):
                continue
            panels = found / units
            off = np.abs(panels - np.round(panels))
            off = np.where(np.isnan(off), 0.0, off)
            if off.max() < _WHOLE:
                whole = np.where(np.isnan(units), found, np.round(panels) * units)
                if self._lacks(probability, whole, target) <= _SLACK:
                    best = whole
                    continue
                # A tangent at this answer cuts it off, unless all panels are fixed.
                means = (*means[1 - _LAST :], self.area(whole)[0])
                first = self.numbers(probability, x, means[0], target, means)
                if not np.allclose(lower, upper):
                    waiting.append((lower, upper))
                continue
            j = int(np.argmax(off))
            down, up = upper.copy(), lower.copy()
            down[j], up[j] = np.floor(panels[j]) * units[j], np.ceil(panels[j]) * units[j]
            # The upper branch is tried first: rounding up mostly keeps the constraints.
            waiting.append((lower, down))
            if up[j] <= upper[j] + _WHOLE:
                waiting.append((up, upper))
        return best
