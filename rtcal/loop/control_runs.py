"""The simulator's own error, from control runs in the room's own geometry; and its scattering.

A control run is a path tracing of the same room in which everything differs that is not known: how the
walls scatter, where exactly sources and receivers stand, the random numbers, and alpha, which is drawn
from the prior. Its values less the simulator's for the same alpha are an error as the simulator may
have against the real room. The covariance of these errors says how far to trust it.

Nobody states how a room scatters as a tracer takes it. The traced paths tell how every observation
depends on the scattering of each material (`PathTracing.scattering_jacobian`). So the scattering
coefficients are unknowns as alpha is, with a wide prior around those stated. A first linear step fits
them to what was measured. The room is traced once more with them, and the calibration's steps move them
on from there.

Control runs differ in scattering, too. They tell what the other meaning of the coefficients adds, and
which error is left: it is larger where less is scattered. The noise of the control runs is no part of
it. In five development rooms the log-likelihood of what was measured was 9 to 21 nats higher without
that noise, and with the likeliest scale of the error. In eight it was 15 nats higher in sum with errors
that grow where little is scattered, and runs far from the line counting less.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from rtcal.acoustics import bands, observables
from rtcal.acoustics.observables import REVERBERATION
from rtcal.acoustics.room import POSITION, Room, checked_uncertainty, plain_directivities
from rtcal.files import disk
from rtcal.simulators.base import Observations, Simulator, complete, observe
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import DENSER, PathTracing, ScatteringModel, eyring_seconds
from rtcal.support import __version__, checks
from rtcal.support.errors import DataError, RtcalError, TooShortError
from rtcal.support.speed import Progress
from rtcal.support.types import Array

RUNS = 16
"""Traces for the control runs."""
SCATTERING = (0.1, 0.85)
"""Scattering coefficients of the control runs: those of ordinary walls and furniture."""
MODELS: tuple[ScatteringModel, ...] = ("random", "vector")
_BETWEEN_MATERIALS = 0.12
"""Standard deviation of the materials' scattering coefficients around the level of a run."""
_PATHS = 6000
"""Most paths of a control run, per source, `DENSER` times as many where they are thinned."""

Simulated = Callable[[Simulator, Array, int], Array]
"""The values of a simulator in another state of the room, (n_parameters, n_pairs, n_bands): for alpha
(n_materials, n_bands) before the change, and a seed."""
AHEAD = 3.0
"""How many times Eyring's T of the prior the paths of a simulator are followed. In ten development
rooms T20 of the control runs' draws needed up to 2.2 times as much, in 40 rooms of other seeds at most
3 times but for one."""
_FIRST = 8.0
"""How many times Eyring's T the first run of each model follows the decays; it scatters least. The
others scatter more and more, and follow them for as long as the four before needed."""
_SPARE = 1.5
"""By how much longer, since T differs between runs; also the least that is followed."""
_LEFT_OUT = 4
"""Most runs that are left out because their decays are longer still. They would be traced twice. In two
of 20 boxes with little scattering T20 of a run was above 12 times Eyring's T."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlRuns:
    """Errors of a simulator in control runs.

    Attributes
    ----------
    parameters, pairs : tuple
        As in `rtcal.simulators.base.Observations`.
    errors : array (n_runs, n_parameters, n_pairs, n_bands)
        Values of a control run less the simulator's for the same alpha.
    levels : array (n_runs,), optional
        Mean scattering coefficient of each run over the surfaces, by area.
    models : tuple of str (n_runs,)
        Scattering model of each run.
    more_paths : int
        How many times the paths of a calibration's control runs they have; see `simulated_controls`.
    """

    parameters: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    errors: Array
    levels: Array | None = None
    models: tuple[ScatteringModel, ...] = ()
    more_paths: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", checks.texts("parameters", self.parameters))
        object.__setattr__(self, "pairs", checks.pairs("pairs", self.pairs))
        object.__setattr__(self, "models", checks.texts("models", self.models))
        checks.whole("more_paths", self.more_paths, 1)
        shape = ("n_runs", len(self.parameters), len(self.pairs), "n_bands")
        errors = checks.shaped("errors", self.errors, *shape)
        if len(errors) < 2 or not np.isfinite(errors).all():
            raise DataError(
                f"errors of {len(errors)} runs: they are finite, and of at least 2 runs"
            )
        object.__setattr__(self, "errors", errors)
        if self.levels is None:
            return
        object.__setattr__(self, "levels", checks.shaped("levels", self.levels, len(errors)))
        if len(self.models) != len(errors):
            raise DataError(f"models has {len(self.models)} texts; there are {len(errors)} runs")

    def __repr__(self) -> str:
        return f"<ControlRuns: {len(self.errors)} runs, {len(self.pairs)} pairs>"

    def at(self, parameters: Sequence[str], pairs: Sequence[tuple[str, str]]) -> ControlRuns:
        """Return the errors of some parameters and pairs; DataError if one is missing."""
        if missing := [p for p in parameters if p not in self.parameters] or [
            " to ".join(p) for p in pairs if p not in self.pairs
        ]:
            raise DataError(f"the control runs lack {missing[0]}: they belong to another simulator")
        rows = [self.parameters.index(p) for p in parameters]
        columns = [self.pairs.index(p) for p in pairs]
        return replace(
            self,
            parameters=tuple(parameters),
            pairs=tuple(pairs),
            errors=self.errors[:, rows][:, :, columns],
        )

    def covariance(self) -> Array:
        """Return the covariance of the simulator's error, (n, n), n = parameters x pairs x bands.

        It is the mean of the products of the errors, so it counts their mean, too: coefficients are
        calibrated for the simulator as it is. The runs are far fewer than the values. So it is drawn
        towards a covariance in which all pairs are alike: a part that is common to all pairs and a
        part of each pair, each the product of a covariance between parameters and a correlation
        between bands.
        """
        rows = self.errors.reshape(len(self.errors), -1)
        return np.asarray(_SHRINKAGE * self.alike() + (1 - _SHRINKAGE) * rows.T @ rows / len(rows))

    def alike(self) -> Array:
        """Return the covariance, (n, n), in which all pairs are alike."""
        _, n_parameters, n_pairs, n_bands = self.errors.shape
        common = self.errors.mean(axis=2, keepdims=True)
        between = _product(common)
        within = _product((self.errors - common) * np.sqrt(n_pairs / max(n_pairs - 1, 1)))
        every, each = np.ones((n_pairs, n_pairs)), np.eye(n_pairs)
        full = np.einsum("pkql,ij->pikqjl", between, every)
        # The mean over the pairs holds 1 / n_pairs of each pair's part.
        full += np.einsum("pkql,ij->pikqjl", within, each - every / n_pairs)
        return np.asarray(full.reshape(n_parameters * n_pairs * n_bands, -1))

    def without_noise(self, noise: Array) -> ControlRuns:
        """Return the errors scaled to the variance that they have without the runs' own noise.

        Parameters
        ----------
        noise : array (n_parameters, n_bands)
            Variance of one pair of one run by the paths of a calibration's. Each pair has its own.
        """
        noise = noise / self.more_paths
        n_pairs = self.errors.shape[2]
        common = self.errors.mean(axis=2)
        own = self.errors - common[:, :, np.newaxis]
        of_common = share_of_signal((common**2).mean(axis=0), noise / n_pairs)
        of_own = share_of_signal((own**2).mean(axis=(0, 2)), noise * (1 - 1 / n_pairs))
        left = [np.sqrt(np.maximum(of, _LEAST))[:, np.newaxis] for of in (of_common, of_own)]
        return replace(self, errors=common[:, :, np.newaxis] * left[0] + own * left[1])

    def with_common(self, factor: float) -> ControlRuns:
        """Return the errors with their mean over the pairs times a factor."""
        common = self.errors.mean(axis=2, keepdims=True)
        return replace(self, errors=self.errors - (1 - factor) * common)


_LEAST = 0.1
"""Share of a variance that is left at least where noise is taken off."""


def share_of_signal(square: Array, noise: Array) -> Array:
    """Return which share of mean squares is not noise, 0 where noise is all of it.

    It is signal over signal and noise (James & Stein 1961, with the variances estimated).
    """
    share = np.divide(noise, square, out=np.ones_like(square), where=square > noise)
    return np.asarray(1 - share)


_SHRINKAGE = 0.7
"""Share of the covariance in which all pairs are alike. From 0.5 to 1 the median error of alpha in
twelve development rooms changed by 4 %, the coverage of the interval by 0.5 %."""


def _product(errors: Array) -> Array:
    """Return the separable covariance, (parameters, bands, parameters, bands), of (runs, p, i, k)."""
    deviation = np.sqrt((errors**2).mean(axis=(0, 2)))  # (p, k)
    z = errors / np.where(deviation > 0, deviation, 1.0)[:, np.newaxis]
    samples = z.shape[0] * z.shape[2]
    parameters = np.einsum("npik,nqik->pq", z, z) / (samples * z.shape[3])
    of_bands = np.einsum("npik,npil->kl", z, z) / (samples * z.shape[1])
    return np.asarray(np.einsum("pk,pq,kl,ql->pkql", deviation, parameters, of_bands, deviation))


def simulated_controls(
    simulator: Simulator,
    room: Room,
    match: Sequence[str],
    *,
    seed: int = 0,
    position_uncertainty: float = POSITION,
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    after: Sequence[tuple[Sequence[str], Simulated]] = (),
    more_paths: int = 1,
) -> ControlRuns | None:
    """Return the errors of a simulator in `RUNS` control runs; None if it has no geometry to trace.

    `PathTracing`, `ScatteringDelayNetwork` and `ImageSource` have one.

    Parameters
    ----------
    simulator : Simulator
    room : Room
        Alpha is drawn from its prior.
    match : sequence of str
    seed : int
        Of the paths. What is not known is drawn alike for every seed.
    position_uncertainty : float
        Root mean square distance of sources and receivers from where they are stated, in m.
    cache : path, optional
        Folder in which the errors are kept, by a hash of everything they depend on.
    progress : callable, optional
        Called with the number of finished runs and their total.
    after : sequence of (names, callable)
        Further states of the room, simulated in the same runs: the values there stand behind
        ``match``, by these names. Nothing is kept in the ``cache`` then.
    more_paths : int
        Factor of the number of paths of the runs, and of a simulator that traces paths.
    """
    uncertainty = checked_uncertainty(position_uncertainty)
    tracing = complete(simulator).tracing
    if tracing is None:
        return None
    base: PathTracing = tracing.denser()
    n_paths = more_paths * paths_of_a_run(base)
    base = base.denser(more_paths)
    traced = tracing is simulator
    if traced:
        simulator = base
    path = None
    if cache is not None and not after:
        key = _key(base, simulator, room, match, seed, uncertainty, n_paths)
        path = checks.path("cache", cache) / f"{key}.array"
    # What is not known is drawn alike for every seed, as the nodes of a quadrature: the paths alone
    # depend on the seed.
    rng = np.random.default_rng(20)
    correlation = bands.correlation(room.centre_frequencies, room.band_correlation)
    root = np.linalg.cholesky(correlation + 1e-10 * np.eye(room.n_bands)).T
    drawn = []
    for run in range(RUNS):
        varied = _varied(base, rng, run, uncertainty, n_paths)
        alpha = room.alpha + room.sigma * (rng.standard_normal(room.alpha.shape) @ root)
        drawn.append((varied, np.clip(alpha, 0.001, 0.99)))
    names = (*match, *(name for named, _ in after for name in named))
    shape = (len(names), len(base.pairs), base.room.n_bands)

    def runs(errors: Array) -> ControlRuns:
        kept = [i for i, of_run in enumerate(errors) if not np.isnan(of_run).all()]
        return ControlRuns(
            parameters=names,
            pairs=base.pairs,
            errors=errors[kept],
            levels=np.array(
                [level(drawn[i][0]["scattering"][:, np.newaxis], room.areas) for i in kept]
            ),
            models=tuple(drawn[i][0]["scattering_model"] for i in kept),
            more_paths=more_paths,
        )

    kept = None if path is None else disk.read(path)
    if kept is not None and kept.shape == (RUNS, *shape):
        with suppress(RtcalError):  # another's file
            return runs(kept)

    def error(
        control: PathTracing, alpha: Array, of_run: int, again: bool
    ) -> tuple[Observations, Array]:
        found = control.observe(alpha, match, seed=of_run, again=again)
        if traced:
            values = base.observe(alpha, match, seed=seed, again=again).values
        else:
            values = observe(simulator, alpha, match, seed=seed).values
        more = [
            values_of(control, alpha, of_run) - values_of(simulator, alpha, seed)
            for _, values_of in after
        ]
        return found, np.concatenate([found.values - values, *more])

    trace_ahead(simulator, room.alpha, seed)
    errors, factors, left_out = [], list[float](), 0
    for run, (varied, alpha) in enumerate(drawn):
        control, of_run = replace(base, **varied), seed + 1 + run  # one run's paths at a time
        ahead = _FIRST if run < len(MODELS) else max(factors[-4:], default=_FIRST)
        control.trace_ahead(alpha, ahead, seed=of_run)
        again = left_out == _LEFT_OUT
        try:
            try:
                found, difference = error(control, alpha, of_run, again)
            except DataError:  # some draws leave a decay without a parameter
                alpha = room.alpha
                found, difference = error(control, alpha, of_run, again)
            factors.append(ahead_factor(match, found.values, control, alpha))
        except (TooShortError, DataError):
            # The paths of a run may be too few, or a place too near a source for an EDT.
            if again:
                raise
            difference, left_out = np.full(shape, np.nan), left_out + 1
        errors.append(difference)
        if progress is not None:
            progress(run + 1, RUNS)
    made = np.array(errors)
    if path is not None:
        disk.write(path, made)
    return runs(made)


GROUPS = 4
"""Groups of paths whose differences tell the noise of a control run."""


def noise_of_a_run(simulator: Any, groups: Array | None) -> Array:
    """Return the variance of a control run's values by its finite paths, (n_parameters, n_bands).

    ``groups`` (n_groups, p, i, k) are the values of groups of the simulator's paths; None for none.
    """
    if groups is None:
        return np.zeros(1)
    of_group = groups.var(axis=0, ddof=1).mean(axis=1)
    return np.asarray(of_group * simulator.n_paths / GROUPS / paths_of_a_run(simulator))


def ahead_factor(
    parameters: Sequence[str], values: Array, tracer: PathTracing, alpha: Array
) -> float:
    """Return how many times Eyring's T decays are followed, so that they hold T20 or T30.

    ``values`` (n_parameters, n_pairs, n_bands) are expected.
    """
    times = [
        kind.natural(of).max() * (observables.MARGIN_DB - kind.lower) / 60
        for name, of in zip(parameters, values, strict=True)
        for kind in REVERBERATION
        if kind.key == name
    ]
    return _SPARE * max(max(times, default=0.0) / eyring_seconds(tracer.room, alpha), 1.0)


def trace_ahead(simulator: Simulator, alpha: Array, seed: int) -> None:
    """Trace paths that are long enough for other draws of alpha, too."""
    complete(simulator).trace_ahead(alpha, AHEAD, seed=seed)


def _varied(
    base: PathTracing, rng: np.random.Generator, run: int, uncertainty: float, n_paths: int
) -> dict[str, Any]:
    """Return what differs in a run: scattering and its model, positions, and the number of paths."""
    low, high = SCATTERING
    mean = low + (high - low) * (run // 2 + rng.uniform()) / (RUNS / 2)
    stated = base.scattering.mean(axis=1, keepdims=True)
    around = np.clip(stated + mean - level(stated, base.room.areas), 0.0, 1.0)[:, 0]
    by_material = around + _BETWEEN_MATERIALS * rng.standard_normal(base.room.n_materials)
    sources, receivers = (
        {
            name: _moved(base.geometry, np.array(point), rng, uncertainty)
            for name, point in points.items()
        }
        for points in (base.sources, base.receivers)
    )
    return {
        "scattering": np.clip(by_material, low, high),
        "scattering_model": MODELS[run % 2],
        "sources": sources,
        "receivers": receivers,
        "n_paths": n_paths,
    }


def paths_of_a_run(tracer: PathTracing) -> int:
    """Return the number of paths per source of the control runs of a tracing."""
    return min(_PATHS if tracer.thinned is None else DENSER * _PATHS, tracer.n_paths)


def level(scattering: Array, areas: Array) -> float:
    """Return the mean of scattering coefficients (n_materials, n_bands) over the areas."""
    return float(np.average(scattering.mean(axis=1), weights=areas))


def _moved(
    geometry: Polyhedron, point: Array, rng: np.random.Generator, uncertainty: float
) -> Array:
    """Return the point moved by about ``uncertainty``, within the room."""
    for _ in range(20):
        trial = point + uncertainty / np.sqrt(3) * rng.standard_normal(3)
        if geometry.contains([trial])[0] and geometry.wall_distance([trial])[0] > 0.01:
            return np.asarray(trial)
    return point


def _key(
    base: PathTracing,
    simulator: Simulator,
    room: Room,
    match: Sequence[str],
    seed: int,
    uncertainty: float,
    n_paths: int,
) -> str:
    """Return a hash of all that the errors depend on."""
    settings = {
        name: value
        for name, value in vars(simulator).items()
        if isinstance(value, (int, float, str, bool, type(None)))
    }
    of_room = [room.to_dict()[name] for name in ("alpha", "sigma", "centre_frequencies", "air")]
    numbers = [seed, uncertainty, RUNS, n_paths, room.band_correlation]
    return key_of(base, simulator.name, settings, of_room, list(match), numbers)


def key_of(tracer: PathTracing, *content: object) -> str:
    """Return a hash of a tracing's geometry, positions and scattering, and of further content."""
    geometry, points = tracer.geometry, {**tracer.sources, **tracer.receivers}
    every = [
        __version__,
        geometry.vertices.tolist(),
        [list(map(int, face)) for face in geometry.faces],
        list(geometry.materials),
        {name: list(map(float, point)) for name, point in points.items()},
        np.asarray(tracer.scattering).tolist(),
        plain_directivities(tracer.directivity),
        *content,
    ]
    return hashlib.sha256(json.dumps(every, sort_keys=True).encode()).hexdigest()[:32]


OWN, COMMON = 0.8, 1.0
"""Standard deviations of the log odds ln(s / (1 - s)): of a material's from the mean of all, and of
that mean from what is stated. Around 0.4 each leaves 0.23 to 0.60 within one deviation."""
_MOST = 3.0
"""Largest change of the log odds: from 0.4 to 0.03 or 0.93."""
COMMON_LEFT = 0.2
"""Share of the variance common to all pairs that is left, as materials' scattering counts apart. In
thirteen rooms the gap at held-out pairs was 0.73 times that of T20 alone with all of it, 0.68 with 0.4
and 0.66 with 0.2; the median error of alpha 0.92, 0.92 and 0.88 times."""
DIGITS = 1
"""To which log odds are rounded before the room is traced: nearly the same data then have the same
paths."""
_COEFFICIENTS = 3
"""Of every value's dependence on scattering: a constant, one for the other model, and a slope. In ten
development rooms polynomials of degree 2 for each model predicted unfitted pairs less well."""
_PASSES = 2
"""Times that the weights of the control runs are found anew."""
_POWERS = (-4.0, 0.5)
"""Limits of the power of the level that a variance is proportional to."""
_RIDGE = 0.3
"""Draws the powers towards 0: variance of ln of a run's mean square (1.2) over that of a power (4)."""
_FREEDOM = 4
"""Degrees of freedom of Student's t distribution."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scattering:
    """Scattering of a tracer, fitted with alpha. It is no measurement of the room's.

    Attributes
    ----------
    model : {"random", "vector"}
        Meaning of the coefficients; see `rtcal.simulators.path_tracing.ScatteringModel`.
    coefficients : array (n_materials, n_bands)
    sigma : array (n_materials, n_bands)
        Their posterior standard deviations, linear in the log odds; 0 where they are 0 or 1.
    mean : float
        Mean coefficient over the surfaces, by area.
    limited : tuple of int
        Numbers of the materials whose coefficients moved as far as they may.
    """

    model: ScatteringModel
    coefficients: Array
    sigma: Array
    mean: float
    limited: tuple[int, ...]

    def notes(self, materials: Sequence[str]) -> list[str]:
        """Return what is to be known of it; ``materials`` are the room's."""
        notes = [
            f"Scattering: {self.in_words}, fitted with alpha. It is no measurement: another seed or "
            "more paths may give other coefficients. Of both meanings of the coefficients, random and "
            "vector, the fit takes the one under which the measurement is likelier: here "
            f'"{self.model}".'
        ]
        if self.limited:
            names = ", ".join(materials[i] for i in self.limited)
            notes.append(
                f"The scattering of {names} moved as far as it may: the data do not tell it."
            )
        return notes

    @property
    def in_words(self) -> str:
        """Mean and range of the coefficients, and their meaning."""
        low, high = self.coefficients.min(), self.coefficients.max()
        return f"{self.mean:.2f} in the mean, {low:.2f} to {high:.2f} ({self.model})"


@dataclass(frozen=True, kw_only=True, eq=False)
class MaterialScattering:
    """Sensitivity of every value to the scattering of each material, around the traced one.

    Attributes
    ----------
    slope : array (n, n_materials)
        Derivatives of all values, n = parameters x pairs x bands, by the log odds.
    traced : array (n_materials,)
        Change of the log odds, from those stated to those traced.
    model : {"random", "vector"}
        With which they were traced.
    """

    slope: Array
    traced: Array
    model: ScatteringModel = "random"

    @property
    def prior(self) -> Array:
        """Covariance of the changes of the log odds, (n_materials, n_materials)."""
        n = len(self.traced)
        return np.asarray(OWN**2 * np.eye(n) + COMMON**2)

    @property
    def covariance(self) -> Array:
        """Covariance of the values by the scattering that is not known, (n, n)."""
        return np.asarray(self.slope @ self.prior @ self.slope.T)

    @property
    def back(self) -> Array:
        """Change of the values from the traced scattering to the stated one, (n,)."""
        return np.asarray(-self.slope @ self.traced)

    def likely(self, pull: Array) -> Array:
        """Return the likeliest change of the log odds from those stated, (n_materials,).

        ``pull`` (n,) is the inverse covariance of what was measured times what is left unexplained
        with the scattering stated; 0 where nothing was measured.
        """
        likeliest = self.prior @ (self.slope.T @ pull)
        return np.asarray(np.clip(likeliest, -_MOST, _MOST))

    def posterior(self, used: NDArray[np.int64], covariance: Array) -> Array:
        """Return the standard deviations of the log odds after what was measured, (n_materials,).

        ``covariance`` (n_used, n_used) is that of the values used, with alpha and scattering unknown.
        """
        across = self.slope[used] @ self.prior
        left = self.prior - across.T @ np.linalg.solve(covariance, across)
        return np.asarray(np.sqrt(np.maximum(np.diag(left), 0.0)))


def material_scattering(
    tracer: PathTracing, alpha: Array, parameters: Sequence[str], seed: int
) -> MaterialScattering:
    """Return how the values of a tracer depend on the scattering of each material.

    The differences between pairs are drawn towards their mean as far as they are noise. DataError for
    a tracer with another scattering model than "random".
    """
    groups = tracer.scattering_jacobian(alpha, parameters, number=2, seed=seed)
    slope = groups.mean(axis=0)
    common = slope.mean(axis=1, keepdims=True)
    off = (groups[0] - groups[1]) / 2
    noise = ((off - off.mean(axis=1, keepdims=True)) ** 2).mean(axis=(1, 2, 3), keepdims=True)
    share = share_of_signal(((slope - common) ** 2).mean(axis=(1, 2, 3), keepdims=True), noise)
    return MaterialScattering(
        slope=(common + share * (slope - common)).reshape(-1, slope.shape[-1]),
        traced=np.zeros(slope.shape[-1]),
    )


def scattered(tracer: PathTracing, log_odds: Array, model: ScatteringModel) -> PathTracing:
    """Return the tracer with other coefficients: their log odds are changed by ``log_odds``.

    (n_materials,), the same in all bands. Coefficients of 0 and 1 stay.
    """
    s = tracer.scattering
    odds = np.exp(log_odds)[:, np.newaxis]
    return replace(tracer, scattering=s * odds / (1 - s + s * odds), scattering_model=model)


def fitted(tracer: PathTracing, log_odds: Array, posterior: Array) -> Scattering:
    """Return the scattering of a tracer, whose log odds were changed and have standard deviations.

    Both (n_materials,).
    """
    s = tracer.scattering
    return Scattering(
        model=tracer.scattering_model,
        coefficients=s,
        sigma=s * (1 - s) * posterior[:, np.newaxis],
        mean=level(s, tracer.room.areas),
        limited=tuple(np.flatnonzero(np.abs(log_odds) >= _MOST).tolist()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorsByScattering:
    """The simulator's errors as control runs tell them, by level and model of scattering.

    Attributes
    ----------
    coefficients : array (3, n_parameters, n_pairs, n_bands)
        Of `basis`: straight lines over the level.
    spread : array (3, 3)
        Their covariance over the variance of what is left.
    power : array (n_parameters,)
        Of the level that the variance of what is left is proportional to, which is 1 at ``middle``.
    left, of_coefficients : array (n, n)
        Covariance of what is left of all values, and of that of which the coefficients are uncertain.
    """

    coefficients: Array
    spread: Array
    power: Array
    middle: float
    left: Array
    of_coefficients: Array

    @property
    def of_model(self) -> Array:
        """What the model "vector" adds to every value, (n_parameters, n_pairs, n_bands)."""
        return np.asarray(self.coefficients[1])

    def covariance(self, level: float, model: ScatteringModel) -> Array:
        """Return the covariance of all values at a level of scattering, (n, n)."""
        at = np.clip(level, *SCATTERING)
        row = basis([at], [MODELS.index(model)])[0]
        # What a few runs leave uncertain of the coefficients: the leverage of the level.
        covariance = self.left + row @ self.spread @ row * self.of_coefficients
        deviation = (at / self.middle) ** (self.power / 2)
        each = np.repeat(deviation, len(covariance) // len(deviation))
        return np.asarray(each[:, np.newaxis] * covariance * each)


def errors_by_scattering(controls: ControlRuns, noise: Array) -> ErrorsByScattering | None:
    """Return how the errors of control runs depend on scattering, by weighted least squares.

    None if the runs are too few, or do not differ in scattering. ``noise`` (n_parameters, n_bands) is
    the variance of a run's values by its finite number of paths.

    Where little is scattered, a room departs most from the line: the variance of T20's error is about
    inverse to the level squared, that of C80's hardly depends on it. So each parameter's variance is a
    power of the level. Runs far from the line count less, as under Student's t distribution.
    """
    errors, levels = controls.errors, controls.levels
    (runs, n_parameters), n = errors.shape[:2], _COEFFICIENTS
    if levels is None or runs < 4 * n:
        return None
    columns = basis(levels, [MODELS.index(m) for m in controls.models])
    if np.linalg.matrix_rank(columns) < n:
        return None
    middle = float(np.exp(np.mean(np.log(levels))))
    log_level = np.log(levels / middle)
    power, weight = np.zeros(n_parameters), np.ones((runs, n_parameters))
    coefficients, left = np.empty((n, *errors.shape[1:])), np.empty_like(errors)
    for last in (False,) * _PASSES + (True,):
        root = np.sqrt(weight) * np.exp(-0.5 * np.outer(log_level, power))
        spread = np.zeros((n, n))
        for p in range(n_parameters):
            weighted = root[:, p, np.newaxis] * columns
            values = errors[:, p].reshape(runs, -1)
            solved = np.linalg.lstsq(weighted, root[:, p, np.newaxis] * values, rcond=None)[0]
            off = root[:, p, np.newaxis] * (values - columns @ solved)
            coefficients[:, p] = solved.reshape(coefficients[:, p].shape)
            left[:, p] = np.sqrt(runs / (runs - n)) * off.reshape(left[:, p].shape)
            spread += np.linalg.inv(weighted.T @ weighted) / n_parameters
        if last:
            break
        deviation = np.sqrt((left**2).mean(axis=(0, 2), keepdims=True))
        square = ((left / np.where(deviation > 0, deviation, 1.0)) ** 2).mean(axis=(2, 3))
        logs = np.log(np.maximum(square / root**2, 1e-12))
        power = log_level @ (logs - logs.mean(axis=0)) / (log_level @ log_level + _RIDGE)
        power = np.clip(power, *_POWERS)
        weight = (_FREEDOM + 1) / (_FREEDOM + square / weight)
    # Coefficients of all pairs are drawn towards their mean, as far as noise makes them differ.
    common, mean = coefficients.mean(axis=2, keepdims=True), left.mean(axis=2, keepdims=True)
    own_noise = ((left - mean) ** 2).mean(axis=0).sum(axis=(1, 2))
    off = np.diag(spread)[:, np.newaxis] * own_noise
    share = share_of_signal(((coefficients - common) ** 2).sum(axis=(2, 3)), off)
    own = np.sqrt(share.mean(axis=0))[:, np.newaxis, np.newaxis]
    of_left = replace(controls, errors=left)
    return ErrorsByScattering(
        coefficients=common + share[..., np.newaxis, np.newaxis] * (coefficients - common),
        spread=spread,
        power=power,
        middle=middle,
        left=of_left.without_noise(noise).with_common(COMMON_LEFT**0.5).covariance(),
        of_coefficients=replace(of_left, errors=mean + (left - mean) * own).covariance(),
    )


def log_likelihood(residual: Array, covariance: Array) -> float:
    """Return the normal log-likelihood without its constant."""
    factor = np.linalg.cholesky(covariance)
    white = solve_triangular(factor, residual, lower=True)
    return float(-0.5 * white @ white - np.log(np.diag(factor)).sum())


def basis(levels: ArrayLike, models: ArrayLike) -> Array:
    """Return the columns that a value depends on, (n, 3): nearly orthogonal over the control runs."""
    level, model = np.asarray(levels, dtype=float), np.asarray(models, dtype=float)
    return np.stack([np.ones_like(level), model - 0.5, level - np.mean(SCATTERING)], axis=1)
