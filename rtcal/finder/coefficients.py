"""Coefficients that are off together: by a factor and a tilt over frequency, for all and per material.

The usual amount of such errors (`rtcal.acoustics.room_errors`) belongs to every hypothesis.
Coefficients that are *off together* err by several times as much (`SCALES`): heavy tails.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rtcal.acoustics.bands import is_middle
from rtcal.acoustics.room_errors import POWER, common_error_columns
from rtcal.finder.case import Case
from rtcal.finder.configuration import Change
from rtcal.support.types import Array

NULL_POWER = 4.0
"""The power with which errors in common fall in the rooms that set the threshold; in the evidence it is
`common_errors.POWER`. The evidence allows for more than is likely, so that a common error is not taken
for an effect. The threshold is right only if its rooms err as real ones do.
`python -m benchmarks.second_world null` shows it on development rooms of both worlds
(docs/discrepancy_study.md)."""
SCALES = ((2.0, 0.6), (4.0, 0.4))
"""Where coefficients are off together: factors on these standard deviations, with probabilities."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Changes of alpha by one standard deviation.

    ``common`` (n_configurations, 2, n_materials, n_bands): factor and tilt of all materials. ``own``,
    same shape: those of each material; 0 where a configuration changed it.
    """

    common: Array
    own: Array


def directions(case: Case, power: float = POWER) -> Directions:
    """Return the changes of alpha in which the coefficients of a case may be off together.

    They fall with the ``power`` of the stated relative sigma, below a handbook's. What the room states
    of its volume, its areas and its tables comes on top.
    """
    room = case.room
    stated = (room.volume_sigma, room.common_area_sigma, room.common_alpha_sigma)
    together = float(np.linalg.norm(stated))
    common, own = [], []
    for c in case.configurations:
        alpha, sigma = c.coefficients(room)
        changed = np.array([[material in c.changes] for material in room.materials])
        both, each = common_error_columns(alpha, sigma, room.centre_frequencies, power)
        each = np.where(changed, 0.0, each)
        # A factor of all coefficients, or of a material's: so errors of volume and areas act, too.
        both[0] = np.hypot(both[0], together * alpha)
        each[0] = np.hypot(each[0], room.area_sigma[:, np.newaxis] * alpha)
        common.append(both)
        own.append(each)
    return Directions(np.array(common), np.array(own))


def factors(d: Directions, slopes: Array) -> Array:
    """Return changes of ln T20 by one standard deviation each, (n, n_values, n_directions).

    ``slopes`` (n, n_configurations, n_materials, n_bands) are -d ln T20 / d alpha. The values are
    configurations and bands, raveled. Of more directions than values as many combinations are left.
    """
    full = _by_direction(d, slopes)
    return full if full.shape[2] <= full.shape[1] else _root(full @ full.swapaxes(1, 2))


def _by_direction(d: Directions, slopes: Array) -> Array:
    """Return the change of ln T20 by each direction: the two common ones, factors, then tilts."""
    n, count, _, bands = slopes.shape
    common = np.einsum("ncmb,ctmb->ncbt", slopes, d.common).reshape(n, count * bands, -1)
    own = np.einsum("ncmb,ctmb->ncbtm", slopes, d.own).reshape(n, count * bands, -1)
    return np.concatenate([common, own], axis=-1)


def _root(covariance: Array) -> Array:
    """Return F with F F' = covariance, (..., n, n)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def drawn(d: Directions, rng: np.random.Generator, n: int) -> Array:
    """Draw usual changes of alpha in common, (n, n_configurations, n_materials, n_bands)."""
    together = np.einsum("nt,ctmb->ncmb", rng.standard_normal((n, 2)), d.common)
    z = rng.standard_normal((n, 2, d.own.shape[2]))
    return np.asarray(together + np.einsum("ntm,ctmb->ncmb", z, d.own))


@dataclass(frozen=True, eq=False)
class OffTogether:
    """The posterior of coefficients that are off together.

    Attributes
    ----------
    probability : float
        Of that, given the effect that is claimed beside it.
    factor : array (n_materials, n_bands)
        Coefficient over what is stated: posterior mean.
    spread : array, same shape
        Standard deviation of ln ``factor``.
    ratio : array (n_bands,)
        The room's absorption area over what is stated.
    """

    probability: float
    factor: Array
    spread: Array
    ratio: Array

    def words(self, frequencies: Array) -> str:
        """Return the ratio in words: ``about 0.82 of what is stated below 500 Hz, ...``."""
        middle = is_middle(frequencies)
        ranges = (
            ("below 500 Hz", ~middle & (frequencies < 1000)),
            ("from 500 Hz to 2 kHz", middle),
            ("above 2 kHz", ~middle & (frequencies > 1000)),
        )
        parts = [(place, float(self.ratio[here].mean())) for place, here in ranges if here.any()]
        values = [value for _, value in parts]
        if max(values) - min(values) < _ALIKE:
            return f"about {np.mean(values):.2f} of what is stated"
        (first, value), *others = parts
        said = [
            f"about {value:.2f} of what is stated {first}",
            *(f"{v:.2f} {p}" for p, v in others),
        ]
        return ", ".join(said)

    def apply(self, case: Case) -> Case:
        """Return the case with alpha moved by the factor, and sigma widened by its spread."""
        room = case.room
        alpha, sigma = self._moved(np.array(room.alpha), np.array(room.sigma), slice(None))
        configurations = []
        for c in case.configurations:
            changes = {
                m: Change(*self._moved(v.alpha, v.sigma, room.material_index(m)))
                for m, v in c.changes.items()
            }
            configurations.append(replace(c, changes=changes))
        return replace(
            case, room=room.replace(alpha=alpha, sigma=sigma), configurations=configurations
        )

    def _moved(self, alpha: Array, sigma: Array, rows: Any) -> tuple[Array, Array]:
        moved = np.clip(alpha * self.factor[rows], 0.0, 1.0)
        wide = np.hypot(sigma * self.factor[rows], moved * self.spread[rows])
        return moved, np.minimum(wide, 1.0)


_ALIKE = 0.06
"""Ratios that differ by less over frequency are said as one."""


def off_together(
    case: Case,
    slopes: Array,
    spreading: Array,
    residual: Array,
    covariance: Array,
    probability: float,
) -> OffTogether:
    """Return the posterior of a common error of the coefficients.

    Parameters
    ----------
    case : Case
    slopes : array (n_configurations, n_materials, n_bands)
        -d ln T20 / d alpha.
    spreading : array (n_used, n_values)
        d feature / d ln T20, the values being configurations and bands, raveled.
    residual : array (n_used,)
        Measured less predicted with the coefficients as stated.
    covariance : array (n_used, n_used)
        Of the residual, the usual common error in it.
    probability : float
        That the coefficients are off together.
    """
    d = directions(case)
    f = -spreading @ _by_direction(d, slopes[None])[0]  # more absorption, shorter T
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
    base = directions(
        replace(case, configurations=[replace(c, changes={}) for c in case.configurations])
    )
    by_alpha = _changes(base)[0]  # (n_directions, n_materials, n_bands)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(by_alpha / room.alpha)
    shift = np.einsum("r,rmb->mb", mean, relative)
    spread = np.sqrt(np.maximum(np.einsum("rmb,rq,qmb->mb", relative, variance, relative), 0.0))
    factor = np.exp(shift)
    ratio = (room.areas @ (room.alpha * factor)) / (room.areas @ room.alpha)
    return OffTogether(probability, factor, spread, ratio)


def _changes(d: Directions) -> Array:
    """Return the change of alpha by each direction.

    (n_configurations, n_directions, n_materials, n_bands).
    """
    count, two, materials, bands = d.own.shape
    own = np.zeros((count, two, materials, materials, bands))
    rows = np.arange(materials)
    own[:, :, rows, rows] = d.own
    return np.concatenate([d.common, own.reshape(count, two * materials, materials, bands)], axis=1)
