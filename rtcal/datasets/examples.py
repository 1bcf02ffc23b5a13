"""Rooms that ship with rtcal, and projects to start from, as ``rtcal example`` writes them.

The rooms' folders state source and licence.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.support import checks
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.finder.case import Case


__all__ = ["NAMES", "Example", "example"]
__dir__ = __all__.copy

_HERE = Path(__file__).parent


def path(name: str) -> Path:
    """Return the path of a shipped file, for example ``path("bras_cr2/room.toml")``."""
    return _HERE / checks.path("name", name)


def bras_cr2() -> tuple[Room, Measurement]:
    """Return the seminar room CR2 of the BRAS benchmark and its measured T30.

    Aspoeck, Brinkmann, Ackermann, Weinzierl, Vorlaender: BRAS - Benchmark for Room Acoustical
    Simulation, doi 10.14279/depositonce-6726.3, CC BY-SA 4.0.
    """
    folder = path("bras_cr2")
    return (
        Room.from_file(str(folder / "room.toml")),
        Measurement.from_file(str(folder / "measured.csv")),
    )


def hidden_room(*, closed: bool = False) -> tuple[Case, dict[str, Any]]:
    """Return a case with a hidden effect, and the truth: the effect and ``alpha``.

    It is a simulated room of six materials. The tracer is separate from rtcal's
    (`tests/hidden_world`). Configuration A is the room as it is. In B one material is covered with
    another one. In C everything that can be closed or taken out is closed or taken out.

    Parameters
    ----------
    closed : bool
        Return A and C. If False, A and B.
    """
    return _hidden("closed" if closed else "case", "truth")


def named_room() -> tuple[Case, dict[str, Any]]:
    """Return a case in which the finder names what is hidden, and the truth.

    It is the first such room by the rule of `benchmarks/shipped_cases.py`. The tracer is not rtcal's,
    and the coefficients are drawn about the stated ones with the stated sigma.
    """
    return _hidden("named", "named_truth")


def untold_room() -> tuple[Case, dict[str, Any]]:
    """Return a case in which something is hidden and the data do not tell, and the truth.

    It is drawn as `named_room`: the first by that rule in which the finder claims nothing.
    """
    return _hidden("not_told", "not_told_truth")


def _hidden(case: str, truth: str) -> tuple[Case, dict[str, Any]]:
    from rtcal.finder.case import Case

    folder = path("hidden_room")
    return (
        Case.from_file(str(folder / f"{case}.json")),
        json.loads((folder / f"{truth}.json").read_text(encoding="utf-8")),
    )


@dataclass(frozen=True)
class Example:
    """Files of a small project, and the commands that use them.

    Attributes
    ----------
    files : mapping of str to bytes
        Contents by file name.
    commands : tuple of str
        Commands to run in the files' folder, in order.
    """

    files: Mapping[str, bytes]
    commands: tuple[str, ...]


_CALIBRATE = "rtcal calibrate room.toml t.csv --out calibrated"
_REPORT = "rtcal report calibrated"


def _seminar_room() -> dict[str, bytes]:
    folder = path("bras_cr2")
    return {
        "room.toml": (folder / "room.toml").read_bytes(),
        "t.csv": (folder / "measured.csv").read_bytes(),
        "SOURCE.md": (folder / "README.md").read_bytes().replace(b"measured.csv", b"t.csv"),
    }


def _room() -> Example:
    return Example(_seminar_room(), (_CALIBRATE, _REPORT))


_PANEL = """\
[[material]]
name = "panel"
alpha = [0.4, 0.6, 0.8, 0.9, 0.9, 0.9]
sigma = 0.1
"""
_VARIANTS = f"""{_PANEL}
[[variant]]
name = "panels"

[[variant.change]]
cover = "ceiling"
by = "panel"
area = 20

[[variant]]
name = "panels and warmer air"

[[variant.change]]
cover = "ceiling"
by = "panel"
area = 20

[[variant.change]]
air = {{ temperature = 26, humidity = 60 }}
"""
_TREATMENTS = f"""probability = 0.8

[target]
high = [1.0, 0.9, 0.8, 0.8, 0.8, 0.8]

{_PANEL}
[[material]]
name = "bass trap"
alpha = [0.6, 0.5, 0.3, 0.2, 0.2, 0.2]
sigma = 0.1

[[treatment]]
name = "panels on the ceiling"
material = "panel"
covers = "ceiling"
largest = 40
cost = 90
unit = 1.44

[[treatment]]
name = "bass traps"
material = "bass trap"
covers = "concrete"
largest = 20
cost = 120
"""


def _change() -> Example:
    return Example(
        {
            **_seminar_room(),
            "variants.toml": _VARIANTS.encode(),
            "treatments.toml": _TREATMENTS.encode(),
        },
        (
            "rtcal predict room.toml t.csv --change variants.toml --out after",
            "rtcal report after",
            "rtcal design room.toml t.csv --treatments treatments.toml --out design",
        ),
    )


_RATE = 16_000  # Hz
_DECAY_TIMES = {125: 1.5, 250: 1.3, 500: 1.1, 1000: 0.95, 2000: 0.85, 4000: 0.75}  # s


def _response(rng: np.random.Generator) -> bytes:
    """Return a WAV file of noise that decays at `_DECAY_TIMES`, octave by octave."""
    from scipy.io import wavfile

    t = np.arange(int(1.5 * _RATE)) / _RATE
    frequency = np.fft.rfftfreq(t.size, 1 / _RATE)
    sound = np.zeros(t.size)
    for centre, decay_time in _DECAY_TIMES.items():
        in_band = (frequency >= centre / np.sqrt(2)) & (frequency < centre * np.sqrt(2))
        noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(t.size)) * in_band, t.size)
        sound += noise * 10 ** (-3 * t / decay_time)
    stream = io.BytesIO()
    samples = 0.9 * sound / np.abs(sound).max()
    wavfile.write(stream, _RATE, np.round(32767 * samples).astype(np.int16))
    return stream.getvalue()


def _responses() -> Example:
    materials = {wall: "carpet" if wall == "floor" else "plaster" for wall in SHOEBOX_WALLS}
    box = Polyhedron.shoebox((9, 7, 3.2), materials)
    rng = np.random.default_rng(1)
    names = ("S1_R1.wav", "S1_R2.wav", "S2_R1.wav", "S2_R2.wav")
    return Example(
        {"room.obj": box.to_text().encode(), **{name: _response(rng) for name in names}},
        (
            "rtcal measure S*.wav --out t.csv",
            "rtcal import catalogue --mesh room.obj --catalogue carpet=carpet_cotton "
            "--catalogue plaster=hard_surface --temperature 20 --humidity 45 --out room.toml",
            _CALIBRATE,
            _REPORT,
        ),
    )


_GEO = """; A rehearsal room of 9 m x 8 m x 3 m. Absorption in percent, octaves from 125 Hz.
ABS plaster = <14 10 6 5 4 3> {200 200 200}
ABS carpet = <8 24 57 69 71 73> {120 60 60}
CORNERS
"""
_TABLE = """Position,Parameter,125 Hz,250 Hz,500 Hz,1 kHz,2 kHz,4 kHz
P1,T20,1.21,1.05,0.82,0.80,0.78,0.70
P2,T20,1.27,1.01,0.85,0.78,0.77,0.71
P3,T20,1.18,1.07,0.86,0.83,0.75,0.69
"""


def _program() -> Example:
    return Example(
        {"hall.geo": _GEO.encode(), "measured.csv": _TABLE.encode()},
        (
            "rtcal table measured.csv --out t.csv",
            "rtcal import catt hall.geo --volume 216 --area plaster=174 --area carpet=72 "
            "--temperature 21 --humidity 40 --out room.toml",
            _CALIBRATE,
            _REPORT,
            "rtcal loop start room.toml t.csv --state loop.json --out next.toml --decimals 3",
            "rtcal export catt next.toml hall.geo",
        ),
    )


_SIMULATOR = '''"""Calibrate a simulator: change the coefficients until its T20 is the measured one."""

import rtcal as rt

room = rt.Room.from_file("room.toml")
measured = rt.Measurement.from_file("t.csv")
tracer = rt.simulators.PathTracing(
    geometry=rt.io.obj.read("room.obj"),
    room=room,
    sources={sources},
    receivers={receivers},
)
result = rt.calibrate_simulator(tracer, room, measured)
print(result)
result.room.save("calibrated.toml")
'''


def _simulator() -> Example:
    from rtcal.datasets import halls
    from rtcal.simulators.path_tracing import PathTracing

    hall = halls.lecture_hall()
    tracer = PathTracing(
        geometry=hall.geometry,
        room=hall.room,
        sources=hall.sources,
        receivers=hall.receivers,
    )
    measured = tracer.simulate(np.clip(1.2 * hall.room.alpha, 0, 1), seed=7)
    script = _SIMULATOR.format(sources=dict(hall.sources), receivers=dict(hall.receivers))
    return Example(
        {
            "room.toml": hall.room.to_text().encode(),
            "room.obj": hall.geometry.to_text().encode(),
            "t.csv": measured.to_text().encode(),
            "calibrate.py": script.encode(),
        },
        ("python calibrate.py",),
    )


_OPTIMISATION = '''"""Compose a calibration of terms, solve it, and read its certificate."""

import rtcal as rt
from rtcal import terms

room = rt.Room.from_file("room.toml")
measured = rt.Measurement.from_file("t.csv")
calibration = rt.Calibration(
    objective=terms.PriorDeviation() + terms.SoftMatch(relative=0.05),
    constraints=[terms.Bounds(0.01, 1), terms.AtMost("concrete", "ceiling", band=250)],
)
problem = calibration.build(room)  # compiled once, solved as often as you like
for solver in ("clarabel", "osqp"):
    result = problem.solve(measured, solver=solver)
    print(solver, result.alpha[:, 2].round(4))
print(result.certificate)
'''


def _optimisation() -> Example:
    files = {**_seminar_room(), "compose.py": _OPTIMISATION.encode()}
    return Example(files, ("python compose.py",))


def _missing_effect() -> Example:
    return Example(
        {name: path(f"hidden_room/{name}").read_bytes() for name in ("case.json", "closed.json")},
        (
            "rtcal find case.json",
            "rtcal find closed.json",
            "rtcal verify closed.json",
            "rtcal find closed.json --out gap",
        ),
    )


def _told() -> Example:
    """Two cases that `benchmarks/shipped_cases.py` drew by a rule: one is named, one is not."""
    return Example(
        {
            f"{name}.json": path(f"hidden_room/{name}.json").read_bytes()
            for name in ("named", "not_told")
        },
        ("rtcal find named.json", "rtcal find not_told.json"),
    )


def _where() -> Example:
    """A room with a curtain that its model lacks: `tests/position_rooms/shipped.py` measures it."""
    return Example(
        {
            name: path(f"where_room/{name}").read_bytes()
            for name in ("room.toml", "room.obj", "pairs.csv")
        },
        (
            "rtcal find room.toml pairs.csv",
            "rtcal find room.toml pairs.csv --out page",
            "rtcal apply room.toml pairs.csv --out corrected",
        ),
    )


_EXAMPLES: Mapping[str, Callable[[], Example]] = {
    "room": _room,
    "change": _change,
    "responses": _responses,
    "program": _program,
    "simulator": _simulator,
    "optimisation": _optimisation,
    "missing-effect": _missing_effect,
    "told": _told,
    "where": _where,
}
NAMES = tuple(_EXAMPLES)


def example(name: str) -> Example:
    """Return the example of this name, one of `NAMES`.

    Raises
    ------
    DataError
        If there is none of this name.

    Examples
    --------
    >>> example("room").commands
    ('rtcal calibrate room.toml t.csv --out calibrated', 'rtcal report calibrated')
    """
    if name not in _EXAMPLES:
        raise DataError(f'example "{name}" is none of {", ".join(NAMES)}')
    return _EXAMPLES[name]()
