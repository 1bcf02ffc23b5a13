"""The measured rooms of which something is left out on purpose, and which names are right.

Which rooms are for development and which for judging, and which names are right, was written here
before the finder was run on any of them. Never used, because they judge from outside: BRAS CR4, the
Elmia hall, the Arni room, the C4DM classroom, the Delft curtain room, DecayFitNet's examples.
`benchmarks.studies.means.real_rooms` runs them, and says where the data come from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.studies.means import real_data as data
from benchmarks.studies.means.judging import NOTHING
from rtcal.finder import Case, ChangedMaterial

ADDED = frozenset({"opening", "furniture", "audience", "porous", "curtain", "people"})
"""Absorption that is not low alone: families that say that the model lacks absorption."""
COEFFICIENTS = "coefficients"


@dataclass(frozen=True)
class RealCase:
    """A measured room with something left out of its model.

    ``names`` are the effects that are right as a single name; ``also`` are effects whose family is
    right as well. Where nothing is hidden, ``names`` has "none".
    """

    name: str
    part: str
    hidden: str
    names: frozenset[str]
    make: Callable[[], Case]
    also: frozenset[str] = frozenset()

    @property
    def control(self) -> bool:
        return NOTHING in self.names


def part_of(number: int) -> str:
    """Every second of a list is for development."""
    return "development" if number % 2 else "judging"


def case(room: Any, *configurations: Any) -> Case:
    return Case(room=room, configurations=list(configurations))


# PTB's studio: judging. Its coefficients are the round robin's table, so "coefficients" is right too.

OPEN, CLOSED = "curtain(open)", "curtain(closed)"
ALL = ("t30", "edt", "c80", "g")


def ptb(curtains: str, left_out: tuple[str, ...], air: Any = data.PTB_AIR, **options: Any) -> Case:
    return case(data.ptb_room(left_out, air), data.ptb_measured(curtains, **options))


def ptb_pair(parameters: tuple[str, ...], stated: bool) -> Case:
    """Open and closed; the model of both is open, or knows the change.

    Where it knows it, the curtain has its closed area, and open coefficients that absorb as much.
    """
    room, changes = data.ptb_room((OPEN if stated else CLOSED,)), {}
    if stated:
        i = room.material_index(CLOSED)
        changes = {CLOSED: ChangedMaterial(room.alpha[i], room.sigma[i])}
        area, gathered = data.ptb_materials()[OPEN]
        alpha, sigma = room.alpha.copy(), room.sigma.copy()
        alpha[i] = gathered * area / room.areas[i]
        sigma[i] = data.handbook_sigma(alpha[i])
        room = room.replace(alpha=alpha, sigma=sigma)
    of = {"parameters": parameters}
    return case(
        room,
        data.ptb_measured("open", name="open", suspect_removed=not stated, **of),
        data.ptb_measured("closed", name="closed", changes=changes, **of),
    )


def ptb_cases() -> Iterator[RealCase]:
    def judged(name: str, hidden: str, right: str, make: Any, *given: Any, **more: Any) -> RealCase:
        names = frozenset({right, COEFFICIENTS})
        return RealCase(f"PTB {name}", "judging", hidden, names, partial(make, *given, **more))

    each = {"": {}, ", C80 and G": {"parameters": ALL}, ", no uncertainty": {"uncertainty": False}}
    for state, out in (("open", CLOSED), ("closed", OPEN)):
        for words, options in each.items():
            name = f"{state}, as stated{words}"
            yield judged(name, "nothing", NOTHING, ptb, state, (out,), **options)
    for words, out in (("modelled open", (CLOSED,)), ("no curtain in the model", (OPEN, CLOSED))):
        for more, options in each.items():
            name = f"closed, {words}{more}"
            yield judged(name, "curtains drawn", "curtain", ptb, "closed", out, **options)
    for words in ("", ", C80 and G"):
        name, given = f"open, no curtain in the model{words}", ("open", (OPEN, CLOSED))
        yield judged(name, "gathered curtains", "curtain", ptb, *given, **each[words])
    for source in ("S1", "S2"):
        name, options = f"closed, modelled open, {source} alone", {"sources": (source,)}
        yield judged(name, "curtains drawn", "curtain", ptb, "closed", (CLOSED,), **options)
    for words, parameters in (("", ("t30", "edt")), (", C80 and G", ALL)):
        name, hidden = f"open and closed, both modelled open{words}", "curtains drawn in the second"
        yield judged(name, hidden, "curtain", ptb_pair, parameters, stated=False)
        name = f"open and closed, as stated{words}"
        yield judged(name, "nothing", NOTHING, ptb_pair, parameters, stated=True)
    given = "open", (CLOSED, "wilhelmi")
    yield judged("open, no wilhelmi", "39 m² of acoustic panel", "porous", ptb, *given)
    yield judged("open, no air", "air", "air", ptb, "open", (CLOSED,), None)


# dEchorate: two measurements of one model between which a panel was turned. Its coefficients are those
# that fit all states, so "coefficients" means the panel's. What turned is literally a material's area.

STEPS = (
    ("000000", "010000"), ("000000", "001000"), ("000000", "000100"), ("000000", "000010"),
    ("000000", "000001"), ("010000", "011000"), ("001000", "011000"), ("011000", "011100"),
    ("011100", "011110"), ("011110", "011111"),
)  # fmt: skip
MIRRORED = (("001000", "000010"), ("000100", "000001"))
"""States whose panels differ only in the wall on which they hang: one room to a diffuse field."""


def dechorate(stated: str, measured: str) -> Case:
    return case(
        data.dechorate_room(stated),
        data.dechorate_measured(stated, "before", True),
        data.dechorate_measured(measured, "after", False),
    )


def dechorate_cases() -> Iterator[RealCase]:
    def of(a: str, b: str, number: int, hidden: str, *names: str, also: Any = ()) -> RealCase:
        return RealCase(
            f"dEchorate {a} to {b}",
            part_of(number),
            hidden,
            frozenset(names),
            partial(dechorate, a, b),
            frozenset(also),
        )

    for n, (few, more) in enumerate(STEPS):
        yield of(few, more, n, "a panel reflects", "area", "covered surface", COEFFICIENTS)
        yield of(more, few, n, "a panel absorbs", "area", "porous", COEFFICIENTS, also=ADDED)
    for n, (first, second) in enumerate(MIRRORED):
        yield of(first, second, n, "nothing", NOTHING)
        yield of(second, first, n, "nothing", NOTHING)


# BRAS: CR2 for development, CR3 for judging. Initial coefficients are off: then they are right as well.

BRAS = {
    "nothing": ("nothing", NOTHING),
    "air": ("air", "air"),
    "volume too large": ("volume stated 25 % too large", "volume"),
    "volume too small": ("volume stated 20 % too small", "volume"),
    "area": ("largest material's area a third too small", "area"),
}
"""By what is left out its words and its name."""


def bras(name: str, coefficients: str, hidden: str) -> Case:
    room = data.bras_room(name, coefficients)
    if hidden == "air":
        room = room.with_air(None)
    elif hidden.startswith("volume"):
        room = room.replace(volume=(1.25 if hidden.endswith("large") else 0.8) * room.volume)
    elif hidden == "area":
        largest = np.arange(len(room.areas)) == np.argmax(room.areas)
        room = room.replace(areas=np.where(largest, room.areas * (2 / 3), room.areas))
    return case(room, data.bras_measured(name))


def bras_cases() -> Iterator[RealCase]:
    for name, part in (("CR2", "development"), ("CR3", "judging")):
        for coefficients, more in (("initial", {COEFFICIENTS}), ("fitted", set())):
            for key, (words, effect) in BRAS.items():
                yield RealCase(
                    f"{name}, {coefficients}: {key}",
                    part,
                    words,
                    frozenset({effect} | more),
                    partial(bras, name, coefficients, key),
                    # A third of a material left out is absorption that the model lacks.
                    ADDED if effect == "area" else frozenset(),
                )


def one_response(name: str, of: Callable[[], Any]) -> Case:
    """One response in a nominal box whose coefficients give its T: only the decay's shape speaks."""
    alone = data.decay_alone(of())
    return case(data.nominal_room(name, alone.measured.mean("t20")), alone)


def every_case() -> list[RealCase]:
    coupled = partial(one_response, "meeting room to hallway", data.coupled_response)
    single = partial(data.bras_measured, "CR3", ["LS1-MP1"])
    slope = partial(one_response, "one pair of CR3", single)
    second = frozenset({"coupled room"})
    return [
        *ptb_cases(),
        *dechorate_cases(),
        *bras_cases(),
        RealCase("pyFDN, coupled", "judging", "a coupled room", second, coupled),
        RealCase("pyFDN, single slope", "judging", "nothing", frozenset({NOTHING}), slope),
    ]
