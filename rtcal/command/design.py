"""``rtcal design``: the cheapest treatments with which T meets a target."""

from __future__ import annotations

import click

from rtcal.acoustics.equations import LinearEquation
from rtcal.command.console import (
    equation_option,
    json_option,
    output_folder,
    quiet_option,
    tell,
    written,
)
from rtcal.command.predict import MAX_BYTES, also_option, measured_states
from rtcal.errors import DataError


@click.command(short_help="Find the cheapest treatments with which T meets a target.")
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@click.option(
    "--treatments",
    type=click.Path(),
    required=True,
    help="File of treatments and target (TOML); see docs/files.md.",
)
@click.option("--probability", type=float, help="0.8 or more; by default that of the file.")
@also_option
@equation_option
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for all numbers (result.json), of which `rtcal report` makes a page.",
)
@json_option
@quiet_option
def design(
    room: str,
    measured: str,
    treatments: str,
    probability: float | None,
    also: tuple[tuple[str, str], ...],
    equation: LinearEquation,
    out: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Find the cheapest treatments of ROOM (TOML), MEASURED (CSV) as it is.

    JND here is ln(T ratio) / ln 1.05.

    Example: rtcal design room.toml t20.csv --treatments treatments.toml
    """
    from rtcal.acoustics.treatments import read_treatments
    from rtcal.datasets import catalogue
    from rtcal.prediction.designed import Known
    from rtcal.prediction.designed import design as cheapest
    from rtcal.support.files import read_text

    folder = output_folder("--out", out)
    before, states = measured_states(room, measured, also)
    try:
        stated, target, in_file = read_treatments(
            read_text(treatments, MAX_BYTES), before, catalogue.material
        )
    except DataError as error:
        raise DataError(f"{treatments}: {error}") from error
    found = cheapest(
        Known(states, before, equation),
        stated,
        target,
        in_file if probability is None else probability,
    )
    text = str(found)
    if folder is not None:
        text += "\n" + written([found.save(folder)])
    tell(text, found.to_dict(), quiet=quiet, as_json=as_json)
