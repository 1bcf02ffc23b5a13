"""The exact answers, from rational arithmetic: they owe nothing to rtcal's own solvers or polish.

A separable problem is solved band by band in fractions (`tests.rational`). Of a composed one a solver
outside rtcal tells the active set; the linear system of the optimality conditions on that set is then
solved with residuals in fractions, and every condition is checked in fractions: feasibility, signs,
stationarity. What passes is the optimum of the matrices as they are, whoever named the active set.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import qpsolvers
import scipy.sparse as sp
from scipy.sparse.linalg import splu

import rtcal as rt
from rtcal.support.types import Array
from tests import rational

EPS = float(np.finfo(float).eps)
NAMED_BY = "piqp"  # names the active set of the composed problems
ROUNDS = 40
REFINEMENTS = 6
EXACT = 1e-20  # residuals in fractions that count as none: rounding is 1e-16


def of_bands(mu: Array, sigma: Array, areas: Array, target: Array, lower: Array) -> Array | None:
    """Return alpha (n, bands) of independent bands; None if one is out of reach.

    A target past an end by no more than the rounding of S'alpha counts as that end.
    """
    columns = []
    for k in range(mu.shape[1]):
        given = (mu[:, k], sigma[:, k], areas, float(target[k]), lower[:, k])
        found = rational.solve(*(v if isinstance(v, float) else v.tolist() for v in given))
        if isinstance(found, str):
            end = lower[:, k] if found == "below" else np.ones(len(areas))
            end = np.where(sigma[:, k] == 0, mu[:, k], end)
            if abs(areas @ end - target[k]) > 16 * len(areas) * EPS * (areas @ abs(end)):
                return None
            columns.append(end)
        else:
            columns.append(np.array([float(v) for v in found]))
    return np.array(columns).T


@dataclass(frozen=True)
class Verified:
    """The optimum x, the largest residual of its conditions, and an estimate of x's own error."""

    x: Array
    residual: float
    error: float


def of_matrices(problem: qpsolvers.Problem) -> Verified:
    """Return the verified optimum of ½ x'Px + q'x, G x <= h, A x = b.

    Raises SolverError if no active set passes.
    """
    n = len(problem.q)
    quadratic, equal = sp.csr_array(problem.P), problem.A
    equal = sp.csr_array((0, n)) if equal is None else sp.csr_array(equal)
    unequal, limit = sp.csr_array(problem.G), problem.h
    wanted = np.zeros(0) if problem.b is None else problem.b
    eps = {f"eps_{k}": 1e-10 for k in ("abs", "rel", "duality_gap_abs", "duality_gap_rel")}
    near = qpsolvers.solve_problem(problem, solver=NAMED_BY, check_duality_gap=True, **eps)
    if near.x is None:
        raise rt.errors.SolverError(f"{NAMED_BY} names no active set")
    # A row without coefficients says nothing about x.
    real = abs(unequal).sum(axis=1) > 0
    active = real & (near.z > limit - unequal @ near.x)
    m = len(wanted)
    for _ in range(ROUNDS):
        rows = sp.vstack([equal, unequal[np.flatnonzero(active)]])
        right = np.concatenate([-problem.q, wanted, limit[active]])
        system = sp.csc_array(sp.block_array([[quadratic, rows.T], [rows, None]]))
        z, left, error = _solve(system, right)
        slack = _residual(unequal, z[:n], limit)
        multiplier = np.array([float(v) for v in z[n + m :]])
        away = ~active & real & (slack < -EXACT)
        drop = np.zeros_like(active)
        drop[np.flatnonzero(active)[multiplier < -EXACT]] = True
        if not away.any() and not drop.any():
            if left > EXACT:
                break
            return Verified(np.array([float(v) for v in z[:n]]), left, error)
        active = (active | away) & ~drop
    raise rt.errors.SolverError("no active set passes the optimality conditions")


def _solve(matrix: Any, right: Array) -> tuple[list[Fraction], float, float]:
    """Solve by refinement with residuals in fractions; also the last residual and z's error."""
    factor = splu(matrix)
    by_row = sp.csr_array(matrix)
    z = [Fraction(0)] * len(right)
    residual = right
    for _ in range(REFINEMENTS):
        z = [a + Fraction(float(c)) for a, c in zip(z, factor.solve(residual), strict=True)]
        residual = _residual(by_row, z, right)
        if np.max(np.abs(residual)) <= EXACT:
            break
    error = np.max(np.abs(factor.solve(residual)))
    return z, float(np.max(np.abs(residual))), float(error)


def _residual(matrix: Any, x: list[Fraction], right: Array) -> Array:
    """Return right - matrix x, computed in fractions and rounded once."""
    starts, columns, values = matrix.indptr, matrix.indices.tolist(), matrix.data.tolist()
    found = np.empty(len(right))
    for i, b in enumerate(right.tolist()):
        part = range(starts[i], starts[i + 1])
        found[i] = float(Fraction(b) - sum(Fraction(values[j]) * x[columns[j]] for j in part))
    return found
