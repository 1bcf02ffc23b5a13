"""The modes of a room: rigid-wall modes, and the poles of the room with absorbing walls.

With p = sum_m x_m phi_m e^{st} over the rigid-wall modes phi_m, of angular frequency omega_m and
∫ phi_m phi_n dV = 1 for m = n and else 0, the Helmholtz equation with locally reacting walls,
dp/dn = -(s / c) beta_i p on wall i, is the eigenproblem

    (s² + omega_m²) x_m + s c sum_i beta_i(s) sum_n B_imn x_n = 0,    B_imn = ∫_i phi_m phi_n dS.

The pole s = -delta + j omega has the decay delta in 1/s: the pressure falls as exp(-delta t), and the
decay time of the mode is 3 ln 10 / delta. To the first order delta_m = c sum_i Re(beta_i) B_imm / 2.

References
----------
Morse & Ingard 1968, Theoretical Acoustics, Sect. 9.4; Kuttruff 2009, Room Acoustics, Sect. 3.1 to 3.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.support.errors import ModelError
from rtcal.support.types import Array

DECAY = 3 * float(np.log(10))
"""Decay time of a mode times its delta: the level falls by 60 dB."""

_ROUNDS = 12
_CONVERGED = 1e-4

Admittances = Callable[[float], NDArray[np.complex128]]
"""Specific admittance of each wall, (n_walls,), at a frequency in Hz."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RoomModes:
    """Modes of a room with rigid walls, up to a frequency.

    Attributes
    ----------
    frequencies : array (n_modes,)
        Hz, rising, without the mode of frequency 0.
    coupling : array (n_walls, n_modes + 1, n_modes + 1)
        B in 1/m: integrals over each wall of the products of two modes. Last is that of frequency 0,
        the constant pressure.
    materials : sequence of str (n_walls,)
        The material of each wall.
    speed_of_sound : float
        m/s.
    largest : float
        Frequency in Hz up to which modes are wanted; those above it complete the others' shapes.
    shapes : function
        Of points (n_points, 3) in m: the modes' values there, (n_points, n_modes + 1), in m^(-3/2).

    Examples
    --------
    >>> import rtcal as rt
    >>> rt.modes.modes_of(rt.simulators.Polyhedron.shoebox((5, 4, 2.5), "wall"), 60).wanted
    3
    """

    frequencies: Array
    coupling: Array
    materials: Sequence[str]
    speed_of_sound: float
    largest: float
    shapes: Callable[[Array], Array]

    @property
    def wanted(self) -> int:
        """Number of modes up to ``largest``."""
        return int(np.searchsorted(self.frequencies, self.largest, side="right"))

    def poles(self, admittances: Admittances, like: NDArray[np.complex128] | None = None) -> Poles:
        """Return the poles of the modes up to ``largest``.

        With ``like``, mixtures (n_modes + 1, n_poles), those whose shapes are like these: where two
        modes lie close together, walls decide which is which, and the rigid room does not.

        Raises ModelError if a pole does not converge: walls too far from rigid.
        """
        omega, c = 2 * np.pi * self.frequencies, self.speed_of_sound
        n = self.wanted
        omega = np.append(omega, 0.0)
        beta = np.stack([admittances(f) for f in [*self.frequencies, self.frequencies[0]]], axis=1)
        root = np.sqrt(beta)
        # Without what couples to negative frequencies the problem is an ordinary one.
        start = np.diag(1j * omega) - c / 2 * np.einsum(
            "im,imn,in->mn", root, self.coupling, root, optimize=True
        )
        first, vectors = np.linalg.eig(start)
        alike = vectors[:n] if like is None else like.conj().T @ vectors
        chosen = _by_mode(np.abs(alike) ** 2)
        poles, shapes = first[chosen], vectors[:, chosen]
        slopes = np.empty((len(chosen), len(self.materials)), dtype=complex)
        norms = np.empty(len(chosen), dtype=complex)
        for k in range(len(chosen)):
            poles[k], shapes[:, k], slopes[k], norms[k] = self._refined(
                poles[k], shapes[:, k], omega, admittances
            )
        return Poles(poles, shapes, slopes, norms)

    def _refined(
        self, pole: complex, shape: NDArray[np.complex128], omega: Array, admittances: Admittances
    ) -> tuple[complex, NDArray[np.complex128], NDArray[np.complex128], complex]:
        """Inverse iteration with Rayleigh's functional; the slopes ds/dbeta by wall, and the norm."""
        c, n = self.speed_of_sound, len(omega)
        for _ in range(_ROUNDS):
            walls = c * np.tensordot(admittances(float(pole.imag / (2 * np.pi))), self.coupling, 1)
            last, pole = pole, _rayleigh(shape, walls, omega, pole)
            if abs(pole - last) < _CONVERGED * abs(pole):
                break
            matrix = pole * walls
            matrix[np.diag_indices(n)] += pole**2 + omega**2
            step = np.linalg.solve(matrix, shape)
            shape = step / np.sqrt(step @ step)
        else:
            raise ModelError(
                f"the mode at {pole.imag / (2 * np.pi):.1f} Hz has no pole near that of rigid walls: "
                "a wall absorbs too much"
            )
        norm = shape @ (2 * pole * shape + walls @ shape)
        slopes = np.array([-pole * c * (shape @ b @ shape) / norm for b in self.coupling])
        return pole, shape, slopes, complex(norm)


def _rayleigh(
    shape: NDArray[np.complex128], walls: NDArray[np.complex128], omega: Array, near: complex
) -> complex:
    """Return the root s of x'(s² + s W + omega²) x = 0 that is nearest to ``near``."""
    norm = shape @ shape
    half, square = shape @ walls @ shape / (2 * norm), (shape * omega**2) @ shape / norm
    root = np.sqrt(half**2 - square)
    return complex(min(-half + root, -half - root, key=lambda s: abs(s - near)))


@dataclass(frozen=True, eq=False)
class Poles:
    """Poles of a room with absorbing walls.

    Attributes
    ----------
    values : complex array (n_poles,)
        -delta + j omega, in 1/s.
    mixtures : complex array (n_modes, n_poles)
        Of rigid-wall modes.
    slopes : complex array (n_poles, n_walls)
        Derivative of each pole by each wall's specific admittance, in 1/s.
    norms : complex array (n_poles,)
        x' (2 s + c sum_i beta_i B_i) x of each mixture x: a source and a receiver at which the mixtures
        have the values a and b excite and hear the pole with a b / norm.
    """

    values: NDArray[np.complex128]
    mixtures: NDArray[np.complex128]
    slopes: NDArray[np.complex128]
    norms: NDArray[np.complex128]

    @property
    def frequencies(self) -> Array:
        """Hz."""
        return np.asarray(self.values.imag / (2 * np.pi))

    @property
    def decays(self) -> Array:
        """Delta in 1/s."""
        return np.asarray(-self.values.real)


def _by_mode(share: Array) -> NDArray[np.intp]:
    """Return for each mode the vector that has most of it, each once; ``share`` (modes, vectors)."""
    from scipy.optimize import linear_sum_assignment

    return np.asarray(linear_sum_assignment(-share)[1])
