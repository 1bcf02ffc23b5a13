"""`rtcal find`, its kin and the hidden rooms: commands, leak audit, stored findings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import rtcal as rt
from rtcal.command.finder import read_case
from rtcal.command.main import cli
from rtcal.finder import Case, Finding, verify
from rtcal.finder.claim import Size
from rtcal.finder.means.engines import FOLDER
from rtcal.finder.search import find
from rtcal.finder.verification import Miss, Verification, of_means
from tests.conftest import candidates_of
from tests.test_discrepancy import controls_of

pytestmark = pytest.mark.usefixtures("runs_kept")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, kept: Path) -> Path:
    """A user's files: the room that ships, its first configuration."""
    case, _ = rt.datasets.hidden_room()
    path = tmp_path_factory.mktemp("case")
    (path / FOLDER).symlink_to(kept)
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
    done = CliRunner().invoke(cli, [*arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.mark.long
def test_the_commands_find_add_and_prove(folder: Path) -> None:
    case = str(folder / "case.json")
    found = json.loads(run("find", case, "--json"))
    by_name = {c["effect"]: c for c in found["candidates"]}
    assert found["family"] == "added absorption"
    assert sum(found["probabilities"].values()) == pytest.approx(1)
    assert found["engines"] == ["path tracing", "image sources"]
    # The truth, datasets/hidden_room. Every candidate is shown with its size.
    assert by_name["opening"]["low"] < 39.6 < by_name["opening"]["high"]
    out, saved = folder / "corrected", str(folder / "found.json")
    run("find", case, "--out", saved, "--quiet")
    assert f"The corrected model contains {found['candidates'][0]['effect']} (" in run(
        "apply", saved, "--out", str(out)
    )
    for name in ("app.json", "app.toml"):
        refused = CliRunner().invoke(cli, ["apply", saved, "--out", str(folder / name)])
        assert isinstance(refused.exception, rt.errors.DataError)
        assert f"Give a folder, such as --out {folder / 'app'}" in str(refused.exception)
        assert not (folder / name).exists()
    again = json.loads(run("find", str(out / "case.json"), "--json"))
    assert again["verdict"] in ("none", "hint")
    assert again["score"] < 0.2 * found["score"]
    assert "all that was held out" in run("verify", saved)
    assert run("find", case, "--quiet") == ""


@pytest.mark.parametrize(
    ("read", "command"),
    [
        ("out/report.html", ["find", "--out", "out"]),
        ("out/result.json", ["find", "--out", "out/result.json"]),
    ],
)
def test_nothing_is_written_over_what_was_read(
    folder: Path, tmp_path: Path, read: str, command: list[str]
) -> None:
    text = (folder / "case.toml").read_text()
    if read.startswith("out/"):  # a report's own name, for a measurement
        text = text.replace("measured.csv", read)
        (tmp_path / "out").mkdir()
        (tmp_path / read).write_bytes((folder / "measured.csv").read_bytes())
    for name in ("room.toml", "measured.csv"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "case.toml").write_text(text)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    name, *options = [str(tmp_path / x) if "." in x or x == "out" else x for x in command]
    with pytest.raises(rt.errors.DataError, match="would overwrite"):
        run(name, str(tmp_path / "case.toml"), *options)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_a_room_and_its_measurement_are_a_case(folder: Path, tmp_path: Path) -> None:
    """One configuration needed a third file, which named the other two."""
    room, measured = str(folder / "room.toml"), str(folder / "measured.csv")
    (tmp_path / "case.toml").write_text(
        f'room = "{room}"\n[[configuration]]\nname = "as measured"\nmeasured = "{measured}"\n'
    )
    stated = Case.from_file(str(tmp_path / "case.toml"))
    assert read_case({"case": room, "measured": measured}).to_dict() == stated.to_dict()
    with pytest.raises(
        rt.errors.DataError, match=r"--paths needs positions: a room with \[sources\]"
    ):
        run("find", room, measured, "--paths", "100")


@pytest.fixture(scope="module")
def finding(folder: Path) -> Finding:
    case = Case.from_file(str(folder / "case.json"))
    return find(case, only=["opening", "area"], controls=controls_of(case))


def unsure(finding: Finding) -> Finding:
    """The same, where a material's area explains the data best and the opening hardly less."""
    area, opening = candidates_of("area", "opening")
    size = Size(1.4, 1.2, 1.6, "of the input area").fields
    area = replace(area, parameters={"material": 1.0, "ratio": 1.4}, **size)
    return replace(
        finding,
        verdict="ambiguous",
        family=None,
        named=(),
        members=("area",),
        candidates=(area, opening),
        detection=replace(finding.detection, score=6.5),
        evidence={"area": 6.5, "opening": 5.7},
        probabilities={"area": 0.6, "opening": 0.3, "none": 0.1},
    )


def with_gap(
    seen: Verification,
    gaps: dict[str, tuple[float, float]],
    *,
    uncertainty: float = 0.1,
    predictive: float = 5.0,
    misses: tuple[Miss, ...] = (),
    finding: Finding | None = None,
) -> Verification:
    """Return a verification with these gaps at what was held out, and a claimed family."""
    rows = [seen.quantities.index(quantity) for quantity in gaps]
    values, counted = seen.gaps.copy(), np.zeros_like(seen.counted)
    values[-2:, 0, rows, 0] = np.transpose([*gaps.values()])[:, :, None] if gaps else 0.0
    counted[rows, 0] = True
    claims = replace(seen.finding, verdict="family", family="added absorption")
    return of_means(
        finding or claims,
        values,
        counted,
        uncertainty,
        predictive,
        misses,
        [*gaps],
        before=seen.uncorrected,
        after=seen.corrected,
    )


MISS = Miss("T20", "", 500.0, 0.53, 0.645, 0.013, -3.6, "s")


@pytest.mark.parametrize(
    ("before", "after", "changes"),
    [
        (1.75, 1.74, {"uncertainty": 0.001}),
        (1.0, 0.7, {"uncertainty": 0.3}),
        (1.0, 0.1, {"predictive": -0.4}),
        (1.0, 0.1, {"predictive": 1.6}),
        (4.0, 1.1, {}),
        (1.0, 0.1, {"misses": (MISS,)}),
    ],
)
def test_supported_means_something(
    finding: Finding, before: float, after: float, changes: dict[str, Any]
) -> None:
    """Not for 1.75 to 1.74 JND, nor within its error, nor where T is missed by 3 JND."""
    seen = with_gap(verify(finding), {"C80": (before, after)}, **changes)
    assert seen.verdict == "unproven"
    record = seen.to_dict()
    assert record["least_shrinkage_jnd"] == 0.2
    assert record["uncertainty_jnd"] == seen.uncertainty
    assert bool(seen.misses) == ("misses" in changes)


def test_what_gets_worse_at_held_out_data_is_said_and_never_supported(
    finding: Finding,
) -> None:
    """A coupled room was supported by EDT, to which it was fitted, while C80 and G got worse."""
    seen = verify(finding)
    both = with_gap(seen, {"C80": (3.0, 0.2), "G": (1.0, 1.4)})
    assert both.gain > both.needed
    assert both.verdict == "unproven"
    assert with_gap(seen, {"C80": (0.1, 1.0)}).verdict == "withdrawn"
    untested = with_gap(seen, {}, uncertainty=np.nan)
    assert untested.verdict == "not tested"
    assert untested.to_dict()["before_jnd"] is None


def test_nothing_ambiguous_is_supported(finding: Finding) -> None:
    torn = with_gap(verify(finding), {"C80": (1.0, 0.1)}, finding=unsure(finding))
    assert torn.verdict == "unproven"
    assert [c["effect"] for c in torn.to_dict()["finding"]["candidates"]] == ["area", "opening"]


def held_out(seen: Verification) -> set[str]:
    return {seen.quantities[q] for q, _ in np.argwhere(seen.counted)}


@pytest.mark.long
def test_what_the_finding_was_fitted_to_tests_nothing(folder: Path) -> None:
    """T20, EDT and T30 of one configuration; with C80 and G these two count, and nothing else does."""
    case = Case.from_file(str(folder / "case.json"))
    found = rt.find(case, cache=folder)
    levels = verify(found)
    assert held_out(levels) == {"C80", "G"}
    assert levels.verdict != "not tested"
    times = case.only("t20", "edt", "t30")
    alone = verify(rt.find(times, cache=folder))
    assert alone.verdict == "not tested"
    assert not held_out(alone)
    # What is measured later was not in the search: the effect stays as it was found.
    later = verify(rt.find(times, cache=folder), case)
    assert later.held_out == ("what was not in the search",)
    assert held_out(later) == {"C80", "G"}


@pytest.mark.long
def test_a_finding_of_two_configurations_takes_at_most_forty_lines(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    case, _ = rt.datasets.hidden_room()
    assert len(case.configurations) == 2
    text = str(rt.find(case, cache=kept))
    assert text.count("\n") < 40
    row = next(line for line in text.splitlines() if line.startswith('T20 of "A"'))
    assert max(map(abs, map(float, row.split('"')[2].split()))) >= 2
    assert "rows with values below 2 in every band are left out" in text


def test_a_plan_needs_no_measurement(folder: Path) -> None:
    text = run("plan", str(folder / "plan.toml"))
    assert text.count("\n") <= 40
    (row,) = (line for line in text.splitlines() if line.startswith("furniture"))
    alike, of = map(int, row.rsplit("  ", 1)[1].split(" of "))
    assert 0 < alike <= of
    every = run("plan", str(folder / "plan.toml"), "--all")
    (named,) = (line for line in every.splitlines() if line.startswith("  furniture: "))
    assert every.startswith(text.replace(" (--all names them)", "")[:400])
    assert named.removeprefix("  furniture: ") not in ("", "no other effect")
    assert "999.0" not in text
    with pytest.raises(rt.errors.DataError, match="or use `rtcal plan`"):
        run("find", str(folder / "plan.toml"))
