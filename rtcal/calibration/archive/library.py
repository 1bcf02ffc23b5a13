"""The library of an archive: materials with mu and sigma, and how sure each is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.room import ARCHIVE, CalibrationRecord, Material, Room
from rtcal.calibration.archive.likelihood import Spread
from rtcal.files.disk import json_numbers
from rtcal.files.saved import Result
from rtcal.support import __version__, checks, text
from rtcal.support.errors import DataError
from rtcal.support.types import Array

_OFF = 2.0
"""Standard deviations from which a table's entry is printed as off."""
_ALIKE = 1.0
"""Largest difference of one material's tables: rms over the bands, in their standard deviations."""


def is_one_material(mu: Array, sigma: Array, other: Array, other_sigma: Array) -> bool:
    """Whether two tables under one name are near enough to be of one material; (n_bands,) each."""
    off, spread = np.abs(mu - other), np.hypot(sigma, other_sigma)
    z = np.divide(off, spread, out=np.where(off > 0, np.inf, 0.0), where=spread > 0)
    return bool(np.sqrt(np.mean(z**2)) <= _ALIKE)


@dataclass(frozen=True, kw_only=True)
class Lesson:
    """The contribution of one room, and its agreement with the others.

    Attributes
    ----------
    room : str
    factor, factor_sigma : float
        The relative factor of all its coefficients, and its standard deviation.
    q, degrees_of_freedom, p_value
        Of its T beside what all other rooms predict: chi-square.
    taught : float
        By which share this room reduced the standard deviation of its materials' means.
    """

    room: str
    factor: float
    factor_sigma: float
    q: float
    degrees_of_freedom: int
    p_value: float
    taught: float


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """A material of a room that is likely another than it is named.

    Attributes
    ----------
    room, material : str
    instead : str
        The archive's material that it more likely is; "" for none of them.
    probability : float
        That it is another one; before the data 0.01.
    """

    room: str
    material: str
    instead: str
    probability: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Archive(Result):
    """The materials that calibrated rooms share, as `rtcal.learn` returns them.

    Attributes
    ----------
    materials : tuple of str
    centre_frequencies : array (n_bands,)
    table, table_sigma : array (n_materials, n_bands)
        What the rooms had stated: the mean of their entries, and the largest sigma.
    alpha, sigma : array (n_materials, n_bands)
        The library: mean and standard deviation of a coefficient in the next room.
    mean_sigma : array (n_materials, n_bands)
        Standard deviation of the mean itself: it falls with every room.
    seen : array (n_materials,)
        In how many rooms.
    spread : Spread
        The likeliest. Those above count what it leaves open.
    together, together_sigma : float
        How far all tables are off together, relative, and its standard deviation.
    room_sigma : float
        Relative standard deviation of the next room's common factor.
    lessons : tuple of Lesson
    suspects : tuple of Suspect
        The likeliest first.
    measured : tuple of str
        Names of the measured T that it has learned from, as a `CalibrationRecord` keeps them.
    """

    record_kind: ClassVar[str] = "archive 1"

    materials: tuple[str, ...]
    centre_frequencies: Array
    table: Array
    table_sigma: Array
    alpha: Array
    sigma: Array
    mean_sigma: Array
    seen: NDArray[np.int_]
    spread: Spread
    together: float
    together_sigma: float
    room_sigma: float
    lessons: tuple[Lesson, ...]
    suspects: tuple[Suspect, ...]
    measured: tuple[str, ...]

    def material(self, name: str) -> Material:
        """Return one entry with its sigma and its source; DataError if the archive lacks it."""
        if name not in self.materials:
            raise DataError(
                f'"{name}" is no material of the archive; it has {", ".join(self.materials)}'
            )
        i = self.materials.index(name)
        return Material(
            name=name,
            alpha=self.alpha[i].tolist(),
            sigma=self.sigma[i].tolist(),
            source=self._source(i),
        )

    def apply(self, room: Room, names: Mapping[str, str] | None = None) -> Room:
        """Return a room with the library's alpha and sigma where the archive knows the material.

        A material that it does not know keeps its table times the factor by which all tables are off
        together, unless the table is exact or made by an archive. Other bands stay, and a material
        whose table is too far from that of the archive's rooms to be one with it: ``names`` takes it
        nevertheless. ``common_alpha_sigma`` becomes the factor by which rooms differ. An ``alpha_min``
        above the new coefficient is kept, and the coefficient raised to it. The room's record names the
        T that the archive has learned from, so that a calibration to one of them is refused.

        Parameters
        ----------
        room : Room
            Not calibrated yet.
        names : mapping of str to str, optional
            From the room's names of materials to the archive's. They may be alike.

        Raises
        ------
        DataError
            If no material or no band of the room is known, ``names`` has an unknown one, or the
            archive's rooms differ so far that they say nothing of the next.
        """
        pairs, columns = self._known(room, names)
        if not pairs or not columns:
            what = "materials" if not pairs else "bands"
            raise DataError(f'the archive knows none of the {what} of room "{room.name}"')
        if not self.room_sigma < 1:
            raise DataError(
                f"room_sigma = {self.room_sigma:.3g}: the archive's rooms differ from each other by a "
                "factor whose standard deviation is not below 1, so they say nothing of the next; look "
                "at those with a small p"
            )
        learned = [k for k, _ in columns]
        own = np.ix_([i for i, _ in pairs], learned)
        entry = np.ix_([j for _, j in pairs], [k for _, k in columns])
        alpha, sigma = room.alpha.copy(), room.sigma.copy()
        alpha[own], sigma[own] = self.alpha[entry], self.sigma[entry]
        unknown = self._unknown(room, pairs)
        other = np.ix_(unknown, learned)
        inexact = sigma[other] > 0
        sigma[other] = np.hypot(sigma[other], inexact * self.together_sigma * alpha[other])
        alpha[other] *= 1 + inexact * self.together
        alpha, sigma = np.clip(alpha, 0.0, 1.0), np.minimum(sigma, 1.0)
        if room.alpha_min is not None:
            alpha = np.maximum(alpha, room.alpha_min)
        sources = dict(room.sources)
        rest = np.delete(room.centre_frequencies, learned)
        for i, j in [*pairs, *((i, None) for i in unknown)]:
            name = room.materials[i]
            held = sources.get(name, "the room's table")
            label = f"{held} times {1 + self.together:.2f}" if j is None else self._source(j)
            sources[name] = (
                f"{label}; {', '.join(bands.labels(rest))}: {held}" if rest.size else label
            )
        before = [] if room.calibration is None else [room.calibration.measured]
        record = CalibrationRecord(
            method=ARCHIVE,
            equation="that of each of its rooms",
            measured=" ".join([*before, *self.measured]),
            version=__version__,
        )
        return room.replace(
            alpha=alpha,
            sigma=sigma,
            sources=sources,
            common_alpha_sigma=self.room_sigma,
            calibration=record,
        )

    def left_as_stated(self, room: Room, names: Mapping[str, str] | None = None) -> tuple[str, ...]:
        """Return in sentences what `apply` takes from the room's own tables: materials, and bands.

        DataError if ``names`` has an unknown one.
        """
        pairs, columns = self._known(room, names)
        moved = self._unknown(room, pairs)
        left = [i for i in range(room.n_materials) if i not in {i for i, _ in pairs} | {*moved}]
        apart = [i for i in left if room.materials[i] in self.materials]
        rest = np.delete(room.centre_frequencies, [k for k, _ in columns])
        bands_left = [", ".join(bands.labels(rest))] if rest.size else []

        def quoted(rows: list[int]) -> list[str]:
            return [f'"{room.materials[i]}"' for i in rows]

        kept, lacks = "Left as the room states them, since the archive", "does not know them"
        factor = f"times {1 + self.together:.2f}, as all tables are off"
        reasons = (
            (f"The archive {lacks}, so the room's own tables count, {factor}", quoted(moved)),
            (f"{kept} {lacks}", quoted([i for i in left if i not in apart])),
            (f"{kept} has another material of that name, by its table", quoted(apart)),
            (f"{kept} {lacks}", bands_left),
        )
        return tuple(f"{why}: {', '.join(these)}." for why, these in reasons if these)

    def _unknown(self, room: Room, pairs: Sequence[tuple[int, int]]) -> list[int]:
        """The materials whose tables count as much as all tables do; none where they are no tables."""
        if room.calibration is not None:
            return []
        known = {i for i, _ in pairs}
        return [
            i
            for i, m in enumerate(room.materials)
            if i not in known and m not in self.materials and (room.sigma[i] > 0).any()
        ]

    def _known(
        self, room: Room, names: Mapping[str, str] | None
    ) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
        """The room's materials and bands that the archive knows: place in the room, in the archive."""
        mapped = checks.mapped("names", {} if names is None else names)
        for own, entry in mapped.items():
            if own not in room.materials or entry not in self.materials:
                raise DataError(
                    f'names: "{own}" = "{entry}": no material of the room, or none known'
                )
        columns = [
            (k, place)
            for k, f in enumerate(room.centre_frequencies)
            if (place := bands.index(self.centre_frequencies, float(f))) is not None
        ]
        own, entry = [k for k, _ in columns], [k for _, k in columns]
        pairs = []
        for i, m in enumerate(room.materials):
            if (called := mapped.get(m, m)) in self.materials:
                j = self.materials.index(called)
                tables = (room.alpha[i, own], room.sigma[i, own])
                known = (self.table[j, entry], self.table_sigma[j, entry])
                # A room that has a record states no table, but what data made of one.
                sure = m in mapped or room.calibration is not None or not columns
                if sure or is_one_material(*tables, *known):
                    pairs.append((i, j))
        return pairs, columns

    def _source(self, i: int) -> str:
        return f"archive of {len(self.lessons)} rooms, in {self.seen[i]} of them"

    @property
    def off(self) -> Array:
        """(alpha - table) / table, (n_materials, n_bands): how far each entry was off; NaN at 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.table > 0, self.alpha / self.table - 1, np.nan)

    def to_dict(self) -> dict[str, Any]:
        """Return the library, the rooms' lessons and the suspects as plain values."""
        return {
            "centre_frequencies": json_numbers(self.centre_frequencies),
            "materials": [
                {
                    "name": name,
                    "rooms": int(self.seen[i]),
                    "table": json_numbers(self.table[i]),
                    "alpha": json_numbers(self.alpha[i]),
                    "sigma": json_numbers(self.sigma[i]),
                    "mean_sigma": json_numbers(self.mean_sigma[i]),
                    "off": json_numbers(self.off[i]),
                }
                for i, name in enumerate(self.materials)
            ],
            "spread": asdict(self.spread),
            "together": self.together,
            "together_sigma": self.together_sigma,
            "room_sigma": self.room_sigma,
            "rooms": [asdict(lesson) for lesson in self.lessons],
            "suspects": [asdict(suspect) for suspect in self.suspects],
        }

    def __repr__(self) -> str:
        return f"<Archive of {len(self.lessons)} rooms, {len(self.materials)} materials>"

    def __str__(self) -> str:
        labels = bands.labels(self.centre_frequencies)
        shift = (self.alpha - self.table) / np.maximum(self.mean_sigma, 1e-12)
        rows = [
            (
                f"{name} ({self.seen[i]})",
                [
                    f"{a:.3f}{'*' if abs(z) >= _OFF else ' '}"
                    for a, z in zip(self.alpha[i], shift[i], strict=True)
                ],
            )
            for i, name in enumerate(self.materials)
        ]
        rooms = [
            (
                lesson.room,
                [
                    f"{100 * lesson.factor:+.0f} %",
                    f"{lesson.q:.1f}",
                    f"{lesson.p_value:.2g}",
                    f"{100 * lesson.taught:.0f} %",
                ],
            )
            for lesson in self.lessons
        ]
        spread = self.spread
        notes = [
            f"An entry is off by {spread.table:.2g} of its stated sigma, a material differs between "
            f"rooms by {spread.between:.2g} of it. Rooms differ by {100 * spread.room:.0f} %, the "
            f"equation by {100 * spread.equation:.0f} % per band (standard deviations). All tables "
            f"are off together by {100 * self.together:+.0f} ± {100 * self.together_sigma:.0f} %.",
            *(
                f'In room "{s.room}", "{s.material}" is likely '
                + (f'"{s.instead}"' if s.instead else "none of the archive's materials")
                + f" (p = {s.probability:.2f}): look, and correct its name or leave the room out."
                for s in self.suspects
            ),
        ]
        return "\n".join(
            [
                f"{len(self.lessons)} rooms, {len(self.materials)} materials",
                "",
                f"alpha (number of rooms; * off the table by {_OFF:g} standard deviations)",
                *text.table(rows, header=("", labels)),
                "",
                "what each room says beside all others",
                *text.table(rooms, header=("", ["factor", "Q", "p", "taught"])),
                "",
                *(line for note in notes for line in text.wrapped(note)),
            ]
        )
