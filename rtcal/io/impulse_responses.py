"""Impulse responses (sound files, SOFA, or pyfar ``Signal``) to decay times, C50, C80, D50, STI and Ts.

Each band is filtered backwards in time (Jacobsen & Rindel 1987), so that the filter's ringing precedes
the sound. A decay then keeps its slope for B T above 4; the forward filter needs 16. The decay curve is
the energy integrated from the end, in one of two ways, of which the one that reaches deeper is taken:

- as it is, where the last tenth is so low that it matters to no parameter, as in simulated decays;
- by the line of the late decay (Lundeby et al. 1995), which tells noise from a decay that was cut off:
  noise is what the line leaves of the last tenth. It is subtracted, the curve ends at the noise, and
  the line's energy beyond is added (Guski & Vorlaender 2014). Some decays have no such line.

A parameter is returned only if the range of levels below the sound is as large as ISO 3382 requires:
the end is 10 dB below the evaluation range. The range is

    INR = 10 lg(E 6 ln(10) / (EDT N)) dB,   E the energy, N the energy per second at the end.

A file whose energy arrives late, such as the recording of a sweep or of interrupted noise, has no
parameter at all. No other module imports soundfile, pyfar and pyrato (``rtcal[measurement]``).

Any container and coding that soundfile reads is read. What a file declares is checked before a sample
is loaded, and one channel is loaded at a time: no more memory is needed than
`budget.MAX_CHANNEL_SAMPLES` take.

References: ISO 3382-1:2009; ISO 3382-2:2008, 5.3.3; Jacobsen and Rindel, J. Sound Vib. 117 (1987);
Lundeby, Vigran, Bietz, Vorlaender, Acustica 81 (1995); Guski and Vorlaender, Acta Acust. united Ac.
100 (2014).
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rtcal.acoustics import bands as _bands
from rtcal.acoustics import observables
from rtcal.acoustics.marks import bent_decays
from rtcal.acoustics.measurement import (
    Measurement,
    names_of_repeats,
    note_of_repeats,
    places_of,
    require_repeats,
)
from rtcal.acoustics.observables import (
    EARLY,
    LEVEL,
    MARGIN_DB,
    OBSERVABLES,
    TARGET,
    DecaySlope,
    observable,
    of_kind,
    parameter_label,
)
from rtcal.files.disk import reason
from rtcal.files.schema import RESPONSE, expecting
from rtcal.io import budget, sofa
from rtcal.io.table_columns import position_in
from rtcal.io.tables import MOST_NAMED, means, spread
from rtcal.support import checks, library, text
from rtcal.support.checks import text_name
from rtcal.support.errors import DataError
from rtcal.support.text import first_of
from rtcal.support.types import Array, Paths

__all__ = ["analyse", "read"]
__dir__ = __all__.copy

MINIMUM_RANGE: dict[str, float] = {
    key: o.minimum_range for key, o in OBSERVABLES.items() if o.minimum_range is not None
}
"""Impulse-to-noise ratio in dB that each parameter needs: its evaluation range plus 10 dB, and 5 dB
more for T20 and T30."""

LEAST_BT = 4.0
"""Product of bandwidth and T above which a time-reversed filter does not bias T (Jacobsen & Rindel
1987)."""

_ORDER = 6  # Butterworth; IEC 61260-1 class 1 needs 5 for octaves and 6 for third-octaves


def read(
    path: Paths,
    *,
    bands: str | Sequence[float] = "octave",
    channels: int | str | None = None,
    minimum_range: Mapping[str, float] | None = None,
    repeats: bool = False,
    level: bool = False,
    progress: Callable[[], None] | None = None,
) -> Analysis:
    """Return the room-acoustic parameters of impulse responses in sound files or SOFA files.

    Sound files are WAV, FLAC and all others that soundfile reads. A part like ``LS1_MP3`` or ``S1-R2``
    of the file's name is its source and receiver; otherwise the source is ``S1`` and the receiver has
    the file's name. ``S1-R2#2`` is a repeat of ``S1-R2``; repeats are averaged and count as one
    position. Positions in a SOFA file are named as in `rtcal.io.sofa.read`.

    The `Analysis` has the ``measurement``, with reasons for values that are missing, and cautions.
    Raises DataError for a file that cannot be read, and for several channels without ``channels``. With
    ``level``, also for files of one source that have the same peak, because they were normalised.

    Parameters
    ----------
    path : path or sequence of paths
        Path of the file, or paths of several files, one per position or repeat.
    bands, minimum_range, progress
        Bands to evaluate, impulse-to-noise ratios that parameters need, and function that is called
        after each response: see `analyse`.
    channels : int or "receivers", optional
        Number of the channel to read, from 1, for files with several channels; or "receivers" if each
        channel is a receiver. For a figure-of-eight or Ambisonics microphone, give the channel of the
        pressure.
    repeats : bool
        Whether several files of one source and receiver are repeats, to be averaged. If False, such
        files are an error. If True, it is an error if there are none.
    level : bool
        Whether the power of each source and the gain were the same in all files, so that the relative
        level of the receivers is evaluated, too.
    """
    doubts = list[str]()
    responses = responses_of(path, channels, repeats, doubts)
    return analysed(responses, bands, ranges_of(minimum_range, level=level), progress, doubts)


def responses_of(
    path: Paths,
    channels: int | str | None,
    repeats: bool,
    doubts: list[str],
) -> dict[tuple[str, str], Response]:
    """Return the impulse responses in files, by source and receiver."""
    paths = [path] if isinstance(path, (str, os.PathLike)) else checks.listed("path", path)
    if not paths:
        raise DataError("no file of an impulse response is given")
    responses: dict[tuple[str, str], Response] = {}
    for file in paths:
        of_sofa = sofa.recognises(file)
        for source, receiver, every in _of_sofa(file) if of_sofa else _of_sound(file, doubts):
            text_name(f"{file}: a position", source + receiver)
            for name, response in _chosen(every, receiver, channels, os.fspath(file)):
                if (source, name) in responses and not repeats:
                    raise DataError(
                        f"{file}: source {source}, receiver {name} is given twice. If it "
                        f"is a repeat, name it {source}-{name}#2, or use repeats=True"
                    )
                names = names_of_repeats(name)
                name = next(n for n in names if (source, n) not in responses)
                several = channels == "receivers" or of_sofa
                place = os.fspath(file) + (f", {source}, {name}" if several else "")
                responses[source, name] = Response(place, response.load, response.sampling_rate)
    if repeats:
        require_repeats(places_of([*responses]), os.fspath(paths[0]))
    return responses


class Floor(Enum):
    """List the reasons that limit a decay's level range, as sentences with a place for it in dB."""

    NOISE = "The decay falls by {} dB before the noise begins."
    CUT = "The decay falls by only {} dB before the response is cut off. Record for longer."
    END = "The decay falls by only {} dB before the response ends. Record for longer, or louder."
    FLAT = "The decay begins less than 10 dB above the end of the response (noise, or a cut decay)."
    SHORT = "The response is silent or shorter than 50 ms."
    UNSTEADY = "The sound before its stop is no steady noise in this band."
    LATE = (
        "The energy arrives late, as in a recording of a sweep, of interrupted noise or of two sounds: "
        "it is no decay."
    )


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """Hold the parameters of impulse responses, with reasons for missing values and cautions.

    ``measurement`` has the values. ``impulse_to_noise_ratio`` (n_pairs, n_bands) is in dB; if a pair
    was measured repeatedly, it is the smallest. ``floors`` (n_pairs, n_bands) are the reasons that
    limit the level range of each decay, such as noise. ``minimum_range`` is the impulse-to-noise ratio
    in dB that each parameter needs, by name.

    ``notes`` are cautions, one sentence each.
    """

    measurement: Measurement
    impulse_to_noise_ratio: Array
    floors: tuple[tuple[Floor, ...], ...]
    minimum_range: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the means by band, what is missing by band, and the notes."""
        lines = means(self.measurement)
        if missing := self.missing:
            needed: dict[float, list[str]] = {}
            for name in self.measurement.values:
                of_band = observable(name).label_of_band or parameter_label(name)
                needed.setdefault(self.minimum_range[name], []).append(of_band)
            parts = [f"{ratio:g} dB for {', '.join(names)}" for ratio, names in needed.items()]
            some, others = "Values", ""
            if len(self.measurement.pairs) > 1:
                some, others = "Values of some pairs", ", and each mean is over the other pairs"
            rule = "Before its noise or its end, the response must decay by"
            said = f"{some} are missing{others}. {rule} {'; '.join(parts)} (ISO 3382-1)."
            lines += ["", *text.wrapped(said)]
            for sentence in missing:
                lines += text.wrapped(sentence, indent="  ")
        for note in self.notes:
            lines += text.wrapped(f"Note: {text.as_sentence(note)}")
        return "\n".join(lines)

    @property
    def missing(self) -> tuple[str, ...]:
        """Sentences, one per band, on which parameters are missing at how many pairs, and why."""
        sentences, n = [], len(self.measurement.pairs)
        for k, frequency in enumerate(self.measurement.centre_frequencies):
            alike: dict[tuple[tuple[str, ...], Floor], list[int]] = {}
            for i in range(n):
                of_pair = ((p, v[i, k]) for p, v in self.measurement.values.items())
                if names := tuple(parameter_label(p) for p, value in of_pair if np.isnan(value)):
                    alike.setdefault((names, self.floors[i][k]), []).append(i)
            parts = [
                f"no {', '.join(names)}{f' in {self._pairs(rows)}' if n > 1 else ''}. "
                + floor.value.format(spread(self.impulse_to_noise_ratio[rows, k], ".1f"))
                for (names, floor), rows in sorted(alike.items(), key=lambda item: -len(item[1]))
            ]
            if parts:
                sentences.append(f"{_bands.label(frequency)}: {' And '.join(parts)}")
        return tuple(sentences)

    def _pairs(self, rows: Sequence[int]) -> str:
        """Return how many pairs these are, and which, up to `MOST_NAMED`."""
        n = len(self.measurement.pairs)
        named = [" to ".join(self.measurement.pairs[i]) for i in rows]
        which = f" ({text.first_of(named, MOST_NAMED)})" if len(rows) < n else ""
        return f"{len(rows)} of {n} pairs{which}"


def with_uncertainty(measurement: Measurement) -> Measurement:
    """Return the measurement with a standard uncertainty for each value, from theory and round robins.

    Each value has that of one random response; the common one is that between teams (Bork 2005).
    """
    frequencies, values = measurement.centre_frequencies, measurement.values
    times = measurement.reverberation_time
    own: dict[str, Array] = {}
    common: dict[str, Array] = {}
    for p, table in values.items():
        kind = observable(p)
        told = kind.decay_time(table)
        decay = np.where(np.isfinite(table), np.where(np.isfinite(told), told, times), np.nan)
        own[p] = kind.of_value(kind.scatter(frequencies, decay), table)
        common[p] = kind.of_value(kind.between_teams(frequencies), measurement.mean(p))
    return replace(measurement, uncertainty=own, common_uncertainty=common)


_RATES = 2000, 400_000  # Hz
_BLOCK = 2**16
_LOSSY = re.compile(r"MPEG|VORBIS|OPUS|ADPCM|GSM|G72|[UA]LAW|DWVW|NMS")
_SIZE = re.compile(r": (\d+) \(should be (\d+)\)")
_SLACK = 64  # bytes by which programs miscount the length in a header


@contextmanager
def _opened(path: str) -> Iterator[Any]:
    """Yield soundfile's object of a file; DataError, in own words, for what it cannot read."""
    soundfile = library("sound files need soundfile: pip install 'rtcal[measurement]'", "soundfile")
    if not Path(path).is_file():
        raise DataError(
            f"{path}: {'this is not a file' if Path(path).exists() else 'no such file or folder'}"
        )
    try:
        # As a stream, since the content and not the name shows the format.
        with open(path, "rb") as stream, soundfile.SoundFile(stream) as file:
            yield file
    except soundfile.SoundFileError as error:
        with expecting(RESPONSE, path):
            raise DataError(
                f"{path}: this file cannot be read as sound, because it is damaged or has "
                "another format (WAV, FLAC, AIFF, CAF, W64 and RF64 can be read). Export "
                "it as WAV or FLAC"
            ) from error
    except OSError as error:
        raise DataError(f"{path}: {reason(error)}") from error


class Response(NamedTuple):
    """Hold an impulse response that is loaded only when it is needed, to save memory."""

    place: str
    load: Callable[[], Array]
    sampling_rate: float


def _of_sound(
    path: str | os.PathLike[str], doubts: list[str]
) -> Iterator[tuple[str, str, list[Response]]]:
    """Yield source, receiver and channels of a sound file, named by its name."""
    place = os.fspath(path)
    with _opened(place) as file:
        n, rate, log, coding = file.frames, file.samplerate, file.extra_info, file.subtype
        n_channels, named = file.channels, file.subtype_info
    if n < 1:
        raise DataError(f"{place}: has no samples")
    if not _RATES[0] <= rate <= _RATES[1]:
        raise DataError(
            f"{place}: has a sampling rate of {rate} Hz; only 2 kHz to 400 kHz are read"
        )
    most = budget.MAX_CHANNEL_SAMPLES
    remedy = f"that is {most / rate:.0f} s at {rate} Hz; keep the part with the decay"
    budget.require(n, most, "samples in each channel", place, remedy)
    if _LOSSY.search(coding):
        doubts.append(
            f"{place}: its coding, {named}, is lossy, so that the late decay is in doubt: WAV and FLAC "
            "keep it"
        )
    if any(int(a) > int(b) + _SLACK and int(a) < 2**32 - 1 for a, b in _SIZE.findall(log)):
        doubts.append(f"{place}: it is shorter than its header states, so that its end is missing")
    stem = Path(place).stem
    source, receiver = position_in(stem) or ("S1", stem)
    loads = [partial(_samples, place, n, channel) for channel in range(n_channels)]
    yield source, receiver, [Response(place, load, float(rate)) for load in loads]


def _samples(path: str, n: int, channel: int) -> Array:
    """Return the samples of a sound file's channel, from 0, (n,); DataError if it ends before."""
    samples, position = np.empty(n), 0
    with _opened(path) as file:
        for block in file.blocks(_BLOCK, always_2d=True):
            block = block[: n - position, channel]
            samples[position : position + len(block)] = block
            position += len(block)
    if position < n:
        raise DataError(
            f"{path}: the file is cut off: it has {position} of the {n} samples that its "
            "header gives. Export or copy it again"
        )
    return samples


def _of_sofa(path: str | os.PathLike[str]) -> Iterator[tuple[str, str, list[Response]]]:
    """Yield source, receiver and channels of each measurement in a SOFA file."""
    file, place = sofa.read(path), os.fspath(path)
    for (source, receiver), samples in zip(file.pairs, file.samples, strict=True):
        loads = [partial(np.asarray, channel, dtype=float) for channel in samples]
        yield source, receiver, [Response(place, load, file.sampling_rate) for load in loads]


def _chosen(
    every: Sequence[Response], receiver: str, channels: int | str | None, place: str
) -> list[tuple[str, Response]]:
    """Return the receivers' names and responses of those channels of a measurement that are read."""
    n_channels = len(every)
    if channels == "receivers" and n_channels > 1:
        name, mark, repeat = receiver.partition("#")
        return [(f"{name}-{i + 1}{mark}{repeat}", response) for i, response in enumerate(every)]
    if isinstance(channels, str) and channels != "receivers":
        raise DataError(f'channels = "{channels}" must be a number or "receivers"')
    if n_channels == 1:
        return [(receiver, every[0])]
    if channels is None:
        raise DataError(
            f"{place}: the file has {n_channels} channels. Choose one of them, such as "
            'channels=1, or give channels="receivers" if each is a receiver'
        )
    number = checks.whole("channels", channels, 1)
    if number > n_channels:
        raise DataError(
            f"{place}: channel {number} does not exist; the file has {n_channels} channels"
        )
    return [(receiver, every[number - 1])]


def analyse(
    signals: Any,
    *,
    bands: str | Sequence[float] = "octave",
    minimum_range: Mapping[str, float] | None = None,
    progress: Callable[[], None] | None = None,
) -> Analysis:
    """Return the room-acoustic parameters (T20, EDT, C80, ...) of impulse responses, in bands.

    The `Analysis` has the ``measurement``, with reasons for values that are missing, and cautions.
    Raises DataError for a silent or broken response, or a band above half the sampling rate. Raises
    MissingDependencyError if pyfar or pyrato is not installed.

    Parameters
    ----------
    signals : pyfar.Signal, or mapping of (source, receiver) to pyfar.Signal
        Room impulse responses, one channel each.
    bands : "octave", "third-octave" or sequence of float
        Bands to evaluate: "octave" for 63 Hz to 8 kHz, "third-octave" for 50 Hz to 10 kHz, both up to
        the limit of the sampling rate, or centre frequencies in Hz.
    minimum_range : mapping of str to float, optional
        Impulse-to-noise ratios in dB below which a parameter is left out, by its key, such as "t20". By
        default 35 dB for T20, 45 dB for T30, and 20 dB for all others.
    progress : callable, optional
        Function that is called after each response.
    """
    libraries()
    needed = ranges_of(minimum_range)
    signals = dict(signals) if isinstance(signals, Mapping) else {("S1", "R1"): signals}
    if not signals:
        raise DataError("no impulse response is given")
    for pair, signal in signals.items():
        if not hasattr(signal, "sampling_rate"):
            raise DataError(f"signals: {checks.shown(signal)} of {pair} must be a pyfar.Signal")
        shape = np.shape(signal.time)
        if len(shape) != 2 or shape[0] != 1:
            raise DataError(f"signals: {pair} has shape {shape}; it must have one channel")
    responses = {
        pair: Response(
            f"impulse response {'/'.join(pair)}",
            partial(np.asarray, signal.time[0], dtype=float),
            float(signal.sampling_rate),
        )
        for pair, signal in signals.items()
    }
    return analysed(responses, bands, needed, progress)


def analysed(
    responses: Mapping[tuple[str, str], Response],
    bands: str | Sequence[float],
    needed: dict[str, float],
    progress: Callable[[], None] | None,
    doubts: Sequence[str] = (),
) -> Analysis:
    """Return the parameters of responses; ``doubts`` are cautions about their files."""
    libraries()
    centres, fractions = centres_of(bands, min(r.sampling_rate for r in responses.values()))
    found: list[list[OfEnergy]] = []
    peaks = dict[tuple[str, str], float]()
    of_files: dict[str, list[str]] = {_BARE: [], _LATE: [], _CLIPPED: [], _SILENT: []}
    for pair, response in responses.items():
        time, onset, silence, n_clipped, peak = _prepared(response)
        rate, place, n = response.sampling_rate, response.place, len(centres)
        of_bands = [_of_band(time, onset, rate, float(f), fractions, needed) for f in centres]
        if LEVEL.key in needed:
            for other, top in peaks.items():
                if other[0] == pair[0] and abs(top / peak - 1) < _SAME_PEAK:
                    raise DataError(
                        f"level: {responses[other].place} and {place} have the same peak, "
                        f"{top:.3g}, so they were normalised. Export them with one gain, or leave "
                        "level out"
                    )
            peaks[pair] = peak
        for of_band in of_bands:
            if LEVEL.key in of_band.values:
                of_band.values[LEVEL.key] += 20 * np.log10(peak)
        known = [of_band for of_band in of_bands if of_band.values]
        if 2 * sum(of_band.late for of_band in known) > len(known):
            of_files[_LATE].append(place)
            of_bands = [OfEnergy({}, of_band.ratio, Floor.LATE) for of_band in of_bands]
        elif 2 * len(known) < n:
            of_files[_BARE].append(f"{place} ({n - len(known)} of {n} bands)")
        if n_clipped:
            of_files[_CLIPPED].append(f"{place} ({n_clipped} samples)")
        if silence >= LEAST_SILENCE:
            of_files[_SILENT].append(f"{place} ({silence:.2f} s)")
        found.append(of_bands)
        if progress is not None:
            progress()
    placed = places_of([*responses])
    notes = [*note_of_repeats(placed), *doubts]
    notes += [note.format(first_of(some, MOST_NAMED)) for note, some in of_files.items() if some]
    return assembled([*responses], found, centres, needed, notes)


def assembled(
    pairs: Sequence[tuple[str, str]],
    found: Sequence[Sequence[OfEnergy]],
    centres: Array,
    needed: Mapping[str, float],
    notes: list[str],
) -> Analysis:
    """Return the analysis of all pairs, from the parameters of each response in each band.

    ``found`` is (n_pairs, n_bands), and repeats among ``pairs`` are averaged. Cautions are added to
    ``notes``.
    """
    fractions = 1 if _bands.bandwidth_factor(centres) > 0.5 else 3
    values = {
        p: np.array([[of_band.values.get(p, np.nan) for of_band in row] for row in found])
        for p in needed
    }
    measurement = Measurement(centre_frequencies=centres, pairs=tuple(pairs), values=values)
    times = np.full((len(found), len(centres)), np.inf)
    for p in reversed([p for p in of_kind(DecaySlope) if p in values]):  # the first replaces others
        times = np.where(np.isfinite(values[p]), values[p], times)
    for centre, product in zip(centres, (bandwidth_of(centres, fractions) * times).T, strict=True):
        if (short := product[product < LEAST_BT]).size:
            count = "" if len(found) == 1 else f" in {short.size} of {len(found)} pairs"
            notes.append(
                f"{_bands.label(centre)}: B T = {spread(short, '.1f')}{count} is below "
                f"{LEAST_BT:g}: the measured decay contains that of the band filter"
            )
    notes += [
        f"{band.frequency:g} Hz: {band.text}; one T does not describe it"
        for band in bent_decays(measurement)
    ]
    least: dict[tuple[str, str], list[OfEnergy]] = {}  # of repeats, that which reaches least deep
    for place_of, row in zip(places_of(pairs), found, strict=True):
        others = least.get(place_of, row)
        least[place_of] = [
            min(both, key=lambda x: x.ratio) for both in zip(others, row, strict=True)
        ]
    return Analysis(
        measurement=measurement,
        impulse_to_noise_ratio=np.array([[b.ratio for b in row] for row in least.values()]),
        floors=tuple(tuple(b.floor for b in row) for row in least.values()),
        minimum_range=needed,
        notes=tuple(notes),
    )


_SAME_PEAK = 1e-3  # Relative difference of the peaks of two files up to which one normalised both


LEAST_SILENCE = 0.01
"""Duration in s of digital silence at the end of a response from which a note mentions it."""
LEAST_CLIPPED = 4
"""Number of samples at the largest value from which a response is clipped; by rounding a decay has a
few at most, as decays of 10 to 24 bits show."""
_BARE = (
    "hardly a decay: {} without any parameter. Look whether it is an impulse response, and not noise "
    "or a recording of the excitation"
)
_LATE = (
    "no decay: the energy arrives late, as in a recording of a sweep, of interrupted noise or of two "
    "sounds: {}. Nothing of it is evaluated: give the sweep that was played (--sweep played.wav), or "
    "--interrupted for noise, or the impulse response"
)
_CLIPPED = (
    f"clipped: {{}}. Their largest value occurs {LEAST_CLIPPED} times or more, that of a decay once. "
    "All their values are in doubt, and no table says so: measure again at a lower level, or without "
    "these files"
)
_SILENT = "digital silence at the end is left out: {}"

_SMOOTH = 5.0
"""Largest step beside a smooth maximum, in the file's smallest step: the neighbours of samples of a
parabola's top that are rounded to one value are 4 steps lower, and 1 more by their own rounding."""

_LARGEST = 1e150  # Largest sample whose square is finite, with a margin for sums


def _prepared(response: Response) -> tuple[Array, int, float, int, float]:
    """Return the samples with a peak of 1, the onset, the silence in s, the clipped samples, the peak.

    Digital silence at the end, which is no noise, and a constant offset are left out. The onset is the
    first sample within 20 dB of the peak (ISO 3382-1:2009, 5.3.2).
    """
    time, place = response.load(), response.place
    budget.require(len(time), budget.MAX_CHANNEL_SAMPLES, "samples", place)
    if (bad := ~(np.abs(time) < _LARGEST)).any():  # the square of a larger one may overflow
        first = int(np.argmax(bad))
        below = f" below {_LARGEST:g}" if np.isfinite(time[first]) else ""
        raise DataError(
            f"{place}: sample {first + 1} of {len(time)} is {time[first]:g}, not a finite number{below}"
        )
    if not np.any(time):
        raise DataError(f"{place}: is silent (every sample is 0); leave it out")
    changes = np.flatnonzero(time != time[-1])
    n_silent = len(time) - 1 - int(changes[-1]) if changes.size else 0
    if n_silent > 1 and np.any(time[: len(time) - n_silent]):  # silence only after a sound
        time = time[: len(time) - n_silent]
    clipped = clipped_samples(time)
    time = time - np.mean(time[-max(len(time) // 10, 1) :])
    peak = float(np.max(np.abs(time))) or 1.0
    time = time / peak
    onset = int(np.argmax(np.abs(time) >= 0.1))
    return time, onset, n_silent / response.sampling_rate, clipped, peak


def clipped_samples(time: Array) -> int:
    """Return the number of clipped samples of a response (n_samples,); 0 below `LEAST_CLIPPED`."""
    steps = np.abs(np.diff(time))
    if not steps.any():
        return 0
    step, peak = float(np.min(steps[steps > 0])), float(np.max(np.abs(time)))
    count = 0
    for signed in (time, -time):
        top = float(signed.max())
        if top < peak / 2:
            continue
        at_top = np.concatenate([[False], signed == top, [False]]).astype(np.int8)
        starts, ends = np.flatnonzero(np.diff(at_top) == 1), np.flatnonzero(np.diff(at_top) == -1)
        outside = np.concatenate([[top], signed, [top]])
        drop = top - np.minimum(outside[starts], outside[ends + 1])
        n = int((ends - starts)[drop > _SMOOTH * step].sum())
        count += n if n >= LEAST_CLIPPED else 0
    return count


def bandwidth_of(centre: Any, fractions: int) -> Any:
    return centre * (2 ** (0.5 / fractions) - 2 ** (-0.5 / fractions))


class OfEnergy(NamedTuple):
    """Hold the parameters of one squared impulse response.

    ``ratio`` is the impulse-to-noise ratio in dB, -inf for a decay below 10 dB, and ``floor`` limits
    it. ``late`` is True if the energy arrives too late for a decay.
    """

    values: dict[str, float]
    ratio: float
    floor: Floor
    late: bool = False


def _of_band(
    time: Array, onset: int, rate: float, centre: float, fractions: int, needed: Mapping[str, float]
) -> OfEnergy:
    """Return the parameters of a response, (n_samples,), in one band."""
    bandwidth = bandwidth_of(centre, fractions)
    lead = int(4 / bandwidth * rate)
    # A response that begins at its direct sound leaves no room for what the filter moves before it.
    missing = max(lead - onset, 0)
    energy = filtered(np.pad(time, (missing, 0)), rate, centre, fractions)
    onset += missing
    before = float(energy[onset - lead : onset].sum())
    # At the end, where it starts, the filter has not risen yet.
    energy = energy[: max(len(energy) - int(rate / bandwidth), onset)]
    return of_energy(energy[onset:], rate, needed, centre, bandwidth, before, lead - missing)


def of_energy(
    energy: Array,
    rate: float,
    needed: Mapping[str, float] = MINIMUM_RANGE,
    centre: float | None = None,
    bandwidth: float | None = None,
    early: float = 0.0,
    early_samples: int = 0,
) -> OfEnergy:
    """Return the parameters of one squared impulse response that begins with the direct sound.

    ``energy`` (n_samples,) has the ``rate`` in Hz; ``centre`` and ``bandwidth`` in Hz are those of its
    band. ``early`` is what the band filter moved to the ``early_samples`` before the direct sound.
    """
    total = float(np.sum(energy))
    if not (np.isfinite(total) and total > 0 and len(energy) >= rate / 20):
        return OfEnergy({}, -np.inf, Floor.SHORT)
    most = float(energy.max())
    energy = energy / most
    early = early / most
    cut = _cut(energy, rate, centre)
    if cut == len(energy) and energy[cut * 9 // 10 :].mean() > _LOW:
        cut = _cut_into_noise(energy, rate, centre, bandwidth or rate / 2)
    done = _evaluated(_as_it_is(energy, cut), rate, needed, early, early_samples)
    if done.ratio < max(needed.values()):
        decay_on_line = _on_line(energy[:cut], rate, centre)
        if decay_on_line is not None:
            by_line = _evaluated(decay_on_line, rate, needed, early, early_samples)
            done = max(done, by_line, key=lambda of_curve: of_curve.ratio)
    if LEVEL.key in done.values:
        done.values[LEVEL.key] += float(10 * np.log10(most))
    return done


def _evaluated(
    decayed: _Decay, rate: float, needed: Mapping[str, float], early: float, early_samples: int
) -> OfEnergy:
    """Return the parameters of a decay curve that its range suffices for."""
    curve = decayed.curve
    level = 10 * np.log10(curve / curve[0])
    # Levels below every evaluation range are left out, which saves memory in the regressions.
    slopes = of_kind(DecaySlope)
    lowest = min(o.lower for o in slopes.values())
    in_range = level[: int(np.max(np.flatnonzero(level >= lowest))) + 1]
    times = {p: float(o.of_curve(in_range, 1 / rate)) for p, o in slopes.items()}
    times = {p: t for p, t in times.items() if np.isfinite(t) and level[-1] <= slopes[p].lower}
    if EARLY.key not in times or decayed.reach < -EARLY.lower:
        return OfEnergy({}, -np.inf, Floor.FLAT)
    density = curve[0] * 6 * np.log(10) / (times[EARLY.key] * rate)
    ratio = float(10 * np.log10(density / decayed.end)) if decayed.end > 0 else np.inf
    reach = min(ratio - decayed.lost, decayed.reach)
    centre = float(curve.sum() / curve[0]) / rate  # of gravity, in s
    curve[0] += max(early - decayed.subtracted * early_samples, 0.0)
    # A ratio is left out if its limit is after the end of the curve.
    energy = np.maximum(-np.diff(curve, append=0.0), 0.0)
    others = [p for p in MINIMUM_RANGE if p not in slopes]
    ratios = observables.parameters(energy, 1 / rate, others).items()
    end = len(curve) / rate
    held = {p: float(v) for p, v in ratios if end > OBSERVABLES[p].reaches and np.isfinite(v)}
    values = {**held, **times}
    if LEVEL.key in needed:
        values[LEVEL.key] = float(10 * np.log10(curve[0] / rate))
    return OfEnergy(
        values={p: v for p, v in values.items() if reach >= needed[p]},
        ratio=ratio if reach >= max(needed.values()) else reach,
        floor=decayed.floor,
        late=_is_late(in_range, rate, centre, times) or _sounds_again(energy, rate),
    )


_LATEST = 2.5
"""Largest T that the energy's centre of gravity amounts to, over the decay's; an exponential has 1."""
_STEADIEST = 2.2
"""Least time of 90 % of the energy over that of the half; an exponential has 3.3, steady noise 1.8."""


def _is_late(level: Array, rate: float, centre: float, times: Mapping[str, float]) -> bool:
    """Return whether the energy arrives later than in a decay, judged by a decay curve in dB.

    Both its centre of gravity and the rise of its energy must be late: one strong reflection in a dry
    room makes one of them so.
    """
    half, most = (int(np.argmax(level <= -10 * np.log10(x))) / rate for x in (2.0, 10.0))
    t = times.get(TARGET.key)
    if t is None:  # the last 5 dB of EDT's range
        t = 12 * (most - int(np.argmax(level <= -5.0)) / rate)
    return most < _STEADIEST * half and centre * 6 * np.log(10) > _LATEST * t


_QUIET = 3
"""Blocks of 0.1 s after which no room returns as much as at first: an echo would come over 100 m."""


def _sounds_again(energy: Array, rate: float) -> bool:
    """Return whether a second sound begins, after a level 20 dB below the first for 0.3 s."""
    block = int(0.1 * rate)
    sums = energy[: len(energy) // block * block].reshape(-1, block).sum(axis=1)
    if not sums.any():
        return False
    level = 10 * np.log10(np.maximum(sums / sums.max(), 1e-12))
    quiet = np.convolve(level < -20.0, np.ones(_QUIET), "valid") == _QUIET
    return bool(quiet.any() and (level[int(np.argmax(quiet)) :] > -3.0).any())


class _Decay(NamedTuple):
    """A decay curve (n,), the energy above 0 that is left at each sample, and what ends it.

    ``end`` is the energy per sample at the end, of noise and decay, ``subtracted`` that of the noise
    that was taken off. ``reach`` is the range in dB that noise leaves where it was not, ``lost`` that
    which a curve loses without the energy beyond a cut.
    """

    curve: Array
    end: float
    floor: Floor
    subtracted: float = 0.0
    reach: float = np.inf
    lost: float = 0.0


def _as_it_is(energy: Array, cut: int) -> _Decay:
    """Return the decay curve of a squared response, integrated as it is.

    An error of the curve that is `MARGIN_DB` below a range is too small for any parameter.
    """
    n = len(energy)
    tenth = energy[n * 9 // 10 :].mean()
    before = energy[cut * 9 // 10 : cut].mean() if cut < n else 0.0
    more = MARGIN_DB - _RANGE_TO_NOISE
    with np.errstate(divide="ignore"):
        reach = float(10 * np.log10(energy.sum() / (tenth * n))) - more
    return _Decay(
        curve=_integrated(energy),
        end=float(max(tenth, before)),
        floor=Floor.END,
        reach=reach,
        lost=more if cut < n else 0.0,
    )


def _on_line(energy: Array, rate: float, centre: float | None) -> _Decay | None:
    """Return the decay curve of a squared response by the line of its late decay; None without one."""
    line = _line(energy, rate, centre)
    if line is None:
        return None
    n = len(energy)
    crossing, t, floor = line  # the line has the energy `floor` where it crosses the noise
    slope = 6 * np.log(10) / t
    first = int(np.clip(crossing + t / 6, 0, n * 9 // 10))
    at_first, at_end = floor * np.exp(-slope * (np.array([first, n]) - crossing))
    own = (at_first - at_end) / slope / (n - first)  # of the decay, in the mean from `first` on
    noise = max(float(energy[first:].mean()) - own, 0.0)
    stop, left = n, at_end
    if noise > at_end:
        stop = int(crossing - t / 6 * np.log10(noise / floor))
        left = noise
    if not 10 <= stop <= n:
        return None
    curve = _integrated(energy[:stop] - noise) + left / slope
    ends = np.flatnonzero(~(curve > 0))
    return _Decay(
        curve=curve[: ends[0]] if ends.size else curve,
        end=noise + at_end,
        subtracted=noise,
        floor=Floor.NOISE if noise > at_end else Floor.CUT,
    )


_RANGE_TO_NOISE = 10.0  # dB, from the end of a range to the noise (ISO 3382-1:2009, 5.3)
_CLIFF = 20.0
"""Level in dB by which a decay that is cut falls at once, in the two blocks around the cut."""


def _cut(energy: Array, rate: float, centre: float | None) -> int:
    """Return the number of samples before a response is cut and only silence follows, or all.

    The sound falls by `_CLIFF` and three times its own decay in two blocks, and does not rise again.
    Digital silence is left out before; but one that carries the noise of a converter is none.
    """
    window = 0.03 if centre is None else 0.8 / centre + 0.01  # s, over which Lundeby smooths
    block = max(int(window * rate), 1)
    n = len(energy) // block
    if n < 4:
        return len(energy)
    means = energy[: n * block].reshape(n, block).mean(axis=1)
    after = np.maximum.accumulate(means[::-1])[::-1]
    before, later = means[1:-2], after[3:]  # two blocks apart
    with np.errstate(divide="ignore", invalid="ignore"):
        drop = 10 * np.log10(before / later)
        own = 10 * np.log10(means.max() / before) / np.arange(1, n - 2)
    found = np.flatnonzero((before > 0) & (drop > _CLIFF + 6 * own))
    if not found.size:
        return len(energy)
    first = int(found[0])
    level = before[first] * np.sqrt(max(later[first] / before[first], 1e-6))
    loud = np.flatnonzero(energy[: (first + 4) * block] > level)
    return int(loud[-1]) + 1


_LOW = 1e-7
"""Energy per sample over its largest value, below which no cut is looked for: one 50 dB
down or lower changes no parameter, and `_cut` finds a fall of 20 dB."""


def _cut_into_noise(energy: Array, rate: float, centre: float | None, bandwidth: float) -> int:
    """Return the number of samples before a response is cut and noise follows, or all.

    The line of the late decay and the noise tell how much energy the last 10 dB before they cross
    have. Of a cut response it is less than half, by more than three times its standard deviation
    1/sqrt(B D) over the duration D.
    """
    line = _line(energy, rate, centre)
    if line is None:
        return len(energy)
    crossing, t, floor = line
    last = int(min(crossing, len(energy)))
    first = max(int(crossing - t / 6), 0)
    if last - first < 10:
        return len(energy)
    at = np.arange(first, last)
    expected = floor * (1 + np.exp(-6 * np.log(10) / t * (at - crossing)))
    share = energy[first:last].sum() / expected.sum()
    if share >= 0.5 or (1 - share) * np.sqrt(bandwidth * (last - first) / rate) <= 3:
        return len(energy)
    before = max(int(crossing - t / 2), 0)
    left = np.cumsum(energy[before:last][::-1])[::-1] / np.arange(last - before, 0, -1)
    return before + int(np.argmax(left < 2 * floor))


def _integrated(energy: Array) -> Array:
    """Return the energy from each sample on, (n_samples,), without the zeros at its end."""
    left = np.cumsum(energy[::-1])[::-1]
    return left[: int(np.max(np.flatnonzero(left)) + 1)]


def _line(energy: Array, rate: float, centre: float | None) -> tuple[float, float, float] | None:
    """Return the line of a late decay by Lundeby's method; None where it finds none.

    Where it crosses the noise and its T, both in samples, and the noise, energy per sample.
    """
    pyfar, pyrato = libraries()
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            found = pyrato.edc.intersection_time_lundeby(
                pyfar.Signal(energy, rate),
                smoothing_parameter=centre or "broadband",
                is_energy=True,
                failure_policy="error",
            )
        except (ArithmeticError, ValueError, IndexError, TypeError):
            return None
    crossing, t, noise = (float(np.ravel(x)[0]) for x in found)
    usable = np.isfinite([crossing, t, noise]).all() and t > 0 and noise > 0
    return (crossing * rate, t * rate, noise) if usable else None


def filtered(time: Array, rate: float, centre: float, fractions: int) -> Array:
    """Return the squared response in one band, filtered backwards in time."""
    from scipy.signal import sosfilt

    pyfar, _ = libraries()
    band = pyfar.dsp.filter.fractional_octave_bands(
        None,
        fractions,
        sampling_rate=rate,
        order=_ORDER,
        frequency_range=(centre * 0.97, centre * 1.03),
    )
    (sections,) = band.coefficients
    filtered = sosfilt(sections, time[::-1])[::-1]
    return np.asarray(np.square(filtered, out=filtered))


def centres_of(bands: str | Sequence[float], rate: float) -> tuple[Array, int]:
    """Return the centre frequencies in Hz, (n_bands,), and 1 for octaves or 3 for third-octaves."""
    named = {"octave": _bands.octaves(63, 8000), "third-octave": _bands.third_octaves(50, 10000)}
    if isinstance(bands, str) and bands not in named:
        raise DataError(f'bands = "{bands}" must be "octave" or "third-octave"')
    stated = _bands.as_bands(named[bands] if isinstance(bands, str) else bands, "bands")
    fractions = 1 if _bands.bandwidth_factor(stated) > 0.5 else 3
    nominal = _bands.OCTAVES if fractions == 1 else _bands.THIRD_OCTAVES
    held = [f in nominal and f * 2 ** (0.5 / fractions) * 1.01 < rate / 2 for f in stated]
    if isinstance(bands, str):
        stated = stated[held]
        if not stated.size:
            raise DataError(f"sampling rate {rate:g} Hz: no band lies below half of it")
    elif not all(held):
        raise DataError(
            f"bands has {_bands.label(stated[held.index(False)])}, which is not "
            f"{'an ' if fractions == 1 else 'a one-third '}octave below half the sampling rate "
            f"of {rate:g} Hz"
        )
    return stated, fractions


def ranges_of(
    minimum_range: Mapping[str, float] | None, *, level: bool = False
) -> dict[str, float]:
    chosen = dict(MINIMUM_RANGE)
    if level:  # all of the energy, as the ratios of energies need it
        chosen[LEVEL.key] = min(MINIMUM_RANGE.values())
    stated = {} if minimum_range is None else minimum_range
    for name, value in checks.mapped("minimum_range", stated).items():
        parameter = checks.text("minimum_range: a name", name).lower()
        place = f"minimum_range[{checks.shown(name)}]"
        value = checks.number(place, value)
        if parameter not in chosen:
            raise DataError(f"{place}: a parameter must be one of {', '.join(chosen)}")
        if not 0 <= value < np.inf:
            raise DataError(f"{place} = {value:g} dB must be finite and 0 or more")
        chosen[parameter] = value
    return chosen


def libraries() -> tuple[Any, Any]:
    """Return the modules pyfar and pyrato; raises MissingDependencyError if one is not installed."""
    needed = "impulse responses need pyfar and pyrato: pip install 'rtcal[measurement]'"
    return library(needed, "pyfar"), library(needed, "pyrato")
