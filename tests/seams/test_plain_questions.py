"""Plain questions of a user who checks answers in his head, asked of commands and of files."""

import re

import numpy as np
import pytest

import rtcal as rt
from rtcal.datasets import examples
from rtcal.prediction import words
from rtcal.support.errors import DataError


def example(name, folder):
    for file, content in examples.example(name).files.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


MEANS = "source,receiver,parameter,band,value\n"


def test_a_column_that_may_be_the_position_is_asked_for(tmp_path, rtcal):
    path = tmp_path / "t.csv"
    path.write_text("wo;T20 500;T20 1000\nfoyer;1,62;1,41\nbar;1,60;1,40\n")
    said = rtcal.refused("table", path)
    found = re.search(r'--columns "([^"]*)"', said)
    assert found[1] == "from line 2 to 3: ?; T20 at 500 Hz; T20 at 1000 Hz"
    assert "given twice" not in said
    rtcal("table", path, "--columns", found[1].replace("?", "receiver"))


def test_bands_of_which_some_are_in_khz_are_refused(tmp_path, rtcal):
    folder = example("room", tmp_path)
    path = folder / "t.csv"
    path.write_text(re.sub(r"T30,(\d)000", r"T30,\1", path.read_text()))
    said = rtcal.refused("calibrate", folder / "room.toml", path)
    assert "1, 2 and 4 Hz and also 125, 250 and 500 Hz, so some are probably in kHz" in said
    rt.Measurement.from_values([4, 8, 16, 31.5, 63], t20=np.ones(5))  # each octave is there


def test_a_list_in_the_place_of_the_room_is_named(tmp_path, rtcal):
    room, hall = example("room", tmp_path) / "room.toml", example("program", tmp_path) / "hall.geo"
    said = rtcal.refused("export", "catt", hall, room)
    assert said.endswith(f"Exchange the two files: rtcal export catt {room} {hall}")


CHANGE = """
[[material]]
name = "carpet"
alpha = [0.1, 0.2, 0.3, 0.4]
sigma = 0.1

[[variant]]
name = "carpet"

[[variant.change]]
cover = "parquet"
by = "carpet"
area = 40
"""


def test_the_directions_of_a_mesh_are_those_of_every_command(tmp_path, rtcal):
    folder = example("where", tmp_path)
    room, change, t = folder / "room.toml", folder / "change.toml", folder / "t.csv"
    change.write_text(CHANGE)
    t.write_text(MEANS + "".join(f"*,*,T20,{f},1.0\n" for f in (250, 500, 1000, 2000)))
    assert "the absorption is uneven" in rtcal("calibrate", room, t, "--out", folder / "cal")
    from_file = rtcal("predict", room, t, "--change", change)
    assert "does not give the axes" not in from_file
    assert "the absorption is uneven" in from_file
    assert rtcal("predict", folder / "cal", "--change", change) == from_file
    stated = rtcal("predict", room, "--change", change)
    assert "does not give the axes" not in stated
    # So they are in Python.
    read, measured = rt.Room.from_file(room), rt.Measurement.from_file(t)
    found = rt.calibrate(read, measured)
    assert "the absorption is uneven" in " ".join(str(found).split())
    carpet = rt.Material("carpet", [0.1, 0.2, 0.3, 0.4], [0.1] * 4)
    put = rt.prediction.Change(cover="parquet", by=carpet, area=40)
    for known, said in ((found, from_file), (read, stated)):
        made = rt.prediction.predict(known, put, name="carpet")
        assert made.is_placed
        assert " ".join(str(made).split()) in said


def test_a_change_after_which_the_areas_do_not_fit_the_volume_is_doubted(cr2):
    found = rt.calibrate(*cr2)
    assert not found.predict([rt.prediction.Change(volume=160)]).doubts
    assert not found.predict([]).doubts
    made = found.predict([rt.prediction.Change(volume=1461)])
    assert [mark.kind for mark in made.doubts] == ["surface_typing_error"]


def test_a_response_that_is_given_twice_is_said(tmp_path, rtcal):
    folder = example("responses", tmp_path)
    one, other = folder / "S1_R1.wav", folder / "S1_R2.wav"
    out = folder / "t.csv"
    measured = ("measure", one, other, "--bands", "250,500,1000", "--out")
    assert "every value of" not in rtcal(*measured, out) + rtcal.warned
    assert "every value of" not in rtcal("table", out) + rtcal.warned
    other.write_bytes(one.read_bytes())
    again = folder / "twice.csv"
    twice = "every value of S1 to R2 equals that of S1 to R1"
    assert twice in rtcal(*measured, again) + rtcal.warned
    assert twice in rtcal("table", again) + rtcal.warned


def test_a_table_that_is_given_twice_is_refused(tmp_path, rtcal):
    folder = example("room", tmp_path)
    path = folder / "t.csv"
    said = rtcal.refused("table", path, folder / "." / "t.csv")
    assert "t.csv is given twice: give each table once" in said


def test_a_repeated_command_writes_the_same_bytes(tmp_path, rtcal):
    folder = example("change", tmp_path)
    room, t = folder / "room.toml", folder / "t.csv"
    commands = {
        "calibrate": (room, t),
        "predict": (room, t, "--change", folder / "variants.toml"),
        "design": (room, t, "--treatments", folder / "treatments.toml"),
    }
    for name, given in commands.items():
        written = []
        for time in ("first", "second"):
            out = folder / f"{name} {time}"
            rtcal(name, *given, "--out", out)
            every = [path for path in sorted(out.iterdir()) if path.name[0] != "."]
            written.append({path.name: path.read_bytes() for path in every})
        first, second = written
        assert first == second, name


def variants(*own):
    """A file of variants, each with its name and its changes."""
    return "\n".join(
        f'[[variant]]\nname = "{name}"\n'
        + "".join(f"[[variant.change]]\n{each}\n" for each in made)
        for name, made in own
    )


def test_air_that_the_room_lacks_is_no_change(cr2, tmp_path, rtcal):
    room, measured = cr2
    found, bare = rt.calibrate(*cr2), rt.calibrate(room.with_air(None), measured)
    warm = rt.prediction.Change(air=rt.Air(26, 60))
    same = found.predict(rt.prediction.Change(air=room.air))
    assert not same.half_width.any()
    with pytest.raises(DataError, match=r"no air before the change.*\[air\]"):
        bare.predict(warm)
    for known, other in ((bare, room), (found, room.with_air(None))):
        with pytest.raises(DataError, match="has no air, but"):
            rt.prediction.predict(known, other)
    folder = example("change", tmp_path)
    path, change = folder / "room.toml", folder / "own.toml"
    path.write_text(re.sub(r"\[air\][^\[]*", "", path.read_text()))
    change.write_text(variants(("air", ["air = {temperature = 26, humidity = 60}"])))
    said = rtcal.refused("predict", path, folder / "t.csv", "--change", change)
    assert 'variant "air"' in said


def test_a_sentence_of_several_variants_is_printed_once_and_the_next_step_last(tmp_path, rtcal):
    folder = example("change", tmp_path)
    change = folder / "own.toml"
    some = [(f"{volume} m³", [f"volume = {volume}"]) for volume in (150, 160)]
    change.write_text(variants(("as it is", []), *some))
    said = rtcal("predict", folder / "room.toml", folder / "t.csv", "--change", change)
    assert said.count(words.GIVEN) == 1
    assert f"150 m³, 160 m³: {words.GIVEN}" in said
    assert words.GIVEN in said[: said.index("Next")]


def test_a_room_calibrated_by_one_equation_has_its_t_by_that_alone(tmp_path, rtcal):
    folder = example("change", tmp_path)
    change = folder / "own.toml"
    change.write_text(variants(("as it is", [])))
    made = folder / "made"
    rtcal(
        "calibrate", folder / "room.toml", folder / "t.csv", "--equation", "sabine", "--out", made
    )
    said = rtcal.refused("predict", made / "room.toml", "--change", change)
    assert "was calibrated with the equation Sabine" in said
    rtcal("predict", made / "room.toml", "--change", change, "--equation", "sabine")
    said = rtcal.refused("predict", made, "--change", change, "--equation", "eyring")
    assert "has its own equation. Leave --equation out" in said
    rtcal("predict", made, "--change", change)


def test_a_design_says_what_its_probability_leaves_out_and_names_no_areas_in_vain(cr2):
    found = rt.calibrate(*cr2)
    t = found.reverberation_time_after
    tile = rt.Material("tile", [0.8] * 6, [0.05] * 6)
    tiles = rt.prediction.Treatment("tiles", tile, largest=30, cost=90, covers="ceiling")
    said = " ".join(
        str(rt.design(found, [tiles], rt.prediction.Target(0.99 * t, 1.01 * t))).split()
    )
    assert "Nothing is needed" in said
    assert "The measured T counts as exact" in said
    with pytest.raises(rt.errors.InfeasibleError) as error:
        rt.design(found, [tiles], rt.prediction.Target(1.3 * t, 1.5 * t))
    assert "T is already too short" in str(error.value)
    assert "cost" not in str(error.value)


def test_an_unbounded_t_is_no_number_and_least_squares_says_what_it_depends_on(cr2):
    room, measured = cr2
    bare = room.with_air(None)
    with pytest.raises(rt.errors.InfeasibleError, match=r"give T from 0\.\d+ s and longer\."):
        rt.calibrate(bare, np.full(6, 0.05), equation=rt.Sabine())
    divided = "a surface that is divided into two materials changes the result"
    for method in ("mle", "lse"):
        assert (divided in " ".join(str(rt.calibrate(room, measured, method)).split())) == (
            method == "lse"
        )


def test_a_prediction_shows_what_a_pocket_calculator_gives():
    """A1 = A0 + 10 m² of 0.7; T by Sabine is T before times A0 / A1."""
    surfaces = {"floor": 48, "ceiling": 48, "walls": 84}
    room = rt.Room(
        name="office",
        volume=144,
        materials=list(surfaces),
        areas=list(surfaces.values()),
        alpha=[[0.1]] * 3,
        sigma=[[0.03]] * 3,
        centre_frequencies=[1000],
    )
    found = rt.calibrate(room, [1.3], equation=rt.Sabine())
    before = rt.Sabine().room_constant(room) * 144 / 1.3
    panel = rt.Material("panel", [0.7], [0.05])
    made = found.predict(rt.prediction.Change(add=panel, area=10))
    row = next(row for row in made.rows if row.name == "Sabine's equation alone / s")
    assert row.values[0] == pytest.approx(1.3 * before / (before + 7), rel=1e-9)
    low, high = made.interval
    assert low[0] < row.values[0] < high[0]
    assert "alone / s" not in str(found.predict([]))


def test_two_states_of_one_room_with_two_t_are_doubted_before_a_prediction(cr2):
    room, measured = cr2
    t = rt.calibrate(room, measured).reverberation_time_after
    both = rt.Configurations([room, room], ["first", "second"])
    joint = rt.calibrate(both, [t, 2 * t], method="joint")
    again = rt.calibrate(both, [t, 1.02 * t], method="joint")
    for found, doubted in ((joint.results[0], True), (again.results[0], False)):
        for made in (str(found.predict([])), found.predict([]).doubts):
            assert ("in place of the measured" in str(made)) == doubted


def test_a_programs_change_needs_a_change_of_the_room(cr2):
    room, measured = cr2
    found = rt.calibrate(room, measured)
    t = found.reverberation_time_after
    before, half = (rt.Measurement.from_values(room.centre_frequencies, t20=x) for x in (t, t / 2))
    run = rt.Run(room, before)
    assert found.predict([], run=run, run_after=before).mean == pytest.approx(t)
    with pytest.raises(DataError, match="nothing of the room changes"):
        found.predict([], run=run, run_after=half)
