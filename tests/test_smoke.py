"""A few tests that show an installed wheel works; they need nothing but the required libraries."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import rtcal as rt

pytestmark = pytest.mark.smoke


@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
@pytest.mark.parametrize("method", ["mle", "lse"])
def test_real_room_is_matched_and_equals_the_closed_form(solver: str, method: str) -> None:
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured, method=method, solver=solver)
    sigma = room.sigma if method == "mle" else np.ones_like(room.sigma)
    oracle = rt.closed_form.maximum_likelihood(room.alpha, sigma, room.areas, result.target)
    np.testing.assert_allclose(result.alpha, oracle, rtol=0, atol=1e-10)
    np.testing.assert_allclose(result.reverberation_time_after, result.measured, rtol=1e-9)
    assert result.certificate.worst < 1e-12


def test_command_prints_json() -> None:
    folder = rt.datasets.path("bras_cr2")
    command = [sys.executable, "-m", "rtcal.command.main", "calibrate", "--json"]
    done = subprocess.run(
        [*command, str(folder / "room.toml"), str(folder / "measured.csv")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert content["plausibility"]["degrees_of_freedom"] == 6
    assert max(abs(g) for g in content["gap_after_jnd"]) < 1e-9
    assert max(abs(g) for g in content["gap_before_jnd"]) > 10


def test_file_round_trip(tmp_path) -> None:
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured)
    result.room.save(tmp_path / "room.toml")
    measured.save(tmp_path / "measured.csv")
    again = rt.Room.from_file(tmp_path / "room.toml")
    np.testing.assert_array_equal(again.alpha, result.alpha)
    np.testing.assert_array_equal(again.sigma, result.posterior_sigma)
    reread = rt.Measurement.from_file(tmp_path / "measured.csv")
    np.testing.assert_array_equal(reread.values["t30"], measured.values["t30"])
    np.testing.assert_array_equal(
        reread.decay_time().uncertainty, measured.decay_time().uncertainty
    )
    with pytest.raises(rt.errors.DataError, match="already calibrated on exactly these data"):
        rt.calibrate(again, measured)
