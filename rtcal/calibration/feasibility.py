"""Feasibility: the bounds allow the measured T, which is checked analytically before solving.

Constraints that contradict each other are explained by the smallest relaxation that is feasible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from rtcal.acoustics import bands
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.trust import surface_doubt
from rtcal.calibration.numpy_model import NumpyModel
from rtcal.calibration.problem_data import Flags, ProblemData
from rtcal.support.errors import InfeasibleError, ModelError
from rtcal.support.types import Array

_MARGIN = 1e-9
"""Relative tolerance within which the bounds count as reaching the equation's largest b. It equals the
primal residual that an answer may have."""


@dataclass(frozen=True)
class Unreachable:
    """A band whose measured T is beyond what coefficients within the bounds give.

    ``target`` is the absorption area b in m² that T requires, NaN if no b has this T. The bounds allow
    b from ``lowest`` to ``highest`` in m² and T from ``shortest`` to ``longest`` in s.
    """

    configuration: int
    frequency: float
    reverberation_time: float
    target: float
    lowest: float
    highest: float
    shortest: float
    longest: float

    def __str__(self) -> str:
        asked = "more absorption than any" if np.isnan(self.target) else f"{self.target:.4g} m²"
        off = ""
        if self.target < self.lowest:
            off = f", {self.lowest - self.target:.4g} m² too little"
        elif self.target > self.highest:
            off = f", {self.target - self.highest:.4g} m² too much"
        return (
            f"T[{bands.label(self.frequency)}] = {self.reverberation_time:.4g} s is beyond reach: "
            f"it asks the surfaces for {asked}, the bounds allow {self.lowest:.4g} to "
            f"{self.highest:.4g} m²{off}; T from {self.shortest:.4g} to {self.longest:.4g} s would do"
        )


def where_valid(
    quantity: Callable[[Room, Array], Array], room: Room, absorption_area: Array
) -> Array:
    """Return a quantity of an equation per band, NaN in bands that the equation does not cover.

    Parameters
    ----------
    quantity : function
        `LinearEquation.time` or `LinearEquation.air_share`.
    room : Room
    absorption_area : array (n_bands,)
        S'alpha in m².
    """
    try:
        return quantity(room, absorption_area)
    except ModelError as error:
        outside = np.isin(np.arange(room.n_bands), error.bands)
        if not outside.any():
            raise
        inside = quantity(room, np.where(outside, 0.0, absorption_area))
        return np.where(outside, np.nan, inside)


def reach(data: ProblemData) -> tuple[Array, Array]:
    """Return the least and the most S'alpha in m² within the box, each (n_configurations, n_bands).

    Fixed unknowns count with their value. The sizes of effects add the range of their bounds.
    """
    lower, upper = data.reachable_box
    least = data.areas @ data.alpha(lower)
    most = data.areas @ data.alpha(upper)
    if data.gains.size:
        with np.errstate(invalid="ignore"):  # 0 times an unlimited size
            ends = data.gains[..., np.newaxis] * np.stack(
                [data.further(lower), data.further(upper)], axis=-1
            )
        ends = np.nan_to_num(ends, nan=0.0, posinf=np.inf, neginf=-np.inf)
        least, most = least + ends.min(axis=-1).sum(axis=-1), most + ends.max(axis=-1).sum(axis=-1)
    return least, most


def end_tolerance(data: ProblemData) -> Array:
    """Return the distance in m² up to which b counts as an end, (n_configurations, n_bands).

    b of a T at an end is an end only up to rounding. A sum of n products has an error of at most
    n eps / 2 times the sum of their absolute values (Higham 2002, Sect. 3.1). From alpha to T and back,
    b has at most 1.5 eps sum S. So 16 n is eight times their sum or more.
    """
    upper = data.alpha(data.reachable_box[1])
    n = data.areas.shape[1]
    return np.asarray(16 * n * np.finfo(float).eps * (data.areas @ np.abs(upper)))


def restrict_to_reach(
    data: ProblemData,
    rooms: Sequence[Room],
    wanted: tuple[Array, Array],
    equation: LinearEquation,
    unreachable: str,
) -> tuple[ProblemData, Flags, Flags, tuple[Unreachable, ...]]:
    """Check every exactly matched target and pin the bands that stand at an end.

    Parameters
    ----------
    data : ProblemData
    rooms : sequence of Room
        One per configuration.
    wanted : two arrays (n_configurations, n_bands)
        The least and the most S'alpha in m² that the match allows.
    equation : LinearEquation
    unreachable : {"raise", "nearest"}

    Returns
    -------
    data : ProblemData
        Unreachable targets moved to the nearest end, and coefficients at an end pinned there.
    at_lower, at_upper : array (size,) of bool
        Unknowns that an end forces to a bound.
    unreachable : tuple of Unreachable

    Raises
    ------
    InfeasibleError
        With ``unreachable="raise"``, naming every band that cannot be reached.
    """
    times = data.time
    asked = np.isfinite(times)
    low, high = reach(data)
    tolerance = end_tolerance(data)
    top = np.minimum(high, data.largest_target)
    _refuse_invalid(equation, rooms, asked & (low > (1 + _MARGIN) * data.largest_target), low)
    wanted_low, wanted_high = wanted
    # Where the match has a tolerance, the target becomes the reachable value nearest to it.
    highest = np.where(np.isnan(wanted_high), np.inf, wanted_high)
    target = np.minimum(
        np.maximum(0.5 * (low + top), wanted_low), highest
    )  # NaN where the least is
    too_low = asked & (target < low - tolerance)
    too_high = asked & (np.isnan(target) | (target > top + tolerance))
    beyond = []
    for c, k in zip(*np.nonzero(too_low | too_high), strict=True):
        longest, shortest = (
            where_valid(equation.time, rooms[c], area)[k] for area in (low[c], top[c])
        )
        beyond.append(
            Unreachable(
                int(c),
                float(rooms[c].centre_frequencies[k]),
                float(times[c, k]),
                float(target[c, k]),
                float(low[c, k]),
                float(top[c, k]),
                float(shortest),
                float(longest),
            )
        )
    if beyond and unreachable == "raise":
        doubts = [doubt[1] for room in rooms if (doubt := surface_doubt(room)) is not None]
        raise InfeasibleError("; ".join([*map(str, beyond), *doubts]))
    at_low = asked & (too_low | (np.abs(target - low) <= tolerance))
    at_high = asked & (too_high | (np.abs(target - top) <= tolerance)) & ~at_low
    reached = np.where(at_low, low, np.where(at_high, top, target))
    moved = too_low | too_high | at_low | at_high
    if not moved.any():
        nothing = np.zeros(data.layout.size, dtype=bool)
        return data, nothing, nothing, ()
    at_high &= top >= high - tolerance  # a limit of the equation is no end of the box
    at_lower, at_upper = _forced(data, at_low, at_high)
    pinned = data.pin(at_lower | at_upper, np.where(at_lower, data.lower, data.upper))
    target = np.where(moved | np.isnan(data.target), reached, data.target)
    return replace(pinned, target=target), at_lower, at_upper, tuple(beyond)


def _refuse_invalid(
    equation: LinearEquation, rooms: Sequence[Room], where: Flags, least: Array
) -> None:
    """Raise InfeasibleError where every coefficient within the bounds is beyond the equation."""
    if where.any():
        c, k = (int(v) for v in np.argwhere(where)[0])
        raise InfeasibleError(
            f"{bands.label(rooms[c].centre_frequencies[k])}: the bounds allow mean coefficients "
            f"from {least[c, k] / rooms[c].total_area:.3f}, but {equation.name}'s equation holds up "
            f"to {equation.largest_mean:.3f}"
        )


def _forced(data: ProblemData, at_low: Flags, at_high: Flags) -> tuple[Flags, Flags]:
    """Unknowns that a target at the end of its range forces to their lower and upper bound."""
    moves = data.scale > 0
    has_area = data.areas[:, :, np.newaxis] > 0
    sides = []
    for end, other in ((at_low, at_high), (at_high, at_low)):
        alpha = np.any(end[:, np.newaxis, :] & has_area, axis=0).ravel()
        further = np.any(
            (end[..., np.newaxis] & (data.gains > 0)) | (other[..., np.newaxis] & (data.gains < 0)),
            axis=(0, 1),
        )
        sides.append(moves & np.concatenate([alpha, further]))
    at_lower, at_upper = sides
    return at_lower, at_upper & ~at_lower & np.isfinite(data.upper)


_NOTHING = 1e-9


def explain(model: NumpyModel) -> None:
    """Raise InfeasibleError, with the smallest relaxation, if the constraints contradict each other.

    An elastic linear programme (Chinneck 2008, ch. 6): minimise the sum of all relaxations, subject to
    every row and every bound of a term, relaxed. Relaxations are in absorption coefficients; a row's is
    divided by the sum of its coefficients of one sign. 0 <= alpha <= 1 and fixed unknowns are not
    relaxed.
    """
    from scipy.optimize import linprog

    data, layout = model.data, model.data.layout
    matrix = sp.csr_array(model.matrix)
    n_rows, size = matrix.shape
    sides = [np.asarray(part.maximum(0).sum(axis=1)).ravel() for part in (matrix, -matrix)]
    norm = np.maximum(*sides)
    norm[norm == 0] = 1.0
    scaled = sp.diags_array(1 / norm) @ matrix
    # Unknowns, then relaxations of rows up and down, then of the box down and up.
    low, high = model.row_lower / norm, model.row_upper / norm
    identity, none = sp.eye_array(n_rows), sp.csr_array((n_rows, size))
    square, empty = sp.eye_array(size), sp.csr_array((size, n_rows))
    above = sp.hstack([scaled, identity * 0, -identity, none, none])
    below = sp.hstack([-scaled, -identity, identity * 0, none, none])
    floor = sp.hstack([-square, empty, empty, -square, square * 0])
    ceiling = sp.hstack([square, empty, empty, square * 0, -square])
    limits = np.concatenate([high, -low, -model.lower, model.upper])
    system = sp.csr_array(sp.vstack([above, below, floor, ceiling]))
    used = np.isfinite(limits)
    held = ~model.movable
    hard_upper = np.where(np.arange(size) < layout.n_alpha, 1.0, np.inf)
    bounds = np.concatenate(
        [
            np.column_stack(
                [np.where(held, data.centre, 0.0), np.where(held, data.centre, hard_upper)]
            ),
            np.column_stack(
                [np.zeros(2 * n_rows + 2 * size), np.full(2 * n_rows + 2 * size, np.inf)]
            ),
        ]
    )
    cost = np.concatenate([np.zeros(size), np.ones(2 * n_rows + 2 * size)])
    program = linprog(cost, A_ub=system[used], b_ub=limits[used], bounds=bounds, method="highs")
    if program.status != 0 or program.fun <= _NOTHING:
        return
    relaxed = program.x[size:]
    raise InfeasibleError(
        "the constraints contradict each other. The smallest relaxation that removes it: "
        + "; ".join(_named(model, relaxed, norm))
    )


def _named(model: NumpyModel, relaxed: Array, norm: Array) -> list[str]:
    layout = model.data.layout
    n_rows, size = len(norm), layout.size
    labels = [
        term.label(row, layout)
        for term in model.row_constraints
        for row in range(len(term.row_scale(model.data)))
    ]
    out = []
    for side, (start, word) in enumerate(((0, "lower"), (n_rows, "higher"))):
        for row in np.flatnonzero(relaxed[start : start + n_rows] > _NOTHING):
            limit = (model.row_lower, model.row_upper)[side][row]
            by = relaxed[start + row] * norm[row]
            out.append(f"{labels[row]}: {limit:.4g} has to be {by:.4g} {word}")
    for start, limits, word in (
        (2 * n_rows, model.lower, "lower bound {:.4g} has to be {:.4g} lower"),
        (2 * n_rows + size, model.upper, "upper bound {:.4g} has to be {:.4g} higher"),
    ):
        for u in np.flatnonzero(relaxed[start : start + size] > _NOTHING):
            out.append(f"{layout.place(int(u))}: " + word.format(limits[u], relaxed[start + u]))
    return out
