"""Gauss-Newton around the compiled QP, for what is no linear function of its unknowns.

Each step linearises the model at a point, solves the QP of the linearised one, and goes towards its
answer: the whole way, or half of it and half again as long as the model itself gets farther from what
was measured. The QP certifies its own answer (`certificate`), and the last step's is that of the whole.

Used by the calibration to every position (`rtcal.loop.positions`) and by that of a case with effects
(`rtcal.finder.means.recalibration`).

References
----------
Nocedal & Wright 2006, Numerical Optimization, Sect. 10.3 (Gauss-Newton) and 3.1 (backtracking).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Room
from rtcal.support.types import Array


def gain(prior: Array, matrix: Array, covariance: Array) -> Array:
    """Return K J' (J K J' + C)⁻¹, (n_unknowns, n_values): the change of the estimate by each value.

    Parameters
    ----------
    prior : array (n_unknowns, n_unknowns)
        K, the prior's covariance.
    matrix : array (n_values, n_unknowns)
        J, the derivatives of the values.
    covariance : array (n_values, n_values)
        C, of the values' errors.

    References
    ----------
    Tarantola (2005), Inverse Problem Theory, Sect. 3.2.

    Examples
    --------
    >>> print(gain(np.eye(1), np.ones((1, 1)), np.eye(1)))
    [[0.5]]
    """
    across = prior @ matrix.T
    return np.asarray(across @ np.linalg.solve(matrix @ across + covariance, np.eye(len(matrix))))


def learned_materials(
    room: Room, sigma: Array, of_bands: NDArray[np.bool_] | None = None
) -> tuple[tuple[str, float, float], ...]:
    """Return materials with prior and posterior sigma (rms over some bands), most learned first.

    ``sigma`` (n_materials, n_bands) is the posterior's; all bands count where none are named.
    """
    used = slice(None) if of_bands is None else of_bands
    before, after = (np.sqrt(np.mean(s[:, used] ** 2, axis=1)) for s in (room.sigma, sigma))
    share = np.divide(after, before, out=np.ones_like(after), where=before > 0)
    return tuple(
        (room.materials[i], float(before[i]), float(after[i]))
        for i in np.argsort(share, kind="stable")
    )


Point = TypeVar("Point")


class Linearised(Protocol[Point]):
    """A model that was linearised at a point, and the answer of its QP."""

    def towards(self, share: Array) -> Point:
        """Return the point at these shares, (n_groups,), of the way to the answer."""
        ...

    def worse(self, end: Point) -> NDArray[np.bool_]:
        """Return of each group whether the model is farther from what was measured than before."""
        ...


Model = TypeVar("Model", bound=Linearised[Any])


@dataclass(frozen=True, eq=False)
class Taken(Generic[Model]):
    """A step: the ``model`` that was linearised, and the shares of the way that were gone.

    ``share`` (n_groups,) is 0 where a step was refused, and the groups are what is shortened alone,
    such as bands.
    """

    model: Model
    share: Array


@dataclass(frozen=True, eq=False)
class Steps(Generic[Point, Model]):
    """Where the steps ended, the steps, and whether the last one settled."""

    end: Point
    steps: tuple[Taken[Model], ...]
    settled: bool


def gauss_newton(
    start: Point,
    linearised: Callable[[Point], Model],
    *,
    groups: int = 1,
    most: int,
    halvings: int,
    settled: Callable[[Taken[Model]], bool] = lambda _: False,
    refuse: bool = False,
) -> Steps[Point, Model]:
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
    point, steps = start, list[Taken[Model]]()
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
