"""Predictions of T20, EDT, T30, C80 and G for a room in one acoustic state.

A `RoomState` holds all data of the prediction. An effect returns a changed state: with more absorption,
another volume or equation, background noise, or another ``shape`` of the decay, such as that of a
non-diffuse field (`DirectionalDecay`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from rtcal.acoustics.equations import MeanEquation, mean_equation
from rtcal.acoustics.room import Room
from rtcal.support.types import Array, read_only_view

FEATURES = ("t20", "edt", "t30", "c80", "g")
"""Names of the parameters that means over positions are compared by, and of the features: ln T20 (s),
ln EDT/T20, ln T30/T20, and C80 and G in dB."""
TIMES, LEVELS = FEATURES[:3], FEATURES[3:]
"""Decay times, whose uncertainty is relative, and levels, whose uncertainty is in dB."""
_LN6 = 6 * np.log(10)
_STEPS = 12
_FROM_ENDS = 1e-6
"""Distance of the mean over the walls from 0 (absolute) and the equation's largest mean (relative)."""
_ARRAYS = ("areas", "alpha", "facing", "air", "frequencies", "covering", "objects", "walls")
"""The arrays of a state."""
STEEPEST = 0.98
"""Largest coefficient at which a derivative is computed; above it, ln T is far from linear in alpha."""


@dataclass(frozen=True)
class Decay:
    """Hold the energy density after a pulse: the sum of ``weights`` (1/m³) exp(-``rates`` (1/s) t).

    Both are (n_bands, n_terms), or (n, n_bands, n_terms) for n rooms.
    """

    weights: Array
    rates: Array


VOLUME_OF_MESH, VOLUME_TYPED = 0.05, 0.1
"""Relative standard deviation of a volume without uncertainty: of a mesh, and of a number. A volume is
taken from drawings, and its error is that of what they leave out."""


def volume_sigma_of(room: Room) -> float:
    """Return the relative standard deviation of a room's volume, by default by its origin."""
    if room.volume_sigma > 0:
        return room.volume_sigma
    return VOLUME_TYPED if room.scene.mesh is None else VOLUME_OF_MESH


@dataclass(frozen=True, eq=False)
class RoomState:
    """Hold the acoustic data of a room, from which the finder predicts T20, C80 and G.

    An effect of your own returns a changed state (`Effect.change`).

    Attributes
    ----------
    volume : float
        Volume in m³; ``volume_sigma`` is its relative standard deviation (`volume_sigma_of`).
    areas, alpha, facing : arrays
        Area of each material in m², (n_materials,); its coefficients, (n_materials, n_bands); and the
        shares of its area whose normal is along x, y and z, (n_materials, 3).
    air : array (n_bands,)
        Attenuation of the energy by air in 1/m.
    frequencies : array (n_bands,)
        Centre frequencies in Hz.
    speed_of_sound : float
        Speed of sound in m/s.
    equation : str
        Name of the reverberation equation, such as "eyring".
    covering : array (n_bands,)
        Contribution of added panels and openings, in m², to the equation's sum of S_i h(alpha_i) over
        the materials, where h(alpha) = alpha for Sabine's and Eyring's equations
        (`rtcal.acoustics.equations.MeanEquation`).
    objects : array (n_bands,)
        Absorption area of free-standing objects in m².
    floor_db : float, optional
        Noise level in dB relative to the start of the decay; None without noise. ``record`` is the
        length of the response in reverberation times.
    direct_db : float
        Level of the direct sound in dB relative to that of an omnidirectional source.
    walls : array (n_materials,) of bool, or True
        Whether each material is a surface. Others are pieces such as persons, whose number is their
        area and whose m² per piece are their alpha. True means that all are surfaces.
    shape : optional
        Object that returns the `Decay` of the state, such as a `CoupledDecay`; None means a single
        exponential decay.
    """

    volume: float
    areas: Array
    alpha: Array
    facing: Array
    air: Array
    frequencies: Array
    speed_of_sound: float
    equation: str = "eyring"
    covering: Array | float = 0.0
    objects: Array | float = 0.0
    shape: Any = None
    floor_db: float | None = None
    record: float = 2.0
    direct_db: float = 0.0
    volume_sigma: float = 0.1
    walls: Any = True

    def locked(self) -> RoomState:
        """Return the state with read-only arrays, so that an effect of your own cannot change them."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        views: dict[str, Any] = {
            name: read_only_view(values)
            for name, values in arrays.items()
            if isinstance(values, np.ndarray) and values.flags.writeable
        }
        return replace(self, **views) if views else self

    @classmethod
    def of_room(cls, room: Room, facing: Array, equation: str = "eyring") -> RoomState:
        """Return the state of a room with its input values.

        ``facing`` (n_materials, 3) are the shares of each material's area along x, y and z, as in
        `Case`; unknown shares (NaN) count as 1/3. ``equation`` is the name of the reverberation
        equation.
        """
        return cls(
            volume=room.volume,
            areas=room.areas,
            alpha=np.array(room.alpha),
            facing=read_only_view(np.where(np.isfinite(facing), facing, 1 / 3)),
            air=room.air_attenuation,
            frequencies=room.centre_frequencies,
            speed_of_sound=room.speed_of_sound,
            equation=equation,
            volume_sigma=volume_sigma_of(room),
            walls=room.is_surface if room.pieces else True,
        )

    @property
    def total_area(self) -> float:
        """Area of all surfaces S in m²."""
        return float(self.areas.sum(where=self.walls))

    @property
    def directions_known(self) -> bool:
        """Whether it is known in which direction any material faces; else all shares are 1/3."""
        return not np.allclose(self.facing, 1 / 3)

    @property
    def surface_absorption(self) -> Array:
        """Absorption area of the surfaces by the equation in m², (n_bands,)."""
        return np.asarray(surface_absorption([self])[0])

    @property
    def rate(self) -> Array:
        """Decay rate k of the energy in 1/s, (n_bands,), from which T = 6 ln 10 / k.

        k = c (S a + 4 m V + A) / 4 V, where a is the absorption exponent of the equation (Eyring: -ln(1
        - mean alpha)), m the attenuation of the air, and A the absorption area of free-standing
        objects.
        """
        return np.asarray(rates([self])[0])

    @cached_property
    def wall(self) -> Array:
        """Mean alpha of the materials; cached, since every grid point covers part of one state."""
        return np.asarray(np.where(self.walls, self.areas, 0.0) @ self.alpha / self.total_area)

    def covered(self, area: float, spectrum: Array) -> RoomState:
        """Return the state with an area of wall in m² replaced by a cover of alpha (n_bands,)."""
        return covered([self], np.array([area]), np.asarray(spectrum)[np.newaxis])[0]

    def with_objects(self, absorption_area: Array) -> RoomState:
        """Return the state with further free-standing objects, by their absorption area in m²."""
        return replace(self, objects=self.objects + absorption_area)


def covered(states: Sequence[RoomState], areas: Array, spectra: Array) -> list[RoomState]:
    """Return states in which walls (n,) in m² have covers of alpha ``spectra`` (n, n_bands)."""
    out = list(states)
    for equation, where in _by_equation(states):
        patches = equation.contribution(np.minimum(spectra[where], equation.largest_alpha))
        walls = equation.contribution(np.array([states[i].wall for i in where]))
        gains = areas[where][:, np.newaxis] * (patches - walls)
        for i, gain in zip(where, gains, strict=True):
            out[i] = replace(states[i], covering=states[i].covering + gain)
    return out


def _attribute(states: Sequence[RoomState], name: str) -> Array:
    """One attribute of all states, (n, n_bands)."""
    out = np.empty((len(states), len(states[0].air)))
    for i, s in enumerate(states):
        out[i] = getattr(s, name)
    return out


def _by_equation(states: Sequence[RoomState]) -> list[tuple[MeanEquation, list[int]]]:
    """Return the equations of the states, each with the indices of its states."""
    places: dict[str, list[int]] = {}
    for i, s in enumerate(states):
        places.setdefault(s.equation, []).append(i)
    return [(mean_equation(key), where) for key, where in places.items()]


def _stacked(states: Sequence[RoomState]) -> tuple[Array, Array]:
    """Return the areas (n, n_materials) and alpha (n, n_materials, n_bands) of states."""
    return np.array([s.areas for s in states]), np.array([s.alpha for s in states])


def highest(equation: MeanEquation) -> float:
    """Return the largest mean absorption of all surfaces for which an equation gives a T above 0."""
    return (1 - _FROM_ENDS) * equation.largest_mean


def mean_contributions(equation: MeanEquation, states: Sequence[RoomState]) -> Array:
    """Return the mean of h(alpha) over the surfaces, within the equation's range, (n, n_bands)."""
    areas, alpha = _stacked(states)
    each = equation.contribution(np.minimum(alpha, equation.largest_alpha))
    if (walls := states[0].walls) is not True:
        each = np.where(walls[:, None], each, alpha)  # pieces are no wall that reflects
    total = np.einsum("nm,nmk->nk", areas, each) + _attribute(states, "covering")
    area = areas.sum(1, where=walls)[:, None]
    return np.asarray(np.clip(total / area, _FROM_ENDS, highest(equation)))


def surface_absorption(states: Sequence[RoomState]) -> Array:
    """Return the absorption area of the surfaces in m², for n states of one room, (n, n_bands)."""
    out = np.empty((len(states), len(states[0].air)))
    for equation, where in _by_equation(states):
        group = [states[i] for i in where]
        areas = np.array([s.areas for s in group]).sum(1, where=group[0].walls)[:, None]
        out[where] = areas * equation.exponent(mean_contributions(equation, group))
    return out


def speeds(states: Sequence[RoomState]) -> Array:
    """Return the speeds of sound in m/s, (n,)."""
    return np.array([s.speed_of_sound for s in states])


def rates(states: Sequence[RoomState]) -> Array:
    """Return the decay rates k of n states in 1/s, (n, n_bands); see `RoomState.rate`."""
    volume = np.array([s.volume for s in states])[:, None]
    absorbed = surface_absorption(states) + 4 * _attribute(states, "air") * volume
    absorbed += _attribute(states, "objects")
    return np.asarray(speeds(states)[:, None] * absorbed / (4 * volume))


def sensitivities(states: Sequence[RoomState]) -> Array:
    """Return the derivatives of the decay rates by alpha in 1/s, (n, n_materials, n_bands)."""
    out = np.empty((len(states), *states[0].alpha.shape))
    for equation, where in _by_equation(states):
        group = [states[i] for i in where]
        areas, alpha = _stacked(group)
        mean = mean_contributions(equation, group)
        slope = equation.slope(np.minimum(mean, STEEPEST))[:, None, :]
        each = equation.contribution_slope(np.minimum(alpha, STEEPEST))
        if group[0].walls is not True:
            each = np.where(group[0].walls[:, None], each, 1.0)
        volume = np.array([s.volume for s in group])[:, None]
        flow = speeds(group)[:, None] / (4 * volume) * areas
        out[where] = flow[:, :, None] * slope * each
    return out


@dataclass(frozen=True, eq=False)
class Predicted:
    """Hold T20, EDT, T30, C80 and G of n states, and their derivatives by ln T20."""

    features: Array  # (n, 5, n_bands), of `FEATURES`
    slopes: Array  # its derivatives by ln T20
    reverberation_time: Array = field(repr=False)  # T20 in s, (n, n_bands)


def predict(states: Sequence[RoomState], distance: Array) -> Predicted:
    """Return what a model predicts for n states of one room, at distances (n_pairs,) in m."""
    n_bands = len(states[0].air)
    features = np.empty((len(states), len(FEATURES), n_bands))
    shifted = np.empty_like(features)
    # By the number of decay terms, and the presence of a noise floor.
    groups: dict[tuple[object, bool], list[int]] = {}
    alone: dict[int, Decay] = {}
    for i, s in enumerate(states):
        kind: object = type(s.shape)
        if s.shape is not None and not hasattr(s.shape, "together"):
            alone[i] = s.shape(s.locked())
            kind = alone[i].rates.shape[1]
        groups.setdefault((kind, s.floor_db is not None), []).append(i)
    for members in groups.values():
        group = [states[i] for i in members]
        if members[0] in alone:
            weights = np.array([alone[i].weights for i in members])
            rate = np.array([alone[i].rates for i in members])
        elif (together := getattr(group[0].shape, "together", None)) is not None:
            decay = together(group, [s.shape for s in group])
            weights, rate = decay.weights, decay.rates
        else:
            rate = rates(group)[:, :, None]
            weights = np.ones_like(rate) / np.array([s.volume for s in group])[:, None, None]
        floor = np.array([np.nan if s.floor_db is None else s.floor_db for s in group])
        record = np.array([s.record for s in group])
        direct = np.array([s.direct_db for s in group])
        c, at = speeds(group), np.asarray(distance)
        features[members] = _levels(weights, rate, direct, at, c)
        shifted[members] = _levels(weights, rate / 1.01, direct, at, c)
        if rate.shape[2] == 1 and not np.isfinite(floor).any():
            features[members, 0] = np.log(_LN6 / rate[:, :, 0])
        else:
            features[members, :3] = _times(weights, rate, floor, record)
        # A common factor of all rates scales the time only, so the ratios do not change.
        shifted[members, :3] = features[members, :3]
        shifted[members, 0] += np.log(1.01)
    return Predicted(
        features, (shifted - features) / np.log(1.01), np.exp(features[:, FEATURES.index("t20")])
    )


def _levels(weights: Array, rates: Array, direct_db: Array, distance: Array, c: Array) -> Array:
    """C80 and G (rows 3 and 4), averaged over the distances; the other rows are 0."""
    out = np.zeros((len(weights), len(FEATURES), weights.shape[1]))

    # Barron and Lee 1988: sound at a distance has decayed since the emission of the direct sound.
    def left(t: Array) -> Array:
        decayed = np.exp(-rates[..., None] * t[:, None, None, :])
        return np.asarray(np.sum((weights / rates)[..., None] * decayed, axis=2))

    arrival = distance / c[:, None]
    power = 4 * np.pi * 100 * c[:, None, None]
    reverberant = power * left(arrival)
    late = power * left(arrival + 0.08)
    direct = (100 / distance**2)[None, None, :] * 10 ** (direct_db / 10)[:, None, None]
    early = direct + reverberant - late
    out[:, 3] = 10 * np.log10(early / late).mean(-1)
    out[:, 4] = 10 * np.log10(direct + reverberant).mean(-1)
    return out


def _times(weights: Array, rates: Array, floor_db: Array, record: Array) -> Array:
    """ln T20, ln EDT/T20, ln T30/T20 of sums of exponentials with a noise floor."""
    energy = weights / rates
    total = energy.sum(2)
    noise = np.where(np.isfinite(floor_db), 10 ** (np.nan_to_num(floor_db) / 10), 0.0)[:, None]
    density = noise * weights.sum(2)
    # The record's length is in reverberation times at the mean rate of the energy.
    end = record[:, None] * _LN6 * total / weights.sum(2)

    whole = (total + density * end)[..., None]

    both = np.stack([energy, weights], axis=2)

    def left(t: Array) -> tuple[Array, Array]:
        """Energy after t, and its loss per second at t; t (n, n_bands, n_times)."""
        sums = both @ np.exp(-rates[..., None] * t[:, :, None, :])
        after = sums[:, :, 0] + density[..., None] * np.maximum(end[..., None] - t, 0)
        return after, sums[:, :, 1] + density[..., None]

    wanted = 10 ** (np.array([-5.0, -10.0, -25.0, -35.0]) / 10) * whole
    # ln of a sum of exponentials is convex, so Newton's steps never pass the root. With a noise floor
    # they may; a step that leaves the bracket is replaced by the bracket's middle.
    at = low = np.zeros_like(wanted)
    high = np.where(noise > 0, end, 9.0 / rates.min(2))[..., None] * np.ones_like(at)
    for _ in range(_STEPS):
        after, loss = left(at)
        past = after < wanted
        low, high = np.where(past, low, at), np.where(past, at, high)
        step = at + np.log(after / wanted) * after / loss
        last, at = at, np.where(step <= high, np.maximum(step, low), 0.5 * (low + high))
        if np.all(np.abs(at - last) <= 1e-12 * at):
            break
    at = np.concatenate([np.zeros((*total.shape, 1)), at], axis=-1)
    # T20, EDT and T30: a line through 24 points from -5 to -25, 0 to -10 and -5 to -35 dB.
    first, last = at[..., [1, 0, 1], None], at[..., [3, 2, 4], None]
    t = first + (last - first) * np.linspace(0, 1, 24)
    y = 10 * np.log10(left(t.reshape(*total.shape, -1))[0]).reshape(t.shape)
    t = t - t.mean(-1, keepdims=True)
    t20, edt, t30 = np.moveaxis(np.log(-60 * (t * t).sum(-1) / (t * y).sum(-1)), -1, 0)
    return np.stack([t20, edt - t20, t30 - t20], axis=1)


_ORDER = 5  # number of polar angles, and of azimuths, of the directions


@dataclass(frozen=True)
class DirectionalDecay:
    """Describe the decay of a box whose walls absorb unevenly, with a different decay per direction.

    The energy density E(u) in the direction u, and its mean <E> over directions, follow dE(u)/dt =
    -r(u) E - nu (E - <E>). r(u) = c sum_i |u_i| A_i / 2V over the axes i, where A_i is the absorption
    area of the walls across axis i. nu = s c S / 4V is the rate at which walls with the scattering
    coefficient s exchange energy between directions (after Nilsson 2004 and EN 12354-6, D).
    """

    scattering: float

    @staticmethod
    def together(states: Sequence[RoomState], shapes: Sequence[DirectionalDecay]) -> Decay:
        """Return the decays of n states, with one exponential term per direction and band."""
        u, weight = _directions()
        c = speeds(states)[:, None]
        volume = np.array([[s.volume] for s in states])
        area = np.array([[s.total_area] for s in states])
        # Shares of the surfaces' absorption by axis; equal shares where they absorb nothing.
        by_axis = np.array(
            [
                (s.facing * areas[:, None]).T @ alpha / (areas @ alpha)
                for s in states
                for alpha in [np.maximum(s.alpha, 1e-9)]
                for areas in [np.where(s.walls, s.areas, 0.0)]
            ]
        )
        absorbing = surface_absorption(states)
        # Pieces absorb alike in every direction: the share that they have in the mean.
        of_pieces = np.zeros_like(absorbing)
        if states[0].walls is not True:
            alone = [replace(s, walls=True, areas=np.where(s.walls, s.areas, 0.0)) for s in states]
            of_pieces = absorbing - surface_absorption(alone)
        absorbed = by_axis * (absorbing - of_pieces)[:, None, :]
        rate = c[:, :, None] / (2 * volume[:, :, None]) * (u.T @ absorbed).swapaxes(1, 2)
        nothing = np.zeros_like(states[0].air)
        everywhere = c * np.array([s.air + (s.objects + nothing) / (4 * s.volume) for s in states])
        everywhere = everywhere + c * of_pieces / (4 * volume)
        nu = np.array([[s.scattering] for s in shapes]) * c * area / (4 * volume)
        # E' = -(diag(r + nu) - nu root root') E, where each direction counts by the root of its weight.
        root = np.sqrt(weight)
        decaying = (rate + nu[:, :, None])[..., None] * np.eye(len(root))
        terms, vectors = np.linalg.eigh(decaying - nu[:, :, None, None] * np.outer(root, root))
        share = (root @ vectors) ** 2
        return Decay(share / volume[:, :, None], np.maximum(terms + everywhere[..., None], 1e-3))


@cache
def _directions() -> tuple[Array, Array]:
    """Directions of one octant, (3, n), and their weights: Gauss points in cos(polar angle)."""
    nodes, gauss = np.polynomial.legendre.leggauss(_ORDER)
    z = 0.5 * (nodes + 1)
    azimuth = (np.arange(_ORDER) + 0.5) * np.pi / 2 / _ORDER  # midpoints
    rho = np.sqrt(1 - z**2)
    u = np.stack(
        [
            np.outer(rho, np.cos(azimuth)),
            np.outer(rho, np.sin(azimuth)),
            np.outer(z, np.ones(_ORDER)),
        ]
    ).reshape(3, -1)
    return u, np.outer(gauss / 2, np.full(_ORDER, 1 / _ORDER)).ravel()
