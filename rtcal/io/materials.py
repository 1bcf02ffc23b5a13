"""Material lists of other programs: read, calibrated values put in, every other byte kept.

Each format's module finds the materials and says where each number stands; this one gives them the
same handling: a `Room` from a list, a room's coefficients back into the list, and what the rounding
to the program's decimals does to T.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from rtcal.acoustics import bands, quality
from rtcal.acoustics.air import Air
from rtcal.acoustics.equations import Eyring, LinearEquation
from rtcal.acoustics.materials import text_name
from rtcal.acoustics.room import Material, Room, Surface
from rtcal.errors import DataError
from rtcal.support.files import write_bytes
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True)
class ListedMaterial:
    """One material of a list.

    Parameters
    ----------
    name : str
    line : int
        Where it stands, from 1.
    alpha : sequence (n_bands,)
        Absorption coefficients, 0 to 1.
    centre_frequencies : sequence (n_bands,)
        Hz.
    spans : sequence of (start, end) (n_bands,)
        The bytes of the file that hold each coefficient.
    unit : float
        alpha = number in the file * unit: 0.01 for percent.
    decimals : int or None
        Decimals of a number that is written; None writes all digits.
    scattering : sequence, optional
        Scattering coefficients, 0 to 1; they are read and never written over.
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
    """The materials of a foreign file, and the file's bytes.

    Examples
    --------
    >>> from rtcal.io import catt
    >>> catt.parse(b"ABS floor = <2 3 5 8 10 12>").names
    ('floor',)
    """

    path: str
    content: bytes = field(repr=False)
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
        """The materials' names, in the file's order, without the aliases."""
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
        """Return a room of these materials, in the bands that all materials used have.

        ``areas`` is the area of each material in m², by name or alias, or surfaces (of a
        mesh: `rtcal.io.obj`). The list states no uncertainty:
        sigma = max(``sigma_relative`` * alpha, ``sigma_minimum``).
        """
        surfaces = (
            [Surface(n, n, a) for n, a in areas.items()]
            if isinstance(areas, Mapping)
            else list(areas)
        )
        used: dict[str, ListedMaterial] = {}
        for surface in surfaces:
            listed = self._listed(surface.material)
            used[surface.material] = listed
        if not used:
            raise DataError(f"{self.path}: no areas; a room has at least one surface")
        common = [
            f
            for f in next(iter(used.values())).centre_frequencies
            if all(f in m.centre_frequencies for m in used.values())
        ]
        scattered = all(m.scattering is not None for m in used.values())
        materials = []
        for called, m in used.items():
            columns = [m.centre_frequencies.index(f) for f in common]
            alpha = [m.alpha[c] for c in columns]
            sigma = [max(sigma_relative * a, sigma_minimum) for a in alpha]
            scattering = [m.scattering[c] for c in columns] if scattered and m.scattering else None
            materials.append(Material(called, alpha, sigma, 0.0, scattering, self.path))
        return Room.from_surfaces(
            name=name,
            volume=volume,
            surfaces=surfaces,
            materials=materials,
            centre_frequencies=common,
            air=air,
        )

    def _listed(self, name: str) -> ListedMaterial:
        called = name if name in self.names else self.aliases.get(name)
        for material in self.materials:
            if material.name == called:
                return material
        known = ", ".join([*self.names, *self.aliases])
        raise DataError(f'"{name}" is no material of {self.path}; it has {known}')

    def with_alpha(self, room: Room) -> tuple[bytes, Room]:
        """Return the file with the room's coefficients in it, and the room as it is then read.

        A number is written anew only where the coefficient, rounded to the file's decimals, is
        not the one that stands there. Raises DataError for a material that the file lacks, for
        a list without a band of the room's, and for aliases given two coefficients.
        """
        read = np.array(room.alpha)
        changes: dict[tuple[int, int], str] = {}
        given: dict[tuple[int, int], tuple[float, str]] = {}
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
                if given.setdefault(span, (alpha, name))[0] != alpha:
                    raise DataError(
                        f'{room.place("alpha", i, k)} = {alpha:g}, but "{given[span][1]}" stands '
                        f"for the same material of {self.path} and has {given[span][0]:g}"
                    )
                text, value = material.rounded(alpha)
                if material.alpha[b] in (alpha, value):
                    value = material.alpha[b]
                else:
                    changes[span] = text
                read[i, k] = value
        pieces, done = [], 0
        for (start, end), text in sorted(changes.items()):
            pieces += [self.content[done:start], text.encode("ascii")]
            done = end
        return b"".join([*pieces, self.content[done:]]), room.replace(alpha=read)


@dataclass(frozen=True, kw_only=True)
class Written:
    """What a program reads from the file that was written, and what the rounding does to T.

    ``room`` has the coefficients as they are read; T in s, (n_bands,), by ``equation``.
    """

    path: str
    equation: str
    room: Room
    reverberation_time: Array
    reverberation_time_as_read: Array
    bands_not_written: tuple[float, ...] = ()

    @property
    def change(self) -> Array:
        """What the rounding does to T, in JND, signed, (n_bands,)."""
        return quality.gap_jnd(self.reverberation_time_as_read, self.reverberation_time)

    def __str__(self) -> str:
        lines = [
            f"{self.path}: T by {self.equation}, before and after the rounding of alpha",
            f"{'band':>8} {'T, s':>9} {'as read, s':>11} {'change, JND':>12}",
        ]
        for f, t, r, c in zip(
            self.room.centre_frequencies,
            self.reverberation_time,
            self.reverberation_time_as_read,
            self.change,
            strict=True,
        ):
            lines.append(f"{bands.label(f):>8} {t:9.4f} {r:11.4f} {c:+12.4f}")
        if self.bands_not_written:
            missing = ", ".join(bands.label(f) for f in self.bands_not_written)
            lines.append(f"Not in the file, so not written: {missing}")
        return "\n".join(lines)


def coefficient(value: float, unit: float) -> float:
    """Return the coefficient of a number in the file; percent divide, so that 7 gives 0.07."""
    return value / round(1 / unit) if unit < 1 else value


def checked(values: Sequence[float], unit: float, place: str, name: str = "alpha") -> None:
    """Raise DataError unless every number is a coefficient from 0 to 1 (0 to 100 in percent)."""
    for value in values:
        if not 0 <= coefficient(value, unit) <= 1:
            raise DataError(f"{place}: {name} {value:g} is not in [0, {1 / unit:g}]")


def write(
    room: Room,
    path: str | os.PathLike[str],
    *,
    read: Callable[[str | os.PathLike[str]], MaterialList],
    fresh: Callable[[Room], MaterialList],
    template: str | os.PathLike[str] | None,
    equation: LinearEquation | None,
    decimals: int | None,
) -> Written:
    """Write a room's coefficients: into the template, else the file that is there, else anew."""
    if template is not None or Path(path).exists():
        listed = read(template if template is not None else path)
    else:
        listed = fresh(room)
    if decimals is not None:
        listed = replace(
            listed, materials=tuple(_with_decimals(m, decimals) for m in listed.materials)
        )
    content, as_read = listed.with_alpha(room)
    equation = equation or Eyring()
    held = {f for m in listed.materials for f in m.centre_frequencies}
    report = Written(
        path=os.fspath(path),
        equation=equation.name,
        room=as_read,
        reverberation_time=equation.reverberation_time(room),
        reverberation_time_as_read=equation.reverberation_time(as_read),
        bands_not_written=tuple(float(f) for f in room.centre_frequencies if f not in held),
    )
    write_bytes(path, content)
    return report


def _with_decimals(listed: ListedMaterial, decimals: int) -> ListedMaterial:
    """The material, its numbers written with these decimals of the coefficient."""
    least = 2 if listed.unit == 0.01 else 0
    if not least <= decimals <= 15:
        raise DataError(
            f"decimals = {decimals} of a coefficient; they are {least} to 15"
            + (", since the file has whole percents at least" if least else "")
        )
    return replace(listed, decimals=decimals - least)


def octaves(room: Room, needed: Sequence[float], program: str) -> list[int]:
    """Return the room's columns of the bands that a fresh file of a program must have."""
    columns = [bands.index(np.asarray(room.centre_frequencies), f) for f in needed]
    for f, column in zip(needed, columns, strict=True):
        if column is None:
            raise DataError(
                f"a new file for {program} needs {bands.label(f)}, which the room has not; write "
                "into the program's own file (template)"
            )
    return [c for c in columns if c is not None]
