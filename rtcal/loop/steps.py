"""The steps of a closed loop, and the T of a simulated measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.bands import label, span
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.parameters import parameter_label
from rtcal.loop.matched import Matched
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only

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


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One simulation.

    Attributes
    ----------
    target : array (n_bands,)
        T in s that the equation was calibrated to, NaN without a measured T.
    alpha : array (n_materials, n_bands)
        Coefficients as simulated.
    simulated : array (n_bands,)
        Simulated T in s of what is matched, NaN if these coefficients give none.
    noise : array (n_bands,)
        Standard error of it in s; 0 if the simulator states none, NaN if it is unknown.
    heard : dict of parameter to array (n_bands,)
        Means of all parameters that are shown, as simulated, matched or not.
    """

    target: Array
    alpha: Array
    simulated: Array
    noise: Array
    heard: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("target", "alpha", "simulated", "noise"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def simulated_time(
    measurement: Measurement, frequencies: Array, matched: Matched, steps: Sequence[Step]
) -> Array:
    """Return the simulated T of what is matched in s, (n_bands,), NaN where some pair has none.

    Parameters
    ----------
    measurement : Measurement
    frequencies : array (n_bands,)
        The room's bands in Hz.
    matched : Matched
    steps : sequence of Step
        Earlier steps.

    Raises
    ------
    DataError
        For other bands, or a matched parameter that is missing. A measured band may lack it only if
        it has one in an earlier step, and some measured band has one now.
    """
    checks.instance("what was simulated", measurement, Measurement)
    if not np.array_equal(measurement.centre_frequencies, frequencies):
        raise DataError(
            f"what was simulated has {span(measurement.centre_frequencies)}; the room has "
            f"{span(frequencies)}"
        )
    for parameter in matched.shares:
        if parameter not in measurement.values:
            raise DataError(f"what was simulated has no {parameter_label(parameter)}")
    measured = np.isfinite(matched.wanted)
    missing = {
        parameter: np.isnan(measurement.values[parameter]) & measured & (share > 0)
        for parameter, share in matched.shares.items()
    }
    lost = np.any([absent.any(axis=0) for absent in missing.values()], axis=0)
    earlier = np.zeros(lost.shape, dtype=bool)
    for step in steps:
        earlier |= np.isfinite(step.simulated)
    refused = lost if lost[measured].all() else lost & ~earlier
    for parameter, absent in missing.items():
        for pair, k in np.argwhere(absent & refused)[:1].tolist():
            raise DataError(
                f"simulated {parameter_label(parameter)}[{' to '.join(measurement.pairs[pair])}, "
                f"{label(frequencies[k])}] is missing, but T was measured there"
            )
    return np.where(lost, np.nan, matched.combined(measurement.mean))
