"""Bad input: a typed error that names the place, the value and the rule; the command exits 2."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.feasibility import Unreachable
from rtcal.command import main as cli
from rtcal.support.errors import DataError, InfeasibleError, MissingDependencyError, ModelError

GOOD = {
    "name": "r",
    "volume": 100.0,
    "materials": ["wall", "carpet"],
    "areas": [80.0, 20.0],
    "alpha": [[0.1, 0.1], [0.3, 0.5]],
    "sigma": [[0.05, 0.05], [0.1, 0.1]],
    "centre_frequencies": [500, 1000],
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"volume": 0}, "volume = 0 m³ is not finite and above 0"),
        ({"volume": float("nan")}, "volume = nan m³ is not finite"),
        ({"volume": "big"}, "volume = 'big' is not a number"),
        ({"materials": "wall"}, 'materials = "wall" is one text'),
        ({"materials": []}, "materials is empty"),
        ({"materials": ["wall", "wall"]}, 'materials has "wall" twice'),
        ({"areas": [80.0]}, r"areas has shape \(1,\); with 2 materials it must be \(2,\)"),
        ({"areas": [80.0, 0.0]}, r'areas\["carpet"\] = 0 m² is not an area above 0'),
        (
            {"areas": [80.0, 1e300]},
            r'areas\["carpet"\] = 1e\+300 m² is not an area .* at most 1e\+09',
        ),
        ({"volume": 1e300}, r"volume = 1e\+300 m³ is not from 1e-09 to 1e\+09 m³"),
        ({"volume": 1e-300}, r"volume = 1e-300 m³ is not from 1e-09 to 1e\+09 m³"),
        ({"areas": [80.0, -3.0]}, r'areas\["carpet"\] = -3 m²'),
        ({"areas": [80.0, float("nan")]}, r'areas\["carpet"\] = nan m²'),
        ({"alpha": [[0.1, 0.1]]}, r"alpha has shape \(1, 2\); it must be .* = \(2, 2\)"),
        (
            {"alpha": [[0.1, 0.1], [0.3, 1.2]]},
            r'alpha\["carpet", 1000 Hz\] = 1.2 is not in \[0, 1\]',
        ),
        ({"alpha": [[0.1, -0.1], [0.3, 1]]}, r'alpha\["wall", 1000 Hz\] = -0.1 is not in'),
        ({"alpha": [[0.1, float("nan")], [0.3, 1]]}, r'alpha\["wall", 1000 Hz\] = nan is not'),
        ({"alpha": [["a", 0.1], [0.3, 1]]}, "alpha is not an array of real numbers"),
        (
            {"alpha": [[0.1j, 0.1], [0.3, 1]]},
            "alpha is not an array of real numbers: it has complex",
        ),
        ({"areas": [True, 20.0]}, "areas is not an array of real numbers: it has true or false"),
        ({"alpha": np.ones((2, 2), dtype=bool)}, "alpha is not an array .* it has true or false"),
        ({"materials": ["wall", " "]}, "materials has ' '; a name is not blank"),
        ({"sigma": [[0.1, 0.1], [0.3, -1]]}, r'sigma\["carpet", 1000 Hz\] = -1 is not a finite'),
        ({"sigma": [[0.1, 0.1], [0.3, float("inf")]]}, r'sigma\["carpet", 1000 Hz\] = inf is not'),
        ({"centre_frequencies": [1000, 500]}, "500 Hz after 1000 Hz; bands must increase"),
        ({"centre_frequencies": [0, 500]}, "has 0 Hz; a centre frequency is finite and above 0"),
        ({"centre_frequencies": []}, "centre_frequencies is empty"),
        ({"dimensions": (5, 4)}, "dimensions has 2 values; a shoebox has 3"),
        ({"scattering": [[0.1, 0.1], [0.3, 1.2]]}, r'scattering\["carpet", 1000 Hz\] = 1.2'),
        ({"alpha_min": [[0.1, 0.1], [0.3, 2]]}, r'alpha_min\["carpet", 1000 Hz\] = 2 is not in'),
    ],
)
def test_room(change: dict, message: str) -> None:
    with pytest.raises(DataError, match=message):
        rt.Room(**{**GOOD, **change})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"temperature": 60}, "air.temperature = 60 °C is not from -20 to 50"),
        ({"humidity": 0}, "air.humidity = 0 % is not above 0"),
        ({"humidity": float("nan")}, "air.humidity = nan"),
        ({"pressure": 1013}, "air.pressure = 1013 kPa"),
    ],
)
def test_air(values: dict, message: str) -> None:
    with pytest.raises(DataError, match=message):
        rt.Air(**values)


@pytest.mark.parametrize(
    ("t", "message"),
    [
        ([1.0], r"measured T has shape \(1,\); the room asks for \(2,\)"),
        ([1.0, 0.0], r"T\[1000 Hz\] = 0 s is not finite and above 0"),
        ([1.0, -2.0], r"T\[1000 Hz\] = -2 s"),
        ([1.0, float("inf")], r"T\[1000 Hz\] = inf s"),
        ([float("nan"), float("nan")], "missing in every band"),
        (["long", 1.0], "measured is not a list of T in s"),
    ],
)
def test_times(t: list, message: str) -> None:
    with pytest.raises(DataError, match=message):
        rt.calibrate(rt.Room(**GOOD), t)


def test_unknown_names() -> None:
    room = rt.Room(**GOOD)
    with pytest.raises(ModelError, match='method "magic" is unknown; known are mle, lse'):
        rt.calibrate(room, [0.5, 0.5], method="magic")
    with pytest.raises(MissingDependencyError, match='solver "magic" is not installed'):
        rt.calibrate(room, [0.5, 0.5], solver="magic")
    with pytest.raises(MissingDependencyError, match='qpsolvers has no solver "magic"'):
        rt.calibrate(room, [0.5, 0.5], solver="qpsolvers:magic")
    with pytest.raises(DataError, match='"steel" is no material of room "r"; it has wall, carpet'):
        rt.Calibration(
            rt.terms.PriorDeviation(), [rt.terms.Bounds(0, 0.5, material="steel")]
        ).build(room).solve([0.5, 0.5])
    with pytest.raises(DataError, match="band 125 Hz is no band of the room; it has 500 Hz, 1000"):
        rt.Calibration(rt.terms.PriorDeviation(), [rt.terms.Bounds(0, 0.5, band=125)]).build(
            room
        ).solve([0.5, 0.5])


def test_t_beyond_reach_says_by_how_much_and_which_would_do() -> None:
    room = rt.Room(**GOOD, air=rt.Air())
    message = (
        r"T\[1000 Hz\] = 90 s is beyond reach: it asks the surfaces for -0.251 m², the bounds allow "
        r"0 to 100 m², 0.251 m² too little; T from .* to 37.48 s would do"
    )
    with pytest.raises(InfeasibleError, match=message):
        rt.calibrate(room, [0.5, 90.0])
    with pytest.raises(InfeasibleError, match="longer than the air alone allows in Eyring's"):
        rt.Eyring().absorption_area(room, np.array([0.5, 90.0]))
    # Both bands are named at once.
    with pytest.raises(InfeasibleError, match=r"T\[500 Hz\].*T\[1000 Hz\]"):
        rt.calibrate(room, [1e-4, 90.0])
    bounded = rt.Calibration(
        rt.terms.PriorDeviation(), [rt.terms.ExactMatch(), rt.terms.Bounds(0.1, 1)]
    ).build(room)
    with pytest.raises(InfeasibleError, match=r"the bounds allow 10 to 100 m²"):
        bounded.solve([0.5, 3.0])


def test_sigma_zero_outside_its_bounds() -> None:
    room = rt.Room(**{**GOOD, "sigma": [[0.0, 0.05], [0.1, 0.1]]})
    tight = rt.Calibration(rt.terms.PriorDeviation(), [rt.terms.Bounds(0.2, 1, material="wall")])
    with pytest.raises(
        DataError, match=r'alpha\["wall", 500 Hz\] = 0.1, bounds 0.2 to 1: sigma is 0'
    ):
        tight.build(room).solve([0.5, 0.5])


ROOM = """\
name = "r"
volume = 100
centre_frequencies = [500, 1000]
[air]
temperature = 20
humidity = 50
[[material]]
name = "wall"
area = 80
alpha = [0.1, 0.1]
sigma = 0.05
[[material]]
name = "carpet"
area = 20
alpha = [0.3, 0.5]
sigma = [0.1, 0.1]
"""
TIMES = "source,receiver,parameter,band,value\nS1,R1,T20,500,0.9\nS1,R1,T20,1000,0.8\n"


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def run(tmp_path: Path, monkeypatch, capsys) -> Callable[..., Done]:
    """Run the command in an empty folder, in this process."""
    monkeypatch.chdir(tmp_path)

    def call(room: str | bytes | None, times: str | bytes | None, *more: str) -> Done:
        for name, content in (("room.toml", room), ("t.csv", times)):
            if content is not None:
                raw = content if isinstance(content, bytes) else content.encode()
                (tmp_path / name).write_bytes(raw)
        with pytest.raises(SystemExit) as stopped:
            cli.main(["calibrate", "room.toml", "t.csv", *more])
        printed = capsys.readouterr()
        return Done(stopped.value.code, printed.out, printed.err)

    return call


BAD_FILES = [  # tests/test_native_files.py has what breaks a rule in a file
    (None, TIMES, "room.toml: No such file or directory"),
    (ROOM, None, "t.csv: No such file or directory"),
    (ROOM.replace("volume = 100\n", ""), TIMES, "room.toml: the file lacks volume"),
    (ROOM, TIMES.replace("0.9", "abc"), 't.csv, line 2: value = "abc" is not a number'),
    (ROOM, TIMES.replace("500", "63").replace("1000", "125"), "have no band in common"),
    (ROOM, TIMES.replace("T20", "EDT"), "has EDT, but no T20 and no T30 in any band of the room"),
    (ROOM, TIMES.replace("0.8", "90"), "T[1000 Hz] = 90 s is beyond reach"),
]


@pytest.mark.parametrize(("room", "times", "message"), BAD_FILES)
def test_command_exits_2_with_one_line(run, tmp_path: Path, room, times, message: str) -> None:
    done = run(room, times, "--out", "made")
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    # Values that hardly any room has are told as they are read, whatever becomes of them.
    lines = [s for s in done.stderr.strip().splitlines() if "hardly any room has" not in s]
    assert len(lines) == 1
    assert message in lines[0]
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "made").exists()


def test_command_writes_room_json_and_figure(run, tmp_path: Path) -> None:
    done = run(ROOM, TIMES, "--out", "made")
    assert done.returncode == 0, done.stderr
    assert sorted(
        p.name for p in (tmp_path / "made").iterdir() if not p.name.startswith(".rtcal_files")
    ) == [
        "result.json",
        "reverberation_time.png",
        "room.toml",
    ]
    assert (tmp_path / "made" / "reverberation_time.png").read_bytes()[:4] == b"\x89PNG"
    again = rt.Room.from_file(tmp_path / "made" / "room.toml")
    assert again.calibration.method == "mle"
    for shown in ("measured T / s", "gap after / JND", "(Q = ", "Certificate, of the"):
        assert shown in done.stdout


def test_command_says_where_it_cannot_write(run, tmp_path: Path) -> None:
    (tmp_path / "made").write_text("a file, not a folder")
    done = run(ROOM, TIMES, "--out", "made/deeper")
    assert done.returncode == 2
    assert "made/deeper: Not a directory" in done.stderr


def test_an_empty_value_is_missing(run) -> None:
    done = run(ROOM, TIMES.replace("0.8", ""))
    assert done.returncode == 0, done.stderr
    assert "1000 Hz: not calibrated, no T was measured" in done.stdout


def test_a_write_that_fails_leaves_nothing(tmp_path: Path, monkeypatch) -> None:
    from rtcal.support import files

    target = tmp_path / "room.toml"
    target.write_text("what was there before")

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(files.os, "replace", fail)
    with pytest.raises(DataError, match="cannot be written: disk full"):
        rt.Room(**GOOD).save(target)
    assert target.read_text() == "what was there before"
    assert [p.name for p in tmp_path.iterdir() if not p.name.startswith(".rtcal_files")] == [
        "room.toml"
    ]


def test_terms_that_set_contradicting_bounds_are_named() -> None:
    floor = rt.Room(**GOOD, alpha_min=[[0.05, 0.05], [0.1, 0.1]])
    tight = rt.terms.Bounds(0, 0.04, material="wall")
    loose = rt.terms.Bounds(0, 0.9)
    problem = rt.Calibration(rt.terms.PriorDeviation(), [loose, tight]).build(floor)
    with pytest.raises(DataError) as error:
        problem.solve([0.5, 0.5])
    rule, _, names = str(error.value).partition("; they come from ")
    assert rule.endswith("bounds 0.05 to 0.04: the bounds contradict each other")
    assert names == f"the room's alpha_min and {tight!r}"


def test_an_unreachable_band_is_told_by_what_it_asks_for() -> None:
    where = {"configuration": 0, "frequency": 500.0, "shortest": 0.2, "longest": 3.0}
    would_do = "the bounds allow 1 to 9 m²{}; T from 0.2 to 3 s would do"
    for t, target, asked, off in (
        (0.1, np.nan, "more absorption than any", ""),
        (0.1, 10.5, "10.5 m²", ", 1.5 m² too much"),
        (5, 0.75, "0.75 m²", ", 0.25 m² too little"),
    ):
        band = Unreachable(reverberation_time=t, target=target, lowest=1.0, highest=9.0, **where)
        assert str(band) == (
            f"T[500 Hz] = {t} s is beyond reach: it asks the surfaces for {asked}, "
            + would_do.format(off)
        )


def test_closed_forms_refuse_what_they_cannot_meet() -> None:
    closed = rt.exact
    for compute, message in (
        (lambda: closed.scaling([0.0, 0.0], [1, 1], 1.0), "S'mu = 0: scaling cannot reach any"),
        (lambda: closed.scaling([0.1, 0.1], [1, 1, 1], 1.0), r"mu \(2,\), areas \(3,\) and target"),
        (lambda: closed.least_squares([0.1], [0], 1.0), "areas has 0 m², which is not above 0"),
        (lambda: closed.least_squares([np.nan], [1], 1.0), "mu has a value that is not finite"),
        (lambda: closed.least_squares([0.1], [np.inf], 1.0), "areas has a value that is not"),
        (lambda: closed.least_squares([0.1], [1], np.nan), "target has a value that is not"),
        (lambda: closed.maximum_likelihood([0.1], [0.0], [1], 1.0), "all sigma of a band are 0"),
        (lambda: closed.maximum_likelihood([0.1], [-1], [1], 1.0), "sigma has -1, which is not 0"),
        (lambda: closed.maximum_likelihood([0.1], [1, 1], [1], 1.0), r"sigma has shape \(2,\); mu"),
        (lambda: closed.maximum_likelihood([0.1], [np.nan], [1], 1.0), "sigma has a value that"),
        (lambda: closed.multiplier([0.1], [0.0], [1], 1.0), "all sigma of a band are 0"),
        (
            lambda: closed.multiplier([0.1], [-1], [1], 1.0),
            r"sigma has not the shape \(1,\) of mu, or",
        ),
        (lambda: closed.multiplier([0.1], [1, 1], [1], 1.0), r"sigma has not the shape \(1,\)"),
    ):
        with pytest.raises(DataError, match=f"^{message}"):
            compute()


def test_a_solver_is_named_where_it_refuses_its_settings() -> None:
    room = rt.Room(**GOOD)
    for name in ("osqp", "scs"):
        with pytest.raises(
            ModelError, match=f'^solver "{name}" refuses the settings .*no_such=1: '
        ):
            rt.calibrate(room, [0.5, 0.5], solver=name, settings={"no_such": 1})
