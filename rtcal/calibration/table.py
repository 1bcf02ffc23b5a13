"""A calibration as printed text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.quality import explained, letters
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

Row = tuple[str, list[str]]

_WIDTH = 9
_COLUMNS = 8  # bands side by side: a page of about 100 characters
_P_LIMIT = 0.05


def table(result: CalibrationResult) -> str:
    """Return the tables that ``print(result)`` shows: bands, materials, plausibility."""
    room = result.prior
    parameters = sorted({p.upper() for p in result.measured_data.parameter if p})
    air = "no air stated"
    if room.air is not None:
        air = f"air {room.air.temperature:g} °C, {room.air.humidity:g} %"
    matched = "matched" if result.joint.asks_for_measured_time else "NOT matched"
    header = ("", [bands.label(f) for f in room.centre_frequencies])
    alphas = _material_rows(result)
    width = max(24, *(len(label) for label, _ in alphas))
    if room.n_bands > _COLUMNS:
        alphas.insert(0, header)
    return "\n".join(
        [
            f"{room.name}: {room.volume:g} m³, {room.total_area:g} m², {air}",
            f"method {result.method}, {result.equation.name}'s equation, "
            f"{' and '.join(parameters)} {matched}, solver {result.solver}",
            "",
            *_blocks([header, *_band_rows(result, mixed=len(parameters) > 1)], width),
            "alpha after (shift in sigmas of the prior; * at a bound)",
            *_blocks(alphas, width),
            *_believe(result),
        ]
    )


def _blocks(rows: list[Row], width: int) -> list[str]:
    """The rows as lines, so many bands side by side, and an empty line after each block."""
    out = []
    for start in range(0, len(rows[0][1]), _COLUMNS):
        for label, cells in rows:
            shown = cells[start : start + _COLUMNS]
            out.append(label.ljust(width) + "".join(c.rjust(_WIDTH) for c in shown))
        out.append("")
    return out


def _band_rows(result: CalibrationResult, mixed: bool) -> list[Row]:
    """One row for each thing told of the bands; with ``mixed``, which parameter was matched."""

    def numbers(label: str, values: Array, form: str) -> Row:
        return label, [format(v, form) if np.isfinite(v) else "-" for v in values]

    marks = [letters(result.trust_marks, f) or "." for f in result.prior.centre_frequencies]
    matched = [p.upper() or "-" for p in result.measured_data.parameter]
    return [
        *([("matched", matched)] if mixed else []),
        numbers("measured T / s", result.measured, ".3f"),
        numbers("  its uncertainty / s", result.measured_uncertainty, ".3f"),
        numbers("T before / s", result.reverberation_time_before, ".3f"),
        numbers("T after / s", result.reverberation_time_after, ".3f"),
        numbers("gap before / JND", result.gap_before, "+.1f"),
        numbers("gap after / JND", _cleaned(result.gap_after), "+.1f"),
        numbers("z", result.plausibility.z, "+.1f"),
        numbers("air's share / %", 100 * result.air_share, ".0f"),
        ("do not trust, see below", marks),
    ]


def _material_rows(result: CalibrationResult) -> list[Row]:
    """Three rows a material: alpha, its shift in sigmas, its shift."""
    room, rows = result.prior, []
    for i, material in enumerate(room.materials):
        marks = ["*" if bound else " " for bound in result.active[i]]
        alphas = [f"{a:.3f}{m}" for a, m in zip(result.alpha[i], marks, strict=True)]
        rows += [
            (f"{material}, {room.areas[i]:g} m²", alphas),
            ("", [f"({s:+.1f}) " for s in _cleaned(result.shift_in_sigmas[i])]),
            ("  shift of alpha", [f"{s:+.3f} " for s in _cleaned(result.shift[i])]),
        ]
    return rows


def _cleaned(values: Array) -> Array:
    """Rounding residue printed as plain 0."""
    return np.where(np.abs(values) < 1e-9, 0.0, values)


def _believe(result: CalibrationResult) -> list[str]:
    """The sentences below the tables: whether to believe it, and what could not be met."""
    plausibility = result.plausibility
    degrees = plausibility.degrees_of_freedom
    text = f"Plausibility: Q = {plausibility.q:.1f} with {degrees} degrees of freedom"
    if plausibility.p_value is None:
        out = [text + "; no p-value, because a bound is active."]
    elif plausibility.p_value < _P_LIMIT:
        out = [
            text + f", p = {plausibility.p_value:.2g}: the measurement contradicts what was stated "
            "of the materials. It fits all the same; do not take the fit for proof."
        ]
    else:
        out = [text + f", p = {plausibility.p_value:.2g}: in keeping with what was stated."]
    if not result.joint.asks_for_measured_time:
        out.append(
            "Nothing in this calibration asks for the measured T: the coefficients follow the other "
            "terms alone. Add terms.ExactMatch(), MatchWithin() or SoftMatch()."
        )
    out += [f"  {u} (nearest end taken)" for u in result.unreachable]
    if result.measured_data.caution:
        out.append(f"  {result.measured_data.caution}")
    if result.measured_data.ignored:
        ignored = ", ".join(bands.label(f) for f in result.measured_data.ignored)
        out.append(f"  measured, but no band of the room: {ignored}")
    if result.trust_marks:
        out += ["Where not to believe it, and what to do:"]
        out += [f"  {text}" for text in explained(result.trust_marks)]
    certificate = result.certificate
    out.append(
        f"Certificate: primal residual {np.max(certificate.primal_residual):.1e}, dual residual "
        f"{np.max(certificate.dual_residual):.1e}, gap {np.max(certificate.duality_gap):.1e}; "
        f"alpha within {np.max(certificate.alpha_error_bound):.1e} of the optimum."
    )
    return out
