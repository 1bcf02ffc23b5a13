"""The finder in rooms in which an effect is hidden: what it claims, and how often that is right.

    python -m benchmarks.studies.means.judged run --folder out  # an hour of one core; can be resumed
    python -m benchmarks.studies.means.judged store --folder out
    python -m benchmarks.studies.means.judged table  # of the stored rows, or --folder out
    python -m benchmarks.studies.means.judged report  # the table of README.md

The rooms are those of three worlds that share no code with rtcal's finder (`hidden_world`,
`second_world`, `third_world`), in one random order. A case is judged cut down to T20, EDT and T30 in
one configuration ("one"), and as it is stated ("all": C80 and G as well, and every second room in two
configurations). Where something can be added to the model, it is, and the error of the calibrated
coefficients is kept: as stated, calibrated without it, and with it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.studies import stored
from benchmarks.studies.means.judging import (
    FLAGS,
    NOTHING,
    UNKNOWN,
    Judged,
    first_of,
    kept_controls,
    one,
    print_confusion,
    print_rates,
    row_of,
)
from benchmarks.studies.rates import markdown, rate, share
from benchmarks.studies.stored import Row
from rtcal.finder import Case, verify
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.search import find

WORLDS = {1: "hidden_world", 2: "second_world", 3: "third_world"}
POPULATIONS = ((1, 1), (1, 3), (2, 1), (3, 1), (3, 2), (3, 3), (3, 13))
"""World and population of the rooms that judge."""
BOTH = (1, 2)
"""The worlds whose claims a finding states: the third has one kind of room for each effect."""
STORED = Path(__file__).with_name("judged.jsonl.gz")
DATA = {"one": "T20, EDT, T30; one configuration", "all": "the case as it is stated"}
KEPT = (
    "verdict", "effect", "family", "candidates", "score", "threshold", "excess", "probabilities",
    "families", "size", "rmse", "verification",
)  # fmt: skip
"""What is stored of a finding."""
NAMES = dict(
    enumerate(
        (
            "air", "opening", "audience", "furniture", "porous", "resonator", "area", "volume",
            "formula", "coupled room", "non-diffuse field", "noise floor", UNKNOWN,
        ), 1,
    )
)  # fmt: skip
"""Kinds of the first world as the finder names them; the last is in no library."""
EMPTY_KIND, TOGGLED = 0, {22: 2, 23: 3}
"""Of the first world: nothing is hidden; measured with and without the suspect."""
PERSONS = "persons"
"""What a hidden audience states that stands: it is `People` to the finder."""
SAID_AS = {"nothing": NOTHING, "material": "coefficients"}
"""How a finding names what the second and the third world hide by another name."""


@cache
def read(world: int, population: int, part: str) -> list[Row]:
    """The stored cases ("case") or truths ("truth") of a population, decompressed once."""
    return stored.read(WORLDS[world], population, part)


def name_of(hidden: Row) -> str:
    """The finder's name of an effect that is hidden in the first world."""
    return "people" if PERSONS in hidden else NAMES[hidden["kind"]]


def truth_of(world: int, truth: Row) -> tuple[frozenset[str], str] | None:
    """The right names and how the uncertainty is stated; None for what is not judged here.

    Left out of the first world: rooms with two effects, and those made to look like others.
    """
    if world > 1:
        name = SAID_AS.get(truth["kind"], truth["kind"])
        return frozenset({"people" if PERSONS in truth else name}), truth["statement"]
    kind = TOGGLED.get(truth["seed"][1], truth["seed"][1])
    if kind == EMPTY_KIND:
        return frozenset({NOTHING}), ""
    if kind not in NAMES:
        return None
    return frozenset({name_of(truth["effects"][0]) if truth["effects"] else NAMES[kind]}), ""


def jobs() -> list[tuple[int, int, int]]:
    """World, population and number of every room that judges, in one random order."""
    every = [
        (world, population, index)
        for world, population in POPULATIONS
        for index, truth in enumerate(read(world, population, "truth"))
        if truth_of(world, truth) is not None
    ]
    return [every[i] for i in np.random.default_rng(60).permutation(len(every))]


def rmse(alpha: Any, truth: Row) -> float:
    """Area-weighted root mean square error of alpha."""
    area = np.array(truth["areas"])[:, None]
    off = np.asarray(alpha) - np.array(truth["alpha"])
    return float(np.sqrt((area * off**2).sum() / area.sum() / off.shape[1]))


def searched(case: Case, controls: list[ControlRooms], truth: Row) -> Row:
    """The finding as plain values; where an effect can be added, what verifying it gives."""
    finding = find(case, controls=controls)
    row = row_of(finding)
    if finding.can_be_added:
        seen = verify(finding)
        row["verification"] = seen.verdict
        if {"alpha", "areas"} <= truth.keys():
            tables = (case.room.alpha, seen.uncorrected.alpha, seen.corrected.alpha)
            row["rmse"] = [rmse(alpha, truth) for alpha in tables]
    return row


def judge(world: int, population: int, index: int, controls: Path) -> Row:
    """Search one room with both sets of data; its control rooms are kept in a file."""
    case = Case.from_dict(read(world, population, "case")[index])
    truth = read(world, population, "truth")[index]
    made = kept_controls(case, controls)
    return {
        "world": world,
        "population": population,
        "index": index,
        "one": searched(one(case), first_of(made), truth),
        "all": searched(case, made, truth),
    }


def run(folder: Path) -> None:
    """Search every room that is not there yet."""
    warnings.simplefilter("ignore")
    named = {"_".join(map(str, job)): job for job in jobs()}
    stored.resume(
        folder / "rows.jsonl",
        {
            name: partial(judge, *job, folder / "controls" / f"{name}.npz")
            for name, job in named.items()
        },
    )


def rows_of(folder: Path | None = None) -> list[Row]:
    """The stored rows, or those of a run."""
    return stored.rows(STORED if folder is None else folder / "rows.jsonl")


def store(folder: Path) -> None:
    """Store the rows of a run."""
    stored.write(
        STORED,
        (
            {**row, **{data: {k: row[data][k] for k in KEPT if k in row[data]} for data in DATA}}
            for row in rows_of(folder)
        ),
    )


def judged(rows: Iterable[Row], data: str, worlds: Sequence[int] = tuple(WORLDS)) -> list[Judged]:
    """The judged rooms of some worlds, with one set of data."""
    out = []
    for row in rows:
        world = row["world"]
        known = truth_of(world, read(world, row["population"], "truth")[row["index"]])
        if world in worlds and known is not None:
            out.append(Judged(known[0], row[data], known[1]))
    return out


def table(rows: Sequence[Row]) -> None:
    """Print rates and confusion by world, then of both worlds together."""
    names = [*NAMES.values(), "coefficients", "curtain", "membrane"]
    names.insert(names.index("audience") + 1, "people")
    for worlds in ((1,), (2,), (3,), BOTH):
        for data, words in DATA.items():
            if rooms := judged(rows, data, worlds):
                print(
                    f"\n== world {' and '.join(map(str, worlds))}: {words}; {len(rooms)} rooms =="
                )
                print_rates(rooms)
                print_confusion(rooms, [NOTHING, *names])
                print_errors(rooms)


def print_errors(rooms: Sequence[Judged]) -> None:
    """Print the error of alpha where an effect was added to the model, and what verifying gave."""
    hidden = [r for r in rooms if not r.nothing and "rmse" in r.row]
    if hidden:
        stated, plain, corrected = np.array([r.row["rmse"] for r in hidden]).T
        print(
            f"alpha's RMSE, medians of {len(hidden)}: stated {np.median(stated):.4f}, calibrated "
            f"{np.median(plain):.4f}, with the effect {np.median(corrected):.4f}; "
            f"with / without {np.median(corrected / plain):.2f}"
        )
        print("  with the effect no worse than without", rate(corrected <= plain))
    for verdict in ("supported", "unproven", "withdrawn", "not tested"):
        of = [r for r in rooms if r.row.get("verification") == verdict]
        if of:
            print(
                f"  {verdict}: {len(of)}; the truth in what is named in",
                rate(r.truth_in_set for r in of),
            )


LINES: dict[str, Callable[[list[Judged]], Iterable[bool]]] = {
    "nothing hidden, flagged": lambda rooms: (r.flagged for r in rooms if r.nothing),
    "hidden, detected": lambda rooms: (r.flagged for r in rooms if r.hidden),
    "a single effect identified: right": lambda rooms: (r.truth_in_set for r in rooms if r.single),
    "a group identified: right": lambda rooms: (
        r.truth_in_set for r in rooms if r.row["verdict"] == "family"
    ),
    "candidates only: the truth among them": lambda rooms: (
        r.truth_in_set for r in rooms if r.row["verdict"] == "ambiguous"
    ),
    "in no library: an effect or group identified": lambda rooms: (
        r.row["verdict"] in FLAGS[:2] for r in rooms if UNKNOWN in r.truths
    ),
    "alpha with the effect no worse than without": lambda rooms: (
        r.row["rmse"][2] <= r.row["rmse"][1] for r in rooms if r.hidden and "rmse" in r.row
    ),
}
"""The lines of `report`: of each judged room that counts, whether it does."""


def report(rows: Sequence[Row]) -> str:
    """Return the table of README.md, in Markdown."""
    columns = [judged(rows, data, worlds) for worlds in ((1,), (2,), (3,)) for data in DATA]
    lines = [
        (label, *(in_words(list(hits(rooms))) for rooms in columns))
        for label, hits in LINES.items()
    ]
    worlds = ("first world: times", "second: times", "third: times")
    return markdown(["", *(word for world in worlds for word in (world, "all data"))], *lines)


def in_words(hits: Sequence[bool]) -> str:
    """A share as README.md has it: "3 of 40 [0.02, 0.20]"."""
    _, low, high, n = share(hits)
    return f"{sum(hits)} of {n} [{low:.2f}, {high:.2f}]" if n else "-"


def most_probable(room: Judged) -> str:
    """The most probable effect of a flagged room, "not detected" of another."""
    if not room.flagged:
        return "not detected"
    effects = {k: v for k, v in room.row["probabilities"].items() if k != NOTHING}
    return max(effects, key=effects.__getitem__)


if __name__ == "__main__":
    stored.commands(
        __doc__,
        run=run,
        store=store,
        table=lambda folder: table(rows_of(folder)),
        report=lambda folder: print(report(rows_of(folder))),
    )
