"""What each part of the finder does: development rooms again, with one part taken away at a time.

    python -m benchmarks.ablation run --folder out --real rows --more folder [--only NAME]
    python -m benchmarks.ablation table --folder out --real rows

The rooms are the first ones, in a mixed order, of population 0 of both hidden worlds whose control
rooms stand in ``folder`` (`benchmarks/second_world.py`), and the real cases for development, whose
control rooms stand in ``rows`` (`benchmarks/real_rooms.py`).
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks import real_cases, real_rooms
from benchmarks.judging import (
    FLAGS,
    NOTHING,
    Judged,
    calibration_error,
    first_of,
    kept_controls,
    one,
    row_of,
    stated_probabilities,
)
from benchmarks.second_world import WORLDS, order, place, truth_of
from rtcal.finder import Case, find, library
from rtcal.finder.effects import Effect
from rtcal.finder.effects.air import OmittedAir
from rtcal.finder.means import hypotheses as hypotheses_module
from rtcal.finder.means import likelihood, search

NEW = ("curtain", "membrane", "covered surface", "people")


def same(case: Case) -> Case:
    return case


def three_percent(case: Case) -> Case:
    """3 % and 0.5 dB for what states no uncertainty, as the finder had it before."""
    stated = {"time": 0.03, "level": 0.5}
    return replace(case, configurations=[c.with_uncertainty(stated) for c in case.configurations])


def measured_climate(case: Case) -> Case:
    """A stated climate is exact, as the finder had it before."""
    return replace(case, climate_uncertainty=(0.0, 0.0))


def even_weights(effect: Effect, grid: Any, state: Any) -> Any:
    return np.full(len(grid), 1 / len(grid))


def even(*_: Any) -> float:
    return 1.0


def no_doubts(*_: Any) -> tuple[str, ...]:
    return ()


@dataclass(frozen=True)
class Part:
    """A part of the finder, and how to take it away."""

    patches: tuple[tuple[Any, str, Any], ...] = ()
    case: Callable[[Case], Case] = same
    options: dict[str, Any] = field(default_factory=dict)
    single_names_only: bool = False

    @contextmanager
    def away(self) -> Iterator[None]:
        with ExitStack() as stack:
            for place_, name, value in self.patches:
                stack.enter_context(patch.object(place_, name, value))
            yield


PARTS = {
    "the whole finder": Part(),
    "1 no coefficients that are off together": Part(options={"without": ("coefficients",)}),
    "2 unstated uncertainty is 3 % and 0.5 dB": Part(case=three_percent),
    "3 grid points and effects count alike": Part(
        (
            (hypotheses_module, "grid_weights", even_weights),
            (Effect, "prior_odds", even),
            (OmittedAir, "prior_odds", even),
        )
    ),
    "4a no family is claimed": Part(single_names_only=True),
    "4b no curtain, membrane, covered surface, people": Part(
        options={"effects": [e for e in library() if e.name not in NEW]}
    ),
    "5 no check of a claim": Part(((search, "doubts", no_doubts),)),
    "6 any climate, and a stated one exact": Part(
        ((OmittedAir, "density", even), (OmittedAir, "prior_odds", even)), measured_climate
    ),
    "normal densities instead of Student's t": Part(((likelihood, "DEGREES", np.inf),)),
    "likelihood at full power": Part(((likelihood, "COARSENING", np.inf),)),
}
"""By what is taken away. The seventh change, one size of an effect everywhere, changes no name."""


def rooms(folder: str, number: int) -> Iterator[tuple[str, frozenset[str], str, Case, Any]]:
    for world, data in ((1, "one"), (2, "all")):
        cases, truths = (WORLDS[world].read(0, part) for part in ("case", "truth"))
        count = 0
        for index in order(len(cases), 1):
            path = place(folder, world, 0, "controls", index, "npz")
            known = truth_of(world, truths[index])
            if count == number or not path.exists() or known is None:
                continue
            count += 1
            case = Case.from_dict(cases[index])
            controls = kept_controls(case, path)
            if data == "one":
                case, controls = one(case), first_of(controls)
            yield f"world {world}", known[0], str(index), case, controls


def run(folder: str, real: Path, more: Path, number: int, only: str | None) -> None:
    warnings.simplefilter("ignore")
    for name, part in PARTS.items():
        if only is not None and only not in name:
            continue
        path = Path(folder) / "ablation" / f"{name.split()[0]}.json"
        if path.exists() or part.single_names_only:
            continue
        out: list[dict[str, Any]] = []
        with part.away():
            for world, truths, index, case, controls in rooms(folder, number):
                said = row_of(find(part.case(case), controls=controls, **part.options))
                out.append({"set": world, "truths": sorted(truths), "room": index, "row": said})
            for each in real_cases.every_case():
                kept = real / "controls" / f"{each.file}.npz"
                if each.part != "development" or not kept.exists():
                    continue
                made = part.case(each.make(more))
                said = row_of(find(made, controls=kept_controls(made, kept), **part.options))
                out.append(
                    {"set": "real", "truths": sorted(each.names), "room": each.name, "row": said}
                )
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(out), encoding="utf-8")
        print(name, flush=True)


def table(folder: str) -> None:
    """Print per part: flagged controls, detected, single claims right, truth in the set, ECE; real."""
    cases = {c.name: c for c in real_cases.every_case()}
    for name, part in PARTS.items():
        source = "the whole finder" if part.single_names_only else name
        path = Path(folder) / "ablation" / f"{source.split()[0]}.json"
        if not path.exists():
            continue
        entries = json.loads(path.read_text(encoding="utf-8"))
        for e in entries:
            if part.single_names_only and e["row"]["verdict"] == "family":
                e["row"]["verdict"] = "ambiguous"
        print(f"\n{name}")
        for world in ("world 1", "world 2"):
            judged = [
                Judged(frozenset(e["truths"]), e["row"]) for e in entries if e["set"] == world
            ]
            hidden = [r for r in judged if not r.nothing]
            error, _ = calibration_error(*stated_probabilities(judged, "probabilities"))
            print(
                f"  {world}: controls flagged {share(r.flagged for r in judged if r.nothing)}, "
                f"detected {share(r.flagged for r in hidden)}, "
                f"single names right {share(r.right_name for r in judged if r.single)}, truth in the "
                f"set {share(r.truth_in_set for r in hidden if r.flagged)}, "
                f"calibration error {error:.2f}"
            )
        real = [(cases[e["room"]], e["row"]) for e in entries if e["set"] == "real"]
        outcomes = [real_rooms.outcome(c, r) for c, r in real]
        claims = sum(r["verdict"] in FLAGS[:2] for _, r in real)
        print(
            f"  real: wrong claims {outcomes.count('wrong')} of {claims} claims, right "
            f"{outcomes.count('right')} of {len(outcomes)}, controls flagged "
            f"{share(r['verdict'] in FLAGS for c, r in real if NOTHING in c.names)}"
        )


def share(hits: Any) -> str:
    whole = list(hits)
    return f"{sum(whole)}/{len(whole)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("--folder", required=True)
    parser.add_argument("--real", type=Path, default=Path("."))
    parser.add_argument("--more", type=Path, default=Path("."), help="further data of real rooms")
    parser.add_argument("--rooms", type=int, default=24, help="of each hidden world")
    parser.add_argument("--only", help="parts whose name has this")
    given = parser.parse_args()
    if given.what == "run":
        run(given.folder, given.real, given.more, given.rooms, given.only)
    else:
        table(given.folder)


if __name__ == "__main__":
    main()
