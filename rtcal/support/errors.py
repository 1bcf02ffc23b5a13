"""Typed errors, classified by what the user can do about them.

``DataError``: mend the input.  ``ModelError``: mend the model.  ``InfeasibleError``: no absorption
coefficients within the bounds give what was asked.  ``SolverError``: the solver failed on a sound
problem; another solver or other settings may help.  ``SimulatorError``: a simulator failed; its
cause says why.  ``ClusterError``: the scheduler or its workers.  ``MissingDependencyError``: install an
extra.

Constructors, readers and commands raise these. A function that is given another type, too few or too
many arguments, or an argument of an unknown name raises Python's own error (TypeError, AttributeError,
or NumPy's ValueError for shapes that do not fit); it raises DataError for a value out of its range.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

__all__ = [
    "ClusterError",
    "DataError",
    "FewPathsWarning",
    "InfeasibleError",
    "MissingAirWarning",
    "MissingDependencyError",
    "ModelError",
    "OtherBandsWarning",
    "RtcalError",
    "RtcalWarning",
    "SimulatorError",
    "SolverError",
    "TooShortError",
]
__dir__ = __all__.copy


class RtcalError(Exception):
    """Catch every error that rtcal raises on purpose: the base class of these errors.

    Attributes
    ----------
    bands : tuple of int
        Numbers, from 0, of the bands that the error concerns; () if it is not about single bands.
    loop : Loop, optional
        `rtcal.loop.Loop` with all steps so far, if the error ended `rtcal.calibrate_simulator`; else
        None.
    """

    bands: tuple[int, ...] = ()
    loop: Any = None


class DataError(RtcalError, ValueError):
    """Report an input that breaks a rule; the message names the place, the value and the rule."""


class TooShortError(DataError):
    """Report a decay that ends before its decay time can be evaluated; simulate or record longer."""


class ModelError(RtcalError):
    """Report a model that cannot be calculated or calibrated: its terms, constraints or equation."""


class InfeasibleError(RtcalError):
    """Report that no coefficients within the bounds give the measured T, or no design the target."""


class SolverError(RtcalError):
    """Report that the solver found no solution, or one that is not optimal to numerical precision."""


class SimulatorError(RtcalError):
    """Report a simulator that failed, took too long, or returned something other than a measurement."""


class ClusterError(RtcalError):
    """Report a scheduler that does not answer or is lost, or whose workers cannot run their tasks."""


class MissingDependencyError(RtcalError, ImportError):
    """Report an optional library that is not installed; the message has the extra that installs it."""


E = TypeVar("E", bound=RtcalError)


def of_bands(error: E, bands: Iterable[int]) -> E:
    """Return the error with the numbers, from 0, of the bands that it concerns.

    Examples
    --------
    >>> of_bands(ModelError("no T"), [2]).bands
    (2,)
    """
    if not isinstance(error, RtcalError):
        raise DataError(f"error = {error!r} must be an error of rtcal.errors")
    try:
        error.bands = tuple(int(k) for k in bands)
    except (TypeError, ValueError, OverflowError) as cause:
        raise DataError(f"bands = {bands!r} must be a list of whole numbers") from cause
    return error


class RtcalWarning(UserWarning):
    """Catch every warning that rtcal gives: the base class of these warnings."""


class OtherBandsWarning(RtcalWarning):
    """Warn that a measurement has other bands than its room, which are converted or left out."""


class FewPathsWarning(RtcalWarning):
    """Warn that a path tracing has too few paths: its random noise hides the values to be matched."""


class MissingAirWarning(RtcalWarning):
    """Warn that a room states no air, so that the calibration adds the air's absorption to surfaces."""
