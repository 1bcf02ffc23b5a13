"""Several effects at once, on the rooms of the first hidden world that lack two (tests/hidden_world).

    python -m benchmarks.several_effects controls --folder out --population 1   # can be resumed
    python -m benchmarks.several_effects bound --folder out --population 1      # what any test could do
    python -m benchmarks.several_effects run --folder out --population 1        # then: table
    python -m benchmarks.several_effects speed --folder out --population 0

Population 0 is for development. It has 12 rooms with two effects; as many as ``--more`` says are
built beside them, from the numbers that follow. Population 1 judges.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import norm

from benchmarks.hidden_effects import NAMES
from benchmarks.judging import first_of, kept_controls, one, rate
from benchmarks.second_world import place
from rtcal.discrepancy import AppliedEffect, Case
from rtcal.discrepancy.engines import ControlRooms
from rtcal.discrepancy.features import observe
from rtcal.discrepancy.hypotheses import predict_hypotheses
from rtcal.discrepancy.likelihood import alpha_covariance
from rtcal.discrepancy.model_error import ModelDiscrepancy, estimate_discrepancy
from tests.hidden_world.generate import read
from tests.hidden_world.populations import COUNTS, DOUBLE, build

LEVEL = 0.05
"""Of Neyman and Pearson's test: one effect taken for two."""
DATA = {"one": "T20, EDT, T30; one configuration", "all": "two configurations, C80, G as well"}
ORDER = (9, 7, 8, 1, 2, 3, 4, 5, 6, 10, 11, 12)
"""Kinds in the order in which they act on a model: formula, area and volume first."""
Room = tuple[int, Case, dict[str, Any], list[ControlRooms]]


def rooms(folder: str, population: int, more: int, *, double: bool) -> Iterator[Room]:
    """The rooms with two effects, or the others, whose control rooms stand."""
    cases, truths = read(population, "case"), read(population, "truth")
    order = np.random.default_rng(0).permutation(len(cases))
    for index in order:
        kept = place(folder, 1, population, "controls", int(index), "npz")
        if kept.exists() and (truths[index]["seed"][1] == DOUBLE) == double:
            case = Case.from_dict(cases[index])
            yield int(index), case, truths[index], kept_controls(case, kept)
    for index in range(more if double else 0):
        made = built(folder, population, COUNTS[population][DOUBLE] + index)
        case = Case.from_dict(made["case"])
        kept = place(folder, 1, population, "more", index, "npz")
        yield len(cases) + index, case, made["truth"], kept_controls(case, kept)


def built(folder: str, population: int, index: int) -> dict[str, Any]:
    """A room with two effects that is not stored with the tests, built once and kept."""
    path = place(folder, 1, population, "more", index, "json")
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(build(population, DOUBLE, index)), encoding="utf-8")
    made: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return made


def true_effects(case: Case, truth: dict[str, Any]) -> list[AppliedEffect]:
    """The hidden effects with their true sizes, as the library states them."""
    hidden = sorted(truth["effects"], key=lambda e: ORDER.index(e["kind"]))
    return [AppliedEffect(NAMES[e["kind"]], true_parameters(e)) for e in hidden]


def true_parameters(hidden: dict[str, Any]) -> dict[str, float]:
    """The library's parameters of one hidden effect."""
    kind = hidden["kind"]
    if kind == 1:
        return {k: hidden[k] for k in ("temperature", "humidity")}
    if kind == 2:
        return {"area": hidden["size"]}
    if kind == 3 and "persons" in hidden:
        return {"standing": 1.0, "absorption_area": 0.51 * hidden["persons"]}
    if kind == 3:
        return {"standing": 0.0, "absorption_area": 0.83 * hidden["size"]}
    if kind == 4:
        return {"absorption_area": hidden["size"]}
    if kind == 5:
        flow = 1000 * hidden["flow"]
        return {"thickness": hidden["depth"], "flow_resistivity": flow, "area": hidden["size"]}
    if kind == 6:
        return {"resonance": hidden["f0"], "quality": hidden["q"], "area": hidden["size"]}
    if kind == 7:
        return {"material": float(hidden["material"]), "ratio": hidden["ratio"]}
    if kind == 8:
        return {"ratio": hidden["ratio"]}
    if kind == 9:
        return {"equation": 1.0}
    if kind == 10:
        return {"aperture": hidden["size"], "volume": hidden["volume"], "alpha": hidden["alpha"]}
    if kind == 11:
        return {"scattering": hidden["scattering"]}
    return {"level": hidden["level"], "record": 2.0}


def distances_apart(
    case: Case, truth: dict[str, Any], discrepancy: ModelDiscrepancy
) -> tuple[float, float, float]:
    """How far the pair is from the nearest effect alone, in standard deviations, and its test.

    The first with the model's error, the second with a model that has none. The third is the log
    likelihood ratio of the measurement over that distance, less half of it: above the quantile of a
    normal density the test says "two".
    """
    observed, _ = observe(case)
    mask = observed.used.ravel()
    effects = true_effects(case, truth)
    both = predict_hypotheses(replace(case, applied=effects), [])
    own = alpha_covariance(both, 0)[np.ix_(mask, mask)] + observed.covariance
    whole = own + discrepancy.covariance[np.ix_(mask, mask)]
    out = []
    for effect in effects:
        alone = predict_hypotheses(replace(case, applied=[effect]), [])
        d = (both.features[0] - alone.features[0]).ravel()[mask]
        far, perfect = (float(np.sqrt(d @ np.linalg.solve(c, d))) for c in (whole, own))
        r = observed.values - alone.features[0].ravel()[mask] - discrepancy.bias[mask]
        out.append((far, perfect, float(d @ np.linalg.solve(whole, r)) / max(far, 1e-12)))
    return min(out)


def bound(folder: str, population: int, more: int) -> None:
    """Print how often a test that is told both effects and sizes could tell them from one."""
    limit = float(norm.ppf(1 - LEVEL))
    table: dict[str, list[tuple[float, float, float]]] = {data: [] for data in DATA}
    for _, case, truth, controls in rooms(folder, population, more, double=True):
        for data, (part, made) in cut(case, controls).items():
            table[data].append(distances_apart(part, truth, estimate_discrepancy(part, made)))
    print(f"Neyman and Pearson's test at {LEVEL:g}, told both effects and their sizes:")
    for data, rows in table.items():
        far, perfect, said = np.array(rows).T
        for label, d in (("with the model's error", far), ("with a model without error", perfect)):
            power = norm.cdf(d - limit)
            print(
                f"{DATA[data]:36} {label:27} tells {power.sum():.1f} of {len(d)} "
                f"({power.mean():.2f}); median distance {np.median(d):.1f} standard deviations"
            )
        print(f"{'':36} of what was measured it says two in {rate(said > limit)}")


def cut(case: Case, controls: list[ControlRooms]) -> dict[str, tuple[Case, list[ControlRooms]]]:
    """The case as `DATA` says, with its control rooms."""
    return {"one": (one(case), first_of(controls)), "all": (case, controls)}


if __name__ == "__main__":
    import sys

    bound(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
