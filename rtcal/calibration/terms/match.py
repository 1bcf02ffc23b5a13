"""Terms that tie alpha to the measured reverberation time, exactly, softly or within a tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from rtcal.acoustics.observables import TARGET
from rtcal.calibration.compiled_qp import Context
from rtcal.calibration.layout import Layout
from rtcal.calibration.problem_data import ProblemData
from rtcal.calibration.terms.base import BaseTerm, Rows, half_squares, limited
from rtcal.support import checks
from rtcal.support.errors import DataError, ModelError
from rtcal.support.kkt import Squares
from rtcal.support.types import Array

SMALLEST_UNCERTAINTY = 1e-6
"""Of T, relative. Below it the soft match dwarfs the prior, and rounding decides alpha."""


@dataclass(frozen=True)
class ExactMatch:
    """S'alpha = b in every band that has a measured T (Bellows & Katz 2025, Eq. 4).

    When to use it: as the paper does, or when the uncertainty of T is not known. It forces the
    noise of T into alpha; `SoftMatch` does not.
    """

    def constraints(self, context: Context) -> list[tuple[Any, int]]:
        """One equality per band, scaled by k = |S sigma| so that all bands weigh alike."""
        rows, columns, n_rows = context.match_pattern()

        def compute(data: ProblemData) -> tuple[Array, Array]:
            scale = self.row_scale(data)
            values = match_values(data) * scale[rows]
            target = np.where(data.matched, data.target, 0.0).ravel()
            return values, -target * scale

        return [(context.affine(rows, columns, n_rows, compute).expression == 0, 1)]

    def row_scale(self, data: ProblemData) -> Array:
        """Return 1 / |S sigma| over the unknowns that can move; 0 where there is no row."""
        return data.match_scale

    def rows(self, data: ProblemData) -> Rows:
        """S'alpha = b; bands without T have a row of zeros without limits."""
        low, high = (
            np.where(data.matched, v, e).ravel()
            for v, e in zip(self.target_limits(data), (-np.inf, np.inf), strict=True)
        )
        return Rows(data.match_rows, low, high)

    def target_limits(self, data: ProblemData) -> tuple[Array, Array]:
        """Return b as lower and upper limit: an equality."""
        return data.target, data.target

    def label(self, row: int, layout: Layout) -> str:
        """Return the band that a row matches."""
        return f"exact match of T at {layout.band_label(row)} (m² of absorption)"


@dataclass(frozen=True)
class MatchWithin:
    """|T - T measured| <= tolerance, in just noticeable differences of 5 %.

    When to use it: when nobody would hear a smaller gap, so that coefficients should not move for
    it. The answer is the nearest to the prior that is within the tolerance. A tolerance of 0 is
    `ExactMatch`.

    Parameters
    ----------
    jnd : float
        0 or more, below 20 (where T would have to be 0).
    """

    jnd: float = 1.0

    def __post_init__(self) -> None:
        checks.number("MatchWithin: jnd", self.jnd, ModelError)
        if not 0 <= self.jnd < 1 / TARGET.jnd:
            raise ModelError(f"MatchWithin({self.jnd:g}): the tolerance must be from 0 to below 20")

    @property
    def sides(self) -> tuple[bool, bool]:
        """There is both a lower and an upper limit."""
        return True, True

    def constraints(self, context: Context) -> list[tuple[Any, int]]:
        """Two inequalities per band, or one equality if the tolerance is 0."""
        if self.jnd == 0:
            return ExactMatch().constraints(context)
        rows, columns, n_rows = context.match_pattern()
        return limited(context, rows, columns, n_rows, self)

    def coefficients(self, data: ProblemData) -> Array:
        """Return S."""
        return match_values(data)

    def limits(self, data: ProblemData) -> tuple[Array, Array]:
        """Return the least and the most S'alpha, flattened; without limit where T is missing."""
        low, high = self.target_limits(data)
        matched = data.matched
        return (
            np.where(matched, low, -np.inf).ravel(),
            np.where(matched, high, np.inf).ravel(),
        )

    def target_limits(self, data: ProblemData) -> tuple[Array, Array]:
        """Return b of the longest and of the shortest T in the tolerance.

        A target that was moved to the end of its reach widens the tolerance to that end.
        """
        if self.jnd == 0:
            return data.target, data.target
        tolerance = TARGET.jnd * self.jnd
        low = data.target_of(data.time * (1 + tolerance))
        high = data.target_of(data.time * (1 - tolerance))
        # A T so short that no b gives it: the equation's largest b is the limit.
        high = np.where(np.isfinite(data.time) & np.isnan(high), data.largest_target, high)
        return np.fmin(low, data.target), np.fmax(high, data.target)

    def row_scale(self, data: ProblemData) -> Array:
        """Return 1 / |S sigma| over the unknowns that can move; 0 where there is no row."""
        return data.match_scale

    def rows(self, data: ProblemData) -> Rows:
        """Lower <= S'alpha <= upper; bands without T have a row of zeros without limits."""
        return Rows(data.match_rows, *self.limits(data))

    def label(self, row: int, layout: Layout) -> str:
        """Return the band that a row matches."""
        return f"match of T within {self.jnd:g} JND at {layout.band_label(row)} (m² of absorption)"


@dataclass(frozen=True)
class SoftMatch(BaseTerm):
    """½ sum ((S'alpha - b) / u_b)²: match T as far as its own uncertainty deserves.

    u_b = |db/dT| u_T. docs/modelling.md compares it with other terms.

    When to use it: whenever the uncertainty of T is known, or can be stated; with several
    configurations always. It keeps the noise of T out of alpha. Weight 1 is the right one: then
    with `PriorDeviation` the answer is the most probable one.

    Parameters
    ----------
    relative : float, optional
        u_T / T, at most 1, for bands whose measurement states no uncertainty. Without it those are
        refused.
    """

    relative: float | None = None

    def __post_init__(self) -> None:
        if self.relative is not None:
            relative = checks.number("SoftMatch: relative", self.relative, ModelError)
            if not 0 < relative <= 1:
                percent = ": is it in percent?" if 1 < relative <= 100 else ""
                raise ModelError(
                    f"SoftMatch(relative={relative:g}): it is not above 0 and at most 1{percent}"
                )

    def uncertainty(self, data: ProblemData) -> Array:
        """Return u_b in m², (n_configurations, n_bands); DataError where it is none."""
        u = data.target_uncertainty
        unknown = data.matched & ~np.isfinite(u)
        if self.relative is not None and unknown.any():
            u = np.where(unknown, self.relative * data.time * data.target_sensitivity, u)
        if (endless := data.matched & np.isinf(u)).any():
            row = int(np.flatnonzero(endless.ravel())[0])
            raise DataError(
                f"T[{data.layout.band_label(row)}] = {data.time.ravel()[row]:.4g} s is the shortest "
                "that the equation gives: there T does not determine the absorption. Take another "
                "equation, or leave out the band"
            )
        bad = data.matched & ~(u > 0)
        if bad.any():
            row = int(np.flatnonzero(bad.ravel())[0])
            raise DataError(
                f"u_T[{data.layout.band_label(row)}] is unknown or 0, and {type(self).__name__} weighs "
                "by it: state it in the measurement, or leave out what is 0 and give "
                f"{type(self).__name__}(relative=...), as the methods do"
            )
        exact = data.matched & (u < SMALLEST_UNCERTAINTY * np.abs(data.target))
        if exact.any():
            row = int(np.flatnonzero(exact.ravel())[0])
            raise DataError(
                f"u_T[{data.layout.band_label(row)}] is below a millionth of T, which no measurement "
                "reaches: state it as measured, or leave it out and take method mle"
            )
        return np.where(data.matched, u, np.nan)

    def expression(self, context: Context, weight: int) -> Any:
        """½ |w^½ (S'alpha - b) / u_b|²."""
        rows, columns, n_rows = context.match_pattern()

        def compute(data: ProblemData) -> tuple[Array, Array]:
            u = self.uncertainty(data).ravel()
            steep = np.where(np.isfinite(u), np.sqrt(data.weights[weight]) / u, 0.0)
            target = np.where(data.matched, data.target, 0.0).ravel()
            return match_values(data) * steep[rows], -target * steep

        return half_squares(context.affine(rows, columns, n_rows, compute).expression)

    def value(self, u: Array, data: ProblemData) -> float:
        """Return ½ sum ((S'alpha - b) / u_b)²."""
        return 0.5 * float(np.nansum(self._residual(u, data) ** 2))

    def gradient(self, u: Array, data: ProblemData) -> Array:
        """Return S (S'alpha - b) / u_b²."""
        return np.asarray(
            data.match_rows.T @ np.where(data.matched, self.pull(u, data), 0.0).ravel()
        )

    def pull(self, u: Array, data: ProblemData) -> Array:
        """Return (S'alpha - b) / u_b² in 1/m², (n_configurations, n_bands), NaN without T."""
        return self._residual(u, data) / self.uncertainty(data)

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return S S' / u_b², which couples the materials of a band."""
        steep = np.where(data.matched, 1 / self.uncertainty(data), 0.0).ravel()
        rows = data.match_rows
        if sp.issparse(rows):
            return Squares(sp.csr_array(sp.diags_array(steep) @ rows))
        return Squares(steep[:, np.newaxis] * rows)

    def _residual(self, u: Array, data: ProblemData) -> Array:
        return (data.absorption_area(u) - data.target) / self.uncertainty(data)


@dataclass(frozen=True)
class RoomMatch(SoftMatch):
    """½ r'C⁻¹r, r = b - S'alpha: match T as far as T, volume, areas and climate deserve.

    C is the covariance of r over all bands: u_b² on its diagonal, and what the room states of its
    volume, areas and climate (`rtcal.acoustics.room_errors.target_changes`). It is the QP with
    A_ik = alpha_ik S_i, every S_i and the volume unknown and shared by all bands, after these are
    minimised out. Eyring's and Kuttruff's b is linearised in them (docs/uncertain_room.md).

    When to use it: when the room states a ``volume_sigma``, an ``area_sigma`` or a ``climate_sigma``;
    `rtcal.calibrate` then uses it for every method but ``lse``. An error of the volume then changes
    all bands alike, and goes less into the coefficients.

    Parameters
    ----------
    relative : float, optional
        As for `SoftMatch`.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> objective = rt.terms.PriorDeviation() + RoomMatch()
    >>> problem = rt.Calibration(objective).build(room.replace(volume_sigma=0.05))
    >>> problem.solve(measured).gap_after.round(1)
    array([1.9, 0.3, 0.4, 0.4, 0.4, 0.3])
    """

    def expression(self, context: Context, weight: int) -> Any:
        """½ |w^½ W (S'alpha - b)|², W'W = C⁻¹ with W lower triangular."""
        rows, columns, n_rows = context.match_pattern()
        own = np.zeros((n_rows, context.size), dtype=bool)
        own[rows, columns] = True
        rows, columns = np.nonzero(np.logical_or.accumulate(own))

        def compute(data: ProblemData) -> tuple[Array, Array]:
            whitener = np.sqrt(data.weights[weight]) * data.match_whitener
            target = np.where(data.matched, data.target, 0.0).ravel()
            return (whitener @ data.match_rows)[rows, columns], -(whitener @ target)

        return half_squares(context.affine(rows, columns, n_rows, compute).expression)

    def value(self, u: Array, data: ProblemData) -> float:
        """Return ½ r'C⁻¹r."""
        return 0.5 * float(np.sum((data.match_whitener @ self._difference(u, data)) ** 2))

    def pull(self, u: Array, data: ProblemData) -> Array:
        """Return C⁻¹(S'alpha - b) in 1/m², (n_configurations, n_bands), NaN without T."""
        whitener = data.match_whitener
        pull = whitener.T @ (whitener @ self._difference(u, data))
        return np.where(data.matched, pull.reshape(data.matched.shape), np.nan)

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return S C⁻¹ S', which couples all matched bands."""
        rows = data.match_rows
        together = data.match_whitener @ rows
        return Squares(sp.csr_array(together) if sp.issparse(rows) else together)

    def _difference(self, u: Array, data: ProblemData) -> Array:
        """S'alpha - b in m², (n_matches,), 0 without T."""
        return np.where(data.matched, data.absorption_area(u) - data.target, 0.0).ravel()


@dataclass(frozen=True)
class AddedAbsorption(BaseTerm):
    """A further unknown theta >= 0: an effect that adds theta times its gain to S'alpha.

    ½ ((theta - mean) / sigma)² is its prior in the objective (docs/modelling.md).

    When to use it: when something other than the listed surfaces absorbs (an opening, furniture, an
    audience) and its spectrum is known but not its amount. theta comes out beside alpha.

    Parameters
    ----------
    name : str
    gain : sequence (n_bands,) or (n_configurations, n_bands)
        m² of absorption that theta = 1 adds in each band.
    sigma : float
        Prior standard deviation of theta, above 0.
    mean : float
        Prior mean of theta.
    """

    name: str
    gain: Sequence[Any]
    sigma: float
    mean: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ModelError(f"AddedAbsorption: name = {self.name!r} is not a text")
        for what in ("sigma", "mean"):
            checks.number(
                f'AddedAbsorption("{self.name}"): {what}', getattr(self, what), ModelError
            )
        if not (np.isfinite(self.sigma) and self.sigma > 0 and np.isfinite(self.mean)):
            raise ModelError(
                f'AddedAbsorption("{self.name}"): sigma = {self.sigma:g} must be finite and above '
                f"0, mean = {self.mean:g} finite"
            )
        gain = checks.array(f'AddedAbsorption("{self.name}"): gain', self.gain, ModelError)
        if gain.ndim not in (1, 2) or not np.isfinite(gain).all():
            raise ModelError(f'AddedAbsorption("{self.name}"): gain is not finite numbers by band')
        frozen: Any = tuple(map(tuple, np.atleast_2d(gain).tolist()))
        object.__setattr__(self, "gain", frozen)

    def gains(self, n_configurations: int, n_bands: int) -> Array:
        """Return the gain by configuration and band in m²; ModelError if it does not fit."""
        gain = np.array(self.gain)
        if gain.shape[1] != n_bands or gain.shape[0] not in (1, n_configurations):
            raise ModelError(
                f'AddedAbsorption("{self.name}"): gain has shape {gain.shape}; there are '
                f"{n_configurations} configurations and {n_bands} bands"
            )
        return np.broadcast_to(gain, (n_configurations, n_bands))

    def expression(self, context: Context, weight: int) -> Any:
        """½ |w^½ (theta - mean) / sigma|²."""
        place = np.array([self._place(context.layout)])

        def compute(data: ProblemData) -> tuple[Array, Array]:
            steep = np.sqrt(data.weights[weight]) / data.sigma[place]
            return steep, -data.mu[place] * steep

        return half_squares(context.affine(np.array([0]), place, 1, compute).expression)

    def compiled_as(self) -> AddedAbsorption:
        """Return an effect of the same name: gain, sigma and mean are the compiled problem's data."""
        return AddedAbsorption(self.name, [0.0], sigma=1.0)

    def value(self, u: Array, data: ProblemData) -> float:
        """Return ½ ((theta - mean) / sigma)²."""
        return 0.5 * float(((u[self._place(data.layout)] - self.mean) / self.sigma) ** 2)

    def gradient(self, u: Array, data: ProblemData) -> Array:
        """Return (theta - mean) / sigma² at theta's place."""
        gradient = np.zeros_like(u)
        place = self._place(data.layout)
        gradient[place] = (u[place] - self.mean) / self.sigma**2
        return gradient

    def curvature(self, u: Array, data: ProblemData) -> Any:
        """Return 1 / sigma² at theta's place: a diagonal."""
        return self.convexity(data) / self.sigma**2

    def convexity(self, data: ProblemData) -> Array:
        """Return 1 at theta's place."""
        m = np.zeros(data.layout.size)
        m[self._place(data.layout)] = 1.0
        return m

    def _place(self, layout: Layout) -> int:
        return layout.n_alpha + layout.further.index(self.name)


def match_values(data: ProblemData) -> Array:
    """Coefficients of the unknowns in S'alpha, in the order of `Context.match_pattern`."""
    matched = data.matched[:, np.newaxis, :]
    values = np.where(matched, data.areas[:, :, np.newaxis], 0.0).ravel()
    if not data.gains.size:
        return values
    gains = np.swapaxes(data.gains, 1, 2)
    return np.concatenate([values, np.where(matched, gains, 0.0).ravel()])


def match_matrix(data: ProblemData) -> Any:
    """Return S' as a sparse matrix, one row per configuration and band, over the unknowns."""
    return sp.csr_array(data.match_rows)
