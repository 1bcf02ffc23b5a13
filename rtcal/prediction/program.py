"""The cheapest areas as a second-order cone program, compiled once for its shape.

    minimise c'x  subject to  lower <= x <= upper,  G x <= h,  and in every band
    |root (w0 + W x)| <= s,  s <= i_j + k_j m  for every tangent j,  m = m0 + mx'x.

Everything but x is a parameter, and the problem is DPP: cvxpy compiles it once, and later solves
fill in numbers.
"""

from __future__ import annotations

import functools
import threading
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.errors import ModelError, SolverError
from rtcal.support.types import Array

TANGENTS = 16
"""Tangents to the largest allowed sd, per band."""
_LOOSER = {"tol_gap_abs": 1e-6, "tol_gap_rel": 1e-6, "tol_feas": 1e-7}
"""Settings for numbers with which Clarabel makes no progress to its usual 1e-8."""
_MISSED = 1e-6
"""Largest violation of a constraint, in shares of the room's surface."""
_GONE = 1e-7
"""Areas below this, in shares of the surface, are 0."""


@dataclass(frozen=True, eq=False)
class ProgramNumbers:
    """The numbers of one program, areas in m².

    Attributes
    ----------
    cost, lower, upper : array (n_treatments,)
    limits : array (n_surfaces, n_treatments)
        G, which treatments cover which surface.
    largest : array (n_surfaces,)
        h.
    start : array (n_bands, n_rows)
        root w0.
    steps : array (n_bands, n_rows, n_treatments)
        root W.
    mean : array (n_bands,)
        m0.
    gains : array (n_bands, n_treatments)
        mx.
    intercept, slope : array (n_bands, TANGENTS)
    scale : float
        The room's surface in m².
    """

    cost: Array
    lower: Array
    upper: Array
    limits: Array
    largest: Array
    start: Array
    steps: Array
    mean: Array
    gains: Array
    intercept: Array
    slope: Array
    scale: float


class Program:
    """The compiled program of one shape: treatments, surfaces, bands and rows."""

    def __init__(self, n_treatments: int, n_surfaces: int, n_bands: int, n_rows: int) -> None:
        import cvxpy as cp

        self.lock = threading.Lock()
        self._x = cp.Variable(n_treatments)
        mean, sigma = cp.Variable(n_bands), cp.Variable(n_bands)
        self._given: dict[str, Any] = {
            "cost": cp.Parameter(n_treatments),
            "lower": cp.Parameter(n_treatments),
            "upper": cp.Parameter(n_treatments),
            "limits": cp.Parameter((n_surfaces, n_treatments)),
            "largest": cp.Parameter(n_surfaces),
            "start": [cp.Parameter(n_rows) for _ in range(n_bands)],
            "steps": [cp.Parameter((n_rows, n_treatments)) for _ in range(n_bands)],
            "mean": cp.Parameter(n_bands),
            "gains": cp.Parameter((n_bands, n_treatments)),
            "intercept": cp.Parameter((n_bands, TANGENTS)),
            "slope": cp.Parameter((n_bands, TANGENTS)),
            "unit": cp.Parameter((n_bands, TANGENTS), nonneg=True),
        }
        g, x = self._given, self._x
        constraints = [
            x >= g["lower"],
            x <= g["upper"],
            g["limits"] @ x <= g["largest"],
            mean == g["mean"] + g["gains"] @ x,
        ]
        for j in range(TANGENTS):
            allowed = g["intercept"][:, j] + cp.multiply(g["slope"][:, j], mean)
            constraints.append(cp.multiply(g["unit"][:, j], sigma) <= allowed)
        for k in range(n_bands):
            constraints.append(cp.SOC(sigma[k], g["start"][k] + g["steps"][k] @ x))
        self._problem = cp.Problem(cp.Minimize(g["cost"] @ x), constraints)
        if not self._problem.is_dcp(dpp=True):
            raise ModelError(
                "the design's program is not DPP: cvxpy would compile it for every solve"
            )

    def solve(self, numbers: ProgramNumbers) -> Array | None:
        """Return the cheapest areas in m², (n_treatments,); None if there are none.

        Raises SolverError if the solver fails, or its answer misses a constraint.
        """
        import cvxpy as cp

        scale = numbers.scale
        # Each tangent's row has unit length: the steep ones at the ends of a range are as well scaled.
        unit = 1 / np.hypot(1, numbers.slope)
        rows = {"unit": unit, "slope": unit * numbers.slope, "intercept": unit * numbers.intercept}
        with self.lock, warnings.catch_warnings():
            # cvxpy warns of an inaccurate answer; each one is judged by its own constraints below.
            warnings.filterwarnings("ignore", "Solution may be inaccurate")
            for name, parameter in self._given.items():
                value = rows[name] if name in rows else getattr(numbers, name)
                if name == "cost":
                    value = value / max(float(np.max(value)), 1e-300)
                elif name not in ("limits", "gains", "slope", "steps", "unit"):
                    value = value / scale
                if isinstance(parameter, list):
                    for each, of_band in zip(parameter, value, strict=True):
                        each.value = of_band
                else:
                    parameter.value = value
            failure = ""
            # Clarabel's workspace keeps the scaling of the numbers before, which may not suit these.
            for kept, settings in ((True, {}), (False, {}), (False, _LOOSER)):
                try:
                    self._problem.solve(solver=cp.CLARABEL, warm_start=kept, **settings)
                except cp.error.SolverError as error:
                    failure = str(error)
                    continue
                status, x = self._problem.status, self._x.value
                if status == "infeasible" and not kept:
                    return None
                if status not in ("optimal", "optimal_inaccurate") or x is None:
                    failure = status
                    continue
                found = np.clip(np.where(x < _GONE, 0.0, x) * scale, numbers.lower, numbers.upper)
                missed = worst(numbers, found) / scale
                if missed <= _MISSED:
                    return np.asarray(found)
                failure = f"{status}, but a constraint is missed by {missed:.1e}"
        if failure.startswith("infeasible"):
            return None
        raise SolverError(f"the design's program was not solved: {failure}")


def worst(numbers: ProgramNumbers, x: Array) -> float:
    """Return by how much areas miss the worst constraint in m², recomputed from the numbers."""
    mean = numbers.mean + numbers.gains @ x
    sigma = np.linalg.norm(numbers.start + numbers.steps @ x, axis=1)
    allowed = (numbers.intercept + numbers.slope * mean[:, np.newaxis]).min(axis=1)
    covered = numbers.limits @ x - numbers.largest
    return float(max(np.max(sigma - allowed), np.max(covered, initial=0.0)))


program = functools.lru_cache(16)(Program)
"""The compiled program of a shape; the one not used for longest is forgotten."""
