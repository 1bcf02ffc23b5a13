"""Numbers of the finder that decide, on the rooms of the first hidden world (tests/hidden_world).

python -m benchmarks.hidden_effects_choices engines --rooms 40    # leave one engine out
python -m benchmarks.hidden_effects_choices numbers --folder out --step 4   # other numbers
python -m benchmarks.hidden_effects_choices alpha --folder out --rooms 30   # alpha's intervals
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects import NAMES, ROOMS, TRUTHS, load, name_of, rows_of
from benchmarks.judging import first_of, kept_controls, one, rate
from rtcal.finder import (
    Case,
    Effect,
    Finding,
    control_rooms,
    find,
    library,
    recalibrate,
)
from rtcal.finder.case import NORMAL_90
from rtcal.finder.means import evidence, hypotheses, model_error
from rtcal.finder.means.bootstrap import (
    bootstrap_threshold,
    draw_null_features,
    score,
)
from rtcal.finder.means.engines import recentred
from rtcal.finder.means.evidence import evaluate
from rtcal.finder.means.features import observe
from rtcal.finder.means.hypotheses import predict_hypotheses
from rtcal.finder.means.model_error import estimate_discrepancy
from rtcal.finder.means.probabilities import credible_set, posterior
from rtcal.finder.means.recalibration import plain
from rtcal.finder.prior import prior_of


def engines(first: int, rooms: int) -> None:
    """Leave one engine out: rooms of each, judged by a threshold from the other two."""
    load(1)
    alarms: dict[str, list[bool]] = {}
    between = []
    for index in range(first, first + rooms):
        case = one(Case.from_dict(ROOMS[1][index]))
        controls = control_rooms(case, engines=("path tracing", "network", "rays"))
        tracing, _, traced = controls
        between.append(np.nanmean(tracing.errors - traced.errors.mean(0), axis=(0, 1, 3)))
        observed, _ = observe(case)
        predicted = predict_hypotheses(case, library())
        for left in controls:
            others = [c for c in controls if c is not left]
            prior = prior_of(case.room, library(), {})
            limit = bootstrap_threshold(case, observed, predicted, others, prior)
            rng = np.random.default_rng([index, 5])
            judged = recentred([*others, left])[-1]
            values = draw_null_features(case, observed, predicted.applied, [judged.errors], rng, 20)
            error = estimate_discrepancy(case, others)
            scores = score(evaluate(observed, predicted, error, prior.off, values), prior)
            alarms.setdefault(left.engine, []).extend((scores > limit.value).tolist())
        print(f"\r{index + 1 - first}/{rooms}", end="", flush=True)
    apart = np.sqrt(np.mean(np.square(between), axis=0))
    print(
        "\nbetween the means of path tracing and of rays, root mean square over rooms: "
        f"T20 {apart[0]:.3f}, EDT/T20 {apart[1]:.3f}, T30/T20 {apart[2]:.3f} (ln), "
        f"C80 {apart[3]:.2f} dB"
    )
    print("false alarms in control rooms of an engine that the threshold was not learnt from")
    for name, flags in alarms.items():
        print(f"  {name:14} {rate(flags)}")


def numbers(folder: str, step: int) -> None:
    """What becomes of development rooms where a number that decides is another one.

    Every so many rooms of population 0, T20, EDT and T30 in one configuration.
    """
    load(0)
    common = model_error.COMMON_UNCERTAINTY
    settings: list[tuple[Any, str, Any]] = [(model_error, "INFLATION", model_error.INFLATION)]
    settings += [(model_error, "SHRINKAGE", x) for x in (0.2, 0.8)]
    settings += [(model_error, "INFLATION", x) for x in (1.0, 1.5)]
    settings += [(Effect, "formula_error", Effect.formula_error * x) for x in (0.5, 2.0)]
    settings += [
        (hypotheses, "SHAPE_CHANGE", tuple((f, x * s) for f, s in hypotheses.SHAPE_CHANGE))
        for x in (0.5, 2.0)
    ]
    settings += [
        (model_error, "COMMON_UNCERTAINTY", {k: x * v for k, v in common.items()})
        for x in (0.5, 2.0)
    ]
    settings += [
        (evidence, "UNKNOWN_SIZES", tuple(x * s for s in evidence.UNKNOWN_SIZES))
        for x in (0.5, 2.0)
    ]
    settings += [
        (evidence, "UNKNOWN_FEATURES", (1.0, *(x * s for s in evidence.UNKNOWN_FEATURES[1:])))
        for x in (0.5, 2.0)
    ]
    settings += [(evidence, "UNKNOWN_SMOOTH", x) for x in (0.3, 0.9)]
    settings += [(evidence, "UNKNOWN_CORRELATION", x) for x in (0.5, 0.9)]
    rooms = []
    for index in range(0, len(ROOMS[0]), step):
        case = Case.from_dict(ROOMS[0][index])
        controls = first_of(kept_controls(case, Path(folder) / "controls_0" / f"{index}.npz"))
        rooms.append((TRUTHS[0][index]["seed"][1], one(case), controls))
        print(f"\r{index}/{len(ROOMS[0])}", end="", flush=True)
    print(
        "\n                                flagged  detected  right name  among candidates  unknown"
    )
    for module, name, value in settings:
        chosen = getattr(module, name)
        setattr(module, name, value)
        count: Counter[str] = Counter()
        for kind, case, controls in rooms:
            observed, _ = observe(case)
            predicted = predict_hypotheses(case, library())
            prior = prior_of(case.room, library(), {})
            limit = bootstrap_threshold(case, observed, predicted, controls, prior)
            weighed = evaluate(observed, predicted, limit.discrepancy, prior.off)
            nats = {k: float(v) for k, v in weighed.by_effect().items()}
            among = credible_set(posterior(nats, prior))
            group = "none" if kind == 0 else "unknown" if kind == 13 else "hidden"
            group = group if kind <= 13 else "other"
            count[group] += 1
            if float(score(weighed, prior)) > limit.value:
                count[f"{group} found"] += 1
                count["right"] += group == "hidden" and among[0] == NAMES[kind]
                count["among"] += group == "hidden" and NAMES[kind] in among
        setattr(module, name, chosen)
        cells = (
            f"{count['none found']}/{count['none']}",
            f"{count['hidden found']}/{count['hidden']}",
            f"{count['right']}",
            f"{count['among']}",
            f"{count['unknown found']}/{count['unknown']}",
        )
        changed = "as chosen" if value == chosen else f"{name} = {value}"
        print(f"{changed[:60]:60}" + "".join(f"{c:>9}" for c in cells), flush=True)


def alpha(folder: str, rooms: int) -> None:
    """How often alpha's 90 % intervals hold the truth, in detected rooms of the stored run."""
    warnings.simplefilter("ignore")
    load(1)
    stored = rows_of(None)
    for data in ("one", "all"):
        seen = [
            r["index"]
            for r in stored
            if 1 <= r["kind"] <= 12 and r.get(data, {}).get("verdict") in ("named", "ambiguous")
        ]
        shares: dict[bool, list[list[float]]] = {True: [], False: []}
        for index in np.random.default_rng(0).permutation(seen)[:rooms]:
            truth = TRUTHS[1][index]
            case = Case.from_dict(ROOMS[1][index])
            controls = kept_controls(case, Path(folder) / "controls" / f"{index}.npz")
            if data == "one":
                case, controls = one(case), first_of(controls)
            finding = find(case, controls=controls)
            if finding.can_be_added:
                right = finding.effect == name_of(truth["effects"][0])
                shares[right].append(held(finding, np.array(truth["alpha"])))
        for right, table in shares.items():
            if len(table) > 1:
                mean, error = np.mean(table, axis=0), np.std(table, axis=0) / len(table) ** 0.5
                cells = "  ".join(
                    f"{name} {m:.3f} ± {e:.3f}"
                    for name, m, e in zip(("prior", "plain", "corrected"), mean, error, strict=True)
                )
                print(
                    f"{data}, {len(table)} rooms {'rightly' if right else 'wrongly'} named: {cells}"
                )


def held(finding: Finding, truth: Any) -> list[float]:
    """Share of the coefficients within the 90 % intervals: the prior's, plain's, the corrected's."""
    room = finding.case.room
    wide = NORMAL_90 * room.sigma
    ends = [(np.clip(room.alpha - wide, 0, 1), np.clip(room.alpha + wide, 0, 1))]
    ends += [
        c.interval for c in (plain(finding.case), recalibrate(finding.apply(), finding.discrepancy))
    ]
    return [float(np.mean((low <= truth) & (truth <= high))) for low, high in ends]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("engines", "numbers", "alpha"))
    parser.add_argument("--folder", help="of the control rooms")
    parser.add_argument("--step", type=int, default=1, help="every so many rooms")
    parser.add_argument("--first", type=int, default=0, help="room to begin with")
    parser.add_argument("--rooms", type=int, default=40)
    chosen = parser.parse_args()
    if chosen.what == "alpha":
        alpha(chosen.folder, chosen.rooms)
    elif chosen.what == "engines":
        engines(chosen.first, chosen.rooms)
    else:
        numbers(chosen.folder, chosen.step)


if __name__ == "__main__":
    main()
