"""Files to start from: one small project per kind of user, as ``rtcal example`` writes them."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.io import wavfile

from rtcal.acoustics.air import Air
from rtcal.acoustics.room import Room
from rtcal.acoustics.scene import Scene
from rtcal.datasets import halls
from rtcal.datasets.shipped import path
from rtcal.io import obj
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError

__all__ = ["NAMES", "Example", "example"]
__dir__ = __all__.copy


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
high = [0.85, 0.75, 0.7, 0.7, 0.7, 0.7]

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
        {"room.obj": obj.text(box).encode(), **{name: _response(rng) for name in names}},
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
            "room.obj": obj.text(hall.geometry).encode(),
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


_PLAN = ((0.0, 0.0), (9.0, 0.0), (9.0, 4.0), (5.0, 4.0), (5.0, 8.0), (0.0, 8.0))
_HEIGHT = 3.2
_WALLS = ("south", "east", "step", "inner", "north", "west")
_BANDS = np.array([250.0, 500.0, 1000.0, 2000.0])
_STATED = {
    "parquet": (0.05, 0.06, 0.08, 0.08),
    "ceiling": (0.20, 0.25, 0.30, 0.30),
    "plaster": (0.08, 0.06, 0.05, 0.05),
    "glass": (0.15, 0.10, 0.06, 0.05),
}
_SOURCES = {"S1": (1.5, 1.3, 1.5), "S2": (7.8, 2.9, 1.5)}
_RECEIVERS = {
    "R1": (3.2, 2.2, 1.2),
    "R2": (6.2, 1.1, 1.2),
    "R3": (2.2, 4.4, 1.2),
    "R4": (3.9, 6.6, 1.2),
    "R5": (1.1, 6.9, 1.2),
    "R6": (8.0, 1.0, 1.2),
}


def _l_shape() -> Polyhedron:
    """Return the L-shaped room as its model states it."""
    faces = [("floor", "parquet", _level(0.0)), ("ceiling", "ceiling", _level(_HEIGHT))]
    for name, start, end in zip(_WALLS, _PLAN, (*_PLAN[1:], _PLAN[0]), strict=True):
        faces.append((name, "glass" if name == "east" else "plaster", _wall(start, end)))
    return Polyhedron.from_polygons(faces)


def _level(height: float) -> list[tuple[float, ...]]:
    return [(*corner, height) for corner in _PLAN]


def _wall(start: tuple[float, float], end: tuple[float, float]) -> list[tuple[float, ...]]:
    return [(*start, 0.0), (*end, 0.0), (*end, _HEIGHT), (*start, _HEIGHT)]


def _rehearsal_room(geometry: Polyhedron) -> Room:
    alpha = np.array([_STATED[name] for name in geometry.areas])
    return Room(
        name="rehearsal room",
        volume=geometry.volume,
        materials=list(geometry.areas),
        areas=np.array(list(geometry.areas.values())),
        alpha=alpha,
        sigma=np.maximum(0.2 * alpha, 0.01).round(4),
        centre_frequencies=_BANDS,
        air=Air(21, 45),
        scattering=np.full(alpha.shape, 0.4),
        scene=Scene(mesh="room.obj", sources=_SOURCES, receivers=_RECEIVERS),
    )


def _where() -> Example:
    """A room with a curtain that its model lacks: `tests/position_rooms/shipped.py` measures it."""
    geometry = _l_shape()
    return Example(
        {
            "room.toml": _rehearsal_room(geometry).to_text().encode(),
            "room.obj": obj.text(geometry).encode(),
            "pairs.csv": path("where_room/pairs.csv").read_bytes(),
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


@checked
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
