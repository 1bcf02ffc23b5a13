"""The gap between model and measurement in JND: its plausibility, and what takes up its rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rtcal.acoustics import bands
from rtcal.acoustics.observables import TARGET, observable
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence
from rtcal.support.types import Array

__all__ = ["Plausibility", "agreement", "gap_jnd", "plausibility"]

__dir__ = __all__.copy


def gap_jnd(model: Array, measured: Array, parameter: str = TARGET.key) -> Array:
    """Return (model - measured) in JND, signed, same shape; NaN where either is missing.

    One JND of a decay time is 5 % of the measured one (ISO 3382-1:2009, Table A.1).

    Examples
    --------
    >>> print(gap_jnd(np.array([1.05, 0.9]), np.array([1.0, 1.0])).round(6))
    [ 1. -2.]
    """
    unit_of = observable(parameter).jnd_of
    model, measured = checks.array("model", model), checks.array("measured", measured)
    return np.asarray((model - measured) / unit_of(measured))


def rms(values: Array, axis: int | tuple[int, ...] | None = None) -> Any:
    """Return the root mean square over some axes of what is known; NaN where nothing is."""
    known = np.isfinite(values)
    squares = np.where(known, values, 0.0) ** 2
    with np.errstate(invalid="ignore"):
        return np.sqrt(squares.sum(axis=axis) / known.sum(axis=axis))


MET = 0.5
"""Gap in JND below which the words count the measured T as met: half of what can be heard."""
P_CONTRADICTION = 0.05
"""Below this p-value, prior and measurement contradict each other: the usual level of 5 %."""
LARGE_Z = 2.0
"""z of a band that contradicts what was stated of the materials."""
P_TOO_GOOD = 0.99
"""Above this p-value, prior and measurement agree too well to be true.

If prior and measurement are right, the p-value is uniform, so 1 room in 100 is marked by chance. If
all standard deviations are f times too large, P(chi² < f² chi²_0.01) of the rooms are marked. In
six octaves these are 25 % for f = 2 and 75 % for f = 3, in 18 thirds 94 % for f = 2."""


@dataclass(frozen=True, eq=False)
class Plausibility:
    """Whether prior and measurement agree. The gap does not show it, since a calibration closes it.

    Attributes
    ----------
    z : array (n_bands,)
        b - S'mu over its standard deviation; NaN where nothing was matched.
    q : float
        z'R^-1 z, R the correlation of z between bands; the sum of z² where the bands are independent.
    degrees_of_freedom : int
        One per matched band, not one per coefficient.
    p_value : float or None
        The probability of a larger q if prior and measurement are right. None where a bound is
        active, because then q is not chi-square.
    p_together : float or None
        The same if the coefficients may also be off together, as `rtcal.finder` assumes
        (`rtcal.acoustics.room_errors`). None where these errors are not known.
    """

    z: Array
    q: float
    degrees_of_freedom: int
    p_value: float | None
    p_together: float | None = None

    @property
    def agreement(self) -> Agreement | None:
        """The agreement that the p-values show: see `agreement`."""
        return agreement(self.p_value, self.p_together)


Agreement = Literal["contradicts", "agrees", "too good"]


def agreement(p_value: float | None, p_together: float | None = None) -> Agreement | None:
    """Return whether measurement and prior contradict, agree, or agree too well to be true.

    Too well: S'mu is nearer to b than the stated uncertainties make likely. Then a sigma or u_T is
    too large, or T was calculated from these coefficients. None without a p-value. What coefficients
    that are off together explain (``p_together``, of `Plausibility`) is no contradiction.

    Examples
    --------
    >>> agreement(0.001), agreement(0.4), agreement(1.0)
    ('contradicts', 'agrees', 'too good')
    >>> agreement(0.001, 0.2)
    'agrees'
    """
    if p_value is None:
        return None
    if max(p_value, p_together or 0.0) < P_CONTRADICTION:
        return "contradicts"
    return "too good" if p_value > P_TOO_GOOD else "agrees"


def together_in_words(p_value: float, p_together: float | None) -> str:
    """Return the sentence on errors that coefficients have in common; "" where they change little.

    Examples
    --------
    >>> print(together_in_words(1.7e-5, 0.011))
    If all handbook values may be off by a common factor, p = 0.011. `rtcal find` also allows for \
errors of the equation and of the measurement.
    >>> together_in_words(0.001, None)
    ''
    """
    if p_together is None or p_together < 2 * p_value:
        return ""
    return (
        f"If all handbook values may be off by a common factor, p = {p_together:.2g}. `rtcal find` "
        "also allows for errors of the equation and of the measurement."
    )


LARGE_GAP = 3.0
"""A gap before calibration, in JND, that anyone hears. Agreement says little where it is allowed."""


def weak_agreement(gap_before: ArrayLike) -> str:
    """Return the reservation of an agreement in spite of large gaps (n_bands,); "" without one.

    Examples
    --------
    >>> print(weak_agreement([0.5, -6.6]))
    The stated uncertainty allows even the gap of 6.6 JND before, so this does not confirm the model.
    """
    gap = np.abs(np.asarray(gap_before, dtype=float))
    largest = float(np.max(gap, where=np.isfinite(gap), initial=0.0))
    if largest < LARGE_GAP:
        return ""
    return (
        f"The stated uncertainty allows even the gap of {largest:.1f} JND before, so this does not "
        "confirm the model."
    )


def plausibility(
    difference: Array, covariance: Array, bound_active: bool, together: Array | None = None
) -> Plausibility:
    """Return z per band and Q over bands.

    Parameters
    ----------
    difference : array (n_bands,)
        b - S'mu in m², NaN where nothing was measured.
    covariance : array (n_bands, n_bands)
        Covariance of ``difference``, if prior and measurement are right.
    bound_active : bool
        Whether a coefficient stands at a bound: then there is no p-value.
    together : array (n_errors, n_bands), optional
        Changes of ``difference`` by one standard deviation each of what coefficients are off by
        together.

    Raises
    ------
    DataError
        If the covariance is not finite or of another size.

    Examples
    --------
    >>> result = plausibility(np.array([2.0, np.nan]), np.eye(2), bound_active=False)
    >>> result.q, result.degrees_of_freedom, round(result.p_value, 4)
    (4.0, 1, 0.0455)
    """
    difference, covariance = (
        checks.array("difference", difference),
        checks.array("covariance", covariance),
    )
    n = difference.size
    if difference.shape != (n,) or covariance.shape != (n, n):
        raise DataError(
            f"difference has shape {difference.shape} and covariance {covariance.shape}; they are "
            "(n_bands,) and (n_bands, n_bands)"
        )
    if not np.isfinite(covariance).all():
        raise DataError("covariance has a value that is not finite: is a sigma far too large?")
    spread = np.sqrt(np.diag(covariance))
    used = np.isfinite(difference) & (spread > 0)
    z = np.full(n, np.nan)
    z[used] = difference[used] / spread[used]
    count, p_value, p_together = int(used.sum()), None, None
    q = _chi_square(difference[used], covariance[np.ix_(used, used)])
    if not bound_active and count:
        from scipy.special import chdtrc

        p_value = float(chdtrc(count, q))
        if together is not None:
            together = checks.array("together", together)
            if together.shape[1:] != (n,):
                raise DataError(f"together has shape {together.shape}, not (n_errors, n_bands)")
            wider = (covariance + together.T @ together)[np.ix_(used, used)]
            p_together = float(chdtrc(count, _chi_square(difference[used], wider)))
    return Plausibility(z, q, count, p_value, p_together)


def _chi_square(difference: Array, covariance: Array) -> float:
    """Return d'C^-1 d, by way of the correlation; 0 of no value."""
    spread = np.sqrt(np.diag(covariance))
    z = difference / spread
    return float(z @ np.linalg.solve(covariance / np.outer(spread, spread), z)) if len(z) else 0.0


class CalibrationVerdict(NamedTuple):
    """The statement of a calibration on model and measurement, which all sentences follow.

    ``level`` is "agrees", "open" or "contradicts", ``heading`` a sentence without its point, and
    ``text`` the evidence.
    """

    level: Literal["agrees", "open", "contradicts"]
    heading: str
    text: str


_AGAINST = "The measurement contradicts what was stated of the materials"
_OF_ROOM = (
    "surface_missing",
    "surface_beyond_sense",
    "dimensions",
    "wide_sigma",
    "equations_differ",
)
"""Marks of the whole room that leave open whether model and measurement agree."""


def verdict(record: Mapping[str, Any]) -> CalibrationVerdict:
    """Return what a calibration shows: the one statement that text, page and JSON share.

    In this order: a likely typing error; a calibration that does not ask for T; a gap that remains;
    what p and z say of the materials, which a reservation about the whole room or about every band
    leaves open.

    Parameters
    ----------
    record : mapping
        As `rtcal.calibration.CalibrationResult.to_dict` returns it.
    """
    marks = record["trust_marks"]
    if typed := [
        f"at {mark['frequency']:g} Hz: {mark['text']}"
        for mark in marks
        if mark["kind"] == "typing_error"
    ]:
        more = f" Another {len(typed) - 1} such values are listed below." if typed[1:] else ""
        return CalibrationVerdict(
            "contradicts",
            f"Likely a typing error {typed[0]}",
            "Check this value before anything else, and calibrate again. Every coefficient of its band "
            f"is computed with it.{more}",
        )
    after = np.abs(numbers(record["gap_after_jnd"]))
    compared = np.isfinite(after)
    if not record["matches_measured_time"]:
        off = f", and T is off by up to {after[compared].max():.1f} JND" if compared.any() else ""
        return CalibrationVerdict(
            "open",
            "Nothing in this calibration asks for the measured T",
            f"The coefficients follow the other terms alone{off}. Add terms.ExactMatch(), "
            "MatchWithin() or SoftMatch().",
        )
    of_materials = _of_materials(record)
    if left := remaining_gap(record):
        fact, _, cause = left.partition(". ")
        if of_materials.level == "contradicts":
            return CalibrationVerdict(
                "contradicts", fact, f"{cause} {of_materials.heading}. {of_materials.text}"
            )
        return CalibrationVerdict("open", fact, f"{cause} {_not_contradicted(record)}")
    f = np.asarray(record["centre_frequencies"])[compared]
    marked = {mark["frequency"] for mark in marks}
    reserved = any(mark["kind"] in _OF_ROOM for mark in marks) or marked >= set(f.tolist())
    if of_materials.level == "agrees" and reserved:
        return CalibrationVerdict(
            "open", f"{of_materials.heading}, with reservations", of_materials.text
        )
    return of_materials


def _evidence(record: Mapping[str, Any]) -> tuple[str, str]:
    """Return Q and p in words, and the bands whose z is large."""
    plausibility = record["plausibility"]
    q = f"Q = {plausibility['q']:.1f}, {plausibility['degrees_of_freedom']} degrees of freedom"
    if plausibility["p_value"] is not None:
        q += f", p = {plausibility['p_value']:.2g}"
    z = numbers(plausibility["z"])
    far = bands.hertz(
        [f for f, of in zip(record["centre_frequencies"], z, strict=True) if abs(of) > LARGE_Z]
    )
    where = f"at {far} the" if far else "in no band does the"
    asks = "asks" if far else "ask"
    return q, (
        f"{where} measurement {asks} for an absorption more than two standard deviations from the "
        "stated one"
    )


def _not_contradicted(record: Mapping[str, Any]) -> str:
    """Return that p and z contradict nothing, of a room that lacks the measured T all the same."""
    p, p_together = (record["plausibility"][key] for key in ("p_value", "p_together"))
    q, asks = _evidence(record)
    if p is not None and p < P_CONTRADICTION:
        return (
            f"What was stated is contradicted unless all coefficients err the same way ({q}); {asks}. "
            f"{together_in_words(p, p_together)}"
        ).rstrip()
    return f"What was stated is not contradicted ({q}); {asks}."


_SOMETHING = (
    "Something is missing from the model, or is stated wrongly, or is less certain than stated."
)


def longer_in_words(record: Mapping[str, Any]) -> str:
    """Return what it most often means that T is longer than stated in every band; "" where it is not.

    That is where z is negative in every band with T, of at least two.
    """
    z = numbers(record["plausibility"]["z"])
    known = z[np.isfinite(z)]
    if len(known) < 2 or not (known < 0).all():
        return ""
    return (
        "T is longer in every band than the stated coefficients give. Most often the equation then "
        "gives too little T for this room, because its absorption is unevenly distributed or its "
        "surfaces scatter little, or handbook coefficients are too high. A wrong volume or area is "
        "rarer."
    )


def _of_materials(record: Mapping[str, Any]) -> CalibrationVerdict:
    """Return what p and z say of the materials, where the calibrated room has the measured T."""
    plausibility = record["plausibility"]
    p, p_together = plausibility["p_value"], plausibility["p_together"]
    far = bool((np.abs(numbers(plausibility["z"])) > LARGE_Z).any())
    q, asks = _evidence(record)
    if not plausibility["degrees_of_freedom"]:
        return CalibrationVerdict(
            "open", "No T was measured in a band of the model", "There is no verdict."
        )
    if p is None:
        return CalibrationVerdict(
            "contradicts" if far else "open",
            _AGAINST if far else "No overall verdict",
            f"{as_sentence(asks)} There is no p-value for all bands together, because a coefficient "
            f"stands at a bound ({q}).",
        )
    together = together_in_words(p, p_together)
    agreed = agreement(p, p_together)
    if agreed == "too good":
        return CalibrationVerdict(
            "open",
            "Too good to be true: the measurement is nearer to what was stated than its uncertainty",
            "Over all bands the coefficients moved less than their stated uncertainty makes likely "
            f"({q}); {asks}. Either a sigma or the uncertainty of T is stated too large, or T was "
            "calculated from these coefficients.",
        )
    further = f"The coefficients had to move further than their stated uncertainty explains ({q})"
    if agreed == "contradicts":
        return CalibrationVerdict(
            "contradicts",
            _AGAINST,
            f"{further}; {asks}. {longer_in_words(record) or _SOMETHING} {together}".rstrip(),
        )
    if p < P_CONTRADICTION:
        return CalibrationVerdict(
            "open",
            "The measurement agrees with what was stated only if all coefficients err the same way",
            " ".join(filter(None, (f"{further}; {asks}.", longer_in_words(record), together))),
        )
    within = (
        f"The coefficients moved no further than their stated uncertainty explains ({q}); {asks}."
    )
    weak = weak_agreement(numbers(record["gap_before_jnd"]))
    if weak:
        return CalibrationVerdict(
            "open",
            "The measurement does not contradict what was stated of the materials",
            f"{within} {weak}",
        )
    return CalibrationVerdict(
        "open" if far else "agrees",
        "The measurement agrees with what was stated of the materials"
        + (", with exceptions" if far else ""),
        within,
    )


def numbers(values: Sequence[float | None] | Array) -> Array:
    """Return the values as an array, NaN where one is missing."""
    return np.array([np.nan if v is None else v for v in values])


def remaining_gap(record: Mapping[str, Any]) -> str:
    """Return that the calibrated room lacks the measured T, where it does, and to what the gap belongs.

    "" where T is met in every band that has one, and where nothing asks for T. ``record`` is as for
    `rtcal.calibration.table.blocks_of`.
    """
    after, before = (np.abs(numbers(record[key])) for key in ("gap_after_jnd", "gap_before_jnd"))
    left = after >= MET  # not where there is no T
    if not left.any() or not record["matches_measured_time"]:
        return ""
    n, count = int(left.sum()), int(np.isfinite(after).sum())
    said = (
        f"The calibrated room does not have the measured reverberation time in {n} of {count} bands: "
        f"gaps of up to {after[left].max():.1f} JND remain"
    )
    grown = left & (after >= before + MET)
    if grown.any():
        said += f", in {int(grown.sum())} larger than before"
    if not record["room_taken_as_exact"]:
        return f"{said}. {_taken_up(record)}"
    if record["unreachable"]:
        return f"{said}. No coefficients within their limits reach that time."
    return f"{said}. The uncertainty of the measured time allows them."


_GROUPS = {
    "volume": "volume",
    "areas": "areas",
    "temperature": "climate",
    "humidity": "climate",
    "coefficients": "",
}
"""What takes up a gap, by the first word of what a room states of its uncertainty."""
_SAID_SHARE = 0.2


def _taken_up(record: Mapping[str, Any]) -> str:
    """Return which of the room's uncertainties takes up the gap, with what is stated of it."""
    shares = record.get("gap_shares", {})
    stated: dict[str, list[str]] = {}
    for words in record.get("room_uncertainty", "").split(", "):
        stated.setdefault(_GROUPS.get(words.partition(" ")[0], ""), []).append(words)
    causes = [
        "the measured time"
        if group == "T"
        else f"the {group} ({', '.join(w.removeprefix(f'{group} ') for w in stated.get(group, []))})"
        for group in sorted(shares, key=lambda g: -float(shares[g]))
        if shares[group] >= _SAID_SHARE
    ]
    check = " Check that first." if shares.get("T", 0.0) < 1 - _SAID_SHARE else ""
    return f"What is stated as uncertain explains them: {' and '.join(causes)}.{check}"
