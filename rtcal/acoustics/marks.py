"""Model and measurement compared: the gap in JND, its plausibility, and the marks of doubt.

A mark is a reason to doubt a result, in one band or of the whole room. A shifted decimal point changes
a value by ten, a lost digit by more; T differs between neighbouring bands by much less. A value that is
far from those of the bands beside it is named before anything else, since all that follows from it is
wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.bands import hertz, mid_frequency_time, schroeder_frequency
from rtcal.acoustics.changes import NOT_KNOWN, enough_known
from rtcal.acoustics.equations import ArauPuchades, Eyring
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import (
    OBSERVABLES,
    REVERBERATION,
    TARGET,
    DecaySlope,
    Observable,
    observable,
    of_kind,
)
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence, listed
from rtcal.support.types import Array

__all__ = ["gap_jnd", "plausibility", "trust_marks"]
__dir__ = __all__.copy


def gap_jnd(model: Array, measured: Array, parameter: str = TARGET.key) -> Array:
    """Return the deviation model - measured in just noticeable differences (JND), with its sign.

    ``model`` and ``measured`` are values of ``parameter``, such as "t20", of one shape; the deviation
    is NaN where either is missing. One JND is 5 % of the measured value for decay times, 1 dB for C80
    and G, 0.05 for D50 and 10 ms for Ts (ISO 3382-1:2009, Table A.1). It is taken as 1 dB for C50 and
    relative levels, and as 0.03 for STI (Bradley, Reich and Norcross 1999).

    Examples
    --------
    >>> print(gap_jnd(np.array([1.05, 0.9]), np.array([1.0, 1.0])).round(6))
    [ 1. -2.]
    """
    unit_of = observable(parameter).jnd_of
    model, measured = checks.array("model", model), checks.array("measured", measured)
    return np.asarray((model - measured) / unit_of(measured))


def rms(values: Array, axis: int | tuple[int, ...] | None = None) -> Any:
    """Return the root mean square over some axes of the values that are not NaN; NaN if all are."""
    known = np.isfinite(values)
    squares = np.where(known, values, 0.0) ** 2
    with np.errstate(invalid="ignore"):
        return np.sqrt(squares.sum(axis=axis) / known.sum(axis=axis))


MET = 0.5
"""Deviation in JND below which texts call the measured T met: half a just noticeable difference."""
P_CONTRADICTION = 0.05
"""p-value below which input coefficients and measured T contradict each other: the usual 5 %."""
LARGE_Z = 2.0
"""Deviation z, in standard deviations, above which a band contradicts the input coefficients."""
P_TOO_GOOD = 0.99
"""p-value above which input coefficients and measured T agree too well to be true.

With right standard deviations the p-value is uniform, so that 1 room in 100 is marked by chance. If
all standard deviations are f times too large, P(chi² < f² chi²_0.01) of the rooms are marked: in six
octaves 25 % for f = 2 and 75 % for f = 3, in 18 third-octaves 94 % for f = 2."""


@dataclass(frozen=True, eq=False)
class Plausibility:
    """Agreement of the measured T with the input coefficients, judged by their uncertainties.

    ``z`` is the deviation in each band in standard deviations, ``q`` the sum of its squares, and
    ``p_value`` the result of the chi-square test of q with ``degrees_of_freedom``. The deviation after
    a calibration cannot show this agreement, because calibration removes it.

    ``p_together`` is the p-value if the coefficients may also be too high or too low together, None
    where this is not known.
    """

    z: Array
    """Absorption area that T needs minus that of the input coefficients, over its standard deviation,
    (n_bands,); NaN where no T was matched."""
    q: float
    """Sum of z² over the bands; if bands are correlated, z'R^-1 z with the correlation R of z."""
    degrees_of_freedom: int
    """Number of bands in which T was matched."""
    p_value: float | None
    """Probability of a larger q if input and measurement are right. None where a coefficient is at a
    bound, because q is then not chi-square distributed."""
    p_together: float | None = None
    """p-value if the coefficients may also be too high or too low together, as `rtcal.finder` assumes
    (`rtcal.acoustics.room_errors`). None where these errors are not known."""


Agreement = Literal["contradicts", "agrees", "too good"]


def agreement(p_value: float | None, p_together: float | None = None) -> Agreement | None:
    """Return whether measured T and input coefficients agree: "contradicts", "agrees" or "too good".

    ``p_value`` is the probability of a larger deviation if input and measurement are right, and
    ``p_together`` the same probability if all coefficients may also be too high or too low together
    (None if unknown). The result is "contradicts" if both are below 0.05, and None if ``p_value`` is
    unknown (None). It is "too good" if ``p_value`` is above 0.99: an uncertainty is then too large, or
    T was calculated from these coefficients.
    """
    if p_value is None:
        return None
    if max(p_value, p_together or 0.0) < P_CONTRADICTION:
        return "contradicts"
    return "too good" if p_value > P_TOO_GOOD else "agrees"


def plausibility(
    difference: Array, covariance: Array, bound_active: bool, together: Array | None = None
) -> Plausibility:
    """Return how well the measured T agrees with the input coefficients, per band and over all bands.

    Parameters
    ----------
    difference : array (n_bands,)
        Absorption area that the measured T needs minus that of the input coefficients, in m²; NaN
        where no T was measured.
    covariance : array (n_bands, n_bands)
        Covariance of ``difference`` in m⁴, if input and measurement are right.
    bound_active : bool
        Whether a calibrated coefficient is at a bound. There is then no p-value.
    together : array (n_errors, n_bands), optional
        Changes of ``difference`` in m² by one standard deviation of each error that the coefficients
        have in common.

    Raises
    ------
    DataError
        If the covariance is not finite or does not have the size of ``difference``.

    Examples
    --------
    >>> result = plausibility(np.array([2.0, np.nan]), np.eye(2), bound_active=False)
    >>> result.q, result.degrees_of_freedom, round(result.p_value, 4)
    (4.0, 1, 0.0455)
    """
    n = difference.size
    if difference.shape != (n,) or covariance.shape != (n, n):
        raise DataError(
            f"difference has shape {difference.shape} and covariance {covariance.shape}; they "
            "must be (n_bands,) and (n_bands, n_bands)"
        )
    if not np.isfinite(covariance).all():
        raise DataError(
            "covariance has a value that is not finite; check whether a sigma is far too large"
        )
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
            wider = (covariance + together.T @ together)[np.ix_(used, used)]
            p_together = float(chdtrc(count, _chi_square(difference[used], wider)))
    return Plausibility(z, q, count, p_value, p_together)


def _chi_square(difference: Array, covariance: Array) -> float:
    """Return d'C^-1 d, by way of the correlation; 0 of no value."""
    spread = np.sqrt(np.diag(covariance))
    z = difference / spread
    return float(z @ np.linalg.solve(covariance / np.outer(spread, spread), z)) if len(z) else 0.0


@dataclass(frozen=True)
class TrustMark:
    """Caution about one band or the whole room: a reason to doubt the result there.

    ``kind`` is the name of the reason, ``frequency`` the band in Hz (None for the whole room),
    ``letter`` the mark in tables, ``text`` the fact and ``advice`` the next step.
    """

    kind: str
    letter: str
    frequency: float | None
    text: str
    advice: str

    @property
    def title(self) -> str:
        """Name in words of the reason for the caution."""
        return self.kind.replace("_", " ").replace("schroeder", "Schroeder")

    @property
    def is_error(self) -> bool:
        """Whether the caution is a likely typing error, which results print before anything else."""
        return self.kind.endswith("_error")

    @property
    def as_error(self) -> str:
        """Sentence part that states a likely typing error, with its band if it has one."""
        where = "" if self.frequency is None else f" at {self.frequency:g} Hz"
        return f"likely a typing error{where}: {self.text}"

    @property
    def checked(self) -> str:
        """Words for the input that may be mistyped: "this value", or "areas, volume and T"."""
        return "areas, volume and T" if self.frequency is None else "this value"

    @property
    def sentence(self) -> str:
        """Sentence with the doubtful fact and the next step, for messages."""
        if not self.is_error:
            return f"{self.text}: {self.advice}"
        return f"{self.as_error}. Check {self.checked} before anything else"


_LETTERS = {
    "typing_error": "t",
    "unreachable": "n",
    "missing": "m",
    "below_schroeder": "s",
    "air": "a",
    "uncertain": "u",
    "at_bound": "b",
    "at_upper_bound": "b",
    "all_at_upper_bound": "b",
    "implausible": "z",
    "bent": "c",
}
"""Marks of the bands in tables, by kind of caution; the others are of the whole room, without one."""
_ADVICE = {
    "typing_error": "likely a typing error: check this value before anything else, and calibrate "
    "again. All results are computed with it",
    "unit_error": "likely a typing error, or another unit: check T (in s), the volume (in m³) "
    "and the areas (in m²) before anything else. All results are computed with them",
    "surface": "check each area, the volume and the dimensions before anything else: every "
    "coefficient is computed with them",
    "gap_before": "what is predicted from there is not of the measured room: check T, areas and "
    "sigma of every measured state",
    "fixed": "no coefficient can move: give uncertain coefficients a sigma above 0, or the file "
    "a [prior]",
    "unreachable": "its coefficients are at their bounds and do not describe the materials: "
    "check T, volume and areas, give the materials wider bounds, or look for an effect that the "
    "model lacks",
    "missing": "alpha keeps its input value there, unless other bands, terms or observations "
    "move it: measure the band, or draw no conclusion from it",
    "below_schroeder": "a few room modes determine the decay there: do not use these "
    "coefficients at other positions or in other rooms",
    "air": "an error of T or of the climate causes an error of alpha several times as large: "
    "measure temperature and humidity with T",
    "uncertain": "the deviation cannot show whether the model is right: measure at more "
    'positions, or calibrate with the method "soft", which fits T within its uncertainty',
    "at_bound": "the sigma of this or another material is too small, or an effect is missing: "
    "give hard materials a lower limit (alpha_min) and look for the effect",
    "at_upper_bound": "the other materials supply the rest of the absorption that T needs: this "
    "material's sigma, another material's sigma or this material's area is too small, or an "
    "effect is missing",
    "all_at_upper_bound": "T needs more absorption than these materials can have: look for "
    "absorption that the model lacks, for a surface that is missing or too small, or a sigma "
    "that is too small",
    "implausible": "do not rely on the coefficients of these bands until the cause is found",
    "bent": "one T does not describe the decay, and these coefficients follow one slope of it: "
    "look for coupled spaces or absorption on one side, and do not use them at other positions "
    "or in other rooms",
    "no_air": "the surfaces are made to absorb what the air does, most of all above 1 kHz: give "
    "the room's file temperature and humidity",
    "no_uncertainty": "the test of the input may be too strict: give T per source and receiver, "
    "or its uncertainty",
    "implausible_modes": "the modes contradict each other or the input coefficients: check "
    "whether the table holds T or decays, and which modes they are, then check the coefficients",
    "clipped": "a laboratory value above 1 includes the specimen's edges, so the true "
    "coefficient is not known: give these materials a larger sigma",
    "dimensions": "the volume or a dimension is wrong: the absorption that T needs is "
    "proportional to the volume",
    "equations_differ": "these coefficients, and each prediction with them, depend on the "
    "equation: calibrate by path tracing (`rtcal fit` with a mesh, `rtcal loop` with a "
    "simulator), and predict a change of one surface there",
    "equations_differ_with_pieces": "these coefficients, and each prediction with them, depend "
    "on the equation. Path tracing does not, but has no [[object]]: state the pieces as a "
    "[[material]] with an area before you take `rtcal fit` or `rtcal loop`",
    "directions_unknown": NOT_KNOWN,
    "wide_sigma": "any T agrees with so large a sigma: check that sigma is neither relative to "
    "alpha nor in percent",
}
"""What to do next, by kind of caution."""


def mark(kind: str, frequency: float | None, text: str, advised: str = "") -> TrustMark:
    """Return a caution with the letter and the advice that rtcal has for its kind.

    ``kind`` names the reason, such as "below_schroeder", ``frequency`` is the band in Hz (None for the
    whole room), and ``text`` is the fact. If ``advised`` is given, letter and advice are those of this
    other kind.
    """
    of = advised or kind
    return TrustMark(kind, _LETTERS.get(of, ""), frequency, text, _ADVICE[of])


FAR = 4.0
"""Ratio of T20 or T30 to both neighbouring bands above which the value is likely mistyped."""
FAR_AT_END = 6.0
"""Ratio of T20 or T30 in the first or last band to its neighbour above which it is likely mistyped."""
FAR_ELSE = 10.0
"""Ratio above which EDT, Ts (shortened by direct sound) or alpha (resonators) is likely mistyped."""


def far_from_neighbours(values: Array, *, late: bool = True) -> NDArray[np.bool_]:
    """Return True for each value that is far above or below those of the bands beside it, (n_bands,).

    ``values`` (n_bands,) that are not above 0 count as missing. ``late`` is True for T20 and T30.

    From the lowest band up, each value joins the group whose last value is nearest, if their ratio is
    below 4 (T20 and T30) or 10 (other quantities); otherwise it begins a new group. All values outside
    the largest group are far off, but none is if two groups are equally large. Values before or after
    all of the largest group are far off only for T20 and T30, and only if all of them differ from its
    nearest value by a factor above 6. Of two values alone, T20 or T30, both are far off if they differ
    by such a factor, because nothing shows which is right.
    """
    found = np.zeros(len(values), dtype=bool)
    with np.errstate(invalid="ignore"):
        places = np.flatnonzero(np.isfinite(values) & (values > 0))
    level, far = np.log(values[places]), np.log(FAR if late else FAR_ELSE)
    group = np.zeros(len(level), dtype=int)
    last: list[float] = []
    for i, value in enumerate(level):
        near = [g for g, latest in enumerate(last) if abs(value - latest) < far]
        group[i] = min(near, key=lambda g: abs(value - last[g])) if near else len(last)
        last[group[i] : group[i] + 1] = [value]
    if len(level) == 2 and late:
        found[places] = np.ptp(level) > np.log(FAR_AT_END)
        return found
    sizes = np.bincount(group)
    if len(sizes) < 2 or np.count_nonzero(sizes == sizes.max()) > 1:
        return found
    right = np.flatnonzero(group == np.argmax(sizes))
    wrong = group != np.argmax(sizes)
    for end, nearest in ((slice(right[0]), right[0]), (slice(right[-1] + 1, None), right[-1])):
        jump = np.abs(level[end] - level[nearest])
        wrong[end] &= late and bool((jump > np.log(FAR_AT_END)).all())
    found[places[wrong]] = True
    return found


def of_row(
    frequencies: Array, values: Array, name: str, unit: str = "", *, late: bool = True
) -> list[TrustMark]:
    """Return a caution for each value of one row (n_bands,) that is likely mistyped.

    ``frequencies`` (n_bands,) are in Hz. ``name`` is the printed name of the row, such as "T30 (S1 to
    R2)" or "alpha of floor", and ``unit`` the printed unit with its blank. ``late`` is True for T20 and
    T30, and False for other quantities, whose first and last band are not judged.

    Examples
    --------
    >>> of_row(np.array([500, 1000, 2000]), np.array([1.9, 19.4, 1.6]), "T20", " s")[0].text
    'T20 = 19.4 s, beside 1.9 s at 500 Hz and 1.6 s at 2000 Hz'
    """
    wrong = far_from_neighbours(values, late=late)
    given = np.isfinite(values)
    out = []
    for k in np.flatnonzero(wrong):
        right = np.flatnonzero(given & ~wrong if (given & ~wrong).any() else given)
        near = [*right[right < k][-1:], *right[right > k][:1]]
        beside = [f"{values[j]:.3g}{unit} at {bands.label(frequencies[j])}" for j in near]
        text = f"{name} = {values[k]:.3g}{unit}, beside {' and '.join(beside)}"
        kind = "alpha_typing_error" if name.startswith("alpha") else "typing_error"
        out.append(mark(kind, float(frequencies[k]), text, "typing_error"))
    return out


def in_measurement(measured: Measurement) -> list[TrustMark]:
    """Return a caution for each decay time that is likely mistyped, T20 and T30 first."""
    kinds = [OBSERVABLES[key] for key in measured.values]
    late = [o for o in REVERBERATION if o in kinds]
    out = []
    for o in (*late, *(o for o in kinds if o not in late and o.unit == "s")):
        for pair, row in zip(measured.pairs, measured.values[o.key], strict=True):
            name = o.label if measured.is_summary else f"{o.label} ({' to '.join(pair)})"
            out += of_row(measured.centre_frequencies, row, name, " s", late=o in late)
    return out


_LEAST_ALIKE = 6
"""Least number of equal values at two positions that are no chance, however they are rounded."""
_BY_CHANCE = 1e-2
"""Largest probability with which some two positions have the same values by chance."""


def given_twice(measured: Measurement) -> tuple[str, ...]:
    """Return a text for each source-receiver pair whose values all equal those of an earlier pair.

    A pair with fewer than 6 values has a text only if some two pairs are equal by chance with a
    probability below 1 %. Two values are equal by chance with the probability that is the rounding step
    over one JND (0.2 for T = 1.00 s with JND 0.05 s, rounded to 0.01 s).
    """
    every, names = np.hstack([*measured.values.values()]), [*map(" to ".join, measured.pairs)]
    steps = np.hstack([_steps(OBSERVABLES[key], v) for key, v in measured.values.items()])
    least = np.log(max(len(names) * (len(names) - 1) / 2, 1) / _BY_CHANCE)
    notes, first = [], dict[bytes, str]()
    for name, row, log in zip(names, every + 0.0, np.log(steps), strict=True):
        if np.isfinite(row).sum() < _LEAST_ALIKE and np.nansum(log) < least:
            continue
        if (same := first.setdefault(row.tobytes(), name)) != name:
            notes.append(
                f"every value of {name} equals that of {same}: check that no response or row was given "
                "twice, because the mean counts both positions"
            )
    return tuple(notes)


def _steps(kind: Observable, values: Array) -> Array:
    """Return how many steps of the rounding of all values one JND of each has, at least 1."""
    with np.errstate(invalid="ignore"):
        off = [np.nanmax(np.abs(values.round(d) - values), initial=0.0) for d in range(_DIGITS)]
    decimals = next((d for d, error in enumerate(off) if error < 0.1**_DIGITS), _DIGITS)
    return np.where(np.isfinite(values), np.maximum(kind.jnd_of(values) * 10**decimals, 1.0), 1.0)


_DIGITS = 6
"""Most decimals of a rounded value."""

LEAST_OF_BOX, MOST_OF_BOX = 0.9, 1.4
"""Least and largest likely surface of a room, over that of the box of its dimensions. Furniture and
steps add up to 0.4; objects against a wall, or a corner that is cut off, take 0.1."""
FLATTEST, FLAT = 20.0, 10.0
"""Length and width over height of the flattest and of a usual room, where no dimensions are stated."""
_SLIPS = (0.1, 10.0), (0.01, 100.0)
_CORRECTED = 0.2
"""Largest relative difference from the box with which an area counts as mistyped by such a factor."""


def _surface_limits(room: Room, flattest: float = FLATTEST) -> tuple[float, float]:
    """Return the least and the largest likely surface of a room in m², from its size.

    The limits follow from the room's dimensions. Without dimensions they follow from its volume: the
    least is 0.9 times the surface of a cube, the largest the surface of a box that is ``flattest``
    times as long and wide as high.
    """
    if room.dimensions is not None:
        box = _surface_of_box(*room.dimensions)
        return LEAST_OF_BOX * box, MOST_OF_BOX * box
    cube, flat = _surface_of_box(1, 1, 1), _surface_of_box(flattest, flattest, 1)
    scale = room.volume ** (2 / 3)
    return LEAST_OF_BOX * cube * scale, flat / flattest ** (4 / 3) * scale


def _surface_of_box(x: float, y: float, z: float) -> float:
    return 2 * (x * y + y * z + z * x)


def likely_slips(room: Room) -> list[tuple[str, Room]]:
    """Return likely slips of a decimal point, each as a text and the room with the corrected value.

    A slip is an area, or the volume, that is 10 or 100 times too large or too small. The list is empty
    if the total area of ``room`` is possible (0.9 to 1.4 times that of the box of its dimensions, or
    without dimensions that of some box of its volume), and if more than two slips could be the reason.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["floor", "rest"], areas=[200, 74],
    ...             alpha=[[0.4], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000],
    ...             dimensions=(5, 4, 3))
    >>> [text for text, _ in likely_slips(room)]
    ['area of "floor" = 200 m², for 20 m²']
    """
    least, most = _surface_limits(room)
    if least <= room.total_area <= most:
        return []
    for factors in _SLIPS:
        slips = [(i, f) for f in factors for i in np.flatnonzero(room.is_surface).tolist()]
        total = np.array([room.total_area + (f - 1) * room.areas[i] for i, f in slips])
        if room.dimensions is not None:
            off = np.abs(total / _surface_of_box(*room.dimensions) - 1)
            found = [_slipped(room, *slips[np.argmin(off)])] if min(off) <= _CORRECTED else []
        else:
            low, high = _surface_limits(room, FLAT)
            fits = np.flatnonzero((total >= low) & (total <= high))
            found = [_slipped(room, *slips[j]) for j in fits]
            for other in (room.replace(volume=room.volume * f) for f in factors):
                text = f"volume = {room.volume:g} m³, for {other.volume:g} m³"
                low, high = _surface_limits(other, FLAT)
                found += [(text, other)] if low <= other.total_area <= high else []
        if found:
            return found if len(found) <= 2 else []
    return []


def _slipped(room: Room, i: int, factor: float) -> tuple[str, Room]:
    areas, material = room.areas.copy(), room.materials[i]
    areas[i] *= factor
    surfaces = [
        replace(s, area=s.area * factor) if s.material == material else s for s in room.surfaces
    ]
    text = f'area of "{material}" = {room.areas[i]:g} m², for {areas[i]:g} m²'
    return text, room.replace(areas=areas, surfaces=surfaces)


def of_surface(room: Room) -> list[TrustMark]:
    """Return a caution if the areas do not fit the room's dimensions or, without these, its volume.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> of_surface(room.replace(volume=4000))[0].text
    'the areas add up to 202.5 m², but even a cube of 4000 m³ has 1512 m²'
    """
    area, volume, (least, most) = room.total_area, room.volume, _surface_limits(room)
    if least <= area <= most:
        return []
    if room.dimensions is not None:
        sides = " x ".join(f"{side:g}" for side in room.dimensions)
        wanted = f"a box of {sides} m has {_surface_of_box(*room.dimensions):.4g} m²"
    elif area < least:
        wanted = f"even a cube of {volume:.4g} m³ has {least / LEAST_OF_BOX:.4g} m²"
    else:
        wanted = (
            f"even a box of {volume:.4g} m³ that is {FLATTEST:g} times as long and wide as high has "
            f"{most:.4g} m²"
        )
    text = f"the areas add up to {area:.4g} m², but {wanted}"
    if not (likely := likely_slips(room)):
        return [mark("surface", None, text)]
    text = f"{', or '.join(slip for slip, _ in likely)}: {text}"
    return [mark("surface_typing_error", None, text, "surface")]


_LEAST_SLIP, _SLIP = 0.5, 0.75
"""Least lg of measured T over that of the stated coefficients in every band, and of its median, from
which on a decimal point or a unit is wrong. Empty and furnished rooms differ by less than 3."""


def of_unit(
    times: Array, stated: Array, name: str = "T", of: str = "that of the input coefficients"
) -> list[TrustMark]:
    """Return a caution if T differs by one large factor in all bands, as if it were in another unit.

    ``times`` are the measured T in s and ``stated`` the T in s to compare with, such as that of the
    input coefficients; both are (n_bands,), NaN where missing. ``name`` is the name of the measured T
    in the caution's text, and ``of`` that of the other T.

    Examples
    --------
    >>> of_unit(np.array([11.0, 9.0]), np.array([1.0, 1.0]))[0].text
    'T is 9 to 11 times that of the input coefficients in every band'
    >>> of_unit(np.array([3.0, 0.9]), np.array([1.0, 1.0]))
    []
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.log10(times / stated)
    off = off[np.isfinite(off)]
    if not off.size or abs(np.median(off)) < _SLIP:
        return []
    if (np.sign(np.median(off)) * off).min() < _LEAST_SLIP:
        return []
    low, high = 10 ** off.min(), 10 ** off.max()
    by = " to ".join(dict.fromkeys(f"{float(f'{end:.2g}'):g}" for end in (low, high)))
    where = "in every band" if off.size > 1 else "in the one band that was measured"
    text = f"{name} is {by} times {of} {where}"
    return [mark("unit_error", None, text)]


def of_input(
    room: Room,
    times: Array | None = None,
    mistyped: Sequence[TrustMark] = (),
) -> tuple[TrustMark, ...]:
    """Return the cautions about a room and its measured T that are printed before every result.

    ``times`` (n_bands,) is the measured T in s, NaN where missing; None if no T was measured. It is
    compared with Eyring's T of the input coefficients. ``mistyped`` are the cautions about single
    values of T that `of_row` returns.
    """
    marks = of_surface(room)
    if room.dimensions is not None:
        box = float(np.prod(room.dimensions))
        if abs(room.volume / box - 1) > OFF_VOLUME:
            sides = " x ".join(f"{side:g}" for side in room.dimensions)
            text = f"volume = {room.volume:g} m³, but the dimensions {sides} m hold {box:g} m³"
            marks.append(mark("dimensions", None, text))
    for name, row in zip(room.materials, room.alpha, strict=True):
        marks += of_row(room.centre_frequencies, row, f'alpha of "{name}"', late=False)
    if times is not None:
        marks += of_unit(times, Eyring().reverberation_time(room))
    marks += mistyped
    if not room.sigma.any():
        marks.append(mark("fixed", None, "sigma is 0 for every coefficient"))
    return tuple(marks)


_ALLOWED = 2.0
"""Standard deviations of a straight decay's ratio that are allowed."""


def bent_decays(measured: Measurement) -> tuple[TrustMark, ...]:
    """Return a caution for each band whose decay is curved in the mean over the positions.

    A decay counts as curved if T30/T20 differs from 1 by more than 10 % (ISO 3382-2:2008, Annex B) or
    EDT/T20 by more than 20 %, in both cases plus twice the standard deviation that this ratio has in
    straight decays of noise. T30, EDT and T20 are means over the positions that have both parameters.
    """
    texts: dict[float, list[str]] = {}
    for parameter, slope in of_kind(DecaySlope).items():
        if slope.bend is None or not {TARGET.key, parameter} <= {*measured.values}:
            continue
        name, limit, straight = slope.bend
        t20, other = measured.values[TARGET.key], measured.values[parameter]
        both = np.isfinite(t20) & np.isfinite(other)
        n_positions = np.sum(both, axis=0)
        if measured.is_summary:
            n_positions = n_positions * (measured.n_sources or 1) * (measured.n_receivers or 1)
        width = bands.bandwidth_factor(measured.centre_frequencies) * measured.centre_frequencies
        for k in np.flatnonzero(n_positions).tolist():
            t, ratio = t20[both[:, k], k].mean(), other[both[:, k], k].mean()
            percent = float(100 * (ratio / t - 1))
            scatter = 100 * straight / np.sqrt(width[k] * t * n_positions[k])
            if abs(percent) > limit + _ALLOWED * scatter:
                texts.setdefault(float(measured.centre_frequencies[k]), []).append(
                    f"{name} = {percent:+.0f} %"
                )
    return tuple(
        mark("bent", f, f"the decay is curved, {', '.join(texts[f])}") for f in sorted(texts)
    )


_AIR_SHARE = 0.5
_AT_BOUND = "stands at its {} bound"
_ODD_UNCERTAINTY = 0.3
"""Of T, relative. Single decays of 0.3 s at 63 Hz, the least certain, scatter by 0.24."""
OFF_VOLUME = 0.1
"""Relative difference that is allowed between the volume and that of the stated dimensions."""
_WIDE_SIGMA = 0.5
"""The standard deviation of a coefficient of which nothing is known, uniform from 0 to 1, is 0.29."""


def uneven_marks(room: Room, shares: Array) -> tuple[TrustMark, ...]:
    """Return a caution if absorption is so uneven that reverberation equations differ by over one JND.

    T of Eyring's equation, in which all surfaces count alike, is compared with T of Arau-Puchades'
    equation, which treats the axes separately. ``shares`` (n_materials, 3) are the shares of each
    material's area that face x, y and z, as `rtcal.acoustics.changes.facing` returns them; a material
    with unknown shares (NaN) counts a third on each axis. If the shares of most of the absorption are
    unknown, the equations are compared for an extreme case, in which all of the most absorbing of these
    materials faces one axis. The caution then says that the direction is unknown.
    """
    known, total = enough_known(room, shares), room.total_area
    areas = np.where(room.is_surface, room.areas, 0.0)  # pieces face no axis
    absorbed = np.where(np.isnan(shares[:, 0]), areas * room.alpha.mean(axis=1), -1.0)
    most = int(np.argmax(absorbed))
    if not known:
        # As little of the others beside it as the shape of a cube leaves.
        others = max(total / 3 - areas[most], 0.0) / max(total - areas[most], 1e-9)
        shares = np.tile([(1 - others) / 2, (1 - others) / 2, others], (room.n_materials, 1))
        shares[most] = 0, 0, 1
    along = areas[:, np.newaxis] * np.where(np.isnan(shares), 1 / 3, shares)
    eyring, arau = Eyring().reverberation_time(room), ArauPuchades().by_axes(room, along)
    with np.errstate(invalid="ignore"):
        differ = np.nan_to_num(np.abs(gap_jnd(arau, eyring)), posinf=0.0)
    k = int(np.argmax(differ))
    if not differ[k] > 1:
        return ()
    at = bands.label(room.centre_frequencies[k])
    times = (
        f"{eyring[k]:.2f} s by Eyring's equation and {arau[k]:.2f} s by Arau-Puchades', "
        f"{differ[k]:.1f} JND apart"
    )
    if known:
        text = f"the absorption is uneven, so T at {at} is {times}"
        advised = "equations_differ_with_pieces" if room.pieces else ""
        return (mark("equations_differ", None, text, advised),)
    text = (
        f"the direction of the absorption is unknown: if all of {room.materials[most]} faced one "
        f"way, T at {at} would be {times}"
    )
    return (mark("directions_unknown", None, text),)


def z_within_bounds(
    room: Room, difference: Array, variance: Array, shift: Array, active: NDArray[Any]
) -> Array:
    """Return the deviation z of the measured T from the input, where a coefficient is at a bound.

    z (n_bands,) is NaN in all other bands. Its size is the distance, in standard deviations, from the
    input coefficients to the nearest coefficients within the bounds that give the measured T (Hasofer &
    Lind 1974, J. Eng. Mech. Div. ASCE 100, 111-121). z² is the sum of (shift / sigma)² over the
    coefficients at bounds, plus r² over its variance, where r is the part of ``difference`` that the
    other coefficients have to make up for. z has the sign of ``difference``.

    ``difference`` (n_bands,) is the absorption area in m² that T needs minus that of the input, and
    ``variance`` (n_bands,) is its variance in m⁴ without bounds. ``shift`` (n_materials, n_bands) is
    the change of the coefficients by the calibration; ``active``, of this shape, is not 0 at a bound.

    Examples
    --------
    The ceiling reaches 1 after half a standard deviation, so that the walls have to move by 9.

    >>> room = Room(name="box", volume=60, materials=["ceiling", "walls"], areas=[20, 74],
    ...             alpha=[[0.95], [0.05]], sigma=[[0.1], [0.01]], centre_frequencies=[1000])
    >>> shift, variance = np.array([[0.05], [0.09]]), (room.areas[:, None] * room.sigma) ** 2
    >>> args = room.areas @ shift, variance.sum(axis=0), shift, np.array([[1], [0]])
    >>> print(z_within_bounds(room, *args).round(1))
    [9.]
    """
    at, areas = np.asarray(active) != 0, room.areas[:, np.newaxis]
    of_bounds = np.where(at, areas * room.sigma, 0.0)
    left = difference - np.sum(np.where(at, areas * shift, 0.0), axis=0)
    spread = np.maximum(variance - np.sum(of_bounds**2, axis=0), 0.0)
    sigma = np.where(at & (room.sigma > 0), room.sigma, np.inf)
    squares = np.sum((shift / sigma) ** 2, axis=0)
    # Where none is left to move, T is out of reach: what is missing counts as if bounds were none.
    spread = np.where(spread > 0, spread, variance)
    squares += np.divide(left**2, spread, out=np.zeros_like(left), where=spread > 0)
    return np.where(at.any(axis=0), np.sign(difference) * np.sqrt(squares), np.nan)


def trust_marks(
    room: Room,
    measured: Array,
    uncertainty: Array,
    air_share: Array,
    active: NDArray[Any],
    z: Array,
    unreachable: Sequence[float] = (),
    bent: Sequence[TrustMark] = (),
) -> tuple[TrustMark, ...]:
    """Return the cautions that follow from a calibration, about single bands or the whole room.

    Parameters
    ----------
    room : Room
        Room before the calibration.
    measured, uncertainty : array (n_bands,)
        Measured T and its standard uncertainty in s; NaN where missing or unknown.
    air_share : array (n_bands,)
        Share of the air in the whole absorption.
    active : array (n_materials, n_bands)
        State of each coefficient: -1 at its lower bound, 1 at its upper bound, else 0.
    z : array (n_bands,)
        Deviation of T from the input in standard deviations, as in `Plausibility`; where a
        coefficient is at a bound, as `z_within_bounds` returns it.
    unreachable : sequence of float
        Centre frequencies in Hz of bands whose T could not be reached.
    bent : sequence of TrustMark
        Cautions about curved decays, as `bent_decays` returns them.
    """
    marks: list[TrustMark] = []

    def add(*stated: Any) -> None:
        marks.append(mark(*stated))

    if room.air is None:
        add("no_air", None, "the room has no air")
    wide = np.argwhere(room.sigma > _WIDE_SIGMA)
    if len(wide):
        i, k = wide[0].tolist()
        text = f"{room.place('sigma', i, k)} = {room.sigma[i, k]:g} is above {_WIDE_SIGMA:g}"
        others = f", and {len(wide) - 1} more" if len(wide) > 1 else ""
        add("wide_sigma", None, text + others)
    if room.clipped:
        add("clipped", None, f"coefficients above 1 were set to 1: {'; '.join(room.clipped)}")
    has_t = np.isfinite(measured)
    if has_t.any() and not np.isfinite(uncertainty[has_t]).any():
        add("no_uncertainty", None, "the uncertainty of T is not known")
    middle = mid_frequency_time(measured, room.centre_frequencies)
    limit = float(schroeder_frequency(np.array(middle), room.volume))
    for k, frequency in enumerate(room.centre_frequencies):
        f = float(frequency)
        if np.isnan(measured[k]):
            add("missing", f, "no T was measured, so the band is not calibrated")
        elif f < limit:
            add("below_schroeder", f, f"the band is below the Schroeder frequency ({limit:.0f} Hz)")
        if f in unreachable:
            add("unreachable", f, "no coefficients within the bounds give this T")
        marks += [band for band in bent if band.frequency == f]
        if air_share[k] > _AIR_SHARE:
            add("air", f, "the air absorbs more than the surfaces")
        if uncertainty[k] > _ODD_UNCERTAINTY * measured[k]:
            over = f"{100 * _ODD_UNCERTAINTY:.0f} %"
            add(
                "uncertain",
                f,
                f"T is uncertain by over {over}: check that the uncertainty is in s, not in percent",
            )
        elif uncertainty[k] > TARGET.jnd_of(measured[k]) and not abs(z[k]) > LARGE_Z:
            add("uncertain", f, "T is uncertain by more than one JND")
        # A single coefficient at 1 says nothing of the others, which may still give the T.
        spent = bool((active[:, k] > 0)[room.sigma[:, k] > 0].all())
        upper = "all_at_upper_bound" if spent else "at_upper_bound"
        for i in np.flatnonzero(active[:, k]).tolist():
            side, advised = ("lower", "") if active[i, k] < 0 else ("upper", upper)
            add("at_bound", f, f"{room.materials[i]} {_AT_BOUND.format(side)}", advised)
        if abs(z[k]) > LARGE_Z:
            side = "more" if z[k] > 0 else "less"
            add(
                "implausible",
                f,
                f"the measured T requires {side} absorption than the input (over {LARGE_Z:g} σ)",
            )
    return tuple(marks)


def letters(marks: Sequence[TrustMark], frequency: float) -> str:
    """Return the letters of the cautions about a band, without repeats; "" if it has none.

    ``marks`` are the cautions, and ``frequency`` is the band's centre frequency in Hz.
    """
    return "".join(dict.fromkeys(m.letter for m in marks if m.frequency == frequency))


def grouped(marks: Sequence[TrustMark]) -> Iterator[tuple[TrustMark, list[str]]]:
    """Yield groups of cautions with the same kind and advice: the first caution, and all facts.

    The facts are texts that begin with the bands, such as "125 and 250 Hz: the air absorbs ...".
    """
    for kind, advice in dict.fromkeys((mark.kind, mark.advice) for mark in marks):
        alike = [mark for mark in marks if (mark.kind, mark.advice) == (kind, advice)]
        by_place: dict[str, list[str]] = {}
        for text in dict.fromkeys(mark.text for mark in alike):
            where = hertz([m.frequency for m in alike if m.text == text and m.frequency])
            by_place.setdefault(where, []).append(text)
        facts = [
            f"{where}: {text}" if where else text
            for where, texts in by_place.items()
            for text in _together(texts)
        ]
        yield alike[0], facts


def _together(texts: Sequence[str]) -> list[str]:
    """Return facts of one place, those of several materials at a bound in one sentence.

    >>> _together([f"{m} {_AT_BOUND.format('lower')}" for m in ("floor", "walls")])
    ['floor and walls stand at their lower bounds']
    """
    said = dict.fromkeys(texts)
    for side in ("lower", "upper"):
        end = f" {_AT_BOUND.format(side)}"
        some = [text for text in texts if text.endswith(end)]
        if len(some) > 1:
            said = {k: None for k in said if k not in some}
            names = listed([text.removesuffix(end) for text in some])
            said[f"{names} stand at their {side} bounds"] = None
    return [*said]


def cautions(marks: Sequence[TrustMark], *, lettered: bool = True) -> list[str]:
    """Return the cautions as texts, grouped by advice: "Caution [s] 125 Hz: facts. Advice.".

    ``marks`` are the cautions. The letters are those of a table of bands; ``lettered`` is False where
    no such table is printed, by default True.
    """
    return [
        f"Caution{f' [{first.letter}]' if first.letter and lettered else ':'} {'; '.join(facts)}. "
        f"{as_sentence(first.advice)}"
        for first, facts in grouped(marks)
    ]
