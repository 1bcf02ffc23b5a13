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
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rtcal.support.errors import ModelError
from rtcal.support.types import Array

DECAY = 3 * float(np.log(10))
"""Decay time of a mode times its delta: the level falls by 60 dB."""

_ROUNDS = 12
_CONVERGED = 1e-7
_SETTLED = 1e-4
"""Largest share of another shape that the last step mixed in."""
_MIXED = 0.3
"""Share of another shape that one step mixes in at most."""

Complex = NDArray[np.complex128]
Integers = NDArray[np.intp]

Admittances = Callable[[float], Complex]
"""Specific admittance of each wall, (n_walls,), at a frequency in Hz."""
_At = Callable[[Array], Complex]
_Moved = tuple[Complex, Array]
_Step = Callable[[Integers, Complex, Complex, Complex, Complex], _Moved]
"""Of which poles, these, shapes, c times admittances and the walls' pull: shapes, and what moved."""


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
    known : dict
        The last poles that were asked of stated coefficients, by these: kept for the next responses.

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
    known: dict[bytes, Poles] = field(default_factory=dict, repr=False)

    @property
    def wanted(self) -> int:
        """Number of modes up to ``largest``."""
        return int(np.searchsorted(self.frequencies, self.largest, side="right"))

    def poles(self, admittances: Admittances, like: Complex | None = None) -> Poles:
        """Return the poles of the modes up to ``largest``.

        With ``like``, mixtures (n_modes + 1, n_poles), those whose shapes are like these: where two
        modes lie close together, walls decide which is which, and the rigid room does not.

        Raises ModelError if a pole does not converge: walls too far from rigid.
        """

        def at(frequencies: Array) -> Complex:
            return np.stack([admittances(float(f)) for f in frequencies], axis=1)

        omega, c = 2 * np.pi * np.append(self.frequencies, 0.0), self.speed_of_sound
        beta = at(np.append(self.frequencies, self.frequencies[0]))
        root = np.sqrt(beta)
        # Without what couples to negative frequencies the problem is an ordinary one.
        start = np.diag(1j * omega) - c / 2 * np.einsum(
            "im,imn,in->mn", root, self.coupling, root, optimize=True
        )
        first, vectors = np.linalg.eig(start)
        alike = vectors[: self.wanted] if like is None else like.conj().T @ vectors
        chosen = _by_mode(np.abs(alike) ** 2)
        inverse = np.linalg.inv(vectors)
        squares, own = omega[:, np.newaxis] ** 2, first[:, np.newaxis]

        def corrected(
            left: Integers, s: Complex, x: Complex, beta: Complex, pull: Complex
        ) -> _Moved:
            """Take off the residual by the vectors, among which the matrix is almost diagonal."""
            residual, apart = (s**2 + squares) * x + s * pull, (s - own) * (s - own.conj())
            apart[chosen[left], np.arange(len(left))] = np.inf  # a shape takes nothing of its own
            mixed = inverse @ residual / apart
            mixed /= np.maximum(np.abs(mixed) / _MIXED, 1.0)
            return x - vectors @ mixed, np.abs(mixed).max(axis=0)

        def solved(left: Integers, s: Complex, x: Complex, beta: Complex, pull: Complex) -> _Moved:
            """Inverse iteration."""
            each = [
                pole * np.tensordot(b, self.coupling, 1) + np.diag(pole**2 + omega**2)
                for pole, b in zip(s, beta.T, strict=True)
            ]
            found = np.asarray(np.linalg.solve(each, x.T[:, :, np.newaxis])[:, :, 0].T)
            return found, np.zeros(len(s))

        poles, shapes, left = first[chosen], vectors[:, chosen], np.arange(len(chosen))
        for step in (corrected, solved):
            if not len(left):
                break
            poles[left], shapes[:, left] = first[chosen[left]], vectors[:, chosen[left]]
            left = self._refined(poles, shapes, left, at, step)
        if len(left):
            raise ModelError(
                f"the mode at {poles[left[0]].imag / (2 * np.pi):.1f} Hz has no pole near that of "
                "rigid walls: a wall absorbs too much"
            )
        of_walls, pull = self._walls(shapes, c * at(poles.imag / (2 * np.pi)))
        norms = (shapes * (2 * poles * shapes + pull)).sum(axis=0)
        return Poles(poles, shapes, (-poles * c * of_walls / norms).T, norms)

    def _refined(
        self, poles: Complex, shapes: Complex, left: Integers, at: _At, step: _Step
    ) -> Integers:
        """Refine those left by steps and Rayleigh's functional; return which have not settled."""
        squares = (2 * np.pi * np.append(self.frequencies, 0.0)[:, np.newaxis]) ** 2
        moved = np.zeros(len(left))
        for _ in range(_ROUNDS):
            x, last = shapes[:, left] / np.sqrt((shapes[:, left] ** 2).sum(axis=0)), poles[left]
            beta = self.speed_of_sound * at(last.imag / (2 * np.pi))
            _, pull = self._walls(x, beta)
            # The root s of x'(s² + s W + omega²) x = 0 that is nearest to the last.
            half, square = (x * pull).sum(axis=0) / 2, (x**2 * squares).sum(axis=0)
            root = np.sqrt(half**2 - square)
            near = np.abs(root - half - last) < np.abs(root + half + last)
            poles[left], shapes[:, left] = np.where(near, root, -root) - half, x
            near = (np.abs(poles[left] - last) < _CONVERGED * np.abs(last)) & (moved < _SETTLED)
            left, far = left[~near], ~near
            if not len(left):
                break
            shapes[:, left], moved = step(left, poles[left], x[:, far], beta[:, far], pull[:, far])
        return left

    def _walls(self, shapes: Complex, weights: Complex) -> tuple[Complex, Complex]:
        """Return x' B_i x of each column x, (n_walls, n_columns), and sum_i weights_i B_i x."""
        n, own, pull = shapes.shape[1], [], np.zeros_like(shapes)
        parts = np.hstack([shapes.real, shapes.imag])
        for wall, weight in zip(self.coupling, weights, strict=True):
            both = wall @ parts
            on_wall = both[:, :n] + 1j * both[:, n:]
            own.append((shapes * on_wall).sum(axis=0))
            pull += weight * on_wall
        return np.array(own), pull


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

    values: Complex
    mixtures: Complex
    slopes: Complex
    norms: Complex

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
