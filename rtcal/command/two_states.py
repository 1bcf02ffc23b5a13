"""``rtcal find``, ``verify`` and ``apply`` with ``--before``: what changed between two measurements."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rtcal.command.console import read_measured, tell, written
from rtcal.command.finder_options import Inputs, Search, add_to_folder
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.finder.states import StatesFinding
    from rtcal.report.document import Heading

PAGE = "report.html"


def find_change(
    inputs: Inputs,
    search: Search,
    before: str,
    folder: Path | None,
    heading: Heading,
    as_json: bool,
    quiet: bool,
) -> None:
    """Find what changed, print it, and write its folder if there is one; then it is verified, too.

    Raises
    ------
    DataError
        Without a room and what was measured in it, and as `rtcal.find` does.
    """
    from rtcal.finder.search import verify
    from rtcal.report import document, finding_pages
    from rtcal.support.results import NUMBERS

    written_here = [] if folder is None else [folder / NUMBERS, folder / PAGE]
    finding = _find(inputs, search, before, written_here)
    printed, record = str(finding), finding.to_dict()
    if folder is not None:
        if finding.can_be_verified:
            verification = verify(finding)
            printed = f"{verification}\n{printed}"
            record["verification"] = verification.to_dict()
        page = finding_pages.states_page(finding, heading, lambda: None)
        paths = [finding.save(folder), folder / PAGE]
        document.write(paths[1], page)
        printed += "\n" + written(paths)
        record["written"] = [str(path) for path in paths]
    tell(printed, record, quiet=quiet, as_json=as_json)


def verify_change(
    inputs: Inputs, search: Search, before: str, earlier: str | None, as_json: bool, quiet: bool
) -> None:
    """Print how well a change predicts pairs that were not fitted: halves, or an earlier finding's."""
    from rtcal.finder.search import verify
    from rtcal.finder.states import StatesFinding
    from rtcal.support.results import load

    if earlier is None:
        finding = _find(inputs, search, before)
        if (nothing := finding.reason_for_none) is not None:
            record = {"verdict": None, "sentence": nothing, "finding": finding.to_dict()}
            tell(nothing, record, quiet=quiet, as_json=as_json)
            return
        result = verify(finding, seed=search.seed)
    else:
        loaded = load(earlier)
        if not isinstance(loaded, StatesFinding):
            raise DataError(f"--finding {earlier} holds no finding of two states")
        _check(inputs, search)
        two = {"before": before, "after": str(inputs.measured)}
        measured = {name: read_measured(path, quiet=quiet) for name, path in two.items()}
        result = verify(loaded, **measured)
    tell(str(result), result.to_dict(), quiet=quiet, as_json=as_json)


def apply_change(
    inputs: Inputs, search: Search, before: str, folder: Path, as_json: bool, quiet: bool
) -> bool:
    """Write the room of the second state into a folder; return whether there was one."""
    from rtcal.finder.states.changed import MESH, ROOM

    if folder.is_file():
        raise DataError(f"--out {folder} is a file; with --before it is a folder")
    finding = _find(inputs, search, before, [folder / ROOM, folder / MESH])
    return add_to_folder(finding, finding.apply, folder, as_json, quiet)


def _check(inputs: Inputs, search: Search) -> None:
    """Raise DataError without a room and a measurement, and for options of a search in one state."""
    if inputs.measured is None:
        raise DataError(
            "--before needs a room and what was measured after: ROOM AFTER --before BEFORE"
        )
    refused = {**inputs.stated, "--prior": search.prior, "--engine": search.engines_stated}
    for option, value in refused.items():
        if value:
            raise DataError(f"{option} is not of a search for what changed between two states")


def _find(
    inputs: Inputs, search: Search, before: str, targets: Sequence[Path] = ()
) -> StatesFinding:
    """Find what changed; no file that is read may be among the targets."""
    from rtcal.acoustics.room import Room
    from rtcal.finder.search import find
    from rtcal.support.files import spare

    _check(inputs, search)
    measured = str(inputs.measured)
    spare(targets, [inputs.case, measured, before])
    room = Room.from_file(inputs.case)
    if room.scene.mesh is not None:
        spare(targets, [room.scene.mesh])
    return find(
        room,
        read_measured(measured, quiet=True),
        before=read_measured(before, quiet=True),
        only=search.only,
        without=search.without,
        seed=search.seed,
    )
