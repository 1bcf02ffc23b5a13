"""An archive of calibrated rooms: coefficients of the materials that they have in common.

The model is linear and normal. In room r, material i has in band k the coefficient, in all
configurations of the room,

    alpha_rik = mu_ik + d_ik + h mu_ik + e_rik + g_r mu_ik.

mu is the handbook value, d its error in all rooms, h the relative error that all handbook values have
in common, e the deviation of the material in this room from others of its name, and g_r a relative
error of all coefficients of this room. The absorption area b_rsk that T needs in configuration s is sum
S_rsi alpha_rik, with the errors of the equation, of T, volume and areas. The means therefore follow
from one linear system, and the marginal likelihood in closed form (`Evidence`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import chdtrc

from rtcal.acoustics import bands
from rtcal.acoustics.room import ARCHIVE, CalibrationRecord, Material, Room
from rtcal.calibration.measured import data_history
from rtcal.calibration.result import CalibrationResult, JointResult
from rtcal.calibration.unknowns import Configurations
from rtcal.files.disk import json_numbers
from rtcal.files.saved import NUMBERS, Result, load
from rtcal.support import __version__, blocks, checks
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.errors import DataError
from rtcal.support.types import Array
from rtcal.support.workers import workforce

__all__ = ["Archive"]
__dir__ = __all__.copy

_MOST = 500
"""Largest number of rooms: their T together are one matrix."""
_OFF = 2.0
"""Standard deviations from which a table's entry is printed as off."""
_ALIKE = 1.0
"""Largest difference of one material's tables: rms over the bands, in their standard deviations."""
MISNAMED = 0.01
"""Prior probability that a material of a room is another than its name says."""


_USUAL = {
    "table": (1.0, 0.5),
    "between": (0.5, 0.7),
    "room": (0.1, 0.7),
    "together": (0.1, 0.7),
    "equation": (0.03, 0.7),
}
"""Prior of each standard deviation: its median, and the standard deviation of its logarithm."""
_LOGIT = (0.85, 1.0)
"""Prior of the band correlation's logit, as mean and standard deviation: about 0.7."""
_CENTRE, _WIDTH = np.array(
    [*((np.log(median), width) for median, width in _USUAL.values()), _LOGIT]
).T
_STEP = 0.05
"""Step of the cost's second differences, in logarithms."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Hold how much coefficients differ from their handbook values and between rooms.

    Five numbers are standard deviations and one is a correlation. `learn` fits them to the T of all
    rooms by maximum marginal likelihood with a weak prior.

    ``table`` is the standard deviation of a handbook value's error that all rooms have in common, and
    ``between`` that of a material's deviation in one room from the others, both in units of the input
    sigma. ``room`` and ``together`` are those of the relative error that all coefficients of one room,
    and all handbook values, have in common. ``equation`` is the relative error of the equation's
    absorption area. ``correlation`` is that of one material's errors in bands an octave apart.
    """

    table: float
    between: float
    """``table``: standard deviation of a handbook value's error in all rooms. ``between``: that of a
    material's deviation in one room from others of its name. Both are in units of the input sigma."""
    room: float
    together: float
    """``room``: standard deviation of the relative error that all coefficients of one room have in
    common. ``together``: that of the relative error that all handbook values have in common."""
    equation: float
    """Relative error of the absorption area from the equation, independent in each configuration and
    band."""
    correlation: float
    """Correlation of one material's errors in bands an octave apart."""


def _spread(x: Array) -> Spread:
    """The spread of its logarithms, and of the logit of its correlation.

    Each is at least 0.001: rooms without any noise would leave the covariance singular.
    """
    values = np.exp(np.clip(x[:-1], np.log(1e-3), 3)).tolist()
    correlation = float(1 / (1 + np.exp(-np.clip(x[-1], -8, 4))))
    return Spread(**dict(zip(_USUAL, values, strict=True)), correlation=correlation)


def _point(spread: Spread) -> Array:
    """The inverse of `_spread`."""
    logit = np.log(spread.correlation / (1 - spread.correlation))
    return np.append(np.log([getattr(spread, name) for name in _USUAL]), logit)


@dataclass(frozen=True, eq=False)
class RoomData:
    """Hold the absorption area that the measured T of one room needs, as data for `learn`.

    ``areas`` (n_configurations, n_materials) are the areas of the archive's materials in m². ``target``
    (n_configurations, n_bands) is the absorption area in m² that T needs, NaN in a band without T.
    ``covariance`` is that of the errors of ``target`` in m⁴, from the errors of T, volume, areas and
    climate; it has n_configurations * n_bands rows and columns.
    """

    areas: Array  # (n_states, n_materials), m² of each of the archive's materials
    target: Array  # (n_states, n_bands)
    covariance: Array


class Evidence:
    """Compute from the T of several rooms how wrong handbook values are, by a linear normal model.

    The data are the absorption areas that the measured T of all rooms need, one row for each room,
    configuration and band with a T. The model is described at the head of this module. ``rooms`` has
    the data of each room, ``mu`` and ``sigma`` (n_materials, n_bands) are the handbook coefficients and
    their standard deviations, and ``octaves`` (n_bands,) is log2 of the centre frequencies in Hz.
    """

    def __init__(self, rooms: Sequence[RoomData], mu: Array, sigma: Array, octaves: Array) -> None:
        self.mu, self.sigma, self.rooms, self.octaves = mu, sigma, rooms, octaves
        place = [(r, *at) for r, d in enumerate(rooms) for at in np.argwhere(d.target > 0).tolist()]
        self.room, state, self.band = np.array(place, dtype=int).reshape(-1, 3).T
        self.distance = np.abs(octaves[:, np.newaxis] - octaves)
        self.areas = np.array([rooms[r].areas[s] for r, s, _ in place])
        self.target = np.array([rooms[r].target[s, k] for r, s, k in place])
        self.same_room = self.room[:, np.newaxis] == self.room
        self.noise = np.zeros_like(self.same_room, dtype=float)
        for r, data in enumerate(rooms):
            rows = np.flatnonzero(self.room == r)
            used = state[rows] * len(octaves) + self.band[rows]
            self.noise[np.ix_(rows, rows)] = data.covariance[np.ix_(used, used)]
        self.expected = np.sum(self.areas * mu.T[self.band], axis=1)  # S'mu
        self.miss = self.target - self.expected
        self.spreads = self.areas * sigma.T[self.band]  # S sigma of each row and material
        self.shared = self.spreads @ self.spreads.T

    def __reduce__(self) -> tuple[type[Evidence], tuple[Any, ...]]:
        """Send what it is made of to a worker: it is far smaller than the matrices."""
        return Evidence, (self.rooms, self.mu, self.sigma, self.octaves)

    def covariance(self, spread: Spread) -> Array:
        """Return the covariance of the absorption areas in m⁴, (n_rows, n_rows), for a given spread.

        The covariance is about the absorption areas by handbook values, and contains the errors of
        handbook values, rooms, equation, T and geometry. There is one row for each room, configuration
        and band.
        """
        shared = self.shared * self.correlation(spread)[np.ix_(self.band, self.band)]
        together = np.outer(self.expected, self.expected)
        common = spread.table**2 * shared + spread.together**2 * together
        of_room = spread.between**2 * shared + spread.room**2 * together
        equation = np.diag((spread.equation * self.target) ** 2)
        own = np.where(self.same_room, of_room, 0.0) + equation + self.noise
        return np.asarray(common + own)

    def correlation(self, spread: Spread) -> Array:
        """Return the correlation of one material's errors between bands, (n_bands, n_bands)."""
        return np.asarray(spread.correlation**self.distance)

    def fitted(self, rows: NDArray[np.bool_] | None = None, start: Spread | None = None) -> Spread:
        """Return the most probable spread for some rows of the data."""
        from scipy.optimize import minimize

        first = _CENTRE if start is None else _point(start)
        return _spread(minimize(self._cost, first, (rows,), method="L-BFGS-B").x)

    def plausible(self, spread: Spread) -> list[Spread]:
        """Return twelve equally weighted spreads that represent the uncertainty of the fitted one.

        ``spread`` is the fitted one, as `fitted` returns it. The posterior density of its six numbers
        is approximated by a normal density with the same curvature. Two spreads lie on each of the six
        axes of this density, so that the twelve have its mean and covariance (Julier & Uhlmann 1997,
        Proc. SPIE 3068, Eq. 12).
        """
        centre, size = _point(spread), len(_CENTRE)
        steps = _STEP * np.eye(size)
        curvature = np.array(
            [
                [
                    sum(
                        s * t * self._cost(centre + s * a + t * b, None)
                        for s in (-1, 1)
                        for t in (-1, 1)
                    )
                    for b in steps
                ]
                for a in steps
            ]
        ) / (4 * _STEP**2)
        values, axes = np.linalg.eigh(curvature)
        # Where the cost is flat, or rounds, the prior of the spread bounds it.
        reach = np.sqrt(size / np.maximum(values, 1 / np.max(_WIDTH) ** 2))
        ends = [sign * r * axis for r, axis in zip(reach, axes.T, strict=True) for sign in (-1, 1)]
        return [_spread(centre + end) for end in ends]

    def _cost(self, x: Array, rows: NDArray[np.bool_] | None) -> float:
        """The negative logarithm of the marginal likelihood times the spread's prior."""
        used = np.s_[:, :] if rows is None else np.ix_(rows, rows)
        miss = self.miss if rows is None else self.miss[rows]
        penalty = float(np.sum(((x - _CENTRE) / _WIDTH) ** 2))
        return 0.5 * penalty - _log_density(miss, self.covariance(_spread(x))[used])

    def posterior(self, spread: Spread, rows: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return mean and covariance of the coefficients that rooms have in common, given the rooms' T.

        These coefficients are the handbook values plus the errors that the values have in all rooms.
        Their means are (n_materials, n_bands); their covariance has n_materials * n_bands rows and
        columns. ``spread`` has the standard deviations of the model. ``rows`` (n_rows,) is True for the
        absorption areas that are used; there is one for each room, configuration and band with a T.
        """
        n, k = self.mu.shape
        correlation = self.correlation(spread)
        sigma, mu = self.sigma.ravel(), self.mu.ravel()
        same = np.kron(np.eye(n), np.ones((k, k)))
        prior = spread.table**2 * same * np.tile(correlation, (n, n)) * np.outer(sigma, sigma)
        prior = prior + spread.together**2 * np.outer(mu, mu)
        matrix = self.matrix(self.areas[rows], self.band[rows])
        whole = self.covariance(spread)[np.ix_(rows, rows)]
        cross = prior @ matrix.T
        factor = cho_factor(whole, lower=True)
        mean = mu + cross @ cho_solve(factor, self.miss[rows])
        return mean.reshape(n, k), prior - cross @ cho_solve(factor, cross.T)

    def together(self, spread: Spread) -> tuple[float, float]:
        """Return mean and variance of the relative error that all handbook coefficients have in common.

        Both are numbers, given the T of all rooms. ``spread`` has the standard deviations of the model.
        """
        cross = spread.together**2 * self.expected
        gain = cho_solve(cho_factor(self.covariance(spread), lower=True), cross)
        return float(gain @ self.miss), float(spread.together**2 - gain @ cross)

    def matrix(self, areas: Array, band: NDArray[np.int_]) -> Array:
        """Return the matrix by which coefficients, (n_materials * n_bands,), give absorption areas.

        The matrix has one row for each room, configuration and band, and is in m². ``areas`` (n_rows,
        n_materials) are the areas of the materials in m², and ``band`` (n_rows,) is the number of the
        band.
        """
        out = np.zeros((len(areas), *self.mu.shape))
        out[np.arange(len(out)), :, band] = areas
        return out.reshape(len(out), -1)


@dataclass(frozen=True, kw_only=True)
class Lesson:
    """Hold what one room contributed to the archive, and how well its T agrees with the other rooms.

    ``factor`` is by how much all its coefficients differ from the archive's (0.1 is 10 % more), and
    ``p_value`` is that of its T given the other rooms.

    ``room`` is the room's name. ``factor_sigma`` is the standard deviation of ``factor``. ``q`` is the
    chi-square of the room's T against the prediction from all other rooms, with ``degrees_of_freedom``.
    ``taught`` (0 to 1) is the share by which the room reduced the standard deviations of its materials'
    means.
    """

    room: str
    factor: float
    factor_sigma: float
    """Relative deviation of all coefficients of this room from the archive's (``factor``), and its
    standard deviation."""
    q: float
    degrees_of_freedom: int
    p_value: float
    """p-value of the chi-square test of the room's T against the prediction from all other rooms."""
    taught: float
    """Share, 0 to 1, by which this room reduced the standard deviations of its materials' means."""


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """Name a material of one room that is probably another material than its name says.

    ``instead`` is the material of the archive that fits better; "" if none does.

    ``room`` and ``material`` are names. ``probability`` is that of another material; it is 0.01 before
    the data.
    """

    room: str
    material: str
    instead: str
    """Material of the archive that it more likely is; "" if it is none of them."""
    probability: float
    """Probability that it is another material; before the data it is 0.01."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Archive(Result):
    """Hold coefficients of materials that occur in several calibrated rooms (`rtcal.learn`).

    `apply` gives these coefficients to another room. ``alpha`` and ``sigma`` are the learned
    coefficients, ``table`` and ``table_sigma`` the rooms' input, (n_materials, n_bands) each;
    ``lessons`` has what each room contributed, and ``suspects`` the materials that are likely misnamed.
    """

    record_kind: ClassVar[str] = "archive 1"

    materials: tuple[str, ...]
    centre_frequencies: Array
    """Centre frequencies in Hz, (n_bands,)."""
    table: Array
    table_sigma: Array
    """Input of the rooms, (n_materials, n_bands): mean of their coefficients, and largest sigma."""
    alpha: Array
    sigma: Array
    """Learned coefficients, (n_materials, n_bands): mean and standard deviation of a coefficient in the
    next room."""
    mean_sigma: Array
    """Standard deviation of the means ``alpha``, (n_materials, n_bands); it falls with every room."""
    seen: NDArray[np.int_]
    """Number of rooms in which each material occurs, (n_materials,)."""
    spread: Spread
    """Most probable spread within and between rooms; the sigmas above also have its uncertainty."""
    together: float
    together_sigma: float
    """Relative error that all handbook values have in common (``together``), and its standard
    deviation."""
    room_sigma: float
    """Standard deviation of the relative error that all coefficients of the next room have in
    common."""
    lessons: tuple[Lesson, ...]
    suspects: tuple[Suspect, ...]
    """Materials that are likely misnamed, the most likely first."""
    measured: tuple[str, ...]
    """Texts that identify the measured T from which the archive was learned (`CalibrationRecord`)."""

    def material(self, name: str) -> Material:
        """Return a material with its sigma and source; DataError if it is not in the archive.

        ``name`` is the material's name.
        """
        if name not in self.materials:
            raise DataError(
                f'"{name}" is not a material of the archive, which has {", ".join(self.materials)}'
            )
        i = self.materials.index(name)
        return Material(
            name=name,
            alpha=self.alpha[i].tolist(),
            sigma=self.sigma[i].tolist(),
            source=self._source(i),
        )

    def apply(self, room: Room, names: Mapping[str, str] | None = None) -> Room:
        """Return a room with the archive's coefficients and sigmas for the materials that it has.

        Only materials of the same name take the archive's coefficients. If their input differs from the
        archive's by more than one standard deviation of the difference (rms over the bands), they count
        as another material and keep their input, unless they are in ``names``. The coefficients of a
        material that is not in the archive are multiplied by 1 + ``together``, because all handbook
        values have this relative error in common; those with a sigma of 0 are not. Bands that the
        archive does not have do not change. The room's ``common_alpha_sigma`` becomes ``room_sigma``,
        and its ``alpha_min`` still holds. A later calibration of the room to a T from which the archive
        was learned raises an error, because this T would count twice.

        Parameters
        ----------
        room : Room
            Room that is not calibrated yet.
        names : mapping of str to str, optional
            Name in the archive for each material of the room that has another name there, or that must
            take the archive's coefficients although they differ much from its own. By default the names
            in room and archive are the same.

        Raises
        ------
        DataError
            If the archive has no material or no band of the room, ``names`` has an unknown name, or the
            archive's rooms differ too much to predict the next (``room_sigma`` of 1 or more).
        """
        checks.instance("room", room, Room).refuse_pieces("an archive")
        known, moved, columns = self._places(room, names)
        if not known or not columns:
            what = "materials" if not known else "bands"
            raise DataError(f'the archive contains none of the {what} of room "{room.name}"')
        if not self.room_sigma < 1:
            raise DataError(
                f"room_sigma = {self.room_sigma:.3g} must be below 1: the archive's rooms differ "
                "from each other so much that they cannot predict another one. Check the rooms "
                "with a small p"
            )
        own, entry = np.ix_([*known], [*columns]), np.ix_([*known.values()], [*columns.values()])
        alpha, sigma = room.alpha.copy(), room.sigma.copy()
        alpha[own], sigma[own] = self.alpha[entry], self.sigma[entry]
        other = np.ix_(moved, [*columns])
        inexact = sigma[other] > 0
        sigma[other] = np.hypot(sigma[other], inexact * self.together_sigma * alpha[other])
        alpha[other] *= 1 + inexact * self.together
        alpha, sigma = np.clip(alpha, 0.0, 1.0), np.minimum(sigma, 1.0)
        if room.alpha_min is not None:
            alpha = np.maximum(alpha, room.alpha_min)
        sources = dict(room.sources)
        rest = np.delete(room.centre_frequencies, [*columns])
        for i in [*known, *moved]:
            name = room.materials[i]
            held = sources.get(name, "the room's table")
            label = (
                self._source(known[i]) if i in known else f"{held} times {1 + self.together:.2f}"
            )
            sources[name] = (
                f"{label}; {', '.join(bands.labels(rest))}: {held}" if rest.size else label
            )
        before = [] if room.calibration is None else [room.calibration.measured]
        record = CalibrationRecord(
            method=ARCHIVE,
            equation="that of each of its rooms",
            measured=" ".join([*before, *self.measured]),
            version=__version__,
        )
        return room.replace(
            alpha=alpha,
            sigma=sigma,
            sources=sources,
            common_alpha_sigma=self.room_sigma,
            calibration=record,
        )

    def left_as_stated(self, room: Room, names: Mapping[str, str] | None = None) -> tuple[str, ...]:
        """Return sentences that name the materials and bands of a room that `apply` does not change.

        ``room`` and ``names`` are those of `apply`: a room that is not calibrated yet, and the
        archive's name for each material of the room that has another name there; None if all names are
        the same. Raises DataError if ``names`` has an unknown name.
        """
        known, moved, columns = self._places(room, names)
        left = [i for i in range(room.n_materials) if i not in known and i not in moved]
        apart = [i for i in left if room.materials[i] in self.materials]
        rest = np.delete(room.centre_frequencies, [*columns])
        bands_left = [", ".join(bands.labels(rest))] if rest.size else []

        def quoted(rows: list[int]) -> list[str]:
            return [f'"{room.materials[i]}"' for i in rows]

        kept, lacks = "Left at the room's values, because the archive", "does not contain them"
        factor = f"times {1 + self.together:.2f}, the correction of all tables"
        reasons = (
            (f"The archive {lacks}, so the room's own tables are used, {factor}", quoted(moved)),
            (f"{kept} {lacks}", quoted([i for i in left if i not in apart])),
            (f"{kept} has another material of that name, by its table", quoted(apart)),
            (f"{kept} {lacks}", bands_left),
        )
        return tuple(f"{why}: {', '.join(these)}." for why, these in reasons if these)

    def _places(
        self, room: Room, names: Mapping[str, str] | None
    ) -> tuple[dict[int, int], list[int], dict[int, int]]:
        """The room's materials that are the archive's, with their places in it; likewise its bands.

        Between the two are the materials whose tables are moved as all tables are.
        """
        mapped = checks.mapped("names", {} if names is None else names)
        for own, entry in mapped.items():
            if own not in room.materials or entry not in self.materials:
                raise DataError(
                    f'names: "{own}" = "{entry}" must pair a material of the room with one '
                    "of the archive"
                )
        found = [
            (k, bands.index(self.centre_frequencies, float(f)))
            for k, f in enumerate(room.centre_frequencies)
        ]
        columns = {k: place for k, place in found if place is not None}
        own, entries = [*columns], [*columns.values()]
        known, moved = {}, []
        # A room that has a record states no table, but what data made of one.
        stated = room.calibration is None
        for i, m in enumerate(room.materials):
            called = mapped.get(m, m)
            if called in self.materials:
                j = self.materials.index(called)
                tables = (room.alpha[i, own], room.sigma[i, own])
                entry = (self.table[j, entries], self.table_sigma[j, entries])
                if m in mapped or not stated or not own or _is_one_material(*tables, *entry):
                    known[i] = j
            elif stated and (room.sigma[i] > 0).any():
                moved.append(i)
        return known, moved, columns

    def _source(self, i: int) -> str:
        return f"archive of {len(self.lessons)} rooms, in {self.seen[i]} of them"

    @property
    def off(self) -> Array:
        """Relative change (alpha - table) / table from the input to the learned coefficient.

        The shape is (n_materials, n_bands), with NaN where the input coefficient is 0.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.table > 0, self.alpha / self.table - 1, np.nan)

    def to_dict(self) -> dict[str, Any]:
        """Return the archive as plain lists and numbers: materials, rooms and likely wrong names."""
        return {
            "centre_frequencies": json_numbers(self.centre_frequencies),
            "materials": [
                {
                    "name": name,
                    "rooms": int(self.seen[i]),
                    "table": json_numbers(self.table[i]),
                    "alpha": json_numbers(self.alpha[i]),
                    "sigma": json_numbers(self.sigma[i]),
                    "mean_sigma": json_numbers(self.mean_sigma[i]),
                    "off": json_numbers(self.off[i]),
                }
                for i, name in enumerate(self.materials)
            ],
            "spread": asdict(self.spread),
            "together": self.together,
            "together_sigma": self.together_sigma,
            "room_sigma": self.room_sigma,
            "rooms": [asdict(lesson) for lesson in self.lessons],
            "suspects": [asdict(suspect) for suspect in self.suspects],
        }

    def __repr__(self) -> str:
        return f"<Archive of {len(self.lessons)} rooms, {len(self.materials)} materials>"

    def __str__(self) -> str:
        return "\n".join(blocks.lines(self._blocks()))

    def _blocks(self) -> list[Block]:
        """The materials, the rooms, and what they say of the tables."""
        labels, spread = bands.labels(self.centre_frequencies), self.spread
        shift = (self.alpha - self.table) / np.maximum(self.mean_sigma, 1e-12)
        materials = [
            Row(
                f"{name} ({self.seen[i]})",
                [
                    f"{a:.3f}{'*' if abs(z) >= _OFF else ' '}"
                    for a, z in zip(self.alpha[i], shift[i], strict=True)
                ],
            )
            for i, name in enumerate(self.materials)
        ]
        of_rooms = {
            "common change of alpha": [f"{100 * lesson.factor:+.0f} %" for lesson in self.lessons],
            "p of its T": [f"{lesson.p_value:.2g}" for lesson in self.lessons],
            "sigma reduced by": [f"{100 * lesson.taught:.0f} %" for lesson in self.lessons],
        }
        rooms = Table.of_columns([lesson.room for lesson in self.lessons], of_rooms)
        notes = [
            "Standard deviations: the error of a table's coefficient, the same in all rooms, is "
            f"{spread.table:.2g} times its input sigma; the difference of a material between rooms is "
            f"{spread.between:.2g} times this sigma; the error that all coefficients of a room share "
            f"is {100 * spread.room:.0f} %; the error of the equation in one band is "
            f"{100 * spread.equation:.0f} %.",
            *(
                f'In room "{s.room}", "{s.material}" is likely '
                + (f'"{s.instead}"' if s.instead else "none of the archive's materials")
                + f" (p = {s.probability:.2f}): check the material, then correct its name "
                "or leave the room out."
                for s in self.suspects
            ),
        ]
        head = f"alpha (number of rooms; *: {_OFF:g} or more standard deviations from the table)"
        return [
            Note(
                f"In {len(self.lessons)} rooms, alpha of {len(self.materials)} materials differs from "
                f"the rooms' input by a common {100 * self.together:+.0f} ± "
                f"{100 * self.together_sigma:.0f} % (standard deviation)."
            ),
            Table(labels, materials, head),
            replace(rooms, title="Each room compared with the prediction from all other rooms"),
            *map(Note, notes),
        ]


def _is_one_material(mu: Array, sigma: Array, other: Array, other_sigma: Array) -> bool:
    """Whether two tables under one name are near enough to be of one material; (n_bands,) each."""
    off, spread = np.abs(mu - other), np.hypot(sigma, other_sigma)
    z = np.divide(off, spread, out=np.where(off > 0, np.inf, 0.0), where=spread > 0)
    return bool(np.sqrt(np.mean(z**2)) <= _ALIKE)


Calibrated = CalibrationResult | JointResult


def _states(result: Calibrated) -> tuple[Sequence[CalibrationResult], Configurations]:
    """The results of a room's states, and the states before the calibration."""
    if isinstance(result, JointResult):
        return result.results, result.configurations
    return (result,), Configurations([result.prior])


def _room(result: Calibrated) -> Room:
    """The room before the calibration, with the materials of all states."""
    return _states(result)[1].union


def _data(result: Calibrated, places: Sequence[int], n: int, columns: Sequence[int]) -> RoomData:
    """What T asks for in some bands, by no method, with the ``places`` of the materials among ``n``.

    T, volume, areas and climate count. A T without a stated uncertainty counts as exact: its error
    is then part of the equation's, which the rooms tell.
    """
    results, states = _states(result)
    equation = results[0].equation
    t = np.array([each.measured for each in results])
    each = list(zip(states.rooms, t, results, strict=True))
    u = [r.measured_uncertainty * equation.target_sensitivity(room, t) for room, t, r in each]
    changes = states.target_changes(equation, t)
    covariance = np.diag(np.nan_to_num(np.ravel(u)) ** 2) + changes.T @ changes
    target = np.array([equation.target(room, t) for room, t, _ in each])
    areas = np.zeros((len(t), n))
    areas[:, places] = states.areas
    used = (np.arange(len(t))[:, np.newaxis] * t.shape[1] + columns).ravel()
    return RoomData(areas, target[:, columns], covariance[np.ix_(used, used)])


def learn(
    rooms: Sequence[Calibrated],
    names: Mapping[str, str] | None = None,
    *,
    scheduler: str | None = None,
) -> Archive:
    """Return an archive of the absorption coefficients that calibrated rooms have in common.

    A material's coefficient in a room is modelled as the mean of this material over all rooms, plus its
    deviation in this room, plus a relative deviation that all coefficients of the room have in common.
    How much materials differ between rooms, and how wrong handbook values are, is estimated from all
    rooms together. Only the rooms' input coefficients and measured T count, not how the rooms were
    calibrated. Nothing leaves the machine without ``scheduler``.

    Parameters
    ----------
    rooms : sequence of CalibrationResult or JointResult
        Calibrations of two or more rooms with different names. A `JointResult` is one room, with the
        name of its first configuration. The archive has the bands that all rooms have.
    names : mapping of str to str, optional
        Name that the archive gives to a material, by the material's name in its room. By default
        materials with the same name in several rooms are one material of the archive if their input
        coefficients are similar; else the room's name is added to the name of the later material.
    scheduler : str, optional
        Address of a Dask scheduler whose workers predict T of each room from the other rooms, which
        shows misnamed materials; None for threads of this machine.

    Returns
    -------
    Archive
        Coefficients of the materials, how much each room added to their accuracy, and the materials
        that are likely misnamed.

    Raises
    ------
    DataError
        For fewer than two rooms, a room that occurs twice, rooms without common bands, an unknown name
        in ``names``, or a room in which two materials get one name.
    ClusterError
        If the scheduler or its workers fail.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> t = 1.2 * rt.Eyring().reverberation_time(room)  # both rooms absorb less than the handbook says
    >>> rooms = [rt.calibrate(room.replace(name=n), f * t) for n, f in (("A", 1.0), ("B", 0.97))]
    >>> archive = learn(rooms)
    >>> floor = archive.materials.index("floor")
    >>> int(archive.seen[floor]), bool(archive.alpha[floor, 2] < room.material("floor").alpha[2])
    (2, True)
    """
    used = _counted(rooms)
    mapped = checks.mapped("names", {} if names is None else names)
    priors = [_room(result) for result in used]
    for room in priors:
        room.refuse_pieces("an archive")
    known = {m for room in priors for m in room.materials}
    if unknown := [name for name in mapped if name not in known]:
        raise DataError(
            f'names: "{unknown[0]}" is not a material of any room; the rooms have '
            f"{', '.join(sorted(known)[:20])}"
        )
    places = {
        f: [bands.index(room.centre_frequencies, f) for room in priors]
        for f in priors[0].centre_frequencies
    }
    common = {f: [i for i in at if i is not None] for f, at in places.items() if None not in at}
    if not common:
        raise DataError("the rooms have no band in common")
    frequencies = np.array([*common])
    columns = [list(of_room) for of_room in zip(*common.values(), strict=True)]
    called, tables = _named(priors, mapped, columns)
    materials = tuple(tables)
    mu = np.array([np.mean([alpha for alpha, _ in rows], axis=0) for rows in tables.values()])
    sigma = np.array([np.max([each for _, each in rows], axis=0) for rows in tables.values()])
    data = [
        _data(result, [materials.index(m) for m in row], len(materials), of_room)
        for result, row, of_room in zip(used, called, columns, strict=True)
    ]
    if not any(np.isfinite(d.target).any() for d in data):
        raise DataError("no room has a measured T in the common bands")
    evidence = Evidence(data, mu, sigma, np.log2(frequencies))
    spread = evidence.fitted()
    every = np.ones(len(evidence.room), dtype=bool)
    left = _sigma(evidence.posterior(spread, every)[1], mu.shape)
    # The spread is uncertain itself: means and variances are those of the mixture.
    mixed = [(each, *evidence.posterior(each, every)) for each in evidence.plausible(spread)]
    mean = np.mean([m for _, m, _ in mixed], axis=0)
    of_mean = np.mean([_sigma(c, mu.shape) ** 2 + (m - mean) ** 2 for _, m, c in mixed], axis=0)
    off, off_variance = np.array([evidence.together(each) for each, _, _ in mixed]).T
    of_rooms = np.mean([(each.between * sigma) ** 2 for each, _, _ in mixed], axis=0)
    lessons: list[Lesson] = []
    suspects: list[Suspect] = []
    measured = np.unique(evidence.room).tolist()
    task = partial(_judged, evidence, spread, left)
    jobs = [(r, priors[r].name) for r in measured]
    with workforce(scheduler) as workers:
        judged = [*workers.in_order(task, jobs)]
    for r, (lesson, suspicion) in zip(measured, judged, strict=True):
        room, row = priors[r], called[r]
        lessons.append(lesson)
        by_material = suspicion.sum(axis=1)
        suspects += [
            Suspect(
                room=room.name,
                material=room.materials[row.index(materials[i])],
                instead=[*materials, ""][int(np.argmax(suspicion[i]))],
                probability=float(by_material[i]),
            )
            for i in np.flatnonzero(by_material > 0.5)
        ]
    return Archive(
        materials=materials,
        centre_frequencies=frequencies,
        table=mu,
        table_sigma=sigma,
        alpha=np.clip(mean, 0.0, 1.0),
        sigma=np.sqrt(of_mean + of_rooms),
        mean_sigma=np.sqrt(of_mean),
        seen=np.array([len(rows) for rows in tables.values()]),
        spread=spread,
        together=float(off.mean()),
        together_sigma=float(np.sqrt(off_variance.mean() + off.var())),
        room_sigma=float(np.sqrt(np.mean([each.room**2 for each, _, _ in mixed]))),
        lessons=tuple(lessons),
        suspects=tuple(sorted(suspects, key=lambda s: -s.probability)),
        measured=tuple(
            data_history(each.prior, each.measured_data)
            for result in used
            for each in _states(result)[0]
        ),
    )


def _sigma(covariance: Array, shape: tuple[int, ...]) -> Array:
    return np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(shape)


def _counted(rooms: Sequence[Calibrated]) -> Sequence[Calibrated]:
    """The rooms, of which there are enough; DataError otherwise."""
    listed = checks.listed("rooms", rooms)
    for i, room in enumerate(listed):
        if not isinstance(room, Calibrated):
            raise DataError(f"rooms[{i}] = {checks.shown(room)} is not a result of rtcal.calibrate")
    names = [_room(result).name for result in listed]
    if repeated := [n for i, n in enumerate(names) if n in names[:i]]:
        raise DataError(
            f'room "{repeated[0]}" occurs twice; leave one out, because its T would count twice'
        )
    if not 2 <= len(listed) <= _MOST:
        raise DataError(
            f"{len(listed)} calibrated rooms are given; an archive needs 2 to {_MOST}, each the "
            "result of a calibration"
        )
    return listed


def _named(
    rooms: Sequence[Room], names: Mapping[str, str], columns: Sequence[Sequence[int]]
) -> tuple[list[list[str]], dict[str, list[tuple[Array, Array]]]]:
    """The archive's names of each room's materials, and the tables (alpha, sigma) of each name.

    Each name is for one table: of another one it is "name (room)". Those in ``names`` are one. A room
    that has a record states no table, but what an archive or a calibration made of one.
    """
    one = set(names.values())
    tables: dict[str, list[tuple[Array, Array]]] = {}
    entries: dict[str, list[str]] = {}
    called = []
    for room, of_room in zip(rooms, columns, strict=True):
        stated = [str(names.get(m, m)) for m in room.materials]
        if repeated := [m for i, m in enumerate(stated) if m in stated[:i]]:
            raise DataError(
                f'room "{room.name}": two of its materials are "{repeated[0]}" in the '
                "archive; give them different names, or make them one material of the "
                "room"
            )
        row = []
        for i, name in enumerate(stated):
            table, known = (
                (room.alpha[i, of_room], room.sigma[i, of_room]),
                entries.setdefault(name, []),
            )
            alike = name in one or room.calibration
            entry = next(
                (e for e in known if alike or _is_one_material(*table, *tables[e][0])), None
            )
            if entry is None:
                entry = f"{name} ({room.name})" if known else name
                known.append(entry)
            tables.setdefault(entry, []).append(table)
            row.append(entry)
        called.append(row)
    return called, tables


def _judged(
    evidence: Evidence, spread: Spread, left: Array, job: tuple[int, str]
) -> tuple[Lesson, Array]:
    """Return what one room taught, and the probability that its materials are others of the archive.

    The job is the room's number and name. The probability (n_materials, n_materials + 1) is that the
    first is the second; the last column is none of the archive's. The spread of the other rooms is
    found without this one: a room that does not fit would excuse itself. ``spread`` is that of all
    rooms, with which the search begins, and ``left`` (n_materials, n_bands) the standard deviation of
    the entries by all rooms.
    """
    room, name = job
    own = evidence.room == room
    n = len(evidence.mu)
    # With the spread of all rooms, so that the difference is what this room taught of the means.
    less = np.diag(evidence.posterior(spread, ~own)[1])
    spread = evidence.fitted(~own, spread)
    mean, covariance = evidence.posterior(spread, ~own)
    band, stated = evidence.band[own], evidence.areas[own]
    correlation = evidence.correlation(spread)[np.ix_(band, band)]
    target = evidence.target[own]
    noise = evidence.noise[np.ix_(own, own)] + np.diag((spread.equation * target) ** 2)
    # A material that the archive lacks comes last: like one of its entries, but nobody knows which.
    width = np.sqrt(mean.var(axis=0) + np.mean(evidence.sigma**2, axis=0))
    every = np.vstack([mean, mean.mean(axis=0)])
    apart = np.vstack([spread.between * evidence.sigma, width]).T[band]

    def predicted(areas: Array) -> tuple[Array, Array]:
        """b and its covariance with these areas in m², (n_rows, n_materials + 1)."""
        total = np.sum(areas * every.T[band], axis=1)
        matrix = evidence.matrix(areas[:, :n], band)
        own, factor = areas * apart, spread.room * total
        among = own @ own.T * correlation + np.outer(factor, factor)
        return total, matrix @ covariance @ matrix.T + among + noise

    areas = np.column_stack([stated, np.zeros(len(stated))])
    total, whole = predicted(areas)
    base = _log_density(target - total, whole)
    found = np.flatnonzero(stated.any(axis=0))
    ratio = np.full((n, n + 1), -np.inf)
    for i in found:
        for j in np.delete(np.arange(n + 1), i):
            moved = areas.copy()
            moved[:, j] += areas[:, i]
            moved[:, i] = 0.0
            total_j, whole_j = predicted(moved)
            ratio[i, j] = _log_density(target - total_j, whole_j) - base
    odds = MISNAMED / n * np.exp(np.minimum(ratio, 600.0))
    rest = 1 - MISNAMED * len(found)
    pull = spread.room**2 * total
    gain = np.linalg.solve(whole, pull)
    miss = target - total
    q = float(miss @ np.linalg.solve(whole, miss))
    without = np.sqrt(np.maximum(less, 0.0)).reshape(n, -1)
    known = np.flatnonzero(odds.sum(axis=1) > 0)
    learnt = [1 - left[i] / without[i] for i in known if (without[i] > 0).all()]
    lesson = Lesson(
        room=name,
        factor=float(gain @ miss),
        factor_sigma=float(np.sqrt(np.maximum(spread.room**2 - gain @ pull, 0.0))),
        q=q,
        degrees_of_freedom=len(miss),
        p_value=float(chdtrc(len(miss), q)),
        taught=float(np.mean(learnt)) if learnt else 0.0,
    )
    return lesson, odds / (rest + odds.sum())


def _log_density(miss: Array, covariance: Array) -> float:
    factor, low = cho_factor(covariance, lower=True)
    quadratic = miss @ cho_solve((factor, low), miss)
    return float(-0.5 * quadratic - np.sum(np.log(np.diag(factor))))


def materials(result: Calibrated) -> tuple[str, ...]:
    """Return the names of all materials in the configurations of a calibrated room."""
    return tuple(_room(result).materials)


def read_folder(folder: str | os.PathLike[str]) -> list[Calibrated]:
    """Return the calibrations that ``rtcal calibrate --out`` has saved in a folder and below it.

    Calibrations are read from files named ``result.json``; other results in such files are left out.
    Raises DataError if there is no calibration, if there are more than 500 such files, or if one of
    them cannot be read.
    """
    if not checks.path("folder", folder).is_dir():
        raise DataError(f"{folder}: no such file or folder")
    files = sorted(Path(folder).rglob(NUMBERS))
    if not files:
        raise DataError(
            f"the folder {folder} has no {NUMBERS}. Write one with `rtcal calibrate ROOM "
            f"MEASURED --out {folder}`"
        )
    kept = []
    for file in files:
        result = load(file)
        if isinstance(result, Calibrated):
            kept.append(result)
        if len(kept) > _MOST:
            raise DataError(
                f"the folder {folder} has more than {_MOST} calibrations: give a folder with fewer"
            )
    if not kept:
        raise DataError(
            f"the folder {folder} has results, but none of them is a calibration. Write "
            "one with `rtcal calibrate ROOM MEASURED --out FOLDER`"
        )
    return kept
