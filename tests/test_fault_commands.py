"""Every command that writes, with a fault: a whole set, old or new, or one that is refused by name."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import rtcal as rt
from rtcal.command.main import main
from rtcal.finder.search import find
from rtcal.loop import positions
from rtcal.report import figures, finding_pages, gap_report, pages, study_report
from rtcal.support import files
from tests import faults, fuzz
from tests.test_discrepancy import controls_of, opened
from tests.test_where_page import PLACE, finding_of, verification_of

BETWEEN = 7
"""Every so many events of the quick commands in the suite; `make study` tries all of all."""

FAULTS = {"fails": faults.full, "is interrupted": faults.interrupt, "is killed": faults.kill}

SECONDS = re.compile(rb'"seconds": [^,\n]*')
"""What differs between two runs of one calibration."""


class Writer(NamedTuple):
    """A command, and what makes its files. ``ahead`` is a folder that may be ahead of the others."""

    prepare: Callable[[Path], object]
    command: str
    ahead: str = ""


def call(command: str, folder: Path) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([part.replace("@", f"{folder}/") for part in [*command.split(), "-q"]])
    assert stopped.value.code in (0, 2, 130), command
    return int(stopped.value.code)


def inputs(folder: Path) -> None:
    room, measured = rt.datasets.bras_cr2()
    room.save(str(folder / "room.toml"))
    measured.save(str(folder / "t.csv"))


def calibrated(folder: Path) -> None:
    inputs(folder)
    assert call("calibrate @room.toml @t.csv --method lse --out @made", folder) == 0


def started(folder: Path) -> None:
    inputs(folder)
    assert call("loop start @room.toml @t.csv --state @loop.json --out @next.toml", folder) == 0
    simulated = rt.Room.from_file(str(folder / "next.toml"))
    t20 = 1.4 * rt.Eyring().reverberation_time(simulated)
    rt.Measurement.from_values(simulated.centre_frequencies, t20=t20).save(str(folder / "s.csv"))


def stepped(folder: Path) -> None:
    started(folder)
    call("loop next @room.toml @s.csv --state @loop.json --out @next.toml", folder)


def with_variants(folder: Path) -> None:
    inputs(folder)
    variant = '[[variant]]\nname = "open"\n[[variant.change]]\nopen = "windows"\narea = 2.0\n'
    (folder / "variants.toml").write_text(variant)


def with_treatments(folder: Path) -> None:
    inputs(folder)
    assert call("example change --out @change", folder) == 0
    shutil.copy(folder / "change" / "treatments.toml", folder)


def an_archive(folder: Path) -> None:
    room, _ = rt.datasets.bras_cr2()
    for name in ("a", "b"):
        times = rt.Eyring().reverberation_time(room) * (1.1 if name == "a" else 1.2)
        rt.calibrate(room.replace(name=name), times).save(folder / "rooms" / name)
    room.save(str(folder / "room.toml"))


def materials(folder: Path) -> None:
    inputs(folder)
    room = rt.Room.from_file(str(folder / "room.toml"))
    lines = [f"ABS {name} = <10 10 10 10 10 10>\n" for name in room.materials]
    (folder / "hall.geo").write_text("".join(lines))


def box(folder: Path) -> None:
    (folder / "hall.geo").write_text("ABS wood = <10 10 10 10 10 10>\n")
    corners = [f"v {x} {y} {z}\n" for x in (0, 5) for y in (0, 4) for z in (0, 3)]
    faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    mesh = [*corners, "usemtl wood\n", *(f"f {face}\n" for face in faces)]
    (folder / "box.obj").write_text("".join(mesh))


def table(folder: Path) -> None:
    (folder / "table.csv").write_text("Frequency;T20 [s]\n500;1.5\n1000;1.4\n")


def box_with_pairs(folder: Path) -> None:
    rt.Room(
        name="box",
        volume=105,
        materials=["walls"],
        areas=[142],
        alpha=[[0.2]],
        sigma=[[0.05]],
        centre_frequencies=[1000],
        dimensions=(5, 7, 3),
        scattering=[[0.5]],
        scene=rt.Scene(sources={"S": (1, 2, 1)}, receivers={"A": (4, 5, 1), "B": (2, 6, 2)}),
    ).save(str(folder / "room.toml"))
    rt.Measurement(
        centre_frequencies=[1000],
        pairs=[("S", "A"), ("S", "B")],
        values={"t20": [[0.5], [0.52]], "c80": [[8.0], [7.0]]},
    ).save(str(folder / "pairs.csv"))


def case(folder: Path) -> None:
    opened().save(str(folder / "case.json"))


def found(folder: Path) -> None:
    case(folder)
    assert call("find @case.json --out @found.json", folder) == 0


def found_in_a_geometry(folder: Path) -> None:
    box_with_pairs(folder)
    assert call("find @room.toml @pairs.csv --out @found.json", folder) == 0


FIT = "fit @room.toml @pairs.csv --match t20 --match c80 --paths 100"


def fit_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """`rtcal fit` calibrates once, but keeps its control runs each time; its figures are drawn once.

    Two calibrations may differ in the last digit, by where their arrays lie in memory.
    """
    calibrate, rendered = positions.calibrate_positions, figures.rendered
    made: dict[object, Any] = {}

    def once(*arguments: Any, cache: Path, **options: Any) -> Any:
        if "result" not in made:
            made["result"] = calibrate(*arguments, **options)
        files.write(cache / "controls.array", made["result"].controls.errors)
        return made["result"]

    def drawn(figure: Any, kind: str) -> Any:
        if not made:
            return rendered(figure, kind)
        if kind not in made:
            made[kind] = rendered(figure, kind)
        return made[kind]

    monkeypatch.setattr(positions, "calibrate_positions", once)
    monkeypatch.setattr(figures, "rendered", drawn)


def search_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """`rtcal find` with a geometry searches and verifies once."""
    finding = finding_of({"floor": 0.7, "wall 5": 0.3})
    verified = verification_of(finding, {"before": 3.0, "plain": 2.0, "corrected": 1.0})
    drawn = finding_pages.drawn(finding, verified, PLACE)
    pictures = {id(figure): figures.rendered(figure, "png") for figure in drawn.values()}
    means = find(opened(), controls=controls_of(opened()))
    of_means = rt.finder.verify(means)

    def found_once(case: object, **_: object) -> object:
        return means if isinstance(case, rt.finder.Case) else finding

    def verified_once(found: object, **_: object) -> object:
        return of_means if found is means else verified

    monkeypatch.setattr("rtcal.finder.search.find", found_once)
    monkeypatch.setattr(rt.finder, "verify", verified_once)
    monkeypatch.setattr(rt.finder.positions, "next_position", lambda *_, **__: (PLACE,))
    monkeypatch.setattr(finding_pages, "drawn", lambda *_: drawn)
    monkeypatch.setattr(finding_pages, "rendered", lambda figure, _: pictures[id(figure)])
    monkeypatch.setattr(finding_pages, "where_page", lambda *_: "<p>a page</p>")


@pytest.fixture(autouse=True)
def fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    fit_once(monkeypatch)


STUDY = "study --kind shoebox --sigma-r 0.05 --out @made"

WRITERS = {
    "calibrate": Writer(calibrated, "calibrate @room.toml @t.csv --out @made"),
    "predict": Writer(
        with_variants, "predict @room.toml @t.csv --change @variants.toml --out @made"
    ),
    "design": Writer(
        with_treatments, "design @room.toml @t.csv --treatments @treatments.toml --out @made"
    ),
    "learn": Writer(an_archive, "learn @rooms --apply @room.toml --out @library"),
    "report": Writer(calibrated, "report @made"),
    "fit": Writer(box_with_pairs, f"{FIT} --out @made", ahead=".rtcal_cache"),
    "loop start": Writer(
        started, "loop start @room.toml @t.csv --method lse --state @loop.json --out @next.toml"
    ),
    "loop next": Writer(started, "loop next @room.toml @s.csv --state @loop.json --out @next.toml"),
    "loop back": Writer(stepped, "loop back @room.toml --state @loop.json --out @next.toml"),
    "import": Writer(
        box,
        "import catt @hall.geo --mesh @box.obj --humidity 50 --out @room.toml",
    ),
    "export": Writer(materials, "export catt @room.toml @hall.geo"),
    "measure": Writer(
        lambda folder: (folder / "ir.wav").write_bytes(fuzz.READERS["wav"].seeds[0]),
        "measure @ir.wav --out @t.csv",
    ),
    "table": Writer(table, "table @table.csv --out @t.csv"),
    "study": Writer(lambda folder: None, f"{STUDY} --realisations 20 --trials 0"),
    "study with pieces": Writer(
        lambda folder: None,
        f"{STUDY} --realisations 250 --trials 10 --workers 1 --folder @pieces",
        ahead="pieces",
    ),
    "apply": Writer(found, "apply @found.json --out @new.json --room @new.toml"),
    "find": Writer(case, "find @case.json --out @found.json"),
    "gap report": Writer(case, "find @case.json --out @gap"),
    "apply with a geometry": Writer(found_in_a_geometry, "apply @found.json --out @corrected"),
    "find with a geometry": Writer(box_with_pairs, "find @room.toml @pairs.csv --out @page"),
}


def attempt(name: str, tmp_path: Path, between: int) -> tuple[int, int]:
    """Return how many faults were tried, and after how many the set is refused by name.

    A fault is an event and what happens there: it fails, it is interrupted, or the process is killed.
    After each the set is old, new or refused, and the command makes it anew.
    """
    writer = WRITERS[name]
    good, work = tmp_path / "good", tmp_path / "work"
    good.mkdir()
    writer.prepare(good)
    shutil.copytree(good, work)

    def state() -> dict[str, bytes]:
        return {
            file: SECONDS.sub(b"", content)
            for file, content in faults.snapshot(work).items()
            if not (writer.ahead and file.startswith(writer.ahead))
        }

    before = state()
    with faults.faulty(None) as layer:
        assert call(writer.command, work) == 0
    after = state()
    assert after != before
    tried = refused = 0
    for nth in range(1, layer.count + 1, between):
        for what, fault in FAULTS.items():
            shutil.rmtree(work)
            shutil.copytree(good, work)
            if fault is faults.kill:
                faults.killed(lambda: call(writer.command, work), nth)
            else:
                with faults.faulty(nth, fault):
                    call(writer.command, work)
            now, place = state(), f"{name}: event {nth} {what}"
            assert all(now[f] in (before.get(f), after.get(f)) for f in now), place
            torn = faults.refused(work)
            assert torn or now in (before, after), place
            assert not torn or "rtcal" in torn, place
            tried += 1
            refused += bool(torn)
            code = call(writer.command, work)
            assert code == 0 or now != before, f"{place}: the command does not go on"
            assert code or state() == after or now != before, place
            assert not faults.refused(work), place
    return tried, refused


@pytest.mark.parametrize(
    "name", [pytest.param("apply with a geometry", marks=pytest.mark.long), "find with a geometry"]
)
def test_a_geometry_is_written_whole_or_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    search_once(monkeypatch)
    tried, _ = attempt(name, tmp_path, BETWEEN)
    assert tried >= 3


@pytest.mark.parametrize(
    "name",
    [
        *("loop start", "loop next", "loop back", "import", "export", "measure", "table"),
        *("predict", "design", "learn", "study"),
        *(pytest.param(name, marks=pytest.mark.long) for name in ("fit", "study with pieces")),
    ],
)
def test_a_command_writes_a_whole_set_or_one_that_is_refused(name: str, tmp_path: Path) -> None:
    tried, _ = attempt(name, tmp_path, BETWEEN)
    assert tried >= 3


def once(patch: pytest.MonkeyPatch, module: Any, name: str) -> None:
    """Let a function that writes nothing run once, and return its answer from then on."""
    real = getattr(module, name)
    answers: list[Any] = []

    def same(*arguments: Any, **options: Any) -> Any:
        if not answers:
            answers.append(real(*arguments, **options))
        return answers[0]

    patch.setattr(module, name, same)


@pytest.fixture
def computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that take long and write nothing are done once; figures are drawn once for all."""
    fit_once(monkeypatch)
    search_once(monkeypatch)
    for name in ("figures", "finding_page"):
        once(monkeypatch, gap_report, name)
    once(monkeypatch, pages, "page_of")
    for module in (figures, gap_report, study_report):
        if hasattr(module, "rendered"):
            once(monkeypatch, module, "rendered")


@pytest.mark.long
@pytest.mark.usefixtures("computed_once")
def test_a_finding_and_its_page_are_a_whole_set_or_one_that_is_refused(tmp_path: Path) -> None:
    tried, _ = attempt("gap report", tmp_path, BETWEEN)
    assert tried >= 3


@pytest.mark.study
@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.usefixtures("computed_once")
def test_a_set_is_whole_or_refused_after_a_fault_at_every_event(name: str, tmp_path: Path) -> None:
    tried, refused = attempt(name, tmp_path, 1)
    print(f"{name}: {tried} faults tried, {refused} sets refused by name")
    assert tried > 15
