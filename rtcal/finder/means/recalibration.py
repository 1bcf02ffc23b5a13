"""Calibrate a case's room without and with the effects that were added to its model.

The QP has the prior's deviation and a soft match of T within the uncertainty of the measurement. What
the model itself errs by, alpha takes up as in any calibration, so that the corrected model has the
measured T. alpha is from 0 to 1, and the configurations share coefficients. The size of each effect
that adds absorption is a further unknown, 0 or more. A decay's shape, another equation or a noise floor
is not part of the QP. For these, Gauss-Newton steps correct its target T until the whole model has the
measured T.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.air import Air
from rtcal.acoustics.equations import LinearEquation, mean_equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.calibration.measured import data_history, times_in_room
from rtcal.calibration.methods import calibrate, gauss_newton
from rtcal.calibration.problem import Calibration
from rtcal.calibration.result import JointResult
from rtcal.calibration.terms import AddedAbsorption, PriorDeviation, SoftMatch
from rtcal.calibration.unknowns import Configurations
from rtcal.files.saved import Result
from rtcal.finder.case import Case, Configuration
from rtcal.finder.effects import AppliedEffect
from rtcal.finder.finding import amount
from rtcal.finder.means.corrected import corrected_room, seen
from rtcal.finder.means.problem import (
    ModelDiscrepancy,
    checked_discrepancy,
    distances,
    observe,
    state,
)
from rtcal.finder.model import FEATURES, STEEPEST, RoomState, predict
from rtcal.support import __version__, text
from rtcal.support.errors import MissingAirWarning
from rtcal.support.speed import single_threaded_blas
from rtcal.support.types import Array


@dataclass(frozen=True, eq=False, repr=False)
class Recalibrated(Result):
    """The calibrated coefficients of a case, and the model's prediction with them.

    Attributes
    ----------
    case : Case
        With the effects' sizes as calibrated.
    alpha : array (n_materials, n_bands)
        The room's coefficients; those that a configuration changes are in ``changed``.
    changed : mapping of (configuration, material) to array (n_bands,)
    sizes : mapping of str to float
        Sizes of the effects that have one, in the effect's unit.
    features : array (n_configurations, n_features, n_bands)
        Predicted: ln T20, ln EDT/T20, ln T30/T20, C80 and G in dB, the model's bias left out.
    off : float
        Root mean square of the fitted ln T less the measured one, over its standard deviation.
    joint : JointResult
        The QP's answer, in which a configuration's changed materials have names of their own.
    """

    record_kind: ClassVar[str] = "recalibration 1"

    case: Case
    alpha: Array
    changed: Mapping[tuple[str, str], Array]
    sizes: Mapping[str, float]
    features: Array
    off: float
    joint: JointResult

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of alpha, (n_materials, n_bands): the QP's `posterior_sigma`.

        It holds if the effects in the model are right, with their parameters. Only the sizes that are
        unknowns of the QP contribute their uncertainty.
        """
        by_name = dict(zip(self.joint.materials, self.joint.posterior_sigma, strict=True))
        room = self.case.room
        return np.array([by_name.get(m, room.sigma[i]) for i, m in enumerate(room.materials)])

    @property
    def interval(self) -> tuple[Array, Array]:
        """Ends of alpha's 90 % interval, each (n_materials, n_bands): alpha ± 1.645 sigma in 0 to 1."""
        spread = NORMAL_90 * self.sigma
        return np.clip(self.alpha - spread, 0, 1), np.clip(self.alpha + spread, 0, 1)

    @cached_property
    def room(self) -> Room:
        """`corrected_room` with the calibrated coefficients, their sigma, and the record of it."""
        stated = self.case.room
        data = [times_in_room(stated, c.measured) for c in self.case.configurations]
        calibrated = stated.replace(
            alpha=self.alpha,
            sigma=self.sigma,
            calibration=CalibrationRecord(
                method="gap",
                equation=self.joint.equation.name,
                solver=self.joint.solver,
                measured=" ".join(
                    [data_history(stated, data[0]), *(d.fingerprint for d in data[1:])]
                ),
                version=__version__,
            ),
        )
        return corrected_room(replace(self.case, room=calibrated))

    @property
    def effects(self) -> list[dict[str, Any]]:
        """The effects with their sizes, and the 90 % interval from all data.

        The size of a ``calibrated`` effect was an unknown of the QP, which uses T20 only. Other effects
        have the size with which they were added.
        """
        return [
            p.to_dict()
            | {
                "size": self.sizes.get(p.name),
                "unit": p.effect.unit,
                "material": p.effect.material(p.parameters, self.case.room),
                "calibrated": p.name in self.joint.effects,
            }
            for p in self.case.applied
        ]

    @property
    def effects_in_words(self) -> list[str]:
        """A line per effect: its size, and the data from which the size follows."""
        return [self._in_words(p) for p in self.case.applied]

    def _in_words(self, p: AppliedEffect) -> str:
        name = p.effect.title(p.parameters, self.case.room)
        size, ends = self.sizes.get(p.name), p.size_interval
        if size is None:
            return f"{name}: {p.effect.describe(p.parameters)}"
        time = self.case.configurations[0].measured.time_label
        source = f", calibrated to {time} alone" if p.name in self.joint.effects else ""
        return f"{name}{source}: {amount(size, p.effect.unit, ends)}"

    def __repr__(self) -> str:
        """Return one line: the room, and the effects with their sizes."""
        sizes = (
            p.name if p.name not in self.sizes else f"{p.name} {self.sizes[p.name]:.3g}"
            for p in self.case.applied
        )
        effects = text.shortened(", ".join(sizes)) or "no effect"
        name = text.shortened(self.case.room.name)
        return f'<Recalibrated "{name}": {len(self.alpha)} materials, with {effects}>'

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        low, high = self.interval
        return {
            "effects": self.effects,
            "materials": [
                {
                    "name": m,
                    "alpha": self.alpha[i].tolist(),
                    "sigma": self.sigma[i].tolist(),
                    "low": low[i].tolist(),
                    "high": high[i].tolist(),
                }
                for i, m in enumerate(self.case.room.materials)
            ],
            "changed": [
                {"configuration": c, "material": m, "alpha": v.tolist()}
                for (c, m), v in self.changed.items()
            ],
        }


def table(room: Room, columns: Mapping[str, Recalibrated]) -> list[str]:
    """Return lines with each material's alpha, as stated and as calibrated, and the effects."""
    named = {"prior": (room.alpha, NORMAL_90 * room.sigma)}
    named |= {k: (c.alpha, np.subtract(*c.interval[::-1]) / 2) for k, c in columns.items()}
    rows = []
    for i, material in enumerate(room.materials):
        cells = [f"{a[i].mean():.3f} ± {half[i].mean():.3f}" for a, half in named.values()]
        rows.append((f"  {material}", cells))
    lines = ["alpha ± half its 90 % interval, means over bands"]
    lines += text.table(rows, header=("", list(named)))
    for c in columns.values():
        for line in c.effects_in_words:
            lines += text.wrapped(line, indent="  ")
    return lines


_ROUNDS = 5
_STEP = 0.02
_LEAST_SLOPE = 0.05
_LARGEST_SLOPE = 20.0
"""Limits of d ln T of the model by d ln T of the QP."""
_HALVINGS = 6
_NEAR = 3.0
"""Standard deviations of the measured T within which no step is halved: there the prior pulls, too."""
_SMALLEST = 1e-3
_LEAST_SEEN = 1e-3
"""Share of a material that the QP counts as seen, however much of it is covered."""
_LEAST_U = 0.002
"""Relative uncertainty of T at least: a stated one of 0 would leave the prior no weight."""
_T20 = FEATURES.index("t20")


def air_of(case: Case, configuration: Configuration) -> Air | None:
    """Return the climate of a configuration, with the applied effects."""
    air = configuration.air or case.room.air
    for added in case.applied:
        air = added.effect.air(air, added.parameters)
    return air


def plain(case: Case) -> Recalibrated:
    """Calibrate without effects: an exact match of the first configuration's T20.

    A band whose T no alpha reaches gets the nearest reachable T.
    """
    bare = replace(case, applied=())
    first = replace(bare, configurations=bare.configurations[:1])
    return _calibrated(first, bare, [0], None, exact=True)


@single_threaded_blas()
def recalibrate(
    case: Case,
    discrepancy: ModelDiscrepancy | None = None,
    *,
    left_out: Sequence[int] = (),
) -> Recalibrated:
    """Calibrate the case with its effects, to T20 of every configuration.

    Parameters
    ----------
    case : Case
    discrepancy : ModelDiscrepancy, optional
        The model's error, from control rooms, whose bias is subtracted.
    left_out : sequence of int
        Numbers of configurations that are predicted and not fitted; not the first.

    Raises
    ------
    DataError
        If the room was calibrated to one of the case's T before, or ``discrepancy`` belongs to another
        case.
    """
    if discrepancy is not None:
        checked_discrepancy(case, discrepancy)
    rows = [c for c in range(len(case.configurations)) if c not in left_out]
    fitted = replace(case, configurations=[case.configurations[c] for c in rows])
    return _calibrated(fitted, case, rows, discrepancy, exact=False)


def _calibrated(
    fitted: Case,
    whole: Case,
    rows: Sequence[int],
    discrepancy: ModelDiscrepancy | None,
    *,
    exact: bool,
) -> Recalibrated:
    """Calibrate to the configurations ``rows`` of the whole case, which the fitted one has."""
    whole.require_fresh()
    room = fitted.room
    k = room.n_bands
    observed, _ = observe(fitted)
    shape = (len(whole.configurations), len(FEATURES), k)
    bias = np.zeros(shape) if discrepancy is None else discrepancy.bias.reshape(shape)
    variance = np.full(observed.used.shape, np.nan)
    variance[observed.used] = np.diag(observed.covariance)
    measured = observed.features[:, _T20] - bias[rows, _T20]
    u = np.sqrt(np.maximum(variance[:, _T20], _LEAST_U**2))
    is_linear = isinstance(mean_equation(fitted.equation), LinearEquation)
    stated = {(c.name, m): v.alpha for c in fitted.configurations for m, v in c.changes.items()}
    steps = gauss_newton(
        _Point(fitted, np.array(room.alpha), stated),
        lambda at: _Linearised.at(at, fitted, measured, u, exact=exact),
        groups=k,
        most=1 if is_linear and not fitted.applied else _ROUNDS,
        halvings=_HALVINGS,
    )
    point, solved = steps.end, steps.steps[-1].model.solved
    applied = point.case.applied
    done = replace(whole, applied=applied if fitted.applied else whole.applied)
    features = np.array(
        [
            predict(
                [
                    state(
                        done,
                        replace(c, changes={}),
                        _coefficients(whole, c, point.alpha, point.changed),
                    )
                ],
                distances(whole, c),
            ).features[0]
            for c in whole.configurations
        ]
    )
    sizes = {p.name: p.size for p in applied if np.isfinite(p.effect.neutral)}
    off = float(np.sqrt(np.nanmean(((point.log_time - measured) / u) ** 2)))
    return Recalibrated(done, point.alpha, point.changed, sizes, features, off, solved)


@dataclass(frozen=True, eq=False)
class _Point:
    """The start of a step: the case with its effects' sizes, and the coefficients."""

    case: Case
    alpha: Array
    changed: Mapping[tuple[str, str], Array]

    @cached_property
    def states(self) -> list[RoomState]:
        each = zip(self.case.configurations, self.coefficients, strict=True)
        return [state(self.case, replace(c, changes={}), alpha) for c, alpha in each]

    @cached_property
    def coefficients(self) -> list[Array]:
        """The unknowns of each configuration (n_materials, n_bands), before any effect on them."""
        return [
            _coefficients(self.case, c, self.alpha, self.changed) for c in self.case.configurations
        ]

    @cached_property
    def log_time(self) -> Array:
        """ln T of the model, (n_configurations, n_bands)."""
        where = [distances(self.case, c) for c in self.case.configurations]
        pairs = zip(self.states, where, strict=True)
        return np.log([predict([s], d).reverberation_time[0] for s, d in pairs])

    def scaled(self, factor: float) -> _Point:
        """The point with all coefficients times ``factor``."""
        changed = {key: value * factor for key, value in self.changed.items()}
        return _Point(self.case, self.alpha * factor, changed)


def _step(point: _Point, measured: Array, u: Array, *, exact: bool) -> JointResult:
    """Solve the QP of a Gauss-Newton step: its T is corrected by what the model's T differs."""
    case, states = point.case, point.states
    rooms = [_room(case, c, s) for c, s in zip(case.configurations, states, strict=True)]
    # A step corrects T by a ratio, so that the QP needs no speed of sound but its rooms' own.
    equation = mean_equation(states[0].equation).linear()
    gains = _gains(point)

    def qp_log_time(of: _Point) -> Array:
        # The QP sees the absorption of its effects only through these unknowns.
        sizes = [[(g[c], p.size) for p, g in gains] for c in range(len(rooms))]
        each = zip(rooms, of.coefficients, sizes, strict=True)
        return np.log([_qp_time(equation, r, alpha, size) for r, alpha, size in each])

    less = point.scaled(1 - _STEP)
    now = qp_log_time(point)
    by_qp, by_model = qp_log_time(less) - now, less.log_time - point.log_time
    # If the model's T hardly depends on alpha, as when the coupled room decays last, the slope is small
    # and T has little weight. Where every alpha is 0, both are 0.
    slope = np.divide(by_model, by_qp, out=np.ones_like(by_qp), where=by_qp != 0)
    slope = np.clip(slope, _LEAST_SLOPE, _LARGEST_SLOPE)
    target = np.exp(now + np.clip((measured - point.log_time) / slope, -1.5, 1.5))
    terms = [AddedAbsorption(p.name, list(g), sigma=_spread(p), mean=p.size) for p, g in gains]
    # An uncertainty near T itself says nothing; a measurement refuses one that is larger than T.
    return _solve(rooms, equation, target, np.minimum(u / slope, 0.9), terms, exact=exact)


def _reached(case: Case, solved: JointResult) -> _Point:
    alpha, changed = _values(case, solved)
    sizes = solved.effects
    effects = [_resized(case, p, sizes[p.name]) if p.name in sizes else p for p in case.applied]
    return _Point(replace(case, applied=effects), alpha, changed)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """The QP at a point, what it solved to, and where that is.

    Near a coefficient of 1 the model's T may fall much faster than the QP's (Millington's does), so a
    step is shortened band by band where it leads farther from the ``measured`` ln T.
    """

    start: _Point
    solved: JointResult
    answer: _Point
    measured: Array
    u: Array

    @classmethod
    def at(
        cls, start: _Point, fitted: Case, measured: Array, u: Array, *, exact: bool
    ) -> _Linearised:
        solved = _step(start, measured, u, exact=exact)
        return cls(start, solved, _reached(fitted, solved), measured, u)

    def towards(self, share: Array) -> _Point:
        """Return the point at these shares, (n_bands,), of the way."""

        def part(start: Array, end: Array) -> Array:
            for halvings in range(1, 1 + _HALVINGS):
                end = np.where(share <= 0.5**halvings, (start + end) / 2, end)
            return end

        if (share == 1).all():
            return self.answer
        changed = {
            key: part(self.start.changed[key], value) for key, value in self.answer.changed.items()
        }
        return _Point(self.answer.case, part(self.start.alpha, self.answer.alpha), changed)

    def worse(self, end: _Point) -> NDArray[np.bool_]:
        """Return in which bands the model is farther from the measured T than at the start."""
        before, after = (
            np.max(np.abs(of.log_time - self.measured) / self.u, axis=0) for of in (self.start, end)
        )
        return np.asarray(after > np.maximum(before, _NEAR))


def _coefficients(
    case: Case, c: Configuration, alpha: Array, changed: Mapping[tuple[str, str], Array]
) -> Array:
    values = np.array(alpha)
    for material, change in c.changes.items():
        values[case.room.material_index(material)] = changed.get((c.name, material), change.alpha)
    return values


def _name(c: Configuration, material: str) -> str:
    """Return the name of a changed material, which is a separate unknown."""
    return f"{material} in {c.name}" if material in c.changes else material


def _room(case: Case, c: Configuration, s: RoomState) -> Room:
    """The configuration's room for the QP: areas that are seen, volume, prior alpha and sigma."""
    room = case.room
    visible = np.clip(seen(case, c).mean(1), _LEAST_SEEN, None)
    alpha, sigma = c.coefficients(room)
    least = None if room.alpha_min is None else np.minimum(room.alpha_min, alpha)
    return Room(
        name=c.name,
        volume=s.volume,
        materials=[_name(c, m) for m in room.materials],
        areas=s.areas * visible,
        alpha=alpha,
        sigma=sigma,
        centre_frequencies=room.centre_frequencies,
        air=air_of(case, c),
        alpha_min=least,
        band_correlation=room.band_correlation,
    )


def _spread(p: AppliedEffect) -> float:
    """Return the prior standard deviation of the size: the size itself, so that T determines it."""
    return max(p.size, _SMALLEST)


def _resized(case: Case, p: AppliedEffect, size: float) -> AppliedEffect:
    """Return the effect with another size, within what is possible."""
    return p.resized(float(np.clip(size, *p.effect.size_limits(case.room))))


def _gains(point: _Point) -> list[tuple[AppliedEffect, Array]]:
    """Return the effects whose size the QP estimates, each with the absorption area of one unit in m².

    The areas are (n_configurations, n_bands).
    """
    case, gains = point.case, []
    for i, p in enumerate(case.applied):
        # A size with an interval is known from all data, of which the QP has T20 alone.
        if p.size_interval is not None or p.effect.size in p.effect.discrete:
            continue
        others = [q for j, q in enumerate(case.applied) if j != i]
        # The slope is needed also at a size of 0.
        size = max(p.size, _SMALLEST)
        resized = [*case.applied]
        resized[i] = _resized(case, p, size)
        rows: list[Array | None] = []
        for c, alpha in zip(case.configurations, point.coefficients, strict=True):
            unchanged = replace(c, changes={})
            without = state(replace(case, applied=others), unchanged, alpha)
            added = p.effect.added_absorption(
                without, state(replace(case, applied=resized), unchanged, alpha)
            )
            rows.append(None if added is None else added / _slope(without) / size)
        if all(row is not None for row in rows):
            gains.append((p, np.array(rows)))
    return gains


def _slope(s: RoomState) -> Array:
    """d (S a) / d (S'alpha) of the QP's equation."""
    equation = mean_equation(s.equation).linear()
    mean = (s.areas @ s.alpha + s.covering) / s.total_area
    return equation.slope(np.clip(mean, 0, min(STEEPEST, equation.largest_mean)))


def _qp_time(
    equation: LinearEquation, room: Room, alpha: Array, gains: list[tuple[Array, float]]
) -> Array:
    """T by the QP's equation for its unknowns: alpha, and the effects that the QP calibrates."""
    area = room.areas @ alpha + sum((g * size for g, size in gains), np.zeros(room.n_bands))
    top = equation.largest_mean * room.total_area
    return equation.time(room, np.clip(area, 1e-6, 0.999 * top))


def _solve(
    rooms: list[Room],
    equation: LinearEquation,
    target: Array,
    u: Array,
    added: list[AddedAbsorption],
    *,
    exact: bool,
) -> JointResult:
    measured = [
        Measurement(
            centre_frequencies=r.centre_frequencies,
            values={"t20": row[None]},
            uncertainty={"t20": (row * spread)[None]},
        )
        for r, row, spread in zip(rooms, target, u, strict=True)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MissingAirWarning)  # it is among the finding's notes
        if exact:
            return calibrate(rooms[0], measured[0], equation=equation, unreachable="nearest").joint
        objective = PriorDeviation(band_correlation=rooms[0].band_correlation) + SoftMatch()
        for term in added:
            objective = objective + term
        return Calibration(objective).build(Configurations(rooms), equation).solve(measured)


def _values(case: Case, solved: JointResult) -> tuple[Array, dict[tuple[str, str], Array]]:
    row = {m: solved.alpha[i] for i, m in enumerate(solved.materials)}
    alpha = np.array([row.get(m, case.room.alpha[i]) for i, m in enumerate(case.room.materials)])
    changed = {(c.name, m): row[_name(c, m)] for c in case.configurations for m in c.changes}
    return alpha, changed
