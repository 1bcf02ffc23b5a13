"""Modes as they were measured: read from a table, or found in impulse responses; and which they are.

A measured mode has a frequency, a decay, their uncertainty, and a pattern over positions. It is a
calculated mode, or none, with a probability. All calculated frequencies share an error (speed of sound,
size) and each has one of its own. The probability weighs the normal density of the frequencies'
difference, and that of the logarithm of the decays' ratio.

No measured mode and no calculated one is used twice: a match counts where its probability is large seen
from either side. Modes of responses need no matching: they were found as the room's own.

`find_modes` fits the room's poles to the spectra of its responses. Where modes overlap, responses alone
do not say how many there are. The room does: its calculated modes have poles, and patterns over the
positions (`rtcal.modes.room_modes`). What is returned of each mode is what the responses say of it: its
posterior, less its own prior. A mode of which they say too little is left out, and so is one that is
nearer to another calculated mode.

The spectra of the pairs r of positions are those of the room's poles s_n, in the form that samples of
finite length have:

    Y_r(w) = sum_n A_nr / (j w - s_n) + conj(A_nr) / (j w - conj(s_n)) + error.

Unknown are the poles, with the calculated ones as prior, and the amplitudes, with A_nr = q(f_n) psi_nr
as prior: psi is what the positions hear of each mode, and q, the source's spectrum, is smooth and
follows from the amplitudes themselves. A scan finds the factor that all calculated frequencies share.
Gauss-Newton steps with Levenberg's damping then fit everything. The amplitudes of all pairs have one
information matrix, and fall out of the poles' (variable projection; Golub & Pereyra 1973).

References
----------
Golub & Pereyra 1973, SIAM J. Numer. Anal. 10; Kay 1993, Fundamentals of Statistical Signal Processing.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.observables import LIMITS
from rtcal.acoustics.room import Room, fingerprint
from rtcal.files.disk import read_bytes
from rtcal.io.impulse_responses import clipped_samples
from rtcal.io.sofa import Responses
from rtcal.io.table_columns import (
    COLUMNS,
    DOUBTFUL,
    OPEN_DECAY_TIMES,
    name_and_unit,
    plain,
    statistic_of,
    with_units,
)
from rtcal.io.tables import sheets_of
from rtcal.io.text import MAX_TEXT, number, shown
from rtcal.modes.room_modes import ABOVE, DECAY, Complex, Poles, RoomPoles
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
from rtcal.support.types import Array, put

__all__ = ["MeasuredModes", "read"]
__dir__ = __all__.copy

_SINGLE = (1.0, 1000.0)
"""Hz within which rooms have single modes."""
_UNITS = {
    "frequency": {"Hz": 1.0, "kHz": 1000.0},
    "decay": {"1/s": 1.0, "s^-1": 1.0, "s-1": 1.0},
    "T": {"s": 1.0, "ms": 1e-3},
}
_NEED_NO_UNIT = {
    "frequency": _SINGLE,
    "T": (0.03, 30.0),
    "decay": (DECAY / 30.0, DECAY / 0.03),
}
"""Values that need no unit: outside, kHz or ms is likelier."""
_LARGEST_UNCERTAINTY = 0.3
"""Relative uncertainty that needs no unit: above, % or ms is likelier."""
_WORDS = dict.fromkeys((word for word, kind in COLUMNS.items() if kind == "band"), "frequency")
_WORDS |= dict.fromkeys(("decay", "delta", "δ", "abklingkonstante", "decayconstant"), "decay")
_WORDS |= dict.fromkeys((*OPEN_DECAY_TIMES, "mt60", "decaytime"), "T")
_RELATIVE = ("%", "percent")
_UNIT_WORDS = {*_RELATIVE, "-", *(unit.lower() for units in _UNITS.values() for unit in units)}
_NUMBERS = ("frequencies", "decays", "decay_uncertainty", "frequency_uncertainty")
_OF_MODES = (*_NUMBERS, "amplitudes", "calculated")


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredModes:
    """Hold measured room modes with their frequencies, their decays and, if known, their amplitudes.

    Parameters
    ----------
    frequencies : array (n_modes,)
        Frequency of each mode in Hz, from 1 to 1000, rising.
    decays : array (n_modes,)
        Decay constant delta = 6.91 / T of each mode in 1/s: the pressure falls as exp(-delta t).
    decay_uncertainty : array (n_modes,)
        Standard uncertainty of each decay constant in 1/s, above 0.
    frequency_uncertainty : array (n_modes,), optional
        Standard uncertainty of each frequency in Hz; 0.01 Hz by default.
    amplitudes : complex array (n_modes, n_pairs), optional
        Complex amplitude of each mode at each source-receiver pair; None if unknown.
    calculated : int array (n_modes,), optional
        Number of the calculated mode to which each measured mode belongs; None if no modes were
        calculated to find the measured ones.
    largest : float, optional
        Frequency in Hz up to which modes were calculated to find the measured ones; 0 if none were.
    notes : sequence of str
        Sentences on how the modes were found, and on what was left out.

    Raises
    ------
    DataError
        For shapes that do not fit, or a value that breaks a rule.

    Examples
    --------
    >>> modes = MeasuredModes(frequencies=[34.1, 42.7], decays=[5.2, 6.0], decay_uncertainty=[0.3, 0.4])
    >>> print(modes.decay_times.round(2))
    [1.33 1.15]
    """

    frequencies: Array
    decays: Array
    decay_uncertainty: Array
    frequency_uncertainty: Array | None = None
    amplitudes: NDArray[np.complex128] | None = None
    calculated: NDArray[np.intp] | None = None
    largest: float = 0.0
    notes: Sequence[str] = ()

    def __post_init__(self) -> None:
        def require(name: str, good: NDArray[np.bool_], found: Array, rule: str) -> None:
            if not good.all():
                bad = int(np.argmin(good))
                raise DataError(f"{name}[{bad}] = {found[bad]:.6g} {rule}")

        n = checks.array("frequencies", self.frequencies).size
        if n == 0:
            raise DataError("frequencies is empty; give at least one mode")
        if self.frequency_uncertainty is None:
            put(self, frequency_uncertainty=np.full(n, 0.01))
        for name in _NUMBERS:
            values = checks.shaped(name, getattr(self, name), n)
            require(name, np.isfinite(values) & (values > 0), values, "must be finite and above 0")
            put(self, **{name: values})
        for name, found, (low, high), unit in (
            ("frequencies", self.frequencies, _SINGLE, "Hz"),
            ("decays", self.decay_times, LIMITS, "s (6.91 / delta)"),
        ):
            rule = f"{unit} must be from {low:g} to {high:g}, where rooms have single modes; "
            good = (found >= low) & (found <= high)
            require(name, good, found, f"{rule}check the unit")
        rising = np.diff(self.frequencies, prepend=0.0) > 0
        require("frequencies", rising, self.frequencies, "Hz must be above the frequency before it")
        put(self, largest=checks.between("largest", self.largest, 0, np.inf, "Hz"))
        put(self, notes=tuple(checks.listed("notes", self.notes)))
        if self.amplitudes is not None:
            try:
                amplitudes = np.array(self.amplitudes, dtype=complex)
            except (TypeError, ValueError, OverflowError) as cause:
                raise DataError(f"amplitudes must be an array of numbers: {cause}") from cause
            if amplitudes.ndim != 2 or len(amplitudes) != n or not np.isfinite(amplitudes).all():
                raise DataError(
                    f"amplitudes has shape {amplitudes.shape}; with {n} modes it must be "
                    f"({n}, n_pairs), and finite"
                )
            put(self, amplitudes=amplitudes)
        if self.calculated is not None:
            own = checks.shaped("calculated", self.calculated, n)
            if len(np.unique(own)) < n or not ((own >= 0) & (own % 1 == 0) & (own < 2**31)).all():
                raise DataError(
                    f"calculated must have {n} different whole numbers of 0 or more, one "
                    "for each measured mode"
                )
            put(self, calculated=own.astype(int))

    def __repr__(self) -> str:
        f = self.frequencies
        return f"<MeasuredModes: {f.size} from {f[0]:.1f} to {f[-1]:.1f} Hz>"

    @property
    def fingerprint(self) -> str:
        """Text that identifies these modes, so that a room is not calibrated to them twice."""
        labels = (f"{f:.2f}" for f in self.frequencies.tolist())
        return fingerprint("modes", dict(zip(labels, self.decays.tolist(), strict=True)))

    @property
    def decay_times(self) -> Array:
        """Decay time T of each mode in s, (n_modes,)."""
        return np.asarray(DECAY / self.decays)

    def only(self, chosen: Sequence[int] | NDArray[np.intp]) -> MeasuredModes:
        """Return some of the modes, by their numbers, in this order.

        ``chosen`` are numbers of modes, counted from 0.
        """
        rows = np.sort(np.asarray(chosen, dtype=int))
        inside = rows.size and rows[0] >= 0 and rows[-1] < self.frequencies.size
        if not inside:
            raise DataError(
                f"chosen = {checks.shown(chosen)}: modes are numbered 0 to {self.decays.size - 1}"
            )
        of_modes = {name: getattr(self, name) for name in _OF_MODES}
        return replace(self, **{n: v[rows] for n, v in of_modes.items() if v is not None})


def read(path: str | os.PathLike[str]) -> MeasuredModes:
    r"""Return measured modes that are read from a table (CSV file, or sheet of a workbook).

    The table must have a column ``frequency`` in Hz; a column ``decay`` in 1/s or ``T`` in s; and its
    standard uncertainty as ``u_decay`` or ``u_T``. It may have a column ``u_frequency``. The header, or
    a row of units below it, may name other units: kHz, ms or, for an uncertainty, %. Decimals may have
    a comma if columns are separated by ``;``. A value without a unit raises an error if another unit is
    more likely: a frequency below 1 Hz, a decay time outside 0.03 to 30 s, an uncertainty above 0.3 of
    its value.

    Raises
    ------
    DataError
        For a file that cannot be read, a missing column, or a value that breaks a rule.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = folder + "/modes.csv"
    ...     with open(path, "w") as file:
    ...         _ = file.write("frequency,T,u_T\n34.1,1.33,0.05\n42.7,1.15,0.04\n")
    ...     print(read(path))
    <MeasuredModes: 2 from 34.1 to 42.7 Hz>
    """
    place = os.fspath(checks.path("path", path))
    sheets = sheets_of(read_bytes(path, MAX_TEXT), place)
    if len(sheets) > 1:
        named = ", ".join(f'"{shown(sheet.name)}"' for sheet in sheets)
        raise DataError(
            f"{place}: the workbook has the sheets {named}; keep only the one with the modes"
        )
    sheet, place = sheets[0], sheets[0].place
    width = max(len(cells) for _, cells in sheet.rows)
    (first, names), *below = ((line, (cells + [""] * width)[:width]) for line, cells in sheet.rows)
    if below and (in_units := with_units(names, below[0][1], _UNIT_WORDS)):
        names, below = in_units, below[1:]
    columns = _columns(names, f"{place}, line {first}")
    of = "decay" if "decay" in columns else "T"
    if not {"frequency", of} <= columns.keys() or {"decay", "T"} <= columns.keys():
        raise DataError(
            f"{place}: the columns are {', '.join(names)}; a table of modes must have frequency, "
            "and either decay (1/s) or T (s)"
        )
    if f"u_{of}" not in columns:
        raise DataError(
            f'{place}: the column "u_{of}" is missing; it must hold the standard uncertainty'
        )
    in_frequency = columns["frequency"][0]
    is_mode = [statistic_of(cells[in_frequency]) in (None, DOUBTFUL) for _, cells in below]
    rows = [row for row, kept in zip(below, is_mode, strict=True) if kept]
    if not rows:
        raise DataError(f"{place}, line {first}: the table has no row below its header")
    used = "".join(cells[k] for _, cells in rows for k, _ in columns.values())
    if "," in used and "." in used:
        raise DataError(
            f"{place}: the table has both decimal commas and decimal points; use one of them"
        )

    def at(name: str, row: int) -> str:
        return f'{place}, line {rows[row][0]}, column "{names[columns[name][0]]}"'

    def stated(name: str) -> Array:
        k = columns[name][0]
        cells = (cells[k].replace(",", ".") for _, cells in rows)
        found = np.array([number(cell, at(name, i)) for i, cell in enumerate(cells)])
        if not (found > 0).all():
            bad = int(np.argmin(found > 0))
            raise DataError(f"{at(name, bad)}: {found[bad]:g} must be above 0")
        return found

    def values(name: str) -> Array:
        """Return a column in Hz, 1/s or s; one without a unit is refused where another is likelier."""
        whole, unit, found = name.removeprefix("u_"), columns[name][1], stated(name)
        if unit in _RELATIVE:
            return 0.01 * found * values(whole)
        if unit:
            return _UNITS[whole][unit] * found
        known = next(iter(_UNITS[whole]))
        low, high = (np.full(len(rows), end) for end in _NEED_NO_UNIT[whole])
        if name != whole:
            low, high = 0 * low, _LARGEST_UNCERTAINTY * stated(whole)
        other = name != whole and columns[whole][1] not in ("", known)
        if (bad := (found < low) | (found > high) | other).any():
            i = int(np.argmax(bad))
            raise DataError(
                f"{at(name, i)}: the unit of {found[i]:g} is unclear. In {known} it would "
                f"be from {low[i]:.3g} to {high[i]:.3g}. Write the unit into the header, "
                f'as in "{name} [{list(_UNITS[whole])[-1]}]"'
            )
        return found

    rows = [rows[i] for i in np.argsort(values("frequency"), kind="stable")]
    decays, uncertainty = values(of), values(f"u_{of}")
    if of == "T":
        decays, uncertainty = DECAY / decays, DECAY * uncertainty / decays**2
    try:
        return MeasuredModes(
            frequencies=values("frequency"),
            decays=decays,
            decay_uncertainty=uncertainty,
            frequency_uncertainty=values("u_frequency") if "u_frequency" in columns else None,
            notes=[
                f'{place}, line {line}: "{shown(cells[in_frequency])}" is no mode, and is left out.'
                for (line, cells), kept in zip(below, is_mode, strict=True)
                if not kept
            ],
        )
    except DataError as error:
        broken = re.match(r"(\w+)\[(\d+)\] =", str(error))
        if broken is None:
            raise DataError(f"{place}: {error}") from error
        place = at("frequency" if broken[1].startswith("f") else of, int(broken[2]))
        raise DataError(f"{place}:{str(error)[broken.end() :]}") from error


def _columns(header: Sequence[str], place: str) -> dict[str, tuple[int, str]]:
    """Return number and unit of the columns that are of modes; DataError for an unknown unit."""
    found: dict[str, tuple[int, str]] = {}
    for k, cell in enumerate(header):
        # As in "decay / 1/s", too.
        slash = "/" in cell and not cell.endswith((")", "]"))
        parts = cell.split("/", 1) if slash else name_and_unit(cell)
        word, unit = (part.strip().lower() for part in parts)
        bare = plain(word.removeprefix("u_").removesuffix(" uncertainty"))
        if bare not in _WORDS:
            continue
        whole = _WORDS[bare]
        name = whole if bare == plain(word) else f"u_{whole}"
        if name in found:
            raise DataError(f'{place}: the column "{name}" occurs twice')
        known = [*_UNITS[whole], *(_RELATIVE if name != whole else ())]
        unit = next((u for u in known if u.lower() == unit), unit)
        if unit not in ("", *known):
            raise DataError(
                f'{place}: the unit of "{shown(cell)}" is not known; known are {", ".join(known)}'
            )
        found[name] = k, unit
    return found


SURE = 0.9
"""Probability from which a measured mode is taken for a calculated mode."""
COMMON_ERROR = 0.012
"""Relative standard deviation of the error that all calculated frequencies have in common: 1 % of the
room's size, and some 4 K of temperature."""
OWN_ERROR = 0.004
"""Relative standard deviation of the independent error of each calculated frequency."""
DECAY_ERROR = 0.5
"""Standard deviation of the logarithm of a calculated decay, before the walls are calibrated."""
_REACTANCE = 0.7
"""Standard deviation of a frequency's shift by reactance, of half the mode's width delta / (2 pi)."""
_STRANGER = 0.05
"""Prior probability that a measured mode is none of those calculated."""
_RANGE = 3.0
"""Largest factor that all frequencies share and that is sought, in its standard deviations."""
_DRAWS = 40
"""Sets of random frequencies that tell how many matches are by chance."""
_BY_CHANCE = 0.05
"""Share of the random sets with as many matches from which these are doubtful."""
_ODD = 0.01
"""Probability of as many modes without a partner below which these are doubtful."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Hold the assignment of measured modes to calculated modes.

    ``measured`` and ``calculated`` (n_matches,) are the numbers of modes that belong together, and
    ``probability`` (n_matches,) is that of a right assignment. ``scale`` is the most likely ratio of
    measured to calculated frequencies, and ``doubts`` are cautions about the assignment.
    """

    measured: NDArray[np.intp]
    calculated: NDArray[np.intp]
    probability: Array
    scale: float
    doubts: tuple[str, ...] = ()


def match(measured: MeasuredModes, frequencies: Array, decays: Array) -> Matches:
    """Return the assignment of measured modes to calculated modes.

    ``frequencies`` in Hz and ``decays`` in 1/s are those of the calculated modes, (n_calculated,).
    Raises DataError if random frequencies would fit as well as the measured ones, or if the ratio of
    measured to calculated frequencies is at the end of its range.
    """
    from scipy.special import bdtrc

    own = measured.calculated
    if own is not None:
        # The modes of responses were found as the room's own.
        scale, sure = float(np.median(measured.frequencies / frequencies[own])), np.ones(len(own))
        return Matches(np.arange(len(own)), own, sure, scale)
    scale, strange, both = _likely(measured, measured.frequencies, frequencies, decays)
    best, probability = both.argmax(axis=1), both.max(axis=1)
    sure, n = probability >= SURE, len(both)
    count, strangers = int(sure.sum()), int((strange > 0.5).sum())
    if count and abs(scale - 1) > (_RANGE - 0.01) * COMMON_ERROR:
        raise DataError(
            "the measured frequencies differ from the calculated ones by at least "
            f"{abs(scale - 1):.1%}, which is more than rtcal searches: check dimensions "
            "and temperature"
        )
    rng, lowest = np.random.default_rng(0), float(min(frequencies[0], measured.frequencies[0]))
    highest = float(max(measured.frequencies[-1], lowest + 1))
    drawn = (rng.uniform(lowest, highest, n) for _ in range(_DRAWS))
    chance = np.array(
        [(_likely(measured, f, frequencies, decays)[2].max(axis=1) >= SURE).sum() for f in drawn]
    )
    if not count or count < chance.mean():
        raise DataError(
            f"{count or 'none'} of the {n} measured modes can be assigned to exactly one "
            f"calculated mode. That is no better than chance: of {n} random frequencies "
            f"{chance.mean():.1f} could be assigned on average. Check frequencies, "
            "dimensions and temperature first, then the input coefficients and the "
            "uncertainties"
        )
    doubts = []
    if (chance >= count).mean() > _BY_CHANCE:
        doubts.append(
            f"Doubtful: {count} of {n} modes were matched, but so are {chance.mean():.1f} of as many "
            f"random frequencies on average, up to {chance.max()}: the modes may be of another room."
        )
    if strangers and bdtrc(strangers - 1, n, _STRANGER) < _ODD:
        doubts.append(
            f"Doubtful: {strangers} of {n} measured modes have no partner among those calculated: "
            "check dimensions, and whether each frequency is a mode."
        )
    return Matches(np.flatnonzero(sure), best[sure], probability[sure], scale, tuple(doubts))


def _likely(
    measured: MeasuredModes, at: Array, frequencies: Array, decays: Array
) -> tuple[float, Array, Array]:
    """Return how likely measured modes, were they ``at`` these frequencies in Hz, are which.

    The factor of the calculated frequencies, the probability of each to be none, (n_modes,), and that
    of each to be each calculated one, seen from either side, (n_modes, n_calculated).
    """
    relative = measured.decay_uncertainty / measured.decays
    of_decay = np.hypot(DECAY_ERROR, relative)[:, np.newaxis]
    # Relative to a stranger's decay, of which nothing is known but its order of magnitude.
    plain = -((np.log(measured.decays[:, np.newaxis] / decays) / of_decay) ** 2) / 2 - np.log(
        of_decay
    )
    stated = np.asarray(measured.frequency_uncertainty)[:, np.newaxis]
    spread = np.hypot(stated, frequency_error(frequencies, decays))
    tried = 1 + COMMON_ERROR * np.linspace(-_RANGE, _RANGE, 121)
    # The modes per Hz of a stranger's frequency: those of the room itself.
    span = max(float(frequencies[-1] - frequencies[0]), 1.0)
    stranger = math.log(_STRANGER * len(frequencies) / span)

    def joint(scale: float) -> Array:
        off = (at[:, np.newaxis] - scale * frequencies) / spread
        near = plain - off**2 / 2 - np.log(spread * np.sqrt(2 * np.pi))
        return np.column_stack([near, np.full(len(near), stranger)])

    # `scipy.special.logsumexp` takes four times as long for 20 modes: 0.14 ms against 0.04 ms.
    likely = [
        np.logaddexp.reduce(joint(s), axis=1).sum() - ((s - 1) / COMMON_ERROR) ** 2 / 2
        for s in tried
    ]
    scale = float(tried[int(np.argmax(likely))])
    table = joint(scale)
    by_row = np.exp(table - np.logaddexp.reduce(table, axis=1, keepdims=True))
    # Seen from the calculated mode: which measured one is it?
    by_column = by_row[:, :-1] / np.maximum(by_row[:, :-1].sum(axis=0), 1e-300)
    return scale, by_row[:, -1], by_row[:, :-1] * by_column


def frequency_error(frequencies: Array, decays: Array) -> Array:
    """Return the standard deviation of the independent error of each calculated frequency in Hz."""
    return np.asarray(np.hypot(OWN_ERROR * frequencies, _REACTANCE * decays / (2 * np.pi)))


AMPLITUDE = 0.3
"""Relative standard deviation of a calculated amplitude at a pair, before the measurement: positions,
and the effect of the walls on the mode's shape."""
LEAST_AMPLITUDE = 0.15
"""Smallest relative standard deviation of amplitudes that may be estimated from the measurement."""
_SMOOTH = 20.0
"""Hz over which the source's spectrum is smooth."""
_LOCAL = 8.0
"""Hz on either side over which the error of the fit is averaged."""
_LEAST_RANGE = 15.0
"""dB between the first eighth of the responses and their last eighth, within the frequencies sought."""
FARTHEST = 2.5 * COMMON_ERROR
"""Largest relative error of all frequencies together that is tried."""
_SCALES = 41
_STEPS = 25


@dataclass(frozen=True, eq=False)
class Spectra:
    """Hold the spectra of impulse responses, with the variance of their noise.

    ``values`` (n_bins, n_pairs) are the spectra at the angular frequencies ``omega`` (n_bins,) in 1/s.
    ``noise`` is the variance of the real part of a value. The responses have ``samples`` samples in
    steps of ``step`` s.
    """

    values: Complex
    omega: Array
    noise: float
    samples: int
    step: float

    @classmethod
    def of(cls, signals: Array, rate: float, lowest: float, highest: float) -> Spectra:
        """Return the spectra of impulse responses in the range from ``lowest`` to ``highest`` in Hz.

        ``signals`` (n_pairs, n_samples) are the responses, and ``rate`` is their sampling rate in Hz.
        Raises DataError if the responses have no decay above noise.
        """
        n = signals.shape[1]
        f = np.fft.rfftfreq(n, 1 / rate)
        inside = (f >= 0.75 * lowest) & (f <= 1.03 * highest)
        spectra = np.fft.rfft(signals, axis=1)[:, inside]
        # Of the last eighth, in which the modes have died away.
        tail = n // 8
        end, start = (
            np.abs(np.fft.rfft(part, n, axis=1)[:, inside]) ** 2
            for part in (signals[:, -tail:], signals[:, :tail])
        )
        if start.sum() < end.sum() * 10 ** (_LEAST_RANGE / 10):
            raise DataError(
                f"the responses do not decay by {_LEAST_RANGE:g} dB above their noise from "
                f"{lowest:g} to {highest:g} Hz: measure with a stronger signal"
            )
        noise = max(float(end.mean()) * n / tail / 2, 1e-12 * float((np.abs(spectra) ** 2).mean()))
        return cls(spectra.T, np.asarray(2 * np.pi * f[inside]), noise, n, 1 / rate)

    def kernel(self, poles: Complex) -> tuple[Complex, Complex]:
        """Return the spectra of exp(s t) for poles s and their derivatives, (n_bins, n_poles) each."""
        n, dt = self.samples, self.step
        turn = -1j * self.omega[:, np.newaxis] * dt
        step, last = np.exp(poles * dt) * np.exp(turn), np.exp(poles * dt * n) * np.exp(turn * n)
        value = (1 - last) / (1 - step)
        return value, dt * (step * value - n * last) / (1 - step)

    @cached_property
    def residuals(self) -> Complex:
        """Spectra of modes below and above the frequency range, (n_bins, 3): 1 / w, 1 and w."""
        x = self.omega / self.omega.mean()
        size = np.sqrt((np.abs(self.values) ** 2).mean())
        return np.asarray(size * x[:, np.newaxis] ** np.array([-1.0, 0.0, 1.0]), dtype=complex)

    def local(self, off: Complex) -> Array:
        """Return the variance of a bin's real part, (n_bins,), as a mean over its neighbours."""
        half = max(int(_LOCAL * 2 * np.pi / (self.omega[1] - self.omega[0])), 1)
        window = np.ones(2 * half + 1)
        power = np.convolve((np.abs(off) ** 2).mean(axis=1) / 2, window, "same")
        count = np.convolve(np.ones(len(off)), window, "same")
        # A window that is longer than the spectrum is cut to it.
        start = (len(power) - len(off)) // 2
        return np.maximum((power / count)[start : start + len(off)], self.noise)


def fitted(spectra: Spectra, poles: Poles, psi: Complex) -> Point:
    """Return the poles and amplitudes of modes that fit measured spectra by least squares.

    ``poles`` are the calculated poles, and ``psi`` (n_poles, n_pairs) the calculated amplitudes of
    their modes at the pairs. A first fit shows how much the amplitudes deviate from ``psi``, and a
    second fit allows for this deviation.
    """
    scale, amplitudes = _scanned(spectra, poles.values, psi)
    own = frequency_error(poles.frequencies, poles.decays)
    prior = np.concatenate([scale * poles.frequencies, np.log(poles.decays)])
    none = np.zeros_like(amplitudes, shape=(spectra.residuals.shape[1], psi.shape[1]))
    first = _settled(
        Point(
            spectra=spectra,
            psi=psi,
            scale=scale,
            prior=prior,
            spread=np.concatenate([own, np.full(len(own), DECAY_ERROR)]),
            at=prior,
            amplitudes=np.vstack([amplitudes, none]),
        )
    )
    spread = float(np.clip(np.sqrt(first.strange), LEAST_AMPLITUDE, AMPLITUDE))
    return _settled(replace(first, spread_of_amplitudes=spread))


def _settled(point: Point) -> Point:
    """Take steps with Levenberg's damping until the misfit falls no more."""
    n, damping = len(point.psi), 1e-2
    for _ in range(_STEPS):
        now, settled = point.misfit(point), True
        for _ in range(6):
            moved = point.moved(damping)
            if np.abs(moved.at - point.at)[n:].max() < 2:
                fallen = now - point.misfit(moved)
                if fallen > 0:
                    point, settled = moved, fallen < 0.5
                    break
            damping *= 10
        damping = max(damping / 10, 1e-8)
        if settled:
            break
    return point


def _scanned(spectra: Spectra, poles: Complex, psi: Complex) -> tuple[float, Complex]:
    """Return the factor of all frequencies, and amplitudes.

    Under this factor the calculated spectra, with a source's smooth spectrum that is common to all
    pairs, are most like the measured ones.
    """
    best = (np.inf, 1.0, psi)
    f = spectra.omega / (2 * np.pi)
    half = round(_SMOOTH / (f[1] - f[0]))
    window = np.exp(-((2 * np.linspace(-1, 1, 2 * half + 1)) ** 2))
    total = float((np.abs(spectra.values) ** 2).sum())
    for scale in 1 + FARTHEST * np.linspace(-1, 1, _SCALES):
        moved = poles.real + 1j * scale * poles.imag
        calculated = spectra.kernel(moved)[0] @ psi / 2
        across, power = (
            np.convolve((calculated.conj() * x).sum(axis=1), window)[half:][: len(f)]
            for x in (spectra.values, calculated)
        )
        q = across / power
        left = float((np.abs(spectra.values - q[:, np.newaxis] * calculated) ** 2).sum())
        # As if an eighth of all bins were independent: the misfit is the model's.
        cost = spectra.values.size / 4 * np.log(left / total) + ((scale - 1) / COMMON_ERROR) ** 2
        if cost < best[0]:
            at = np.interp(scale * poles.imag / (2 * np.pi), f, q)
            best = (float(cost), float(scale), at[:, np.newaxis] * psi)
    return best[1], best[2]


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """Hold a point of the least-squares fit of modes: poles and amplitudes, with their errors.

    ``at`` (2 n_poles,) are the frequencies in Hz, followed by the logarithms of the decays in 1/s.
    ``prior`` are their expected values, which have ``scale`` times the calculated frequencies, and
    ``spread`` the standard deviations of the expected values. ``psi`` (n_poles, n_pairs) are the
    calculated amplitudes. ``amplitudes`` (n_poles + 3, n_pairs) are the fitted ones, of the poles and
    of the modes outside the frequency range.
    """

    spectra: Spectra
    psi: Complex
    scale: float
    prior: Array
    spread: Array
    at: Array
    amplitudes: Complex
    spread_of_amplitudes: float = AMPLITUDE

    @property
    def frequencies(self) -> Array:
        """Frequencies in Hz, (n_poles,)."""
        return self.at[: len(self.psi)]

    @property
    def log_decays(self) -> Array:
        """Logarithms of the decays in 1/s, (n_poles,)."""
        return self.at[len(self.psi) :]

    @cached_property
    def columns(self) -> Complex:
        """Derivatives of the spectra by amplitudes and poles, (n_bins, 2 n_amplitudes + 2 n_poles).

        First are the derivatives by the real, then by the imaginary parts of the amplitudes. The last
        ones are by the real and imaginary parts of each pole, for an amplitude of 1: they must be
        multiplied by the pole's amplitude at each pair.
        """
        spectra = self.spectra
        poles, rest = -np.exp(self.log_decays) + 2j * np.pi * self.frequencies, spectra.residuals
        ours, others = spectra.kernel(poles), spectra.kernel(poles.conj())
        sums, turned = (
            [(a + sign * b) / 2 for a, b in zip(ours, others, strict=True)] for sign in (1, -1)
        )
        by_amplitudes = np.hstack([sums[0], rest, 1j * turned[0], 1j * rest])
        return np.hstack([by_amplitudes, sums[1], 1j * turned[1]])

    @cached_property
    def off(self) -> Complex:
        """Deviation of the measured spectra from the fitted spectra, (n_bins, n_pairs)."""
        parts = np.vstack([self.amplitudes.real, self.amplitudes.imag])
        return np.asarray(self.spectra.values - self.columns[:, : len(parts)] @ parts)

    @property
    def own(self) -> Complex:
        """Amplitudes of the modes, (n_poles, n_pairs)."""
        return self.amplitudes[: len(self.psi)]

    @cached_property
    def expected(self) -> Complex:
        """Calculated amplitudes of the modes, times the source's smooth spectrum."""
        psi, f, own = self.psi, self.frequencies, self.own
        near = np.exp(-(((f[:, np.newaxis] - f) / _SMOOTH) ** 2))
        q = near @ (psi.conj() * own).sum(axis=1) / (near @ (np.abs(psi) ** 2).sum(axis=1))
        none = np.zeros_like(self.amplitudes[len(psi) :])
        return np.vstack([q[:, np.newaxis] * psi, none])

    @cached_property
    def ridge(self) -> Array:
        """Weight by which the amplitudes of each mode are held to the calculated ones, (n_poles,)."""
        n = len(self.own)
        size = np.sqrt((np.abs(self.expected[:n]) ** 2).mean(axis=1))
        spread = self.spread_of_amplitudes
        own = 1 / np.maximum(spread * size, 1e-9 * size.max()) ** 2
        return np.concatenate([own, np.ones(len(self.amplitudes) - n)])

    @cached_property
    def weight(self) -> Array:
        """Weights of the bins in the least squares, (n_bins,)."""
        return np.asarray(1 / np.sqrt(self.spectra.local(self.off)))

    @property
    def unexplained(self) -> float:
        """Share of the responses' power that the modes do not explain."""
        return _share(self.off, self.spectra.values)

    @property
    def strange(self) -> float:
        """Share of the amplitudes' power that the calculated modes do not explain."""
        within = self.frequencies <= self.spectra.omega[-1] / (2 * np.pi)
        own = self.own[within]
        return _share(own - self.expected[: len(within)][within], own)

    @property
    def covariance(self) -> Array:
        """Covariance of frequencies and ln decays of the poles, (2 n_poles, 2 n_poles)."""
        return np.asarray(np.linalg.inv(self._reduced(0.0)[0]))

    def misfit(self, there: Point) -> float:
        """Return the weighted sum of squared deviations at another point, with this point's weights."""
        left = np.abs(there.off) ** 2 * self.weight[:, np.newaxis] ** 2
        far = np.abs(there.amplitudes - self.expected) ** 2 * self.ridge[:, np.newaxis]
        return float(left.sum() + far.sum() + (((there.at - self.prior) / self.spread) ** 2).sum())

    def moved(self, damping: float) -> Point:
        """Return the point after a damped step of the fit."""
        from scipy.linalg import solve_triangular

        matrix, right, lower, across, sides = self._reduced(damping)
        move = np.linalg.solve(matrix, right)
        more = solve_triangular(lower, sides - across @ move, trans=1, lower=True)
        n = len(self.amplitudes)
        amplitudes = self.amplitudes + more[:n] + 1j * more[n:]
        return replace(self, at=self.at + move, amplitudes=amplitudes)

    def _reduced(self, damping: float) -> tuple[Array, ...]:
        """Return matrix and right side of the poles, without the amplitudes.

        And of these the root L of their matrix, and by L what they share with the poles, (2 n, n_pairs,
        2 n_poles), and their sides, (2 n, n_pairs).
        """
        from scipy.linalg import solve_triangular

        own, matrix, right, across, sides = self._normal
        own, matrix = (m + damping * np.diag(np.diag(m)) for m in (own, matrix))
        lower = np.asarray(np.linalg.cholesky(own), dtype=float)
        across, sides = (solve_triangular(lower, m, lower=True) for m in (across, sides))
        rows = across.reshape(-1, len(matrix))
        matrix, right = matrix - rows.T @ rows, right - rows.T @ sides.ravel()
        return matrix, right, lower, across.reshape(*sides.shape, -1), sides

    @cached_property
    def _normal(self) -> tuple[Array, ...]:
        """Normal equations: of amplitudes, of poles with their right side, of both, and sides."""
        n = 2 * len(self.amplitudes)
        columns, left = (
            np.concatenate([weighed.real, weighed.imag])
            for weighed in (x * self.weight[:, np.newaxis] for x in (self.columns, self.off))
        )
        gram, off = columns.T @ columns, columns.T @ left
        decays = np.exp(self.log_decays)

        def of_poles(mixed: Array, a: Complex) -> Array:
            """Return what a pair of amplitudes ``a`` has of poles, along the last axis."""
            one, two = mixed[..., : len(a)], mixed[..., len(a) :]
            by_frequency = 2 * np.pi * (two * a.real - one * a.imag)
            return np.concatenate([by_frequency, -decays * (one * a.real + two * a.imag)], axis=-1)

        matrix, right = np.diag(self.spread**-2), (self.prior - self.at) / self.spread**2
        for a, side in zip(self.own.T, off[n:].T, strict=True):
            matrix += of_poles(of_poles(gram[n:, n:], a).T, a)
            right += of_poles(side, a)
        across = np.hstack([of_poles(gram[:n, n:], a) for a in self.own.T])
        far = (self.expected - self.amplitudes) * self.ridge[:, np.newaxis]
        sides = off[:n] + np.concatenate([far.real, far.imag])
        return gram[:n, :n] + np.diag(np.tile(self.ridge, 2)), matrix, right, across, sides


def _share(part: Complex, whole: Complex) -> float:
    """Return the power of a part over that of the whole."""
    return float((np.abs(part) ** 2).sum() / max((np.abs(whole) ** 2).sum(), 1e-300))


HIGHEST = 150.0  # Hz, where none is stated
LARGEST_ERROR = 0.5  # largest relative uncertainty of a decay that is used
UNEXPLAINED = 0.2
"""Share of unexplained power of responses or amplitudes above which they do not fit the room.

In seven rooms with their right positions at most 2 % of the amplitudes' power was unexplained; with
exchanged receivers, or a time axis that is 20 ms late, it was 33 % or more.
"""
_INFLATED = 1.5  # uncertainty over what independent errors give: what is left is no white noise


@single_threaded_blas()
def find_modes(
    room: Room,
    responses: Array,
    rate: float,
    pairs: Sequence[tuple[str, str]],
    *,
    lowest: float = 20.0,
    highest: float = HIGHEST,
    geometry: Polyhedron | None = None,
) -> MeasuredModes:
    """Return the modes of a room that are found in impulse responses at several positions.

    The search begins at the modes that are calculated from the room's geometry and input coefficients.

    Parameters
    ----------
    room : Room
        Room with its geometry, input coefficients, and the positions of sources and receivers.
    responses : array (n_pairs, n_samples)
        Impulse responses, all in one unit, and all with a time axis that starts when the source emits.
    rate : float
        Sampling rate in Hz.
    pairs : sequence of (source, receiver)
        Names of source and receiver of each response, as in the room's scene.
    lowest, highest : float
        Frequency range in Hz in which modes are searched for.
    geometry : Polyhedron, optional
        Geometry of the room, if its scene has no mesh or another one.

    Returns
    -------
    MeasuredModes
        Modes that are certain enough, with their amplitudes; ``notes`` says which were left out.

    Raises
    ------
    DataError
        For fewer than two pairs, a pair that occurs twice, a shape or value that breaks a rule, a
        clipped response, noise that hides the decay, more than 20 % of the power that the room's modes
        do not explain, frequencies that differ by 3 % or more from the calculated ones, or no mode that
        is certain enough.
    """
    pairs = checks.pairs("pairs", pairs)
    signals = _checked(responses, rate, pairs, lowest, highest)
    # By a power of two, so that no digit changes.
    size = float(2.0 ** np.frexp(np.abs(signals).max())[1])
    model = RoomPoles.of(room, ABOVE * highest, geometry)
    spectra = Spectra.of(signals / size, rate, lowest, highest)
    fit = fitted(spectra, model.calculated, model.amplitudes(pairs))
    if max(fit.unexplained, fit.strange) > UNEXPLAINED:
        raise DataError(
            f"the room's modes do not explain {fit.unexplained:.0%} of the power of the "
            f"responses, and {fit.strange:.0%} of the amplitudes over the positions. "
            "Check dimensions, positions and temperature, and that the sound begins at "
            "time 0"
        )
    if abs(fit.scale - 1) > 0.99 * FARTHEST:
        raise DataError(
            "the measured frequencies differ from the calculated ones by at least "
            f"{abs(fit.scale - 1):.1%}, which is more than rtcal searches: check "
            "dimensions and temperature"
        )
    return _without_prior(fit, size, model.modes.largest, lowest, highest)


def modes_in(room: Room, responses: Responses, geometry: Polyhedron | None) -> MeasuredModes:
    """Return the modes that are found in the first channel of a SOFA file's responses.

    If a pair was measured several times, only its first response is used. ``geometry`` is that of the
    room; None means the room's own. Errors are those of `find_modes`.
    """
    first: dict[tuple[str, str], Array] = {}
    placed, note = responses.placed(room.scene)
    for pair, samples in zip(placed.pairs, placed.samples, strict=True):
        first.setdefault(pair, samples[0])
    signals = np.array([*first.values()])
    rate, top = placed.sampling_rate, min(HIGHEST, placed.sampling_rate / 2.5)
    modes = find_modes(room, signals, rate, [*first], highest=top, geometry=geometry)
    return replace(modes, notes=[*modes.notes, *filter(None, [note])])


def _checked(
    responses: Array, rate: float, pairs: Sequence[tuple[str, str]], lowest: float, highest: float
) -> Array:
    signals = checks.shaped("responses", responses, len(pairs), "n_samples")
    rate = checks.positive("rate", rate, "Hz")
    if len(pairs) < 2:
        raise DataError(f"responses has {len(pairs)} pair; give at least 2, at different positions")
    if len(set(pairs)) < len(pairs):
        twice = next(p for k, p in enumerate(pairs) if p in pairs[:k])
        raise DataError(f"pairs: {' to '.join(twice)} occurs twice; average its responses")
    if not np.isfinite(signals).all():
        raise DataError("responses has a value that is not finite")
    if not 0 < lowest < highest <= rate / 2.5:
        raise DataError(
            f"lowest = {lowest:g} Hz and highest = {highest:g} Hz must increase, be above 0 and "
            f"at most rate / 2.5 = {rate / 2.5:g} Hz"
        )
    if signals.shape[1] < rate:
        raise DataError(
            f"responses are {signals.shape[1] / rate:.2f} s long; they must be at least 1 s "
            "long to resolve low modes"
        )
    for pair, signal in zip(pairs, signals, strict=True):
        if not signal.any():
            raise DataError(
                f"the response of {' to '.join(pair)} is silent: every sample is 0; leave it out"
            )
        if clipped_samples(signal):
            raise DataError(
                f"the response of {' to '.join(pair)} is clipped; measure it again with a lower "
                "level"
            )
    return signals


def _without_prior(
    fit: Point, size: float, largest: float, lowest: float, highest: float
) -> MeasuredModes:
    """Return what the responses, times ``size``, say of each mode: the posterior less its prior."""
    n = len(fit.frequencies)
    variance = np.diag(fit.covariance)
    after, before = variance[n:], DECAY_ERROR**2
    precision = np.maximum(1 / after - 1 / before, 1e-9)
    log_decay = (fit.log_decays / after - fit.prior[n:] / before) / precision
    relative = _INFLATED / np.sqrt(precision)
    sure = relative < LARGEST_ERROR
    own = _own(fit)
    inside = (fit.frequencies >= lowest) & (fit.frequencies <= highest)
    chosen = np.flatnonzero(sure & own & inside)
    if not len(chosen):
        raise DataError(
            "no mode was found with enough certainty: measure at more positions, or with less noise"
        )
    chosen = chosen[np.argsort(fit.frequencies[chosen], kind="stable")]
    notes = [
        f"Modes of {fit.own.shape[1]} pairs: {len(chosen)} of {int(inside.sum())} calculated from "
        f"{lowest:g} to {highest:g} Hz were found. Together they do not explain "
        f"{fit.unexplained:.1%} of the power of the responses, and the patterns "
        f"{fit.strange:.1%} of the power of the amplitudes."
    ]
    for some, why in (
        (inside & ~sure, "the responses do not determine them"),
        (inside & sure & ~own, "they are nearer to another calculated mode"),
    ):
        if some.any():
            where = ", ".join(f"{f:.1f}" for f in fit.frequencies[some])
            notes.append(f"Left out, because {why}: {where} Hz.")
    decays = np.exp(log_decay[chosen])
    return MeasuredModes(
        frequencies=fit.frequencies[chosen],
        decays=decays,
        decay_uncertainty=relative[chosen] * decays,
        frequency_uncertainty=np.maximum(_INFLATED * np.sqrt(variance[chosen]), 1e-3),
        amplitudes=size * fit.own[chosen],
        calculated=chosen,
        largest=largest,
        notes=notes,
    )


def _own(fit: Point) -> NDArray[np.bool_]:
    """Return which modes are nearest to their own calculated one, by frequency and pattern."""
    psi, found, n = fit.psi, fit.own, len(fit.own)
    common = np.abs(found.conj() @ psi.T) ** 2
    whole = np.outer(*((np.abs(a) ** 2).sum(axis=1) for a in (found, psi)))
    missed = 1 - common / np.maximum(whole, 1e-300)
    off = (fit.frequencies[:, np.newaxis] - fit.prior[:n]) / fit.spread[:n]
    return np.asarray((off**2 + missed / AMPLITUDE**2).argmin(axis=1) == np.arange(n))
