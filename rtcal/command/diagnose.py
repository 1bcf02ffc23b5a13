"""``rtcal diagnose``: find, verify, apply and calibrate in one command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.command import console
from rtcal.command.finder import kept_beside, searched, verified
from rtcal.files.disk import make_folder, write_all

if TYPE_CHECKING:
    from rtcal.report.document import Heading


@click.command(
    short_help="All at once: where a model is off, why, and what is left when it is mended."
)
@console.takes(
    click.argument("case", metavar="CASE|ROOM", type=click.Path()),
    "MEASURED?",
    "match",
    "exclude",
    "scattering",
    "paths",
    "seed",
    console.folder(
        "Folder for one page (report.html) with its figures, the calibrated room (room.toml, with "
        "its mesh and its lists of materials where there are any) and all numbers (result.json)."
    ),
    console.heading_options,
)
def diagnose(heading: Heading, out: Path | None, **options: Any) -> None:
    """Find what the model misses, verify it, add it and calibrate: one answer, one page.

    It stands for `rtcal find`, `verify`, `apply` and `fit`, with their defaults, and prints them. What
    has a probability of less than 0.3, or is withdrawn by its verification, is not added: the model is
    then calibrated as it is given, and the text says so.

    Example: rtcal diagnose room.toml pairs.csv --out diagnosis
    """
    from rtcal.finder.apply import CASE, CATT, MESH, ODEON, ROOM
    from rtcal.finder.diagnosis import diagnosis
    from rtcal.report import of_diagnosis, of_finding

    files = (*of_finding.WRITTEN, ROOM, CASE, MESH, CATT, ODEON)
    defaults = {
        "before": None,
        "simulated": None,
        "without": (),
        "only": (),
        "prior": (),
        "most": 1,
    }
    finding = searched(defaults | options, [] if out is None else [out / name for name in files])
    cache = kept_beside(options["case"])
    verification = verified(finding, cache) if finding.can_be_verified else None
    given = tuple(filter(None, (options["case"], options["measured"])))
    result = replace(diagnosis(finding, verification, cache=cache), given=given)
    if out is not None:
        written = of_diagnosis.contents(result, out, heading)
        make_folder(out)
        write_all(written)
    console.tell(str(result), result.to_dict)
