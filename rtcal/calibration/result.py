"""What a calibration returns: the room, how it was got, and how far to believe it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rtcal
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.quality import gap_jnd
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.calibration.certificate import Certificate, certify
from rtcal.calibration.feasibility import Unreachable
from rtcal.calibration.measured import Measured
from rtcal.calibration.twin import Multipliers, Twin
from rtcal.types import Array


@dataclass(frozen=True, eq=False)
class RawAnswer:
    """The solver's own answer, before polishing, so that a solver can be judged.

    ``alpha`` (n_materials, n_bands); ``seconds`` is the solver's own time.
    """

    twin: Twin
    alpha: Array
    multipliers: Multipliers
    status: str
    iterations: int
    seconds: float

    @cached_property
    def certificate(self) -> Certificate:
        """The raw answer's own certificate."""
        return certify(self.twin, self.alpha, self.multipliers, 1.0)


@dataclass(frozen=True)
class Plausibility:
    """Whether to believe a calibration: it always fits.

    Attributes
    ----------
    z : array (n_bands,)
        The shift of S'alpha in standard deviations of what was known; NaN where nothing was matched.
    q : float
        Sum of z².
    degrees_of_freedom : int
        One a matched band, not one a coefficient.
    p_value : float or None
        The chance of a larger q if prior and measurement are right; None where a bound is active,
        because then q is not chi-square.
    """

    z: Array
    q: float
    degrees_of_freedom: int
    p_value: float | None


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationResult:
    """A calibrated room and everything that is known of the calibration.

    Attributes
    ----------
    prior : Room
        The room as it was given.
    alpha : array (n_materials, n_bands)
        The calibrated coefficients.
    target, target_uncertainty : array (n_bands,)
        b and its standard uncertainty in m², NaN where missing.
    multipliers : array (n_bands,)
        D in 1/m²: free coefficients are mu - D S sigma² (Bellows & Katz 2025, Eq. 25).
    active : array (n_materials, n_bands) of int
        -1 at the lower bound, 1 at the upper, 0 free.
    certificate : Certificate
    raw : RawAnswer
    polished : bool
        Whether ``alpha`` is the polished answer (else the solver's own was better).
    unreachable : tuple of Unreachable
        Bands that were moved to the nearest end.
    """

    prior: Room
    equation: LinearEquation
    method: str
    solver: str
    measured_data: Measured
    alpha: Array
    target: Array
    target_uncertainty: Array
    gain_sigma: Array
    multipliers: Array
    active: NDArray[np.int8]
    certificate: Certificate
    raw: RawAnswer
    polished: bool
    unreachable: tuple[Unreachable, ...]

    @property
    def measured(self) -> Array:
        """Measured T in s, (n_bands,), NaN where missing."""
        return self.measured_data.reverberation_time

    @property
    def measured_uncertainty(self) -> Array:
        """Standard uncertainty of the measured T in s, (n_bands,), NaN where unknown."""
        return self.measured_data.uncertainty

    @property
    def matched(self) -> Array:
        """Which bands were matched, (n_bands,) of bool."""
        return np.asarray(np.isfinite(self.target))

    @cached_property
    def reverberation_time_before(self) -> Array:
        """T of the prior in s, (n_bands,)."""
        return self.equation.time(self.prior, self.prior.absorption_area)

    @cached_property
    def reverberation_time_after(self) -> Array:
        """T of the calibrated room in s, (n_bands,)."""
        return self.equation.time(self.prior, self.prior.areas @ self.alpha)

    @property
    def gap_before(self) -> Array:
        """(T of the prior - measured) in JND of 5 %, signed, (n_bands,)."""
        return gap_jnd(self.reverberation_time_before, self.measured)

    @property
    def gap_after(self) -> Array:
        """(T calibrated - measured) in JND of 5 %, signed, (n_bands,)."""
        return gap_jnd(self.reverberation_time_after, self.measured)

    @property
    def shift(self) -> Array:
        """Alpha - mu, (n_materials, n_bands)."""
        return self.alpha - self.prior.alpha

    @property
    def shift_in_sigmas(self) -> Array:
        """(alpha - mu) / sigma, (n_materials, n_bands); 0 where sigma = 0."""
        sigma = self.prior.sigma
        return np.divide(self.shift, sigma, out=np.zeros_like(sigma), where=sigma > 0)

    @cached_property
    def plausibility(self) -> Plausibility:
        """Z per band and Q over bands, with the prior's own sigma whatever the method."""
        room = self.prior
        known = np.nan_to_num(self.target_uncertainty)
        spread = np.sqrt(room.areas**2 @ room.sigma**2 + known**2)
        miss = self.target - room.absorption_area
        z = np.divide(miss, spread, out=np.full_like(miss, np.nan), where=spread > 0)
        used = np.isfinite(z)
        q = float(np.sum(z[used] ** 2))
        p_value = None
        if not self.active.any():
            from scipy.special import chdtrc

            p_value = float(chdtrc(used.sum(), q))
        return Plausibility(z, q, int(used.sum()), p_value)

    @cached_property
    def posterior_sigma(self) -> Array:
        """Standard deviation of the calibrated coefficients, (n_materials, n_bands).

        The error of a linear estimate alpha = mu + q (b - S'mu) / S'q with q = sigma² S of the
        method, for a prior with the room's sigma and a T with its uncertainty:
        var = K - 2 q S K / S'q + q² (S'KS + u_b²) / (S'q)². Bounds are not counted in.
        """
        areas = self.prior.areas[:, np.newaxis]
        prior = self.prior.sigma**2
        gain = self.gain_sigma**2 * areas
        total = np.sum(areas * gain, axis=0)
        used = self.matched & (total > 0)
        gain = np.divide(gain, total, out=np.zeros_like(gain), where=used)
        spread = np.sum(areas**2 * prior, axis=0) + np.nan_to_num(self.target_uncertainty) ** 2
        variance = prior - 2 * gain * areas * prior + gain**2 * spread
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @cached_property
    def room(self) -> Room:
        """The room with calibrated coefficients, the posterior's sigma, and the record of it."""
        record = CalibrationRecord(
            method=self.method,
            equation=self.equation.name,
            measured=self.measured_data.fingerprint,
            solver=self.solver,
            version=rtcal.__version__,
        )
        return self.prior.replace(alpha=self.alpha, sigma=self.posterior_sigma, calibration=record)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text; None where a value is missing."""
        room, plausibility = self.prior, self.plausibility
        bounds = {-1: "lower", 0: "", 1: "upper"}
        return {
            "rtcal_version": rtcal.__version__,
            "room": room.name,
            "method": self.method,
            "equation": self.equation.name,
            "volume": room.volume,
            "air": None if room.air is None else vars(room.air),
            "centre_frequencies": _listed(room.centre_frequencies),
            "measured": {
                "reverberation_time": _listed(self.measured),
                "uncertainty": _listed(self.measured_uncertainty),
                "parameter": list(self.measured_data.parameter),
                "bands_not_in_room": list(self.measured_data.ignored),
                "fingerprint": self.measured_data.fingerprint,
            },
            "reverberation_time_before": _listed(self.reverberation_time_before),
            "reverberation_time_after": _listed(self.reverberation_time_after),
            "gap_before_jnd": _listed(self.gap_before),
            "gap_after_jnd": _listed(self.gap_after),
            "target": _listed(self.target),
            "target_uncertainty": _listed(self.target_uncertainty),
            "materials": [
                {
                    "name": name,
                    "area": float(room.areas[i]),
                    "alpha_before": _listed(room.alpha[i]),
                    "sigma_before": _listed(room.sigma[i]),
                    "alpha_after": _listed(self.alpha[i]),
                    "sigma_after": _listed(self.posterior_sigma[i]),
                    "shift_in_sigmas": _listed(self.shift_in_sigmas[i]),
                    "at_bound": [bounds[int(v)] for v in self.active[i]],
                    "error_bound": _listed(self.certificate.alpha_error_bound[i]),
                }
                for i, name in enumerate(room.materials)
            ],
            "plausibility": {
                "z": _listed(plausibility.z),
                "q": plausibility.q,
                "degrees_of_freedom": plausibility.degrees_of_freedom,
                "p_value": plausibility.p_value,
            },
            "multipliers": _listed(self.multipliers),
            "unreachable": [str(u) for u in self.unreachable],
            "certificate": _certificate(self.certificate),
            "solver": {
                "name": self.solver,
                "status": self.raw.status,
                "iterations": self.raw.iterations,
                "seconds": None if np.isnan(self.raw.seconds) else self.raw.seconds,
                "polished": self.polished,
                "raw_certificate": _certificate(self.raw.certificate),
                "raw_alpha": [_listed(row) for row in self.raw.alpha],
            },
        }

    def to_json(self) -> str:
        """Return `to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def __str__(self) -> str:
        from rtcal.calibration.table import table

        return table(self)


def _listed(values: Array) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


def _certificate(certificate: Certificate) -> dict[str, list[float | None]]:
    return {
        "primal_residual": _listed(certificate.primal_residual),
        "dual_residual": _listed(certificate.dual_residual),
        "duality_gap": _listed(certificate.duality_gap),
    }
