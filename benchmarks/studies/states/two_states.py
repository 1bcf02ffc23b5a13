"""The change between two measurements: real rooms, controls, a hidden world.

    python -m benchmarks.studies.states.two_states [real] [surfaces] [worlds] [controls] [hidden]
        [climates] [time]

This folder's README.md has its output. The data are read from the shared folder beside the checkout.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections import Counter

import numpy as np

import rtcal as rt
from benchmarks.studies.means.real_data import lines
from rtcal.finder import StatesCase
from rtcal.finder.finding import Finding
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.support.types import Array
from tests import test_two_states_surfaces as test_walls
from tests import test_where
from tests import two_states as synthetic

LABORATORY = (9.7, 5.5, 2.7)
STATES = ("000", "050", "100", "R")
OCTAVES = np.array([125.0, 250, 500, 1000, 2000, 4000, 8000])
MIDDLE = (500.0, 1000.0, 2000.0)
STEPS = ("000000", "011000", "011100", "011110", "011111")
"""dEchorate's panels, turned one after the other (floor, ceiling, west, south, east, north)."""
FIRST = 5000
"""First seed of what is drawn: none was drawn before the rule was frozen."""


def box(name: str, sides: tuple[float, float, float], frequencies: Array) -> rt.Room:
    x, y, z = sides
    n = len(frequencies)
    return rt.Room(
        name=name,
        volume=x * y * z,
        materials=["all"],
        areas=[2 * (x * y + x * z + y * z)],
        alpha=[[0.2] * n],
        sigma=[[0.1] * n],
        centre_frequencies=frequencies,
        air=rt.Air(),
    )


def laboratory(state: str, aimed: bool = True) -> rt.Measurement:
    """Return T20 of the loudspeakers, or of the omnidirectional sources."""
    rows = [
        r
        for r in lines("r3vival", f"{state}.csv")
        if r["parameter"] == "t20" and r["source"].startswith("SBG") != aimed
    ]
    return rt.Measurement(
        centre_frequencies=OCTAVES,
        values={"t20": [[float(r[f"{f:.0f}"] or "nan") for f in OCTAVES] for r in rows]},
        pairs=[(r["source"], "M") for r in rows],
    )


def dechorate() -> dict[str, rt.Measurement]:
    """Return T of each state, as means over 6 sources and 30 microphones."""
    f = [500, 1000, 2000, 4000]
    return {
        r["code_floor_ceiling_west_south_east_north"]: rt.Measurement(
            centre_frequencies=f,
            values={"t20": [[float(r[str(b)]) for b in f]]},
            n_sources=6,
            n_receivers=30,
        )
        for r in lines("dechorate", "t60.csv")
        if r["estimator"] == "published"
    }


def ptb(curtains: str) -> rt.Measurement:
    """Return T30 of six pairs with the standard deviation over the teams."""
    rows = [
        r
        for r in lines("ptb_studio", "measured.csv")
        if r["quantity"] == "T30" and r["curtains"] == curtains
    ]
    pairs = list(dict.fromkeys(r["pair"] for r in rows))
    f = list(dict.fromkeys(float(r["band_hz"]) for r in rows))
    at = {(r["pair"], float(r["band_hz"])): r for r in rows}
    tables = [
        [[float(at[p, b][column]) for b in f] for p in pairs]
        for column in ("mean", "std_over_teams")
    ]
    return rt.Measurement(
        centre_frequencies=f,
        values={"t30": tables[0]},
        uncertainty={"t30": tables[1]},
        pairs=[(p[:2], p[2:]) for p in pairs],
    )


def studio() -> rt.Room:
    """Return PTB's studio: 383 m³, with the areas that its materials state."""
    areas = sum(
        float(r["area_m2"]) for r in lines("ptb_studio", "materials.csv") if r["state"] == "both"
    )
    f = ptb("open").centre_frequencies
    n = len(f)
    return rt.Room(
        name="PTB studio",
        volume=383.0,
        materials=["all"],
        areas=[areas],
        alpha=[[0.2] * n],
        sigma=[[0.1] * n],
        centre_frequencies=f,
        air=rt.Air(),
    )


def line(name: str, finding: Finding) -> bool:
    """Print a change; return whether it was detected."""
    case = finding.case
    area = [case.equation.absorption_area(case.room, t) for t in case.times]
    inside = np.isin(case.room.centre_frequencies, finding.middle)
    eyring = float((area[1] - area[0])[inside].mean())
    ratio = finding.size.mean / eyring
    print(
        f"| {name} | {finding.score:+.1f} | {finding.verdict} | {finding.family or '-'} | "
        f"{eyring:+.1f} | {finding.size.mean:+.1f} ({finding.size.low:+.1f} to "
        f"{finding.size.high:+.1f}) | {ratio:.2f} |",
        flush=True,
    )
    return finding.detected


HEAD = (
    "| change | nats | verdict | family | Eyring / m² | found / m² (90 %) | ratio |\n"
    "|---|---|---|---|---|---|---|"
)


def real() -> None:
    """Every ordered pair of measured states."""
    print(HEAD)
    room = box("laboratory", LABORATORY, OCTAVES)
    done = [
        line(f"laboratory, {a} to {b}", rt.find(room, laboratory(b), before=laboratory(a)))
        for a, b in itertools.permutations(STATES, 2)
    ]
    print(f"detected {sum(done)} of {len(done)}\n\n{HEAD}")
    done = [
        line(f"curtain {a} to {b}", rt.find(studio(), ptb(b), before=ptb(a)))
        for a, b in (("open", "closed"), ("closed", "open"))
    ]
    print(f"detected {sum(done)} of {len(done)}\n\n{HEAD}")
    states = dechorate()
    small = box("dEchorate", (5.705, 5.965, 2.355), states[STEPS[0]].centre_frequencies)
    singles = [(STEPS[0], code) for code in states if code.count("1") == 1]
    for title, steps in (("steps", list(itertools.pairwise(STEPS))), ("single", singles)):
        both = [*steps, *((b, a) for a, b in steps)]
        done = [
            line(f"dEchorate, {a} to {b}", rt.find(small, states[b], before=states[a]))
            for a, b in both
        ]
        print(f"{title}: detected {sum(done)} of {len(done)}\n")


def drawn(state: str, seed: int, aimed: bool, noisy: int) -> Finding:
    """Return what is found between two measurements of a state, with the noise of both drawn."""
    measured = laboratory(state, aimed)
    t = np.nanmedian(measured.values["t20"], axis=0)
    n = len(measured.pairs)
    rng = np.random.default_rng(seed)
    scale = np.ones((n, 1))
    scale[rng.permutation(n)[:noisy]] = 3.0
    spread = 0.88 / np.sqrt(OCTAVES / np.sqrt(2) * t)
    two = [
        rt.Measurement(
            centre_frequencies=OCTAVES,
            values={"t20": t * np.exp(scale * spread * rng.standard_normal((n, len(t))))},
            pairs=measured.pairs,
        )
        for _ in range(2)
    ]
    return rt.find(box("laboratory", LABORATORY, OCTAVES), two[1], before=two[0])


def controls(number: int = 40) -> None:
    """Nothing changed: drawn noise, one source three times as noisy, other places."""
    for aimed, noisy in itertools.product((True, False), (0, 1)):
        scores = np.array(
            [drawn(STATES[i % 4], FIRST + i, aimed, noisy).score for i in range(number)]
        )
        sources = "30 loudspeakers" if aimed else "4 omnidirectional"
        print(
            f"| {sources}, {noisy} noisy | {number} | {int((scores > np.log(20)).sum())} | "
            f"{np.median(scores):+.1f} | {scores.max():+.1f} |",
            flush=True,
        )
    room = box("laboratory", LABORATORY, OCTAVES)
    for state in STATES:
        every = laboratory(state)
        azimuths = [s[:-4] for s, _ in every.pairs if s.endswith("-150")]
        two = []
        for distance in ("150", "200"):
            chosen = every.select([(f"{a}-{distance}", "M") for a in azimuths])
            two.append(
                rt.Measurement(
                    centre_frequencies=OCTAVES,
                    values=dict(chosen.values),
                    pairs=[(a, "M") for a in azimuths],
                )
            )
        finding = rt.find(room, two[1], before=two[0])
        print(f"| loudspeakers 0.5 m farther, {state} | {finding.score:+.1f} | {finding.verdict} |")


def hidden(number: int = 40) -> None:
    """Panels of a random area in a room of another equation, with six sources; and none."""
    held = claimed = right = detected = flagged = 0
    ratios, eyring = [], rt.Eyring()
    for i in range(number):
        rng = np.random.default_rng(FIRST + i)
        panels = float(np.exp(rng.uniform(np.log(1.0), np.log(40.0))))
        times = [synthetic.times(), synthetic.times(panels)]
        room = synthetic.room()
        a, b = (eyring.absorption_area(room, t)[2:5].mean() for t in times)
        two = [synthetic.measured(t, FIRST + 2 * i + j, uneven=0.03) for j, t in enumerate(times)]
        finding = rt.find(StatesCase(room=room, before=two[0], after=two[1]))
        detected += finding.detected
        if finding.detected:
            held += finding.size.low <= b - a <= finding.size.high
            ratios.append(finding.size.mean / (b - a))
        if finding.family is not None:
            claimed += 1
            right += finding.family in ("added absorption", "added absorption, rising")
        same = [synthetic.measured(times[0], 2 * FIRST + 2 * i + j) for j in range(2)]
        flagged += rt.find(StatesCase(room=room, before=same[0], after=same[1])).detected
    print(
        f"panels of 1 to 40 m², {number} rooms: detected {detected}, intervals that hold "
        f"{held}, ratio of the amounts {np.median(ratios):.2f} (90 %: {np.quantile(ratios, 0.05):.2f} "
        f"to {np.quantile(ratios, 0.95):.2f}), families claimed {claimed}, right {right}; nothing "
        f"changed: flagged {flagged} of {number}"
    )


def climates(number: int = 20) -> None:
    """Each state in a climate of its own, as uncertain as stated: with panels, and without."""
    for panels in (0.9, 0.0):
        claimed: Counter[str] = Counter()
        for i in range(number):
            rng = np.random.default_rng(FIRST + i)
            two = []
            for j, area in enumerate((0.0, panels)):
                air = rt.Air(20 + 2 * rng.standard_normal(), 50 + 10 * rng.standard_normal())
                t = synthetic.times(area, air)
                two.append(synthetic.measured(t, 3 * FIRST + 2 * i + j, pairs=30))
            finding = rt.find(synthetic.room(), two[1], before=two[0])
            claimed[finding.family or finding.verdict] += 1
        counts = ", ".join(f"{name} {n}" for name, n in claimed.most_common())
        print(f"{panels:g} m² of panels, {number} rooms of 30 pairs: {counts}", flush=True)


INDEX = (0.6, 1.2, 0.5, 3.0, 7.0, 7.7, 7.7)
"""Directivity index of the loudspeakers in dB, 125 Hz to 8 kHz, fitted to direct over late energy of
state 000; the ends are extrapolated."""
WALLS = {
    "000 to R": {"south"},
    "000 to 100": set(SHOEBOX_WALLS[:4]),
    "R to 100": set(SHOEBOX_WALLS[:4]) - {"south"},
}
"""What is known of the walls: R has the panels of one wall (y = 0), 100 those of all four."""


def all_parameters(state: str) -> rt.Measurement:
    """Return what the loudspeakers' responses tell."""
    rows = [r for r in lines("r3vival", f"{state}.csv") if not r["source"].startswith("SBG")]
    pairs = list(dict.fromkeys((r["source"], "M") for r in rows))
    table = {
        (r["source"], r["parameter"]): [float(r[f"{f:.0f}"] or "nan") for f in OCTAVES]
        for r in rows
    }
    values = {
        name: [table[source, name] for source, _ in pairs]
        for name in ("t20", "edt", "c80", "ts", "level")
    }
    return rt.Measurement(centre_frequencies=OCTAVES, values=values, pairs=pairs)


def aimed_simulator(stated: bool, n_paths: int = 2400) -> PathTracing:
    """Return the laboratory with its aimed loudspeakers."""
    places = {
        r["name"]: tuple(float(r[axis]) for axis in "xyz")
        for r in lines("r3vival", "positions.csv")
    }
    receiver = places["receiver"]
    sources = {s: at for s, at in places.items() if s.startswith("S") and not s.startswith("SBG")}
    speakers = {
        s: rt.Directivity(index=INDEX, aim=tuple(np.subtract(receiver, at).tolist()))
        for s, at in sources.items()
    }
    return PathTracing(
        geometry=Polyhedron.shoebox(LABORATORY, "all"),
        room=box("laboratory", LABORATORY, OCTAVES),
        sources=sources,
        receivers={"M": receiver},
        directivity=speakers if stated else {},
        scattering=0.3,
        n_paths=n_paths,
        workers=1,
    )


def surfaces(seed: int = FIRST) -> None:
    """On which walls of the laboratory, with the directivity and without."""
    for change, walls in WALLS.items():
        a, b = change.split(" to ")
        for stated in (True, False):
            model = aimed_simulator(stated)
            finding = rt.find(
                model.room, all_parameters(b), model, before=all_parameters(a), seed=seed
            )
            claimed = set(finding.claimed_surfaces)
            said = ", ".join(f"{n} {p:.2f}" for n, p in finding.surfaces.items() if p >= 0.03)
            print(
                f"| {change} | {'stated' if stated else 'unstated'} | {len(walls)} | "
                f"{len(claimed & walls)} | {len(claimed - walls)} | {said or 'none told'} |",
                flush=True,
            )


def worlds(number: int = 12) -> None:
    """One wall or two of a box change; paths of other seeds, another scattering, other coefficients."""
    right = wrong = changed = 0
    for i in range(number):
        rng = np.random.default_rng(FIRST + i)
        room = test_where.stated()
        truth = test_where.tracing(
            room, scattering=float(rng.uniform(0.2, 0.6)), n_paths=9600, sources=test_walls.PLACES
        )
        rows = rng.permutation(6)[: 1 + i % 2]
        names = {SHOEBOX_WALLS[r] for r in rows}
        share = float(rng.uniform(0.15, 0.7))
        base = room.alpha * np.exp(0.25 * rng.standard_normal((6, 1)))
        states = [
            test_walls.noisy(test_where.heard(truth, base), rng),
            test_walls.noisy(test_where.heard(truth, test_walls.moved(base, rows, share)), rng),
        ]
        model = test_walls.simulator(dict.fromkeys(test_walls.PLACES, test_walls.POINT))
        finding = rt.find(model.room, states[1], model, before=states[0], seed=i)
        claimed = set(finding.claimed_surfaces)
        changed += len(names)
        right += len(claimed & names)
        wrong += len(claimed - names)
        print(
            f"| {', '.join(sorted(names))} | {share:.2f} | {', '.join(sorted(claimed))} |",
            flush=True,
        )
    print(f"claimed right {right} of {changed}, wrong {wrong}")


def seconds() -> None:
    """Time of one search, of 30 pairs and of means."""
    room = box("laboratory", LABORATORY, OCTAVES)
    two = [laboratory(s) for s in ("000", "R")]
    rt.find(room, two[1], before=two[0])
    for name, (a, b) in {
        "30 pairs": two,
        "4 pairs": [laboratory(s, aimed=False) for s in ("000", "100")],
    }.items():
        begin = time.process_time()
        rt.find(room, b, before=a)
        print(f"{name}: {time.process_time() - begin:.1f} s of processor time")


if __name__ == "__main__":
    parts = {
        "real": real,
        "surfaces": surfaces,
        "worlds": worlds,
        "controls": controls,
        "hidden": hidden,
        "climates": climates,
        "time": seconds,
    }
    for name in sys.argv[1:] or parts:
        parts[name]()
