"""Rooms that ship with rtcal, and projects to start from, as ``rtcal example`` writes them.

The rooms' folders state source and licence.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.finder.case import Case


__all__ = ["NAMES", "example"]
__dir__ = __all__.copy

_HERE = Path(__file__).parent


def path(name: str) -> Path:
    """Return the path of a shipped file, for example ``path("bras_cr2/room.toml")``.

    ``name`` is the file's path within rtcal's examples.
    """
    return _HERE / checks.path("name", name)


def bras_cr2() -> tuple[Room, Measurement]:
    """Return the seminar room CR2 of the BRAS benchmark and its measured T30.

    The room has 146 m³ and five materials, with input coefficients from the data base. T30 is the mean
    over the positions in the six octaves from 125 to 4000 Hz.

    Aspoeck, Brinkmann, Ackermann, Weinzierl, Vorlaender: BRAS - Benchmark for Room Acoustical
    Simulation, doi 10.14279/depositonce-6726.3, CC BY-SA 4.0.
    """
    folder = path("bras_cr2")
    return (
        Room.from_file(str(folder / "room.toml")),
        Measurement.from_file(str(folder / "measured.csv")),
    )


_HIDDEN = {
    "case": "truth",
    "closed": "truth",
    "identified": "identified_truth",
    "not_identified": "not_identified_truth",
}


def hidden_room(which: str = "case") -> tuple[Case, dict[str, Any]]:
    """Return the case of a simulated room in which the model lacks an effect, and the true effect.

    The first value is the case for `rtcal.find`. The second value is a dict with the true ``alpha`` of
    the materials, (n_materials, n_bands), and the effect: ``opening_area_m2`` for "case" and "closed",
    and its name ``hidden`` for the other two. The rooms were simulated by a program that is independent
    of rtcal (`benchmarks/studies/hidden_world`).

    Raises DataError for another name.

    Parameters
    ----------
    which : {"case", "closed", "identified", "not_identified"}
        Name of the room. "case": a room of six materials, measured as it is and with one material
        covered. "closed": the same room, with everything closed or taken out that can be. "identified":
        a room in which rtcal identifies the effect. "not_identified": a room in which rtcal identifies
        no effect.
    """
    from rtcal.finder.case import Case

    checks.choice("which", which, _HIDDEN)
    folder = path("hidden_room")
    truth = (folder / f"{_HIDDEN[which]}.json").read_text(encoding="utf-8")
    return Case.from_file(str(folder / f"{which}.json")), json.loads(truth)


@dataclass(frozen=True)
class Example:
    """Hold the files of a small project by name, and the commands to run in their folder, in order.

    ``files`` maps the name of each file to its content in bytes, and ``commands`` are lines to type
    into a terminal.
    """

    files: Mapping[str, bytes]
    commands: tuple[str, ...]


_CALIBRATE = "rtcal calibrate room.toml t.csv --out calibrated"
_REPORT = "rtcal report calibrated"
_SEMINAR_ROOM = {
    "room.toml": "bras_cr2/room.toml",
    "t.csv": "bras_cr2/measured.csv",
    "SOURCE.md": "bras_cr2/README.md",
}
_EXAMPLES: Mapping[str, tuple[Mapping[str, str], tuple[str, ...]]] = {
    "room": (_SEMINAR_ROOM, (_CALIBRATE, _REPORT)),
    "change": (
        _SEMINAR_ROOM,
        (
            "rtcal predict room.toml t.csv --change variants.toml --out after",
            "rtcal report after",
            "rtcal design room.toml t.csv --treatments treatments.toml --out design",
        ),
    ),
    "responses": (
        {},
        (
            "rtcal measure S*.wav --out t.csv",
            "rtcal import catalogue --mesh room.obj --catalogue carpet=carpet_cotton "
            "--catalogue plaster=hard_surface --temperature 20 --humidity 45 --out room.toml",
            _CALIBRATE,
            _REPORT,
        ),
    ),
    "recordings": (
        {},
        (
            "rtcal measure S1-R1.wav --sweep played.wav --out t.csv",
            "rtcal measure S1-R2.wav --interrupted --out stopped.csv",
            "rtcal room --dimensions 9,8,3 --floor 'thick carpet' --ceiling 'gypsum board' "
            "--walls plaster --temperature 20 --out room.toml",
            _CALIBRATE,
            _REPORT,
        ),
    ),
    "program": (
        {},
        (
            "rtcal table measured.csv --out t.csv",
            "rtcal import catt hall.geo --volume 216 --area plaster=174 --area carpet=72 "
            "--temperature 21 --humidity 40 --out room.toml",
            _CALIBRATE,
            _REPORT,
            "rtcal loop start room.toml t.csv --state loop.json --out next.toml --decimals 3",
            "rtcal export catt next.toml hall.geo",
        ),
    ),
    # t.csv is a simulation with coefficients 1.2 times as large: `PathTracing(...).simulate(seed=7)`.
    "simulator": ({}, ("python calibrate.py",)),
    "optimisation": (_SEMINAR_ROOM, ("python compose.py",)),
    # The room of "where"; run.csv is what simulate.py (pyroomacoustics 0.10) gave.
    "compare": (
        {name: f"where_room/{name}" for name in ("room.toml", "room.obj", "pairs.csv")},
        (
            "python simulate.py",
            "rtcal compare room.toml pairs.csv --simulated run.csv --out gap",
            "rtcal loop start room.toml pairs.csv --simulated run.csv --state loop.json "
            "--out next.toml",
        ),
    ),
    "missing-effect": (
        {"case.json": "hidden_room/case.json", "closed.json": "hidden_room/closed.json"},
        (
            "rtcal find case.json",
            "rtcal find closed.json --out gap",
            "rtcal verify gap",
        ),
    ),
    # Two cases, one identified and one not: `benchmarks/studies/means/README.md` has their rule.
    "identified": (
        {
            "identified.json": "hidden_room/identified.json",
            "not_identified.json": "hidden_room/not_identified.json",
        },
        ("rtcal find identified.json", "rtcal find not_identified.json"),
    ),
    # A room with a curtain that its model lacks, measured by another tracer
    # (`benchmarks/studies/pairs`).
    "where": (
        {name: f"where_room/{name}" for name in ("room.toml", "room.obj", "pairs.csv")},
        (
            "rtcal find room.toml pairs.csv --out page",
            "rtcal apply page --effect curtain --out corrected",
        ),
    ),
    # A room whose ceiling was covered, simulated by pyroomacoustics (`benchmarks/studies/pairs`).
    "diagnose": (
        {name: f"seminar_room/{name}" for name in ("room.toml", "room.obj", "pairs.csv")},
        ("rtcal diagnose room.toml pairs.csv --out diagnosis",),
    ),
}
"""Files of each example that ship elsewhere, by name, and its commands. Its own are in ``examples``."""
NAMES = tuple(_EXAMPLES)


def example(name: str) -> Example:
    """Return the example project ``name``: its files by name, and the commands to run in their folder.

    ``rtcal example NAME`` writes these files. Raises DataError if the name is none of `NAMES`, such as
    "room", "change" or "where".
    """
    if name not in _EXAMPLES:
        raise DataError(f'there is no example "{name}"; the examples are {", ".join(NAMES)}')
    shared, commands = _EXAMPLES[name]
    files = {file: path(place).read_bytes() for file, place in shared.items()}
    if "SOURCE.md" in files:
        files["SOURCE.md"] = files["SOURCE.md"].replace(b"measured.csv", b"t.csv")
    own = path(f"examples/{name}")
    files |= {file.name.removesuffix(".txt"): file.read_bytes() for file in sorted(own.glob("*"))}
    rng = np.random.default_rng(1)
    if name == "responses":
        names = ("S1_R1.wav", "S1_R2.wav", "S2_R1.wav", "S2_R2.wav")
        files |= {name: _wav(_response(rng)) for name in names}
    if name == "recordings":
        played, silence = _sweep(), np.zeros(_RATE // 2)
        swept = np.concatenate([silence, played, np.zeros(2 * _RATE)])
        on_and_off = np.repeat([1.0, 0.0] * 3, 2 * _RATE) * rng.standard_normal(12 * _RATE)
        stopped = np.concatenate([silence, on_and_off])
        files |= {
            "played.wav": _wav(played),
            "S1-R1.wav": _wav(_recorded(swept, rng)),
            "S1-R2.wav": _wav(_recorded(stopped, rng)),
        }
    return Example(files, commands)


_RATE = 16_000  # Hz
_DECAY_TIMES = {125: 1.5, 250: 1.3, 500: 1.1, 1000: 0.95, 2000: 0.85, 4000: 0.75}  # s


def _wav(sound: Array) -> bytes:
    """Return a WAV file of a sound, with its peak 1 dB below full scale."""
    from scipy.io import wavfile

    stream = io.BytesIO()
    samples = 0.9 * sound / np.abs(sound).max()
    wavfile.write(stream, _RATE, np.round(32767 * samples).astype(np.int16))
    return stream.getvalue()


def _response(rng: np.random.Generator) -> Array:
    """Return noise that decays at `_DECAY_TIMES`, octave by octave."""
    t = np.arange(int(1.5 * _RATE)) / _RATE
    frequency = np.fft.rfftfreq(t.size, 1 / _RATE)
    sound = np.zeros(t.size)
    for centre, decay_time in _DECAY_TIMES.items():
        in_band = (frequency >= centre / np.sqrt(2)) & (frequency < centre * np.sqrt(2))
        noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(t.size)) * in_band, t.size)
        sound += noise * 10 ** (-3 * t / decay_time)
    return sound


def _sweep() -> Array:
    """Return an exponential sweep of 3 s from 70 Hz to 7 kHz, faded in and out over 20 ms."""
    t = np.arange(3 * _RATE) / _RATE
    ratio = np.log(7000 / 70)
    fade = np.minimum(1, 50 * np.minimum(t, t[::-1]))
    return np.asarray(fade * np.sin(2 * np.pi * 70 * 3 / ratio * np.exp(t / 3 * ratio)))


def _recorded(played: Array, rng: np.random.Generator) -> Array:
    """Return what a microphone records of a sound in the room of `_response`, with some noise."""
    response = _response(rng)
    response[0] = 3 * np.abs(response).max()  # the direct sound
    size = played.size + response.size
    sound = np.fft.irfft(np.fft.rfft(played, size) * np.fft.rfft(response, size), size)
    sound = sound[: played.size]
    return np.asarray(sound + 3e-4 * np.abs(sound).max() * rng.standard_normal(sound.size))
