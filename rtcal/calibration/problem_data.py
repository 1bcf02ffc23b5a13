"""The numbers of one calibration, with which a compiled problem is filled before each solve."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.calibration.layout import Integers, Layout
from rtcal.calibration.observed import Whitened
from rtcal.support.types import Array, read_only_view

__all__ = ["Flags", "Integers", "ProblemData"]

Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, repr=False)
class ProblemData:
    """One set of numbers for a problem of a fixed shape.

    The unknowns u are alpha, flattened row by row with the bands last, and then the further unknowns.
    The solver's unknowns x are whitened: u = centre + scale x. By default centre = mu and
    scale = sigma. A pinned unknown has its value as centre, and scale 0.

    Attributes
    ----------
    layout : Layout
    mu, sigma : array (size,)
        The prior.
    lower, upper : array (size,)
        The box.
    areas : array (n_configurations, n_rows)
        m²; 0 if a configuration lacks the material.
    gains : array (n_configurations, n_bands, n_further)
        m² of absorption that one unit of each further unknown adds.
    time : array (n_configurations, n_bands)
        Measured T in s, NaN where missing.
    target, target_uncertainty : array (n_configurations, n_bands)
        b and its standard uncertainty in m², NaN where missing.
    largest_target : array (n_configurations, 1)
        The largest b in m² that the equation can invert.
    target_of : function
        b in m² for any T in s, both (n_configurations, n_bands).
    weights : tuple of float
        One per objective term.
    pinned : array (size,) of bool
        Unknowns fixed at ``centre`` for this solve.
    centre : array (size,)
    observed : mapping of term to Whitened
        The numbers of each `rtcal.terms.LinearObservations`.
    """

    layout: Layout
    mu: Array
    sigma: Array
    lower: Array
    upper: Array
    areas: Array
    gains: Array
    time: Array
    target: Array
    target_uncertainty: Array
    largest_target: Array
    target_of: Callable[[Array], Array]
    weights: tuple[float, ...]
    pinned: Flags
    centre: Array
    observed: Mapping[object, Whitened] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray) and value.flags.writeable:
                vars(self)[name] = read_only_view(value)

    @cached_property
    def matched(self) -> Flags:
        """Where there is a target, (n_configurations, n_bands)."""
        return np.isfinite(self.target)

    @cached_property
    def scale(self) -> Array:
        """d u / d x, (size,)."""
        return np.where(self.pinned, 0.0, self.sigma)

    @cached_property
    def inverse_sigma(self) -> Array:
        """1 / sigma, 0 where sigma = 0, (size,)."""
        inverse = np.divide(1.0, self.sigma, out=np.zeros_like(self.sigma), where=self.sigma > 0)
        inverse.setflags(write=False)
        return inverse

    @cached_property
    def reachable_box(self) -> tuple[Array, Array]:
        """The box, (size,) each, in which a fixed unknown has its centre as both sides."""
        moves = self.scale > 0
        return (
            np.where(moves, self.lower, self.centre),
            np.where(moves, self.upper, self.centre),
        )

    @cached_property
    def match_scale(self) -> Array:
        """1 / |S sigma| over the unknowns that can move, (n_matches,); 0 where nothing is matched."""
        alpha, further = self.alpha(self.scale), self.further(self.scale)
        square = self.areas**2 @ alpha**2
        if self.gains.size:
            square = square + self.gains**2 @ further**2
        size = np.sqrt(square)
        inverse = np.divide(1.0, size, out=np.zeros_like(size), where=self.matched & (size > 0))
        inverse.setflags(write=False)
        return inverse.ravel()

    def __repr__(self) -> str:
        return f"<ProblemData: {self.layout!r}>"

    def alpha(self, u: Array) -> Array:
        """Return the absorption coefficients among the unknowns, (n_rows, n_bands)."""
        return u[: self.layout.n_alpha].reshape(self.layout.n_rows, self.layout.n_bands)

    def further(self, u: Array) -> Array:
        """Return the further unknowns, (n_further,)."""
        return u[self.layout.n_alpha :]

    def absorption_area(self, u: Array) -> Array:
        """Return S'alpha with the effects' absorption area in m², (n_configurations, n_bands)."""
        area = self.areas @ self.alpha(u)
        return np.asarray(area + self.gains @ self.further(u)) if self.gains.size else area

    def pin(self, where: Flags, values: Array) -> ProblemData:
        """Return the data with the unknowns at ``where`` fixed at ``values``."""
        return replace(
            self,
            pinned=self.pinned | where,
            centre=np.where(where, values, self.centre),
        )
