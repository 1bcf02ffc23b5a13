"""The finder's verdict on PTB's studio: the model has its curtains open, they were measured closed.

    python -m benchmarks.studies.pairs.where_ptb run --folder out  # rtcal's model, then 21 others
    python -m benchmarks.studies.pairs.where_ptb run --folder out --only own  # rtcal's model alone
    python -m benchmarks.studies.pairs.where_ptb table --folder out
    python -m benchmarks.studies.pairs.where_ptb told --folder out  # the bound: the change is told

Two sources and three receivers, six octaves (Bork 2005). The closed curtains hang 0.24 m before
the wall y = 0 (40.2 m²) and 0.29 m before x = -4.19 (17.3 m²); the model has their 13.9 m² gathered.
Right is the wall y = 0. ``own`` is rtcal's simulation of the round robin's geometry and materials, a
number is that participant's simulation of the open state, with rtcal's derivatives. As a control each
model meets the measurement with the curtains open, in which nothing is hidden.

The data are not shipped: `benchmarks.studies.means.real_data` says where they are looked for. Sigma
of the coefficients is a handbook's, 30 % and at least 0.02; the uncertainty is the spread over the
teams.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.means.judging import FLAGS, families_of, rate
from benchmarks.studies.means.real_data import DATA, OCTAVES, PTB_AIR, handbook_sigma, lines
from benchmarks.studies.pairs.where import PATHS, plain, said
from benchmarks.studies.pairs.where_figures import MODELS, first
from rtcal.acoustics.observables import observable
from rtcal.finder.positions.posterior import flat
from rtcal.finder.positions.problem import PositionsProblem, problem_of
from rtcal.finder.positions.search import controls_of
from rtcal.finder.positions.weighing import BASE, Weighing, parameters, responses_of
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.support.types import Array

PAIRS = [(s, r) for s in ("S1", "S2") for r in ("R1", "R2", "R3")]
QUANTITIES = {"t30": ("T30", 1.0), "edt": ("EDT", 1.0), "c80": ("C", 1.0), "ts": ("TS", 0.001)}
LEVEL = {"g": ("G", 1.0)}
OWN = "own"
STATES = ("closed", "open")
AREA = 40.15
"""Of the curtain before y = 0, m²; both have 57.41."""
WITHIN = 0.4
WALL = "wall y = 0"
SLAB = 0.02
"""Thickness in m of the gathered curtains, which absorb on both sides."""
SPELLED = {
    "windowglass": "windowglas",
    "wood absorbers": "wood absorber",
    "curtain (closed)": "curtain(closed)",
}
"""Materials of the planes as the table of coefficients spells them."""
SURFACES = {
    WALL: ("2", "3"),
    "wall x = -4.19": ("4", "5"),
    "wall y = 9": ("6 left", "6 right"),
    "wall y = 9.66": ("9", "31"),
    "wall x = 4.19": ("10",),
    "floor": ("1", "36"),
    "panels of the ceiling": ("11", "12", "13", "14", "15", "16", "17", "18"),
    "ceiling": ("25",),
    "window y = 0": ("41",),
    "windows x = -4.19": ("51", "61", "71"),
    "window y = 9": ("8",),
    "windows of the ceiling": ("19", "20", "21", "22"),
}
"""Faces by surface; reveals, beams and the gathered curtains are none. A material's coplanar faces."""


def corners() -> dict[str, Array]:
    """Return the model's corners in m; those off their plane by up to 1 cm are put into it."""
    out = {
        r["corner"]: np.array([float(r[k]) for k in ("x_m", "y_m", "z_m")])
        for r in lines("ptb_studio", "corners.csv")
    }
    start, end = out["3"], out["5"]
    for name in ("28", "332", "333", "41", "42", "43", "44"):  # of the slanting wall
        share = (out[name][0] - start[0]) / (end[0] - start[0])
        out[name][1] = start[1] + share * (end[1] - start[1])
    out["24"][1], out["25"][1] = out["21"][1], out["22"][1]  # the ceiling's rim
    return out


def slab(name: str, material: str, points: Array) -> list[tuple[str, str, Array]]:
    """Return the six faces of a thin box in place of a rectangle, clear of the walls by 1 cm."""
    low, high = points.min(0), points.max(0)
    thin = int(np.argmin(high - low))
    for axis in range(3):
        if axis == thin:
            low[axis], high[axis] = low[axis] - SLAB / 2, high[axis] + SLAB / 2
        else:
            low[axis], high[axis] = low[axis] + 0.01, high[axis] - 0.01
    box = Polyhedron.shoebox(tuple(high - low), material)
    return [
        (f"{name} {i}", material, low + box.vertices[list(face)])
        for i, face in enumerate(box.faces)
    ]


def geometry(state: str = "open") -> Polyhedron:
    """Return the studio with its curtains open or closed."""
    at = corners()
    polygons: list[tuple[str, str, Array]] = []
    for row in lines("ptb_studio", "planes.csv"):
        points = np.array([at[c] for c in row["corners"].split()])
        name = row["plane"]
        material = SPELLED.get(row["material"], row["material"])
        if row["curtains"] == state:
            polygons += slab(name, material, points)
        elif row["curtains"] == "both" and name != "6":
            polygons.append((name, material, points))
        elif name == "6":  # its window, plane 8, is in its plane: the wall is two faces around it
            low, top = (0.5 * (at[a] + at[b]) for a, b in (("44", "41"), ("43", "42")))
            foot, head = low * [1, 1, 0], low * [1, 1, 0] + [0, 0, at["8"][2]]
            left = [at["3"], foot, low, at["44"], at["43"], top, head]
            left += [at[c] for c in ("8", "338", "333", "332", "77")]
            right = [foot, at["5"], at["10"], head, top, at["42"], at["41"], low]
            polygons.append(("6 left", material, np.array(left)))
            polygons.append(("6 right", material, np.array(right)))
    return Polyhedron.from_polygons(polygons)


def simulator(workers: int | None = None, state: str = "open") -> PathTracing:
    """Return the studio's path tracer with the round robin's coefficients.

    Scattering is the mean over the bands, so that all of them share their paths.
    """
    solid = geometry(state)
    table = {r["material"]: r for r in lines("ptb_studio", "materials.csv")}

    def of(kind: str) -> Array:
        return np.array(
            [[float(table[m][f"{kind}_{f:.0f}"]) for f in OCTAVES] for m in solid.areas]
        )

    alpha = of("alpha")
    room = rt.Room(
        name="PTB studio",
        volume=solid.volume,
        materials=list(solid.areas),
        areas=list(solid.areas.values()),
        alpha=alpha,
        sigma=handbook_sigma(alpha),
        air=PTB_AIR,
        scattering=np.repeat(of("scattering").mean(1)[:, np.newaxis], len(OCTAVES), axis=1),
        centre_frequencies=OCTAVES,
    )
    place = {
        r["name"]: np.array([float(r[k]) for k in ("x_m", "y_m", "z_m")])
        for r in lines("ptb_studio", "positions.csv")
    }
    return PathTracing(
        geometry=solid,
        room=room,
        sources={k: v for k, v in place.items() if k[0] == "S"},
        receivers={k: v for k, v in place.items() if k[0] == "R"},
        n_paths=PATHS,
        workers=workers,
    )


def measurement(rows: list[dict[str, str]], value: str, spread: str | None) -> rt.Measurement:
    """Return the pairs' values in rows of a table; quantities that a table lacks are left out."""
    at = {(r["quantity"], r["pair"], float(r["band_hz"])): r for r in rows}
    values, uncertainty = {}, {}
    for name, (quantity, unit) in {**QUANTITIES, **LEVEL}.items():
        if not any(key[0] == quantity for key in at):
            continue
        cells = [[at[quantity, s + r, f] for f in OCTAVES] for s, r in PAIRS]
        values[name] = unit * np.array([[float(c[value]) for c in row] for row in cells])
        if spread:
            uncertainty[name] = unit * np.array([[float(c[spread]) for c in row] for row in cells])
    return rt.Measurement(
        centre_frequencies=np.array(OCTAVES), values=values, uncertainty=uncertainty, pairs=PAIRS
    )


def measured(state: str) -> rt.Measurement:
    rows = [r for r in lines("ptb_studio", "measured.csv") if r["curtains"] == state]
    return measurement(rows, "mean", "std_over_teams")


def simulated(participant: str) -> rt.Measurement:
    """Return a participant's simulation with the curtains open."""
    rows = [
        r
        for r in lines("ptb_studio", "simulated.csv")
        if r["participant"] == participant and r["curtains"] == "open"
    ]
    return measurement(rows, "value", None)


def participants() -> list[str]:
    return list(dict.fromkeys(r["participant"] for r in lines("ptb_studio", "simulated.csv")))


def judged(model: str, state: str, folder: Path, workers: int | None) -> dict[str, Any]:
    """Return what is said of a model against the measurement in a state."""
    case = case_of(model, state, workers)
    clock, processor = time.perf_counter(), time.process_time()
    finding = rt.finder.positions.find(case, cache=folder / "controls")
    wall = case.geometry.names.index(SURFACES[WALL][0])
    row = {
        "model": model,
        "state": state,
        "seconds": time.perf_counter() - clock,
        "processor": time.process_time() - processor,
        **said(finding, case, wall),
    }
    if state == "closed" and finding.can_be_added:
        verification = rt.finder.positions.verify(finding, cache=folder / "controls")
        row["gaps"] = {model: float(verification.gap(model).mean()) for model in MODELS}
        row["by_parameter"] = verification.by_parameter
        row["ratio"] = verification.ratio
    return dict(plain(row))


def case_of(model: str, state: str, workers: int | None) -> rt.finder.positions.PositionsCase:
    """Return a model against the measurement in a state."""
    others = None if model == OWN else simulated(model)
    match = tuple(p for p in QUANTITIES if others is None or p in others.values)
    return rt.finder.positions.PositionsCase(
        simulator=simulator(workers),
        measured=measured(state),
        match=(*match, "level"),
        simulated=others,
        surfaces=SURFACES,
    )


def read(folder: Path) -> list[dict[str, Any]]:
    file = folder / "rows.jsonl"
    return [json.loads(r) for r in file.read_text("utf-8").splitlines()] if file.exists() else []


def run(folder: Path, only: str | None, workers: int | None) -> None:
    if not (DATA / "ptb_studio").exists():
        print(f"skipped: the studio's tables are not in {DATA}")
        return
    folder.mkdir(parents=True, exist_ok=True)
    done = {(r["model"], r["state"]) for r in read(folder)}
    for model in [only] if only else [OWN, *participants()]:
        for state in STATES:
            if (model, state) in done:
                continue
            row = judged(model, state, folder, workers)
            with (folder / "rows.jsonl").open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row, separators=(",", ":")) + "\n")
            print(model, state, row["verdict"], row["effect"], first(row), flush=True)


def told(folder: Path, only: str | None, workers: int | None) -> None:
    """Print the log likelihood ratio of the true change, told exactly, in nats.

    The change is what rtcal's tracing says of the model with its curtains closed, less that of the open
    one. Beside it stands what is to be expected of this ratio if the change and all errors are as
    assumed. With fewer errors it is what a better simulator, measurement or prior would give.
    """
    own = case_of(OWN, "closed", workers)
    names, controls = parameters(own), folder / "controls"
    runs = controls_of(own, cache=controls)
    made = responses_of(own, 0, controls)
    closed = simulator(workers, "closed")
    heard = Weighing(closed.denser(BASE), names).observe(Weighing(closed, names).alpha)
    print(f"{'nats: got / expected':28}" + "".join(f"{state:>16}" for state in STATES))
    others = []
    for model in [only] if only else [OWN, *participants()]:
        case = {state: case_of(model, state, workers) for state in STATES}
        numbers = {state: problem_of(case[state], made, runs) for state in STATES}
        columns = [
            ratios(numbers[state], made.parameters, made.base, heard, state == "closed")
            for state in STATES
        ]
        for name in columns[0] if model == OWN else ["all errors"]:
            print_ratios(f"{model}: {name}", [column[name] for column in columns])
        if model != OWN:
            others.append([column["all errors"] for column in columns])
    if others:
        print_ratios("others: median", np.median(others, axis=0))


def print_ratios(name: str, columns: Iterable[Iterable[float]]) -> None:
    """Print one line of `told`."""
    cells = (f"{got:8.1f} /{expected:6.1f}" for got, expected in columns)
    print(f"{name:28}" + "".join(cells), flush=True)


def ratios(
    numbers: PositionsProblem, names: Sequence[str], opened: Array, closed: Array, changed: bool
) -> dict[str, tuple[float, float]]:
    """Return the log likelihood ratio of a told change and its expectation, by the errors assumed.

    The last entry is chi-square per value with all errors, and 1, of what is measured less what is
    simulated: with the change where it is there (``changed``).
    """
    wanted = numbers.data.observations
    rows = [names.index(p) for p in wanted.parameters]
    change = [observable(names[r]).linear(closed[r], opened[r]) for r in rows]
    used = numbers.used
    shift, residual = flat(np.array(change))[used], numbers.residual[used]
    simulators = numbers.simulator_error() + numbers.levels.covariance
    prior = numbers.alpha @ numbers.alpha.T
    least = 0.01 * np.diag(np.diag(simulators + prior + numbers.measurement))
    errors = {
        "all errors": simulators + prior + numbers.measurement,
        "a perfect simulator": prior + numbers.measurement,
        "a perfect measurement": prior + simulators,
        "known coefficients": simulators + numbers.measurement,
    }
    out = {}
    for name, covariance in errors.items():
        pulled = np.linalg.solve((covariance + least)[np.ix_(used, used)], shift)
        expected = 0.5 * float(shift @ pulled)
        out[name] = (float(residual @ pulled) - expected, expected)
    left = residual - shift if changed else residual
    covariance = errors["all errors"][np.ix_(used, used)]
    out["chi-square per value"] = (float(left @ np.linalg.solve(covariance, left)) / len(left), 1.0)
    return out


def curtain(row: dict[str, Any]) -> bool:
    """Return whether a curtain, or its family, is what is said."""
    right = families_of(["curtain"])
    if row["verdict"] == "named":
        return row["effect"] == "curtain"
    if row["verdict"] == "family":
        return row["family"] in right
    return bool(row["best"]) and row["best"]["effect"] == "curtain"


def stated_beside_measured() -> None:
    """Print T of the stated coefficients by Eyring's equation beside T30 of both states, in s."""
    rows = {"stated, Eyring": rt.Eyring().reverberation_time(simulator(1).room)}
    for state in ("open", "closed"):
        rows[f"measured, {state}"] = measured(state).values["t30"].mean(axis=0)
    print(f"{'T / s':18}" + "".join(f"{f:8.0f}" for f in OCTAVES))
    for name, t in rows.items():
        print(f"{name:18}" + "".join(f"{value:8.2f}" for value in t))


def table(rows: list[dict[str, Any]]) -> None:
    """Print each case, and how often the curtain is found when the model is somebody else's."""
    for row in rows:
        best = row["best"] or {"effect": None, "surface": None, "size": [None] * 3}
        size = best["size"][0]
        area = f"{size:.0f} m²" if best["surface"] else ""
        gaps = " / ".join(f"{gap:.2f}" for gap in row.get("gaps", {}).values())
        print(
            f"{row['model']:>4} {row['state']:7}{row['verdict']:10}{best['effect']!s:16}"
            f"{first(row)!s:24}{area:8}{gaps}"
        )
    for model, words in ((True, "rtcal's model"), (False, "the participants' models")):
        chosen = [r for r in rows if (r["model"] == OWN) == model]
        closed = [r for r in chosen if r["state"] == "closed"]
        opened = [r for r in chosen if r["state"] == "open"]
        caught = [r for r in closed if r["verdict"] in FLAGS]
        sizes = [r["best"]["size"][0] for r in caught if r["best"] and r["best"]["surface"]]
        print(f"\n{words}: {len(closed)}")
        print("  detected                     ", rate(r["verdict"] in FLAGS for r in closed))
        print("  a curtain, or its family     ", rate(curtain(r) for r in caught))
        print("  on y = 0 first               ", rate(first(r) == WALL for r in closed))
        print("  size within 40 % of 40 m²    ", rate(abs(s / AREA - 1) <= WITHIN for s in sizes))
        print(
            "  gap at pairs left out shrinks", rate(r["ratio"] < 1 for r in closed if "ratio" in r)
        )
        print("  flagged with curtains open   ", rate(r["verdict"] in FLAGS for r in opened))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=("run", "table", "told"))
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--only", help="own, or the number of a participant")
    parser.add_argument("--workers", type=int, default=None)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    if given.command == "run":
        run(given.folder, given.only, given.workers)
    elif given.command == "told":
        told(given.folder, given.only, given.workers)
    else:
        stated_beside_measured()
        table(read(given.folder))


if __name__ == "__main__":
    main()
