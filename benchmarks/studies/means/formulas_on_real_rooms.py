"""Does every reverberation formula predict T within 10 % once alpha is known? On measured rooms.

    python -m benchmarks.studies.means.formulas_on_real_rooms [store]

prints the stored errors; `store` computes them anew, which takes the data.

Prawda, Schlecht and Välimäki (2022, J. Acoust. Soc. Am. 152, 1004) say that Sabine's and Eyring's
errors are mostly those of the coefficients. Here the coefficients are fitted with a formula to some
states of a room, and the same or another formula predicts T of a state that was left out.

dEchorate: ten states of a box whose panels were turned; three coefficients per band (floor, absorbing
and reflecting panel), fitted to nine states, predict the tenth. PTB's studio: all materials fitted to
the curtains open predict the curtains drawn, and the other way round; the curtain's coefficients are
the table's. Only its areas are known, not their axes, which Fitzroy and Arau-Puchades need. BRAS: the
published coefficients, which were fitted with Eyring's formula, and every formula on the same state.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import rtcal as rt
from benchmarks.studies.means import real_data as data
from rtcal.acoustics.equations import EQUATIONS, Equation
from rtcal.acoustics.room import Surface
from rtcal.support.types import Array

MEAN = ("sabine", "eyring", "millington", "kuttruff")
ALL = (*MEAN, "fitzroy", "arau")
MEASURED = 0.01
"""Relative uncertainty of T in the fits, small beside the coefficients' 30 %."""
STORED = Path(__file__).with_suffix(".json")


def formula(key: str) -> Equation:
    return EQUATIONS[key]()


def fitted(
    key: str,
    rooms: Sequence[rt.Room],
    which: Sequence[Array],
    times: Sequence[Array],
    mu: Array,
    sigma: Array,
) -> Array:
    """Coefficients (n, n_bands), common to the rooms, that give these T after the formula.

    ``which`` has per room the coefficient of each of its materials. Least squares of ln T, with the
    prior mu ± sigma, from 0.005 to 0.98.
    """

    def misfit(flat: Array) -> Array:
        alpha = flat.reshape(mu.shape)
        off = [
            (np.log(formula(key).reverberation_time(r.replace(alpha=alpha[i]))) - np.log(t))
            / MEASURED
            for r, i, t in zip(rooms, which, times, strict=True)
        ]
        return np.concatenate([*(o.ravel() for o in off), ((alpha - mu) / sigma).ravel()])

    start = np.clip(mu, 0.01, 0.97).ravel()
    return np.asarray(least_squares(misfit, start, bounds=(0.005, 0.98)).x.reshape(mu.shape))


def error(key: str, room: rt.Room, alpha: Array, times: Array) -> Array:
    return np.asarray(formula(key).reverberation_time(room.replace(alpha=alpha)) / times - 1)


def dechorate_box(state: str) -> tuple[rt.Room, Array]:
    """The room, each wall a material, and which coefficient each has: floor, absorbing, reflecting."""
    surfaces = [
        Surface(name=p, material=p, area=float(a), axis=x)
        for p, a, x in zip(data.PANELS, data.PANEL_AREAS, "zzxyxy", strict=True)
    ]
    shape = (len(data.PANELS), len(data.DECHORATE_BANDS))
    room = rt.Room(
        name=state,
        volume=data.DECHORATE_VOLUME,
        materials=data.PANELS,
        areas=data.PANEL_AREAS,
        alpha=np.full(shape, 0.3),
        sigma=np.full(shape, 0.3),
        surfaces=surfaces,
        air=rt.Air(20.0, 50.0),
        centre_frequencies=data.DECHORATE_BANDS,
    )
    return room, np.array([0, *(2 if d == "1" else 1 for d in state[1:])])


def dechorate() -> dict[str, dict[str, Array]]:
    """Errors by fitting formula and predicting formula, of the states left out."""
    times = data.dechorate_times()
    mu = np.tile(np.array([[0.3], [0.5], [0.1]]), (1, len(data.DECHORATE_BANDS)))
    out: dict[str, dict[str, Array]] = {}
    for key in ALL:
        errors: dict[str, list[Array]] = {k: [] for k in ALL}
        for state in times:
            others = [s for s in times if s != state]
            boxes, which = zip(*(dechorate_box(s) for s in others), strict=True)
            wanted = [times[s] for s in others]
            alpha = fitted(key, boxes, which, wanted, mu, np.full(mu.shape, 0.5))
            room, index = dechorate_box(state)
            for other in ALL:
                errors[other].append(error(other, room, alpha[index], times[state]))
        out[key] = {k: np.array(v) for k, v in errors.items()}
    return out


def ptb() -> dict[str, dict[str, Array]]:
    """Errors by fitting formula and predicting formula, of the state that was not fitted."""
    curtains = {"open": "curtain(open)", "closed": "curtain(closed)"}
    out: dict[str, dict[str, Array]] = {}
    for key in MEAN:
        errors: dict[str, list[Array]] = {k: [] for k in MEAN}
        for known, other in (("open", "closed"), ("closed", "open")):
            room, left = (data.ptb_room((curtains[s],)) for s in (other, known))
            t, wanted = (data.ptb_measured(s).measured.mean("t30") for s in (known, other))
            every = np.arange(room.n_materials)
            alpha = fitted(key, [room], [every], [t], room.alpha, room.sigma)
            carried = left.alpha.copy()
            for i, name in enumerate(room.materials):
                if name != curtains[known]:
                    carried[left.material_index(name)] = alpha[i]
            for k in MEAN:
                errors[k].append(error(k, left, carried, wanted))
        out[key] = {k: np.array(v) for k, v in errors.items()}
    return out


def bras() -> dict[str, dict[str, Array]]:
    """Errors with the fitted coefficients in the 24 third-octaves that were measured."""
    found: dict[str, list[Array]] = {k: [] for k in MEAN}
    for name in ("CR2", "CR3"):
        rows = [r for r in data.lines("bras", "measured_third_octave.csv") if r["room"] == name]
        t20 = next(r for r in rows if r["parameter"] == "T20")
        room = data.bras_room(name, "fitted")
        bands = [b for b in t20 if b.isdigit()]
        thirds = {
            r["material"]: [float(r[b]) for b in bands]
            for r in data.lines("bras", "absorption_third_octave.csv")
            if r["room"] == name and r["set"] == "fitted"
        }
        alpha = np.array([thirds[m] for m in room.materials])
        full = room.replace(alpha=alpha, sigma=alpha, centre_frequencies=[float(b) for b in bands])
        times = np.array([float(t20[b]) for b in bands])
        for key in MEAN:
            found[key].append(error(key, full, alpha, times))
    return {"eyring": {k: np.array(v) for k, v in found.items()}}


def line(fit: str, predict: str, errors: Array) -> str:
    size = np.abs(errors)
    return (
        f"  {fit:11} {predict:11} within 10 %: {np.mean(size <= 0.1):5.2f} of {errors.size:3}   "
        f"mean {100 * size.mean():5.1f} %   bias {100 * errors.mean():+6.1f} %   "
        f"most {100 * size.max():5.1f} %"
    )


def compute() -> dict[str, Any]:
    """Return the errors of T by room, formula of the fit and formula of the prediction."""
    return {
        "dEchorate, one of ten states left out": dechorate(),
        "PTB studio, the other state of the curtains": ptb(),
        "BRAS CR2 and CR3, the state that was fitted": bras(),
    }


def store() -> None:
    """Write the errors for those who do not have the data."""
    rooms = {
        name: {
            fit: {k: v.ravel().round(5).tolist() for k, v in row.items()} for fit, row in of.items()
        }
        for name, of in compute().items()
    }
    STORED.write_text(json.dumps(rooms, indent=1) + "\n", encoding="utf-8")


def print_all() -> None:
    """Print the stored errors."""
    for name, table in json.loads(STORED.read_text(encoding="utf-8")).items():
        print(f"\n{name}: fitted with, predicted with")
        for fit, row in table.items():
            for predict, errors in row.items():
                if fit == predict or fit == "eyring":
                    print(line(fit, predict, np.array(errors)))


if __name__ == "__main__":
    if "store" in sys.argv[1:]:
        store()
    print_all()
