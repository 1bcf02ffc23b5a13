"""A calibration as plain numbers, lists and text: what is saved, and what the page is made of."""

from __future__ import annotations

import platform
from dataclasses import asdict
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.calibration.certificate import Certificate
from rtcal.support.files import json_numbers
from rtcal.support.version import __version__

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

KIND = "calibration 1"
"""What the key ``rtcal`` of a saved calibration says."""

_LIBRARIES = ("numpy", "scipy", "cvxpy", "clarabel", "osqp", "qpsolvers")


def record(result: CalibrationResult) -> dict[str, Any]:
    """Return everything that is known of a calibration, JSON-able; None where a value is missing.

    ``inputs`` holds the room and the mean T with its uncertainty as the texts of their files: with
    them the calibration can be done again from the record alone.
    """
    room, plausible, model = result.prior, result.plausibility, result.joint.solution.model
    return {
        "rtcal": KIND,
        "versions": versions(),
        "room": room.name,
        "method": result.method,
        "equation": result.equation.name,
        "equation_parameters": _own_parameters(result.equation),
        "objective": [repr(term) for term in model.objective.terms],
        "constraints": [repr(row) for row in model.row_constraints],
        "volume": room.volume,
        "air": None if room.air is None else vars(room.air),
        "centre_frequencies": json_numbers(room.centre_frequencies),
        "measured": {
            "reverberation_time": json_numbers(result.measured),
            "uncertainty": json_numbers(result.measured_uncertainty),
            "parameter": list(result.measured_data.parameter),
            "bands_not_in_room": list(result.measured_data.ignored),
            "fingerprint": result.measured_data.fingerprint,
            "caution": result.measured_data.caution,
        },
        "reverberation_time_before": json_numbers(result.reverberation_time_before),
        "reverberation_time_after": json_numbers(result.reverberation_time_after),
        "gap_before_jnd": json_numbers(result.gap_before),
        "gap_after_jnd": json_numbers(result.gap_after),
        "target": json_numbers(result.target),
        "target_uncertainty": json_numbers(result.target_uncertainty),
        "materials": _materials(result),
        "material_correlation": [
            {"materials": list(pair), "value": value}
            for pair, value in room.material_correlation.items()
        ],
        "band_correlation": room.band_correlation,
        "plausibility": {
            "z": json_numbers(plausible.z),
            "q": plausible.q,
            "degrees_of_freedom": plausible.degrees_of_freedom,
            "p_value": plausible.p_value,
        },
        "effects": result.effects,
        "added_absorption": json_numbers(result.added_absorption),
        "air_share": json_numbers(result.air_share),
        "trust_marks": [vars(mark) for mark in result.trust_marks],
        "multipliers": json_numbers(result.multipliers),
        "unreachable": [str(u) for u in result.unreachable],
        "certificate": _certificate(result.certificate),
        "solver": {
            "name": result.solver,
            "status": result.raw.status,
            "iterations": result.raw.iterations,
            "seconds": None if np.isnan(result.raw.seconds) else result.raw.seconds,
            "polished": result.polished,
            "raw_certificate": _certificate(result.raw.certificate),
            "raw_alpha": json_numbers(result.raw.alpha),
        },
        "inputs": {
            "room": room.to_text(),
            "measured": _means(result).to_text(),
        },
    }


def versions() -> dict[str, str]:
    """Return the versions of rtcal, Python and the required libraries."""
    found = {"rtcal": __version__, "Python": platform.python_version()}
    return found | {name: metadata.version(name) for name in _LIBRARIES}


def _own_parameters(equation: LinearEquation) -> dict[str, Any]:
    """The equation's parameters that are not the usual ones."""
    usual = asdict(type(equation)())
    return {name: value for name, value in asdict(equation).items() if value != usual[name]}


def _materials(result: CalibrationResult) -> list[dict[str, Any]]:
    room, bounds = result.prior, {-1: "lower", 0: "", 1: "upper"}
    interval = result.interval
    return [
        {
            "name": name,
            "area": float(room.areas[i]),
            "source": room.sources.get(name, ""),
            "alpha_before": json_numbers(room.alpha[i]),
            "sigma_before": json_numbers(room.sigma[i]),
            "alpha_after": json_numbers(result.alpha[i]),
            "sigma_after": json_numbers(result.posterior_sigma[i]),
            "interval_after": None
            if interval is None
            else [json_numbers(end[i]) for end in interval],
            "alpha_min": None if room.alpha_min is None else json_numbers(room.alpha_min[i]),
            "shift_in_sigmas": json_numbers(result.shift_in_sigmas[i]),
            "at_bound": [bounds[int(v)] for v in result.active[i]],
            "error_bound": json_numbers(result.certificate.alpha_error_bound[i]),
        }
        for i, name in enumerate(room.materials)
    ]


def _means(result: CalibrationResult) -> Measurement:
    """The T that was matched, band by band, as a measurement: a summary over the pairs."""
    data = result.measured_data
    found = {}
    for parameter in dict.fromkeys(p for p in data.parameter if p):
        here = np.array([p == parameter for p in data.parameter])
        found[parameter] = [
            np.where(here, values, np.nan)[np.newaxis]
            for values in (data.reverberation_time, data.uncertainty)
        ]
    return Measurement(
        centre_frequencies=result.prior.centre_frequencies,
        values={p: mean for p, (mean, _) in found.items()},
        uncertainty={p: u for p, (_, u) in found.items() if np.isfinite(u).any()},
    )


def _certificate(certificate: Certificate) -> dict[str, list[float | None]]:
    return {
        "primal_residual": json_numbers(certificate.primal_residual),
        "dual_residual": json_numbers(certificate.dual_residual),
        "duality_gap": json_numbers(certificate.duality_gap),
    }
