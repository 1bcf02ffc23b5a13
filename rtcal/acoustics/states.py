"""States of one room: what they have in common, T with the areas that each had, their joint estimate.

Per band, the unknowns of joint states are alpha of every material of any state, ln V, ln S_i, the
air's attenuation ln m and g, the error of ln T that the equation makes in all states alike. Each
measured state gives

    ln T = ln T(alpha, V, S, m) + g + e,  var e = u_T² / T² + own².

The estimate is the posterior's mode within 0 <= alpha <= 1, by Gauss-Newton steps; its covariance is
that of the linear estimate there, without the bounds.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics import bands, repeats
from rtcal.acoustics.equations import LinearEquation
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_errors import Assumptions, alpha_covariance, between_materials, of_climate
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError, ModelError, SolverError
from rtcal.support.sampler import samples_of_normal
from rtcal.support.types import Array


@checked
@dataclass(frozen=True, eq=False)
class State:
    """A state of a room in which T was measured.

    Parameters
    ----------
    room : Room
        With the prior's alpha and sigma, not calibrated ones.
    reverberation_time : array (n_bands,)
        Measured T in s, NaN where missing.
    uncertainty : array (n_bands,)
        Standard uncertainty of T in s, NaN where unknown.

    Raises
    ------
    DataError
        For another shape, a T that is not above 0, or an uncertainty below 0.

    Examples
    --------
    >>> room = Room(name="box", volume=60, materials=["all"], areas=[94], alpha=[[0.1]],
    ...             sigma=[[0.02]], centre_frequencies=[1000])
    >>> State(room, [1.02]).uncertainty
    array([nan])
    """

    room: Room
    reverberation_time: Array
    uncertainty: Array = field(default_factory=lambda: np.array(np.nan))

    def __post_init__(self) -> None:
        checks.instance("room", self.room, Room)
        shape = (self.room.n_bands,)
        t = checks.array("reverberation_time", self.reverberation_time)
        u = checks.array("uncertainty", self.uncertainty)
        u = np.full(shape, np.nan) if np.isnan(u).all() and u.ndim == 0 else u
        for name, values in (("reverberation_time", t), ("uncertainty", u)):
            if values.shape != shape:
                raise DataError(f"{name} has shape {values.shape}; the room asks for {shape}")
            bad = np.isinf(values) | (values < 0)
            if values is t:
                bad |= values == 0
            if bad.any():
                k = int(np.argmax(bad))
                band = bands.label(self.room.centre_frequencies[k])
                raise DataError(f"{name}[{band}] = {values[k]:g} s is not finite and above 0")
            object.__setattr__(self, name, values)

    def log_uncertainty(self, unstated: float) -> Array:
        """Return the standard uncertainty of ln T, (n_bands,); ``unstated`` where u is unknown."""
        u = self.uncertainty / self.reverberation_time
        return np.asarray(np.where(np.isnan(u), unstated, u))


def refuse_counted_twice(rooms: Sequence[Room], states: Sequence[State]) -> None:
    """Raise DataError if a room was calibrated on a state's T, or two states are one."""
    known = [s for s in states if np.isfinite(s.reverberation_time).any()]
    names = [repeats.of_times(s.room, s.reverberation_time) for s in known]
    for room in rooms:
        repeats.refuse_repeated_data(room, *names)
    for i, j in itertools.combinations(range(len(known)), 2):
        one, other = known[i].room, known[j].room
        same_room = one.volume == other.volume and (
            dict(zip(one.materials, one.areas.tolist(), strict=True))
            == dict(zip(other.materials, other.areas.tolist(), strict=True))
        )
        if same_room and repeats.same_data(names[i], names[j]):
            raise DataError(
                f'room "{one.name}": two states have the same areas and the same measured T, which '
                "would count twice; leave one out"
            )


def refuse_other_priors(rooms: Sequence[Room], places: Sequence[str]) -> None:
    """Raise DataError if states of one room differ in bands, or in a material's alpha or sigma.

    ``places`` name the rooms in messages: ``room "box"``.
    """
    for place, room in list(zip(places, rooms, strict=True))[1:]:  # the first is that compared with
        if not np.array_equal(room.centre_frequencies, rooms[0].centre_frequencies):
            raise DataError(f"{place} has other bands than {places[0]}")
        for i, material in enumerate(room.materials):
            owner = next(n for n, r in enumerate(rooms) if material in r.materials)
            j = rooms[owner].materials.index(material)
            for name in ("alpha", "sigma"):
                values, first = getattr(room, name)[i], getattr(rooms[owner], name)[j]
                if not np.array_equal(values, first):
                    k = int(np.flatnonzero(values != first)[0])
                    raise DataError(
                        f"{place}: {room.place(name, i, k)} = {values[k]:g}, but {places[owner]} says "
                        f"{first[k]:g}; a shared material has one prior"
                    )


Flags = NDArray[np.bool_]

_LEAST_AREA = 1e-5
"""Least relative error of an area beside one of all areas: the covariance has an inverse."""


@dataclass(frozen=True, eq=False)
class Rooms:
    """States of one room on common unknowns: alpha of every material, ln V, ln S of each, ln m and g.

    Raises DataError if bands differ, or a material's alpha or sigma.
    """

    rooms: Sequence[Room]
    equation: LinearEquation
    assumptions: Assumptions

    def __post_init__(self) -> None:
        refuse_other_priors(self.rooms, [f'room "{room.name}"' for room in self.rooms])

    def _owner(self, material: str) -> Room:
        return next(r for r in self.rooms if material in r.materials)

    @cached_property
    def materials(self) -> tuple[str, ...]:
        """Every material of any state."""
        return tuple(dict.fromkeys(m for room in self.rooms for m in room.materials))

    @cached_property
    def areas(self) -> Array:
        """Areas in m², (n_states, n_materials); 0 where a state lacks a material."""
        out = np.zeros((len(self.rooms), len(self.materials)))
        for row, room in zip(out, self.rooms, strict=True):
            row[[self.materials.index(m) for m in room.materials]] = room.areas
        return out

    @cached_property
    def changing(self) -> Flags:
        """Which materials have another area in some state, (n_materials,) of bool."""
        return np.asarray(np.ptp(self.areas, axis=0) > 0)

    def stacked(self, name: str) -> Array:
        """Return ``alpha`` or another field of all materials, (n_materials, n_bands)."""
        owners = [(self._owner(m), m) for m in self.materials]
        return np.array([getattr(r, name)[r.materials.index(m)] for r, m in owners])

    @cached_property
    def lower(self) -> Array:
        """Lower bounds of alpha, (n_materials, n_bands)."""
        return self._most("alpha_min", np.zeros((len(self.materials), self.rooms[0].n_bands)))

    def _most(self, name: str, least: Array) -> Array:
        """Return the largest that any room states of each material, at least ``least``."""
        for room in self.rooms:
            if (stated := getattr(room, name)) is not None:
                rows = [self.materials.index(m) for m in room.materials]
                least[rows] = np.maximum(least[rows], stated)
        return least

    @cached_property
    def sigma(self) -> Array:
        """Sigma of alpha, (n_materials, n_bands), at least the assumed one where the area changes."""
        stated = self.stacked("sigma")
        raised = self.changing[:, np.newaxis] & (stated > 0)
        return np.where(raised, np.maximum(stated, self.assumptions.changed), stated)

    @property
    def size(self) -> int:
        """Number of unknowns per band."""
        return 2 * len(self.materials) + 3

    @cached_property
    def area_sigma(self) -> Array:
        """Relative error of each material's own area, (n_materials,): as stated, or as assumed."""
        if not any(room.area_sigma.any() or room.common_area_sigma for room in self.rooms):
            return np.full(len(self.materials), self.assumptions.areas)
        return self._most("area_sigma", np.full(len(self.materials), _LEAST_AREA))

    @cached_property
    def air_sigma(self) -> Array:
        """Relative error of the air's attenuation by the stated climate's, (n_bands,)."""
        found = np.zeros(self.rooms[0].n_bands)
        for room in self.rooms:
            of_m = np.linalg.norm(of_climate(room, lambda changed: changed.air_attenuation), axis=0)
            np.maximum(found, of_m / np.where(of_m > 0, room.air_attenuation, 1.0), out=found)
        return found

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Mean (n_bands, size) and covariance (n_bands, size, size) of the unknowns."""
        n, assumed = len(self.materials), self.assumptions
        mean = np.zeros((self.rooms[0].n_bands, self.size))
        mean[:, :n] = self.stacked("alpha").T
        covariance = np.zeros((*mean.shape, self.size))
        common = max(room.common_alpha_sigma for room in self.rooms)
        between = between_materials(self.materials, self.rooms)
        covariance[:, :n, :n] = alpha_covariance(mean[:, :n], self.sigma.T, between, common)
        volume = max(room.volume_sigma for room in self.rooms) or assumed.volume
        covariance[:, n, n] = volume**2
        areas = slice(n + 1, 2 * n + 1)
        covariance[:, areas, areas] = np.diag(self.area_sigma**2)
        covariance[:, areas, areas] += max(room.common_area_sigma for room in self.rooms) ** 2
        covariance[:, -2, -2] = self.air_sigma**2
        covariance[:, -1, -1] = assumed.common**2
        return mean, covariance

    def log_time(self, state: int, unknowns: Array) -> tuple[Array, Array]:
        """Return ln T + g, (..., n_bands), and its gradient, (..., n_bands, size).

        ``unknowns`` is (..., n_bands, size). ModelError where nothing absorbs, or everything.
        """
        room, n = self.rooms[state], len(self.materials)
        alpha, s = unknowns[..., :n], unknowns[..., n + 1 : -2]
        volume = room.volume * np.exp(unknowns[..., n])
        areas = self.areas[state] * np.exp(s)
        total = areas.sum(axis=-1)
        mean = (areas * alpha).sum(axis=-1) / total
        exponent, slope = self.equation.exponent(mean), self.equation.slope(mean)
        air = 4 * room.air_attenuation * np.exp(unknowns[..., -2]) * volume
        whole = total * exponent + air
        if not (np.isfinite(whole) & np.isfinite(slope) & (whole > 0)).all():
            raise ModelError(
                f'room "{room.name}": {self.equation.name}\'s equation gives no T where the mean alpha '
                f"is {np.min(mean):.3g} to {np.max(mean):.3g}"
            )
        gradient = np.empty(unknowns.shape)
        w = whole[..., np.newaxis]
        gradient[..., :n] = -areas * slope[..., np.newaxis] / w
        gradient[..., n] = 1 - air / whole
        per_area = exponent[..., np.newaxis] + slope[..., np.newaxis] * (
            alpha - mean[..., np.newaxis]
        )
        gradient[..., n + 1 : -2] = -areas * per_area / w
        gradient[..., -2] = -air / whole
        gradient[..., -1] = 1.0
        constant = self.equation.room_constant(room)
        return np.log(constant * volume / whole) + unknowns[..., -1], gradient


_STEPS = 60
_SETTLED = 1e-9
"""Largest last step of alpha, ln V, ln S and g."""
_NEAR = 2.0
"""Distance of a coefficient from a bound, in standard deviations, below which the bound counts."""
_MATTERS = 0.1
"""Share of the whole standard deviation from which a coefficient counts."""
_LEAST = 1e-9
"""Least standard deviation of a measured ln T: an exact one would divide by 0."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """The posterior of a room's unknowns, per band.

    Attributes
    ----------
    mode : array (n_bands, size)
        The most probable unknowns within the bounds.
    free : array (n_bands, size)
        The mode without the bounds, of the model that is linear at ``mode``.
    covariance : array (n_bands, size, size)
        Of the linear estimate.
    gain : array (n_bands, size, n_measured)
        d(estimate) / d(ln T measured), 0 where T is missing.
    gradient : array (n_bands, n_measured, size)
        Of the measured states' ln T; 0 where T is missing.
    noise : array (n_bands, n_measured)
        Variance of each measured ln T, without the equation's own error.
    """

    mode: Array
    free: Array
    covariance: Array
    gain: Array
    gradient: Array
    noise: Array


def estimated_change(rooms: Rooms, states: Sequence[State]) -> Estimate:
    """Return the posterior given the measured T of the first rooms, which are the states'.

    Raises
    ------
    DataError
        If a measured T would count twice.
    ModelError
        If the equation gives no T for coefficients on the way.
    SolverError
        If the steps do not settle.
    """
    refuse_counted_twice(rooms.rooms, states)
    mean, covariance = rooms.prior
    n_bands = len(mean)
    measured = np.array([np.log(s.reverberation_time) for s in states]).reshape(-1, n_bands).T
    assumed = rooms.assumptions
    u = [s.log_uncertainty(assumed.time) for s in states]
    known = np.isfinite(measured)
    noise: Array = np.where(known, np.array(u).reshape(-1, n_bands).T ** 2, 0.0)
    # A missing T has gradient 0: its variance does not matter, but must not be 0.
    variance = np.where(known, np.maximum(noise + assumed.own**2, _LEAST**2), 1.0)
    mode = mean
    for _ in range(_STEPS):
        value, gradient = _linearised(rooms, len(states), mode)
        gradient = np.where(known[..., np.newaxis], gradient, 0.0)
        at_prior = value + np.einsum("kcs,ks->kc", gradient, mean - mode)
        residual = np.where(known, measured - at_prior, 0.0)
        across = covariance @ gradient.swapaxes(1, 2)
        spread = gradient @ across + variance[:, np.newaxis] * np.eye(len(states))
        gain = np.linalg.solve(spread, across.swapaxes(1, 2)).swapaxes(1, 2)
        free = mean + np.einsum("ksc,kc->ks", gain, residual)
        after = _within(rooms, free, gradient, residual, variance)
        moved, mode = np.max(np.abs(after - mode)), after
        if moved < _SETTLED:
            break
    else:
        raise SolverError(f"the estimate did not settle: its last step was {moved:.1g}")
    posterior = covariance - gain @ across.swapaxes(1, 2)
    return Estimate(mode, free, posterior, np.asarray(gain), gradient, noise)


def _linearised(rooms: Rooms, n_measured: int, mode: Array) -> tuple[Array, Array]:
    """Return ln T of the measured states, (n_bands, n_measured), and their gradients."""
    values = np.empty((len(mode), n_measured))
    gradients = np.empty((len(mode), n_measured, rooms.size))
    for c in range(n_measured):
        values[:, c], gradients[:, c] = rooms.log_time(c, mode)
    return values, gradients


def _within(rooms: Rooms, free: Array, gradient: Array, residual: Array, variance: Array) -> Array:
    """Return the linear model's mode within the bounds of alpha: ``free`` where that keeps them.

    ``residual`` is the measured ln T less that of the prior's mean, 0 where missing.
    """
    from scipy.optimize import lsq_linear

    n = len(rooms.materials)
    beyond = ((free[:, :n] < rooms.lower.T) | (free[:, :n] > 1)).any(axis=1)
    mean, covariance = rooms.prior
    out = free.copy()
    for k in np.flatnonzero(beyond).tolist():
        moving = np.flatnonzero(np.diagonal(covariance[k]) > 0)
        of_prior = np.linalg.inv(np.linalg.cholesky(covariance[k][np.ix_(moving, moving)]))
        weight = 1 / np.sqrt(variance[k])
        low, high = np.full(rooms.size, -np.inf), np.full(rooms.size, np.inf)
        low[:n], high[:n] = rooms.lower[:, k], 1.0
        fitted = lsq_linear(
            np.vstack([of_prior, weight[:, np.newaxis] * gradient[k][:, moving]]),
            np.concatenate([np.zeros(len(moving)), weight * residual[k]]),
            ((low - mean[k])[moving], (high - mean[k])[moving]),
            method="bvls",
        )
        out[k, moving] = mean[k, moving] + fitted.x
    return out


def near_bounds(rooms: Rooms, found: Estimate, weights: Array, whole: Array) -> Flags:
    """Return in which bands the bounds change the distribution of a weighted sum, (n_bands,) of bool.

    Parameters
    ----------
    rooms : Rooms
    found : Estimate
    weights : array (n_bands, n_materials)
        d(sum) / d alpha.
    whole : array (n_bands,)
        The sum's standard deviation.
    """
    n = len(rooms.materials)
    sigma = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2)[:, :n], 0))
    alpha = found.free[:, :n]
    near = np.minimum(alpha - rooms.lower.T, 1 - alpha) < _NEAR * sigma
    matters = np.abs(weights) * sigma > _MATTERS * whole[:, np.newaxis]
    return np.asarray((near & matters & (sigma > 0)).any(axis=1))


def samples(rooms: Rooms, found: Estimate, band: int, number: int) -> Array:
    """Return samples of a band's unknowns within the bounds of alpha, (number, size)."""
    n = len(rooms.materials)
    lower, upper = np.full(rooms.size, -np.inf), np.full(rooms.size, np.inf)
    lower[:n], upper[:n] = rooms.lower[:, band], 1.0
    return samples_of_normal(
        found.free[band], found.covariance[band], (lower, upper), found.mode[band], number, band
    )
