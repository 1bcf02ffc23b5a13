"""A saved calibration: its parts, ready for JSON, and its words: the verdict, tables and remarks."""

from __future__ import annotations

import functools
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import metadata
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.marks import MET, P_CONTRADICTION, TrustMark, agreement, cautions, letters
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import TARGET, parameter_label
from rtcal.acoustics.room import Room
from rtcal.calibration.measured import MeasuredTimes
from rtcal.calibration.qp import Certificate
from rtcal.files.disk import json_numbers
from rtcal.support import __version__
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.text import as_sentence
from rtcal.support.types import Array

KIND = "calibration 1"
"""Value of the key ``rtcal`` in the file of a saved calibration."""

_LIBRARIES = ("numpy", "scipy", "cvxpy", "clarabel", "osqp")
_RESIDUALS = ("primal_residual", "dual_residual", "duality_gap")
_ENDS = {-1: "lower", 0: "", 1: "upper"}


@functools.cache  # metadata.version reads and parses a file
def versions() -> Mapping[str, str]:
    """Return the versions of rtcal, Python and the required libraries."""
    rtcal_and_python = {"rtcal": __version__, "Python": platform.python_version()}
    return rtcal_and_python | {name: metadata.version(name) for name in _LIBRARIES}


def inputs(room: Room, measured: MeasuredTimes) -> dict[str, Any]:
    """Return the room as TOML and the mean T as CSV; the two suffice to repeat the calibration."""
    values, uncertainty = {}, {}
    for parameter in dict.fromkeys(p for p in measured.parameter if p):
        of_parameter = np.array([p == parameter for p in measured.parameter])
        values[parameter] = np.where(of_parameter, measured.reverberation_time, np.nan)[np.newaxis]
        u = np.where(of_parameter, measured.uncertainty, np.nan)[np.newaxis]
        if np.isfinite(u).any():
            uncertainty[parameter] = u
    if not values:  # no T was matched
        values[TARGET.key] = np.full((1, room.n_bands), np.nan)
    frequencies = room.centre_frequencies
    mean = Measurement(centre_frequencies=frequencies, values=values, uncertainty=uncertainty)
    return {"room": room.to_text(), "measured": mean.to_text()}


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
    alpha: Array,
    sigma: Array | None,
    shift_in_sigmas: Array,
    interval: Sequence[Array] | None,
    active: NDArray[np.int8],
    error_bound: Array,
) -> list[dict[str, Any]]:
    """Return one entry per material; every array is (n_materials, n_bands)."""
    entries = coefficients(prior, alpha, sigma, interval)
    return [
        {
            "name": name,
            # Of pieces the number, by which their alpha, in m² per piece, counts as by an area.
            "area": float(prior.areas[i]),
            **({} if prior.is_surface[i] else {"piece": True}),
            "source": prior.sources.get(name, ""),
            **entries[i],
            "alpha_min": None if prior.alpha_min is None else json_numbers(prior.alpha_min[i]),
            "shift_in_sigmas": json_numbers(shift_in_sigmas[i]),
            "at_bound": [_ENDS[int(v)] for v in active[i]],
            "error_bound": json_numbers(error_bound[i]),
        }
        for i, name in enumerate(prior.materials)
    ]


def coefficients(
    prior: Room, alpha: Array, sigma: Array | None, interval: Sequence[Array] | None
) -> list[dict[str, Any]]:
    """Return coefficients and sigmas before and after with intervals, one entry per material."""
    return [
        {
            "name": name,
            "alpha_before": json_numbers(prior.alpha[i]),
            "sigma_before": json_numbers(prior.sigma[i]),
            "alpha_after": json_numbers(alpha[i]),
            "sigma_after": None if sigma is None else json_numbers(sigma[i]),
            "interval_after": interval and [json_numbers(end[i]) for end in interval],
        }
        for i, name in enumerate(prior.materials)
    ]


def residuals(certificate: Certificate) -> dict[str, float]:
    """Return the residuals of a certificate as plain numbers."""
    return {name: getattr(certificate, name) for name in _RESIDUALS}


_STRONG_SHIFT = 3.0
"""Shift (in sigmas) and deviation (in JND) at which the notebook's shading saturates."""

SIGNS = (
    "Deviation: T of the model minus measured T (1 JND is 5 % of T). Missing absorption: absorption "
    "that the measured T requires minus absorption by the input coefficients, in standard deviations."
)

_NAMES_OF_METHODS = {
    "mle": "maximum likelihood (mle)",
    "lse": "least squares (lse)",
    "soft": "soft match of T (soft)",
    "smooth": "soft match of T with smooth shifts (smooth)",
    "robust": "soft match of T with outliers (robust)",
    "joint": "soft match of T in several configurations (joint)",
    "composed": "terms composed in Python",
}
"""Methods in print, with the names that --method takes."""
_BOUNDS = {"lower": "*", "upper": "*", "": " "}
SHARE = "Share of absorption after calibration"
_LEAST_SHARE = 0.5  # share in % that is not printed as 0
_QUANTITIES = ("alpha", "absorption area of one piece / m²")
"""What is calibrated of surfaces, and of pieces such as persons."""
_SEEN = 0.05  # shift in standard deviations that is not printed as 0.0


def blocks_of(record: Mapping[str, Any]) -> list[Block]:
    """Return the parts of a calibration's output: verdict, cautions, bands, materials, and details.

    ``record`` is the calibration as `CalibrationResult.to_dict` returns it. A terminal does not show
    the details, which are the input coefficients, all changes, and the solver.
    """
    labels, materials = bands.labels(record["centre_frequencies"]), record["materials"]
    kinds = [[m for m in materials if bool(m.get("piece")) is piece] for piece in (False, True)]
    calibrated = [
        Table(
            [*labels, "largest shift / σ"],
            [
                Row(
                    m["name"],
                    [*(f"{a:.3f}{_BOUNDS[b]}" for a, b in cells), _largest_shift(m, labels)],
                )
                for m in rows
                for cells in [zip(m["alpha_after"], m["at_bound"], strict=True)]
            ],
            f"Calibrated {what} (* at a bound), and its largest shift from the input in input σ",
        )
        for what, rows in zip(_QUANTITIES, kinds, strict=True)
        if rows
    ]
    found = verdict(record)
    of_room, *others = remarks(record)
    if not record["room_taken_as_exact"]:
        of_room, others = "", [of_room, *others]
    return [
        Note(f"{found.heading}. {found.text}"),
        *map(Note, _cautions(record)),
        *map(Note, others),
        *([Note(f"Next: {found.step}")] if found.step else []),
        of_bands(record),
        *calibrated,
        *(
            Table(
                labels,
                [Row(m["name"], m["alpha_before"], ".3f") for m in rows],
                f"Input {what}",
                detail=True,
            )
            for what, rows in zip(_QUANTITIES, kinds, strict=True)
            if rows
        ),
        shifts(record),
        Note(_shares_in_words(record)),
        shares(record),
        Note(f"{_made(record)} {of_room}".strip()),
    ]


def _cautions(record: Mapping[str, Any]) -> list[str]:
    """Return the cautions, without the likely typing error that the verdict states."""
    marks = _trust_marks(record)
    first = next((mark for mark in marks if mark.is_error), None)
    return cautions([mark for mark in marks if mark is not first])


def _largest_shift(material: Mapping[str, Any], labels: Sequence[str]) -> str:
    """Return the largest shift of a material's coefficients in prior standard deviations, and where."""
    shifts = np.nan_to_num(numbers(material["shift_in_sigmas"]))
    k = int(np.argmax(np.abs(shifts)))
    return f"{shifts[k]:+.1f} at {labels[k]}" if abs(shifts[k]) >= _SEEN else "none"


def shifts(record: Mapping[str, Any]) -> Table:
    """Return the table of the change of each material's coefficients, in input sigmas, by band."""
    each = [(m["name"], numbers(m["shift_in_sigmas"])) for m in record["materials"]]
    rows = [Row(name, of, "+.1f", np.nan_to_num(of) / _STRONG_SHIFT) for name, of in each]
    title = "Shift of alpha in standard deviations (input sigma)"
    return Table(bands.labels(record["centre_frequencies"]), rows, title, "Material", detail=True)


def _made(record: Mapping[str, Any]) -> str:
    """Return the room, and how it was calibrated."""
    air = "no air"
    if record["air"] is not None:
        air = f"air {record['air']['temperature']:g} °C, {record['air']['humidity']:g} % humidity"
    area = sum(material["area"] for material in record["materials"] if not material.get("piece"))
    of_t = " and ".join(_parameters(record))
    matched = f"to {of_t}" if record["matches_measured_time"] else f"without matching {of_t}"
    method = _NAMES_OF_METHODS.get(record["method"], record["method"])
    return (
        f"{record['room']}: {record['volume']:g} m³, {area:g} m² of surfaces, {air}; calibrated "
        f"{matched} by {record['equation']}'s equation and {method}."
    )


def absorption_share(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the share of each material, of further effects and of the air in each band's absorption.

    ``record`` is the calibration as `CalibrationResult.to_dict` returns it. The entries are sorted by
    their mean over the measured bands, the largest first. The shares of a band sum to 1.
    """
    parts = [(m["name"], m["area"] * numbers(m["alpha_after"])) for m in record["materials"]]
    if any(added := record["added_absorption"]):
        parts.append(("effects: " + ", ".join(record["effects"]), numbers(added)))
    air, surfaces = numbers(record["air_share"]), np.sum([part for _, part in parts], axis=0)
    of_surfaces = (1 - air) / np.where(surfaces > 0, surfaces, 1.0)
    shares = [*((name, part * of_surfaces) for name, part in parts), ("air", air)]
    known = _known(record)
    shares.sort(key=lambda of: -np.nan_to_num(of[1])[known].sum())
    return [{"name": name, "share": json_numbers(share)} for name, share in shares]


def _known(record: Mapping[str, Any]) -> NDArray[np.bool_]:
    """Return in which bands T was measured; all others have the coefficients of the input."""
    return np.asarray(np.isfinite(numbers(record["measured"]["reverberation_time"])))


def _shares(record: Mapping[str, Any]) -> Array:
    """Return the shares of `absorption_share`, (n_shares, n_bands)."""
    return np.array([numbers(one["share"]) for one in record["absorption_share"]])


def shares(record: Mapping[str, Any]) -> Table:
    """Return the table of the shares of `absorption_share` in %."""
    of = _shares(record)
    each = zip(record["absorption_share"], whole_percents(of), of, strict=True)
    rows = [Row(one["name"], whole, ".0f", np.nan_to_num(share)) for one, whole, share in each]
    labels = bands.labels(record["centre_frequencies"])
    return Table(labels, rows, f"{SHARE} / %", "Material", detail=True)


def whole_percents(shares: Array) -> Array:
    """Return shares (n, n_bands), whose sum is 1 in each band, in whole % that sum to 100.

    The % that rounding down leaves go to the shares with the largest remainders. A band with NaN has
    NaN.

    Examples
    --------
    >>> whole_percents(np.array([[0.335], [0.335], [0.33]])).tolist()
    [[34.0], [33.0], [33.0]]
    """
    percents = 100 * shares
    whole = np.floor(percents + 1e-9)
    left = np.nan_to_num(100 - whole.sum(axis=0))
    ranks = np.argsort(np.argsort(whole - percents, axis=0, kind="stable"), axis=0)
    return np.asarray(whole + (ranks < left))


def _shares_in_words(record: Mapping[str, Any]) -> str:
    """Return the mean and the range of each share over the measured bands, the largest first."""
    shares = _shares(record)
    known = _known(record)
    shares = shares[:, np.isfinite(shares).all(axis=0) & known]
    seen = (100 * shares).max(axis=1, initial=0.0) >= _LEAST_SHARE
    if not seen.any():
        return f"{SHARE}: unknown in every band."
    shares, said = shares[seen] / shares[seen].sum(axis=0), []
    means = whole_percents(shares.mean(axis=1, keepdims=True))[:, 0]
    names = [one["name"] for one, of in zip(record["absorption_share"], seen, strict=True) if of]
    for name, mean, of in zip(names, means, 100 * shares, strict=True):
        ends = dict.fromkeys([f"{of.min():.0f}", f"{of.max():.0f}"])
        said.append(f"{name} {mean:.0f} % ({' to '.join(ends)})")
    over = "the bands" if known.all() else "the measured bands"
    return f"{SHARE}, mean over {over} (range): {', '.join(said)}."


def _parameters(record: Mapping[str, Any]) -> list[str]:
    return sorted({parameter_label(p) for p in record["measured"]["parameter"] if p})


def of_bands(record: Mapping[str, Any]) -> Table:
    """Return the table of the bands, with a row for the parameter if T20 and T30 are mixed."""
    measured, marks = record["measured"], _trust_marks(record)
    before, after = (numbers(record[f"gap_{when}_jnd"]) for when in ("before", "after"))
    rows = [
        Row("measured T / s", measured["reverberation_time"], ".3f"),
        Row("  uncertainty / s", measured["uncertainty"], ".3f"),
        Row("T of the input / s", record["reverberation_time_before"], ".3f"),
        Row("T calibrated / s", record["reverberation_time_after"], ".3f"),
        Row("deviation before / JND", before, "+.1f", np.nan_to_num(before) / _STRONG_SHIFT),
        Row("deviation after / JND", after, "+.1f", np.nan_to_num(after) / _STRONG_SHIFT),
        Row("missing absorption / σ", record["plausibility"]["z"], "+.1f"),
        Row("share of the air / %", 100 * numbers(record["air_share"]), ".0f"),
        Row("cautions", [letters(marks, f) or "." for f in record["centre_frequencies"]]),
    ]
    if len(_parameters(record)) > 1:
        rows.insert(0, Row("matched", [parameter_label(p) or "-" for p in measured["parameter"]]))
    return Table(bands.labels(record["centre_frequencies"]), rows, note=SIGNS)


def _trust_marks(record: Mapping[str, Any]) -> list[TrustMark]:
    return [TrustMark(**mark) for mark in record["trust_marks"]]


def remarks(record: Mapping[str, Any]) -> list[str]:
    """Return sentences on exact inputs, omitted bands, and bands with a missing or unreachable T."""
    measured, uncertainty = record["measured"], record.get("room_uncertainty")
    if not record["room_taken_as_exact"]:
        first = (
            f"The room is uncertain (standard deviations: {uncertainty}). T calibrated is computed "
            "with the input volume, areas and climate, not with corrected ones."
        )
    elif uncertainty:
        first = (
            "With this method volume and areas count as exact, although the room's file gives them "
            f"standard deviations: {uncertainty}."
        )
    else:
        first = "Volume and areas count as exact: the room's file gives them no uncertainty."
    if record["method"] == "lse":
        first += (
            " Least squares counts each material once, whatever its area: a surface that is divided "
            "into two materials changes the result."
        )
    nearest = "the coefficients with the nearest T were taken"
    said = [first, *(f"{sentence}; {nearest}." for sentence in record["unreachable"])]
    said += filter(None, [measured["caution"]])
    if measured["bands_not_in_room"]:
        ignored = ", ".join(bands.labels(measured["bands_not_in_room"]))
        said.append(f"Measured, but left out because the room does not have the band: {ignored}.")
    if beyond := _bands_beyond_equation(record):
        said.append(
            f"T of the input cannot be calculated at {', '.join(beyond)}: {record['equation']}'s "
            "equation does not hold for coefficients as large as these."
        )
    return said


def certificate(record: Mapping[str, Any]) -> str:
    """Return a sentence on how exactly the problem was solved."""
    worst = max(abs(record["certificate"][name]) for name in _RESIDUALS)
    bound = np.max([numbers(material["error_bound"]) for material in record["materials"]])
    return (
        f"Numerical error of alpha: at most {bound:.1e} (largest residual of the solution: "
        f"{worst:.1e})."
    )


def _bands_beyond_equation(record: Mapping[str, Any]) -> list[str]:
    """Return the bands where the equation gives no prior T although the surfaces absorb."""
    alpha = np.array([material["alpha_before"] for material in record["materials"]])
    return [
        bands.label(f)
        for f, t, column in zip(
            record["centre_frequencies"], record["reverberation_time_before"], alpha.T, strict=True
        )
        if t is None and column.any()
    ]


LARGE_GAP = 3.0
"""Deviation in JND before calibration that is clearly audible, whatever the input sigma allows."""
_AGAINST = "The measurement contradicts the input coefficients"
_ALIKE = "The measurement agrees with the input coefficients only if all of them err the same way"
_CHECK = "check the areas, the volume and the measured T; if they are right, run `rtcal find`."
_SOMETHING = "Something is missing from the model, or an input value or its sigma is wrong."
_EQUATION = "run `rtcal find`, which also tries other reverberation equations."
_OF_ROOM = ("surface", "dimensions", "wide_sigma", "equations_differ")
"""Marks of the whole room that leave open whether model and measurement agree."""


class CalibrationVerdict(NamedTuple):
    """Statement of a calibration on whether model and measurement agree.

    ``level`` is "agrees", "open" or "contradicts", ``heading`` a sentence without its full stop,
    ``text`` the reason, and ``step`` what to do next, "" for nothing.
    """

    level: Literal["agrees", "open", "contradicts"]
    heading: str
    text: str
    step: str = ""


def verdict(record: Mapping[str, Any]) -> CalibrationVerdict:
    """Return the statement of a calibration on whether model and measurement agree.

    The first that applies decides: a likely typing error; a calibration that does not use T; a
    deviation that remains after the calibration; else the agreement of the measured T with the input
    coefficients. The level is "open" in place of "agrees" if a caution is about all bands or the room.
    ``record`` is the calibration as `rtcal.calibration.CalibrationResult.to_dict` returns it.
    """
    marks = record["trust_marks"]
    if typed := [mark for mark in _trust_marks(record) if mark.is_error]:
        first, more = typed[0], ""
        if typed[1:]:
            more = (
                f" {len(typed) - 1} more of this kind {'are' if typed[2:] else 'is'} listed below."
            )
        what = "Every coefficient" if first.frequency is None else "Every coefficient of its band"
        return CalibrationVerdict(
            "contradicts",
            f"{first.as_error[:1].upper()}{first.as_error[1:]}",
            f"Check {first.checked} before anything else, and calibrate again. {what} is computed "
            f"with {'them' if first.frequency is None else 'it'}.{more}",
        )
    after = np.abs(numbers(record["gap_after_jnd"]))
    compared = np.isfinite(after)
    if not record["matches_measured_time"]:
        off = f", and T is off by up to {after[compared].max():.1f} JND" if compared.any() else ""
        return CalibrationVerdict(
            "open",
            "Nothing in this calibration requires the measured T",
            f"The coefficients follow the other terms alone{off}. Add terms.ExactMatch(), "
            "MatchWithin() or SoftMatch().",
        )
    of_materials = _of_materials(record)
    if left := _remaining_gap(record):
        fact, _, cause = left.partition(". ")
        text = f"{cause} {of_materials.heading}. {of_materials.text}"
        level: Literal["open", "contradicts"] = (
            "contradicts" if of_materials.level == "contradicts" else "open"
        )
        return of_materials._replace(level=level, heading=fact, text=text)
    f = np.asarray(record["centre_frequencies"])[compared]
    marked = {mark["frequency"] for mark in marks}
    reserved = any(mark["kind"] in _OF_ROOM for mark in marks) or marked >= set(f.tolist())
    if of_materials.level == "agrees" and reserved:
        heading = f"{of_materials.heading}, with cautions"
        return of_materials._replace(level="open", heading=heading)
    return of_materials


def _off(record: Mapping[str, Any]) -> tuple[float, str]:
    """Return the largest deviation before calibration in JND, and its words; 0 and "" without one."""
    gap = np.abs(numbers(record["gap_before_jnd"]))
    if not np.isfinite(gap).any():
        return 0.0, ""
    k = int(np.nanargmax(gap))
    before, label = (
        record["reverberation_time_before"][k],
        bands.label(record["centre_frequencies"][k]),
    )
    wanted = record["measured"]["reverberation_time"][k]
    return float(gap[k]), (
        f"With the input coefficients, {' and '.join(_parameters(record))} deviates by up to "
        f"{gap[k]:.1f} JND ({before:.2f} s instead of {wanted:.2f} s at {label})"
    )


def _chance(p: float) -> str:
    """Return a p-value as a count: "fewer than 1", "43", "more than 99" of 100 rooms."""
    return "fewer than 1" if p < 0.01 else "more than 99" if p > 0.99 else f"{100 * p:.0f}"


def _evidence(record: Mapping[str, Any]) -> str:
    """Return how many rooms deviate as much by chance, with p."""
    p = record["plausibility"]["p_value"]
    return (
        f"if they are right, {_chance(p)} of 100 rooms would deviate at least this much "
        f"(p = {p:.2g})"
    )


def _together(record: Mapping[str, Any]) -> str:
    """Return what errors in common explain of a contradiction; "" where they explain nothing."""
    p, p_together = record["plausibility"]["p_value"], record["plausibility"]["p_together"]
    if p_together is None or p_together < 2 * p:
        return ""
    return (
        f"With a possible common error of all coefficients, {_chance(p_together)} of 100 rooms would "
        f"deviate as much (p = {p_together:.2g})."
    )


def _longer(record: Mapping[str, Any]) -> str:
    """Return what it most often means that z is negative in every band with T, of at least two."""
    z = numbers(record["plausibility"]["z"])
    known = z[np.isfinite(z)]
    if len(known) < 2 or not (known < 0).all():
        return ""
    return (
        "T is longer in every band than the input coefficients give. Most often the equation then "
        "gives too short a T for this room, because its absorption is unevenly distributed or its "
        "surfaces scatter little, or handbook coefficients are too high. A wrong volume or area is "
        "rarer."
    )


def _of_materials(record: Mapping[str, Any]) -> CalibrationVerdict:
    """Return what p and z say of the materials, where the calibrated room has the measured T."""
    found = record["plausibility"]
    p, marks = found["p_value"], record["trust_marks"]
    far = [m["frequency"] for m in marks if m["kind"] == "implausible"]
    check = _CHECK if far else ""
    if not found["degrees_of_freedom"]:
        return CalibrationVerdict(
            "open", "No T was measured in a band of the model", "There is no verdict."
        )
    largest, off = _off(record)
    if p is None:
        needs = f"at {bands.hertz(far)} the measured T needs" if far else "in no band does T need"
        return CalibrationVerdict(
            "contradicts" if far else "open",
            _AGAINST if far else "There is no overall verdict",
            f"{as_sentence(needs)[:-1]} an absorption more than two standard deviations from the "
            "input. How likely such a difference is over all bands cannot be calculated, because a "
            "coefficient stands at a bound.",
            check,
        )
    agreed, chance = agreement(p, found["p_together"]), _evidence(record)
    if agreed == "too good":
        less = f"{off}. This is less than the input's standard deviations make likely: {chance}."
        if record.get("stated_by"):
            return CalibrationVerdict(
                "open",
                "The measurement agrees with coefficients that follow from a measurement of this room",
                f"{less} Small deviations are usual after a calibration or `rtcal apply`, and do not "
                "confirm the materials.",
            )
        return CalibrationVerdict(
            "open",
            "Too good to be true: the measured T is nearer to T with the input coefficients than the "
            "uncertainties of both allow",
            f"{less} Either a sigma or the uncertainty of T is too large, or T was calculated from "
            "these coefficients, or `rtcal apply` added what this T needs.",
        )
    if agreed == "contradicts" or p < P_CONTRADICTION:
        against, longer = agreed == "contradicts", _longer(record)
        said = (
            f"{off}. This is more than the input's standard deviations explain: {chance}.",
            _together(record),
            longer or _SOMETHING * against,
        )
        return CalibrationVerdict(
            "contradicts" if against else "open",
            _AGAINST if against else _ALIKE,
            " ".join(filter(None, said)),
            (_EQUATION if longer else _CHECK) * against,
        )
    within = f"{off}. The input's standard deviations explain this: {chance}."
    if largest >= LARGE_GAP:
        return CalibrationVerdict(
            "open",
            "The measurement does not contradict the input coefficients",
            f"{within} Standard deviations that allow so large a deviation do not confirm the model.",
            check,
        )
    return CalibrationVerdict(
        "open" if far else "agrees",
        "The measurement agrees with the input coefficients" + (", with exceptions" if far else ""),
        within,
        check,
    )


def numbers(values: Sequence[float | None] | Array) -> Array:
    """Return the values as an array, NaN where one is missing."""
    return np.array([np.nan if v is None else v for v in values])


def _remaining_gap(record: Mapping[str, Any]) -> str:
    """Return a sentence on bands in which the calibrated T differs from the measured T, and why."""
    after, before = (np.abs(numbers(record[key])) for key in ("gap_after_jnd", "gap_before_jnd"))
    left = after >= MET  # not where there is no T
    if not left.any() or not record["matches_measured_time"]:
        return ""
    n, count = int(left.sum()), int(np.isfinite(after).sum())
    said = (
        f"The calibrated room does not reproduce the measured T in {n} of {count} bands: "
        f"deviations of up to {after[left].max():.1f} JND remain"
    )
    grown = left & (after >= before + MET)
    if grown.any():
        said += f", in {int(grown.sum())} larger than before"
    if record["room_taken_as_exact"]:
        if record["unreachable"]:
            return f"{said}. No coefficients within their limits give the measured T."
        return (
            f"{said}. They are a compromise between the uncertainty of the measured T and the sigma of "
            "the coefficients."
        )
    uncertain = f" ({words})" if (words := record.get("room_uncertainty")) else ""
    return (
        f"{said}. The uncertainty of the room{uncertain} explains these deviations: check it first."
    )
