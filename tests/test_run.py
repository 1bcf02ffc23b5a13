"""A run of the user's own program beside the measurement: what is compared, and what is refused."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.observables import OBSERVABLES
from rtcal.report import pages
from rtcal.simulators.external import of_equation
from rtcal.support.errors import DataError, OtherBandsWarning
from tests.conftest import also, room_of

F = [500.0, 1000.0]
PAIRS = [("S1", "R1"), ("S1", "R2")]


def box(**changes):
    materials = {"wall": (120, 0.1, 0.02), "floor": (38, [0.2, 0.3], 0.05)}
    return room_of(materials, F, 120, **{"name": "box", "air": rt.Air(20.0, 50.0), **changes})


def of_pairs(pairs=PAIRS, **values):
    return rt.Measurement(centre_frequencies=F, values=values, pairs=pairs)


def test_the_same_parameters_pairs_and_values_are_compared():
    run = rt.Run(box(), of_pairs(t20=[[1.0, 1.1], [1.2, 1.3]], c80=[[1, 2], [3, 4]]))
    measured = of_pairs(
        [*PAIRS[::-1], ("S1", "R3")], t20=[[2, 2.2], [1, np.nan], [9, 9]], t30=[[1, 1]] * 3
    )
    both = run.beside(measured)
    for one in (both.run, both.measured):
        assert one.pairs == (("S1", "R2"), ("S1", "R1"))
        assert [*one.values] == ["t20"]
        assert np.isnan(one.values["t20"]).tolist() == [[False, False], [False, True]]
    assert both.run.mean("t20").tolist() == [1.1, 1.3]
    assert both.lacking == {"t30": "run", "c80": "measurement"}
    assert both.left_out() == [
        "Not compared: T30 and S1 to R3, which the run does not have, and C80 and T20 from S1 to R1 at "
        "1000 Hz, which the measurement does not have."
    ]


def test_without_a_pair_in_common_means_are_compared():
    run = rt.Run(box(), of_pairs([("S9", "R9"), ("S9", "R8")], t20=[[1.0, 1.1], [1.2, 1.3]]))
    both = run.beside(of_pairs(t20=[[2.0, 2.2], [1.0, 1.1]]))
    assert both.run.mean("t20") == pytest.approx([1.1, 1.2])
    assert "Means over the pairs are compared" in both.left_out()[-1]


def test_bands_are_converted_and_t20_is_not_t30():
    thirds = rt.Measurement.from_values([400, 500, 630], t20=[1.0, 1.0, 1.0])
    with pytest.warns(OtherBandsWarning, match="the run is converted from third-octaves"):
        run = rt.Run(box(), thirds)
    assert run.simulated.centre_frequencies.tolist() == F
    for other in (
        rt.Measurement.from_values(F, t30=[1, 1]),
        rt.Measurement.from_values(F[1:], t20=[1]),
    ):
        with pytest.raises(DataError, match="no value in common: the simulation has T20"):
            run.beside(other)
    with pytest.raises(DataError, match=r"simulated: .* no band in common"):
        rt.Run(box(), rt.Measurement.from_values([8000], t20=[1]))


def test_a_band_that_the_run_lacks_is_left_out_of_comparison_and_loop_alike():
    room = box(sigma=[[0.04, 0.04], [0.1, 0.1]])
    said = "Not compared: 500 Hz, which the run does not have."
    program = of_equation(rt.Millington(), room)
    wanted = program.simulate(np.array([[0.13, 0.08], [0.3, 0.2]])).mean("t20")
    measured = rt.Measurement.from_values(F, t20=wanted)
    run = rt.Run(
        room,
        rt.Measurement.from_values(F, t20=[np.nan, program.simulate(room.alpha).mean("t20")[1]]),
    )
    found = rt.compare(room, measured, run)
    assert found.left_out == [said]
    assert np.isnan(found.deviation["t20"]).tolist() == [True, False]
    begun = rt.loop.start(room, measured, run=run)
    assert begun.notes == (said,)
    assert begun.status[0] == "no measured T"
    np.testing.assert_array_equal(begun.next_alpha[:, 0], room.alpha[:, 0])
    ended = rt.calibrate_simulator(program, room, measured, run=run)
    assert said in ended.notes
    assert ended.status == ("no measured T", "converged")
    alone = rt.Measurement.from_values(F, t20=[np.nan, wanted[1]])
    np.testing.assert_array_equal(
        ended.alpha, rt.calibrate_simulator(program, room, alone, run=run).alpha
    )


def test_a_loop_matches_t30_beside_t30_where_t20_is_not_in_both():
    room = box(sigma=[[0.04, 0.04], [0.1, 0.1]])
    program = of_equation(rt.Millington(), room)
    wanted = program.simulate(np.array([[0.13, 0.08], [0.3, 0.2]])).mean("t20")
    given = program.simulate(room.alpha).mean("t20")
    by_t20, by_t30 = (
        rt.loop.start(
            room,
            rt.Measurement.from_values(F, **{key: wanted}, **more),
            run=rt.Run(room, rt.Measurement.from_values(F, **{key: given})),
        )
        for key, more in (("t20", {}), ("t30", {"t20": 2 * wanted}))
    )
    np.testing.assert_array_equal(by_t20.next_alpha, by_t30.next_alpha)
    assert by_t30.notes == ("Not compared: T20, which the run does not have.",)
    for loop, key in ((by_t20, "t20"), (by_t30, "t30")):
        times = program.simulate(loop.next_alpha).mean("t20")
        more = {} if key == "t20" else {"t20": 0.5 * times}
        after = loop.record(loop.next_alpha, rt.Measurement.from_values(F, **{key: times}, **more))
        np.testing.assert_allclose(after.gap, 0, atol=1.0)
    other = rt.Run(room, rt.Measurement.from_values(F, t20=given))
    with pytest.raises(DataError, match="Only the same parameter in the same band"):
        rt.loop.start(room, rt.Measurement.from_values(F, t30=wanted), run=other)
    with pytest.raises(DataError, match="no EDT in common"):
        rt.loop.start(
            room,
            rt.Measurement.from_values(F, t20=wanted, edt=wanted),
            run=other,
            weights={"t20": 1, "edt": 1},
        )


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"materials": ["wall", "carpet"]}, "carpet"),
        ({"areas": [120, 39]}, r'area\["floor"\]'),
        ({"volume": 121}, "volume"),
        ({"centre_frequencies": [1000, 2000]}, "2000 Hz"),
        ({"air": None}, "no air"),
    ],
)
def test_a_run_of_another_room_is_refused(changed, named):
    run = rt.Run(box(alpha=[[0.5, 0.5], [0.5, 0.5]]), rt.Measurement.from_values(F, t20=[1.0, 1.1]))
    run.refuse_other(box())
    with pytest.raises(DataError, match=named):
        run.refuse_other(box(**changed))


def measurement(rng, pairs=None):
    shape = (1 if pairs is None else len(pairs), 2)
    values = {
        "t20": np.exp(rng.normal(0, 0.3, shape)),
        "edt": np.exp(rng.normal(0, 0.3, shape)),
        "c80": rng.normal(0, 3, shape),
        "d50": rng.uniform(0.2, 0.8, shape),
        "ts": rng.uniform(0.05, 0.2, shape),
    }
    more = {} if pairs is None else {"pairs": pairs}
    return rt.Measurement(centre_frequencies=F, values=values, **more)


@pytest.mark.parametrize("pairs", [PAIRS, *also(None)])
def test_laws_of_a_comparison(pairs):
    rng = np.random.default_rng(0)
    for _ in range(20):
        one, other = measurement(rng, pairs), measurement(rng, pairs)
        found = rt.compare(box(), one, rt.Run(box(), other))
        mirrored = rt.compare(box(), other, rt.Run(box(), one))
        for p, off in found.deviation.items():
            # Of a share of the value, such as T, the other side is the base.
            jnd = OBSERVABLES[p].jnd if OBSERVABLES[p].relative_jnd else 0.0
            np.testing.assert_allclose(off, -mirrored.deviation[p] * (1 + jnd * off))
        assert str(found).count("\n") < 40
        # The run itself, and a run with all times doubled.
        same = rt.compare(box(), one, rt.Run(box(), one))
        assert not same.left_out
        assert not any(np.any(off) for off in same.deviation.values())
        assert not any(at.any() for at in same.disagrees.values())
        times = {p: 2 * v for p, v in one.values.items() if p in ("t20", "edt")}
        twice = rt.Measurement(centre_frequencies=F, values=times, pairs=one.pairs)
        doubled = rt.compare(box(), one, rt.Run(box(), twice))
        assert "T20 is 100 % too long in all bands" in doubled.sentence
        assert doubled.lacking == {"d50": "run", "c80": "run", "ts": "run"}


@pytest.mark.parametrize(
    ("factor", "slope", "said"),
    [
        (2.0, 0.0, "The program's T20 is 2.0 times the measured one in all bands. Check the scale"),
        (0.5, 0.0, "The measured T20 is 2.0 times the program's in all bands. Check the scale"),
        (2.0, 0.1, ""),  # other coefficients are otherwise off from band to band
        (1.2, 0.0, ""),
    ],
)
def test_a_run_that_is_a_multiple_in_all_bands_is_said_so(factor, slope, said):
    room = rt.Room(
        name="box", volume=200, materials=["all"], areas=[220], alpha=[[0.1, 0.12, 0.15]],
        sigma=[[0.03] * 3], centre_frequencies=[500, 1000, 2000],
    )  # fmt: skip
    times = rt.Eyring().reverberation_time(room)
    one = rt.Measurement.from_values(room.centre_frequencies, t20=times)
    other = times * factor * (1 + slope * np.arange(3))
    run = rt.Run(room, rt.Measurement.from_values(room.centre_frequencies, t20=other))
    text = " ".join(str(rt.compare(room, one, run)).split())
    assert said in text
    assert ("times the" in text) == bool(said)


def test_a_deviation_that_the_coefficients_explain_is_not_the_programs():
    measured = rt.Measurement.from_values(F, t20=[1.0, 1.0], c80=[0.0, 0.0])
    run = rt.Measurement.from_values(F, t20=[1.2, 1.2], c80=[-1.2, 3.0])
    for relative, explained in ((0.3, True), (0.001, False)):
        alpha = np.array([[0.1, 0.1], [0.2, 0.3]])
        room = box(sigma=relative * alpha)
        found = rt.compare(room, measured, rt.Run(room, run))
        assert found.disagrees["t20"].all()
        assert found.explained["t20"].tolist() == [explained] * 2
        # C80 falls with a longer T: coefficients carry along what they do, and not a rise.
        assert found.explained["c80"].tolist() == [explained, False]


def test_what_follows_from_a_time_beyond_sigma_is_not_explained_by_coefficients():
    times = {"t20": [1.0, 1.0], "edt": [1.0, 1.0]}
    run = rt.Measurement.from_values(F, t20=[2.0, 1.1], edt=[2.0, 1.1])
    room = box(sigma=0.1 * np.array([[0.1, 0.1], [0.2, 0.3]]))
    found = rt.compare(room, rt.Measurement.from_values(F, **times), rt.Run(room, run))
    for each in found.explained.values():
        assert each.tolist() == [False, True]


def test_without_a_run_the_equation_is_compared():
    measured = rt.Measurement.from_values(F, t20=1.5 * rt.Sabine().reverberation_time(box()))
    found = rt.compare(box(), measured, equation=rt.Sabine())
    assert found.sentence == "Sabine's T20 is 33 % too short in all bands."


def test_the_command_writes_page_and_numbers(tmp_path, rtcal):
    room, measured, run = (str(tmp_path / n) for n in ("room.toml", "m.csv", "run.csv"))
    box().save(room)
    rt.Measurement.from_values(F, t20=[1.0, 1.0]).save(measured)
    rt.Measurement.from_values(F, t20=[1.3, 1.0]).save(run)
    out, command = tmp_path / "gap", ("compare", room, measured)
    text = rtcal(*command, "--simulated", run, "--out", out)
    assert text.startswith("The program's T20 is 30 % too long at 500 Hz.")
    found = rt.load(out)
    assert found.sentence in text
    assert "disagree" in (out / "report.html").read_text("utf-8")
    assert pages.page(found) == (out / "report.html").read_text("utf-8")
    other = str(tmp_path / "other.toml")
    box(volume=130).save(other)
    assert "Add it with --simulated" in rtcal.refused(*command, "--at", other)
    assert "volume = 130" in rtcal.refused(*command, "--simulated", run, "--at", other)


@pytest.mark.parametrize("equation", [rt.Millington(), rt.Kuttruff()])
def test_a_loop_that_begins_with_a_run_needs_one_simulation_less(equation):
    room = box(sigma=[[0.04, 0.04], [0.1, 0.1]])
    program = of_equation(equation, room)
    measured = program.simulate(np.array([[0.13, 0.08], [0.3, 0.2]]))
    whole = rt.calibrate_simulator(program, room, measured)
    run = rt.Run(room, program.simulate(room.alpha))
    rest = rt.calibrate_simulator(program, room, measured, run=run)
    assert rest.simulations == whole.simulations - 1
    np.testing.assert_array_equal(rest.alpha, whole.alpha)
    np.testing.assert_array_equal(rest.ends[0].simulated, whole.ends[0].simulated)
    # The first step is the paper's: the equation's T as far off as the program's.
    begun = rt.loop.start(room, measured, run=run)
    eyring = rt.Eyring().reverberation_time(room)
    target = begun.wanted * eyring / run.simulated.mean("t20")
    np.testing.assert_allclose(begun.next_target, target)
