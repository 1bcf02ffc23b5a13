"""Designing to a target: laws of the envelope, the program against brute force, what is refused."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rtcal as rt
from benchmarks.prediction import cheapest_of, random_design, witness
from rtcal.prediction import (
    Assumptions,
    Known,
    State,
    Target,
    Treatment,
    ansi_s12_60,
    changed,
    din_18041,
    read_treatments,
)
from rtcal.prediction.design_model import DesignModel
from rtcal.prediction.designed import Design, design
from rtcal.prediction.program import Ranges, program
from rtcal.support.errors import DataError, InfeasibleError

BANDS = [250.0, 500.0, 1000.0]
PANEL = rt.Material("panel", [0.5, 0.7, 0.8], [0.1] * 3)
BASS = rt.Material("bass", [0.6, 0.4, 0.2], [0.1] * 3)


def a_room() -> rt.Room:
    return rt.Room(
        name="classroom",
        volume=180,
        materials=["wall", "floor", "ceiling"],
        areas=[100, 60, 60],
        alpha=[[0.06, 0.05, 0.05], [0.05, 0.06, 0.08], [0.1, 0.08, 0.08]],
        sigma=np.full((3, 3), 0.02),
        centre_frequencies=BANDS,
        air=rt.Air(20, 50),
    )


def known(room: rt.Room | None = None) -> Known:
    room = room or a_room()
    t = 0.95 * rt.Eyring().reverberation_time(room)
    return Known((State(room, t, 0.03 * t),), room)


TREATMENTS = (
    Treatment("ceiling", PANEL, 55, cost=90, covers="ceiling"),
    Treatment("traps", BASS, 40, cost=60, covers="wall"),
)
TARGET = Target([0.4] * 3, [0.8] * 3)


def test_the_cheapest_is_not_beaten_by_a_grid_and_keeps_its_promise() -> None:
    found = design(known(), TREATMENTS, TARGET, 0.85)
    assert (found.probability >= 0.85 - 0.002).all()
    model, target = found.model, found.model.target
    cheapest = np.inf
    for x in itertools.product(np.arange(0, 55.1, 1.0), np.arange(0, 40.1, 1.0)):
        cost = 90 * x[0] + 60 * x[1]
        if cost < cheapest and (model.probability(np.array(x)) >= 0.83).all():
            exact = model.prediction(np.array(x)).probability(target.low, target.high)
            cheapest = cost if (exact >= 0.85).all() else cheapest
    assert found.cost <= 1.01 * cheapest
    assert found.cost >= 0.94 * cheapest  # the grid is 1 m²


@pytest.mark.parametrize("index", [2, 17])
def test_the_whole_posterior_keeps_the_promise_where_bounds_cut_it(index: int) -> None:
    """The program takes A as normal: a band of its own answer lacks up to 0.012."""
    model, p = random_design(index)
    alone = model.cheapest(p)
    assert alone is not None
    assert Design(model=model, promised=p, areas=alone).probability.min() < p - 0.002
    state = model.states[0]
    found = design(
        Known((state,), state.room),
        model.treatments,
        model.target,
        p,
        assumptions=model.assumptions,
    )
    assert p - 0.002 <= found.probability.min() <= p + 0.002


def test_the_model_has_the_whole_posteriors_sd() -> None:
    found = design(known(), TREATMENTS, TARGET, 0.85)
    mean, sigma = found.model.area(found.areas)
    q = found.model._slope(mean, found.areas)
    tau = found.model.ranges(found.areas).tau
    plain = ~found.prediction.sampled
    assert np.hypot(sigma / q, tau)[plain] == pytest.approx(
        found.prediction.linear_sigma[plain], rel=0.03
    )


def test_probability_agrees_with_counting() -> None:
    room = a_room()
    ranges = Ranges(room, rt.Eyring(), TARGET, np.array([0.1, 0, -0.1]), np.array([0.1, 0.05, 0.2]))
    mean, sigma = np.array([50.0, 45.0, 40.0]), np.array([5.0, 8.0, 2.0])
    rng = np.random.default_rng(1)
    area = mean + sigma * rng.standard_normal((400_000, 3))
    log_time = np.log(rt.Eyring().time(room, area)) + ranges.offset
    log_time += ranges.tau * rng.standard_normal(log_time.shape)
    counted = ((log_time > np.log(0.4)) & (log_time < np.log(0.8))).mean(axis=0)
    assert ranges.probability(mean, sigma) == pytest.approx(counted, abs=0.004)


@pytest.mark.parametrize("p", [0.8, 0.9, 0.95])
@pytest.mark.parametrize("high", [0.8, np.nan])
def test_a_tangent_touches_where_it_is_drawn_and_cuts_off_nothing(p: float, high: float) -> None:
    target = Target([0.4] * 3, [high] * 3)
    ranges = Ranges(a_room(), rt.Eyring(), target, np.zeros(3), np.array([0.06, 0.08, 0.1]))
    span = ranges.span(p, np.zeros(3), np.full(3, 220.0))
    assert span is not None
    means = span[0] + (span[1] - span[0]) * np.linspace(0.02, 0.98, 13)[:, np.newaxis]
    intercept, slope = ranges.tangents(p, means)
    touching = intercept + slope * means
    assert ranges.probability(means, touching) == pytest.approx(p, abs=1e-5)
    intercept, slope = ranges.tangents_above(p, means)
    elsewhere = intercept[:, np.newaxis] + slope[:, np.newaxis] * means  # (tangent, mean, band)
    assert (elsewhere.min(axis=0) >= touching - 1e-9).all()
    assert (elsewhere.min(axis=0) <= 1.05 * touching).all()
    assert (ranges.probability(means, 1.05 * touching) < p).all()


@pytest.mark.parametrize("index", [3, 8, 17, 24])
def test_no_fine_grid_is_cheaper_by_one_percent(index: int) -> None:
    """Chords cut off what stands near the ends of a range: designs cost up to 2.7 % more."""
    model, p = random_design(index)
    cost, largest = (
        np.array([getattr(t, n) for t in model.treatments]) for n in ("cost", "largest")
    )
    x = model.cheapest(p)
    shares = np.array(list(itertools.product(np.linspace(0, 1, 61), repeat=2)))
    best = cheapest_of(model, p, shares * largest, cost)
    assert (x is None) == (best is None)
    if x is not None and best is not None:
        assert cost @ x <= 1.005 * cost @ best
        assert witness(model, x[np.newaxis]).min() >= p - 0.002


def test_the_program_is_compiled_once_for_its_shape() -> None:
    design(known(), TREATMENTS, TARGET)
    before = program.cache_info().misses
    dearer = tuple(replace(t, cost=2 * t.cost + 1) for t in TREATMENTS)
    again = design(known(), dearer, Target([0.4] * 3, [0.85] * 3), 0.9)
    assert program.cache_info().misses == before
    assert again.cost > 0


def test_whole_panels_are_whole_and_cost_least() -> None:
    whole = (replace(TREATMENTS[0], unit=2.5), replace(TREATMENTS[1], unit=4.0))
    found = design(known(), whole, TARGET, 0.85)
    counts = found.areas / [2.5, 4.0]
    assert counts == pytest.approx(np.round(counts))
    free = design(known(), TREATMENTS, TARGET, 0.85)
    assert found.cost >= free.cost - 1e-6
    assert (found.model.probability(found.areas) >= 0.85 - 0.002).all()
    cheapest = min(
        90 * x[0] + 60 * x[1]
        for x in itertools.product(np.arange(23) * 2.5, np.arange(11) * 4.0)
        if (found.model.probability(np.array(x)) >= 0.85 + 1e-4).all()
    )
    assert found.cost <= cheapest + 1e-6


def test_free_standing_treatments_add_surface() -> None:
    baffles = Treatment("baffles", PANEL, 80, cost=50)
    found = design(known(), [baffles], TARGET, 0.8)
    assert found.prediction.after.total_area == pytest.approx(220 + found.areas[0])
    assert (found.probability >= 0.79).all()


def test_what_can_be_had_is_said_where_nothing_will_do() -> None:
    with pytest.raises(InfeasibleError, match="wider by") as error:
        design(known(), TREATMENTS, Target([0.50] * 3, [0.56] * 3))
    said = str(error.value)
    assert "equation's error alone allows" in said
    assert "Best probability of each band alone" in said
    assert "To narrow the interval" in said
    small = tuple(replace(t, largest=3.0) for t in TREATMENTS)
    with pytest.raises(InfeasibleError, match="some band stays almost surely out of its range"):
        design(known(), small, TARGET)


def test_two_treatments_share_the_surface_they_cover() -> None:
    both = (
        Treatment("cheap", PANEL, 50, cost=10, covers="ceiling"),
        Treatment("good", BASS, 50, cost=20, covers="ceiling"),
    )
    found = design(known(), both, Target([0.3] * 3, [0.95] * 3))
    assert found.areas.sum() <= 60 * (1 + 1e-6)
    changed(a_room(), [t.change(a) for t, a in zip(both, found.areas, strict=True) if a > 0])


def test_a_measured_second_state_makes_the_design_cheaper() -> None:
    room = a_room()
    one = known(room)
    some = changed(room, TREATMENTS[0].change(20.0))
    t = 0.95 * rt.Eyring().reverberation_time(some)
    two = Known((*one.states, State(some, t, 0.03 * t)), room)
    target = Target([0.4] * 3, [0.78] * 3)
    dear, cheap = (design(k, TREATMENTS, target, 0.85) for k in (one, two))
    assert cheap.cost < 0.98 * dear.cost


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: design(known(), TREATMENTS, TARGET, 0.7), "0.7 is not from 0.8 to 0.99"),
        (lambda: design(known(), [], TARGET), "at least one"),
        (lambda: design(known(), [TREATMENTS[0]] * 2, TARGET), "twice"),
        (lambda: design(known(), TREATMENTS, Target([0.4], [0.8])), "1 bands"),
        (lambda: Treatment("x", PANEL, 4, cost=1, unit=5), "more than largest"),
        (lambda: Treatment("x", PANEL, 4, cost=-1), "cost = -1"),
        (lambda: Target([0.8], [0.4]), "not below"),
        (lambda: Target([np.nan], [np.nan]), "no band has a range"),
        (lambda: Target([0.4], [100.5]), "high = 100.5 s is above 100 s"),
        (
            lambda: design(known(), [Treatment("x", PANEL, 2201, cost=1)], TARGET),
            'treatment "x": largest = 2201 m² is more than 2200 m²',
        ),
        (lambda: din_18041("A3", 6000, BANDS), "from 30 to 5000"),
        (lambda: din_18041("B1", 100, BANDS), "not one of A1"),
        (lambda: ansi_s12_60(600, BANDS), "above 566"),
        (
            lambda: design(known(), [Treatment("x", PANEL, 4, cost=1, covers="roof")], TARGET),
            '"roof" is no material',
        ),
    ],
)
def test_what_breaks_a_rule_is_refused(make, said: str) -> None:
    with pytest.raises(DataError, match=said):
        make()


def test_standards_give_their_numbers() -> None:
    """Classroom of 180 m³: 0.32 lg 180 - 0.17 = 0.552 s, by hand."""
    target = din_18041("A3", 180, [125, 250, 1000, 4000, 8000])
    assert target.low[:4] == pytest.approx(0.5517 * np.array([0.65, 0.8, 0.8, 0.65]), abs=1e-3)
    assert target.high[:4] == pytest.approx(0.5517 * np.array([1.45, 1.2, 1.2, 1.2]), abs=1e-3)
    assert np.isnan(target.low[4])
    assert np.isnan(din_18041("A5", 2000, [125, 500]).low).tolist() == [True, False]


TREATMENT_FILE = """
[target]
high = [0.9, 0.9, 0.9, 0.9, 0.9, 0.9]

[[material]]
name = "panel"
alpha = [0.5, 0.6, 0.9, 0.9, 0.9, 0.9]
sigma = 0.1

[[treatment]]
name = "panels"
material = "panel"
covers = "ceiling"
largest = 45
cost = 90
unit = 1.44
"""


@pytest.mark.long
def test_the_command_designs_and_its_result_is_read_back(tmp_path: Path) -> None:
    for name, content in rt.datasets.examples.example("room").files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "treatments.toml").write_text(TREATMENT_FILE, encoding="utf-8")
    command = [sys.executable, "-m", "rtcal", "design", "room.toml", "t.csv"]
    options = ["--treatments", "treatments.toml", "--out", "found", "--json"]
    run = subprocess.run(
        [*command, *options], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    record = json.loads(run.stdout)
    assert min(record["probability"]) >= 0.79
    again = rt.load(tmp_path / "found")
    assert again.cost == record["cost"]
    refused = subprocess.run(
        [*command, *options, "--probability", "0.5"], cwd=tmp_path, capture_output=True, text=True
    )
    assert refused.returncode == 2
    assert "0.5 is not from 0.8" in refused.stderr


def test_the_answer_does_not_depend_on_the_order_of_treatments() -> None:
    first = design(known(), TREATMENTS, TARGET, 0.85)
    turned = design(known(), TREATMENTS[::-1], TARGET, 0.85)
    assert turned.areas[::-1] == pytest.approx(first.areas, abs=0.3)
    assert turned.cost == pytest.approx(first.cost, rel=2e-3)


def test_without_any_error_the_range_is_met_at_its_edge() -> None:
    """With nothing unknown the cheapest areas put T at the upper end of the range."""
    room = a_room().replace(sigma=np.zeros((3, 3)))
    sure = Assumptions(volume=0, areas=0, common=0, own=0.001, changed=0)
    panel = rt.Material("panel", [0.5, 0.7, 0.8], [0.0] * 3)
    only = Treatment("ceiling", panel, 58, cost=90, covers="ceiling")
    model = DesignModel((), room, (only,), TARGET, rt.Eyring(), sure)
    x = model.cheapest(0.8)
    assert x is not None
    times = rt.Eyring().reverberation_time(model.prediction(x).after)
    assert times.max() == pytest.approx(0.8, rel=0.005)


TREATMENTS_FILE = """
[target]
TARGET
[[material]]
name = "panel"
alpha = [0.5, 0.7, 0.8]
sigma = 0.1
[[treatment]]
name = "panels"
material = "panel"
covers = "ceiling"
largest = 40
cost = 90
"""


@pytest.mark.parametrize(
    ("target", "old", "new", "said"),
    [
        ('standard = "DIN 18041"\ngroup = "A3"\nhigh = 0.6', "", "", "and high are both stated"),
        ('standard = "ANSI S12.60"\ngroup = "A3"', "", "", "ANSI S12.60 has no group"),
        ('group = "A3"\nhigh = 0.6', "", "", "without a standard"),
        ("high = 600", "", "", "above 100 s"),
        (
            "high = 0.6",
            'material = "panel"',
            'material = "panl"',
            'material = "panl" is no material; the room has wall, floor, ceiling; the file has panel',
        ),
    ],
)
def test_nothing_that_a_file_states_is_lost(target: str, old: str, new: str, said: str) -> None:
    content = TREATMENTS_FILE.replace("TARGET", target).replace(old, new)
    with pytest.raises(DataError, match=said):
        read_treatments(content, a_room())


def test_a_range_is_widened_to_100_s_at_most() -> None:
    assert Target([50.0], [90.0]).widened(2).high == 100


def test_a_room_that_was_calibrated_on_the_data_is_not_designed_with_them() -> None:
    room = a_room()
    t = 1.1 * rt.Eyring().reverberation_time(room)
    calibrated = rt.calibrate(room, t).room
    with pytest.raises(DataError, match='"classroom" was already calibrated on these data'):
        design(Known((State(calibrated, t),), calibrated), TREATMENTS, TARGET)


def a_seminar_room() -> tuple[rt.CalibrationResult, Treatment, Target]:
    """CR2 with one panel and a largest T alone: the mean of A has no upper end."""
    result = rt.calibrate(*rt.datasets.bras_cr2())
    panel = rt.Material("P", [0.4, 0.6, 0.8, 0.9, 0.9, 0.9], [0.1] * 6)
    target = Target([np.nan] * 6, [1.2, 1.2, 1.1, 1.1, 1.1, 1.1])
    return result, Treatment("a", panel, 40, 90, covers="ceiling"), target


@pytest.mark.parametrize("p", [0.8, 0.9])
def test_a_largest_t_alone_is_met_at_the_least_area_that_keeps_the_promise(p: float) -> None:
    result, panel, target = a_seminar_room()
    found = rt.design(result, [panel], target, p)
    assert p - 0.002 <= found.probability.min() <= p + 0.002
    less = found.model.prediction(0.99 * found.areas)
    assert less.probability(target.low, target.high).min() < p


def test_treatments_that_are_not_used_change_nothing() -> None:
    result, panel, target = a_seminar_room()
    alone = rt.design(result, [panel], target)
    material = panel.material
    dear = [Treatment(s, material, 9, 1e5, covers=s) for s in ("floor", "concrete", "windows")]
    among = rt.design(result, [panel, *dear], target)
    assert among.areas == pytest.approx([alone.areas[0], 0, 0, 0], rel=2e-3)


def test_what_all_areas_reach_is_found() -> None:
    """The program that is linear without a treatment has no answer; another one has."""
    result, panel, target = a_seminar_room()
    traps = rt.Material("traps", [0.6, 0.5, 0.3, 0.2, 0.2, 0.2], [0.1] * 6)
    both = [panel, Treatment("traps", traps, 20, 120, covers="concrete")]
    strict = Target(target.low, [0.85, 0.75, 0.7, 0.7, 0.7, 0.7])
    model = rt.design(result, both, strict).model
    every = model.prediction(np.array([40.0, 20.0])).probability(strict.low, strict.high)
    assert every.min() > 0.95
    assert model.cheapest(0.95) is not None


BOARD = rt.Material("board", [0.4] * 6, [0.1] * 6)


@pytest.mark.parametrize(
    ("treatment", "rule"),
    [
        ({"largest": 60, "unit": 52}, 'largest = 60 m² is more than the 51.62 m² of "ceiling"'),
        ({"largest": 1e300}, "is more than the 51.62 m²"),
        ({"largest": 40, "unit": 0.01}, "allows more than 500 panels"),
        ({"largest": 40, "cost": 1e308}, 'treatment "a": cost = 1e\\+308 is not from 0 to 1e\\+09'),
    ],
)
def test_a_treatment_that_cannot_be_is_refused(treatment: dict[str, float], rule: str) -> None:
    result, _, target = a_seminar_room()
    with pytest.raises(DataError, match=rule):
        rt.design(
            result, [Treatment("a", BOARD, **{"cost": 9, **treatment}, covers="ceiling")], target
        )


def test_a_room_is_no_result() -> None:
    result, panel, target = a_seminar_room()
    with pytest.raises(DataError, match="is not a calibration's result"):
        rt.design(result.room, [panel], target)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("low", "high", "rule"),
    [
        ([1.0] * 6, [0.5] * 6, "low = 1 s is not below high = 0.5 s"),
        (-1.0, 2.0, "low = -1 s is not finite and above 0"),
        ([1.0] * 6, [2.0] * 5, "high has shape"),
    ],
)
def test_a_range_that_is_none_has_no_probability(low: object, high: object, rule: str) -> None:
    predicted = a_seminar_room()[0].predict(rt.prediction.Cover("ceiling", BOARD, 20))
    with pytest.raises(DataError, match=rule):
        predicted.probability(low, high)  # type: ignore[arg-type]


def test_a_volume_that_no_room_of_these_surfaces_has_is_refused() -> None:
    with pytest.raises(DataError, match="volume = 1e-09 m³ is not from"):
        a_seminar_room()[0].predict(rt.prediction.NewVolume(1e-9))


def test_a_material_of_the_catalogue_states_no_alpha() -> None:
    room, _ = rt.datasets.bras_cr2()
    text = '[[material]]\nname = "c"\ncatalogue = "carpet_cotton"\nsigma = 0.4\n[[variant]]\n'
    with pytest.raises(DataError, match=r"\[\[material\]\] 1: catalogue and sigma are both stated"):
        rt.prediction.read_variants(text, room, rt.datasets.catalogue.material)


def test_a_program_that_has_hardly_an_answer_is_decided(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Clarabel makes no progress, another solver says whether there is one."""
    import cvxpy as cp

    solved = cp.Problem.solve

    def fails(self: cp.Problem, *args: Any, solver: str, **settings: Any) -> Any:
        if solver == cp.CLARABEL:
            raise cp.error.SolverError("Solver 'CLARABEL' failed.")
        return solved(self, *args, solver=solver, **settings)

    expected = design(known(), TREATMENTS, TARGET)
    monkeypatch.setattr(cp.Problem, "solve", fails)
    found = design(known(), TREATMENTS, TARGET)
    assert found.cost == pytest.approx(expected.cost, rel=1e-3)


def test_rounding_draws_the_same_samples() -> None:
    """A covariance that is another in its last digits, as on another processor, changes no sample."""
    from rtcal.support.sampler import samples_of_normal

    rng = np.random.default_rng(4)
    n = 9
    factor = rng.standard_normal((n, 4))
    covariance = 0.01 * np.eye(n) + factor @ factor.T  # five eigenvalues are one: any basis will do
    bounds = np.full(n, -1.0), np.full(n, 5.0)
    other = covariance * (1 + 1e-12 * rng.standard_normal((n, n)))
    a, b = (
        samples_of_normal(np.ones(n), (c + c.T) / 2, bounds, np.ones(n), 400, 0)
        for c in (covariance, other)
    )
    np.testing.assert_allclose(a, b, atol=1e-6)
