"""A calibrated simulator predicts what every position hears after changes, which share control runs.

With alpha the coefficients, f what the simulator hears before the change and h after it, e and e' its
errors in the two states, u the errors of the room's volume, areas and climate, d what it does that a
cover lies in one place, and r the errors of the measurement,

    measured = f(alpha, u) + e + r,    predicted = h(alpha, u) + e' + d.

Control runs are heard in both states, so they tell the covariance of e and e' together: what is
common to both states was measured, and what is each state's own was not. Given what was measured,
alpha, u, e and e' are jointly normal. h is linear around the calibrated coefficients, but along the
change of alpha that T20 depends on most: there it is a parabola through three weighings of the same
paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands
from rtcal.acoustics.change_files import Variant, refuse_repeated_names
from rtcal.acoustics.observables import MATCH, OBSERVABLES, TARGET, observable
from rtcal.acoustics.room_errors import Assumptions, heard_changes
from rtcal.acoustics.scene import POSITION, checked_uncertainty
from rtcal.loop.changed_room import ChangedRoom, Pieces
from rtcal.loop.control_runs import ControlRuns, Heard, level, simulated_controls
from rtcal.loop.positions_prediction import (
    CalibratedAtPositions,
    PairsAndMean,
    PositionsPrediction,
    PositionsPredictions,
    Z,
    quantiles,
)
from rtcal.loop.positions_steps import GROUPS, groups_of_paths, noise_of_a_run
from rtcal.loop.scattering import (
    MaterialScattering,
    errors_by_scattering,
    material_scattering,
)
from rtcal.prediction import words
from rtcal.simulators.base import Simulator
from rtcal.simulators.observations import Observations, checked_parameters, jacobian, observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import Progress
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False)
class Before:
    """The measurement before the change, against the calibrated simulator."""

    result: CalibratedAtPositions
    simulator: Simulator
    pairs: tuple[tuple[str, str], ...]

    @cached_property
    def used(self) -> NDArray[np.int64]:
        """Numbers of the values that were measured, over the matched parameters at all pairs."""
        result = self.result
        flags = np.zeros(
            (len(result.parameters), len(self.pairs), result.prior.n_bands), dtype=bool
        )
        flags[:, [self.pairs.index(pair) for pair in result.pairs]] = result.measured.used
        return np.flatnonzero(flags)

    @cached_property
    def heard(self) -> Observations:
        """Matched parameters at all pairs, as the calibrated simulator gives them."""
        result = self.result
        return observe(self.simulator, result.alpha, result.parameters, seed=result.seed)

    @cached_property
    def matrix(self) -> Array:
        """Derivatives of the values used, (n_used, n_materials * n_bands)."""
        result = self.result
        slopes = jacobian(self.simulator, result.alpha, result.parameters, seed=result.seed)
        return _by_band(slopes)[self.used]

    @cached_property
    def by_room(self) -> Array:
        """Change of the values used by errors of volume, areas and climate, (n_errors, n_used)."""
        of_level = _of_level(self.result.parameters, self.pairs, self.result.prior.n_bands)
        return heard_changes(self.result.prior, self.matrix, of_level[self.used])

    @cached_property
    def innovation(self) -> Array:
        """The measured values less those heard with the prior, linearly, (n_used,)."""
        result = self.result
        measured = result.measured.observations.values
        left = measured[result.measured.used] - self.heard.values.ravel()[self.used]
        return np.asarray(left + self.matrix @ (result.alpha - result.prior.alpha).ravel())

    def error(
        self, of: Simulator, alpha: Array, match: Sequence[str]
    ) -> tuple[Array, Array | None]:
        """Return what groups of paths hear, and the derivatives by each material's scattering.

        (n_groups, p, i, k), and (n, n_materials), None where the scattering stated was kept.
        """
        result = self.result
        shape = (len(match), len(self.pairs), result.prior.n_bands)
        groups = groups_of_paths(of, alpha, match, result.seed, shape)
        if result.scattering is None or not isinstance(of, PathTracing):
            return groups, None
        random = replace(of, scattering_model="random")
        stated = np.zeros(result.prior.n_materials)
        return groups, material_scattering(random, alpha, match, stated, result.seed).slope

    @cached_property
    def own_error(self) -> tuple[Array, Array | None]:
        """The same of what was measured."""
        return self.error(self.simulator, self.result.alpha, self.result.parameters)


@dataclass(frozen=True, eq=False)
class Changed:
    """One change: what is heard after it, and the covariances of errors before and after."""

    known: Before
    room: ChangedRoom
    match: tuple[str, ...]
    names: tuple[str, ...]
    controls: ControlRuns

    @property
    def result(self) -> CalibratedAtPositions:
        """The calibration before the change."""
        return self.known.result

    @cached_property
    def alpha(self) -> Array:
        """The calibrated coefficients, and those stated of the new materials."""
        return self.room.all_alpha(self.result.alpha)

    def hear(self, alpha: Array) -> Array:
        """Return what is heard after the change for coefficients of all materials, (p, i, k)."""
        walls = self.room.mixture @ np.clip(alpha, 0.0, 1.0)
        return observe(self.after, walls, self.match, seed=self.result.seed).values

    @cached_property
    def after(self) -> Simulator:
        """The simulator with the air after the change."""
        return self.room.simulator(self.known.simulator)

    @cached_property
    def walls(self) -> Array:
        """Coefficients of what was each of the room's materials, (n_before, n_bands)."""
        return np.asarray(self.room.mixture @ self.alpha)

    @cached_property
    def by_wall(self) -> Array:
        """Derivatives of all rows by these, (p, i, k, n_before)."""
        return jacobian(self.after, self.walls, self.match, seed=self.result.seed)

    @cached_property
    def by_alpha(self) -> Array:
        """Derivatives of all rows by alpha of all materials, (rows, n_materials * n_bands)."""
        return _by_band(np.einsum("pikm,me->pike", self.by_wall, self.room.mixture))

    @cached_property
    def by_covers(self) -> Array:
        """Change of all rows by the error of each partial cover's area, (n_covers, rows)."""
        by_areas = self.room.cover_sigma[:, np.newaxis, np.newaxis] * self.room.by_areas(self.alpha)
        rows = np.einsum("pikm,cmk->cpik", self.by_wall, by_areas)
        return np.asarray(rows.reshape(len(by_areas), self.by_alpha.shape[0]))

    @cached_property
    def by_room(self) -> Array:
        """Change of all rows by errors of volume, areas and climate, (n_errors, rows)."""
        room = self.room.before.replace(alpha=self.walls, calibration=None)
        of_level = _of_level(self.match, self.known.pairs, room.n_bands)
        return heard_changes(room, _by_band(self.by_wall), of_level)

    @cached_property
    def by_places(self) -> Array:
        """Change of all rows by the places of the covers, (n_places, rows)."""
        if not self.room.moves or not isinstance(self.after, PathTracing):
            return np.zeros((0, self.by_alpha.shape[0]))
        pieces = Pieces.of(self.after, self.room.moves)
        return pieces.heard(self.walls, self.alpha, self.match, self.result.seed)

    @cached_property
    def prior(self) -> Array:
        """Covariance of alpha of all materials, the calibrated room's first."""
        room, old = self.result.prior, self.result.prior_covariance
        sigma = self.room.new_sigma.ravel()
        of_bands = bands.correlation(room.centre_frequencies, room.band_correlation)
        new = np.kron(np.eye(len(self.room.new_sigma)), of_bands) * np.outer(sigma, sigma)
        out = np.zeros((len(old) + len(new), len(old) + len(new)))
        out[: len(old), : len(old)], out[len(old) :, len(old) :] = old, new
        return out

    @cached_property
    def errors(self) -> Array:
        """Covariance of the simulator's errors before and after, of all values, (n, n).

        What control runs tell, what the materials' scattering does, and the noise of the paths that
        are weighed: all control runs have the same, so they do not tell it.
        """
        result, tracer = self.result, self.known.simulator
        names = (*result.parameters, *self.names)
        controls = self.controls.at(names, self.controls.pairs)
        states = (self.known.own_error, self.known.error(self.after, self.walls, self.match))
        groups = np.concatenate([of_groups for of_groups, _ in states], axis=1)
        noise = noise_of_a_run(tracer, groups)
        off = groups - groups.mean(axis=0)
        own = replace(controls, errors=off / np.sqrt(GROUPS - 1), levels=None, models=())
        slopes = [slope for _, slope in states if slope is not None]
        told = errors_by_scattering(controls, noise) if slopes else None
        if told is None or not isinstance(tracer, PathTracing):
            return controls.without_noise(noise).covariance() + own.covariance()
        of_materials = MaterialScattering(
            slope=np.vstack(slopes), traced=np.zeros(slopes[0].shape[1])
        )
        at = level(tracer.scattering, tracer.room.areas)
        of_runs = told.covariance(at, tracer.scattering_model)
        return of_runs + of_materials.covariance + own.covariance()

    def _unexplained(self) -> Array:
        """Return the covariance of the calibration's unexplained errors before and after, (n, n).

        Such an error stays with its pair: that of a matched parameter is the same after the change.
        """
        result, heard = self.result, self.known.heard
        deviation = dict.fromkeys((*result.parameters, *self.match), np.zeros(heard.values[0].size))
        for name, number in zip(result.parameters, result.unexplained, strict=True):
            kind, values = observable(name), heard.natural(name)
            unit = np.broadcast_to(kind.jnd_of(values), values.shape)
            deviation[name] = number * kind.of_observed(unit, values).ravel()
        rows = (*result.parameters, *self.match)
        return np.block(
            [[np.diag(deviation[p] * deviation[q] * (p == q)) for q in rows] for p in rows]
        )

    def predicted(self, variant: Variant) -> PositionsPrediction:
        """Return the prediction, whose ``heard_before`` is its own middle."""
        result, used = self.result, self.known.used
        matrix, measured = self.known.matrix, result.measured.covariance
        whole = self.errors + self._unexplained()
        rows = PairsAndMean((len(self.match), len(self.controls.pairs), result.prior.n_bands))
        first = len(result.parameters) * len(self.controls.pairs) * result.prior.n_bands
        before, across, own = (
            whole[np.ix_(used, used)],
            whole[first:][:, used],
            whole[first:, first:],
        )
        n_old = matrix.shape[1]
        prior, by_alpha, by_room = self.prior, self.by_alpha, self.known.by_room
        of_alpha = prior[:, :n_old] @ matrix.T
        unknown = matrix @ of_alpha[:n_old] + by_room.T @ by_room + before + measured
        told = by_alpha @ of_alpha + self.by_room.T @ by_room + across
        gain = np.asarray(np.linalg.solve(unknown, told.T).T, dtype=np.float64)

        heard = self.hear(self.alpha)
        at_prior = by_alpha[:, :n_old] @ (result.prior.alpha - result.alpha).ravel()
        shift = at_prior + gain @ self.known.innovation
        middle = rows.values(heard + shift.reshape(heard.shape))

        old, new = by_alpha[:, :n_old], by_alpha[:, n_old:]
        alike = across @ np.linalg.pinv(before, hermitian=True)

        def parts(gain: Array) -> dict[str, Array]:
            """Return the variances that are left where the measurement counts with a gain."""
            stays, kept = old - gain @ matrix, alike - gain
            found = {
                words.STAYS: stays @ prior[:n_old, :n_old] @ stays.T,
                **self._by_material(new, prior[n_old:, n_old:]),
                words.COVERS: self.by_covers.T @ self.by_covers,
                words.PLACES: self.by_places.T @ self.by_places,
                words.ALIKE: kept @ before @ kept.T,
                words.CHANGED_ALONE: own - alike @ across.T,
                words.MEASUREMENT: gain @ measured @ gain.T,
            }
            if result.prior.is_uncertain:
                of_room = self.by_room - by_room @ gain.T
                found[words.SIZES] = of_room.T @ of_room
            return {name: rows.variances(each) for name, each in found.items()}

        variance, without = parts(gain), parts(np.zeros(gain.shape))
        total, uncalibrated = (
            np.sqrt(np.maximum(sum(each.values(), np.zeros(rows.with_mean)), 0.0))
            for each in (variance, without)
        )
        posterior = prior - of_alpha @ np.linalg.solve(unknown, of_alpha.T)
        bend, ends = self._bend(heard, posterior, by_alpha)
        slope, curved = rows.values(ends), rows.values(bend)
        low, high, sampled = quantiles(middle, total, slope, curved)
        means = np.where(total[:, -1] > 0, total[:, -1], 1.0) ** 2
        return PositionsPrediction(
            name=variant.name,
            changes=self.room.changes,
            before=result.prior,
            simulator=result.simulator,
            parameters=self.match,
            pairs=self.controls.pairs,
            heard_before=middle,
            middle=np.where(sampled, middle + curved, middle),
            sigma=total,
            uncalibrated_sigma=uncalibrated,
            low=low,
            high=high,
            sampled=sampled,
            shares={name: each[:, -1] / means for name, each in variance.items()},
        )

    def _by_material(self, by_new: Array, prior: Array) -> dict[str, Array]:
        """Return the covariance by each new material's coefficients."""
        names, n_bands = self.room.materials[self.result.prior.n_materials :], self.alpha.shape[1]
        found = {}
        for i, name in enumerate(names):
            own = slice(i * n_bands, (i + 1) * n_bands)
            if prior[own, own].any():
                found[words.ALPHA.format(name)] = (
                    by_new[:, own] @ prior[own, own] @ by_new[:, own].T
                )
        return found

    def _bend(self, heard: Array, posterior: Array, by_alpha: Array) -> tuple[Array, Array]:
        """Return curvature and slope of all values along the direction of alpha that matters most.

        Per band it is the one along which T20, as mean over the pairs, spreads most. Values are
        middle + slope z + curvature z² for a standard normal z; (p, i, k) each.
        """
        n_bands = heard.shape[2]
        row = by_alpha.reshape(*heard.shape, -1, n_bands)[0].mean(axis=0)  # (k, e, l)
        blocks = posterior.reshape(-1, n_bands, len(self.alpha), n_bands)
        direction = np.zeros_like(self.alpha)
        for k in range(n_bands):
            spread = blocks[:, k, :, k] @ row[k, :, k]
            size = float(np.sqrt(max(row[k, :, k] @ spread, 0.0)))
            direction[:, k] = spread / size if size > 0 else 0.0
        below, above = (self.hear(self.alpha + z * direction) for z in (-Z, Z))
        return (above + below - 2 * heard) / (2 * Z**2), (above - below) / (2 * Z)


def _of_level(
    parameters: Sequence[str], pairs: Sequence[tuple[str, str]], n_bands: int
) -> NDArray[np.bool_]:
    """Return which values are levels, (n_parameters * n_pairs * n_bands,)."""
    return np.repeat([observable(p).part == "level" for p in parameters], len(pairs) * n_bands)


def _by_band(slopes: Array) -> Array:
    """Return derivatives (p, i, k, m) by alpha of the same band as (p * i * k, m * k)."""
    full = np.einsum("pikm,kl->pikml", slopes, np.eye(slopes.shape[2]))
    return np.asarray(full.reshape(slopes[..., 0].size, -1))


WANTED = (*MATCH, *(key for key, each in OBSERVABLES.items() if each.predicted))
"""What is predicted where nothing else is asked for."""
_BEFORE = "before the change"


def predict_positions(
    result: CalibratedAtPositions,
    variants: Sequence[Variant],
    *,
    wanted: Sequence[str] = WANTED,
    assumptions: Assumptions | None = None,
    position_uncertainty: float = POSITION,
    progress: Progress | None = None,
) -> PositionsPredictions:
    """Predict what every position hears after changes, which share the control runs.

    Parameters
    ----------
    result : CalibratedAtPositions
    variants : sequence of Variant
        Covers, openings and another climate.
    wanted : sequence of str
        Keys of `rtcal.acoustics.observables`.
    assumptions : Assumptions, optional
        Its ``changed`` is the least sigma of a new material, ``areas`` the relative error of the area
        of a partial cover. The others are the equation's.
    position_uncertainty : float
        As of `rtcal.calibrate_positions`.
    progress : callable, optional
        Called with the number of finished control runs and their total.

    Raises
    ------
    DataError
        For a change that the simulator does not know the place of, two variants of one name, or a
        simulator whose error no control run tells.

    Examples
    --------
    >>> import rtcal as rt
    >>> from rtcal.prediction import Cover, Open
    >>> room = rt.Room(name="box", volume=60, materials=["plaster"], areas=[94], alpha=[[0.2]],
    ...                sigma=[[0.04]], centre_frequencies=[1000], air=rt.Air(20, 50),
    ...                scattering=[[0.5]])
    >>> tracer = rt.simulators.PathTracing(
    ...     room=room, geometry=rt.simulators.Polyhedron.shoebox((4, 5, 3), "plaster"),
    ...     sources={"S1": (1, 1, 1.5)}, receivers={"R1": (3, 4, 1.2), "R2": (2.8, 1.3, 1.3)},
    ...     n_paths=400)
    >>> measured = tracer.simulate([[0.18]], seed=1)
    >>> result = rt.calibrate_positions(tracer, room, measured, ("t20", "c80"), more_paths=1)
    >>> panel = rt.Material("panel", [0.8], [0.1])
    >>> after = predict_positions(
    ...     result, [Variant("panels", (Cover("plaster", panel, 15),)),
    ...              Variant("window", (Open("plaster", 2),))], wanted=("t20", "c80"))
    >>> for prediction in after.predictions:
    ...     low, high = prediction.interval("t20")
    ...     print(prediction.name, bool((low < high).all()), bool((prediction.change("c80") > 0).all()))
    panels True True
    window True True
    """
    if not hasattr(result, "weighed"):
        raise DataError(
            f"result = {checks.shown(result)} is no result of rtcal.calibrate_positions"
        )
    variants = checks.listed("variants", variants)
    for i, variant in enumerate(variants):
        checks.instance(f"variants[{i}]", variant, Variant)
    refuse_repeated_names(variants)
    assumed = Assumptions() if assumptions is None else assumptions
    every = (Variant(_BEFORE, ()), *variants)
    rooms = [ChangedRoom(result.prior, tuple(v.changes), assumed) for v in every]
    simulator, seed = result.weighed, result.seed
    for room in rooms:
        room.simulator(simulator)  # raises where it cannot take the change, before anything is run
    match = tuple(dict.fromkeys([TARGET.key, *checked_parameters(wanted)]))
    checked_uncertainty(position_uncertainty)
    if isinstance(simulator, PathTracing):
        match = simulator.trusted(match)

    def after(room: ChangedRoom) -> Heard:
        at_alpha: dict[bytes, Array] = {}

        def hear(of: Simulator, alpha: Array, seed: int) -> Array:
            walls = room.mixture @ room.all_alpha(alpha)
            if of is not simulator:
                return observe(room.simulator(of), walls, match, seed=seed).values
            if walls.tobytes() not in at_alpha:
                heard = observe(room.simulator(of), walls, match, seed=seed).values
                at_alpha[walls.tobytes()] = heard
            return at_alpha[walls.tobytes()]

        return hear

    controls = None
    if result.controls is not None:
        # The runs stand at the calibrated coefficients: those are known far better than the prior.
        controls = simulated_controls(
            simulator,
            result.room.replace(sigma=np.zeros_like(result.alpha), calibration=None),
            result.parameters,
            seed=seed,
            position_uncertainty=position_uncertainty,
            progress=progress,
            after=[(_names(match, i), after(room)) for i, room in enumerate(rooms)],
        )
    if controls is None:
        raise DataError(
            f"no control run tells the error of {result.simulator}: predict with a simulator that "
            "has a geometry, or T by an equation"
        )
    known = Before(result, simulator, controls.pairs)
    before, *after_each = (
        Changed(known, room, match, _names(match, i), controls).predicted(variant)
        for i, (room, variant) in enumerate(zip(rooms, every, strict=True))
    )
    return PositionsPredictions(
        predictions=tuple(replace(each, heard_before=before.middle) for each in after_each)
    )


def _names(match: Sequence[str], variant: int) -> tuple[str, ...]:
    return tuple(f"{parameter}, variant {variant + 1}" for parameter in match)
