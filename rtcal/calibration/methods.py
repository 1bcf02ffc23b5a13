"""The calibration methods by name, `calibrate` (the main path), and Gauss-Newton around the QP.

`calibrate` takes the terms of a method (`preset`), has them compiled for the room (`Calibration.build`)
and solves the QP for what was measured (`CalibrationProblem.solve`): one QP, without any step below.

`gauss_newton` is for models that are not linear in the unknowns: the calibration to every position
(`rtcal.loop.positions`), to modes (`rtcal.modes.calibrate`), and that of a case with effects
(`rtcal.finder.means.recalibration`). Each step linearises the model at a point, solves the QP of the
linearised one, and goes towards its answer: the whole way, or half of it and half again as long as the
model itself gets farther from what was measured. The QP certifies its own answer (`certificate`), and
the last step's is that of the whole.

References
----------
Nocedal & Wright 2006, Numerical Optimization, Sect. 10.3 (Gauss-Newton) and 3.1 (backtracking).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

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
from rtcal.support.types import Array

_TIME_UNCERTAINTY = 0.05
"""u_T / T where the measurement states no uncertainty: one just noticeable difference."""
_SMOOTHING = 0.3
"""Weight of the smoothness: small enough to cost under 1 % where the truth is uncorrelated over
bands (notebooks/studies/smoothing.ipynb)."""

_NEARLY_EXACT = 1e-4
"""u_T / T where T is matched exactly but the room is uncertain: a hundredth of what is measured."""

Match = Callable[[float], SoftMatch]
"""The class `SoftMatch`, or `RoomMatch` in a room whose volume, areas or climate are uncertain."""

METHODS: dict[str, Callable[[PriorDeviation, Match], Calibration]] = {
    "mle": lambda prior, match: (
        Calibration(prior, [ExactMatch()])
        if match is SoftMatch
        else Calibration(prior + match(_NEARLY_EXACT), [])
    ),
    "lse": lambda prior, match: Calibration(PriorDeviation(sigma=1.0), [ExactMatch()]),
    "soft": lambda prior, match: Calibration(prior + match(_TIME_UNCERTAINTY), []),
    "smooth": lambda prior, match: Calibration(
        prior + match(_TIME_UNCERTAINTY) + _SMOOTHING * BandSmoothness(), []
    ),
    "robust": lambda prior, match: Calibration(HuberDeviation() + match(_TIME_UNCERTAINTY), []),
    "joint": lambda prior, match: Calibration(prior + match(_TIME_UNCERTAINTY), []),
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
    return _checked_once(method, prior, match)


@functools.lru_cache(maxsize=16)
def _checked_once(method: str, prior: PriorDeviation, match: Match) -> Calibration:
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
        settings.

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


Point = TypeVar("Point")


class Linearised(Protocol[Point]):
    """A model that was linearised at a point, and the answer of its QP."""

    def towards(self, share: Array) -> Point:
        """Return the point at these shares, (n_groups,), of the way to the answer."""
        ...

    def worse(self, end: Point) -> NDArray[np.bool_]:
        """Return of each group whether the model is farther from what was measured than before."""
        ...


LinearisedModel = TypeVar("LinearisedModel", bound=Linearised[Any])


@dataclass(frozen=True, eq=False)
class Taken(Generic[LinearisedModel]):
    """A step: the ``model`` that was linearised, and the shares of the way that were gone.

    ``share`` (n_groups,) is 0 where a step was refused, and the groups are what is shortened alone,
    such as bands.
    """

    model: LinearisedModel
    share: Array


@dataclass(frozen=True, eq=False)
class Steps(Generic[Point, LinearisedModel]):
    """Where the steps ended, the steps, and whether the last one settled."""

    end: Point
    steps: tuple[Taken[LinearisedModel], ...]
    settled: bool


def gauss_newton(
    start: Point,
    linearised: Callable[[Point], LinearisedModel],
    *,
    groups: int = 1,
    most: int,
    halvings: int,
    settled: Callable[[Taken[LinearisedModel]], bool] = lambda _: False,
    refuse: bool = False,
) -> Steps[Point, LinearisedModel]:
    """Take Gauss-Newton steps until one settles.

    Parameters
    ----------
    start : Point
    linearised : function
        Linearises the model at a point and solves its QP.
    groups : int
        Of unknowns, each with a step length of its own: 1, or the bands.
    most : int
        Largest number of steps.
    halvings : int
        Largest number of halvings of a step.
    settled : function
        Whether a step moved so little that it is the last one.
    refuse : bool
        Whether a step that leads away however short it is, is not taken, and is the last one.

    Returns
    -------
    Steps

    Examples
    --------
    The root of x² = 2, linearised in x; no step leads away:

    >>> import numpy as np
    >>> class Tangent:
    ...     def __init__(self, x):
    ...         self.x, self.step = x, (2 - x**2) / (2 * x)
    ...     def towards(self, share):
    ...         return self.x + share * self.step
    ...     def worse(self, end):
    ...         return np.abs(end**2 - 2) > np.abs(self.x**2 - 2)
    >>> path = gauss_newton(np.array([1.0]), Tangent, most=6, halvings=3)
    >>> print(path.end.round(9), len(path.steps))
    [1.41421356] 6
    """
    point, steps = start, list[Taken[LinearisedModel]]()
    while len(steps) < most:
        model = linearised(point)
        share = np.ones(groups)
        end = model.towards(share)
        for _ in range(halvings):
            worse = model.worse(end)
            if not worse.any():
                break
            share = np.where(worse, share / 2, share)
            end = model.towards(share)
        else:
            if refuse and model.worse(end).any():
                end, share = point, np.zeros(groups)
        steps.append(Taken(model, share))
        point = end
        if settled(steps[-1]) or not share.any():
            return Steps(point, tuple(steps), settled(steps[-1]))
    return Steps(point, tuple(steps), False)
