"""Export of a room into a material list, and the effect of its rounding on T."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from rtcal.acoustics import band_conversion, bands, quality, repeats
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.scene import POSITION, Scene
from rtcal.io.material_list import ListedMaterial, MaterialList
from rtcal.support import checks, text
from rtcal.support.errors import DataError
from rtcal.support.files import write_bytes
from rtcal.support.types import Array

MOST_NAMED = 5
RECORD = "the record of the calibration"
LOST = {
    "name": ("name",),
    "author": ("author",),
    "areas and volume": ("areas", "volume", "surfaces", "dimensions"),
    "sigma": ("sigma",),
    "uncertainties of areas, volume and climate": (
        "area_sigma",
        "volume_sigma",
        "common_area_sigma",
        "common_alpha_sigma",
        "climate_sigma",
    ),
    "alpha_min": ("alpha_min",),
    "correlations": ("band_correlation", "material_correlation"),
    "what scattering means": ("scattering_model",),
    "air": ("air",),
    "where coefficients are from": ("sources",),
    "coefficients that were above 1": ("clipped",),
    RECORD: ("calibration",),
}
"""What it does not hold, in words, and the fields of a room that these are; see `_of_scene`, too."""


@dataclass(frozen=True, kw_only=True)
class ExportReport:
    """The room as a program reads it from the written file, and the effect on T.

    Parameters
    ----------
    path : str
    template : str or None
        The list whose numbers were changed; None for a new list.
    equation : str
        The reverberation equation that gives both T.
    room : Room
        The room as read from the file: in the file's bands, rounded to its decimals.
    reverberation_time : array (n_bands,)
        T in s of the room that was exported, converted to the file's bands.
    reverberation_time_as_read : array (n_bands,)
        T in s of ``room``.
    bands_not_written : sequence of float
        Bands of the exported room in Hz that the file does not have for every material.
    notes : sequence of str
        How bands were converted or filled.
    lost : sequence of str
        What the exported room states and the file does not hold.
    """

    path: str
    template: str | None
    equation: str
    room: Room
    reverberation_time: Array
    reverberation_time_as_read: Array
    bands_not_written: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()

    @property
    def change(self) -> Array:
        """Change of T by the conversion and rounding, in JND, signed, (n_bands,)."""
        return quality.gap_jnd(self.reverberation_time_as_read, self.reverberation_time)

    def __str__(self) -> str:
        if self.template is None:
            kind = "new list, since there was no such file"
        else:
            kind = "changed list" if self.template == self.path else f"changed {self.template}"
        cells = [
            (bands.label(f), [f"{before:.4f}", f"{after:.4f}", text.number(change, "+.2f")])
            for f, before, after, change in zip(
                self.room.centre_frequencies,
                self.reverberation_time,
                self.reverberation_time_as_read,
                self.change,
                strict=True,
            )
        ]
        rows = [
            f"{self.path}: {kind}",
            *text.wrapped(
                f"T by {self.equation}'s equation: of the room, and of the coefficients as the program "
                "reads them (rounded, in its bands)"
            ),
            *text.table(cells, header=("band", ["T / s", "as read / s", "change / JND"])),
        ]
        if self.bands_not_written:
            missing = ", ".join(bands.labels(self.bands_not_written))
            rows.append(f"Not in the file, so not written: {missing}")
        for note in self.notes:
            rows += text.wrapped(note)
        rows += text.wrapped(f"Not in the file: {', '.join(self.lost)}. Keep the room's own file.")
        if RECORD in self.lost:
            rows += text.wrapped(
                "A room made of this file can be calibrated to the same data again, which would count "
                "them twice."
            )
        return "\n".join(rows)


def write_list(
    room: Room,
    path: str | os.PathLike[str],
    *,
    read: Callable[[str | os.PathLike[str]], MaterialList],
    new_list: Callable[[Room], MaterialList],
    template: str | os.PathLike[str] | None,
    equation: LinearEquation | None,
    decimals: int | None,
    new_bands: Sequence[float] = (),
    missing_bands: str = "refuse",
    entries: Mapping[str, str] | None = None,
    readable: Callable[[str], str] = str,
) -> ExportReport:
    """Write a room's coefficients into the template, else into the existing file, else into a new file.

    ``read`` and ``new_list`` are functions of the format: they return the material list of a file,
    and a new one for a room. ``new_bands`` are the bands of a new file. With
    ``missing_bands="nearest"``, bands that the room lacks have the coefficients of the nearest
    band; with "refuse" they are an error. ``readable`` returns the name that a new file has for a
    material without one in ``entries``.
    """
    checks.instance("room", room, Room)
    checks.choice("missing_bands", missing_bands, ("refuse", "nearest"))
    entries = checks.text_by_name("entries", entries)
    equation = Eyring() if equation is None else equation
    checks.instance("equation", equation, LinearEquation)
    if decimals is not None:
        decimals = checks.whole("decimals", decimals, 0)
    notes: list[str] = []
    if template is None and checks.path("path", path).exists():
        template = path
    if template is not None:
        listed = read(template)
    else:
        in_new_bands, notes = _in_new_bands(room, new_bands, missing_bands, os.fspath(path))
        renamed = _renamed(room.materials, entries, readable)
        entries |= renamed
        names = [entries.get(name, name) for name in room.materials]
        if renamed:
            pairs = [f'"{name}" is {new}' for name, new in renamed.items()]
            some = text.first_of(pairs, MOST_NAMED)
            notes.append(f"Renamed, as the program reads names: {some}")
        listed = new_list(in_new_bands.replace(materials=names, surfaces=()))
    listed = listed.with_entries(entries, room)
    if decimals is not None:
        listed = replace(
            listed, materials=tuple(_with_decimals(m, decimals) for m in listed.materials)
        )
    content, as_read, lacking = listed.with_room(room)
    notes += _without_measured_time(room, equation)
    time = equation.reverberation_time(room)
    between = room.centre_frequencies, as_read.centre_frequencies
    not_written = band_conversion.unused(*between)
    rule = band_conversion.rule(*between, "alpha")
    if rule:
        time = band_conversion.parameter(time, *between)
        notes.append(f"{rule}; T of the room by the mean of 1/T")
    else:
        time = time[np.isin(*between)]
    report = ExportReport(
        path=os.fspath(path),
        template=None if template is None else os.fspath(template),
        equation=equation.name,
        room=as_read,
        reverberation_time=time,
        reverberation_time_as_read=equation.reverberation_time(as_read),
        bands_not_written=tuple(float(f) for f in not_written),
        notes=tuple(notes),
        lost=_lost(room, lacking),
    )
    write_bytes(path, content)
    if template is None:
        return report
    return replace(report, notes=(*report.notes, *_replaced_scattering(listed, read(path))))


def _renamed(
    materials: Sequence[str], stated: Mapping[str, str], readable: Callable[[str], str]
) -> dict[str, str]:
    """Return other names for materials whose own cannot stand in a new file, each there once."""
    taken = {stated.get(name, name) for name in materials}
    renamed: dict[str, str] = {}
    for i, name in enumerate(materials):
        new = readable(name)
        if name in stated or new == name:
            continue
        while new in taken:
            new = f"{new}_{i + 1}"
        taken.add(new)
        renamed[name] = new
    return renamed


def _replaced_scattering(listed: MaterialList, as_written: MaterialList) -> tuple[str, ...]:
    """Return a note on the materials of a changed list that have another scattering now."""
    after = {m.name: m.scattering for m in as_written.materials}
    changed = [
        f"{m.name} ({np.mean(m.scattering):.2f}, now {np.mean(now):.2f})"
        for m in listed.materials
        if m.scattering is not None
        and (now := after.get(m.name)) is not None
        and now != m.scattering
    ]
    if not changed:
        return ()
    return (
        "The room's scattering replaced the list's, which a fit to positions changes too. Means over "
        f"the bands: {text.first_of(changed, MOST_NAMED)}",
    )


def _without_measured_time(room: Room, equation: LinearEquation) -> list[str]:
    """Return a note where a calibrated room lacks the T that it was calibrated to, by half a JND."""
    if room.calibration is None or room.calibration.equation != equation.name:
        return []
    gap = quality.gap_jnd(equation.reverberation_time(room), repeats.times_of(room))
    left = np.abs(gap) >= quality.MET
    if not left.any():
        return []
    each = ", ".join(
        f"{bands.label(f)} {g:+.1f} JND"
        for f, g in zip(room.centre_frequencies[left], gap[left], strict=True)
    )
    return [
        f"The room as exported does not have the measured T ({each}). The calibration left this gap, "
        "as to an uncertain volume: see its page before you simulate"
    ]


def _lost(room: Room, lacking: Sequence[str]) -> tuple[str, ...]:
    """Return what a room states and no list of materials holds, after ``lacking`` scattering."""
    of = "" if len(lacking) == room.n_materials else f" of {', '.join(lacking)}"
    usual = {f.name: f.default for f in fields(room)}

    def is_stated(name: str) -> bool:
        value = getattr(room, name)
        if isinstance(value, np.ndarray):
            return bool(value.any())
        return bool(value) and value != usual[name]

    return (
        *((f"scattering{of}",) if lacking else ()),
        *(words for words, names in LOST.items() if any(map(is_stated, names))),
        *_of_scene(room.scene),
    )


def _of_scene(scene: Scene) -> tuple[str, ...]:
    """Return what a scene states, in words: no sources and receivers where it has none."""
    said = ["mesh"] if scene.mesh is not None else []
    said += ["sources and receivers"] if scene.sources else []
    further = {
        "directivity of sources": bool(scene.directivity),
        "uncertainty of positions": scene.position_uncertainty != POSITION,
        "names of surfaces": bool(scene.surfaces),
    }
    return (*filter(None, [", ".join(said)]), *(words for words, is_so in further.items() if is_so))


def _in_new_bands(
    room: Room, needed: Sequence[float], missing_bands: str, path: str
) -> tuple[Room, list[str]]:
    """Return the room in the bands of a new file, with notes on bands that were filled."""
    if not needed:
        return room, []
    obtainable = band_conversion.obtainable(room.centre_frequencies, needed)
    missing = [f for f in needed if f not in obtainable]
    if missing and (missing_bands == "refuse" or not obtainable.size):
        raise DataError(
            f"{path}: a new file of this program needs {bands.label(missing[0])}, which the room "
            'lacks; write into the program\'s own file (template), or state missing_bands="nearest"'
        )
    converted = band_conversion.room(room, obtainable)
    nearest = [int(np.argmin(np.abs(np.log(obtainable / f)))) for f in needed]
    notes = [
        f"{bands.label(f)} is not in the room: alpha as at {bands.label(obtainable[k])}"
        for f, k in zip(needed, nearest, strict=True)
        if f in missing
    ]
    tables = {n: getattr(converted, n) for n in ("alpha", "sigma", "alpha_min", "scattering")}
    return converted.replace(
        centre_frequencies=np.asarray(needed),
        **{n: t[:, nearest] for n, t in tables.items() if t is not None},
    ), notes


def _with_decimals(listed: ListedMaterial, decimals: int) -> ListedMaterial:
    """Return the material with its numbers written to these decimals of the coefficient."""
    least = 2 if listed.unit == 0.01 else 0
    if not least <= decimals <= 15:
        raise DataError(
            f"decimals = {decimals} of a coefficient; they are {least} to 15"
            + (", since the file has whole percents at least" if least else "")
        )
    return replace(listed, decimals=decimals - least)
