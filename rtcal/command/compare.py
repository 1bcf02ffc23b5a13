"""``rtcal compare``: where a simulation and a measurement disagree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rtcal.command import console
from rtcal.files.disk import make_folder, spare, write_all


@click.command(short_help="Where your simulation and the measurement disagree.")
@console.takes(
    "ROOM",
    "MEASURED",
    "simulated",
    "at",
    "equation",
    console.folder("Folder for the page (report.html) and all numbers (result.json)."),
)
def compare(
    room: str, measured: str, simulated: str | None, at: str | None, equation: Any, out: Path | None
) -> None:
    """Compare what a program gave for ROOM (TOML) with MEASURED (CSV), by parameter, band and pair.

    Without --simulated the equation's T is compared. It prints one sentence and one table, the
    largest deviation first, in JND and in standard deviations.

    Example: rtcal compare room.toml measured.csv --simulated run.csv --out gap
    """
    from rtcal.acoustics.comparison import compare as compared
    from rtcal.files.saved import NUMBERS
    from rtcal.report import pages
    from rtcal.report.document import PAGE

    files = {} if out is None else {name: out / name for name in (NUMBERS, PAGE)}
    spare([*files.values()], [path for path in (room, measured, simulated, at) if path is not None])
    stated = console.read_room(room)
    with console.without_air_warning():
        run, data = console.read_run(stated, simulated, at), console.read_measured(measured)
        found = compared(stated, data, run, equation=equation)
    if out is not None:
        make_folder(out)
        texts = (found.to_json(out), pages.page(found))
        write_all({path: text.encode() for path, text in zip(files.values(), texts, strict=True)})
    console.tell(str(found), found.to_dict)
