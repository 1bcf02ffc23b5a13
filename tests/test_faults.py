"""Each file is old or new; a set written in part is refused by name; own files alone are replaced."""

import os
import stat
from pathlib import Path

import numpy as np
import pytest

from rtcal.files import disk
from rtcal.files.disk import write_all, write_text
from rtcal.support.errors import DataError
from tests import faults

OLD, NEW = b"old " * 3000, b"new " * 4000
NAMES = ("a/one", "a/two", "b/three", "b/four")
BEFORE = dict.fromkeys(NAMES[::2], OLD)
AFTER = dict.fromkeys(NAMES, NEW)


def set_of(folder):
    """Two files that are there and two that are not, in two folders."""
    for name in NAMES:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).unlink(missing_ok=True)
    for name, content in BEFORE.items():
        (folder / name).write_bytes(content)
    return {folder / name: NEW for name in NAMES}


def events(folder):
    contents = set_of(folder)
    with faults.faulty(None) as layer:
        write_all(contents)
    assert faults.snapshot(folder) == AFTER
    return layer.count


def require_whole_or_refused(folder):
    """Return whether the set is refused; each file is old or new in any case."""
    now = faults.snapshot(folder)
    assert all(now[name] in (BEFORE.get(name), AFTER[name]) for name in now)
    if said := faults.refused(folder):
        assert "`the call that wrote it` was interrupted while it wrote" in said
        return True
    assert now in (BEFORE, AFTER)
    return False


@pytest.mark.long
@pytest.mark.parametrize("fault", [faults.full, faults.interrupt, faults.kill])
def test_a_set_is_old_new_or_refused_after_a_fault_at_any_event(fault, tmp_path):
    total, refusals = events(tmp_path), 0
    for nth in range(1, total + 1):
        contents = set_of(tmp_path)
        if fault is faults.kill:
            assert faults.killed(lambda c=contents: write_all(c), nth)
        else:
            with faults.faulty(nth, fault):
                try:
                    write_all(contents)
                except (DataError, KeyboardInterrupt):
                    pass
                else:
                    pytest.fail(f"event {nth} of {total} went unnoticed")
        refusals += require_whole_or_refused(tmp_path)
        write_all(contents)
        assert faults.snapshot(tmp_path) == AFTER
        assert not faults.refused(tmp_path)
    assert total > 40
    assert 1 <= refusals < total / 3


def test_a_full_disk_changes_no_file(tmp_path):
    contents = set_of(tmp_path)
    for nth in (1, 2, 9):
        with faults.faulty(nth), pytest.raises(DataError, match="No space left on device"):
            write_all(contents)
        assert faults.snapshot(tmp_path) == BEFORE
        assert not [*tmp_path.rglob(f"*{disk.NEW}")]


def test_a_command_replaces_its_own_files_alone(tmp_path):
    """A file is known by its content: one that was changed is the user's."""
    own, foreign = tmp_path / "own", tmp_path / "foreign"
    foreign.write_text("mine")
    write_text(own, "first")
    with disk.one_set("rtcal x"):
        write_text(own, "second")
        with pytest.raises(DataError, match="rtcal did not write it"):
            write_text(foreign, "theirs")
        with pytest.raises(DataError, match="rtcal did not write it"):
            disk.spare([foreign], [])
    assert (own.read_text(), foreign.read_text()) == ("second", "mine")
    own.write_text("changed")
    with disk.one_set("rtcal x"), pytest.raises(DataError, match="it was changed afterwards"):
        write_text(own, "third")
    with disk.one_set("rtcal x"):
        disk.may_replace()
        write_text(own, "third")
        write_text(foreign, "theirs")
    assert (own.read_text(), foreign.read_text()) == ("third", "theirs")


def test_what_a_command_writes_is_one_set(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    with disk.one_set("rtcal x"):
        write_text(one, "1")
        write_text(two, "2")
        assert not one.exists()
        assert disk.commit() == [str(one), str(two)]
        assert two.exists()
    with pytest.raises(ZeroDivisionError), disk.one_set("rtcal x"):
        write_text(one, "new")
        raise ZeroDivisionError
    assert one.read_text() == "1"


def test_links_are_followed_and_modes_kept(tmp_path):
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


def test_what_is_no_file_is_not_written_over(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    one.symlink_to(two)
    two.symlink_to(one)
    os.mkfifo(tmp_path / "pipe")
    for place in (one, tmp_path / "pipe", Path("/dev/null"), tmp_path):
        with pytest.raises(DataError, match=str(place)):
            write_text(place, "x")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def test_a_kept_array_that_is_damaged_or_another_counts_as_missing(tmp_path):
    place = tmp_path / "folder" / "a.array"
    disk.write(place, np.arange(6.0).reshape(2, 3))
    again = disk.read(place)
    assert again is not None
    np.testing.assert_array_equal(again, [[0, 1, 2], [3, 4, 5]])
    good = place.read_bytes()
    for damaged in (
        good.replace(b"(2, 3)", b"(9**19, 3)"),
        good[:-8] + np.array([np.nan]).tobytes(),
        good[:50],
        b"",
    ):
        place.write_bytes(damaged)
        assert disk.read(place) is None
    other = place.with_name("b.array")
    other.write_bytes(good)
    assert disk.read(other) is None
    pipe = place.with_name("c.array")
    os.mkfifo(pipe)
    assert disk.read(pipe) is None
    disk.write(other / "no folder" / "a.array", np.zeros(3))
