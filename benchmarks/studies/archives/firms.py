"""Hidden firms with measured rooms, and what an observer knows of them who knows every spread.

A firm has 20 measured rooms and 12 materials, 4 to 8 in each room. The tables that it uses are off:
together by 10 %, each entry by 25 % (its bands go together), and a material differs between rooms by
10 %. Volume and areas are off by 3 %, and T is measured to 3 %. The tables state sigma = 0.3 alpha.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

import rtcal as rt
from rtcal.acoustics.room_errors import target_changes
from rtcal.calibration.archive import MISNAMED
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


def measured(t: Array) -> rt.Measurement:
    return rt.Measurement(
        centre_frequencies=BANDS,
        values={"t30": t[np.newaxis]},
        uncertainty={"t30": TIME * t[np.newaxis]},
    )


def calibrated(room: rt.Room, t: Array) -> rt.calibration.CalibrationResult:
    return rt.calibrate(room, measured(t), "soft", EQUATION)


def knowing(firm: Firm, rooms: int) -> rt.Room:
    """The twenty-first room as an observer knows it who knows every spread of the firm exactly.

    The coefficients' posterior mean and standard deviation, given the tables and so many rooms.
    """
    mu = firm.table.ravel()
    of_table = np.kron(np.eye(MATERIALS), OF_BANDS)
    prior = np.outer(mu, mu) * (TOGETHER**2 + TABLE**2 * of_table)
    of_room = np.outer(mu, mu) * BETWEEN**2 * of_table
    matrices, misses, noises = [], [], []
    for room, _, t in firm.rooms[:rooms]:
        areas = np.zeros((1, MATERIALS))
        areas[0, [firm.names.index(m) for m in room.materials]] = room.areas
        matrix = np.kron(areas, np.eye(len(BANDS)))
        changes = target_changes(EQUATION, room, t)
        u = TIME * t * EQUATION.target_sensitivity(room, t)
        matrices.append(matrix)
        misses.append(EQUATION.target(room, t) - matrix @ mu)
        noises.append(matrix @ of_room @ matrix.T + changes.T @ changes + np.diag(u**2))
    matrix = np.concatenate(matrices)
    gain = np.linalg.solve(block_diag(*noises) + matrix @ prior @ matrix.T, matrix @ prior).T
    mean = (mu + gain @ np.concatenate(misses)).reshape(firm.table.shape)
    variance = np.diag(prior - gain @ matrix @ prior + of_room).reshape(firm.table.shape)
    last = firm.rooms[-1][0]
    which = [firm.names.index(m) for m in last.materials]
    return last.replace(alpha=np.clip(mean[which], 0, 1), sigma=np.sqrt(variance[which]))


def bound(
    firm: Firm, stated: list[tuple[rt.Room, Array]], hidden: tuple[int, int]
) -> dict[str, bool]:
    """Whether an observer who knows the firm's materials and all spreads finds the misnamed one.

    That is the most that any archive can find: its materials are known without an error. ``hidden`` is
    the number of the room and of its misnamed material. "bound": likelier wrong than right. The others
    are told that one name in the firm is wrong, and list the two likeliest names, or rooms.
    """
    likelier: list[tuple[float, int, int]] = []
    found = False
    for r, (room, t) in enumerate(stated):
        odds = misnamed_odds(firm, room, t)
        n = len(odds)
        each = odds.sum(axis=1)
        likelier += [(float(each[i] / (n * (MATERIALS - n))), r, i) for i in range(n)]
        if r == hidden[0]:
            prior = MISNAMED / MATERIALS
            found = bool(prior * each[hidden[1]] > 0.5 * (1 - MISNAMED * n + prior * each.sum()))
    names = [name[1:] for name in sorted(likelier, reverse=True)[:2]]
    of_room = [sum(p for p, room, _ in likelier if room == r) for r in range(len(stated))]
    return {
        "bound": found,
        "name of two": hidden in names,
        "room of two": hidden[0] in np.argsort(of_room)[-2:],
    }


def misnamed_odds(firm: Firm, room: rt.Room, t: Array) -> Array:
    """Likelihood of T with material i being j over that as stated, (n_materials, MATERIALS)."""
    b = EQUATION.target(room, t)

    def density(which: list[int]) -> float:
        own = room.areas[:, np.newaxis] * firm.true[which] * np.exp(BETWEEN**2 / 2)
        total = own.sum(axis=0)
        covariance = own.T @ own * (BETWEEN**2 * OF_BANDS + SIZE**2)
        covariance += SIZE**2 * np.outer(total, total) + np.diag((TIME * total) ** 2)
        factor = np.linalg.cholesky(covariance)
        miss = np.linalg.solve(factor, b - total)
        return float(-0.5 * miss @ miss - np.log(np.diag(factor)).sum())

    named = [firm.names.index(m) for m in room.materials]
    base = density(named)
    odds = np.zeros((len(named), MATERIALS))
    for i in range(len(named)):
        for j in set(range(MATERIALS)) - set(named):
            ratio = density([*named[:i], j, *named[i + 1 :]]) - base
            odds[i, j] = np.exp(min(ratio, 600.0))
    return odds
