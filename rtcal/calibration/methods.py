"""The calibration methods by name, and `calibrate` (the main path).

`calibrate` takes the terms of a method (`preset`), has them compiled for the room (`Calibration.build`)
and solves the QP for what was measured (`CalibrationProblem.solve`): one QP. Models that are not linear
in alpha take several (`rtcal.calibration.problem`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, overload

from rtcal.acoustics.equations import Equation
from rtcal.acoustics.room import Room
from rtcal.calibration.problem import Calibration, Times
from rtcal.calibration.result import CalibrationResult, JointResult
from rtcal.calibration.terms import (
    BandSmoothness,
    ExactMatch,
    HuberDeviation,
    PriorDeviation,
    SoftMatch,
)
from rtcal.calibration.unknowns import Configurations
from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError

_TIME_UNCERTAINTY = 0.05
"""u_T / T where the measurement states no uncertainty: one just noticeable difference."""
_SMOOTHING = 0.3
"""Weight of the smoothness: small enough to cost under 1 % where the truth is uncorrelated over
bands (notebooks/studies/smoothing.ipynb)."""

_NEARLY_EXACT = 1e-4
"""u_T / T where T is matched exactly but the room is uncertain: a hundredth of what is measured."""


def _soft(prior: Any, uncertain: bool, relative: float = _TIME_UNCERTAINTY) -> Any:
    """A prior and the soft match of T, in an uncertain room with the room's own errors."""
    return prior + SoftMatch(relative, room=uncertain)


METHODS: dict[str, Callable[[PriorDeviation, bool], Calibration]] = {
    "mle": lambda prior, uncertain: (
        Calibration(_soft(prior, uncertain, _NEARLY_EXACT))
        if uncertain
        else Calibration(prior, [ExactMatch()])
    ),
    "lse": lambda prior, uncertain: Calibration(PriorDeviation(sigma=1.0), [ExactMatch()]),
    "soft": lambda prior, uncertain: Calibration(_soft(prior, uncertain)),
    "smooth": lambda prior, uncertain: Calibration(
        _soft(prior, uncertain) + _SMOOTHING * BandSmoothness(prior.material_correlation)
    ),
    "robust": lambda prior, uncertain: Calibration(_soft(HuberDeviation(), uncertain)),
    "joint": lambda prior, uncertain: Calibration(_soft(prior, uncertain)),
}
"""Calibration methods by name.

``mle``: the most likely coefficients that give the measured T (Bellows & Katz 2025, Eq. 19).
``lse``: the coefficients nearest to the input that give T, without sigma (Eq. 7).
``soft``: the most probable coefficients if T is uncertain (by 5 % if no uncertainty is stated).
``smooth``: as soft, with changes of the coefficients that vary slowly over frequency.
``robust``: as soft, but a few coefficients may be far from their input values.
``joint``: as soft, for several configurations of one room.

In a room that states an uncertainty of its volume, areas or climate, every method but ``lse`` matches T
within it (``rtcal.terms.SoftMatch(room=True)``). ``mle`` then also uses a stated uncertainty of T.
"""


def preset(method: str, room: Room | None = None) -> Calibration:
    """Return the calibration of a named method, with the correlations and uncertainties of a room.

    ``method`` is a name that `rtcal.calibrate` knows, such as "mle". ``room`` states correlations of
    its coefficients and uncertainties of its volume, areas and climate; with None the calibration has
    neither. The method ``lse`` uses no correlation, no uncertainty and no sigma. Raises ModelError for
    an unknown name, and for ``robust`` in a room with correlations, because that method treats every
    coefficient separately.
    """
    if not isinstance(method, str) or method not in METHODS:
        raise ModelError(f'method "{method}" is unknown; known are {", ".join(METHODS)}')
    if room is None:
        return _calibration(method)
    correlated = bool(room.band_correlation or room.material_correlation)
    if method == "robust" and (correlated or room.common_alpha_sigma):
        raise ModelError(
            'method "robust" treats every coefficient on its own, but the room has correlations '
            "or a common_alpha_sigma: use another method, or leave them out of the room"
        )
    pairs = tuple(room.material_correlation.items())
    common, uncertain = room.common_alpha_sigma > 0, room.is_uncertain
    return _calibration(method, room.band_correlation, pairs, common, uncertain)


@functools.lru_cache(maxsize=16)
def _calibration(
    method: str,
    band_correlation: float = 0.0,
    pairs: tuple[Any, ...] = (),
    common: bool = False,
    uncertain: bool = False,
) -> Calibration:
    """Return a method's calibration, kept so that its terms are checked once."""
    return METHODS[method](PriorDeviation(None, band_correlation, pairs, common), uncertain)


@overload
def calibrate(
    room: Room,
    measured: Times,
    method: str = "mle",
    equation: Equation | None = None,
    *,
    solver: str = ...,
    unreachable: str = ...,
    warm_start: bool = ...,
    settings: Mapping[str, Any] | None = ...,
) -> CalibrationResult: ...


@overload
def calibrate(
    room: Configurations,
    measured: Sequence[Times],
    method: str = "mle",
    equation: Equation | None = None,
    *,
    solver: str = ...,
    unreachable: str = ...,
    warm_start: bool = ...,
    settings: Mapping[str, Any] | None = ...,
) -> JointResult: ...


def calibrate(
    room: Room | Configurations,
    measured: Any,
    method: str = "mle",
    equation: Equation | None = None,
    *,
    solver: str = "clarabel",
    unreachable: str = "raise",
    warm_start: bool = True,
    settings: Mapping[str, Any] | None = None,
) -> CalibrationResult | JointResult:
    """Calibrate a room's absorption coefficients to its measured reverberation time.

    minimise sum ((alpha - mu) / sigma)²  subject to  S'alpha = b,  alpha_min <= alpha <= 1

    in every band (Bellows & Katz 2025). mu are the input coefficients, sigma their standard deviations,
    and S'alpha is the sum of area times coefficient, which must equal the absorption area b that the
    measured T needs. If the room states an uncertainty of its volume, areas or climate, every method
    but ``lse`` matches T within that uncertainty.

    Parameters
    ----------
    room : Room or Configurations
        Room with the input coefficients. Several configurations of one room share their materials'
        coefficients; ``measured`` then has one entry per configuration.
    measured : Measurement, or T in s, (n_bands,)
        Measured T per band: T20, else T30. Coefficients in a band with NaN do not change.
    method : {"mle", "lse", "soft", "smooth", "robust", "joint"}
        ``mle`` solves the problem above. ``lse`` solves it with the same sigma for all coefficients.
        ``soft`` matches T within its uncertainty, which is 5 % if the measurement states none.
        ``smooth`` is soft, and also keeps changes similar in neighbouring bands. ``robust`` is soft,
        and lets few coefficients move far, because their sigmas may be wrong. ``joint`` is soft, for
        several configurations.
    equation : Equation, optional
        Reverberation equation; `rtcal.Eyring` with the room's air by default.
    solver : {"clarabel", "osqp"}
        Solver of the quadratic programme.
    unreachable : {"raise", "nearest"}
        For a band whose T no coefficients within the bounds give: whether to raise an error, or to
        match the nearest possible T and list the band in the result. Only exact matches need it.
    warm_start : bool
        Whether OSQP starts from the solution without bounds.
    settings : mapping, optional
        Settings of the solver by name; see `CalibrationProblem.solve`.

    Returns
    -------
    CalibrationResult, or JointResult for Configurations
        Calibrated coefficients, with their uncertainty and cautions.

    Raises
    ------
    DataError, ModelError, InfeasibleError, SolverError
        For the reasons that `rtcal.calibration.problem.CalibrationProblem.solve` names.

    Warns
    -----
    MissingAirWarning
        If the room has no air.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = rt.calibrate(room, measured)
    >>> print(result.gap_before.round(1))  # T of the input minus measured T, in JND of 5 %
    [15.6 -2.8 -4.7 -2.8 -2.6 -5.6]
    >>> bool(abs(result.gap_after).max() < 1e-9)
    True
    """
    if not isinstance(room, Configurations):
        checks.instance("room", room, Room)
    if measured is None:
        raise DataError("measured = None must be the measured T: a list of s, or a Measurement")
    calibration = preset(method, room if isinstance(room, Room) else room.union)
    return calibration.build(room, equation).solve(
        measured,
        method=method,
        solver=solver,
        unreachable=unreachable,
        warm_start=warm_start,
        settings=settings,
    )
