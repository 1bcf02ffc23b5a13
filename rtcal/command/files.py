"""``rtcal measure``, ``table``, ``import`` and ``export``: foreign files in and out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from rtcal.command.console import bar_wanted, json_option, quiet_option, tell
from rtcal.errors import DataError
from rtcal.support.files import spare

if TYPE_CHECKING:
    from rtcal.io.impulse_responses import Analysis
    from rtcal.io.tables import Table

PROGRAMS = ("catt", "odeon", "pyroomacoustics", "bras")


@click.command(short_help="Impulse responses (WAV) to T20, T30, EDT, C50, C80, D50, Ts.")
@click.argument("responses", type=click.Path(), nargs=-1, required=True)
@click.option(
    "--bands",
    type=click.Choice(("octave", "third-octave")),
    default="octave",
    show_default=True,
    help="Width of the bands.",
)
@click.option(
    "--minimum-range",
    "ranges",
    multiple=True,
    metavar="PARAMETER=DB",
    help="The impulse-to-noise ratio that a parameter needs, in place of ISO 3382's: t30=38.",
)
@click.option("--out", type=click.Path(dir_okay=False), help="Measurement (CSV) to write.")
@json_option
@quiet_option
def measure(
    responses: tuple[str, ...],
    bands: str,
    ranges: tuple[str, ...],
    out: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """T20, T30, EDT, C50, C80, D50 and Ts of RESPONSES (WAV), and why any is missing.

    Example: rtcal measure *.wav --out t.csv
    """
    from rtcal.io import impulse_responses
    from rtcal.support.progress import bar

    spare([] if out is None else [out], responses)
    with bar(len(responses), "response", bar_wanted(quiet)) as shown:
        analysis = impulse_responses.read(
            responses,
            bands=bands,
            minimum_range=_assignments(ranges, "DB"),
            progress=lambda: shown.update(1),
        )
    if not quiet and all(np.isnan(v).all() for v in analysis.measurement.values.values()):
        click.echo("rtcal: no parameter could be determined; the reasons are listed", err=True)
    notes = {
        "impulse_to_noise_ratio_db": analysis.impulse_to_noise_ratio,
        "missing": analysis.missing,
        "notes": analysis.notes,
    }
    _write_and_tell(analysis, notes, out, as_json, quiet)


@click.command(short_help="A measuring system's table (CSV) to a measurement.")
@click.argument("path", type=click.Path())
@click.option("--decay-time", help="t20 or t30: what a column RT60 or T60 holds.")
@click.option("--parameter", help="What the values are, where the table does not say it.")
@click.option("--out", type=click.Path(dir_okay=False), help="Measurement (CSV) to write.")
@json_option
@quiet_option
def table(
    path: str,
    decay_time: str | None,
    parameter: str | None,
    out: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Read a measuring system's table (CSV) and say how each column was taken.

    Example: rtcal table dirac.csv --decay-time t20 --out t.csv
    """
    from rtcal.io import tables

    spare([] if out is None else [out], [path])
    found = tables.read(path, decay_time=decay_time, parameter=parameter)
    _write_and_tell(found, {"columns": found.columns}, out, as_json, quiet)


def _write_and_tell(
    found: Analysis | Table, notes: dict[str, Any], out: str | None, as_json: bool, quiet: bool
) -> None:
    """The file first: whoever reads the page may close it half-way (``| head``)."""
    if out is not None:
        found.measurement.save(out)
    measurement = found.measurement
    record = {
        "centre_frequencies": measurement.centre_frequencies,
        "pairs": measurement.pairs,
        "values": measurement.values,
        **notes,
        "written": out,
    }
    text = str(found) if out is None else f"{found}\nWritten: {out}"
    tell(text, record, quiet=quiet, as_json=as_json)


@click.command("import", short_help="A program's material list and a mesh to a room.")
@click.argument("program", type=click.Choice(PROGRAMS))
@click.argument("materials", type=click.Path())
@click.option("--mesh", type=click.Path(), help="OBJ with the materials' names: areas and volume.")
@click.option("--unit", type=float, default=1.0, show_default=True, help="The mesh's unit in m.")
@click.option("--volume", type=float, help="m³, without a mesh.")
@click.option(
    "--area", "areas", multiple=True, metavar="MATERIAL=M2", help="Without a mesh, one a material."
)
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="Room (TOML) to write.")
@json_option
@quiet_option
def import_room(
    program: str,
    materials: str,
    mesh: str | None,
    unit: float,
    volume: float | None,
    areas: tuple[str, ...],
    out: str,
    as_json: bool,
    quiet: bool,
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
    unused = [m for m in listed.names if m not in room.materials]
    areas_of = dict(zip(room.materials, room.areas.tolist(), strict=True))
    lines = [
        f"V = {room.volume:.6g} m³, S = {room.total_area:.6g} m²",
        *(f"{area:10.3f} m²  {material}" for material, area in areas_of.items()),
        *([f"Left out, without area: {', '.join(unused)}"] if unused else []),
        f"Written: {out}",
    ]
    record = {"volume": room.volume, "areas": areas_of, "left_out": unused, "written": out}
    tell("\n".join(lines), record, quiet=quiet, as_json=as_json)


@click.command(short_help="A calibrated room into a program's material list.")
@click.argument("program", type=click.Choice(PROGRAMS))
@click.argument("room", type=click.Path())
@click.argument("materials", type=click.Path())
@click.option(
    "--template", type=click.Path(), help="Program's own file to change; else MATERIALS itself."
)
@click.option(
    "--decimals",
    type=click.IntRange(0, 15),
    help="Decimals of a coefficient (3: a tenth of a percent); else the format's.",
)
@json_option
@quiet_option
def export(
    program: str,
    room: str,
    materials: str,
    template: str | None,
    decimals: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write ROOM's coefficients into a program's MATERIALS; print what the rounding does to T.

    Example: rtcal export catt calibrated/room.toml hall.geo
    """
    from importlib import import_module

    from rtcal.acoustics.room import Room

    module = import_module(f"rtcal.io.{program}")
    done = module.write(Room.from_file(room), materials, template=template, decimals=decimals)
    record = {
        "written": done.path,
        "equation": done.equation,
        "centre_frequencies": done.room.centre_frequencies,
        "reverberation_time": done.reverberation_time,
        "reverberation_time_as_read": done.reverberation_time_as_read,
        "change_jnd": done.change,
        "bands_not_written": done.bands_not_written,
    }
    tell(str(done), record, quiet=quiet, as_json=as_json)


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
