"""Modes of impulse responses: a room's own poles and patterns, fitted to all positions together.

Where modes overlap, responses alone do not say how many there are. The room does: its calculated modes
have poles s_n and patterns psi_nr at the pairs r of positions (`rtcal.modes.model`). Their spectra are

    Y_r(w) = sum_n A_nr / (j w - s_n) + conj(A_nr) / (j w - conj(s_n)) + error,

in the form of what samples of finite length have. Unknown are the poles, with the calculated ones as
prior, and the amplitudes, with A_nr = q(f_n) psi_nr as prior; q, the source's spectrum, is smooth and
follows from the amplitudes themselves. A scan finds the factor that all calculated frequencies
share. Gauss-Newton steps with Levenberg's damping then fit everything. The amplitudes of all pairs have
one information matrix, and fall out of the poles' (variable projection; Golub & Pereyra 1973).

What is returned of each mode is what the responses say of it: its posterior, less its own prior. A mode
of which they say too little is left out, and so is one that is nearer to another calculated mode.

References
----------
Golub & Pereyra 1973, SIAM J. Numer. Anal. 10; Kay 1993, Fundamentals of Statistical Signal Processing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.room import Room
from rtcal.errors import DataError
from rtcal.io.sofa import Responses
from rtcal.modes.matching import COMMON_ERROR, frequency_error
from rtcal.modes.measured import MeasuredModes
from rtcal.modes.model import ABOVE, RoomPoles
from rtcal.modes.room_modes import RoomModes
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.types import Array

Complex = NDArray[np.complex128]

LEAST_PAIRS = 2
LARGEST_ERROR = 0.5
"""Largest relative uncertainty of a decay that is used."""
UNEXPLAINED = 0.2
"""Share of the responses' power, or of the amplitudes', from which these are not the room's modes.

In eight rooms with their own positions at most 5 % of the amplitudes' were unexplained. With receivers
exchanged or a time axis 20 ms late it was 36 % or more.
"""
_AMPLITUDE = 0.3
"""Relative standard deviation of an amplitude at a pair: positions, the walls' effect on the shape."""
_DECAY = 0.5
"""Standard deviation of the logarithm of a calculated decay, while the walls are not calibrated."""
_INFLATED = 1.5
"""Uncertainty over what independent errors would give: what the modes leave is no white noise."""
_SMOOTH = 20.0
"""Hz over which the source's spectrum is smooth."""
_LOCAL = 8.0
"""Hz on either side over which the error of the fit is averaged."""
_SCALES = 41
_STEPS = 25
_CLIPPED = 4
"""Samples in a row at the largest value from which a response is clipped."""
_LEAST_RANGE = 15.0
"""dB between the first eighth of the responses and their last eighth, within the frequencies sought."""


@checked
def find_modes(
    room: Room,
    responses: Array,
    rate: float,
    pairs: Sequence[tuple[str, str]],
    *,
    lowest: float = 20.0,
    highest: float = 150.0,
    geometry: Polyhedron | None = None,
    room_modes: RoomModes | None = None,
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
    room_modes : RoomModes, optional
        Modes that were calculated before, up to 1.08 times ``highest`` or above.

    Raises
    ------
    DataError
        For fewer than two pairs, a shape or value that breaks its rule, a clipped response, noise that
        leaves no decay, responses that the room's modes do not explain, or no mode that is sure enough.

    Examples
    --------
    >>> import rtcal as rt
    >>> walls = rt.simulators.geometry.SHOEBOX_WALLS
    >>> box = rt.simulators.Polyhedron.shoebox((5.2, 4.1, 2.6), dict(zip(walls, walls)))
    >>> scene = rt.Scene(sources={"S": (0, 0, 0)}, receivers={"R1": (5, 4, 0), "R2": (5, 0, 0)})
    >>> materials = [rt.Material(w, [0.1], [0.05]) for w in walls]
    >>> room = rt.Room.from_geometry(box, name="box", materials=materials, centre_frequencies=[63],
    ...                              dimensions=(5.2, 4.1, 2.6), air=rt.Air(20, 50))
    >>> t = np.arange(1600) / 800
    >>> one, other = (np.exp(-d * t) * np.sin(2 * np.pi * f * t) / f for f, d in ((33, 4), (41.8, 5)))
    >>> heard = np.array([other - one, -one - other])
    >>> pairs = [("S", "R1"), ("S", "R2")]
    >>> modes = find_modes(room.replace(scene=scene), heard, 800, pairs, lowest=25, highest=45)
    >>> print(modes.frequencies.round(1), modes.decays.round(1), modes.calculated)
    [33.  41.8] [4. 5.] [0 1]
    """
    pairs = checks.pairs("pairs", pairs)
    signals = _checked(responses, rate, pairs, lowest, highest)
    model = RoomPoles.of(room, ABOVE * highest, geometry=geometry, room_modes=room_modes)
    heard = _Spectra.of(signals, rate, lowest, highest)
    fit = _fitted(heard, model, pairs)
    if max(fit.unexplained, fit.strange) > UNEXPLAINED:
        raise DataError(
            f"the room's modes leave {fit.unexplained:.0%} of the responses' power unexplained, and "
            f"{fit.strange:.0%} of the amplitudes over the positions: check dimensions, positions, "
            "temperature and that the time axis begins as the sound does"
        )
    return _told(fit, model, pairs, lowest, highest)


def modes_in(
    room: Room,
    responses: Responses,
    *,
    geometry: Polyhedron | None = None,
    room_modes: RoomModes | None = None,
) -> MeasuredModes:
    """Return the modes of a SOFA file's responses, of the first channel; errors as `find_modes`.

    A pair that was measured several times counts once.
    """
    first: dict[tuple[str, str], Array] = {}
    for pair, samples in zip(responses.pairs, responses.samples, strict=True):
        first.setdefault(pair, samples[0])
    heard = np.array([*first.values()])
    rate = responses.sampling_rate
    return find_modes(room, heard, rate, [*first], geometry=geometry, room_modes=room_modes)


def _checked(
    responses: Array, rate: float, pairs: Sequence[tuple[str, str]], lowest: float, highest: float
) -> Array:
    signals = checks.array("responses", responses)
    rate = checks.positive("rate", rate, "Hz")
    if signals.ndim != 2 or signals.shape[0] != len(pairs):
        raise DataError(
            f"responses has shape {signals.shape}; with {len(pairs)} pairs it is ({len(pairs)}, "
            "n_samples)"
        )
    if len(pairs) < LEAST_PAIRS:
        raise DataError(
            f"responses has {len(pairs)} pair; modes need {LEAST_PAIRS}, of different positions"
        )
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
        top = np.abs(signal).max()
        if top == 0:
            raise DataError(f"the response of {' to '.join(pair)} is silent")
        at_top = (np.abs(signal) >= top * (1 - 1e-9)).astype(int)
        if (np.convolve(at_top, np.ones(_CLIPPED, dtype=int), "valid") == _CLIPPED).any():
            raise DataError(f"the response of {' to '.join(pair)} is clipped")
    return signals


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Spectra of the responses: ``values`` (n_bins, n_pairs) at ``omega`` in 1/s, and their noise.

    ``noise`` is the variance of the real part of a bin.
    """

    values: Complex
    omega: Array
    noise: float
    samples: int
    step: float

    @classmethod
    def of(cls, signals: Array, rate: float, lowest: float, highest: float) -> _Spectra:
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
        return cls(spectra.T, 2 * np.pi * f[inside], noise, n, 1 / rate)

    def kernel(self, poles: Complex) -> tuple[Complex, Complex]:
        """Return the spectra of exp(s t) and their derivatives by s, each (n_bins, n_poles)."""
        n, dt = self.samples, self.step
        step = np.exp((poles - 1j * self.omega[:, np.newaxis]) * dt)
        last = np.exp(poles * dt * n) * np.exp(-1j * self.omega * dt * n)[:, np.newaxis]
        value = (1 - last) / (1 - step)
        return value, dt * (step * value - n * last) / (1 - step)

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
class _Fit:
    """Poles that were fitted: frequency in Hz, decay's logarithm, amplitudes (n_poles, n_pairs)."""

    frequencies: Array
    log_decays: Array
    amplitudes: Complex
    prior: Array
    covariance: Array
    scale: float
    unexplained: float
    strange: float


def _fitted(heard: _Spectra, model: RoomPoles, pairs: Sequence[tuple[str, str]]) -> _Fit:
    poles = model.calculated
    psi = model.amplitudes(pairs)
    spread = np.concatenate(
        [frequency_error(poles.frequencies, poles.decays), np.full(len(psi), _DECAY)]
    )
    scale, amplitudes = _scanned(heard, poles.values, psi)
    prior = np.concatenate([scale * poles.frequencies, np.log(poles.decays)])
    problem = _Problem(heard, psi, prior, spread)
    at, damping = prior.copy(), 1e-2
    for _ in range(_STEPS):
        weighed = problem.weighed(at, amplitudes)
        now, settled = weighed.misfit(at, amplitudes), True
        for _ in range(6):
            move, more = weighed.step(damping)
            if np.abs(move[len(psi) :]).max() < 2:
                fallen = now - weighed.misfit(at + move, amplitudes + more)
                if fallen > 0:
                    at, amplitudes, settled = at + move, amplitudes + more, fallen < 0.5
                    break
            damping *= 10
        damping = max(damping / 10, 1e-8)
        if settled:
            break
    weighed = problem.weighed(at, amplitudes)
    off = problem.off(at, amplitudes)
    within = at[: len(psi)] <= heard.omega[-1] / (2 * np.pi)
    return _Fit(
        frequencies=at[: len(psi)],
        log_decays=at[len(psi) :],
        amplitudes=amplitudes,
        prior=prior,
        covariance=np.linalg.inv(weighed.reduced(0.0)[0]),
        scale=scale,
        unexplained=_share(off, heard.values),
        strange=_share((amplitudes - weighed.expected)[within], amplitudes[within]),
    )


def _share(part: Complex, whole: Complex) -> float:
    """Return the power of a part over that of the whole."""
    return float((np.abs(part) ** 2).sum() / max((np.abs(whole) ** 2).sum(), 1e-300))


def _scanned(heard: _Spectra, poles: Complex, psi: Complex) -> tuple[float, Complex]:
    """Return the factor of all frequencies under which the patterns explain most, and amplitudes."""
    best = (np.inf, 1.0, psi)
    gram = psi.conj() @ psi.T
    total = float((np.abs(heard.values) ** 2).sum())
    for scale in 1 + 2.5 * COMMON_ERROR * np.linspace(-1, 1, _SCALES):
        value, _ = heard.kernel(poles.real + 1j * scale * poles.imag)
        matrix = gram * (value.conj().T @ value) / 4
        matrix[np.diag_indices(len(psi))] *= 1 + 1e-3
        right = (psi.conj() * (value.conj().T @ heard.values)).sum(axis=1) / 2
        q = np.linalg.solve(matrix, right)
        left = max(total - float((right.conj() @ q).real), 1e-12 * total)
        # As if an eighth of all bins were independent: the misfit is the model's.
        cost = heard.values.size / 4 * np.log(left) + ((scale - 1) / COMMON_ERROR) ** 2
        if cost < best[0]:
            best = (float(cost), float(scale), q[:, np.newaxis] * psi)
    return best[1], best[2]


@dataclass(frozen=True, eq=False)
class _Problem:
    """The least squares of poles (frequencies, then logarithms of decays) and amplitudes."""

    heard: _Spectra
    psi: Complex
    prior: Array
    spread: Array

    def parts(self, at: Array) -> tuple[Complex, Complex, Complex, Complex]:
        """Return kernels of the poles and of their conjugates, and their derivatives."""
        n = len(self.psi)
        poles = -np.exp(at[n:]) + 2j * np.pi * at[:n]
        value, slope = self.heard.kernel(poles)
        other, other_slope = self.heard.kernel(poles.conj())
        return value / 2, other / 2, slope / 2, other_slope / 2

    def off(self, at: Array, amplitudes: Complex) -> Complex:
        """Return what the modes leave of the spectra, (n_bins, n_pairs)."""
        value, other, _, _ = self.parts(at)
        return np.asarray(self.heard.values - value @ amplitudes - other @ amplitudes.conj())

    def weighed(self, at: Array, amplitudes: Complex) -> _Weighed:
        """Return the problem around a point, with the errors and the source's spectrum there."""
        near = np.exp(-(((at[: len(self.psi), np.newaxis] - at[: len(self.psi)]) / _SMOOTH) ** 2))
        power = (np.abs(self.psi) ** 2).sum(axis=1)
        q = near @ (self.psi.conj() * amplitudes).sum(axis=1) / (near @ power)
        size = np.abs(q) * np.sqrt(power / self.psi.shape[1])
        return _Weighed(
            problem=self,
            at=at,
            amplitudes=amplitudes,
            expected=q[:, np.newaxis] * self.psi,
            ridge=1 / np.maximum(_AMPLITUDE * size, 1e-9 * size.max()) ** 2,
            weight=1 / np.sqrt(self.heard.local(self.off(at, amplitudes))),
        )


@dataclass(frozen=True, eq=False)
class _Weighed:
    """The problem, linearised at a point: ``weight`` of each bin, ``ridge`` of each amplitude."""

    problem: _Problem
    at: Array
    amplitudes: Complex
    expected: Complex
    ridge: Array
    weight: Array

    def misfit(self, at: Array, amplitudes: Complex) -> float:
        """Return the weighed squares of what is left, of amplitudes and of poles."""
        p = self.problem
        left = np.abs(p.off(at, amplitudes)) ** 2 * self.weight[:, np.newaxis] ** 2
        far = np.abs(amplitudes - self.expected) ** 2 * self.ridge[:, np.newaxis]
        return float(left.sum() + far.sum() + (((at - p.prior) / p.spread) ** 2).sum())

    def reduced(self, damping: float) -> tuple[Array, Array, Array, list[Array], list[Array]]:
        """Return matrix and right side of the poles, without the amplitudes, and these' own."""
        p, n = self.problem, len(self.ridge)
        value, other, slope, other_slope = p.parts(self.at)

        def real(columns: Complex) -> Array:
            weighed = columns * self.weight[:, np.newaxis]
            return np.concatenate([weighed.real, weighed.imag])

        of_amplitudes = real(np.hstack([value + other, 1j * (value - other)]))
        own = of_amplitudes.T @ of_amplitudes
        own[np.diag_indices(2 * n)] += np.tile(self.ridge, 2)
        own[np.diag_indices(2 * n)] *= 1 + damping
        matrix, right = np.diag(p.spread**-2), (p.prior - self.at) / p.spread**2
        off = real(p.off(self.at, self.amplitudes))
        far = (self.expected - self.amplitudes) * self.ridge[:, np.newaxis]
        across, sides = [], []
        for r, a in enumerate(self.amplitudes.T):
            one, two = slope * a, other_slope * a.conj()
            of_poles = real(
                np.hstack([2j * np.pi * (one - two), -np.exp(self.at[n:]) * (one + two)])
            )
            matrix = matrix + of_poles.T @ of_poles
            right = right + of_poles.T @ off[:, r]
            across.append(of_amplitudes.T @ of_poles)
            sides.append(
                of_amplitudes.T @ off[:, r] + np.concatenate([far[:, r].real, far[:, r].imag])
            )
        matrix[np.diag_indices(2 * n)] *= 1 + damping
        inverse = np.linalg.inv(own)
        for c, side in zip(across, sides, strict=True):
            matrix = matrix - c.T @ inverse @ c
            right = right - c.T @ inverse @ side
        return (matrix + matrix.T) / 2, right, inverse, across, sides

    def step(self, damping: float) -> tuple[Array, Complex]:
        """Return the damped step of poles and amplitudes."""
        matrix, right, inverse, across, sides = self.reduced(damping)
        move = np.linalg.solve(matrix, right)
        more = np.stack(
            [inverse @ (s - c @ move) for c, s in zip(across, sides, strict=True)], axis=1
        )
        n = len(self.ridge)
        return move, more[:n] + 1j * more[n:]


def _told(
    fit: _Fit,
    model: RoomPoles,
    pairs: Sequence[tuple[str, str]],
    lowest: float,
    highest: float,
) -> MeasuredModes:
    """Return what the responses say of each mode, without what was believed of it before."""
    n = len(fit.frequencies)
    variance = np.diag(fit.covariance)
    after, before = variance[n:], _DECAY**2
    precision = np.maximum(1 / after - 1 / before, 1e-9)
    log_decay = (fit.log_decays / after - fit.prior[n:] / before) / precision
    relative = _INFLATED / np.sqrt(precision)
    sure = relative < LARGEST_ERROR
    own = _own(fit, model, pairs)
    inside = (fit.frequencies >= lowest) & (fit.frequencies <= highest)
    chosen = np.flatnonzero(sure & own & inside)
    if not len(chosen):
        raise DataError("no mode is sure enough: measure at more positions, or with less noise")
    chosen = chosen[np.argsort(fit.frequencies[chosen], kind="stable")]
    notes = [
        f"Modes of {len(pairs)} pairs: {len(chosen)} of {int(inside.sum())} calculated from "
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
        pairs=pairs,
        amplitudes=fit.amplitudes[chosen],
        calculated=chosen,
        largest=model.modes.largest,
        notes=notes,
    )


def _own(fit: _Fit, model: RoomPoles, pairs: Sequence[tuple[str, str]]) -> NDArray[np.bool_]:
    """Return which modes are nearest to their own calculated one, by frequency and pattern."""
    psi, heard = model.amplitudes(pairs), fit.amplitudes
    common = np.abs(heard.conj() @ psi.T) ** 2
    whole = np.outer(*((np.abs(a) ** 2).sum(axis=1) for a in (heard, psi)))
    missed = 1 - common / np.maximum(whole, 1e-300)
    poles = model.calculated
    spread = frequency_error(poles.frequencies, poles.decays)
    off = (fit.frequencies[:, np.newaxis] - fit.prior[: len(psi)]) / spread
    return np.asarray((off**2 + missed / _AMPLITUDE**2).argmin(axis=1) == np.arange(len(psi)))
