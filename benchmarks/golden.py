"""The verdicts of finders and calibrations of development rooms, stored to see what a change moves.

    python -m benchmarks.golden store               # about ten minutes of processor time
    python -m benchmarks.golden compare             # prints each figure that moved; exit code 1 then
    python -m benchmarks.golden compare --all       # every development room; hours
    python -m benchmarks.golden compare --only means

The rooms are those of the development populations of both worlds, the geometric and the position
rooms, the real rooms in which something is left out (those whose data are beside the repository), and
the calibrations of the rooms that ship. Figures are stored as they are, so that "moved" means another
bit. Nothing that judges is read. `store` replaces the figures of the rooms that it ran.
"""

from __future__ import annotations

import argparse
import gzip
import json
import multiprocessing
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks import second_world
from benchmarks.judging import one
from benchmarks.positions import MATCH
from benchmarks.real_cases import every_case
from rtcal.acoustics.equations import EQUATIONS
from rtcal.finder import Case, control_rooms, verify
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.set_posterior import MOST
from rtcal.finder.search import find
from tests.geometric_world import load as geometric
from tests.position_rooms import load as positions

STORED = Path(__file__).parent / "golden.json.gz"
PATHS = 2000
"""Of the geometric and the position rooms: their figures are compared with themselves alone."""
SHORT_MEANS = {1: 6, 2: 6}
"""Rooms of each world in the short form, every kind once as far as they go."""
SHORT_SEVERAL, SHORT_GEOMETRIC, SHORT_POSITIONS = 2, 2, 1


@dataclass(frozen=True)
class Task:
    """A room by name, and what makes its figures."""

    name: str
    figures: Callable[[], dict[str, Any]]


def plain(value: Any) -> Any:
    """Return a value as JSON keeps it, every bit of a number included; NaN is None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def of_finding(finding: Any, gaps: bool) -> dict[str, Any]:
    """The figures of a finding on means; with ``gaps`` those of its verification."""
    size = finding.size
    row = {
        "verdict": finding.verdict,
        "effect": finding.effect,
        "family": finding.family,
        "candidates": finding.names,
        "probabilities": finding.probabilities,
        "families": finding.families,
        "evidence": finding.evidence,
        "score": finding.score,
        "threshold": finding.threshold,
        "parameters": finding.best_parameters,
        "size": None if size is None else [size.mean, size.low, size.high],
        "residuals": finding.residuals,
    }
    if gaps and finding.can_be_added:
        seen = verify(finding)
        row |= {
            "verification": seen.verdict,
            "gaps": [[g.configuration, g.quantity, g.before, g.after] for g in seen.quantities],
            "alpha": seen.corrected.alpha,
            "plain alpha": seen.plain.alpha,
        }
    return row


def means(plain_case: Any) -> dict[str, Any]:
    """A room of a world: as it is stated, and cut down to one configuration."""
    case = Case.from_dict(plain_case)
    controls = control_rooms(case)
    first = [ControlRooms(c.engine, c.errors[:, :1]) for c in controls]
    return {
        "one": of_finding(find(one(case), controls=first), gaps=False),
        "all": of_finding(find(case, controls=controls), gaps=True),
    }


def several(plain_case: Any) -> dict[str, Any]:
    """A room of the first world, searched for several effects at once."""
    found = find(Case.from_dict(plain_case), most=MOST)
    return {
        "verdict": found.verdict,
        "named": found.named,
        "named families": found.named_families,
        "named set": found.named_set,
        "probabilities": found.probabilities,
        "families": found.families,
        "numbers": found.numbers,
        "sets": {" + ".join(names): p for names, p in found.sets.items()},
        "alpha": found.alpha,
    }


def on_pairs(index: int, statement: str, paths: int) -> dict[str, Any]:
    """A geometric room, searched at every position; what was found is verified on other pairs."""
    room = geometric.load(0, index, statement)
    case = rt.finder.positions.PositionsCase(
        simulator=room.simulator(n_paths=paths), measured=room.measured, match=MATCH
    )
    found = rt.finder.positions.find(case)
    row = {
        "verdict": found.verdict,
        "effect": found.effect,
        "family": found.family,
        "surface": found.surface,
        "surfaces": found.surfaces,
        "probabilities": found.probabilities,
        "families": found.families,
        "score": found.score,
        "threshold": found.threshold,
        "candidates": {
            f"{c.effect}, {c.place}": [c.probability, c.size, c.low, c.high, c.spectrum]
            for c in found.candidates[:20]
        },
        "map": found.map,
    }
    if found.can_be_added:
        seen = rt.finder.positions.verify(found)
        row |= {"verification": seen.verdict, "gain": seen.gain, "gaps": seen.gaps[-1]}
    return row


def at_positions(index: int, prior: str, paths: int) -> dict[str, Any]:
    """A position room, calibrated to every position."""
    case = positions.load(0, index, prior)
    result = rt.calibrate_positions(
        case.simulator(n_paths=paths), case.room, case.measured, match=MATCH
    )
    return {
        "alpha": result.alpha,
        "sigma": result.sigma,
        "gap before": result.gap_before,
        "gap after": result.gap_after,
        "scattering": result.tracer.scattering,
    }


def real(name: str, more: Path) -> dict[str, Any]:
    """A real room of which something is left out; {} where its data are not here."""
    (each,) = (c for c in every_case() if c.name == name)
    try:
        case = each.make(more)
    except FileNotFoundError:
        return {}
    return of_finding(find(case), gaps=True)


def calibrated(equation: str, method: str) -> dict[str, Any]:
    """The shipped real room, calibrated."""
    room, measured = rt.datasets.bras_cr2()
    result = rt.calibrate(room, measured, method=method, equation=EQUATIONS[equation]())
    return {
        "alpha": result.alpha,
        "gap before": result.gap_before,
        "gap after": result.gap_after,
        "sigma": result.posterior_sigma,
    }


def of_worlds(every: bool) -> list[Task]:
    """Rooms of both worlds: in the short form one of each kind, as many as are affordable."""
    tasks = []
    for world, number in SHORT_MEANS.items():
        cases, truths = (second_world.WORLDS[world].read(0, part) for part in ("case", "truth"))
        kinds: dict[str, int] = {}
        for i, truth in enumerate(truths):
            kinds.setdefault(str(truth["kind"] if world == 2 else truth["seed"][1]), i)
        rooms = range(len(cases)) if every else sorted(kinds.values())[:number]
        tasks += [Task(f"means: world {world}, room {i}", partial(means, cases[i])) for i in rooms]
        if world == 1:
            double = [i for i, truth in enumerate(truths) if len(truth["effects"]) == 2]
            chosen = double if every else double[:SHORT_SEVERAL]
            tasks += [
                Task(f"several: world 1, room {i}", partial(several, cases[i])) for i in chosen
            ]
    return tasks


def every_task(every: bool, more: Path) -> list[Task]:
    """All rooms with what makes their figures; those of development only."""
    paths = 3 * PATHS if every else PATHS
    rooms = list(geometric.stored(0, "rooms"))
    tasks = of_worlds(every)
    tasks += [
        Task(f"pairs: room {i}, {statement}", partial(on_pairs, i, statement, paths))
        for i in (rooms if every else rooms[:SHORT_GEOMETRIC])
        for statement in (
            (geometric.IN_SITU, geometric.HANDBOOK) if every else (geometric.IN_SITU,)
        )
    ]
    rooms = list(positions.stored(0, "rooms"))
    tasks += [
        Task(f"positions: room {i}, {prior}", partial(at_positions, i, prior, paths))
        for i in (rooms if every else rooms[:SHORT_POSITIONS])
        for prior in ("wide", "narrow")
    ]
    cases = [c for c in every_case() if c.part == "development"]
    tasks += [
        Task(f"real: {c.name}", partial(real, c.name, more))
        for c in (cases if every else cases[:: max(1, len(cases) // 4)])
    ]
    tasks += [
        Task(f"fit: {equation}, {method}", partial(calibrated, equation, method))
        for equation in ("eyring", "sabine")
        for method in ("mle", "soft")
    ]
    return tasks


def made(task: Task) -> tuple[str, dict[str, Any], float]:
    """Return a room's name, its figures and the processor time that they took, in s."""
    warnings.simplefilter("ignore")
    begin = time.process_time()
    figures = task.figures()
    # As they are read back, so that a fresh figure and a stored one are alike.
    return task.name, json.loads(json.dumps(plain(figures))), time.process_time() - begin


def run(tasks: list[Task], jobs: int) -> dict[str, dict[str, Any]]:
    """Return the figures of the rooms whose data are here, by name."""
    out, spent = {}, 0.0
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for n, (name, figures, seconds) in enumerate(pool.imap(made, tasks), 1):
            spent += seconds
            print(f"{n}/{len(tasks)}  {seconds:6.1f} s  {name}", file=sys.stderr, flush=True)
            if figures:
                out[name] = figures
    print(f"{spent:.0f} s of processor time", file=sys.stderr)
    return out


def read() -> dict[str, dict[str, Any]]:
    """Return the stored figures, by room."""
    if not STORED.exists():
        return {}
    with gzip.open(STORED, "rt", encoding="utf-8") as file:
        return dict(json.load(file))


def write(figures: Mapping[str, dict[str, Any]]) -> None:
    """Store figures; the file has no date, so that the same figures are the same bytes."""
    text = json.dumps(dict(sorted(figures.items())), separators=(",", ":"))
    STORED.write_bytes(gzip.compress(text.encode(), mtime=0))


def moved(before: Any, now: Any, place: str = "") -> list[str]:
    """Return a line for each figure that is not the same, with both values.

    Tables of numbers of one shape get one line: how many differ, and by how much at most.

    Examples
    --------
    >>> moved({"verdict": "none", "score": [1.0, 2.0]}, {"verdict": "hint", "score": [1.0, 2.5]})
    ['verdict: none -> hint', 'score: 1 of 2 numbers, by 0.5 at most']
    """
    if json.dumps(before) == json.dumps(now):
        return []
    if isinstance(before, dict) and isinstance(now, dict):
        lines = []
        for key in dict.fromkeys((*before, *now)):
            at = f"{place}, {key}" if place else key
            lines += moved(before.get(key), now.get(key), at)
        # Mappings run from the most probable; another order of the same numbers is a change.
        return lines or [f"{place}: another order"]
    old, new = _numbers(before), _numbers(now)
    if old is not None and new is not None and old.shape == new.shape and old.size > 1:
        unlike = ~((old == new) | (np.isnan(old) & np.isnan(new)))
        with np.errstate(invalid="ignore"):
            most = np.nanmax(np.abs(new - old)[unlike], initial=0.0)
        return [f"{place}: {unlike.sum()} of {old.size} numbers, by {most:.2g} at most"]
    return [f"{place}: {before} -> {now}"]


def _numbers(value: Any) -> np.ndarray | None:
    """Return a value as an array of numbers, None where it is none."""
    try:
        return np.array(value, dtype=float) if isinstance(value, list) else None
    except (TypeError, ValueError):
        return None


def compare(stored: Mapping[str, Any], now: Mapping[str, Any]) -> int:
    """Print what moved in the rooms that both have; return the number of rooms with a change."""
    changed = 0
    for name, figures in now.items():
        lines = ["not stored"] if name not in stored else moved(stored[name], figures)
        changed += bool(lines)
        for line in lines:
            print(f"{name}: {line}")
    print(f"{changed} of {len(now)} rooms changed")
    return changed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("store", "compare"))
    parser.add_argument("--all", action="store_true", help="every development room; hours")
    parser.add_argument("--only", default="", help="rooms whose names begin so")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--more", type=Path, default=Path("."), help="folder of further real data")
    given = parser.parse_args()
    tasks = [t for t in every_task(given.all, given.more) if t.name.startswith(given.only)]
    now = run(tasks, given.jobs)
    if given.what == "store":
        write({**read(), **now})
    elif compare(read(), now):
        sys.exit(1)


if __name__ == "__main__":
    main()
