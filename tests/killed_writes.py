"""A writer is killed at every event: `python -m tests.killed_writes NAME FOLDER`.

A process of its own is small. Each fork of one that holds all tests costs fifty milliseconds.
"""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from rtcal.support.errors import DataError
from rtcal.support.files import read_text, recover, write_all
from tests import faults

OLD, NEW = b"old " * 3000, b"new " * 4000
BEFORE = {"a/one": OLD, "b/three": OLD}
AFTER = dict.fromkeys(("a/one", "a/two", "b/three", "b/four"), NEW)


def set_of(folder: Path) -> dict[Path, bytes]:
    """Two files that are there and two that are not, in two folders."""
    (folder / "a").mkdir(exist_ok=True)
    (folder / "b").mkdir(exist_ok=True)
    names = ("a/one", "a/two", "b/three", "b/four")
    for name in names[::2]:
        (folder / name).write_bytes(OLD)
    return {folder / name: NEW for name in names}


def events(folder: Path) -> int:
    contents = set_of(folder)
    with faults.faulty(None) as layer:
        write_all(contents)
    assert faults.snapshot(folder) == AFTER
    remove_new(folder)
    return layer.count


def remove_new(folder: Path) -> None:
    for name in ("a/two", "b/four"):
        (folder / name).unlink(missing_ok=True)


def old_or_new(folder: Path) -> None:
    kills = 0
    for nth in range(1, events(folder) + 1):
        contents = set_of(folder)
        kills += faults.killed(lambda c=contents: write_all(c), nth)
        last = ("a", "b")[nth % 2]
        recover([folder / last])
        assert faults.snapshot(folder) in (BEFORE, AFTER), nth
        recover([folder / "a", folder / "b"])
        assert faults.snapshot(folder) in (BEFORE, AFTER), nth
        assert faults.left_over(folder) == []
        remove_new(folder)
    assert kills > 40


def recovery(folder: Path) -> None:
    contents = set_of(folder)
    with faults.faulty(None) as layer:
        write_all(contents)
    middle = layer.count - 10  # some files are in place, the journal is there
    for nth in range(1, 12):
        contents = set_of(folder)
        remove_new(folder)
        assert faults.killed(lambda c=contents: write_all(c), middle)
        faults.killed(lambda: recover([folder / "a"]), nth)
        recover([folder / "b"])
        recover([folder / "a"])
        assert faults.snapshot(folder) == AFTER
        assert faults.left_over(folder) == []


def reader(folder: Path) -> None:
    contents = set_of(folder)
    kills = 0
    for nth in range(1, 100):
        if not faults.killed(lambda: write_all(contents), nth):
            break
        kills += 1
        one, two = "", ""
        if (folder / "a" / "one").exists():
            one = read_text(folder / "a" / "one", 10**6)
        if (folder / "a" / "two").exists():
            two = read_text(folder / "a" / "two", 10**6)
        assert (one, two) in ((OLD.decode(), ""), (NEW.decode(), NEW.decode()))
    assert kills > 40


def run_study(folder: Path | None, seed: int = 3) -> list[object]:
    from rtcal import studies

    areas = [35, 35, 21, 21, 15, 15]
    table: list[object] = studies.run(areas, 0.05, 250, 20, seed, folder=folder).scores().tolist()
    return table


def pieces(folder: Path) -> None:
    whole = run_study(None)
    with faults.faulty(None) as layer:
        run_study(folder / "counted")
    assert layer.count > 10
    for nth in range(1, layer.count + 1, 3):
        place = folder / f"fault {nth}"
        with faults.faulty(nth), suppress(DataError):
            assert run_study(place) == whole
        faults.killed(lambda p=place: run_study(p), nth)
        assert run_study(place) == whole
        assert faults.left_over(place) == []


LAWS = {law.__name__: law for law in (old_or_new, recovery, reader, pieces)}


def run_killed(law: str, folder: Path) -> None:
    """Run a law in a process of its own, which must end well."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.killed_writes", law, str(folder)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).resolve().parents[1],
        check=False,
    )
    assert done.returncode == 0, done.stderr


if __name__ == "__main__":
    LAWS[sys.argv[1]](Path(sys.argv[2]))
