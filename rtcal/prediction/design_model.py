"""A room, the treatments that it allows, and how probable a range of T is with some of each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from rtcal.acoustics.change_files import LEAST, Treatment
from rtcal.acoustics.changed_time import KnownRoom
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions
from rtcal.acoustics.targets import Target
from rtcal.prediction.predicted import Prediction, predict
from rtcal.prediction.search import Choice, Margins
from rtcal.support.types import Array

_LEAST, _MOST = 1e-3, 1 - 1e-6
"""Probabilities beyond which a margin is that of a normal ln T: there samples are too few."""
_NONE = 1e-9
"""Areas below this, in shares of a treatment's largest, are 0."""
_KEPT = 100
"""Most predictions that are kept."""
_WIDEST, _WIDENED = 100.0, 0.002
"""Largest factor by which a range is widened, and its accuracy."""
_FAR = 50.0
"""Largest margin in standard deviations: where nothing changes, T is exact."""


@dataclass(frozen=True, eq=False)
class DesignModel:
    """The treatments that a room allows, and what is known of it."""

    known: KnownRoom
    treatments: tuple[Treatment, ...]
    target: Target
    assumptions: Assumptions

    @property
    def before(self) -> Room:
        """The room before, with the stated coefficients."""
        return self.known.room

    @cached_property
    def prices(self) -> Array:
        """Cost of 1 m² of each treatment, (n_treatments,)."""
        return np.array([t.cost for t in self.treatments], dtype=float)

    @cached_property
    def covering(self) -> tuple[Array, Array]:
        """Which treatments cover which surface, (n_surfaces, n_treatments), and its area in m²."""
        names = sorted({t.covers for t in self.treatments if t.covers is not None})
        rows = np.array([[float(t.covers == n) for t in self.treatments] for n in names])
        areas = [float(self.before.areas[self.before.material_index(n)]) for n in names]
        return rows.reshape(len(names), len(self.treatments)), np.array(areas)

    def prediction(self, x: Array) -> Prediction:
        """Return T of the room with areas of the treatments in m²."""
        put = [(self.treatments[j], float(x[j])) for j in self._order]
        return predict(
            self.known,
            [t.change(area) for t, area in put if area > _NONE * t.largest],
            assumptions=self.assumptions,
            name="design",
        )

    @cached_property
    def _predicted(self) -> dict[bytes, tuple[Prediction, Array, Array]]:
        return {}

    def _known(self, x: Array) -> tuple[Prediction, Array, Array]:
        """Return the prediction for areas in m², and mean and sd of ln T; kept for later."""
        key = x.tobytes()
        if key not in self._predicted:
            if len(self._predicted) == _KEPT:  # the first one goes
                del self._predicted[next(iter(self._predicted))]
            made = self.prediction(x)
            self._predicted[key] = made, made.log_mean, made.log_sigma
        return self._predicted[key]

    def probability(self, x: Array, target: Target | None = None) -> Array:
        """Return the probability that T is in its range, (n_bands,), as the prediction states it."""
        target = target or self.target
        return self._known(x)[0].probability(target.low, target.high)

    def margins(self, probability: float, target: Target | None = None) -> Margins:
        """Return the function that returns ndtri(P) - ndtri(probability) of the bands with a range."""
        target = target or self.target
        bounded = target.bounded
        low, high = np.log(target.low[bounded]), np.log(target.high[bounded])

        def of(x: Array) -> Array:
            found = self.probability(x, target)[bounded]
            _, mean, sigma = self._known(x)
            mean, sigma = mean[bounded], sigma[bounded]
            # Further off than samples reach, ln T is taken as normal: the search must see a slope.
            ends = np.fmin(high - mean, mean - low) / np.maximum(sigma, 1e-9)
            sampled = ndtri(np.clip(found, _LEAST, _MOST))
            level = np.where(found < _LEAST, np.minimum(ends, sampled), sampled)
            level = np.where(found > _MOST, np.maximum(ends, sampled), level)
            return np.asarray(np.clip(level, -_FAR, _FAR) - ndtri(probability))

        return of

    @cached_property
    def _order(self) -> Array:
        """The treatments by what they are: the search does not depend on the order of a list."""

        def what(j: int) -> tuple[object, ...]:
            t = self.treatments[j]
            return t.cost, t.largest, t.unit or 0.0, t.covers or "", t.material_name, t.name

        return np.array(sorted(range(len(self.treatments)), key=what))

    def _choice(self, margins: Margins) -> Choice:
        """Return what may be placed, and what it must keep, in the treatments' own order."""
        listed = [self.treatments[j] for j in self._order]
        units = [np.nan if t.unit is None else t.unit for t in listed]
        largest = [t.largest for t in listed]
        covers, surfaces = self.covering
        return Choice(
            cost=self.prices[self._order],
            largest=np.array(largest),
            unit=np.array(units),
            covers=covers[:, self._order],
            surfaces=surfaces,
            margins=lambda x: margins(self._as_listed(x)),
        )

    def _as_listed(self, x: Array) -> Array:
        return x[np.argsort(self._order)]

    def _widest(self, margins: Margins) -> Array:
        """Return the areas in m² whose least margin is largest. Panels need not be whole."""
        choice = self._choice(margins)
        return self._as_listed(choice.widest(choice.everything)[0] * choice.size)

    def cheapest(self, probability: float) -> Array | None:
        """Return the cheapest areas in m², (n_treatments,), panels whole; None if none will do."""
        found = self._choice(self.margins(probability)).cheapest()
        return None if found is None else self._as_listed(found)

    def most_probable(self, target: Target | None = None) -> tuple[Array, float]:
        """Return the areas whose least probable band is most probable, and its probability.

        Panels need not be whole.
        """
        target = target or self.target
        x = self._widest(self.margins(LEAST, target))
        return x, float(self.probability(x, target)[target.bounded].min())

    def widening(self, probability: float) -> float | None:
        """Return the factor by which both ends must move for a design to exist; None above 100.

        Panels need not be whole.
        """
        bounded = self.target.bounded
        low, high = np.log(self.target.low[bounded]), np.log(self.target.high[bounded])

        def spare(x: Array) -> Array:
            """Distance by which a normal ln T keeps the nearer end."""
            _, mean, sigma = self._known(x)
            ends = np.fmin(high - mean[bounded], mean[bounded] - low)
            return np.asarray(ends - ndtri(probability) * sigma[bounded])

        x = self._widest(spare)

        def kept(factor: float) -> bool:
            found = self.probability(x, self.target.widened(factor))
            return bool((found[bounded] >= probability).all())

        least, most = 1.0, _WIDEST
        if not kept(most):
            return None
        while most / least > 1 + _WIDENED:
            middle = float(np.sqrt(least * most))
            least, most = (least, middle) if kept(middle) else (middle, most)
        return most
