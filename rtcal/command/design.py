"""``rtcal design``: the cheapest treatments with which T meets a target."""

from __future__ import annotations

import click

from rtcal.acoustics.equations import LinearEquation
from rtcal.command.console import output_folder
from rtcal.command.predict import measured_states, read_changes, told, what_is_known


@click.command(short_help="Find the cheapest treatments with which T meets a target.")
@click.argument("room", type=click.Path())
@click.argument("measured", type=click.Path())
@click.option(
    "--treatments",
    type=click.Path(),
    required=True,
    help="File of treatments and target (TOML): `rtcal example change` writes one; see docs/files.md.",
)
@click.option("--probability", type=float, help="0.8 or more; by default that of the file.")
@what_is_known
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

    output_folder("--out", out)
    before, states = measured_states(room, measured, also)
    stated, target, in_file = read_changes(
        treatments, lambda text: read_treatments(text, before, catalogue.material)
    )
    found = cheapest(
        Known(states, before, equation),
        stated,
        target,
        in_file if probability is None else probability,
    )
    told(found, out, quiet=quiet, as_json=as_json)
