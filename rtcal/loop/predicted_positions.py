"""What every position hears after a change, by a simulator that was calibrated to every position.

With alpha the coefficients, f what the simulator hears before the change and h after it, e and e' its
errors in the two states, r those of the measurement,

    measured = f(alpha) + e + r,    predicted = h(alpha) + e'.

Control runs are heard in both states, so they tell the covariance of e and e' together: what is
common to both states was measured, and what is each state's own was not. Given what was measured,
alpha, e and e' are jointly normal. h is linear around the calibrated coefficients, but along the change
of alpha that T20 depends on most: there it is a parabola through three weighings of the same paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from rtcal.acoustics import bands
from rtcal.acoustics.change_files import Variant
from rtcal.acoustics.changes import Change
from rtcal.acoustics.observables import MATCH, TARGET, observable
from rtcal.acoustics.parameters import parameter_label
from rtcal.acoustics.room import Room
from rtcal.acoustics.scene import POSITION
from rtcal.errors import DataError
from rtcal.loop.changed_room import ChangedRoom
from rtcal.loop.control_runs import ControlRuns, Heard, level, simulated_controls
from rtcal.loop.scattering import MaterialScattering, errors_by_scattering, material_scattering
from rtcal.loop.simulator_error import noise_of_a_run
from rtcal.prediction.assumptions import Assumptions
from rtcal.prediction.compared import refuse_repeated_names
from rtcal.prediction.predicted import LEVEL
from rtcal.prediction.words import ALPHA, MEASUREMENT, STAYS
from rtcal.simulators.base import Simulator
from rtcal.simulators.observations import jacobian, observe
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import text
from rtcal.support.files import json_numbers
from rtcal.support.progress import Progress
from rtcal.support.results import Result
from rtcal.support.text import shortened
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.loop.positions_result import PositionsResult

WANTED = (*MATCH, "d50", "sti")
"""What is predicted where nothing else is asked for."""
COMMON, OWN, AREAS = (
    "the simulator, alike in both states",
    "the simulator, in the changed room alone",
    "the covered areas",
)
_Z = float(ndtri((1 + LEVEL) / 2))
_BEFORE = "before the change"
_SAMPLES = 2000
_BENT = 0.1
"""Departure from a straight line at the interval's ends, in standard deviations, from which the
interval is that of samples."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsPrediction(Result):
    """What every position hears after a change; `PositionsResult.predict` makes it.

    Rows are the pairs in their order, and then their mean.

    Attributes
    ----------
    name : str
    changes : tuple of Change
    before : Room
        With the prior's coefficients.
    simulator : str
    parameters : tuple of str (n_parameters,)
        Keys of `rtcal.acoustics.observables`.
    pairs : tuple of (source, receiver) (n_pairs,)
    heard_before : array (n_parameters, n_pairs + 1, n_bands)
        Before the change, predicted in the same way; as observed: times are logarithms.
    middle, sigma : array (n_parameters, n_pairs + 1, n_bands)
        Mean and standard deviation after the change, as observed.
    low, high : array (n_parameters, n_pairs + 1, n_bands)
        Ends of the 90 % interval, as observed.
    sampled : array of bool (n_parameters, n_pairs + 1, n_bands)
        Where the interval is that of samples, since the simulator departs from its linear model.
    shares : mapping of str to array (n_parameters, n_bands)
        Of the variance of the mean over the pairs, by what it comes from.
    """

    record_kind: ClassVar[str] = "prediction at positions 1"

    name: str
    changes: tuple[Change, ...]
    before: Room
    simulator: str
    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    heard_before: Array
    middle: Array
    sigma: Array
    low: Array
    high: Array
    sampled: NDArray[np.bool_]
    shares: dict[str, Array]

    def mean(self, parameter: str) -> Array:
        """Return the mean over the pairs in its unit, (n_bands,); of times the geometric one."""
        return np.asarray(self.at_pairs(parameter)[-1])

    def interval(self, parameter: str) -> tuple[Array, Array]:
        """Return the ends of the 90 % interval of the mean over the pairs, each (n_bands,)."""
        low, high = self.interval_at_pairs(parameter)
        return low[-1], high[-1]

    def at_pairs(self, parameter: str) -> Array:
        """Return each pair's value in its unit and then the mean, (n_pairs + 1, n_bands)."""
        return np.asarray(observable(parameter).natural(self.middle[self._row(parameter)]))

    def interval_at_pairs(self, parameter: str) -> tuple[Array, Array]:
        """Return the ends of the 90 % intervals, each (n_pairs + 1, n_bands)."""
        row, of = self._row(parameter), observable(parameter)
        return of.natural(self.low[row]), of.natural(self.high[row])

    def change(self, parameter: str) -> Array:
        """Return the effect on each pair and on the mean in JND, (n_pairs + 1, n_bands)."""
        return self._in_jnd(parameter, self.middle - self.heard_before)

    def half_width(self, parameter: str) -> Array:
        """Return half of the 90 % interval in JND, (n_pairs + 1, n_bands)."""
        return self._in_jnd(parameter, (self.high - self.low) / 2)

    def _in_jnd(self, parameter: str, observed: Array) -> Array:
        of, row, values = (
            observable(parameter),
            observed[self._row(parameter)],
            self.at_pairs(parameter),
        )
        one = np.asarray(of.jnd_of(values))
        return np.asarray(row / (np.log1p(one / values) if of.logarithmic else one))

    def _row(self, parameter: str) -> int:
        if parameter not in self.parameters:
            raise DataError(f'parameter = "{parameter}" is not one of {", ".join(self.parameters)}')
        return self.parameters.index(parameter)

    def parts(self, parameter: str) -> dict[str, Array]:
        """Return shares of the variance of the mean over the pairs, (n_bands,), the largest first."""
        row = self._row(parameter)
        found = {name: share[row] for name, share in self.shares.items()}
        return dict(sorted(found.items(), key=lambda each: -float(each[1].mean())))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, lists and text."""
        return {
            "room": self.before.name,
            "name": self.name,
            "changes": [str(change) for change in self.changes],
            "simulator": self.simulator,
            "centre_frequencies": json_numbers(self.before.centre_frequencies),
            "pairs": [list(pair) for pair in self.pairs],
            "parameters": {
                p: {
                    "unit": observable(p).unit,
                    "before": json_numbers(observable(p).natural(self.heard_before[i])),
                    "after": json_numbers(self.at_pairs(p)),
                    "interval_90": [json_numbers(end) for end in self.interval_at_pairs(p)],
                    "change_jnd": json_numbers(self.change(p)),
                    "half_width_jnd": json_numbers(self.half_width(p)),
                    "sampled": self.sampled[i].tolist(),
                    "parts": {name: json_numbers(v) for name, v in self.parts(p).items()},
                }
                for i, p in enumerate(self.parameters)
            },
        }

    def __repr__(self) -> str:
        first = self.parameters[0]
        return (
            f'<PositionsPrediction "{shortened(self.name)}" of "{shortened(self.before.name)}": '
            f"{len(self.pairs)} pairs, {parameter_label(first)} {self.change(first)[-1].mean():+.1f} "
            f"JND, ± {np.median(self.half_width(first)[-1]):.1f} JND>"
        )

    def __str__(self) -> str:
        labels = [bands.label(f) for f in self.before.centre_frequencies]
        rows = []
        for i, p in enumerate(self.parameters):
            of, (low, high) = observable(p), self.interval(p)
            unit = f" / {of.unit}" if of.unit else ""
            before = of.natural(self.heard_before[i, -1])
            for name, values in (
                ("before", before),
                ("after", self.mean(p)),
                ("90 %: from", low),
                ("to", high),
            ):
                rows.append(
                    (
                        f"{of.label} {name}{unit}",
                        [text.number(v, f".{of.decimals}f") for v in values],
                    )
                )
        shares = self.parts(self.parameters[0])
        made_of = [
            (n, [text.number(100 * v, ".0f") for v in of_part]) for n, of_part in shares.items()
        ]
        return "\n".join(
            [
                *text.wrapped(f"{self.before.name}: {self.name}"),
                *text.wrapped(f"Mean over {len(self.pairs)} pairs, by {self.simulator}"),
                "",
                *text.table(rows, header=("", labels)),
                "",
                f"what the interval of {parameter_label(self.parameters[0])} is made of / % of the "
                "variance",
                *text.table(made_of, header=("", labels)),
            ]
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PositionsPredictions(Result):
    """Predictions of several variants at every position.

    Attributes
    ----------
    predictions : tuple of PositionsPrediction
        One per variant.
    """

    record_kind: ClassVar[str] = "predictions at positions 1"

    predictions: tuple[PositionsPrediction, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return each variant's `PositionsPrediction.to_dict`."""
        return {"variants": [prediction.to_dict() for prediction in self.predictions]}

    def __str__(self) -> str:
        return "\n\n\n".join(map(str, self.predictions))

    def __repr__(self) -> str:
        return f"<PositionsPredictions: {', '.join(p.name for p in self.predictions)}>"


def predict_positions(
    result: PositionsResult,
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
    result : PositionsResult
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
    """
    refuse_repeated_names(variants)
    assumed = Assumptions.of(result.prior) if assumptions is None else assumptions
    every = (Variant(_BEFORE, ()), *variants)
    rooms = [ChangedRoom(result.prior, tuple(v.changes), assumed) for v in every]
    simulator, seed = result.weighed, result.seed
    match = tuple(dict.fromkeys([TARGET.key, *wanted]))
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
    known = _Known(result, simulator, controls.pairs)
    before, *after_each = (
        _Changed(known, room, match, controls, i).predicted(variant)
        for i, (room, variant) in enumerate(zip(rooms, every, strict=True))
    )
    return PositionsPredictions(
        predictions=tuple(replace(each, heard_before=before.middle) for each in after_each)
    )


def _names(match: Sequence[str], variant: int) -> tuple[str, ...]:
    return tuple(f"{parameter}, variant {variant + 1}" for parameter in match)


@dataclass(frozen=True, eq=False)
class _Known:
    """What was measured before the change, against the calibrated simulator."""

    result: PositionsResult
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
    def matrix(self) -> Array:
        """Derivatives of the values used, (n_used, n_materials * n_bands)."""
        result = self.result
        slopes = jacobian(self.simulator, result.alpha, result.parameters, seed=result.seed)
        return _by_band(slopes)[self.used]

    @cached_property
    def innovation(self) -> Array:
        """What was measured less what the simulator hears with the prior, linearly, (n_used,)."""
        result = self.result
        heard = observe(self.simulator, result.alpha, result.parameters, seed=result.seed).values
        measured = result.measured.observations.values
        left = measured[result.measured.used] - heard.ravel()[self.used]
        return np.asarray(left + self.matrix @ (result.alpha - result.prior.alpha).ravel())

    def error(
        self, of: Simulator, alpha: Array, match: Sequence[str]
    ) -> tuple[Array, Array | None]:
        """Return a control run's noise, and the derivatives by the scattering of each material.

        (n_parameters, n_bands), and (n, n_materials), None where the scattering stated was kept.
        """
        result = self.result
        shape = (len(match), result.prior.n_bands)
        noise = noise_of_a_run(of, alpha, match, result.seed, shape)
        if result.scattering is None or not isinstance(of, PathTracing):
            return noise, None
        random = replace(of, scattering_model="random")
        stated = np.zeros(result.prior.n_materials)
        return noise, material_scattering(random, alpha, match, stated, result.seed).slope

    @cached_property
    def own_error(self) -> tuple[Array, Array | None]:
        """The same of what was measured."""
        return self.error(self.simulator, self.result.alpha, self.result.parameters)


@dataclass(frozen=True, eq=False)
class _Changed:
    """One change: what is heard after it, and the covariances of errors before and after."""

    known: _Known
    room: ChangedRoom
    match: tuple[str, ...]
    controls: ControlRuns
    number: int

    @property
    def result(self) -> PositionsResult:
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
        return self.room.simulator(self.known.simulator)

    @cached_property
    def slopes(self) -> tuple[Array, Array]:
        """Derivatives of all rows by alpha of all materials, and by ln of each partial cover's area.

        (rows, n_materials * n_bands) and (rows, n_covers).
        """
        walls = self.room.mixture @ self.alpha
        by_wall = jacobian(self.after, walls, self.match, seed=self.result.seed)
        by_areas = np.einsum("pikm,cmk->pikc", by_wall, self.room.by_areas(self.alpha))
        by_alpha = np.einsum("pikm,me->pike", by_wall, self.room.mixture)
        return _by_band(by_alpha), by_areas.reshape(by_wall[..., 0].size, -1)

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
        """Covariance of the simulator's errors before and after, of all values, (n, n)."""
        result, tracer = self.result, self.known.simulator
        names = (*result.parameters, *_names(self.match, self.number))
        controls = self.controls.at(names, self.controls.pairs)
        walls = self.room.mixture @ self.alpha
        states = (self.known.own_error, self.known.error(self.after, walls, self.match))
        noise = np.vstack([of_run for of_run, _ in states])
        slopes = [slope for _, slope in states if slope is not None]
        told = errors_by_scattering(controls, noise) if slopes else None
        if told is None or not isinstance(tracer, PathTracing):
            return controls.without_noise(noise).covariance()
        of_materials = MaterialScattering(
            slope=np.vstack(slopes), traced=np.zeros(slopes[0].shape[1])
        )
        at = level(tracer.scattering, tracer.room.areas)
        return told.covariance(at, tracer.scattering_model) + of_materials.covariance

    def predicted(self, variant: Variant) -> PositionsPrediction:
        """Return the prediction, whose ``heard_before`` is its own middle."""
        result, used = self.result, self.known.used
        matrix, measured = self.known.matrix, result.measured.covariance
        whole = result.error_scale * self.errors
        rows = _Rows((len(self.match), len(self.controls.pairs), result.prior.n_bands))
        first = len(result.parameters) * len(self.controls.pairs) * result.prior.n_bands
        before, across, own = (
            whole[np.ix_(used, used)],
            whole[first:][:, used],
            whole[first:, first:],
        )
        n_old = matrix.shape[1]
        prior, (by_alpha, by_areas) = self.prior, self.slopes
        of_alpha = prior[:, :n_old] @ matrix.T
        unknown = matrix @ prior[:n_old, :n_old] @ matrix.T + before + measured
        gain = np.linalg.solve(unknown, (by_alpha @ of_alpha + across).T).T

        heard = self.hear(self.alpha)
        at_prior = by_alpha[:, :n_old] @ (result.prior.alpha - result.alpha).ravel()
        shift = at_prior + gain @ self.known.innovation
        middle = rows.values(heard + shift.reshape(heard.shape))

        by_alpha_left = by_alpha.copy()
        by_alpha_left[:, :n_old] -= gain @ matrix
        alike = across @ np.linalg.pinv(before, hermitian=True)
        old, new = by_alpha_left[:, :n_old], by_alpha_left[:, n_old:]
        areas = self.room.assumptions.areas * by_areas
        kept = alike - gain
        parts = {
            STAYS: old @ prior[:n_old, :n_old] @ old.T,
            **self._by_material(new, prior[n_old:, n_old:]),
            AREAS: areas @ areas.T,
            COMMON: kept @ before @ kept.T,
            OWN: own - alike @ across.T,
            MEASUREMENT: gain @ measured @ gain.T,
        }
        posterior = prior - of_alpha @ np.linalg.solve(unknown, of_alpha.T)
        bend, ends = self._bend(heard, posterior, by_alpha)
        variance = {name: rows.variances(each) for name, each in parts.items()}
        total = sum(variance.values(), np.zeros(rows.with_mean))
        sigma, slope = np.sqrt(np.maximum(total, 0.0)), rows.values(ends)
        low, high, sampled = _quantiles(middle, sigma, slope, rows.values(bend))
        means = np.where(total[:, -1] > 0, total[:, -1], 1.0)
        return PositionsPrediction(
            name=variant.name,
            changes=self.room.changes,
            before=result.prior,
            simulator=result.simulator,
            parameters=self.match,
            pairs=self.controls.pairs,
            heard_before=middle,
            middle=np.where(sampled, middle + rows.values(bend), middle),
            sigma=sigma,
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
                found[ALPHA.format(name)] = by_new[:, own] @ prior[own, own] @ by_new[:, own].T
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
        below, above = (self.hear(self.alpha + z * direction) for z in (-_Z, _Z))
        return (above + below - 2 * heard) / (2 * _Z**2), (above - below) / (2 * _Z)


def _by_band(slopes: Array) -> Array:
    """Return derivatives (p, i, k, m) by alpha of the same band as (p * i * k, m * k)."""
    full = np.einsum("pikm,kl->pikml", slopes, np.eye(slopes.shape[2]))
    return np.asarray(full.reshape(slopes[..., 0].size, -1))


@dataclass(frozen=True)
class _Rows:
    """Values (n_parameters, n_pairs, n_bands), and the mean over the pairs behind them."""

    shape: tuple[int, int, int]

    @property
    def with_mean(self) -> tuple[int, int, int]:
        p, i, k = self.shape
        return p, i + 1, k

    def values(self, values: Array) -> Array:
        """Return values with their mean over the pairs, (n_parameters, n_pairs + 1, n_bands)."""
        return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)

    def variances(self, covariance: Array) -> Array:
        """Return the variances of values and of their mean, of the covariance of all values."""
        of_mean = np.einsum("pikpjk->pk", covariance.reshape(*self.shape, *self.shape))
        own = np.diag(covariance).reshape(self.shape)
        return np.concatenate([own, of_mean[:, np.newaxis] / self.shape[1] ** 2], axis=1)


def _quantiles(
    middle: Array, sigma: Array, slope: Array, bend: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the ends of the 90 % intervals, and where they are those of samples."""
    sampled = np.abs(bend) * _Z**2 > _BENT * sigma
    low, high = middle - _Z * sigma, middle + _Z * sigma
    rest = np.sqrt(np.maximum(sigma**2 - slope**2, 0.0))
    z = ndtri((np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    other = np.random.default_rng(0).permutation(z)
    for at in np.argwhere(sampled):
        a, b, c, d = (each[tuple(at)] for each in (middle, slope, bend, rest))
        drawn = a + b * z + c * z**2 + d * other
        low[tuple(at)], high[tuple(at)] = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return low, high, sampled
