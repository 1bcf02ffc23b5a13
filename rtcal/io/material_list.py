"""Material lists of other programs: a room from a list, and calibrated coefficients back into it.

Each format's module reads the materials and the position of every number. This module converts bands
and writes numbers, for all formats. Only numbers that change are written; all other bytes stay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rtcal.acoustics import band_conversion, bands, priors
from rtcal.acoustics.air import Air
from rtcal.acoustics.materials import above_one_hint, text_name
from rtcal.acoustics.room import Material, Room, Surface
from rtcal.io.text import Text
from rtcal.support.errors import DataError
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True)
class SigmaRule:
    """A rule for the sigma of materials that state none; see `rtcal.acoustics.priors`.

    sigma = in_situ_factor * max(relative * alpha, minimum), or with ``iso_12999_2`` the maximum also of
    ISO 12999-2's sigma_R.
    """

    relative: float = 0.3
    minimum: float = 0.01
    iso_12999_2: bool = False
    in_situ_factor: float = 1.0

    def sigma(self, alpha: Array, centre_frequencies: Array) -> Array:
        """Return sigma, (n_bands,)."""
        sigma = priors.sigma_relative(alpha, self.relative, self.minimum)
        if self.iso_12999_2:
            sigma = np.maximum(sigma, priors.sigma_iso_12999_2(alpha, centre_frequencies))
        return priors.in_situ(sigma, self.in_situ_factor)

    def __str__(self) -> str:
        rules = [f"{self.relative:g} alpha", f"{self.minimum:g}"]
        rules += ["ISO 12999-2's"] if self.iso_12999_2 else []
        factor = "" if self.in_situ_factor == 1 else f"{self.in_situ_factor:g} "
        return f"sigma = {factor}max({', '.join(rules)})"


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
        Factor from the file's number to alpha: 0.01 for percent.
    decimals : int or None
        Decimals of written numbers; None for all digits.
    scattering : sequence (n_bands,), optional
        Scattering coefficients, 0 to 1.
    scattering_spans : sequence of (start, end) (n_bands,)
        Characters of the file's text that hold each of them.
    scattering_place : int, optional
        Where the format takes those of a material that states none; None if nowhere.
    source : str
        Where the coefficients come from, if not from the list itself.
    doubt : str
        Why a room is not to have the coefficients as they are read, and what to write; empty if
        they are plain.
    """

    name: str
    line: int
    alpha: tuple[float, ...]
    centre_frequencies: tuple[float, ...]
    spans: tuple[tuple[int, int], ...]
    unit: float = 1.0
    decimals: int | None = None
    scattering: tuple[float, ...] | None = None
    scattering_spans: tuple[tuple[int, int], ...] = ()
    scattering_place: int | None = None
    source: str = ""
    doubt: str = ""

    def in_bands(self, values: Sequence[float], wanted: Array, place: str) -> Array:
        """Return one value per band of this material in other bands; DataError names the place."""
        try:
            return band_conversion.absorption(np.array(values), self.centre_frequencies, wanted)
        except DataError as error:
            raise DataError(f"{place}: {error}") from error

    def rounded(self, alpha: float) -> tuple[str, float]:
        """Return the text of a written number, and the coefficient that is read from it."""
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
    scattering_text : callable, optional
        Returns the text for a `ListedMaterial.scattering_place`, of one number per band.

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
    scattering_text: Callable[[Sequence[str]], str] | None = None

    def __post_init__(self) -> None:
        first: dict[str, int] = {}
        for material in self.materials:
            place = f"{self.path}, line {material.line}: a material's name"
            if not text_name(place, material.name).strip():
                raise DataError(f"{place} has {material.name!r}; a name is not blank")
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
        centre_frequencies: Sequence[float] | None = None,
        sigma_rule: SigmaRule | None = None,
        sigma: Mapping[str, ListedMaterial | float] | None = None,
        scattering: float | None = None,
        others: Mapping[str, ListedMaterial] | None = None,
        air: Air | None = None,
    ) -> Room:
        """Return a room of these materials.

        Parameters
        ----------
        name : str
        volume : float
            m³.
        areas : mapping of str to float, or sequence of Surface
            Area of each material in m², by name or alias; or surfaces, for example of a mesh
            (`rtcal.io.obj`).
        centre_frequencies : sequence, optional
            The room's bands in Hz, converted from the list's if they are of another width; by
            default the bands that all of the room's materials have.
        sigma_rule : SigmaRule, optional
            A list states no uncertainty; by default sigma = max(0.3 alpha, 0.01).
        sigma : mapping of str to ListedMaterial or float, optional
            Stated sigma of some materials, in any bands or as one number.
        scattering : float, optional
            Scattering coefficient of materials that state none. Without it, the room has scattering
            only if all its materials state it.
        others : mapping of str to ListedMaterial, optional
            Materials from another source, for instance a catalogue.
        air : Air, optional

        Raises
        ------
        DataError
            For a material that the list lacks or whose coefficients are in doubt, a missing area,
            a band that a material lacks, and as `Room` does.
        """
        surfaces = (
            [Surface(n, n, a) for n, a in areas.items()]
            if isinstance(areas, Mapping)
            else list(areas)
        )
        others = others or {}
        used = {s.material: others.get(s.material) or self.listed(s.material) for s in surfaces}
        if doubts := [m.doubt for m in used.values() if m.doubt]:
            raise DataError(doubts[0])
        if not used:
            raise DataError(f"{self.path}: no areas; a room has at least one surface")
        if centre_frequencies is None:
            common = set.intersection(*(set(m.centre_frequencies) for m in used.values()))
            if not common:
                raise DataError(f"{self.path}: the materials of the room have no band in common")
            centre_frequencies = sorted(common)
        wanted = bands.as_bands(centre_frequencies)
        all_scatter = all(m.scattering is not None or scattering is not None for m in used.values())
        materials = []
        for material_name, listed in used.items():
            place = f'material "{material_name}"'
            alpha = listed.in_bands(listed.alpha, wanted, place)
            spread = (sigma_rule or SigmaRule()).sigma(alpha, wanted)
            stated = (sigma or {}).get(material_name)
            if isinstance(stated, ListedMaterial):
                spread = stated.in_bands(stated.alpha, wanted, f"sigma of {place}")
            elif stated is not None:
                spread = np.full(len(wanted), stated)
            scatters = None
            if all_scatter:
                rows = listed.scattering or (scattering,) * len(listed.centre_frequencies)
                scatters = listed.in_bands(rows, wanted, place).tolist()  # type: ignore[arg-type]
            source = listed.source or self.path
            materials.append(
                Material(material_name, alpha.tolist(), spread.tolist(), 0.0, scatters, source)
            )
        return Room.from_surfaces(
            name=name,
            volume=volume,
            surfaces=surfaces,
            materials=materials,
            centre_frequencies=wanted,
            air=air,
        )

    def listed(self, name: str) -> ListedMaterial:
        """Return the material of a name or alias; DataError if the list has none."""
        target = self.aliases.get(name, name)
        for material in self.materials:
            if material.name == target:
                return material
        names = ", ".join([*self.names, *self.aliases])
        raise DataError(f'"{name}" is no material of {self.path}; it has {names}')

    def with_entries(self, entries: Mapping[str, str], room: Room) -> MaterialList:
        """Return the list with names of its own for a room's materials; see `rtcal.io.catt.write`."""
        if unknown := [name for name in entries if name not in room.materials]:
            raise DataError(
                f'entries: "{unknown[0]}" is no material of the room; it has '
                f"{', '.join(room.materials)}"
            )
        names = {name: self.listed(entry).name for name, entry in entries.items()}
        listed = replace(self, aliases={**self.aliases, **names}).with_spellings(room.materials)
        there = {*listed.names, *listed.aliases}
        if missing := [name for name in room.materials if name not in there]:
            raise DataError(
                f'"{missing[0]}" is no material of {self.path}; it has {", ".join(listed.names)}. '
                f'Which is it? State entries={{"{missing[0]}": "NAME"}}'
            )
        return listed

    def with_spellings(self, names: Iterable[str]) -> MaterialList:
        """Return the list with aliases for names that differ from its own by blanks alone.

        Exporters of meshes write ``ceiling_plaster`` for "ceiling plaster", or the reverse.
        """
        there = {*self.names, *self.aliases}
        aliases = dict(self.aliases)
        for name in names:
            alike = {self.listed(n).name for n in there if _spelling(n) == _spelling(name)}
            if name not in there and len(alike) == 1:
                aliases[name] = alike.pop()
        return replace(self, aliases=aliases)

    def _in_file_bands(self, room: Room) -> Room:
        """Return the room itself, or the room in the file's bands if they are of another width."""
        bands_of = {name: set(self.listed(name).centre_frequencies) for name in room.materials}
        wanted = sorted(set.intersection(*bands_of.values()))
        if not wanted or not band_conversion.rule(room.centre_frequencies, wanted, "alpha"):
            return room
        obtainable = band_conversion.obtainable(room.centre_frequencies, wanted)
        if not obtainable.size:
            raise DataError(
                f"{self.path}: none of its bands can be had from the room's, "
                f"{', '.join(bands.labels(room.centre_frequencies))}"
            )
        return band_conversion.room(room, obtainable)

    def with_room(self, room: Room) -> tuple[bytes, Room, tuple[str, ...]]:
        """Return the file with the room's coefficients, the room as read from it, and what it lacks.

        If the file has octaves and the room thirds, the file gets the means of the thirds. If the file
        has thirds and the room octaves, each third gets its octave's value. The returned room has the
        file's bands. A number is replaced only if the coefficient, rounded to the file's decimals,
        differs from it.

        Scattering is written where the file holds it or its format takes it in that place. What is
        lacking are the materials whose scattering is not written; without it in all of them, the room
        as read has none.

        Raises
        ------
        DataError
            For a material that the file lacks, for a material that has none of the room's bands,
            and for two aliases of one material with different coefficients.
        """
        room = self._in_file_bands(room)
        change = _Change()
        alpha = np.array(room.alpha)
        scattering = None if room.scattering is None else np.array(room.scattering)
        lacking = []
        for i, name in enumerate(room.materials):
            material = self.listed(name)
            columns = [
                bands.index(np.asarray(room.centre_frequencies), f)
                for f in material.centre_frequencies
            ]
            if all(c is None for c in columns):
                raise DataError(
                    f'{self.path}, line {material.line}: "{material.name}" has none of the '
                    "room's bands"
                )
            for k, span, stated in zip(columns, material.spans, material.alpha, strict=True):
                if k is not None:
                    place = f"{self.path}: {room.place('alpha', i, k)}"
                    alpha[i, k] = change.to(material, span, stated, float(alpha[i, k]), place)
            if scattering is None:
                continue
            spans, at = material.scattering_spans, material.scattering_place
            in_room = [k for k in columns if k is not None]
            if material.scattering is not None and spans:
                for k, span, stated in zip(columns, spans, material.scattering, strict=True):
                    if k is not None:
                        place = f"{self.path}: {room.place('scattering', i, k)}"
                        value = float(scattering[i, k])
                        scattering[i, k] = change.to(material, span, stated, value, place)
            elif at is not None and self.scattering_text and len(in_room) == len(columns):
                numbers = [material.rounded(float(scattering[i, k])) for k in in_room]
                inserted = self.scattering_text([text for text, _ in numbers])
                change.insert(at, inserted, f'{self.path}: scattering["{name}"]')
                scattering[i, in_room] = [value for _, value in numbers]
            else:
                lacking.append(name)
        as_read = room.replace(alpha=alpha, scattering=None if lacking else scattering)
        in_file = set.intersection(
            *(set(self.listed(name).centre_frequencies) for name in room.materials)
        )
        shared = [f for f in room.centre_frequencies if f in in_file]
        if not shared:
            raise DataError(f"{self.path}: its materials have none of the room's bands in common")
        if len(shared) < room.n_bands:
            as_read = band_conversion.room(as_read, shared)
        return self.text.encode(change.text(self.text.characters)), as_read, tuple(lacking)


def _spelling(name: str) -> str:
    return "_".join(name.replace("_", " ").split())


class _Change:
    """The spans of a file's text that get other characters."""

    def __init__(self) -> None:
        self.texts: dict[tuple[int, int], str] = {}
        self.written: dict[tuple[int, int], tuple[float | str, str]] = {}

    def to(
        self,
        material: ListedMaterial,
        span: tuple[int, int],
        stated: float,
        value: float,
        place: str,
    ) -> float:
        """Write a number unless the one stated is the same when rounded; return what is then read."""
        self._once(span, value, place)
        text, read = material.rounded(value)
        if stated in (value, read):
            return stated
        self.texts[span] = text
        return read

    def insert(self, at: int, text: str, place: str) -> None:
        """Write numbers where the file has none."""
        self._once((at, at), text, place)
        self.texts[at, at] = text

    def _once(self, span: tuple[int, int], value: float | str, place: str) -> None:
        """Raise DataError if two names of one material ask for different values."""
        before, first = self.written.setdefault(span, (value, place))
        if before != value:
            raise DataError(
                f"{place} = {value}, but {first} is the same material and has "
                f"{before}: give one of them an entry of its own in the program"
            )

    def text(self, characters: str) -> str:
        """Return the file's text with all changes."""
        pieces, position = [], 0
        for (start, end), text in sorted(self.texts.items()):
            pieces += [characters[position:start], text]
            position = end
        return "".join([*pieces, characters[position:]])


def coefficient(value: float, unit: float) -> float:
    """Return the coefficient of a number in the file.

    Percent are divided by 100, not multiplied by 0.01, so that 7 gives exactly the float 0.07.
    """
    return value / round(1 / unit) if unit < 1 else value


def check_coefficients(
    values: Sequence[float], unit: float, place: str, name: str = "alpha"
) -> None:
    """Raise DataError unless every number is from 0 to 1 (0 to 100 in percent)."""
    for value in values:
        if not 0 <= coefficient(value, unit) <= 1:
            hint = above_one_hint(coefficient(value, unit)) if name == "alpha" else ""
            instead = f"; in this list write {1 / unit:g}" if hint else ""
            raise DataError(f"{place}: {name} {value:g} is not in [0, {1 / unit:g}]{hint}{instead}")
