"""Calibrate a case's room without and with the effects that were added to its model.

The QP has the prior's deviation and a soft match of T, whose uncertainty includes the model's. alpha is
from 0 to 1, and the configurations share coefficients. The size of each effect that adds absorption is
a further unknown, 0 or more. A decay's shape, another equation or a noise floor is not part of the QP.
For these, Gauss-Newton steps correct its target T until the whole model has the measured T.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rtcal.acoustics.equations import LinearEquation, mean_equation
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import CalibrationRecord, Room
from rtcal.calibration.configurations import Configurations
from rtcal.calibration.measured import data_history, times_in_room
from rtcal.calibration.presets import calibrate
from rtcal.calibration.problem import Calibration
from rtcal.calibration.result import JointResult
from rtcal.calibration.terms import AddedAbsorption, PriorDeviation, SoftMatch
from rtcal.discrepancy.case import NORMAL_90, AppliedEffect, Case
from rtcal.discrepancy.configuration import Configuration
from rtcal.discrepancy.corrected import corrected_room
from rtcal.discrepancy.features import observe
from rtcal.discrepancy.model import FEATURES, STEEPEST, State, predict
from rtcal.discrepancy.model_error import ModelDiscrepancy, checked_discrepancy
from rtcal.discrepancy.states import distances, state
from rtcal.discrepancy.wording import amount
from rtcal.errors import MissingAirWarning
from rtcal.support import text
from rtcal.support.arguments import checked
from rtcal.support.threads import single_threaded_blas
from rtcal.support.types import Array
from rtcal.support.version import __version__

_ROUNDS = 5
_STEP = 0.02
_LEAST_SLOPE = 0.05
_SMALLEST = 1e-3
_MISFIT = 0.15
"""Relative standard deviation of an effect's change of T: half of its
variance is common to all bands (`Effect.spectrum_error`), half is not (`Effect.formula_error`)."""
_T20 = FEATURES.index("t20")


@dataclass(frozen=True, eq=False, repr=False)
class Recalibrated:
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
    joint : JointResult
        The QP's answer, in which a configuration's changed materials have names of their own.
    """

    case: Case
    alpha: Array
    changed: Mapping[tuple[str, str], Array]
    sizes: Mapping[str, float]
    features: Array
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
        source = ", calibrated to T20 alone" if p.name in self.joint.effects else ""
        interval = "" if ends is None else f" (90 %: {ends[0]:.3g} to {ends[1]:.3g})"
        return f"{name}{source}: {amount(size, p.effect.unit)}{interval}"

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


def plain(case: Case) -> Recalibrated:
    """Calibrate without effects: an exact match of the first configuration's T20.

    A band whose T no alpha reaches gets the nearest reachable T.
    """
    bare = replace(case, applied=())
    first = replace(bare, configurations=bare.configurations[:1])
    return _calibrated(first, bare, None, exact=True)


@single_threaded_blas()
@checked
def recalibrate(case: Case, discrepancy: ModelDiscrepancy | None = None) -> Recalibrated:
    """Calibrate the case with its effects, to T20 of every configuration.

    Parameters
    ----------
    case : Case
    discrepancy : ModelDiscrepancy, optional
        The model's error, from control rooms. Its bias is subtracted, and its covariance adds to the
        uncertainty of T.

    Raises
    ------
    DataError
        If the room was calibrated to one of the case's T before, or ``discrepancy`` belongs to another
        case.
    """
    if discrepancy is not None:
        checked_discrepancy(case, discrepancy)
    return _calibrated(case, case, discrepancy, exact=False)


def _calibrated(
    fitted: Case, whole: Case, discrepancy: ModelDiscrepancy | None, *, exact: bool
) -> Recalibrated:
    whole.require_fresh()
    room = fitted.room
    n, k = len(fitted.configurations), room.n_bands
    observed, _ = observe(fitted)
    shape = (len(whole.configurations), len(FEATURES), k)
    bias = np.zeros(shape) if discrepancy is None else discrepancy.bias.reshape(shape)
    error = np.zeros(shape)
    if discrepancy is not None:
        error = np.diag(discrepancy.covariance).reshape(shape)
    variance = np.full(observed.used.shape, np.nan)
    variance[observed.used] = np.diag(observed.covariance)
    t = np.exp(observed.features[:, _T20] - bias[:n, _T20])
    u = np.sqrt(variance[:, _T20] + error[:n, _T20] + _misfit(fitted) ** 2)
    effects = list(fitted.applied)
    alpha, changed = np.array(room.alpha), dict[tuple[str, str], Array]()
    solved: JointResult
    is_linear = isinstance(mean_equation(fitted.equation), LinearEquation)
    for _ in range(1 if is_linear and not effects else _ROUNDS):
        case = replace(fitted, applied=effects)
        states = [_state(case, c, alpha, changed) for c in fitted.configurations]
        rooms = [_room(room, c, s) for c, s in zip(fitted.configurations, states, strict=True)]
        equation = _equation(fitted, states[0])
        gains = _gains(case, states)
        # The QP sees the absorption of its effects only through these unknowns.
        current, moved = (
            np.log(
                [
                    [
                        _qp_time(equation, r, s, [(g[c], _size(p)) for p, g in gains]),
                        predict([s], distances(fitted, where)).reverberation_time[0],
                    ]
                    for c, (r, s, where) in enumerate(
                        zip(
                            rooms,
                            [replace(s, alpha=s.alpha * by) for s in states],
                            fitted.configurations,
                            strict=True,
                        )
                    )
                ]
            )
            for by in (1.0, 1.0 + _STEP)
        )
        # A Gauss-Newton step. If the model's T hardly depends on alpha, as when the coupled room decays
        # last, the slope is small and T has little weight.
        slope = (moved - current)[:, 1] / (moved - current)[:, 0]
        slope = np.clip(slope, _LEAST_SLOPE, 2.0)
        target = np.exp(current[:, 0] + np.clip((np.log(t) - current[:, 1]) / slope, -1.5, 1.5))
        terms = [
            AddedAbsorption(p.name, list(g), sigma=_spread(p), mean=_size(p)) for p, g in gains
        ]
        # An uncertainty near T itself says nothing; a measurement refuses one that is larger than T.
        spread = np.minimum(u / slope, 0.9)
        solved = _solve(rooms, equation, target, spread, terms, exact=exact)
        alpha, changed = _values(fitted, solved)
        effects = [_resized(p, solved.effects) if p.name in solved.effects else p for p in effects]
    done = replace(whole, applied=effects if fitted.applied else whole.applied)
    features = np.array(
        [
            predict([_state(done, c, alpha, changed)], distances(whole, c)).features[0]
            for c in whole.configurations
        ]
    )
    sizes = {p.name: _size(p) for p in effects if np.isfinite(p.effect.neutral)}
    return Recalibrated(done, alpha, changed, sizes, features, solved)


def _misfit(case: Case) -> Array:
    """Standard deviation of ln T by the effects' forms and sizes, (n_configurations, n_bands)."""
    if not case.applied:
        return np.zeros((len(case.configurations), case.room.n_bands))
    bare = replace(case, applied=())
    sizes = [_relative_spread(p) for p in case.applied]
    return np.array(
        [
            np.hypot(_MISFIT, max(sizes))
            * np.diff(
                predict([state(bare, c), state(case, c)], distances(case, c)).features[:, _T20],
                axis=0,
            )[0]
            for c in case.configurations
        ]
    )


def _relative_spread(p: AppliedEffect) -> float:
    """Return the size's standard deviation over its distance from the size that changes nothing."""
    apart = abs(_size(p) - p.effect.neutral)
    return min(p.size_sigma / max(apart, _SMALLEST), 1.0) if p.size_sigma else 0.0


def _state(
    case: Case, c: Configuration, alpha: Array, changed: Mapping[tuple[str, str], Array]
) -> State:
    values = np.array(alpha)
    for material, change in c.changes.items():
        values[case.room.material_index(material)] = changed.get((c.name, material), change.alpha)
    return state(case, replace(c, changes={}), values)


def _name(c: Configuration, material: str) -> str:
    """Return the name of a changed material, which is a separate unknown."""
    return f"{material} in {c.name}" if material in c.changes else material


def _room(room: Room, c: Configuration, s: State) -> Room:
    """The configuration's room for the QP: true areas and volume, prior alpha and sigma."""
    alpha, sigma = np.array(room.alpha), np.array(room.sigma)
    for material, change in c.changes.items():
        row = room.material_index(material)
        alpha[row], sigma[row] = change.alpha, change.sigma
    least = None if room.alpha_min is None else np.minimum(room.alpha_min, alpha)
    return Room(
        name=c.name,
        volume=s.volume,
        materials=[_name(c, m) for m in room.materials],
        areas=s.areas,
        alpha=alpha,
        sigma=sigma,
        centre_frequencies=room.centre_frequencies,
        air=c.air or room.air,
        alpha_min=least,
        band_correlation=room.band_correlation,
    )


def _equation(case: Case, s: State) -> LinearEquation:
    return replace(mean_equation(s.equation).linear(), speed_of_sound=case.room.speed_of_sound)


def _size(p: AppliedEffect) -> float:
    return float(p.parameters[p.effect.size])


def _spread(p: AppliedEffect) -> float:
    """Return the prior standard deviation of the size: the size itself, so that T determines it."""
    return max(_size(p), _SMALLEST)


def _resized(p: AppliedEffect, sizes: Mapping[str, float]) -> AppliedEffect:
    return replace(p, parameters={**p.parameters, p.effect.size: sizes[p.name]})


def _gains(case: Case, states: list[State]) -> list[tuple[AppliedEffect, Array]]:
    """Return the effects whose size the QP estimates, each with the absorption area of one unit in m².

    The areas are (n_configurations, n_bands).
    """
    gains = []
    for i, p in enumerate(case.applied):
        if p.size_interval is not None:
            continue  # its size is known from all data, of which the QP has T20 alone
        others = [q for j, q in enumerate(case.applied) if j != i]
        # The slope is needed also at a size of 0.
        size = max(_size(p), _SMALLEST)
        resized = [*case.applied]
        resized[i] = _resized(p, {p.name: size})
        rows: list[Array | None] = []
        for c, s in zip(case.configurations, states, strict=True):
            unchanged = replace(c, changes={})
            without = state(replace(case, applied=others), unchanged, s.alpha)
            added = p.effect.added_absorption(
                without, state(replace(case, applied=resized), unchanged, s.alpha)
            )
            rows.append(None if added is None else added / _slope(without) / size)
        if all(row is not None for row in rows):
            gains.append((p, np.array(rows)))
    return gains


def _slope(s: State) -> Array:
    """d (S a) / d (S'alpha) of the QP's equation."""
    equation = mean_equation(s.equation).linear()
    mean = (s.areas @ s.alpha + s.covering) / s.total_area
    return equation.slope(np.clip(mean, 0, min(STEEPEST, equation.largest_mean)))


def _qp_time(
    equation: LinearEquation, room: Room, s: State, gains: list[tuple[Array, float]]
) -> Array:
    """T by the QP's equation for the state's alpha and the effects that the QP calibrates."""
    area = room.areas @ s.alpha + sum((g * size for g, size in gains), np.zeros_like(s.air))
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
