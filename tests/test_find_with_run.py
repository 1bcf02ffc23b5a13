"""Laws of a search in which a program's run stands in place of the equation."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import Case, Configuration, recalibrate, verify
from rtcal.finder.apply import DRAWN_LARGER
from rtcal.finder.claim import Reason
from rtcal.finder.effects import IN_RUN, AppliedEffect, Opening
from rtcal.finder.means import engines
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import features_of, observe
from rtcal.finder.means.recalibration import plain
from rtcal.finder.verification import residual_map
from rtcal.report import of_finding
from rtcal.report.finding_words import without_measuring
from rtcal.report.verification_words import sentence
from rtcal.support.blocks import lines as lines_of
from rtcal.support.errors import DataError
from tests.conftest import also, measurement_of

F = 125.0 * 2.0 ** np.arange(6)
FEWER = ("membrane", "resonator", "curtain", "people", "audience", "covered surface")
"""Effects that the laws do without: a search is quicker."""
MATERIALS = ("audience", "walls", "ceiling")


def hall():
    alpha = np.array([[0.4, 0.55, 0.7, 0.8, 0.85, 0.85], [0.05] * 6, [0.04] * 6])
    return rt.Room(
        name="hall", volume=4000, materials=MATERIALS, areas=[350, 900, 450], alpha=alpha,
        sigma=0.2 * alpha, centre_frequencies=F, air=rt.Air(20, 50), band_correlation=0.7,
    )  # fmt: skip


def natural(features):
    """Return the values of a model's features, (5, n_bands), by parameter."""
    t20, edt, t30, c80, g = features
    t = np.exp(t20)
    return {"t20": t, "edt": t * np.exp(edt), "t30": t * np.exp(t30), "c80": c80, "g": g}


def values_of(room, factor=1.0):
    """What the equation gives, with T so many times as long and levels to match it."""
    made = Case(
        room=room,
        configurations=[Configuration(name="a", measured=measurement({"t20": np.ones(6)}))],
    )
    level = 10 * np.log10(factor)
    steps = {"c80": -level, "g": level}
    values = natural(features_of(made)[0])
    return {p: v + steps[p] if p in steps else factor * v for p, v in values.items()}


def measurement(values):
    u = {k: 0.02 * v if k in ("t20", "edt", "t30") else np.full(6, 0.3) for k, v in values.items()}
    return measurement_of(
        F, u={k: v[None] for k, v in u.items()}, **{k: v[None] for k, v in values.items()}
    )


def controls():
    """Reference rooms without an engine."""
    scale = 0.02 * np.array([1, 1, 0.7, 20, 20])[:, None]
    rng = np.random.default_rng(1)
    return [ControlRooms(n, scale * rng.standard_normal((40, 1, 5, 6))) for n in ("one", "other")]


def found(measured, run, **more):
    room = hall()
    simulated = None if run is None else rt.Run(room, rt.Measurement.from_values(F, **run))
    more = {"without": FEWER, **more}
    return rt.find(room, measurement(measured), simulated=simulated, controls=controls(), **more)


def with_absorber(values):
    """T of a room that absorbs 40 % more, at low frequencies less."""
    less = 1 / (1 + 0.4 * np.array([0.3, 0.8, 1, 1, 1, 1]))
    return {k: less * v for k, v in values.items() if k in ("t20", "edt", "t30")}


def test_a_run_that_is_the_measurement_agrees():
    values = values_of(hall(), 1.3)
    finding = found(values, values)
    assert finding.verdict == "none"
    np.testing.assert_allclose(finding.residuals, 0, atol=0.1)  # the controls' bias


@pytest.mark.parametrize("change", [with_absorber, *also(dict)])
def test_a_run_of_the_equation_answers_as_without_one(change):
    values = values_of(hall())
    measured = change(values)
    one, other = found(measured, values), found(measured, None)
    assert one.verdict == other.verdict
    assert one.score == pytest.approx(other.score, abs=1e-6)
    assert one.probabilities == pytest.approx(other.probabilities, abs=1e-6)


def test_run_and_measurement_with_twice_the_time_say_the_same():
    some = {"without": (), "only": ("opening", "volume")}
    runs = [values_of(hall(), factor) for factor in (1.0, 2.0)]
    one, other = (found(with_absorber(run), run, **some) for run in runs)
    assert one.verdict == other.verdict
    assert one.score == pytest.approx(other.score, abs=1e-6)


def test_what_the_equation_errs_by_is_not_blamed_on_the_room():
    """Eyring is 20 % low where the audience alone absorbs, and programs agree with the measurement."""
    values = values_of(hall(), 1.25)
    without, finding = found(values, None), found(values, values, program="geometrical")
    assert without.verdict not in ("none", "hint")
    assert finding.verdict == "none"
    assert " ".join(str(finding).split()).startswith(
        "Eyring's T is 20 % shorter than the program's"
    )
    assert finding.not_judged["formula"] == IN_RUN
    assert "formula" not in finding.probabilities


def test_a_band_and_a_parameter_that_the_run_lacks_are_left_out_as_in_compare():
    values = values_of(hall(), 1.25)
    run = {p: np.where(F > 125, v, np.nan) for p, v in values.items() if p != "c80"}
    finding = found(values, run)
    compared = rt.compare(
        hall(), measurement(values), rt.Run(hall(), rt.Measurement.from_values(F, **run))
    )
    said = "Not compared: C80 and 125 Hz, which the run does not have."
    assert compared.left_out == [said]
    assert said in map(str, finding.notes)
    assert finding.verdict == "none"
    used = observe(finding.case)[0].used[0]
    assert not used[:, 0].any()
    assert used[0, 1:].all()
    # Fewer parameters of the case are fewer of its run: nothing else is said to be missing.
    assert finding.case.only("t20", "edt").configurations[0].left_out == (said,)


def test_what_is_missing_from_the_run_is_found_all_the_same():
    run = values_of(hall(), 1.25)
    finding = found(with_absorber(run), run)
    assert finding.detected
    assert finding.families["added absorption"] > 0.7


def test_calibrations_meet_the_measurement_in_the_terms_of_the_run():
    """At the run's coefficients the model is the run, whatever they are; away from them, its ratio."""
    room, values = hall(), values_of(hall(), 1.3)
    at = room.replace(alpha=1.1 * room.alpha.clip(max=0.88))
    run = rt.Run(at, rt.Measurement.from_values(F, **values))
    measured = measurement({"t20": 0.95 * values["t20"], "c80": values["c80"]})
    case = Case(
        room=room, configurations=[Configuration(name="a", measured=measured, simulated=run)]
    )
    at_run = features_of(replace(case, room=room.replace(alpha=at.alpha)))[0]
    np.testing.assert_allclose(np.exp(at_run[0]), values["t20"])
    np.testing.assert_allclose(at_run[3], values["c80"])
    ratio = rt.Eyring().reverberation_time(room) / rt.Eyring().reverberation_time(at)
    np.testing.assert_allclose(np.exp(features_of(case)[0, 0]), values["t20"] * ratio)
    met = plain(case).features[0, 0]
    np.testing.assert_allclose(met, observe(case)[0].features[0, 0], atol=1e-6)
    assert abs(recalibrate(case).features[0, 0] - met).max() < 0.02


def test_a_case_file_names_the_run_and_its_coefficients(tmp_path):
    room, values = hall(), values_of(hall(), 1.3)
    at = room.replace(alpha=0.9 * room.alpha)
    room.save(str(tmp_path / "room.toml"))
    at.save(str(tmp_path / "calibrated.toml"))
    measurement(values).save(str(tmp_path / "measured.csv"))
    rt.Measurement.from_values(F, **values).save(str(tmp_path / "run.csv"))
    (tmp_path / "case.toml").write_text(
        'room = "room.toml"\nprogram = "geometrical"\n[[configuration]]\nname = "empty"\n'
        'measured = "measured.csv"\nsimulated = "run.csv"\nat = "calibrated.toml"\n'
    )
    case = Case.from_file(str(tmp_path / "case.toml"))
    case.save(str(tmp_path / "case.json"))
    again = Case.from_file(str(tmp_path / "case.json"))
    assert json.loads(again.to_json()) == json.loads(case.to_json())
    np.testing.assert_array_equal(again.configurations[0].simulated.room.alpha, at.alpha)
    np.testing.assert_array_equal(features_of(again), features_of(case))


@pytest.mark.parametrize(
    ("volume", "program", "message"),
    [
        (4000.0, "wave", "program = 'wave' must be \"geometrical\""),
        (None, "geometrical", "add it as simulated"),
        (4100.0, "", "volume = 4100 m³"),
    ],
)
def test_a_run_of_something_else_is_refused(volume, program, message):
    values, run = values_of(hall()), None
    if volume is not None:
        run = rt.Run(hall().replace(volume=volume), rt.Measurement.from_values(F, **values))
    with pytest.raises(DataError, match=message):
        rt.find(hall(), measurement(values), simulated=run, program=program)


FIELD = np.array([0.4, -0.25, 0.08, -0.5, 0.3])[:, None] * np.ones(6)
"""What a less diffuse field changes: T is longer, and the decay is bent."""


def of_other_fields(sign=1.0):
    """Reference rooms of two engines, of which the second one has the less diffuse field."""
    one, other = controls()
    return [one, replace(other, errors=sign * (other.errors + FIELD))]


def by_program(measured, run, sign=1.0):
    """Search features of which a geometrical program's run is given."""
    simulated = rt.Run(hall(), rt.Measurement.from_values(F, **natural(run)))
    return rt.find(hall(), measurement(natural(measured)), simulated=simulated, without=FEWER,
                   program="geometrical", controls=of_other_fields(sign))  # fmt: skip


def features_of_hall(*applied):
    whole = Configuration(name="a", measured=measurement(values_of(hall())))
    return features_of(Case(room=hall(), configurations=[whole]), applied)[0]


def test_what_no_effect_explains_is_a_geometrical_programs_own():
    """T is shorter and the level higher; the decay is bent, and C80 lower: no effect does all of it."""
    run = natural(features_of_hall())
    change = np.array([-0.3, 0.2, 0.15, -4.0, 3.0])[:, None] * np.linspace(0.7, 1.3, 6)
    measured = natural(features_of_hall() + change)
    assert found(measured, run).verdict == "unknown"
    finding = found(measured, run, program="geometrical")
    assert finding.score > finding.threshold
    assert finding.verdict == "hint"
    assert "may come from the program itself" in " ".join(str(finding).split())


def test_room_and_program_are_exchangeable():
    """Either may have the less diffuse field: the error has no sign, and its covariance is the same."""
    run = features_of_hall()
    same, turned = by_program(run, run), by_program(run, run, -1.0)
    assert not same.discrepancy.bias.any()
    np.testing.assert_allclose(same.discrepancy.covariance, turned.discrepancy.covariance)
    assert same.score == pytest.approx(turned.score)


def test_what_positions_do_cancels_between_room_and_program(monkeypatch):
    def by_place(control, _number):
        far = float(control.distances.mean())
        return lambda alpha, _duration: far + alpha.sum(0) + np.zeros((5, 6))

    monkeypatch.setattr(engines, "_path_tracing", by_place)
    engine = engines.Engine("places", by_place, 1, 8, 1.0, ("random", "vector"))
    room, values = hall(), values_of(hall())
    run = rt.Run(room, rt.Measurement.from_values(F, **values))
    of_run = Configuration(name="a", measured=measurement(values), simulated=run)
    sure = room.replace(sigma=np.full_like(room.sigma, 1e-9))
    case = Case(room=sure, configurations=[of_run], program="geometrical")
    np.testing.assert_allclose(engine.run(case, 0).errors, 0, atol=1e-6)
    alone = replace(case, configurations=[replace(of_run, simulated=None)], program="")
    assert np.ptp(engine.run(alone, 0).errors, axis=0).min() > 0.1


@pytest.fixture(scope="module")
def absorber():
    """A finding with a run in which an opening is missing, and C80 and G were measured."""
    room = hall()
    whole = Configuration(name="as measured", measured=measurement(values_of(room)))
    opened = AppliedEffect(Opening(), {"area": 250.0})
    made = features_of(Case(room=room, configurations=[whole]), [opened])[0]
    return found(natural(made), values_of(room))


def test_three_models_are_compared_with_and_without_a_second_run(absorber):
    first = absorber.case.configurations[0]
    seen = verify(absorber)
    assert seen.models == ("input", "calibrated", "corrected and calibrated")
    again = verify(absorber, simulated=first.measured)
    assert again.models == ("as simulated", "calibrated", "corrected")
    assert again.runs == ("as simulated",)
    assert again.verdict == "not tested"  # the opening moves C80 and G by T alone
    assert "leaves only 0.02 JND there" in sentence(seen)
    assert "not tested: at C80 and G" in sentence(again)
    np.testing.assert_allclose(again.by_seed[1], seen.by_seed[1], atol=0.1)  # but for the bias
    assert again.after == pytest.approx(0.0, abs=1e-4)
    np.testing.assert_allclose(residual_map(again), 0, atol=0.1)
    both = verify(absorber, simulated=first.measured, calibrated=first.simulated.simulated)
    assert both.runs == both.models
    assert both.before == pytest.approx(float(again.by_seed[0, 0]))


def test_a_second_run_is_of_an_effect_that_was_chosen_and_of_one_configuration(absorber):
    first = absorber.case.configurations[0]
    weak = {name: 0.2 * p for name, p in absorber.probabilities.items()}
    unsure = replace(absorber, probabilities=weak)
    with pytest.raises(DataError, match="effect is missing"):
        verify(unsure, simulated=first.measured)
    assert verify(unsure, simulated=first.measured, effect=absorber.names[0]).effect == "opening"
    drawn = {p: 1.01 * v[0] for p, v in first.measured.values.items()}
    other = Configuration(name="curtain drawn", measured=measurement(drawn))
    run_again = rt.Run(hall(), first.simulated.simulated)
    case = Case(room=hall(), configurations=[first, replace(other, simulated=run_again)])
    twice = [replace(c, errors=np.repeat(c.errors, 2, axis=1)) for c in controls()]
    two = rt.find(case, controls=twice, without=FEWER)
    made = verify(two, simulated=first.measured, effect=two.names[0])
    assert any('not compared: "curtain drawn"' in note for note in made.notes)


def run_of(finding, effect, off):
    """What the equation gives of the corrected model with all alpha so many times as large."""
    made = finding.apply().model
    case = made.case if effect else finding.case
    room = case.room.replace(alpha=np.minimum(off * case.room.alpha, 0.99))
    bare = replace(
        case, room=room, configurations=[replace(case.configurations[0], simulated=None)]
    )
    return rt.Measurement.from_values(F, **natural(features_of(bare)[0]))


@pytest.mark.parametrize("off", [0.8, *also(1.0, 1.15)])
def test_a_second_run_is_moved_to_the_measured_time_as_the_first_one_is(absorber, off):
    """Coefficients that are off together withdraw no right effect, and support no run without it."""
    right = verify(absorber, simulated=run_of(absorber, effect=True, off=off))
    np.testing.assert_allclose(right.gaps[1:, 0, 0], 0, atol=1e-3)
    assert right.verdict == "not tested"
    assert right.after < 0.3
    without = verify(absorber, simulated=run_of(absorber, effect=False, off=0.97 * off))
    assert without.verdict != "supported"
    assert not np.allclose(right.again[0], 0, atol=0.1)
    for name, i in (("T20", 0), ("C80", 3)):
        assert f"{name} {right.sizes[0, 0, i, 0]:.2f} to" in sentence(right)


@pytest.mark.parametrize("off", [0.8, *also(1.0, 1.15)])
def test_a_second_run_that_has_what_calibrating_lacks_supports_the_finding(absorber, off):
    """The program's C80 changes with the effect by more than the equation's, and so does the room's."""
    first = absorber.case.configurations[0]

    def shifted(of):
        return replace(of, values={**of.values, "c80": of.values["c80"] + 2.0})

    case = replace(absorber.case, configurations=[replace(first, measured=shifted(first.measured))])
    second = shifted(run_of(absorber, effect=True, off=off))
    assert verify(absorber, case).verdict != "supported"
    made = verify(absorber, case, simulated=second)
    assert made.verdict == "supported", str(made)
    without = run_of(absorber, effect=False, off=0.97 * off)
    assert verify(absorber, case, simulated=without).verdict != "supported"
    # The model errs by as much as it may where the program simulated what was added.
    unsure = replace(absorber.discrepancy, covariance=25 * absorber.discrepancy.covariance)
    again = verify(replace(absorber, discrepancy=unsure), case, simulated=second)
    assert again.verdict == "supported"
    assert again.uncertainty == made.uncertainty


def test_the_noise_of_measurement_and_runs_counts_against_a_second_run(absorber):
    first = absorber.case.configurations[0]

    def errors(of, levels):
        u = {p: np.full_like(of.values[p], levels) for p in ("c80", "g")}
        return replace(of, uncertainty={**of.uncertainty, **u})

    case = replace(
        absorber.case, configurations=[replace(first, measured=errors(first.measured, 1e-3))]
    )
    second = run_of(absorber, effect=True, off=1.0)
    exact, noisy = (verify(absorber, case, simulated=errors(second, u)) for u in (0.0, 2.0))
    # In JND of 1 dB, two parameters in six bands each. What was measured is common to both gaps.
    assert exact.uncertainty < 1e-3
    assert noisy.uncertainty == pytest.approx(2.0 * np.sqrt((1 - 2 / np.pi) / 12), rel=0.15)


def test_instructions_are_in_the_terms_of_the_program(absorber, tmp_path):
    """The list's old coefficients are those of the run; a run with the new ones has the measured T."""
    _, _, files = of_finding.correct(absorber, tmp_path, effect=absorber.names[0])
    text = files[tmp_path / "instructions.txt"].decode()
    assert re.search(r"^opening, 3\d\d\.\d\d m² +0\.6", text, re.M)
    listed = files[tmp_path / "catt.txt"].decode()
    (new,) = re.findall(r"^walls, new +(.*)$", text, re.M)
    (of_list,) = re.findall(r"^ABS walls = <(.*)>", listed, re.M)
    np.testing.assert_allclose(
        [*map(float, of_list.split())], 100 * np.array(new.split(), float), atol=0.06
    )
    old = next(line for line in text.splitlines() if line.startswith("walls, old"))
    assert [float(v) for v in old.split()[2:]] == [0.05] * 6
    bare = replace(absorber.case.configurations[0], simulated=None)
    without = replace(absorber, case=replace(absorber.case, configurations=[bare]))
    assert tmp_path / "instructions.txt" not in of_finding.correct(without, tmp_path)[2]


def test_what_is_drawn_larger_is_said_where_it_is_drawn(absorber):
    made = absorber.apply()
    drawn = Reason(DRAWN_LARGER, {"drawn": 11.0, "size": 10.0})
    patch = replace(made, notes=(drawn, Reason("surface unknown")))
    said = " ".join(lines_of(of_finding.instructions(absorber, patch, made.room)))
    assert said.count("11.00 m²") == 1
    assert said.index("2. ") < said.index("11.00 m²") < said.index("3. ")


def test_a_hint_is_added_and_verified_only_where_it_is_chosen(absorber, tmp_path):
    hint, name = replace(absorber, verdict="hint", family=None, named=()), absorber.names[0]
    said, _, files = of_finding.correct(hint, tmp_path)
    assert not files
    assert "--effect NAME" in said
    with pytest.raises(DataError, match="verdict"):
        hint.apply()
    with pytest.raises(DataError, match="nothing was found that can be verified"):
        verify(hint)
    said, _, files = of_finding.correct(hint, tmp_path, effect=name)
    assert tmp_path / "room.toml" in files
    assert "only a weak indication" in said
    again = verify(hint, simulated=run_of(absorber, effect=True, off=1.0), effect=name)
    assert again.verdict != "supported"


def test_a_program_that_differs_is_calibrated_by_the_loop(absorber):
    agrees = replace(absorber, verdict="none", family=None, named=())
    assert "rtcal loop start" in without_measuring(agrees)


def test_a_second_run_that_is_nearer_as_simulated_is_not_withdrawn(absorber):
    """Calibrated by the equation it is farther, which may be the equation's error."""
    made = verify(absorber, simulated=absorber.case.configurations[0].measured)
    gaps = np.broadcast_to(np.array([4.0, 4.0, 7.0])[:, None, None, None, None], made.gaps.shape)
    for off, verdict in ((2.0, "unproven"), (5.0, "withdrawn")):
        seen = replace(made, gaps=gaps, again=np.full(made.again.shape, off))
        assert seen.verdict == verdict
        assert ("may be wrong. Calibrate your program" in sentence(seen)) == (verdict == "unproven")
