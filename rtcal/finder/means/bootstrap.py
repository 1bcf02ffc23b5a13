"""The thresholds: the evidence that rooms without a missing effect give by chance.

What T20 of the first configuration detects, more data must not hide: one scale of all data dilutes what
T20 says with values that say nothing of the effect. So T20 and all data have a threshold each
(`features.steps`), the quantile of the null rooms' scores at one level: 5 % of these rooms exceed
either (the smallest p-value, Westfall & Young 1993).

A parametric bootstrap. Each draw takes alpha from the prior, the model's error from the engines'
control rooms, and noise from the measurement and from distances that are not stated. The errors that
coefficients have in common fall faster with the stated sigma than in the evidence
(`coefficients.NULL_POWER`). The model's bias and covariance are estimated from one half of the control
rooms, and the draws use the other half. The few control rooms of the network are not divided.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtcal.finder.case import Case
from rtcal.finder.means.engines import (
    ENGINES,
    ControlRooms,
    draw_alpha,
    recentred,
)
from rtcal.finder.means.evidence import MeansEvidence, evaluate_leading
from rtcal.finder.means.features import ObservedFeatures, distances, states, steps
from rtcal.finder.means.hypotheses import LowRank, MeansHypotheses
from rtcal.finder.means.likelihood import MeansProblem
from rtcal.finder.means.model_error import ModelDiscrepancy, estimate_discrepancy
from rtcal.finder.model import FEATURES, predict
from rtcal.finder.prior import NONE, NULL_POWER, Prior, directions, drawn
from rtcal.support import checks, files
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError
from rtcal.support.lazy import __version__
from rtcal.support.speed import TaskProgress, single_threaded_blas
from rtcal.support.types import Array

QUANTILE = 0.95
"""Share of the null rooms that exceed no threshold: 5 % false alarms."""
MINIMUM = 0.0
"""Smallest threshold in nats: below it, nothing missing explains the data better."""


@dataclass(frozen=True, eq=False)
class Threshold:
    """The evidence in nats that a finding must exceed, and what it was estimated from.

    ``values`` (n_steps,) are of ever more data, the last of all (`features.steps`). ``scores``
    (n_draws, n_steps) are those of the null rooms; ``discrepancy`` is that of all control rooms.
    """

    values: Array
    scores: Array
    discrepancy: ModelDiscrepancy

    @property
    def engines(self) -> tuple[str, ...]:
        """The simulators of the control rooms."""
        return self.discrepancy.engines


FOLDER = ".rtcal_cache"
"""Name of the folder beside a case's file; `support.files` removes those named ``.rtcal-*``."""


@single_threaded_blas()
@checked
def control_rooms(
    case: Case,
    seed: int = 0,
    engines: Sequence[str] = ("path tracing", "network"),
    progress: TaskProgress | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> tuple[ControlRooms, ...]:
    """Simulate the case's control rooms with at least two engines, or read them from a folder.

    A file of the folder ``cache`` holds the rooms of one engine. Its name is a hash of everything that
    they depend on: the case, the seed, the engine and the version of rtcal. The folder can be deleted
    at any time. If a file cannot be read or written, the rooms are simulated without an error.

    Raises
    ------
    DataError
        For fewer than two engines, or an engine that rtcal lacks.
    """
    checks.whole("seed", seed, 0)
    where, rooms = None if cache is None else checks.path("cache", cache), []
    for name in checked_engines(engines):
        path = None if where is None else where / f"{_key(case, seed, name)}.array"
        controls = None if path is None else _kept(path, case, name)
        if controls is None:
            controls = ENGINES[name].run(case, seed, progress)
            if path is not None:
                files.write(path, controls.errors)
        rooms.append(controls)
    return tuple(rooms)


def _key(case: Case, seed: int, engine: str) -> str:
    content = json.dumps([case.to_dict(), seed, engine, __version__], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:32]


def _kept(path: Path, case: Case, engine: str) -> ControlRooms | None:
    errors = files.read(path)
    if errors is None:
        return None
    try:
        return checked_controls(case, [ControlRooms(engine, errors)], least=1)[0]
    except DataError:
        return None


def checked_engines(engines: object) -> list[str]:
    """Return the names of at least two engines, each once; DataError otherwise."""
    names = list(dict.fromkeys(map(str, checks.listed("engines", engines))))
    if unknown := sorted(set(names) - set(ENGINES)):
        raise DataError(f'engine "{unknown[0]}" is not one of {", ".join(ENGINES)}')
    if len(names) < 2:
        raise DataError(f"engines = {names}: a threshold needs at least two engines")
    return names


def checked_controls(case: Case, controls: object, least: int = 2) -> tuple[ControlRooms, ...]:
    """Return control rooms of this case's shape and of ``least`` engines; DataError otherwise."""
    every = tuple(
        checks.instance("controls", c, ControlRooms) for c in checks.listed("controls", controls)
    )
    if len({c.engine for c in every}) < least:
        raise DataError(
            f"controls are of {', '.join(c.engine for c in every) or 'no engine'}: a threshold needs "
            "at least two engines"
        )
    shape = len(case.configurations), len(FEATURES), case.room.n_bands
    for c in every:
        if c.errors.shape[1:] != shape or not len(c.errors):
            raise DataError(
                f'controls of "{c.engine}" have shape {c.errors.shape}; this case\'s are (n_controls, '
                f"{', '.join(map(str, shape))}): they are of another case"
            )
    return every


def bootstrap_threshold(
    case: Case,
    observed: ObservedFeatures,
    predicted: MeansHypotheses,
    controls: Sequence[ControlRooms],
    prior: Prior,
    seed: int = 0,
    draws: int = 200,
) -> Threshold:
    """Return the thresholds for this case's data."""
    rng = np.random.default_rng([seed, 3])
    ends, scores = list(steps(case, observed.used)), []
    for fold in (0, 1):
        training = [_part(c, fold) for c in controls]
        test = [c.errors for c in recentred([_part(c, 1 - fold) for c in controls])]
        values = draw_null_features(case, observed, predicted.applied, test, rng, draws // 2)
        learnt = MeansProblem(case, observed, predicted, estimate_discrepancy(case, training))
        parts = evaluate_leading(learnt, prior.off, ends, values)
        scores.append(np.stack([score(part, prior) for part in parts], axis=1))
    table = np.concatenate(scores)
    return Threshold(thresholds(table), table, estimate_discrepancy(case, controls))


def thresholds(scores: Array) -> Array:
    """Return the threshold of each step, (n_steps,), from the null rooms' scores (n_draws, n_steps).

    They are quantiles of the steps at one level, and at least `MINIMUM`. Of the rooms `QUANTILE` exceed
    none of them.

    Examples
    --------
    >>> thresholds(np.stack([np.arange(101.0), np.arange(101.0)], axis=1))
    array([95., 95.])
    """
    raised = np.maximum(scores, MINIMUM)
    below = [np.searchsorted(np.sort(column), column) for column in raised.T]
    level = np.quantile(np.max(below, axis=0) / max(len(scores) - 1, 1), QUANTILE)
    return np.asarray(np.quantile(raised, level, axis=0))


_FEW = 16
"""Number of an engine's control rooms below which they are not divided."""


def _part(controls: ControlRooms, fold: int) -> ControlRooms:
    errors = controls.errors
    return ControlRooms(controls.engine, errors[fold::2] if len(errors) >= _FEW else errors)


def score(evidence: MeansEvidence, prior: Prior) -> Array:
    """Return the log evidence that something is missing, over "none", in nats.

    It is that of every hypothesis but "none", weighted by its prior probability.
    """
    table: Mapping[str, Array] = evidence.by_effect()
    names = [k for k in table if k != NONE]
    over = np.array([table[k] - table[NONE] for k in names])
    log = np.array([prior.log_probability[k] for k in names])
    log -= np.logaddexp.reduce(log)
    return np.asarray(np.logaddexp.reduce((over.T + log).T))


def draw_null_features(
    case: Case,
    observed: ObservedFeatures,
    applied: LowRank,
    errors: Sequence[Array],
    rng: np.random.Generator,
    n: int,
) -> Array:
    """Draw features (n, n_used) of rooms that lack nothing, with the engines' errors in them.

    ``applied`` is the covariance of the effects in the model, and of distances that are not stated.
    """
    alphas = draw_alpha(case, rng, n) + drawn(directions(case, NULL_POWER), rng, n)
    alphas = np.clip(alphas, 0.001, 0.99)
    rows = [
        predict(states(case, c, [a[i] for a in alphas]), distances(case, c)).features
        for i, c in enumerate(case.configurations)
    ]
    values = np.stack(rows, axis=1)
    engine = rng.integers(len(errors), size=n)
    picked = np.stack([errors[e][rng.integers(len(errors[e]))] for e in engine])
    values = values + np.nan_to_num(picked)
    mask = observed.used.ravel()
    covariance = observed.covariance + applied.covariance[np.ix_(mask, mask)]
    noise = rng.multivariate_normal(np.zeros(len(covariance)), covariance, n)
    return np.asarray(values[:, observed.used] + noise)
