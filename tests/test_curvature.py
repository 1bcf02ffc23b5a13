"""Bent decays: flagged where they are, and not where the decay is straight."""

from __future__ import annotations

import numpy as np

import rtcal as rt
from rtcal.acoustics import observables
from rtcal.acoustics.marks import bent_decays


def test_the_double_slope_of_the_issue_is_bent() -> None:
    measured = rt.Measurement.from_values(
        [500, 1000], edt=[0.72, 0.42], t20=[0.73, 0.73], t30=[0.74, 1.01]
    )
    (bent,) = bent_decays(measured)
    assert bent.frequency == 1000
    assert bent.text == "the decay is curved, curvature T30/T20 - 1 = +38 %, EDT/T20 - 1 = -42 %"


def test_only_positions_with_both_parameters_count() -> None:
    measured = rt.Measurement(
        centre_frequencies=np.array([1000.0]),
        pairs=[("S1", "R1"), ("S1", "R2")],
        values={"t20": np.array([[1.0], [np.nan]]), "t30": np.array([[1.0], [3.0]])},
    )
    assert bent_decays(measured) == ()


def test_straight_decays_are_seldom_flagged() -> None:
    """Two standard deviations of a ratio beyond its limit: less than 2 % of straight decays."""
    rng = np.random.default_rng(3)
    time, width, n_rooms = 1.0, 88, 1500  # the octave of 125 Hz, one position
    t = np.arange(int(1.6 * width)) / width
    energy = rng.exponential(1, (n_rooms, len(t))) * 10 ** (-6 * t / time)
    times = observables.parameters(energy, 1 / width, ("edt", "t20", "t30"))
    n_bent = sum(
        bool(
            bent_decays(rt.Measurement.from_values([125], **{p: [v[i]] for p, v in times.items()}))
        )
        for i in range(n_rooms)
    )
    assert n_bent / n_rooms < 0.02
