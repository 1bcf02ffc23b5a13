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

from rtcal.acoustics.equations import LinearEquation, mean_equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.calibration.fit import gauss_newton
from rtcal.calibration.measured import data_history, times_in_room
from rtcal.calibration.methods import calibrate
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
from rtcal.finder.model import FEATURES, STEEPEST, Predicted, RoomState, predict
from rtcal.support import __version__, text
from rtcal.support.blocks import Block, Note, Row, Table
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

    def blocks(self, plain: Recalibrated | None = None) -> list[Block]:
        """Return each material's alpha, as stated and as calibrated, and the effects."""
        room, beside = (plain or self).case.room, {} if plain is None else {"plain": plain}
        named = {"prior": (room.alpha, NORMAL_90 * room.sigma)}
        for name, c in {**beside, "corrected": self}.items():
            named[name] = (c.alpha, np.subtract(*c.interval[::-1]) / 2)
        rows = [
            Row(m, [f"{a[i].mean():.3f} ± {half[i].mean():.3f}" for a, half in named.values()])
            for i, m in enumerate(room.materials)
        ]
        title = "alpha ± half its 90 % interval, means over bands"
        return [Table([*named], rows, title), *(Note(w, "  ") for w in self.effects_in_words)]

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


def plain(case: Case) -> Recalibrated:
    """Calibrate without effects: an exact match of the first configuration's T20.

    A band whose T no alpha reaches gets the nearest reachable T.
    """
    return _calibrated(replace(case, applied=()), [0], None, exact=True)


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
    fitted = [c for c in range(len(case.configurations)) if c not in left_out]
    return _calibrated(case, fitted, discrepancy, exact=False)


def _calibrated(
    case: Case, fitted: Sequence[int], discrepancy: ModelDiscrepancy | None, *, exact: bool
) -> Recalibrated:
    """Calibrate to the configurations of these numbers."""
    case.require_fresh()
    observed, _ = observe(replace(case, configurations=[case.configurations[c] for c in fitted]))
    shape = (len(case.configurations), len(FEATURES), case.room.n_bands)
    bias = np.zeros(shape) if discrepancy is None else discrepancy.bias.reshape(shape)
    variance = np.full(observed.used.shape, np.nan)
    variance[observed.used] = np.diag(observed.covariance)
    measured = observed.features[:, _T20] - bias[fitted, _T20]
    u = np.sqrt(np.maximum(variance[:, _T20], _LEAST_U**2))
    is_linear = isinstance(mean_equation(case.equation), LinearEquation)
    changes = [c.changes[m].alpha for c, m in _changed(case)]
    steps = gauss_newton(
        _Point(case, fitted, np.vstack([case.room.alpha, *changes])),
        lambda at: _Linearised.at(at, measured, u, exact=exact),
        groups=case.room.n_bands,
        most=1 if is_linear and not case.applied else _ROUNDS,
        halvings=_HALVINGS,
    )
    point, solved = steps.end, steps.steps[-1].model.solved
    applied, n = point.case.applied, case.room.n_materials
    return Recalibrated(
        point.case,
        point.alpha[:n],
        {
            (c.name, m): row
            for (c, m), row in zip(_changed(case), point.alpha[n:], strict=True)
            if case.configurations.index(c) in fitted
        },
        {p.name: p.size for p in applied if np.isfinite(p.effect.neutral)},
        np.array([point.predicted(c).features[0] for c in range(len(case.configurations))]),
        float(np.sqrt(np.nanmean(((point.log_time - measured) / u) ** 2))),
        solved,
    )


def _changed(case: Case) -> list[tuple[Configuration, str]]:
    """Return the materials that configurations change: each is an unknown of its own."""
    return [(c, m) for c in case.configurations for m in c.changes]


def _name(c: Configuration, material: str) -> str:
    """Return the name of an unknown: that of a changed material has its configuration's."""
    return f"{material} in {c.name}" if material in c.changes else material


@dataclass(frozen=True, eq=False)
class _Point:
    """The start of a step: the case with its effects' sizes, and the coefficients.

    ``alpha`` has the room's materials, then those that configurations change (`_changed`). ``fitted``
    are the numbers of the configurations that are calibrated to.
    """

    case: Case
    fitted: Sequence[int]
    alpha: Array

    @cached_property
    def coefficients(self) -> list[Array]:
        """The unknowns of each configuration (n_materials, n_bands), before any effect on them."""
        room, out = self.case.room, []
        names = [*room.materials, *(_name(c, m) for c, m in _changed(self.case))]
        for c in self.case.configurations:
            out.append(self.alpha[[names.index(_name(c, m)) for m in room.materials]])
        return out

    def state(self, c: int, applied: Sequence[AppliedEffect] | None = None) -> RoomState:
        """Return the state of a configuration with these effects, by default the case's."""
        case = self.case if applied is None else replace(self.case, applied=applied)
        unchanged = replace(case.configurations[c], changes={})
        return state(case, unchanged, self.coefficients[c])

    def predicted(self, c: int) -> Predicted:
        """Return what the model predicts of a configuration."""
        return predict([self.state(c)], distances(self.case, self.case.configurations[c]))

    @cached_property
    def log_time(self) -> Array:
        """ln T of the model in the fitted configurations, (n_fitted, n_bands)."""
        return np.log([self.predicted(c).reverberation_time[0] for c in self.fitted])

    @cached_property
    def gains(self) -> list[tuple[AppliedEffect, Array]]:
        """The effects whose size the QP estimates, each with the absorption area of one unit in m².

        The areas are (n_fitted, n_bands).
        """
        case, gains = self.case, []
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
            for c in self.fitted:
                without = self.state(c, others)
                added = p.effect.added_absorption(without, self.state(c, resized))
                rows.append(None if added is None else added / _slope(without) / size)
            if all(row is not None for row in rows):
                gains.append((p, np.array(rows)))
        return gains

    def qp_log_time(self, rooms: Sequence[Room], equation: LinearEquation, at: _Point) -> Array:
        """Return ln T by the QP's equation: it has effects only through the sizes that are unknowns."""
        out = []
        for i, (c, room) in enumerate(zip(self.fitted, rooms, strict=True)):
            more = sum((g[i] * p.size for p, g in self.gains), np.zeros(room.n_bands))
            top = 0.999 * equation.largest_mean * room.total_area
            area = np.clip(room.areas @ at.coefficients[c] + more, 1e-6, top)
            out.append(equation.time(room, area))
        return np.log(out)


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
    def at(cls, start: _Point, measured: Array, u: Array, *, exact: bool) -> _Linearised:
        """Solve the QP of a Gauss-Newton step: its T is corrected by what the model's T differs."""
        case, states = start.case, [start.state(c) for c in start.fitted]
        rooms = [
            _room(case, case.configurations[c], s)
            for c, s in zip(start.fitted, states, strict=True)
        ]
        # A step corrects T by a ratio, so that the QP needs no speed of sound but its rooms' own.
        equation = mean_equation(states[0].equation).linear()
        less = replace(start, alpha=start.alpha * (1 - _STEP))
        now = start.qp_log_time(rooms, equation, start)
        by_qp = start.qp_log_time(rooms, equation, less) - now
        by_model = less.log_time - start.log_time
        # If the model's T hardly depends on alpha, as when the coupled room decays last, the slope is
        # small and T has little weight. Where every alpha is 0, both are 0.
        slope = np.divide(by_model, by_qp, out=np.ones_like(by_qp), where=by_qp != 0)
        slope = np.clip(slope, _LEAST_SLOPE, _LARGEST_SLOPE)
        target = np.exp(now + np.clip((measured - start.log_time) / slope, -1.5, 1.5))
        # An uncertainty near T itself says nothing; a measurement refuses one that is larger than T.
        error = target * np.minimum(u / slope, 0.9)
        data = [
            Measurement(
                centre_frequencies=case.room.centre_frequencies,
                values={"t20": t[None]},
                uncertainty={"t20": of[None]},
            )
            for t, of in zip(target, error, strict=True)
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MissingAirWarning)  # it is among the finding's notes
            if exact:
                plainly = calibrate(rooms[0], data[0], equation=equation, unreachable="nearest")
                solved = plainly.joint
            else:
                prior = PriorDeviation(band_correlation=case.room.band_correlation)
                objective = prior + SoftMatch()
                for p, g in start.gains:
                    # The size has itself as its prior's deviation, so that T determines it.
                    spread = max(p.size, _SMALLEST)
                    objective = objective + AddedAbsorption(
                        p.name, list(g), sigma=spread, mean=p.size
                    )
                solved = Calibration(objective).build(Configurations(rooms), equation).solve(data)
        return cls(start, solved, _reached(start, solved), measured, u)

    def towards(self, share: Array) -> _Point:
        """Return the point at these shares, (n_bands,), of the way."""
        if (share == 1).all():
            return self.answer
        alpha = self.start.alpha + share * (self.answer.alpha - self.start.alpha)
        return replace(self.answer, alpha=alpha)

    def worse(self, end: _Point) -> NDArray[np.bool_]:
        """Return in which bands the model is farther from the measured T than at the start."""
        before, after = (
            np.max(np.abs(of.log_time - self.measured) / self.u, axis=0) for of in (self.start, end)
        )
        return np.asarray(after > np.maximum(before, _NEAR))


def _reached(start: _Point, solved: JointResult) -> _Point:
    """Return the point of the QP's answer; what it has not stays as it was."""
    case, row = start.case, dict(zip(solved.materials, solved.alpha, strict=True))
    names = [*case.room.materials, *(_name(c, m) for c, m in _changed(case))]
    alpha = [row.get(name, stated) for name, stated in zip(names, start.alpha, strict=True)]
    sizes = solved.effects
    effects = [_resized(case, p, sizes[p.name]) if p.name in sizes else p for p in case.applied]
    return _Point(replace(case, applied=effects), start.fitted, np.array(alpha))


def _room(case: Case, c: Configuration, s: RoomState) -> Room:
    """The configuration's room for the QP: areas that are seen, volume, prior alpha and sigma."""
    room, air = case.room, c.air or case.room.air
    for p in case.applied:
        air = p.effect.air(air, p.parameters)
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
        air=air,
        alpha_min=least,
        band_correlation=room.band_correlation,
    )


def _resized(case: Case, p: AppliedEffect, size: float) -> AppliedEffect:
    """Return the effect with another size, within what is possible."""
    return p.resized(float(np.clip(size, *p.effect.size_limits(case.room))))


def _slope(s: RoomState) -> Array:
    """d (S a) / d (S'alpha) of the QP's equation."""
    equation = mean_equation(s.equation).linear()
    mean = (s.areas @ s.alpha + s.covering) / s.total_area
    return equation.slope(np.clip(mean, 0, min(STEEPEST, equation.largest_mean)))
