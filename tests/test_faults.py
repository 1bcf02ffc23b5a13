"""After a fault at any event, files are old or new as a whole, and the next command goes on."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from rtcal.support.errors import DataError
from rtcal.support.files import read_text, recover, write_all, write_text
from tests import faults
from tests.killed_writes import AFTER, BEFORE, events, remove_new, run_killed, set_of


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
        remove_new(tmp_path)


@pytest.mark.parametrize("law", ["old_or_new", "recovery", "reader"])
def test_a_kill_at_any_event_leaves_a_set_old_or_new(law: str, tmp_path: Path) -> None:
    """Whoever comes next, by either folder, sees the whole. Recovery may be killed, too."""
    run_killed(law, tmp_path)


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
