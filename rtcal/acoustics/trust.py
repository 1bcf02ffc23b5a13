"""The trust marks: reasons to doubt a result, in one band or of the whole room; likely typing errors.

A shifted decimal point changes a value by ten, a lost digit by more. T differs between neighbouring
bands by much less. A value that is far from those of the bands beside it is named before anything else,
since all that follows from it is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import OBSERVABLES, REVERBERATION
from rtcal.acoustics.room import Room
from rtcal.support.types import Array

__all__ = [
    "TrustMark",
    "bent_marks",
    "explained",
    "trust_marks",
]
__dir__ = __all__.copy
from collections.abc import Sequence
from typing import Any

from rtcal.acoustics.bands import mid_frequency_time, schroeder_frequency
from rtcal.acoustics.decay import BentDecay
from rtcal.acoustics.directions import enough_known
from rtcal.acoustics.equations import Eyring
from rtcal.acoustics.observables import TARGET
from rtcal.acoustics.quality import LARGE_Z, gap_jnd
from rtcal.support import checks
from rtcal.support.errors import DataError

FAR = 4.0
"""Ratio of T20 or T30 to both neighbouring bands from which on it counts as mistyped."""
FAR_AT_END = 6.0
"""The same of the first and of the last band, which have one neighbour."""
FAR_ELSE = 10.0
"""The same of EDT and Ts, which direct sound makes short, and of alpha: a resonator is a peak."""


@dataclass(frozen=True)
class TypingError:
    """A value that is likely mistyped: its band in Hz, and the value with those beside it in words."""

    frequency: float
    text: str

    @property
    def sentence(self) -> str:
        """The error with what to do, for messages."""
        return (
            f"likely a typing error at {self.frequency:g} Hz: {self.text}. Check this value before "
            "anything else"
        )


def far_from_neighbours(values: Array, *, late: bool = True) -> NDArray[np.bool_]:
    """Return which values (n_bands,) are far above or below those of the bands beside them.

    Each jump between neighbouring bands begins a new group, unless it leads back to an earlier one. The
    largest group is right. None is flagged where two groups are equally large.

    Parameters
    ----------
    values : array (n_bands,)
        Above 0; others, and NaN, are missing.
    late : bool
        Whether they are T20 or T30. Others are not judged in the first and in the last band.

    Examples
    --------
    >>> far_from_neighbours(np.array([1.4, 1.72, 2.02, 1.94, 0.05, 1.57])).tolist()
    [False, False, False, False, True, False]
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
) -> list[TypingError]:
    """Return the mistyped values of one row (n_bands,).

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
        beside = [*right[right < k][-1:], *right[right > k][:1]]
        told = [f"{values[j]:.3g}{unit} at {bands.label(frequencies[j])}" for j in beside]
        text = f"{name} = {values[k]:.3g}{unit}, beside {' and '.join(told)}"
        out.append(TypingError(float(frequencies[k]), text))
    return out


def in_measurement(measured: Measurement) -> list[TypingError]:
    """Return the mistyped times of a measurement, T20 and T30 first."""
    late = [o for o in REVERBERATION if o.key in measured.values]
    others = [
        o
        for o in OBSERVABLES.values()
        if o.key in measured.values and o not in late and o.unit == "s"
    ]
    out = []
    for o in (*late, *others):
        for pair, row in zip(measured.pairs, measured.values[o.key], strict=True):
            name = o.label if measured.is_summary else f"{o.label} ({' to '.join(pair)})"
            out += of_row(measured.centre_frequencies, row, name, " s", late=o in late)
    return out


def in_room(room: Room) -> list[TypingError]:
    """Return the mistyped coefficients of a room."""
    return [
        error
        for name, row in zip(room.materials, room.alpha, strict=True)
        for error in of_row(room.centre_frequencies, row, f'alpha of "{name}"', late=False)
    ]


_SHORT_PATH = 0.3
"""m. A reverberation chamber full of furniture keeps about 1 m."""


def surface_doubt(room: Room) -> tuple[str, str] | None:
    """Return the kind of mark and a sentence if areas and volume do not fit, else None.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, _ = rt.datasets.bras_cr2()
    >>> surface_doubt(room.replace(volume=4000))[1]
    '202.5 m² of surface cannot enclose 4000 m³, which takes at least 1220 m²'
    """
    area, volume = room.total_area, room.volume
    smallest = 4.84 * volume ** (2 / 3)  # the surface of the sphere of this volume
    if area < smallest:
        return (
            "surface_missing",
            f"{area:.4g} m² of surface cannot enclose {volume:.4g} m³, which takes at least "
            f"{smallest:.4g} m²",
        )
    if (path := 4 * volume / area) < _SHORT_PATH:
        return (
            "surface_beyond_sense",
            f"{area:.4g} m² of surface in {volume:.4g} m³ leave a mean free path of {path:.2g} m",
        )
    return None


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


_ADVICE: dict[str, tuple[str, str]] = {
    "typing_error": (
        "t",
        "likely a typing error: check this value before anything else, and calibrate again. What "
        "follows is computed with it",
    ),
    "unreachable": (
        "n",
        "its coefficients are the ends of their bounds, which says nothing of the materials: check T, "
        "volume and areas, give the materials wider bounds, or look for an effect that the model lacks",
    ),
    "missing": (
        "m",
        "alpha stays as stated there, unless other bands, terms or observations move it: measure the "
        "band, or draw no conclusion from it",
    ),
    "below_schroeder": (
        "s",
        "a few room modes determine the decay, which no reverberation equation describes: do not use "
        "these coefficients at other positions or in other rooms",
    ),
    "air": (
        "a",
        "an error of T, or of the stated climate, counts several times in alpha: measure "
        "temperature and humidity with T",
    ),
    "uncertain": (
        "u",
        "the gap says nothing of the model: measure at more positions, or calibrate with method soft",
    ),
    "at_bound": (
        "b",
        "its sigma or another's is too small, or an effect is missing: state a lower limit (alpha_min) "
        "for hard materials and look for the effect",
    ),
    "at_upper_bound": (
        "b",
        "the other materials supply what T asks for beyond it: this material's sigma, another "
        "material's sigma or this material's area is stated too small, or an effect is missing",
    ),
    "all_at_upper_bound": (
        "b",
        "T asks for more absorption than these materials can have: look for absorption that the "
        "model lacks, for a surface that is missing or too small, or a sigma that is too small",
    ),
    "implausible": (
        "z",
        "the measurement contradicts what was stated of the materials: check areas and volume, "
        "then look for an effect that the model lacks, before using these coefficients",
    ),
    "bent": (
        "c",
        "one T does not describe the decay, and these coefficients follow one slope of it: look for "
        "coupled spaces or absorption on one side, and do not use them at other positions or in other "
        "rooms",
    ),
    "no_air": (
        "",
        "the surfaces are made to absorb what the air does, most of all above 1 kHz: state "
        "temperature and humidity",
    ),
    "no_uncertainty": (
        "",
        "z and Q may be too large: state T per source and receiver, or its uncertainty",
    ),
    "implausible_modes": (
        "",
        "the modes contradict each other or what was stated of the materials: are T and "
        "decays called so, and which modes are they? Then check the stated coefficients",
    ),
    "surface_missing": ("", "a surface is missing, or the volume is wrong: check both"),
    "surface_beyond_sense": ("", "are the areas in m² and the volume in m³?"),
    "clipped": (
        "",
        "a laboratory value above 1 counts the specimen's edges too, so the true one is not known: "
        "state a larger sigma for these materials",
    ),
    "dimensions": (
        "",
        "one of them is wrong: the absorption that T asks for is proportional to the volume",
    ),
    "equations_differ": (
        "",
        "these coefficients, and each prediction with them, depend on the equation: calibrate by path "
        "tracing (`rtcal fit` with a mesh, `rtcal loop` with a simulator), and predict a change of one "
        "surface there",
    ),
    "wide_sigma": (
        "",
        "any T agrees with so large a sigma: is it relative to alpha, or in percent?",
    ),
}

_AIR_SHARE = 0.5
_ODD_UNCERTAINTY = 0.3
"""Of T, relative. Single decays of 0.3 s at 63 Hz, the least certain, scatter by 0.24."""
OFF_VOLUME = 0.1
"""Relative difference of the volume from that of the stated dimensions: plans are no more precise."""
_WIDE_SIGMA = 0.5
"""The standard deviation of a coefficient of which nothing is known, uniform from 0 to 1, is 0.29."""


def mark(kind: str, frequency: float | None, text: str, advised: str = "") -> TrustMark:
    """Return the mark of a kind; ``advised`` is the kind whose advice it has, by default its own."""
    letter, advice = _ADVICE[advised or kind]
    return TrustMark(kind, letter, frequency, text, advice)


def bent_marks(bent: Sequence[BentDecay]) -> tuple[TrustMark, ...]:
    """Return the trust marks of bands whose decay is bent."""
    return tuple(mark("bent", band.frequency, band.text) for band in bent)


def typing_marks(room: Room, measured: Sequence[TypingError]) -> tuple[TrustMark, ...]:
    """Return the trust marks of likely typing errors, measured and in the room."""
    return tuple(
        mark(kind, error.frequency, error.text, "typing_error")
        for kind, errors in (("typing_error", measured), ("alpha_typing_error", in_room(room)))
        for error in errors
    )


def uneven_marks(room: Room, shares: Array) -> tuple[TrustMark, ...]:
    """Return the mark of a room whose absorption is so uneven that equations differ by over one JND.

    Compared are Eyring's T, for which all surfaces count alike, and Arau-Puchades', for which the
    surfaces of each axis count for themselves (`rtcal.acoustics.equations.ArauPuchades`).

    Parameters
    ----------
    room : Room
        With the coefficients to compare by.
    shares : array (n_materials, 3)
        Directions of each material, as `rtcal.acoustics.directions.facing` returns them. Where most of
        the absorption has no known direction there is no mark; the rest counts a third each.

    Examples
    --------
    >>> import rtcal as rt
    >>> room = rt.Room(name="classroom", volume=180, materials=["ceiling", "floor", "walls"],
    ...                areas=[60, 60, 96], alpha=[[0.8], [0.04], [0.03]],
    ...                sigma=[[0.1], [0.01], [0.01]], centre_frequencies=[500])
    >>> from rtcal.acoustics.directions import facing
    >>> uneven_marks(room, facing(room))[0].text[:66]
    "the absorption is uneven: Arau-Puchades' equation gives 0.89 s for"
    """
    if not enough_known(room, shares):
        return ()
    along = room.areas[:, np.newaxis] * np.where(np.isnan(shares), 1 / 3, shares)
    areas = along.sum(axis=0)
    along, areas = along[:, areas > 0], areas[areas > 0]
    eyring = Eyring()
    mean = np.minimum(along.T @ room.alpha / areas[:, np.newaxis], eyring.largest_mean)
    exponents = np.vstack([eyring.exponent(mean), eyring.exponent(areas @ mean / areas.sum())])
    absorbed = room.total_area * exponents + 4 * room.air_attenuation * room.volume
    known = (absorbed > 0).all(axis=0)
    times = eyring.room_constant(room) * room.volume / np.where(known, absorbed, np.nan)
    arau: Array = np.exp(areas @ np.log(times[:-1]) / areas.sum())
    differ = np.nan_to_num(np.abs(gap_jnd(arau, times[-1])))
    k = int(np.argmax(differ))
    if not differ[k] > 1:
        return ()
    text = (
        f"the absorption is uneven: Arau-Puchades' equation gives {arau[k]:.2f} s for Eyring's "
        f"{times[-1, k]:.2f} s at {room.centre_frequencies[k]:g} Hz, {differ[k]:.1f} JND apart"
    )
    return (mark("equations_differ", None, text),)


def uncarried_mark(frequency: float, low: float, high: float) -> TrustMark:
    """Return the mark of a band below the Schroeder frequency that too few modes carry.

    ``low`` to ``high`` are the frequencies in Hz in which they would lie.
    """
    text = (
        "below the Schroeder frequency, and fewer than three of the modes used lie from "
        f"{low:.0f} to {high:.0f} Hz, or none in the band itself"
    )
    return mark("below_schroeder", float(frequency), text)


def implausible_modes_mark(
    q: float, count: int, p_value: float, strangest: float, factor: float, z: float
) -> TrustMark:
    """Return the mark of decays of modes that what was stated does not explain.

    ``strangest`` is the mode in Hz that contributes most to Q. All decays together are ``factor``
    times those stated, ``z`` standard deviations off.
    """
    text = (
        f"decays of {count} modes have Q = {q:.1f}, p = {p_value:.1g}; {strangest:.1f} Hz contributes "
        f"most; together they are {factor:.2g} times as fast as stated coefficients make them "
        f"(z = {z:.1f})"
    )
    return mark("implausible_modes", None, text)


def trust_marks(
    room: Room,
    measured: Array,
    uncertainty: Array,
    air_share: Array,
    active: NDArray[Any],
    z: Array,
    unreachable: Sequence[float] = (),
    bent: Sequence[BentDecay] = (),
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
        See `Plausibility`.
    unreachable : sequence of float
        Centre frequencies in Hz of bands that were moved to the nearest end.
    bent : sequence of BentDecay
        Bands whose measured decay is not straight.
    """
    checks.instance("room", room, Room)
    measured = checks.array("measured", measured)
    if measured.shape != (room.n_bands,):
        raise DataError(f"measured has shape {measured.shape}, not (n_bands,) = ({room.n_bands},)")
    marks: list[TrustMark] = []

    def add(*stated: Any) -> None:
        marks.append(mark(*stated))

    if room.air is None:
        add("no_air", None, "no air is stated")
    if (doubt := surface_doubt(room)) is not None:
        add(doubt[0], None, doubt[1])
    if room.dimensions is not None:
        box = float(np.prod(room.dimensions))
        if abs(room.volume / box - 1) > OFF_VOLUME:
            sides = " x ".join(f"{side:g}" for side in room.dimensions)
            text = f"volume = {room.volume:g} m³, but the dimensions {sides} m hold {box:g} m³"
            add("dimensions", None, text)
    wide = np.argwhere(room.sigma > _WIDE_SIGMA)
    if len(wide):
        i, k = wide[0].tolist()
        text = f"{room.place('sigma', i, k)} = {room.sigma[i, k]:g} is above {_WIDE_SIGMA:g}"
        others = f", and {len(wide) - 1} more" if len(wide) > 1 else ""
        add("wide_sigma", None, text + others)
    if room.clipped:
        add("clipped", None, f"cut to 1: {'; '.join(room.clipped)}")
    has_t = np.isfinite(measured)
    if has_t.any() and not np.isfinite(uncertainty[has_t]).any():
        add("no_uncertainty", None, "the uncertainty of T is not known")
    middle = mid_frequency_time(measured, room.centre_frequencies)
    limit = float(schroeder_frequency(np.array(middle), room.volume))
    for k, frequency in enumerate(room.centre_frequencies):
        f = float(frequency)
        if np.isnan(measured[k]):
            add("missing", f, "not calibrated, no T was measured")
        elif f < limit:
            add("below_schroeder", f, f"below the Schroeder frequency, {limit:.0f} Hz")
        if f in unreachable:
            add("unreachable", f, "no coefficients within the bounds give this T")
        marks += bent_marks([band for band in bent if band.frequency == f])
        if air_share[k] > _AIR_SHARE:
            add("air", f, "the air absorbs more than the surfaces")
        if uncertainty[k] > _ODD_UNCERTAINTY * measured[k]:
            over = f"{100 * _ODD_UNCERTAINTY:.0f} %"
            add("uncertain", f, f"T is uncertain by over {over}: is it stated in percent, not s?")
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
            add("implausible", f, f"T asks for {side} absorption than was stated, |z| over 2")
    return tuple(marks)


def letters(marks: Sequence[TrustMark], frequency: float) -> str:
    """Return the letters of a band's marks, without repeats; empty if it has none."""
    return "".join(dict.fromkeys(m.letter for m in marks if m.frequency == frequency))


def explained(marks: Sequence[TrustMark]) -> list[str]:
    """Return the marks as lines of text, grouped by advice: the facts, then the advice."""
    lines = []
    for advice in dict.fromkeys(mark.advice for mark in marks):
        alike = [mark for mark in marks if mark.advice == advice]
        letter = f"[{alike[0].letter}] " if alike[0].letter else ""
        texts = []
        for text in dict.fromkeys(mark.text for mark in alike):
            where = [f"{m.frequency:g}" for m in alike if m.text == text and m.frequency]
            texts.append(f"{', '.join(where)} Hz: {text}" if where else text)
        lines += [f"{letter}{'; '.join(texts)}", f"    -> {advice}"]
    return lines
