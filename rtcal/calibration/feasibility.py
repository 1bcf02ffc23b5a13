"""Feasibility: the bounds allow the measured T, which is checked analytically before solving.

Constraints that contradict each other are explained by the smallest relaxation that is feasible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.marks import surface_doubt
from rtcal.acoustics.room import Room
from rtcal.calibration.composition import Composition
from rtcal.calibration.qp import COMPILING, QP, CompiledProblem
from rtcal.calibration.unknowns import Flags, Numbers
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


def reach(numbers: Numbers) -> tuple[Array, Array]:
    """Return the least and the most S'alpha in m² within the box, each (n_configurations, n_bands).

    Fixed unknowns count with their value. The sizes of effects add the range of their bounds.
    """
    lower, upper = numbers.box
    least = numbers.areas @ numbers.alpha(lower)
    most = numbers.areas @ numbers.alpha(upper)
    if numbers.gains.size:
        with np.errstate(invalid="ignore"):  # 0 times an unlimited size
            ends = numbers.gains[..., np.newaxis] * np.stack(
                [numbers.further(lower), numbers.further(upper)], axis=-1
            )
        ends = np.nan_to_num(ends, nan=0.0, posinf=np.inf, neginf=-np.inf)
        least, most = least + ends.min(axis=-1).sum(axis=-1), most + ends.max(axis=-1).sum(axis=-1)
    return least, most


def end_tolerance(numbers: Numbers) -> Array:
    """Return the distance in m² up to which b counts as an end, (n_configurations, n_bands).

    b of a T at an end is an end only up to rounding. A sum of n products has an error of at most
    n eps / 2 times the sum of their absolute values (Higham 2002, Sect. 3.1). From alpha to T and back,
    b has at most 1.5 eps sum S. So 16 n is eight times their sum or more.
    """
    upper = numbers.alpha(numbers.box[1])
    n = numbers.areas.shape[1]
    return np.asarray(16 * n * np.finfo(float).eps * (numbers.areas @ np.abs(upper)))


@dataclass(frozen=True, eq=False)
class Reach:
    """The matched targets within reach of the bounds.

    ``target`` is b in m², (n_configurations, n_bands), an unreachable one moved to the nearest end.
    ``at`` (size,) is -1 or 1 for unknowns that a target at an end forces to their lower or upper bound,
    else 0. ``beyond`` are the unreachable bands.
    """

    target: Array
    at: NDArray[np.int8]
    beyond: tuple[Unreachable, ...] = ()


def restrict_to_reach(
    numbers: Numbers, matches: Sequence[tuple[Array, Array]], unreachable: str
) -> Reach:
    """Check every exactly matched target, and hold the bands that stand at an end there.

    Parameters
    ----------
    numbers : Numbers
    matches : sequence of two arrays (n_configurations, n_bands)
        The least and the most S'alpha in m² that each match allows.
    unreachable : {"raise", "nearest"}

    Raises
    ------
    InfeasibleError
        With ``unreachable="raise"``, naming every band that cannot be reached; in a problem without a
        match, for a T that is too short for any absorption.
    """
    times, rooms, equation = numbers.time, numbers.rooms, numbers.equation
    free = np.zeros(numbers.layout.size, dtype=np.int8)
    if not matches:
        lost = np.isfinite(times) & ~np.isfinite(numbers.target)
        if lost.any():
            row = int(np.flatnonzero(lost.ravel())[0])
            raise InfeasibleError(
                f"T[{numbers.layout.band_label(row)}] = {times.ravel()[row]:.4g} s is "
                "too short for any absorption"
            )
        return Reach(numbers.target, free)
    asked = np.isfinite(times)
    low, high = reach(numbers)
    tolerance, largest = end_tolerance(numbers), numbers.largest_target
    top = np.minimum(high, largest)
    _refuse_invalid(numbers, asked & (low > (1 + _MARGIN) * largest), low)
    wanted_low = np.max([least for least, _ in matches], axis=0)
    wanted_high = np.min([most for _, most in matches], axis=0)
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
        doubts = [doubt.text for room in rooms if (doubt := surface_doubt(room)) is not None]
        raise InfeasibleError("; ".join([*map(str, beyond), *doubts]))
    at_low = asked & (too_low | (np.abs(target - low) <= tolerance))
    at_high = asked & (too_high | (np.abs(target - top) <= tolerance)) & ~at_low
    reached = np.where(at_low, low, np.where(at_high, top, target))
    moved = too_low | too_high | at_low | at_high
    if not moved.any():
        return Reach(numbers.target, free)
    at_high &= top >= high - tolerance  # a limit of the equation is no end of the box
    target = np.where(moved | np.isnan(numbers.target), reached, numbers.target)
    return Reach(target, _forced(numbers, at_low, at_high), tuple(beyond))


def _refuse_invalid(numbers: Numbers, where: Flags, least: Array) -> None:
    """Raise InfeasibleError where every coefficient within the bounds is beyond the equation."""
    if where.any():
        c, k = (int(v) for v in np.argwhere(where)[0])
        room, equation = numbers.rooms[c], numbers.equation
        raise InfeasibleError(
            f"{bands.label(room.centre_frequencies[k])}: the bounds allow mean coefficients "
            f"from {least[c, k] / room.total_area:.3f}, but {equation.name}'s equation holds up "
            f"to {equation.largest_mean:.3f}"
        )


def _forced(numbers: Numbers, at_low: Flags, at_high: Flags) -> NDArray[np.int8]:
    """Return -1 or 1 for the unknowns that a target at the end of its range forces to a bound."""
    has_area = numbers.areas[:, :, np.newaxis] > 0
    sides = []
    for end, other in ((at_low, at_high), (at_high, at_low)):
        alpha = np.any(end[:, np.newaxis, :] & has_area, axis=0).ravel()
        further = np.any(
            (end[..., np.newaxis] & (numbers.gains > 0))
            | (other[..., np.newaxis] & (numbers.gains < 0)),
            axis=(0, 1),
        )
        sides.append(numbers.movable & np.concatenate([alpha, further]))
    at_lower, at_upper = sides
    at_upper &= ~at_lower & np.isfinite(numbers.upper)
    return np.asarray(at_upper.astype(np.int8) - at_lower.astype(np.int8))


@dataclass(frozen=True)
class _Limit:
    """The limit of a row that a term states; ``flipped`` if it falls as the row's b rises."""

    row: int
    label: str
    value: float
    flipped: bool


def _limits(compiled: CompiledProblem, numbers: Numbers) -> list[_Limit]:
    """Return the limits of all rows that terms state."""
    limits: list[_Limit] = []
    with COMPILING:  # the problem has one value of each parameter
        for parameter, compute in compiled.model.parameters:
            parameter.save_value(np.reshape(compute(numbers), parameter.shape))
        for (term, stated), rows_of in zip(compiled.stated, compiled.rows_of, strict=True):
            label = getattr(term, "label", lambda row, _, term=term: f"{term!r}, row {row + 1}")
            for constraint, rows in zip(stated, rows_of, strict=True):
                left, right = constraint.args
                flipped = not right.is_constant()
                values = left.value if flipped and left.is_constant() else right.value
                values = np.broadcast_to(0.0 if values is None else values, constraint.shape)
                limits += [
                    _Limit(int(row), label(i, compiled.layout), float(value), flipped)
                    for i, (row, value) in enumerate(zip(rows, np.ravel(values), strict=True))
                    if row >= 0
                ]
    return limits


_NOTHING = 1e-9


def explain(composition: Composition, numbers: Numbers, program: QP) -> None:
    """Raise InfeasibleError, with the smallest relaxation, if the constraints contradict each other.

    An elastic linear programme (Chinneck 2008, ch. 6): minimise the sum of all relaxations, subject to
    every row of a constraint and every bound, relaxed. Relaxations are in absorption coefficients; a
    row's is divided by the sum of its coefficients of one sign. 0 <= alpha <= 1 and fixed unknowns are
    not relaxed.
    """
    from scipy.optimize import linprog

    compiled, place, moves = composition.compiled, composition.compiled.unknowns, numbers.movable
    # In the unknowns' own units, alpha = mu + sigma x. What cannot move goes to the limits.
    held = np.where(moves, 0.0, numbers.box[0])
    unit, offset = np.ones(len(program.c)), np.zeros(len(program.c))
    unit[place] = np.where(moves, numbers.inverse_sigma, 0.0)
    offset[place] = (held - numbers.mu) * numbers.inverse_sigma
    matrix = sp.csr_array(program.matrices[1] @ sp.diags_array(unit))
    own = matrix[:, place]
    sides = [np.asarray((sign * own).maximum(0).sum(axis=1)).ravel() for sign in (1, -1)]
    size = np.maximum(*sides)
    size[size == 0] = 1.0
    limits = _limits(compiled, numbers)
    rows, soft = np.array([limit.row for limit in limits], dtype=int), place[moves]
    n_rows, n = matrix.shape
    give = sp.csr_array((size[rows], (rows, np.arange(len(rows)))), shape=(n_rows, len(rows)))
    pick = sp.csr_array((np.ones(len(soft)), (np.arange(len(soft)), soft)), (len(soft), n))
    bounds = np.array([program.lower, program.upper])
    bounds[:, place] = numbers.box
    one = sp.eye_array(len(soft))
    # The variables of the QP; relaxations of rows, up and down; of bounds, down and up.
    lines = sp.csr_array(
        sp.block_array(
            [
                [matrix, -give, give, None, None],
                [-pick, None, None, -one, None],
                [pick, None, None, None, -one],
            ]
        )
    )
    right = np.concatenate([program.b - program.rows(offset), -bounds[0][soft], bounds[1][soft]])
    equal = np.concatenate([program.equal, np.zeros(2 * len(soft), dtype=bool)])
    used = np.isfinite(right) & ~equal
    n_alpha = composition.layout.n_alpha
    bounds[0, place] = held
    bounds[1, place] = np.where(moves, 1.0, held)
    bounds[1, place[n_alpha:]] = np.inf
    extra = np.zeros(2 * (len(rows) + len(soft)))
    answer = linprog(
        np.concatenate([np.zeros(n), extra + 1]),
        A_ub=lines[used],
        b_ub=right[used],
        A_eq=lines[equal],
        b_eq=right[equal],
        bounds=np.concatenate([bounds.T, np.column_stack([extra, extra + np.inf])]),
        method="highs",
    )
    if answer.status != 0 or answer.fun <= _NOTHING:
        return
    up, down, low, high = np.split(answer.x[n:], np.cumsum([len(rows), len(rows), len(soft)]))
    out = []
    for given, rises in ((down, False), (up, True)):
        for i in np.flatnonzero(given > _NOTHING):
            limit, word = limits[i], "higher" if rises != limits[i].flipped else "lower"
            by = given[i] * size[rows[i]]
            out.append(f"{limit.label}: {limit.value:.4g} has to be {by:.4g} {word}")
    for given, limit_of, words in (
        (low, numbers.lower, "lower bound {:.4g} has to be {:.4g} lower"),
        (high, numbers.upper, "upper bound {:.4g} has to be {:.4g} higher"),
    ):
        for i in np.flatnonzero(given > _NOTHING):
            u = int(np.flatnonzero(moves)[i])
            out.append(f"{composition.layout.place(u)}: " + words.format(limit_of[u], given[i]))
    raise InfeasibleError(
        "the constraints contradict each other. The smallest relaxation that removes it: "
        + "; ".join(out)
    )
