"""The numbers of one calibration: what a compiled problem is filled with before it is solved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.types import Array

Flags = NDArray[np.bool_]
Integers = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Instance:
    """One set of numbers for a problem of a fixed shape.

    The unknowns, flattened material by material with the bands last, are whitened:
    alpha = centre + scale x. By default centre = mu and scale = sigma; a coefficient that is pinned
    has scale 0 and its value as centre, which needs no special case in the solver.

    Attributes
    ----------
    mu, sigma : array (n_materials, n_bands)
        The prior.
    lower, upper : array (n_materials, n_bands)
        The box.
    areas : array (n_configurations, n_materials)
        m²; 0 where a configuration lacks a material.
    target, target_uncertainty : array (n_configurations, n_bands)
        b and its standard uncertainty in m², NaN where missing.
    weights : tuple of float
        One for each objective term.
    pinned : array (n_materials, n_bands) of bool
        Coefficients held at ``centre`` for this solve.
    centre : array (n_materials, n_bands)
    """

    mu: Array
    sigma: Array
    lower: Array
    upper: Array
    areas: Array
    target: Array
    target_uncertainty: Array
    weights: tuple[float, ...]
    pinned: Flags
    centre: Array

    @property
    def shape(self) -> tuple[int, int, int]:
        """(n_configurations, n_materials, n_bands)."""
        return (self.areas.shape[0], *self.mu.shape)

    @cached_property
    def matched(self) -> Flags:
        """Where there is a target, (n_configurations, n_bands)."""
        return np.isfinite(self.target)

    @cached_property
    def scale(self) -> Array:
        """D alpha / d x, (n_materials, n_bands)."""
        return np.where(self.pinned, 0.0, self.sigma)

    def pin(self, where: Flags, values: Array) -> Instance:
        """Return the instance with the coefficients at ``where`` held at ``values``."""
        return replace(
            self,
            pinned=self.pinned | where,
            centre=np.where(where, values, self.centre),
        )
