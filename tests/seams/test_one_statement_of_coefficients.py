"""Calibrate and find state once what coefficients are off by, alone and together."""

import numpy as np
import pytest
from scipy import stats

import rtcal as rt
from rtcal.acoustics.marks import agreement
from rtcal.finder import Case, Configuration
from rtcal.finder.evidence import directions
from tests.conftest import room_of


def test_the_p_value_beside_the_first_has_the_errors_that_gap_find_assumes():
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured)
    case = Case(room=room, configurations=[Configuration(name="as built", measured=measured)])
    errors = directions(case)
    together = np.einsum("m,dmb->db", room.areas, errors[0])
    covariance = np.diag((room.areas[:, None] * room.sigma).T @ (room.areas[:, None] * room.sigma))
    deviation, stated = result.joint.innovation
    assert (np.diag(stated) >= covariance).all()  # and the uncertainty of T
    q = deviation @ np.linalg.solve(stated + together.T @ together, deviation)
    found = result.plausibility
    assert found.p_together == pytest.approx(stats.chi2.sf(q, room.n_bands), rel=1e-9)
    assert found.p_together > 100 * found.p_value


def test_what_errors_in_common_explain_is_no_contradiction():
    """Every coefficient is 20 % too small: improbable one by one, and usual of a handbook."""
    alpha, areas = (0.1, 0.2, 0.15, 0.1, 0.3, 0.25), (60, 60, 70, 70, 80, 80)
    handbook = {n: (s, a, 0.3 * a) for n, s, a in zip("abcdef", areas, alpha, strict=True)}
    room = room_of(handbook, 125 * 2.0 ** np.arange(6), 500, air=rt.Air())
    times = rt.Eyring().time(room, 1.25 * room.absorption_area)
    found = rt.calibrate(room, times).plausibility
    assert agreement(found.p_value) == "contradicts"
    assert agreement(found.p_value, found.p_together) == "agrees"
