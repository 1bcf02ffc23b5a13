"""Bad input: a typed error that names the place, the value and the rule; the command exits 2."""

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
import soundfile as sf

import rtcal as rt
from rtcal.acoustics.changes import new_name
from rtcal.command import main as cli
from rtcal.loop import start
from rtcal.simulators.base import check_alpha
from rtcal.support.errors import DataError, InfeasibleError, ModelError, RtcalError
from tests.conftest import also, in_hall

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
    ("change", "place"),
    [
        ({"volume": 0}, "volume = 0 m³"),
        ({"volume": float("nan")}, "volume = nan m³"),
        ({"volume": "big"}, "volume = 'big'"),
        ({"materials": "wall"}, "materials"),
        ({"materials": []}, "materials"),
        ({"materials": ["wall", "wall"]}, "wall"),
        ({"areas": [80.0]}, "areas has shape"),
        ({"areas": [80.0, 0.0]}, r'areas\["carpet"\] = 0 m²'),
        ({"alpha": [[0.1, 0.1]]}, r"alpha has shape \(1, 2\)"),
        ({"alpha": [[0.1, 0.1], [0.3, 1.2]]}, r'alpha\["carpet", 1000 Hz\] = 1.2'),
        ({"alpha": [[0.1, float("nan")], [0.3, 1]]}, r'alpha\["wall", 1000 Hz\] = nan'),
        ({"sigma": [[0.1, 0.1], [0.3, -1]]}, r'sigma\["carpet", 1000 Hz\] = -1'),
        ({"centre_frequencies": [1000, 500]}, "500 Hz after 1000 Hz"),
        ({"centre_frequencies": []}, "centre_frequencies"),
        ({"alpha_min": [[0.1, 0.1], [0.3, 2]]}, r'alpha_min\["carpet", 1000 Hz\]'),
        ({"areas": {"wal": 80, "carpet": 20}}, "keys wal, carpet; they must be wall, carpet"),
        ({"alpha": SimpleNamespace(to_numpy=list)}, "alpha is a table with labels"),
    ],
)
def test_room(change, place):
    with pytest.raises(DataError, match=place):
        rt.Room(**{**GOOD, **change})


def test_a_mapping_in_another_order_is_put_in_the_room_s():
    plain = rt.Room(**GOOD)
    alpha = {"carpet": GOOD["alpha"][1], "wall": GOOD["alpha"][0]}
    labelled = rt.Room(**{**GOOD, "alpha": alpha, "areas": {"carpet": 20, "wall": 80}})
    np.testing.assert_array_equal(labelled.alpha, plain.alpha)
    np.testing.assert_array_equal(labelled.areas, plain.areas)
    np.testing.assert_array_equal(check_alpha(labelled, alpha), plain.alpha)


def test_an_unknown_method():
    with pytest.raises(ModelError, match="magic"):
        rt.calibrate(rt.Room(**GOOD), [0.5, 0.5], method="magic")


@pytest.mark.parametrize(
    ("t", "message"),
    [
        ([1.0], r"measured T has shape \(1,\); it must be \(2,\)"),
        ([1.0, 0.0], r"T\[1000 Hz\] = 0 s must be finite and above 0"),
        ([1.0, -2.0], r"T\[1000 Hz\] = -2 s"),
        ([1.0, float("inf")], r"T\[1000 Hz\] = inf s"),
        ([float("nan"), float("nan")], "missing in every band"),
        (["long", 1.0], "measured must be a list of T in s"),
    ],
)
def test_times(t, message):
    with pytest.raises(DataError, match=message):
        rt.calibrate(rt.Room(**GOOD), t)


@pytest.mark.parametrize("call", [rt.calibrate, rt.find, rt.calibrate_modes])
def test_exchanged_arguments_are_named(call):
    room, measured = rt.datasets.bras_cr2()
    with pytest.raises(DataError, match=r"must be an rtcal.Room, not an rtcal.Measurement"):
        call(measured, room)
    with pytest.raises(DataError, match=r"'room.toml' must be an rtcal.Room"):
        call("room.toml", measured)


def test_t_beyond_reach_says_by_how_much_and_which_would_do():
    room = rt.Room(**GOOD, air=rt.Air())
    message = r"T\[1000 Hz\] = 90 s cannot .* 37.48 s.*-0.251 m²; the bounds allow 0 to 100 m²"
    with pytest.raises(InfeasibleError, match=message):
        rt.calibrate(room, [0.5, 90.0])
    with pytest.raises(InfeasibleError, match=r"T\[1000 Hz\] = 90 s is too long"):
        rt.Eyring().absorption_area(room, np.array([0.5, 90.0]))
    # Both bands are named at once.
    with pytest.raises(InfeasibleError, match=r"T\[500 Hz\].*T\[1000 Hz\]"):
        rt.calibrate(room, [1e-4, 90.0])
    bounded = rt.Calibration(
        rt.terms.PriorDeviation(), [rt.terms.ExactMatch(), rt.terms.Bounds(0.1, 1)]
    ).build(room)
    with pytest.raises(InfeasibleError, match=r"the bounds allow 10 to 100 m²"):
        bounded.solve([0.5, 3.0])


def test_sigma_zero_outside_its_bounds():
    room = rt.Room(**{**GOOD, "sigma": [[0.0, 0.05], [0.1, 0.1]]})
    tight = rt.Calibration(rt.terms.PriorDeviation(), [rt.terms.Bounds(0.2, 1, material="wall")])
    with pytest.raises(DataError, match=r'alpha\["wall", 500 Hz\] = 0.1, bounds 0.2 to 1'):
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
def run(tmp_path, monkeypatch, capsys):
    """Run the command in an empty folder, in this process."""
    monkeypatch.chdir(tmp_path)

    def call(room, times, *more):
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
    (None, TIMES, "room.toml: no such file or folder"),
    (ROOM, None, "t.csv: no such file or folder"),
    (ROOM.replace("volume = 100\n", ""), TIMES, 'room.toml: the file lacks the key "volume"'),
    (ROOM, TIMES.replace("0.9", "abc"), 't.csv, line 2: value = "abc" must be a number'),
    (ROOM, TIMES.replace("500", "63").replace("1000", "125"), "have no band in common"),
    (ROOM, TIMES.replace("T20", "EDT"), "EDT but no T20 or T30 in any band of the room"),
    (ROOM, TIMES.replace("0.8", "90"), "T[1000 Hz] = 90 s cannot be reached"),
]


@pytest.mark.parametrize(("room", "times", "message"), BAD_FILES)
def test_command_exits_2_with_one_line(run, tmp_path, room, times, message):
    done = run(room, times, "--out", "made")
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    # Values that hardly any room has are told as they are read, whatever becomes of them.
    *warned, error = done.stderr.strip().splitlines()
    assert message in error
    assert all(line.startswith("rtcal: t.csv: ") for line in warned)
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "made").exists()


FILES = {  # every kind of file that commands read, by the word that stands for it in `TAKEN`
    "ROOM": ("room.toml", "a room"),
    "TABLE": ("t.csv", "a table of values"),
    "VARIANTS": ("variants.toml", "a file of variants"),
    "TREATMENTS": ("treatments.toml", "a file of treatments"),
    "CASE": ("case.json", "a case"),
    "RESULT": ("made/result.json", "a saved result"),
    "RESPONSE": ("s.flac", "a recording or impulse response"),
}


def stated():
    Path("one.toml").write_text(ROOM)
    Path("one.csv").write_text(TIMES)
    Path("variants.toml").write_text('[[variant]]\nname = "as it is"\n')
    Path("s.flac").write_bytes(b"fLaC\0\0\0\x22\xff\xfe")
    Path("treatments.toml").write_text(
        '[target]\ntime = 0.5\n[[treatment]]\nname = "rug"\nmaterial = "carpet"\ncovers = "wall"\n'
        "largest = 10\n"
    )


TAKEN = (
    "calibrate ROOM TABLE",
    "predict ROOM TABLE --change VARIANTS",
    "predict one.toml one.csv --also ROOM TABLE --change variants.toml",
    "design ROOM TABLE --treatments TREATMENTS",
    "find ROOM TABLE",
    "find CASE",
    "plan CASE",
    "apply RESULT --out x",
    "loop next ROOM TABLE --state loop.json --out next.toml",
    "export catt ROOM new.geo",
    "learn made --apply ROOM --out x",
    "measure RESPONSE",
    "import library TABLE --volume 100 --out new.toml",
)


@pytest.mark.parametrize("taken", [*TAKEN[::3], *also(*TAKEN[1::3], *TAKEN[2::3])])
def test_a_file_of_another_kind_is_called_so_by_every_command(taken, run, capsys):
    run(ROOM, TIMES, "--out", "made")
    stated()
    Path("case.json").write_text('{"configuration": []}')

    def said(arguments):
        with pytest.raises(SystemExit) as stopped:
            cli.main(arguments)
        assert stopped.value.code in (0, 2)
        return capsys.readouterr().err

    said(["loop", "start", "room.toml", "t.csv", "--state", "loop.json", "--out", "next.toml"])
    words = taken.split()
    names = [FILES[word][0] if word in FILES else word for word in words]
    for i, word in enumerate(words):
        needed = FILES.get(word)
        for other, (name, kind) in FILES.items():
            # A room of `find`: its table is missing.
            taken_as_well = {("plan", "RESULT"), ("find CASE", "ROOM")}
            if needed and other != word and not {(words[0], other), (taken, other)} & taken_as_well:
                told = said([*names[:i], name, *names[i + 1 :]])
                assert f"{name} is {kind}, but {needed[1]} is needed here" in told, (names, name)
    stands = [i for i, word in enumerate(words) if word in FILES]
    for i, k in itertools.combinations(stands, 2):
        exchanged = [*names]
        exchanged[i], exchanged[k] = names[k], names[i]
        advice = said(exchanged).partition("Exchange the two files: rtcal ")[2].strip()
        assert advice == " ".join(names)


@pytest.mark.parametrize("ending", ["wav", "rf64", "w64", "aiff", "flac", "ogg", "caf", "sofa"])
def test_a_sound_in_any_place_names_the_command_that_reads_it(ending, run, capsys):
    run(ROOM, TIMES)
    stated()
    sound = Path(f"s1.{ending}")
    if ending == "sofa":
        sound.write_bytes(b"\x89HDF\r\n\x1a\n")
    else:
        sf.write(sound, np.zeros(480), 48000, format="OGG" if ending == "ogg" else ending.upper())
    with sound.open("ab") as stream:
        stream.truncate(2**26)  # more than any table or room may have
    in_pairs = itertools.product(
        ("calibrate", "find", "fit"), ((sound, "t.csv"), ("room.toml", sound))
    )
    for command, arguments in (*in_pairs, ("table", (sound,))):
        with pytest.raises(SystemExit):
            cli.main([command, *map(str, arguments)])
        assert f"`rtcal measure {sound}` makes a table" in capsys.readouterr().err


def test_terms_that_set_contradicting_bounds_are_named():
    floor = rt.Room(**GOOD, alpha_min=[[0.05, 0.05], [0.1, 0.1]])
    tight = rt.terms.Bounds(0, 0.04, material="wall")
    loose = rt.terms.Bounds(0, 0.9)
    problem = rt.Calibration(rt.terms.PriorDeviation(), [loose, tight]).build(floor)
    with pytest.raises(DataError) as error:
        problem.solve([0.5, 0.5])
    rule, _, names = str(error.value).partition(". The bounds come from ")
    assert rule.endswith("bounds 0.05 to 0.04: the lower bound is above the upper one")
    assert names == f"the room's alpha_min and {tight!r}"


@pytest.mark.parametrize(
    ("form", "arguments", "place"),
    [
        ("scaling", ([0.0, 0.0], [1, 1], 1.0), "S'mu = 0"),
        ("scaling", ([0.1, 0.1], [1, 1, 1], 1.0), "areas"),
        ("least_squares", ([0.1], [0], 1.0), "areas has 0 m²"),
        ("least_squares", ([np.nan], [1], 1.0), "mu"),
        ("least_squares", ([0.1], [1], np.nan), "target"),
        ("maximum_likelihood", ([0.1], [0.0], [1], 1.0), "sigma"),
        ("maximum_likelihood", ([0.1], [-1], [1], 1.0), "sigma has -1"),
        ("maximum_likelihood", ([0.1], [1, 1], [1], 1.0), "sigma has shape"),
        ("multiplier", ([0.1], [0.0], [1], 1.0), "sigma"),
        ("multiplier", ([0.1], [1, 1], [1], 1.0), "sigma"),
    ],
)
def test_closed_forms_refuse_what_they_cannot_meet(form, arguments, place):
    with pytest.raises(DataError, match=place):
        getattr(rt.exact, form)(*arguments)


# A law: names that the eye does not tell apart are refused, of materials, sources and receivers

LOOKS = {
    "upper case": "wall1",
    "a blank after it": "Wall1 ",
    "a blank within it": "Wall 1",
    "a full width": "\uff37all1",
    "no width": "Wall\u200b1",
    "a blank without a break": "Wall\u00a01",
}


@pytest.mark.parametrize("name", LOOKS.values(), ids=LOOKS)
class TestBeside:
    def test_a_material(self, name):
        with pytest.raises(DataError, match=r"materials has .* differ only in"):
            rt.Room(name="box", volume=60, materials=["Wall1", name], areas=[20, 74],
                    alpha=[[0.4], [0.6]], sigma=[[0.1], [0.1]], centre_frequencies=[1000])  # fmt: skip

    @pytest.mark.parametrize("kind", ["source", "receiver"])
    def test_a_place(self, kind, name):
        pairs = [("Wall1", "R"), (name, "R")] if kind == "source" else [("S", "Wall1"), ("S", name)]
        with pytest.raises(DataError, match=rf"pairs has the {kind} .* differ only in"):
            rt.Measurement(centre_frequencies=[500], values={"t20": np.ones((2, 1))}, pairs=pairs)

    def test_a_new_name(self, name):
        assert new_name([name], "Wall1") == "Wall1 (2)"


# A law: a constructor names an argument of another kind, and no function takes it in silence


@pytest.mark.parametrize(
    "wrong", [{"method": np.ones(3)}, {"rule": np.ones(3)}, {"tolerance": [None]}], ids=str
)
def test_of_a_loop(wrong):
    room, measured = rt.datasets.bras_cr2()
    with pytest.raises(RtcalError, match=next(iter(wrong))):
        start(room, measured, **wrong)


ARRAYS = (np.ones(3), np.array([]), np.array(["a", "b"]))


@pytest.mark.parametrize("array", ARRAYS, ids=str)
@pytest.mark.parametrize("option", ["solver", "unreachable", "warm_start", "settings"])
def test_an_array_in_place_of_an_option(option, array):
    with pytest.raises(RtcalError, match=option):
        rt.calibrate(*rt.datasets.bras_cr2(), **{option: array})


def test_arguments_of_a_program():
    room, _ = rt.datasets.bras_cr2()
    with pytest.raises(RtcalError, match="arguments has"):
        rt.simulators.command(np.ones((2, 2)), room)


def test_a_flag_of_a_tracer():
    hall = rt.datasets.halls.corridor()
    tracer = in_hall(hall, n_paths=160)
    tracer.observe(hall.room.alpha, ("edt",))
    with pytest.raises(RtcalError, match="again"):
        tracer.observe(hall.room.alpha, ("edt",), again=np.ones(3))


CHANGES = (
    {"open": "ceiling", "area": 2},
    {"cover": "ceiling", "by": "floor", "area": 2},
    {"add": "floor", "area": 2},
    {"remove": "floor", "area": 2},
    {"volume": 180},
    {"air": rt.Air()},
)


@pytest.mark.parametrize(
    ("stated", "field"),
    [(stated, field) for stated in CHANGES for field in stated],
    ids=lambda x: x if isinstance(x, str) else next(iter(x)),
)
def test_a_field_of_a_change(stated, field):
    for wrong in (np.array([1, 2]), (x for x in [2]), True, [2.0]):
        with pytest.raises(RtcalError, match=f"^change: {field} = "):
            rt.prediction.Change(**stated | {field: wrong})
