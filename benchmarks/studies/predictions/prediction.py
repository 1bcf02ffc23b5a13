"""The quality of predictions: the numbers of benchmarks/studies/predictions/README.md.

    python -m benchmarks.studies.predictions.prediction toggles  # real rooms in several states
    # drawn changes, by two tracers
    python -m benchmarks.studies.predictions.prediction changes --rooms 60

The measured rooms are not shipped: `benchmarks.studies.means.real_data` says where they are looked
for. The rule stands in the study and was written first.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.means.real_data import (
    DECHORATE_VOLUME,
    PANEL_AREAS,
    handbook_sigma,
    lines,
    ptb_measured,
    ptb_room,
)
from rtcal import prediction as rp
from rtcal.acoustics.changes import placed
from rtcal.calibration.measured import times_in_room
from rtcal.prediction import Assumptions, predict
from rtcal.prediction.predicted import Prediction
from rtcal.support.types import Array

Z = 1.6449
UNSTATED = 0.05
LOG_JND = float(np.log(1.05))
FACTOR, LEAST = (0.1, 0.15, 0.2), (0.03, 0.06, 0.09)
SMALL = 0.1
"""Share of the absorption below which an exchange is a small change."""


@dataclass(frozen=True)
class State:
    """A room with a measured T in s and its standard uncertainty, NaN where none is stated."""

    room: rt.Room
    time: Array
    uncertainty: Array

    @property
    def log_uncertainty(self) -> Array:
        return np.nan_to_num(self.uncertainty / self.time, nan=UNSTATED)


@dataclass(frozen=True)
class Toggled:
    """A real room in several states."""

    name: str
    states: tuple[State, ...]


# Real rooms ---------------------------------------------------------------------------------------

_DECHORATE = {  # handbook: carpet on felt; porous panel of 50 mm; laminated board
    "floor": (0.25, 0.35, 0.45, 0.55, 0.6),
    "absorbing panels": (0.6, 0.85, 0.9, 0.9, 0.9),
    "reflecting panels": (0.1, 0.06, 0.05, 0.05, 0.05),
}
_DECHORATE_BANDS = (250.0, 500.0, 1000.0, 2000.0, 4000.0)


_ACROSS = "zzxyxy"
"""Axis that floor, ceiling, west, south, east and north stand across."""


def dechorate(estimator: str, lowest: float) -> Toggled:
    """dEchorate's ten unfurnished states, by one of two estimates of T."""
    f = np.array([b for b in _DECHORATE_BANDS if b >= lowest])
    first = len(_DECHORATE_BANDS) - len(f)
    states = []
    for row in lines("dechorate", "t60.csv"):
        code = row["code_floor_ceiling_west_south_east_north"]
        if row["estimator"] != estimator or "2" in code:
            continue
        names = ["floor", *(("absorbing", "reflecting")[int(d)] + " panels" for d in code[1:])]
        areas = dict.fromkeys(_DECHORATE, 0.0)
        for name, area in zip(names, PANEL_AREAS, strict=True):
            areas[name] += float(area)
        room = handbook_room(f"dEchorate {code}", DECHORATE_VOLUME, areas, _DECHORATE, first, f)
        surfaces = [
            rt.Surface(f"panel {i}", name, float(area), axis)
            for i, (name, area, axis) in enumerate(zip(names, PANEL_AREAS, _ACROSS, strict=True))
        ]
        t = np.array([float(row[f"{b:.0f}"]) for b in f])
        states.append(State(room.replace(surfaces=surfaces), t, np.full(len(f), np.nan)))
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
        room = room.replace(dimensions=(x, y, z))
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
    """Errors of ln T by change and band, and the standard deviation that an interval has for them.

    The uncertainties of T before and after are in ``sigma``: an interval is for the T before that is
    given, and for a measurement without error. ``small`` says where less than a tenth of the absorption
    is exchanged.
    """

    error: Array
    sigma: Array
    half_width: Array
    scaled: Array
    nothing: Array
    small: Array

    @property
    def covered(self) -> float:
        return float((np.abs(self.error) <= Z * self.sigma).mean())

    @property
    def log_likelihood(self) -> float:
        return float((-0.5 * (self.error / self.sigma) ** 2 - np.log(self.sigma)).mean())


def exchanged(before: rt.Room, after: rt.Room) -> Array:
    """Share of the absorption that is exchanged, by the stated coefficients, (n_bands,)."""
    total = np.zeros(before.n_bands)
    for name in {*before.materials, *after.materials}:
        areas = [
            float(r.areas[r.materials.index(name)]) if name in r.materials else 0.0
            for r in (before, after)
        ]
        room = before if name in before.materials else after
        total += abs(areas[1] - areas[0]) * room.alpha[room.materials.index(name)]
    return total / before.absorption_area


def moves(before: rt.Room, after: rt.Room) -> bool:
    """Whether the states differ in what they state: areas by material and direction."""
    states = [placed(room, ()) for room in (before, after)]
    tables = [dict(zip(s.room.materials, s.areas, strict=True)) for s in states]
    if tables[0].keys() != tables[1].keys():
        return True
    return not all(np.allclose(tables[0][m], tables[1][m]) for m in tables[0])


def calibrated(measured: Sequence[State]) -> rt.CalibrationResult:
    """The calibration to one state, or to several; the first is that before the change."""
    first = measured[0]
    if len(measured) == 1:
        return rt.calibrate(first.room, first.time, unreachable="nearest")
    every = rt.Configurations([s.room for s in measured])
    times = [s.time for s in measured]
    return rt.calibrate(every, times, method="joint", unreachable="nearest").results[0]


def score(
    result: rt.CalibrationResult,
    before: State,
    after: State,
    assumptions: Assumptions | None = None,
) -> Score:
    """Predict one state from others; "scaled" is T before, changed as the model changes."""
    made = predict(result, after.room, assumptions=assumptions)
    truth = np.log(after.time)
    low, high = made.interval
    u = np.hypot(after.log_uncertainty, before.log_uncertainty)
    model = [np.log(rt.Eyring().reverberation_time(s.room)) for s in (before, after)]
    first = np.log(before.time)
    return Score(
        error=made.log_mean - truth,
        sigma=np.hypot(np.log(high / low) / 2 / Z, u),
        half_width=made.half_width,
        scaled=first + model[1] - model[0] - truth,
        nothing=first - truth,
        small=exchanged(before.room, after.room) < SMALL,
    )


def pooled(scores: Sequence[Score]) -> Score:
    names = Score.__dataclass_fields__
    return Score(**{n: np.concatenate([getattr(s, n) for s in scores]) for n in names})


def pairs(room: Toggled) -> Iterator[tuple[State, State]]:
    return ((a, b) for a, b in itertools.permutations(room.states, 2) if moves(a.room, b.room))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)) / LOG_JND)


def toggles() -> None:
    rooms = real_rooms()
    results = {id(s): calibrated([s]) for room in rooms for s in room.states}
    print("one state measured: values, rms error / JND of predicted, scaled, nothing; coverage;")
    print("median half width / JND; changes below a tenth of the absorption: values, half width")
    covered = []
    for room in rooms:
        s = pooled([score(results[id(a)], a, b) for a, b in pairs(room)])
        errors = ", ".join(f"{rms(e):.1f}" for e in (s.error, s.scaled, s.nothing))
        small = f"{s.half_width[s.small].max():.1f}" if s.small.any() else "-"
        covered.append(s.covered)
        print(
            f"{room.name}: {s.error.size}, {errors}; {s.covered:.2f}; "
            f"{np.median(s.half_width):.1f}; {s.small.sum()}, {small}"
        )
        moved = [
            (a, b) for a, b in itertools.permutations(room.states, 2) if not moves(a.room, b.room)
        ]
        if moved:
            print(
                f"  {len(moved)} changes are none by what is stated; T differs by "
                f"{rms(np.array([np.log(a.time / b.time) for a, b in moved])):.1f} JND"
            )
    print(f"mean coverage {np.mean(covered):.2f}")
    left_out(rooms, results)
    two_states(rooms)


def left_out(rooms: Sequence[Toggled], results: dict[int, rt.CalibrationResult]) -> None:
    """Choose the equation's error by the likelihood of the other rooms."""
    drawn = np.random.default_rng(0)
    kept = {}
    for room in rooms:
        every = list(pairs(room))
        kept[room.name] = [every[i] for i in drawn.permutation(len(every))[:30]]
    table: dict[tuple[float, float], dict[str, Score]] = {}
    for factor, least in itertools.product(FACTOR, LEAST):
        assumed = replace(Assumptions(), factor=factor, least=least)
        table[factor, least] = {
            room.name: pooled([score(results[id(a)], a, b, assumed) for a, b in kept[room.name]])
            for room in rooms
        }
    print("left out: factor and least by the other rooms' likelihood, coverage")
    covered = []
    for room in rooms:
        others = [r.name for r in rooms if r.name.split(",")[0] != room.name.split(",")[0]]

        def support(key: tuple[float, float], others: list[str] = others) -> float:
            return sum(table[key][n].log_likelihood for n in others)

        best = max(table, key=support)
        covered.append(table[best][room.name].covered)
        print(f"{room.name}: {best[0]:g}, {best[1]:g}: {covered[-1]:.2f}")
    print(f"mean {np.mean(covered):.2f}")


def two_states(rooms: Sequence[Toggled]) -> None:
    print("two states measured: changes, rms error / JND, coverage, median half width / JND")
    drawn = np.random.default_rng(1)
    for room in rooms:
        triples = [
            (a, b, c)
            for a, b in itertools.permutations(room.states, 2)
            for c in room.states
            if moves(a.room, b.room) and moves(a.room, c.room) and moves(b.room, c.room)
        ]
        if not triples:
            continue
        chosen = [triples[i] for i in drawn.permutation(len(triples))[:60]]
        s = pooled([score(calibrated([a, b]), a, c) for a, b, c in chosen])
        width = np.median(s.half_width)
        print(f"{room.name}, {len(chosen)}: {rms(s.error):.1f}, {s.covered:.2f}, {width:.1f}")


# Drawn changes, by two tracers --------------------------------------------------------------------

BANDS = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
_AXES = "xxyyzz"
_SOURCE = (0.2, 0.25, 0.5)
_RECEIVERS = ((0.75, 0.7, 0.4), (0.4, 0.8, 0.45), (0.85, 0.3, 0.4), (0.5, 0.5, 0.55))
_PATHS, _RAYS = 4000, 4000


@dataclass(frozen=True)
class Change:
    """A box with a material on each wall, and how much of each wall a panel then covers."""

    sides: Array
    areas: Array
    alpha: Array
    stated: Array
    panel: Array
    panel_stated: Array
    panel_sigma: float
    shares: Array
    scattering: float
    one: bool

    @property
    def walls(self) -> tuple[Array, Array]:
        """Coefficients of the walls before and after, (6, n_bands) each."""
        share = self.shares[:, np.newaxis]
        return self.alpha, (1 - share) * self.alpha + share * self.panel


def drawn_change(seed: int, index: int) -> Change:
    """One change in three covers most of one surface; the others cover parts of three, one per axis."""
    rng, one = np.random.default_rng([seed, index]), index % 3 == 0
    volume = np.exp(rng.uniform(np.log(60), np.log(600)))
    ratio = np.array([rng.uniform(1.1, 2.0), rng.uniform(0.9, 1.3), rng.uniform(0.28, 0.7)])
    x, y, z = sides = ratio * (volume / np.prod(ratio)) ** (1 / 3)
    areas = np.array([y * z, y * z, x * z, x * z, x * y, x * y])
    base = np.exp(rng.uniform(*np.log((0.03, 0.12) if one else (0.04, 0.25)), (6, 1)))
    tilt = 0.2 * rng.standard_normal((6, 1)) * np.log2(BANDS / 1000)
    alpha = np.clip(base * np.exp(tilt + 0.1 * rng.standard_normal((6, 6))), 0.01, 0.6)
    low, top = rng.uniform(0.1, 0.5), rng.uniform(0.6, 0.95)
    rise = np.array([0.0, 0.45, 0.9, 1.0, 1.0, 0.95])
    panel_stated = np.clip(low + (top - low) * rise, 0.05, 0.95)
    sigma = float(rng.choice([0.05, 0.1]))
    root = np.linalg.cholesky(0.7 ** np.abs(np.subtract.outer(range(6), range(6))))
    panel = np.clip(panel_stated + sigma * root @ rng.standard_normal(6), 0.02, 0.98)
    shares = np.zeros(6)
    if one:
        shares[int(rng.choice([5, 5, 5, 4, 0, 2]))] = rng.uniform(0.6, 1.0)
    else:
        chosen = [rng.choice(pair) for pair in ((0, 1), (2, 3), (4, 5))]
        shares[chosen] = rng.uniform(0.1, 0.7) * rng.uniform(0.7, 1.3, 3)
    common = np.exp(0.1 * rng.standard_normal())
    stated = np.clip(alpha * common * np.exp(0.2 * rng.standard_normal((6, 1))), 0.01, 0.95)
    return Change(
        sides=sides,
        areas=areas,
        alpha=alpha,
        stated=stated,
        panel=panel,
        panel_stated=panel_stated,
        panel_sigma=sigma,
        shares=np.minimum(shares, 1.0),
        scattering=float(rng.uniform(0.1, 0.5)),
        one=one,
    )


def room_of(change: Change, named: bool) -> rt.Room:
    """The room as a user states it: with the axis of each surface, or without any direction."""
    names = WALLS if named else tuple(f"material {i}" for i in range(6))
    surfaces = [
        rt.Surface(n, n, float(s), a) for n, s, a in zip(names, change.areas, _AXES, strict=True)
    ]
    return rt.Room(
        name="box",
        volume=float(np.prod(change.sides)),
        materials=names,
        areas=change.areas,
        alpha=change.stated,
        sigma=handbook_sigma(change.stated),
        air=rt.Air(20.0, 50.0),
        centre_frequencies=BANDS,
        **({"surfaces": surfaces} if named else {}),
    )


def prediction_of(change: Change, t: Array, named: bool) -> Prediction:
    """The prediction from T before."""
    room = room_of(change, named)
    panel = rt.Material("panel", change.panel_stated.tolist(), [change.panel_sigma] * 6)
    covers = [
        rp.Change(cover=name, by=panel, area=None if share == 1 else float(share * area))
        for name, share, area in zip(room.materials, change.shares, change.areas, strict=True)
        if share > 0
    ]
    return rt.calibrate(room, t, unreachable="nearest").predict(covers)


def by_paths(change: Change, seed: int) -> list[Array]:
    """Mean T20 before and after, by rtcal's path tracing."""
    room = room_of(change, named=True)
    box = rt.simulators.Polyhedron.shoebox(
        tuple(change.sides.tolist()), dict(zip(WALLS, WALLS, strict=True))
    )
    tracer = rt.simulators.PathTracing(
        geometry=box,
        room=room,
        sources={"S": tuple(change.sides * _SOURCE)},
        receivers={f"R{i}": tuple(change.sides * r) for i, r in enumerate(_RECEIVERS)},
        scattering=change.scattering,
        n_paths=_PATHS,
    )
    return [tracer.simulate(a, seed=seed).mean("t20") for a in change.walls]


def by_rays(change: Change) -> list[Array]:
    """Mean T20 before and after, by pyroomacoustics' ray tracing with image sources up to order 3."""
    import pyroomacoustics

    fs, found = 16_000, []
    for alpha in change.walls:
        bands = {"center_freqs": BANDS.tolist()}
        materials = {
            name: pyroomacoustics.Material(
                {"coeffs": a.tolist(), **bands}, {"coeffs": [change.scattering] * 6, **bands}
            )
            for name, a in zip(WALLS, alpha, strict=True)
        }
        room: Any = pyroomacoustics.ShoeBox(
            change.sides,
            fs=fs,
            materials=materials,
            max_order=3,
            ray_tracing=True,
            air_absorption=True,
            temperature=20,
            humidity=50,
        )
        room.set_ray_tracing(n_rays=_RAYS, receiver_radius=0.5)
        room.add_source(change.sides * _SOURCE)
        room.add_microphone_array((change.sides * np.array(_RECEIVERS)).T)
        room.compute_rir()
        found.append(np.nanmean([decay_times(rows[0], fs) for rows in room.rir], axis=0))
    return found


def decay_times(samples: Array, fs: int) -> Array:
    """T20 in octaves by backward integration to the end, (n_bands,): there is no noise."""
    from scipy.signal import butter, sosfiltfilt

    times = np.full(len(BANDS), np.nan)
    for k, f in enumerate(BANDS):
        edges = [f / 2**0.5, min(f * 2**0.5, 0.49 * fs)]
        energy = sosfiltfilt(butter(3, edges, "bandpass", fs=fs, output="sos"), samples) ** 2
        level = np.cumsum(energy[::-1])[::-1]
        level = 10 * np.log10(np.maximum(level / level[0], 1e-12))
        first, last = int(np.argmax(level < -5)), int(np.argmax(level < -25))
        if last > first:
            slope = np.polyfit(np.arange(first, last) / fs, level[first:last], 1)[0]
            times[k] = -60 / slope
    return times


def changes(rooms: int, seed: int) -> None:
    """Print how often the intervals of drawn changes hold, half of them by each tracer."""
    rows: list[dict[str, Any]] = []
    for index in range(rooms):
        change = drawn_change(seed, index)
        paths = (index // 3) % 2 == 0
        before, after = by_paths(change, index) if paths else by_rays(change)
        for named in (True, False):
            made = prediction_of(change, before, named)
            low, high = made.interval
            rows.append(
                {
                    "one": change.one,
                    "named": named,
                    "tracer": "rtcal" if paths else "pyroomacoustics",
                    "held": (low <= after) & (after <= high),
                    "half": made.half_width,
                    "error": made.log_mean - np.log(after),
                }
            )
    print(f"{rooms} changes: values, coverage of 90 %, median half width / JND, rms error / JND")
    for one, named in itertools.product((True, False), (True, False)):
        for tracer in (None, "rtcal", "pyroomacoustics"):
            some = [
                r
                for r in rows
                if (r["one"], r["named"]) == (one, named) and tracer in (None, r["tracer"])
            ]
            held, half, error = (np.array([r[n] for r in some]) for n in ("held", "half", "error"))
            print(
                f"{'one surface' if one else 'evenly spread'}, directions "
                f"{'stated' if named else 'not stated'}, {tracer or 'both'}: {held.size}, "
                f"{held.mean():.3f}, {np.median(half):.1f}, {rms(error):.1f}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("toggles", "changes"))
    parser.add_argument("--rooms", type=int, default=60)
    parser.add_argument("--seed", type=int, default=2057)
    stated = parser.parse_args()
    if stated.part == "toggles":
        toggles()
    else:
        changes(stated.rooms, stated.seed)


if __name__ == "__main__":
    main()
