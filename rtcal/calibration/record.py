"""The parts of a saved calibration: plain numbers, lists and text, ready for JSON."""

from __future__ import annotations

import functools
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET
from rtcal.acoustics.room import Room
from rtcal.calibration.certificate import Certificate
from rtcal.calibration.convex_program import RawSolution
from rtcal.calibration.measured import MeasuredTimes
from rtcal.support.files import json_numbers
from rtcal.support.types import Array
from rtcal.support.version import __version__

KIND = "calibration 1"
"""The value of the key ``rtcal`` in a saved calibration."""

_LIBRARIES = ("numpy", "scipy", "cvxpy", "clarabel", "osqp", "qpsolvers")
_BOUNDS = {-1: "lower", 0: "", 1: "upper"}


def versions() -> dict[str, str]:
    """Return the versions of rtcal, Python and the required libraries."""
    rtcal_and_python = {"rtcal": __version__, "Python": platform.python_version()}
    return rtcal_and_python | {name: _version(name) for name in _LIBRARIES}


@functools.cache
def _version(library: str) -> str:
    return metadata.version(library)  # it reads and parses a file


def inputs(room: Room, measured: MeasuredTimes) -> dict[str, Any]:
    """Return the room as TOML and the mean T as CSV; the two suffice to repeat the calibration."""
    return {
        "room": room.to_text(),
        "measured": _mean_measurement(room, measured).to_text(),
    }


def measurement(measured: MeasuredTimes) -> dict[str, Any]:
    """Return the measured T in the room's bands, and the caution about its conversion."""
    return {
        "reverberation_time": json_numbers(measured.reverberation_time),
        "uncertainty": json_numbers(measured.uncertainty),
        "parameter": list(measured.parameter),
        "bands_not_in_room": list(measured.ignored),
        "fingerprint": measured.fingerprint,
        "caution": measured.caution,
    }


def equation_parameters(equation: LinearEquation) -> dict[str, Any]:
    """Return the equation's parameters that differ from their defaults."""
    usual = asdict(type(equation)())
    return {name: value for name, value in asdict(equation).items() if value != usual[name]}


def materials(
    prior: Room,
    calibrated: Room,
    shift_in_sigmas: Array,
    interval: Sequence[Array] | None,
    active: NDArray[np.int8],
    error_bound: Array,
) -> list[dict[str, Any]]:
    """Return one entry per material; every array is (n_materials, n_bands)."""
    return [
        {
            "name": name,
            "area": float(prior.areas[i]),
            "source": prior.sources.get(name, ""),
            "alpha_before": json_numbers(prior.alpha[i]),
            "sigma_before": json_numbers(prior.sigma[i]),
            "alpha_after": json_numbers(calibrated.alpha[i]),
            "sigma_after": json_numbers(calibrated.sigma[i]),
            "interval_after": None
            if interval is None
            else [json_numbers(end[i]) for end in interval],
            "alpha_min": None if prior.alpha_min is None else json_numbers(prior.alpha_min[i]),
            "shift_in_sigmas": json_numbers(shift_in_sigmas[i]),
            "at_bound": [_BOUNDS[int(v)] for v in active[i]],
            "error_bound": json_numbers(error_bound[i]),
        }
        for i, name in enumerate(prior.materials)
    ]


def solver(name: str, raw: RawSolution, polished: bool) -> dict[str, Any]:
    """Return the solver's name, status, iterations and time, and whether polishing succeeded."""
    return {
        "name": name,
        "status": raw.status,
        "iterations": raw.iterations,
        "seconds": None if np.isnan(raw.seconds) else raw.seconds,
        "polished": polished,
        "raw_certificate": residuals(raw.certificate),
        "raw_alpha": json_numbers(raw.alpha),
    }


def residuals(certificate: Certificate) -> dict[str, list[float | None]]:
    """Return the certificate's residuals per band."""
    return {
        "primal_residual": json_numbers(certificate.primal_residual),
        "dual_residual": json_numbers(certificate.dual_residual),
        "duality_gap": json_numbers(certificate.duality_gap),
    }


def _mean_measurement(room: Room, measured: MeasuredTimes) -> Measurement:
    """Return the matched T per band as a measurement: a summary over the pairs."""
    values, uncertainty = {}, {}
    for parameter in dict.fromkeys(p for p in measured.parameter if p):
        of_parameter = np.array([p == parameter for p in measured.parameter])
        values[parameter] = np.where(of_parameter, measured.reverberation_time, np.nan)[np.newaxis]
        u = np.where(of_parameter, measured.uncertainty, np.nan)[np.newaxis]
        if np.isfinite(u).any():
            uncertainty[parameter] = u
    if not values:  # no T was matched
        values[TARGET.key] = np.full((1, room.n_bands), np.nan)
    return Measurement(
        centre_frequencies=room.centre_frequencies, values=values, uncertainty=uncertainty
    )
