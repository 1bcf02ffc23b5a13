"""States of one room: what they have in common, and T with the areas that it had then."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rtcal.acoustics import bands, fingerprints
from rtcal.acoustics.room import Room
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.types import Array


@checked
@dataclass(frozen=True, eq=False)
class State:
    """A state of a room in which T was measured.

    Parameters
    ----------
    room : Room
        With the prior's alpha and sigma, not calibrated ones.
    reverberation_time : array (n_bands,)
        Measured T in s, NaN where missing.
    uncertainty : array (n_bands,)
        Standard uncertainty of T in s, NaN where unknown.

    Raises
    ------
    DataError
        For another shape, a T that is not above 0, or an uncertainty below 0.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["all"], areas=[94], alpha=[[0.1]],
    ...             sigma=[[0.02]], centre_frequencies=[1000])
    >>> State(room, [1.02]).uncertainty
    array([nan])
    """

    room: Room
    reverberation_time: Array
    uncertainty: Array = field(default_factory=lambda: np.array(np.nan))

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        shape = (self.room.n_bands,)
        t = checks.array("reverberation_time", self.reverberation_time)
        u = checks.array("uncertainty", self.uncertainty)
        u = np.full(shape, np.nan) if np.isnan(u).all() and u.ndim == 0 else u
        for name, values in (("reverberation_time", t), ("uncertainty", u)):
            if values.shape != shape:
                raise DataError(f"{name} has shape {values.shape}; the room asks for {shape}")
            bad = np.isinf(values) | (values < 0)
            if values is t:
                bad |= values == 0
            if bad.any():
                k = int(np.argmax(bad))
                band = bands.label(self.room.centre_frequencies[k])
                raise DataError(f"{name}[{band}] = {values[k]:g} s is not finite and above 0")
            object.__setattr__(self, name, values)

    def log_uncertainty(self, unstated: float) -> Array:
        """Return the standard uncertainty of ln T, (n_bands,); ``unstated`` where u is unknown."""
        u = self.uncertainty / self.reverberation_time
        return np.asarray(np.where(np.isnan(u), unstated, u))


def refuse_counted_twice(rooms: Sequence[Room], states: Sequence[State]) -> None:
    """Raise DataError if a room was calibrated on a state's T, or two states are one."""
    known = [s for s in states if np.isfinite(s.reverberation_time).any()]
    names = [fingerprints.of_times(s.room, s.reverberation_time) for s in known]
    for room in rooms:
        fingerprints.refuse_repeated_data(room, *names)
    for i, j in itertools.combinations(range(len(known)), 2):
        one, other = known[i].room, known[j].room
        same_room = one.volume == other.volume and (
            dict(zip(one.materials, one.areas.tolist(), strict=True))
            == dict(zip(other.materials, other.areas.tolist(), strict=True))
        )
        if same_room and fingerprints.same_data(names[i], names[j]):
            raise DataError(
                f'room "{one.name}": two states have the same areas and the same measured T, which '
                "would count twice; leave one out"
            )


def refuse_other_priors(rooms: Sequence[Room], places: Sequence[str]) -> None:
    """Raise DataError if states of one room differ in bands, or in a material's alpha or sigma.

    ``places`` name the rooms in messages: ``room "box"``.
    """
    for place, room in zip(places, rooms, strict=True):
        if not np.array_equal(room.centre_frequencies, rooms[0].centre_frequencies):
            raise DataError(f"{place} has other bands than {places[0]}")
        for i, material in enumerate(room.materials):
            owner = next(n for n, r in enumerate(rooms) if material in r.materials)
            j = rooms[owner].materials.index(material)
            for name in ("alpha", "sigma"):
                values, first = getattr(room, name)[i], getattr(rooms[owner], name)[j]
                if not np.array_equal(values, first):
                    k = int(np.flatnonzero(values != first)[0])
                    raise DataError(
                        f"{place}: {room.place(name, i, k)} = {values[k]:g}, but {places[owner]} says "
                        f"{first[k]:g}; a shared material has one prior"
                    )
