"""Commands that write, with a fault: a whole set, old or new, or one that is refused by name."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

import rtcal as rt
from rtcal.command.main import main
from tests import faults

BETWEEN = 7
"""Every so many events in the suite; `make study` tries all."""

FAULTS = {"fails": faults.full, "is interrupted": faults.interrupt, "is killed": faults.kill}


class Writer(NamedTuple):
    """A command, and what makes its files."""

    prepare: Callable[[Path], object]
    command: str


def call(command: str, folder: Path) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([part.replace("@", f"{folder}/") for part in [*command.split(), "-q"]])
    assert stopped.value.code in (0, 2, 130), command
    return int(stopped.value.code)


def inputs(folder: Path) -> None:
    room, measured = rt.datasets.bras_cr2()
    room.save(str(folder / "room.toml"))
    measured.save(str(folder / "t.csv"))


def started(folder: Path) -> None:
    inputs(folder)
    assert call("loop start @room.toml @t.csv --state @loop.json --out @next.toml", folder) == 0
    simulated = rt.Room.from_file(str(folder / "next.toml"))
    t20 = 1.4 * rt.Eyring().reverberation_time(simulated)
    rt.Measurement.from_values(simulated.centre_frequencies, t20=t20).save(str(folder / "s.csv"))


def with_variants(folder: Path) -> None:
    inputs(folder)
    variant = '[[variant]]\nname = "open"\n[[variant.change]]\nopen = "windows"\narea = 2.0\n'
    (folder / "variants.toml").write_text(variant)


def with_treatments(folder: Path) -> None:
    inputs(folder)
    assert call("example change --out @change", folder) == 0
    shutil.copy(folder / "change" / "treatments.toml", folder)


def box(folder: Path) -> None:
    (folder / "hall.geo").write_text("ABS wood = <10 10 10 10 10 10>\n")
    corners = [f"v {x} {y} {z}\n" for x in (0, 5) for y in (0, 4) for z in (0, 3)]
    faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    mesh = [*corners, "usemtl wood\n", *(f"f {face}\n" for face in faces)]
    (folder / "box.obj").write_text("".join(mesh))


WRITERS = {
    "predict": Writer(
        with_variants, "predict @room.toml @t.csv --change @variants.toml --out @made"
    ),
    "design": Writer(
        with_treatments, "design @room.toml @t.csv --treatments @treatments.toml --out @made"
    ),
    "loop next": Writer(started, "loop next @room.toml @s.csv --state @loop.json --out @next.toml"),
    "import": Writer(box, "import catt @hall.geo --mesh @box.obj --humidity 50 --out @room.toml"),
    "study": Writer(
        lambda folder: None,
        "study --kind shoebox --sigma-r 0.05 --out @made --realisations 250 --trials 10 --workers 1",
    ),
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

    before = faults.snapshot(work)
    with faults.faulty(None) as layer:
        assert call(writer.command, work) == 0
    after = faults.snapshot(work)
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
            now, place = faults.snapshot(work), f"{name}: event {nth} {what}"
            assert all(now[f] in (before.get(f), after.get(f)) for f in now), place
            torn = faults.refused(work)
            assert torn or now in (before, after), place
            assert not torn or "rtcal" in torn, place
            tried += 1
            refused += bool(torn)
            code = call(writer.command, work)
            assert code == 0 or now != before, f"{place}: the command does not go on"
            assert code or faults.snapshot(work) == after or now != before, place
            assert not faults.refused(work), place
    return tried, refused


@pytest.mark.parametrize(
    "name",
    [
        *("predict", "loop next", "import"),
        *(pytest.param(n, marks=pytest.mark.long) for n in ("design", "study")),
    ],
)
def test_a_command_writes_a_whole_set_or_one_that_is_refused(name: str, tmp_path: Path) -> None:
    tried, _ = attempt(name, tmp_path, BETWEEN)
    assert tried >= 3


@pytest.mark.study
@pytest.mark.parametrize("name", WRITERS)
def test_a_set_is_whole_or_refused_after_a_fault_at_every_event(name: str, tmp_path: Path) -> None:
    tried, refused = attempt(name, tmp_path, 1)
    print(f"{name}: {tried} faults tried, {refused} sets refused by name")
    assert tried > 15
