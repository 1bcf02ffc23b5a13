"""``rtcal compare``, ``find``, ``verify``, ``apply``, ``diagnose`` and ``plan``: what a model misses.

`find` and `diagnose` search. `verify`, `apply` and `plan` read the finding that was written with
``--out``.
"""

from __future__ import annotations

import hashlib
import json
import os
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.command import console
from rtcal.files.disk import command, make_folder, replace_file, spare, write_all
from rtcal.files.saved import CannotBeSavedError, Result, load, plain
from rtcal.files.schema import RESULT, kind_of
from rtcal.support import __version__
from rtcal.support.blocks import lines
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.finder.finding import Finding
    from rtcal.finder.positions.places import Place

CHANGE = 0.2
"""Relative change of T by each effect for which ``rtcal plan`` plans, where none is stated."""
NOTHING_TO_ADD = 6
"""Exit code of ``rtcal apply`` if the finding names nothing to add to the model."""
PROPOSED = 3
"""Places for a further receiver that are printed."""
SEEDS = (0, 1, 2)
"""Seeds of the simulator over which a gap at positions is printed."""
_OF_POSITIONS = ("match", "exclude", "scattering", "paths")
_OF_DIAGNOSIS = (*_OF_POSITIONS, "seed", "scheduler")
"""Options of `diagnose` that `find` and `fit` take, too."""
_OF_MEANS = ("prior", "most", "program")
_DEFAULTS = (("most", 1), ("seed", 0))
_OF_RUN = ("simulated", "at", "program")
_NEEDS_POSITIONS = (
    " needs positions: a room with [sources] and [receivers], and a measurement with a row for each "
    "pair"
)
_ENDINGS = (".csv", ".json", ".toml")
"""Endings of the files that rtcal reads, which no folder of `apply` has."""


def stated(options: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """Return the values of the options of these names that are not at their defaults."""
    every = {name: options.get(name) for name in names}
    return {k: v for k, v in every.items() if v not in (None, ()) and (k, v) not in _DEFAULTS}


def _is_case(options: Mapping[str, Any]) -> bool:
    """Whether what is measured is stated by the case, and not beside a room."""
    return not stated(options, "measured", "t20", "t30")


def files_of(options: Mapping[str, Any]) -> list[str]:
    """Return the paths of the files that ``rtcal find`` reads."""
    from rtcal.finder.case import files_of_case

    if _is_case(options):
        return [os.fspath(path) for path in files_of_case(options["case"])]
    return [*stated(options, "case", "measured", "before", "simulated", "at").values()]


def read_case(options: Mapping[str, Any], targets: Sequence[str | Path] = ()) -> Any:
    """Return the case of ``rtcal find``; DataError if a file to be written is one of those read."""
    from rtcal.finder import Case, case_of

    path, before = options["case"], options.get("before")
    spare(targets, [path])
    if _is_case(options):
        if kind_of(path) == "a room" or before is not None:
            raise DataError(
                f"the measurement is missing: give the file MEASURED after {path}, or --t20 or --t30 "
                "of `rtcal find`; with --before in the order ROOM AFTER --before BEFORE"
            )
        refuse(stated(options, *_OF_POSITIONS), _NEEDS_POSITIONS)
        refuse(stated(options, *_OF_RUN), f" cannot be given with a case: write it into {path}")
        case = Case.from_file(path)
        spare(targets, files_of(options))
        return case
    room = console.read_room(path)
    spare(targets, [*files_of(options), room.scene.mesh])
    measured = console.measured(
        room,
        options.get("measured"),
        quietly=before is not None,
        t20=options.get("t20"),
        t30=options.get("t30"),
    )
    at_positions = bool(room.scene.sources) and not measured.is_summary
    more: dict[str, Any] = {}
    if before is not None:
        more["before"] = console.read_measured(before, quietly=True)
        at_positions = at_positions and not more["before"].is_summary
        every = (*_OF_POSITIONS, *_OF_MEANS, *_OF_RUN, "scheduler")
        others = [n for n in every if n != "scattering"]
        refuse(stated(options, *others), " cannot be given with --before: leave it out")
    run = console.read_run(room, options.get("simulated"), options.get("at"))
    if not at_positions:
        refuse(stated(options, *_OF_POSITIONS), _NEEDS_POSITIONS)
        if before is None:
            more |= {"simulated": run, **stated(options, "program")}
        return case_of(room, measured, **more)
    refuse(
        stated(options, *_OF_MEANS),
        " cannot be used with positions: leave it out, or search with means, with a room "
        "without [sources] and [receivers]",
    )
    if before is None:
        more |= stated(options, "match") | {
            "exclude": console.pairs("--exclude", options.get("exclude", ()))
        }
        more["simulated"] = run
    tracing = {"paths": "n_paths", "scattering": "scattering"}
    more["tracing"] = {tracing[k]: v for k, v in stated(options, *tracing).items()}
    with console.errors_name_options("scattering", "match", "exclude"):
        return case_of(room, measured, **more)


def searched(options: Mapping[str, Any], targets: Sequence[str | Path] = ()) -> Any:
    """Return the finding for the options of `rtcal find`, which is kept: a search is made once."""
    from rtcal.finder import Case, search

    case = read_case(options, targets)
    chosen = {name: options[name] for name in ("seed", "without", "only")}
    if isinstance(case, Case):
        chosen["most"] = options["most"]
        chosen["prior"] = console.numbers(
            "--prior", options["prior"], "EFFECT=ODDS, such as opening=2"
        )
    cache = kept_beside(options["case"])

    def find() -> Any:
        if options["before"] is not None:
            return search.find(case, **chosen)
        more = stated(options, "scheduler")
        with _progress("step") as progress:
            return search.find(case, **chosen, **more, cache=cache, progress=progress)

    return _once(cache, case, chosen, find)


def _once(cache: Path, of: Any, options: Mapping[str, Any], make: Callable[[], Result]) -> Any:
    """Return what is kept of the same object and options, else what ``make`` gives, which is kept."""
    try:
        content = json.dumps([plain(of), options, __version__], sort_keys=True)
        path = cache / f"{hashlib.sha256(content.encode()).hexdigest()[:32]}.json"
    except CannotBeSavedError:
        return make()
    with suppress(DataError):
        return load(path)
    made = make()
    with suppress(DataError):  # a folder that cannot be written costs the time alone
        make_folder(cache)
        replace_file(path, made.to_json().encode())
        return load(path)  # it is written as it is read, so that what is made of it has one name
    return made


def kept_beside(path: str) -> Path:
    """Return the folder in which simulations are kept, beside a case, room or finding."""
    from rtcal.finder.means.engines import FOLDER

    return Path(path).parent / FOLDER


def _as_given(options: Mapping[str, Any]) -> tuple[str, ...]:
    """Return options by name as words of a command line, an option of several values once for each."""
    every = ((name, v if isinstance(v, tuple) else (v,)) for name, v in options.items())
    return tuple(word for name, values in every for v in values for word in (f"--{name}", str(v)))


def refuse(stated: Mapping[str, object], why: str) -> None:
    """Raise DataError for the first option that is stated."""
    for option, value in stated.items():
        if value is not None:
            raise DataError(f"--{option}{why}")


@contextmanager
def _progress(unit: str) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each step of a computation."""
    with console.progress_bar(0, unit) as shown:

        def progress(step: str, done: int, total: int) -> None:
            if done < shown.n or total != shown.total:
                shown.reset(total=total)
            shown.set_description(step)
            shown.update(done - shown.n)

        yield progress


def saved(path: str) -> tuple[Any, Any]:
    """Return the finding that ``find`` or ``diagnose --out`` wrote, and its verification or None."""
    from rtcal.finder.diagnosis import Diagnosis
    from rtcal.finder.finding import Finding
    from rtcal.finder.verification import Verification

    result: Result = load(path)
    if isinstance(result, Verification):
        return result.finding, result
    if isinstance(result, Diagnosis):
        return result.finding, result.verification
    if isinstance(result, Finding):
        return result, None
    kind = result.record_kind.rstrip(" 0123456789")
    raise DataError(
        f"{path} is the result of another command ({kind}), but a finding is needed. Make "
        "one with `rtcal find room.toml t.csv --out found`"
    )


def verified(finding: Any, cache: Path, scheduler: str | None = None) -> Any:
    """Return the verification of a finding, which is kept in ``cache``; None if it cannot be made."""
    if not finding.can_be_verified:
        return None
    make = partial(_verified, finding, cache, scheduler=scheduler)
    return _once(cache, finding, {"seeds": SEEDS}, make)


def _verified(finding: Any, cache: Path, **options: Any) -> Any:
    """Return `rtcal.finder.verify` of a finding; at positions over `SEEDS`, with progress."""
    from rtcal import finder

    if finding.kind != "positions":
        return finder.verify(finding, **{k: v for k, v in options.items() if v is not None})
    with _progress("model") as progress:
        return finder.verify(finding, seeds=SEEDS, cache=cache, progress=progress, **options)


@click.command(short_help="Where your simulation and the measurement disagree.")
@console.takes(
    "ROOM",
    "MEASURED",
    "simulated",
    "at",
    "equation",
    console.folder("Folder for the page (report.html) and all numbers (result.json)."),
)
def compare(args: Namespace) -> None:
    """Compare your program's results for ROOM (TOML) with MEASURED (CSV), by parameter, band and pair.

    Without --simulated, T of the reverberation equation is compared. Prints one sentence and one table
    of the deviations in JND and in standard deviations, the largest first.

    Example: rtcal compare room.toml measured.csv --simulated run.csv --out gap
    """
    from rtcal.acoustics.comparison import compare as compared
    from rtcal.files.saved import NUMBERS
    from rtcal.report import pages
    from rtcal.report.document import PAGE

    read = [args.room, args.measured, args.simulated, args.at]
    spare([args.out / NUMBERS, args.out / PAGE] if args.out else [], read)
    stated = console.read_room(args.room)
    run = console.read_run(stated, args.simulated, args.at)
    data = console.read_measured(args.measured)
    found = compared(stated, data, run, equation=args.equation)
    if args.out is not None:
        texts = {NUMBERS: found.to_json(args.out), PAGE: pages.page(found)}
        write_all({args.out / name: text.encode() for name, text in texts.items()}, args.out)
    console.tell(str(found), found.to_dict)


@click.command(short_help="Find what a model misses.")
@console.takes(
    click.argument("case", metavar="CASE|ROOM", type=click.Path()),
    "MEASURED?",
    "t20",
    "t30",
    "before",
    "simulated",
    "at",
    console.choice(
        "program",
        ("geometrical",),
        "Kind of program that made --simulated. A program that traces rays or image sources uses no "
        "equation and has an uneven field of its own, so that neither is taken for an error of the "
        "room. Only for means over positions.",
    ),
    "match",
    "exclude",
    "scattering",
    "paths",
    console.several("without", "EFFECT", "Do not try this effect."),
    console.several(
        "only",
        "EFFECT",
        "Try only this effect; with means over positions, an unknown effect is tried beside it.",
    ),
    console.several(
        "prior",
        "EFFECT=ODDS",
        "Prior odds of an effect, of none or of coefficients: opening=2.",
    ),
    console.option(
        "most", int, "Largest number of effects that may be missing at once, up to 3.", default=1
    ),
    "seed",
    "scheduler",
    console.option(
        "out",
        click.Path(),
        "Folder for page (report.html), figures (PNG) and the finding (result.json), which is "
        "then verified, too; or a file that ends in .json, for the finding alone.",
    ),
    *console.HEADING,
)
def find(args: Namespace) -> None:
    """Print whether something is missing from a room's model, and what it is.

    Give the files of a ROOM and of what was MEASURED in it. If ROOM has a mesh, sources and receivers,
    and MEASURED has every pair of them, the answer says on which surface (docs/where.md). Or give one
    CASE, a file that names a room, its equation, and measurements by configuration (docs/files.md).

    The first search simulates reference rooms, which takes a minute or more. Simulations and findings
    are kept beside ROOM or CASE, in .rtcal_cache, so that a later search is quicker.

    With --most 3, sets of up to three effects are compared, and the probability of an effect is that of
    all sets that contain it. With --out the finding is written for `rtcal verify`, `apply`, `plan` and
    `report`.

    With --simulated, your program's result is compared with the measurement in place of the equation's
    T, so that an error of the equation is not taken for an error of the model (docs/compare.md).

    With --before, MEASURED was measured after a change of the room. The search finds what changed, and
    by how much, without using the room's coefficients (docs/two_states.md).

    \b
    Example: rtcal find room.toml measured.csv --out found
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal.report import of_finding
    from rtcal.report.document import page_files
    from rtcal.report.finding_words import blocks

    if args.out == "":
        raise DataError("--out is empty; give the name of a folder")
    target = None if args.out is None else Path(args.out)
    if target is None or target.suffix == ".json":
        finding = searched(vars(args), [] if target is None else [target])
        if target is not None:
            finding.save(target)
        console.tell(str(finding), finding.to_dict)
        return
    finding = searched(vars(args), [target / name for name in of_finding.WRITTEN])
    verification = verified(finding, kept_beside(args.case), args.scheduler)
    place = next(iter(_further_places(finding)), None)
    made = of_finding.page(finding, verification, command(), place)
    contents = page_files(made, verification or finding, target, console.heading(args))
    write_all(contents, target)
    record = finding.to_dict()
    if verification is not None:
        record["verification"] = verification.to_dict()
    console.tell("\n".join(lines(blocks(finding, verification))), record)


_EFFECT = console.option(
    "effect",
    None,
    "The candidate to add; needed where none has a probability of 0.3.",
    metavar="NAME",
)


_PLACE = console.option(
    "place",
    None,
    "With a geometry: middle of the patch in m, on its surface.",
    "at",
    metavar="X,Y,Z",
    callback=lambda context, parameter, text: _place(text),
)


@click.command(short_help="Compare the deviations with and without what was found.")
@console.takes(
    "FOUND",
    "simulated",
    console.file(
        "calibrated",
        "With --simulated, what the program gave of the model calibrated without the correction.",
    ),
    _EFFECT,
    _PLACE,
    "before",
    console.file(
        "after",
        "With --before, for two states: what was measured after the change at the pairs that the "
        "finding predicts.",
    ),
    console.folder("Folder for the page (report.html), its figures and all numbers (result.json)."),
)
def verify(args: Namespace) -> None:
    """Verify that the effect which was found improves the model at data that it was not fitted to.

    FOUND is the folder that `rtcal find --out` wrote. The model is calibrated without and with the
    effect, and the deviations that alpha cannot remove are compared. This shows whether the model gets
    better, not whether the name of the effect is right; other candidates are therefore printed, too.
    With a geometry, and with `rtcal find --before`, half of the pairs are fitted and the other half is
    predicted. With --before and --after, the change that was found predicts further pairs.

    If your program's result was given to `rtcal find`, --simulated is its result for the corrected
    model, which `rtcal apply` describes. Both results are then calibrated before they are compared: for
    means the equation scales them to the measured T; with a geometry rtcal's tracer calibrates them to
    half of the pairs, and the other half is compared. --out writes a page of the verification.

    \b
    Example: rtcal verify found
    Example: rtcal verify found --simulated corrected_run.csv --out verified
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal import finder
    from rtcal.report import of_finding
    from rtcal.report.document import page_files

    read = [args.found, args.before, args.after, args.simulated, args.calibrated]
    spare([args.out / name for name in of_finding.WRITTEN] if args.out else [], read)
    finding, verification = saved(args.found)
    if args.before is not None or args.after is not None:
        if finding.kind != "states" or args.before is None or args.after is None:
            raise DataError(
                "--before and --after belong together, and to a finding of `rtcal find --before`: give "
                "both, with the same source-receiver pairs"
            )
        further: Any = {
            "before": console.read_measured(args.before),
            "after": console.read_measured(args.after),
        }
        verification = finder.verify(finding, **further)
    runs = {"simulated": args.simulated, "calibrated": args.calibrated}
    some: dict[str, Any] = {
        n: console.read_measured(path) for n, path in runs.items() if path is not None
    }
    some |= stated(vars(args), "effect", "at")
    if some:
        with console.errors_name_options(*runs, "effect", at="place"):
            verification = _verified(finding, kept_beside(args.found), **some)
    if verification is None:
        nothing = str(finding.refusal or "")
        if not nothing and finding.kind == "means" and not finding.can_be_verified:
            together = "Several effects were found together; search with --most 1."
            nothing = f"Not verified. {of_finding.chosen(finding, args.found) or together}"
        if nothing:
            record = {"verdict": None, "sentence": nothing, "finding": finding.to_dict()}
            console.tell(nothing, record)
            return
        verification = verified(finding, kept_beside(args.found))
        if verification is None:  # too few pairs, which this raises
            verification = finder.verify(finding)
    if args.out is not None:
        page = of_finding.page(verification, command=command())
        write_all(page_files(page, verification, args.out), args.out)
    console.tell(str(verification), verification.to_dict)


@click.command(short_help="Add what was found to the model.")
@console.takes(
    "FOUND",
    click.option("--out", type=click.Path(), required=True, help="Folder for the files."),
    console.choice(
        "form",
        ("patch", "material"),
        "With a geometry: a patch on the surface (default), or the whole surface.",
    ),
    _PLACE,
    _EFFECT,
)
def apply(args: Namespace) -> None:
    """Add what was found to the model, and write the room with it into a folder.

    FOUND is the folder that `rtcal find --out` wrote. The most probable effect is added, or the most
    probable set of effects if you searched with --most 3. If its probability is below 0.3, you must
    choose an effect by --effect. If nothing was detected (verdict none or hint), only an effect that
    you choose is added; without --effect no file is written, and the exit code is 6.

    room.toml is the room with the effect and the input coefficients: calibrate it before you use it. An
    absorber is an additional material, and the areas of your room stay the same. The volume is changed
    only if it was identified as wrong, with a probability of at least 0.9. case.json is the case with
    the effect, for `rtcal find`. The calibration with the effect is only printed.

    With a geometry, room.obj is the mesh. With a geometry, or with your program's result, catt.txt,
    odeon.txt and pyroomacoustics.json are lists of materials. With a geometry, the effect is a patch in
    the middle of its surface, or about the point of --place. If the most probable group of effects on
    one surface has a probability below 0.3, you must give --effect or --place.

    If your program's result was given to `rtcal find`, instructions.txt lists what to change in the
    program's materials, what to draw, and what the program cannot contain.

    If FOUND is from `rtcal find --before`, room.toml is the room after the change: calibrated to the
    measurement before the change, with what changed added.

    If the verification in FOUND warns against simulating with the model, the printed text, room.toml,
    case.json, catt.txt and caution.txt repeat the warning.

    Example: rtcal apply found --out corrected
    """
    from rtcal.report import of_finding

    finding, verification = saved(args.found)
    target = Path(args.out)
    if target.is_file() or target.suffix in _ENDINGS:
        what = "is a file" if target.is_file() else "is the name of a file"
        raise DataError(
            f"--out {args.out} {what}, but the results need a folder. Give a folder, such as "
            f"--out {target.with_suffix('')}"
        )
    with console.errors_name_options("effect", "form", at="place"):
        options = console.rest(args, "found", "out")
        said, record, files = of_finding.correct(finding, target, verification, **options)
    if files:
        make_folder(target)
    write_all(files)
    console.tell(said, record)
    if not files:
        raise click.exceptions.Exit(NOTHING_TO_ADD)


@click.command(
    short_help="All at once: where and why a model deviates, and what remains after the correction."
)
@console.takes(
    click.argument("case", metavar="CASE|ROOM", type=click.Path()),
    "MEASURED?",
    "match",
    "exclude",
    "scattering",
    "paths",
    "seed",
    "scheduler",
    console.folder(
        "Folder for one page (report.html) with its figures, the calibrated room (room.toml, with "
        "its mesh and its lists of materials where there are any) and all numbers (result.json)."
    ),
    *console.HEADING,
)
def diagnose(args: Namespace) -> None:
    """Find what is missing from a room's model, verify it, add it and calibrate the model.

    It does what `rtcal find`, `verify`, `apply` and `fit` do with these options, and prints the
    commands. An effect with a probability below 0.3, or whose verification has the verdict "withdrawn",
    is not added: the model is then calibrated as given, and the text says so.

    Example: rtcal diagnose room.toml pairs.csv --out diagnosis
    """
    from rtcal.finder.apply import CASE, CAUTION, LISTS, MESH, ROOM
    from rtcal.finder.diagnosis import diagnosis
    from rtcal.report import of_diagnosis, of_finding

    files = (*of_finding.WRITTEN, ROOM, CASE, MESH, *LISTS, CAUTION)
    defaults = {
        "before": None,
        "simulated": None,
        "without": (),
        "only": (),
        "prior": (),
        "most": 1,
    }
    targets = [args.out / name for name in files] if args.out else []
    finding = searched(defaults | vars(args), targets)
    cache = kept_beside(args.case)
    verification = verified(finding, cache, args.scheduler)
    given = tuple(filter(None, (args.case, args.measured)))
    result = replace(
        diagnosis(finding, verification, seed=args.seed, cache=cache),
        given=given,
        options=_as_given(stated(vars(args), *_OF_DIAGNOSIS)),
    )
    if args.out is not None:
        written = of_diagnosis.contents(result, args.out, console.heading(args))
        write_all(written, args.out)
    console.tell(str(result), result.to_dict)


@click.command(short_help="Which effects the data could distinguish; what to measure next.")
@console.takes(
    click.argument("case", metavar="CASE|FOUND", type=click.Path()),
    console.option(
        "relative-change",
        float,
        "Relative change of T by each effect, in the band that changes most; "
        f"{CHANGE:g} by default.",
        "change",
    ),
    console.option(
        "case",
        click.Path(dir_okay=False),
        "With FOUND: a case whose configurations without measurements could be measured next.",
        "further",
    ),
    console.several(
        "cost", "MEASUREMENT=HOURS", "Hours of a further measurement, such as G=0.5.", "costs"
    ),
    console.flag(
        "all", "Name the effects that the data do not distinguish, for each effect.", "all_named"
    ),
    writes=False,
)
def plan(args: Namespace) -> None:
    """Print which effects the data could distinguish, and what to measure next.

    Give a CASE to plan before anything is measured: its configurations then have parameters = ["t20",
    "edt"] in place of measured. If other configurations were measured, these planned ones are among the
    proposals. Each proposal has its hours, and the share of the uncertainty about the effects that it
    is expected to remove.

    Give FOUND, the folder that `rtcal find --out` wrote, to plan the next measurement; search with
    --most 3 for the best proposals. With a geometry, if several surfaces are possible, the proposals
    are positions for a further receiver, with the number of measured pairs that would distinguish the
    surfaces as well.

    Example: rtcal plan case.toml
    """
    from rtcal.finder import Case
    from rtcal.finder import plan as planned_with
    from rtcal.report.finding_words import of_plan

    finding = None
    if Path(args.case).is_dir() or kind_of(args.case) == RESULT:
        finding, _ = saved(args.case)
        if finding.kind != "means":
            refused = {
                "relative-change": args.change,
                "cost": args.costs or None,
                "case": args.further,
            }
            refuse(refused, ": with a geometry a place for a receiver is proposed")
            _tell_places(finding)
            return
        read = finding.case
        every = [] if args.further is None else Case.from_file(args.further).configurations
    else:
        refuse({"case": args.further}, " needs a finding")
        read = Case.from_file(args.case)
        every = read.configurations
        if measured := [c for c in every if not c.planned]:
            read = replace(read, configurations=measured)
        else:
            every = ()  # all are planned, and none is to be proposed
    result = planned_with(
        read,
        change=CHANGE if args.change is None else args.change,
        finding=finding,
        costs=console.numbers("--cost", args.costs, "MEASUREMENT=HOURS, such as G=0.5"),
        planned=[c for c in every if c.planned],
    )
    console.tell("\n".join(lines(of_plan(result, every=args.all_named))), result.to_dict)


def _further_places(finding: Any) -> tuple[Place, ...]:
    """Return places for a further receiver, the one that tells most first; none without a question."""
    from rtcal.finder import positions

    asked = finding.kind == "positions" and finding.can_be_added and finding.surface is None
    try:
        return positions.next_position(finding) if asked else ()
    except DataError:  # at most one surface is in question, or the room is too small for a grid
        return ()


def _tell_places(finding: Finding) -> None:
    """Print where a further receiver would distinguish the surfaces that are in question."""
    from rtcal.report.finding_words import of_places

    places = _further_places(finding)[:PROPOSED]
    record = {
        "places": [{**vars(place), "point": list(place.point)} for place in places],
        "finding": finding.to_dict(),
    }
    console.tell("\n".join(lines(of_places(finding, places))), record)


def _place(stated: str | None) -> tuple[float, ...] | None:
    """Read X,Y,Z; DataError for anything else."""
    if stated is None:
        return None
    try:
        place = tuple(float(part) for part in stated.split(","))
    except ValueError:
        place = ()
    if len(place) != 3:
        raise DataError(f'--place "{stated}" must have the form X,Y,Z in m, such as 0,4.2,1.5')
    return place
