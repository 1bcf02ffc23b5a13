"""The modes of a room in its impulse responses: a fit of its poles to their spectra.

Where modes overlap, responses alone do not say how many there are. The room does: its calculated modes
have poles, and patterns over the positions (`rtcal.modes.model`). What is returned of each mode is what
the responses say of it: its posterior, less its own prior. A mode of which they say too little is left
out, and so is one that is nearer to another calculated mode.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Room
from rtcal.io.impulse_responses import clipped_samples
from rtcal.io.sofa import Responses
from rtcal.modes.measured import COMMON_ERROR, DECAY_ERROR, MeasuredModes, frequency_error
from rtcal.modes.model import ABOVE, RoomPoles
from rtcal.modes.room_modes import Complex, Poles
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import single_threaded_blas
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


def fitted(heard: Spectra, poles: Poles, psi: Complex) -> Point:
    """Return the poles and amplitudes of the least squares.

    How far amplitudes are from the calculated patterns is known only then, and counts in a second fit.
    """
    scale, amplitudes = _scanned(heard, poles.values, psi)
    own = frequency_error(poles.frequencies, poles.decays)
    prior = np.concatenate([scale * poles.frequencies, np.log(poles.decays)])
    none = np.zeros_like(amplitudes, shape=(heard.residuals.shape[1], psi.shape[1]))
    first = _settled(
        Point(
            heard=heard,
            psi=psi,
            scale=scale,
            prior=prior,
            spread=np.concatenate([own, np.full(len(own), DECAY_ERROR)]),
            at=prior,
            amplitudes=np.vstack([amplitudes, none]),
        )
    )
    spread = float(np.clip(np.sqrt(first.strange), LEAST_AMPLITUDE, AMPLITUDE))
    return _settled(replace(first, spread_of_amplitudes=spread))


def _settled(point: Point) -> Point:
    """Take steps with Levenberg's damping until the misfit falls no more."""
    n, damping = len(point.psi), 1e-2
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """A point of the least squares: poles and amplitudes, with the errors there.

    ``psi`` (n_poles, n_pairs) is what the pairs hear of each calculated pole, ``scale`` times whose
    frequencies in Hz, and the logarithms of whose decays, are the ``prior`` (2 n_poles,) with its
    standard deviation ``spread``. ``at`` are those of this point. ``amplitudes`` (n_poles + 3, n_pairs)
    are of the poles and of the residuals.
    """

    heard: Spectra
    psi: Complex
    scale: float
    prior: Array
    spread: Array
    at: Array
    amplitudes: Complex
    spread_of_amplitudes: float = AMPLITUDE

    @property
    def frequencies(self) -> Array:
        """Hz, (n_poles,)."""
        return self.at[: len(self.psi)]

    @property
    def log_decays(self) -> Array:
        """Logarithms of the decays in 1/s, (n_poles,)."""
        return self.at[len(self.psi) :]

    @cached_property
    def columns(self) -> Complex:
        """Derivatives of the spectra, (n_bins, 2 n_amplitudes + 2 n_poles).

        By the amplitudes' real parts and imaginary parts; and two for each pole, which each pair mixes
        by its amplitude. The residuals have no poles of their own.
        """
        heard = self.heard
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
        return np.asarray(self.heard.values - self.columns[:, : len(parts)] @ parts)

    @property
    def own(self) -> Complex:
        """Amplitudes of the modes, (n_poles, n_pairs)."""
        return self.amplitudes[: len(self.psi)]

    @cached_property
    def expected(self) -> Complex:
        """Amplitudes of the calculated patterns with the source's smooth spectrum."""
        psi, f, own = self.psi, self.frequencies, self.own
        near = np.exp(-(((f[:, np.newaxis] - f) / _SMOOTH) ** 2))
        q = near @ (psi.conj() * own).sum(axis=1) / (near @ (np.abs(psi) ** 2).sum(axis=1))
        none = np.zeros_like(self.amplitudes[len(psi) :])
        return np.vstack([q[:, np.newaxis] * psi, none])

    @cached_property
    def ridge(self) -> Array:
        """Weight of each mode's amplitudes, (n_poles,)."""
        n = len(self.own)
        size = np.sqrt((np.abs(self.expected[:n]) ** 2).mean(axis=1))
        spread = self.spread_of_amplitudes
        own = 1 / np.maximum(spread * size, 1e-9 * size.max()) ** 2
        return np.concatenate([own, np.ones(len(self.amplitudes) - n)])

    @cached_property
    def weight(self) -> Array:
        """Weights of the bins, (n_bins,)."""
        return np.asarray(1 / np.sqrt(self.heard.local(self.off)))

    @property
    def unexplained(self) -> float:
        """Share of the responses' power that the modes leave."""
        return _share(self.off, self.heard.values)

    @property
    def strange(self) -> float:
        """Share of the amplitudes' power that the calculated patterns leave."""
        within = self.frequencies <= self.heard.omega[-1] / (2 * np.pi)
        own = self.own[within]
        return _share(own - self.expected[: len(within)][within], own)

    @property
    def covariance(self) -> Array:
        """Covariance of the poles, (2 n_poles, 2 n_poles), with their prior."""
        return np.asarray(np.linalg.inv(self._reduced(0.0)[0]))

    def misfit(self, there: Point) -> float:
        """Return the weighed squares of what is left ``there``, with the weights of this point."""
        left = np.abs(there.off) ** 2 * self.weight[:, np.newaxis] ** 2
        far = np.abs(there.amplitudes - self.expected) ** 2 * self.ridge[:, np.newaxis]
        return float(left.sum() + far.sum() + (((there.at - self.prior) / self.spread) ** 2).sum())

    def moved(self, damping: float) -> Point:
        """Return the point after a damped step."""
        from scipy.linalg import solve_triangular

        matrix, right, lower, across, sides = self._reduced(damping)
        move = np.linalg.solve(matrix, right)
        more = solve_triangular(lower, sides - across @ move, trans=1, lower=True)
        n = len(self.amplitudes)
        amplitudes = self.amplitudes + more[:n] + 1j * more[n:]
        return replace(self, at=self.at + move, amplitudes=amplitudes)

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
        n = 2 * len(self.amplitudes)
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

        matrix, right = np.diag(self.spread**-2), (self.prior - self.at) / self.spread**2
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


HIGHEST = 150.0  # Hz, where none is stated
LARGEST_ERROR = 0.5  # largest relative uncertainty of a decay that is used
UNEXPLAINED = 0.2
"""Share of the responses' power, or of the amplitudes', from which these are not the room's modes.

In seven rooms with their own positions at most 2 % of the amplitudes' were unexplained. With receivers
exchanged or a time axis 20 ms late it was 33 % or more.
"""
_INFLATED = 1.5  # uncertainty over what independent errors give: what is left is no white noise


@single_threaded_blas()
def find_modes(
    room: Room,
    responses: Array,
    rate: float,
    pairs: Sequence[tuple[str, str]],
    *,
    lowest: float = 20.0,
    highest: float = HIGHEST,
    geometry: Polyhedron | None = None,
) -> MeasuredModes:
    """Find the modes of a room in impulse responses at several positions.

    Parameters
    ----------
    room : Room
        It states geometry and positions. Its coefficients are where the search begins.
    responses : array (n_pairs, n_samples)
        All in one unit and on one time axis, which begins as the sound does.
    rate : float
        Samples per second.
    pairs : sequence of (source, receiver)
        Names of the positions in the room's scene.
    lowest, highest : float
        Hz within which modes are sought.
    geometry : Polyhedron, optional
        In place of the room's scene.

    Raises
    ------
    DataError
        For fewer than two pairs, a pair that stands there twice, a shape or value that breaks its rule,
        a clipped response, noise that leaves no decay, responses that the room's modes do not explain,
        frequencies at the end of what is sought, or no mode that is sure enough.
    """
    pairs = checks.pairs("pairs", pairs)
    signals = _checked(responses, rate, pairs, lowest, highest)
    # By a power of two, so that no digit changes.
    size = float(2.0 ** np.frexp(np.abs(signals).max())[1])
    model = RoomPoles.of(room, ABOVE * highest, geometry)
    heard = Spectra.of(signals / size, rate, lowest, highest)
    fit = fitted(heard, model.calculated, model.amplitudes(pairs))
    if max(fit.unexplained, fit.strange) > UNEXPLAINED:
        raise DataError(
            f"the room's modes leave {fit.unexplained:.0%} of the responses' power unexplained, and "
            f"{fit.strange:.0%} of the amplitudes over the positions: check dimensions, positions, "
            "temperature and that the time axis begins as the sound does"
        )
    if abs(fit.scale - 1) > 0.99 * FARTHEST:
        raise DataError(
            f"frequencies are {fit.scale:.3f} times those calculated or beyond, where the "
            "search ends: check dimensions and temperature"
        )
    return _without_prior(fit, size, model.modes.largest, lowest, highest)


def modes_in(room: Room, responses: Responses, geometry: Polyhedron | None) -> MeasuredModes:
    """Return the modes of a SOFA file's responses, of the first channel; errors as `find_modes`.

    A pair that was measured several times counts once.
    """
    first: dict[tuple[str, str], Array] = {}
    placed, note = responses.placed(room.scene)
    for pair, samples in zip(placed.pairs, placed.samples, strict=True):
        first.setdefault(pair, samples[0])
    heard = np.array([*first.values()])
    rate, top = placed.sampling_rate, min(HIGHEST, placed.sampling_rate / 2.5)
    modes = find_modes(room, heard, rate, [*first], highest=top, geometry=geometry)
    return replace(modes, notes=[*modes.notes, *filter(None, [note])])


def _checked(
    responses: Array, rate: float, pairs: Sequence[tuple[str, str]], lowest: float, highest: float
) -> Array:
    signals = checks.shaped("responses", responses, len(pairs), "n_samples")
    rate = checks.positive("rate", rate, "Hz")
    if len(pairs) < 2:
        raise DataError(f"responses has {len(pairs)} pair; modes need 2, of different positions")
    if len(set(pairs)) < len(pairs):
        twice = next(p for k, p in enumerate(pairs) if p in pairs[:k])
        raise DataError(f"pairs: {' to '.join(twice)} stands there twice; average its responses")
    if not np.isfinite(signals).all():
        raise DataError("responses has a value that is not finite")
    if not 0 < lowest < highest <= rate / 2.5:
        raise DataError(
            f"lowest = {lowest:g} Hz and highest = {highest:g} Hz are not in order above 0 and up to "
            f"rate / 2.5 = {rate / 2.5:g} Hz"
        )
    if signals.shape[1] < rate:
        raise DataError(
            f"responses are {signals.shape[1] / rate:.2f} s long; low modes need at least 1 s"
        )
    for pair, signal in zip(pairs, signals, strict=True):
        if not signal.any():
            raise DataError(f"the response of {' to '.join(pair)} is silent")
        if clipped_samples(signal):
            raise DataError(f"the response of {' to '.join(pair)} is clipped")
    return signals


def _without_prior(
    fit: Point, size: float, largest: float, lowest: float, highest: float
) -> MeasuredModes:
    """Return what the responses, times ``size``, say of each mode: the posterior less its prior."""
    n = len(fit.frequencies)
    variance = np.diag(fit.covariance)
    after, before = variance[n:], DECAY_ERROR**2
    precision = np.maximum(1 / after - 1 / before, 1e-9)
    log_decay = (fit.log_decays / after - fit.prior[n:] / before) / precision
    relative = _INFLATED / np.sqrt(precision)
    sure = relative < LARGEST_ERROR
    own = _own(fit)
    inside = (fit.frequencies >= lowest) & (fit.frequencies <= highest)
    chosen = np.flatnonzero(sure & own & inside)
    if not len(chosen):
        raise DataError("no mode is sure enough: measure at more positions, or with less noise")
    chosen = chosen[np.argsort(fit.frequencies[chosen], kind="stable")]
    notes = [
        f"Modes of {fit.own.shape[1]} pairs: {len(chosen)} of {int(inside.sum())} calculated from "
        f"{lowest:g} to {highest:g} Hz were heard. Together they leave {fit.unexplained:.1%} of the "
        f"responses' power, and the patterns {fit.strange:.1%} of the amplitudes'."
    ]
    for some, why in (
        (inside & ~sure, "the responses say too little of them"),
        (inside & sure & ~own, "nearer to another calculated mode"),
    ):
        if some.any():
            where = ", ".join(f"{f:.1f}" for f in fit.frequencies[some])
            notes.append(f"Left out, since {why}: {where} Hz.")
    decays = np.exp(log_decay[chosen])
    return MeasuredModes(
        frequencies=fit.frequencies[chosen],
        decays=decays,
        decay_uncertainty=relative[chosen] * decays,
        frequency_uncertainty=np.maximum(_INFLATED * np.sqrt(variance[chosen]), 1e-3),
        amplitudes=size * fit.own[chosen],
        calculated=chosen,
        largest=largest,
        notes=notes,
    )


def _own(fit: Point) -> NDArray[np.bool_]:
    """Return which modes are nearest to their own calculated one, by frequency and pattern."""
    psi, heard, n = fit.psi, fit.own, len(fit.own)
    common = np.abs(heard.conj() @ psi.T) ** 2
    whole = np.outer(*((np.abs(a) ** 2).sum(axis=1) for a in (heard, psi)))
    missed = 1 - common / np.maximum(whole, 1e-300)
    off = (fit.frequencies[:, np.newaxis] - fit.prior[:n]) / fit.spread[:n]
    return np.asarray((off**2 + missed / AMPLITUDE**2).argmin(axis=1) == np.arange(n))
