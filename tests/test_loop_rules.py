"""The closed loop's arithmetic by hand: rules, goals, statuses, limits, next targets."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.loop import rules
from rtcal.loop.matched import Matched
from rtcal.loop.rules import (
    CLOSE_TARGETS,
    Step,
    band_goals,
    band_statuses,
    confirmed_statuses,
    next_targets,
    simulated_time,
    stuck_bands,
    target_limits,
    target_without_t20,
)

LOW, HIGH = 0.01, 100.0


def after(rule, points, wanted, low=LOW, high=HIGH):
    """The rule's next target rate after points (target, rate)."""
    targets, rates = np.array(points, dtype=float).T
    return rules.RULES[rule](targets, rates, wanted, low, high)


def test_the_secant_is_equations_38_to_40_of_the_paper():
    wanted = 2.0
    assert after("secant", [(2.0, 2.5)], wanted) == pytest.approx(2.0 * (1 - (2.5 - 2.0) / 2.0))
    third = 1.5 - (1.8 - 2.0) * (1.5 - 2.0) / (1.8 - 2.5)  # Eq. 40
    assert after("secant", [(2.0, 2.5), (1.5, 1.8)], wanted) == pytest.approx(third)
    assert after("secant", [(9.0, 9.0), (2.0, 2.5), (1.5, 1.8)], wanted) == pytest.approx(third)
    assert after("secant", [(2.0, 5.0)], wanted) < 0  # its weakness


def test_the_secant_keeps_its_target_where_the_rate_stays():
    assert after("secant", [(2.0, 3.0), (1.5, 3.0)], 2.0) == 1.5


@pytest.mark.parametrize("rule", ["safeguarded", "regression"])
def test_the_first_step_takes_the_rate_to_be_proportional(rule):
    assert after(rule, [(2.0, 2.5)], 2.0) == pytest.approx(2.0 * 2.0 / 2.5)
    assert after(rule, [(2.0, 1.8)], 2.5) == pytest.approx(2.0 * 2.5 / 1.8)


@pytest.mark.parametrize("power", [0.31, 0.8, 1.7, 2.9])
def test_the_safeguarded_rule_solves_a_power_law_in_two_steps(power):
    points = [(t, 1.3 * t**power) for t in (2.0, 1.6)]
    assert after("safeguarded", points, 2.2) == pytest.approx((2.2 / 1.3) ** (1 / power))
    # It is the last two points that count.
    assert after("safeguarded", [(9.0, 2.5), *points], 2.2) == pytest.approx(
        (2.2 / 1.3) ** (1 / power)
    )


@pytest.mark.parametrize(("power", "slope"), [(0.1, 0.3), (-1.0, 0.3), (0.29, 0.3), (7.0, 3.0)])
def test_the_safeguarded_rules_slope_is_clipped(power, slope):
    """Slopes of 0.3 to 3."""
    points = [(t, 1.3 * t**power) for t in (2.0, 2.1)]
    last = points[-1][1]
    wanted = 1.2 * max(rate for _, rate in points)
    expected = 2.1 * (wanted / last) ** (1 / slope)
    assert after("safeguarded", points, wanted) == pytest.approx(expected)


def test_a_target_simulated_twice_has_slope_one():
    assert after("safeguarded", [(2.0, 2.4), (2.0, 2.5)], 2.2) == pytest.approx(2.0 * 2.2 / 2.5)


def test_the_safeguarded_rule_halves_into_its_bracket():
    # 1 is too low, 3.9 and 4 are too high; the slope between the latter leads below 1.
    points = [(1.0, 0.5), (4.0, 3.0), (3.9, 2.99)]
    assert after("safeguarded", points, 1.9) == pytest.approx(np.sqrt(1.0 * 3.9))
    # The mirror image: 4 is too high, 1 and 1.02 are too low.
    points = [(4.0, 8.0), (1.0, 1.0), (1.02, 1.003)]
    assert after("safeguarded", points, 1.9) == pytest.approx(np.sqrt(1.02 * 4.0))
    # A step within the bracket is kept.
    points = [(1.0, 0.5), (4.0, 3.0)]
    slope = np.log(6) / np.log(4)
    assert after("safeguarded", points, 1.9) == pytest.approx(4 * (1.9 / 3) ** (1 / slope))


def test_points_at_the_wanted_rate_are_no_ends_of_the_bracket():
    points = [(1.0, 2.0), (3.0, 4.0)]
    assert after("safeguarded", points, 2.0, low=0.5) == pytest.approx(1.0)


def test_a_rule_ends_at_the_range_of_the_equation():
    assert after("safeguarded", [(1.0, 10.0)], 1.0, low=0.5) == pytest.approx(0.5)
    assert after("safeguarded", [(1.0, 0.1)], 1.0, high=3.0) == pytest.approx(3.0)
    # Beyond the other end of the bracket it is halved, not cut.
    points = [(1.0, 2.0), (0.9, 1.95)]
    step = 0.9 * (1.2 / 1.95) ** (1 / 0.3)
    assert after("safeguarded", points, 1.2, low=0.1) == pytest.approx(step)
    assert after("safeguarded", points, 1.2, low=0.3) == pytest.approx(0.3)


def test_a_step_to_the_very_end_of_the_range_is_kept():
    assert after("safeguarded", [(2.0, 4.0)], 2.0, low=1.0) == 1.0
    assert after("safeguarded", [(2.0, 1.0)], 2.0, high=4.0) == pytest.approx(4.0, rel=1e-12)


def test_one_target_that_was_too_low_and_too_high_is_no_bracket():
    points = [(2.0, 1.9), (2.0, 2.1)]
    assert after("safeguarded", points, 2.0) == pytest.approx(2.0 * 2.0 / 2.1)


def test_a_bracket_that_contradicts_itself_is_ignored():
    points = [(1.0, 3.0), (2.0, 1.0)]  # falls
    assert after("safeguarded", points, 1.5) == pytest.approx(2.0 * 1.5 ** (1 / 0.3))


def ridge(points, wanted):
    """The regression's target by least squares with the prior as one more row."""
    u, v = np.log(np.array(points)).T
    rows = np.column_stack([np.ones_like(u), u]) / 0.03
    rows, values = np.vstack([rows, [0, 1 / 0.3]]), np.append(v / 0.03, 1 / 0.3)
    intercept, slope = np.linalg.lstsq(rows, values, rcond=None)[0]
    return np.exp((np.log(wanted) - intercept) / slope), slope


@pytest.mark.parametrize(
    "points", [[(2.0, 2.5), (1.7, 2.0)], [(2.0, 2.5), (1.7, 2.0), (1.5, 2.05), (1.3, 1.5)]]
)
def test_the_regression_is_ridge_regression(points):
    expected, slope = ridge(points, 1.8)
    assert 0.3 < slope < 3
    assert expected / points[-1][0] == pytest.approx(1, abs=0.5)
    assert after("regression", points, 1.8) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("power", "slope"), [(-2.0, 0.3), (9.0, 3.0)])
def test_the_regressions_slope_is_clipped(power, slope):
    points = [(t, t**power) for t in (0.5, 1.0, 2.0)]
    wanted = 1.2**slope
    assert not 0.3 < ridge(points, wanted)[1] < 3
    assert after("regression", points, wanted) == pytest.approx(1.2, rel=1e-9)


def test_the_regression_steps_by_a_factor_of_two_at_most():
    assert after("regression", [(1.0, 1.0)], 50.0) == pytest.approx(2.0)
    assert after("regression", [(1.0, 1.0)], 0.02) == pytest.approx(0.5)
    assert after("regression", [(3.0, 1.0), (1.0, 1.0)], 50.0) == pytest.approx(2.0)


def next_time(rule, times, wanted, shortest=0.1, longest=10.0):
    targets, simulated = np.array(times, dtype=float).T
    return rules.next_target(rule, targets, simulated, wanted, shortest, longest)


def test_the_next_target_is_a_time_within_the_range():
    # Rates 1/2 and 1/2.5: the first step is proportional, so that 2 s times 2/2.5 follow.
    assert next_time("safeguarded", [(2.0, 2.5)], 2.0) == pytest.approx(1.6)
    assert next_time("secant", [(2.0, 2.5)], 2.0) == pytest.approx(1 / (2 / 2.0 - 1 / 2.5))
    assert next_time("safeguarded", [(2.0, 9.0)], 1.0, shortest=0.8) == pytest.approx(0.8)
    assert next_time("safeguarded", [(2.0, 1.0)], 8.0, longest=5.0) == pytest.approx(5.0)
    assert next_time("safeguarded", [(2.0, 1.0)], 5 / 3, longest=5.0) == pytest.approx(10 / 3)
    assert next_time("safeguarded", [(2.0, 4.0)], 2.4, shortest=0.8) == pytest.approx(1.2)
    assert next_time("secant", [(2.0, 0.9)], 2.0, longest=5.0) == pytest.approx(2.0)  # below 0
    assert next_time("secant", [(2.0, 1.0)], 2.0, longest=5.0) == pytest.approx(2.0)  # 0
    assert next_time("secant", [(9.0, 0.9)], 2.0, longest=5.0) == pytest.approx(5.0)  # and cut
    assert next_time("regression", [(2.0, 2.5)], 2.0, longest=1.5) == pytest.approx(1.5)


def test_the_goal_is_the_tolerance_less_the_noise():
    noise = np.array([0.0, 0.2, 0.5, 0.6, 9.0, np.nan])
    assert band_goals(1.0, noise) == pytest.approx([1.0, 0.8, 0.5, 0.5, 0.5, 0.5])
    assert band_goals(2.0, noise) == pytest.approx([2.0, 1.8, 1.5, 1.4, 1.0, 1.0])


def test_a_loops_goal_is_in_jnd_of_the_measured_time(cr2):
    """A noise of 2 % of the measured T is 0.4 JND; the simulated T has no part in it."""
    room, measured = cr2
    wanted = measured.mean("t30")
    share = np.array([0.0, 0.01, 0.02, 0.03, 0.1, np.nan])
    for tolerance in (1.0, 2.0):
        loop = rt.loop.start(room, measured, tolerance=tolerance)
        simulated = rt.Measurement(
            centre_frequencies=room.centre_frequencies,
            values={"t20": np.tile(3 * wanted, (4, 1))},
            pairs=[("S", f"R{i}") for i in range(4)],
            uncertainty={"t20": np.tile(2 * share * wanted, (4, 1))},  # the mean has half of it
        )
        loop = loop.record(loop.next_alpha, simulated)
        assert loop.steps[0].noise == pytest.approx(share * wanted, nan_ok=True)
        expected = np.fmax(tolerance - share / 0.05, tolerance / 2)
        assert loop.goal == pytest.approx(expected)
        assert loop.gap == pytest.approx(np.full(6, 40.0))


def test_the_goal_decides_what_is_converged(cr2):
    """With a noise of 0.4 JND a gap of 0.59 JND is within the goal, and 0.61 is not."""
    room, measured = cr2
    wanted = measured.mean("t30")
    gap = np.array([0.59, 0.61, -0.59, -0.61, 0.99, 0.0])
    noise = np.array([0.4, 0.4, 0.4, 0.4, 0.0, 0.4])
    loop = rt.loop.start(room, measured)
    simulated = rt.Measurement(
        centre_frequencies=room.centre_frequencies,
        values={"t20": [wanted * (1 + 0.05 * gap)]},
        uncertainty={"t20": [0.05 * noise * wanted]},
    )
    loop = loop.record(loop.next_alpha, simulated)
    done, on = "converged", "not converging"
    assert loop.status == (done, on, done, on, done, done)
    assert not loop.finished
    # Bands that converged with a gap above half their goal go on with the others.
    moved = loop.next_target != loop.steps[0].target
    assert moved.tolist() == [True, True, True, True, True, False]


def statuses(**changes):
    """The status of one band: 3 JND too long, its target in the middle of the range."""
    values = {
        "gap": 3.0,
        "goals": 1.0,
        "target": 1.0,
        "limits": (0.5, 2.0),
        "blocked": False,
        "measured": True,
    } | changes
    values["limits"] = tuple(np.array([x]) for x in values["limits"])
    return band_statuses(**{k: v if k == "limits" else np.array([v]) for k, v in values.items()})[0]


def test_statuses_of_a_band():
    assert statuses() == "not converging"
    assert statuses(gap=np.nan) == "not converging"
    assert statuses(gap=1.0) == statuses(gap=-1.0) == "converged"
    assert statuses(gap=1.0001) == statuses(gap=-1.0001) == "not converging"
    assert statuses(gap=1.4, goals=1.5) == "converged"
    # At the limit that would help, or within rounding of it, and beyond it:
    for target in (0.5, 0.5 * (1 + 1e-10), 0.4):
        assert statuses(target=target) == "unreachable"
        assert statuses(target=target, gap=-3.0) == "not converging"
        assert statuses(target=target, gap=0.5) == "converged"
    for target in (2.0, 2.0 * (1 - 1e-10), 2.5):
        assert statuses(target=target, gap=-3.0) == "unreachable"
        assert statuses(target=target) == "not converging"
        assert statuses(target=target, gap=0.5, goals=0.3) == "not converging"
    for target in (0.5 * (1 + 1e-6), 2.0 * (1 - 1e-6)):
        assert statuses(target=target) == statuses(target=target, gap=-3.0) == "not converging"
    assert statuses(blocked=True) == "unreachable"
    assert statuses(blocked=True, gap=0.3) == "converged"
    assert statuses(gap=np.nan, measured=False, blocked=True) == "no measured T"
    assert statuses(gap=np.nan, blocked=True) == "unreachable"


def test_a_confirmation_is_within_tolerance_and_noise():
    gap = np.array([1.0, 1.3, 1.31, -1.31, 0.0, 0.0, 0.5, 9.0])
    noise = np.array([0.0, 0.3, 0.3, 0.3, 1.0, 1.01, np.nan, 0.0])
    before = ("converged",) * 7 + ("unreachable",)
    yes, no = "converged", "not confirmed"
    expected = (yes, yes, no, no, yes, no, no, "unreachable")
    assert confirmed_statuses(before, gap, noise, 1.0) == expected
    assert confirmed_statuses(before[:1], gap[2:3], noise[2:3], 2.0) == (yes,)


def test_stuck_bands_have_one_time_for_three_coefficients():
    alpha = np.arange(12.0).reshape(3, 2, 2)
    simulated = np.array([[1.0, 1.0], [1.0, 2.0], [1.0, 1.0]])
    assert stuck_bands(alpha, simulated).tolist() == [True, False]
    assert stuck_bands(alpha[:2], simulated[:2]).tolist() == [False, False]
    # What came before does not count.
    earlier = np.concatenate([[[9.0, 9.0]], simulated])
    assert stuck_bands(np.concatenate([alpha[:1] - 1, alpha]), earlier).tolist() == [True, False]
    # The same coefficients in any two steps tell nothing; one material that changed tells.
    for step in (1, 2):
        same = alpha.copy()
        same[step, :, 0] = same[step - 1, :, 0]
        assert stuck_bands(same, simulated).tolist() == [False, False]
    one = np.zeros((3, 2, 2))
    one[:, 1, 0] = [0.1, 0.2, 0.3]
    assert stuck_bands(one, simulated).tolist() == [True, False]
    missing = np.where(simulated == 1.0, np.nan, simulated)
    assert stuck_bands(alpha, missing).tolist() == [False, False]


def hall(**changes):
    """Volume 100 m³, two materials of 30 and 70 m², no air."""
    values = {
        "name": "hall",
        "volume": 100,
        "materials": ["a", "b"],
        "areas": [30, 70],
        "alpha": [[0.2], [0.1]],
        "sigma": [[0.1], [0.1]],
        "centre_frequencies": [1000],
    }
    return rt.Room(**(values | changes))


def test_limits_of_the_target_are_a_thousandth_from_the_bounds():
    room, sabine = hall(), rt.Sabine(speed_of_sound=343)
    factor = 24 * np.log(10) * 100 / 343

    def limits(room, equation=sabine):
        shortest, longest = target_limits(room, equation)
        return factor / shortest[0], factor / longest[0]

    assert limits(room) == pytest.approx((99.9, 0.1))
    floor = hall(alpha_min=[[0.1], [0.05]])
    assert limits(floor) == pytest.approx((99.9, 6.5 + 0.001 * 93.5))
    fixed = hall(sigma=[[0.0], [0.1]])
    assert limits(fixed) == pytest.approx((6 + 0.999 * 70, 6 + 0.001 * 70))
    kuttruff = rt.Kuttruff(speed_of_sound=343)
    area = 0.999 * kuttruff.largest_mean * 100
    assert area < 99.9
    shortest, _ = target_limits(room, kuttruff)
    assert shortest == pytest.approx(kuttruff.time(room, np.array([area])))


def step(target, simulated):
    n = len(target)
    return Step(
        target=np.array(target, dtype=float),
        alpha=np.zeros((1, n)),
        simulated=np.array(simulated, dtype=float),
        noise=np.zeros(n),
    )


WANTED = np.array([2.0, 2.0, 2.0, np.nan])
NAN = np.nan


def test_the_nearest_target_without_a_t20():
    steps = [
        step([2.0, 2.0, 2.0, NAN], [2.5, 2.5, NAN, NAN]),
        step([1.0, 1.6, 1.8, NAN], [NAN, 2.2, NAN, NAN]),
        step([1.5, 1.5, 1.7, NAN], [NAN, 2.1, NAN, NAN]),
    ]
    best = np.array([2.0, 1.5, 2.0, NAN])
    # The nearest one; none; never any T20; no measured T.
    assert target_without_t20(steps, WANTED, best) == pytest.approx(
        [1.5, NAN, NAN, NAN], nan_ok=True
    )
    # Nearest by ratio, not by difference: 1.1 and 3.2 from 2.
    steps = [step([2.0], [2.5]), step([1.1], [NAN]), step([3.2], [NAN])]
    found = target_without_t20(steps, WANTED[:1], np.array([2.0]))
    assert found == pytest.approx([3.2])


def next_of(steps, best, moving=(True,), rule="safeguarded", limits=(0.1, 10.0), prior=1.2):
    n = len(best)
    return next_targets(
        rule,
        steps,
        WANTED[:n],
        np.array(best),
        np.array(moving),
        tuple(np.full(n, limit) for limit in limits),
        np.full(n, prior),
    )


def test_bands_that_do_not_move_keep_their_best_target():
    steps = [step([2.0, 2.0], [2.5, 2.5])]
    best = [2.0, 2.0]
    assert next_of(steps, best, (True, False)) == pytest.approx([1.6, 2.0])
    assert best == [2.0, 2.0]


def test_only_steps_with_a_t20_are_points_of_the_rule():
    steps = [step([2.0], [2.5]), step([0.4], [NAN])]
    # 1.6 s is asked for; halfway to 0.4 is 0.89: not beyond.
    assert next_of(steps, [2.0]) == pytest.approx([1.6])
    steps = [step([2.0], [2.5]), step([1.5], [NAN])]
    assert next_of(steps, [2.0]) == pytest.approx([np.sqrt(2.0 * 1.5)])
    # Towards longer times, too; and away from the target without a T20 it is free.
    steps = [step([2.0], [1.5]), step([2.2], [NAN])]
    assert next_of(steps, [2.0]) == pytest.approx([np.sqrt(2.0 * 2.2)])
    steps = [step([2.0], [1.5]), step([1.5], [NAN])]
    assert next_of(steps, [2.0]) == pytest.approx([2.0 * 2.0 / 1.5])


def test_a_band_without_any_t20_takes_the_equations_time():
    steps = [step([2.0], [NAN])]
    assert next_of(steps, [2.0]) == pytest.approx([1.2])
    assert next_of(steps, [2.0], limits=(1.4, 10.0)) == pytest.approx([1.4])
    assert next_of(steps, [2.0], limits=(0.1, 1.1)) == pytest.approx([1.1])


def test_targets_within_a_tenth_are_close():
    """The loop gives up a band between a T20 and none once they are within 10 %."""
    assert pytest.approx(np.log(1.1)) == CLOSE_TARGETS


def measurement(**changes):
    values = {
        "centre_frequencies": [500, 1000],
        "values": {"t20": [[1.0, 2.0], [3.0, 4.0]]},
        "pairs": [("S", "R1"), ("S", "R2")],
    }
    return rt.Measurement(**(values | changes))


def test_noise_of_a_mean_is_that_of_independent_pairs():
    t20 = Matched.time(np.ones(2), "T20")
    assert t20.noise(measurement()) == pytest.approx([0.0, 0.0])
    stated = measurement(uncertainty={"t20": [[0.3, 0.6], [0.4, NAN]]})
    assert t20.noise(stated) == pytest.approx([0.25, NAN], nan_ok=True)


def test_t20_of_a_measurement():
    bands = np.array([500.0, 1000.0])
    wanted = Matched.time(np.array([1.0, 1.0]), "T20")
    assert simulated_time(measurement(), bands, wanted, []) == pytest.approx([2.0, 3.0])
    lacking = measurement(values={"t20": [[1.0, 2.0], [3.0, NAN]]})
    with pytest.raises(rt.errors.DataError, match=r"T20\[S to R2, 1000 Hz\] is missing"):
        simulated_time(lacking, bands, wanted, [])
    earlier = [step([1.0, 1.0], [1.0, 1.0])]
    t20 = simulated_time(lacking, bands, wanted, earlier)
    assert t20 == pytest.approx([2.0, NAN], nan_ok=True)
    # An earlier step that lacked it too does not help.
    with pytest.raises(rt.errors.DataError, match="1000 Hz"):
        simulated_time(lacking, bands, wanted, [step([1.0, 1.0], [1.0, NAN])])
    # A band without a measured T may lack it; all measured bands may not.
    unmeasured = Matched.time(np.array([1.0, NAN]), "T20")
    assert simulated_time(lacking, bands, unmeasured, []) == pytest.approx([2.0, 2.0])
    none = measurement(values={"t20": [[NAN, 2.0], [3.0, NAN]]})
    with pytest.raises(rt.errors.DataError, match=r"S to R1, 500 Hz"):
        simulated_time(none, bands, wanted, earlier)
    with pytest.raises(rt.errors.DataError, match="the room has 2 bands, 1000 to 2000 Hz"):
        simulated_time(measurement(), bands * 2, wanted, [])
    with pytest.raises(rt.errors.DataError, match="no T20"):
        simulated_time(measurement(values={"t30": [[1.0, 2.0], [3.0, 4.0]]}), bands, wanted, [])


def test_the_noise_of_a_compromise_adds_the_shares_of_both():
    """T20 and EDT come from the same paths, so their errors are not taken as independent."""
    values = {"t20": [[2.0, 2.0]], "edt": [[1.0, NAN]]}
    errors = {"t20": [[0.2, 0.2]], "edt": [[0.05, NAN]]}
    pairs = [("S", "R1")]
    simulated = measurement(values=values, uncertainty=errors, pairs=pairs)
    both = Matched(
        measured={"t20": np.array([2.0, 2.0]), "edt": np.array([2.0, NAN])},
        shares={"t20": np.array([0.75, 1.0]), "edt": np.array([0.25, 0.0])},
    )
    assert both.wanted == pytest.approx([2.0, 2.0])
    time = 2**0.75
    relative = 0.75 * 0.1 + 0.25 * 0.05
    assert both.noise(simulated) == pytest.approx([time * relative, 0.2])
