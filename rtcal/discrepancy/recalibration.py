"""Calibrate a case's room: as its model stands, and with what has been added to it.

The QP is rtcal's own: the prior's deviation, T matched as closely as its uncertainty (the
measurement's and the model's) deserves, alpha from 0 to 1, coefficients shared between
configurations, and for each effect that adds absorption a further unknown, 0 or more. What cannot
stand in the QP (a decay's shape, another equation, a noise floor) moves the target: the QP matches
what its own equation must give for the whole model to give the measured T, in Gauss-Newton steps.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from rtcal.acoustics.equations import Eyring, LinearEquation, Sabine
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.room import Room
from rtcal.calibration.configurations import Configurations
from rtcal.calibration.presets import calibrate
from rtcal.calibration.problem import Calibration
from rtcal.calibration.terms import AddedAbsorption, PriorDeviation, SoftMatch
from rtcal.discrepancy.case import Case, Configuration, Present
from rtcal.discrepancy.effects import Effect, library
from rtcal.discrepancy.evidence import KAPPA, ModelError, observe
from rtcal.discrepancy.model import FEATURES, State, predict
from rtcal.discrepancy.states import distances, state
from rtcal.errors import MissingAirWarning
from rtcal.types import Array

_ROUNDS = 5
_STEP = 0.02
_LEAST_SLOPE = 0.05
_T20 = FEATURES.index("t20")


@dataclass(frozen=True, eq=False)
class Recalibrated:
    """A case's coefficients and what the model then predicts.

    Attributes
    ----------
    case : Case
        With the effects' sizes as calibrated.
    alpha : array (n_materials, n_bands)
        The room's own; a configuration's changes are in ``changed``.
    changed : mapping of (configuration, material) to array (n_bands,)
    sizes : mapping of str to float
        Of the effects that are unknowns of the QP, in the effect's unit.
    features : array (n_configurations, n_features, n_bands)
        Predicted: ln T20, ln EDT/T20, ln T30/T20, C80 and G in dB, the model's bias left out.
    """

    case: Case
    alpha: Array
    changed: Mapping[tuple[str, str], Array]
    sizes: Mapping[str, float]
    features: Array


def plain(case: Case) -> Recalibrated:
    """Calibrate as is usual: the first configuration's T20, exactly, whatever the model lacks.

    Bands that no alpha reaches go to the nearest end.
    """
    bare = replace(case, present=())
    one = replace(bare, configurations=bare.configurations[:1])
    return _calibrated(one, bare, None, exact=True)


def recalibrate(case: Case, error: ModelError | None = None) -> Recalibrated:
    """Calibrate the case with its effects, to T20 of every configuration.

    Parameters
    ----------
    case : Case
    error : ModelError, optional
        The model's own, from control rooms; it widens what T is known to, and its bias is taken off.
    """
    return _calibrated(case, case, error, exact=False)


def _calibrated(
    fitted: Case, whole: Case, error: ModelError | None, *, exact: bool
) -> Recalibrated:
    room = fitted.room
    n, k = len(fitted.configurations), room.n_bands
    observed, _ = observe(fitted)
    shape = (len(whole.configurations), len(FEATURES), k)
    bias = np.zeros(shape) if error is None else error.bias.reshape(shape)
    own = np.zeros(shape) if error is None else np.diag(error.covariance).reshape(shape)
    variance = np.full(observed.used.shape, np.nan)
    variance[observed.used] = np.diag(observed.covariance)
    t = np.exp(observed.features[:, _T20] - bias[:n, _T20])
    u = np.sqrt(variance[:, _T20] + own[:n, _T20] + _misfit(fitted) ** 2)
    effects = {e.name: e for e in library()}
    present = list(fitted.present)
    alpha, changed = np.array(room.alpha), dict[tuple[str, str], Array]()
    solved = None
    for _ in range(_ROUNDS if present or fitted.equation == "millington" else 1):
        case = replace(fitted, present=present)
        states = [_state(case, c, alpha, changed) for c in fitted.configurations]
        rooms = [_room(room, c, s) for c, s in zip(fitted.configurations, states, strict=True)]
        equation = _equation(fitted, states[0])
        gains = _gains(case, states, effects)
        # What the effects of the QP add is known to the target only through these unknowns.
        here, moved = (
            np.log([
                [
                    _qp_time(equation, r, s, [(g[c], _size(p, effects)) for p, g in gains]),
                    predict([s], distances(fitted, where)).reverberation_time[0],
                ]
                for c, (r, s, where) in enumerate(
                    zip(rooms, [replace(s, alpha=s.alpha * by) for s in states],
                        fitted.configurations, strict=True)
                )
            ])
            for by in (1.0, 1.0 + _STEP)
        )  # fmt: skip
        # A step of Gauss and Newton: where the model's T hardly depends on alpha (the other room
        # decays last), its T says as little about alpha.
        slope = (moved - here)[:, 1] / (moved - here)[:, 0]
        slope = np.clip(slope, _LEAST_SLOPE, 2.0)
        target = np.exp(here[:, 0] + np.clip((np.log(t) - here[:, 1]) / slope, -1.5, 1.5))
        terms = [
            AddedAbsorption(p.effect, list(g), sigma=_spread(p, effects), mean=_size(p, effects))
            for p, g in gains
        ]
        solved = _solve(rooms, equation, target, u / slope, terms, exact=exact)
        alpha, changed = _values(fitted, solved)
        present = [
            _resized(p, effects, solved.effects) if p.effect in solved.effects else p
            for p in present
        ]
    done = replace(whole, present=present if fitted.present else whole.present)
    features = np.array([
        predict([_state(done, c, alpha, changed)], distances(whole, c)).features[0]
        for c in whole.configurations
    ])  # fmt: skip
    sizes = {p.effect: _size(p, effects) for p in present if np.isfinite(effects[p.effect].neutral)}
    return Recalibrated(done, alpha, changed, sizes, features)


def _misfit(case: Case) -> Array:
    """How far ln T of the effects in the model may be off, (n_configurations, n_bands)."""
    bare = replace(case, present=())
    return np.array([
        KAPPA * np.diff(
            predict([state(bare, c), state(case, c)], distances(case, c)).features[:, _T20], axis=0
        )[0]
        for c in case.configurations
    ])  # fmt: skip


def _state(
    case: Case, c: Configuration, alpha: Array, changed: Mapping[tuple[str, str], Array]
) -> State:
    values = np.array(alpha)
    for material, change in c.changes.items():
        values[case.room.material_index(material)] = changed.get((c.name, material), change.alpha)
    return state(case, replace(c, changes={}), values)


def _name(c: Configuration, material: str) -> str:
    """A changed material is an unknown of its own."""
    return f"{material} in {c.name}" if material in c.changes else material


def _room(room: Room, c: Configuration, s: State) -> Room:
    """The configuration's room for the QP: true areas and volume, prior alpha and sigma."""
    alpha, sigma = np.array(room.alpha), np.array(room.sigma)
    for material, change in c.changes.items():
        row = room.material_index(material)
        alpha[row], sigma[row] = change.alpha, change.sigma
    return Room(
        name=c.name, volume=s.volume, materials=[_name(c, m) for m in room.materials],
        areas=s.areas, alpha=alpha, sigma=sigma, centre_frequencies=room.centre_frequencies,
        air=c.air or room.air, band_correlation=room.band_correlation,
    )  # fmt: skip


def _equation(case: Case, s: State) -> LinearEquation:
    kind = Sabine if s.equation == "sabine" else Eyring
    return kind(speed_of_sound=case.room.speed_of_sound)


def _size(p: Present, effects: Mapping[str, Effect]) -> float:
    return float(p.parameters[effects[p.effect].size])


def _spread(p: Present, effects: Mapping[str, Effect]) -> float:
    """As wide as the size itself: the data decide it, not what they were found by."""
    return max(_size(p, effects), 1e-3)


def _resized(p: Present, effects: Mapping[str, Effect], sizes: Mapping[str, float]) -> Present:
    return replace(p, parameters={**p.parameters, effects[p.effect].size: sizes[p.effect]})


def _gains(
    case: Case, states: list[State], effects: Mapping[str, Effect]
) -> list[tuple[Present, Array]]:
    """What a unit of each additive effect adds to S'alpha, (n_configurations, n_bands), in m²."""
    found = []
    for i, p in enumerate(case.present):
        effect = effects[p.effect]
        if not effect.removable or (states[0].shape is not None and effect.name == "coupled room"):
            continue
        others = [q for j, q in enumerate(case.present) if j != i]
        bare = replace(case, present=others)
        gain = []
        for c, s in zip(case.configurations, states, strict=True):
            if c.suspect_removed:
                gain.append(np.zeros_like(s.air))
                continue
            without = state(bare, replace(c, changes={}), s.alpha)
            change = s.surface_absorption + s.objects - without.surface_absorption - without.objects
            gain.append(np.asarray(change / _slope(without) / _size(p, effects)))
        found.append((p, np.array(gain)))
    return found


def _slope(s: State) -> Array:
    """d (S a) / d (S'alpha) of the QP's equation."""
    if s.equation == "sabine":
        return np.ones_like(s.air)
    mean = (s.areas @ s.alpha + s.covering) / s.total_area
    return np.asarray(1 / (1 - np.clip(mean, 0, 0.98)))


def _qp_time(
    equation: LinearEquation, room: Room, s: State, gains: list[tuple[Array, float]]
) -> Array:
    """T of the QP's equation for the state's alpha and the effects that are its unknowns."""
    area = room.areas @ s.alpha + sum((g * size for g, size in gains), np.zeros_like(s.air))
    top = equation.largest_mean_alpha * room.total_area
    return equation.time(room, np.clip(area, 1e-6, 0.999 * top))


@dataclass(frozen=True, eq=False)
class Solved:
    """The QP's answer: alpha by its own materials' names, and the effects' sizes."""

    alpha: Array
    materials: tuple[str, ...]
    effects: Mapping[str, float]


def _solve(
    rooms: list[Room], equation: LinearEquation, target: Array, u: Array,
    added: list[AddedAbsorption], *, exact: bool,
) -> Solved:  # fmt: skip
    measured = [
        Measurement(
            centre_frequencies=r.centre_frequencies, values={"t20": row[None]},
            uncertainty={"t20": (row * spread)[None]},
        )
        for r, row, spread in zip(rooms, target, u, strict=True)
    ]  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MissingAirWarning)  # it is among the finding's notes
        if exact:
            result = calibrate(rooms[0], measured[0], equation=equation, unreachable="nearest")
            return Solved(result.alpha, tuple(rooms[0].materials), {})
        return _soft(rooms, equation, measured, added)


def _soft(
    rooms: list[Room], equation: LinearEquation, measured: list[Measurement],
    added: list[AddedAbsorption],
) -> Solved:  # fmt: skip
    correlation = rooms[0].band_correlation
    objective = PriorDeviation(band_correlation=correlation) + SoftMatch()
    for term in added:
        objective = objective + term
    joint = Calibration(objective).build(Configurations(rooms), equation=equation).solve(measured)
    return Solved(joint.alpha, joint.materials, dict(joint.effects))


def _values(case: Case, solved: Solved) -> tuple[Array, dict[tuple[str, str], Array]]:
    row = {m: solved.alpha[i] for i, m in enumerate(solved.materials)}
    alpha = np.array([row.get(m, case.room.alpha[i]) for i, m in enumerate(case.room.materials)])
    changed = {(c.name, m): row[_name(c, m)] for c in case.configurations for m in c.changes}
    return alpha, changed
