"""How well each effect explains what was measured: evidence in closed form.

    log E_k = log mean over theta of N(y; y_k(theta) + bias, C)
    C = J Sigma J' + R + D + kappa² (½ d d' + ½ diag d²) + B

with y the features, J Sigma J' what the prior on alpha lets them vary, R what the measurement does,
bias and D the model's own discrepancy as control rooms showed it, d the effect's change, kappa its own
misfit (after Kennedy & O'Hagan 2001) and B what its place does to the decay's shape (`SHAPE_CHANGE`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from rtcal.acoustics import bands
from rtcal.acoustics.bands import correlation
from rtcal.discrepancy.case import AppliedEffect, Case
from rtcal.discrepancy.configuration import Configuration
from rtcal.discrepancy.effect_checks import changed, tried
from rtcal.discrepancy.effects import Effect, Parameters
from rtcal.discrepancy.engines import ControlRooms, bias_estimates
from rtcal.discrepancy.model import FEATURES, Predicted, State, predict, sensitivities
from rtcal.discrepancy.states import distances, state
from rtcal.errors import DataError
from rtcal.support.types import Array

KAPPA = 0.15
"""What an effect may be off, relative to the change that its formula gives."""
SHAPE_CHANGE = (("edt", 0.12), ("t30", 0.06))
"""How far ln EDT/T20 and ln T30/T20 may change where the effect changes ln T20 by one: what absorbs
stands somewhere, and the field is no longer as even as the formula takes it."""
NONE, UNKNOWN = "none", "unknown"


@dataclass(frozen=True, eq=False)
class Observed:
    """What was measured: features (n_configurations, n_features, n_bands), NaN where missing.

    ``covariance`` (n, n) is R, of the features that are there, in the order of ``used``.
    """

    features: Array
    used: Array  # bool, as features
    covariance: Array

    @property
    def values(self) -> Array:
        """The features that are there, (n,)."""
        return np.asarray(self.features[self.used])


@dataclass(frozen=True, eq=False)
class ModelDiscrepancy:
    """The model's own discrepancy: bias and covariance over all features, raveled."""

    bias: Array
    covariance: Array
    engines: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Every effect with every one of its parameters, and what the case's model then predicts.

    ``names`` and ``parameters`` (n,); ``features`` and ``slopes`` (n, n_configurations, n_features,
    n_bands); ``alpha_variance`` (n, n_configurations, n_bands, n_configurations, n_bands), the prior's
    covariance of ln T20. ``applied_covariance``, over all features raveled, is what is not known of the
    effects that the model has already. The first hypothesis is "none".
    """

    names: tuple[str, ...]
    parameters: tuple[Parameters, ...]
    features: Array
    slopes: Array
    alpha_variance: Array
    applied_covariance: Array
    effects: Mapping[str, Effect] = field(default_factory=dict)


LARGEST_UNCERTAINTY = 0.15
"""Relative standard uncertainty of a decay time, beyond which it is dropped."""


def observe(case: Case) -> tuple[Observed, list[str]]:
    """Return the case's features with their measurement covariance, and what was dropped, in words."""
    notes: list[str] = []
    n, k = len(case.configurations), case.room.n_bands
    table = np.full((n, len(FEATURES), k), np.nan)
    blocks = np.zeros((n, k, len(FEATURES), len(FEATURES)))
    for c, configuration in enumerate(case.configurations):
        table[c], blocks[c] = _features(configuration)
        for b, f in enumerate(configuration.measured.centre_frequencies):
            if blocks[c, b, 0, 0] > LARGEST_UNCERTAINTY**2:
                u = 100 * float(np.sqrt(blocks[c, b, 0, 0]))
                notes.append(
                    f'"{configuration.name}": {bands.label(f)} dropped: T is known to {u:.0f} % only'
                )
                table[c, :, b] = np.nan
            elif np.isnan(table[c, 0, b]):
                notes.append(f'"{configuration.name}": {bands.label(f)} dropped: no T20')
                table[c, :, b] = np.nan
    used = np.isfinite(table)
    full = np.zeros((n, len(FEATURES), k, n, len(FEATURES), k))
    for c in range(n):
        for b in range(k):
            full[c, :, b, c, :, b] = np.nan_to_num(blocks[c, b])
    flat = used.ravel()
    size = flat.size
    if not used.any():
        raise DataError(
            "no band of any configuration has a T that can be trusted: " + "; ".join(notes)
        )
    return Observed(table, used, full.reshape(size, size)[np.ix_(flat, flat)]), notes


def _features(configuration: Configuration) -> tuple[Array, Array]:
    m = configuration.measured
    t20, t30, edt = m.mean("t20"), m.mean("t30"), m.mean("edt")
    relative = {p: m.mean_uncertainty(p) / m.mean(p) for p in ("t20", "t30", "edt")}
    amount, u = (t20, relative["t20"]) if "t20" in m.values else (t30, relative["t30"])
    with np.errstate(divide="ignore", invalid="ignore"):
        table = np.stack(
            [np.log(amount), np.log(edt / amount), np.log(t30 / amount), m.mean("c80"), m.mean("g")]
        )
    if "t20" not in m.values:
        table[2] = np.nan  # it would be 0 by its making
    k = len(t20)
    base = np.where(np.isfinite(u), u, 0.03)
    e, t = (np.where(np.isfinite(relative[p]), relative[p], 0.03) for p in ("edt", "t30"))
    block = np.zeros((k, 5, 5))
    block[:, 0, 0] = base**2
    block[:, 1, 1] = base**2 + e**2
    block[:, 2, 2] = base**2 + t**2
    # The ratios share the T20 that they are taken to.
    block[:, 0, 1] = block[:, 1, 0] = block[:, 0, 2] = block[:, 2, 0] = -(base**2)
    block[:, 1, 2] = block[:, 2, 1] = base**2
    for row, p in ((3, "c80"), (4, "g")):
        known = m.mean_uncertainty(p)
        block[:, row, row] = np.where(np.isfinite(known), known, 0.5) ** 2
    return table, block


def hypotheses(
    case: Case, effects: Sequence[Effect], grids: Sequence[Sequence[Parameters]] | None = None
) -> Hypotheses:
    """Predict the case under every effect and parameter: of each effect's ``grids``, or its own."""
    base = [state(case, c) for c in case.configurations]
    if grids is None:
        grids = [tried(effect, base[0]) for effect in effects]
    names: list[str] = [NONE]
    parameters: list[Parameters] = [{}]
    states: list[list[State]] = [[one] for one in base]  # by configuration
    for effect, grid in zip(effects, grids, strict=True):
        names += [effect.name] * len(grid)
        parameters += grid
        for c, one, column in zip(case.configurations, base, states, strict=True):
            absent = c.suspect_removed and effect.removable
            column += [one] * len(grid) if absent else changed(effect, one, grid)
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        predicted = [
            predict(column, distances(case, c))
            for c, column in zip(case.configurations, states, strict=True)
        ]
    for p in predicted:
        if not (
            finite := np.isfinite(p.features).all((1, 2)) & np.isfinite(p.slopes).all((1, 2))
        ).all():
            i = int(np.argmin(finite))
            culprit = "the case's model" if i == 0 else f'effect "{names[i]}" with {parameters[i]}'
            raise DataError(
                f"{culprit} has no finite T, C80 and G in a room of {case.room.volume:g} m³ with "
                f"{case.room.total_area:g} m² of walls"
            )
    return Hypotheses(
        names=tuple(names),
        parameters=tuple(parameters),
        features=np.stack([p.features for p in predicted], axis=1),
        slopes=np.stack([p.slopes for p in predicted], axis=1),
        alpha_variance=alpha_variance(case, states, predicted),
        applied_covariance=_applied_covariance(case),
        effects={e.name: e for e in effects},
    )


def _applied_covariance(case: Case) -> Array:
    """What the effects in the model leave open: sizes and misfit, over all features raveled."""
    if not case.applied:
        n = len(case.configurations) * len(FEATURES) * case.room.n_bands
        return np.zeros((n, n))

    def features(present: Sequence[AppliedEffect]) -> Array:
        changed = replace(case, applied=present)
        return np.array(
            [
                predict([state(changed, c)], distances(case, c)).features[0]
                for c in case.configurations
            ]
        ).ravel()

    base = features(case.applied)
    out = np.zeros((len(base), len(base)))
    for i, one in enumerate(case.applied):
        if one.size_sigma > 0:
            size = one.effect.size
            moved = {**one.parameters, size: one.parameters[size] + one.size_sigma}
            others = list(case.applied)
            others[i] = replace(one, parameters=moved)
            d = features(others) - base
            out += np.outer(d, d)
        without = features([p for p in case.applied if p is not one])
        d = (base - without).reshape(len(case.configurations), len(FEATURES), -1)
        amount = np.broadcast_to(d[:, :1], d.shape).ravel()
        feature = np.broadcast_to(np.arange(len(FEATURES))[:, None], d.shape).ravel()
        out += _misfit(d.ravel(), amount, feature, KAPPA)
    return out


def _misfit(d: Array, amount: Array, feature: NDArray[np.intp], kappa: float) -> Array:
    """What an effect may do beside what its formula says, (..., m, m).

    Of changes ``d`` (..., m) of the features that ``feature`` (m,) numbers, ``amount`` (..., m) the
    change of ln T20 in the same band and configuration.
    """
    parts = [kappa * d]
    parts += [share * amount * (feature == FEATURES.index(name)) for name, share in SHAPE_CHANGE]
    return _half_common(np.stack(parts, axis=-2))


def _half_common(parts: Array) -> Array:
    """Sum over the parts e of ½ e e' + ½ diag e²: errors e, half of each in common; (..., n, m)."""
    parts = np.sqrt(0.5) * parts
    out = np.swapaxes(parts, -1, -2) @ parts
    diagonal = np.arange(parts.shape[-1])
    out[..., diagonal, diagonal] += (parts**2).sum(-2)
    return np.asarray(out)


def alpha_variance(
    case: Case, states: Sequence[Sequence[State]], predicted: Sequence[Predicted]
) -> Array:
    """Return the prior's covariance of ln T20, (n, n_configurations, n_bands, same, same).

    d ln T20 = -(d k / d alpha) T20 / (6 ln 10) d alpha; a material that a configuration changed is
    independent there of what it is elsewhere. ``states`` and ``predicted`` by configuration.
    """
    room = case.room
    rho = correlation(room.centre_frequencies, room.band_correlation)
    pull = np.stack(
        [
            sensitivities(column) * p.reverberation_time[:, None, :] / (6 * np.log(10))
            for column, p in zip(states, predicted, strict=True)
        ],
        axis=1,
    )  # (n, configurations, materials, bands)
    n, count, _, bands = pull.shape
    out = np.zeros((n, count, bands, count, bands))
    sigma = np.stack([_sigma(case, c) for c in case.configurations])
    scaled = pull * sigma
    for a in range(count):
        for b in range(count):
            first, second = case.configurations[a].changes, case.configurations[b].changes
            shared = np.array(
                [a == b or (m not in first and m not in second) for m in room.materials],
                dtype=float,
            )
            product = np.swapaxes(scaled[:, a] * shared[:, None], 1, 2) @ scaled[:, b]
            out[:, a, :, b, :] = product * rho
    return out


def _sigma(case: Case, configuration: Configuration) -> Array:
    sigma = np.array(case.room.sigma)
    for material, change in configuration.changes.items():
        sigma[case.room.material_index(material)] = change.sigma
    return sigma


COMMON_UNCERTAINTY: Mapping[str, float] = {"edt": 0.018, "t30": 0.006, "c80": 0.5, "g": 0.5}
"""Standard uncertainty of theory in all bands and configurations alike, in ln and dB: what one
engine's scatter does not show, since others see another field (`hidden_effects engines`)."""


def estimate_discrepancy(case: Case, controls: Sequence[ControlRooms]) -> ModelDiscrepancy:
    """Return bias and covariance of the model's discrepancy from control rooms.

    The bias is the mean of `bias_estimates`. The covariance is the scatter within each engine plus the
    scatter between these estimates. A sample covariance of few rooms is shrunk towards its diagonal.
    """
    n, k = len(case.configurations), case.room.n_bands
    size = n * len(FEATURES) * k
    estimates = bias_estimates(controls)
    bias = np.nanmean(estimates, axis=0)
    degrees = np.maximum(np.isfinite(estimates).sum(axis=0) - 1, 1)
    between = (np.nan_to_num(estimates - bias) / np.sqrt(degrees)).reshape(len(estimates), size)
    covariance = between.T @ between
    for c in controls:
        centred = np.nan_to_num(c.errors - c.mean).reshape(-1, size)
        covariance += centred.T @ centred / max(len(centred) - 1, 1) / len(controls)
    common = np.diag([COMMON_UNCERTAINTY.get(name, 0.0) ** 2 for name in FEATURES])
    ones = np.ones((n, n)), np.ones((k, k))
    covariance += np.einsum("ab,fg,kl->afkbgl", ones[0], common, ones[1]).reshape(size, size)
    shrunk = 0.6 * covariance + 0.4 * np.diag(np.diag(covariance))
    return ModelDiscrepancy(bias.ravel(), shrunk * 1.2, tuple(c.engine for c in controls))


@dataclass(frozen=True, eq=False)
class Evidence:
    """Log likelihood of every hypothesis, (n_hypotheses,) or (n_hypotheses, n_draws), in nats."""

    log_likelihood: Array
    unknown: Array
    names: tuple[str, ...]

    def by_effect(self) -> dict[str, Array]:
        """Return the log evidence of each effect, "none" and "unknown", in nats."""
        names = np.array(self.names)
        out = {}
        for name in dict.fromkeys(self.names):
            rows = self.log_likelihood[names == name]
            out[name] = np.logaddexp.reduce(rows) - np.log(len(rows))
        out[UNKNOWN] = self.unknown
        return out


def weigh(
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    values: Array | None = None,
    kappa: float = KAPPA,
) -> Evidence:
    """Return the evidence for the observed features, or for other ``values`` (n_draws, n) of them."""
    y = np.atleast_2d(observed.values if values is None else values)
    likelihood = log_likelihood(observed, predicted, discrepancy, y, kappa)
    mask = observed.used.ravel()
    residual = y - predicted.features[0].ravel()[mask] - discrepancy.bias[mask]
    covariance = alpha_covariance(predicted, 0)[np.ix_(mask, mask)]
    covariance += _without_alpha(observed, predicted, discrepancy)
    unknown = _unknown(residual, covariance, observed.used)
    if values is None:
        return Evidence(likelihood[:, 0], unknown[0], predicted.names)
    return Evidence(likelihood, unknown, predicted.names)


def log_likelihood(
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    values: Array,
    kappa: float = KAPPA,
) -> Array:
    """Return log N(y; y_k + bias, C) of ``values`` (n_draws, n), (n_hypotheses, n_draws), in nats."""
    rest = _without_alpha(observed, predicted, discrepancy)
    c, f, b = np.nonzero(observed.used)
    centres = predicted.features[:, c, f, b]
    slopes = predicted.slopes[:, c, f, b]
    count, _, bands = observed.used.shape
    own = c[:, None] * bands + b[:, None] == np.arange(count * bands)  # each feature's ln T20
    variances = predicted.alpha_variance.reshape(-1, count * bands, count * bands)
    d = centres - centres[0]
    amount = predicted.features[:, c, 0, b] - predicted.features[0, c, 0, b]
    out = np.empty((len(centres), len(values)))
    # A few hypotheses at once, so that their covariances stay in the processor's cache.
    for begin in range(0, len(out), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        jacobian = slopes[part, :, None] * own
        covariance = jacobian @ variances[part] @ jacobian.swapaxes(-1, -2)
        covariance += rest
        covariance += _misfit(d[part], amount[part], f, kappa)
        residual = values - (centres[part] + discrepancy.bias[observed.used.ravel()])[:, None]
        out[part] = _log_normal(residual, covariance)
    return out


def goodness_of_fit(
    observed: Observed, predicted: Hypotheses, discrepancy: ModelDiscrepancy, i: int
) -> tuple[float, float]:
    """Return how far the measurement is from hypothesis ``i``, and how probable as much or more is.

    The distance is the root of r' C^-1 r over its number of features, 1 where all is as expected; the
    probability chi-square's (Gelman, Meng & Stern 1996, without their draws: C holds the prior).
    """
    mask = observed.used.ravel()
    c, f, b = np.nonzero(observed.used)
    d = (predicted.features[i] - predicted.features[0])[c, f, b]
    amount = (predicted.features[i] - predicted.features[0])[c, 0, b]
    covariance = alpha_covariance(predicted, i)[np.ix_(mask, mask)]
    covariance += _without_alpha(observed, predicted, discrepancy) + _misfit(d, amount, f, KAPPA)
    residual = observed.values - predicted.features[i].ravel()[mask] - discrepancy.bias[mask]
    square = float(residual @ np.linalg.solve(covariance, residual))
    return float(np.sqrt(square / len(residual))), float(chdtrc(len(residual), square))


def _without_alpha(
    observed: Observed, predicted: Hypotheses, discrepancy: ModelDiscrepancy
) -> Array:
    """R + D and what is not known of the effects in the model, of the features that are there."""
    mask = observed.used.ravel()
    both = discrepancy.covariance + predicted.applied_covariance
    return np.asarray(observed.covariance + both[np.ix_(mask, mask)])


_AT_ONCE = 32
_LARGE = 1e30


def alpha_covariance(predicted: Hypotheses, i: int) -> Array:
    """J Sigma J' of one hypothesis, over all features raveled."""
    slopes = predicted.slopes[i]  # (configurations, features, bands)
    variance = predicted.alpha_variance[i]
    count, kinds, bands = slopes.shape
    full = np.einsum("afk,akbl,bgl->afkbgl", slopes, variance, slopes)
    return np.asarray(full.reshape(count * kinds * bands, -1))


def _log_normal(residual: Array, covariance: Array) -> Array:
    """Log density of residuals (..., n_draws, m) under covariances (..., m, m)."""
    m, draws = covariance.shape[-1], residual.shape[-2]
    # The factor of [[C, r], [r', large]] has L⁻¹ r in its last rows: no system is left to solve.
    whole = np.zeros((*covariance.shape[:-2], m + draws, m + draws))
    whole[..., :m, :m] = covariance
    whole[..., m:, :m] = residual
    own = np.arange(m, m + draws)
    whole[..., own, own] = _LARGE
    factor = np.linalg.cholesky(whole)
    z = factor[..., m:, :m]
    halves = np.log(np.diagonal(factor, axis1=-2, axis2=-1)[..., :m]).sum(-1)
    return np.asarray(-0.5 * (z * z).sum(-1) - halves[..., None] - 0.5 * m * np.log(2 * np.pi))


_SPREADS = (0.03, 0.08, 0.2)
"""Relative size of an unknown effect: of times in ln, of levels ten times as many dB."""


def _unknown(residual: Array, covariance: Array, used: Array) -> Array:
    """Log evidence of "something else": a change smooth over bands, and one free in each."""
    count, kinds, bands = used.shape
    scale = np.array([1.0, 0.4, 0.4, 8.0, 8.0])
    lag = np.abs(np.subtract.outer(np.arange(bands), np.arange(bands)))
    over_bands = 0.6 * 0.75**lag + 0.4 * np.eye(bands)
    # In all configurations alike; amount, shape and level each on its own.
    full = np.einsum("ab,fg,kl->afkbgl", np.ones((count, count)), np.diag(scale**2), over_bands)
    size = count * kinds * bands
    mask = used.ravel()
    extra = full.reshape(size, size)[np.ix_(mask, mask)]
    parts = [_log_normal(residual, covariance + s**2 * extra) for s in _SPREADS]
    return np.asarray(np.logaddexp.reduce(parts) - np.log(len(parts)))


def standardized_residuals(
    observed: Observed, predicted: Hypotheses, discrepancy: ModelDiscrepancy
) -> Array:
    """Return measured less modelled over its standard deviation, as `Observed.features`."""
    mask = observed.used.ravel()
    c = alpha_covariance(predicted, 0) + discrepancy.covariance
    spread = np.sqrt(np.diag(c)[mask] + np.diag(observed.covariance))
    out = np.full(mask.size, np.nan)
    residual = observed.values - predicted.features[0].ravel()[mask] - discrepancy.bias[mask]
    out[mask] = residual / spread
    return out.reshape(observed.used.shape)
