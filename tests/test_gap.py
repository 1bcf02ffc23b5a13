"""`rtcal gap` and the hidden rooms: commands, leak audit, stored findings."""

from __future__ import annotations

import gzip
import json
import multiprocessing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import rtcal as rt
from rtcal.cli import cli
from rtcal.discrepancy import Case, control_rooms, find, verify
from rtcal.discrepancy.engines import Controls

pytest.importorskip("numba", reason="the engines are compiled (extra fast)")

from tests.hidden_world import populations
from tests.hidden_world.generate import numbers, read

HERE = Path(__file__).parent / "hidden_world"
STORED = HERE / "population_1_findings.jsonl.gz"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's files: the room that ships, its first configuration."""
    case, _ = rt.datasets.hidden_room()
    path = tmp_path_factory.mktemp("case")
    case.room.save(str(path / "room.toml"))
    case.configurations[0].measured.save(str(path / "measured.csv"))
    (path / "case.toml").write_text(
        'room = "room.toml"\n[uncertainty]\ntime = 0.02\nlevel = 0.3\n'
        '[[configuration]]\nname = "as built"\nmeasured = "measured.csv"\n'
    )
    replace(case, configurations=case.configurations[:1]).save(str(path / "case.json"))
    (path / "plan.toml").write_text(
        'room = "room.toml"\n[[configuration]]\nname = "to do"\nparameters = ["t20", "edt"]\n'
    )
    return path


def run(*arguments: str) -> str:
    done = CliRunner().invoke(cli, ["gap", *arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_the_commands_find_add_and_prove(folder: Path) -> None:
    case = str(folder / "case.json")
    found = json.loads(run("find", case, "--json"))
    assert "opening" in found["candidates"]
    assert found["engines"] == ["path tracing", "network"]
    assert found["size"]["low"] < 39.6 < found["size"]["high"]  # the truth, datasets/hidden_room
    out = folder / "corrected.json"
    assert "Added" in run("apply", case, "--out", str(out))
    again = json.loads(run("find", str(out), "--json"))
    assert again["verdict"] in ("none", "hint")
    assert again["score"] < 0.2 * found["score"]
    assert "what alpha cannot absorb" in run("verify", case)
    assert run("find", case, "--quiet") == ""


def test_the_report_is_written_whole(folder: Path) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra report")
    pytest.importorskip("jinja2", reason="needs the extra report")
    run("report", str(folder / "case.toml"), "--out", str(folder / "out"))
    names = {p.name for p in (folder / "out").iterdir()}
    assert {"finding.json", "report.html", "evidence.png", "residuals.png", "decay.png",
            "reverberation_time.png", "shifts.png"} == names  # fmt: skip
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "opening" in page
    assert len(page) < 2_000_000
    record = json.loads((folder / "out" / "finding.json").read_text(encoding="utf-8"))
    assert record["verification"]["gaps"]


def test_a_plan_needs_no_measurement(folder: Path) -> None:
    assert "Cannot be told apart" in run("plan", str(folder / "plan.toml"))
    with pytest.raises(rt.errors.DataError, match="can only be planned"):
        run("find", str(folder / "plan.toml"))


def test_a_room_s_case_holds_nothing_of_the_truth() -> None:
    for case in read(1, "case"):
        assert set(case) == {"room", "equation", "uncertainty", "configurations"}
        assert set(case["room"]) == {
            "volume", "centre_frequencies", "materials", "areas", "alpha", "sigma",
            "band_correlation", "facing", "air",
        }  # fmt: skip
        text = json.dumps(case)
        for name in set(populations.KINDS.values()) - {
            "air",
            "area",
            "volume",
        }:  # a room's own words
            assert name not in text
    for path in HERE.glob("*.gz"):
        assert not any(name in path.name for name in populations.KINDS.values())


def test_the_truth_that_no_user_knows_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Renaming every kind, and moving what is only noted down, leaves the case byte for byte."""
    seed = (1, 2, 0)
    whole = populations.build(*seed)
    real = populations.make

    def renamed(*numbers: int) -> populations.Hidden:
        h = real(*numbers)
        h.truth = [{"kind": 99, "size": -1.0}]
        return h

    monkeypatch.setattr(populations, "make", renamed)
    other = populations.build(*seed)
    assert json.dumps(other["case"]) == json.dumps(whole["case"])
    assert other["truth"]["effects"] != whole["truth"]["effects"]
    assert whole["case"] == read(1, "case")[numbers(1).index(seed)]  # and the frozen one is this


def test_counts_are_what_was_asked_for() -> None:
    kinds = [k for _, k, _ in numbers(1)]
    assert kinds.count(0) >= 203
    assert all(kinds.count(k) >= 25 for k in range(1, 14))
    assert len(read(1, "case")) == len(kinds) == len(read(1, "truth"))


def stored() -> list[dict[str, Any]]:
    return [json.loads(x) for x in gzip.decompress(STORED.read_bytes()).splitlines()]


def differences(index: int) -> list[str]:
    """What comes out otherwise than stored, of a room of population 1 with T20, EDT, T30."""
    case, stored_ = Case.from_dict(read(1, "case")[index]), stored()[index]["one"]
    one = case.only("t20", "edt", "t30", configurations=[case.configurations[0].name])
    # As the stored run has it: one configuration is judged by its part of the whole case's rooms.
    finding = find(one, controls=[Controls(c.engine, c.errors[:, :1]) for c in control_rooms(case)])
    # The control rooms were kept in single precision.
    near = {
        "threshold": finding.threshold == pytest.approx(stored_["threshold"], rel=0.02),
        "verdict": finding.verdict == stored_["verdict"],
        "candidates": list(finding.candidates) == stored_["candidates"],
    } | {
        name: finding.evidence[name] == pytest.approx(value, rel=0.02, abs=0.1)
        for name, value in stored_["evidence"].items() if value > -20
    }  # fmt: skip
    if "rmse" in stored_:
        truth = read(1, "truth")[index]
        area = np.array(truth["areas"])[:, None]
        off = verify(finding).corrected.alpha - np.array(truth["alpha"])
        error = np.sqrt((area * off**2).sum() / area.sum() / off.shape[1])
        near["rmse"] = error == pytest.approx(stored_["rmse"][2], rel=0.03)
    return [name for name, is_so in near.items() if not is_so]


@pytest.mark.parametrize("seed", [(1, 0, 7), (1, 2, 3), (1, 11, 5)])
def test_stored_findings_are_found_again(seed: tuple[int, int, int]) -> None:
    assert differences(numbers(1).index(seed)) == []


@pytest.mark.study
def test_the_whole_population_is_as_published() -> None:
    """All stored findings anew, an hour on two cores; and no more false alarms than 5 %."""
    rows = stored()
    controls = [r["one"]["verdict"] for r in rows if r["kind"] == 0]
    flagged = [v in ("named", "ambiguous", "unknown") for v in controls]
    assert np.mean(flagged) <= 0.05
    with multiprocessing.Pool() as pool:
        changed = {i: d for i, d in enumerate(pool.imap(differences, range(len(rows)))) if d}
    # On another processor a path of a control room may part from its twin in the last digit.
    assert len(changed) <= 0.01 * len(rows), changed
