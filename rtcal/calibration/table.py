"""A calibration as printed text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.quality import explained, letters
from rtcal.types import Array

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

_WIDTH = 9
_P_LIMIT = 0.05


def table(result: CalibrationResult) -> str:
    """Return the tables that ``print(result)`` shows: bands, materials, plausibility."""
    room = result.prior
    plausibility = result.plausibility
    name = max(22, *(len(m) + 11 for m in room.materials))

    def line(label: str, cells: list[str]) -> str:
        return label.ljust(name) + "".join(c.rjust(_WIDTH) for c in cells)

    def numbers(label: str, values: Array, form: str) -> str:
        return line(label, [format(v, form) if np.isfinite(v) else "-" for v in values])

    parameters = sorted({p.upper() for p in result.measured_data.parameter if p})
    mixed = []
    if len(parameters) > 1:
        mixed = [line("matched", [p.upper() or "-" for p in result.measured_data.parameter])]
    air = "no air stated"
    if room.air is not None:
        air = f"air {room.air.temperature:g} °C, {room.air.humidity:g} %"
    out = [
        f"{room.name}: {room.volume:g} m³, {room.total_area:g} m², {air}",
        f"method {result.method}, {result.equation.name}'s equation, "
        f"{' and '.join(parameters)} matched, solver {result.solver}",
        "",
        line("", [bands.label(f) for f in room.centre_frequencies]),
        *mixed,
        numbers("measured T / s", result.measured, ".3f"),
        numbers("  its uncertainty / s", result.measured_uncertainty, ".3f"),
        numbers("T before / s", result.reverberation_time_before, ".3f"),
        numbers("T after / s", result.reverberation_time_after, ".3f"),
        numbers("gap before / JND", result.gap_before, "+.1f"),
        numbers("gap after / JND", _cleaned(result.gap_after), "+.1f"),
        numbers("z", plausibility.z, "+.1f"),
        numbers("air's share / %", 100 * result.air_share, ".0f"),
        line(
            "do not trust, see below",
            [letters(result.trust_marks, f) or "." for f in room.centre_frequencies],
        ),
        "",
        "alpha after (shift in sigmas of the prior; * at a bound)",
    ]
    for i, material in enumerate(room.materials):
        marks = ["*" if bound else " " for bound in result.active[i]]
        cells = [f"{a:.3f}{m}" for a, m in zip(result.alpha[i], marks, strict=True)]
        out.append(line(f"{material}, {room.areas[i]:g} m²", cells))
        out.append(line("", [f"({s:+.1f}) " for s in _cleaned(result.shift_in_sigmas[i])]))
        out.append(line("  shift of alpha", [f"{s:+.3f} " for s in _cleaned(result.shift[i])]))
    out += ["", *_believe(result)]
    return "\n".join(out)


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
