"""The difference of a patch on a part of a surface from one that is spread over all of it.

A hypothesis spreads an absorber over its surface. In truth it hangs somewhere: receivers near it lose
more than others, and T changes by more or less. Neither is known before the place is, so it is an error
of the hypothesis, in proportion to its change of the absorption. The shares come from patches on walls
of development boxes, which are weighed on the same paths (`python -m benchmarks.where_patches`). They
are over sqrt(1 / s - 1), s being the part of the surface that is covered.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.acoustics.observables import observable
from rtcal.support.types import Array

SMALLEST = 1 / 9
"""Least part of a surface for which the shares were found; smaller ones have its error."""
COMMON = {"late": 0.05, "early": 0.06, "level": 0.14}
"""Relative deviation that all pairs share, by `Observable.part`. That of T and of the early parameters
is the same one."""
OWN = {"late": 0.06, "early": 0.06, "level": 0.24}
"""Relative deviation of each pair: one for T, one for all early parameters, one for the level."""


def sign(parameter: str) -> float:
    """Return whether a parameter's linear scale rises or falls with the absorption."""
    return 1.0 if observable(parameter).rises else -1.0


def factor(covered: Array) -> Array:
    """Return the size of the deviation where these parts of a surface are covered."""
    return np.asarray(np.sqrt(1 / np.clip(covered, SMALLEST, 1.0) - 1))


def amount(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the weights of a mean change of the absorption, (n_parameters n_pairs,)."""
    signs = np.array([sign(name) for name in parameters])
    return np.repeat(signs, n_pairs) / (len(parameters) * n_pairs)


def columns(parameters: Sequence[str], n_pairs: int) -> Array:
    """Return the deviations at a change of 1, (n_parameters n_pairs, n_columns)."""
    signs = np.array([sign(name) for name in parameters])
    groups = [observable(name).part for name in parameters]
    out = []
    for shared in (("late", "early"), ("level",)):
        row = [COMMON[g] if g in shared else 0.0 for g in groups]
        out.append(np.repeat(signs * row, n_pairs))
    for group in OWN:
        own = np.array([OWN[g] if g == group else 0.0 for g in groups])
        for pair in np.eye(n_pairs):
            out.append(np.outer(signs * own, pair).ravel())
    every = np.array(out).T
    return np.asarray(every[:, np.abs(every).max(axis=0) > 0])
