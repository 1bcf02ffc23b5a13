"""Hidden firms: what an archive of rooms knows of its materials, judged in a room that it lacks.

    python -m benchmarks.studies.archives.archive firms [--firms 100] [--first 0] [--rooms 20]
    python -m benchmarks.studies.archives.archive misnamed [--firms 100]

A firm has 20 measured rooms and 12 materials, 4 to 8 in each room. The tables that it uses are off:
together by 10 %, each entry by 25 % (its bands go together), and a material differs between rooms by
10 %. Volume and areas are off by 3 %, and T is measured to 3 %. The tables state sigma = 0.3 alpha. The
archive is told a firm's rooms, and judged in the twenty-first.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.rates import markdown
from rtcal.support.types import Array

BANDS = np.array([125, 250, 500, 1000, 2000, 4000])
ROOMS, MATERIALS = 20, 12
TOGETHER, TABLE, BETWEEN, CORRELATION = 0.10, 0.25, 0.10, 0.7
SIZE, TIME = 0.03, 0.03
STATED = {"volume_sigma": SIZE, "area_sigma": SIZE}
EQUATION = rt.Sabine()
OCTAVES = np.log2(BANDS / 1000)
OF_BANDS = CORRELATION ** np.abs(OCTAVES[:, np.newaxis] - OCTAVES)


def together(rng: np.random.Generator, n: int) -> Array:
    """Errors of n materials that go together over the bands, (n, n_bands)."""
    return rng.standard_normal((n, len(BANDS))) @ np.linalg.cholesky(OF_BANDS).T


class Firm:
    """True materials, the tables that the firm uses, and its rooms."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([seed, 41])
        level = np.exp(rng.uniform(np.log(0.04), np.log(0.6), (MATERIALS, 1)))
        slope = rng.uniform(-0.25, 0.35, (MATERIALS, 1))
        bump = 0.25 * together(rng, MATERIALS)
        self.table = np.clip(level * np.exp(slope * OCTAVES + bump), 0.01, 0.85)
        off = np.exp(TOGETHER * rng.standard_normal() + TABLE * together(rng, MATERIALS))
        self.true = np.clip(self.table * off, 0.005, 0.95)
        self.names = [f"material {i + 1}" for i in range(MATERIALS)]
        # One room is the twenty-first; most materials are in several rooms.
        self.rooms = [self.room(f"room {r + 1}") for r in range(ROOMS + 1)]

    def room(self, name: str) -> tuple[rt.Room, Array, Array]:
        """A room as stated, its true coefficients, and the measured T."""
        rng = self.rng
        which = np.sort(rng.choice(MATERIALS, rng.integers(4, 9), replace=False))
        sides = np.exp(rng.uniform(np.log([4, 5, 2.5]), np.log([15, 25, 8])))
        surface = 2 * (sides[0] * sides[1] + sides[1] * sides[2] + sides[0] * sides[2])
        areas = surface * rng.dirichlet(np.full(len(which), 2.0))
        alpha = self.true[which] * np.exp(BETWEEN * together(rng, len(which)))
        alpha = np.clip(alpha, 0.002, 0.98)
        stated = rt.Room(
            name=name,
            volume=float(np.prod(sides)),
            materials=[self.names[i] for i in which],
            areas=np.maximum(areas, 0.5),
            alpha=self.table[which],
            sigma=0.3 * self.table[which],
            centre_frequencies=BANDS,
            air=rt.Air(),
            **STATED,  # type: ignore[arg-type]
        )
        true = stated.replace(
            alpha=alpha,
            volume=stated.volume * np.exp(SIZE * rng.standard_normal()),
            areas=stated.areas * np.exp(SIZE * rng.standard_normal(len(which))),
        )
        t = EQUATION.reverberation_time(true)
        return stated, alpha, t * np.exp(TIME * rng.standard_normal(len(BANDS)))


def calibrated(room: rt.Room, t: Array) -> rt.calibration.CalibrationResult:
    measured = rt.Measurement(
        centre_frequencies=BANDS, values={"t30": t[None]}, uncertainty={"t30": TIME * t[None]}
    )
    return rt.calibrate(room, measured, "soft", EQUATION)


def error(alpha: Array, truth: Array) -> float:
    return float(np.sqrt(np.mean((alpha - truth) ** 2)))


def judge(seed: int, rooms: int = ROOMS) -> dict[str, Any]:
    """Errors and coverage in the firm's twenty-first room, with so many of its rooms in the archive."""
    firm = Firm(seed)
    archive = rt.learn([calibrated(room, t) for room, _, t in firm.rooms[:rooms]])
    room, truth, t = firm.rooms[-1]
    known = archive.apply(room)
    before, after = calibrated(room, t), calibrated(known, t)
    low, high = after.interval  # type: ignore[misc]
    width = 1.645 * known.sigma
    return {
        "firm": seed,
        "table": error(room.alpha, truth),
        "archive": error(known.alpha, truth),
        "table, calibrated": error(before.alpha, truth),
        "archive, calibrated": error(after.alpha, truth),
        "coverage": float(np.mean((low <= truth) & (truth <= high))),
        "coverage before T": float(np.mean(np.abs(known.alpha - truth) <= width)),
        "false suspects": len(archive.suspects),
    }


def misnamed(seed: int) -> dict[str, Any]:
    """Whether the archive names the material that one room has under another's name."""
    firm = Firm(seed)
    rng = np.random.default_rng([seed, 42])
    stated = [(room, t) for room, _, t in firm.rooms[:-1]]
    r = int(rng.integers(ROOMS))
    room, t = stated[r]
    i = int(rng.integers(room.n_materials))
    others = [m for m in firm.names if m not in room.materials]
    wrong = str(rng.choice(others))
    names, alpha, sigma = list(room.materials), room.alpha.copy(), room.sigma.copy()
    j = firm.names.index(wrong)
    names[i], alpha[i], sigma[i] = wrong, firm.table[j], 0.3 * firm.table[j]
    # What the wrong name changes in the absorption area of the room, rms over the bands.
    true = firm.rooms[r][1]
    change = room.areas[i] * (firm.true[j] - true[i]) / (room.areas @ true)
    stated[r] = (room.replace(materials=names, alpha=alpha, sigma=sigma), t)
    archive = rt.learn([calibrated(each, time) for each, time in stated])
    first = archive.suspects[0] if archive.suspects else None
    hidden = (room.name, wrong)
    return {
        "firm": seed,
        "found": first is not None and (first.room, first.material) == hidden,
        "its name": first is not None and first.instead == room.materials[i],
        "listed": hidden in [(s.room, s.material) for s in archive.suspects],
        "room has the least p": min(archive.lessons, key=lambda x: x.p_value).room == room.name,
        "change of absorption": float(np.sqrt(np.mean(change**2))),
        "false suspects": sum((s.room, s.material) != hidden for s in archive.suspects),
    }


def firms_table(rows: list[dict[str, Any]]) -> str:
    of = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    rms = {key: np.sqrt(np.mean(values**2)) for key, values in of.items()}
    both = [(f"archive{when}", f"table{when}") for when in ("", ", calibrated")]
    ratios = [of[own] / of[other] for own, other in both]
    held = [f"{of[k].mean():.3f}" for k in ("coverage before T", "coverage")]
    alone = f"{rms['archive, calibrated'] / rms['table']:.2f}"
    return markdown(
        (f"firms: {len(rows)}", "before T", "calibrated"),
        ("error of α, archive / table", *(f"{rms[own] / rms[other]:.2f}" for own, other in both)),
        ("the same, median of the firms", *(f"{np.median(ratio):.2f}" for ratio in ratios)),
        ("firms no worse than the table", *(f"{np.mean(ratio <= 1):.2f}" for ratio in ratios)),
        ("90 % intervals hold", *held),
        ("error of α, archive and T / table alone", "", alone),
        ("suspects per firm, none misnamed", f"{of['false suspects'].mean():.2f}", ""),
    )


CHANGES = {
    "0 to 0.1": (0, 0.1),
    "0.1 to 0.2": (0.1, 0.2),
    "0.2 to 0.3": (0.2, 0.3),
    "0.3 and more": (0.3, np.inf),
    "all": (0, np.inf),
}


def misnamed_table(rows: list[dict[str, Any]]) -> str:
    keys = ("found", "listed", "its name", "room has the least p", "false suspects")
    lines = []
    for name, (low, high) in CHANGES.items():
        few = [r for r in rows if low <= r["change of absorption"] < high]
        cells = [f"{np.mean([r[k] for r in few]):.2f}" if few else "" for k in keys]
        lines.append((name, len(few), *cells))
    return markdown(("change of the room's absorption", "firms", *keys), *lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("firms", "misnamed"))
    parser.add_argument("--firms", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rooms", type=int, default=ROOMS)
    arguments = parser.parse_args()
    one, table = {
        "firms": (partial(judge, rooms=arguments.rooms), firms_table),
        "misnamed": (misnamed, misnamed_table),
    }[arguments.what]
    seeds = range(arguments.first, arguments.first + arguments.firms)
    print(table([one(seed) for seed in seeds]))


if __name__ == "__main__":
    main()
