"""``rtcal report``: a saved result as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rtcal.command.console import bar_wanted, heading_options, json_option, quiet_option, said, tell
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.report.document import Heading

_FIGURES = 5


@click.command(short_help="Write a saved result as one HTML page.")
@click.argument("result", type=click.Path())
@click.option(
    "--out",
    type=click.Path(dir_okay=False),
    help="Page (HTML) to write, by default report.html beside the result; or, as tables.xlsx, a "
    "workbook of all its tables.",
)
@heading_options
@json_option
@quiet_option
def report(result: str, out: str | None, heading: Heading, as_json: bool, quiet: bool) -> None:
    """Write RESULT as one HTML page: summary, doubts, tables, figures; or its tables as a workbook.

    RESULT is the folder of `rtcal calibrate`, `fit`, `find`, `predict` or `design --out`, its
    result.json, the state of an `rtcal loop`, or the file of `LoopResult.save`. The page needs no
    network and no other file. It can be printed.

    \b
    Example: rtcal report calibrated \\
        --author "A. Consultant" --out hall.html

    \b
    Example: rtcal report calibrated --out hall.xlsx
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal.io import workbook
    from rtcal.report import document, pages, result_folder, tables
    from rtcal.support.files import spare
    from rtcal.support.progress import bar

    if out == "":
        raise DataError("--out is empty; it is a file")
    folder = Path(result) if Path(result).is_dir() else Path(result).parent
    kept = [folder / name for name in result_folder.FILES if (folder / name).exists()]
    target = Path(out) if out is not None else folder / "report.html"
    spare([target], [result, *kept])
    if target.suffix.lower() == workbook.ENDING:
        tables.write(result, target)
        done = {"written": str(target), "bytes": target.stat().st_size}
        tell(f"Written: {target}", done, quiet=quiet, as_json=as_json)
        return
    with bar(_FIGURES, "figure", bar_wanted(quiet), said(quiet)) as shown:
        text = pages.page_of(result, heading=heading, progress=lambda: shown.update(1))
    document.write(target, text)
    tell(
        f"Written: {target}",
        {"written": str(target), "bytes": len(text.encode())},
        quiet=quiet,
        as_json=as_json,
    )
