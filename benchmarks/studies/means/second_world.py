"""The finder on the second hidden world (benchmarks/studies/second_world), and on the others beside it.

    # hours; can be resumed
    python -m benchmarks.studies.means.second_world controls --folder out --population 1
    # with what stands there
    python -m benchmarks.studies.means.second_world run --folder out --population 1
    python -m benchmarks.studies.means.second_world table --folder out --population 1
    python -m benchmarks.studies.means.second_world run --folder out --world 1 --population 1
    # misuka's rooms
    python -m benchmarks.studies.means.second_world run --folder out --world 3 --population 1
    # what any test detects
    python -m benchmarks.studies.means.second_world bound --folder out --population 1
    python -m benchmarks.studies.means.second_world both --folder out  # of all judging rows
    # is the threshold's rate right?
    python -m benchmarks.studies.means.second_world null --folder out --world 1

A case is judged as it is stated ("all": T20, EDT, T30, C80 and G, every second room in two
configurations) and cut down to T20, EDT and T30 in one configuration ("one"). Rows of the first world
that `hidden_effects run` made have the same keys, and `table` reads them as well. The third world
(studies/third_world) is another group's engine; another material counts as "coefficients".
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.studies.hidden_world import generate as first_world
from benchmarks.studies.hidden_world.populations import TOGGLED
from benchmarks.studies.means import known_effect_test
from benchmarks.studies.means.hidden_effects import NAMES, PERSONS, name_of, parameters_of
from benchmarks.studies.means.judging import (
    FLAGS,
    NOTHING,
    UNKNOWN,
    Judged,
    first_of,
    kept_controls,
    one,
    print_calibration,
    print_confusion,
    print_rates,
    rate,
    row_of,
)
from benchmarks.studies.second_world import generate as second_world
from benchmarks.studies.second_world.rooms import KINDS
from benchmarks.studies.third_world import generate as third_world
from rtcal.acoustics.room_errors import POWER
from rtcal.finder import AppliedEffect, Case, library
from rtcal.finder.means import problem as bootstrap
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import (
    QUANTILE,
    MeansProblem,
    evaluate,
    observe,
    predict_hypotheses,
)
from rtcal.finder.prior import NULL_POWER, prior_of
from rtcal.finder.search import find

WORLDS = {1: first_world, 2: second_world, 3: third_world}
SAID_AS = {"nothing": NOTHING, "material": "coefficients"}
"""How a finding says what the second and the third world hide by another name."""
JUDGING = ((1, 1), (1, 3), (2, 1))
"""World and population of the rooms that judge."""
SEEN = Path(__file__).parent / "judged_before.json"
DATA = {"one": "T20, EDT, T30; one configuration", "all": "the case as it is stated"}


def truth_of(world: int, truth: dict[str, Any]) -> tuple[frozenset[str], str] | None:
    """The right names and how the uncertainty is stated; None for what is not judged here.

    Left out of the first world: rooms with two effects, and those made to look like others.
    """
    if world > 1:
        name = SAID_AS.get(truth["kind"], truth["kind"])
        return frozenset({"people" if PERSONS in truth else name}), truth["statement"]
    kind = truth["seed"][1]
    kind = TOGGLED.get(kind, kind)
    if kind == 0:
        return frozenset({NOTHING}), ""
    if kind not in NAMES:
        return None
    return frozenset({name_of(truth["effects"][0]) if truth["effects"] else NAMES[kind]}), ""


def order(n: int, step: int) -> list[int]:
    """Room numbers in an order in which the kinds are mixed, every so many of them."""
    return [int(i) for i in np.random.default_rng(0).permutation(n)[::step]]


def place(folder: str, world: int, population: int, part: str, index: int, kind: str) -> Path:
    return Path(folder) / f"world{world}_pop{population}" / part / f"{index}.{kind}"


def controls(folder: str, world: int, population: int, step: int) -> None:
    """Simulate the control rooms; they do not depend on the finder."""
    rooms = WORLDS[world].read(population, "case")
    for n, index in enumerate(order(len(rooms), step), 1):
        path = place(folder, world, population, "controls", index, "npz")
        kept_controls(Case.from_dict(rooms[index]), path)
        print(f"\r{n}/{len(rooms)}", end="", flush=True)
    print()


def run(folder: str, world: int, population: int, step: int, label: str) -> None:
    """Run the finder on the rooms whose control rooms stand."""
    warnings.simplefilter("ignore")
    rooms, truths = (WORLDS[world].read(population, part) for part in ("case", "truth"))
    for n, index in enumerate(order(len(rooms), step), 1):
        kept = place(folder, world, population, "controls", index, "npz")
        path = place(folder, world, population, label, index, "json")
        if path.exists() or not kept.exists() or truth_of(world, truths[index]) is None:
            continue
        case, made = (
            Case.from_dict(rooms[index]),
            kept_controls(Case.from_dict(rooms[index]), kept),
        )
        row = {
            "one": row_of(find(one(case), controls=first_of(made))),
            "all": row_of(find(case, controls=made)),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(row), encoding="utf-8")
        print(f"\r{n}/{len(rooms)}", end="", flush=True)
    print()


def seen_before(world: int, population: int) -> frozenset[int]:
    """Numbers of the rooms on which earlier versions of this finder were judged."""
    stored = json.loads(SEEN.read_text(encoding="utf-8"))
    return frozenset(stored.get(f"world {world}, population {population}", ()))


def judged(
    folder: str, world: int, population: int, label: str, data: str
) -> Iterator[tuple[int, Judged]]:
    """The rooms that were run, with their numbers."""
    for index, truth in enumerate(WORLDS[world].read(population, "truth")):
        path = place(folder, world, population, label, index, "json")
        known = truth_of(world, truth)
        if path.exists() and known is not None:
            row = json.loads(path.read_text(encoding="utf-8"))
            if data in row:
                yield index, Judged(known[0], row[data], known[1])


def table(folder: str, world: int, population: int, label: str) -> None:
    names = list(NAMES.values()) if world == 1 else [k for k in KINDS if k != "nothing"]
    names.insert(names.index("audience") + 1, "people")
    seen = seen_before(world, population)
    for data, words in DATA.items():
        rooms = list(judged(folder, world, population, label, data))
        parts = {"": [r for _, r in rooms]}
        if seen:
            parts["judged before, "] = [r for i, r in rooms if i in seen]
            parts["fresh, "] = [r for i, r in rooms if i not in seen]
        for part, some in parts.items():
            print(
                f"\n== world {world}, population {population}: {part}{words}; {len(some)} rooms =="
            )
            print_rates(some)
            print_confusion(some, [NOTHING, *names])


def both(folder: str, label: str) -> None:
    """Print the calibration error of both worlds together, and how often each verdict was right.

    Of all judging rooms and of those that no version had seen before, and of each world's. Once every
    room counts alike, and once every world: more rooms of the first one were run.
    """
    for data, words in DATA.items():
        every = [
            (world, index not in seen_before(world, population), row)
            for world, population in JUDGING
            for index, row in judged(folder, world, population, label, data)
        ]
        parts = [(fresh, world) for fresh in (False, True) for world in (0, *WORLDS)]
        for only_fresh, only in parts:
            some = [
                (world, row)
                for world, fresh, row in every
                if fresh >= only_fresh and only in (0, world)
            ]
            rooms = [row for _, row in some]
            counts = Counter(world for world, _ in some)
            part = "fresh rooms" if only_fresh else "all rooms"
            print(f"\n== {part} of worlds {dict(counts)}: {words} ==")
            hidden = [r for r in rooms if not r.nothing and UNKNOWN not in r.truths]
            for verdict in FLAGS[:3]:
                for of, which in (("hidden", hidden), ("all rooms", rooms)):
                    named = [r for r in which if r.row["verdict"] == verdict]
                    print(f"{verdict:10} right, {of:9}", rate(r.truth_in_set for r in named))
            print("hidden, missed  ", rate(not r.flagged for r in hidden))
            print("nothing, flagged", rate(r.flagged for r in rooms if r.nothing))
            for what in ("probabilities", "families"):
                print_calibration(rooms, what)
                print("every world alike:")
                print_calibration(rooms, what, [1 / counts[world] for world, _ in some])


def true_effect(world: int, truth: dict[str, Any]) -> AppliedEffect:
    """The hidden effect with its true size, as the library states it."""
    if world == 1:
        (hidden,) = truth["effects"]
        return AppliedEffect(name_of(hidden), parameters_of(hidden))
    kind, size = "people" if PERSONS in truth else truth["kind"], truth.get("size")
    parameters = {
        "air": lambda: {k: truth[k] for k in ("temperature", "humidity")},
        "opening": lambda: {"area": size},
        "audience": lambda: {"absorption_area": 0.96 * size},
        "people": lambda: {"persons": float(truth[PERSONS])},
        "furniture": lambda: {"absorption_area": size},
        "porous": lambda: {
            "area": size,
            "thickness": truth["depth"],
            "flow_resistivity": 1e3 * truth["flow"],
        },
        "resonator": lambda: {
            "area": size,
            "resonance": truth["resonance"],
            "quality": 0.7 / truth["width"],
        },
        "curtain": lambda: {"area": size, "airspace": 0.17, "flow_resistance": 1.0},
        "membrane": lambda: {
            "area": size,
            "mass": 5.0,
            "airspace": (60 / truth["resonance"]) ** 2 / 5.0,
        },
        "area": lambda: {"material": float(truth["material"]), "ratio": truth["ratio"]},
        "volume": lambda: {"ratio": truth["ratio"]},
        "formula": lambda: {"equation": 1.0},
        # The second world states neither of the second room, the third one its volume: the middles of
        # what they are drawn from.
        "coupled room": lambda: {
            "aperture": size,
            "volume": truth["volume"] if world == 3 else 0.79 * truth["volume"],
            "alpha": 0.087,
        },
        "non-diffuse field": lambda: {"scattering": float(np.mean(truth["scattering"]))},
        "noise floor": lambda: {"level": truth["level"], "record": 2.0},
    }[kind]()
    return AppliedEffect(kind, parameters)


def bound(folder: str, world: int, population: int, step: int, label: str) -> None:
    """Print how many effects a test could detect at 5 % false alarms, and how many find did."""
    warnings.simplefilter("ignore")
    rooms, truths = (WORLDS[world].read(population, part) for part in ("case", "truth"))
    told: dict[str, list[known_effect_test.Told]] = {data: [] for data in DATA}
    said: dict[str, list[bool]] = {data: [] for data in DATA}
    for index in order(len(rooms), step):
        kept = place(folder, world, population, "controls", index, "npz")
        row = place(folder, world, population, label, index, "json")
        known = truth_of(world, truths[index])
        if not (kept.exists() and row.exists()) or known is None:
            continue
        if known[0] & {NOTHING, "unknown", "coefficients"}:
            continue
        whole, made = (
            Case.from_dict(rooms[index]),
            kept_controls(Case.from_dict(rooms[index]), kept),
        )
        rows, hidden = (
            json.loads(row.read_text(encoding="utf-8")),
            true_effect(world, truths[index]),
        )
        for data, case, errors in (("one", one(whole), first_of(made)), ("all", whole, made)):
            truth = [replace(case, applied=(hidden,))] * len(case.configurations)
            told[data].append(known_effect_test.told(case, truth, errors, known[0]))
            said[data].append(Judged(known[0], rows[data]).flagged)
    for data, words in DATA.items():
        print(f"\n== world {world}, population {population}: {words} ==")
        known_effect_test.detections(told[data], said[data])


COMMANDS = ("controls", "run", "table", "bound", "null", "both")
NULL_POWERS = (POWER, NULL_POWER)


def null(folder: str, world: int, population: int, step: int) -> None:
    """Print where rooms that lack nothing lie among the bootstrap's: 5 % should lie above 95 %.

    For powers with which the coefficients' errors in common fall in the bootstrap's rooms.
    """
    warnings.simplefilter("ignore")
    rooms, truths = (WORLDS[world].read(population, part) for part in ("case", "truth"))
    above: dict[tuple[str, float], list[float]] = {}
    limits: dict[tuple[str, float], list[float]] = {}
    for index in order(len(rooms), step):
        kept = place(folder, world, population, "controls", index, "npz")
        known = truth_of(world, truths[index])
        if not kept.exists() or known is None or NOTHING not in known[0]:
            continue
        whole = Case.from_dict(rooms[index])
        made = kept_controls(whole, kept)
        for data, case, errors in (("one", one(whole), first_of(made)), ("all", whole, made)):
            for power in NULL_POWERS:
                with patch.object(bootstrap, "NULL_POWER", power):
                    score, scores = scored(case, errors)
                above.setdefault((data, power), []).append(float(np.mean(scores >= score)))
                limits.setdefault((data, power), []).append(float(np.quantile(scores, QUANTILE)))
    for (data, power), shares in above.items():
        p, limit = np.array(shares), np.median(limits[data, power])
        parts = "  ".join(
            f"{level:.2f}: {np.mean(p < level):.2f}" for level in (0.05, 0.1, 0.2, 0.5)
        )
        print(
            f"world {world}, {data}, power {power:g}, {len(p)} rooms: {parts}; quantile {limit:.2f}"
        )


def scored(case: Case, controls: list[ControlRooms]) -> tuple[float, np.ndarray]:
    """The measurement's score, and those of the bootstrap's rooms."""
    observed, _ = observe(case)
    prior = prior_of(case.room, library(), {})
    predicted = predict_hypotheses(case, library())
    drawn = bootstrap.bootstrap_threshold(case, observed, predicted, controls, prior)
    evidence = evaluate(MeansProblem(case, observed, predicted, drawn.discrepancy), prior.off)
    return float(bootstrap.score(evidence, prior)), drawn.scores[:, -1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=COMMANDS)
    parser.add_argument("--folder", required=True)
    parser.add_argument("--world", type=int, choices=tuple(WORLDS), default=2)
    parser.add_argument("--population", type=int, default=0)
    parser.add_argument("--step", type=int, default=1, help="every so many rooms")
    parser.add_argument("--label", default="rows", help="folder of this run's rows")
    given = parser.parse_args()
    if given.what == "controls":
        controls(given.folder, given.world, given.population, given.step)
    elif given.what == "run":
        run(given.folder, given.world, given.population, given.step, given.label)
    elif given.what == "bound":
        bound(given.folder, given.world, given.population, given.step, given.label)
    elif given.what == "both":
        both(given.folder, given.label)
    elif given.what == "null":
        null(given.folder, given.world, given.population, given.step)
    else:
        table(given.folder, given.world, given.population, given.label)


if __name__ == "__main__":
    main()
