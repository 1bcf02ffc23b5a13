"""The certificate: how far an answer is from the optimum, computed from the terms' NumPy descriptions.

It uses nothing that a solver states. A few lines of NumPy repeat it.

It bounds how far each coefficient is from the optimum. Where the problem is separable, its exact
dual encloses the optimum (`rtcal.calibration.optimum`). Elsewhere strong convexity does. Let v
keep all rows and the box, let F be the gradient of the Lagrangian at v for any multipliers y of the
rows, and d = u* - v the step to the optimum. The objective at u* is at most that at v. Where y is 0
but for the rows that v keeps with equality, and has the sign of their side, y'A d <= 0. Hence

    sum (F d + w d² / 2) <= 0,    w = m / sigma² the curvature's lower limit.

Each summand has a least value within the box. What those of the other coefficients leave bounds the
step of each one.

An answer keeps its rows to a tolerance only, and floating-point numbers keep hardly any equality
exactly. So v is an interval. A right inverse P of the rows moves the answer onto them. Where
|A P - I| < 1, a point within the interval keeps them exactly (Neumann's series). Where that is not
proved, the box alone bounds the error.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from rtcal.calibration.layout import Integers
from rtcal.calibration.numpy_model import Multipliers, NumpyModel
from rtcal.calibration.optimum import active_rows, separable_form
from rtcal.calibration.problem_data import Flags
from rtcal.support.types import Array

_EPS = np.finfo(float).eps
_ROUNDING = 16 * _EPS
"""Rounding error of a term's gradient, of a few operations, relative to the steepest in its band."""
_STARTS = 3
"""Points tried. The first is the answer. In the next ones what the multipliers force to a bound is
there, which an interior-point answer only nears: its bound is 1e-6 from the first point, 1e-12 from
the third."""
_AT_BOUND = 1e-12
"""Distance from a bound that counts as none: a move of rounding's size would pass the bound."""
_ROUNDS = 4
"""Rounds in which the rows that a move breaks are added. After them the box bounds the error."""
_MOVES = 3
"""Moves onto the rows. Each reduces the residual by |A P - I|, which is usually 1e-15."""
_PROVED = 0.5
"""Largest |A P - I| accepted. It at most doubles the bound of a residual."""


def largest_error(model: NumpyModel, u: Array, rows: Array) -> Array:
    """Return how far each coefficient is from the optimum at most, (n_alpha,).

    Parameters
    ----------
    model : NumpyModel
    u : array (size,)
        The unknowns.
    rows : array (n_rows,)
        Multipliers of the rows. Poor ones make the bound loose, not wrong.
    """
    problem = separable_form(model)
    n_alpha = model.data.layout.n_alpha
    if problem is not None:
        below, above = (ends.T.ravel() for ends in problem.enclosure())
        alpha = u[:n_alpha]
        return np.maximum(np.maximum(alpha - below, above - alpha), 0.0) + _EPS * np.abs(alpha)
    box = _box(model)
    widest = np.maximum(np.maximum(box.upper - u, u - box.lower), 0.0)
    start = u
    for _ in range(_STARTS):
        point = _feasible(model, box, start, rows)
        if point is None:
            break
        distance = np.abs(point.centre - u) + point.radius
        widest = np.minimum(widest, distance + _reach(model, box, point))
        start, rows = _at_bounds(model, point), point.multipliers
    return np.asarray(widest[:n_alpha])


@dataclass(frozen=True)
class _Box:
    """The limits of each unknown, and the rows' entries one by one.

    ``lower`` and ``upper`` are as tight as each row makes them. A row whose target is at the end of
    its reach leaves its unknowns no freedom: their limits differ by the rounding error only.
    """

    outer: tuple[Array, Array]
    lower: Array
    upper: Array
    row: Integers
    column: Integers
    value: Array


def _box(model: NumpyModel) -> _Box:
    if sp.issparse(model.matrix):
        entries = model.matrix.tocoo()
        row, column, value = entries.row, entries.col, entries.data
    else:
        row, column = model.matrix.nonzero()
        value = model.matrix[row, column]
    lower = np.where(model.movable, model.lower, model.data.centre)
    upper = np.where(model.movable, model.upper, model.data.centre)
    outer, n_rows = (lower.copy(), upper.copy()), len(model.row_lower)
    rounding = 2 * _rounding(model, np.maximum(np.abs(lower), np.abs(upper)))
    for signed, limit in ((value, model.row_upper), (-value, -model.row_lower)):
        ends = signed * outer[0][column], signed * outer[1][column]
        least = np.bincount(row, np.minimum(*ends), minlength=n_rows)
        slack = np.maximum(limit - least, 0.0) + rounding + _EPS * np.abs(limit)
        width = slack[row] / np.abs(signed)
        rising, falling = (np.isfinite(width) & (signed > 0), np.isfinite(width) & (signed < 0))
        # An effect has no upper end: infinite widths are left out before they meet it.
        np.minimum.at(upper, column[rising], outer[0][column[rising]] + width[rising])
        np.maximum.at(lower, column[falling], outer[1][column[falling]] - width[falling])
    return _Box(outer, np.maximum(lower, outer[0]), np.minimum(upper, outer[1]), row, column, value)


def _rounding(model: NumpyModel, size: Array) -> Array:
    """Bound the rounding error of the rows' sums over unknowns of at most this size, (n_rows,).

    It is infinite in a row that has an unknown without a limit.
    """
    limited = np.isfinite(size)
    sums = np.asarray(model.absolute @ np.where(limited, size, 0.0))
    unlimited = np.asarray(model.absolute @ np.where(limited, 0.0, 1.0)) > 0
    return np.asarray(np.where(unlimited, np.inf, (model.entries + 1) * _EPS * sums))


@dataclass(frozen=True)
class _Point:
    """An interval that holds a point which keeps all rows and the box.

    Attributes
    ----------
    centre, radius : array (size,)
    still : array (size,) of bool
        Unknowns that have no freedom, so that the point shares them with the optimum.
    multipliers : array (n_rows,)
        Of the rows: those that leave the unknowns with room the least force. Rows that the point does
        not keep with equality have none, so that no row has a gap.
    """

    centre: Array
    radius: Array
    still: Flags
    multipliers: Array


def _feasible(model: NumpyModel, box: _Box, u: Array, rows: Array) -> _Point | None:
    """Return a point near u that keeps the rows, None where that is not proved."""
    start = np.where(u - box.outer[0] < _AT_BOUND, box.outer[0], np.maximum(u, box.outer[0]))
    start = np.where(box.outer[1] - u < _AT_BOUND, box.outer[1], np.minimum(start, box.outer[1]))
    equal = model.row_lower == model.row_upper
    side = np.where(equal, 1, np.sign(active_rows(model, start, rows)))
    for _ in range(_ROUNDS):
        point = _onto(model, box, start, side, rows)
        if point is None:
            return None
        values = np.asarray(model.matrix @ point.centre)
        radius = np.asarray(model.absolute @ point.radius)
        error = radius + _rounding(model, np.abs(point.centre))
        above = (side == 0) & (values + error > model.row_upper)
        below = (side == 0) & (values - error < model.row_lower)
        for row in np.flatnonzero((above | below) & (radius == 0)):
            total = _exact_sum(box, int(row), point.centre)
            above[row], below[row] = total > model.row_upper[row], total < model.row_lower[row]
        if not (above | below).any():
            return point
        side = np.where(above, 1, np.where(below, -1, side))
    return None


def _exact_sum(box: _Box, row: int, values: Array) -> Fraction:
    """Return a row's sum without rounding: unknowns at their bounds may keep it with equality."""
    entries = np.flatnonzero(box.row == row)
    products = (Fraction(box.value[i]) * Fraction(values[box.column[i]]) for i in entries)
    return sum(products, Fraction(0))


def _onto(
    model: NumpyModel, box: _Box, start: Array, side: Array, multipliers: Array
) -> _Point | None:
    """Move a point onto rows, each unknown by no more than it has room to its limits.

    Rows of which no unknown has room cannot be kept by a move. Unless they are kept already, the
    point takes the optimum's values of their unknowns, which are known as precisely as their limits.
    """
    room = np.minimum(start - box.lower, box.upper - start)
    scale = np.where(model.movable, np.clip(room, 0.0, model.sigma), 0.0)
    norm = np.sqrt(np.asarray(model.squares @ scale**2))
    limits = np.where(side < 0, model.row_lower, model.row_upper)
    used, fixed = (side != 0) & (norm > 0), (side != 0) & (norm == 0)
    for row in np.flatnonzero(fixed):
        fixed[row] = _exact_sum(box, int(row), start) != limits[row]
    still = np.zeros(len(start), dtype=bool)
    still[box.column[fixed[box.row]]] = True
    width = np.where(still, box.upper - box.lower, 0.0)
    limit, rows, norm = limits[used], model.matrix[used], norm[used]
    shares = rows * scale / norm[:, np.newaxis]
    magnitudes = abs(shares)
    try:
        inverse = np.linalg.inv(_dense(shares @ shares.T))
    except np.linalg.LinAlgError:
        return None
    rest = np.abs(_dense(shares @ shares.T) @ inverse - np.eye(len(norm)))
    rest += (len(start) + len(norm)) * _EPS * (_dense(magnitudes @ magnitudes.T) @ np.abs(inverse))
    share = float(rest.sum(axis=1).max(initial=0.0))
    if not share < _PROVED:
        return None
    centre = start
    for _ in range(_MOVES):
        residual = (limit - np.asarray(rows @ centre)) / norm
        centre = centre + scale * np.asarray(shares.T @ (inverse @ residual))
    unknown = _rounding(model, np.abs(centre)) + np.asarray(model.absolute @ width)
    residual = np.abs(limit - np.asarray(rows @ centre)) + _EPS * np.abs(limit) + unknown[used]
    residual = residual / norm
    step = residual + share / (1 - share) * residual.max(initial=0.0)
    radius = scale * np.asarray(magnitudes.T @ (np.abs(inverse) @ step))
    inside = (centre - radius >= box.outer[0]) & (centre + radius <= box.outer[1])
    if not (inside | still).all():
        return None
    equal = model.row_lower == model.row_upper
    multipliers = np.where(equal | (multipliers * side > 0), multipliers, 0.0)
    force = model.stationarity(centre, multipliers) * scale
    balanced = multipliers.copy()
    balanced[used] -= inverse @ np.asarray(shares @ force) / norm
    kept = equal | (balanced * side > 0)
    return _Point(centre, radius + width, still, np.where(kept, balanced, multipliers))


def _at_bounds(model: NumpyModel, point: _Point) -> Array:
    """Move each unknown to the minimum of the Lagrangian along it, (size,), within the box later."""
    diagonal = model.curvature(point.centre).diagonal()
    force = model.stationarity(point.centre, point.multipliers)
    step = np.divide(force, diagonal, out=np.zeros_like(force), where=diagonal > 0)
    return np.asarray(point.centre - np.where(model.movable, step, 0.0))


def _dense(matrix: Any) -> Array:
    return np.asarray(matrix.toarray() if sp.issparse(matrix) else matrix)


def _reach(model: NumpyModel, box: _Box, point: _Point) -> Array:
    """Bound the distance of the optimum from a point that keeps all rows, (size,)."""
    layout, sigma, centre = model.data.layout, model.sigma, point.centre
    movable = model.movable & ~point.still
    m = np.where(movable, model.convexity, 0.0)
    # In sigmas: the gradient of the Lagrangian, its error, and the limits of the step.
    force = model.stationarity(centre, point.multipliers) * sigma
    error = _force_error(model, point) * sigma
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=movable)
    upwards = np.maximum(box.upper - centre + point.radius, 0.0)
    downwards = np.maximum(centre - box.lower + point.radius, 0.0)
    with np.errstate(invalid="ignore"):
        upwards = np.where(movable, upwards * inverse, 0.0)
        downwards = np.where(movable, downwards * inverse, 0.0)
    least = np.minimum(
        _least(force - error, m, upwards),
        _least(-force - error, m, downwards),
    )
    available = layout.by_band(-least, np.sum)
    if not model.separate(centre):  # bands are coupled: their gaps count together
        available = np.full(layout.n_bands, available.sum())
    of_bands = np.tile(available, layout.n_rows)
    energy = np.full(len(sigma), available.sum())
    energy[: layout.n_alpha] = of_bands
    with np.errstate(invalid="ignore"):
        energy = np.maximum(energy + least, 0.0)
    step = np.maximum(
        _largest_step(force - error, m, energy, upwards),
        _largest_step(-force - error, m, energy, downwards),
    )
    return np.asarray(sigma * step)


def _force_error(model: NumpyModel, point: _Point) -> Array:
    """Bound the error of gradient + rows' multipliers over the point's interval, (size,).

    The change over the interval is that of a linear gradient, or that to an end of the interval
    where the gradient bends within it.
    """
    gradient = model.gradient(point.centre)
    change = 2 * model.curvature(point.centre).magnitude(point.radius)
    for end in (point.centre - point.radius, point.centre + point.radius):
        change = np.maximum(change, np.abs(model.gradient(end) - gradient))
    pulls = np.asarray(model.absolute.T @ np.abs(point.multipliers))
    inverse = np.divide(1.0, model.sigma, out=np.zeros_like(change), where=model.movable)
    return np.asarray(change + _ROUNDING * (model.steepness(point.centre) * inverse + pulls))


def _least(force: Array, m: Array, room: Array) -> Array:
    """Return the least F d + m d² / 2 for d from 0 to ``room``."""
    falls = force < 0
    step = np.divide(-force, m, out=np.full_like(m, np.inf), where=m > 0)
    step = np.where(falls, np.minimum(step, room), 0.0)
    with np.errstate(invalid="ignore"):
        least = force * step + m * np.where(m > 0, step, 0.0) ** 2 / 2
    return np.asarray(np.where(falls, least, 0.0))


def _largest_step(force: Array, m: Array, energy: Array, room: Array) -> Array:
    """Return the largest d from 0 to ``room`` with F d + m d² / 2 at most the energy.

    Each root is written without a difference of nearly equal numbers.
    """
    limited = np.isfinite(energy)
    energy = np.where(limited, energy, 0.0)
    root = np.sqrt(force**2 + 2 * m * energy)
    uphill = np.divide(2 * energy, root + force, out=np.zeros_like(root), where=root + force > 0)
    downhill = np.divide(root - force, m, out=np.full_like(root, np.inf), where=m > 0)
    step = np.where(force > 0, uphill, downhill)
    return np.asarray(np.where(limited, np.minimum(step, room), room))


@dataclass(frozen=True, repr=False)
class Certificate:
    """Residuals of the optimality conditions, each (n_bands,).

    Attributes
    ----------
    primal_residual : array
        The larger of |S'alpha - b| / sum S and the violation of the box.
    dual_residual : array
        max |sigma (gradient + S D - z_lower + z_upper)| over sigma > 0.
    duality_gap : array
        sum z_lower (alpha - lower) + z_upper (upper - alpha).
    model : NumpyModel
    unknowns : array (size,)
        The answer.
    row_multipliers : array (n_rows,)
        Its multipliers of the rows.
    materials : tuple of int
        The materials of `alpha_error_bound`, by their index in the problem.
    """

    primal_residual: Array
    dual_residual: Array
    duality_gap: Array
    model: NumpyModel
    unknowns: Array
    row_multipliers: Array
    materials: tuple[int, ...]

    @cached_property
    def alpha_error_bound(self) -> Array:
        """No coefficient is farther than this from the optimum, (n_materials, n_bands).

        An enclosure, by the exact dual where the problem is separable, by strong convexity elsewhere
        (see the module). It is computed when it is first read.
        """
        bound = largest_error(self.model, self.unknowns, self.row_multipliers)
        return self.model.data.layout.expand(bound)[list(self.materials)]

    @cached_property
    def worst(self) -> float:
        """The largest of the three residuals over all bands."""
        return float(
            max(np.max(r) for r in (self.primal_residual, self.dual_residual, self.duality_gap))
        )

    def __repr__(self) -> str:
        return (
            f"<Certificate: worst residual {self.worst:.1e}, alpha within "
            f"{np.max(self.alpha_error_bound):.1e} of the optimum>"
        )


def certify(model: NumpyModel, u: Array, multipliers: Multipliers) -> Certificate:
    """Return the certificate of an answer.

    Parameters
    ----------
    model : NumpyModel
    u : array (size,)
        The unknowns.
    multipliers : Multipliers
    """
    data = model.data
    layout = data.layout
    u = u.ravel()
    matrix, sigma = model.matrix, model.sigma
    values = np.asarray(matrix @ u)
    violation = np.maximum(np.maximum(model.row_lower - values, values - model.row_upper), 0.0)
    outside = np.maximum(np.maximum(model.lower - u, u - model.upper), 0.0)
    relative = np.divide(violation, model.row_norm, out=violation.copy(), where=model.row_norm > 0)
    bands = model.row_band
    primal = layout.by_band(outside, np.maximum.reduce)
    np.maximum.at(primal, bands, relative)

    gradient, pull = model.gradient(u), np.asarray(matrix.T @ multipliers.rows)
    force = gradient + pull
    unbalanced = np.abs(sigma * (force - multipliers.lower + multipliers.upper))
    dual = layout.by_band(unbalanced, np.maximum.reduce)
    slack_lower, slack_upper = u - model.lower, _finite(model.upper - u)
    gap = _gap(multipliers.lower, multipliers.upper, slack_lower, slack_upper)
    row_gap = _row_gap(model, multipliers.rows, values)
    total_gap = layout.by_band(gap, np.add.reduce)
    np.add.at(total_gap, bands, row_gap)

    return Certificate(
        primal_residual=primal,
        dual_residual=dual,
        duality_gap=np.abs(total_gap),
        model=model,
        unknowns=u,
        row_multipliers=multipliers.rows,
        materials=tuple(range(len(layout.materials))),
    )


def _finite(slack: Array) -> Array:
    """Slack of the box; 0 for a side without bound."""
    return np.where(np.isfinite(slack), slack, 0.0)


def _gap(lower: Array, upper: Array, slack_lower: Array, slack_upper: Array) -> Array:
    return np.asarray(lower * slack_lower + upper * slack_upper)


def _row_gap(model: NumpyModel, rows: Array, values: Array) -> Array:
    """Multiplier times slack of the inequality rows."""
    slack = np.where(rows > 0, model.row_upper - values, values - model.row_lower)
    equality = (model.row_lower == model.row_upper) | (rows == 0)
    return np.where(equality, 0.0, np.abs(rows) * np.maximum(np.where(equality, 0.0, slack), 0.0))
