"""Ways to calibrate a simulator, compared: `python benchmarks/studies/loops/comparators.py`.

One simulator with a call counter (path tracing of the invented lecture hall at 1 kHz, nine
materials, four receivers, one seed: deterministic), one search box (prior ± 3 sigma within 0.01 to
0.99), two tasks: (T) mean T20 within one JND; (P) T20, EDT and C80 within one JND at every position.
The truth is drawn from the prior, again where the prior is within two JND of its T20; "measured" is
the same simulator with it, so that every task can be met. Runs start from the prior (seeded) or from
a random point of the box. The closed loop keeps to the lower end of the box and to 1.

Printed: simulations to the goal, median (worst; - where the budget ended first), and the mean
absolute error of alpha at the goal, or of the best when the budget ended. Christensen et al. used a
genetic algorithm, Pilch gradient and evolutionary methods, Martellotta et al. and Postma & Katz
changed the largest areas by hand; pymoo's genetic algorithm runs where pymoo is installed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import optimize

import rtcal as rt
from rtcal.acoustics.observables import parameters
from rtcal.datasets import halls
from rtcal.simulators.external import External
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.errors import RtcalError

BAND = 3  # 1 kHz
JND = np.array([0.05, 0.05, 1.0])  # T20, EDT relative; C80 in dB


class BudgetSpent(RtcalError):
    """The simulations allowed are used up, or the goal is met."""


@dataclass
class Counter:
    """The simulator, counting: what every method calls, and nothing else."""

    tracer: PathTracing
    truth: np.ndarray
    task: str
    budget: int
    calls: int = 0
    best: tuple[float, np.ndarray] = (np.inf, np.zeros(0))
    met: int | None = None
    target: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.target = self.observe(self.truth)

    def observe(self, alpha: np.ndarray) -> np.ndarray:
        """T20, EDT and C80 by receiver, (3, n_receivers)."""
        energy = self.tracer.energy(alpha[:, np.newaxis], 3.0).mean(axis=0)[0, :, 0]
        dt = self.tracer.bin_width
        return np.stack([*parameters(energy, dt, ["t20", "edt", "c80"]).values()])

    def times(self, alpha: np.ndarray) -> float:
        """Mean T20 in s; counts."""
        return float(self.simulate(alpha)[0].mean())

    def simulate(self, alpha: np.ndarray) -> np.ndarray:
        if self.calls >= self.budget or self.met is not None:
            raise BudgetSpent
        self.calls += 1
        found = self.observe(alpha)
        loss = float(np.abs(self.gaps(found)).max())
        if loss < self.best[0]:
            self.best = (loss, np.array(alpha))
        if loss <= 1:
            self.met = self.calls
        return found

    def gaps(self, found: np.ndarray) -> np.ndarray:
        """Return what the task asks to be small, in JND; a decay without T20 counts as 100."""
        if self.task == "T":
            gap = (found[0].mean() / self.target[0].mean() - 1) / JND[0]
        else:
            relative = (found[:2] / self.target[:2] - 1) / JND[:2, np.newaxis]
            gap = np.concatenate([relative.ravel(), (found[2] - self.target[2]) / JND[2]])
        return np.nan_to_num(np.atleast_1d(gap), nan=100.0)

    def residuals(self, alpha: np.ndarray) -> np.ndarray:
        return self.gaps(self.simulate(alpha))

    def loss(self, alpha: np.ndarray) -> float:
        return float(np.sum(self.residuals(alpha) ** 2))


Method = Callable[[Counter, rt.Room, np.ndarray, np.ndarray, np.ndarray, np.random.Generator], None]


def closed_loop(
    counter: Counter, room: rt.Room, start: np.ndarray, lo: np.ndarray, hi: np.ndarray, rng: object
) -> None:
    """rtcal: calibrate Eyring's equation, move its target until the simulator agrees."""
    room = room.replace(alpha=start[:, np.newaxis], alpha_min=lo[:, np.newaxis])

    def times(alpha: np.ndarray, seed: int) -> np.ndarray:
        return np.array([counter.times(alpha[:, 0])])

    simulator = External(room=room, run=times, name="the counter")
    wanted = rt.Measurement.from_values(
        room.centre_frequencies, t20=counter.target[:1].mean(axis=1)
    )
    # A tolerance that is never met: the counter ends the run.
    rt.calibrate_simulator(
        simulator, room, wanted, tolerance=1e-6, max_simulations=max(counter.budget, 1)
    )


def largest_area_first(
    counter: Counter, room: rt.Room, start: np.ndarray, lo: np.ndarray, hi: np.ndarray, rng: object
) -> None:
    """Calibrate by hand: the largest area by what Eyring asks for, by 25 % at most, then the next."""
    alpha, order = start.copy(), np.argsort(-room.areas)
    for turn in range(counter.budget):
        t = counter.times(alpha)
        equation = rt.Eyring()
        own = equation.time(room, np.array([room.areas @ alpha]))
        needed = equation.target(room, own * counter.target[0].mean() / t)[0] - room.areas @ alpha
        k = order[turn % len(order)]
        change = np.clip(needed / room.areas[k], -0.25 * alpha[k], 0.25 * alpha[k])
        alpha[k] = np.clip(alpha[k] + change, lo[k], hi[k])


def least_squares(counter, room, start, lo, hi, rng) -> None:  # type: ignore[no-untyped-def]
    # Steps of 0.02: smaller ones would differentiate the bins of the histogram.
    optimize.least_squares(
        counter.residuals, start, bounds=(lo, hi), diff_step=0.02, x_scale=hi - lo
    )


def differential_evolution(counter, room, start, lo, hi, rng) -> None:  # type: ignore[no-untyped-def]
    optimize.differential_evolution(
        counter.loss,
        list(zip(lo, hi, strict=True)),
        popsize=3,
        rng=rng,
        x0=start,
        polish=False,
        maxiter=counter.budget,
    )


def genetic(counter, room, start, lo, hi, rng) -> None:  # type: ignore[no-untyped-def]
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.core.problem import ElementwiseProblem
    from pymoo.optimize import minimize

    class Task(ElementwiseProblem):
        def __init__(self) -> None:
            super().__init__(n_var=len(lo), n_obj=1, xl=lo, xu=hi)

        def _evaluate(self, x, out, *args, **kwargs) -> None:  # type: ignore[no-untyped-def]
            out["F"] = counter.loss(x)

    first = np.vstack([start, rng.uniform(lo, hi, (29, len(lo)))])
    minimize(
        Task(), GA(pop_size=30, sampling=first), ("n_gen", 1000), seed=int(rng.integers(2**31))
    )


METHODS: dict[str, Method] = {
    "closed loop (rtcal)": closed_loop,
    "largest area first": largest_area_first,
    "least squares": least_squares,
    "differential evolution": differential_evolution,
    "genetic algorithm": genetic,
}


@dataclass(frozen=True)
class Scene:
    """The lecture hall at 1 kHz with one source; the search box, (n_materials,)."""

    room: rt.Room
    tracer: PathTracing
    lo: np.ndarray
    hi: np.ndarray

    @classmethod
    def of(cls, n_paths: int) -> Scene:
        hall = halls.lecture_hall()
        room = hall.room.replace(
            alpha=hall.room.alpha[:, BAND : BAND + 1],
            sigma=hall.room.sigma[:, BAND : BAND + 1],
            scattering=hall.room.scattering[:, BAND : BAND + 1],
            centre_frequencies=hall.room.centre_frequencies[BAND : BAND + 1],
        )
        tracer = PathTracing(
            geometry=hall.geometry,
            room=room,
            sources={"S1": hall.sources["S1"]},
            receivers=hall.receivers,
            n_paths=n_paths,
        )
        mu, sigma = room.alpha[:, 0], room.sigma[:, 0]
        lo, hi = np.clip(mu - 3 * sigma, 0.01, 0.99), np.clip(mu + 3 * sigma, 0.01, 0.99)
        return cls(room, tracer, lo, hi)

    @property
    def prior(self) -> np.ndarray:
        return self.room.alpha[:, 0]

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """A truth from the prior, over two JND of T20 away from it."""
        prior_t = Counter(self.tracer, self.prior, "T", 0).target[0].mean()
        sigma = self.room.sigma[:, 0]
        while True:
            truth = np.clip(self.prior + sigma * rng.standard_normal(len(sigma)), self.lo, self.hi)
            t = Counter(self.tracer, truth, "T", 0).target[0].mean()
            if abs(prior_t / t - 1) > 2 * JND[0]:
                return truth


def shown(needed: list[float]) -> str:
    """Median (worst) number of simulations; - where the goal was not met."""
    return f"{np.median(needed):.0f} ({max(needed):.0f})".replace("inf", "-")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=6)
    parser.add_argument("--budget", type=int, default=300)
    parser.add_argument("--paths", type=int, default=4000)
    arguments = parser.parse_args()
    scene = Scene.of(arguments.paths)
    mu, lo, hi = scene.prior, scene.lo, scene.hi
    prior_error = []
    print(f"{arguments.trials} trials, at most {arguments.budget} simulations each")
    print(f"{'method':24}{'task':5}{'start':8}{'simulations to the goal':26}{'mean |alpha error|'}")
    for task in ("T", "P"):
        for label, method in METHODS.items():
            for start in ("prior", "random"):
                needed, errors = [], []
                for trial in range(arguments.trials):
                    rng = np.random.default_rng([1, trial])
                    truth = scene.draw(rng)
                    prior_error.append(np.abs(truth - mu).mean())
                    counter = Counter(scene.tracer, truth, task, arguments.budget)
                    x0 = mu if start == "prior" else rng.uniform(lo, hi)
                    try:
                        method(counter, scene.room, np.clip(x0, lo, hi), lo, hi, rng)
                    except BudgetSpent:
                        pass
                    except ImportError as error:
                        print(f"{label:24}{task:5}{start:8}left out: {error}")
                        break
                    needed.append(counter.met or np.inf)
                    errors.append(np.abs(counter.best[1] - truth).mean())
                if not needed:
                    continue
                print(
                    f"{label:24}{task:5}{start:8}{shown(needed):26}{np.mean(errors):.4f}",
                    flush=True,
                )
    print(f"{'(the prior itself)':24}{'':39}{np.mean(prior_error):.4f}")


if __name__ == "__main__":
    main()
