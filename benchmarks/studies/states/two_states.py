"""The change between two measurements in real rooms: `python -m benchmarks.studies.states.two_states`.

This folder's README.md has its output. The data are read from the shared folder beside the checkout.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

import rtcal as rt
from benchmarks.studies.means import real_data as data
from rtcal.finder.finding import Finding
from rtcal.support.types import Array

LABORATORY = (9.7, 5.5, 2.7)
STATES = ("000", "050", "100", "R")
OCTAVES = np.array([125.0, 250, 500, 1000, 2000, 4000, 8000])
STEPS = ("000000", "011000", "011100", "011110", "011111")
"""dEchorate's panels, turned one after the other (floor, ceiling, west, south, east, north)."""


def one_material(name: str, volume: float, area: float, frequencies: Array) -> rt.Room:
    """Return a room of which nothing but volume and area is stated."""
    n = len(frequencies)
    return rt.Room(
        name=name,
        volume=volume,
        materials=["all"],
        areas=[area],
        alpha=[[0.2] * n],
        sigma=[[0.1] * n],
        centre_frequencies=frequencies,
        air=rt.Air(),
    )


def box(name: str, sides: tuple[float, float, float], frequencies: Array) -> rt.Room:
    x, y, z = sides
    return one_material(name, x * y * z, 2 * (x * y + x * z + y * z), frequencies)


def laboratory(state: str, aimed: bool = True) -> rt.Measurement:
    """Return T20 of the loudspeakers, or of the omnidirectional sources."""
    rows = [
        r
        for r in data.lines("r3vival", f"{state}.csv", parameter="t20")
        if r["source"].startswith("SBG") != aimed
    ]
    return rt.Measurement(
        centre_frequencies=OCTAVES,
        values={"t20": [data.numbers(r, [f"{f:.0f}" for f in OCTAVES]) for r in rows]},
        pairs=[(r["source"], "M") for r in rows],
    )


def dechorate() -> dict[str, rt.Measurement]:
    """Return T of each state, as means over 6 sources and 30 microphones."""
    return {
        state: rt.Measurement(
            centre_frequencies=data.DECHORATE_BANDS,
            values={"t20": [t]},
            n_sources=6,
            n_receivers=30,
        )
        for state, t in data.dechorate_times().items()
    }


def ptb(curtains: str) -> rt.Measurement:
    """Return T30 of six pairs with the standard deviation over the teams."""
    return data.ptb_measured(curtains, parameters=("t30",)).measured


def studio() -> rt.Room:
    """Return PTB's studio: 383 m³, with the areas that its materials state."""
    rows = data.lines("ptb_studio", "materials.csv", state="both")
    area = sum(float(r["area_m2"]) for r in rows)
    return one_material("PTB studio", data.PTB_VOLUME, area, ptb("open").centre_frequencies)


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


def table(
    title: str, room: rt.Room, states: dict[str, rt.Measurement], changes: Iterable[tuple[str, str]]
) -> None:
    """Print each change from one state to another."""
    print("| change | nats | verdict | family | Eyring / m² | found / m² (90 %) | ratio |")
    print("|---|---|---|---|---|---|---|")
    done = [
        line(f"{title} {a} to {b}", rt.find(room, states[b], before=states[a])) for a, b in changes
    ]
    print(f"detected {sum(done)} of {len(done)}\n")


def main() -> None:
    """Every ordered pair of measured states."""
    measured = {state: laboratory(state) for state in STATES}
    room = box("laboratory", LABORATORY, OCTAVES)
    table("laboratory,", room, measured, itertools.permutations(STATES, 2))
    curtains = {state: ptb(state) for state in ("open", "closed")}
    table("curtain", studio(), curtains, itertools.permutations(curtains, 2))
    states = dechorate()
    small = box("dEchorate", (5.705, 5.965, 2.355), states[STEPS[0]].centre_frequencies)
    singles = [(STEPS[0], code) for code in states if code.count("1") == 1]
    for steps in (list(itertools.pairwise(STEPS)), singles):
        table("dEchorate,", small, states, [*steps, *((b, a) for a, b in steps)])


if __name__ == "__main__":
    main()
