"""The problems: each a qpbenchmark problem in the whitened unknowns that carries its exact answer."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import qpbenchmark
import scipy.sparse as sp

import rtcal as rt
from benchmarks.solvers import truth
from rtcal import terms
from rtcal.acoustics.bands import octaves, third_octaves
from rtcal.calibration.methods import preset
from rtcal.calibration.problem import CalibrationProblem, measured_times
from rtcal.calibration.unknowns import Configurations
from rtcal.studies.paper import SHOEBOX, TABLE_1_MU, TABLE_1_SIGMA
from rtcal.support.types import Array
from tests import problems

OCTAVES, THIRDS = octaves(63, 8000), third_octaves(50, 10_000)
RUNTIME = 2.0  # s allowed a solve, for the solvers that take a limit
RANDOM = 10  # random rooms of each size in a full run
COMPOSED = {
    "tolerance": lambda: rt.Calibration(terms.PriorDeviation(), [terms.MatchWithin()]),
    "soft": lambda: preset("soft"),
    "correlated": lambda: rt.Calibration(terms.PriorDeviation(band_correlation=0.5)),
}


@dataclass(frozen=True, eq=False)
class Separable:
    """The numbers of a problem that `rtcal.exact` solves: (n, bands), areas (n,), target (bands,)."""

    mu: Array
    sigma: Array
    areas: Array
    target: Array
    lower: Array

    def solve(self) -> rt.exact.Answer:
        return rt.exact.solve(self.mu.T, self.sigma.T, self.areas, self.target, self.lower.T)


class Case(qpbenchmark.Problem):
    """A calibration's QP for any solver, and its exact answer: alpha = centre + scale x.

    After x come helper variables. ``alpha`` is None where no answer exists; ``alpha_within`` bounds the
    error of ``alpha`` itself.
    """

    def __init__(
        self,
        name: str,
        family: str,
        built: CalibrationProblem[Any],
        measured: Any,
        room: Any,
        separable: Separable | None,
    ) -> None:
        self.family, self.built, self.measured, self.room = family, built, measured, room
        self.separable = separable
        # Unsolved and unchecked: it may have no answer.
        alone = isinstance(built.room, rt.Room)
        rooms = Configurations([room]) if alone else room
        times = measured_times(rooms, [measured] if alone else measured)
        composed = replace(built, room=rooms)
        numbers = composed.numbers(times)
        self.centre, self.scale, self.layout = numbers.mu, numbers.sigma, numbers.layout
        qp = composed.compiled.filled(numbers)
        order = np.concatenate(
            [qp.compiled.places, np.setdiff1d(np.arange(len(qp.c)), qp.compiled.places)]
        )
        quadratic, rows = (part.tocsc()[:, order] for part in qp.matrices)
        low, high = qp.lower[order], qp.upper[order]
        one = sp.eye_array(len(order), format="csr")
        bounded = [np.flatnonzero(np.isfinite(end)) for end in (low, high)]
        every = sp.csr_array(sp.vstack([rows, -one[bounded[0]], one[bounded[1]]]))
        limits = np.concatenate([qp.b, -low[bounded[0]], high[bounded[1]]])
        size = np.sqrt(np.asarray(every.power(2).sum(axis=1)).ravel())
        unit = sp.diags_array(np.divide(1.0, size, out=np.ones_like(size), where=size > 0))
        every, limits, n = sp.csr_matrix(unit @ every), unit @ limits, qp.equal.sum()
        super().__init__(
            sp.csc_matrix(quadratic.tocsr()[order]),
            qp.c[order],
            sp.csc_matrix(every[n:]),
            limits[n:],
            sp.csc_matrix(every[:n]) if n else None,
            limits[:n] if n else None,
            None,
            None,
            name,
        )
        self.alpha: Array | None = None
        self.alpha_within = truth.EPS
        if separable is None:
            found = truth.of_matrices(self.to_sparse())
            self.alpha = self.of(found.x)
            self.alpha_within += found.error
        else:
            self.alpha = truth.of_bands(
                separable.mu, separable.sigma, separable.areas, separable.target, separable.lower
            )

    @property
    def unknowns(self) -> int:
        return len(self.centre)

    def of(self, x: Array) -> Array:
        """Return the absorption coefficients of a point x, (n_materials, n_bands)."""
        return self.layout.expand(self.centre + self.scale * x[: len(self.centre)])


def _single(
    name: str,
    family: str,
    built: CalibrationProblem[Any],
    room: rt.Room,
    times: Array,
    sigma: Array | None = None,
) -> Case:
    lower = np.zeros(room.alpha.shape) if room.alpha_min is None else room.alpha_min
    target = built.equation.target(room, np.asarray(times))
    given = room.alpha, room.sigma if sigma is None else sigma, room.areas, target, lower
    return Case(name, family, built, times, room, Separable(*given))


def _room(
    mu: Array, sigma: Array, areas: Array, frequencies: Sequence[float], **more: Any
) -> rt.Room:
    n = len(areas)
    return rt.Room(
        name="random",
        materials=[f"m{i}" for i in range(n)],
        areas=areas,
        alpha=np.reshape(mu, (n, -1)),
        sigma=np.reshape(sigma, (n, -1)),
        centre_frequencies=frequencies,
        **more,
    )


def room_of(
    n: int, frequencies: Sequence[float], rng: np.random.Generator
) -> tuple[rt.Room, Array]:
    """A random room and T of coefficients drawn from its prior."""
    shape = (n, len(frequencies))
    areas, mu = rng.uniform(5, 60, n), rng.uniform(0.02, 0.6, shape)
    sigma = rng.uniform(0.01, 0.1, shape)
    room = _room(mu, sigma, areas, frequencies, volume=100.0 * n, air=rt.Air())
    drawn = np.clip(mu + sigma * rng.standard_normal(shape), 0.01, 0.99)
    return room, rt.Eyring().time(room, areas @ drawn)


def _hard(kind: str, n: int, rng: np.random.Generator) -> tuple[rt.Room, Array]:
    """One of the kinds of tests/problems.py as a room; Sabine's equation reaches any b > 0."""
    drawn = problems.problem(kind, n, rng)
    target, lower = drawn.target, None
    if kind in ("at an end", "beyond an end"):
        # A positive least alpha, so that the low end has a T too.
        lower = 0.3 * np.reshape(drawn.mu, (-1, 1))
        low, high = float(drawn.areas @ lower[:, 0]), float(drawn.areas.sum())
        beyond = 10 ** rng.uniform(-6, -0.5) if kind == "beyond an end" else 0.0
        target = high * (1 + beyond) if rng.integers(2) else low * (1 - beyond)
    room = _room(drawn.mu, drawn.sigma, drawn.areas, [1000], volume=200.0, alpha_min=lower)
    return room, rt.Sabine().time(room, np.array([target]))


class Rooms(qpbenchmark.TestSet):
    """Calibrations of rooms, from the shipped real one to those that have tripped a solver."""

    def __init__(self, size: str = "short", seed: int = 20250412) -> None:
        self.size, self.seed = size, seed
        super().__init__()

    description = property(lambda self: "Calibrations of room-acoustic models, with exact answers.")
    sparse_only = property(lambda self: False)
    title = property(lambda self: "rtcal rooms")

    def define_tolerances(self, runtime: float = RUNTIME) -> None:
        super().define_tolerances(runtime)

    def __iter__(self) -> Iterator[Case]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rt.errors.MissingAirWarning)
            for family in (self._real, self._paper, self._random, self._hard, self._composed):
                yield from family()
            if self.size != "tiny":
                yield from self._sizes()

    def _real(self) -> Iterator[Case]:
        room, measured = rt.datasets.bras_cr2()
        for method in ("mle", "lse"):
            built = preset(method).build(room)
            # As rtcal places T in the room's bands: where there is none, the prior stays.
            times = np.array(built.solve(measured).joint.measured_times[0].reverberation_time)
            sigma = np.where(room.sigma > 0, 1.0, 0.0) if method == "lse" else None
            yield _single(f"CR2 {method}", "real", built, room, times, sigma)

    def _paper(self) -> Iterator[Case]:
        # Two walls of 47 m² as in Figs. 1 and 3, and Table 1's shoebox.
        walls = (47.0, 47.0)
        for name, mu, sigma, areas in (
            ("Fig 1", (0.6, 0.5), (0.1, 0.1), walls),
            ("Fig 3", (0.6, 0.5), (0.05, 0.1), walls),
            ("Table 1", TABLE_1_MU, TABLE_1_SIGMA, tuple(float(s) for s in SHOEBOX)),
        ):
            room = _room(np.array(mu), np.array(sigma), np.array(areas), [1000], volume=200.0)
            built = preset("mle").build(room, rt.Sabine())
            for share in (0.1, 0.4, 0.8):
                times = rt.Sabine().time(room, np.array([share * sum(areas)]))
                yield _single(f"{name} mean {share}", "paper", built, room, times)

    def _random(self) -> Iterator[Case]:
        count = {"tiny": 1, "short": 3, "full": RANDOM}[self.size]
        for n in (6, 23, 40):
            rng = np.random.default_rng([self.seed, n])
            built = None
            for i in range(count):
                room, times = room_of(n, OCTAVES, rng)
                built = built or preset("mle").build(room)
                yield _single(f"random {n} x 8 no {i}", "random", built, room, times)

    def _hard(self) -> Iterator[Case]:
        count = {"tiny": 1, "short": 2, "full": 8}[self.size]
        for n in (6,) if self.size == "tiny" else (6, 23, 40):
            rng = np.random.default_rng([self.seed, n, 1])
            built = None
            for kind in problems.KINDS:
                family = "infeasible" if kind == "beyond an end" else "hard"
                for i in range(count):
                    room, times = _hard(kind, n, rng)
                    built = built or preset("mle").build(room, rt.Sabine())
                    yield _single(f"{kind} {n} no {i}", family, built, room, times)

    def _composed(self) -> Iterator[Case]:
        for n in {"tiny": (6,), "short": (6, 23), "full": (6, 23, 40)}[self.size]:
            for name in COMPOSED:  # each in a room of its own
                room, times = room_of(n, OCTAVES, np.random.default_rng([self.seed, n, 2]))
                yield self._of(name, n, room, times, "composed")
            yield self._two(n, OCTAVES, "composed")

    def _of(self, name: str, n: int, room: rt.Room, times: Array, family: str) -> Case:
        built = COMPOSED[name]().build(room)
        return Case(f"{name} {n} x {room.n_bands}", family, built, times, room, None)

    def _two(self, n: int, bands: Sequence[float], family: str) -> Case:
        rng = np.random.default_rng([self.seed, n, 3])
        room, times = room_of(n, bands, rng)
        other = room.replace(areas=room.areas * rng.uniform(0.5, 1.5, n))
        pair = Configurations([room, other])
        seen = rt.Eyring().time(other, other.areas @ np.clip(room.alpha * 1.02, 0.01, 0.99))
        name = f"two configurations {n} x {len(bands)}"
        return Case(name, family, preset("joint").build(pair), [times, seen], pair, None)

    def _sizes(self) -> Iterator[Case]:
        for n in (5, 20) if self.size == "short" else (5, 10, 20, 40, 80, 208):
            room, times = room_of(n, THIRDS, np.random.default_rng([self.seed, n, 4]))
            yield _single(f"mle {n} x 24", "sizes", preset("mle").build(room), room, times)
            for name in COMPOSED:
                yield self._of(name, n, room, times, "sizes")
            yield self._two(n, THIRDS, "sizes")
