"""Hidden firms: what an archive of rooms knows of its materials, judged in a room that it lacks.

    python -m benchmarks.archive firms [--firms 100] [--first 0] [--rooms 20] [--out FILE.json]
    python -m benchmarks.archive misnamed [--firms 100]
    python -m benchmarks.archive tables [--firms 18] [--first 5000]
    python -m benchmarks.archive real

A firm has 20 measured rooms and 12 materials, 4 to 8 in each room. The tables that it uses are off:
together by 10 %, each entry by 25 % (its bands go together), and a material differs between rooms by
10 %. Volume and areas are off by 3 %, and T is measured to 3 %. The tables state sigma = 0.3 alpha.
The archive is told the firm's rooms, and judged in the twenty-first.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks import real_data
from rtcal.archive.suspects import MISNAMED
from rtcal.support.types import Array

BANDS = np.array([125, 250, 500, 1000, 2000, 4000])
ROOMS, MATERIALS = 20, 12
TOGETHER, TABLE, BETWEEN, CORRELATION = 0.10, 0.25, 0.10, 0.7
SIZE, TIME = 0.03, 0.03
STATED = {"volume_sigma": SIZE, "area_sigma": SIZE}
EQUATION = rt.Sabine()


def together(rng: np.random.Generator, n: int) -> Array:
    """Errors of n materials that go together over the bands, (n, n_bands)."""
    octaves = np.log2(BANDS / 1000)
    correlation = CORRELATION ** np.abs(octaves[:, np.newaxis] - octaves)
    return rng.standard_normal((n, len(BANDS))) @ np.linalg.cholesky(correlation).T


class Firm:
    """True materials, the tables that the firm uses, and its rooms."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([seed, 41])
        octaves = np.log2(BANDS / 1000)
        level = np.exp(rng.uniform(np.log(0.04), np.log(0.6), (MATERIALS, 1)))
        slope = rng.uniform(-0.25, 0.35, (MATERIALS, 1))
        bump = 0.25 * together(rng, MATERIALS)
        self.table = np.clip(level * np.exp(slope * octaves + bump), 0.01, 0.85)
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


def measured(t: Array) -> rt.Measurement:
    return rt.Measurement(
        centre_frequencies=BANDS,
        values={"t30": t[np.newaxis]},
        uncertainty={"t30": TIME * t[np.newaxis]},
    )


def calibrated(room: rt.Room, t: Array) -> rt.calibration.CalibrationResult:
    return rt.calibrate(room, measured(t), "soft", EQUATION)


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
    names[i] = wrong
    alpha[i] = firm.table[firm.names.index(wrong)]
    sigma[i] = 0.3 * alpha[i]
    # What the wrong name changes in the absorption area of the room, rms over the bands.
    true = firm.rooms[r][1]
    j = firm.names.index(wrong)
    absorbed = room.areas @ true
    change = float(np.sqrt(np.mean((room.areas[i] * (firm.true[j] - true[i]) / absorbed) ** 2)))
    stated[r] = (room.replace(materials=names, alpha=alpha, sigma=sigma), t)
    archive = rt.learn([calibrated(each, time) for each, time in stated])
    first = archive.suspects[0] if archive.suspects else None
    hidden = (room.name, wrong)
    return {
        "firm": seed,
        "bound": bound(firm, room, t, names, (i, firm.names.index(room.materials[i]))),
        "found": first is not None and (first.room, first.material) == hidden,
        "its name": first is not None and first.instead == room.materials[i],
        "listed": hidden in [(s.room, s.material) for s in archive.suspects],
        "room has the least p": min(archive.lessons, key=lambda x: x.p_value).room == room.name,
        "change of absorption": change,
        "false suspects": sum((s.room, s.material) != hidden for s in archive.suspects),
    }


def bound(firm: Firm, room: rt.Room, t: Array, names: list[str], hidden: tuple[int, int]) -> bool:
    """Whether an observer who knows the firm's materials and all spreads finds the misnamed one.

    That is the most that any archive can find: its materials are known without an error. ``names`` are
    those of the room, of which number ``hidden[0]`` is truly the firm's material ``hidden[1]``.
    """
    octaves = np.log2(BANDS / 1000)
    correlation = CORRELATION ** np.abs(octaves[:, np.newaxis] - octaves)
    b = EQUATION.target(room, t)

    def density(which: list[int]) -> float:
        own = room.areas[:, np.newaxis] * firm.true[which] * np.exp(BETWEEN**2 / 2)
        total = own.sum(axis=0)
        covariance = own.T @ own * (BETWEEN**2 * correlation + SIZE**2)
        covariance += SIZE**2 * np.outer(total, total) + np.diag((TIME * total) ** 2)
        factor = np.linalg.cholesky(covariance)
        miss = np.linalg.solve(factor, b - total)
        return float(-0.5 * miss @ miss - np.log(np.diag(factor)).sum())

    stated = [firm.names.index(m) for m in names]
    base = density(stated)
    odds = np.zeros((len(stated), MATERIALS))
    for i in range(len(stated)):
        for j in set(range(MATERIALS)) - set(stated):
            ratio = density([*stated[:i], j, *stated[i + 1 :]]) - base
            odds[i, j] = MISNAMED / MATERIALS * np.exp(min(ratio, 600.0))
    by_material = odds.sum(axis=1) / (1 - MISNAMED * len(stated) + odds.sum())
    return bool(by_material[hidden[0]] > 0.5)


def tables(seed: int) -> dict[str, Any]:
    """Whether `apply` tells by a room's table if a name is the archive's material.

    Each entry stands in a new room twice: as that material with another handbook's table, and as
    another material of the firm, with its table, under this name. Taking the archive's coefficients is
    right where they are nearer to the truth than the room's table.
    """
    firm = Firm(seed)
    archive = rt.learn([calibrated(room, t) for room, _, t in firm.rooms[:-1]])
    rng = np.random.default_rng([seed, 43])
    off = np.exp(TOGETHER * rng.standard_normal() + TABLE * together(rng, MATERIALS))
    second = np.clip(firm.true / off, 0.01, 0.85)
    own = np.clip(firm.true * np.exp(BETWEEN * together(rng, MATERIALS)), 0.002, 0.98)
    found = []
    for i, name in enumerate(firm.names):
        if name not in archive.materials:
            continue
        learned = archive.alpha[archive.materials.index(name)]
        j = int(rng.choice([m for m in range(MATERIALS) if m != i]))
        for kind, m, table in (("same", i, second[i]), ("other", j, firm.table[j])):
            room = firm.rooms[-1][0].replace(
                materials=[name], areas=[100.0], alpha=[table], sigma=[0.3 * table], area_sigma=0.03
            )
            taken = not archive.left_as_stated(room)
            used, other = error(learned, own[m]), error(table, own[m])
            found.append((kind, taken, used, other))
    return {"firm": seed, "entries": found}


def tables_table(rows: list[dict[str, Any]]) -> str:
    lines = [
        f"| firms: {len(rows)} | entries | taken | rightly decided | error / the room's table |"
        " if all were taken |",
        "|---|---|---|---|---|---|",
    ]
    for kind in ("same", "other"):
        few = [e[1:] for row in rows for e in row["entries"] if e[0] == kind]
        taken, used, own = (np.array(column) for column in zip(*few, strict=True))
        right = np.mean(taken == (used <= own))
        kept = np.where(taken, used, own)
        ratio, every = (np.sqrt(np.mean(e**2) / np.mean(own**2)) for e in (kept, used))
        lines.append(
            f"| {kind} material | {len(few)} | {taken.mean():.2f} | {right:.2f} | {ratio:.2f} | "
            f"{every:.2f} |"
        )
    return "\n".join(lines)


def firms_table(rows: list[dict[str, Any]]) -> str:
    def rms(key: str) -> float:
        return float(np.sqrt(np.mean([row[key] ** 2 for row in rows])))

    def ratios(key: str, other: str) -> Array:
        return np.array([row[key] / row[other] for row in rows])

    lines = ["| firms: " + str(len(rows)) + " | before T | calibrated |", "|---|---|---|"]
    pairs = (("archive", "table"), ("archive, calibrated", "table, calibrated"))
    cells = [f"{rms(a) / rms(b):.2f}" for a, b in pairs]
    lines.append(f"| error of α, archive / table | {' | '.join(cells)} |")
    cells = [f"{np.median(ratios(a, b)):.2f}" for a, b in pairs]
    lines.append(f"| the same, median of the firms | {' | '.join(cells)} |")
    cells = [f"{np.mean(ratios(a, b) <= 1):.2f}" for a, b in pairs]
    lines.append(f"| firms no worse than the table | {' | '.join(cells)} |")
    cells = [f"{np.mean([row[k] for row in rows]):.3f}" for k in ("coverage before T", "coverage")]
    lines.append(f"| 90 % intervals hold | {' | '.join(cells)} |")
    ratio = rms("archive, calibrated") / rms("table")
    lines.append(f"| error of α, archive and T / table alone | | {ratio:.2f} |")
    false = np.mean([row["false suspects"] for row in rows])
    lines.append(f"| suspects per firm, none misnamed | {false:.2f} | |")
    return "\n".join(lines)


def misnamed_table(rows: list[dict[str, Any]]) -> str:
    keys = ("bound", "found", "listed", "its name", "room has the least p", "false suspects")
    head = f"| change of the room's absorption | firms | {' | '.join(keys)} |"
    lines = [head, "|---|---|---|---|---|---|---|---|"]
    for low, high in ((0, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, np.inf), (0, np.inf)):
        few = [r for r in rows if low <= r["change of absorption"] < high]
        cells = [f"{np.mean([r[k] for r in few]):.2f}" if few else "" for k in keys]
        name = "all" if high - low == np.inf and not low else f"{low:g} to {high:g}"
        lines.append(f"| {name.replace('to inf', 'and more')} | {len(few)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def real_rooms() -> list[tuple[rt.Room, Array]]:
    """dEchorate's ten states, and BRAS' CR2 and CR3, as handbooks would have them, in four octaves.

    The handbook of dEchorate is a guess: 0.3 for the floor, 0.5 for absorbing and 0.1 for reflecting
    panels, each with sigma 50 %. Plaster and windows have one name in both BRAS rooms.
    """
    names = ("panel room's floor", "absorbing panels", "reflecting panels")
    guess = np.array([0.3, 0.5, 0.1])
    found = []
    for state, t in real_data.dechorate_times().items():
        areas = real_data.dechorate_areas(state)
        used = areas > 0
        alpha = np.tile(guess[used, np.newaxis], (1, len(t)))
        room = rt.Room(
            name=f"dEchorate {state}",
            volume=real_data.DECHORATE_VOLUME,
            materials=[n for n, u in zip(names, used, strict=True) if u],
            areas=areas[used],
            alpha=alpha,
            sigma=0.5 * alpha,
            air=rt.Air(20.0, 50.0),
            centre_frequencies=real_data.DECHORATE_BANDS,
            **STATED,  # type: ignore[arg-type]
        )
        found.append((room, t))
    for name in ("CR2", "CR3"):
        room = real_data.bras_room(name, "initial")
        rows = real_data.lines("bras", "measured_octave.csv")
        row = next(
            r for r in rows if (r["room"], r["parameter"], r["stat"]) == (name, "T30", "mean")
        )
        bands = [f"{f:.0f}" for f in real_data.DECHORATE_BANDS]
        columns = [room.centre_frequencies.tolist().index(float(b)) for b in bands]
        shared = ("plaster", "windows")
        room = room.replace(
            name=name,
            materials=[m if m in shared else f"{m} of {name}" for m in room.materials],
            alpha=room.alpha[:, columns],
            sigma=room.sigma[:, columns],
            centre_frequencies=real_data.DECHORATE_BANDS,
            **STATED,
        )
        found.append((room, np.array([float(row[b]) for b in bands])))
    return found


def real_table() -> str:
    """Share of bands whose T is within 10 % of what was measured, each state or room left out in turn.

    The states of dEchorate that are not left out are one room.
    """
    rooms = real_rooms()
    lines = [
        "| left out | T within 10 %: handbook | archive | mean error of T: handbook | archive |",
        "|---|---|---|---|---|",
    ]
    errors: dict[str, list[Array]] = {}
    for i, (room, t) in enumerate(rooms):
        left = rooms[:i] + rooms[i + 1 :]
        states = [each for each in left if each[0].name.startswith("dEchorate")]
        of_states, times = zip(*states, strict=True)
        one = rt.calibrate(rt.Configurations(of_states), times, "soft")
        archive = rt.learn([one, *(rt.calibrate(*each, "soft") for each in left[len(states) :])])
        known = archive.apply(room) if set(room.materials) & set(archive.materials) else room
        both = [rt.Eyring().reverberation_time(r) / t - 1 for r in (room, known)]
        errors.setdefault(room.name.split()[0], []).append(np.abs(both))
    errors["all"] = [e for each in errors.values() for e in each]
    for name, each in errors.items():
        handbook, archived = np.concatenate(each, axis=1)
        label = f"{name}, each of {len(each)}" if len(each) > 1 else name
        lines.append(
            f"| {label} | {np.mean(handbook <= 0.1):.2f} | {np.mean(archived <= 0.1):.2f} | "
            f"{100 * handbook.mean():.0f} % | {100 * archived.mean():.0f} % |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("firms", "misnamed", "tables", "real"))
    parser.add_argument("--firms", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rooms", type=int, default=ROOMS)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    if arguments.what == "real":
        print(real_table())
        return
    studies: dict[str, tuple[Callable[[int], dict[str, Any]], Callable[[Any], str]]] = {
        "firms": (partial(judge, rooms=arguments.rooms), firms_table),
        "misnamed": (misnamed, misnamed_table),
        "tables": (tables, tables_table),
    }
    one, table = studies[arguments.what]
    rows = [one(seed) for seed in range(arguments.first, arguments.first + arguments.firms)]
    print(table(rows))
    if arguments.out:
        arguments.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
