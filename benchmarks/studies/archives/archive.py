"""Hidden firms: what an archive of rooms knows of its materials, judged in a room that it lacks.

    python -m benchmarks.studies.archives.archive firms [--firms 100] [--first 0] [--rooms 20] [--out F]
    python -m benchmarks.studies.archives.archive misnamed [--firms 100]
    python -m benchmarks.studies.archives.archive tables [--firms 18] [--first 5000]
    python -m benchmarks.studies.archives.archive unknown [--firms 100] [--rooms 3]
    python -m benchmarks.studies.archives.archive real

The firms are those of `benchmarks.studies.archives.firms`. The archive is told a firm's rooms, and
judged in the twenty-first.
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
from benchmarks.studies.archives.firms import (
    BETWEEN,
    EQUATION,
    MATERIALS,
    ROOMS,
    SIZE,
    STATED,
    TABLE,
    TOGETHER,
    Firm,
    bound,
    calibrated,
    knowing,
    together,
)
from benchmarks.studies.means import real_data
from rtcal.support.types import Array


def error(alpha: Array, truth: Array) -> float:
    return float(np.sqrt(np.mean((alpha - truth) ** 2)))


def judge(seed: int, rooms: int = ROOMS) -> dict[str, Any]:
    """Errors and coverage in the firm's twenty-first room, with so many of its rooms in the archive."""
    firm = Firm(seed)
    archive = rt.learn([calibrated(room, t) for room, _, t in firm.rooms[:rooms]])
    room, truth, t = firm.rooms[-1]
    known = archive.apply(room)
    before, after = calibrated(room, t), calibrated(known, t)
    best = knowing(firm, rooms)
    low, high = after.interval  # type: ignore[misc]
    width = 1.645 * known.sigma
    return {
        "firm": seed,
        "table": error(room.alpha, truth),
        "archive": error(known.alpha, truth),
        "table, calibrated": error(before.alpha, truth),
        "archive, calibrated": error(after.alpha, truth),
        "knowing": error(best.alpha, truth),
        "knowing, calibrated": error(calibrated(best, t).alpha, truth),
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
    bounds = bound(firm, stated, (r, i))
    first = archive.suspects[0] if archive.suspects else None
    hidden = (room.name, wrong)
    return {
        "firm": seed,
        **bounds,
        "found": first is not None and (first.room, first.material) == hidden,
        "its name": first is not None and first.instead == room.materials[i],
        "listed": hidden in [(s.room, s.material) for s in archive.suspects],
        "room has the least p": min(archive.lessons, key=lambda x: x.p_value).room == room.name,
        "change of absorption": change,
        "false suspects": sum((s.room, s.material) != hidden for s in archive.suspects),
    }


def unknown(seed: int, rooms: int) -> dict[str, Any]:
    """Errors in a room of which the archive knows one small material, and how far all tables are off.

    Its tables are those of the firm, or each room has tables of its own.
    """
    found: dict[str, Any] = {"firm": seed}
    for tables_of in ("firm", "room"):
        firm = Firm(seed)
        rng = np.random.default_rng([seed, 44])
        each = []
        for r, (room, alpha, t) in enumerate(firm.rooms):
            if tables_of == "room":
                off = TOGETHER * rng.standard_normal() + TABLE * together(rng, room.n_materials)
                table = np.clip(alpha / np.exp(off), 0.01, 0.85)
                names = [f"{m} of {r}" for m in room.materials]
                room = room.replace(materials=names, alpha=table, sigma=0.3 * table)
            each.append((room, alpha, t))
        archive = rt.learn([calibrated(room, t) for room, _, t in each[:rooms]])
        room, truth, t = each[-1]
        entry = archive.materials[0]
        room = room.replace(
            materials=[entry, *(f"{m}, new" for m in room.materials)],
            areas=[0.01, *room.areas],
            alpha=[archive.table[0], *room.alpha],
            sigma=[archive.table_sigma[0], *room.sigma],
            area_sigma=SIZE,
        )
        known = archive.apply(room)
        for name, of in (("table", room), ("archive", known)):
            gap = EQUATION.reverberation_time(of) / t - 1
            found[f"{name} of the {tables_of}"] = (
                error(of.alpha[1:], truth),
                float(np.sqrt(np.mean(gap**2))),
                float(np.mean(np.abs(gap) <= 0.1)),
            )
    return found


def unknown_table(rows: list[dict[str, Any]]) -> str:
    lines = [
        "| tables of the | error of α, archive / table | error of T | T within 10 %: table | archive |",
        "|---|---|---|---|---|",
    ]
    for of in ("firm", "room"):
        table, known = (
            np.array([row[f"{name} of the {of}"] for row in rows]) for name in ("table", "archive")
        )
        ratio = np.sqrt(np.mean(known**2, axis=0) / np.mean(table**2, axis=0))
        lines.append(
            f"| {of} | {ratio[0]:.2f} | {ratio[1]:.2f} | {table[:, 2].mean():.2f} | "
            f"{known[:, 2].mean():.2f} |"
        )
    return "\n".join(lines)


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

    head = f"| firms: {len(rows)} | before T | calibrated | before T, spreads known | calibrated |"
    lines = [head, "|---|---|---|---|---|"]
    pairs = [
        (f"{of}{when}", f"table{when}")
        for of in ("archive", "knowing")
        for when in ("", ", calibrated")
    ]
    cells = [f"{rms(a) / rms(b):.2f}" for a, b in pairs]
    lines.append(f"| error of α, archive / table | {' | '.join(cells)} |")
    cells = [f"{np.median(ratios(a, b)):.2f}" for a, b in pairs]
    lines.append(f"| the same, median of the firms | {' | '.join(cells)} |")
    cells = [f"{np.mean(ratios(a, b) <= 1):.2f}" for a, b in pairs]
    lines.append(f"| firms no worse than the table | {' | '.join(cells)} |")
    cells = [f"{np.mean([row[k] for row in rows]):.3f}" for k in ("coverage before T", "coverage")]
    lines.append(f"| 90 % intervals hold | {' | '.join(cells)} | | |")
    ratio = rms("archive, calibrated") / rms("table")
    lines.append(f"| error of α, archive and T / table alone | | {ratio:.2f} | | |")
    false = np.mean([row["false suspects"] for row in rows])
    lines.append(f"| suspects per firm, none misnamed | {false:.2f} | | | |")
    return "\n".join(lines)


def misnamed_table(rows: list[dict[str, Any]]) -> str:
    keys = (
        *("bound", "name of two", "room of two", "found", "listed", "its name"),
        *("room has the least p", "false suspects"),
    )
    head = f"| change of the room's absorption | firms | {' | '.join(keys)} |"
    lines = [head, "|---" * (len(keys) + 2) + "|"]
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
    parser.add_argument("what", choices=("firms", "misnamed", "tables", "unknown", "real"))
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
        "unknown": (partial(unknown, rooms=arguments.rooms), unknown_table),
    }
    one, table = studies[arguments.what]
    rows = [one(seed) for seed in range(arguments.first, arguments.first + arguments.firms)]
    print(table(rows))
    if arguments.out:
        arguments.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
