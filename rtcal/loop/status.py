"""The status of each band of a closed loop: its goal, its convergence, its confirmation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtcal.support.types import Array

STATUSES = ("converged", "no measured T", "unreachable", "not converging", "not confirmed")
"""Status of a band. Only a `LoopResult` has the last one: the loop itself has no confirmation."""

CLOSE_TARGETS = np.log(1.1)
"""If log targets with and without a simulated T20 are closer, another simulation gains little: T is
then known within 10 %, two JND."""

STUCK_STEPS = 3
"""Steps with different coefficients and the same T20 after which T does not depend on alpha."""

_AT_LIMIT = 1e-9  # relative; rounding of a target that was set to the limit


def band_goals(tolerance: float, noise: Array) -> Array:
    """Return the gap in JND at which a band is done, (n_bands,): the tolerance less the noise.

    The goal is at least half the tolerance, since no gap below a large noise can be shown. Unknown
    noise (NaN) counts as large. ``noise`` is the simulator's standard error in JND.
    """
    return np.fmax(tolerance - noise, tolerance / 2)


def band_statuses(
    gap: Array,
    goals: Array,
    target: Array,
    limits: tuple[Array, Array],
    blocked: NDArray[np.bool_],
    measured: NDArray[np.bool_],
) -> tuple[str, ...]:
    """Return the status of each band before a confirmation.

    Parameters
    ----------
    gap, goals : array (n_bands,)
        Gap of the best step and its goal in JND. NaN if no step has a T20.
    target : array (n_bands,)
        Target of the last step in s.
    limits : pair of arrays (n_bands,)
        Shortest and longest T in s that the equation can give.
    blocked : bool array (n_bands,)
        Whether more simulations cannot help for another reason.
    measured : bool array (n_bands,)
        Whether T was measured.
    """
    shortest, longest = limits
    at_limit = ((gap < 0) & (target >= longest * (1 - _AT_LIMIT))) | (
        (gap > 0) & (target <= shortest * (1 + _AT_LIMIT))
    )
    status = np.select(
        [~measured, np.abs(gap) <= goals, blocked | at_limit],
        ["no measured T", "converged", "unreachable"],
        "not converging",
    )
    return tuple(status.tolist())


def confirmed_statuses(
    status: tuple[str, ...], gap: Array, noise: Array, tolerance: float
) -> tuple[str, ...]:
    """Return the statuses after a simulation with fresh random numbers.

    A converged band is confirmed if the noise is within the tolerance, and the gap within tolerance
    plus noise. A larger noise would confirm any gap. Gap and noise, (n_bands,), are in JND.
    """
    kept = (noise <= tolerance) & (np.abs(gap) <= tolerance + noise)
    return tuple(
        "not confirmed" if before == "converged" and not within else before
        for before, within in zip(status, kept, strict=True)
    )


def stuck_bands(alpha: Array, simulated: Array) -> NDArray[np.bool_]:
    """Return whether T20 stayed the same in the last `STUCK_STEPS` steps although alpha changed.

    ``alpha`` (n_steps, n_materials, n_bands), ``simulated`` T20 (n_steps, n_bands); the result is
    (n_bands,).
    """
    if len(simulated) < STUCK_STEPS:
        return np.zeros(simulated.shape[1], dtype=bool)
    changed = (np.diff(alpha[-STUCK_STEPS:], axis=0) != 0).any(axis=1).all(axis=0)
    same = (np.diff(simulated[-STUCK_STEPS:], axis=0) == 0).all(axis=0)
    return np.asarray(changed & same)
