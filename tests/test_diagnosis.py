"""A diagnosis says what `find`, `verify`, `apply` and the calibration say, in one result."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.diagnosis import Diagnosis
from rtcal.finder.means.recalibration import plain
from rtcal.loop.positions import PositionsResult
from rtcal.report.of_diagnosis import contents, steps
from tests.conftest import run
from tests.test_discrepancy import controls_of

FEW = ("noise floor", "opening", "volume")


@pytest.fixture(scope="module")
def named():
    case = rt.datasets.hidden_room("identified")[0]
    return rt.diagnose(case, only=FEW, controls=controls_of(case))


def test_it_is_what_the_single_steps_give(named):
    case = named.finding.case
    finding = rt.find(case, only=FEW, controls=controls_of(case))
    verified, truth = rt.finder.verify(finding), rt.datasets.hidden_room("identified")[1]
    assert finding.effect == named.finding.effect == truth["hidden"]
    assert named.verification.after == verified.after < 0.5 * verified.before
    applied = finding.apply()
    assert named.corrected.room.to_dict() == applied.room.to_dict()
    assert [line.split()[1] for line in steps(named).splitlines()] == ["find", "verify", "apply"]
    assert np.array_equal(named.calibrated.alpha, verified.corrected.alpha)
    assert np.array_equal(named.room.alpha[: len(named.calibrated.alpha)], named.calibrated.alpha)


def test_its_commands_carry_the_options_that_were_given():
    options = ("--match", "t20", "--scattering", "0.2", "--paths", "2000", "--seed", "1")
    fitted = Diagnosis(
        finding=SimpleNamespace(can_be_added=False),
        verification=None,
        calibrated=object.__new__(PositionsResult),
        given=("room.toml", "pairs.csv"),
        options=options,
    )
    assert [line.split(" --out ")[0] for line in steps(fitted).splitlines()] == [
        f"rtcal {command} room.toml pairs.csv {' '.join(options)}" for command in ("find", "fit")
    ]


def test_saved_it_prints_the_same(named, tmp_path):
    assert str(rt.load(named.save(tmp_path))) == str(named)


def test_its_room_has_the_warning_of_apply(named, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra report")
    monkeypatch.setattr("rtcal.report.verification_words.misses", lambda _: "Do not simulate.")
    written = contents(named, tmp_path)
    assert written[tmp_path / "room.toml"].startswith(b"# Do not simulate.\n")


@pytest.mark.long
def test_where_nothing_is_missing_the_model_is_calibrated_as_given(kept):
    case, _ = rt.datasets.hidden_room("not_identified")
    result = rt.diagnose(case, cache=kept)
    assert result.corrected is None
    assert result.verification is None
    assert np.array_equal(result.calibrated.alpha, plain(case).alpha)
    assert "Nothing is added to the model: " in str(result)
    assert steps(result).splitlines() == [
        "rtcal find room.toml measured.csv --out found",
        "rtcal calibrate room.toml measured.csv --out calibrated",
    ]


@pytest.mark.long
@pytest.mark.usefixtures("runs_kept")
def test_the_command_writes_one_folder_that_apply_and_report_read(
    kept, tmp_path, monkeypatch, capsys
):
    pytest.importorskip("matplotlib", reason="needs the extra report")
    monkeypatch.chdir(tmp_path)
    named = rt.diagnose(rt.datasets.hidden_room("identified")[0], cache=kept)
    named.finding.case.save("case.json")
    assert run("diagnose", "case.json", "--out", "out", "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["finding"]["named"] == list(named.finding.named)
    assert np.allclose(rt.Room.from_file("out/room.toml").alpha, named.room.alpha)
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert run("report", "out") == 0
    assert "The corrected model contains noise floor" in page
    assert "rtcal find case.json --out found" in page
    assert run("apply", "out", "--out", "again") == 0


@pytest.mark.long
def test_at_positions_the_corrected_model_is_fitted(tmp_path, kept):
    for name, content in rt.datasets.examples.example("diagnose").files.items():
        (tmp_path / name).write_bytes(content)
    room = rt.Room.from_file(str(tmp_path / "room.toml"))
    measured = rt.Measurement.from_file(str(tmp_path / "pairs.csv"))
    result = rt.diagnose(room, measured, tracing={"n_paths": 2000}, cache=kept)
    assert (result.finding.effect, result.finding.surface) == ("covered surface", "ceiling")
    assert isinstance(result.calibrated, PositionsResult)
    assert result.calibrated.prior.materials == result.corrected.room.materials
    as_stated, _, corrected = result.verification.by_seed.mean(axis=1)
    assert corrected < 0.5 * as_stated
