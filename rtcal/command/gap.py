"""``rtcal gap``: plan, find, apply, verify, report."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.command import gap_where
from rtcal.command.assignments import numbers
from rtcal.command.console import (
    bar_wanted,
    heading_options,
    json_option,
    quiet_option,
    said,
    tell,
    written,
)
from rtcal.command.gap_options import (
    ENGINES,
    Inputs,
    Search,
    input_options,
    search_options,
    seed_option,
    several_options,
)
from rtcal.errors import DataError
from rtcal.support.files import spare
from rtcal.support.progress import bar

if TYPE_CHECKING:
    from rtcal.finder import Case, Finding, SeveralFinding
    from rtcal.report.document import Heading

CHANGE = 0.2
"""Relative change of T by each effect for which ``rtcal gap plan`` plans, where none is stated."""
NOTHING_TO_ADD = 6
"""Exit code of ``rtcal gap apply`` if the finding names nothing to add to the model."""


@click.group(short_help="Find what a model misses.")
def gap() -> None:
    """Find what a model misses, add it, and verify it by the gaps that alpha cannot close.

    A ROOM and what was MEASURED in it are two files. If ROOM states a mesh, sources and receivers, and
    MEASURED has every pair of them, the answer says on which surface (docs/where.md). A CASE is one
    file that names a room, its equation, and measurements by configuration (docs/files.md).

    The first search simulates control rooms, which takes a minute or more. They are kept beside ROOM or
    CASE, in .rtcal_cache.
    """


@gap.command(short_help="Which effects the data could tell apart; what to measure next.")
@input_options
@click.option(
    "--change",
    type=float,
    help="Relative change of T by each effect, in the band that changes most; "
    f"{CHANGE:g} unless stated.",
)
@click.option(
    "--next", "after", is_flag=True, help="Go on from what has been measured: search first."
)
@click.option(
    "--cost",
    "costs",
    multiple=True,
    metavar="MEASUREMENT=HOURS",
    help="Hours of a further measurement, such as G=0.5.",
)
@seed_option
@json_option
@quiet_option
def plan(
    inputs: Inputs,
    change: float | None,
    after: bool,
    costs: tuple[str, ...],
    seed: int,
    as_json: bool,
    quiet: bool,
) -> None:
    """Print which effects the data could distinguish, and what to measure next.

    A configuration may state parameters = ["t20", "edt"] in place of measured. If others are measured,
    it is among what could be measured next. Each proposal has the information to expect about which
    effects are there, and its hours. With --next the proposals go on from what has been measured.

    With a geometry the room is searched first. Where several surfaces are in question, places for a
    further receiver are proposed, with the evidence that is to be expected of them.

    Example: rtcal gap plan case.toml
    """
    search = Search(ENGINES, seed, (), (), {})
    if inputs.of_positions:
        for option, stated in (("--change", change is not None), ("--cost", bool(costs))):
            if stated:
                raise DataError(f"{option}: with a geometry a place for a receiver is proposed")
        gap_where.plan(inputs, search, quiet=quiet, as_json=as_json)
        return
    from rtcal.finder import plan as planned_with
    from rtcal.finder.means.set_posterior import EXPECTED

    read = _case(inputs)
    planned = [c for c in read.configurations if c.planned]
    if len(planned) < len(read.configurations):
        measured = [c for c in read.configurations if not c.planned]
        read = replace(read, configurations=measured)
    else:
        planned = []
    finding = None
    if after:
        finding = _find_several(inputs, read, search, quiet, EXPECTED)
    hours = numbers("--cost", costs, "MEASUREMENT=HOURS, such as G=0.5")
    result = planned_with(
        read,
        change=CHANGE if change is None else change,
        finding=finding,
        costs=hours,
        planned=planned,
    )
    tell(str(result), result.to_dict(), quiet=quiet, as_json=as_json)


@gap.command(short_help="Whether the model misses something, and what.")
@search_options
@several_options
def find(
    inputs: Inputs, search: Search, expected: float | None, as_json: bool, quiet: bool
) -> None:
    """Print whether the model misses something, where it shows, and what it is.

    With --several, sets of up to three effects are compared, and each effect has the probability that
    it is there at all.

    Example: rtcal gap find room.toml measured.csv
    """
    if inputs.of_positions:
        _refuse_several(expected)
        gap_where.tell_finding(inputs, search, quiet=quiet, as_json=as_json)
        return
    read = _case(inputs)
    finding: Finding | SeveralFinding
    if expected is None:
        finding = _find(inputs, read, search, quiet)
    else:
        finding = _find_several(inputs, read, search, quiet, expected)
    tell(str(finding), finding.to_dict(), quiet=quiet, as_json=as_json)


@gap.command(short_help="Add the named effect, or the best candidate, to the model.")
@search_options
@click.option(
    "--out",
    type=click.Path(),
    required=True,
    help="The case with the effect (JSON); with a geometry, a folder.",
)
@click.option(
    "--room",
    type=click.Path(dir_okay=False),
    help="The room with the effect (TOML), for rtcal calibrate. Absorbers are materials of it.",
)
@click.option(
    "--form",
    type=click.Choice(("patch", "material")),
    help="With a geometry: a patch on the surface (default), or the whole surface.",
)
@click.option(
    "--at", metavar="X,Y,Z", help="With a geometry: middle of the patch in m, on its surface."
)
@several_options
def apply(
    inputs: Inputs,
    search: Search,
    expected: float | None,
    as_json: bool,
    quiet: bool,
    out: str,
    room: str | None,
    form: str | None,
    at: str | None,
) -> None:
    """Add the named effect to the model, and print the calibration with it.

    If the finding is ambiguous, the best candidate is added, and the others are printed. If there is
    nothing to add, nothing is written and the exit code is 6. With --several, the most probable set is
    added.

    The written case can be used like any other. Neither it nor the room is calibrated.

    With a geometry, a folder gets room, mesh, and lists of materials for CATT and ODEON. The
    patch stands in the middle of its surface unless --at says where.

    \b
    Example: rtcal gap apply case.toml \\
        --out corrected.json --room corrected.toml
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    if inputs.of_positions:
        _refuse_several(expected)
        if room is not None:
            raise DataError("--room: with a geometry the room is written into the folder of --out")
        if os.path.isfile(out):
            raise DataError(f"--out {out} is a file; with a geometry it is a folder")
        patch = gap_where.Patch(form or "patch", _place(at))
        if not gap_where.apply(inputs, search, out, patch, quiet=quiet, as_json=as_json):
            raise click.exceptions.Exit(NOTHING_TO_ADD)
        return
    from rtcal.report.correction import correct
    from rtcal.support.files import write_all

    targets = [out] if room is None else [out, room]
    read = _case(inputs, targets)
    for option, value in (("--form", form), ("--at", at)):
        if value is not None:
            raise DataError(f"{option}: a case without a geometry has no surface")
    finding: Finding | SeveralFinding
    if expected is None:
        finding = _find(inputs, read, search, quiet)
    else:
        finding = _find_several(inputs, read, search, quiet, expected)
    correction = correct(finding, out, room)
    write_all(correction.files)
    tell(str(correction), correction.to_dict(), quiet=quiet, as_json=as_json)
    if not correction.files:
        raise click.exceptions.Exit(NOTHING_TO_ADD)


@gap.command(short_help="Compare the gaps with and without the effect.")
@search_options
def verify(inputs: Inputs, search: Search, as_json: bool, quiet: bool) -> None:
    """Add the named effect, calibrate again, and compare the gaps that alpha cannot close.

    This shows whether the model gets better, not whether the name is right, so the rivals are printed
    too. If there is nothing to add, the output says so. With a geometry, half of the pairs are fitted
    and the others predicted.

    Example: rtcal gap verify case.toml
    """
    if inputs.of_positions:
        gap_where.verify(inputs, search, quiet=quiet, as_json=as_json)
        return
    from rtcal.finder import verify as verified

    finding = _find(inputs, _case(inputs), search, quiet)
    if (nothing := finding.reason_for_none) is not None:
        record = {"verdict": None, "sentence": nothing, "finding": finding.to_dict()}
        tell(nothing, record, quiet=quiet, as_json=as_json)
        return
    result = verified(finding)
    tell(str(result), result.to_dict(), quiet=quiet, as_json=as_json)


@gap.command(short_help="Write finding, verification and figures.")
@search_options
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    required=True,
    help="Folder for the page (report.html), figures (PNG) and numbers (result.json).",
)
@several_options
@heading_options
def report(
    inputs: Inputs,
    search: Search,
    expected: float | None,
    heading: Heading,
    as_json: bool,
    quiet: bool,
    out: str,
) -> None:
    """Write finding, verification and their figures into a folder.

    The page leads with the finding: what is missing, what that rests on and what to do. Then follow the
    calibration with the effect in the model, and last the plain one. With --several it leads with the
    most probable set of effects, each with the probability that it is there.

    Example: rtcal gap report case.toml --out gap
    """
    from rtcal.report.gap_report import WRITTEN, Reproduction, write

    if not out:
        raise DataError("--out is empty; it is a folder")
    if inputs.of_positions:
        _refuse_several(expected)
        gap_where.report(inputs, search, out, heading, quiet=quiet, as_json=as_json)
        return
    read = _case(inputs, [str(Path(out) / name) for name in WRITTEN])
    finding: Finding | SeveralFinding
    several: list[str] = []
    if expected is None:
        finding = _find(inputs, read, search, quiet)
    else:
        finding = _find_several(inputs, read, search, quiet, expected)
        several = ["--several", "--expected", f"{expected:g}"]
    options = [*search.arguments(), *several, "--out", out]
    command = shlex.join(["rtcal", "gap", "report", *inputs.arguments(), *options])
    files = _files(inputs)
    paths = write(finding, Path(out), Reproduction(command, tuple(files), search.seed), heading)
    names = [str(p) for p in paths]
    text = f"{finding}\n{written(names)}"
    tell(text, {"written": names, **finding.to_dict()}, quiet=quiet, as_json=as_json)


def _place(text: str | None) -> tuple[float, ...] | None:
    """Read X,Y,Z; DataError for anything else."""
    if text is None:
        return None
    try:
        place = tuple(float(part) for part in text.split(","))
    except ValueError:
        place = ()
    if len(place) != 3:
        raise DataError(f'--at "{text}" is not X,Y,Z in m, such as 0,4.2,1.5')
    return place


def _refuse_several(expected: float | None) -> None:
    """Raise DataError if several effects are sought with positions."""
    if expected is not None:
        raise DataError("--several: with a geometry one effect is sought at a time")


def _case(inputs: Inputs, targets: Sequence[str] = ()) -> Case:
    """Read the case; DataError if a file to be written is also one of those that are read."""
    from rtcal.acoustics.measurement import Measurement
    from rtcal.acoustics.room import Room
    from rtcal.finder import Case, Configuration

    inputs.refuse_options()
    spare(targets, [inputs.case])
    if inputs.measured is None:
        case = Case.from_file(inputs.case)
        spare(targets, _files(inputs))
        return case
    spare(targets, _files(inputs))
    room = Room.from_file(inputs.case)
    measured = Measurement.from_file(inputs.measured)
    return Case(room=room, configurations=[Configuration(name="as measured", measured=measured)])


def _files(inputs: Inputs) -> list[str]:
    """Return the paths of the files that are read."""
    from rtcal.finder.case_files import files

    if inputs.measured is None:
        return [os.fspath(path) for path in files(inputs.case)]
    return [inputs.case, inputs.measured]


def _find(inputs: Inputs, case: Case, search: Search, quiet: bool) -> Finding:
    """Find what the case's model misses; control rooms are kept beside its file."""
    from rtcal import finder

    with _arguments(inputs, search, quiet) as arguments:
        return finder.find(case, **arguments)


def _find_several(
    inputs: Inputs, case: Case, search: Search, quiet: bool, expected: float
) -> SeveralFinding:
    """Find several effects at once, ``expected`` in number."""
    from rtcal import finder

    with _arguments(inputs, search, quiet) as arguments:
        return finder.find_several(case, expected=expected, **arguments)


@contextmanager
def _arguments(inputs: Inputs, search: Search, quiet: bool) -> Iterator[dict[str, Any]]:
    """Return the arguments of a search, whose progress is shown."""
    begun: list[str] = []
    with bar(0, "control room", bar_wanted(quiet), said(quiet)) as shown:

        def progress(engine: str, done: int, total: int) -> None:
            if engine not in begun and hasattr(shown, "reset"):
                begun.append(engine)
                shown.reset(total=total)
                shown.set_description(f"{engine}, {len(begun)} of {len(search.engines)}")
            shown.update(1)

        yield {
            "seed": search.seed,
            "without": search.without,
            "only": search.only,
            "prior": search.prior,
            "engines": search.engines,
            "cache": inputs.kept,
            "progress": progress,
        }
