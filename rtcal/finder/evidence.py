"""What a hypothesis weighs: its prior, and its evidence by a log density in each observation model.

    y - f = d + e,   e of covariance C + U U'

f is what is predicted as stated and d the hypothesis' change of it. C is the covariance that is
factored once, U the columns of errors that are the hypothesis' own. With r = y - f - d, the density
needs r' C⁻¹ r, U' C⁻¹ r and U' C⁻¹ U alone (`with_columns`), and the form of its tail: Student's t by
means (`student`), normal up to the number of values by positions (`bounded`), and normal for the
surfaces between two states.

Coefficients may err together: by a factor and a tilt over frequency, for all and per material. The
usual amount of such errors (`rtcal.acoustics.room_errors`) belongs to every hypothesis. Coefficients
that are *off together* err by several times as much (`SCALES`): heavy tails.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.special import gammaln

from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import HANDBOOK_SIGMA, POWER, common_error_columns
from rtcal.finder.case import Case, ChangedMaterial, Configuration
from rtcal.finder.effects import Effect, Parameters, columns
from rtcal.finder.model import RoomState
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array, read_only_view


def with_columns(
    square: Array, half: Array | float, across: Array, inner: Array
) -> tuple[Array, Array]:
    """Return r' (C + U U')⁻¹ r and ln sqrt|C + U U'| from products with C⁻¹ (Woodbury's identity).

    Of m vectors r: ``square`` (..., m) is r' C⁻¹ r and ``half`` (..., 1) ln sqrt|C|; ``across``
    (..., n_columns, m) is U' C⁻¹ r and ``inner`` (..., n_columns, n_columns) U' C⁻¹ U.
    """
    factor = np.asarray(np.linalg.cholesky(inner + np.eye(inner.shape[-1])), dtype=float)
    whitened = np.array(across.swapaxes(-2, -1), order="C")
    shape = whitened.shape[-2:]
    _whiten(factor.reshape(-1, *factor.shape[-2:]), whitened.reshape(-1, *shape))
    more = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)[..., np.newaxis]
    return square - np.einsum("...mr,...mr->...m", whitened, whitened), half + more


def _whiten(factors: Array, rows: Array) -> None:
    """Replace rows x (n, d, m) by L⁻¹ x, of lower factors L (n, m, m)."""
    # LAPACK sees the transpose of a matrix in C order, so its upper factor is the lower one.
    for factor, each in zip(factors, rows, strict=True):
        dtrtrs(factor.T, each.T, lower=0, trans=1, overwrite_b=1)


DEGREES = 5.0
"""Degrees of freedom of the densities: Student's t of covariance C; infinite is the normal density. C
is estimated from few reference rooms, and other rooms differ from them, so its scale is uncertain.
Chosen on development rooms of both worlds."""
COARSENING = 50.0
"""Number of features at which the log likelihood counts half: its power is 50 / (50 + n).

No model is exact, and the covariance of its errors is estimated from few reference rooms, so n features
say less than n independent ones would. A density of the data being near the model's, instead of equal
to them, has this power (Miller & Dunson 2019, the coarsened posterior). Chosen on
development rooms of both worlds."""


def student(square: Array, half: Array | float, n: int, *, coarsened: bool = True) -> Array:
    """Return the log density of ``n`` values by Student's t, from r' C⁻¹ r and ln sqrt|C|.

    If ``coarsened``, it has the power `COARSENING` / (`COARSENING` + n), because no model is exact.
    """
    power = COARSENING / (COARSENING + n) if coarsened and np.isfinite(COARSENING) else 1.0
    if np.isinf(DEGREES):
        return np.asarray(power * (-0.5 * square - half - 0.5 * n * np.log(2 * np.pi)))
    degrees, scale = DEGREES, DEGREES - 2
    constant = gammaln((degrees + n) / 2) - gammaln(degrees / 2) - 0.5 * n * np.log(scale * np.pi)
    log = constant - half - 0.5 * (degrees + n) * np.log(1 + square / scale)
    return np.asarray(power * log)


def bounded(square: Array, half: Array | float, n: int) -> Array:
    """Return a log density of ``n`` values from r' C⁻¹ r and ln sqrt|C|, up to a constant.

    It is normal if ``square`` is at most n. Above n, C is scaled by ``square`` / n, because few
    reference simulations do not determine well how large the errors are.
    """
    beyond = n / 2 * (1 + np.log(np.maximum(square / n, 1.0)))
    return np.asarray(-np.where(square <= n, square / 2, beyond) - half)


def log_mixture(one: Array, other: Array, share: float) -> Array:
    """Return the log density of a mixture: (1 - share) times one density plus share times the other."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.logaddexp(np.log1p(-share) + one, np.log(share) + other))


def leading_products(
    covariance: Array, rows: Array, first: int, ends: Sequence[int]
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield ln sqrt|C| and products x C⁻¹ y' of rows, for the leading parts of n matrices C.

    Of ``covariance`` (n, m, m) and ``rows`` (n, d, m), both overwritten, and of leading sizes
    ``ends``: each of the ``first`` rows with itself, (n, first); the others with these; the others
    with one another. Raises LinAlgError if a matrix is not positive definite.
    """
    # LAPACK sees the transpose of a matrix in C order, so its upper factor is the lower one.
    for i, matrix in enumerate(covariance):
        _, info = dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError(f"covariance {i} is not positive definite")
    halves = np.cumsum(np.log(np.diagonal(covariance, axis1=1, axis2=2)), axis=1)
    whitened, begin = np.ascontiguousarray(rows), 0
    if whitened.size:
        _whiten(covariance, whitened)
    square, across, inner = np.zeros(()), np.zeros(()), np.zeros(())
    for end in ends:
        z, w = whitened[:, :first, begin:end], whitened[:, first:, begin:end]
        square = square + np.einsum("ndm,ndm->nd", z, z)
        across, inner = across + w @ z.swapaxes(1, 2), inner + w @ w.swapaxes(1, 2)
        yield halves[:, end - 1, np.newaxis], square, across, inner
        begin = end


NONE, COEFFICIENTS, UNKNOWN = "none", "coefficients", "unknown"
NO_EFFECT = 1 / 3
"""Probability before the measurement that no effect is missing from the model. In the development rooms
of the two test worlds nothing is missing in 0.38 and 0.26."""
UNKNOWN_ODDS = 1.0
"""Odds before the measurement of an effect that no library has, relative to a listed effect of odds
1."""
OFF_TOGETHER = 0.2
"""Prior probability that coefficients of handbook uncertainty are off together. Catalogues agree to
some 30 % for a material, and a room's absorption area after them is off by 23 to 34 % in three
measured rooms (benchmarks/studies/means): more than independent errors of so many materials."""
EXPECTED = 0.7
"""Expected number of effects that are missing, if several are tried together."""
SHARPER = 0.4
"""How much the power of the probabilities grows towards a sigma of 0: it is 1 at a handbook's sigma,
and 1.4 at 0. Where coefficients were measured, the most probable answer is right more often than
evidence times prior says: rooms err less than the evidence assumes, and the library has effects
that they do not have. Chosen on development rooms, as the temperature of a
classifier is (Guo, Pleiss, Sun & Weinberger 2017)."""


@dataclass(frozen=True)
class Prior:
    """Hold the log probabilities of all explanations before the measurement.

    ``off`` is the probability that all coefficients have an error in common, and ``sharpness`` the
    power to which probabilities after the measurement are raised.
    """

    log_probability: Mapping[str, float]
    off: float
    sharpness: float = 1.0


def relative_sigma(room: Room) -> float:
    """Return a room's relative sigma, weighted by area, over that of a handbook, at most 1."""
    stated = float((room.areas @ room.sigma).sum() / max((room.areas @ room.alpha).sum(), 1e-12))
    return min(1.0, stated / HANDBOOK_SIGMA)


def probability_off(room: Room) -> float:
    """Return the prior probability of an error that all input coefficients of a room have in common.

    It falls with the square of `relative_sigma`: measured coefficients have hardly any such error.
    """
    return OFF_TOGETHER * relative_sigma(room) ** 2


def log_priors(odds: ArrayLike, off: float, no_effect: float = NO_EFFECT) -> Array:
    """Return log priors (2 + n,) of nothing, of an error in common, and of n effects by odds."""
    of_effects = (1 - no_effect) * np.asarray(odds) / np.sum(odds)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log([no_effect * (1 - off), no_effect * off, *of_effects]))


def prior_of(
    room: Room, effects: Sequence[Effect], stated: Mapping[str, float], without: Sequence[str] = ()
) -> Prior:
    """Return the prior, with each effect's own odds or those of the same name in ``stated``."""
    off = probability_off(room)
    if COEFFICIENTS in stated:
        off = stated[COEFFICIENTS] / (1 + stated[COEFFICIENTS])
    if COEFFICIENTS in without:
        off = 0.0
    no_effect = NO_EFFECT
    if NONE in stated:
        no_effect = stated[NONE] / (1 + stated[NONE])
    odds = {e.name: stated.get(e.name, e.prior_odds(room)) for e in effects}
    odds[UNKNOWN] = 0.0 if UNKNOWN in without else stated.get(UNKNOWN, UNKNOWN_ODDS)
    log = log_priors([*odds.values()], off, no_effect).tolist()
    probabilities = dict(zip((NONE, COEFFICIENTS, *odds), log, strict=True))
    return Prior(probabilities, off, sharpness=1.0 + SHARPER * (1.0 - relative_sigma(room)))


def left_out_of(
    only: Sequence[str],
    without: Sequence[str],
    possible: Sequence[str],
    in_any_case: Sequence[str] = (),
) -> tuple[str, ...]:
    """Return the names that are not tried, sorted, by the options ``only`` and ``without``.

    ``only`` keeps those ``in_any_case``. Raises DataError for an unknown name, and if no name is
    left.
    """
    named = {"only": checks.listed("only", only), "without": checks.listed("without", without)}
    for place, names in named.items():
        if unlisted := [n for n in names if n not in possible]:
            raise DataError(
                f'{place} has "{unlisted[0]}", which is not an effect of this search. '
                f"Possible: {', '.join(possible)}"
            )
    left = set(named["without"])
    if named["only"]:
        left |= {*possible} - {*named["only"], *in_any_case}
    if left >= {*possible}:
        raise DataError(NONE_LEFT)
    return tuple(sorted(left))


NONE_LEFT = "no effect is left to search for; name other effects in only, or fewer in without"


def grid_weights(effect: Effect, grid: Sequence[Parameters], state: RoomState) -> Array:
    """Return prior probabilities of n parameter sets, (n,): the density times the width of the cell.

    A cell reaches half of the way to its neighbours, on a log scale for values above 0, so that a
    finer grid gives the effect the same probability.
    """
    values = columns(grid)
    weights = np.ones(len(grid)) * effect.density(values, state)
    for name, of_parameter in values.items():
        if name not in effect.discrete:
            weights *= _cells(of_parameter)
    if not (np.isfinite(weights).all() and weights.min() >= 0 and weights.sum() > 0):
        raise DataError(f'effect "{effect.name}": density must be finite and 0 or more')
    return np.asarray(weights / weights.sum())


def _cells(values: Array) -> Array:
    """Return the width of each value's cell, (n,); 1 where all values are equal."""
    unique, place = np.unique(values, return_inverse=True)
    if len(unique) == 1:
        return np.ones(len(values))
    scaled = np.log(unique) if unique[0] > 0 else unique
    edges = np.concatenate([scaled[:1], 0.5 * (scaled[1:] + scaled[:-1]), scaled[-1:]])
    return np.asarray(np.diff(edges)[place])


NULL_POWER = 4.0
"""The power with which errors in common fall in the rooms that set the threshold; in the evidence it is
`room_errors.POWER`. The evidence allows for more than is likely, so that a common error is not taken
for an effect. The threshold is right only if its rooms err as real ones do.
Chosen on development rooms of both worlds."""
SCALES = ((2.0, 0.6), (4.0, 0.4))
"""Where coefficients are off together: factors on these standard deviations, with probabilities."""


@lru_cache(maxsize=4)
def directions(case: Case, power: float = POWER) -> Array:
    """Return changes of alpha by errors that coefficients have in common, one standard deviation each.

    (n_configurations, n_directions, n_materials, n_bands): a factor and a tilt over frequency of
    all materials, then each material's own factor and tilt, 0 in a configuration that changed it.
    Below a handbook's sigma they fall with the ``power`` of the ratio.
    """
    return read_only_view(np.array([_directions(case.room, c, power) for c in case.configurations]))


def _directions(room: Room, c: Configuration | None = None, power: float = POWER) -> Array:
    """Return the changes in one configuration, or in the room as stated."""
    alpha, sigma = (room.alpha, room.sigma) if c is None else c.coefficients(room)
    both, each = common_error_columns(alpha, sigma, room.centre_frequencies, power)
    if c is not None:
        each[:, [room.material_index(material) for material in c.changes]] = 0.0
    # A factor of all coefficients, or of a material's: so errors of volume and areas act, too.
    stated = (room.volume_sigma, room.common_area_sigma, room.common_alpha_sigma)
    both[0] = np.hypot(both[0], float(np.linalg.norm(stated)) * alpha)
    each[0] = np.hypot(each[0], room.area_sigma[:, np.newaxis] * alpha)
    own = each[:, :, np.newaxis] * np.eye(room.n_materials)[:, :, np.newaxis]
    return np.concatenate([both, own.reshape(-1, *alpha.shape)])


def by_direction(changes: Array, slopes: Array) -> Array:
    """Return the decrease of ln T20 by each common error of `directions`, (n, n_values, n_directions).

    ``slopes`` (n, n_configurations, n_materials, n_bands) are -d ln T20 / d alpha in n states.
    """
    n, count, materials, n_bands = slopes.shape
    of_own = changes[:, 2:].reshape(count, 2, materials, materials, n_bands)
    common = np.einsum("ncmb,ctmb->ncbt", slopes, changes[:, :2]).reshape(n, count * n_bands, -1)
    # Each material's own directions move no other.
    own = np.einsum("ncmb,ctmmb->ncbtm", slopes, of_own).reshape(n, count * n_bands, -1)
    return np.concatenate([common, own], axis=-1)


def factors(changes: Array, slopes: Array) -> Array:
    """Return the errors of `by_direction`, in at most as many combinations as there are values."""
    full = by_direction(changes, slopes)
    if full.shape[2] <= full.shape[1]:
        return full
    values, vectors = np.linalg.eigh(full @ full.swapaxes(1, 2))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def drawn(changes: Array, materials: Sequence[str], rng: np.random.Generator, n: int) -> Array:
    """Draw n common errors of alpha, (n, n_configurations, n_materials, n_bands), from `directions`."""
    together = rng.standard_normal((n, 2))
    own = [of_name.standard_normal((n, 2)) for of_name in by_name(rng, materials)]
    z = np.concatenate([together, np.stack(own, axis=-1).reshape(n, -1)], axis=1)
    return np.asarray(np.einsum("nd,cdmb->ncmb", z, changes))


def by_name(rng: np.random.Generator, names: Sequence[str]) -> list[np.random.Generator]:
    """Return a random generator for each name, which does not depend on other names or their order."""
    of_all = int(rng.integers(2**63))
    digests = [hashlib.sha256(name.encode()).digest()[:8] for name in names]
    return [np.random.default_rng([of_all, int.from_bytes(digest)]) for digest in digests]


@dataclass(frozen=True, eq=False)
class OffTogether:
    """Hold the error that all input coefficients have in common, as estimated from the measurement.

    ``probability`` is that of such an error, given the identified effects. ``factor`` (n_materials,
    n_bands) is the mean ratio of true to input coefficients, and ``spread`` the standard deviation of
    the ratio's logarithm. ``ratio`` (n_bands,) is the room's true over input absorption area.
    """

    probability: float
    factor: Array
    spread: Array
    ratio: Array

    def apply(self, case: Case) -> Case:
        """Return the case with alpha multiplied by the factor, and sigma widened by its spread."""
        room = case.room
        alpha, sigma = self._moved(room, np.array(room.alpha), np.array(room.sigma), slice(None))
        configurations = []
        for c in case.configurations:
            changes = {
                m: ChangedMaterial(*self._moved(room, v.alpha, v.sigma, room.material_index(m)))
                for m, v in c.changes.items()
            }
            configurations.append(replace(c, changes=changes))
        return replace(
            case, room=room.replace(alpha=alpha, sigma=sigma), configurations=configurations
        )

    def _moved(self, room: Room, alpha: Array, sigma: Array, rows: Any) -> tuple[Array, Array]:
        most = room.most_alpha
        moved = np.clip(alpha * self.factor[rows], 0.0, most[rows])
        wide = np.hypot(sigma * self.factor[rows], moved * self.spread[rows])
        return moved, np.minimum(wide, most[rows])


def off_together(
    case: Case, changes: Array, residual: Array, covariance: Array, probability: float
) -> OffTogether:
    """Return the error that all coefficients of a case have in common, estimated from the measurement.

    ``changes`` (n_used, n_directions) are those of the compared values by each common error, and
    ``residual`` (n_used,) is measured minus predicted, with its ``covariance``.
    """
    f = changes
    weights, means, variances = [], [], []
    for scale, share in SCALES:
        whole = covariance + (scale**2 - 1) * f @ f.T
        gain = np.linalg.solve(whole, f).T * scale**2
        means.append(gain @ residual)
        variances.append(scale**2 * np.eye(f.shape[1]) - gain @ f * scale**2)
        square = residual @ np.linalg.solve(whole, residual)
        weights.append(np.log(share) - 0.5 * square - 0.5 * np.linalg.slogdet(whole)[1])
    w = np.exp(np.array(weights) - np.max(weights))
    w = w / w.sum()
    mean = np.einsum("s,sr->r", w, means)
    apart = np.array(means) - mean
    variance = np.einsum("s,srq->rq", w, variances) + np.einsum("s,sr,sq->rq", w, apart, apart)
    room = case.room
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(_directions(room) / room.alpha)
    shift = np.einsum("r,rmb->mb", mean, relative)
    spread = np.sqrt(np.maximum(np.einsum("rmb,rq,qmb->mb", relative, variance, relative), 0.0))
    factor = np.exp(shift)
    ratio = (room.areas @ (room.alpha * factor)) / (room.areas @ room.alpha)
    return OffTogether(probability, factor, spread, ratio)
