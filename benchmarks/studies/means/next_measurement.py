"""Whether the measurement that `plan` proposes tells what a model lacks.

    # then: table
    python -m benchmarks.studies.means.next_measurement run --folder out --population 1 --rooms 24

Each room begins with T20, EDT and T30 in one configuration. Five further measurements are possible:
C80, G, four more positions, the configuration in which a surface is covered, and one without all that
can be taken out. Each is made in the world that hides the effects, and the effects are sought again. So
the proposed one is compared with one chosen at random: the mean over all five. Costs are equal.
"""

from __future__ import annotations

import argparse
import json
import warnings
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from benchmarks.studies.hidden_world.populations import Hidden, make, measure
from benchmarks.studies.means.hidden_effects import name_of
from benchmarks.studies.means.judging import first_of, interval, one
from benchmarks.studies.means.second_world import place
from benchmarks.studies.means.several_effects import wide
from benchmarks.studies.means.several_effects_rooms import Room, judged_alone, rooms
from rtcal.finder import Case, library, plan
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.planning import COSTS
from rtcal.finder.means.problem import (
    MeansProblem,
    estimate_discrepancy,
    observe,
    predict_hypotheses,
)
from rtcal.finder.means.sets import MOST, compare, posterior_of_sets
from rtcal.finder.prior import prior_of
from rtcal.finder.search import find

BASE = ("t20", "edt", "t30")
KINDS = ("C80", "G", "more positions", "planned", "removed")
Measured = tuple[Case, list[ControlRooms]]


def said(case: Case, made: list[ControlRooms], truth: list[str]) -> dict[str, Any]:
    """Whether the most probable set is right, and the probability of the right families."""
    observed, _ = observe(case)
    predicted = predict_hypotheses(case, library())
    error, prior = estimate_discrepancy(case, made), prior_of(case.room, library(), {})
    posterior = posterior_of_sets(compare(MeansProblem(case, observed, predicted, error)), prior)
    best = posterior.best(predicted.effects)
    right = [s for s in posterior.sets if "unknown" not in s and wide(list(s)) == wide(truth)]
    return {
        "name": sorted(best) == sorted(truth),
        "family": wide(list(best)) == wide(truth),
        "probability": sum(posterior.sets[s] for s in right),
    }


def measured(hidden: Hidden, further: Hidden, seed: list[int], **entries: Any) -> dict[str, Any]:
    """A further configuration, as a user's file states it."""
    rng = np.random.default_rng([*seed, 7])
    values = measure(hidden, further.world, int(rng.integers(2**31)), rng)
    table = {k: np.where(np.isfinite(v), v, np.nan) for k, v in values.items()}
    plain = {
        k: [[None if np.isnan(x) else float(x) for x in row] for row in np.atleast_2d(v)]
        for k, v in table.items()
    }
    return {**entries, **plain, "distance": values["distance"].tolist()}


def without(hidden: Hidden) -> Hidden:
    """The room with its objects taken out and its openings closed."""
    world = replace(hidden.world, patch_wall=-1, patch_alpha=None, objects_area=0.0)
    return replace(hidden, world=replace(world, second_size=None, second_alpha=None))


def elsewhere(hidden: Hidden, seed: list[int]) -> Hidden:
    """The room with four other receivers."""
    rng = np.random.default_rng([*seed, 8])
    world, radius = hidden.world, 0.5 * (hidden.volume / 200) ** 0.25
    receivers: list[np.ndarray] = []
    while len(receivers) < 4:
        low, high = radius + 0.1, world.size - radius - 0.1
        r = np.clip(world.size * rng.uniform(0.12, 0.88, 3), low, high)
        if np.linalg.norm(r - world.source) > max(radius + 0.5, 0.25 * hidden.volume ** (1 / 3)):
            receivers.append(r)
    return replace(hidden, world=replace(world, receivers=np.array(receivers)))


def further(case: Case, made: list[ControlRooms], seed: list[int]) -> dict[str, Measured]:
    """The room after each of the further measurements, with its control rooms."""
    first = case.configurations[0].name
    out: dict[str, Measured] = {
        "C80": (case.only(*BASE, "c80", configurations=[first]), first_of(made)),
        "G": (case.only(*BASE, "g", configurations=[first]), first_of(made)),
        "planned": (case.only(*BASE), made),
    }
    hidden = make(seed[0], seed[1], seed[2])
    stated = case.to_dict()
    time_and_level = {"uncertainty": {"time": 0.02, "level": 0.3}}
    bare = measured(hidden, without(hidden), seed, name="bare", suspect_removed=True)
    both = {**stated, "configurations": [stated["configurations"][0], bare], **time_and_level}
    twice = [ControlRooms(c.engine, c.errors[:, [0, 0]]) for c in made]
    out["removed"] = (Case.from_dict(both).only(*BASE), twice)
    more = measured(hidden, elsewhere(hidden, seed), seed, name="more")
    added = Case.from_dict({**stated, "configurations": [more], **time_and_level})
    old, new = case.configurations[0].measured, added.configurations[0].measured
    joined = replace(
        old,
        values={p: np.concatenate([old.values[p], new.values[p]]) for p in BASE},
        uncertainty={p: np.concatenate([old.uncertainty[p], new.uncertainty[p]]) for p in BASE},
        pairs=[("S", f"R{i}") for i in range(len(old.pairs) + len(new.pairs))],
    )
    at = [c.configurations[0].distances for c in (case, added)]
    distances = np.concatenate([d for d in at if d is not None])
    again = replace(case.configurations[0], measured=joined, distances=distances)
    out["more positions"] = (replace(case, configurations=[again]), first_of(made))
    return out


def examined(room: Room) -> dict[str, Any]:
    """Return what is proposed in one room, and what each measurement shows."""
    _, case, truth, made = room
    names = [name_of(e) for e in truth["effects"]]
    base, controls = one(case), first_of(made)
    found = find(base, controls=controls, most=MOST)
    planned = case.configurations[1].measured
    second = replace(
        case.configurations[1],
        measured=replace(
            planned,
            values={p: planned.values[p] for p in BASE},
            uncertainty={p: planned.uncertainty[p] for p in BASE},
        ),
    )
    made_plan = plan(base, finding=found, planned=[second], costs=dict.fromkeys(COSTS, 1.0))
    nats = {p.kind: p.information for p in made_plan.proposals if p.kind in KINDS}
    return {
        "truth": names,
        "base": said(base, controls, names),
        "further": {
            kind: said(*after, names) for kind, after in further(case, made, truth["seed"]).items()
        },
        "nats": nats,
        "proposed": max(nats, key=lambda k: nats[k]),
    }


def chosen(folder: str, population: int, number: int) -> list[Room]:
    """As many rooms with one effect as with two, every one with a second configuration."""
    two = list(rooms(folder, population, 0, double=True))[: number // 2]
    others = [
        r
        for r in rooms(folder, population, 0, double=False)
        if judged_alone(r[2]) and r[2]["effects"] and r[2]["seed"][1] < 20
    ]
    return [*two, *others[: number - len(two)]]


def run(folder: str, population: int, number: int) -> None:
    """Measure and search; what was done is kept."""
    warnings.simplefilter("ignore")
    every = chosen(folder, population, number)
    for room in every[::2] + every[1::2]:
        path = place(folder, 1, population, "next", room[0], "json")
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(examined(room)), encoding="utf-8")
            print(f"\r{room[0]}   ", end="", flush=True)
    print()


def table(folder: str, population: int) -> None:
    """Print the share of right answers before, after a random and after the proposed measurement."""
    stored = sorted(place(folder, 1, population, "next", 0, "json").parent.glob("*.json"))
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in stored]
    rng = np.random.default_rng(0)
    print(f"{len(rows)} rooms of population {population}; 95 % intervals by bootstrap over rooms")
    for what in ("name", "family", "probability"):
        before = np.array([float(r["base"][what]) for r in rows])
        drawn = np.array([np.mean([float(f[what]) for f in r["further"].values()]) for r in rows])
        after = np.array([float(r["further"][r["proposed"]][what]) for r in rows])
        picked = rng.integers(len(rows), size=(4000, len(rows)))
        gains = np.stack([(drawn - before)[picked].mean(1), (after - before)[picked].mean(1)])
        ends = np.quantile(gains, [0.025, 0.975], axis=1)
        difference = np.quantile(gains[1] - 2 * gains[0], [0.025, 0.975])
        print(
            f"{what:12} before {before.mean():.3f}; random {drawn.mean() - before.mean():+.3f} "
            f"[{ends[0, 0]:+.3f}, {ends[1, 0]:+.3f}]; proposed {after.mean() - before.mean():+.3f} "
            f"[{ends[0, 1]:+.3f}, {ends[1, 1]:+.3f}]; proposed less twice random "
            f"[{difference[0]:+.3f}, {difference[1]:+.3f}]"
        )
    for kind in KINDS:
        gained = [float(r["further"][kind]["family"]) - float(r["base"]["family"]) for r in rows]
        nats = np.mean([r["nats"].get(kind, 0.0) for r in rows])
        number = sum(r["proposed"] == kind for r in rows)
        low, high = interval(number, len(rows))
        print(
            f"  {kind:15} proposed in {number} [{low:.2f}, {high:.2f}]; expected {nats:.2f} nats; "
            f"families right {np.mean(gained):+.3f}"
        )
    hours = {kind: COSTS[kind] for kind in KINDS}
    said = [cheapest(r, hours) for r in rows]
    print("nats per hour:", ", ".join(f"{k} in {said.count(k)}" for k in KINDS))
    for kind, factor in product(KINDS, (0.5, 2.0)):
        other = [cheapest(r, {**hours, kind: factor * hours[kind]}) for r in rows]
        same = sum(a == b for a, b in zip(said, other, strict=True))
        print(f"  {kind:15} {factor:g} times the hours: the same proposal in {same} of {len(rows)}")


def cheapest(row: dict[str, Any], hours: dict[str, float]) -> str:
    """The measurement with most nats per hour."""
    return max(row["nats"], key=lambda kind: row["nats"][kind] / hours[kind])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("--folder", required=True)
    parser.add_argument("--population", type=int, default=0)
    parser.add_argument("--rooms", type=int, default=24)
    given = parser.parse_args()
    if given.what == "run":
        run(given.folder, given.population, given.rooms)
    else:
        table(given.folder, given.population)


if __name__ == "__main__":
    main()
