"""A case in a geometry as TOML, which refers to the files of room, mesh, positions and measurement.

::

    room = "room.toml"
    geometry = "room.obj"              # or "box": the room's dimensions, with a surface per wall
    positions = "positions.toml"       # sources and receivers
    measured = "pairs.csv"             # a row for each source and receiver

    unit = 0.001                       # optional: of the mesh, in m
    scattering = 0.4                   # optional: of every material, unless the room states it
    paths = 8000                       # optional
    match = ["t20", "edt", "c80"]      # optional
    exclude = [["S1", "R3"]]           # optional
    simulated = "program.csv"          # optional: another program's values at the same pairs
    position_uncertainty = 0.1         # optional, m
    [surfaces]                         # optional: names of the faces of each surface
    "south wall" = ["face 3", "face 7"]
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH
from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.io import geometry_files, position_files
from rtcal.loop.control_runs import POSITION
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.arguments import checked
from rtcal.support.decode import Entries, toml_table
from rtcal.support.files import read_text

MAX_BYTES = 50_000_000
LEAST_PATHS, MOST_PATHS = 100, 10_000_000
"""Fewer paths leave decays without a T; more do not fit into memory."""
BOX = "box"
"""Value of ``geometry`` for the box of the room's dimensions."""
_NEEDED = ("room", "geometry", "positions", "measured")
_OPTIONAL = (
    "unit",
    "scattering",
    "paths",
    "match",
    "exclude",
    "simulated",
    "position_uncertainty",
    "surfaces",
)


@checked
def has_geometry(path: str | os.PathLike[str]) -> bool:
    """Return whether a case's file states a geometry; DataError if it is not valid TOML."""
    if Path(path).suffix.lower() != ".toml" or not Path(path).is_file():
        return False
    try:
        return "geometry" in toml_table(read_text(path, MAX_BYTES))
    except DataError as error:
        raise DataError(f"{os.fspath(path)}: {error}") from error


@checked
def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the arguments of `Case` that a file states."""
    content = toml_table(read_text(path, MAX_BYTES))
    return _arguments(Path(path).parent, Entries("", content, _NEEDED, _OPTIONAL))


@checked
def files(path: str | os.PathLike[str]) -> list[Path]:
    """Return the paths that a valid case file refers to, itself included."""
    case = Path(path)
    content = toml_table(read_text(path, MAX_BYTES))
    names = [content[k] for k in (*_NEEDED, "simulated") if k in content]
    return [case, *(case.parent / name for name in names if name != BOX)]


def _arguments(folder: Path, file: Entries) -> dict[str, Any]:
    room = Room.from_file(str(folder / file.text("room")))
    mesh = file.text("geometry")
    geometry = geometry_files.read(
        room, None if mesh == BOX else folder / mesh, file.number("unit") if "unit" in file else 1.0
    )
    sources, receivers = position_files.read(folder / file.text("positions"))
    optional: dict[str, Any] = {}
    if "paths" in file:
        optional["n_paths"] = file.whole("paths", LEAST_PATHS)
        if optional["n_paths"] > MOST_PATHS:
            raise DataError(f"{file.place}paths = {optional['n_paths']} is above {MOST_PATHS}")
    simulator = PathTracing(
        geometry=geometry,
        room=room,
        sources=sources,
        receivers=receivers,
        scattering=file.number("scattering") if "scattering" in file else None,
        **optional,
    )
    simulated = None
    if "simulated" in file:
        simulated = Measurement.from_file(str(folder / file.text("simulated")))
    return {
        "simulator": simulator,
        "measured": Measurement.from_file(str(folder / file.text("measured"))),
        "match": file.listed("match", list(MATCH)),
        "simulated": simulated,
        "exclude": file.listed("exclude", []),
        "surfaces": file.mapping("surfaces") if "surfaces" in file else None,
        "position_uncertainty": (
            file.number("position_uncertainty") if "position_uncertainty" in file else POSITION
        ),
    }
