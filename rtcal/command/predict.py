"""``rtcal predict`` and ``design``: T after changes of a room with its interval, and what to change."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.acoustics.equations import LinearEquation
from rtcal.command import console
from rtcal.files.disk import read_text
from rtcal.files.schema import expecting
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.acoustics.room import Room
    from rtcal.calibration.result import CalibrationResult
    from rtcal.files.saved import Result


MAX_BYTES = 2**18
"""Largest size of a file of variants or treatments in bytes."""
_KNOWN = (
    console.option(
        "also",
        click.Path(),
        "A further measured state: the same room with other areas. It narrows the interval most.",
        nargs=2,
        multiple=True,
        metavar="ROOM MEASURED",
    ),
    "equation",
    console.folder("Folder for all numbers (result.json), of which `rtcal report` makes a page."),
)
"""Options of measured states, of the equation, and of what is done with the result."""


def told(found: Result, out: Path | None) -> None:
    """Write a result's file where asked for, and print the result."""
    if out is not None:
        found.save(out)
    console.tell(str(found), found.to_dict)


@click.command(short_help="Predict T after changes of a room, and how sure that is.")
@console.takes(
    "ROOM",
    "MEASURED?",
    console.option(
        "change",
        click.Path(),
        "File of variants (TOML): `rtcal example change` writes one; see docs/files.md.",
        required=True,
    ),
    *_KNOWN,
    "simulated",
    "at",
)
def predict(args: Namespace) -> None:
    """Predict T of ROOM (TOML) after changes, from T MEASURED (CSV) before them.

    The model predicts only the change, which is applied to the measured T. One JND is 5 % of T. Without
    MEASURED, T is predicted from the input coefficients alone.

    --simulated is your program's result before the change. For each variant that names the result after
    the change, simulated = "after.csv", their ratio of T replaces that of the equation.

    ROOM may be the folder that `rtcal calibrate` or `rtcal fit` wrote, without MEASURED. From a fit,
    T20, EDT, C80, Ts, level, D50 and STI are predicted at every position.

    Example: rtcal predict room.toml t20.csv --change variants.toml
    """
    from rtcal.acoustics.changes import read_variants
    from rtcal.datasets import catalogue
    from rtcal.loop.positions import PositionsResult
    from rtcal.loop.predicted import predict_positions
    from rtcal.prediction.predicted import known_room, predict_variants

    # What the file of variants states is checked before anything is calibrated.
    known = saved(args.room, args.measured, args.also)
    before = console.read_room(args.room) if known is None else getattr(known, "prior", None)
    if before is None:
        raise DataError(
            f"{args.room} is not the result of a calibration. Give a folder that `rtcal "
            "calibrate --out` or `rtcal fit --out` wrote"
        )
    with expecting("a file of variants", args.change):
        text = read_text(args.change, MAX_BYTES)
        variants, target = read_variants(text, before, catalogue.material, Path(args.change).parent)
    run = console.read_run(before, args.simulated, args.at)
    if run is None and any(v.simulated is not None for v in variants):
        raise DataError(
            f"{args.change} has simulated, the program's result after a change, but its result "
            "before the change is missing. Add it with --simulated"
        )
    if run is not None and (
        isinstance(known, PositionsResult) or (known is None and args.measured is None)
    ):
        raise DataError(
            "--simulated needs the measured T before the change, because it is multiplied "
            "by the program's ratio of T. Add MEASURED, or give a folder of `rtcal "
            "calibrate`"
        )
    if not isinstance(known, PositionsResult):
        if known is None and (args.measured is not None or args.also):
            known = calibrated(before, args.measured, args.also, args.equation)
        if known is None:
            as_input = known_room(before, args.equation)
            told(predict_variants(as_input, variants, target=target), args.out)
            return
        if before.scene.sources:
            console.note(
                "T is predicted by an equation. To predict every position, give a folder of `rtcal "
                "fit` instead"
            )
        told(predict_variants(known, variants, target=target, run=run), args.out)
        return
    if target is not None:
        raise DataError(
            f"{args.change}: a target needs T from an equation, but {args.room} is a result of "
            "`rtcal fit`. Leave the target out, or give a folder of `rtcal calibrate`"
        )
    with console.control_bar() as progress:
        at_positions = predict_positions(
            known,
            variants,
            position_uncertainty=before.scene.position_uncertainty,
            progress=progress,
        )
    told(at_positions, args.out)


def saved(room: str, measured: str | None, also: tuple[tuple[str, str], ...]) -> Result | None:
    """Return the result in a folder; None if ``room`` is a file. A folder has its own T."""
    from rtcal.files.saved import load

    if not Path(room).is_dir():
        return None
    of_equation = click.get_current_context().get_parameter_source("equation")
    own = {
        "MEASURED": ("measured T", measured is not None or also),
        "--equation": ("equation", of_equation is click.core.ParameterSource.COMMANDLINE),
    }
    for name, (what, given) in own.items():
        if given:
            raise DataError(
                f"{name} is given, but the calibration in the folder {room} has its own {what}. "
                f"Leave {name} out"
            )
    found: Result = load(room)
    return found


def calibrated(
    room: Room, measured: str | None, also: tuple[tuple[str, str], ...], equation: LinearEquation
) -> CalibrationResult:
    """Return the calibration of a room to its measured T, and to that of further configurations."""
    from rtcal.calibration.measured import tell_data, times_in_room
    from rtcal.calibration.methods import calibrate
    from rtcal.calibration.unknowns import Configurations

    if measured is None:
        raise DataError(
            "MEASURED is missing: give the file with the T of the room before the change"
        )
    rooms = [room, *(console.read_room(path) for path, _ in also)]
    times = [
        console.read_measured(path, quietly=True)
        for path in (measured, *(path for _, path in also))
    ]
    for state, heard in zip(rooms, times, strict=True):
        tell_data(state, heard)
    if not also:
        return calibrate(rooms[0], times[0], equation=equation)
    given = [
        (times_in_room(state, heard).fingerprint, state.areas.tolist())
        for state, heard in zip(rooms, times, strict=True)
    ]
    for i, each in enumerate(given):
        if each in given[:i]:
            raise DataError(
                f"--also {' '.join(also[i - 1])}: this measurement is also given elsewhere "
                "in the command; leave one of them out"
            )
    every = [each.name for each in rooms]
    names = [
        f"{name} ({i})" if every.count(name) > 1 else name for i, name in enumerate(every, start=1)
    ]
    joint = calibrate(Configurations(rooms, names), times, method="joint", equation=equation)
    return joint.results[0]


@click.command(short_help="Find the cheapest treatments with which T meets a target.")
@console.takes(
    "ROOM",
    "MEASURED?",
    console.option(
        "treatments",
        click.Path(),
        "File of treatments and target (TOML): `rtcal example change` writes one; see "
        "docs/files.md.",
        required=True,
    ),
    click.option("--probability", type=float, help="0.8 or more; by default that of the file."),
    *_KNOWN,
)
def design(args: Namespace) -> None:
    """Find the cheapest treatments of ROOM (TOML) with which T meets a target.

    MEASURED (CSV) is T of the room as it is. Without it, ROOM must be the folder that `rtcal calibrate`
    wrote. Panels with a `unit` are not cut. T is predicted as by `rtcal predict`.

    Example: rtcal design room.toml t20.csv --treatments treatments.toml
    """
    from rtcal.acoustics.changes import read_treatments
    from rtcal.calibration.result import CalibrationResult
    from rtcal.datasets import catalogue
    from rtcal.prediction.designed import design as cheapest

    result: Any = saved(args.room, args.measured, args.also)
    if result is None:
        room = console.read_room(args.room)
        result = calibrated(room, args.measured, args.also, args.equation)
    if not isinstance(result, CalibrationResult):
        raise DataError(
            f"{args.room} is not the result of `rtcal calibrate`. Give a folder that `rtcal "
            "calibrate --out` wrote"
        )
    with expecting("a file of treatments", args.treatments):
        text = read_text(args.treatments, MAX_BYTES)
        stated, target, in_file = read_treatments(text, result.prior, catalogue.material)
    probability = in_file if args.probability is None else args.probability
    told(cheapest(result, stated, target, probability), args.out)
