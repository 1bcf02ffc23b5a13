"""``rtcal find --before``: what changed between two measurements of one room."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rtcal.command.console import tell, written
from rtcal.command.finder_options import Inputs, Search
from rtcal.errors import DataError

if TYPE_CHECKING:
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
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.finder.search import find, verify
    from rtcal.report import document, states_page
    from rtcal.support.files import spare
    from rtcal.support.results import NUMBERS

    if inputs.measured is None:
        raise DataError(
            "--before needs a room and what was measured after: ROOM AFTER --before BEFORE"
        )
    refused = {**inputs.stated, "--prior": search.prior, "--engine": search.engines_stated}
    for option, value in refused.items():
        if value:
            raise DataError(f"{option} is not of a search for what changed between two states")
    if folder is not None:
        spare([folder / NUMBERS, folder / PAGE], [inputs.case, inputs.measured, before])
    finding = find(
        Room.from_file(inputs.case),
        Measurement.from_file(inputs.measured),
        before=Measurement.from_file(before),
        only=search.only,
        without=search.without,
        seed=search.seed,
    )
    printed, record = str(finding), finding.to_dict()
    if folder is not None:
        if finding.can_be_verified:
            verification = verify(finding)
            printed = f"{verification}\n{printed}"
            record["verification"] = verification.to_dict()
        page = states_page.page(finding, heading, lambda: None)
        paths = [finding.save(folder), folder / PAGE]
        document.write(paths[1], page)
        printed += "\n" + written(paths)
        record["written"] = [str(path) for path in paths]
    tell(printed, record, quiet=quiet, as_json=as_json)
