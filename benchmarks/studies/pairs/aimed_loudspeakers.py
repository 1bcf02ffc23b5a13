"""Aimed loudspeakers in a laboratory where nothing is hidden: is something claimed of the room?

    python -m benchmarks.studies.pairs.aimed_loudspeakers FOLDER [12] [30]

State 000 of R3VIVAL (CC BY 4.0): two-way loudspeakers that aim at the one receiver, twelve at 2 m or
all thirty. What is assumed of the materials gives Eyring's T of the omnidirectional sources near the
corners, which are not searched: alike on all surfaces, more on the ceiling, or more on the walls. The
directivity is not stated, stated as unknown, or stated: an index that was fitted to direct over late
energy. FOLDER keeps simulations, and a row of each case.
"""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path

import numpy as np

import rtcal as rt
from benchmarks.studies.states.two_states import (
    INDEX,
    LABORATORY,
    OCTAVES,
    aimed_simulator,
    all_parameters,
    laboratory,
)
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.geometry import SHOEBOX_WALLS

ASSUMED = {"alike": (1.0, 1.0, 1.0), "ceiling": (0.6, 2.2, 0.8), "walls": (0.5, 0.5, 1.6)}
"""Share of the mean coefficient: of the floor, the ceiling and the walls."""
STATED = ("not stated", "unknown", "stated")
BANDS = slice(1, 6)
"""250 Hz to 4 kHz: 125 Hz is modal, and nothing is known of the index at 8 kHz."""


def room(assumed: str) -> rt.Room:
    """Return the laboratory with the coefficients that are assumed, for T of the other sources."""
    x, y, z = LABORATORY
    areas = np.array([x * y, x * y, 2 * z * (x + y)])
    t = np.nanmean(laboratory("000", aimed=False).values["t20"], axis=0)[BANDS]
    names = ["floor", "ceiling", "walls"]
    stated = rt.Room(
        name=f"laboratory, {assumed}",
        volume=x * y * z,
        dimensions=LABORATORY,
        materials=names,
        areas=areas,
        alpha=np.full((3, len(t)), 0.2),
        sigma=np.full((3, len(t)), 0.05),
        centre_frequencies=OCTAVES[BANDS],
        air=rt.Air(),
    )
    share = np.array(ASSUMED[assumed])
    mean = rt.Eyring().absorption_area(stated, t) / (areas @ share)
    alpha = np.clip(share[:, None] * mean, 0.01, 0.95)
    return stated.replace(alpha=alpha, sigma=np.maximum(0.3 * alpha, 0.02))


def simulator(assumed: str, stated: str, distance: str) -> PathTracing:
    """Return the laboratory with the loudspeakers at a distance in cm; at all for an empty one."""
    places = aimed_simulator(stated=True, n_paths=800)
    sources = {s: p for s, p in places.sources.items() if s.endswith(distance)}
    index = INDEX[BANDS]
    lobes = {s: rt.Directivity(index=index, aim=places.directivity[s].aim) for s in sources}
    walls = dict.fromkeys(SHOEBOX_WALLS[:4], "walls") | {"floor": "floor", "ceiling": "ceiling"}
    return PathTracing(
        geometry=Polyhedron.shoebox(LABORATORY, walls),
        room=room(assumed),
        sources=sources,
        receivers=places.receivers,
        directivity={
            "not stated": {},
            "unknown": dict.fromkeys(sources, "unknown"),
            "stated": lobes,
        }[stated],
        scattering=0.3,
        n_paths=1600,
        workers=1,
    )


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for number, assumed, stated in itertools.product(sys.argv[2:] or ("12", "30"), ASSUMED, STATED):
        path = folder / f"{number} {assumed} {stated}.json"
        if not path.exists():
            model = simulator(assumed, stated, "-200" if number == "12" else "")
            every = all_parameters("000")
            pairs = [p for p in every.pairs if p[0] in model.sources]
            found = rt.find(model.room, every.select(pairs), model, cache=folder / "kept")
            path.write_text(json.dumps(found.to_dict() | {"headline": found.headline}))
        row = json.loads(path.read_text())
        best = max(row["probabilities"], key=row["probabilities"].get)
        print(
            f"| {number} | {assumed} | {stated} | {row['score']:+.1f} | {row['threshold']:.1f} | "
            f"{row['verdict']} | {row['family'] or '-'} | {best} {row['probabilities'][best]:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
