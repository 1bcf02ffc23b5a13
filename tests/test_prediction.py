"""Predicting a change: laws of the estimate, of the interval and of what it is made of."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.states import Rooms, estimated_change
from rtcal.prediction import (
    Add,
    Assumptions,
    Climate,
    Cover,
    NewVolume,
    Open,
    Remove,
    State,
    Variant,
    changed,
    compare,
    predict,
    read_variants,
)
from rtcal.support.errors import DataError, ModelError

BANDS = [500.0, 1000.0]
PANEL = rt.Material("panel", [0.8, 0.9], [0.1, 0.1])


def a_room(alpha=((0.2, 0.25), (0.1, 0.12)), sigma=0.04, **more) -> rt.Room:
    return rt.Room(
        name="box",
        volume=100,
        materials=["wall", "floor"],
        areas=[100, 30],
        alpha=alpha,
        sigma=np.full((2, 2), sigma),
        centre_frequencies=BANDS,
        **more,
    )


def measured(room: rt.Room, factor: float = 1.1, u: float = 0.02) -> State:
    t = factor * rt.Eyring().reverberation_time(room)
    return State(room, t, u * t)


@pytest.mark.parametrize("state", [0, 1])
def test_the_gradient_is_that_of_ln_t(state: int) -> None:
    room = a_room(air=rt.Air(20, 50))
    rooms = Rooms([room, changed(room, Add(PANEL, 10))], rt.Eyring(), Assumptions())
    x = rooms.prior[0] + 0.01
    value, gradient = rooms.log_time(state, x)
    for i in range(rooms.size):
        step = np.zeros(rooms.size)
        step[i] = 1e-6
        slope = (rooms.log_time(state, x + step)[0] - rooms.log_time(state, x - step)[0]) / 2e-6
        assert gradient[:, i] == pytest.approx(slope, rel=1e-6, abs=1e-9)
    assert np.exp(rooms.log_time(0, rooms.prior[0])[0]) == pytest.approx(
        rt.Eyring().reverberation_time(room)
    )
    assert np.isfinite(value).all()


def negative_log_posterior(rooms: Rooms, states: list[State], x: np.ndarray, k: int) -> float:
    mean, covariance = rooms.prior
    off = x - mean[k]
    out = off @ np.linalg.solve(covariance[k], off)
    whole = np.tile(x, (len(mean), 1))
    for c, state in enumerate(states):
        residual = np.log(state.reverberation_time[k]) - rooms.log_time(c, whole)[0][k]
        u = state.uncertainty[k] / state.reverberation_time[k]
        out += residual**2 / (u**2 + rooms.assumptions.own**2)
    return float(out)


@pytest.mark.parametrize("factor", [1.1, 2.0, 0.4])
def test_the_estimate_is_the_mode_within_the_bounds(factor: float) -> None:
    stated = {"air": rt.Air(20, 50), "climate_sigma": (2.0, 10.0)}
    room = a_room(((0.2, 0.25), (0.01, 0.01)), 0.2, **stated)
    states = [measured(room, factor), measured(changed(room, Add(PANEL, 10)), factor * 0.95)]
    rooms = Rooms([s.room for s in states], rt.Eyring(), Assumptions())
    found = estimated_change(rooms, states)
    rng = np.random.default_rng(3)
    for k in range(2):
        best = negative_log_posterior(rooms, states, found.mode[k], k)
        for size in (1e-3, 1e-2, 0.1):
            for _ in range(200):
                other = found.mode[k] + size * rng.standard_normal(rooms.size)
                other[:3] = np.clip(other[:3], 0, 1)
                assert negative_log_posterior(rooms, states, other, k) >= best - 1e-9
    assert (found.mode[:, :3] >= 0).all()
    if factor == 2.0:
        assert (found.mode[:, :3] == 0).any()  # the bounds were needed


def test_parts_add_up_to_the_variance_and_the_largest_is_first() -> None:
    state = measured(a_room())
    prediction = predict([state], Cover("wall", PANEL, 20))
    assert sum(prediction.parts.values()) == pytest.approx(np.ones(2), abs=1e-12)
    means = [part.mean() for part in prediction.parts.values()]
    assert means == sorted(means, reverse=True)
    assert all((part >= 0).all() for part in prediction.parts.values())


def test_a_part_that_is_known_is_no_part() -> None:
    exact = rt.Material("panel", PANEL.alpha, [0.0, 0.0])
    sure = Assumptions(volume=0, areas=0, common=0, own=0)
    prediction = predict([measured(a_room(sigma=0.0), u=0.0)], Add(exact, 5), assumptions=sure)
    assert prediction.linear_sigma == pytest.approx(np.zeros(2), abs=1e-9)
    after = predict([measured(a_room())], Add(exact, 5))
    assert after.parts['alpha of "panel"'] == pytest.approx(np.zeros(2))


def test_nothing_changed_nothing_predicted_but_what_was_measured() -> None:
    """With a sure measurement and no error of the equation's own, T stays as measured."""
    state = measured(a_room(), 1.3, 1e-6)
    sure = Assumptions(own=1e-6)
    prediction = predict([state], [], assumptions=sure)
    assert prediction.mean == pytest.approx(state.reverberation_time, rel=1e-4)
    assert (prediction.half_width < 0.01).all()


def test_a_second_state_narrows_and_corrects() -> None:
    """The panel's alpha is 0.5 in truth, not 0.85: one state cannot tell, two can."""
    room = a_room()
    truth = rt.Material("panel", [0.5, 0.5], [0.1, 0.1])
    first = measured(room, 1.0, 0.01)
    second_room = changed(room, Cover("wall", PANEL, 15))
    t = rt.Eyring().reverberation_time(changed(room, Cover("wall", truth, 15)))
    second = State(second_room, t, 0.01 * t)
    target = rt.Eyring().reverberation_time(changed(room, Cover("wall", truth, 40)))
    one = predict([first], Cover("wall", PANEL, 40))
    two = predict([first, second], Cover("wall", PANEL, 40))
    assert (two.half_width < 0.85 * one.half_width).all()
    error = [np.abs(np.log(p.mean / target)) for p in (one, two)]
    assert (error[1] < 0.6 * error[0]).all()
    joint = rt.calibrate(
        rt.Configurations([room, second_room], ["bare", "some panels"]),
        [first.reverberation_time, t],
        method="joint",
    )
    assert len(joint.results[0].predict(Cover("wall", PANEL, 40)).states) == 2


def test_calibrating_says_where_it_gains_and_where_not() -> None:
    unsure = rt.Material("panel", [0.5, 0.5], [0.25, 0.25])
    state = measured(a_room(), u=0.01)
    gains = str(predict([state], Climate(rt.Air(25, 50))))
    none = str(predict([state], Cover("wall", unsure, 90)))
    assert "it tells of what" in gains
    assert "which the calibration does not know" in " ".join(none.split())
    assert 'measure alpha of "panel"' in " ".join(none.split())


def test_a_sampled_band_agrees_with_a_sum_over_a_grid() -> None:
    """One material, alpha near 0 and nothing else unknown: its truncated normal is summed by hand."""
    room = rt.Room(
        name="box",
        volume=100,
        materials=["all"],
        areas=[130],
        alpha=[[0.05]],
        sigma=[[0.05]],
        centre_frequencies=[1000],
        air=rt.Air(20, 50),
    )
    sure = Assumptions(volume=0, areas=0, common=0, own=0.02)
    prediction = predict([], [], before=room, assumptions=sure)
    assert prediction.sampled.all()
    alpha = np.linspace(0, 1, 20001)
    weight = np.exp(-(((alpha - 0.05) / 0.05) ** 2) / 2)
    times = rt.Eyring().time(room, 130 * alpha[:-1, np.newaxis])[:, 0]
    weight = weight[:-1] / weight[:-1].sum()
    assert prediction.log_mean[0] == pytest.approx(weight @ np.log(times), abs=0.02)
    order = np.argsort(times)
    ends = np.interp([0.05, 0.95], np.cumsum(weight[order]), np.log(times[order]))
    assert np.log(prediction.interval).ravel() == pytest.approx(ends, abs=0.05)
    inside = (times > 1.0) & (times < 2.0)
    assert prediction.probability(1.0, 2.0)[0] == pytest.approx(weight[inside].sum(), abs=0.03)


def test_probability_agrees_with_the_interval_and_falls_over_all_bands() -> None:
    prediction = predict([measured(a_room())], Cover("wall", PANEL, 20))
    low, high = prediction.interval
    assert prediction.probability(low, high) == pytest.approx([0.9, 0.9], abs=0.01)
    every = prediction.probability_together(low, high)
    assert 0.81 < every < 0.9
    assert prediction.probability(np.nan, high) == pytest.approx([0.95, 0.95], abs=0.01)


def test_changes_keep_the_books() -> None:
    room = a_room()
    total = room.total_area
    assert changed(room, Cover("wall", PANEL, 20)).total_area == total
    assert changed(room, Cover("wall", PANEL)).materials == ("floor", "panel")
    assert changed(room, Add(PANEL, 7)).total_area == total + 7
    assert changed(room, [Add(PANEL, 7), Remove("panel")]).total_area == total
    assert changed(room, NewVolume(120)).volume == 120
    opened = changed(room, Open("wall", 3))
    assert opened.alpha[-1].tolist() == [1, 1]
    assert opened.sigma[-1].tolist() == [0, 0]
    assert changed(room, Cover("wall", "floor", 10)).areas.tolist() == [90, 40]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (Cover("wal", PANEL), '"wal" is no material'),
        (Cover("wall", PANEL, 120), 'cover 120 m² of "wall" by "panel": .* more than the 100 m²'),
        ([Cover("wall", PANEL, 60), Open("wall", 50)], 'open 50 m² of "wall": .* the 40 m²'),
        (Add(rt.Material("panel", [0.8], [0.1]), 3), "2 bands"),
        (Add(rt.Material("wall", [0.8, 0.8], [0.1, 0.1]), 3), "not that of the room's"),
        (Cover("wall", PANEL, -1), "area = -1"),
        (Add(PANEL, 1301), 'add 1301 m² of "panel": area = 1301 m² is more than 1300 m²'),
        (Cover("floor", "ceiling", 1), '"ceiling" is no material'),
    ],
)
def test_changes_that_do_not_fit_are_refused(change, said: str) -> None:
    with pytest.raises(DataError, match=said):
        changed(a_room(), change)


def test_states_that_do_not_fit_are_refused() -> None:
    room = a_room()
    with pytest.raises(DataError, match="one prior"):
        predict([measured(room), measured(a_room(sigma=0.05))], [])
    with pytest.raises(DataError, match="finite and above 0"):
        State(room, [0.0, 1.0])
    with pytest.raises(DataError, match="no room before"):
        predict([], Cover("wall", PANEL))
    with pytest.raises(ModelError, match="gives no T"):
        predict([measured(room)], [Open("wall"), Open("floor")])
    with pytest.raises(DataError, match=r"own = 2"):
        Assumptions(own=2)


def test_no_measured_t_counts_twice() -> None:
    room = a_room()
    state = measured(room)
    t = state.reverberation_time
    again = State(a_room(), t.round(5))
    with pytest.raises(DataError, match='"box": two states have the same areas and the same meas'):
        predict([state, again], [])
    predict([state, State(room, 1.01 * t)], [])  # another measurement of the same state
    calibrated = rt.calibrate(room, t).room
    with pytest.raises(DataError, match='"box" was already calibrated on these data'):
        predict([State(calibrated, t)], [])
    predict([State(calibrated, 1.01 * t)], [])


def test_variants_have_names_of_their_own() -> None:
    with pytest.raises(DataError, match='"one" twice'):
        compare([measured(a_room())], [Variant("one", ()), Variant("one", (Open("wall", 1.0),))])


def test_a_missing_t_leaves_the_stated_coefficients() -> None:
    room = a_room()
    state = measured(room)
    missing = State(room, [np.nan, state.reverberation_time[1]], state.uncertainty)
    prediction = predict([missing], Cover("wall", PANEL, 20))
    stated = predict([], Cover("wall", PANEL, 20), before=room)
    both = predict([state], Cover("wall", PANEL, 20))
    assert prediction.log_mean[0] == pytest.approx(stated.log_mean[0])
    assert prediction.log_mean[1] == pytest.approx(both.log_mean[1])
    assert prediction.half_width[0] == pytest.approx(stated.half_width[0])


def test_a_prediction_is_saved_and_read_back(tmp_path: Path) -> None:
    room, t = rt.datasets.bras_cr2()
    prediction = rt.calibrate(room, t).predict(Open("windows", 2.0), name="open")
    prediction.save(tmp_path)
    again = rt.load(tmp_path)
    assert str(again) == str(prediction)
    assert (again.mean == prediction.mean).all()


VARIANTS = """
[[material]]
name = "panel"
alpha = [0.2, 0.6, 0.9, 0.9, 0.9, 0.9]
sigma = 0.1

[[variant]]
name = "panels"
[[variant.change]]
cover = "ceiling"
by = "panel"
area = 20
[[variant.change]]
air = {temperature = 24, humidity = 50}
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("cover", "covers", "covers"),
        ("area = 20", "area = 2000", "more than"),
        ('by = "panel"', "", "lacks by"),
        (
            'by = "panel"',
            'by = "panl"',
            r'by = "panl" is no material; the room has .*file has panel',
        ),
        (
            "[[variant]]",
            '[[variant]]\nname = "panels"\nchange = []\n[[variant]]',
            "twice; each has a name of its own",
        ),
        ("[[variant]]", "[[variants]]", "variants"),
        ("air = {temperature = 24, humidity = 50}", "air = {temperature = 24}\nby = 3", "by"),
        ("air = {temperature = 24, humidity = 50}", 'open = "x"\nair = {}', "2 of"),
    ],
)
def test_a_file_of_variants_that_breaks_a_rule_is_refused(old: str, new: str, said: str) -> None:
    room, _ = rt.datasets.bras_cr2()
    assert old in VARIANTS
    with pytest.raises(DataError, match=said):
        for variant in read_variants(VARIANTS.replace(old, new), room):
            changed(room, variant.changes)


def test_the_command_predicts_and_writes(tmp_path: Path) -> None:
    for name, content in rt.datasets.examples.example("room").files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "variants.toml").write_text(VARIANTS, encoding="utf-8")
    command = [sys.executable, "-m", "rtcal", "predict", "room.toml", "t.csv"]
    options = ["--change", "variants.toml", "--out", "after", "--json"]
    run = subprocess.run(
        [*command, *options], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    (variant,) = json.loads(run.stdout)["variants"]
    low, high = variant["interval_90"]
    assert all(a < t < b for a, t, b in zip(low, variant["reverberation_time"], high, strict=True))
    assert rt.load(tmp_path / "after").predictions[0].name == "panels"


def test_material_correlation_counts() -> None:
    room = a_room()
    alike = room.replace(material_correlation={("wall", "floor"): 0.9})
    apart, together = (predict([], [], before=r) for r in (room, alike))
    assert (together.linear_sigma > apart.linear_sigma).all()
    assert sum(together.parts.values()) == pytest.approx(np.ones(2), abs=1e-12)


def test_the_floor_of_sigma_holds_for_what_changes_alone() -> None:
    room = a_room(sigma=0.01)
    state = measured(room)
    rooms = Rooms([room, changed(room, Cover("wall", PANEL, 5))], rt.Eyring(), Assumptions())
    assert rooms.sigma[0] == pytest.approx([0.1, 0.1])
    assert rooms.sigma[1] == pytest.approx([0.01, 0.01])
    stated = replace(Assumptions(), changed=0.0)
    narrow = predict([state], Cover("wall", PANEL, 5), assumptions=stated)
    wide = predict([state], Cover("wall", PANEL, 5))
    assert (narrow.linear_sigma < wide.linear_sigma).all()


def test_what_a_room_states_of_its_volume_counts_in_every_way_to_predict_and_design():
    room, measured = rt.datasets.bras_cr2()
    vague = room.replace(volume_sigma=0.2)
    panel = rt.Material("panel", [0.2, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)
    change = rt.prediction.Cover("ceiling", panel, 20)
    result = rt.calibrate(vague, measured)
    stated = result.predict(change).half_width
    alone = rt.prediction.predict(result.states, change)
    assert alone.half_width == pytest.approx(stated, rel=1e-9)
    usual = rt.calibrate(room, measured).predict(change).half_width
    assert (stated > 1.02 * usual).all()
    # What the room states takes the place of any assumption.
    assumed = rt.prediction.Assumptions(volume=0.0)
    other = rt.prediction.predict(result.states, change, assumptions=assumed).half_width
    assert other == pytest.approx(stated, rel=1e-9)
