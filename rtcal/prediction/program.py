"""The cheapest areas as a second-order cone program, compiled once for its shape.

    minimise c'x  subject to  lower <= x <= upper,  G x <= h,  and in every band
    |root (w0 + W x)| <= s,  s <= i_j + k_j m  for every tangent j,  m = m0 + mx'x.

Everything but x is a parameter, and the problem is DPP: cvxpy compiles it once, and later solves
fill in numbers.

The tangents follow from the probability that T is in a range. The absorption area A of the surfaces
is normal with mean m and standard deviation s, and

    ln T = f(A) + offset + r,  r normal with standard deviation tau,

f the equation's ln T. P(m, s) is the probability that T is in its range. g(m), the largest s at which
P(m, s) is at least p, is concave for p from 0.8 on, but for rounding. Its tangents are linear
constraints on s that cut off no design; where a tangent touches, the probability is kept.
"""

from __future__ import annotations

import functools
import threading
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.targets import Target
from rtcal.support.errors import ModelError, SolverError
from rtcal.support.types import Array

_HALVINGS = 26
# A trapezium rule: for a smooth function times the normal density it converges exponentially, also
# where r is a few times narrower than A's spread. Gauss-Hermite nodes are too far apart there.
_NODES = np.linspace(-4.2, 4.2, 43)
_WEIGHTS = np.exp(-(_NODES**2) / 2) / np.exp(-(_NODES**2) / 2).sum()
_EDGE = 1e-9
"""Share of the whole surface by which A keeps off 0 and the equation's largest absorption."""
_STEP = 1e-6
"""Step of the derivatives of P, in shares of the surface."""
_NARROWEST = 1e-6
"""Least width of the means that are allowed, in shares of the surface: below, there is no design."""
_LOOSE = 10.0
"""Largest sd, in shares of the surface, of a band without a range."""


@dataclass(frozen=True, eq=False)
class Ranges:
    """Ranges of T of one room, in terms of the absorption area of its surfaces.

    Attributes
    ----------
    room : Room
        Its volume, air and total area count.
    equation : LinearEquation
    target : Target
    offset, tau : array (n_bands,)
        Mean and standard deviation of ln T less that of the equation.
    """

    room: Room
    equation: LinearEquation
    target: Target
    offset: Array
    tau: Array

    def probability(self, mean: Array, sigma: Array) -> Array:
        """Return P that T is in range for A of mean and standard deviation in m², (..., n_bands)."""
        area = mean[..., np.newaxis, :] + sigma[..., np.newaxis, :] * _NODES[:, np.newaxis]
        whole = self.room.total_area
        top = min(self.equation.largest_mean, 1.0) - _EDGE
        area = np.clip(area, _EDGE * whole, top * whole)
        log_time = np.log(self.equation.time(self.room, area)) + self.offset
        tau = np.maximum(self.tau, 1e-9)
        high = ndtr((np.log(self.target.high) - log_time) / tau)
        low = ndtr((np.log(self.target.low) - log_time) / tau)
        inside = np.where(np.isnan(high), 1.0, high) - np.where(np.isnan(low), 0.0, low)
        return np.asarray(np.einsum("...qk,q->...k", inside, _WEIGHTS))

    def best(self) -> tuple[Array, Array]:
        """Return the mean at which a known A would be most probably in range, and that probability."""
        whole = self.room.total_area
        means = np.linspace(0.001, 0.999, 400)[:, np.newaxis] * np.full(len(self.tau), whole)
        found = self.probability(means, np.zeros_like(means))
        at = np.argmax(found, axis=0)
        bands = np.arange(len(self.tau))
        return means[at, bands], found[at, bands]

    def span(
        self, probability: float | Array, least: Array, most: Array
    ) -> tuple[Array, Array] | None:
        """Return the least and the largest mean in m² at which a known A would do, (n_bands,) each.

        They are from ``least`` to ``most`` m², (n_bands,) each, which is what the treatments reach:
        far beyond, g need not be concave. None if a band cannot be in range with this probability.
        """
        whole, n_bands = self.room.total_area, len(self.tau)
        peak, best = self.best()
        bounded = self.target.bounded
        if (best < probability)[bounded].any():
            return None
        first = self._edge(probability, peak, np.full(n_bands, _EDGE * whole))
        last = self._edge(probability, peak, np.full(n_bands, (1 - _EDGE) * whole))
        first, last = np.maximum(first, least), np.minimum(last, most)
        if ((last - first)[bounded] < _NARROWEST * whole).any():
            return None
        return first, last

    def tangents(self, probability: float | Array, means: Array) -> tuple[Array, Array]:
        """Return intercepts in m² and slopes of the tangents at means in m², (..., n_bands) each.

        A band without a range, or a mean at which the probability is not to be had, has none: a
        limit that never binds stands there.
        """
        whole = self.room.total_area
        sigmas = self._largest(probability, means)
        step = _STEP * whole
        by_mean, by_sigma = (
            self.probability(means + dm, sigmas + ds) - self.probability(means - dm, sigmas - ds)
            for dm, ds in ((step, 0.0), (0.0, np.minimum(step, sigmas / 2)))
        )
        by_sigma = by_sigma / np.minimum(step, sigmas / 2)
        touches = self.target.bounded & (sigmas > 4 * step) & (by_sigma < 0)
        slope = np.where(touches, -(by_mean / step) / np.where(touches, by_sigma, -1.0), 0.0)
        return np.where(touches, sigmas - slope * means, _LOOSE * whole), slope

    def tangents_above(self, probability: float | Array, means: Array) -> tuple[Array, Array]:
        """Return the tangents at means (n, n_bands), each moved up until it is above g at all of them.

        Only where the spread is large beside the mean is g not concave, and a tangent moved. Between
        the means, and the ends, g is looked at once more.
        """
        intercept, slope = self.tangents(probability, means)
        has_one = intercept < _LOOSE * self.room.total_area
        dense = np.concatenate([means, (means[1:] + means[:-1]) / 2])
        g = self._largest(probability, dense)
        above = np.max(g - slope[:, np.newaxis] * dense, axis=1)
        return np.where(has_one, above, intercept), slope

    def _edge(self, probability: float | Array, inside: Array, outside: Array) -> Array:
        """Return the mean nearest ``outside`` at which a known A is in range with the probability."""
        kept = self.probability(outside, np.zeros_like(outside)) >= probability
        for _ in range(2 * _HALVINGS):
            middle = (inside + outside) / 2
            good = self.probability(middle, np.zeros_like(middle)) >= probability
            inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
        return np.where(kept, outside, inside)

    def _largest(self, probability: float | Array, means: Array) -> Array:
        low, high = np.zeros_like(means), np.full_like(means, self.room.total_area)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            good = self.probability(means, middle) >= probability
            low, high = np.where(good, middle, low), np.where(good, high, middle)
        return low


TANGENTS = 16
"""Tangents to the largest allowed sd, per band."""
_LOOSER = {"tol_gap_abs": 1e-6, "tol_gap_rel": 1e-6, "tol_feas": 1e-7}
"""Settings for numbers with which Clarabel makes no progress to its usual 1e-8."""
_SCS = {"eps": 1e-8, "max_iters": 100_000}
"""Settings of SCS, a first-order method, which needs many short iterations."""
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
            # Where an answer hardly exists, or hardly not, it makes no progress. SCS decides then.
            for solver, kept, settings in (
                (cp.CLARABEL, True, {}),
                (cp.CLARABEL, False, {}),
                (cp.CLARABEL, False, _LOOSER),
                (cp.SCS, False, _SCS),
            ):
                try:
                    self._problem.solve(solver=solver, warm_start=kept, **settings)
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
