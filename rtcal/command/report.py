"""``rtcal report``: a saved result as one HTML page."""

from __future__ import annotations

from pathlib import Path

import click

from rtcal.command.console import bar_wanted, json_option, quiet_option, tell
from rtcal.errors import DataError

_FIGURES = 5


@click.command(short_help="Write a saved result as one HTML page.")
@click.argument("result", type=click.Path())
@click.option(
    "--out",
    type=click.Path(dir_okay=False),
    help="Page (HTML) to write; by default report.html beside the result.",
)
@json_option
@quiet_option
def report(result: str, out: str | None, as_json: bool, quiet: bool) -> None:
    """Write RESULT as one HTML page: summary, doubts, figures, tables.

    RESULT is the folder of `rtcal calibrate --out`, its result.json, the state of an `rtcal loop`, or
    the file of `LoopResult.save`. The page needs no network and no other file.

    Example: rtcal report calibrated --out calibrated.html
    """
    from rtcal.report import page, result_folder
    from rtcal.support.files import spare
    from rtcal.support.progress import bar

    if out == "":
        raise DataError("--out is empty; it is a file")
    folder = Path(result) if Path(result).is_dir() else Path(result).parent
    kept = [folder / name for name in result_folder.FILES if (folder / name).exists()]
    target = Path(out) if out is not None else folder / "report.html"
    spare([target], [result, *kept])
    with bar(_FIGURES, "figure", bar_wanted(quiet)) as shown:
        text = page.page_of(result, progress=lambda: shown.update(1))
    page.write(target, text)
    tell(
        f"Written: {target}",
        {"written": str(target), "bytes": len(text.encode())},
        quiet=quiet,
        as_json=as_json,
    )
