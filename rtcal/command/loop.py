"""``rtcal loop start`` and ``next``: the closed loop with a program that is run by hand."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace

import click
import numpy as np

from rtcal.command import console
from rtcal.files.disk import may_replace, spare

_STATE = console.file("state", "File of the loop's state (JSON).", required=True)
_OUT = console.file("out", "Room to simulate next (TOML) to write.", required=True)
_AGAIN = console.flag(
    "again", "Accept a table that is likely the wrong one, such as that of an earlier step."
)


@click.group(short_help="The closed loop with a program that is run by hand.")
def loop() -> None:
    """Calibrate a program run by hand (CATT, ODEON): start, simulate, next, simulate, ..."""


@loop.command(short_help="Begin: write what to simulate first.")
@console.takes(
    "ROOM",
    "MEASURED",
    _STATE,
    _OUT,
    "method",
    "equation",
    console.choice(
        "rule",
        ("secant", "safeguarded"),
        "How the loop chooses the next target; see docs/closed_loop.md.",
        default="safeguarded",
    ),
    console.several(
        "weight",
        "PARAMETER=NUMBER",
        "Match the mean of T20 and EDT with these weights: --weight t20=1 --weight edt=0.5.",
        "weights",
    ),
    "decimals",
    "modes",
    "simulated",
    "at",
    _AGAIN,
)
def start(args: Namespace) -> None:
    """Write ROOM (TOML) with the coefficients that your program must simulate first.

    The loop ends when the program gives T in MEASURED (CSV). With --simulated it begins with a
    simulation that you already have, and the coefficients are those with which the program, not the
    equation, is expected to give the measured T.

    A state that holds simulations is not overwritten: delete it to begin anew.

    \b
    Example: rtcal loop start room.toml t.csv \\
        --state loop.json --out next.toml --decimals 3
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal.acoustics.marks import cautions
    from rtcal.loop import closed
    from rtcal.support import text

    spare([args.state, args.out], [args.room, args.measured, args.modes, args.simulated, args.at])
    closed.refuse_progress(args.state)
    prior, data = console.read_room(args.room), console.read_measured(args.measured)
    weighted = console.numbers("--weight", args.weights, "PARAMETER=NUMBER, such as edt=0.5")
    known = prior if args.modes is None else console.told_by_modes(prior, args.modes)
    run = console.read_run(prior, args.simulated, args.at)
    options = {name: getattr(args, name) for name in ("method", "equation", "rule", "decimals")}
    begun = closed.start(known, data, weights=weighted or None, run=run, **options)
    if args.simulated is not None and not args.again:
        closed.refuse_doubtful(replace(begun, steps=()), begun.steps[0], args.simulated)
    unreachable = begun.calibrated(begun.wanted).unreachable
    first = []
    if run is not None:
        worst = float(np.nanmax(np.abs(begun.gap)))
        first = [
            f"{args.simulated} is the loop's first run: its T deviates from the measured T by up to "
            f"{worst:.1f} JND.",
            *begun.notes,
        ]
    record = {
        "state": args.state,
        "simulate": args.out,
        "unreachable": [f"{band} (the nearest is taken)" for band in unreachable],
        "measured": begun.matched.time_label,
        "matched": begun.matched.label,
    }
    who = "the program is expected to give"
    if run is None:
        who = f"{begun.equation.name}'s equation gives"
    matched = begun.matched.label if args.weights else begun.matched.time_label
    said = [
        f"With the coefficients in {args.out}, {who} the measured {matched}.",
        *(f"{band}. The coefficients with the nearest T are used." for band in unreachable),
        *first,
        *cautions(begun.marks_of_next, lettered=False),
        *([] if begun.low is None else [begun.low.loop_note]),
    ]
    lines = [line for each in said for line in text.wrapped(each)]
    console.tell("\n".join([*lines, closed.write(begun, args.state, args.out)]), record)


@loop.command(name="next", short_help="Go on: read what was simulated.")
@console.takes(
    "ROOM",
    "SIMULATED",
    _STATE,
    _OUT,
    _AGAIN,
)
def next_(args: Namespace) -> None:
    """Read what the program SIMULATED (CSV) and write the room to simulate next.

    ROOM is the file that `start` read. `rtcal report STATE` shows the steps so far, and `rtcal loop
    back` takes the last step back.

    \b
    Example: rtcal loop next room.toml simulated.csv \\
        --state loop.json --out next.toml
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal.acoustics.room import Room
    from rtcal.loop import closed

    before = closed.Loop.load(args.state, Room.from_file(args.room))
    may_replace(args.state)  # a copy of a state is a state, too
    spare([args.state, args.out], [args.room, args.simulated])
    after = closed.record(
        before,
        console.read_measured(args.simulated),
        args.simulated,
        args.state,
        args.out,
        again=args.again,
    )
    end = closed.write(after, args.state, args.out)
    console.tell(f"{after}\n{end}", {"state": args.state, "simulate": args.out, **after.to_dict()})


@loop.command(short_help="Take the last step back.")
@console.takes("ROOM", _STATE, _OUT)
def back(args: Namespace) -> None:
    """Forget the table that `next` read last, and write the room to simulate in its place.

    \b
    Example: rtcal loop back room.toml \\
        --state loop.json --out next.toml
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal.acoustics.room import Room
    from rtcal.loop import closed

    before = closed.Loop.load(args.state, Room.from_file(args.room)).back()
    may_replace(args.state)
    spare([args.state, args.out], [args.room])
    n = len(before.steps)
    then = closed.write(before, args.state, args.out)
    said = f"{args.state} now holds {n} simulation{'s' * (n != 1)}. {then}"
    console.tell(said, {"simulations": n, "state": args.state, "simulate": args.out})
