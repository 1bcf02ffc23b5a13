"""The quality of predictions and designs: the numbers of docs/prediction_study.md.

    python -m benchmarks.prediction toggles            # real rooms in several states
    python -m benchmarks.prediction worlds --rooms 200 # another tracer's rooms, one change each

The measured rooms are not shipped: `benchmarks.real_data` says where they are looked for. The rule
stands in the study and was written first.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import rtcal as rt
from benchmarks.real_data import (
    DECHORATE_VOLUME,
    PANEL_AREAS,
    handbook_sigma,
    lines,
    ptb_measured,
    ptb_room,
)
from rtcal.calibration.problem_data import times_in_room
from rtcal.prediction import Assumptions, State, predict
from rtcal.prediction.predicted import JND, Prediction
from rtcal.support.types import Array
from tests.hidden_world import populations

Z = 1.6449
UNSTATED = 0.05
OWN, FLOOR = (0.04, 0.06, 0.08, 0.1), (0.05, 0.1, 0.15)


@dataclass(frozen=True)
class Toggled:
    """A real room in several states, each a material list with its measured T."""

    name: str
    states: tuple[State, ...]


# Real rooms ---------------------------------------------------------------------------------------

_DECHORATE = {  # handbook: carpet on felt; porous panel of 50 mm; laminated board
    "floor": (0.25, 0.35, 0.45, 0.55, 0.6),
    "absorbing panels": (0.6, 0.85, 0.9, 0.9, 0.9),
    "reflecting panels": (0.1, 0.06, 0.05, 0.05, 0.05),
}
_DECHORATE_BANDS = (250.0, 500.0, 1000.0, 2000.0, 4000.0)


def dechorate(estimator: str, lowest: float) -> Toggled:
    """dEchorate's ten unfurnished states, by one of two estimates of T."""
    f = np.array([b for b in _DECHORATE_BANDS if b >= lowest])
    first = len(_DECHORATE_BANDS) - len(f)
    states = []
    for row in lines("dechorate", "t60.csv"):
        code = row["code_floor_ceiling_west_south_east_north"]
        if row["estimator"] != estimator or "2" in code:
            continue
        hard = np.array([d == "1" for d in code[1:]])
        areas = {
            "floor": PANEL_AREAS[0],
            "absorbing panels": PANEL_AREAS[1:][~hard].sum(),
            "reflecting panels": PANEL_AREAS[1:][hard].sum(),
        }
        room = handbook_room(f"dEchorate {code}", DECHORATE_VOLUME, areas, _DECHORATE, first, f)
        states.append(State(room, np.array([float(row[f"{b:.0f}"]) for b in f])))
    return Toggled(f"dEchorate, {estimator}", tuple(states))


def handbook_room(name, volume, areas, alpha, first, f) -> rt.Room:
    """A room of handbook coefficients; a material without area is left out."""
    used = [m for m, s in areas.items() if s > 0]
    table = np.array([alpha[m][first:] for m in used])
    return rt.Room(
        name=name,
        volume=volume,
        materials=used,
        areas=[areas[m] for m in used],
        alpha=table,
        sigma=handbook_sigma(table),
        air=rt.Air(20.0, 50.0),
        centre_frequencies=f,
    )


def ptb() -> Toggled:
    """PTB's studio with its curtains open and closed."""
    states = []
    for curtains, other in (("open", "closed"), ("closed", "open")):
        room = ptb_room([f"curtain({other})"])
        times = times_in_room(room, ptb_measured(curtains).measured)
        states.append(State(room, times.reverberation_time, times.uncertainty))
    return Toggled("PTB studio", tuple(states))


_LABORATORY = {  # handbook: carpet tiles, suspended mineral ceiling, painted board, 50 mm panels
    "floor": (0.1, 0.2, 0.3, 0.35, 0.4),
    "ceiling": (0.3, 0.4, 0.45, 0.45, 0.45),
    "hard wall": (0.1, 0.06, 0.05, 0.05, 0.05),
    "panels": (0.5, 0.8, 0.9, 0.9, 0.9),
}
_PANELS = 44.0
"""Of the laboratory's walls (82 m²), in m²: not published, guessed."""


def laboratory() -> Toggled:
    """The laboratory of R3VIVAL: no panel absorbs, half, all, one side; aimed sources."""
    x, y, z = 9.7, 5.5, 2.7
    f = np.array([250.0, 500.0, 1000.0, 2000.0, 4000.0])
    states = []
    for state, share in (("000", 0.0), ("050", 0.5), ("100", 1.0), ("R", 0.5)):
        rows = [
            r
            for r in lines("r3vival", f"{state}.csv")
            if r["parameter"] == "t20" and not r["source"].startswith("SBG")
        ]
        values = np.array([[float(r[f"{b:.0f}"] or "nan") for b in f] for r in rows])
        walls = 2 * (x + y) * z
        areas = {
            "floor": x * y,
            "ceiling": x * y,
            "hard wall": walls - share * _PANELS,
            "panels": share * _PANELS,
        }
        room = handbook_room(f"laboratory {state}", x * y * z, areas, _LABORATORY, 0, f)
        spread = np.nanstd(values, axis=0, ddof=1) / np.sqrt(len(rows))
        states.append(State(room, np.nanmean(values, axis=0), np.maximum(spread, 1e-3)))
    return Toggled("laboratory", tuple(states))


def real_rooms() -> list[Toggled]:
    return [
        dechorate("published", 500.0),
        dechorate("prerak23 second estimate", 250.0),
        ptb(),
        laboratory(),
    ]


@dataclass(frozen=True)
class Score:
    """Errors of ln T per change and band, with and without the uncertainty of the measured T."""

    error: Array
    sigma: Array
    half_width: Array
    handbook: Array
    scaled: Array
    nothing: Array

    @property
    def covered(self) -> float:
        return float((np.abs(self.error) <= Z * self.sigma).mean())

    @property
    def log_likelihood(self) -> float:
        return float((-0.5 * (self.error / self.sigma) ** 2 - np.log(self.sigma)).sum())


def score(measured: Sequence[State], after: State, assumptions: Assumptions | None = None) -> Score:
    """Predict one state from others; "scaled" is T of the first, changed as the model changes."""
    assumptions = assumptions or Assumptions()
    made = predict(measured, after.room, assumptions=assumptions)
    truth = np.log(after.reverberation_time)
    low, high = made.interval
    u = after.log_uncertainty(UNSTATED)
    alone = predict([], after.room, before=measured[0].room, assumptions=assumptions)
    model = [np.log(rt.Eyring().reverberation_time(s.room)) for s in (measured[0], after)]
    first = np.log(measured[0].reverberation_time)
    return Score(
        error=made.log_mean - truth,
        sigma=np.hypot(np.log(high / low) / 2 / Z, u),
        half_width=made.half_width,
        handbook=alone.linear_mean - truth,
        scaled=first + model[1] - model[0] - truth,
        nothing=first - truth,
    )


def pooled(scores: Sequence[Score]) -> Score:
    names = Score.__dataclass_fields__
    return Score(**{n: np.concatenate([getattr(s, n) for s in scores]) for n in names})


def changes(room: Toggled) -> Iterator[tuple[State, State]]:
    return itertools.permutations(room.states, 2)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)) / JND)


def toggles() -> None:
    rooms = real_rooms()
    print("one state measured, rms error in JND; half width: median, JND")
    print(
        "room, changes x bands, handbook, calibrated, scaled, nothing, ratio, coverage, half width"
    )
    found = {room.name: pooled([score([a], b) for a, b in changes(room)]) for room in rooms}
    for name, s in found.items():
        errors = [rms(e) for e in (s.handbook, s.error, s.scaled, s.nothing)]
        ratio = errors[1] / min(errors[1], errors[2])
        print(
            f"{name}, {s.error.size}, {', '.join(f'{e:.1f}' for e in errors)}, {ratio:.2f}, "
            f"{s.covered:.2f}, {np.median(s.half_width):.1f}"
        )
    print(f"mean coverage {np.mean([s.covered for s in found.values()]):.2f}")
    left_out(rooms)
    two_states(rooms)


def left_out(rooms: Sequence[Toggled]) -> None:
    """Choose own error and floor of sigma by the likelihood of the other rooms."""
    drawn = np.random.default_rng(0)
    kept = {}
    for room in rooms:
        pairs = list(changes(room))
        kept[room.name] = [pairs[i] for i in drawn.permutation(len(pairs))[:30]]
    table: dict[tuple[float, float], dict[str, Score]] = {}
    for own, floor in itertools.product(OWN, FLOOR):
        assumed = replace(Assumptions(), own=own, changed=floor)
        table[own, floor] = {
            room.name: pooled([score([a], b, assumed) for a, b in kept[room.name]])
            for room in rooms
        }
    print("left out: chosen own error and floor of sigma, coverage")
    covered = []
    for room in rooms:
        others = [r.name for r in rooms if r is not room]

        def support(key: tuple[float, float], others: list[str] = others) -> float:
            # Each room counts alike, however many states it has.
            return sum(table[key][n].log_likelihood / table[key][n].error.size for n in others)

        best = max(table, key=support)
        covered.append(table[best][room.name].covered)
        print(f"{room.name}: {best[0]:g}, {best[1]:g}: {covered[-1]:.2f}")
    print(f"mean {np.mean(covered):.2f}")


def two_states(rooms: Sequence[Toggled]) -> None:
    print("two states measured: rms error in JND, coverage, half width")
    drawn = np.random.default_rng(1)
    for room in rooms:
        triples = [
            (a, b, c)
            for a, b in itertools.combinations(room.states, 2)
            for c in room.states
            if c is not a and c is not b
        ]
        if not triples:
            continue
        chosen = [triples[i] for i in drawn.permutation(len(triples))[:60]]
        s = pooled([score([a, b], c) for a, b, c in chosen])
        width = np.median(s.half_width)
        print(f"{room.name}, {len(chosen)}: {rms(s.error):.1f}, {s.covered:.2f}, {width:.1f}")


# Another tracer's rooms ---------------------------------------------------------------------------

_PANEL = np.array([0.25, 0.5, 0.8, 0.9, 0.9, 0.85, 0.8])


def world(index: int) -> tuple[Prediction, Array, Array]:
    """Return the prediction of one change, ln T measured after it, and the prior's ln T error."""
    rng = np.random.default_rng([40, index])
    hidden = populations.room(rng, populations.log_uniform(rng, 0.08, 0.28))
    common = np.exp(0.1 * rng.standard_normal())
    each = np.exp(0.2 * rng.standard_normal((6, 1)))
    stated = np.clip(hidden.alpha * common * each, 0.01, 0.95)
    noise = np.linalg.cholesky(0.7 ** np.abs(np.subtract.outer(range(7), range(7))))
    panel = np.clip(_PANEL + 0.1 * noise @ rng.standard_normal(7), 0.02, 0.98)
    wall, whole = populations.largest(hidden)
    area = whole * rng.uniform(0.2, 0.8)
    before = t20(populations.measure(hidden, hidden.world, int(rng.integers(2**31)), rng))
    populations.put(hidden, rng, area, panel, wall)
    after = t20(populations.measure(hidden, hidden.world, int(rng.integers(2**31)), rng))
    areas = hidden.areas * np.exp(0.03 * rng.standard_normal(6))
    room = rt.Room(
        name=f"world {index}",
        volume=hidden.volume * np.exp(0.03 * rng.standard_normal()),
        materials=[f"material {i + 1}" for i in range(6)],
        areas=areas,
        alpha=stated,
        sigma=handbook_sigma(stated),
        air=rt.Air(**hidden.stated["air"]),
        centre_frequencies=populations.BANDS,
    )
    material = rt.Material("panel", _PANEL.tolist(), [0.1] * 7)
    covers = [
        rt.prediction.Cover(f"material {i + 1}", material, area * share)
        for i, share in enumerate(hidden.where[wall])
        if share > 1e-3
    ]
    state = State(room, before[0], before[1])
    return predict([state], covers), np.log(after[0]), after[1] / after[0]


def t20(measured: dict) -> tuple[Array, Array]:
    """Mean T20 over the positions and its standard uncertainty."""
    values = measured["t20"]
    return np.nanmean(values, axis=0), np.nanstd(values, axis=0, ddof=1) / np.sqrt(len(values))


def worlds(rooms: int) -> None:
    rows = []
    for index in range(rooms):
        made, truth, u = world(index)
        low, high = made.interval
        alone = made.uncalibrated
        before = np.log(made.states[0].reverberation_time)
        model = [np.log(rt.Eyring().reverberation_time(r)) for r in (made.before, made.after)]
        rows.append(
            Score(
                error=made.log_mean - truth,
                sigma=np.hypot(np.log(high / low) / 2 / Z, u),
                half_width=made.half_width,
                handbook=alone.linear_mean - truth,
                scaled=before + model[1] - model[0] - truth,
                nothing=before - truth,
            )
        )
        if (index + 1) % 20 == 0 or index + 1 == rooms:
            told(rows)


def told(rows: Sequence[Score]) -> None:
    s = pooled(rows)
    errors = [rms(e) for e in (s.handbook, s.error, s.scaled, s.nothing)]
    print(f"{len(rows)} changes: rms error in JND: handbook, calibrated, scaled, nothing")
    print(
        ", ".join(f"{e:.2f}" for e in errors), f"calibrated / handbook {errors[1] / errors[0]:.2f}"
    )
    width = np.median(s.half_width)
    print(f"coverage {s.covered:.3f}, median half width {width:.1f} JND", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("toggles", "worlds"))
    parser.add_argument("--rooms", type=int, default=200)
    stated = parser.parse_args()
    if stated.part == "toggles":
        toggles()
    else:
        worlds(stated.rooms)


if __name__ == "__main__":
    main()
