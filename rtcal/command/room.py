"""``rtcal room``: a box of named materials, by options or questions, to a room, and its calibration."""

from __future__ import annotations

import math
import re
import shlex
from argparse import Namespace
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rtcal.command import console
from rtcal.command.import_room import (
    AIR,
    NAME,
    SIGMA,
    USUAL_CLIMATE,
    air_note,
    assumed_sigma,
    described,
    sigma_rule,
    stated_air,
)
from rtcal.files.disk import spare
from rtcal.io import units
from rtcal.io.text import numbers
from rtcal.support import checks
from rtcal.support.errors import DataError

if TYPE_CHECKING:
    from rtcal.acoustics.room import Piece, Room
    from rtcal.io.material_list import ListedMaterial

_WALLS = ("west", "east", "south", "north")
_WALL = "WALL=MATERIAL"
_PIECE = "WALL=M2:MATERIAL"
_OBJECT = "NAME=NUMBER"
_STATED = "stated with the room"
_OF_PIECES = (
    "m² of one piece, and its sigma, in the same bands: the standard deviation between the values that "
    "are named, or that of all pieces if it is larger"
)
_USUAL = [f"{value:g}" for value in USUAL_CLIMATE]
_ASSUMED_AIR = (
    f"The air is assumed to have {_USUAL[0]} °C and {_USUAL[1]} % relative humidity; others with "
    "--temperature and --humidity."
)
_UNCERTAINTY_OF_T = (
    "The uncertainty of T is that of 10 decays at one position (ISO 3382-2), because none is given."
)
_COPIES = "The values are from copies of these tables, not from the works themselves:"


@click.command(short_help="A box without a file: its sides and materials to a room.")
@console.takes(
    console.option(
        "dimensions", None, "Length (x), width (y), height (z): 9,7,3; 7x8x3.75; 30x20x10 ft."
    ),
    console.option(
        "floor", None, 'Material of the floor: "carpet"; or alpha, "0.1 0.2 0.3 0.3 0.4 0.4".'
    ),
    console.option("ceiling", None, "Material of the ceiling."),
    console.option("walls", None, "Material of the walls."),
    console.several("wall", _WALL, "One wall's own: west (x = 0), east, south (y = 0), north."),
    click.option(
        "--window",
        "--door",
        "--piece",
        "pieces",
        multiple=True,
        metavar=_PIECE,
        help="A piece of a wall, the floor or the ceiling, in m²: west=4.5:glazing.",
    ),
    console.option(
        "audience",
        click.IntRange(1),
        "Persons (not m²) seated on the floor. Each takes 1 m² of it, so 40 persons take 40 m².",
        metavar="PERSONS",
    ),
    console.several(
        "object",
        _OBJECT,
        "Pieces that are no surface, of `rtcal materials`: 'wooden chair=40'.",
        "objects",
    ),
    "bands",
    *AIR,
    *SIGMA,
    "t20",
    "t30",
    "equation",
    NAME,
    console.flag("ask", "Ask in the terminal for what is not given."),
    console.file("out", "Room (TOML) to write."),
)
def room(args: Namespace) -> None:
    """Make a room from the sides of a box and the names of its materials.

    Names are looked up in the catalogue (Vorländer 2008, and others). The entries that were taken are
    printed, and T by the equation. With --t20 or --t30 the room is also calibrated, as by `rtcal
    calibrate`; --out writes the room before calibration.

    \b
    Example: rtcal room --dimensions 9,7,3 --floor carpet \\
        --ceiling "acoustic tile" --walls plaster \\
        --window west=4.5:glazing --temperature 20 --out room.toml \\
        --t20 "0.9 0.8 0.7 0.7 0.6 0.6"

    \b
    Example: rtcal room --ask
    """  # noqa: D301 (click's mark for lines that are not to be wrapped)
    from rtcal.acoustics.bands import octaves, span, third_octaves

    frequencies = args.bands
    if frequencies is None or isinstance(frequencies, str):
        thirds = frequencies == "third-octave"
        frequencies = [*(third_octaves(100, 5000) if thirds else octaves(125, 4000))]
    materials = _Materials(frequencies)
    own = console.texts("--wall", args.wall, _WALL)
    if unknown := [name for name in own if name not in _WALLS]:
        raise DataError(f'--wall: "{unknown[0]}" is not a wall; the walls are {", ".join(_WALLS)}')
    four = len(own) == len(_WALLS)
    times = {name: vars(args)[name] for name in ("t20", "t30") if vars(args)[name] is not None}
    if args.ask:
        _ask(vars(args), times, materials, four)
    needed = ("dimensions", "floor", "ceiling", *(() if four else ("walls",)))
    if missing := [f"--{name}" for name in needed if not vars(args)[name]]:
        raise DataError(
            f"{', '.join(missing)} {'are' if missing[1:] else 'is'} missing. Add "
            f"{'them' if missing[1:] else 'it'}, or use --ask to be asked for each value"
        )
    out = args.out
    spare([out], [])
    console.fit_ending("--out", out, ".toml")
    made, notes = _made(materials, own, args)
    notes += [_UNCERTAINTY_OF_T] if times else []
    said, record = described(made, [], notes)
    path = shlex.quote(out or "room.toml")
    which = "" if args.equation.key == "eyring" else f" --equation {args.equation.key}"
    then = f"Next: rtcal calibrate {path} t.csv{which}, or --t20 with T by band in place of t.csv"
    if times:
        from rtcal.calibration import methods

        measured = console.measured(made, None, t20=times.get("t20"), t30=times.get("t30"))
        result = methods.calibrate(made, measured, equation=args.equation)
        said, record = f"{result}\n\n{said}", {**record, "calibration": result.to_dict()}
        (option,) = times
        second = f'rtcal calibrate {path} --{option} "{times[option]}"{which}'
        then = (
            f"This stands for two commands: `rtcal room` without --{option}, and then `{second}`; "
            "with --out calibrated, the second keeps the calibrated room."
        )
    else:
        t = args.equation.reverberation_time(made)
        said = (
            f"T by {args.equation.name}'s equation: {', '.join(f'{each:.2f}' for each in t)} s in "
            f"{span(made.centre_frequencies)}\n{said}"
        )
        record = {**record, "equation": args.equation.key, "reverberation_time": t}
    if out is None:
        said = f"{said}\nNothing is written; --out room.toml keeps the room."
    else:
        made.save(out)
    console.tell(said, record, then)


def _made(materials: _Materials, own: dict[str, str], args: Namespace) -> tuple[Room, list[str]]:
    """Return the room, and the notes on what was taken and assumed."""
    from rtcal.acoustics.air import Air
    from rtcal.acoustics.room import refuse_too_many, with_patches
    from rtcal.io.material_list import MaterialList
    from rtcal.io.text import Text
    from rtcal.simulators.geometry import Polyhedron

    size, unit = _sides(args.dimensions)
    units.check_volume(math.prod(size), unit, "--dimensions", units.OF_SIDES)
    of_box = {place: materials.add(place, vars(args)[place]) for place in ("floor", "ceiling")}
    for wall in _WALLS:
        of_box[wall] = materials.add(
            *((wall, own[wall]) if wall in own else ("walls", args.walls or ""))
        )
    patches = [
        (place, materials.add(f"piece of {place}", text), area)
        for place, area, text in map(_piece, args.pieces)
    ]
    if args.audience is not None:
        if args.audience >= size[0] * size[1]:
            raise DataError(
                f"--audience: {args.audience} persons need 1 m² each and must leave a part of the "
                f"floor's {size[0] * size[1]:.4g} m². For a floor full of people give its material, "
                "such as --floor audience_wooden_chairs_2_m2"
            )
        patches.append(("floor", materials.add("audience", "audience"), float(args.audience)))
        materials.notes.append(
            f"{args.audience} persons are seated on {args.audience} m² of the floor, 1 m² each"
        )
    geometry, air = Polyhedron.shoebox(size, of_box), stated_air(args.temperature, args.humidity)
    rule = sigma_rule(args)
    made = MaterialList(
        path="the options", text=Text(""), materials=(*materials.listed.values(),)
    ).room(
        name=Path(args.out or "room").stem if args.name is None else args.name,
        volume=geometry.volume,
        areas=with_patches(geometry.surfaces, patches),
        centre_frequencies=materials.bands,
        sigma_rule=rule,
        air=air or Air(*USUAL_CLIMATE),
    )
    counted = console.numbers("--object", args.objects, _OBJECT)
    free = [materials.piece(each, n) for each, n in counted.items()]
    if free:
        for piece in free:
            checks.positive(f'--object "{piece.name}"', piece.number)
            place = f'--object "{piece.name}"'
            refuse_too_many(place, piece.number, piece.area_per_piece, made.total_area)
        rows = [*map(made.material, made.materials), *(piece.as_material() for piece in free)]
        made = made.with_rows(rows, pieces=[piece.name for piece in free])
        materials.notes += _counted_twice(args.audience, counted)
    doubt = units.size_doubt(made.volume, size, unit, advice=units.OF_SIDES)
    said = f"{units.in_words(size)}: length (x), width (y), height (z)"
    notes = [
        said,
        *filter(None, [doubt]),
        *materials.notes,
        assumed_sigma(rule, materials.listed),
        air_note(made) if air is not None else _ASSUMED_AIR,
    ]
    return made.replace(dimensions=size), notes


def _counted_twice(audience: int | None, counted: dict[str, float]) -> list[str]:
    """Return notes on persons, and on chairs with persons on them, that are stated in two ways."""
    from rtcal.datasets import catalogue

    pieces = catalogue.pieces()
    of = {name: catalogue.holds(catalogue.found(name, pieces)[0]) for name in counted}
    if audience is not None:
        of["--audience"], counted = {"person", "chair"}, {**counted, "--audience": audience}
    persons = {name: counted[name] for name in of if "person" in of[name]}
    chairs = [name for name in of if of[name] == {"chair"}]
    on_chairs = [name for name in persons if "chair" in of[name]]
    notes = []
    if len(persons) > 1:
        each = " + ".join(f"{n:g} ({name})" for name, n in persons.items())
        notes.append(f"Persons add up: {each} = {sum(persons.values()):g} in all")
    if on_chairs and chairs:
        notes.append(
            f"{', '.join(on_chairs)}: the values are of persons on their chairs. Leave these chairs "
            f"out of {', '.join(chairs)}, or they count twice"
        )
    return notes


class _Materials:
    """Materials of a room by their names in it: entries of the catalogue, or stated coefficients."""

    def __init__(self, bands: list[float]) -> None:
        self.bands = bands
        self.notes: list[str] = []
        self.listed: dict[str, ListedMaterial] = {}
        self._names: dict[tuple[str, str], str] = {}

    def add(self, place: str, text: str) -> str:
        """Return the name of the material that is stated for a place: a name is always one material.

        Coefficients are those of one place. DataError for a name that is like none of the catalogue,
        and for wrong coefficients.
        """
        numeric = re.fullmatch(r"[-+%\d.,;:\skhz]*\d[-+%\d.,;:\skhz]*", text, re.I)
        key = (place if numeric else "", text.strip())
        if key not in self._names:
            added = (self._coefficients if numeric else self._of_catalogue)(place, text.strip())
            name, n = added.name, 1
            while name in self.listed:
                n += 1
                name = f"{added.name} ({n})"
            self.listed[name] = replace(added, name=name)
            self._names[key] = name
        return self._names[key]

    def _coefficients(self, place: str, text: str) -> ListedMaterial:
        from rtcal.io.material_list import ListedMaterial

        by_band = console.spectrum(place, text, self.bands, alone=True)
        for f in self.bands:
            alpha = by_band.get(f)
            if alpha is None:
                raise DataError(
                    f"{place}: alpha at {f:g} Hz is missing; give alpha for every band of the room"
                )
            if not 0 <= alpha <= 1:
                percent = checks.IN_PERCENT if 2 < alpha <= 100 else ""
                raise DataError(
                    f"{place}: alpha = {alpha:g} at {f:g} Hz must be from 0 to 1{percent}"
                )
        alphas = tuple(by_band[f] for f in self.bands)
        return ListedMaterial(
            name=place,
            line=0,
            alpha=alphas,
            centre_frequencies=(*self.bands,),
            spans=(),
            source=_STATED,
        )

    def _of_catalogue(self, place: str, name: str) -> ListedMaterial:
        from rtcal.datasets import catalogue

        entries = {m.name: m for m in catalogue.material_list().materials}
        own = 'alpha by band instead, such as "0.1 0.2 0.3 0.3 0.4 0.4"'
        entry = self._taken(name, None, f"{place}: {{}}. Give another name, or {own}")
        return replace(entries[entry], name=name)

    def piece(self, name: str, number: float) -> Piece:
        """Return pieces by what people call them; DataError for a name that is like none."""
        from rtcal.datasets import catalogue

        refused = (
            "--object: {}. `rtcal materials` lists all pieces; own values go into the room's file, as "
            "[[object]] with name, number, area_per_piece and sigma"
        )
        entry = self._taken(name, catalogue.pieces(), refused)
        return replace(catalogue.piece(entry, number, self.bands), name=name)

    def _taken(self, name: str, among: dict[str, str] | None, refused: str) -> str:
        """Return the first entry that resembles a name, with a note if its name is another."""
        from rtcal.datasets import catalogue, lookup

        try:
            entry, *others = catalogue.found(name, among)
        except DataError as error:
            raise DataError(refused.format(error)) from error
        if entry != name:
            similar = f"; similar names are {', '.join(others)}" if others else ""
            lacks = lookup.unstated(name, entry, {**catalogue.names(), **catalogue.pieces()}[entry])
            lacking = f", which does not state {' and '.join(lacks)}" if lacks else ""
            self.notes.append(f"For {name} the catalogue's {entry} was taken{lacking}{similar}")
        return entry


@click.command(short_help="The catalogue of materials and pieces, with their sources.")
@console.takes(click.argument("names", nargs=-1, metavar="[NAME]..."), writes=False)
def materials(args: Namespace) -> None:
    """List the catalogue's materials and pieces, or those that each NAME means, and similar ones.

    `rtcal room` takes the first one for a NAME. Several words are one name in quotes. Pieces are
    persons, seats and furniture (m² of absorption each).

    Example: rtcal materials carpet "wooden chair"
    """
    import numpy as np

    from rtcal.acoustics.bands import octaves, span
    from rtcal.datasets import catalogue

    of_octaves = [*octaves(125, 4000)]
    entries = {m.name: m for m in catalogue.material_list().materials}
    described = catalogue.pieces()
    origin = catalogue.origin()
    lines = [
        f"{origin}, and other works: alpha in {span(of_octaves)}; `rtcal room` takes 30 % of alpha as "
        f"sigma, at least 0.01; {catalogue.OPENING} is exact"
    ]
    meant, unknown = dict[str, list[str]](), dict[str, str]()
    for name in dict.fromkeys(args.names):
        meant[name] = []
        for among in (described, None):
            try:
                meant[name][:0] = catalogue.found(name, among)
            except DataError as error:
                unknown[name] = str(error)
    if args.names and not any(meant.values()):
        quote = ". A name of several words stands in quotes" if len(meant) > 1 else ""
        raise DataError(
            f"{'; '.join(unknown.values())}{quote}. `rtcal materials` lists all entries"
        )
    listed: dict[str, ListedMaterial] = {}
    pieces: dict[str, Piece] = {}
    for name, found in (meant or {"": [*entries, *described]}).items():
        lines += [f"{name}:" if found else f"{name}: {unknown[name]}"] if len(meant) > 1 else []
        for entry in (each for each in found if each in entries):
            listed[entry] = entries[entry]
            by_band = dict(zip(listed[entry].centre_frequencies, listed[entry].alpha, strict=True))
            values = (f"{by_band[f]:5.2f}" if f in by_band else "    -" for f in of_octaves)
            lines.append(f"{''.join(values)}  {entry}")
            lines.append(f"  {listed[entry].source.removeprefix(f'{origin}: ')}")
        free = [catalogue.piece(each, 1, of_octaves) for each in found if each in described]
        lines += [_OF_PIECES] if free else []
        for piece in free:
            pieces[piece.name] = piece
            rows: Any = ((piece.area_per_piece, piece.name), (piece.sigma, "sigma"))
            for row, text in rows:
                lines.append(f"{''.join(f'{value:5.2f}' for value in np.ravel(row))}  {text}")
            lines.append(f"  {piece.source}")
    pages = catalogue.pages([*listed, *pieces])
    lines += [_COPIES, *(f"  {page}" for page in pages)] if pages else []
    keys = ("name", "centre_frequencies", "alpha", "source")
    record = {
        "names": meant,
        "materials": [{key: getattr(each, key) for key in keys} for each in listed.values()],
        "pieces": [*map(asdict, pieces.values())],
        "pages": pages,
    }
    console.tell("\n".join(lines), record)


def _sides(text: str) -> tuple[tuple[float, float, float], float]:
    try:
        return units.sides(text)
    except DataError as error:
        raise DataError(
            f"--dimensions {error}. Give three sides, such as 9,7,3 or 30x20x10 ft"
        ) from error


def _piece(text: str) -> tuple[str, float, str]:
    """Return place, area in m² and material of a piece; DataError for another form."""
    place, _, rest = text.partition("=")
    area, _, material = rest.partition(":")
    if not (place.strip() and area.strip() and material.strip()):
        raise DataError(f'"{text}" must have the form {_PIECE}, such as west=4.5:glazing')
    in_feet = re.fullmatch(r"(.*?)\s*(?:ft2|ft²|sq\.? ?ft)\s*", area)
    bare = in_feet[1] if in_feet else re.sub(r"\s*(m2|m²|sqm|qm)\s*$", "", area)
    try:
        (stated,) = numbers(bare, [1], text)
    except DataError as error:
        raise DataError(
            f"{error}. A piece has the form {_PIECE}, such as west=4.5:glazing"
        ) from error
    checks.positive(f"{text}: area", stated, "m²")
    return place.strip(), stated * (0.3048**2 if in_feet else 1.0), material


def _ask(
    stated: dict[str, Any], times: dict[str, str], materials: _Materials, four_walls: bool
) -> None:
    """Put answers into the options that are not given; a wrong answer is asked for again."""
    from rtcal.acoustics.air import Air
    from rtcal.acoustics.bands import span
    from rtcal.acoustics.room import refuse_too_many, with_patches
    from rtcal.simulators.geometry import Polyhedron

    def answer(option: str, question: str, check: Any, default: str | None = None) -> Any:
        def checked(text: str) -> Any:
            known = len(materials.notes)
            try:
                value = check(text) if text else text
            except DataError as error:
                raise click.UsageError(str(error)) from error
            for note in materials.notes[known:]:
                click.echo(f"  {note}", err=True)
            return value

        try:
            return click.prompt(question, default, value_proc=checked, err=True)
        except click.Abort as error:
            if not isinstance(error.__context__, EOFError):
                raise
            needed = ", ".join(f"--{n}" for n, *_, usual in left() if usual is None)
            raise DataError(
                f'the input ended before "{question}" was answered; still missing: '
                f"{needed or f'--{option}'}"
            ) from error

    def repeated(name: str, option: str, question: str, check: Callable[[str], str]) -> None:
        """Ask for one more piece or object until the answer is empty."""
        while added := answer(option, question, check, ""):
            stated[name] = (*stated[name], added)

    def material(place: str, text: str) -> str:
        materials.add(place, text)
        return text

    def piece(text: str) -> str:
        whole = Polyhedron.shoebox(_sides(stated["dimensions"])[0], "").surfaces
        pieces = [*map(_piece, (*stated["pieces"], text))]
        with_patches(whole, [(place, of, area) for place, area, of in pieces])
        place, _, of = pieces[-1]
        materials.add(f"piece of {place}", of)
        return text

    def counted(text: str) -> str:
        x, y, z = _sides(stated["dimensions"])[0]
        trial = _Materials(materials.bands)  # `_made` looks the pieces up once more, with notes
        for each, n in console.numbers("--object", (*stated["objects"], text), _OBJECT).items():
            place = f'--object "{each}"'
            of_one = trial.piece(each, checks.positive(place, n)).area_per_piece
            refuse_too_many(place, n, of_one, 2 * (x * y + y * z + z * x))
        return text

    def climate(name: str, text: str) -> float:
        (value,) = numbers(text, [1], name)
        Air(**{name: value})
        return value

    def measured_time(text: str) -> str:
        console.stated_times("t20", text, materials.bands)
        return text

    questions: tuple[tuple[str, str, Callable[[str], Any], str | None], ...] = (
        ("dimensions", "Length, width, height", lambda text: _sides(text) and text, None),
        ("floor", "Material of the floor", partial(material, "floor"), None),
        ("ceiling", "Material of the ceiling", partial(material, "ceiling"), None),
        ("walls", "Material of the walls", partial(material, "walls"), None),
        ("temperature", "Temperature / °C", partial(climate, "temperature"), _USUAL[0]),
        ("humidity", "Relative humidity / %", partial(climate, "humidity"), _USUAL[1]),
        ("out", "File to write", lambda text: text, "room.toml"),
    )

    def left() -> list[tuple[str, str, Callable[[str], Any], str | None]]:
        unneeded = {"walls"} if four_walls else set()
        return [each for each in questions if stated[each[0]] is None and each[0] not in unneeded]

    for name, _, check, _ in questions:
        if stated[name] is not None:  # before the first question, whose answer would be lost
            check(str(stated[name]))
    for name, question, check, default in left():
        stated[name] = answer(name, question, check, default)
    repeated("pieces", "piece", f"A window, a door ({_PIECE}), or nothing", piece)
    question = f"Persons, seats, desks ({_OBJECT}: person seated=20), or nothing"
    repeated("objects", "object", question, counted)
    if not times:
        question = f"Measured T20 / s in {span(materials.bands)}, to calibrate, or nothing"
        if text := answer("t20", question, measured_time, ""):
            times["t20"] = text
