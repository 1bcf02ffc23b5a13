"""Decays that are not one exponential: two coupled rooms, and a field that is not diffuse.

A state's ``shape`` is anything that turns the state into a `Decay`. One that has a method `together`
is asked for the decays of many states at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from rtcal.discrepancy.model import Decay, State, rates, surface_absorption
from rtcal.support.types import Array


@dataclass(frozen=True)
class Coupled:
    """A second room of this ``volume`` in m³ and ``alpha`` behind an ``aperture`` in m².

    V1 dE1/dt = -(c/4) (A1 + S) E1 + (c/4) S E2, and the like for the second room, whose surface is
    a cube's (Kuttruff 2016, Sect. 5.8; Cremer & Mueller 1982).
    """

    aperture: float
    volume: float
    alpha: float

    def __call__(self, state: State) -> Decay:
        """Return the state's decay, of two terms."""
        return _first(self.together([state], [self]))

    @staticmethod
    def together(states: Sequence[State], shapes: Sequence[Coupled]) -> Decay:
        """Return the decays of many states, each with its shape: (n, n_bands, 2)."""
        c, opening = states[0].speed_of_sound, np.ones_like(states[0].frequencies)
        aperture = np.array([[s.aperture] for s in shapes])
        volume = np.array([[s.volume] for s in shapes])
        first_volume = np.array([[s.volume] for s in states])
        alpha, air = np.array([[s.alpha] for s in shapes]), np.array([s.air for s in states])
        first = rates(
            [
                state.covered(shape.aperture, opening)
                for state, shape in zip(states, shapes, strict=True)
            ]
        )
        absorbed = -np.log1p(-alpha) * 6 * volume ** (2 / 3) + 4 * air * volume + aperture
        second = c * absorbed / (4 * volume)
        # In E1 sqrt(V1), E2 sqrt(V2) the exchange is symmetric.
        cross = c * aperture / (4 * np.sqrt(first_volume * volume))
        middle, half = (first + second) / 2, (first - second) / 2
        root = np.sqrt(half**2 + cross**2)
        both = np.stack([middle - root, middle + root], axis=-1)
        share = np.clip(0.5 * (1 + half / root), 0, 1)  # of E1 in the faster term
        weights = np.stack([1 - share, share], axis=-1) / first_volume[:, :, None]
        return Decay(weights, np.maximum(both, 1e-3))


@dataclass(frozen=True)
class NonDiffuse:
    """The direction-resolved decay of a box whose walls scatter this little.

    dE(u)/dt = -r(u) E - nu (E - <E>), with r(u) = c sum_i |u_i| A_i / 2V over the axes, A_i what the
    walls that face along i absorb, and nu = s c S / 4V; after Nilsson 2004 and EN 12354-6, D.
    """

    scattering: float

    def __call__(self, state: State) -> Decay:
        """Return the state's decay, a term for each direction."""
        return _first(self.together([state], [self]))

    @staticmethod
    def together(states: Sequence[State], shapes: Sequence[NonDiffuse]) -> Decay:
        """Return the decays of many states, each with its shape: (n, n_bands, n_directions)."""
        u, weight = _directions()
        c = states[0].speed_of_sound
        volume = np.array([[s.volume] for s in states])
        area = np.array([[s.total_area] for s in states])
        # By axis, of what the equation says that the surfaces absorb; alike where they absorb nothing.
        by_axis = np.array(
            [
                (s.facing * s.areas[:, None]).T @ alpha / (s.areas @ alpha)
                for s in states
                for alpha in [np.maximum(s.alpha, 1e-9)]
            ]
        )
        absorbed = by_axis * surface_absorption(states)[:, None, :]
        rate = c / (2 * volume[:, :, None]) * (u.T @ absorbed).swapaxes(1, 2)
        nothing = np.zeros_like(states[0].air)
        everywhere = c * np.array([s.air + (s.objects + nothing) / (4 * s.volume) for s in states])
        nu = np.array([[s.scattering] for s in shapes]) * c * area / (4 * volume)
        terms, share = _terms(rate + nu[:, :, None], nu, np.sqrt(weight))
        return Decay(share / volume[:, :, None], np.maximum(terms + everywhere[..., None], 1e-3))


_TERMS = 12


def _terms(diagonal: Array, nu: Array, root: Array) -> tuple[Array, Array]:
    """Rates and shares of root' exp(-M t) root, M = diag(``diagonal``) - ``nu`` root root'.

    As many as Lanczos' steps from ``root``: a dozen give the decay to seven digits.
    """
    basis = np.zeros((*diagonal.shape[:-1], _TERMS, len(root)))
    small = np.zeros((*diagonal.shape[:-1], _TERMS, _TERMS))
    q = np.broadcast_to(root, diagonal.shape)
    for j in range(_TERMS):
        basis[..., j, :] = q
        w = diagonal * q - nu[..., None] * (q @ root)[..., None] * root
        small[..., j, j] = (w * q).sum(-1)
        for _ in range(2):  # once more, against rounding
            w = w - (np.swapaxes(basis, -1, -2) @ (basis @ w[..., None]))[..., 0]
        length = np.linalg.norm(w, axis=-1)
        if j + 1 < _TERMS:
            small[..., j, j + 1] = small[..., j + 1, j] = length
            q = w / np.maximum(length, 1e-300)[..., None]
    values, vectors = np.linalg.eigh(small)
    return values, vectors[..., 0, :] ** 2


def _first(decay: Decay) -> Decay:
    return Decay(decay.weights[0], decay.rates[0])


_ORDER = 5


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
