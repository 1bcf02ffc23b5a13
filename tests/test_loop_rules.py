"""The closed loop's arithmetic by hand: rules, goals, statuses, limits, next targets."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.loop import closed as rules
from rtcal.loop.closed import Matched, Step
from tests.conftest import measurement_of, room_of

LOW, HIGH, NAN = 0.01, 100.0, np.nan


def after(rule, points, wanted, low=LOW, high=HIGH):
    """The rule's next target rate after points (target, rate)."""
    targets, rates = np.array(points, dtype=float).T
    return rules.RULES[rule](targets, rates, wanted, low, high)


SLOPE = np.log(4) / np.log(6)
THIRD = 1.5 - (1.8 - 2.0) * (1.5 - 2.0) / (1.8 - 2.5)  # Eq. 40


@pytest.mark.parametrize(
    ("rule", "points", "wanted", "limits", "expected"),
    [
        # Eqs. 38 to 40 of the paper: the last two points count, and a target may be below 0.
        ("secant", [(2.0, 2.5)], 2.0, {}, 2.0 * (1 - (2.5 - 2.0) / 2.0)),
        ("secant", [(2.0, 2.5), (1.5, 1.8)], 2.0, {}, THIRD),
        ("secant", [(9.0, 9.0), (2.0, 2.5), (1.5, 1.8)], 2.0, {}, THIRD),
        ("secant", [(2.0, 5.0)], 2.0, {}, -1.0),
        ("secant", [(2.0, 3.0), (1.5, 3.0)], 2.0, {}, 1.5),
        # The first step takes the rate to be proportional, and so does a target simulated twice.
        ("safeguarded", [(2.0, 2.5)], 2.0, {}, 2.0 * 2.0 / 2.5),
        ("safeguarded", [(2.0, 1.8)], 2.5, {}, 2.0 * 2.5 / 1.8),
        ("safeguarded", [(2.0, 2.4), (2.0, 2.5)], 2.2, {}, 2.0 * 2.2 / 2.5),
        # 1 is too low, 3.9 and 4 are too high, and the slope leads below 1: the middle; its mirror.
        ("safeguarded", [(1.0, 0.5), (4.0, 3.0), (3.9, 2.99)], 1.9, {}, np.sqrt(1.0 * 3.9)),
        ("safeguarded", [(4.0, 8.0), (1.0, 1.0), (1.02, 1.003)], 1.9, {}, np.sqrt(1.02 * 4.0)),
        # A step within the bracket is kept.
        ("safeguarded", [(1.0, 0.5), (4.0, 3.0)], 1.9, {}, 4 * (1.9 / 3) ** SLOPE),
        # Points at the wanted rate are no ends of the bracket; one that contradicts itself is ignored.
        ("safeguarded", [(1.0, 2.0), (3.0, 4.0)], 2.0, {"low": 0.5}, 1.0),
        ("safeguarded", [(2.0, 1.9), (2.0, 2.1)], 2.0, {}, 2.0 * 2.0 / 2.1),
        ("safeguarded", [(1.0, 3.0), (2.0, 1.0)], 1.5, {}, 2.0 * 1.5 ** (1 / 0.3)),
        # The range of the equation cuts a step, also to its very end.
        ("safeguarded", [(1.0, 10.0)], 1.0, {"low": 0.5}, 0.5),
        ("safeguarded", [(1.0, 0.1)], 1.0, {"high": 3.0}, 3.0),
        ("safeguarded", [(1.0, 2.0), (0.9, 1.95)], 1.2, {}, 0.9 * (1.2 / 1.95) ** (1 / 0.3)),
        ("safeguarded", [(1.0, 2.0), (0.9, 1.95)], 1.2, {"low": 0.3}, 0.3),
        ("safeguarded", [(2.0, 4.0)], 2.0, {"low": 1.0}, 1.0),
        ("safeguarded", [(2.0, 1.0)], 2.0, {"high": 4.0}, 4.0),
    ],
)
def test_the_next_target_of_a_rule(rule, points, wanted, limits, expected):
    assert after(rule, points, wanted, **limits) == pytest.approx(expected, rel=1e-12)


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
    assert next_time("secant", [(2.0, 0.9)], 2.0, longest=5.0) == pytest.approx(4.0)  # below 0
    assert next_time("secant", [(2.0, 1.0)], 2.0, longest=5.0) == pytest.approx(4.0)  # 0
    assert next_time("secant", [(9.0, 0.9)], 2.0, longest=5.0) == pytest.approx(5.0)  # and cut
    assert next_time("safeguarded", [(2.0, 2.5)], 2.0, longest=1.5) == pytest.approx(1.5)


def test_a_loops_goal_is_in_jnd_of_the_measured_time(cr2):
    """A noise of 2 % of the measured T is 0.4 JND; the simulated T has no part in it."""
    room, measured = cr2
    wanted = measured.mean("t30")
    share = np.array([0.0, 0.01, 0.02, 0.03, 0.1, np.nan])
    for tolerance in (1.0, 2.0):
        loop = rt.loop.start(room, measured, tolerance=tolerance)
        simulated = measurement_of(
            room.centre_frequencies,
            [("S", f"R{i}") for i in range(4)],
            u={"t20": np.tile(2 * share * wanted, (4, 1))},
            t20=np.tile(3 * wanted, (4, 1)),
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
    simulated = measurement_of(
        room.centre_frequencies, u={"t20": [0.05 * noise * wanted]}, t20=[wanted * (1 + 0.05 * gap)]
    )
    loop = loop.record(loop.next_alpha, simulated)
    done, on = "converged", "not converging"
    assert loop.status == (done, on, done, on, done, done)
    assert not loop.finished
    # Bands that converged with a gap above half their goal go on with the others.
    moved = loop.next_target != loop.steps[0].target
    assert moved.tolist() == [True, True, True, True, True, False]


def t20_alone(times):
    """The measured T20 alone is matched."""
    return Matched(measured={"t20": times}, shares={"t20": np.ones(len(times))})


def loop_of(targets, simulated, wanted=(2.0,), alpha=None, room=None, **fields):
    """A loop after steps with these targets and T in s, one row per step and one column per band."""
    targets, simulated = np.array(targets, dtype=float), np.array(simulated, dtype=float)
    room = room or hall(targets.shape[1])
    if alpha is None:
        alpha = np.broadcast_to(room.alpha, (len(targets), *room.alpha.shape))
    return rt.loop.Loop(
        prior=room,
        matched=t20_alone(np.array(wanted)),
        data="",
        rule="safeguarded",
        equation=rt.Sabine(speed_of_sound=343),
        steps=tuple(
            Step(target=t, alpha=a, simulated=s, noise=np.zeros(len(t)))
            for t, a, s in zip(targets, alpha, simulated, strict=True)
        ),
        **fields,
    )


def hall(n_bands=1, **changes):
    """Volume 100 m³, two materials of 30 and 70 m², no air."""
    materials = {"a": (30, 0.2, 0.1), "b": (70, 0.1, 0.1)}
    return room_of(materials, [250, 500, 1000, 2000][:n_bands], **changes)


K = 24 * np.log(10) * 100 / 343
"""T in s of 1 m² in the hall."""


@pytest.mark.parametrize(
    ("room", "equation", "areas"),
    [
        (hall(), rt.Sabine(343), (99.9, 0.1)),
        (hall(alpha_min=[[0.1], [0.05]]), rt.Sabine(343), (99.9, 6.5 + 0.001 * 93.5)),
        (hall(sigma=[[0.0], [0.1]]), rt.Sabine(343), (6 + 0.999 * 70, 6 + 0.001 * 70)),
        (hall(), rt.Kuttruff(343), (0.999 * rt.Kuttruff().largest_mean * 100, 0.1)),
    ],
)
def test_targets_keep_a_thousandth_from_the_bounds(room, equation, areas):
    shortest, longest = (equation.time(room, np.array([area]))[0] for area in areas)
    base = loop_of([[1.0]], [[1.0]], wanted=[1.0], room=room)
    for simulated, end in ((100.0, shortest), (0.001, longest)):
        step = Step(
            target=np.ones(1), alpha=room.alpha, simulated=np.array([simulated]), noise=np.zeros(1)
        )
        loop = rt.loop.Loop(**{**vars_of(base), "equation": equation, "steps": (step,)})
        assert loop.next_target == pytest.approx([end])


def vars_of(loop):
    return {n: getattr(loop, n) for n in ("prior", "matched", "data", "rule")}


def status(gap, target=1.0, **fields):
    """The status of one band whose simulated T is ``gap`` JND too long."""
    return loop_of([[target]], [[2.0 * (1 + 0.05 * gap)]], **fields).status[0]


def test_statuses_of_a_band():
    shortest, longest = K / 99.9, K / 0.1
    assert status(3.0) == status(NAN) == "not converging"
    assert status(0.9999) == status(-0.9999) == "converged"
    assert status(1.0001) == status(-1.0001) == "not converging"
    assert status(1.4, tolerance=1.5) == "converged"
    # At the limit that would help, or within rounding of it, and beyond it:
    for target in (shortest, shortest * (1 + 1e-10), 0.8 * shortest):
        assert status(3.0, target) == "unreachable"
        assert status(-3.0, target) == "not converging"
        assert status(0.5, target) == "converged"
    for target in (longest, longest * (1 - 1e-10), 1.2 * longest):
        assert status(-3.0, target) == "unreachable"
        assert status(3.0, target) == "not converging"
    for target in (shortest * (1 + 1e-6), longest * (1 - 1e-6)):
        assert status(3.0, target) == status(-3.0, target) == "not converging"
    assert loop_of([[NAN]], [[2.0]], wanted=[NAN]).status == ("no measured T",)


def test_a_confirmation_is_within_tolerance_and_noise(cr2):
    room, measured = cr2
    wanted = measured.mean("t30")
    loop = rt.loop.start(room, measured)

    def means(gap, noise):
        return measurement_of(
            room.centre_frequencies,
            u={"t20": [0.05 * np.array(noise) * wanted]},
            t20=[wanted * (1 + 0.05 * np.array(gap))],
        )

    loop = loop.record(loop.next_alpha, means([0.0, 0.0, 0.0, 0.0, 0.0, 9.0], np.zeros(6)))
    yes, no = "converged", "not confirmed"

    def confirmed(gap, noise):
        return replace(loop, confirmation=means(gap, noise)).status

    assert confirmed([0.99, 1.29, 1.31, -1.31, 0.0, 9.0], [0.0, 0.3, 0.3, 0.3, 0.99, 0.0]) == (
        *(yes, yes, no, no, yes),
        "not converging",
    )
    assert confirmed([0.0] * 6, [1.01, NAN, 0, 0, 0, 0])[:3] == (no, no, yes)


def test_a_band_is_stuck_that_has_one_time_for_three_coefficients():
    alpha = np.arange(12.0).reshape(3, 2, 2) / 12
    simulated = np.array([[1.0, 1.0], [1.0, 1.5], [1.0, 1.0]])

    def stuck(alpha, simulated):
        targets = np.ones_like(simulated) * np.arange(1, len(simulated) + 1)[:, np.newaxis]
        loop = loop_of(targets, simulated, wanted=[2.0, 2.0], alpha=alpha)
        return [status == "unreachable" for status in loop.status]

    assert stuck(alpha, simulated) == [True, False]
    assert stuck(alpha[:2], simulated[:2]) == [False, False]
    # What came before does not count.
    earlier = np.concatenate([[[1.2, 1.2]], simulated])
    assert stuck(np.concatenate([alpha[:1] / 2, alpha]), earlier) == [True, False]
    # The same coefficients in any two steps tell nothing; one material that changed tells.
    for step in (1, 2):
        same = alpha.copy()
        same[step, :, 0] = same[step - 1, :, 0]
        assert stuck(same, simulated) == [False, False]
    one = np.zeros((3, 2, 2))
    one[:, 1, 0] = [0.1, 0.2, 0.3]
    assert stuck(one, simulated) == [True, False]


@pytest.mark.parametrize(
    ("targets", "simulated", "expected"),
    [
        # 1.6 s is asked for; halfway to 0.4, without a T20, is 0.89: not beyond. To 1.5 it is.
        ([2.0, 0.4], [2.5, NAN], 1.6),
        ([2.0, 1.5], [2.5, NAN], np.sqrt(2.0 * 1.5)),
        # Towards longer times, too; and away from the target without a T20 it is free.
        ([2.0, 2.3], [1.5, NAN], np.sqrt(2.0 * 2.3)),
        ([2.0, 1.5], [1.5, NAN], 2.0 * 2.0 / 1.5),
        # The nearest by ratio, not by difference: 1.1 and 3.2 from 2.
        ([2.0, 1.1, 3.2], [1.2, NAN, NAN], np.sqrt(2.0 * 3.2)),
        # Once targets with and without a T20 are within 10 %, the band is given up and stays.
        ([2.0, 1.83], [2.5, NAN], 2.0),
        # A band without any T20 takes the equation's time for the prior.
        ([2.0], [NAN], K / 13),
    ],
)
def test_the_next_target_keeps_from_those_without_a_t20(targets, simulated, expected):
    loop = loop_of(np.array([targets]).T, np.array([simulated]).T)
    assert loop.next_target == pytest.approx([expected])


def measurement(**changes):
    values = {
        "centre_frequencies": [500, 1000],
        "values": {"t20": [[1.0, 2.0], [3.0, 4.0]]},
        "pairs": [("S", "R1"), ("S", "R2")],
    }
    return rt.Measurement(**(values | changes))


NONE = {"t20": [[NAN, 2.0], [3.0, NAN]]}
LACKING = {"t20": [[1.0, 2.0], [3.0, NAN]]}
BEFORE, HALF = [[1.2, 1.2]], [[1.2, NAN]]


@pytest.mark.parametrize(
    ("changes", "steps", "wanted", "expected"),
    [
        ({}, [], [1.0, 1.0], [2.0, 3.0]),
        ({"values": LACKING}, BEFORE, [1.0, 1.0], [2.0, NAN]),
        # A band without a measured T may lack it; not all measured bands, nor one at first.
        ({"values": LACKING}, [], [1.0, NAN], [2.0, 2.0]),
        ({"values": LACKING}, [], [1.0, 1.0], "T20 at S to R2, 1000 Hz is missing"),
        ({"values": LACKING}, HALF, [1.0, 1.0], "1000 Hz"),
        ({"values": NONE}, BEFORE, [1.0, 1.0], "S to R1, 500 Hz"),
        ({"centre_frequencies": [1000, 2000]}, [], [1.0, 1.0], "the room has 2 bands"),
        ({"values": {"t30": [[1.0, 2.0], [3.0, 4.0]]}}, [], [1.0, 1.0], "no T20"),
    ],
)
def test_t20_of_a_simulation(changes, steps, wanted, expected):
    room = hall(2, centre_frequencies=[500, 1000])
    loop = loop_of(np.ones((len(steps), 2)), np.reshape(steps, (-1, 2)), wanted, room=room)
    if isinstance(expected, str):
        with pytest.raises(rt.errors.DataError, match=expected):
            loop.record(room.alpha, measurement(**changes))
    else:
        step = loop.record(room.alpha, measurement(**changes)).steps[-1]
        assert step.simulated == pytest.approx(expected, nan_ok=True)


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
