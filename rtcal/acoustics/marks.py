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
    observable,
    of_kind,
)
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import as_sentence
from rtcal.support.types import Array

__all__ = ["gap_jnd", "plausibility", "trust_marks"]
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
    """Return the root mean square of the known values over some axes; NaN without a known value."""
    known = np.isfinite(values)
    squares = np.where(known, values, 0.0) ** 2
    with np.errstate(invalid="ignore"):
        return np.sqrt(squares.sum(axis=axis) / known.sum(axis=axis))


MET = 0.5
"""Gap in JND below which the words count the measured T as met: half of what can be heard."""
P_CONTRADICTION = 0.05
"""Below this p-value, prior and measurement contradict each other: the usual level of 5 %."""
LARGE_Z = 2.0
"""z of a band that contradicts the input coefficients."""
P_TOO_GOOD = 0.99
"""Above this p-value, prior and measurement agree too well to be true.

If prior and measurement are right, the p-value is uniform, so 1 room in 100 is marked by chance. If
all standard deviations are f times too large, P(chi² < f² chi²_0.01) of the rooms are marked. In
six octaves these are 25 % for f = 2 and 75 % for f = 3, in 18 thirds 94 % for f = 2."""


@dataclass(frozen=True, eq=False)
class Plausibility:
    """Agreement of prior and measurement. The gap cannot show it, because a calibration closes it."""

    z: Array
    """b - S'mu over its standard deviation, (n_bands,); NaN where nothing was matched."""
    q: float
    """z'R^-1 z, R the correlation of z between bands; the sum of z² where the bands are independent."""
    degrees_of_freedom: int
    """One per matched band, not one per coefficient."""
    p_value: float | None
    """The probability of a larger q if prior and measurement are right. None where a bound is active,
    because then q is not chi-square."""
    p_together: float | None = None
    """The same if the coefficients may also be off together, as `rtcal.finder` assumes
    (`rtcal.acoustics.room_errors`). None where these errors are not known."""


Agreement = Literal["contradicts", "agrees", "too good"]


def agreement(p_value: float | None, p_together: float | None = None) -> Agreement | None:
    """Return whether measurement and prior contradict, agree, or agree too well to be true.

    Too well: S'mu is nearer to b than the stated uncertainties make likely. Then a sigma or u_T is
    too large, or T was calculated from these coefficients. None without a p-value. What coefficients
    that are off together explain (``p_together``, of `Plausibility`) is no contradiction.
    """
    if p_value is None:
        return None
    if max(p_value, p_together or 0.0) < P_CONTRADICTION:
        return "contradicts"
    return "too good" if p_value > P_TOO_GOOD else "agrees"


def plausibility(
    difference: Array, covariance: Array, bound_active: bool, together: Array | None = None
) -> Plausibility:
    """Return how well T agrees with the input: z per band, and Q over all bands.

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
    """A reason to doubt one band, with its ``frequency`` in Hz, or the whole room, with None.

    ``kind`` names it, ``letter`` stands for it in tables, ``text`` states the fact and ``advice``
    says what to do.
    """

    kind: str
    letter: str
    frequency: float | None
    text: str
    advice: str

    @property
    def title(self) -> str:
        """Name of the kind in words."""
        return self.kind.replace("_", " ").replace("schroeder", "Schroeder")

    @property
    def is_error(self) -> bool:
        """Whether the mark is a likely typing error, which a result states before anything else."""
        return self.kind.endswith("_error")

    @property
    def as_error(self) -> str:
        """A likely typing error, with its band if it has one."""
        where = "" if self.frequency is None else f" at {self.frequency:g} Hz"
        return f"likely a typing error{where}: {self.text}"

    @property
    def checked(self) -> str:
        """What may be mistyped: a value in one band, else what all bands have in common."""
        return "areas, volume and T" if self.frequency is None else "this value"

    @property
    def sentence(self) -> str:
        """What is doubted, with what to do, for messages."""
        if not self.is_error:
            return f"{self.text}: {self.advice}"
        return f"{self.as_error}. Check {self.checked} before anything else"


_ADVICE: dict[str, tuple[str, str]] = {
    "typing_error": (
        "t",
        "likely a typing error: check this value before anything else, and calibrate again. All "
        "results are computed with it",
    ),
    "unit_error": (
        "",
        "likely a typing error, or another unit: check T (in s), the volume (in m³) and the areas "
        "(in m²) before anything else. All results are computed with them",
    ),
    "surface": (
        "",
        "check each area, the volume and the dimensions before anything else: every coefficient is "
        "computed with them",
    ),
    "fixed": (
        "",
        "no coefficient can move: give uncertain coefficients a sigma above 0, or the file a [prior]",
    ),
    "unreachable": (
        "n",
        "its coefficients are at their bounds and do not describe the materials: check T, volume and "
        "areas, give the materials wider bounds, or look for an effect that the model lacks",
    ),
    "missing": (
        "m",
        "alpha keeps its input value there, unless other bands, terms or observations move it: measure "
        "the band, or draw no conclusion from it",
    ),
    "below_schroeder": (
        "s",
        "a few room modes determine the decay there: do not use these coefficients at other positions "
        "or in other rooms",
    ),
    "air": (
        "a",
        "an error of T or of the climate causes an error of alpha several times as large: measure "
        "temperature and humidity with T",
    ),
    "uncertain": (
        "u",
        "the deviation cannot show whether the model is right: measure at more positions, or calibrate "
        'with the method "soft", which fits T within its uncertainty',
    ),
    "at_bound": (
        "b",
        "the sigma of this or another material is too small, or an effect is missing: give hard "
        "materials a lower limit (alpha_min) and look for the effect",
    ),
    "at_upper_bound": (
        "b",
        "the other materials supply the rest of the absorption that T needs: this material's sigma, "
        "another material's sigma or this material's area is too small, or an effect is missing",
    ),
    "all_at_upper_bound": (
        "b",
        "T needs more absorption than these materials can have: look for absorption that the "
        "model lacks, for a surface that is missing or too small, or a sigma that is too small",
    ),
    "implausible": (
        "z",
        "check areas and volume, then look for a missing effect, before using these coefficients",
    ),
    "bent": (
        "c",
        "one T does not describe the decay, and these coefficients follow one slope of it: look for "
        "coupled spaces or absorption on one side, and do not use them at other positions or in other "
        "rooms",
    ),
    "no_air": (
        "",
        "the surfaces are made to absorb what the air does, most of all above 1 kHz: give the "
        "room's file temperature and humidity",
    ),
    "no_uncertainty": (
        "",
        "the test of the input may be too strict: give T per source and receiver, or its uncertainty",
    ),
    "implausible_modes": (
        "",
        "the modes contradict each other or the input coefficients: check whether the table holds T or "
        "decays, and which modes they are, then check the coefficients",
    ),
    "clipped": (
        "",
        "a laboratory value above 1 includes the specimen's edges, so the true coefficient is not "
        "known: give these materials a larger sigma",
    ),
    "dimensions": (
        "",
        "the volume or a dimension is wrong: the absorption that T needs is proportional to the volume",
    ),
    "equations_differ": (
        "",
        "these coefficients, and each prediction with them, depend on the equation: calibrate by path "
        "tracing (`rtcal fit` with a mesh, `rtcal loop` with a simulator), and predict a change of one "
        "surface there",
    ),
    "directions_unknown": ("", NOT_KNOWN),
    "wide_sigma": (
        "",
        "any T agrees with so large a sigma: is it relative to alpha, or in percent?",
    ),
}


def mark(kind: str, frequency: float | None, text: str, advised: str = "") -> TrustMark:
    """Return the mark of a kind; ``advised`` is the kind whose advice it has, by default its own."""
    letter, advice = _ADVICE[advised or kind]
    return TrustMark(kind, letter, frequency, text, advice)


FAR = 4.0
"""Ratio of T20 or T30 to both neighbouring bands from which on it counts as mistyped."""
FAR_AT_END = 6.0
"""The same of the first and of the last band, which have one neighbour."""
FAR_ELSE = 10.0
"""The same of EDT and Ts, which direct sound makes short, and of alpha: a resonator is a peak."""


def far_from_neighbours(values: Array, *, late: bool = True) -> NDArray[np.bool_]:
    """Return which values (n_bands,) are far above or below those of the bands beside them.

    Each jump between neighbouring bands begins a new group, unless it leads back to an earlier one. The
    largest group is right. None is flagged where two groups are equally large. Values that are not
    above 0 are missing. Unless ``late`` (T20 or T30), the first and the last band are not judged.
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
    """Return the marks of the values of one row (n_bands,) that are likely mistyped.

    ``name`` is what is printed: "T30 (S1 to R2)", "alpha of floor".

    Examples
    --------
    >>> of_row(np.array([500, 1000, 2000]), np.array([1.9, 19.4, 1.6]), "T20", " s")[0].text
    'T20 = 19.4 s, beside 1.9 s at 500 Hz and 1.6 s at 2000 Hz'
    """
    wrong = far_from_neighbours(values, late=late)
    right = np.flatnonzero(np.isfinite(values) & ~wrong)
    out = []
    for k in np.flatnonzero(wrong):
        near = [*right[right < k][-1:], *right[right > k][:1]]
        beside = [f"{values[j]:.3g}{unit} at {bands.label(frequencies[j])}" for j in near]
        text = f"{name} = {values[k]:.3g}{unit}, beside {' and '.join(beside)}"
        kind = "alpha_typing_error" if name.startswith("alpha") else "typing_error"
        out.append(mark(kind, float(frequencies[k]), text, "typing_error"))
    return out


def in_measurement(measured: Measurement) -> list[TrustMark]:
    """Return the marks of mistyped times of a measurement, T20 and T30 first."""
    kinds = [OBSERVABLES[key] for key in measured.values]
    late = [o for o in REVERBERATION if o in kinds]
    out = []
    for o in (*late, *(o for o in kinds if o not in late and o.unit == "s")):
        for pair, row in zip(measured.pairs, measured.values[o.key], strict=True):
            name = o.label if measured.is_summary else f"{o.label} ({' to '.join(pair)})"
            out += of_row(measured.centre_frequencies, row, name, " s", late=o in late)
    return out


LEAST_OF_BOX, MOST_OF_BOX = 0.9, 1.4
"""Surface of a room over that of the box of its dimensions. Furniture and steps add up to 0.4; what
stands against a wall, or a corner that is cut off, takes 0.1."""
FLATTEST, FLAT = 20.0, 10.0
"""Length and width over height where no dimensions are stated: of the flattest room, of a usual one."""
_SLIPS = (0.1, 10.0), (0.01, 100.0)
_CORRECTED = 0.2
"""Largest relative difference from the box with which an area counts as mistyped by such a factor."""


def surface_limits(room: Room, flattest: float = FLATTEST) -> tuple[float, float]:
    """Return the least and the most surface in m² of a room of these dimensions, or of this volume.

    Without dimensions they are 0.9 times that of a cube, and that of a box ``flattest`` times as long
    and wide as high.
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
    """Return each likely slip of a decimal point: the value in words, and the corrected room.

    A slip is one area, or the volume, that is 10 or 100 times too large or too small, so that the
    room has a likely surface once it is corrected. The list is empty where the surface is likely
    already, and where more than two slips would explain it.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["floor", "rest"], areas=[200, 74],
    ...             alpha=[[0.4], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000],
    ...             dimensions=(5, 4, 3))
    >>> [text for text, _ in likely_slips(room)]
    ['area of "floor" = 200 m², for 20 m²']
    """
    least, most = surface_limits(room)
    if least <= room.total_area <= most:
        return []
    for factors in _SLIPS:
        slips = [(i, f) for f in factors for i in np.flatnonzero(room.is_surface).tolist()]
        total = np.array([room.total_area + (f - 1) * room.areas[i] for i, f in slips])
        if room.dimensions is not None:
            off = np.abs(total / _surface_of_box(*room.dimensions) - 1)
            found = [_slipped(room, *slips[np.argmin(off)])] if min(off) <= _CORRECTED else []
        else:
            low, high = surface_limits(room, FLAT)
            fits = np.flatnonzero((total >= low) & (total <= high))
            found = [_slipped(room, *slips[j]) for j in fits]
            for other in (room.replace(volume=room.volume * f) for f in factors):
                text = f"volume = {room.volume:g} m³, for {other.volume:g} m³"
                low, high = surface_limits(other, FLAT)
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
    """Return the mark of areas that enclose no room of the stated dimensions, or else of the volume.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> of_surface(room.replace(volume=4000))[0].text
    'the areas add up to 202.5 m², but even a cube of 4000 m³ has 1512 m²'
    """
    area, volume, (least, most) = room.total_area, room.volume, surface_limits(room)
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
    """Return the mark of a T that differs by one factor in all bands from T of the stated coefficients.

    ``times`` are the measured T and ``stated`` those of the coefficients in s, (n_bands,), NaN where
    missing; ``name`` and ``of`` are both in words.

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
    by = f"{low:.2g}" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g}"
    where = "in every band" if off.size > 1 else "in the one band that was measured"
    text = f"{name} is {by} times {of} {where}"
    return [mark("unit_error", None, text)]


def of_input(
    room: Room,
    times: Array | None = None,
    mistyped: Sequence[TrustMark] = (),
) -> tuple[TrustMark, ...]:
    """Return the doubts about a room and its T that stand before every result, in one order.

    The measured T, ``times`` in s, (n_bands,), NaN where missing, is compared with Eyring's of the
    stated coefficients. ``mistyped`` are the marks of single values of T, as `of_row` returns them.
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
    """Return the marks of bands whose mean decay over the positions is bent.

    A band is bent if T30/T20 or EDT/T20 leaves 1 by more than its limit and twice the scatter of
    the ratio in straight decays. Only positions that have both parameters count.
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
_ODD_UNCERTAINTY = 0.3
"""Of T, relative. Single decays of 0.3 s at 63 Hz, the least certain, scatter by 0.24."""
OFF_VOLUME = 0.1
"""Relative difference of the volume from that of the stated dimensions: plans are no more precise."""
_WIDE_SIGMA = 0.5
"""The standard deviation of a coefficient of which nothing is known, uniform from 0 to 1, is 0.29."""


def uneven_marks(room: Room, shares: Array) -> tuple[TrustMark, ...]:
    """Return the mark of a room whose absorption is so uneven that equations differ by over one JND.

    Compared are Eyring's T, for which all surfaces count alike, and Arau-Puchades', for which the
    surfaces of each axis count for themselves (`rtcal.acoustics.equations.ArauPuchades`), with the
    coefficients of ``room``. ``shares`` (n_materials, 3) are the directions of each material, as
    `rtcal.acoustics.changes.facing` returns them; unknown ones count a third each. Where most of the
    absorption has no known direction the mark says that this is not judged, if the equations
    differed with all of the material that absorbs most across one axis.
    """
    known, total = enough_known(room, shares), room.total_area
    absorbed = np.where(np.isnan(shares[:, 0]), room.areas * room.alpha.mean(axis=1), -1.0)
    most = int(np.argmax(absorbed))
    if not known:
        # As little of the others beside it as the shape of a cube leaves.
        others = max(total / 3 - room.areas[most], 0.0) / max(total - room.areas[most], 1e-9)
        shares = np.tile([(1 - others) / 2, (1 - others) / 2, others], (room.n_materials, 1))
        shares[most] = 0, 0, 1
    along = room.areas[:, np.newaxis] * np.where(np.isnan(shares), 1 / 3, shares)
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
        return (mark("equations_differ", None, text),)
    text = (
        f"the direction of the absorption is unknown: if all of {room.materials[most]} faced one "
        f"way, T at {at} would be {times}"
    )
    return (mark("directions_unknown", None, text),)


def z_within_bounds(
    room: Room, difference: Array, variance: Array, shift: Array, active: NDArray[Any]
) -> Array:
    """Return z of bands in which coefficients stand at bounds, (n_bands,); NaN elsewhere.

    It is the distance of the nearest point within the bounds that has the measured T from what was
    stated, in standard deviations, which tells the probability beyond it to first order (Hasofer & Lind
    1974, J. Eng. Mech. Div. ASCE 100, 111-121): z² is the sum of the squared shifts of the coefficients
    at bounds, over sigma, and r² over its variance, where r of b - S'mu is left to the others.

    ``difference`` and ``variance`` (n_bands,) are b - S'mu in m², and its variance without bounds.
    ``shift`` (n_materials, n_bands) is alpha - mu, ``active`` where it stands at a bound.

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
    """Return every reason to doubt single bands or the room.

    Parameters
    ----------
    room : Room
    measured, uncertainty : array (n_bands,)
        T and its standard uncertainty in s; NaN where missing or unknown.
    air_share : array (n_bands,)
        The air's share of the whole absorption.
    active : array (n_materials, n_bands)
        Where a coefficient stands at a bound: -1 for the lower, 1 for the upper one, else 0.
    z : array (n_bands,)
        See `Plausibility`; where a coefficient stands at a bound as of `z_within_bounds`.
    unreachable : sequence of float
        Centre frequencies in Hz of bands that were moved to the nearest end.
    bent : sequence of TrustMark
        Those of `bent_decays`.
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
            add("uncertain", f, f"T is uncertain by over {over}: is it in percent, not s?")
        elif uncertainty[k] > TARGET.jnd_of(measured[k]) and not abs(z[k]) > LARGE_Z:
            add("uncertain", f, "T is uncertain by more than one JND")
        # A single coefficient at 1 says nothing of the others, which may still give the T.
        spent = bool((active[:, k] > 0)[room.sigma[:, k] > 0].all())
        upper = "all_at_upper_bound" if spent else "at_upper_bound"
        for i in np.flatnonzero(active[:, k]).tolist():
            side, advised = ("lower", "") if active[i, k] < 0 else ("upper", upper)
            add("at_bound", f, f"{room.materials[i]} stands at its {side} bound", advised)
        if abs(z[k]) > LARGE_Z:
            side = "more" if z[k] > 0 else "less"
            add(
                "implausible",
                f,
                f"T needs {side} absorption than the input, by over 2 σ",
            )
    return tuple(marks)


def letters(marks: Sequence[TrustMark], frequency: float) -> str:
    """Return the letters of a band's marks, without repeats; empty if it has none."""
    return "".join(dict.fromkeys(m.letter for m in marks if m.frequency == frequency))


def grouped(marks: Sequence[TrustMark]) -> Iterator[tuple[TrustMark, list[str]]]:
    """Yield the first mark of each kind and advice, and the facts of all of them."""
    for kind, advice in dict.fromkeys((mark.kind, mark.advice) for mark in marks):
        alike = [mark for mark in marks if (mark.kind, mark.advice) == (kind, advice)]
        facts = []
        for text in dict.fromkeys(mark.text for mark in alike):
            where = hertz([m.frequency for m in alike if m.text == text and m.frequency])
            facts.append(f"{where}: {text}" if where else text)
        yield alike[0], facts


def cautions(marks: Sequence[TrustMark]) -> list[str]:
    """Return the marks as cautions, grouped by advice: "Caution [s] 125 Hz: facts. Advice."."""
    return [
        f"Caution{f' [{first.letter}]' if first.letter else ':'} {'; '.join(facts)}. "
        f"{as_sentence(first.advice)}"
        for first, facts in grouped(marks)
    ]
