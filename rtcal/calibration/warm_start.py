"""The warm start of solvers: the paper's closed form, primal and dual, in the whitened unknowns."""

from __future__ import annotations

import numpy as np

from rtcal.calibration.problem_data import ProblemData
from rtcal.support.types import Array

_ROUNDS = 8


def from_closed_form(data: ProblemData) -> tuple[Array, list[Array]]:
    """Return x (size,) and the duals of the exact match and of the two sides of the box.

    Coefficients that the closed form puts outside the box are fixed at their bound, and the closed form
    is solved again for the others (Bellows & Katz 2025, Sect. 3.3). This is only a start: coefficients
    once fixed are not released.
    """
    areas = data.areas[0]
    centre, scale = data.alpha(data.centre), data.alpha(data.scale)
    lower, upper = data.alpha(data.lower), data.alpha(data.upper)
    alpha = centre
    held = scale == 0
    pull = np.zeros(alpha.shape[1])
    for _ in range(_ROUNDS):
        free = np.where(held, 0.0, scale)
        moves = data.matched[0] & ((areas @ free) > 0)
        excess = areas @ np.where(held, alpha, centre) - data.target[0]
        pull = np.divide(excess, areas**2 @ free**2, out=pull, where=moves)  # D of Eqs. 23 to 25
        trial = np.where(held, alpha, centre - pull * areas[:, np.newaxis] * free**2)
        alpha = np.clip(trial, lower, upper)
        if np.array_equal(alpha, trial):
            break
        held = held | (alpha != trial)
    x = np.divide(alpha - centre, scale, out=np.zeros_like(alpha), where=scale > 0)
    force = np.divide(x, scale, out=np.zeros_like(x), where=scale > 0)
    force = np.where(held & (scale > 0), force + pull * areas[:, np.newaxis], 0.0)
    size = np.sqrt(areas**2 @ scale**2)
    return x.ravel(), [pull * size, np.maximum(force, 0).ravel(), np.maximum(-force, 0).ravel()]
