"""``rtcal gap``: plan, find, apply, verify, report."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.errors import DataError

if TYPE_CHECKING:
    from rtcal.discrepancy import Case, Finding
    from rtcal.discrepancy.engines import Report

_QUIET_SECONDS = 2.0


@click.group()
def gap() -> None:
    """Find what a model misses, add it, and see whether the gap shrinks where alpha cannot make it.

    CASE is a TOML file: a room, its equation, and measurements by configuration (docs/discrepancy.md).
    """


def _common(command: Any) -> Any:
    for option in (
        click.option("--quiet", is_flag=True, help="Print nothing but errors."),
        click.option("--json", "as_json", is_flag=True, help="Print JSON in place of the tables."),
        click.option(
            "--seed", default=0, show_default=True, help="Of the control rooms and the bootstrap."
        ),
        click.option(
            "--engine", "engines", multiple=True,
            help="At least two simulators for the control rooms; path tracing and network if not "
            "given.",
        ),
        click.argument("case", type=click.Path()),
    ):  # fmt: skip
        command = option(command)
    return command


@gap.command()
@click.argument("case", type=click.Path())
@click.option(
    "--change", default=0.2, show_default=True,
    help="How much the effects are to change T, at the most changed band.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON in place of the table.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def plan(case: str, change: float, as_json: bool, quiet: bool) -> None:
    """Say which effects CASE's data could tell apart, before measuring.

    A configuration may state parameters = ["t20", "edt"] in place of measured.
    """
    from rtcal.discrepancy import plan as planned

    made = planned(_case(case), change=change)
    if not quiet:
        click.echo(json.dumps(made.to_dict(), indent=1) if as_json else str(made))


@gap.command()
@_common
def find(case: str, engines: tuple[str, ...], seed: int, as_json: bool, quiet: bool) -> None:
    """Say whether CASE's model misses something, where it shows, and what it is."""
    finding = _find(_case(case), engines, seed, quiet)
    if not quiet:
        click.echo(json.dumps(finding.to_dict(), indent=1) if as_json else str(finding))


@gap.command()
@_common
@click.option(
    "--out", type=click.Path(dir_okay=False), required=True, help="The case with the effect (JSON)."
)
def apply(
    case: str, engines: tuple[str, ...], seed: int, as_json: bool, quiet: bool, out: str
) -> None:
    """Add the named effect to CASE's model; the corrected case is a case like any other."""
    from rtcal.acoustics.files import spare

    spare([Path(out)], [case])
    finding = _find(_case(case), engines, seed, quiet)
    corrected = finding.apply()
    corrected.save(out)
    if not quiet:
        added = [{"effect": p.effect, **p.parameters} for p in corrected.present]
        click.echo(json.dumps(added) if as_json else f"Added {finding.effect}. Written: {out}")


@gap.command()
@_common
def verify(case: str, engines: tuple[str, ...], seed: int, as_json: bool, quiet: bool) -> None:
    """Add the named effect, calibrate again, and compare the gaps that alpha cannot close."""
    from rtcal.discrepancy import verify as verified

    result = verified(_find(_case(case), engines, seed, quiet))
    if not quiet:
        click.echo(json.dumps(result.to_dict(), indent=1) if as_json else str(result))


@gap.command()
@_common
@click.option(
    "--out", type=click.Path(file_okay=False), required=True, help="Folder for figures and JSON."
)
def report(
    case: str, engines: tuple[str, ...], seed: int, as_json: bool, quiet: bool, out: str
) -> None:
    """Write finding, verification and their figures into a folder."""
    from rtcal.report import gap_report

    finding = _find(_case(case), engines, seed, quiet)
    written = gap_report.write(finding, Path(out))
    if not quiet:
        names = [str(p) for p in written]
        click.echo(json.dumps(names) if as_json else f"{finding}\nWritten: {', '.join(names)}")


def _case(path: str) -> Case:
    from rtcal.discrepancy import Case

    return Case.from_file(path)


def _find(case: Case, engines: tuple[str, ...], seed: int, quiet: bool) -> Finding:
    from rtcal import discrepancy

    if any(c.planned for c in case.configurations):
        raise DataError(
            "a configuration states parameters but no measurement: it can only be planned"
        )
    chosen = engines or ("path tracing", "network")
    return discrepancy.find(case, seed=seed, engines=chosen, report=_bar(quiet))


def _bar(quiet: bool) -> Report:
    """A progress line on standard error, where a person looks on, beyond two seconds."""
    begun = time.monotonic()

    def show(engine: str, done: int, of: int) -> None:
        stream = click.get_text_stream("stderr")
        if quiet or not stream.isatty() or time.monotonic() - begun < _QUIET_SECONDS:
            return
        filled = round(20 * done / of)
        end = "\n" if done == of else ""
        bar = "#" * filled + "." * (20 - filled)
        click.echo(f"\rcontrol rooms, {engine:14} [{bar}] {done}/{of}{end}", err=True, nl=False)

    return show
