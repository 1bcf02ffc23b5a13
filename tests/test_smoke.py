"""A few tests that show an installed wheel works; they need nothing but the required libraries."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt

pytestmark = pytest.mark.smoke


@pytest.mark.parametrize("solver", ["clarabel", "osqp"])
@pytest.mark.parametrize("method", ["mle", "lse"])
def test_real_room_is_matched_and_equals_the_closed_form(solver, method):
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured, method=method, solver=solver)
    sigma = room.sigma if method == "mle" else np.ones_like(room.sigma)
    oracle = rt.exact.maximum_likelihood(room.alpha, sigma, room.areas, result.target)
    np.testing.assert_allclose(result.alpha, oracle, rtol=0, atol=1e-10)
    np.testing.assert_allclose(result.reverberation_time_after, result.measured, rtol=1e-9)
    assert result.certificate.worst < 1e-12


def test_command_prints_json():
    folder = rt.datasets.path("bras_cr2")
    command = [sys.executable, "-m", "rtcal", "calibrate", "--json"]
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


def test_file_round_trip(tmp_path):
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
        reread.reverberation_time_uncertainty, measured.reverberation_time_uncertainty
    )
    with pytest.raises(rt.errors.DataError, match="already calibrated on these data"):
        rt.calibrate(again, measured)


def long(*values):
    """A process that imports a solver takes more than a second; other tests call the command itself."""
    return pytest.param(*values, marks=pytest.mark.long)


CALIBRATE = ["calibrate", "room.toml", "measured.csv"]


def fails_with(error):
    """Return code after which calibration raises ``error``: no input makes a solver fail at will."""
    return f"""
import rtcal.calibration.methods as methods
from rtcal.support.errors import SolverError

def calibrate(*_, **__):
    raise {error}

methods.calibrate = calibrate
"""


NOTHING_TO_ADD = """
from rtcal.command import finder as commands
from types import SimpleNamespace
from rtcal.report import of_finding

commands.saved = lambda _: (SimpleNamespace(kind="means"), None)
of_finding.correct = lambda *_, **__: ("nothing to add", {}, {})
"""


@pytest.mark.parametrize(
    ("code", "setting", "arguments", "said"),
    [
        long(0, "", CALIBRATE, ""),
        (2, "", [], "Usage: rtcal"),
        long(2, "", ["nonsense"], "rtcal: No such command"),
        long(2, "", ["loop"], "Usage: rtcal loop"),
        long(2, "", ["calibrate", "room.toml"], "rtcal: Missing argument"),
        long(2, "", ["calibrate", "room.toml", "none.csv"], "rtcal: none.csv: no such file"),
        (3, fails_with("SolverError('no values')"), CALIBRATE, "no values"),
        long(
            4, "import sys; sys.modules['jinja2'] = None", ["report", "calibrated"], "rtcal[report]"
        ),
        long(6, NOTHING_TO_ADD, ["apply", "case.toml", "--out", "c"], ""),
        long(130, fails_with("KeyboardInterrupt"), CALIBRATE, ""),
    ],
)
def test_each_exit_code(tmp_path, code, setting, arguments, said):
    done = command(tmp_path, arguments, setting, stdout=subprocess.PIPE)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no full device")
def test_exit_code_of_a_full_output(tmp_path):
    with open("/dev/full", "w") as full:
        done = command(tmp_path, ["example", "room"], "", stdout=full)
    assert (done.returncode, done.stderr) == (5, "rtcal: cannot print: No space left on device\n")


def command(folder, arguments, setting, **streams):
    """Run the command in a folder with a room, a measurement and a calibration."""
    room, measured = rt.datasets.bras_cr2()
    room.save(folder / "room.toml")
    measured.save(folder / "measured.csv")
    (folder / "calibrated").mkdir()
    (folder / "calibrated" / "result.json").write_text(
        rt.calibrate(room, measured).to_json(), encoding="utf-8"
    )
    code = f"{setting}\nfrom rtcal.command.main import main\nmain({arguments!r})"
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        **streams,
    )
