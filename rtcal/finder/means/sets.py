"""Evidence of sets of effects: several effects in the model at once.

A hypothesis here is a set of rows of `MeansHypotheses`, each of another effect. There are some 200,000
pairs, so all are screened in closed form, and the best of each two effects are evaluated as `evidence`
does. The screen adds the changes that the effects cause alone. With C = L L' the covariance under
"none", M = U U' the misfit of an effect's change and W = L⁻¹ U, a pair costs one system of a few rows
(Woodbury) in place of a factorisation.

The likelihood has its full power, where the search for one effect coarsens it
(`likelihood.COARSENING`): that guards against what else the model lacks, which a set has in it. Chosen
by raising the sets' probabilities of development rooms to powers, without a new search: of the families
that reached 0.9, 42 of 45 were right at full power, 25 of 26 at the coarsened one. Both of two effects
were claimed in 5 of 36 rooms, and in 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from rtcal.acoustics.bands import correlation
from rtcal.finder.case import Case
from rtcal.finder.effects import Effect
from rtcal.finder.effects.checks import added, changed_states
from rtcal.finder.means.evidence import unknown_evidence
from rtcal.finder.means.features import COMMON_CORRELATION, AlphaCovariance, distances, state
from rtcal.finder.means.hypotheses import LowRank, MeansHypotheses, misfit
from rtcal.finder.means.likelihood import Factorization, MeansProblem, log_densities, student
from rtcal.finder.model import RoomState, predict, sensitivities
from rtcal.support.types import Array


def compare(problem: MeansProblem) -> MeansProblem:
    """Return a problem of sets: with errors of the direct sound (`DIRECT_SOUND`) and the grids."""
    case, predicted = problem.case, problem.predicted
    columns = np.zeros((*predicted.features.shape[1:], case.room.n_bands))
    over_bands = np.linalg.cholesky(correlation(case.room.centre_frequencies, COMMON_CORRELATION))
    for i, c in enumerate(case.configurations):
        base, at = state(case, c), distances(case, c)
        levels = (base.direct_db + 1.0, base.direct_db - 1.0)
        up, down = predict([replace(base, direct_db=level) for level in levels], at).features
        columns[i] = 0.5 * DIRECT_SOUND * (up - down)[:, :, None] * over_bands
    applied = predicted.applied
    factor = np.concatenate([applied.factor, columns.reshape(-1, columns.shape[-1])], axis=1)
    predicted = replace(predicted, applied=LowRank(factor, applied.diagonal))
    return replace(problem, predicted=predicted, cells=_cells(problem))


def _cells(problem: MeansProblem) -> Array:
    """Return the changes of the features over each hypothesis's cell of the grid.

    The standard deviation of an even distribution is the step over sqrt(12). Without it, what lies
    between the grid's points would look like a second effect.
    """
    predicted = problem.predicted
    c, f, b = problem.places
    features = predicted.features[:, c, f, b]
    names = np.array(predicted.names)
    steps: list[Array] = []
    for name, effect in predicted.effects.items():
        rows = np.flatnonzero(names == name)
        grid = [predicted.parameters[i] for i in rows]
        for k, parameter in enumerate(p for p in grid[0] if p not in effect.discrete):
            if k == len(steps):
                steps.append(np.zeros_like(features))
            lines: dict[tuple[float, ...], list[int]] = {}
            for j in np.argsort([theta[parameter] for theta in grid]):
                others = tuple(v for p, v in grid[j].items() if p != parameter)
                lines.setdefault(others, []).append(rows[j])
            for line in lines.values():
                if len(line) > 1:
                    steps[k][line] = np.gradient(features[line], axis=0)
    if not steps:
        return np.zeros((*features.shape, 0))
    return np.asarray(np.stack(steps, axis=-1) / np.sqrt(12))


DIRECT_SOUND = 6.0
"""Standard deviation of the direct sound's level in dB, in every set; alike in neighbouring octaves.
Objects between source and receiver shade it, and the directivity of a source may be 6 dB (ISO 3382-1,
Table 1, 4 kHz). No formula has either in it, so that C80 and G would speak for a second effect."""
Indices = NDArray[np.intp]
Rows = tuple[int, ...]
"""A set of effects with their parameters: rows of `MeansHypotheses`, in the order in which they act."""
_AT_ONCE = 256


def acting_order(case: Case, predicted: MeansHypotheses) -> list[str]:
    """Return the effects' names in the order in which they act on a state.

    Another equation comes first, since absorbers are added in its terms; then whatever contradicts
    what the room states; then what is added to it.
    """
    base = state(case, case.configurations[0])
    first = dict(zip(reversed(predicted.names), reversed(predicted.parameters), strict=True))

    def rank(effect: Effect) -> tuple[bool, bool]:
        changed = changed_states(effect, base, [first[effect.name]])[0]
        return changed.equation == base.equation, not effect.contradicts(case.room)

    return [e.name for e in sorted(predicted.effects.values(), key=rank)]


def shapes(case: Case, predicted: MeansHypotheses) -> frozenset[str]:
    """Return the effects that replace the decay's shape: a set holds one of them at most."""
    base = state(case, case.configurations[0])
    out = set()
    for name, theta in zip(predicted.names[1:], predicted.parameters[1:], strict=True):
        if name not in out:
            changed = changed_states(predicted.effects[name], base, [theta])[0]
            if changed.shape is not None:
                out.add(name)
    return frozenset(out)


class Screen:
    """Log likelihoods of pairs from the changes that each effect causes alone.

    With a ``base``, of pairs beside the effects of these rows. Row 0, "none", is a member that changes
    nothing.
    """

    def __init__(self, compared: MeansProblem, base: Rows = ()) -> None:
        predicted, change, amount = compared.predicted, compared.changes, compared.amounts
        _, f, b = compared.places
        alpha, other = compared.covariance_of(0)
        smooth = predicted.spectrum_errors[:, :, :2].take(b, 1)
        error = misfit(change, amount, f, smooth, 0.0)
        residual = compared.residual(0)
        for i in base:
            residual = residual - change[i]
            of_change = misfit(
                change[i],
                amount[i],
                f,
                predicted.spectrum_errors[i][b],
                predicted.formula_errors[i],
            )
            other = other + of_change.covariance + compared.cells[i] @ compared.cells[i].T
        factor = np.linalg.cholesky(alpha + other)
        self._half = float(np.log(np.diag(factor)).sum())
        self._m = len(factor)

        def whitened(rows: Array) -> Array:
            flat = rows.reshape(-1, self._m)
            return np.asarray(solve_triangular(factor, flat.T, lower=True).T.reshape(rows.shape))

        self._z = whitened(residual[None])[0]
        self._v = whitened(change)
        self._w = whitened(np.concatenate([error.factor, compared.cells], axis=2).swapaxes(1, 2))
        self._own = self._w @ self._w.swapaxes(1, 2)

    def pairs(self, first: Indices, second: Indices) -> Array:
        """Return the log likelihoods of every row of ``first`` with every one of ``second``."""
        a, b, r = len(first), len(second), self._w.shape[1]
        left = self._z - self._v[first]
        v, w1, w2 = self._v[second], self._w[first], self._w[second]
        # I + W' W, bordered by W' r and r' r: one Cholesky factor has its determinant and, squared in
        # its last element, what the misfit leaves of r' r.
        bordered = np.empty((a, b, 2 * r + 1, 2 * r + 1))
        bordered[:, :, :r, :r] = self._own[first][:, None]
        bordered[:, :, r:-1, r:-1] = self._own[second]
        bordered[:, :, r:-1, :r] = np.tensordot(w2, w1, axes=(2, 2)).transpose(2, 0, 1, 3)
        diagonal = np.arange(2 * r)
        bordered[:, :, diagonal, diagonal] += 1.0
        bordered[:, :, -1, :r] = (w1 @ left[:, :, None])[:, None, :, 0] - np.einsum(
            "arm,bm->abr", w1, v, optimize=True
        )
        bordered[:, :, -1, r:-1] = (
            np.einsum("am,brm->abr", left, w2, optimize=True) - (w2 @ v[:, :, None])[None, :, :, 0]
        )
        bordered[:, :, -1, -1] = (left**2).sum(1)[:, None] - 2 * left @ v.T + (v**2).sum(1)
        roots = np.diagonal(np.linalg.cholesky(bordered), axis1=2, axis2=3)
        half, square = np.log(roots[..., :-1]).sum(-1), roots[..., -1] ** 2
        return student(square, self._half + half, self._m, coarsened=False)


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean (n, m) and covariance (n, m, m) of the features in use under each of n sets.

    ``common`` (n, r, m) are the changes by what the coefficients usually err by in common. A set that
    is not ``possible`` has no finite features; its moments are 0 and the unit matrix.
    """

    mean: Array
    covariance: Array
    common: Array
    possible: NDArray[np.bool_]


def evaluate_sets(compared: MeansProblem, sets: Sequence[Rows], *, off: bool) -> Array:
    """Return the log likelihoods of sets in nats, each with all of its effects in the state.

    (n_sets, 2): with the coefficients as stated, and off together; -inf without ``off``.
    """
    out = np.full((len(sets), 2), -np.inf)
    for begin in range(0, len(sets), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        of = moments(compared, sets[part])
        rows = (compared.observed.values - of.mean)[:, None, :]
        if off:
            rows = np.concatenate([rows, of.common], axis=1)
        factorization, ends = Factorization(of.covariance), [rows.shape[2]]
        ((one, scaled),) = log_densities(factorization, rows, 1, ends, coarsened=False)
        out[part, 0] = np.where(of.possible, one[:, 0], -np.inf)
        if scaled is not None:
            out[part, 1] = np.where(of.possible, scaled[:, 0], -np.inf)
    return out


def moments(compared: MeansProblem, sets: Sequence[Rows]) -> Moments:
    """Return mean and covariance of the features in use, with all effects of a set in the state."""
    case, predicted, t20 = compared.case, compared.predicted, compared.t20
    c, f, b = compared.places
    if max(map(len, sets)) < 2:
        # These are predicted already.
        which = np.array([rows[0] if rows else 0 for rows in sets])
        features, slopes = predicted.features[which], predicted.slopes[which]
        alpha = predicted.alpha_covariance
    else:
        which = np.arange(len(sets))
        states = states_of(compared, sets)
        with np.errstate(all="ignore"):
            made = [
                predict(column, distances(case, where))
                for column, where in zip(states, case.configurations, strict=True)
            ]
        features = np.stack([p.features for p in made], axis=1)
        slopes = np.stack([p.slopes for p in made], axis=1)
        alpha = AlphaCovariance(case, len(sets))
        alpha.fill(slice(0, len(sets)), states, made)
    features, slopes = features[:, c, f, b], slopes[:, c, f, b]
    covariance = alpha.of(which).take(t20, 2) * slopes[:, None, :]
    covariance = covariance.take(t20, 1) * slopes[:, :, None]
    covariance += compared.without_alpha
    for member in range(max(map(len, sets))):
        at = np.array([rows[member] if member < len(rows) else 0 for rows in sets])
        errors = predicted.spectrum_errors[at].take(b, 1)
        alone = predicted.formula_errors[at]
        covariance += misfit(
            compared.changes[at], compared.amounts[at], f, errors, alone
        ).covariance
        cells = compared.cells[at]
        covariance += cells @ cells.swapaxes(1, 2)
    common = alpha.off_together(which).take(t20, 1) * slopes[:, :, None]
    mean = features + compared.bias
    possible = np.isfinite(mean).all(1) & np.isfinite(covariance).all((1, 2))
    mean[~possible], covariance[~possible], common[~possible] = 0.0, np.eye(len(f)), 0.0
    return Moments(mean, covariance, common.swapaxes(1, 2), possible)


def states_of(compared: MeansProblem, sets: Sequence[Rows]) -> list[list[RoomState]]:
    """Return the states of sets in each configuration."""
    case, predicted = compared.case, compared.predicted
    return [
        _states(case, predicted, state(case, where), i, sets)
        for i, where in enumerate(case.configurations)
    ]


def _states(
    case: Case,
    predicted: MeansHypotheses,
    base: RoomState,
    configuration: int,
    sets: Sequence[Rows],
) -> list[RoomState]:
    """Return the state of each set in one configuration; what is removed there is left out."""
    removed = case.configurations[configuration].suspect_removed
    made: dict[Rows, RoomState] = {(): base}
    for length in range(1, max(map(len, sets)) + 1):
        groups: dict[tuple[Rows, str], list[int]] = {}
        for rows in dict.fromkeys(s[:length] for s in sets if len(s) >= length):
            groups.setdefault((rows[:-1], predicted.names[rows[-1]]), []).append(rows[-1])
        for (before, name), last in groups.items():
            effect = predicted.effects[name]
            if removed and effect.removable:
                made |= {(*before, i): made[before] for i in last}
                continue
            grid = [predicted.parameters[i] for i in last]
            states = added(effect, made[before], grid)
            made |= {(*before, i): s for i, s in zip(last, states, strict=True)}
    return [made[rows] for rows in sets]


def unknown_beside(compared: MeansProblem, rows: Indices) -> Array:
    """Return the log evidence of single hypotheses with an unknown effect beside them, (n_rows,)."""
    used, out = compared.observed.used, []
    for i in rows.tolist():
        alpha, other = compared.covariance_of(i)
        other = other + compared.cells[i] @ compared.cells[i].T
        residual = compared.residual(i)
        ends = [len(residual)]
        value = unknown_evidence(residual[None], alpha + other, used, ends, coarsened=False)
        out.append(value[0, 0])
    return np.array(out)


def averaged_alpha(compared: MeansProblem, likely: Sequence[tuple[Rows, float]]) -> Array:
    """Return the posterior mean of alpha over sets with these probabilities, (n_materials, n_bands).

    Under each set, features and coefficients are jointly normal, with the moments that the evidence
    has: E[alpha | y] = mu + Sigma G' C^-1 (y - mean), G = d features / d alpha. Each set has its
    probability as its weight (Hoeting et al. 1999). So T bends the coefficients only as far as neither
    an effect nor the model's error explains it. Coefficients stay within 0 and 1.
    """
    sets = [rows for rows, _ in likely]
    of = moments(compared, sets)
    across = covariance_with_alpha(compared, sets)
    weights = np.array([p for _, p in likely]) * of.possible
    out = np.array(compared.case.room.alpha)
    for k in np.flatnonzero(weights):
        explained = np.linalg.solve(of.covariance[k], compared.observed.values - of.mean[k])
        out += weights[k] / weights.sum() * np.tensordot(explained, across[k], axes=1)
    return np.clip(out, 0.0, 1.0)


def covariance_with_alpha(compared: MeansProblem, sets: Sequence[Rows]) -> Array:
    """Return G Sigma, the prior's covariance of the features in use and alpha, under each set.

    (n_sets, n_used, n_materials, n_bands).
    """
    case, observed = compared.case, compared.observed
    room = case.room
    jacobian = np.zeros((*observed.used.shape, len(sets), *room.alpha.shape))
    for i, (configuration, states) in enumerate(
        zip(case.configurations, states_of(compared, sets), strict=True)
    ):
        with np.errstate(all="ignore"):  # sets that are not possible have no weight
            made = predict(states, distances(case, configuration))
            per_alpha = -sensitivities(states) * made.reverberation_time[:, None] / (6 * np.log(10))
        changed = [m in configuration.changes for m in room.materials]
        per_alpha[:, changed] = 0.0  # what stands there is another material
        for band in range(room.n_bands):
            slopes = made.slopes[:, :, band].T[..., None]
            jacobian[i, :, band, :, :, band] = slopes * per_alpha[:, :, band]
    rho = correlation(room.centre_frequencies, room.band_correlation)
    across = (jacobian[observed.used] * room.sigma) @ rho * room.sigma
    return np.asarray(across.swapaxes(0, 1))
