"""``rtcal learn``: what a folder of calibrated rooms says of their materials."""

from __future__ import annotations

from pathlib import Path

import click

from rtcal.command.console import (
    entries_option,
    json_option,
    numbers,
    output_folder,
    quiet_option,
    tell,
    texts,
    written,
)
from rtcal.support import text
from rtcal.support.errors import DataError
from rtcal.support.files import make_folder, spare, write_all

LIBRARY_ROOM = "room.toml"


@click.command(short_help="A library of materials from a folder of calibrated rooms.")
@click.argument("folder", type=click.Path())
@entries_option
@click.option(
    "--room-weight",
    "weights",
    multiple=True,
    metavar="ROOM=WEIGHT",
    help="How far a room counts, from 0 (left out) to 1. The option may be repeated.",
)
@click.option(
    "--apply",
    "room",
    type=click.Path(),
    help="A room (TOML) that gets the library's coefficients: room.toml of --out.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False),
    help="Folder for the archive (result.json), and with --apply for the room (room.toml).",
)
@json_option
@quiet_option
def learn(
    folder: str,
    entries: tuple[str, ...],
    weights: tuple[str, ...],
    room: str | None,
    out: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Learn from the results below FOLDER, as rtcal calibrate --out writes them.

    Example: rtcal learn rooms --apply new.toml --out library

    It prints each material's coefficients, what each room says beside the others, and which material is
    likely misnamed. Nothing leaves this machine.
    """
    from rtcal.acoustics.room import Room
    from rtcal.archive import rooms
    from rtcal.support.results import NUMBERS

    target = output_folder("--out", out)
    if room is not None and target is None:
        raise DataError("--apply writes a room: say where with --out")
    if target is not None:
        read = [*map(str, Path(folder).rglob(NUMBERS)), *([] if room is None else [room])]
        spare([target / NUMBERS, target / LIBRARY_ROOM], read)
    called = texts("--as", entries, "MATERIAL=ENTRY")
    archive = rooms.learn(
        rooms.read_folder(folder),
        called,
        numbers("--room-weight", weights, "ROOM=WEIGHT, such as hall=0.5"),
    )
    said, record = str(archive), archive.to_dict()
    if target is not None:
        files = {target / NUMBERS: archive.to_json().encode()}
        if room is not None:
            new = Room.from_file(room)
            of_room = {name: entry for name, entry in called.items() if name in new.materials}
            known, left = archive.apply(new, of_room), archive.left_as_stated(new, of_room)
            record["left_as_stated"] = list(left)
            said = "\n".join([said, *(line for each in left for line in text.wrapped(each))])
            files[target / LIBRARY_ROOM] = known.to_text(target).encode()
        make_folder(target)
        write_all(files)
        said += "\n" + written([*files])
    tell(said, record, quiet=quiet, as_json=as_json)
