"""``rtcal find``, ``verify``, ``apply`` and ``plan``: what a model misses, and what to do about it."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.command.console import (
    as_options,
    errors_name_options,
    force_option,
    heading_options,
    numbers,
    output_folder,
    output_options,
    seed_option,
    tell,
)
from rtcal.command.finder_options import (
    Inputs,
    Search,
    add_to_folder,
    apply_change,
    before_option,
    files_read,
    find_change,
    input_options,
    number_options,
    read_case,
    refuse,
    search_case,
    search_options,
    verified,
    verify_change,
)
from rtcal.support import text
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.finder import positions
    from rtcal.report.document import Heading

CHANGE = 0.2
"""Relative change of T by each effect for which ``rtcal plan`` plans, where none is stated."""
NOTHING_TO_ADD = 6
"""Exit code of ``rtcal apply`` if the finding names nothing to add to the model."""
OF_ONE_STATE = " is not of what changed between two states"
PROPOSED = 3
"""Places for a further receiver that are printed."""


@click.command(short_help="Find what a model misses.")
@search_options
@force_option
@number_options
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Verify it, too, and write page (report.html), figures (PNG) and numbers (result.json) "
    "into this folder.",
)
@before_option
@heading_options
def find(
    inputs: Inputs,
    search: Search,
    number: Mapping[str, Any],
    before: str | None,
    heading: Heading,
    out: str | None,
) -> None:
    """Print whether the model misses something, where it shows, and what it is.

    A ROOM and what was MEASURED in it are two files. If ROOM states a mesh, sources and receivers, and
    MEASURED has every pair of them, the answer says on which surface (docs/where.md). A CASE is one
    file that names a room, its equation, and measurements by configuration (docs/files.md).

    The first search simulates control rooms, which takes a minute or more. They are kept beside ROOM or
    CASE, in .rtcal_cache.

    With --most 3, sets of up to three effects are compared, and each effect has the probability that it
    is there at all. With --out the finding is verified, and its page leads with what is missing,
    what that rests on and what to do.

    With --before, MEASURED is what was measured after a change of the room. What changed is found, with
    its amount, and the room's coefficients do not count (docs/two_states.md).

    Example: rtcal find room.toml measured.csv
    """
    folder = output_folder("--out", out)
    if before is not None:
        refuse(_more_than_one(number), OF_ONE_STATE)
        find_change(inputs, search, before, folder, heading)
        return
    if folder is None:
        finding = search_case(inputs, search, number=number)
        tell(str(finding), finding.to_dict())
        return
    from rtcal.report import finding_pages, gap_report

    targets = [folder / name for name in {*gap_report.WRITTEN, *finding_pages.FILES}]
    finding = search_case(inputs, search, targets, number)
    numbers_stated = [
        word
        for name, value in number.items()
        if value not in (None, 1)
        for word in (f"--{name}", f"{value:g}")
    ]
    words = [
        *inputs.arguments(),
        *search.arguments(),
        *numbers_stated,
        "--out",
        str(out),
    ]
    command, first = shlex.join(["rtcal", "find", *words]), []
    if inputs.at_positions:
        verification = None
        if finding.can_be_verified:
            verification = verified(inputs, finding)
            first = [verification.sentence]
        place = next(iter(_further_places(finding)), None)
        finding_pages.write_where(finding, verification, folder, heading, command, place)
    else:
        files = gap_report.Reproduction(command, tuple(files_read(inputs)), search.seed)
        gap_report.write(finding, folder, files, heading)
    tell("\n".join([*first, str(finding)]), finding.to_dict())


@click.command(short_help="Compare the gaps with and without what was found.")
@search_options
@before_option
@click.option(
    "--finding",
    type=click.Path(exists=True),
    help="With --before: folder of an earlier find --before, whose pairs were others.",
)
def verify(
    inputs: Inputs,
    search: Search,
    before: str | None,
    finding: str | None,
) -> None:
    """Add the named effect, calibrate again, and compare the gaps that alpha cannot close.

    This shows whether the model gets better, not whether the name is right, so the rivals are printed
    too. If there is nothing to add, the output says so. With a geometry, half of the pairs are fitted
    and the others predicted. With --before, too; or an earlier --finding predicts the pairs that it had
    not.

    Example: rtcal verify case.toml
    """
    if before is not None:
        verify_change(inputs, search, before, finding)
        return
    refuse({"--finding": finding}, " needs --before")
    found = search_case(inputs, search)
    nothing = found.reason_for_none
    if nothing is None and not found.can_be_verified and found.undecided:
        nothing = f"Not verified: {as_options(found.undecided, ['effect'])}"
    if nothing is not None:
        record = {"verdict": None, "sentence": nothing, "finding": found.to_dict()}
        tell(nothing, record)
        return
    result = verified(inputs, found)
    tell(str(result), result.to_dict())


@click.command(short_help="Add what was found to the model.")
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
@click.option(
    "--effect",
    metavar="NAME",
    help="The candidate to add; needed where none has a probability of 0.3.",
)
@before_option
@force_option
@number_options
def apply(
    inputs: Inputs,
    search: Search,
    number: Mapping[str, Any],
    out: str,
    room: str | None,
    effect: str | None,
    form: str | None,
    at: str | None,
    before: str | None,
) -> None:
    """Add the named effect to the model, and print the calibration with it.

    If the finding is ambiguous, the best candidate is added if its probability is at least 0.3, and the
    others are printed; else --effect must name one. If there is nothing to add, nothing is written and
    the exit code is 6. With --most 3, the most probable set is added.

    The written case can be used like any other. Neither it nor the room is calibrated. Areas and volume
    stay as stated: absorbers stand free in the room. A volume is changed only where its error is
    claimed, at 0.9.

    With a geometry, a folder gets room, mesh, and lists of materials for CATT and ODEON. The
    patch stands in the middle of its surface unless --at states a place. Where the best family on one
    surface has less than 0.3, --effect or --at must be stated.

    With --before, a folder gets the room of the second state: calibrated to what was measured before,
    with what changed.

    \b
    Example: rtcal apply case.toml \\
        --out corrected.json --room corrected.toml
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    stated = {"--room": room, "--form": form, "--at": at, "--effect": effect}
    if before is not None:
        refuse(stated | _more_than_one(number), OF_ONE_STATE)
        if not apply_change(inputs, search, before, Path(out)):
            raise click.exceptions.Exit(NOTHING_TO_ADD)
        return
    if not inputs.at_positions:
        from rtcal.report.finding_pages import correct
        from rtcal.support.files import write_all

        case = read_case(inputs, [out] if room is None else [out, room])
        of_patch = {k: stated[k] for k in ("--form", "--at")}
        refuse(of_patch, ": a case without a geometry has no surface")
        found = search_case(inputs, search, (), number, case)
        with errors_name_options("effect"):
            correction = correct(found, out, room, effect)
        write_all(correction.files)
        tell(str(correction), correction.to_dict())
        added = bool(correction.files)
    else:
        from rtcal.finder.positions.corrected import FILES

        refuse({"--room": room}, ": with a geometry the room is written into the folder of --out")
        if os.path.isfile(out):
            raise DataError(f"--out {out} is a file; with a geometry it is a folder")
        place = _place(at)
        finding = search_case(inputs, search, [Path(out, name) for name in FILES])
        made = partial(finding.apply, form or "patch", at=place, effect=effect)
        with errors_name_options("effect", "at"):
            added = add_to_folder(finding, made, Path(out))
    if not added:
        raise click.exceptions.Exit(NOTHING_TO_ADD)


@click.command(short_help="Which effects the data could tell apart; what to measure next.")
@input_options
@click.option(
    "--relative-change",
    "change",
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
@output_options
def plan(
    inputs: Inputs,
    change: float | None,
    after: bool,
    costs: tuple[str, ...],
    seed: int,
) -> None:
    """Print which effects the data could distinguish, and what to measure next.

    A configuration may state parameters = ["t20", "edt"] in place of measured. If others are measured,
    it is among what could be measured next. Each proposal has the information to expect about which
    effects are there, and its hours. With --next the proposals go on from what has been measured.

    With a geometry the room is searched first. Where several surfaces are in question, places for a
    further receiver are proposed, with the evidence that is to be expected of them.

    Example: rtcal plan case.toml
    """
    search = Search(seed)
    if inputs.at_positions:
        refuse(
            {"--relative-change": change, "--cost": costs or None},
            ": with a geometry a place for a receiver is proposed",
        )
        _tell_places(search_case(inputs, search))
        return
    from rtcal.finder import plan as planned_with
    from rtcal.finder.means.set_posterior import MOST

    read = read_case(inputs)
    planned = [c for c in read.configurations if c.planned]
    if len(planned) < len(read.configurations):
        measured = [c for c in read.configurations if not c.planned]
        read = replace(read, configurations=measured)
    else:
        planned = []
    result = planned_with(
        read,
        change=CHANGE if change is None else change,
        finding=search_case(inputs, search, number={"most": MOST}, case=read) if after else None,
        costs=numbers("--cost", costs, "MEASUREMENT=HOURS, such as G=0.5"),
        planned=planned,
    )
    tell(str(result), result.to_dict())


def _further_places(finding: positions.PositionsFinding) -> tuple[positions.Place, ...]:
    """Return places for a further receiver, the one that tells most first; none without a question."""
    from rtcal.finder import positions

    if not finding.can_be_added or finding.surface is not None:
        return ()
    try:
        return positions.next_position(finding)
    except DataError:  # at most one surface is in question, or the room is too small for a grid
        return ()


def _tell_places(
    finding: positions.PositionsFinding,
) -> None:
    """Print where a further receiver would tell the surfaces apart that are in question."""
    places = _further_places(finding)[:PROPOSED]
    lines = [*text.wrapped(finding.headline), ""]
    if places:
        names = [f'"{name}"' for name in finding.likely_surfaces]
        lines += text.wrapped(
            "A further receiver is expected to tell these surfaces apart with so many nats of "
            f"evidence (2.3 are odds of ten to one): {', '.join(names)}."
        )
        rows = [
            (f"{', '.join(f'{x:.2f}' for x in place.point)} m", [place.source, f"{place.nats:.1f}"])
            for place in places
        ]
        lines += text.table(rows, header=("receiver", ["source", "nats"]))
    else:
        lines += text.wrapped(
            "No surfaces are in question that a further receiver would tell apart. Which other "
            "measurement would tell most is planned with means over positions: name a case that states "
            "the room, or a measurement of means."
        )
    record = {
        "places": [{**vars(place), "point": list(place.point)} for place in places],
        "finding": finding.to_dict(),
    }
    tell("\n".join(lines), record)


def _more_than_one(number: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of how many effects may be missing, as far as they are stated."""
    most = number["most"] if number["most"] > 1 else None
    return {"--most": most, "--expected": number["expected"]}


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
