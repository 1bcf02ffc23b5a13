"""The measured rooms of which something is left out on purpose, and which names are right.

Which rooms are for development and which for judging, and which names are right, was written here
before the finder was run on any of them. Never used, because they judge from outside: BRAS CR4, the
Elmia hall, the Arni room, the C4DM classroom, the Delft curtain room, DecayFitNet's examples.
`benchmarks.studies.means.real_rooms` runs them, and says where the data come from.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies.means import real_data as data
from benchmarks.studies.means.judging import NOTHING
from rtcal.acoustics.room import Room
from rtcal.finder import Case, ChangedMaterial

ADDED = ("opening", "furniture", "audience", "porous", "curtain", "people")
"""Absorption that is not low alone: families that say that the model lacks absorption."""
COEFFICIENTS = "coefficients"


@dataclass(frozen=True)
class RealCase:
    """A measured room with something left out of its model.

    ``names`` are the effects that are right as a single name; ``also`` are effects whose family is
    right as well. Where nothing is hidden, ``names`` has "none". ``true_rooms`` makes the room as it
    was in each configuration, nothing left out; empty where it is not known.
    """

    name: str
    part: str
    hidden: str
    names: frozenset[str]
    make: Callable[[Path], Case]
    also: frozenset[str] = frozenset()
    true_rooms: Callable[[], list[Room]] = list

    @property
    def control(self) -> bool:
        return NOTHING in self.names

    @property
    def file(self) -> str:
        return re.sub(r"\W+", "_", self.name)


def case(room: Any, *configurations: Any) -> Case:
    return Case(room=room, configurations=list(configurations))


def set_of(*names: str) -> frozenset[str]:
    return frozenset(names)


# PTB's studio: judging. Its coefficients are the round robin's table, so "coefficients" is right too.

OPEN, CLOSED = "curtain(open)", "curtain(closed)"
ALL = ("t30", "edt", "c80", "g")
HANDBOOK = set_of(NOTHING, COEFFICIENTS)
CURTAIN = set_of("curtain", COEFFICIENTS)


def ptb(measured: str, left_out: tuple[str, ...], **options: Any) -> Callable[[Path], Case]:
    air = options.pop("air", data.PTB_AIR)

    def make(_: Path) -> Case:
        return case(data.ptb_room(left_out, air), data.ptb_measured(measured, **options))

    return make


def ptb_pair(parameters: tuple[str, ...], stated: bool) -> Callable[[Path], Case]:
    """Open and closed; the model of both is open, or knows the change.

    Where it knows it, the curtain has its closed area, and open coefficients that absorb as much.
    """

    def make(_: Path) -> Case:
        if not stated:
            room, changes = data.ptb_room((CLOSED,)), {}
        else:
            room = data.ptb_room((OPEN,))
            i = room.material_index(CLOSED)
            changes = {CLOSED: ChangedMaterial(room.alpha[i], room.sigma[i])}
            area, gathered = data.ptb_materials()[OPEN]
            alpha, sigma = room.alpha.copy(), room.sigma.copy()
            alpha[i] = gathered * area / room.areas[i]
            sigma[i] = data.handbook_sigma(alpha[i])
            room = room.replace(alpha=alpha, sigma=sigma)
        return case(
            room,
            data.ptb_measured("open", parameters=parameters, name="open", removed=not stated),
            data.ptb_measured("closed", parameters=parameters, name="closed", changes=changes),
        )

    return make


def ptb_cases() -> Iterator[RealCase]:
    def judged(name: str, hidden: str, names: frozenset[str], make: Any) -> RealCase:
        def rooms() -> list[Room]:
            closed, opened = data.ptb_room((OPEN,)), data.ptb_room((CLOSED,))
            if name.startswith("open and closed"):
                return [opened, closed]
            return [closed if name.startswith("closed") else opened]

        return RealCase(f"PTB {name}", "judging", hidden, names, make, true_rooms=rooms)

    for state, out in (("open", CLOSED), ("closed", OPEN)):
        nothing = (f"{state}, as stated", "nothing", HANDBOOK)
        yield judged(*nothing, ptb(state, (out,)))
        yield judged(
            f"{state}, as stated, C80 and G", *nothing[1:], ptb(state, (out,), parameters=ALL)
        )
        yield judged(
            f"{state}, as stated, no uncertainty",
            *nothing[1:],
            ptb(state, (out,), uncertainty=False),
        )
    for words, out in (("modelled open", (CLOSED,)), ("no curtain in the model", (OPEN, CLOSED))):
        hidden = ("curtains drawn", CURTAIN)
        yield judged(f"closed, {words}", *hidden, ptb("closed", out))
        yield judged(f"closed, {words}, C80 and G", *hidden, ptb("closed", out, parameters=ALL))
        yield judged(
            f"closed, {words}, no uncertainty", *hidden, ptb("closed", out, uncertainty=False)
        )
    hidden = ("gathered curtains", CURTAIN)
    yield judged("open, no curtain in the model", *hidden, ptb("open", (OPEN, CLOSED)))
    yield judged(
        "open, no curtain in the model, C80 and G",
        *hidden,
        ptb("open", (OPEN, CLOSED), parameters=ALL),
    )
    for source in ("S1", "S2"):
        yield judged(
            f"closed, modelled open, {source} alone",
            "curtains drawn",
            CURTAIN,
            ptb("closed", (CLOSED,), sources=(source,)),
        )
    for words, parameters in (("", ("t30", "edt")), (", C80 and G", ALL)):
        hidden = ("curtains drawn in the second", CURTAIN)
        yield judged(
            f"open and closed, both modelled open{words}", *hidden, ptb_pair(parameters, False)
        )
        nothing = ("nothing", HANDBOOK)
        yield judged(f"open and closed, as stated{words}", *nothing, ptb_pair(parameters, True))
    porous = set_of("porous", COEFFICIENTS)
    yield judged(
        "open, no wilhelmi", "39 m² of acoustic panel", porous, ptb("open", (CLOSED, "wilhelmi"))
    )
    air = set_of("air", COEFFICIENTS)
    yield judged("open, no air", "air", air, ptb("open", (CLOSED,), air=None))


# dEchorate: two measurements of one model between which a panel was turned. Its coefficients are those
# that fit all states, so "coefficients" means the panel's. What turned is literally a material's area.

STEPS = (
    ("000000", "010000"),
    ("000000", "001000"),
    ("000000", "000100"),
    ("000000", "000010"),
    ("000000", "000001"),
    ("010000", "011000"),
    ("001000", "011000"),
    ("011000", "011100"),
    ("011100", "011110"),
    ("011110", "011111"),
)
MIRRORED = (("001000", "000010"), ("000100", "000001"))
"""States whose panels differ only in the wall on which they hang: one room to a diffuse field."""


def dechorate(stated: str, measured: str) -> Callable[[Path], Case]:
    def make(_: Path) -> Case:
        return case(
            data.dechorate_room(stated),
            data.dechorate_measured(stated, "before", True),
            data.dechorate_measured(measured, "after", False),
        )

    return make


def dechorate_rooms(*states: str) -> Callable[[], list[Room]]:
    return lambda: [data.dechorate_room(state) for state in states]


def dechorate_cases() -> Iterator[RealCase]:
    for number, (few, more) in enumerate(STEPS):
        part = "judging" if number % 2 == 0 else "development"
        yield RealCase(
            f"dEchorate {few} to {more}",
            part,
            "a panel reflects",
            set_of("area", "covered surface", COEFFICIENTS),
            dechorate(few, more),
            true_rooms=dechorate_rooms(few, more),
        )
        yield RealCase(
            f"dEchorate {more} to {few}",
            part,
            "a panel absorbs",
            set_of("area", "porous", COEFFICIENTS),
            dechorate(more, few),
            frozenset(ADDED),
            dechorate_rooms(more, few),
        )
    for number, (first, second) in enumerate(MIRRORED):
        part = "judging" if number % 2 == 0 else "development"
        for a, b in ((first, second), (second, first)):
            yield RealCase(
                f"dEchorate {a} to {b}", part, "nothing", set_of(NOTHING), dechorate(a, b)
            )


# BRAS: CR2 for development, CR3 for judging. Initial coefficients are off: then they are right as well.


def bras(name: str, coefficients: str, hidden: str) -> Callable[[Path], Case]:
    def make(more: Path) -> Case:
        room = data.bras_room(name, coefficients)
        if hidden == "air":
            room = room.with_air(None)
        elif hidden.startswith("volume"):
            ratio = 1.25 if hidden.endswith("large") else 0.8
            room = room.replace(volume=ratio * room.volume)
        elif hidden == "area":
            areas = room.areas.copy()
            areas[int(np.argmax(areas))] *= 2 / 3
            room = room.replace(areas=areas)
        return case(room, data.bras_measured(name, more))

    return make


def bras_cases() -> Iterator[RealCase]:
    hidden = {
        "nothing": ("nothing", NOTHING),
        "air": ("air", "air"),
        "volume too large": ("volume stated 25 % too large", "volume"),
        "volume too small": ("volume stated 20 % too small", "volume"),
        "area": ("largest material's area a third too small", "area"),
    }
    for name, part in (("CR2", "development"), ("CR3", "judging")):
        for coefficients in ("initial", "fitted"):
            for key, (words, effect) in hidden.items():
                names = {effect} | ({COEFFICIENTS} if coefficients == "initial" else set())
                yield RealCase(
                    f"{name}, {coefficients}: {key}",
                    part,
                    words,
                    frozenset(names),
                    bras(name, coefficients, key),
                    # A third of a material left out is absorption that the model lacks.
                    frozenset(ADDED) if effect == "area" else frozenset(),
                    lambda name=name, c=coefficients: [data.bras_room(name, c)],
                )


# One response each, in a nominal box whose coefficients give its T: only the decay's shape speaks.


def coupled(more: Path) -> Case:
    measured = data.coupled_response(more)
    room = data.nominal_room("meeting room to hallway", measured.mean("t20"))
    kept = {p: measured.values[p] for p in ("t20", "edt", "t30")}
    alone = replace(measured, values=kept, uncertainty={})
    return case(room, data.Configuration(name="measured", measured=alone))


def single_slope(more: Path) -> Case:
    pair = data.bras_measured("CR3", more, ["LS1-MP1"])
    kept = {p: pair.measured.values[p] for p in ("t20", "edt", "t30")}
    room = data.nominal_room("one pair of CR3", pair.measured.mean("t20"))
    return case(room, replace(pair, measured=replace(pair.measured, values=kept)))


def every_case() -> list[RealCase]:
    return [
        *ptb_cases(),
        *dechorate_cases(),
        *bras_cases(),
        RealCase("pyFDN, coupled", "judging", "a coupled room", set_of("coupled room"), coupled),
        RealCase("pyFDN, single slope", "judging", "nothing", set_of(NOTHING), single_slope),
    ]
