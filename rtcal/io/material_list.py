"""Material lists of other programs: a room from a list, and calibrated coefficients back into it.

Each format's module reads the materials and the position of every number. This module does what all
formats share. Only numbers that change are written; all other bytes stay. The report says what the
rounding to the program's decimals does to T.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from rtcal.acoustics import band_conversion, bands, quality
from rtcal.acoustics.air import Air
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.room import Material, Room, Surface
from rtcal.errors import DataError
from rtcal.io.text import Text
from rtcal.support.files import write_bytes
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True)
class ListedMaterial:
    """One material of a list.

    Parameters
    ----------
    name : str
    line : int
        Line of the file, from 1.
    alpha : sequence (n_bands,)
        Absorption coefficients, 0 to 1.
    centre_frequencies : sequence (n_bands,)
        Hz.
    spans : sequence of (start, end) (n_bands,)
        Characters of the file's text that hold each coefficient.
    unit : float
        alpha = number in the file * unit: 0.01 for percent.
    decimals : int or None
        Decimals of a number that is written; None writes all digits.
    scattering : sequence (n_bands,), optional
        Scattering coefficients, 0 to 1. They are read and never changed.
    """

    name: str
    line: int
    alpha: tuple[float, ...]
    centre_frequencies: tuple[float, ...]
    spans: tuple[tuple[int, int], ...]
    unit: float = 1.0
    decimals: int | None = None
    scattering: tuple[float, ...] | None = None

    def rounded(self, alpha: float) -> tuple[str, float]:
        """Return the number as it is written, and the coefficient that is read from it."""
        if self.decimals is None:
            return repr(alpha / self.unit), alpha
        text = f"{alpha / self.unit:.{self.decimals}f}"
        return text, coefficient(float(text), self.unit)


@dataclass(frozen=True, kw_only=True)
class MaterialList:
    """The materials of a foreign file, and the file's text.

    Parameters
    ----------
    path : str
        The file's name in messages.
    text : Text
    materials : sequence of ListedMaterial
    aliases : mapping of str to str
        Further names of materials.

    Examples
    --------
    >>> from rtcal.io import catt
    >>> catt.parse(b"ABS floor = <2 3 5 8 10 12>").names
    ('floor',)
    """

    path: str
    text: Text = field(repr=False)
    materials: tuple[ListedMaterial, ...]
    aliases: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        first: dict[str, int] = {}
        for material in self.materials:
            text_name(f"{self.path}, line {material.line}: a material's name", material.name)
            if material.name in first:
                raise DataError(
                    f'{self.path}, line {material.line}: "{material.name}" is given twice, first '
                    f"on line {first[material.name]}"
                )
            first[material.name] = material.line
        if not self.materials:
            raise DataError(f"{self.path}, line 1: no material in it")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the materials in the file's order, without aliases."""
        return tuple(m.name for m in self.materials)

    def room(
        self,
        *,
        name: str,
        volume: float,
        areas: Mapping[str, float] | Sequence[Surface],
        sigma_relative: float = 0.3,
        sigma_minimum: float = 0.01,
        air: Air | None = None,
    ) -> Room:
        """Return a room of these materials, in the bands that all of its materials have.

        Parameters
        ----------
        name : str
        volume : float
            m³.
        areas : mapping of str to float, or sequence of Surface
            Area of each material in m², by name or alias; or surfaces (of a mesh: `rtcal.io.obj`).
        sigma_relative, sigma_minimum : float
            A list states no uncertainty: sigma = max(sigma_relative alpha, sigma_minimum).
        air : Air, optional

        Raises
        ------
        DataError
            For a material that the list lacks, for no area, and as `Room` does.
        """
        surfaces = (
            [Surface(n, n, a) for n, a in areas.items()]
            if isinstance(areas, Mapping)
            else list(areas)
        )
        used = {surface.material: self._listed(surface.material) for surface in surfaces}
        if not used:
            raise DataError(f"{self.path}: no areas; a room has at least one surface")
        common = [
            f
            for f in next(iter(used.values())).centre_frequencies
            if all(f in m.centre_frequencies for m in used.values())
        ]
        all_scatter = all(m.scattering is not None for m in used.values())
        materials = []
        for material_name, listed in used.items():
            columns = [listed.centre_frequencies.index(f) for f in common]
            alpha = [listed.alpha[c] for c in columns]
            sigma = [max(sigma_relative * a, sigma_minimum) for a in alpha]
            scattering = None
            if all_scatter and listed.scattering:
                scattering = [listed.scattering[c] for c in columns]
            materials.append(Material(material_name, alpha, sigma, 0.0, scattering, self.path))
        return Room.from_surfaces(
            name=name,
            volume=volume,
            surfaces=surfaces,
            materials=materials,
            centre_frequencies=common,
            air=air,
        )

    def _listed(self, name: str) -> ListedMaterial:
        """Return the material of a name or alias."""
        target = name if name in self.names else self.aliases.get(name)
        for material in self.materials:
            if material.name == target:
                return material
        names = ", ".join([*self.names, *self.aliases])
        raise DataError(f'"{name}" is no material of {self.path}; it has {names}')

    def _in_file_bands(self, room: Room) -> Room:
        """Return the room itself, or the room in the file's bands if they are of another width."""
        bands_of = {name: set(self._listed(name).centre_frequencies) for name in room.materials}
        wanted = sorted(set.intersection(*bands_of.values()))
        if not wanted or not band_conversion.rule(room.centre_frequencies, wanted, "alpha"):
            return room
        obtainable = band_conversion.obtainable(room.centre_frequencies, wanted)
        if not obtainable.size:
            raise DataError(
                f"{self.path}: none of its bands can be had from the room's, "
                f"{', '.join(bands.label(f) for f in room.centre_frequencies)}"
            )
        return band_conversion.room(room, obtainable)

    def with_alpha(self, room: Room) -> tuple[bytes, Room]:
        """Return the file with the room's coefficients in it, and the room as it is then read.

        A room in thirds is written into a file in octaves as the means of the thirds, and a room in
        octaves into a file in thirds as the octaves' values; the room that is returned is then in
        the file's bands. A number is written only where the coefficient, rounded to the file's
        decimals, differs from the one that stands there.

        Raises
        ------
        DataError
            For a material that the file lacks, for a material that has none of the room's bands,
            and for two aliases of one material with different coefficients.
        """
        room = self._in_file_bands(room)
        as_read = np.array(room.alpha)
        texts: dict[tuple[int, int], str] = {}
        written: dict[tuple[int, int], tuple[float, str]] = {}
        for i, name in enumerate(room.materials):
            material = self._listed(name)
            columns = [
                bands.index(np.asarray(room.centre_frequencies), f)
                for f in material.centre_frequencies
            ]
            if all(c is None for c in columns):
                raise DataError(
                    f'{self.path}, line {material.line}: "{material.name}" has none of the '
                    "room's bands"
                )
            for b, k in enumerate(columns):
                if k is None:
                    continue
                alpha, span = float(room.alpha[i, k]), material.spans[b]
                if written.setdefault(span, (alpha, name))[0] != alpha:
                    raise DataError(
                        f'{room.place("alpha", i, k)} = {alpha:g}, but "{written[span][1]}" is '
                        f"the same material of {self.path} and has {written[span][0]:g}"
                    )
                text, value = material.rounded(alpha)
                if material.alpha[b] in (alpha, value):
                    value = material.alpha[b]
                else:
                    texts[span] = text
                as_read[i, k] = value
        pieces, position = [], 0
        for (start, end), text in sorted(texts.items()):
            pieces += [self.text.characters[position:start], text]
            position = end
        pieces.append(self.text.characters[position:])
        return self.text.encode("".join(pieces)), room.replace(alpha=as_read)


@dataclass(frozen=True, kw_only=True)
class ExportReport:
    """What a program reads from the file that was written, and what that does to T.

    Parameters
    ----------
    path : str
    equation : str
        The reverberation equation that gives both T.
    room : Room
        The room as the program reads it: in the file's bands, rounded to its decimals.
    reverberation_time : array (n_bands,)
        T in s of the room that was exported, converted to the file's bands.
    reverberation_time_as_read : array (n_bands,)
        T in s of ``room``.
    bands_not_written : sequence of float
        Bands of the exported room in Hz that the file does not have.
    notes : sequence of str
        How bands were converted or filled.
    """

    path: str
    equation: str
    room: Room
    reverberation_time: Array
    reverberation_time_as_read: Array
    bands_not_written: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def change(self) -> Array:
        """What writing does to T, in JND, signed, (n_bands,)."""
        return quality.gap_jnd(self.reverberation_time_as_read, self.reverberation_time)

    def __str__(self) -> str:
        rows = [
            f"{self.path}: T by {self.equation}, of the room and as the program reads it",
            f"{'band':>8} {'T, s':>9} {'as read, s':>11} {'change, JND':>12}",
        ]
        for f, before, after, change in zip(
            self.room.centre_frequencies,
            self.reverberation_time,
            self.reverberation_time_as_read,
            self.change,
            strict=True,
        ):
            rows.append(f"{bands.label(f):>8} {before:9.4f} {after:11.4f} {change:+12.4f}")
        if self.bands_not_written:
            missing = ", ".join(bands.label(f) for f in self.bands_not_written)
            rows.append(f"Not in the file, so not written: {missing}")
        return "\n".join([*rows, *self.notes])


def coefficient(value: float, unit: float) -> float:
    """Return the coefficient that a number of the file means.

    Percent are divided by 100, so that 7 gives 0.07 to the last bit.
    """
    return value / round(1 / unit) if unit < 1 else value


def check_coefficients(
    values: Sequence[float], unit: float, place: str, name: str = "alpha"
) -> None:
    """Raise DataError unless every number is from 0 to 1 (0 to 100 in percent)."""
    for value in values:
        if not 0 <= coefficient(value, unit) <= 1:
            raise DataError(f"{place}: {name} {value:g} is not in [0, {1 / unit:g}]")


def write(
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
) -> ExportReport:
    """Write a room's coefficients into the template, else into the file that exists, else anew.

    ``read`` and ``new_list`` are the format's: a file's material list, and a new one for a room.
    ``new_bands`` are those that a new file needs; ``missing_bands`` is "refuse" or "nearest", which
    gives a band that the room lacks the coefficients of its nearest one.
    """
    if missing_bands not in ("refuse", "nearest"):
        raise DataError(f'missing_bands = "{missing_bands}" is neither "refuse" nor "nearest"')
    equation = equation or Eyring()
    notes: list[str] = []
    if template is not None or Path(path).exists():
        listed = read(template if template is not None else path)
    else:
        in_new_bands, notes = _in_new_bands(room, new_bands, missing_bands, os.fspath(path))
        listed = new_list(in_new_bands)
    if decimals is not None:
        listed = replace(
            listed, materials=tuple(_with_decimals(m, decimals) for m in listed.materials)
        )
    content, as_read = listed.with_alpha(room)
    time = equation.reverberation_time(room)
    held = {f for m in listed.materials for f in m.centre_frequencies}
    not_written = np.array([f for f in room.centre_frequencies if f not in held])
    rule = band_conversion.rule(room.centre_frequencies, as_read.centre_frequencies, "alpha")
    if rule:
        between = room.centre_frequencies, as_read.centre_frequencies
        time, not_written = (
            band_conversion.parameter(time, *between),
            band_conversion.unused(*between),
        )
        notes.append(f"{rule}; T of the room by the mean of 1/T")
    report = ExportReport(
        path=os.fspath(path),
        equation=equation.name,
        room=as_read,
        reverberation_time=time,
        reverberation_time_as_read=equation.reverberation_time(as_read),
        bands_not_written=tuple(float(f) for f in not_written),
        notes=tuple(notes),
    )
    write_bytes(path, content)
    return report


def _in_new_bands(
    room: Room, needed: Sequence[float], missing_bands: str, path: str
) -> tuple[Room, list[str]]:
    """Return the room in the bands that a new file needs, and how they were filled."""
    if not needed:
        return room, []
    obtainable = band_conversion.obtainable(room.centre_frequencies, needed)
    missing = [f for f in needed if f not in obtainable]
    if missing and (missing_bands == "refuse" or not obtainable.size):
        raise DataError(
            f"{path}: a new file of this program needs {bands.label(missing[0])}, which the room has "
            'not; write into the program\'s own file (template), or state missing_bands="nearest"'
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
