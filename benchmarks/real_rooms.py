"""What the finder says of measured rooms, of which something was left out of the model on purpose.

    python -m benchmarks.real_rooms list --more folder
    python -m benchmarks.real_rooms run --more folder --out rows [--part judging]
    python -m benchmarks.real_rooms table --out rows
    python -m benchmarks.real_rooms bound --more folder --out rows   # what any finder could name

Which rooms are for development and which for judging, and which names are right, was written here
before the finder was run on any of them. Never used, because they judge from outside: BRAS CR4, the
Elmia hall, the Arni room, the C4DM classroom, the Delft curtain room, DecayFitNet's examples.

``folder`` has what is not beside the repository, and a case without its data is skipped:
`bras-cr2/measured.json` and `bras-cr3/measured.json` (of emmettl/RoomCAD, `Validation/`, derived from
BRAS, doi 10.14279/depositonce-6726.3; CC BY-SA 4.0), and `meetingroom_to_hallway_290cm.wav` (McKenzie,
Schlecht, Pulkki 2021, doi 10.5281/zenodo.4636068, CC BY 4.0; in the wheel of pyFDN 0.5.0).

A wrong claim is a member or family claimed (verdict "named" or "family") that is not right.
"""

from __future__ import annotations

import argparse
import json
import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import real_data as data
from benchmarks import told_test
from benchmarks.judging import FLAGS, NOTHING, Judged, families_of, kept_controls, rate, row_of
from rtcal.acoustics.room import Room
from rtcal.discrepancy import AppliedEffect, Case, Change, find

STORED = Path(__file__).parent / "real_rooms.json"
"""The rows of the run that the study shows: what the finder said, no measured value."""
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
            changes = {CLOSED: Change(room.alpha[i], room.sigma[i])}
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


def run(more: Path, out: Path, part: str | None) -> None:
    """Run the finder on every case whose data are there; control rooms are kept beside the rows."""
    warnings.simplefilter("ignore")
    for each in every_case():
        path = out / f"{each.file}.json"
        if path.exists() or part not in (None, each.part):
            continue
        try:
            made = each.make(more)
        except FileNotFoundError as error:
            print(f"skipped: {each.name}: no {Path(error.filename or str(error)).name}")
            continue
        controls = kept_controls(made, out / "controls" / f"{each.file}.npz")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(row_of(find(made, controls=controls))), encoding="utf-8")
        print(".", end="", flush=True)
    print()


def rows_of(out: Path | None) -> dict[str, dict[str, Any]]:
    """Rows by case: of a run, or those that are stored."""
    if out is None:
        stored: dict[str, dict[str, Any]] = json.loads(STORED.read_text(encoding="utf-8"))
        return stored
    paths = {c.name: out / f"{c.file}.json" for c in every_case()}
    return {k: json.loads(p.read_text(encoding="utf-8")) for k, p in paths.items() if p.exists()}


def outcome(each: RealCase, row: dict[str, Any]) -> str:
    """Return "right", "wrong" (a claim), or "missed" (nothing claimed, and the truth not in it).

    Several candidates are right where the truth is among them, or where all are of families that would
    have been right: a set is then at least as narrow as the family.
    """
    judged = Judged(each.names, row)
    accepted = families_of(each.names | each.also)
    if row["verdict"] == "named":
        return "right" if judged.right_name else "wrong"
    if row["verdict"] == "family":
        return "right" if row["family"] in accepted else "wrong"
    if row["verdict"] not in FLAGS:
        return "right" if each.control else "missed"
    narrow = bool(accepted) and all(families_of([c]) <= accepted for c in row["candidates"])
    return "right" if judged.truth_in_set or narrow else "missed"


def named(row: dict[str, Any]) -> bool:
    """Whether anything is named: an effect, a family, several candidates."""
    return row["verdict"] in ("named", "family", "ambiguous")


def claim(row: dict[str, Any]) -> str:
    """The claim in a few words, with the probability of what is claimed."""
    names = {
        "named": row["effect"],
        "family": row["family"],
        "ambiguous": " or ".join(row["candidates"][:4]),
        "hint": row["effect"],
    }
    said = names.get(row["verdict"])
    table = {**row["families"], **row["probabilities"]}
    p = row["families"].get(said) if row["verdict"] == "family" else table.get(row["effect"])
    if row["verdict"] == "none":
        p = row["probabilities"].get(NOTHING)
    return row["verdict"] + (f": {said}" if said else "") + ("" if p is None else f" ({p:.2f})")


def table(rows: dict[str, dict[str, Any]], part: str) -> dict[str, int]:
    """Print the cases one by one and the rates; return the counts."""
    here = [(c, rows[c.name]) for c in every_case() if c.part == part and c.name in rows]
    print(f"\n== {part}: {len(here)} cases ==")
    for each, row in here:
        size = "" if row["size"] is None else "  {:.3g} ({:.3g} to {:.3g})".format(*row["size"])
        print(
            f"{outcome(each, row):7} {each.name:50} hidden: {each.hidden:42} "
            f"{claim(row)}{size if row['verdict'] == 'named' else ''}"
        )
    results = [(c, outcome(c, r)) for c, r in here]
    claims = [o for (_, o), (_, r) in zip(results, here, strict=True) if r["verdict"] in FLAGS[:2]]
    print("wrong claims                ", rate(o == "wrong" for _, o in results))
    print("  on controls               ", rate(o == "wrong" for c, o in results if c.control))
    print("  of the claims made        ", rate(o == "wrong" for o in claims))
    print("truth in what is named      ", rate(o == "right" for _, o in results))
    print(
        "  where something is named  ",
        rate(o == "right" for (_, o), (_, r) in zip(results, here, strict=True) if named(r)),
    )
    print("  where something is hidden ", rate(o == "right" for c, o in results if not c.control))
    itself = [
        outcome(replace(c, names=c.names - {COEFFICIENTS}), r) == "right"
        for c, r in here
        if not c.control
    ]
    print("    and not as coefficients ", rate(itself))
    print("controls flagged            ", rate(r["verdict"] in FLAGS for c, r in here if c.control))
    for source in ("PTB", "dEchorate", "CR2", "CR3", "pyFDN"):
        of = [o for c, o in results if c.name.startswith(source)]
        if of:
            print(
                f"  {source:10} wrong {of.count('wrong')}, right {of.count('right')}, "
                f"missed {of.count('missed')} of {len(of)}"
            )
    return {
        "cases": len(results),
        "wrong": sum(o == "wrong" for _, o in results),
        "wrong on controls": sum(o == "wrong" for c, o in results if c.control),
        "right": sum(o == "right" for _, o in results),
    }


def truth_of(each: RealCase, made: Case, row: dict[str, Any]) -> list[Case]:
    """The case as its room was, per configuration: with the size that was found where none is known."""
    rooms = each.true_rooms()
    if rooms:
        return [case(room, *made.configurations) for room in rooms]
    (name,) = each.names
    return [replace(made, applied=(AppliedEffect(name, row["parameters"]),))]


def bound(more: Path, out: Path, part: str) -> None:
    """Print what a test that is told what was left out could name, and what find named."""
    rows, told = rows_of(out), []
    hidden = [c for c in every_case() if c.part == part and not c.control and c.name in rows]
    for each in hidden:
        made = each.make(more)
        controls = kept_controls(made, out / "controls" / f"{each.file}.npz")
        truth = truth_of(each, made, rows[each.name])
        told.append(told_test.told(made, truth, controls, each.names | each.also))
    print(f"\n== {part}: {len(hidden)} cases with something left out ==")
    said = [outcome(c, rows[c.name]) for c in hidden]
    told_test.show([c.name for c in hidden], told, said)
    others = sum(c.part == part and c.control and c.name in rows for c in every_case())
    told_test.shares(told, said.count("right"), others)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("list", "run", "table", "store", "bound"))
    parser.add_argument("--more", type=Path, default=Path("."), help="folder of further data")
    parser.add_argument("--out", type=Path, help="folder of the rows")
    parser.add_argument("--part", choices=("development", "judging"))
    given = parser.parse_args()
    if given.what == "list":
        for each in every_case():
            right = ", ".join(sorted(each.names))
            print(f"{each.part:12} {each.name:50} hidden: {each.hidden:42} right: {right}")
    elif given.what == "run":
        run(given.more, given.out, given.part)
    elif given.what == "store":
        STORED.write_text(json.dumps(rows_of(given.out), indent=0) + "\n", encoding="utf-8")
    else:
        for part in ("development", "judging") if given.part is None else (given.part,):
            if given.what == "bound":
                bound(given.more, given.out, part)
            else:
                table(rows_of(given.out), part)


if __name__ == "__main__":
    main()
