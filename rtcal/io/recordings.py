"""Recordings of a sweep, or of noise that is stopped, to decay times and the other parameters.

A recorded sweep is deconvolved by pyfar's regularised inversion (Mueller and Massarani 2001) and goes
the way of an impulse response (`rtcal.io.impulse_responses`). The spectra are padded, so that what a
loudspeaker distorts precedes the response and is cut off with all before the direct sound. What is kept
ends where the recording no longer holds the whole sweep.

Of interrupted noise (ISO 3382-2:2008, 5.3) each band gives a level curve around each stop. The energies
of all stops at a position are averaged, as its decays may not be long enough alone; T20 and T30 are
regressions on the levels, over blocks of T / 40. The standard uncertainty is that of the mean over the
stops, by the spread of their own T, or the theoretical one of ISO 3382-2:2008 if that is larger: the
spread of three stops has two degrees of freedom, and knows nothing of what they have in common.

References: ISO 3382-2:2008; Mueller and Massarani, J. Audio Eng. Soc. 49 (2001).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from rtcal.acoustics.measurement import places_of
from rtcal.acoustics.observables import DecaySlope, of_kind
from rtcal.io import impulse_responses as ir
from rtcal.io.impulse_responses import Analysis, Floor, OfEnergy, Response
from rtcal.io.tables import spread
from rtcal.support.errors import DataError
from rtcal.support.text import rounded
from rtcal.support.types import Array, Paths

__all__ = ["from_sweep", "interrupted"]
__dir__ = __all__.copy

_PARTS = 6  # Number of parts of a band, in each of which a sweep must have energy
_EXCITED = 1e-3
"""Least energy of a part of a band over that of the strongest: 30 dB less than in the others."""
_PIECES, _EXCITED_PIECE = 32, 0.1
"""Number of pieces of the first and last such part, and least energy of a piece over the largest."""
_COMPACT = 10.0
"""Least peak of a response over its rms. Noise has at most 5.5 in 4 million samples; a diffuse decay
with T as long as the recording has 13."""
_BEFORE = 0.05
"""Time in s that is kept before the peak of a response. A sweep's distortion is earlier."""
_CAUSAL = 0.25
"""Largest energy of half a second before that time, over that of half a second after the peak.
Distorted sound has 0.01; what another sweep gives is long before and after its peak."""
_RISE, _ABOVE_NOISE = 10**-1.5, 10**2.1
"""Power of a band's envelope at its onset over the largest, and least of that over the median."""
_LOWEST_ONSET = 500.0
"""Lowest band in Hz whose onset counts: those below ring in a filter and in a loudspeaker."""
_ONSETS = 0.015
"""Largest difference in s of the onsets of bands. In 40 rooms of image sources the right sweep had up
to 0.005, and one of a length or rate 8 % off, which delays each band otherwise, 0.021 and more."""
_LEAST_TAIL = 0.05  # Shortest response in s that is taken
_QUIET = 0.01
"""Largest peak over full scale of a recording of which a note says that it is quiet (-40 dB)."""


def from_sweep(
    path: Paths,
    sweep: str | os.PathLike[str],
    *,
    bands: str | Sequence[float] = "octave",
    channels: int | str | None = None,
    minimum_range: Mapping[str, float] | None = None,
    repeats: bool = False,
    level: bool = False,
    progress: Callable[[], None] | None = None,
) -> Analysis:
    """Return the room-acoustic parameters (T20, EDT, C80, ...) from recordings of a sweep, in bands.

    Raises DataError for files that cannot be read, for different sampling rates, for a given band that
    the sweep does not excite, and for a recording that lacks a part of the sweep, or is the sweep.

    Parameters
    ----------
    path : path or sequence of paths
        Path of one or several recordings, with source and receiver in the name as for
        `rtcal.io.impulse_responses.read`.
    sweep : path
        File of the signal that was played, with one channel and the recordings' sampling rate. Any
        signal with energy in all bands can be used. Silence at its end does not count.
    bands : "octave", "third-octave" or sequence of float
        Bands to evaluate, see `rtcal.io.impulse_responses.analyse`; octaves or third-octaves that the
        sweep does not excite are left out.
    channels, minimum_range, repeats, level, progress
        Options of reading and evaluation: see `rtcal.io.impulse_responses.read`.
    """
    doubts = list[str]()
    given = [*ir.responses_of(sweep, 1, False, doubts).values()]
    excitation, name = given[0], os.fspath(sweep)
    played = np.trim_zeros(excitation.load(), "b")
    if not len(played):
        raise DataError(
            f"{name}: the sweep is silent (every sample is 0); give the file that was played"
        )
    recordings = ir.responses_of(path, channels, repeats, doubts)
    for each in recordings.values():
        if each.sampling_rate != excitation.sampling_rate:
            raise DataError(
                f"{each.place}: the sampling rate is {each.sampling_rate:g} Hz, but that of the "
                f"sweep {name} is {excitation.sampling_rate:g} Hz. Convert one of them"
            )
    rate = excitation.sampling_rate
    centres, fractions = ir.centres_of(bands, rate)
    excited, ends = _excited(played, rate, centres, fractions)
    if not excited.any() or not (isinstance(bands, str) or excited.all()):
        missing = float(centres[int(np.argmin(excited))])
        raise DataError(
            f"{name}: the sweep does not excite the whole band at {missing:g} Hz, but only "
            f"{rounded(float(ends[0]), 3)} to {rounded(float(ends[1]), 3)} Hz. Leave this band out, or "
            "use a sweep with a wider range"
        )

    def load(recording: Response) -> Array:
        recorded = recording.load()
        if clipped := ir.clipped_samples(recorded):
            doubts.append(
                f"clipped recording: {recording.place} ({clipped} samples). That distorts the whole "
                "response: measure again at a lower level"
            )
        elif 0 < (peak := float(np.abs(recorded).max())) < _QUIET:
            doubts.append(
                f"{recording.place}: it peaks {-20 * np.log10(peak):.0f} dB below full scale: "
                "with more gain, less of the decay is lost in noise"
            )
        return impulse_response(recorded, played, rate, ends, recording.place)

    deconvolved = {
        pair: Response(recording.place, partial(load, recording), rate)
        for pair, recording in recordings.items()
    }
    return ir.analysed(
        deconvolved,
        centres[excited].tolist(),
        ir.ranges_of(minimum_range, level=level),
        progress,
        doubts,
    )


def _excited(
    played: Array, rate: float, centres: Array, fractions: int
) -> tuple[Any, tuple[float, float]]:
    """Return which bands a signal excites, (n_bands,), and the ends in Hz of all that it excites.

    Parts of bands are compared, since a sweep has an equal energy in them and a linear one nearly so.
    """
    energy = np.concatenate([[0.0], np.cumsum(np.abs(np.fft.rfft(played)) ** 2)])
    edges = 1000 * 2 ** (np.arange(-60, 60) / (_PARTS * fractions))
    edges = edges[edges < rate / 2]
    ends = np.minimum((edges * len(played) / rate).astype(int), len(energy) - 1)
    parts = np.diff(energy[ends])
    strong = parts >= _EXCITED * parts.max()
    first, last = np.flatnonzero(strong)[[0, -1]]
    inside = [
        strong[
            (edges[:-1] > f * 2 ** (-0.55 / fractions)) & (edges[1:] < f * 2 ** (0.55 / fractions))
        ]
        for f in centres
    ]
    # Beyond the ends the inversion would amplify noise, by 60 dB and more.
    lowest, highest = (
        _refined(energy, len(played) / rate, *edges[k : k + 2])[i]
        for k, i in ((first, 0), (last, 1))
    )
    return np.array([len(each) > 0 and each.all() for each in inside]), (lowest, highest)


def _refined(energy: Array, seconds: float, low: float, high: float) -> tuple[float, float]:
    """Return the ends in Hz between which a part of a band has ``energy``, which is cumulative."""
    edges = np.geomspace(low, high, _PIECES + 1)
    pieces = np.diff(np.interp(edges * seconds, np.arange(len(energy)), energy))
    first, last = np.flatnonzero(pieces >= _EXCITED_PIECE * pieces.max())[[0, -1]]
    return float(edges[first]), float(edges[last + 1])


def impulse_response(
    recorded: Array, played: Array, rate: float, ends: tuple[float, float], place: str
) -> Array:
    """Return the impulse response (n_samples,) from a recorded signal, from shortly before its peak.

    ``ends`` are the lowest and highest frequency in Hz in the ``played`` signal (n_samples,). Raises
    DataError for a silent recording, and one that is the signal or does not contain all of it.
    """
    pyfar, _ = ir.libraries()
    if not np.any(recorded):
        raise DataError(f"{place}: is silent (every sample is 0); leave it out")
    if len(recorded) <= len(played):
        raise DataError(
            f"{place}: a recording must be longer than its sweep, but it lasts "
            f"{len(recorded) / rate:.2f} s and the sweep {len(played) / rate:.2f} s. {_EXCHANGED}"
        )
    if _alike(recorded, played):
        raise DataError(f"{place}: this is the sweep itself; give its recording in the room")
    n = len(recorded) + len(played)
    sweep, recording = (pyfar.Signal(np.pad(x, (0, n - len(x))), rate) for x in (played, recorded))
    inversion = pyfar.dsp.RegularizedSpectrumInversion.from_frequency_range(
        sweep, ends, beta=float(np.max(np.abs(sweep.freq)) ** 2)
    )
    response = np.asarray((recording * inversion.invert).time[0])
    peak = int(np.argmax(np.abs(response)))
    centred = np.roll(response, n // 2 - peak)
    energy = centred**2
    early, half = n // 2 - int(_BEFORE * rate), int(0.5 * rate)
    before, after = energy[early - half : early].sum(), energy[early : n // 2 + half].sum()
    if energy[n // 2] < _COMPACT**2 * energy.mean() or before > _CAUSAL * after:
        raise DataError(f"{place}: the sweep is not found in this recording. {_EXCHANGED}")
    if (apart := _onsets_apart(centred, rate, ends)) > _ONSETS:
        raise DataError(
            f"{place}: the direct sound is {1000 * apart:.0f} ms later in one band than in another, "
            "so another sweep was played. Give the file that was played"
        )
    if peak >= len(recorded):
        raise DataError(
            f"{place}: the direct sound lies {(n - peak) / rate:.2f} s before the start of the "
            f"recording. Start the recording before the sweep. {_EXCHANGED}"
        )
    left = len(recorded) - len(played) - peak
    if left < _LEAST_TAIL * rate:
        raise DataError(
            f"{place}: the recording ends {max(left, 0) / rate:.2f} s after the end of the sweep, "
            "before the room has decayed. Record for longer"
        )
    return response[max(peak - int(_BEFORE * rate), 0) : peak + left]


_EXCHANGED = "Check that this sweep was played, and that it and the recording are not exchanged"


def _onsets_apart(response: Array, rate: float, ends: tuple[float, float]) -> float:
    """Return the largest difference in s of the onsets of octave bands, half an octave apart."""
    middle, half = len(response) // 2, int(0.5 * rate)
    near = response[max(middle - half, 0) : middle + half]
    size = 2 ** int(np.ceil(np.log2(len(near))))
    spectrum, frequency = np.fft.fft(near, size), np.fft.fftfreq(size, 1 / rate)
    octaves = np.log2(np.maximum(frequency, 1.0))  # of negative frequencies nothing is left
    onsets = []
    for centre in _LOWEST_ONSET * 2 ** (np.arange(20) / 2):
        if ends[0] <= centre / np.sqrt(2) and centre * np.sqrt(2) <= ends[1]:
            distance = np.minimum(np.abs(octaves - np.log2(centre)), 1.0)
            in_band = spectrum * np.cos(0.5 * np.pi * distance) ** 2
            envelope = np.abs(np.fft.ifft(in_band)[: len(near)]) ** 2
            if envelope.max() >= _ABOVE_NOISE * np.median(envelope):
                onsets.append(int(np.argmax(envelope >= _RISE * envelope.max())))
    return float(np.ptp(onsets)) / rate if onsets else 0.0


def _alike(recorded: Array, played: Array) -> bool:
    """Return whether a recording is the signal itself but for its gain and silence at its end."""
    begin, rest = recorded[: len(played)], recorded[len(played) :]
    gain = float(begin @ played / (played @ played))
    return not rest.any() and float(np.abs(begin - gain * played).max()) <= 1e-3 * abs(gain)


_BLOCK, _SMOOTHED = 0.01, 5
"""Length in s of the blocks in which stops are looked for, and how many are averaged."""
_LEAST_ON = 0.5  # Shortest time in s that a noise is on: it must become steady
_FALL = 4.0  # Power by which the noise has fallen at its stop, 6 dB; `_LEAD` is before
_LEAD = 0.3
"""Time in s before a stop that a level curve begins, and by which it ends before the next noise, which
begins before it is found."""
_LEAST_FALL = 10**1.5  # Least power by which the level falls after a stop
_STEADY = 4.0
"""Largest power before the stop over that of the whole noise, or the inverse, in a band."""
_MOST_UNSTEADY = 0.5
"""Largest share of bands and stops without a steady noise. Of a sweep, only its last band is steady."""
_FLAT = 1.26
"""Power of the tenth before the last over that of the last, up to which both are noise: 1 dB."""
_BLOCKS_PER_T = 40
"""Number of blocks in T over which a level is averaged; ISO 3382-2 asks for at least 12."""
_STEPS = 10
"""Number of regressions, each in the range of the last one's line; nothing changes after five."""
_PRECISION = 3  # Number of stops at each position by the precision method of ISO 3382-2:2008
_OF_UNCERTAINTY = (
    "the uncertainty is the larger of the standard error over the stops and the theoretical standard "
    "deviation of ISO 3382-2 for as many decays"
)
PARAMETERS = ("t20", "t30")
"""Names of the parameters that interrupted noise gives; its EDT would begin in the noise itself."""


class Stop(NamedTuple):
    """Hold the samples at which a noise begins and stops, and at which its decay ends."""

    on: int
    off: int
    end: int


def interrupted(
    path: Paths,
    *,
    bands: str | Sequence[float] = "octave",
    channels: int | str | None = None,
    minimum_range: Mapping[str, float] | None = None,
    repeats: bool = False,
    progress: Callable[[], None] | None = None,
) -> Analysis:
    """Return T20 and T30 from recordings of interrupted noise, in bands.

    Each recording may have several decays. All decays at a position are averaged, including those of
    repeats. The uncertainty is the larger of the standard error of this mean, by the decays' own T, and
    the theoretical standard deviation of ISO 3382-2 for as many decays.

    ``path``, ``bands``, ``channels``, ``minimum_range``, ``repeats`` and ``progress`` are those of
    `rtcal.io.impulse_responses.read`. Raises DataError for files that cannot be read, and for a
    recording without a steady noise that stops.
    """
    ir.libraries()
    doubts = list[str]()
    recordings = ir.responses_of(path, channels, repeats, doubts)
    centres, fractions = ir.centres_of(bands, min(r.sampling_rate for r in recordings.values()))
    needed = {p: v for p, v in ir.ranges_of(minimum_range).items() if p in PARAMETERS}
    by_place: dict[tuple[str, str], list[Response]] = {}
    for place, recording in zip(places_of([*recordings]), recordings.values(), strict=True):
        by_place.setdefault(place, []).append(recording)
    found, spreads, counts = list[list[OfEnergy]](), list[list[list[float]]](), list[int]()
    for members in by_place.values():
        rate = members[0].sampling_rate
        if other := next((m for m in members if m.sampling_rate != rate), None):
            raise DataError(
                f"{other.place}: the sampling rate is {other.sampling_rate:g} Hz, but that of "
                f"{members[0].place}, at the same position, is {rate:g} Hz. Convert one of them"
            )
        curves: list[list[Array]] = [[] for _ in centres]
        for recording in members:
            samples = recording.load()
            if clipped := ir.clipped_samples(samples):
                doubts.append(f"clipped: {recording.place} ({clipped} samples): measure again")
            stops = stops_of(samples, rate, recording.place)
            unsteady = 0
            for of_band, centre in zip(curves, centres.tolist(), strict=True):
                energy = ir.filtered(samples, rate, centre, fractions)
                made = [_from_steady(energy, stop, rate) for stop in stops]
                unsteady += sum(not len(curve) for curve in made)
                of_band += made
            if unsteady > _MOST_UNSTEADY * len(stops) * len(centres):
                raise DataError(
                    f"{recording.place}: in most bands the sound before its stop is not steady "
                    f"noise. {_NOT_INTERRUPTED}"
                )
            if progress is not None:
                progress()
        counts.append(len(curves[0]))
        found.append([_of_stops(of_band, rate, needed) for of_band in curves])
        spreads.append(
            [_spread([_of_stops([c], rate, needed).values for c in b], needed) for b in curves]
        )
    notes = [f"stops per position: {spread(counts, 'd')}", *doubts]
    if min(counts) < _PRECISION:
        notes[0] += "; ISO 3382-2 asks for 2 (engineering method) or 3 (precision method)"
    notes.insert(1, _OF_UNCERTAINTY)
    analysis = ir.assembled([*by_place], found, centres, needed, notes)
    of_stops, values = np.array(spreads), analysis.measurement.values
    uncertainty = {}
    for i, p in enumerate(needed):
        u = np.fmax(of_stops[..., i], _theory(p, centres, analysis, counts))
        uncertainty[p] = np.where(np.isfinite(values[p]), u, np.nan)
    return replace(analysis, measurement=replace(analysis.measurement, uncertainty=uncertainty))


def _theory(parameter: str, frequencies: Array, analysis: Analysis, counts: Sequence[int]) -> Array:
    """Return ISO 3382-2's standard deviation of T from the decays at each position, in s."""
    one, of = np.ones(len(frequencies)), of_kind(DecaySlope)[parameter]
    values = analysis.measurement.values[parameter]
    rows = [
        of.variance_of_mean(frequencies, t, one, n) for t, n in zip(values, counts, strict=True)
    ]
    return np.sqrt(rows)


def _spread(each: Sequence[Mapping[str, float]], parameters: Iterable[str]) -> list[float]:
    """Return the standard uncertainty of the mean of each parameter over stops; NaN of a single one."""
    n = len(each)
    values = np.array([[of_stop.get(p, np.nan) for of_stop in each] for p in parameters])
    return (values.std(axis=1, ddof=1) / np.sqrt(n)).tolist() if n > 1 else [np.nan] * len(values)


_NOT_INTERRUPTED = "For a recorded sweep give --sweep instead of --interrupted, else neither"


def stops_of(samples: Array, rate: float, place: str) -> list[Stop]:
    """Return the stops of a steady noise; DataError for a recording without one."""
    size = max(int(_BLOCK * rate), 1)
    n = len(samples) // size
    blocks = np.square(samples[: n * size]).reshape(n, size).mean(axis=1)
    if n > _SMOOTHED:
        blocks = np.convolve(blocks, np.full(_SMOOTHED, 1 / _SMOOTHED), "same")
    level = float(np.quantile(blocks, 0.9)) if n else 0.0
    is_on = np.concatenate([[False], blocks > level / _FALL, [False]]).astype(np.int8)
    begins, ends = np.flatnonzero(np.diff(is_on) == 1), np.flatnonzero(np.diff(is_on) == -1)
    # A gap that is shorter than what is averaged is a fluctuation of the noise.
    apart = begins[1:] - ends[:-1] > 2 * _SMOOTHED
    begins, ends = np.append(begins[:1], begins[1:][apart]), np.append(ends[:-1][apart], ends[-1:])
    after = np.append(begins[1:] - int(_LEAD / _BLOCK), n)[: len(begins)]
    stops = [
        Stop(int(on) * size, int(off) * size, int(end) * size)
        for on, off, end in zip(begins, ends, after, strict=True)
        if (off - on) * size >= _LEAST_ON * rate
        and off < end
        and blocks[off:end].min() < level / _LEAST_FALL
    ]
    if not stops or level <= 0:
        raise DataError(
            f"{place}: no noise was found that is steady for {_LEAST_ON:g} s and then stops and falls "
            f"by {10 * np.log10(_LEAST_FALL):.0f} dB. {_NOT_INTERRUPTED}"
        )
    return stops


def _from_steady(energy: Array, stop: Stop, rate: float) -> Array:
    """Return the energy from `_LEAD` before a stop on, 1 for the steady noise; (0,) without one."""
    lead = stop.off - int(_LEAD * rate)
    whole = energy[(stop.on + lead) // 2 : lead]  # the first half may be the build-up
    last = energy[max(lead - int(_LEAD * rate), stop.on) : lead]
    steady = float(whole.mean())
    if not 1 / _STEADY < float(last.mean()) / (steady or 1.0) < _STEADY:
        return np.zeros(0)
    return np.asarray(energy[lead : stop.end] / steady)


def _of_stops(curves: Sequence[Array], rate: float, needed: Mapping[str, float]) -> OfEnergy:
    """Return T20 and T30 of the energies around several stops at one place, in one band."""
    n = min(map(len, curves))
    if not n:
        return OfEnergy({}, -np.inf, Floor.UNSTEADY)
    energy = np.mean([curve[:n] for curve in curves], axis=0)
    before, last = (float(part.mean()) for part in np.split(energy[n - 2 * (n // 10) :], 2))
    is_noise = before < _FLAT * last
    ratio = float(-10 * np.log10(max(last, np.finfo(float).tiny)))
    values = {
        p: _regression(energy - last * is_noise, rate, slope)
        for p, slope in of_kind(DecaySlope).items()
        if p in needed and ratio >= needed[p]
    }
    known = {p: t for p, t in values.items() if np.isfinite(t)}
    return OfEnergy(known, ratio, Floor.NOISE if is_noise else Floor.CUT)


def _regression(energy: Array, rate: float, slope: DecaySlope) -> float:
    """Return T in s by the line through the levels in a parameter's range; NaN without one.

    The range is where the line itself is in it, found in `_STEPS` steps: a level that fluctuates would
    choose its own noise.
    """
    t, first, last = 1.0, 0.0, np.inf
    for step in range(_STEPS):
        size = max(int(t / _BLOCKS_PER_T * rate), 1)
        n = len(energy) // size
        blocks = energy[: n * size].reshape(n, size).mean(axis=1)
        time = (np.arange(n) + 0.5) * size / rate
        if not step:
            low = np.flatnonzero(blocks < 10 ** (slope.lower / 10))
            if not low.size:
                return np.nan
            high = np.flatnonzero(blocks[: low[0]] > 10 ** (slope.upper / 10))
            first, last = time[high[-1]] if high.size else 0.0, time[low[0]]
        for margin in (0.0, t / _BLOCKS_PER_T):  # a steep line may pass between two blocks
            used = (time >= first - margin) & (time <= last + margin) & (blocks > 0)
            if used.sum() >= 2:
                break
        else:
            return np.nan
        fall, at_0 = np.polyfit(time[used], 10 * np.log10(blocks[used]), 1)
        if not fall < 0:
            return np.nan
        t = float(-60 / fall)
        first, last = ((end - at_0) / fall for end in (slope.upper, slope.lower))
    return t
