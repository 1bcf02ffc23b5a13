"""The fit of a room's poles to the spectra of its responses.

The spectra of the pairs r of positions are those of the room's poles s_n, in the form that samples of
finite length have:

    Y_r(w) = sum_n A_nr / (j w - s_n) + conj(A_nr) / (j w - conj(s_n)) + error.

Unknown are the poles, with the calculated ones as prior, and the amplitudes, with A_nr = q(f_n) psi_nr
as prior: psi is what the positions hear of each mode, and q, the source's spectrum, is smooth and
follows from the amplitudes themselves. A scan finds the factor that all calculated frequencies share.
Gauss-Newton steps with Levenberg's damping then fit everything. The amplitudes of all pairs have one
information matrix, and fall out of the poles' (variable projection; Golub & Pereyra 1973).

References
----------
Golub & Pereyra 1973, SIAM J. Numer. Anal. 10; Kay 1993, Fundamentals of Statistical Signal Processing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rtcal.modes.measured import COMMON_ERROR, DECAY_ERROR, frequency_error
from rtcal.modes.room_modes import Complex, Poles
from rtcal.support.errors import DataError
from rtcal.support.types import Array

AMPLITUDE = 0.3
"""Relative standard deviation of an amplitude at a pair, before anything was heard: positions, the
walls' effect on the shape."""
LEAST_AMPLITUDE = 0.15
"""Least standard deviation that the amplitudes heard may tell."""
_SMOOTH = 20.0
"""Hz over which the source's spectrum is smooth."""
_LOCAL = 8.0
"""Hz on either side over which the error of the fit is averaged."""
_LEAST_RANGE = 15.0
"""dB between the first eighth of the responses and their last eighth, within the frequencies sought."""
FARTHEST = 2.5 * COMMON_ERROR
"""Largest relative error that all frequencies share and that is sought."""
_SCALES = 41
_STEPS = 25


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectra of the responses: ``values`` (n_bins, n_pairs) at ``omega`` in 1/s, and their noise.

    ``noise`` is the variance of the real part of a bin.
    """

    values: Complex
    omega: Array
    noise: float
    samples: int
    step: float

    @classmethod
    def of(cls, signals: Array, rate: float, lowest: float, highest: float) -> Spectra:
        """Return the spectra of responses (n_pairs, n_samples); DataError without a decay in them."""
        n = signals.shape[1]
        f = np.fft.rfftfreq(n, 1 / rate)
        inside = (f >= 0.75 * lowest) & (f <= 1.03 * highest)
        spectra = np.fft.rfft(signals, axis=1)[:, inside]
        # Of the last eighth, in which the modes have died away.
        tail = n // 8
        end, start = (
            np.abs(np.fft.rfft(part, n, axis=1)[:, inside]) ** 2
            for part in (signals[:, -tail:], signals[:, :tail])
        )
        if start.sum() < end.sum() * 10 ** (_LEAST_RANGE / 10):
            raise DataError(
                f"the responses have no decay of {_LEAST_RANGE:g} dB above their noise from "
                f"{lowest:g} to {highest:g} Hz: measure with more signal"
            )
        noise = max(float(end.mean()) * n / tail / 2, 1e-12 * float((np.abs(spectra) ** 2).mean()))
        return cls(spectra.T, np.asarray(2 * np.pi * f[inside]), noise, n, 1 / rate)

    def kernel(self, poles: Complex) -> tuple[Complex, Complex]:
        """Return the spectra of exp(s t) and their derivatives by s, each (n_bins, n_poles)."""
        n, dt = self.samples, self.step
        turn = -1j * self.omega[:, np.newaxis] * dt
        step, last = np.exp(poles * dt) * np.exp(turn), np.exp(poles * dt * n) * np.exp(turn * n)
        value = (1 - last) / (1 - step)
        return value, dt * (step * value - n * last) / (1 - step)

    @cached_property
    def residuals(self) -> Complex:
        """Spectra of the modes below and above those sought, (n_bins, 3): 1 / w, 1 and w."""
        x = self.omega / self.omega.mean()
        size = np.sqrt((np.abs(self.values) ** 2).mean())
        return np.asarray(size * x[:, np.newaxis] ** np.array([-1.0, 0.0, 1.0]), dtype=complex)

    def local(self, off: Complex) -> Array:
        """Return the variance of a bin's real part, (n_bins,), averaged over its neighbours."""
        half = max(int(_LOCAL * 2 * np.pi / (self.omega[1] - self.omega[0])), 1)
        window = np.ones(2 * half + 1)
        power = np.convolve((np.abs(off) ** 2).mean(axis=1) / 2, window, "same")
        count = np.convolve(np.ones(len(off)), window, "same")
        # A window that is longer than the spectrum is cut to it.
        start = (len(power) - len(off)) // 2
        return np.maximum((power / count)[start : start + len(off)], self.noise)


@dataclass(frozen=True, eq=False)
class Problem:
    """The least squares of poles (frequencies in Hz, then logarithms of decays) and amplitudes.

    ``psi`` (n_poles, n_pairs) is what the pairs hear of each calculated pole, ``scale`` times whose
    frequencies are the ``prior``.
    """

    heard: Spectra
    poles: Poles
    psi: Complex
    scale: float
    spread_of_amplitudes: float = AMPLITUDE

    @cached_property
    def prior(self) -> Array:
        """Frequencies and logarithms of decays, (2 n_poles,)."""
        return np.concatenate([self.scale * self.poles.frequencies, np.log(self.poles.decays)])

    @cached_property
    def spread(self) -> Array:
        """Standard deviations of the prior, (2 n_poles,)."""
        own = frequency_error(self.poles.frequencies, self.poles.decays)
        return np.concatenate([own, np.full(len(own), DECAY_ERROR)])


def fitted(heard: Spectra, poles: Poles, psi: Complex) -> Point:
    """Return the poles and amplitudes of the least squares.

    How far amplitudes are from the calculated patterns is known only then, and counts in a second fit.
    """
    scale, amplitudes = _scanned(heard, poles.values, psi)
    problem = Problem(heard, poles, psi, scale)
    none = np.zeros_like(amplitudes, shape=(heard.residuals.shape[1], psi.shape[1]))
    first = _settled(Point(problem, problem.prior, np.vstack([amplitudes, none])))
    spread = float(np.clip(np.sqrt(first.strange), LEAST_AMPLITUDE, AMPLITUDE))
    told = replace(problem, spread_of_amplitudes=spread)
    return _settled(Point(told, first.at, first.amplitudes))


def _settled(point: Point) -> Point:
    """Take steps with Levenberg's damping until the misfit falls no more."""
    n, damping = len(point.problem.psi), 1e-2
    for _ in range(_STEPS):
        now, settled = point.misfit(point), True
        for _ in range(6):
            moved = point.moved(damping)
            if np.abs(moved.at - point.at)[n:].max() < 2:
                fallen = now - point.misfit(moved)
                if fallen > 0:
                    point, settled = moved, fallen < 0.5
                    break
            damping *= 10
        damping = max(damping / 10, 1e-8)
        if settled:
            break
    return point


def _scanned(heard: Spectra, poles: Complex, psi: Complex) -> tuple[float, Complex]:
    """Return the factor of all frequencies, and amplitudes.

    Under this factor the calculated spectra, with a source's smooth spectrum that is common to all
    pairs, are most like those heard.
    """
    best = (np.inf, 1.0, psi)
    f = heard.omega / (2 * np.pi)
    half = round(_SMOOTH / (f[1] - f[0]))
    window = np.exp(-((2 * np.linspace(-1, 1, 2 * half + 1)) ** 2))
    total = float((np.abs(heard.values) ** 2).sum())
    for scale in 1 + FARTHEST * np.linspace(-1, 1, _SCALES):
        moved = poles.real + 1j * scale * poles.imag
        calculated = heard.kernel(moved)[0] @ psi / 2
        across, power = (
            np.convolve((calculated.conj() * x).sum(axis=1), window)[half:][: len(f)]
            for x in (heard.values, calculated)
        )
        q = across / power
        left = float((np.abs(heard.values - q[:, np.newaxis] * calculated) ** 2).sum())
        # As if an eighth of all bins were independent: the misfit is the model's.
        cost = heard.values.size / 4 * np.log(left / total) + ((scale - 1) / COMMON_ERROR) ** 2
        if cost < best[0]:
            at = np.interp(scale * poles.imag / (2 * np.pi), f, q)
            best = (float(cost), float(scale), at[:, np.newaxis] * psi)
    return best[1], best[2]


@dataclass(frozen=True, eq=False)
class Point:
    """Poles and amplitudes, with the errors and the source's spectrum there."""

    problem: Problem
    at: Array
    amplitudes: Complex

    @property
    def frequencies(self) -> Array:
        """Hz, (n_poles,)."""
        return self.at[: len(self.problem.psi)]

    @property
    def log_decays(self) -> Array:
        """Logarithms of the decays in 1/s, (n_poles,)."""
        return self.at[len(self.problem.psi) :]

    @cached_property
    def columns(self) -> Complex:
        """Derivatives of the spectra, (n_bins, 2 n_amplitudes + 2 n_poles).

        By the amplitudes' real parts and imaginary parts; and two for each pole, which each pair mixes
        by its amplitude. The residuals have no poles of their own.
        """
        heard = self.problem.heard
        poles, rest = -np.exp(self.log_decays) + 2j * np.pi * self.frequencies, heard.residuals
        ours, others = heard.kernel(poles), heard.kernel(poles.conj())
        sums, turned = (
            [(a + sign * b) / 2 for a, b in zip(ours, others, strict=True)] for sign in (1, -1)
        )
        by_amplitudes = np.hstack([sums[0], rest, 1j * turned[0], 1j * rest])
        return np.hstack([by_amplitudes, sums[1], 1j * turned[1]])

    @cached_property
    def off(self) -> Complex:
        """Spectra less those of the modes, (n_bins, n_pairs)."""
        parts = np.vstack([self.amplitudes.real, self.amplitudes.imag])
        return np.asarray(self.problem.heard.values - self.columns[:, : len(parts)] @ parts)

    @property
    def own(self) -> Complex:
        """Amplitudes of the modes, (n_poles, n_pairs)."""
        return self.amplitudes[: len(self.problem.psi)]

    @cached_property
    def expected(self) -> Complex:
        """Amplitudes of the calculated patterns with the source's smooth spectrum."""
        psi, f, own = self.problem.psi, self.frequencies, self.own
        near = np.exp(-(((f[:, np.newaxis] - f) / _SMOOTH) ** 2))
        q = near @ (psi.conj() * own).sum(axis=1) / (near @ (np.abs(psi) ** 2).sum(axis=1))
        none = np.zeros_like(self.amplitudes[len(psi) :])
        return np.vstack([q[:, np.newaxis] * psi, none])

    @cached_property
    def ridge(self) -> Array:
        """Weight of each mode's amplitudes, (n_poles,)."""
        n = len(self.own)
        size = np.sqrt((np.abs(self.expected[:n]) ** 2).mean(axis=1))
        spread = self.problem.spread_of_amplitudes
        own = 1 / np.maximum(spread * size, 1e-9 * size.max()) ** 2
        return np.concatenate([own, np.ones(len(self.amplitudes) - n)])

    @cached_property
    def weight(self) -> Array:
        """Weights of the bins, (n_bins,)."""
        return np.asarray(1 / np.sqrt(self.problem.heard.local(self.off)))

    @property
    def unexplained(self) -> float:
        """Share of the responses' power that the modes leave."""
        return _share(self.off, self.problem.heard.values)

    @property
    def strange(self) -> float:
        """Share of the amplitudes' power that the calculated patterns leave."""
        within = self.frequencies <= self.problem.heard.omega[-1] / (2 * np.pi)
        own = self.own[within]
        return _share(own - self.expected[: len(within)][within], own)

    @property
    def covariance(self) -> Array:
        """Covariance of the poles, (2 n_poles, 2 n_poles), with their prior."""
        return np.asarray(np.linalg.inv(self._reduced(0.0)[0]))

    def misfit(self, there: Point) -> float:
        """Return the weighed squares of what is left ``there``, with the weights of this point."""
        p = self.problem
        left = np.abs(there.off) ** 2 * self.weight[:, np.newaxis] ** 2
        far = np.abs(there.amplitudes - self.expected) ** 2 * self.ridge[:, np.newaxis]
        return float(left.sum() + far.sum() + (((there.at - p.prior) / p.spread) ** 2).sum())

    def moved(self, damping: float) -> Point:
        """Return the point after a damped step."""
        from scipy.linalg import solve_triangular

        matrix, right, lower, across, sides = self._reduced(damping)
        move = np.linalg.solve(matrix, right)
        more = solve_triangular(lower, sides - across @ move, trans=1, lower=True)
        n = len(self.amplitudes)
        return Point(self.problem, self.at + move, self.amplitudes + more[:n] + 1j * more[n:])

    def _reduced(self, damping: float) -> tuple[Array, ...]:
        """Return matrix and right side of the poles, without the amplitudes.

        And of these the root L of their matrix, and by L what they share with the poles, (2 n, n_pairs,
        2 n_poles), and their sides, (2 n, n_pairs).
        """
        from scipy.linalg import solve_triangular

        own, matrix, right, across, sides = self._normal
        own, matrix = (m + damping * np.diag(np.diag(m)) for m in (own, matrix))
        lower = np.asarray(np.linalg.cholesky(own), dtype=float)
        across, sides = (solve_triangular(lower, m, lower=True) for m in (across, sides))
        rows = across.reshape(-1, len(matrix))
        matrix, right = matrix - rows.T @ rows, right - rows.T @ sides.ravel()
        return matrix, right, lower, across.reshape(*sides.shape, -1), sides

    @cached_property
    def _normal(self) -> tuple[Array, ...]:
        """Normal equations: of amplitudes, of poles with their right side, of both, and sides."""
        p, n = self.problem, 2 * len(self.amplitudes)
        columns, left = (
            np.concatenate([weighed.real, weighed.imag])
            for weighed in (x * self.weight[:, np.newaxis] for x in (self.columns, self.off))
        )
        gram, off = columns.T @ columns, columns.T @ left
        decays = np.exp(self.log_decays)

        def of_poles(mixed: Array, a: Complex) -> Array:
            """Return what a pair of amplitudes ``a`` has of poles, along the last axis."""
            one, two = mixed[..., : len(a)], mixed[..., len(a) :]
            by_frequency = 2 * np.pi * (two * a.real - one * a.imag)
            return np.concatenate([by_frequency, -decays * (one * a.real + two * a.imag)], axis=-1)

        matrix, right = np.diag(p.spread**-2), (p.prior - self.at) / p.spread**2
        for a, side in zip(self.own.T, off[n:].T, strict=True):
            matrix += of_poles(of_poles(gram[n:, n:], a).T, a)
            right += of_poles(side, a)
        across = np.hstack([of_poles(gram[:n, n:], a) for a in self.own.T])
        far = (self.expected - self.amplitudes) * self.ridge[:, np.newaxis]
        sides = off[:n] + np.concatenate([far.real, far.imag])
        return gram[:n, :n] + np.diag(np.tile(self.ridge, 2)), matrix, right, across, sides


def _share(part: Complex, whole: Complex) -> float:
    """Return the power of a part over that of the whole."""
    return float((np.abs(part) ** 2).sum() / max((np.abs(whole) ** 2).sum(), 1e-300))
