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
    """Base of every error that rtcal raises on purpose.

    ``bands`` are the indices of the bands concerned, if the error concerns only some; see `of_bands`.
    ``loop`` is the `rtcal.loop.Loop` with its steps so far, if the error ended
    `rtcal.calibrate_simulator`.
    """

    bands: tuple[int, ...] = ()
    loop: Any = None


class DataError(RtcalError, ValueError):
    """The input breaks a rule; the message names the place, the value and the rule."""


class TooShortError(DataError):
    """A decay ends before it holds its decay time; simulate or record longer."""


class ModelError(RtcalError):
    """The model, as composed of terms and constraints, cannot be calibrated."""


class InfeasibleError(RtcalError):
    """No absorption coefficients within the bounds give the measured reverberation time."""


class SolverError(RtcalError):
    """The solver did not find an answer that passes the certificate."""


class SimulatorError(RtcalError):
    """A simulator raised, took too long, or returned something that is no measurement."""


class ClusterError(RtcalError):
    """A scheduler does not answer, is lost, or its workers cannot run what they are given."""


class MissingDependencyError(RtcalError, ImportError):
    """An optional library is not installed; the message says which extra brings it."""


E = TypeVar("E", bound=RtcalError)


def of_bands(error: E, bands: Iterable[int]) -> E:
    """Attach the indices of the bands concerned; the closed loop continues without these bands.

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
    """Base of every warning that rtcal gives."""


class OtherBandsWarning(RtcalWarning):
    """A measurement is in other bands than its room: converted, left out, or without T in some."""


class FewPathsWarning(RtcalWarning):
    """The paths from each source are so few that their noise hides what is to be matched."""


class MissingAirWarning(RtcalWarning):
    """A room states no air, so its surfaces are made to absorb what the air does."""
