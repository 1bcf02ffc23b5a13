"""The paper's stochastic study: how much a calibration reduces the error of the coefficients.

MSE is the mean squared error of a trial (Bellows & Katz 2025, Eq. 28). EMSE is its mean over the trials
of a realisation (Eq. 29). AACE is the root of EMSE's mean over realisations (Eq. 32). The calibration
score is 1 - AACE / AACE of no calibration (Eq. 35), with the actual AACE of no calibration in place of
its approximation sqrt(2) sigma_r.

A study is computed in pieces. A piece draws from a generator seeded by (seed, number), so the result
does not depend on the number of workers, nor on which of them computes what. The sums over
realisations, from which scores, standard errors and box plots are calculated, do not grow with the
number of rooms, so neither does the study's memory.
"""

from __future__ import annotations

import csv
import functools
import io
import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rtcal.studies import paper
from rtcal.studies.paper import (
    CALIBRATIONS,
    METHODS,
    SAMPLINGS,
    SIGMA_LIMIT,
    Sampling,
    TrialSums,
    analytic_emse,
)
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import bar as progress_bar
from rtcal.support.speed import following
from rtcal.support.types import Array
from rtcal.support.workers import workforce

_LEAST = 1e-9
_MOST: dict[str, tuple[float, str]] = {
    "sigma_r": (SIGMA_LIMIT, 'mu has no interval (sampling = "sigma_n" takes more)'),
    "sigma_n": (10.0, f"sigma is evenly spread over what is below {SIGMA_LIMIT:g}"),
}
"""Largest sigma_r by sampling, and what is the matter above it."""
_MOST_NUMBERS = 2**53  # the moments are summed in double precision
_LARGEST_AREA = 1e8  # m² of one surface: the walls of the largest halls have some 1e5

Table = np.recarray[Any, Any]
"""Rows with named columns: ``table["score"]``, ``table.score``, ``row.method``."""

PIECE = 100  # realisations per piece
BLOCK = 61_440  # normal numbers per step: half a megabyte; BLAS uses one thread

_SCORES = [
    ("method", "U12"),
    ("bounded", "?"),
    ("aace", "f8"),
    ("score", "f8"),
    ("standard_error", "f8"),
]


def table_csv(table: np.recarray[Any, Any]) -> bytes:
    """Return a table as the bytes of a CSV file, in which numbers keep all their digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.dtype.names)
    writer.writerows(table.tolist())
    return stream.getvalue().encode()


SAMPLED = METHODS + tuple(f"{m} bounded" for m in CALIBRATIONS)
ANALYTIC = tuple(f"{m} analytic" for m in METHODS)
SERIES = SAMPLED + ANALYTIC
"""Names of the eleven errors (EMSE) that are computed in each realisation."""

EDGES = np.linspace(0.0, 0.5, 4001)  # of sqrt(EMSE); the last bin holds all larger values


@dataclass(frozen=True, eq=False)
class ScoreMoments:
    """Hold sums over realisations, from which mean scores and their standard errors follow.

    ``count`` is the number of realisations. ``active`` (3,) is the number of trials of each calibration
    in which a coefficient reaches 0 or 1. A series is the error (EMSE) of one method in each
    realisation. ``sums`` are the sums of the series, and ``products`` those of the products of two
    series. The series from trials also have a histogram of sqrt(EMSE) and its extremes.
    """

    count: int
    sums: Array
    products: Array
    active: Array
    histogram: Array
    least: Array
    most: Array

    @classmethod
    def of(cls, emse: Array, active: Array) -> ScoreMoments:
        """Sum up the series of some realisations, (r, 11), and their active trials, (r, 3)."""
        root = np.sqrt(emse[:, : len(SAMPLED)])
        bins = np.minimum(np.searchsorted(EDGES, root, side="right") - 1, EDGES.size - 2)
        histogram = np.stack([np.bincount(b, minlength=EDGES.size - 1) for b in bins.T])
        return cls(
            count=len(emse),
            sums=emse.sum(0),
            products=np.einsum("ri,rj->ij", emse, emse),
            active=active.sum(0).astype(float),
            histogram=histogram.astype(float),
            least=root.min(0),
            most=root.max(0),
        )

    def __add__(self, other: ScoreMoments) -> ScoreMoments:
        return ScoreMoments(
            self.count + other.count,
            self.sums + other.sums,
            self.products + other.products,
            self.active + other.active,
            self.histogram + other.histogram,
            np.minimum(self.least, other.least),
            np.maximum(self.most, other.most),
        )

    def mean(self, weights: dict[str, float]) -> float:
        """Return the mean over realisations of a weighted sum of series."""
        return float(_vector(weights) @ self.sums / self.count)

    def score(self, method: dict[str, float], baseline: dict[str, float]) -> tuple[float, Array]:
        """Return 1 - sqrt(mean method / mean baseline) and its gradient by the series' means."""
        top, bottom = self.mean(method), self.mean(baseline)
        if top == 0:  # exact in every realisation: there is no error to propagate
            return 1.0, np.zeros(len(SERIES))
        ratio = np.sqrt(top / bottom)
        gradient = -ratio / 2 * (_vector(method) / top - _vector(baseline) / bottom)
        return float(1 - ratio), gradient

    def standard_error(self, gradient: Array) -> float:
        """Return the standard error of a smooth function of the means that has this ``gradient``.

        It follows from the scatter between realisations, which are independent (delta method). It is
        NaN for a single realisation.
        """
        if self.count < 2:
            return float("nan")
        means = self.sums / self.count
        covariance = self.products / self.count - np.outer(means, means)
        variance = float(gradient @ covariance @ gradient) / (self.count - 1)
        return float(max(variance, 0.0) ** 0.5)

    def quantile(self, series: int, share: float) -> float:
        """Return a quantile of sqrt(EMSE) of a sampled series, to a histogram bin (1.25e-4)."""
        running = np.cumsum(self.histogram[series])
        return float(np.interp(share * running[-1], np.concatenate([[0.0], running]), EDGES))


def _vector(weights: dict[str, float]) -> Array:
    return np.array([weights.get(name, 0.0) for name in SERIES])


def _sum_of_pieces(
    compute: Callable[[int], ScoreMoments],
    count: int,
    scheduler: str | None,
    workers: int | None,
    progress: bool,
) -> ScoreMoments:
    """Return the sum of ``compute(0)`` to ``compute(count - 1)``, always added in that order."""
    if workers is not None:
        checks.whole("workers", workers, 1)
        if scheduler is not None:
            raise DataError(
                f"workers = {workers} (of this machine) and a scheduler, which has workers "
                "of its own, are both given: leave one of them out"
            )
    shown = progress_bar(count, "piece", checks.flag("progress", progress))
    with workforce(scheduler, workers) as pool, shown as bar:
        pieces: Iterator[ScoreMoments] = pool.in_order(compute, range(count), following(bar))
        return functools.reduce(operator.add, pieces)


@dataclass(frozen=True, eq=False)
class Study:
    """Hold a finished study of one room at one sigma_r, which `run` returns.

    ``areas``, ``sigma_r``, ``realisations``, ``trials``, ``seed`` and ``sampling`` are the arguments of
    `run`, and ``moments`` are sums over the trials from which the tables are calculated.
    """

    areas: Array
    sigma_r: float
    realisations: int
    trials: int
    seed: int
    sampling: Sampling
    moments: ScoreMoments

    def scores(self) -> Table:
        """Return the calibration score of each method with its standard error, as in the paper.

        Columns are method, bounded (whether alpha stays within 0 and 1), aace (average coefficient
        error), score (as a fraction) and standard error. All errors are estimated from the trials.
        """
        rows = [self._row(m, False, {m: 1.0}, {"none": 1.0}) for m in METHODS]
        rows += [self._row(m, True, {f"{m} bounded": 1.0}, {"none": 1.0}) for m in CALIBRATIONS]
        return _table(rows, _SCORES)

    def controlled_scores(self) -> Table:
        """Return the table that `scores` returns, with smaller random errors.

        Scores without bounds are computed by a formula. Scores with the bounds 0 and 1 add the
        simulated effect of the bounds, which is 0 in trials in which no coefficient reaches one.
        """
        baseline = {"none analytic": 1.0}
        rows = [self._row(m, False, {f"{m} analytic": 1.0}, baseline) for m in METHODS]
        rows += [self._row(m, True, _controlled(m), baseline) for m in CALIBRATIONS]
        return _table(rows, _SCORES)

    def bound_effects(self) -> Table:
        """Return the effect of the bounds 0 and 1 on the score, with its standard error.

        The effect is the score with bounds minus that without. ``active_share`` is the share of trials
        in which a coefficient reaches a bound.
        """
        rows = []
        for k, m in enumerate(CALIBRATIONS):
            baseline = {"none analytic": 1.0}
            bounded, slope = self.moments.score(_controlled(m), baseline)
            free, other = self.moments.score({f"{m} analytic": 1.0}, baseline)
            share = self.moments.active[k] / (self.realisations * self.trials)
            error = self.moments.standard_error(slope - other)
            rows.append((m, bounded - free, error, share))
        columns = [
            ("method", "U12"),
            ("difference", "f8"),
            ("standard_error", "f8"),
            ("active_share", "f8"),
        ]
        return _table(rows, columns)

    def spread(self) -> Table:
        """Return minimum, quartiles and maximum of the root error over realisations (as Fig. 4b)."""
        rows = []
        for i, name in enumerate(SAMPLED):
            quartiles = [self.moments.quantile(i, share) for share in (0.25, 0.5, 0.75)]
            method, _, bounded = name.partition(" ")
            ends = float(self.moments.least[i]), float(self.moments.most[i])
            rows.append((method, bool(bounded), ends[0], *quartiles, ends[1]))
        columns = ("least", "first_quartile", "median", "third_quartile", "most")
        types = [("method", "U12"), ("bounded", "?"), *((c, "f8") for c in columns)]
        return _table(rows, types)

    @property
    def redrawn_share(self) -> float:
        """Share of random sigma that left no possible mu and were therefore drawn again."""
        return paper.redrawn_share(self.sigma_r, self.sampling)

    def _row(
        self, method: str, bounded: bool, series: dict[str, float], baseline: dict[str, float]
    ) -> tuple[str, bool, float, float, float]:
        score, slope = self.moments.score(series, baseline)
        aace = float(np.sqrt(self.moments.mean(series)))
        return method, bounded, aace, score, self.moments.standard_error(slope)


def run(
    areas: ArrayLike,
    sigma_r: float,
    realisations: int,
    trials: int,
    seed: int = 0,
    *,
    sampling: Sampling = "sigma_r",
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = False,
) -> Study:
    """Return a study of how much calibration improves alpha in many random rooms with given areas.

    A room has random input coefficients mu with uncertainties sigma. Its true coefficients are drawn
    from the truncated normal distributions of mu and sigma, and the input coefficients are calibrated
    to the true absorption area by three methods: scaling, least squares and maximum likelihood (Bellows
    & Katz 2025, Sect. 3.4).

    Parameters
    ----------
    areas : array (n_surfaces,)
        Area of each surface in m²; each surface has its own coefficient.
    sigma_r : float
        Scale of the Rayleigh distribution of sigma, the uncertainty of the input coefficients.
    realisations, trials : int
        Number of random sets of input coefficients (mu, sigma), and number of random sets of true
        coefficients for each of them.
    seed : int
        Seed of the random numbers. The study is the same for any number of workers.
    sampling : {"sigma_r", "sigma_n"}
        Rule for the distance of mu from 0 and 1: 2 sigma_r, which gives the paper's scores, or 2 sigma
        of each surface, as the paper's text says.
    scheduler : str, optional
        Address of a Dask scheduler whose workers compute; by default threads of this machine do.
    workers : int, optional
        Number of threads; by default the number of cores.
    progress : bool
        Whether to show a progress bar on standard error after two seconds.

    Returns
    -------
    Study
        Study whose ``scores()`` has the mean error of each method, and by which share it is smaller
        than without calibration.

    Raises
    ------
    DataError
        If an area, sigma_r or a number is not positive; if sigma_r is above 0.25 for "sigma_r", where
        no mu keeps its distance from 0 and 1, or above 10 for "sigma_n"; for another ``sampling``, and
        for ``workers`` together with a scheduler.
    ClusterError
        If the scheduler does not answer.
    MissingDependencyError
        If a scheduler is given, and dask.distributed is not installed.

    Examples
    --------
    >>> table = run([35, 35, 21, 21, 15, 15], 0.05, 200, 100, seed=1).scores()
    >>> for row in table[:4]:
    ...     print(row.method, round(100 * row.score, 1), "%")
    none 0.0 %
    scaling 5.1 %
    lse 8.7 %
    mle 14.0 %
    """
    s = _areas(areas)
    _check(sigma_r, seed, sampling, realisations=realisations, trials=trials)
    compute = functools.partial(_piece, s, sigma_r, realisations, trials, seed, sampling)
    count = -(-realisations // PIECE)
    moments = _sum_of_pieces(compute, count, scheduler, workers, progress)
    return Study(s, sigma_r, realisations, trials, seed, sampling, moments)


def analytic_scores(
    areas: ArrayLike,
    sigma_r: float,
    realisations: int,
    seed: int = 0,
    *,
    sampling: Sampling = "sigma_r",
) -> Table:
    """Return the scores of the methods that `run` compares, by a formula and without bounds.

    For the parameters see `run`, whose random input coefficients are the same for the same seed. True
    coefficients are not drawn: the errors are those expected from the mean and the variance of the
    truncated normal distribution of alpha (`rtcal.studies.paper.analytic_emse`). The table has the
    columns of `Study.scores`.

    ``areas`` are in m², ``sigma_r`` is the scale of the input uncertainties, and ``realisations`` the
    number of random sets of input coefficients.

    Examples
    --------
    >>> table = analytic_scores([35, 35, 21, 21, 15, 15], 0.05, 2000, seed=1)
    >>> print(round(100 * table.score[2], 1), "%, theory", round(100 * (1 - (5 / 6) ** 0.5), 1), "%")
    8.8 %, theory 8.7 %
    """
    s = _areas(areas)
    _check(sigma_r, seed, sampling, realisations=realisations)
    moments = _analytic(s, sigma_r, realisations, seed, sampling)
    study = Study(s, sigma_r, realisations, 0, seed, sampling, moments)
    return _table(study.controlled_scores().tolist()[: len(METHODS)], _SCORES)


def _drawn(
    areas: Array, sigma_r: float, realisations: int, seed: int, sampling: Sampling, number: int
) -> tuple[np.random.Generator, Array, Array]:
    """Return the generator of a piece and its realisations."""
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=(number,))))
    count = min(PIECE, realisations - number * PIECE)
    return rng, *paper.realisations(rng, count, areas.size, sigma_r, sampling)


def _analytic(
    areas: Array, sigma_r: float, realisations: int, seed: int, sampling: Sampling
) -> ScoreMoments:
    def piece(number: int) -> ScoreMoments:
        _, mu, sigma = _drawn(areas, sigma_r, realisations, seed, sampling, number)
        unsampled = np.zeros((len(mu), len(SAMPLED)))
        errors = np.hstack([unsampled, analytic_emse(mu, sigma, areas)])
        return ScoreMoments.of(errors, np.zeros((len(mu), len(CALIBRATIONS))))

    return functools.reduce(operator.add, map(piece, range(-(-realisations // PIECE))))


def _piece(
    areas: Array,
    sigma_r: float,
    realisations: int,
    trials: int,
    seed: int,
    sampling: Sampling,
    number: int,
) -> ScoreMoments:
    """Simulate one piece of a study."""
    rng, mu, sigma = _drawn(areas, sigma_r, realisations, seed, sampling, number)
    sampled = np.empty((len(mu), len(SAMPLED)))
    active = np.empty((len(mu), len(CALIBRATIONS)))
    block = min(trials, max(1, BLOCK // areas.size))
    buffer = np.empty(areas.size * block)
    for r, room in enumerate(paper.tabulated(mu, sigma, areas)):
        sums: list[TrialSums] = []
        for start in range(0, trials, block):
            few = min(block, trials - start)
            z = buffer[: areas.size * few].reshape(areas.size, few)
            paper.trials(rng, room.mu, room.sigma, z)
            sums.append(paper.score(z, room))
        total = functools.reduce(operator.add, sums)
        sampled[r], active[r] = total.errors(room, trials), total.active
    return ScoreMoments.of(np.hstack([sampled, analytic_emse(mu, sigma, areas)]), active)


def _table(rows: list[Any], columns: list[tuple[str, str]]) -> Table:
    table: Table = np.array(rows, dtype=columns).view(np.recarray)
    return table


def _controlled(method: str) -> dict[str, float]:
    return {f"{method} analytic": 1.0, f"{method} bounded": 1.0, method: -1.0}


def _areas(areas: ArrayLike) -> Array:
    s = checks.array("areas", areas)
    if s.ndim != 1 or s.size == 0:
        raise DataError(f"areas has shape {s.shape}; give one value in m² per surface: (n,)")
    for i, value in enumerate(s):
        if not 0 < value <= _LARGEST_AREA:
            raise DataError(
                f"areas[{i}] = {value:g} m² must be above 0 and at most {_LARGEST_AREA:g} m²"
            )
    return s


def _check(sigma_r: float, seed: int, sampling: str, **numbers: int) -> None:
    if not isinstance(sampling, str) or sampling not in SAMPLINGS:
        raise DataError(
            f"sampling = {checks.shown(sampling)} must be one of {', '.join(SAMPLINGS)}"
        )
    checks.number("sigma_r", sigma_r)
    if not (np.isfinite(sigma_r) and sigma_r > 0):
        raise DataError(f"sigma_r = {sigma_r:g} must be above 0")
    most, why = _MOST[sampling]
    if not _LEAST <= sigma_r <= most:
        raise DataError(
            f"sigma_r = {sigma_r:g} must be from {_LEAST:g} to {most:g}: smaller errors are lost "
            f"in rounding, and above it {why}"
        )
    checks.whole("seed", seed, 0)
    for name, value in numbers.items():
        if checks.whole(name, value, 1) > _MOST_NUMBERS:
            raise DataError(
                f"{name} = {checks.shown(value)} must be at most 2**53, above which sums of "
                "counts are not exact"
            )
