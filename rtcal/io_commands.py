"""``rtcal measure``, ``table``, ``import`` and ``export``: foreign files in and out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from rtcal.acoustics.files import spare
from rtcal.errors import DataError

if TYPE_CHECKING:
    from rtcal.io.impulse_responses import Analysis
    from rtcal.io.tables import Table

PROGRAMS = ("catt", "odeon", "pyroomacoustics", "bras")


@click.command()
@click.argument("responses", type=click.Path(), nargs=-1, required=True)
@click.option(
    "--bands", type=click.Choice(("octave", "third-octave")), default="octave", show_default=True
)
@click.option(
    "--minimum-range", "ranges", multiple=True, metavar="PARAMETER=DB",
    help="The impulse-to-noise ratio that a parameter needs, in place of ISO 3382's: t30=38.",
)  # fmt: skip
@click.option("--out", type=click.Path(dir_okay=False), help="Measurement (CSV) to write.")
def measure(
    responses: tuple[str, ...], bands: str, ranges: tuple[str, ...], out: str | None
) -> None:
    """T20, T30, EDT, C50, C80, D50 and Ts of RESPONSES (WAV), and why any is missing.

    Example: rtcal measure *.wav --out t.csv
    """
    from rtcal.io import impulse_responses

    spare([] if out is None else [out], responses)
    analysis = impulse_responses.read(
        responses, bands=bands, minimum_range=_assignments(ranges, "DB")
    )
    _write_and_print(analysis, out)


@click.command()
@click.argument("path", type=click.Path())
@click.option("--decay-time", help="t20 or t30: what a column RT60 or T60 holds.")
@click.option("--parameter", help="What the values are, where the table does not say it.")
@click.option("--out", type=click.Path(dir_okay=False), help="Measurement (CSV) to write.")
def table(path: str, decay_time: str | None, parameter: str | None, out: str | None) -> None:
    """Read a measuring system's table (CSV) and say how each column was taken."""
    from rtcal.io import tables

    spare([] if out is None else [out], [path])
    _write_and_print(tables.read(path, decay_time=decay_time, parameter=parameter), out)


def _write_and_print(found: Analysis | Table, out: str | None) -> None:
    """The file first: whoever reads the page may close it half-way (``| head``)."""
    if out is not None:
        found.measurement.save(out)
    click.echo(str(found))
    if out is not None:
        click.echo(f"Written: {out}")


@click.command("import")
@click.argument("program", type=click.Choice(PROGRAMS))
@click.argument("materials", type=click.Path())
@click.option("--mesh", type=click.Path(), help="OBJ with the materials' names: areas and volume.")
@click.option("--unit", type=float, default=1.0, show_default=True, help="The mesh's unit in m.")
@click.option("--volume", type=float, help="m³, without a mesh.")
@click.option(
    "--area", "areas", multiple=True, metavar="MATERIAL=M2", help="Without a mesh, one a material."
)
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room (TOML) to write.")
def import_room(
    program: str,
    materials: str,
    mesh: str | None,
    unit: float,
    volume: float | None,
    areas: tuple[str, ...],
    out: str,
) -> None:
    """Make a room of a program's MATERIALS and a mesh, or stated areas and volume.

    Example: rtcal import catt hall.geo --volume 2000 --area wood=300 --out room.toml
    """
    from importlib import import_module

    from rtcal.io import obj

    spare([out], [materials] if mesh is None else [materials, mesh])
    listed = import_module(f"rtcal.io.{program}").read(materials)
    name = Path(materials).stem
    if (mesh is None) == (volume is None and not areas):
        raise DataError("either --mesh, or --volume and --area, say how large the room is")
    if mesh is not None:
        polyhedron = obj.read(mesh, unit=unit)
        room = listed.room(name=name, volume=polyhedron.volume, areas=polyhedron.surfaces)
    elif volume is None:
        raise DataError("--volume is missing")
    else:
        stated = _assignments(areas, "M2")
        room = listed.room(name=name, volume=volume, areas=stated)
    room.save(out)
    click.echo(f"V = {room.volume:.6g} m³, S = {room.total_area:.6g} m²")
    for material, area in zip(room.materials, room.areas, strict=True):
        click.echo(f"{area:10.3f} m²  {material}")
    if unused := [m for m in listed.names if m not in room.materials]:
        click.echo(f"Left out, without area: {', '.join(unused)}")
    click.echo(f"Written: {out}")


@click.command()
@click.argument("program", type=click.Choice(PROGRAMS))
@click.argument("room", type=click.Path())
@click.argument("materials", type=click.Path())
@click.option(
    "--template", type=click.Path(), help="Program's own file to change; else MATERIALS itself."
)
def export(program: str, room: str, materials: str, template: str | None) -> None:
    """Write ROOM's coefficients into a program's MATERIALS; print what the rounding does to T.

    Example: rtcal export catt calibrated/room.toml hall.geo
    """
    from importlib import import_module

    from rtcal.acoustics.room import Room

    module = import_module(f"rtcal.io.{program}")
    click.echo(str(module.write(Room.from_file(room), materials, template=template)))


def _assignments(texts: tuple[str, ...], unit: str) -> dict[str, float]:
    pairs = [_assignment(text, unit) for text in texts]
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = next(name for i, (name, _) in enumerate(pairs) if name in dict(pairs[:i]))
        raise DataError(f'"{twice}" is given twice')
    return found


def _assignment(text: str, unit: str) -> tuple[str, float]:
    name, _, value = text.rpartition("=")
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not name or number != number:
        raise DataError(f'"{text}" is not NAME={unit}')
    return name, number
