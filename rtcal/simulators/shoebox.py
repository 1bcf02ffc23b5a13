"""A `Room` as a shoebox with sources and receivers, and the base of shoebox simulators."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.decay import gradients
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import MATCH
from rtcal.acoustics.room import Room
from rtcal.simulators import observations
from rtcal.simulators.base import RoomSimulator, check_alpha
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.observations import Observations
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

Point = Sequence[float]


@dataclass(frozen=True, eq=False)
class Shoebox:
    """A shoebox with sources and receivers.

    Attributes
    ----------
    dimensions : array (3,)
        In m.
    walls : int array (6,)
        Row of alpha of each wall, in the order of `SHOEBOX_WALLS`.
    sources, receivers : array (n, 3)
        Positions in m.
    pairs : tuple of (source, receiver)
        Names, source by source.
    """

    dimensions: Array
    walls: NDArray[np.int64]
    sources: Array
    receivers: Array
    pairs: tuple[tuple[str, str], ...]

    def __post_init__(self) -> None:
        for values in (self.dimensions, self.walls, self.sources, self.receivers):
            values.setflags(write=False)
        for source in self.sources:
            if (self.receivers == source).all(axis=1).any():
                raise DataError("a source and a receiver are at the same place")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ShoeboxSimulator(RoomSimulator, ABC):
    """A deterministic simulator of shoeboxes, whose T is a smooth function of alpha.

    The parameters are described by `ScatteringDelayNetwork` and `ImageSource`.
    """

    room: Room
    sources: Mapping[str, Point]
    receivers: Mapping[str, Point]
    box: Shoebox = field(init=False)
    deterministic: ClassVar[bool] = True
    smooth: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "box", shoebox_of(self.room, self.sources, self.receivers))

    @property
    @abstractmethod
    def name(self) -> str:
        """Name that calibrated coefficients belong to."""

    @abstractmethod
    def decays(self, alpha: Array) -> tuple[Array, float]:
        """Return energy decays from the direct sound on, and the width of their bins in s.

        (n_pairs, n_bands, n_bins), in 1/m²: the direct sound of a source of unit energy is
        1 / (4 pi d²).
        """

    def observe(self, alpha: Array, match: Sequence[str] = MATCH, *, seed: int = 0) -> Observations:
        """Return what each position hears for alpha (n_materials, n_bands); the seed has no effect.

        The level is G of a source whose power is known. Raises as `simulate` does.
        """
        checks.whole("seed", seed, 0)
        match = observations.checked_parameters(match)
        energy, width = self.decays(check_alpha(self, alpha))
        return observations.of_decays(energy, width, match, self.box.pairs, self.centre_frequencies)

    def jacobian(
        self,
        alpha: Array,
        match: Sequence[str] = MATCH,
        *,
        seed: int = 0,
        by: Literal["material", "surface"] = "material",
    ) -> Array:
        """Return the derivatives of `observe`, (n_parameters, n_pairs, n_bands, n_unknowns).

        They are analytic. Coefficients above 0.999 count as 0.999.

        Parameters
        ----------
        alpha : array (n_materials, n_bands)
        match : sequence of str
        seed : int
            It has no effect.
        by : {"material", "surface"}
            Surfaces are the walls, in the order of `rtcal.simulators.geometry.SHOEBOX_WALLS`.

        Raises
        ------
        DataError, TooShortError
            As `observe` does, and for another ``by``.
        """
        alpha = np.minimum(check_alpha(self, alpha), observations.LARGEST_ALPHA)
        match = observations.checked_parameters(match)
        surface = observations.by_surface(by)
        energy, width = self.decays(alpha)
        observations.of_decays(energy, width, match, self.box.pairs, self.centre_frequencies)
        out = np.empty((len(match), *energy.shape[:2], len(self.box.walls)))
        for pair, of_walls in enumerate(self._wall_gradients(alpha, energy.shape[-1])):
            by_bin = gradients(energy[pair], width, match)
            out[:, pair] = np.einsum("pkb,wkb->pkw", by_bin, of_walls, optimize=True)
        if surface:
            return out
        belongs = self.box.walls[:, np.newaxis] == np.arange(self.room.n_materials)
        return np.asarray(out @ belongs)

    @abstractmethod
    def _wall_gradients(self, alpha: Array, n_bins: int) -> Iterator[Array]:
        """Yield the derivatives of each pair's decays by alpha of each wall, (6, n_bands, n_bins)."""

    @abstractmethod
    def simulate(self, alpha: Array, *, seed: int = 0) -> Measurement:
        """Return the simulated measurement for alpha (n_materials, n_bands)."""


def shoebox_of(room: Room, sources: Mapping[str, Point], receivers: Mapping[str, Point]) -> Shoebox:
    """Return the room as a shoebox.

    A room of several materials has one surface per wall, named as in `SHOEBOX_WALLS`. A room of a
    single material needs no surfaces.

    Raises
    ------
    DataError
        If the room states no dimensions, a wall has no surface, an area differs from the walls' by
        over 1 %, a position is outside, or a source and a receiver are at the same place.
    """
    checks.instance("room", room, Room)
    if room.dimensions is None:
        raise DataError(f'room "{room.name}" states no dimensions; a shoebox needs them')
    if room.n_materials == 1:
        materials = dict.fromkeys(SHOEBOX_WALLS, room.materials[0])
    else:
        material_of_surface = {s.name: s.material for s in room.surfaces}
        if missing := [wall for wall in SHOEBOX_WALLS if wall not in material_of_surface]:
            raise DataError(
                f'room "{room.name}" has no surface "{missing[0]}"; a shoebox of several materials '
                f"has one surface per wall: {', '.join(SHOEBOX_WALLS)}"
            )
        materials = {wall: material_of_surface[wall] for wall in SHOEBOX_WALLS}
    box = Polyhedron.shoebox(room.dimensions, materials)
    for material, area in zip(room.materials, room.areas, strict=True):
        if abs(box.areas.get(material, 0.0) - area) > 0.01 * area:
            raise DataError(
                f'areas["{material}"] = {area:.4g} m², but its walls in the box of '
                f"{' x '.join(f'{d:g}' for d in room.dimensions)} m have "
                f"{box.areas.get(material, 0.0):.4g} m²"
            )
    return Shoebox(
        dimensions=np.array(room.dimensions, dtype=float),
        walls=np.array([room.material_index(materials[wall]) for wall in SHOEBOX_WALLS]),
        sources=box.require_inside("source", sources),
        receivers=box.require_inside("receiver", receivers),
        pairs=tuple((s, r) for s in sources for r in receivers),
    )
