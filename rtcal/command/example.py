"""``rtcal example``: files to start from."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from rtcal.command.console import json_option, output_folder, quiet_option, tell, written

_PURPOSES = {
    "room": "a room and a measured T",
    "change": "variants to predict, a target to design to",
    "responses": "impulse responses and a mesh",
    "program": "a CATT list and a table of T",
    "simulator": "a simulator in Python",
    "optimisation": "terms, solvers and the certificate",
    "missing-effect": "a model that may lack something",
    "told": "two rooms: one effect named, one not",
    "where": "a mesh and twelve pairs: on which surface?",
}
_LIST = "\b\n" + "\n".join(f"    {name:16s}{text}" for name, text in _PURPOSES.items())


@click.command(
    short_help="Write files to start from.",
    help=f"""Write the files of a small project, and print the commands that use them.

    {_LIST}

    Example: rtcal example room --out my-room
    """,
)
@click.argument("name", type=click.Choice(tuple(_PURPOSES)))
@click.option("--out", type=click.Path(file_okay=False), help="Folder to write; NAME if not given.")
@json_option
@quiet_option
def example(name: str, out: str | None, as_json: bool, quiet: bool) -> None:
    """Write the files of a small project, and print the commands that use them."""
    from rtcal.datasets import examples
    from rtcal.support.errors import DataError
    from rtcal.support.files import make_folder, write_all
    from rtcal.support.text import shell

    project = examples.example(name)
    folder = output_folder("--out", out) or Path(name)
    targets = {folder / file: content for file, content in project.files.items()}
    if present := [path for path in targets if path.exists()]:
        raise DataError(f"{present[0]} exists; an example writes over no file: give another --out")
    make_folder(folder)
    write_all(targets)
    commands = [f"cd {shlex.quote(str(folder))}", *project.commands]
    lines = [written(list(targets)), "", "Next:"]
    lines += [line for command in commands for line in shell(command, "  ")]
    tell(
        "\n".join(lines),
        {"written": [str(path) for path in targets], "commands": list(project.commands)},
        quiet=quiet,
        as_json=as_json,
    )
