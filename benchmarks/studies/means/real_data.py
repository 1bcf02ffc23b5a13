"""Measured rooms as rtcal's objects: PTB's studio, dEchorate, BRAS' CR2 and CR3, a coupled room.

The data are not shipped. `DATA` is the folder of tables beside the repository. The pairs of the BRAS
rooms and the response of the coupled room are read from its folder `more`
(`benchmarks/studies/means/real_rooms.py` says where they come from). A loader raises FileNotFoundError.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import rtcal as rt
from rtcal.finder import Configuration
from rtcal.support.types import Array

DATA = Path(os.environ.get("RTCAL_SHARED_DATA", Path(__file__).parents[4] / "shared" / "data"))
OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)


def lines(*parts: str, **only: str) -> list[dict[str, str]]:
    """Return the lines of a table whose columns have these values."""
    with DATA.joinpath(*parts).open(newline="", encoding="utf-8") as stream:
        return [r for r in csv.DictReader(stream) if only.items() <= r.items()]


def numbers(row: dict[str, str], columns: Sequence[Any]) -> Array:
    """Return the numbers of some columns; NaN where there is none."""
    return np.array([float(row[str(c)] or "nan") for c in columns])


def handbook_sigma(alpha: Array) -> Array:
    """30 %, at least 0.02."""
    return np.maximum(0.3 * alpha, 0.02)


def room_of(name: str, volume: float, areas: dict[str, Any], alpha: Array, **more: Any) -> rt.Room:
    """Return a room of these materials, with a handbook's sigma unless another is given."""
    given = {"sigma": handbook_sigma(alpha), "centre_frequencies": OCTAVES, **more}
    return rt.Room(
        name=name,
        volume=volume,
        materials=list(areas),
        areas=list(areas.values()),
        alpha=alpha,
        **given,
    )


# PTB's studio -------------------------------------------------------------------------------------

PTB_VOLUME = 383.0
PTB_AIR = rt.Air(20.0, 50.0)
PTB_KEYS = {"t30": "T30", "edt": "EDT", "c80": "C", "g": "G"}


def ptb_materials() -> dict[str, tuple[float, Array]]:
    """Area in m² and coefficients by material; both sides of a curtain count."""
    return {
        r["material"]: (
            float(r["area_m2"]) * int(r["sides"]),
            numbers(r, [f"alpha_{f:.0f}" for f in OCTAVES]),
        )
        for r in lines("ptb_studio", "materials.csv")
    }


def ptb_room(left_out: Sequence[str], air: rt.Air | None = PTB_AIR) -> rt.Room:
    """The studio without the materials named."""
    every = {k: v for k, v in ptb_materials().items() if k not in left_out}
    areas, alpha = {k: s for k, (s, _) in every.items()}, np.array([a for _, a in every.values()])
    return room_of("PTB studio", PTB_VOLUME, areas, alpha, air=air)


def ptb_measured(
    curtains: str,
    *,
    parameters: Sequence[str] = ("t30", "edt"),
    uncertainty: bool = True,
    sources: Sequence[str] = ("S1", "S2"),
    **more: Any,
) -> Configuration:
    """Means over the teams per pair; their standard deviation over the teams is the uncertainty."""
    rows = {
        (r["quantity"], r["pair"], float(r["band_hz"])): numbers(r, ("mean", "std_over_teams"))
        for r in lines("ptb_studio", "measured.csv", curtains=curtains)
    }
    pairs = [(s, r) for s in sources for r in ("R1", "R2", "R3")]
    table = {
        p: np.array([[rows[PTB_KEYS[p], s + r, f] for f in OCTAVES] for s, r in pairs])
        for p in parameters
    }
    places = {
        r["name"]: numbers(r, ("x_m", "y_m", "z_m")) for r in lines("ptb_studio", "positions.csv")
    }
    measured = rt.Measurement(
        centre_frequencies=np.array(OCTAVES),
        values={p: v[..., 0] for p, v in table.items()},
        uncertainty={p: v[..., 1] for p, v in table.items()} if uncertainty else {},
        pairs=pairs,
    )
    distances = np.array([np.linalg.norm(places[s] - places[r]) for s, r in pairs])
    return Configuration(
        **{"name": "measured", "measured": measured, "distances": distances, **more}
    )


# dEchorate ----------------------------------------------------------------------------------------

PANEL_AREAS = np.array([34.03, 34.03, 14.05, 13.44, 14.05, 13.44])
DECHORATE_VOLUME = 80.14
DECHORATE_BANDS = (500.0, 1000.0, 2000.0, 4000.0)
"""The published T60 begins at 500 Hz."""


def dechorate_times() -> dict[str, Array]:
    """Published T60 in s, (n_bands,), by state: one digit per panel, 1 where it reflects."""
    key = "code_floor_ceiling_west_south_east_north"
    return {
        r[key]: numbers(r, [f"{f:.0f}" for f in DECHORATE_BANDS])
        for r in lines("dechorate", "t60.csv", estimator="published")
        if "2" not in r[key]
    }


def dechorate_areas(state: str) -> Array:
    """Areas of floor, absorbing panels and reflecting panels."""
    turned = np.array([d == "1" for d in state])
    rest = PANEL_AREAS[1:]
    return np.array([PANEL_AREAS[0], rest[~turned[1:]].sum(), rest[turned[1:]].sum()])


def dechorate_alpha() -> Array:
    """Coefficients (3, n_bands) of floor, absorbing and reflecting panels that fit all states best.

    By least squares of ln T after Eyring, band by band, from 0.01 to 0.99.
    """
    times = dechorate_times()
    areas, total = np.array([dechorate_areas(s) for s in times]), PANEL_AREAS.sum()

    def misfit(alpha: Array, wanted: Array) -> Array:
        exponent = -np.log(1 - areas @ alpha / total)
        return np.asarray(np.log(0.161 * DECHORATE_VOLUME / (total * exponent)) - wanted)

    start, bounds = [0.3, 0.6, 0.1], (0.01, 0.99)
    return np.transpose(
        [
            least_squares(misfit, start, bounds=bounds, args=(wanted,)).x
            for wanted in np.log([*times.values()]).T
        ]
    )


def dechorate_room(state: str) -> rt.Room:
    """The room in a state, with the coefficients that fit all unfurnished states; sigma 20 %."""
    areas = dechorate_areas(state)
    names = ("floor", "absorbing panels", "reflecting panels")
    used = {n: a for n, a in zip(names, areas, strict=True) if a > 0}
    alpha = dechorate_alpha()[areas > 0]
    return room_of(
        f"dEchorate {state}",
        DECHORATE_VOLUME,
        used,
        alpha,
        sigma=np.maximum(0.2 * alpha, 0.02),
        air=rt.Air(20.0, 50.0),
        centre_frequencies=DECHORATE_BANDS,
    )


def dechorate_measured(state: str, name: str, removed: bool) -> Configuration:
    measured = rt.Measurement.from_values(DECHORATE_BANDS, t20=dechorate_times()[state])
    return Configuration(name=name, measured=measured, suspect_removed=removed)


# BRAS ---------------------------------------------------------------------------------------------

CR2_SOURCES = {"LS1": (0.931, -2.547, 0.723), "LS2": (0.119, 2.880, 0.723)}
CR2_RECEIVERS = {
    f"MP{i}": (x, y, 1.230)
    for i, (x, y) in enumerate(
        [(-0.993, 1.426), (0.439, -0.147), (1.361, -0.603), (-1.110, -0.256), (-0.998, -1.409)], 1
    )
}
THIRDS = (
    (100, 125, 160), (200, 250, 315), (400, 500, 630),
    (800, 1000, 1250), (1600, 2000, 2500), (3150, 4000, 5000),
)  # fmt: skip
"""Of each octave."""


def bras_room(name: str, coefficients: str) -> rt.Room:
    """CR2 or CR3 in octaves: "initial" (sigma 30 %, at least 0.02) or "fitted" (10 %)."""
    (facts,) = lines("bras", "rooms.csv", room=name)
    areas = {r["material"]: float(r["area_m2"]) for r in lines("bras", "surfaces.csv", room=name)}
    table = lines("bras", "absorption_third_octave.csv", room=name, set=coefficients)
    thirds = {r["material"]: r for r in table}
    alpha = np.array([[np.mean(numbers(thirds[m], ts)) for ts in THIRDS] for m in areas])
    more = {} if coefficients == "initial" else {"sigma": np.maximum(0.1 * alpha, 0.005)}
    air = rt.Air(float(facts["temperature_C"]), float(facts["rel_humidity_pct"]))
    return room_of(f"BRAS {name}", float(facts["volume_m3"]), areas, alpha, air=air, **more)


def bras_measured(name: str, pairs: Sequence[str] | None = None) -> Configuration:
    """T20, EDT, T30 and C80 of the ten pairs, or of those named.

    Without 8 kHz: there the file differs from BRAS' own third-octaves (EDT 0.96 and 0.90 s in CR2).
    """
    path = DATA / "more" / f"bras-{name.lower()}" / "measured.json"
    table = json.loads(path.read_text(encoding="utf-8"))
    which = [table["bandCentres"].index(int(f)) for f in OCTAVES]
    chosen = list(table["pairs"]) if pairs is None else list(pairs)
    values = {
        p: np.array([[table["pairs"][c]["parameters"][k][p] for k in which] for c in chosen])
        for p in ("t20", "edt", "t30", "c80")
    }
    named = [(c.split("-")[0], c.split("-")[1]) for c in chosen]
    distances = None
    if name == "CR2":
        distances = np.array(
            [np.linalg.norm(np.subtract(CR2_SOURCES[s], CR2_RECEIVERS[r])) for s, r in named]
        )
    measured = rt.Measurement(centre_frequencies=np.array(OCTAVES), values=values, pairs=named)
    return Configuration(name="measured", measured=measured, distances=distances)


# One response, in a room that is stated to fit its T: only the decay's shape speaks. ---------------


def decay_alone(configuration: Configuration) -> Configuration:
    """T20, EDT and T30 of a configuration, without their uncertainty."""
    measured = configuration.measured
    kept = {p: measured.values[p] for p in ("t20", "edt", "t30")}
    return replace(configuration, measured=replace(measured, values=kept, uncertainty={}))


def coupled_response() -> Configuration:
    """The response from a meeting room to the hallway, 125 Hz to 4 kHz."""
    from rtcal.io import impulse_responses

    path = DATA / "more" / "meetingroom_to_hallway_290cm.wav"
    if not path.exists():
        raise FileNotFoundError(path)
    measured = impulse_responses.read(str(path), bands=OCTAVES).measurement
    return Configuration(name="measured", measured=measured)


def nominal_room(name: str, times: Array) -> rt.Room:
    """A box of 200 m³ whose coefficients give these T after Eyring, sigma 10 %.

    So T says nothing, and the decay's shape everything.
    """
    x, y, z = 8.0, 7.8, 3.2
    area, volume = 2 * (x * y + x * z + y * z), x * y * z
    areas = {"floor": x * y, "walls": 2 * (x + y) * z, "ceiling": x * y}
    empty = room_of(name, volume, areas, np.full((3, len(OCTAVES)), 0.1), air=rt.Air(21.0, 45.0))
    absorbed = 24 * np.log(10) / empty.speed_of_sound * volume / times
    exponent = (absorbed - 4 * empty.air_attenuation * volume) / area
    alpha = np.tile(np.clip(1 - np.exp(-exponent), 0.01, 0.99), (3, 1))
    return empty.replace(alpha=alpha, sigma=0.1 * alpha)
