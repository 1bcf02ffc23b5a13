"""The calibration methods by name, and `calibrate` (the main path).

`calibrate` takes the terms of a method (`preset`), has them compiled for the room (`Calibration.build`)
and solves the QP for what was measured (`CalibrationProblem.solve`): one QP. Models that are not linear
in alpha take several (`rtcal.calibration.fit`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
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
    RoomMatch,
    SoftMatch,
)
from rtcal.calibration.unknowns import Configurations
from rtcal.support.errors import DataError, ModelError

_TIME_UNCERTAINTY = 0.05
"""u_T / T where the measurement states no uncertainty: one just noticeable difference."""
_SMOOTHING = 0.3
"""Weight of the smoothness: small enough to cost under 1 % where the truth is uncorrelated over
bands (notebooks/studies/smoothing.ipynb)."""

_NEARLY_EXACT = 1e-4
"""u_T / T where T is matched exactly but the room is uncertain: a hundredth of what is measured."""

Match = Callable[[float], SoftMatch]
"""The class `SoftMatch`, or `RoomMatch` in a room whose volume, areas or climate are uncertain."""


def _soft(prior: PriorDeviation, match: Match) -> Calibration:
    return Calibration(prior + match(_TIME_UNCERTAINTY), [])


METHODS: dict[str, Callable[[PriorDeviation, Match], Calibration]] = {
    "mle": lambda prior, match: (
        Calibration(prior, [ExactMatch()])
        if match is SoftMatch
        else Calibration(prior + match(_NEARLY_EXACT), [])
    ),
    "lse": lambda prior, match: Calibration(PriorDeviation(sigma=1.0), [ExactMatch()]),
    "soft": _soft,
    "smooth": lambda prior, match: Calibration(
        prior + match(_TIME_UNCERTAINTY) + _SMOOTHING * BandSmoothness(), []
    ),
    "robust": lambda prior, match: Calibration(HuberDeviation() + match(_TIME_UNCERTAINTY), []),
    "joint": _soft,
}
"""The calibration methods by name.

``mle``: the likeliest coefficients that give the measured T (Bellows & Katz 2025, Eq. 19).
``lse``: the nearest coefficients, without sigma (Eq. 7).
``soft``: the most probable coefficients if T is uncertain (by 5 % if no uncertainty is stated).
``smooth``: soft, with a shift that changes slowly over frequency.
``robust``: soft, but a few coefficients may be far from their stated value.
``joint``: soft, for several configurations of one room.

In a room that states an uncertainty of its volume, areas or climate, every method but ``lse`` matches T
within it (`rtcal.terms.RoomMatch`). ``mle`` then counts the uncertainty of T where one is stated.
"""


def preset(method: str, room: Room | None = None) -> Calibration:
    """Return the calibration of a method, with correlations and uncertainties that ``room`` states.

    ``lse`` uses none of them, nor sigma. Raises ModelError for an unknown name, and for
    ``robust`` with correlations, since it treats every coefficient separately.
    """
    if not isinstance(method, str) or method not in METHODS:
        raise ModelError(f'method "{method}" is unknown; known are {", ".join(METHODS)}')
    prior = PriorDeviation()
    match: Match = SoftMatch
    if room is not None:
        common = room.common_alpha_sigma > 0
        if room.band_correlation or room.material_correlation or common:
            if method == "robust":
                raise ModelError(
                    'method "robust" treats every coefficient apart, but the room states correlations '
                    "or a common_alpha_sigma"
                )
            prior = PriorDeviation(
                band_correlation=room.band_correlation,
                material_correlation=room.material_correlation,
                common=common,
            )
        match = RoomMatch if room.is_uncertain else SoftMatch
    return _cached_calibration(method, prior, match)


@functools.lru_cache(maxsize=16)
def _cached_calibration(method: str, prior: PriorDeviation, match: Match) -> Calibration:
    """Return a method's calibration, kept so that its terms are checked once."""
    return METHODS[method](prior, match)


@overload
def calibrate(
    room: Room,
    measured: Times,
    method: str = "mle",
    equation: Equation | None = None,
    **options: Any,
) -> CalibrationResult: ...


@overload
def calibrate(
    room: Configurations,
    measured: Sequence[Times],
    method: str = "mle",
    equation: Equation | None = None,
    **options: Any,
) -> JointResult: ...


def calibrate(
    room: Room | Configurations,
    measured: Any,
    method: str = "mle",
    equation: Equation | None = None,
    **options: Any,
) -> CalibrationResult | JointResult:
    """Calibrate a room's absorption coefficients to its measured reverberation time.

    minimise sum ((alpha - mu) / sigma)²  subject to  S'alpha = b,  alpha_min <= alpha <= 1,
    in every band, with b the absorption area that gives the measured T (Bellows & Katz 2025).

    Parameters
    ----------
    room : Room or Configurations
        Its alpha and sigma are the prior. Several configurations of one room share their
        materials' coefficients; then ``measured`` has one entry per configuration.
    measured : Measurement, or T in s, (n_bands,)
        Per band T20, else T30. A band with NaN keeps its prior.
    method : {"mle", "lse", "soft", "smooth", "robust", "joint"}
        ``mle``: by the stated sigmas. ``lse``: all sigmas alike. ``soft``: T within its uncertainty.
        ``smooth``: soft, with neighbouring bands alike. ``robust``: soft, and a single sigma may be
        wrong. ``joint``: soft, of several configurations.
    equation : Equation, optional
        `rtcal.Eyring` with the room's air if not given.
    **options
        ``solver``: ``"clarabel"`` (the default), ``"osqp"``, or another solver of cvxpy's.
        ``unreachable``: ``"raise"`` (the default), or ``"nearest"`` to take the nearest T within
        reach and list the band in the result. ``warm_start``: whether OSQP starts from the closed
        form; see `rtcal.calibration.qp.SolveOptions`. ``settings``: a mapping of the solver's own
        settings. (No method has `rtcal.terms.LinearObservations`, so ``observed`` is refused.)

    Returns
    -------
    CalibrationResult, or JointResult for Configurations

    Raises
    ------
    DataError, ModelError, InfeasibleError, SolverError
        As `rtcal.calibration.problem.CalibrationProblem.solve`.

    Warns
    -----
    MissingAirWarning
        If the room states no air.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> result = rt.calibrate(room, measured)
    >>> print(result.gap_before.round(1))
    [15.6 -2.8 -4.7 -2.8 -2.6 -5.6]
    >>> bool(abs(result.gap_after).max() < 1e-9)
    True
    """
    if not isinstance(room, (Room, Configurations)):
        raise DataError(f"room = {room!r} is not a rtcal.Room (Room.from_file reads one)")
    if measured is None:
        raise DataError("measured = None: there is no T to calibrate to")
    calibration = preset(method, room if isinstance(room, Room) else room.union)
    return calibration.build(room, equation).solve(measured, method=method, **options)
