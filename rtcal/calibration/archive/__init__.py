"""An archive of calibrated rooms, and what they say of the materials that they share."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from rtcal.acoustics.bands import index
from rtcal.acoustics.room import Room
from rtcal.calibration.archive import likelihood
from rtcal.calibration.archive.library import Archive, Lesson, Suspect, is_one_material
from rtcal.calibration.archive.likelihood import Evidence, RoomData, Spread
from rtcal.calibration.measured import data_history
from rtcal.calibration.result import CalibrationResult, JointResult
from rtcal.calibration.unknowns import Configurations
from rtcal.files.saved import NUMBERS, load
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

__all__ = ["Archive", "Lesson", "Spread", "Suspect", "read_folder"]
__dir__ = __all__.copy

_MOST = 500
"""Largest number of rooms: their T together are one matrix."""


@dataclass(frozen=True, eq=False)
class _Calibrated:
    """A calibrated room: the results of its states."""

    results: Sequence[CalibrationResult]

    @cached_property
    def states(self) -> Configurations:
        """The states before the calibration."""
        return Configurations([result.prior for result in self.results])

    @property
    def room(self) -> Room:
        """The room before the calibration, with the materials of all states."""
        return self.states.union

    @classmethod
    def of(cls, result: CalibrationResult | JointResult) -> _Calibrated:
        """The room of a result."""
        return cls(result.results if isinstance(result, JointResult) else (result,))

    def asked(self) -> tuple[Array, Array]:
        """b in m², (n_states, n_bands), and its covariance, by no method.

        T, volume, areas and climate count. A T without a stated uncertainty counts as exact: its error
        is then part of the equation's, which the rooms tell.
        """
        equation = self.results[0].equation
        t = np.array([result.measured for result in self.results])
        each = list(zip(self.states.rooms, t, self.results, strict=True))
        u = [r.measured_uncertainty * equation.target_sensitivity(room, t) for room, t, r in each]
        changes = self.states.target_changes(equation, t)
        noise = np.diag(np.nan_to_num(np.ravel(u)) ** 2)
        b = np.array([equation.target(room, t) for room, t, _ in each])
        return b, noise + changes.T @ changes


def learn(
    rooms: Sequence[CalibrationResult | JointResult],
    names: Mapping[str, str] | None = None,
    weights: Mapping[str, float] | None = None,
) -> Archive:
    """Learn from calibrated rooms what the materials that they share absorb.

    alpha of material i in room r is the material's mean, an error of the room's own and a factor of the
    room, the same in all states of the room; see `rtcal.calibration.archive.likelihood`. How
    far a material differs between rooms, how far the tables are off, alone and together, follow by
    marginal likelihood; the means by one linear step, cut to 0 to 1 after it. Only the rooms' stated
    priors and measured T count, not how they were calibrated. Nothing leaves the machine.

    Parameters
    ----------
    rooms : sequence of CalibrationResult or JointResult
        Two or more, each with a name of its own: that of the first configuration of a `JointResult`,
        whose configurations are states of one room. Their common bands are used.
    names : mapping of str to str, optional
        From a room's name of a material to the archive's, where the two differ. A name that it does not
        give is one material where the rooms' tables are near; else the later room's name stands by it.
    weights : mapping of room name to float, optional
        Between 0 and 1: how far a room counts; 0 leaves it out. 1 if not given.

    Returns
    -------
    Archive
        The library, what each room taught, and materials that are likely misnamed.

    Raises
    ------
    DataError
        For fewer than two rooms, one that occurs twice, rooms without common bands, an unknown name in
        ``names`` or ``weights``, or a room in which two materials get one name.

    Examples
    --------
    >>> import rtcal as rt
    >>> room, measured = rt.datasets.bras_cr2()
    >>> t = 1.2 * rt.Eyring().reverberation_time(room)  # they absorb less than stated
    >>> rooms = [rt.calibrate(room.replace(name=n), f * t) for n, f in (("A", 1.0), ("B", 0.97))]
    >>> archive = learn(rooms)
    >>> print(archive.seen, bool(archive.material("floor").alpha[2] < room.alpha[3, 2]))
    [2 2 2 2 2] True
    """
    used, of_room = _weighed(rooms, weights)
    mapped = checks.mapped("names", {} if names is None else names)
    known = {m for each in used for m in each.room.materials}
    if unknown := [name for name in mapped if name not in known]:
        raise DataError(
            f'names: "{unknown[0]}" is a material of no room; there are {", ".join(sorted(known)[:20])}'
        )
    called = [_called(each.room, mapped) for each in used]
    columns_of = {
        f: [index(each.room.centre_frequencies, f) for each in used]
        for f in used[0].room.centre_frequencies
    }
    common = {f: [i for i in at if i is not None] for f, at in columns_of.items() if None not in at}
    if not common:
        raise DataError("the rooms have no band in common")
    frequencies = np.array([*common])
    entries = [list(columns) for columns in zip(*common.values(), strict=True)]
    called = _told_apart(used, called, entries, {*mapped.values()})
    materials = tuple(dict.fromkeys(m for row in called for m in row))
    mu, sigma, seen = _tables(used, called, materials, entries)
    data = [
        _data(each, row, materials, columns, weight)
        for each, row, columns, weight in zip(used, called, entries, of_room, strict=True)
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
    lessons, doubts = [], []
    for r, room in enumerate(each.room for each in used):
        if not (evidence.room == r).any():
            continue
        lesson, doubt = _lesson(room.name, evidence, likelihood.judged(evidence, spread, r), left)
        lessons.append(lesson)
        doubts += [
            Suspect(
                room=room.name,
                material=room.materials[called[r].index(materials[i])],
                instead=materials[j] if j < len(materials) else "",
                probability=p,
            )
            for i, j, p in doubt
        ]
    return Archive(
        materials=materials,
        centre_frequencies=frequencies,
        table=mu,
        table_sigma=sigma,
        alpha=np.clip(mean, 0.0, 1.0),
        sigma=np.sqrt(of_mean + of_rooms),
        mean_sigma=np.sqrt(of_mean),
        seen=seen,
        spread=spread,
        together=float(off.mean()),
        together_sigma=float(np.sqrt(off_variance.mean() + off.var())),
        room_sigma=float(np.sqrt(np.mean([each.room**2 for each, _, _ in mixed]))),
        lessons=tuple(lessons),
        suspects=tuple(sorted(doubts, key=lambda s: -s.probability)),
        measured=tuple(
            data_history(result.prior, result.measured_data)
            for each in used
            for result in each.results
        ),
    )


def _sigma(covariance: Array, shape: tuple[int, ...]) -> Array:
    return np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(shape)


def _weighed(
    rooms: Sequence[CalibrationResult | JointResult], weights: Mapping[str, float] | None
) -> tuple[list[_Calibrated], list[float]]:
    """The rooms that count, and how far."""
    listed = checks.listed("rooms", rooms)
    for i, room in enumerate(listed):
        if not isinstance(room, CalibrationResult | JointResult):
            raise DataError(f"rooms[{i}] = {checks.shown(room)} is no result of rtcal.calibrate")
    calibrated = [_Calibrated.of(result) for result in listed]
    names = [each.room.name for each in calibrated]
    if repeated := [n for i, n in enumerate(names) if n in names[:i]]:
        raise DataError(f'room "{repeated[0]}" occurs twice; its T would count twice')
    stated = checks.mapped("weights", {} if weights is None else weights)
    for name, value in stated.items():
        if name not in names:
            raise DataError(f'weights: "{name}" is no room; there are {", ".join(names[:20])}')
        if not 0 <= checks.number(f'weights["{name}"]', value) <= 1:
            raise DataError(f'weights["{name}"] = {value:g} is not from 0 to 1')
    kept = [(r, float(stated.get(name, 1.0))) for r, name in zip(calibrated, names, strict=True)]
    kept = [(r, w) for r, w in kept if w > 0]
    if not 2 <= len(kept) <= _MOST:
        raise DataError(f"rooms that count: {len(kept)}; an archive has from 2 to {_MOST}")
    return [r for r, _ in kept], [w for _, w in kept]


def _called(room: Room, names: Mapping[str, str]) -> list[str]:
    """The archive's names of a room's materials."""
    called = [str(names.get(m, m)) for m in room.materials]
    if repeated := [m for i, m in enumerate(called) if m in called[:i]]:
        raise DataError(
            f'room "{room.name}": two of its materials are "{repeated[0]}"; merge them there'
        )
    return called


def _told_apart(
    rooms: Sequence[_Calibrated],
    called: Sequence[Sequence[str]],
    entries: Sequence[Sequence[int]],
    stated: Set[str],
) -> list[list[str]]:
    """The names, each for one table: of another table under it, "name (room)". ``stated`` are one.

    A room that has a record states no table, but what an archive or a calibration made of one.
    """
    tables: dict[str, list[tuple[str, tuple[Array, Array]]]] = {}

    def entry(name: str, room: Room, table: tuple[Array, Array]) -> str:
        known = tables.setdefault(name, [])
        for found, other in known:
            if name in stated or room.calibration or is_one_material(*table, *other):
                return found
        known.append((f"{name} ({room.name})" if known else name, table))
        return known[-1][0]

    return [
        [
            entry(name, each.room, (each.room.alpha[i, columns], each.room.sigma[i, columns]))
            for i, name in enumerate(row)
        ]
        for each, row, columns in zip(rooms, called, entries, strict=True)
    ]


def _tables(
    rooms: Sequence[_Calibrated],
    called: Sequence[Sequence[str]],
    materials: Sequence[str],
    entries: Sequence[Sequence[int]],
) -> tuple[Array, Array, NDArray[np.int_]]:
    """The mean of the rooms' entries for each material, their largest sigma, and how many there are."""
    mu, sigma, seen = [], [], []
    for name in materials:
        rows = [
            (each.room.alpha[row.index(name), columns], each.room.sigma[row.index(name), columns])
            for each, row, columns in zip(rooms, called, entries, strict=True)
            if name in row
        ]
        mu.append(np.mean([alpha for alpha, _ in rows], axis=0))
        sigma.append(np.max([each for _, each in rows], axis=0))
        seen.append(len(rows))
    return np.array(mu), np.array(sigma), np.array(seen, dtype=int)


def _data(
    calibrated: _Calibrated,
    called: Sequence[str],
    materials: Sequence[str],
    columns: Sequence[int],
    weight: float,
) -> RoomData:
    target, covariance = calibrated.asked()
    n_states, n_bands = target.shape
    areas = np.zeros((n_states, len(materials)))
    areas[:, [materials.index(m) for m in called]] = calibrated.states.areas
    used = (np.arange(n_states)[:, np.newaxis] * n_bands + columns).ravel()
    return RoomData(areas, target[:, columns], covariance[np.ix_(used, used)], weight)


def _lesson(
    name: str, evidence: Evidence, room: likelihood.Judged, left: Array
) -> tuple[Lesson, list[tuple[int, int, float]]]:
    """The contribution of one room, and its materials that are likelier than not another one."""
    q = float(room.miss @ np.linalg.solve(room.covariance, room.miss))
    rows = np.flatnonzero(room.suspicion.sum(axis=1) > 0)
    learnt = [1 - left[i] / room.sigma[i] for i in rows if (room.sigma[i] > 0).all()]
    lesson = Lesson(
        room=name,
        factor=room.factor,
        factor_sigma=room.factor_sigma,
        q=q,
        degrees_of_freedom=len(room.miss),
        p_value=float(chi2.sf(q, len(room.miss))),
        taught=float(np.mean(learnt)) if learnt else 0.0,
    )
    by_material = room.suspicion.sum(axis=1)
    doubtful = np.flatnonzero(by_material > 0.5)
    return lesson, [
        (int(i), int(np.argmax(room.suspicion[i])), float(by_material[i])) for i in doubtful
    ]


def materials(result: CalibrationResult | JointResult) -> tuple[str, ...]:
    """Return the names of the materials of all states of a calibrated room."""
    return tuple(_Calibrated.of(result).room.materials)


def read_folder(folder: str | os.PathLike[str]) -> list[CalibrationResult | JointResult]:
    """Return the calibrations in a folder: each ``result.json`` of ``rtcal calibrate --out`` below it.

    Raises DataError if there is none, one that cannot be read, or more than 500. Files of other results
    are left out.

    Examples
    --------
    >>> import tempfile
    >>> import rtcal as rt
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = rt.calibrate(*rt.datasets.bras_cr2()).save(f"{folder}/seminar room")
    ...     print([result.prior.name for result in read_folder(folder)])
    ['BRAS CR2, seminar room']
    """
    if not checks.path("folder", folder).is_dir():
        raise DataError(f"{folder}: no such folder")
    files = sorted(Path(folder).rglob(NUMBERS))
    if not files:
        raise DataError(f"folder {folder} has no {NUMBERS}; rtcal calibrate --out writes one")
    kept = []
    for file in files:
        result = load(file)
        if isinstance(result, CalibrationResult | JointResult):
            kept.append(result)
        if len(kept) > _MOST:
            raise DataError(
                f"folder {folder} has more than {_MOST} calibrations: name a smaller one"
            )
    if not kept:
        raise DataError(f"folder {folder} has results, but no calibration among them")
    return kept
