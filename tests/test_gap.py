"""`rtcal find`, its kin and the hidden rooms: commands, leak audit, stored findings."""

from __future__ import annotations

import gzip
import json
import multiprocessing
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from click.testing import CliRunner

import rtcal as rt
from rtcal.command.finder import Search
from rtcal.command.main import cli
from rtcal.finder import Case, MeansFinding, MeansVerification, control_rooms, verify
from rtcal.finder.finding import Miss, Size
from rtcal.finder.means import engines, evidence, search
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.evidence import FOLDER
from rtcal.finder.means.features import distances, state
from rtcal.finder.means.verification import Gap
from rtcal.finder.model import predict
from rtcal.finder.search import find
from rtcal.report import gap_figures, pages
from rtcal.report.document import Heading
from rtcal.report.gap_report import summary
from rtcal.simulators.sdn import ScatteringDelayNetwork
from tests.conftest import candidates_of
from tests.hidden_world import populations
from tests.hidden_world.generate import numbers, read
from tests.typed import wrongly_typed

pytestmark = pytest.mark.usefixtures("runs_kept")
HERE = Path(__file__).parent / "hidden_world"
STORED = HERE / "population_1_findings.jsonl.gz"


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


def test_the_commands_find_add_and_prove(folder: Path) -> None:
    case = str(folder / "case.json")
    found = json.loads(run("find", case, "--json"))
    assert "opening" in found["candidates"]
    assert found["family"] == "added absorption"
    assert sum(found["probabilities"].values()) == pytest.approx(1)
    assert found["engines"] == ["path tracing", "image sources"]
    # The truth, datasets/hidden_room. Every candidate is shown with its size.
    assert found["sizes"]["opening"]["low"] < 39.6 < found["sizes"]["opening"]["high"]
    out, saved = folder / "corrected.json", str(folder / "found.json")
    run("find", case, "--out", saved, "--quiet")
    assert f"Added: {found['candidates'][0]} ({found['verdict']}: " in run(
        "apply", saved, "--out", str(out)
    )
    again = json.loads(run("find", str(out), "--json"))
    assert again["verdict"] in ("none", "hint")
    assert again["score"] < 0.2 * found["score"]
    assert "all that was held out" in run("verify", saved)
    assert run("find", case, "--quiet") == ""


def test_the_report_is_written_whole(folder: Path) -> None:
    pytest.importorskip("matplotlib", reason="needs the extra report")
    pytest.importorskip("jinja2", reason="needs the extra report")
    run("find", str(folder / "case.toml"), "--out", str(folder / "out"))
    names = {p.name for p in (folder / "out").iterdir() if not p.name.startswith(".rtcal_files")}
    # An opening bends no decay, so none is drawn.
    assert {
        "result.json",
        "report.html",
        "evidence.png",
        "residuals.png",
        "reverberation_time.png",
        "shifts.png",
    } == names
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    saved = rt.load(folder / "out" / "result.json")
    best = saved.finding.names[0]
    assert f"Corrected coefficients, with {best} in the model" in page
    # Its shape is no nearer to the measured one than plain calibration's; the page says so.
    assert "Nothing but the evidence supports them" in page
    assert "The name may be wrong" in page
    assert "--seed 0 --out" in page
    assert "measured.csv" in page
    assert len(page) < 2_000_000
    assert saved.quantities


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
    with pytest.raises(rt.errors.DataError, match="would be written over"):
        run(name, str(tmp_path / "case.toml"), *options)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_a_room_and_its_measurement_are_a_case(folder: Path, tmp_path: Path) -> None:
    """One configuration needed a third file, which named the other two."""
    room, measured = str(folder / "room.toml"), str(folder / "measured.csv")
    (tmp_path / "case.toml").write_text(
        f'room = "{room}"\n[[configuration]]\nname = "as measured"\nmeasured = "{measured}"\n'
    )
    stated = Case.from_file(str(tmp_path / "case.toml"))
    assert Search(case=room, measured=measured).read().to_dict() == stated.to_dict()
    with pytest.raises(rt.errors.DataError, match="--paths needs a room that states its sources"):
        run("find", room, measured, "--paths", "100")


@pytest.fixture(scope="module")
def finding(folder: Path, kept: Path) -> MeansFinding:
    return find(Case.from_file(str(folder / "case.json")), cache=kept)


def unsure(finding: MeansFinding) -> MeansFinding:
    """The same, where a material's area explains the data best and the opening hardly less."""
    first = next(iter(finding.fits.values()))
    area = replace(
        first,
        name="area",
        gap=replace(first.gap, uncertainty=0.01),
        parameters={"material": 1.0, "ratio": 1.4},
        size=Size(1.4, 1.2, 1.6, "of the stated area"),
        coefficients=None,
    )
    return replace(
        finding,
        verdict="ambiguous",
        family=None,
        named=(),
        members=("area",),
        candidates=candidates_of("area", "opening"),
        detection=replace(finding.detection, score=6.5),
        evidence={"area": 6.5, "opening": 5.7},
        probabilities={"area": 0.6, "opening": 0.3, "none": 0.1},
        fits={**finding.fits, "area": area},
    )


@pytest.mark.parametrize("verdict", ["none", "hint", "named", "family", "ambiguous", "unknown"])
def test_every_verdict_has_a_headline_and_says_what_to_do(
    finding: MeansFinding, verdict: str
) -> None:
    """A client reads these first; the page had led with the plain calibration."""
    seen = replace(
        finding, verdict=verdict, candidates=() if verdict == "none" else finding.candidates
    )
    proved = verify(seen) if seen.can_be_added else None
    assert wrongly_typed(seen) == []
    assert proved is None or wrongly_typed(proved) == []
    page = summary(seen, proved)
    for sentence in (page["headline"], *page["rests_on"], *page["to_do"]):
        assert re.match(r"[A-Z].*\.$", sentence), sentence
    assert page["level"] == {"none": "agrees", "hint": "open"}.get(verdict, "contradicts")
    lacks = verdict not in ("none", "hint")
    assert ("lacks something" in page["plain_heading"]) is lacks
    can_be_used = "The calibration below can be used, with the reservations that it states."
    assert (can_be_used in page["to_do"]) is not lacks
    shown = str(page["headline"])
    named = [c for c in finding.names if seen.title_of(c) in shown]
    assert bool(named) is (verdict in ("named", "family", "ambiguous"))


def with_gap(
    seen: MeansVerification, before: float, after: float, **changes: Any
) -> MeansVerification:
    """Return a verification with this gap in one quantity, which was held out, and a claimed family."""
    gap = Gap("as built", "C80", fitted=False, held_out=True, before=before, after=after)
    gaps = (*(g for g in seen.quantities if not g.held_out), gap)
    finding = replace(seen.finding, verdict="family", family="added absorption")
    stated = {"held_out": ("C80",), "uncertainty": 0.1, "missed": (), "finding": finding}
    return replace(seen, quantities=gaps, **(stated | changes))


MISS = Miss("T20", "", 500.0, 0.53, 0.645, 0.013, -3.6, "s")


def test_the_verdict_stands_beside_what_is_supported(finding: MeansFinding) -> None:
    seen = verify(finding)
    sure = with_gap(seen, 1.0, 0.1, predictive=5.0)
    assert sure.verdict == "supported"
    assert "shrinks with furniture from 1.00 to 0.10 JND, by 0.90 ± 0.10 JND" in sure.sentence
    assert "more than 0.20 JND counts" in sure.sentence
    best = str(finding.best_effect)
    assert f"(family: {best} {finding.percent(best)}; " in sure.sentence
    page = summary(sure.finding, sure)
    assert "not to be used, the model lacks something" in page["plain"]
    assert "Use the corrected calibration below" in " ".join(page["to_do"])
    assert sure.sentence in page["rests_on"]
    corrected = page["corrected"]["materials"][0]["cells"][0]
    assert corrected["low"] < corrected["after"] == sure.corrected.alpha[0, 0] < corrected["high"]


@pytest.mark.parametrize(
    ("before", "after", "changes", "why"),
    [
        (1.75, 1.74, {"uncertainty": 0.001}, "a decrease by more than 0.20 JND counts"),
        (1.0, 0.7, {"uncertainty": 0.3}, "a decrease by more than 0.49 JND counts"),
        (1.0, 0.1, {"predictive": -0.4}, "0.4 nats less probable with it"),
        (1.0, 0.1, {"predictive": 1.6}, "1.6 nats more probable with it; 2.3 count"),
        (4.0, 1.1, {}, "with it these data are still missed by 1.10 JND on average"),
        (1.0, 0.1, {"missed": (MISS,)}, "T20 at 500 Hz is 0.53 s, measured 0.645 ± 0.013 s"),
    ],
)
def test_supported_means_something(
    finding: MeansFinding, before: float, after: float, changes: dict[str, Any], why: str
) -> None:
    """Not for 1.75 to 1.74 JND, nor within its error, nor where T is missed by 3 JND."""
    seen = with_gap(verify(finding), before, after, **({"predictive": 5.0} | changes))
    assert seen.verdict == "unproven"
    assert why.lower() in seen.sentence.lower()
    page = summary(seen.finding, seen)
    said = " ".join(page["to_do"])
    assert "Use the corrected" not in said
    assert why.lower() in " ".join(page["rests_on"]).lower()
    record = seen.to_dict()
    assert record["least_shrinkage_jnd"] == 0.2
    assert record["uncertainty_jnd"] == seen.uncertainty
    if seen.misses:
        assert "Do not simulate with it" in said
        assert page["corrected"]["use"] == "Not to be used: with them the model misses T."


def test_what_gets_worse_at_held_out_data_is_said_and_never_supported(
    finding: MeansFinding,
) -> None:
    """A coupled room was supported by EDT, to which it was fitted, while C80 and G got worse."""
    seen = with_gap(verify(finding), 3.0, 0.2, predictive=5.0)
    worse = Gap("as built", "G", fitted=False, held_out=True, before=1.0, after=1.4)
    both = replace(seen, quantities=(*seen.quantities, worse))
    assert both.gain > both.needed
    assert both.verdict == "unproven"
    assert "gap of G grows from 1.00 to 1.40 JND" in both.sentence
    assert with_gap(seen, 0.1, 1.0).verdict == "withdrawn"
    fitted = tuple(replace(g, held_out=False) for g in seen.quantities)
    untested = replace(seen, quantities=fitted, held_out=(), uncertainty=np.nan)
    assert untested.verdict == "not tested"
    assert untested.sentence.startswith(
        "Not tested: furniture was fitted to all that was measured."
    )
    page = summary(untested.finding, untested)
    assert "Measure C80 or G, or a second configuration" in " ".join(page["to_do"])
    assert untested.to_dict()["before_jnd"] is None


def test_nothing_ambiguous_is_supported(finding: MeansFinding) -> None:
    torn = with_gap(verify(finding), 1.0, 0.1, predictive=5.0, finding=unsure(finding))
    assert torn.verdict == "unproven"
    assert "no effect and no family of effects is claimed" in torn.sentence.lower()
    assert torn.to_dict()["finding"]["candidates"] == ["area", "opening"]


def test_what_the_finding_was_fitted_to_tests_nothing(folder: Path) -> None:
    """T20, EDT and T30 of one configuration; with C80 and G these two count, and nothing else does."""
    case = Case.from_file(str(folder / "case.json"))
    found = rt.find(case, cache=folder)
    levels = verify(found)
    held = {g.quantity for g in levels.quantities if g.held_out}
    assert held == {"C80", "G"}
    assert levels.verdict != "not tested"
    times = case.only("t20", "edt", "t30")
    alone = verify(rt.find(times, cache=folder))
    assert alone.verdict == "not tested"
    assert not any(g.held_out for g in alone.quantities)
    # What is measured later was not in the search: the effect stays as it was found.
    later = verify(rt.find(times, cache=folder), case)
    assert later.held_out == ("what was not in the search",)
    assert {g.quantity for g in later.quantities if g.held_out} == {"C80", "G"}


@pytest.mark.parametrize(
    ("verdict", "before", "after", "predictive"),
    [("supported", 1.0, 0.1, 5.0), ("unproven", 0.31, 0.33, 20.0), ("withdrawn", 0.1, 1.0, -5.0)],
)
def test_how_closely_t_is_met_is_said_as_it_is(
    finding: MeansFinding, verdict: str, before: float, after: float, predictive: float
) -> None:
    seen = with_gap(verify(finding), before, after, predictive=predictive)
    assert seen.verdict == verdict
    fitted = next(g for g in seen.quantities if g.fitted)

    def said(before: float, off: float) -> str:
        gaps = (replace(fitted, before=before), *(g for g in seen.quantities if not g.fitted))
        changed = replace(seen, quantities=gaps, corrected=replace(seen.corrected, off=off))
        return " ".join(str(changed).split())

    met = "The corrected one meets it as closely as the uncertainty of T allows."
    assert f"Plain calibration meets the fitted T20 exactly. {met}" in said(0.0, 0.5)
    assert f"Plain calibration meets the fitted T20 to 0.19 JND. {met}" in said(0.19, 0.5)
    far = said(0.0, 3.2)
    assert "does not meet the fitted T20: it is 3.2 times as far off as the uncertainty" in far
    assert met not in far


def test_an_ambiguous_effect_is_not_added_silently(folder: Path, finding: MeansFinding) -> None:
    out, found = folder / "torn.json", folder / "unsure.json"
    unsure(finding).save(found)
    text = " ".join(run("apply", str(found), "--out", str(out)).split())
    name = f'area of "{finding.case.room.materials[1]}"'
    assert text.startswith(f"Added: {name} (ambiguous: {name} 60 %; opening 30 %, not told apart).")
    assert f"{name}: 1.4 times the stated area" in text
    assert Case.from_file(str(out)).applied[0].parameters["material"] == 1.0


def test_that_nothing_is_missing_is_told_first_where_it_may_be(finding: MeansFinding) -> None:
    torn = unsure(finding)
    probabilities = {**torn.probabilities, "none": 0.32}
    assert str(replace(torn, probabilities=probabilities)).startswith("ambiguous (nothing: 32 %): ")
    page = summary(replace(torn, probabilities=probabilities), None)
    assert page["headline"].startswith("The model lacks something (nothing: 32 %).")
    assert "nothing" not in replace(torn, probabilities={**probabilities, "none": 0.09}).headline


def test_parameters_have_names_and_units(finding: MeansFinding) -> None:
    room = finding.case.room
    area = unsure(finding)
    assert f'one of area of "{room.materials[1]}" (60 %), opening (30 %).' in " ".join(
        str(area).split()
    )
    assert "1.4 times the stated area" in " ".join(str(area).split())
    record = area.to_dict()
    assert record["parameters"]["material"] == 1.0
    assert record["material"] == room.materials[1]
    climate = {"temperature": 5.0, "humidity": 10.3}
    fit = replace(next(iter(finding.fits.values())), name="air", size=None, parameters=climate)
    only = ("air",)
    air = replace(
        finding, named=only, members=only, candidates=candidates_of(*only), fits={"air": fit}
    )
    assert "temperature 5 °C, humidity 10.3 % (found together" in " ".join(str(air).split())
    assert air.to_dict()["material"] is None


def test_a_sound_model_is_no_input_error(folder: Path) -> None:
    case = Case.from_file(str(folder / "case.json"))
    where = case.configurations[0]
    seen = predict([state(case, where)], distances(case, where)).reverberation_time[0]
    path, out = folder / "sound.json", folder / "never.json"
    sound = {"name": "as stated", "t20": np.repeat(seen[None], 4, axis=0).tolist()}
    path.write_text(json.dumps(case.to_dict() | {"configurations": [sound]}))
    found = str(folder / "nothing.json")
    run("find", str(path), "--out", found)
    assert run("verify", found).startswith("Nothing to add: prior, measurement and model agree")
    assert json.loads(run("verify", found, "--json"))["verdict"] is None
    done = CliRunner().invoke(cli, ["apply", found, "--out", str(out)])
    assert done.exit_code == 6
    assert done.output.startswith("Nothing to add")
    assert not out.exists()


def test_a_plan_needs_no_measurement(folder: Path) -> None:
    text = run("plan", str(folder / "plan.toml"))
    assert "What each may be taken for" in text
    assert any(
        x.startswith("  ") and "furniture" in x.split() for x in text.splitlines()
    )  # not cut
    assert "999.0" not in text
    with pytest.raises(rt.errors.DataError, match="can only be planned"):
        run("find", str(folder / "plan.toml"))


def test_a_room_s_case_holds_nothing_of_the_truth() -> None:
    for case in read(1, "case"):
        assert set(case) == {"room", "equation", "uncertainty", "configurations"}
        assert set(case["room"]) == {
            "volume",
            "centre_frequencies",
            "materials",
            "areas",
            "alpha",
            "sigma",
            "band_correlation",
            "facing",
            "air",
        }
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


def stored() -> dict[int, dict[str, Any]]:
    rows = [json.loads(x) for x in gzip.decompress(STORED.read_bytes()).splitlines()]
    return {row["index"]: row for row in rows}


_NEAR = {"air": 0.25}
"""Evidence in nats that may differ by more than 0.1. The stored run's model kept the stated speed of
sound in another climate; of seven rooms, four of them of another air, the largest change was 0.13."""


RATE = 4000.0


def delay_network(setup: engines.Setup) -> engines.Simulation:
    """The stored run's second simulator; its responses begin at the direct sound."""
    network = ScatteringDelayNetwork(**setup.positions, sampling_rate=RATE)
    speed = setup.room.speed_of_sound
    first = [round(d * RATE / speed) for d in engines._distances(setup)]

    def simulate(alpha: np.ndarray, duration: float) -> np.ndarray:
        energy = network.impulse_responses(alpha, min(duration, network.longest)) ** 2
        length = energy.shape[-1] - max(first)
        aligned = np.stack([e[:, s : s + length] for e, s in zip(energy, first, strict=True)])
        return engines._features(aligned, 1 / RATE, 100.0)

    return simulate


THEN = ("path tracing", "network")
NETWORK = replace(
    engines.ENGINES["image sources"], name="network", simulator=delay_network, stream=2
)


@patch.dict(engines.ENGINES, network=NETWORK)
def differences(index: int) -> list[str]:
    """Return the differences from what is stored, of a room of population 1 with T20, EDT, T30."""
    case, stored_ = Case.from_dict(read(1, "case")[index]), stored()[index]["one"]
    one = case.only("t20", "edt", "t30", configurations=[case.configurations[0].name])
    # As the stored run has it: one configuration is judged by its part of the whole case's rooms.
    controls = [ControlRooms(c.engine, c.errors[:, :1]) for c in control_rooms(case, engines=THEN)]
    # The stored run's grids ended; since then they go on, and a rival may have more evidence.
    # All data had one threshold, which is that of one step.
    with (
        patch.object(evidence, "_ROUNDS", 0),
        patch.object(evidence, "steps", all_data),
        patch.object(search, "steps", all_data),
    ):
        finding = find(one, controls=controls)
    now = find(one, controls=controls)
    # The control rooms were kept in single precision. The threshold is a quantile of simulated rooms:
    # on another processor it was 0.04 nats off.
    near = {
        "threshold": finding.threshold == pytest.approx(stored_["threshold"], rel=0.02, abs=0.06),
        "verdict": finding.verdict == stored_["verdict"],
        "candidates": list(finding.names) == stored_["candidates"],
        "with grids that go on": (now.verdict, now.names) == (finding.verdict, finding.names),
    } | {
        name: finding.evidence[name] == pytest.approx(value, rel=0.02, abs=_NEAR.get(name, 0.1))
        for name, value in stored_["evidence"].items()
        if value > -20
    }
    if "rmse" in stored_:
        truth = read(1, "truth")[index]
        area = np.array(truth["areas"])[:, None]
        off = verify(finding).corrected.alpha - np.array(truth["alpha"])
        error = np.sqrt((area * off**2).sum() / area.sum() / off.shape[1])
        near["rmse"] = error == pytest.approx(stored_["rmse"][2], rel=0.03)
    return [name for name, is_so in near.items() if not is_so]


def all_data(_: Case, used: np.ndarray) -> dict[int, str]:
    return {int(used.sum()): "all data"}


@pytest.mark.study
@pytest.mark.parametrize("kind", [0, 2, 11])
def test_stored_findings_are_found_again(kind: int) -> None:
    """The stored population is of the finder before 32 fixed control rooms and the volume's prior.

    It is to be judged anew, once, with the next change of the finder: a study, since it takes an hour.
    """
    assert differences(min(i for i, row in stored().items() if row["kind"] == kind)) == []


@pytest.mark.study
def test_the_whole_population_is_as_published() -> None:
    """All stored findings anew, two seconds each; and no more false alarms than 5 %.

    Thresholds are left out: what the simulated rooms draw has changed since, by some 0.1 nats.
    """
    rows = stored()
    controls = [r["one"]["verdict"] for r in rows.values() if r["kind"] == 0]
    flagged = [v in ("named", "family", "ambiguous", "unknown") for v in controls]
    assert np.mean(flagged) <= 0.05
    with multiprocessing.Pool() as pool:
        found = zip(rows, pool.imap(differences, rows), strict=True)
        changed = {i: d for i, d in found if set(d) - {"threshold"}}
    # On another processor a path of a control room may part from its twin in the last digit.
    assert len(changed) <= 0.01 * len(rows), changed


def test_a_saved_finding_has_its_page(finding: MeansFinding, tmp_path: Path) -> None:
    """It had been refused: the page was written by `find --out` alone."""
    pytest.importorskip("matplotlib")
    finding.save(tmp_path)
    text = pages.page_of(tmp_path, heading=Heading(author="A. Consultant"))
    assert "A. Consultant" in text
    assert finding.case.room.name in text
    assert "The evidence in numbers" in text


def test_the_label_beside_a_flat_map_of_residuals_is_not_cropped(finding: MeansFinding) -> None:
    """A measurement of T20 alone makes a map of one row."""
    pytest.importorskip("matplotlib")
    alone = np.full_like(finding.residuals, np.nan)
    alone[:, 0] = finding.residuals[:, 0]
    figure = gap_figures.residuals(replace(finding, residuals=alone))
    figure.draw_without_rendering()
    (label,) = [
        text
        for axis in figure.axes
        for text in (axis.xaxis.label, axis.yaxis.label)
        if "standard deviation" in text.get_text()
    ]
    box = label.get_window_extent()
    assert (box.min >= 0).all()
    assert (box.max <= figure.bbox.max).all()
