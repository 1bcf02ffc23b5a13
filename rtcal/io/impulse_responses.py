"""Impulse responses (WAV, SOFA, or pyfar ``Signal``) to decay times, C50, C80, D50, STI and Ts.

Each band is filtered backwards in time (Jacobsen & Rindel 1987), so that the filter's ringing precedes
the sound. A decay then keeps its slope for B T above 4; the forward filter needs 16. The noise is
subtracted. The decay curve ends at the noise by the method of Lundeby et al. (1995). The energy beyond
is added (Guski & Vorlaender 2014), and the curve is divided by its start. A parameter is returned only
if the impulse-to-noise ratio

    INR = 10 lg(E 6 ln(10) / (EDT N)) dB,   E the energy, N the noise's energy per second,

is as large as ISO 3382 requires: the noise is 10 dB below the evaluation range. No other module
imports pyfar, pyrato and soundfile (``rtcal[measurement]``).

References: ISO 3382-1:2009; ISO 3382-2:2008, 5.3.3; Jacobsen and Rindel, J. Sound Vib. 117 (1987);
Lundeby, Vigran, Bietz, Vorlaender, Acustica 81 (1995); Guski and Vorlaender, Acta Acust. united Ac.
100 (2014).
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics import bands as _bands
from rtcal.acoustics import decay
from rtcal.acoustics.decay import bent_decays
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import EARLY, OBSERVABLES, DecaySlope, of_kind, parameter_label
from rtcal.acoustics.repeats import copies, groups, in_words, names_of_repeats, places_of
from rtcal.io import sofa, wav
from rtcal.io.analysis import MOST_NAMED, Analysis, late_energy, spread
from rtcal.support import checks, library
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.text import first_of
from rtcal.support.types import Array

__all__ = ["analyse", "of_energy", "read"]
__dir__ = __all__.copy

MINIMUM_RANGE: dict[str, float] = {
    key: o.minimum_range for key, o in OBSERVABLES.items() if o.minimum_range is not None
}
"""Impulse-to-noise ratio in dB that each parameter needs: its range plus 10 dB, and 5 dB more for T."""

LEAST_BT = 4.0
"""Bandwidth times T above which a backward filter does not bias T (Jacobsen & Rindel 1987)."""

_ORDER = 6  # Butterworth; IEC 61260-1 class 1 needs 5 for octaves and 6 for third-octaves
_NAMES = re.compile(r"(?<![A-Za-z])(L?S\w*?\d+)[_-]+((?:MP|M|R)\w*?\d+(?:#\d+)?)", re.I | re.ASCII)


@checked
def read(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    bands: str | Sequence[float] = "octave",
    channels: int | str | None = None,
    minimum_range: Mapping[str, float] | None = None,
    repeats: bool = False,
    progress: Callable[[], None] | None = None,
) -> Analysis:
    """Read one or more WAV (PCM or float, 18 s at 48 kHz at most) or SOFA files and analyse them.

    A name like ``LS1_MP3`` or ``S1-R2`` in the file's name is its source and receiver; else the
    source is ``S1`` and the receiver the file's name. ``S1-R2#2`` is a repeat of ``S1-R2``: repeats are
    averaged, and count as one position. A SOFA file states its positions: equal ones have one name, as
    `rtcal.io.sofa.read` gives it.

    Parameters
    ----------
    path : path or sequence of paths
    bands, minimum_range, progress
        See `analyse`.
    channels : int or "receivers", optional
        For files of several channels: the number of the channel to read, from 1, or "receivers" if each
        channel is one receiver. For a figure-of-eight or Ambisonics microphone, state the channel of
        the pressure.
    repeats : bool
        Whether several files of one source and receiver are repeats. Else they are refused.

    Raises
    ------
    DataError
        For a file that cannot be read, and for several channels where ``channels`` is not stated;
        the message names file and rule.
    """
    paths = [path] if isinstance(path, (str, os.PathLike)) else list(path)
    if not paths:
        raise DataError("no file of an impulse response is given")
    signals: dict[tuple[str, str], Any] = {}
    places: dict[tuple[str, str], str] = {}
    for file in paths:
        several = channels == "receivers" or sofa.claims(file)
        for source, receiver, signal in _sounds(os.fspath(file)):
            text_name(f"{file}: a position", source + receiver)
            for name, channel in _channels(signal, receiver, channels, os.fspath(file)):
                if (source, name) in signals and not repeats:
                    raise DataError(
                        f"{file}: source {source}, receiver {name} is given twice; if it is a repeat, "
                        f"name it {source}-{name}#2, or state repeats=True"
                    )
                names = names_of_repeats(name)
                name = next(n for n in names if (source, n) not in signals)
                signals[source, name] = channel
                places[source, name] = os.fspath(file) + (f", {source}, {name}" if several else "")
    return _analysis(signals, places, bands, _ranges(minimum_range), progress)


def _sounds(file: str) -> Iterator[tuple[str, str, Any]]:
    """Yield source, receiver and pyfar Signal of each response in a WAV or SOFA file."""
    if not sofa.claims(file):
        stem = Path(file).stem
        match = _NAMES.search(stem)
        source, receiver = match.groups() if match else ("S1", stem)
        yield source, receiver, _sound(file)
        return
    pyfar, _ = _libraries()
    responses = sofa.read(file)
    for (source, receiver), samples in zip(responses.pairs, responses.samples, strict=True):
        yield source, receiver, pyfar.Signal(samples, responses.sampling_rate)


def _sound(file: str) -> Any:
    """Return the pyfar Signal of a file; DataError if it is no WAV or a sample is not finite."""
    wav.check_header(file)
    pyfar, _ = _libraries()
    try:
        import soundfile  # pyfar reads with it, and does not say which sample is not finite

        samples, rate = soundfile.read(file, always_2d=True)
    except (OSError, RuntimeError, ValueError, TypeError) as error:
        raise DataError(f"{file}: cannot be read as WAV: {error}") from error
    for channel in samples.T:
        wav.check_finite(file, channel)
    return pyfar.Signal(samples.T, rate)


def _channels(
    signal: Any, receiver: str, channels: int | str | None, place: str
) -> list[tuple[str, Any]]:
    """Return the receivers' names and signals that a file holds."""
    n_channels = signal.time.shape[0]
    if channels == "receivers" and n_channels > 1:
        place, mark, repeat = receiver.partition("#")
        return [(f"{place}-{i + 1}{mark}{repeat}", signal[i]) for i in range(n_channels)]
    if isinstance(channels, str) and channels != "receivers":
        raise DataError(f'channels = "{channels}" is neither a number nor "receivers"')
    if n_channels == 1:
        return [(receiver, signal)]  # no copy
    if channels is None:
        raise DataError(
            f"{place}: {n_channels} channels; state which one to read (channels=1), or that each "
            'is a receiver (channels="receivers")'
        )
    number = checks.whole("channels", channels, 1)
    if number > n_channels:
        raise DataError(f"{place}: {n_channels} channels; there is no channel {number}")
    return [(receiver, signal[number - 1])]


@checked
def analyse(
    signals: Any,
    *,
    bands: str | Sequence[float] = "octave",
    minimum_range: Mapping[str, float] | None = None,
    progress: Callable[[], None] | None = None,
) -> Analysis:
    """Return the room-acoustic parameters of impulse responses.

    Parameters
    ----------
    signals : pyfar.Signal, or mapping of (source, receiver) to pyfar.Signal
        Room impulse responses, one channel each.
    bands : "octave", "third-octave" or sequence of float
        All octaves from 63 Hz to 8 kHz, all third-octaves from 50 Hz to 10 kHz, as far as the
        sampling rate holds them; or centre frequencies in Hz.
    minimum_range : mapping of str to float, optional
        In dB, in place of `MINIMUM_RANGE`, for some parameters.
    progress : callable, optional
        Called after each response.

    Raises
    ------
    DataError
        For a silent or broken response, or a band above half the sampling rate.
    MissingDependencyError
        If pyfar or pyrato is not installed.
    """
    _libraries()
    needed = _ranges(minimum_range)
    signals = dict(signals) if isinstance(signals, Mapping) else {("S1", "R1"): signals}
    if not signals:
        raise DataError("no impulse response is given")
    for pair, signal in signals.items():
        if not hasattr(signal, "sampling_rate"):
            raise DataError(f"signals: {checks.shown(signal)} of {pair} is no pyfar.Signal")
    places = {pair: f"impulse response {'/'.join(pair)}" for pair in signals}
    return _analysis(signals, places, bands, needed, progress)


def _analysis(
    signals: Mapping[tuple[str, str], Any],
    places: Mapping[tuple[str, str], str],
    bands: str | Sequence[float],
    needed: dict[str, float],
    progress: Callable[[], None] | None,
) -> Analysis:
    """Return the parameters of responses; ``places`` are their names in messages."""
    wav.check_usable((places[pair], signal) for pair, signal in signals.items())
    rate = min(float(s.sampling_rate) for s in signals.values())
    centres, fractions = _centres(bands, rate)
    values = {p: np.full((len(signals), len(centres)), np.nan) for p in MINIMUM_RANGE}
    ratios = np.full((len(signals), len(centres)), np.nan)
    missing, clipped = list[str](), list[str]()
    silences: dict[tuple[str, str], float] = {}
    short: dict[float, list[float]] = {}
    for i, (pair, signal) in enumerate(signals.items()):
        samples = wav.prepared(signal)
        onset = samples.onset
        if samples.silence >= wav.LEAST_SILENCE:
            silences[pair] = samples.silence
        if samples.clipped:
            clipped.append(f"{places[pair]} ({samples.clipped} samples)")
        for k, centre in enumerate(centres):
            bandwidth = centre * (2 ** (0.5 / fractions) - 2 ** (-0.5 / fractions))
            energy = _filtered(samples.time, float(signal.sampling_rate), float(centre), fractions)
            lead = min(onset, int(4 / bandwidth * signal.sampling_rate))
            parameters, ratios[i, k], reasons = of_energy(
                energy[onset:],
                signal.sampling_rate,
                minimum_range=needed,
                centre_frequency=centre,
                early=float(energy[onset - lead : onset].sum()),
                early_samples=lead,
            )
            place = f"{', '.join(pair)}, {_bands.label(centre)}"
            missing += [f"{place}: {reason}" for reason in reasons]
            for parameter, value in parameters.items():
                values[parameter][i, k] = value
            t = next((parameters[p] for p in of_kind(DecaySlope) if p in parameters), np.inf)
            if bandwidth * t < LEAST_BT:
                short.setdefault(centre, []).append(bandwidth * t)
        if progress is not None:
            progress()
    measurement = Measurement(centre_frequencies=centres, pairs=tuple(signals), values=values)
    placed = places_of([*signals])
    of_place = groups(placed).values()
    notes = in_words(placed) + copies([*signals], values.values())
    silent = np.isneginf(ratios).sum(axis=1)
    if lacking := np.flatnonzero(2 * silent > len(centres)).tolist():
        names = [*places.values()]
        of_file = [f"{names[i]} ({silent[i]} of {len(centres)} bands)" for i in lacking]
        notes.append(
            f"no decay stands out of the noise: {first_of(of_file, MOST_NAMED)}. Look whether it is an "
            "impulse response, and not noise or a recording of the excitation"
        )
    notes += late_energy(values, [*places.values()])
    if clipped:
        notes.append(
            f"clipped: {first_of(clipped, MOST_NAMED)}. Their largest value occurs "
            f"{wav.LEAST_CLIPPED} times or more, that of a decay once. All their values are in doubt, "
            "and no table says so: measure again at a lower level, or without these files"
        )
    if silences:
        seconds = spread([*silences.values()], ".2f")
        named = first_of([" to ".join(pair) for pair in silences], MOST_NAMED)
        notes.append(f"{named}: the last {seconds} s are digital silence, left out")
    for centre, products in short.items():
        count = "" if len(signals) == 1 else f" in {len(products)} of {len(signals)} pairs"
        notes.append(
            f"{_bands.label(centre)}: B T = {spread(products, '.1f')}{count} is below {LEAST_BT:g}: "
            "the measured decay contains that of the band filter"
        )
    notes += [
        f"{_bands.label(band.frequency)}: {band.text}; one T does not describe it"
        for band in bent_decays(measurement)
    ]
    return Analysis(
        measurement=measurement,
        impulse_to_noise_ratio=np.array([ratios[rows].min(axis=0) for rows in of_place]),
        minimum_range=needed,
        missing=tuple(missing),
        notes=tuple(notes),
    )


@checked
def of_energy(
    energy: Array,
    sampling_rate: float,
    *,
    minimum_range: Mapping[str, float] | None = None,
    centre_frequency: float | None = None,
    early: float = 0.0,
    early_samples: int = 0,
) -> tuple[dict[str, float], float, tuple[str, ...]]:
    """Return parameters, the INR in dB and the reasons for what is missing, of one squared response.

    ``energy``, (n_samples,), begins with the direct sound. ``early`` is the energy that the filter has
    moved before it, over ``early_samples``; it counts as early sound.
    """
    needed = _ranges(minimum_range)
    checks.positive("sampling_rate", sampling_rate, "Hz")
    total = float(np.sum(energy))
    if not (np.isfinite(total) and total > 0 and len(energy) >= sampling_rate / 20):
        return {}, -np.inf, ("no decay: the response is silent or shorter than 50 ms",)
    energy = np.asarray(energy, dtype=float) / energy.max()
    early = early * float(np.sum(energy)) / total
    curve, noise = _curve_and_noise(energy, sampling_rate, centre_frequency)
    if len(curve) < 10 or not noise >= 0:
        return {}, -np.inf, ("no decay stands out of the noise",)
    level = 10 * np.log10(curve / curve[0])
    # Levels below every evaluation range are left out, which saves memory in the regressions.
    slopes = of_kind(DecaySlope)
    lowest = min(o.lower for o in slopes.values())
    in_range = level[: int(np.max(np.flatnonzero(level >= lowest))) + 1]
    times = {
        p: float(o.of_curve(in_range, 1 / sampling_rate))
        for p, o in slopes.items()
        if level[-1] <= o.lower
    }
    times = {p: t for p, t in times.items() if np.isfinite(t)}
    if EARLY.key not in times:
        reason = f"no decay of 10 dB stands out of the noise ({-level[-1]:.0f} dB do)"
        return {}, -np.inf, (reason,)
    density = curve[0] * 6 * np.log(10) / (times[EARLY.key] * sampling_rate)
    inr = float(10 * np.log10(density / noise)) if noise > 0 else np.inf
    curve[0] += max(early - noise * early_samples, 0.0)
    parameters = {**_energy_ratios(curve, sampling_rate), **times}
    reasons = [
        f"{parameter_label(p)} needs {needed[p]:g} dB between sound and noise (ISO 3382); there are "
        f"{inr:.1f} dB"
        for p in MINIMUM_RANGE
        if inr < needed[p]
    ] + [
        f"{parameter_label(p)}: the decay curve ends at {level[-1]:.1f} dB"
        for p in MINIMUM_RANGE
        if inr >= needed[p] and p not in parameters
    ]
    return {p: v for p, v in parameters.items() if inr >= needed[p]}, inr, tuple(reasons)


def _curve_and_noise(
    energy: Array, sampling_rate: float, centre_frequency: float | None
) -> tuple[Array, float]:
    """Return the decay curve without noise, and the noise's energy per sample.

    All values of the curve are positive. It is empty if no decay is above the noise.
    """
    pyfar, pyrato = _libraries()
    options = {
        "smoothing_parameter": centre_frequency or "broadband",
        "is_energy": True,
        "time_shift": False,
    }
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # a failure shows in the curve, and the caller reports it
        signal = pyfar.Signal(energy, sampling_rate)
        try:
            _, _, noise = pyrato.edc.intersection_time_lundeby(
                signal, failure_policy="error", **options
            )
            corrected = pyrato.edc.energy_decay_curve_chu_lundeby(
                signal, normalize=False, **options
            )
        except (ArithmeticError, ValueError, IndexError, TypeError):
            return np.empty(0), np.nan
    curve = np.ravel(corrected.time)
    ends = np.flatnonzero(~(curve > 0))
    return curve[: ends[0]] if ends.size else curve.copy(), float(np.ravel(noise)[0])


def _energy_ratios(curve: Array, rate: float) -> dict[str, float]:
    """Return all but the decay times of a decay curve, which begins at the whole energy.

    A ratio is left out if its limit is after the end of the curve.
    """
    energy = np.maximum(-np.diff(curve, append=0.0), 0.0)
    others = [p for p in MINIMUM_RANGE if p not in of_kind(DecaySlope)]
    values = decay.parameters(energy, 1 / rate, others)
    return {
        name: float(value)
        for name, value in values.items()
        if len(curve) / rate > OBSERVABLES[name].reaches and np.isfinite(value)
    }


def _filtered(time: Array, rate: float, centre: float, fractions: int) -> Array:
    """Square of the response in one band, filtered backwards in time."""
    pyfar, _ = _libraries()
    filtered = pyfar.dsp.filter.fractional_octave_bands(
        pyfar.Signal(time[::-1], rate),
        fractions,
        order=_ORDER,
        frequency_range=(centre * 0.97, centre * 1.03),
    )
    return np.asarray(np.ravel(filtered.time)[::-1] ** 2)


def _centres(bands: str | Sequence[float], rate: float) -> tuple[Array, int]:
    if isinstance(bands, str):
        if bands not in ("octave", "third-octave"):
            raise DataError(f'bands = "{bands}" is neither "octave" nor "third-octave"')
        fractions = 1 if bands == "octave" else 3
        listed = _bands.octaves(63, 8000) if fractions == 1 else _bands.third_octaves(50, 10000)
        listed = tuple(f for f in listed if f * 2 ** (0.5 / fractions) * 1.01 < rate / 2)
        if not listed:
            raise DataError(f"sampling rate {rate:g} Hz: no band lies below half of it")
        return _bands.as_bands(listed), fractions
    centres = _bands.as_bands(bands, "bands")
    fractions = 1 if _bands.bandwidth_factor(centres) > 0.5 else 3
    for f in centres:
        nominal = _bands.OCTAVES if fractions == 1 else _bands.THIRD_OCTAVES
        if f not in nominal or f * 2 ** (0.5 / fractions) * 1.01 >= rate / 2:
            raise DataError(
                f"bands has {_bands.label(f)}; it is no {'' if fractions == 1 else 'third-'}octave "
                f"below half the sampling rate of {rate:g} Hz"
            )
    return centres, fractions


def _ranges(minimum_range: Mapping[str, float] | None) -> dict[str, float]:
    chosen = dict(MINIMUM_RANGE)
    for parameter, value in (minimum_range or {}).items():
        if parameter.lower() not in chosen:
            raise DataError(
                f"minimum_range[{parameter}] = {value:g} dB; known are {', '.join(chosen)}"
            )
        if not 0 <= value < np.inf:
            raise DataError(
                f"minimum_range[{parameter}] = {value:g} dB is not finite and 0 or more"
            )
        chosen[parameter.lower()] = float(value)
    return chosen


def _libraries() -> tuple[Any, Any]:
    """Return pyfar and pyrato; MissingDependencyError if one of them is missing."""
    needed = "impulse responses need pyfar and pyrato: pip install 'rtcal[measurement]'"
    return library(needed, "pyfar"), library(needed, "pyrato")
