"""Check before solving whether coefficients within their bounds can give the measured T.

If constraints contradict each other, the error names the smallest change that removes the
contradiction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.room import Room
from rtcal.calibration.composition import Composition
from rtcal.calibration.qp import QP
from rtcal.calibration.unknowns import Flags, Numbers
from rtcal.support.errors import InfeasibleError, ModelError
from rtcal.support.types import Array

_SHOWN = 3
"""Most bands beyond reach that a message has in full."""
_MARGIN = 1e-9
"""Relative tolerance within which the bounds count as reaching the equation's largest b. It equals the
primal residual that an answer may have."""


@dataclass(frozen=True)
class Unreachable:
    """Describe a band whose measured T no coefficients within their bounds can give.

    ``target`` is the absorption area in m² that T requires, NaN if no area gives this T. The bounds
    allow absorption areas from ``lowest`` to ``highest`` in m² and T from ``shortest`` to ``longest``
    in s. ``configuration`` is the number of the measured state, from 0, and ``frequency`` the centre
    frequency in Hz.

    ``reverberation_time`` is the measured T in s.
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
        time = f"{self.reverberation_time:.4g} s"
        needed = f"{time} would need an absorption area of the surfaces of {self.target:.4g} m²"
        if np.isnan(self.target):
            needed = f"No absorption area gives {time}"
        longest = f"to {self.longest:.4g} s" if np.isfinite(self.longest) else "s and longer"
        return (
            f"T[{bands.label(self.frequency)}] = {time} cannot be reached: coefficients within their "
            f"bounds give T from {self.shortest:.4g} {longest}. {needed}; the bounds "
            f"allow {self.lowest:.4g} to {self.highest:.4g} m²"
        )


def where_valid(
    quantity: Callable[[Room, Array], Array], room: Room, absorption_area: Array
) -> Array:
    """Return T in s, or the air's share of absorption, (n_bands,), and NaN where the equation fails.

    ``quantity`` is the method that calculates the value: `LinearEquation.time` or
    `LinearEquation.air_share`. ``absorption_area`` (n_bands,) is that of the surfaces of ``room`` in
    m². Some equations hold only up to a largest absorption area; a band above it is NaN.
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
    """Return the least and the largest absorption area in m² that the bounds of the coefficients allow.

    Each is (n_configurations, n_bands). ``numbers`` has the values of room and measurement, with the
    bounds. If the calibration also fits the sizes of effects (`rtcal.terms.AddedAbsorption`), the
    absorption that they add within their own bounds is included.
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


def restrict_to_reach(
    numbers: Numbers, matches: Sequence[tuple[Array, Array]], unreachable: str
) -> tuple[Numbers, NDArray[np.int8], tuple[Unreachable, ...]]:
    """Check which measured T can be reached, and move those out of reach to the nearest possible value.

    Parameters
    ----------
    numbers : Numbers
        Values of room and measurement, with the absorption area ``target`` that each T needs.
    matches : sequence of pairs of arrays
        Least and largest absorption area in m² that each constraint on T allows, (n_configurations,
        n_bands) each. If it is empty, only a T shorter than that of full absorption is an error.
    unreachable : {"raise", "nearest"}
        Whether a T out of reach is an error, or is replaced by the nearest one.

    Returns
    -------
    numbers : Numbers
        The same values, with ``target`` moved into the reachable range.
    held : array (size,)
        -1 or 1 for an unknown that must be at its lower or upper bound, because the target is at an end
        of the reachable range; 0 for the others.
    bands : tuple of Unreachable
        Bands whose T cannot be reached.

    Raises
    ------
    InfeasibleError
        If a T cannot be reached and ``unreachable`` is "raise"; if T is shorter than with full
        absorption; or if the least absorption that the bounds allow is too large for the equation.
    """
    times, rooms, equation = numbers.time, numbers.rooms, numbers.equation
    none_held = np.zeros(numbers.layout.size, dtype=np.int8)
    if not matches:
        lost = np.isfinite(times) & ~np.isfinite(numbers.target)
        if lost.any():
            row = int(np.flatnonzero(lost.ravel())[0])
            raise InfeasibleError(
                f"T[{numbers.layout.band_label(row)}] = {times.ravel()[row]:.4g} s cannot "
                "be reached: it is shorter than T with fully absorbing surfaces. Check "
                "T, the volume and the areas"
            )
        return numbers, none_held, ()
    asked = np.isfinite(times)
    low, high = reach(numbers)
    # b of a T at an end is an end only up to rounding. A sum of n products has an error of at most
    # n eps / 2 times the sum of their absolute values (Higham 2002, Sect. 3.1). From alpha to T and
    # back, b has at most 1.5 eps sum S. So 16 n is eight times their sum or more.
    sizes = numbers.areas @ np.abs(numbers.alpha(numbers.box[1]))
    tolerance = 16 * numbers.areas.shape[1] * np.finfo(float).eps * sizes
    largest = numbers.largest_target
    top = np.minimum(high, largest)
    for c, k in np.argwhere(asked & (low > (1 + _MARGIN) * largest))[:1].tolist():
        raise InfeasibleError(
            f"{bands.label(rooms[c].centre_frequencies[k])}: with these bounds the mean "
            f"absorption coefficient is at least {low[c, k] / rooms[c].total_area:.3f}, "
            f"but {equation.name}'s equation holds only up to {equation.largest_mean:.3f}. "
            "Lower the bounds, or use another equation"
        )
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
    for c, k in np.argwhere(too_low | too_high).tolist():
        shortest, longest = (
            where_valid(equation.time, rooms[c], area)[k] for area in (top[c], low[c])
        )
        areas = target[c, k], low[c, k], top[c, k]
        stated = rooms[c].centre_frequencies[k], times[c, k], *areas, shortest, longest
        beyond.append(Unreachable(c, *map(float, stated)))
    if beyond and unreachable == "raise":
        more = [f"{len(beyond) - _SHOWN} more bands cannot be reached"] * (len(beyond) > _SHOWN)
        cure = "Check T, the volume, the areas and the bounds"
        raise InfeasibleError(". ".join([*map(str, beyond[:_SHOWN]), *more, cure]))
    at_low = asked & (too_low | (np.abs(target - low) <= tolerance))
    at_high = asked & (too_high | (np.abs(target - top) <= tolerance)) & ~at_low
    reached = np.where(at_low, low, np.where(at_high, top, target))
    moved = too_low | too_high | at_low | at_high
    if not moved.any():
        return numbers, none_held, ()
    at_high &= top >= high - tolerance  # a limit of the equation is no end of the box
    target = np.where(moved | np.isnan(numbers.target), reached, numbers.target)
    held_at = _forced(numbers, at_low, at_high)
    return replace(numbers, target=target), held_at, tuple(beyond)


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


_NOTHING = 1e-9


def explain(composition: Composition, numbers: Numbers, program: QP) -> None:
    """Raise InfeasibleError, with the smallest change that helps, if constraints contradict each other.

    The message names the constraints and bounds to relax, and by how much. The sum of these
    relaxations, each as a change of absorption coefficients, is the least possible (elastic linear
    programme, Chinneck 2008, ch. 6). The limits 0 <= alpha <= 1 and fixed coefficients are not relaxed.
    ``numbers`` has the values of room and measurement, and ``program`` is the quadratic programme that
    no solver could solve. If no contradiction is found, nothing is raised.
    """
    from scipy.optimize import linprog

    compiled, layout, moves = composition.compiled, composition.layout, numbers.movable
    A, places, unit = program.matrices[1], compiled.places, numbers.inverse_sigma
    own = A[:, places] @ sp.diags_array(unit * moves)
    above, below = (np.asarray((sign * own).maximum(0).sum(axis=1)).ravel() for sign in (1, -1))
    size = np.maximum(above, below)
    size[size == 0] = 1.0
    relaxed: list[tuple[int, float, str]] = []  # row, what a relaxation of 1 gives it, and in words
    for term, stated in compiled.rows_of:
        label = getattr(term, "label", lambda row, _, term=term: f"{term!r}, row {row + 1}")
        for i, row in ((i, row) for rows in stated for i, row in enumerate(rows.tolist())):
            for side in (1, -1) if compiled.equal[row] else (1,):
                word = "higher" if side * (above[row] - below[row]) >= 0 else "lower"
                text = f"{label(i, layout)} has to be {{:.4g}} {word}"
                relaxed.append((row, side * size[row], text))
    # Every bound is a row of its own, after those of the constraints.
    limits, columns, sides = [program.b], list[int](), list[float]()
    for bound, sign, word in ((numbers.lower, -1.0, "lower"), (numbers.upper, 1.0, "higher")):
        for u in np.flatnonzero(moves & np.isfinite(bound)).tolist():
            text = f"{layout.place(u)}: {'upper' if sign > 0 else 'lower'} bound {bound[u]:.4g}"
            relaxed.append(
                (len(program.b) + len(columns), 1.0, f"{text} has to be {{:.4g}} {word}")
            )
            limits.append(np.array([sign * (bound[u] - numbers.mu[u])]))
            columns.append(int(places[u]))
            sides.append(sign / unit[u])
    lower, upper = program.lower.copy(), program.upper.copy()
    most = np.where(np.arange(layout.size) < layout.n_alpha, 1.0, np.inf)
    lower[places[moves]] = (-numbers.mu * unit)[moves]
    upper[places[moves]] = ((most - numbers.mu) * unit)[moves]
    rows, k = [row for row, _, _ in relaxed], len(relaxed)
    by_bound = sp.csr_array((sides, (range(len(columns)), columns)), (len(columns), A.shape[1]))
    gives = sp.csr_array(
        ([-give for _, give, _ in relaxed], (rows, range(k))), (A.shape[0] + len(columns), k)
    )
    whole = sp.csr_array(sp.hstack([sp.vstack([A, by_bound]), gives]))
    b, equal = np.concatenate(limits), np.append(program.equal, np.zeros(len(columns), dtype=bool))
    found = linprog(
        np.append(np.zeros(A.shape[1]), np.ones(k)),
        A_ub=whole[~equal],
        b_ub=b[~equal],
        A_eq=whole[equal],
        b_eq=b[equal],
        bounds=[*zip(lower, upper, strict=True), *[(0, None)] * k],
    )
    if found.status != 0 or found.fun <= _NOTHING:
        return
    by = found.x[A.shape[1] :]
    raise InfeasibleError(
        "the constraints contradict each other. The smallest change that removes the "
        "contradiction: "
        + "; ".join(
            text.format(by[i] * abs(give))
            for i, (_, give, text) in enumerate(relaxed)
            if by[i] > _NOTHING
        )
    )
