"""The mesh of ``rtcal import``: checked, read, mended, drawn, written beside the room."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from rtcal.command.console import as_options, errors_name_options, fit_ending, numbers, said, tell
from rtcal.files.disk import commit, spare
from rtcal.support.errors import DataError
from rtcal.support.speed import bar
from rtcal.support.text import rounded, shortened

if TYPE_CHECKING:
    from rtcal.acoustics.room import Room, Surface
    from rtcal.io.mend import Mended, MeshError

_LEAST_UNCERTAINTY = 1e-3
"""Relative uncertainty of V or of an area that a room states: no T is measured as exactly."""
_MOST_UNCERTAINTY = 0.99
"""That of an area which may be missing: a room states less than 1."""
_USED_BY_CHECK = {
    *("program", "materials", "mesh", "unit", "space", "weld", "hole", "as_drawn", "mended"),
    *("picture", "as_json", "quiet"),
}


def refuse_unused_options() -> None:
    """Raise DataError for an option that ``check`` would not use."""
    context = click.get_current_context()
    for option in context.command.params:
        stated = context.get_parameter_source(str(option.name)) is ParameterSource.COMMANDLINE
        if stated and option.name not in _USED_BY_CHECK:
            raise DataError(
                f"import check does not use {option.opts[0]}: it reads the mesh alone and writes no "
                "room; leave it out"
            )
    if context.params["materials"] is not None and context.params["mesh"] is not None:
        raise DataError("import check reads one mesh: leave --mesh out")


def check(
    mesh: str | None,
    unit: float | None,
    space: str | None,
    weld: float,
    hole: float | None,
    as_drawn: bool,
    mended: str | None,
    picture: str | None,
) -> None:
    """Print V, S and the defects of a mesh, without a list of materials; write it and its picture.

    With ``as_drawn`` a mesh that cannot be closed has V by rays and S as it is drawn.
    """
    from rtcal.io import mesh as meshes
    from rtcal.io.mend import Faces, MeshError

    if mesh is None:
        raise DataError("which mesh? rtcal import check room.obj")
    fit_ending("--mended", mended, ".obj")
    spare([path for path in (mended, picture) if path is not None], [mesh])
    drawn: Any
    with errors_name_options("unit", "weld"), _patience(mesh):
        try:
            done = meshes.room(mesh, unit=unit, space=space, weld=weld, largest_hole=hole)
            drawn, edges = done.geometry, None
        except MeshError as error:
            drawn, edges = meshes.read(mesh, unit=unit, space=space), error.edges
            if not as_drawn or error.unclosed is None:
                refused = _with_volume(error)
                if picture is not None:
                    draw(drawn, edges, picture)
                    commit()
                    refused = DataError(f"{refused}. Written: {picture}")
                raise refused from error
            done = error.unclosed
    if mended is not None:
        if isinstance(drawn, Faces):
            raise DataError(f"--mended: the mesh was not closed; leave --open or {mended} out")
        drawn.save(mended)
    if picture is not None:
        draw(drawn, edges, picture)
    notes = [as_options(note, ["unit"]) for note in done.notes]
    record = {
        "volume": done.volume,
        "volume_uncertainty": done.volume_uncertainty,
        "size": done.size,
        "areas": done.areas,
        "area_uncertainty": done.area_uncertainty,
        "defects": [asdict(defect) for defect in done.defects],
        "notes": notes,
    }
    tell("\n".join([*notes, str(done)]), record)


@contextmanager
def _patience(mesh: str) -> Iterator[None]:
    """Say that a mesh takes longer: how much longer is not known."""
    with bar(1, "step", False, said()) as shown:
        shown.set_description(f"mending of {mesh}")
        yield


def geometry(
    mesh: str | None,
    unit: float | None,
    space: str | None,
    weld: float,
    hole: float | None,
    as_drawn: bool,
    volume: float | None,
    areas: tuple[str, ...],
    names: Sequence[str],
) -> tuple[Mended | None, float, Sequence[Surface]]:
    """Return the mesh's room, volume in m³ and surfaces, from the mesh or from the options.

    ``names`` are those of the list's materials, for the message where the options lack them.
    """
    from rtcal.acoustics.room import Surface
    from rtcal.finder.positions.surfaces import stated_surfaces
    from rtcal.io import mesh as meshes
    from rtcal.io.mend import MeshError

    if mesh is not None and (volume is not None or areas):
        raise DataError("--mesh states volume and areas already: leave --volume and --area out")
    if mesh is not None:
        with errors_name_options("unit", "weld"), _patience(mesh):
            try:
                model = meshes.room(mesh, unit=unit, space=space, weld=weld, largest_hole=hole)
            except MeshError as error:
                if not as_drawn or error.unclosed is None:
                    raise _with_volume(error) from error
                model = error.unclosed
                drawn = [Surface(name, name, area) for name, area in model.areas.items()]
                return model, model.volume, drawn
        return model, model.volume, stated_surfaces(model.geometry)
    if as_drawn:
        raise DataError("--open is for a mesh: state --mesh, or leave it out")
    if volume is None or not areas:
        raise DataError(
            "how large is the room? State --mesh room.obj, or --volume M3 and --area MATERIAL=M2 for "
            f"each material in it. The list has: {shortened(', '.join(names), 200)}"
        )
    stated = numbers("--area", areas, "NAME=M2")
    return None, volume, [Surface(name, name, area) for name, area in stated.items()]


def with_scene(
    room: Room,
    mesh: str,
    model: Mended,
    unit: float | None,
    out: str,
    mended: str | None,
    picture: str | None,
) -> Room:
    """Return the room with its mesh, which is written where it was mended, as its picture is."""
    from rtcal.acoustics.scene import Scene

    if model.geometry is None:
        for option, path in (("--mended", mended), ("--picture", picture)):
            if path is not None:
                raise DataError(f"{option}: the mesh was not closed; leave --open or {option} out")
        return room
    target = _mesh_file(mesh, model, out, mended)
    if target is not None:
        spare([target], [mesh])
        model.geometry.save(target)
    stated = 1.0 if target is not None or unit is None else unit
    if picture is not None:
        draw(model.geometry, None, picture)
    return room.replace(scene=Scene(mesh=target or mesh, unit=stated))


def with_uncertainty(room: Room, model: Mended) -> tuple[Room, list[str]]:
    """Return the room with what a mesh leaves open of its volume and areas, and the notes on it."""
    read = [as_options(note, ["unit"]) for note in model.notes]
    notes = [f"mesh: {note}" for note in (*read, *map(str, model.defects))]
    if model.volume_uncertainty > _LEAST_UNCERTAINTY * room.volume:
        sigma = float(f"{model.volume_uncertainty / room.volume:.2g}")
        room = room.replace(volume_sigma=sigma)
        drawn = "drawn: its faces do not close" if model.geometry is None else "mended"
        notes.append(f"V is known to {100 * sigma:.2g} % (volume_sigma), by what was {drawn}")
    unsure = model.area_uncertainty
    of_room = zip(room.materials, room.areas.tolist(), strict=True)
    relative = {m: min(unsure.get(m, 0.0) / area, _MOST_UNCERTAINTY) for m, area in of_room}
    area_sigma = {m: float(f"{u:.2g}") for m, u in relative.items() if u > _LEAST_UNCERTAINTY}
    if area_sigma:
        room = room.replace(area_sigma=area_sigma)
        said = ", ".join(f"{m} to {100 * u:.2g} %" for m, u in area_sigma.items())
        notes.append(f"Areas are known (area_sigma), by what was mended: {said}")
    return room, notes


def _mesh_file(mesh: str, model: Mended, out: str, stated: str | None) -> str | None:
    """Return the file to which the room's mesh is written; None if the tracers read it as it is."""
    if stated is not None:
        return stated
    if Path(mesh).suffix.lower() == ".obj" and all(
        d.kind in ("turned", "gap") for d in model.defects
    ):
        return None
    beside = Path(out).with_suffix(".obj")
    return str(
        beside
        if beside.resolve() != Path(mesh).resolve()
        else beside.with_stem(f"{beside.stem}_mended")
    )


def draw(geometry: Any, edges: Any, path: str) -> None:
    """Write the picture (PNG) of a mesh, with its open edges."""
    from rtcal.report import figures

    figures.save(figures.wireframe(geometry, edges), path)


def _with_volume(error: MeshError) -> DataError:
    """Return the error of a mesh with what rays say of its volume."""
    if error.unclosed is None:
        return error
    v, u = error.unclosed.volume, error.unclosed.volume_uncertainty
    return DataError(
        f"{error}. By rays V = {rounded(v, 4)} ± {rounded(u, 2)} m³: `rtcal import` takes it with "
        "--open, for equations alone"
    )
