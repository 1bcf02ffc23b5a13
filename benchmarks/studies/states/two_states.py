"""The change between two measurements in real rooms: `python -m benchmarks.studies.states.two_states`.

This folder's README.md has its output. The data are read from the shared folder beside the checkout.
"""

from __future__ import annotations

import itertools

import numpy as np

import rtcal as rt
from benchmarks.studies.means.real_data import lines
from rtcal.finder.finding import Finding
from rtcal.support.types import Array

LABORATORY = (9.7, 5.5, 2.7)
STATES = ("000", "050", "100", "R")
OCTAVES = np.array([125.0, 250, 500, 1000, 2000, 4000, 8000])
STEPS = ("000000", "011000", "011100", "011110", "011111")
"""dEchorate's panels, turned one after the other (floor, ceiling, west, south, east, north)."""


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


if __name__ == "__main__":
    real()
