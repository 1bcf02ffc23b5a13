"""After a fault at any event, files are old or new as a whole, and the next command goes on."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from rtcal.support.errors import DataError
from rtcal.support.files import read_text, write_all, write_text
from rtcal.support.transaction import recover
from tests import faults

OLD, NEW = b"old " * 3000, b"new " * 4000


def set_of(folder: Path) -> dict[Path, bytes]:
    """Two files that are there and two that are not, in two folders."""
    (folder / "a").mkdir(exist_ok=True)
    (folder / "b").mkdir(exist_ok=True)
    names = ("a/one", "a/two", "b/three", "b/four")
    for name in names[::2]:
        (folder / name).write_bytes(OLD)
    return {folder / name: NEW for name in names}


BEFORE = {"a/one": OLD, "b/three": OLD}
AFTER = dict.fromkeys(("a/one", "a/two", "b/three", "b/four"), NEW)


def events(folder: Path) -> int:
    contents = set_of(folder)
    with faults.faulty(None) as layer:
        write_all(contents)
    assert faults.snapshot(folder) == AFTER
    for name in ("a/two", "b/four"):
        (folder / name).unlink()
    return layer.count


@pytest.mark.parametrize("fault", [faults.full, faults.interrupt])
def test_a_fault_at_any_event_leaves_a_set_old_or_new(
    fault: Callable[[str], None], tmp_path: Path
) -> None:
    for nth in range(1, events(tmp_path) + 1):
        contents = set_of(tmp_path)
        failed = False
        with faults.faulty(nth, fault):
            try:
                write_all(contents)
            except (DataError, KeyboardInterrupt):
                failed = True
        recover([tmp_path / "a", tmp_path / "b"])
        now = faults.snapshot(tmp_path)
        assert now in (BEFORE, AFTER), nth
        assert failed or now == AFTER, nth
        assert faults.left_over(tmp_path) == []
        for name in ("a/two", "b/four"):
            (tmp_path / name).unlink(missing_ok=True)


def test_a_kill_at_any_event_leaves_a_set_old_or_new(tmp_path: Path) -> None:
    """And whoever comes next, by either folder, sees the whole."""
    kills = 0
    for nth in range(1, events(tmp_path) + 1):
        contents = set_of(tmp_path)
        kills += faults.killed(lambda c=contents: write_all(c), nth)
        last = ("a", "b")[nth % 2]
        recover([tmp_path / last])
        assert faults.snapshot(tmp_path) in (BEFORE, AFTER), nth
        recover([tmp_path / "a", tmp_path / "b"])
        assert faults.snapshot(tmp_path) in (BEFORE, AFTER), nth
        assert faults.left_over(tmp_path) == []
        for name in ("a/two", "b/four"):
            (tmp_path / name).unlink(missing_ok=True)
    assert kills > 40


def test_recovery_may_be_killed_too(tmp_path: Path) -> None:
    contents = set_of(tmp_path)
    with faults.faulty(None) as layer:
        write_all(contents)
    middle = layer.count - 10  # some files are in place, the journal is there
    for nth in range(1, 12):
        contents = set_of(tmp_path)
        for name in ("a/two", "b/four"):
            (tmp_path / name).unlink(missing_ok=True)
        assert faults.killed(lambda c=contents: write_all(c), middle)
        faults.killed(lambda: recover([tmp_path / "a"]), nth)
        recover([tmp_path / "b"])
        recover([tmp_path / "a"])
        assert faults.snapshot(tmp_path) == AFTER
        assert faults.left_over(tmp_path) == []


def test_a_reader_sees_one_set_after_a_kill(tmp_path: Path) -> None:
    contents = set_of(tmp_path)
    for nth in range(1, 100):
        if not faults.killed(lambda: write_all(contents), nth):
            break
        one, two = "", ""
        if (tmp_path / "a" / "one").exists():
            one = read_text(tmp_path / "a" / "one", 10**6)
        if (tmp_path / "a" / "two").exists():
            two = read_text(tmp_path / "a" / "two", 10**6)
        assert (one, two) in ((OLD.decode(), ""), (NEW.decode(), NEW.decode()))


def test_a_hidden_folder_that_rtcal_did_not_write_touches_nothing(tmp_path: Path) -> None:
    precious, here = tmp_path / "precious", tmp_path / "here"
    precious.mkdir()
    (precious / "file").write_text("kept")
    made = here / ".rtcal-0"
    made.mkdir(parents=True)
    (made / "0.new").write_text("gone")
    (made / "folders").write_text('[".rtcal-0", "../precious"]')
    (made / "journal").write_text('[[".rtcal-0/0.new", "../precious/file"]]')
    (here / "text").write_text("x")
    with pytest.raises(DataError, match="names files elsewhere"):
        read_text(here / "text", 100)
    assert (precious / "file").read_text() == "kept"


def test_a_failure_names_the_file_or_the_folder_of_a_set(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    for contents, place in (({one: b"x"}, one), ({one: b"x", two: b"y"}, tmp_path)):
        with faults.faulty(2), pytest.raises(DataError) as caught:
            write_all(contents)
        assert str(caught.value).startswith(f"{place}: cannot be written: No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_no_files_are_no_error(tmp_path: Path) -> None:
    write_all({})
    assert list(tmp_path.iterdir()) == []


def test_links_are_followed_and_modes_kept(tmp_path: Path) -> None:
    target = tmp_path / "data" / "room.toml"
    target.parent.mkdir()
    target.write_text("old")
    target.chmod(0o600)
    link = tmp_path / "room.toml"
    link.symlink_to(target)
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    dangling = tmp_path / "dangling"
    dangling.symlink_to(tmp_path / "data" / "made")
    write_text(dangling, "made")
    assert (tmp_path / "data" / "made").read_text() == "made"
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE((tmp_path / "data" / "made").stat().st_mode) == 0o666 & ~mask


def test_what_is_no_file_is_not_written_over(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    one.symlink_to(two)
    two.symlink_to(one)
    with pytest.raises(DataError, match=r"one: cannot be written: (a loop of|Too many levels)"):
        write_text(one, "x")
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", Path("/dev/null")):
        with pytest.raises(DataError, match="cannot be written: not a regular file"):
            write_text(place, "x")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)
    with pytest.raises(DataError, match="Is a directory"):
        write_text(tmp_path, "x")
