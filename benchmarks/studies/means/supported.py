"""Is "supported" right? Findings by means in rooms of another tracer, with and without a hidden effect.

    # can be resumed
    python -m benchmarks.studies.means.supported make --folder out --population 1 --number 120
    python -m benchmarks.studies.means.supported run --folder out --population 1 --out rows
    python -m benchmarks.studies.means.supported table [--out rows]  # of the stored rows, or a run
    python -m benchmarks.studies.means.supported store --out rows

The rooms are boxes that pyroomacoustics simulates: image sources to the third order, rays for the rest,
its own air. Six impulse responses are filtered into octaves and integrated backwards here, without
rtcal's code. What pyroomacoustics adds to the direct sound is 3.8 dB stronger than in a diffuse field,
so that C80 and G are off by it. In half of the rooms they are left so, and nothing of it is stated:
that is part of the test. In the others what follows the direct sound is lowered by as much.

A third of the rooms lacks nothing. Coefficients are drawn about the true ones, with 10 to 30 %, half of
it common to all. In every second room a further configuration was measured, with an absorber of known
coefficients on a wall. Each room is judged with four sets of data (`DATA`).

"Supported" is right if something is hidden, the family of the effect that was added is that of what is
hidden, and the mean gap at the data that were held out is smaller with it. Population 0 is for
development; each other population is run once, with a rule that was frozen before. Stored is 2.
"""

from __future__ import annotations

import argparse
import gzip
import json
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt

import rtcal as rt
from benchmarks.studies.means.judging import (
    FLAGS,
    NOTHING,
    families_of,
    first_of,
    kept_controls,
    rate,
    row_of,
)
from rtcal.files.disk import json_numbers
from rtcal.finder import Case, Configuration, Finding, verify
from rtcal.finder.case import ChangedMaterial
from rtcal.finder.search import find

STORED = Path(__file__).with_name("supported.json.gz")
BANDS = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])
RATE = 16000
WALLS = {
    "floor": ("floor",),
    "ceiling": ("ceiling",),
    "long walls": ("north", "south"),
    "short walls": ("east", "west"),
}
NORMALS = {"floor": 2, "ceiling": 2, "long walls": 1, "short walls": 0}
EFFECTS = (
    "opening",
    "furniture",
    "porous",
    "resonator",
    "audience",
    "area",
    "volume",
    "air",
    "non-diffuse field",
    "noise floor",
    "direct sound",
    "covered surface",
    "coefficients",
)
"""What is hidden, in turn, beside `NOTHING`."""
DATA = ("times", "levels", "second", "all")
"""T20, EDT, T30; with C80 and G; of two configurations without C80 and G; all."""
SPECTRA = {
    "hard": (0.02, 0.02, 0.03, 0.03, 0.04, 0.05),
    "plaster": (0.10, 0.08, 0.06, 0.06, 0.07, 0.08),
    "panel": (0.28, 0.20, 0.12, 0.09, 0.09, 0.09),
    "carpet": (0.05, 0.08, 0.18, 0.32, 0.42, 0.48),
    "tiles": (0.25, 0.42, 0.62, 0.72, 0.74, 0.72),
}
ADDED = {
    "opening": (1.0,) * 6,
    "furniture": (0.30, 0.38, 0.46, 0.52, 0.56, 0.58),
    "porous": (0.12, 0.33, 0.68, 0.92, 0.95, 0.92),
    "resonator": (0.72, 0.60, 0.22, 0.10, 0.07, 0.06),
    "audience": (0.36, 0.50, 0.68, 0.84, 0.88, 0.86),
}
"""alpha of what is added; of furniture, per m² of floor and walls that it stands before."""
KNOWN = (0.10, 0.28, 0.60, 0.80, 0.82, 0.80)
"""alpha of what hangs on half of a wall in the second configuration, known to 5 %."""


def drawn(population: int, index: int) -> dict[str, Any]:
    """Return a room as it is, and what is stated of it, from its numbers alone."""
    rng = np.random.default_rng([57, population, index])
    hidden = NOTHING if index % 3 == 0 else EFFECTS[(index - index // 3 - 1) % len(EFFECTS)]
    sides = rng.uniform([6, 5, 2.7], [15, 10, 5.0])
    x, y, z = sides
    areas = {"floor": x * y, "ceiling": x * y, "long walls": 2 * x * z, "short walls": 2 * y * z}
    kinds = {
        "floor": rng.choice(["hard", "carpet"]),
        "ceiling": rng.choice(["plaster", "tiles", "hard"], p=[0.5, 0.2, 0.3]),
        "long walls": rng.choice(["plaster", "panel", "hard"]),
        "short walls": rng.choice(["plaster", "panel", "hard"]),
    }
    scattering = float(rng.uniform(0.4, 0.8))
    if hidden == "non-diffuse field":
        kinds |= {
            "floor": "carpet",
            "ceiling": "tiles",
            "long walls": "hard",
            "short walls": "hard",
        }
        scattering = float(rng.uniform(0.02, 0.1))
    true = {w: np.array(SPECTRA[k]) * rng.uniform(0.8, 1.25) for w, k in kinds.items()}
    size = sum(areas.values())
    absorbed = sum(areas[w] * true[w] for w in WALLS).mean()
    relative = float(rng.uniform(0.1, 0.3))
    spread = relative * np.sqrt([0.5, 0.5])
    common = rng.standard_normal()
    stated = {
        w: np.clip(a * np.exp(spread[0] * common + spread[1] * rng.standard_normal()), 0.01, 0.95)
        for w, a in true.items()
    }
    room: dict[str, Any] = {
        "hidden": hidden,
        "sides": sides.tolist(),
        "areas": areas,
        "volume": float(np.prod(sides)),
        "scattering": scattering,
        "humidity": float(rng.uniform(30, 60)),
        "air": True,
        "direct_db": 0.0,
        "noise_db": None,
        "sigma": relative,
    }
    much = float(rng.uniform(0.35, 1.1)) * absorbed
    if hidden in ADDED:
        alpha = np.array(ADDED[hidden])
        on = {
            "opening": ["long walls"],
            "porous": ["short walls", "long walls"],
            "resonator": ["long walls"],
            "audience": ["floor"],
            "furniture": list(WALLS),
        }[hidden]
        area = min(much / alpha.mean(), 0.8 * sum(areas[w] for w in on))
        share = area / sum(areas[w] for w in on)
        for w in on:
            true[w] = (1 - share) * true[w] + share * alpha
        room["size"] = area
    elif hidden == "area":
        which = max(WALLS, key=lambda w: areas[w] * true[w].mean())
        ratio = float(rng.choice([0.45, 0.55, 1.8, 2.2]))
        room["areas"] = {**areas, which: areas[which] / ratio}
        room["size"] = ratio
    elif hidden == "volume":
        ratio = float(rng.choice([0.65, 0.72, 1.35, 1.5]))
        room["volume"] = room["volume"] / ratio
        room["size"] = ratio
    elif hidden == "air":
        room["air"] = False
    elif hidden == "noise floor":
        room["noise_db"] = float(rng.uniform(-42, -30))
    elif hidden == "direct sound":
        room["direct_db"] = float(rng.choice([-8.0, 6.0]))
    elif hidden == "covered surface":
        which = max(WALLS, key=lambda w: areas[w] * true[w].mean())
        share = float(rng.uniform(0.5, 0.9))
        true[which] = (1 - share) * true[which] + share * np.minimum(true[which], 0.04)
        room["size"] = share
    elif hidden == "coefficients":
        ratio = float(rng.choice([0.6, 1.6]))
        stated = {w: np.clip(a * ratio, 0.01, 0.95) for w, a in stated.items()}
    low, high = 0.18 * sides, 0.82 * sides
    points = rng.uniform(low, high, (200, 3))
    points[:, 2] = rng.uniform(1.1, 1.7, 200)
    sources = points[:2]
    receivers = [p for p in points[2:] if np.linalg.norm(sources - p, axis=1).min() > 1.5][:3]
    return room | {
        "true": {w: np.clip(a, 0, 1).tolist() for w, a in true.items()},
        "stated": {w: a.tolist() for w, a in stated.items()},
        "sources": sources.tolist(),
        "receivers": np.array(receivers).tolist(),
        "share": absorbed / size,
        "second": index % 2 == 0,
        "seed": [57, population, index],
    }


def responses(room: dict[str, Any], alpha: dict[str, Any]) -> Iterator[tuple[np.ndarray, float]]:
    """Simulate each pair's impulse response, and yield it with the pair's distance in m."""
    import pyroomacoustics as pra

    pra.random.seed(numpy=room["seed"][2], libroom=room["seed"][2])
    scatter = {"coeffs": [room["scattering"]] * 6, "center_freqs": BANDS.tolist()}
    materials = {
        side: pra.Material(
            {"coeffs": list(alpha[w]), "center_freqs": BANDS.tolist()}, scattering=scatter
        )
        for w, sides in WALLS.items()
        for side in sides
    }
    area = sum(room["true_areas"].values())
    mean = sum(room["true_areas"][w] * np.array(alpha[w]) for w in WALLS) / area
    slowest = float(0.161 * np.prod(room["sides"]) / (area * mean).min())
    box = pra.ShoeBox(
        room["sides"],
        fs=RATE,
        materials=materials,
        max_order=3,
        ray_tracing=True,
        air_absorption=True,
        temperature=20.0,
        humidity=room["humidity"],
    )
    box.set_ray_tracing(
        n_rays=8000,
        receiver_radius=0.3,
        energy_thres=1e-10,
        time_thres=min(1.3 * slowest + 0.2, 4.0),
    )
    for source in room["sources"]:
        box.add_source(source)
    box.add_microphone_array(np.array(room["receivers"]).T)
    box.compute_rir()
    rng = np.random.default_rng([*room["seed"], 1])
    for r, receiver in enumerate(room["receivers"]):
        for s, source in enumerate(room["sources"]):
            rir = np.array(box.rir[r][s])
            apart = float(np.linalg.norm(np.subtract(source, receiver)))
            at = int(np.argmax(np.abs(rir) > 0.2 * np.abs(rir).max()))
            rir = rir[max(at - 8, 0) :]
            rir[:40] *= 10 ** (room["direct_db"] / 20)
            if room["noise_db"] is not None:
                level = np.sqrt(np.mean(rir[40:800] ** 2)) * 10 ** (room["noise_db"] / 20)
                rir = rir + level * rng.standard_normal(len(rir))
            yield rir, apart


def parameters(rir: np.ndarray) -> dict[str, list[float]]:
    """Return T20, EDT and T30 in s, C80 and G in dB by band; NaN where a decay is too short."""
    out: dict[str, list[float]] = {k: [] for k in ("t20", "edt", "t30", "c80", "g")}
    unit = np.zeros(RATE)
    unit[RATE // 4] = 1.0
    for f in BANDS:
        sos = butter(
            3, [f / 2**0.5, min(f * 2**0.5, 0.99 * RATE / 2)], "band", fs=RATE, output="sos"
        )
        energy = sosfilt(sos, np.append(rir, np.zeros(RATE // 20))) ** 2
        left = np.cumsum(energy[::-1])[::-1]
        level = 10 * np.log10(np.maximum(left / left[0], 1e-12))
        t = np.arange(len(level)) / RATE
        for name, first, last in (("t20", -5, -25), ("edt", 0, -10), ("t30", -5, -35)):
            inside = (level <= first) & (level >= last)
            slope = np.polyfit(t[inside], level[inside], 1)[0] if inside.sum() > 20 else np.nan
            out[name].append(float(-60 / slope))
        early = int(0.08 * RATE)
        out["c80"].append(float(10 * np.log10((left[0] - left[early]) / left[early])))
        reference = np.sum(sosfilt(sos, unit) ** 2) / 10**2  # its amplitude is 1 at 1 m
        out["g"].append(float(10 * np.log10(left[0] / reference)))
    return out


def made(population: int, index: int) -> dict[str, Any]:
    """Return a room with what was measured in each configuration."""
    room = drawn(population, index)
    x, y, z = room["sides"]
    room["true_areas"] = dict(zip(WALLS, (x * y, x * y, 2 * x * z, 2 * y * z), strict=True))
    states = [room["true"]]
    if room["second"]:
        hung = 0.5 * np.array(room["true"]["short walls"]) + 0.5 * np.array(KNOWN)
        states.append(room["true"] | {"short walls": hung.tolist()})
        stated = 0.5 * np.array(room["stated"]["short walls"]) + 0.5 * np.array(KNOWN)
        room["hung"] = stated.tolist()
    room["measured"] = []
    for alpha in states:
        pairs = [(parameters(rir), d) for rir, d in responses(room, alpha)]
        values = {k: [p[k] for p, _ in pairs] for k in pairs[0][0]}
        room["measured"].append({"values": values, "distances": [d for _, d in pairs]})
    return room


def case_of(room: dict[str, Any], data: str) -> Case:
    """Return the case as it is stated, with one of the sets `DATA`."""
    names = list(WALLS)
    alpha = np.array([room["stated"][w] for w in names])
    volume, sides = room["volume"], None
    if np.isclose(volume, np.prod(room["sides"])):
        sides = tuple(room["sides"])
    stated = rt.Room(
        name=f"room {room['seed']}",
        volume=volume,
        materials=names,
        areas=[room["areas"][w] for w in names],
        alpha=alpha,
        sigma=np.minimum(room["sigma"] * alpha + 0.005, 1.0),
        centre_frequencies=BANDS,
        air=rt.Air(20.0, room["humidity"]) if room["air"] else None,
        dimensions=sides,
    )
    kept = (
        ("t20", "edt", "t30") if data in ("times", "second") else ("t20", "edt", "t30", "c80", "g")
    )
    count = len(room["measured"]) if data in ("second", "all") else 1
    configurations = []
    for i, each in enumerate(room["measured"][:count]):
        values = {k: np.array(each["values"][k]) for k in kept}
        if "g" in kept and room["seed"][2] // 2 % 2 == 0:
            values["c80"], values["g"] = levelled(values["c80"], values["g"], each["distances"])
        changes = {}
        if i:
            hung = np.array(room["hung"])
            changes = {"short walls": ChangedMaterial(hung, np.minimum(0.1 * hung, 1.0))}
        pairs = [(f"S{k % 2 + 1}", f"R{k // 2 + 1}") for k in range(len(values["t20"]))]
        configurations.append(
            Configuration(
                name="as it is" if i == 0 else "with the absorber",
                measured=rt.Measurement(centre_frequencies=BANDS, values=values, pairs=pairs),
                changes=changes,
                distances=np.array(each["distances"]),
            )
        )
    facing = np.zeros((4, 3))
    facing[range(4), [NORMALS[w] for w in names]] = 1.0
    return Case(room=stated, configurations=configurations, facing=facing)


LEVEL = 10**-0.38
"""Factor on the energy after the direct sound with which a box of uniform absorption, 0.1 or 0.2, has
the G of a diffuse field. Its T is Eyring's to 5 %, whatever the level."""


def levelled(
    c80: np.ndarray, g: np.ndarray, distances: list[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return C80 and G, (n_pairs, n_bands) in dB, with less energy after the direct sound."""
    direct = 100 / np.square(distances)[:, np.newaxis]  # the source has 0 dB at 10 m
    whole, ratio = 10 ** (g / 10), 10 ** (c80 / 10)
    late = LEVEL * whole / (1 + ratio)
    early = direct + LEVEL * np.maximum(whole * ratio / (1 + ratio) - direct, 0.0)
    return 10 * np.log10(early / late), 10 * np.log10(early + late)


def path_of(folder: Path, population: int, index: int) -> Path:
    return folder / f"room_{population}_{index}.json"


def make(folder: Path, population: int, indices: range) -> None:
    """Simulate the rooms that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    for index in indices:
        path = path_of(folder, population, index)
        if not path.exists():
            path.write_text(json.dumps(made(population, index)), encoding="utf-8")
            print(".", end="", flush=True)
    print()


def judged(finding: Finding) -> dict[str, Any]:
    """Return what the finding and its verification say, as plain values."""
    row = row_of(finding)
    kept = {k: row[k] for k in ("verdict", "effect", "family", "candidates", "score", "threshold")}
    best = str(finding.best_effect)
    kept |= {"best": best, "probability": finding.probabilities.get(best, 0.0)}
    if not finding.can_be_added:
        return kept
    seen = verify(finding)
    return kept | {
        "verification": seen.verdict,
        "before": json_numbers(seen.before),
        "after": json_numbers(seen.after),
        "uncertainty": json_numbers(seen.uncertainty),
        "predictive": seen.predictive,
        "misses": len(seen.misses),
        "objections": [] if seen.verdict == "not tested" else [str(o) for o in seen.objections],
    }


def run(folder: Path, population: int, indices: range, out: Path) -> None:
    """Find and verify in each room that is simulated and has no row yet, with each set of data."""
    warnings.simplefilter("ignore")
    out.mkdir(parents=True, exist_ok=True)
    for index in indices:
        path = out / f"row_{population}_{index}.json"
        if path.exists() or not path_of(folder, population, index).exists():
            continue
        room = json.loads(path_of(folder, population, index).read_text(encoding="utf-8"))
        controls = kept_controls(
            case_of(room, "all"), out / "controls" / f"{population}_{index}.npz"
        )
        sets = DATA if len(room["measured"]) > 1 else DATA[:2]
        rows = {}
        for data in sets:
            case = case_of(room, data)
            several = len(case.configurations) > 1
            rows[data] = judged(find(case, controls=controls if several else first_of(controls)))
        row = {"index": index, "hidden": room["hidden"], "rows": rows}
        path.write_text(json.dumps(row), encoding="utf-8")
        print(".", end="", flush=True)
    print()


def is_right(hidden: str, row: dict[str, Any]) -> bool:
    """Whether a supported finding is right: the claimed family is hidden, and the gap shrinks."""
    families = {hidden} if hidden == "coefficients" else families_of([hidden])
    claimed = row["best"] if row["best"] == "coefficients" else row["family"]
    return claimed in families and row["after"] < row["before"]


def table(rooms: list[dict[str, Any]]) -> None:
    """Print the verdicts by set of data, and how often "supported" is right."""
    print(f"{len(rooms)} rooms: {dict(Counter(r['hidden'] for r in rooms))}")
    every = []
    for data in DATA:
        rows = [(r["hidden"], r["rows"][data]) for r in rooms if data in r["rows"]]
        verified = [(h, row) for h, row in rows if "verification" in row]
        supported = [is_right(h, row) for h, row in verified if row["verification"] == "supported"]
        every += supported
        flagged = [row["verdict"] in FLAGS for h, row in rows if h == NOTHING]
        print(
            f"{data:7} {len(rows)} cases; nothing hidden, flagged {rate(flagged)}; verified "
            f"{len(verified)}: {dict(Counter(row['verification'] for _, row in verified))}; "
            f"supported, right {rate(supported)}"
        )
    print(f"supported, right, all data: {rate(every)}")


def stored() -> list[dict[str, Any]]:
    out: list[dict[str, Any]] = json.loads(gzip.decompress(STORED.read_bytes()))
    return out


def rows_of(out: Path | None) -> list[dict[str, Any]]:
    if out is None:
        return stored()
    return [json.loads(p.read_text(encoding="utf-8")) for p in sorted(out.glob("row_*.json"))]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("make", "run", "table", "store"))
    parser.add_argument("--folder", type=Path, default=Path("."))
    parser.add_argument("--population", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--number", type=int, default=60)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    indices = range(given.first, given.first + given.number)
    if given.what == "make":
        make(given.folder, given.population, indices)
    elif given.what == "run":
        run(given.folder, given.population, indices, given.out or given.folder)
    elif given.what == "table":
        table(rows_of(given.out))
    else:
        text = json.dumps(rows_of(given.out), separators=(",", ":"))
        STORED.write_bytes(gzip.compress(text.encode(), mtime=0))


if __name__ == "__main__":
    main()
