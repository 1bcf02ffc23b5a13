"""Does adding data ever cost? T20 alone, with EDT, T30, C80 and G, and with a second configuration.

    python -m benchmarks.studies.means.chain table  # of the stored rows
    python -m benchmarks.studies.means.chain weak  # what a weak verdict changes
    python -m benchmarks.studies.means.chain run --folder out --empty 16 --each 2  # can be resumed
    python -m benchmarks.studies.means.chain run --folder out --setting "full power" --empty 16 --each 2
    python -m benchmarks.studies.means.chain table --folder out --setting "full power"

Rooms of three worlds are built from their numbers, or read (`POPULATIONS`): so many that lack nothing,
and so many of each effect. Control rooms are kept beside them, so that another setting or version of
the finder reads the same rooms. A row is stored room by room. `table` prints what was flagged where
nothing is hidden, what was detected and claimed, and the same at equal false alarms: the threshold that
one in 20 of the rooms with nothing hidden passes. Last, how often each verdict was right.

The stored rows are of the present rule ("chosen"; `run` with `--empty 50 --each 3`, in the third world
24 and 5). All others are of earlier rooms: of this rule ("chosen, earlier"), and of the one before it
in the same rooms ("one score": all data decide); "one score, earlier" of that rule, the third world's
too; "with a floor" under the threshold; the one before it ("before"; of what it changes only); and a
likelihood that was not taken ("mean of normal densities", "beside it" the rule of that day). Each rule
was frozen before its rooms were read (docs/discrepancy_study.md).

Probabilities are judged as if nothing were missing in as many rooms as the prior says: in these
populations it is missing in about half of the rooms.
"""

from __future__ import annotations

import argparse
import gzip
import json
import time
import warnings
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.studies.hidden_world import populations as first_world
from benchmarks.studies.means.judging import (
    Judged,
    calibration_error,
    first_of,
    kept_controls,
    rate,
    row_of,
    stated_probabilities,
)
from benchmarks.studies.means.second_world import truth_of
from benchmarks.studies.second_world import rooms as second_world
from benchmarks.studies.third_world import generate as third_world_stored
from benchmarks.studies.third_world import rooms as third_world
from rtcal.finder import Case
from rtcal.finder import evidence as densities
from rtcal.finder.claim import too_weak
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.prior import NO_EFFECT
from rtcal.finder.search import find

POPULATIONS = {1: 21, 2: 19, 3: 13}
"""Populations that no finder had read on 2026-11-27; of the rows "chosen, earlier" 11, 9 and 3."""
LEVELS = "and C80, G"
CHAIN = {
    "T20": ("t20",),
    "and EDT": ("t20", "edt"),
    "and T30": ("t20", "edt", "t30"),
    LEVELS: ("t20", "edt", "t30", "c80", "g"),
}
SECOND = "and a second configuration"
SETTINGS: dict[str, dict[str, float]] = {
    "chosen": {"COARSENING": densities.COARSENING},
    "full power": {"COARSENING": np.inf},
    "full power, normal": {"COARSENING": np.inf, "DEGREES": np.inf},
}
"""Values of `rtcal.finder.evidence` that are tried."""
TRIED = (
    "chosen",
    "chosen, earlier",
    "one score",
    "one score, earlier",
    "with a floor",
    "before",
    "mean of normal densities",
    "beside it",
)
"""Of the rows that are stored."""
EARLIER_FLOOR = 0.5
"""Smallest threshold in nats with C80 or G, until 2026-11-24."""
STORED = Path(__file__).with_name("chain.json.gz")
Room = tuple[int, int, int]
"""World, kind and number."""


def kinds(world: int) -> list[int]:
    """Numbers of a world's kinds of effects."""
    if world == 1:
        return list(range(1, 13))
    every = third_world.KINDS if world == 3 else second_world.KINDS
    return [k for k, name in enumerate(every) if name not in ("nothing", "unknown")]


def rooms(empty: int, each: int, only: Collection[int]) -> Iterator[Room]:
    """Rooms of these worlds in turn, in an order in which the kinds are mixed."""
    rng, worlds = np.random.default_rng(39), []
    for world in sorted(only):
        some = [(world, 0, i) for i in range(empty)]
        some += [(world, k, i) for k in kinds(world) for i in range(each)]
        rng.shuffle(some)
        worlds.append(some)
    for place in range(max(map(len, worlds))):
        for some in worlds:
            if place < len(some):
                world, kind, index = some[place]
                yield int(world), int(kind), int(index)


def data_sets(
    case: Case, controls: list[ControlRooms]
) -> Iterator[tuple[str, Case, list[ControlRooms]]]:
    """The case with ever more data, and the control rooms that go with it."""
    first = case.configurations[0]
    for name, parameters in CHAIN.items():
        some = [p for p in parameters if p in first.measured.values]
        yield name, case.only(*some, configurations=[first.name]), first_of(controls)
    if len(case.configurations) > 1:
        yield SECOND, case, controls


def built(room: Room) -> dict[str, Any]:
    """Build a room from its numbers; the third world's are stored, since they need another engine."""
    world, kind, index = room
    population = POPULATIONS[world]
    if world < 3:
        of = first_world if world == 1 else second_world
        drawn: dict[str, Any] = of.build(population, kind, index)
        return drawn
    truths = third_world_stored.read(population, "truth")
    at = [t["seed"] for t in truths].index([population, kind, index])
    return {"case": third_world_stored.read(population, "case")[at], "truth": truths[at]}


def made(folder: Path, room: Room) -> tuple[dict[str, Any], Case, list[ControlRooms]]:
    """Build a room and its control rooms, or read them."""
    name = "_".join(map(str, room))
    kept = folder / f"{name}.case.json"
    if not kept.exists():
        kept.write_text(json.dumps(built(room)), encoding="utf-8")
    whole = json.loads(kept.read_text(encoding="utf-8"))
    case = Case.from_dict(whole["case"])
    return whole["truth"], case, kept_controls(case, folder / f"{name}.npz")


def run(folder: Path, setting: str, empty: int, each: int, only: Collection[int]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for room in rooms(empty, each, only):
        path = folder / f"{'_'.join(map(str, room))}.{setting.replace(' ', '_')}.json"
        if path.exists():
            continue
        truth, case, controls = made(folder, room)
        known = truth_of(room[0], truth)
        if known is None:
            continue
        row: dict[str, Any] = {"truth": sorted(known[0]), "statement": known[1]}
        with mock.patch.multiple(densities, **SETTINGS[setting]):
            for name, some, theirs in data_sets(case, controls):
                clock = time.process_time()
                row[name] = row_of(find(some, controls=theirs))
                row[name]["seconds"] = time.process_time() - clock
        path.write_text(json.dumps(row), encoding="utf-8")
        print(
            *room,
            {name: row[name]["verdict"] for name in row if name in (*CHAIN, SECOND)},
            flush=True,
        )


def rows_of(folder: Path | None, setting: str) -> dict[str, dict[str, Any]]:
    """Rows by room, "world_kind_number": of a run, or those that are stored."""
    if folder is None:
        stored: dict[str, dict[str, dict[str, Any]]] = json.loads(
            gzip.decompress(STORED.read_bytes())
        )
        return stored[setting]
    paths = sorted(folder.glob(f"*.{setting.replace(' ', '_')}.json"))
    return {p.name.split(".")[0]: json.loads(p.read_text(encoding="utf-8")) for p in paths}


def judged(every: Mapping[str, dict[str, Any]], world: int, *data: str) -> list[Judged]:
    """The rooms that were run with these data: the first of them that a room has."""
    out = []
    for room, row in every.items():
        which = next((name for name in data if name in row), None)
        if room.startswith(f"{world}_") and which is not None:
            out.append(Judged(frozenset(row["truth"]), row[which], row["statement"]))
    return out


def over(room: Judged) -> float:
    """Return by how many nats a threshold is exceeded; the score, of rules that had only one."""
    return float(room.row.get("excess", room.row["score"]))


def table(rows: Mapping[str, dict[str, Any]], setting: str) -> None:
    for world in POPULATIONS:
        for data in (*CHAIN, SECOND):
            every = judged(rows, world, data)
            empty, hidden = ([r for r in every if r.nothing is which] for which in (True, False))
            if not empty or not hidden:
                continue
            found = [r for r in hidden if r.flagged]
            claimed = [r for r in found if r.row["verdict"] in ("named", "family")]
            right = [r.right_name if r.single else r.right_family for r in claimed]
            limit = float(np.quantile([over(r) for r in empty], 0.95))
            print(f"\n== world {world}, {data}; setting: {setting} ==")
            print("nothing hidden, flagged    ", rate(r.flagged for r in empty))
            print("something hidden, detected ", rate(r.flagged for r in hidden))
            print("  at equal false alarms    ", rate(over(r) > limit for r in hidden))
            if data in (LEVELS, SECOND):
                for words, some in (("flagged", empty), ("detected", hidden)):
                    above = [r.flagged and r.row["score"] > EARLIER_FLOOR for r in some]
                    print(f"from {EARLIER_FLOOR} nats, {words:13}", rate(above))
            print("claimed, of the detected   ", rate(r in claimed for r in found))
            print("  and right                ", rate(right))
            rare = NO_EFFECT / (1 - NO_EFFECT) * len(hidden) / len(empty)
            weights = [rare if r.nothing else 1.0 for r in every]
            for what in ("probabilities", "families"):
                stated, hits = stated_probabilities(every, what)
                error = calibration_error(stated, hits, weights=np.array(weights))[0]
                means = (np.average(values, weights=weights) for values in (stated, hits))
                print(f"{what}: error {error:.3f}, stated, right", *(f"{m:.3f}" for m in means))
            seconds = [r.row["seconds"] for r in every if "seconds" in r.row]
            if seconds:
                print(f"seconds of processor, mean {np.mean(seconds):.2f}")


def steps(rows: Mapping[str, dict[str, Any]]) -> None:
    """Print what each step of the chain detects more and less, in the same rooms."""
    for world in POPULATIONS:
        for fewer, more in pairwise((*CHAIN, SECOND)):
            counts = Counter[tuple[bool, bool]]()
            for room, row in rows.items():
                if room.startswith(f"{world}_") and fewer in row and more in row:
                    kinds = (judged({room: row}, world, data)[0] for data in (fewer, more))
                    first, second = kinds
                    counts[first.flagged, second.flagged] += not first.nothing
            if counts.total():
                gained, lost = counts[False, True], counts[True, False]
                print(f"world {world}, {fewer} -> {more}: {gained} more, {lost} fewer, ", end="")
                print(f"of {counts.total()}")


PRESENT = ("chosen", "chosen, earlier")
"""Stored rows of the present threshold, from before `rtcal.finder.claim.too_weak`; no room twice."""


def weak() -> None:
    """Print flagged, detected and claimed rooms before and after weak findings became hints.

    The rule needs the probabilities alone, which the rows hold. Claims of a name or a family are not
    changed by it.
    """
    print("data: nothing hidden, flagged; hidden, detected; ambiguous sets with the truth")
    whole = (SECOND, *reversed(CHAIN))
    for name, data in {**{n: (n,) for n in CHAIN}, "as stated": whole}.items():
        rooms = [
            room
            for setting in PRESENT
            for world in POPULATIONS
            for room in judged(rows_of(None, setting), world, *data)
        ]
        said = []
        for rule in (False, True):
            flagged = [r for r in rooms if r.flagged and not (rule and _weak(r))]
            sets = [r.truth_in_set for r in flagged if r.row["verdict"] == "ambiguous"]
            empty = sum(r.nothing for r in flagged)
            of_empty = sum(r.nothing for r in rooms)
            said.append(
                f"{empty} of {of_empty} ({empty / of_empty:.3f}); {len(flagged) - empty} of "
                f"{len(rooms) - of_empty}; {sum(sets)} of {len(sets)}"
            )
        print(f"{name:24} before {said[0]:42} after {said[1]}")


def _weak(room: Judged) -> bool:
    unclaimed = room.row["verdict"] in ("ambiguous", "unknown")
    return unclaimed and bool(too_weak(room.row["probabilities"], room.row["families"]))


def record(rows: Mapping[str, dict[str, Any]]) -> None:
    """Print how often each verdict was right: T20, EDT and T30, and the case as it is stated."""
    times: list[Judged] = []
    whole: list[Judged] = []
    for world in POPULATIONS:
        times += judged(rows, world, "and T30")
        whole += judged(rows, world, *reversed((*CHAIN, SECOND)))
    for words, every in (("T20, EDT, T30", times), ("as stated", whole)):
        counts = {}
        for verdict in ("named", "family", "ambiguous"):
            said = [r for r in every if r.row["verdict"] == verdict]
            counts[verdict] = f"{len(said)}; {sum(r.truth_in_set for r in said)}"
        hidden, empty = ([r for r in every if r.nothing is which] for which in (False, True))
        counts["hidden; missed"] = f"{len(hidden)}; {sum(not r.flagged for r in hidden)}"
        counts["nothing; flagged"] = f"{len(empty)}; {sum(r.flagged for r in empty)}"
        print(words, counts)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("run", "table", "weak"))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--setting", default="", help=f"of a run: {', '.join(SETTINGS)}")
    parser.add_argument("--empty", type=int, default=16, help="rooms with nothing hidden")
    parser.add_argument("--each", type=int, default=2, help="rooms with each effect")
    parser.add_argument("--world", type=int, nargs="+", default=[*POPULATIONS], help="of a run")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.what == "weak":
        weak()
        return
    if given.what == "run":
        if given.folder is None:
            parser.error("--folder is needed")
        run(given.folder, given.setting or "chosen", given.empty, given.each, given.world)
        return
    both = TRIED if given.folder is None else ("chosen",)
    for setting in (given.setting,) if given.setting else both:
        rows = rows_of(given.folder, setting)
        table(rows, setting)
        steps(rows)
        record(rows)


if __name__ == "__main__":
    main()
