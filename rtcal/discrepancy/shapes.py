"""Decays that are not one exponential: two coupled rooms, and a field that is not diffuse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rtcal.discrepancy.model import Decay, State


def coupled(aperture: float, volume: float, alpha: float) -> Callable[[State], Decay]:
    """Return the decay in a room with a second one of this volume (m³) and alpha behind a hole.

    V1 dE1/dt = -(c/4) (A1 + S) E1 + (c/4) S E2, and the like for the second room, whose surface is
    a cube's (Kuttruff 2016, Sect. 5.8; Cremer & Mueller 1982).
    """

    def shape(state: State) -> Decay:
        c = state.speed_of_sound
        first = state.covered(aperture, np.ones_like(state.frequencies)).rate
        surface = 6 * volume ** (2 / 3)
        absorbed = -np.log1p(-alpha) * surface + 4 * state.air * volume + aperture
        second = c * absorbed / (4 * volume)
        # In E1 sqrt(V1), E2 sqrt(V2) the exchange is symmetric.
        cross = c * aperture / (4 * np.sqrt(state.volume * volume))
        middle, half = (first + second) / 2, (first - second) / 2
        root = np.sqrt(half**2 + cross**2)
        rates = np.stack([middle - root, middle + root], axis=1)
        share = np.clip(0.5 * (1 + half / root), 0, 1)  # of E1 in the faster term
        weights = np.stack([1 - share, share], axis=1) / state.volume
        return Decay(weights, np.maximum(rates, 1e-3))

    return shape


_ORDER = 5


def nondiffuse(scattering: float) -> Callable[[State], Decay]:
    """Return the direction-resolved decay of a box whose walls scatter this little.

    dE(u)/dt = -r(u) E - nu (E - <E>), with r(u) = c sum_i |u_i| A_i / 2V over the axes, A_i what the
    walls that face along i absorb, and nu = s c S / 4V; after Nilsson 2004 and EN 12354-6, D.
    """
    # Directions of one octant: Gauss points in cos(polar angle), midpoints in azimuth.
    nodes, gauss = np.polynomial.legendre.leggauss(_ORDER)
    z = 0.5 * (nodes + 1)
    azimuth = (np.arange(_ORDER) + 0.5) * np.pi / 2 / _ORDER
    rho = np.sqrt(1 - z**2)
    u = np.stack([
        np.outer(rho, np.cos(azimuth)), np.outer(rho, np.sin(azimuth)), np.outer(z, np.ones(_ORDER))
    ]).reshape(3, -1)  # fmt: skip
    weight = np.outer(gauss / 2, np.full(_ORDER, 1 / _ORDER)).ravel()

    def shape(state: State) -> Decay:
        c, v = state.speed_of_sound, state.volume
        bare = state.areas @ state.alpha
        # By axis, of what the equation says that the surfaces absorb.
        by_axis = (state.facing * state.areas[:, None]).T @ state.alpha
        absorbed = by_axis / bare * state.surface_absorption
        rate = c / (2 * v) * (u.T @ absorbed)  # (directions, bands)
        everywhere = c * (state.air + (state.objects + np.zeros_like(bare)) / (4 * v))
        nu = scattering * c * state.total_area / (4 * v)
        root = np.sqrt(weight)
        system = np.zeros((rate.shape[1], len(weight), len(weight)))
        index = np.arange(len(weight))
        system[:, index, index] = rate.T + nu
        system -= nu * np.outer(root, root)
        values, vectors = np.linalg.eigh(system)
        weights = np.einsum("d,bdj->bj", root, vectors) ** 2 / v
        return Decay(weights, np.maximum(values + everywhere[:, None], 1e-3))

    return shape
