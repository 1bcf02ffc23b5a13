"""Say where: the wall of a shoebox on which something stands, and what follows from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.errors import DataError
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.where.patch import patched

pytest.importorskip("numba", reason="the paths are traced by compiled code (extra fast)")

BANDS = (500.0, 1000.0, 2000.0)
SIZE = (7.0, 5.0, 3.0)
SOURCES = {"S1": (1.2, 1.0, 1.5), "S2": (5.6, 3.9, 1.4)}
RECEIVERS = {"R1": (5.5, 1.2, 1.2), "R2": (3.4, 2.4, 1.3), "R3": (1.5, 3.8, 1.2)}
ALPHA = {
    "west": 0.06,
    "east": 0.12,
    "south": 0.08,
    "north": 0.05,
    "floor": 0.10,
    "ceiling": 0.15,
}
MATCH = ("t20", "edt", "c80", "ts", "level")
HIDDEN = 4.0  # m², an opening in the middle of the east wall of 15 m²


def stated() -> rt.Room:
    box = Polyhedron.shoebox(SIZE, {w: f"{w} wall" for w in SHOEBOX_WALLS})
    alpha = np.array([[ALPHA[w]] * len(BANDS) for w in SHOEBOX_WALLS])
    return rt.Room(
        name="box",
        volume=box.volume,
        materials=[f"{w} wall" for w in SHOEBOX_WALLS],
        areas=box.face_areas,
        alpha=alpha,
        sigma=0.01 + 0.07 * alpha,
        centre_frequencies=BANDS,
        air=rt.Air(20, 50),
        surfaces=box.surfaces,
        dimensions=SIZE,
    )


def tracing(room: rt.Room, geometry: Polyhedron | None = None, **options: object) -> PathTracing:
    settings = {"n_paths": 1600, "scattering": 0.4} | options
    box = Polyhedron.shoebox(SIZE, {w: f"{w} wall" for w in SHOEBOX_WALLS})
    return PathTracing(
        geometry=geometry or box, room=room, sources=SOURCES, receivers=RECEIVERS, **settings
    )


def heard(tracer: PathTracing, alpha: np.ndarray, level: str = "g") -> rt.Measurement:
    """Return what a tracing measures, with the noise of 2 %."""
    seen = tracer.observe(alpha, MATCH, seed=7)
    rng = np.random.default_rng(3)
    values = {}
    for p in MATCH:
        noise = rng.standard_normal(seen.natural(p).shape)
        values[level if p == "level" else p] = (
            seen.natural(p) + 0.1 * noise
            if p in ("c80", "level")
            else seen.natural(p) * (1 + 0.02 * noise)
        )
    return rt.Measurement(centre_frequencies=BANDS, pairs=seen.pairs, values=values)


def measured(hidden: bool, level: str = "g") -> rt.Measurement:
    """Return a measurement in the box, with other scattering; with or without the opening."""
    room = stated()
    tracer = tracing(room)
    geometry, alpha = tracer.geometry, room.alpha
    if hidden:
        made = patched(geometry, 1, HIDDEN, "hole", "hole")
        assert made is not None
        areas = np.append(room.areas, HIDDEN)
        areas[1] -= HIDDEN
        alpha = np.vstack([alpha, np.ones(len(BANDS))])
        room = room.replace(
            materials=[*room.materials, "hole"],
            areas=areas,
            alpha=alpha,
            sigma=np.vstack([room.sigma, room.sigma[:1]]),
            surfaces=(),
        )
        geometry = made
    return heard(tracing(room, geometry, scattering=0.5, n_paths=6400), alpha, level)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def finding(cache: Path) -> rt.where.Finding:
    case = rt.where.Case(simulator=tracing(stated()), measured=measured(True))
    return rt.where.find(case, cache=cache)


def test_an_opening_is_found_on_its_wall(finding: rt.where.Finding) -> None:
    assert finding.detected
    assert next(iter(finding.surfaces)) == "east"
    best = finding.best
    assert best is not None
    assert best.surface == "east"
    assert best.low < HIDDEN < best.high
    assert finding.family is not None
    assert finding.family.startswith("added absorption")


def test_nothing_is_found_where_nothing_is_hidden(cache: Path) -> None:
    case = rt.where.Case(simulator=tracing(stated()), measured=measured(False))
    finding = rt.where.find(case, cache=cache)
    assert finding.verdict in ("none", "hint")
    assert finding.surface is None
    with pytest.raises(DataError, match="no surface lacks anything"):
        finding.apply()
