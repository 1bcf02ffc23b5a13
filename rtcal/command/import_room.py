"""``rtcal import``: a program's material list, or the catalogue, and a mesh to a room.

The mesh is checked, read, mended, drawn, and written beside the room.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.command import console
from rtcal.command.files import PROGRAMS
from rtcal.files.disk import commit, read_bytes, spare
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.text import as_sentence, rounded, shortened
from rtcal.support.text import listed as in_a_row

if TYPE_CHECKING:
    from rtcal.acoustics.air import Air
    from rtcal.acoustics.priors import SigmaRule
    from rtcal.acoustics.room import Room, Surface
    from rtcal.io.material_list import ListedMaterial, MaterialList
    from rtcal.io.mend import Mended
    from rtcal.simulators.geometry import Polyhedron
    from rtcal.simulators.path_tracing import Chords

_LEAST_UNCERTAINTY = 1e-3
"""Relative uncertainty of V or of an area that a room states: no T is measured as exactly."""
_MOST_UNCERTAINTY = 0.99  # that of an area which may be missing: a room states less than 1
_MESH = (
    console.option("unit", float, "The mesh's unit in m; by default what the file states, else 1."),
    console.option("space", None, "Space of a building model (IFC), if it has several."),
    console.option(
        "weld",
        float,
        "In a mesh that does not close: distance in m within which corners are one.",
        default=0.01,
    ),
    console.option(
        "hole",
        float,
        "Largest area in m² of a hole that is closed; by default 1 % of all surfaces.",
        "largest_hole",
    ),
    console.flag(
        "open",
        "If the mesh cannot be closed, use it as drawn: V by rays, with an uncertainty, and no mesh "
        "for tracers.",
        "as_drawn",
    ),
    console.flag(
        "leaks",
        "If the mesh cannot be closed, use it with its holes, if a tracing loses at most 2 % of its "
        "paths: V by rays, with an uncertainty.",
    ),
    console.file("mended", "Mended mesh (OBJ) to write."),
    console.file("picture", "Picture (PNG) of the mesh to write."),
)
"""Options of how a mesh is read and mended."""
NAME = console.option(
    "name", None, "The room's name; by default that of the list, the mesh or --out."
)
AIR = (
    console.option(
        "temperature",
        float,
        "Temperature of the air in °C (20 with --humidity alone, or for a box).",
    ),
    console.option(
        "humidity", float, "Relative humidity in % (50 with --temperature alone, or for a box)."
    ),
)
SIGMA = (
    console.option("sigma-relative", float, "sigma as a share of alpha.", "relative", default=0.3),
    console.option("sigma-minimum", float, "Smallest sigma.", "minimum", default=0.01),
    console.flag("iso-12999-2", "Use at least the sigma between laboratories."),
    console.option(
        "in-situ-factor",
        float,
        "Factor on every sigma, such as 2 where specimens were mounted otherwise.",
        default=1.0,
    ),
)
"""Options of the sigma of materials that state none."""
_ROOM = (
    console.option(
        "mesh",
        click.Path(),
        "Mesh (OBJ, glTF, COLLADA, DXF, PLY, STL, 3MF, IFC), for areas and volume.",
    ),
    *_MESH,
    NAME,
    console.option("volume", float, "The room's volume in m³, without a mesh."),
    console.several(
        "area",
        "MATERIAL=M2",
        "Area of a material in m², without a mesh; one option per material.",
        "areas",
    ),
    console.several(
        "catalogue",
        "MATERIAL=ENTRY",
        "Take a material from the catalogue (Vorländer 2008, and others).",
        "in_catalogue",
    ),
    "as",
    "bands",
    *AIR,
    console.option(
        "sigma",
        click.Path(),
        "Table of sigma (CSV): material,sigma or one column per band.",
        "sigma_table",
    ),
    *SIGMA,
    "scattering",
    console.file("out", "Room (TOML) to write.", required=True),
)
"""Options of a room that is made of a list of materials."""


@click.group("import", short_help="A program's material list and a mesh to a room.")
def import_room() -> None:
    """Make a room of a program's list of materials and of a mesh, or of areas and a volume.

    `rtcal import check MESH` checks a mesh alone.
    """


@import_room.command(short_help="V, S and the defects of a mesh.")
@console.takes(click.argument("mesh", type=click.Path()), *_MESH)
def check(args: Namespace) -> None:
    """Print volume, surface and defects of MESH (OBJ, glTF, COLLADA, DXF, PLY, STL, 3MF, IFC).

    Every defect is listed with the effect of its repair on volume V and surface S.

    Example: rtcal import check hall.glb --picture hall.png
    """
    console.fit_ending("--mended", args.mended, ".obj")
    spare([args.mended, args.picture], [args.mesh])
    done = _read(args)
    if args.mended is not None:
        _closed(done).save(args.mended)
    notes = [console.as_options(note, ["unit"]) for note in done.notes]
    record = {
        "volume": done.volume,
        "volume_uncertainty": done.volume_uncertainty,
        "size": done.size,
        "areas": done.areas,
        "area_uncertainty": done.area_uncertainty,
        "defects": [asdict(defect) for defect in done.defects],
        "notes": notes,
    }
    unsure = _not_in_mesh(args.mesh, done) if args.mended is not None else []
    console.tell("\n".join([*map(as_sentence, notes), str(done), *unsure]), record)


def _not_in_mesh(mesh: str, model: Mended) -> list[str]:
    """Return the sentence on the uncertainties that a mended mesh cannot keep; none without any."""
    relative = model.volume_uncertainty / model.volume
    unsure = [f"volume_sigma = {relative:.2g}"] * (relative > _LEAST_UNCERTAINTY)
    unsure += [f"area_sigma = {u:.2g} of {m}" for m, u in _area_sigma(model, model.areas).items()]
    if not unsure:
        return []
    return [
        f"The mended mesh does not keep the uncertainty. Add to a room's file that is made from it "
        f"{in_a_row(unsure)}; `rtcal import ... --mesh {mesh}` writes this by itself."
    ]


def _imported(program: str, args: Namespace) -> None:
    """Write a room of a program's materials, or of the catalogue's."""
    from rtcal import io
    from rtcal.datasets import catalogue
    from rtcal.io.material_list import read_sigma

    spare([args.out, args.mended, args.picture], [args.materials, args.mesh, args.sigma_table])
    console.fit_ending("--out", args.out, ".toml")
    console.fit_ending("--mended", args.mended, ".obj")
    of_library = {} if args.columns is None else {"columns": args.columns}
    with console.errors_name_options("columns"):
        listed: MaterialList = (
            catalogue.material_list()
            if args.materials is None
            else getattr(io, program).read(args.materials, **of_library)
        )
    model = None if args.mesh is None else _read(args)
    volume, surfaces = _volume_and_surfaces(model, args, listed.names)
    used = list(dict.fromkeys(surface.material for surface in surfaces))
    chosen = console.texts("--catalogue", args.in_catalogue, "NAME=ENTRY")
    renamed = console.texts("--as", args.entries, "MATERIAL=ENTRY")
    if both := [name for name in renamed if name in chosen]:
        raise DataError(
            f'the material "{both[0]}" is given in --as and in --catalogue; leave one of them out'
        )
    place = "--area" if args.mesh is None else args.mesh
    own = _entries("--as", listed, renamed, used, place)
    listed = listed.with_spellings(used)
    offered = catalogue.material_list() if chosen else listed
    others = own | _entries("--catalogue", offered, chosen, used, place)
    _require_all(listed, others, program, used, place)
    rule = sigma_rule(args)
    sigma = {} if args.sigma_table is None else read_sigma(args.sigma_table)
    if unknown := [name for name in sigma if name not in used]:
        raise DataError(
            f'{args.sigma_table}: "{unknown[0]}" is not a material of the room, which has '
            f"{shortened(', '.join(used), 200)}"
        )
    room = listed.room(
        name=Path(args.mesh or args.materials or args.out).stem if args.name is None else args.name,
        volume=volume,
        areas=surfaces,
        centre_frequencies=_centre_frequencies(args.bands, [*listed.materials, *others.values()]),
        sigma_rule=rule,
        sigma=sigma,
        scattering=args.scattering,
        others=others,
        air=stated_air(args.temperature, args.humidity),
    )
    of_mesh: list[str] = []
    if args.mesh is not None and model is not None:
        _check_leaks(room, model)
        room = _with_scene(room, model, args)
        room, of_mesh = _with_uncertainty(room, model)
    room.save(args.out)
    in_use = {listed.listed(name).name for name in used if name not in others}
    in_use |= {material.name for material in own.values()}
    unused = [] if program == "catalogue" else [n for n in listed.names if n not in in_use]
    taken = {name: others.get(name) or listed.listed(name) for name in used}
    of_sigma = f"{rule}; from the file: {', '.join(sigma)}" if sigma else assumed_sigma(rule, taken)
    without = [name for name, material in taken.items() if material.scattering is None]
    if without and len(without) < len(taken) and room.scattering is None:
        of_mesh.insert(
            0, f"Scattering is left out, because {', '.join(without)} have none: give --scattering."
        )
    console.tell(*described(room, unused, [of_sigma, air_note(room), *of_mesh]))


def _add_import(program: str) -> None:
    """Add ``rtcal import PROGRAM``, with a file of MATERIALS unless they are the catalogue's."""
    of = {"catalogue": "the catalogue", "library": "product data (CSV, xlsx; a file or a folder)"}
    source = of.get(program, f"MATERIALS of {program}")
    materials = () if program == "catalogue" else ("MATERIALS",)
    example = "" if program == "catalogue" else f" {_EXAMPLES.get(program, 'materials')}"

    @console.takes(*materials, *(("columns",) if program == "library" else ()), *_ROOM)
    def command(args: Namespace) -> None:
        _imported(program, Namespace(**{"materials": None, "columns": None} | vars(args)))

    command.__doc__ = f"""Make a room of {source} and a mesh, or given areas and volume.

    The room's file names the mesh. Add [sources] and [receivers] to it for what needs positions. A mesh
    that does not close is mended where that is safe: every defect is listed with its effect on V and S,
    and the mended mesh is written beside the room.

    A list states neither uncertainty nor air. Without the options for them, the assumptions are
    printed.

    \b
    Example: rtcal import {program}{example} --volume 2000 \\
        --area wood=300 --area plaster=800 --out room.toml

    \b
    Example: rtcal import {program}{example} \\
        --mesh hall.obj --out room.toml
    """
    import_room.command(program, short_help=f"A room of {source}.")(command)


_EXAMPLES = {"catt": "hall.geo", "odeon": "hall.Li8", "library": "products"}
for _program in (*PROGRAMS, "library", "catalogue"):
    _add_import(_program)


def _read(args: Namespace) -> Mended:
    """Return the room of a mesh, and draw it, with its open edges where it does not close.

    With --open a mesh that cannot be closed has V by rays and S as it is drawn; with --leaks it has its
    holes, too.
    """
    mesh, leaks, picture = args.mesh, args.leaks, args.picture
    options = {name: vars(args)[name] for name in ("unit", "space", "weld", "largest_hole")}
    if args.as_drawn and leaks:
        raise DataError("--open and --leaks are both given; leave one of them out")
    from rtcal.io import mesh as meshes
    from rtcal.io.mend import MeshError
    from rtcal.report import figures

    with (
        console.errors_name_options("unit", "weld"),
        console.progress_bar(1, "step", wanted=False) as shown,
    ):
        shown.set_description(f"mending of {mesh}")
        try:
            done = meshes.room(mesh, **options)
        except MeshError as error:
            if picture is not None:
                drawn = meshes.read(mesh, unit=args.unit, space=args.space)
                figures.save(figures.wireframe(drawn, error.edges), picture)
            if args.as_drawn and error.unclosed is not None:
                return error.unclosed
            chords = _chords(error.leaking, leaks)
            takes_paths = chords is not None and chords.least_alpha <= _ABSORBING
            if leaks and error.unclosed is not None and chords is not None and takes_paths:
                return replace(
                    error.unclosed,
                    geometry=error.leaking,
                    volume=chords.volume,
                    volume_uncertainty=chords.volume_uncertainty,
                    notes=(
                        f"not closed, and taken with its holes: {chords}",
                        *error.unclosed.notes,
                    ),
                )
            refused = str(error)
            if leaks and chords is not None:
                refused += f". --leaks cannot be used, because the holes are too large: {chords}"
                refused += ". Use `rtcal import ... --open`" * (error.unclosed is not None)
            elif takes_paths:
                refused += (
                    f". To use the mesh with its holes, take `rtcal import ... --leaks`: {chords}. A "
                    "room with less absorption in any band needs `rtcal import ... --open`"
                )
            elif error.unclosed is not None:
                v, u = error.unclosed.volume, error.unclosed.volume_uncertainty
                refused += (
                    f". Rays estimate a volume of {rounded(v, 4)} ± {rounded(u, 2)} m³. "
                    "`rtcal import ... --open` uses this volume, but then only reverberation "
                    "equations are available, and no path tracing"
                )
            if picture is not None:
                commit()
                refused += f". Written: {picture}"
            raise DataError(refused) from error
    if picture is not None:
        figures.save(figures.wireframe(_closed(done)), picture)
    return done


_ABSORBING = 0.12
"""Mean alpha of a room with much absorption; a mesh that needs more for path tracing is refused."""
_FEW_RAYS, _LARGE_HOLE = 2000, 0.005
"""Rays that show a large hole, and the share that leaves above which it is one; a mesh with
`_ABSORBING` loses 0.4 of them on the average."""


def _chords(leaking: Polyhedron | None, asked: bool) -> Chords | None:
    """Return V and S by rays of a mesh with its holes; None of a large hole, unless it is ``asked``."""
    from rtcal.simulators.path_tracing import by_chords

    if leaking is None:
        return None
    if not asked and by_chords(leaking, _FEW_RAYS).lost > _LARGE_HOLE:
        return None
    return by_chords(leaking)


def _check_leaks(room: Room, model: Mended) -> None:
    """Refuse a mesh with holes in a room that is too reverberant for them; DataError names the band."""
    from rtcal.simulators.path_tracing import by_chords

    if model.geometry is None or not model.geometry.leaks:
        return
    chords, mean = by_chords(model.geometry), room.areas @ room.alpha / room.areas.sum()
    if mean.min() < chords.least_alpha:
        band = room.centre_frequencies[mean.argmin()]
        raise DataError(
            f"--leaks: {chords}, but the mean absorption coefficient is {mean.min():.2g} "
            f"at {band:g} Hz. Close the holes, or use only reverberation equations with "
            "`rtcal import ... --open`"
        )


def _closed(model: Mended) -> Polyhedron:
    """Return the geometry that is written as the mended mesh; DataError without one."""
    if model.geometry is None:
        raise DataError(
            "--mended and --open are both given, but --open does not repair the mesh; "
            "leave one of them out"
        )
    return model.geometry


def _volume_and_surfaces(
    model: Mended | None, args: Namespace, names: Sequence[str]
) -> tuple[float, Sequence[Surface]]:
    """Return the volume in m³ and the surfaces, of the mesh or of the options."""
    from rtcal.acoustics.room import Surface
    from rtcal.finder.positions.surfaces import stated_surfaces

    if model is not None:
        if args.volume is not None or args.areas:
            raise DataError("--mesh already gives volume and areas: leave --volume and --area out")
        if model.geometry is not None:
            return model.volume, stated_surfaces(model.geometry)
        return model.volume, [Surface(name, name, area) for name, area in model.areas.items()]
    if args.as_drawn:
        raise DataError("--open can be used only with --mesh: add --mesh, or leave --open out")
    if args.volume is None or not args.areas:
        raise DataError(
            "the size of the room is missing. Give --mesh room.obj; or give --volume M3, "
            "and --area MATERIAL=M2 for each material. The list has the materials "
            f"{shortened(', '.join(names), 200)}"
        )
    stated = console.numbers("--area", args.areas, "MATERIAL=M2")
    return args.volume, [Surface(name, name, area) for name, area in stated.items()]


def _with_scene(room: Room, model: Mended, args: Namespace) -> Room:
    """Return the room with its mesh, which is written where the tracers do not read it as it is."""
    from rtcal.acoustics.room import Scene
    from rtcal.io.mesh import MAX_BYTES
    from rtcal.io.units import in_comments

    mesh, mended = args.mesh, args.mended
    if mended is None:
        if model.geometry is None:
            return room
        as_it_is = all(d.kind == "gap" for d in model.defects) and not model.geometry.leaks
        if as_it_is and Path(mesh).suffix.lower() == ".obj":
            unit = args.unit or in_comments(read_bytes(mesh, MAX_BYTES), mesh) or 1.0
            return room.replace(scene=Scene(mesh=mesh, unit=unit))
        beside = Path(args.out).with_suffix(".obj")
        if beside.resolve() == Path(mesh).resolve():
            beside = beside.with_stem(f"{beside.stem}_mended")
        mended = str(beside)
    geometry = _closed(model)
    spare([mended], [mesh])
    geometry.save(mended)
    return room.replace(scene=Scene(mesh=mended, unit=1.0, leaks=geometry.leaks))


def _with_uncertainty(room: Room, model: Mended) -> tuple[Room, list[str]]:
    """Return the room with what a mesh leaves open of its volume and areas, and the notes on it."""
    read = [console.as_options(note, ["unit"]) for note in model.notes]
    notes = [f"Mesh: {note}" for note in (*read, *map(str, model.defects))]
    is_open = model.geometry is None or model.geometry.leaks
    if model.volume_uncertainty > _LEAST_UNCERTAINTY * room.volume:
        sigma = float(f"{model.volume_uncertainty / room.volume:.2g}")
        room = room.replace(volume_sigma=sigma)
        drawn = "drawn: its faces do not close" if is_open else "mended"
        notes.append(f"V is known to {100 * sigma:.2g} % (volume_sigma), by what was {drawn}")
    area_sigma = _area_sigma(model, dict(zip(room.materials, room.areas.tolist(), strict=True)))
    if area_sigma:
        room = room.replace(area_sigma=area_sigma)
        each = ", ".join(f"{m} to {100 * u:.2g} %" for m, u in area_sigma.items())
        left = "mended and left open" if is_open else "mended"
        notes.append(f"Areas are known (area_sigma), by what was {left}: {each}")
    return room, notes


def _area_sigma(model: Mended, areas: Mapping[str, float]) -> dict[str, float]:
    """Return the relative uncertainty of the areas, in m² by material, that a mesh leaves open."""
    unsure = model.area_uncertainty
    relative = {m: min(unsure.get(m, 0.0) / area, _MOST_UNCERTAINTY) for m, area in areas.items()}
    return {m: float(f"{u:.2g}") for m, u in relative.items() if u > _LEAST_UNCERTAINTY}


def _centre_frequencies(
    bands: str | list[float] | None, materials: Sequence[ListedMaterial]
) -> list[float] | None:
    """Return the room's bands in Hz as stated; None for those that the materials have."""
    from rtcal.acoustics.bands import OCTAVES, THIRD_OCTAVES, obtainable

    if not isinstance(bands, str):
        return bands
    wanted = map(float, OCTAVES if bands == "octave" else THIRD_OCTAVES)
    return [f for f in wanted if all(obtainable(m.centre_frequencies, [f]).size for m in materials)]


def _entries(
    option: str, listed: MaterialList, stated: dict[str, str], used: Sequence[str], place: str
) -> dict[str, ListedMaterial]:
    """Return a list's materials by the room's names, as an option states them."""
    from rtcal.datasets import catalogue

    if unknown := [name for name in stated if name not in used]:
        raise DataError(
            f'{option}: "{unknown[0]}" is not a material of the room. {place} has the '
            f"materials {shortened(', '.join(used), 200)}"
        )
    found = {}
    for name, entry in stated.items():
        try:
            found[name] = listed.listed(entry)
        except DataError as error:
            why = shortened(str(error), 300)
            if option == "--catalogue":
                near = "; ".join(catalogue.nearest(entry))
                near = f"Similar entries: {near}" if near else "`rtcal materials` lists its entries"
                why = f'"{entry}" is not a material of the catalogue. {near}'
            raise DataError(f'{option} "{name}={entry}": {why}') from error
    return found


def _require_all(
    listed: MaterialList, found: Collection[str], program: str, used: Sequence[str], place: str
) -> None:
    """Raise DataError, with proposals, for materials that are in neither the list nor the options."""
    from rtcal.datasets import catalogue

    known = {*listed.names, *listed.aliases, *found}
    if not (missing := [name for name in used if name not in known]):
        return
    of_catalogue = program == "catalogue"
    of_list = {} if of_catalogue else dict.fromkeys(listed.names, "")
    lines = []
    for name in missing[:_PROPOSED]:
        near = [f'"{entry}" of the list' for entry in catalogue.similar(name, 2, of_list)]
        with suppress(MissingDependencyError):
            near += catalogue.nearest(name, 3)
        lines.append(f'\n- "{name}" is similar to {"; ".join(near) or "no entry"}')
    options = " ".join(f'--catalogue "{name}=ENTRY"' for name in missing[:_PROPOSED])
    own = ""
    if not of_catalogue:
        own = f".\nThe list has: {shortened(', '.join([*listed.names, *listed.aliases]), 200)}"
        options = (
            f'one of its names (--as "{missing[0]}=NAME"), or an entry of the catalogue: {options}'
        )
    more = f" and {len(missing) - _PROPOSED} more" * (len(missing) > _PROPOSED)
    raise DataError(
        f"{place}: some materials are not in {'the catalogue' if of_catalogue else listed.path}:"
        f'{";".join(lines)}{more}{own}.\nGive {options}. --catalogue "{missing[0]}=carpet" lists the '
        "kinds of carpet"
    )


_PROPOSED = 12  # largest number of missing materials for which a message has proposals


USUAL_CLIMATE = (20.0, 50.0)
"""Temperature in °C and relative humidity in % of a room in use, where they are not stated."""


def stated_air(temperature: float | None, humidity: float | None) -> Air | None:
    """Return the air of the options; None without either."""
    from rtcal.acoustics.air import Air

    if temperature is None and humidity is None:
        return None
    stated = zip((temperature, humidity), USUAL_CLIMATE, strict=True)
    return Air(*(usual if value is None else value for value, usual in stated))


def air_note(room: Room) -> str:
    """Return the note on the air of a room that was made of the options."""
    if room.air is None:
        return (
            "No air is given, so alpha will include what the air absorbs: give --temperature and "
            "--humidity."
        )
    return f"The air has {room.air.temperature:g} °C and {room.air.humidity:g} % relative humidity."


def sigma_rule(args: Namespace) -> SigmaRule:
    """Return the rule of `SIGMA` for materials that state no sigma."""
    from rtcal.acoustics.priors import SigmaRule

    names = ("relative", "minimum", "iso_12999_2", "in_situ_factor")
    return SigmaRule(**{name: vars(args)[name] for name in names})


def assumed_sigma(rule: SigmaRule, used: Mapping[str, ListedMaterial]) -> str:
    """Return the note on the assumed sigma, which names materials that are exact by definition."""
    exact = [name for name, material in used.items() if material.sigma == 0]
    apart = f"; 0 for {', '.join(exact)} (exact by definition)" if exact else ""
    return f"Assumed standard deviation of alpha: {rule}{apart}"


def described(room: Room, unused: list[str], notes: list[str]) -> tuple[str, dict[str, Any]]:
    """Return the room, the assumptions beyond the list, and what was left out: a text and a record."""
    from rtcal.acoustics.bands import span
    from rtcal.acoustics.marks import of_input

    notes = [*(doubt.sentence for doubt in of_input(room)), *notes]
    by_source: dict[tuple[str, str], list[str]] = {}
    for name, source in room.sources.items():
        of = "the area per" if name in room.pieces else "alpha of"
        by_source.setdefault((of, source), []).append(name)
    notes += [
        f"Source of {of} {', '.join(names)}: {source}" for (of, source), names in by_source.items()
    ]
    rows_of = dict(zip(room.materials, room.areas.tolist(), strict=True))
    objects = {name: rows_of.pop(name) for name in room.pieces}
    rows = [
        f"The room has {room.volume:.6g} m³ and {room.total_area:.6g} m² of surfaces, in "
        f"{span(room.centre_frequencies)}:",
        *(f"{area:10.3f} m²  {material}" for material, area in rows_of.items()),
        *(f"{number:10g} ×   {name}" for name, number in objects.items()),
        *notes,
        *([f"Materials without an area are left out: {', '.join(unused)}."] if unused else []),
    ]
    record = {
        "volume": room.volume,
        "areas": rows_of,
        **({"objects": objects} if objects else {}),
        "centre_frequencies": room.centre_frequencies,
        "notes": notes,
        "left_out": unused,
    }
    return "\n".join(rows), record
