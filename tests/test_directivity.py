"""Sources that are not omnidirectional: the lobe, room files, and the paths that it weighs."""

import re

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.room import Directivity
from rtcal.datasets import halls
from rtcal.io import balloon, geometry_files
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.errors import DataError

HALL = halls.lecture_hall()
SOURCE, RECEIVER = HALL.sources["S1"], next(iter(HALL.receivers))
TO_RECEIVER = tuple(np.subtract(HALL.receivers[RECEIVER], SOURCE))


def tracer(**options):
    settings = {
        "n_paths": 4000,
        "geometry": HALL.geometry,
        "room": HALL.room,
        "sources": {"S1": SOURCE},
        "receivers": HALL.receivers,
    }
    return PathTracing(**(settings | options))


def speaker(index, aim=TO_RECEIVER):
    return {"S1": Directivity(index=index, aim=aim)}


def test_the_index_is_the_level_on_the_axis():
    on_axis = Directivity(index=[3, 8], aim=(0, 0, 2)).gain([[0, 0, 5]])
    assert 10 * np.log10(on_axis[0]) == pytest.approx([3, 8])


def test_an_index_of_zero_changes_nothing():
    plain = tracer().simulate(HALL.room.alpha, seed=1)
    stated = tracer(directivity=speaker(0.0)).simulate(HALL.room.alpha, seed=1)
    for parameter, values in plain.values.items():
        assert np.array_equal(values, stated.values[parameter])


def test_sound_that_no_wall_reflects_has_the_gain_of_its_direction():
    alpha = np.full_like(HALL.room.alpha, 0.999999)
    index = np.arange(1.0, HALL.room.n_bands + 1)
    plain = tracer().energy(alpha, 0.1, seed=1).mean(axis=0)[0, 0, :, 0]
    towards = tracer(directivity=speaker(index)).energy(alpha, 0.1, seed=1)
    away = tracer(directivity=speaker(index, np.negative(TO_RECEIVER)))
    ratio = towards.mean(axis=0)[0, 0, :, 0] / plain
    assert 10 * np.log10(ratio) == pytest.approx(index, abs=1e-4)
    assert away.energy(alpha, 0.1, seed=1).mean(axis=0)[0, 0, :, 0].max() < 1e-3 * plain.min()


def test_derivatives_are_those_of_the_aimed_source():
    aimed = tracer(directivity=speaker([2.0, 3, 4, 5, 6, 7, 8]), n_paths=1600)
    alpha, step = np.full_like(HALL.room.alpha, 0.3), 1e-4
    more = alpha.copy()
    more[0] += step
    jacobian = aimed.jacobian(alpha, ["level"], seed=1)[0, :, :, 0]
    change = (
        aimed.observe(more, ["level"], seed=1).values
        - aimed.observe(alpha, ["level"], seed=1).values
    )
    assert change[0] / step == pytest.approx(jacobian, rel=1e-2, abs=1e-3)


def test_where_the_directivity_is_unknown_reverberation_times_alone_count():
    unknown = tracer(directivity={"S1": "unknown"})
    assert unknown.trusted(["t20", "edt", "c80", "ts", "level"]) == ("t20",)
    assert tracer().trusted(["edt", "c80"]) == ("edt", "c80")
    with pytest.raises(
        DataError,
        match="depends on the directivity of a source, and that directivity is given as unknown",
    ):
        unknown.trusted(["edt", "sti"])


def box(directivity=(), **scene):
    stated = {
        name: Directivity(**of) if isinstance(of, dict) else of
        for name, of in dict(directivity).items()
    }
    return rt.Room(
        name="box", volume=60, dimensions=(4, 5, 3), materials=["plaster"], areas=[94],
        alpha=[[0.1, 0.2]], sigma=[[0.02, 0.02]], centre_frequencies=[500, 1000],
        scattering=[[0.3, 0.3]],
        scene=rt.Scene(
            sources={"S1": (1, 1, 1.5), "S 2": (2, 1, 1)}, receivers={"R1": (3, 4, 1.2)},
            directivity=stated, **scene
        ),
    )  # fmt: skip


def test_a_room_file_keeps_it_and_the_simulator_takes_it(tmp_path):
    stated = {"S1": Directivity(index=[3, 7.5], aim=(1, 1, 0)), "S 2": "unknown"}
    room = box(directivity=stated)
    room.save(tmp_path / "room.toml")
    again = rt.Room.from_file(tmp_path / "room.toml")
    assert again.scene.directivity == stated
    assert rt.Room.from_dict(room.to_dict()).scene.directivity == stated
    made = geometry_files.path_tracing(again, n_paths=160)
    assert made.directivity["S1"] == stated["S1"]
    # "unknown" is taken as omnidirectional
    one = geometry_files.path_tracing(box(directivity={"S1": stated["S1"]}), n_paths=160)
    alpha = room.alpha
    assert np.array_equal(made.energy(alpha, 0.1), one.energy(alpha, 0.1))


def of_lobe(index, n_theta=37, n_phi=72, **how):
    """The balloon of a lobe, with more to its left than to its right, and above than below."""
    theta = np.linspace(0, np.pi, n_theta)[:, None]
    phi = np.arange(n_phi) * 2 * np.pi / n_phi
    power = 10 ** (np.atleast_1d(index)[:, None, None] / 10)
    lobe = ((1 + np.cos(theta)) / 2) ** (power - 1) + 0 * phi
    uneven = 1 + np.sin(theta) ** 2 * (0.3 * np.sin(phi) + 0.2 * np.cos(phi))
    return Directivity(gains=lobe * uneven, **({"aim": TO_RECEIVER} | how))


def test_the_mean_over_all_directions_is_one():
    directions = np.random.default_rng(0).standard_normal((200_000, 3))
    lobe = Directivity(index=[0, 3, 8], aim=(1, 2, -1))
    balloon = of_lobe([0, 3, 8], aim=(1, 2, -1), up=(1, 0, 3))
    for made in (lobe, balloon):
        assert made.gain(directions).mean(axis=0) == pytest.approx([1, 1, 1], abs=0.02)


def test_above_and_left_of_the_axis_are_where_they_are_stated():
    made = of_lobe([3], aim=(2, 0, 0), up=(1, 0, 5))
    above, left, right, below = made.gain([[0, 0, 1], [0, 1, 0], [0, -1, 0], [0, 0, -1]])[:, 0]
    assert left / right == pytest.approx(1.3 / 0.7, rel=0.01)
    assert above / below == pytest.approx(1.2 / 0.8, rel=0.01)
    assert made.gain([[1, 0, 0]]).max() > left


def test_a_lobe_s_balloon_weighs_the_paths_as_the_lobe():
    index = np.arange(1.0, HALL.room.n_bands + 1)
    theta = np.linspace(0, np.pi, 73)[:, None]
    power = 10 ** (index[:, None, None] / 10)
    gains = ((1 + np.cos(theta)) / 2) ** (power - 1) + np.zeros((1, 1, 8))
    two = [
        tracer(directivity={"S1": of}, n_paths=1600).energy(HALL.room.alpha, 0.2, seed=1)
        for of in (Directivity(gains=gains, aim=TO_RECEIVER), speaker(index)["S1"])
    ]
    assert two[0].sum(-1) == pytest.approx(two[1].sum(-1), rel=0.01)


def clf(path, rows, head="<CLF1>", band="1000", **tags):
    lines = [head, "<VERSION>\t1", *(f"<{k.replace('_', '-')}>\t<{v}>" for k, v in tags.items())]
    table = ["\t".join(f"{level:.3f}" for level in row) for row in rows]
    path.write_text("\n".join([*lines, f"<BAND>\t{band}", *table, "<CLF1END>"]), encoding="utf-8")
    return path


def levels(step):
    """Levels of the balloon `of_lobe(6)` by CLF: arcs from the top to the right, (n_phi, n_theta)."""
    gains = of_lobe([6], n_theta=180 // step + 1, n_phi=360 // step).gains[0].copy()
    gains[-1] = gains[-2].min() / 4  # a lobe is 0 behind
    level = 10 * np.log10(gains.T)
    return np.concatenate([level[:1], level[:0:-1]])


DIRECTIONS = np.array([[1, 0, 0], [1, 1, 0.0], [1, -1, 0], [1, 0, 1], [1, 0, -1], [-1, 0.1, 0]])


@pytest.mark.parametrize(("head", "step"), [("<CLF1>", 10), ("<CIF2>", 5)])
def test_clf_s_text_has_the_top_first_and_then_the_right(tmp_path, head, step):
    read = balloon.read(clf(tmp_path / "a.tab", levels(step), head), [1000], aim=(1, 0, 0))
    right = of_lobe([6], aim=(1, 0, 0)).gain(DIRECTIONS)
    assert read.gain(DIRECTIONS) == pytest.approx(right, rel=0.05, abs=0.02)
    again = clf(tmp_path / "b.tab", levels(step), head, BALLOON_ARC_ORDER="reversed")
    mirrored = balloon.read(again, [1000], aim=(1, 0, 0))
    assert mirrored.gain(DIRECTIONS * [1, -1, 1]) == pytest.approx(read.gain(DIRECTIONS))


@pytest.mark.parametrize(
    ("symmetry", "arcs"), [("rotational", 1), ("full", 10), ("horizontal", 19)]
)
def test_clf_s_symmetries_are_mirrored(tmp_path, symmetry, arcs):
    phi = np.arange(36) * np.pi / 18
    up = {"rotational": 0 * phi, "full": np.cos(2 * phi), "horizontal": np.cos(phi)}[symmetry]
    rows = -np.arange(19) + np.sin(np.arange(19) * np.pi / 18) * up[:, None]
    whole = balloon.read(clf(tmp_path / "a.tab", rows), [1000], aim=(1, 0, 0))
    part = clf(tmp_path / "b.tab", rows[:arcs], BALLOON_SYMMETRY=symmetry)
    assert balloon.read(part, [1000], aim=(1, 0, 0)).gains == pytest.approx(whole.gains, rel=1e-3)


def test_a_room_file_names_a_balloon_and_the_simulator_reads_it(tmp_path):
    (tmp_path / "room").mkdir()
    rows = levels(10)
    text = clf(tmp_path / "a.tab", rows).read_text().replace("<CLF1END>", "<BAND>\t500\n")
    text += "\n".join("\t".join(["0"] * 19) for _ in rows)
    (tmp_path / "room" / "a.tab").write_text(text)
    file = tmp_path / "room" / "a.tab"
    room = box(directivity={"S1": {"file": file, "aim": (1, 0, 0), "up": (0, 1, 0)}})
    room.save(tmp_path / "room" / "room.toml")
    again = rt.Room.from_file(tmp_path / "room" / "room.toml")
    made = geometry_files.path_tracing(again, n_paths=160).directivity["S1"]
    assert made.gain(DIRECTIONS)[:, 0] == pytest.approx(1)  # 500 Hz
    assert made.gain([[1, 0, 0]])[0, 1] > 3
    assert made.up == (0, 1, 0)
    again.save(tmp_path / "other.toml")
    assert 'file = "room/a.tab"' in (tmp_path / "other.toml").read_text()
    (tmp_path / "room" / "a.tab").unlink()
    with pytest.raises(rt.errors.RtcalError, match=r"a\.tab"):
        geometry_files.path_tracing(again, n_paths=160)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("<CLF1>", "<CLF3>"), "begins with '<CLF3>'; CLF text must begin with <CLF1> or <CLF2>"),
        (("<CLF1>", "<CF1>\0"), "CF1, CF2 and GLL cannot be read"),
        (("<VERSION>\t1", "<RADIATION>\t<halfsphere>"), "<RADIATION> is 'halfsphere'"),
        (("<VERSION>\t1", "<BALLOON-SYMMETRY>\t<vertical>"), "<BALLOON-SYMMETRY> is 'vertical'"),
        (("<VERSION>\t1", "<BALLOON-SYMMETRY>\t<full>"), "36 arcs, but with the symmetry full"),
        (
            ("<BAND>\t1000", "<BAND>\t2000"),
            "no band in the octave of 1000 Hz; its bands are 2000 Hz",
        ),
        (("-3.000", "<nodata>"), '"<nodata>" must be a finite number'),
        (("-3.000", "-3000"), "-3000 must be from -300 to 300"),
        (("-3.000\t", ""), "this arc has 18 levels, but must have 19, one every 10 degrees"),
        (("\n0.000", "\n-2.0"), "the arcs differ by 2.0 dB on the axis, where they must be equal"),
        (("\n0.000", "\n-90"), "the source does not radiate along the file's axis"),
    ],
)
def test_clf_s_text_that_says_too_little_is_refused(tmp_path, change, said):
    path = clf(tmp_path / "a.tab", [0.0 - np.arange(19)] * 36)
    once = -1 if change[1] == "\n-90" else 1
    path.write_text(path.read_text().replace(*change, once))
    with pytest.raises(DataError) as error:
        balloon.read(path, [1000], aim=(1, 0, 0))
    assert said in str(error.value)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (lambda: Directivity(index=-1, aim=(1, 0, 0)), "index[0] = -1 dB"),
        (lambda: Directivity(index=[], aim=(1, 0, 0)), "index"),
        (lambda: Directivity(index=3, aim=(0, 0, 0)), "aim"),
        (
            lambda: Directivity(aim=(1, 0, 0)),
            "exactly one of index, gains and file; this one has none",
        ),
        (lambda: Directivity(gains=[[[1]]], aim=(1, 0, 0)), "gains has shape"),
        (lambda: Directivity(gains=-np.ones((1, 7, 4)), aim=(1, 0, 0)), "gains[0, 0, 0] = -1"),
        (lambda: Directivity(gains=np.zeros((1, 7, 4)), aim=(1, 0, 0)), "gains[0]"),
        (lambda: Directivity(gains=np.ones((1, 7, 4)), aim=(0, 0, -1)), "up = "),
        (lambda: tracer(directivity={"S1": of_lobe([3, 4])}), 'directivity["S1"].gains'),
        (lambda: box(directivity={"S3": "unknown"}), 'directivity["S3"]'),
    ],
)
def test_bad_input_names_the_place(make, place):
    with pytest.raises(DataError, match=re.escape(place)):
        make()
