"""Rooms in several configurations, whose rows share coefficients, and their exact optimum.

The optimum is solved in rational arithmetic: the truth that `alpha_error_bound` is held against.
"""

from fractions import Fraction
from functools import cache

import numpy as np

import rtcal as rt
from rtcal import terms
from rtcal.calibration.problem import CalibrationProblem
from rtcal.calibration.result import JointResult
from rtcal.calibration.unknowns import Configurations

FREQUENCIES = (500.0, 1000.0)
MOST = 20.0
"""m²: the limit of the group of m0 and m2."""
CONSTRAINTS = (
    (terms.ExactMatch(),),
    (terms.ExactMatch(), terms.AtMost("m0", "m1")),
    (terms.ExactMatch(), terms.GroupAbsorption(["m0", "m2"], most=MOST)),
    (terms.MatchWithin(0.5), terms.AtMost("m0", "m1")),
)
EYRING = rt.Eyring()
_ROUNDS = 50


@cache
def compiled(n_configurations: int, n_materials: int, kind: int) -> CalibrationProblem[JointResult]:
    """Return the problem of a shape, compiled once."""
    alpha = np.full((n_materials, len(FREQUENCIES)), 0.2)
    configurations = _configurations(np.ones((n_configurations, n_materials)), alpha, alpha / 2)
    calibration = rt.Calibration(terms.PriorDeviation(), list(CONSTRAINTS[kind]))
    return calibration.build(configurations, EYRING)


def _configurations(areas: np.ndarray, alpha: np.ndarray, sigma: np.ndarray) -> Configurations:
    return Configurations(
        [
            rt.Room(
                name=f"configuration {c}",
                volume=float(s.sum()) ** 1.5 / 10,
                materials=[f"m{i}" for i in range(len(s))],
                areas=s,
                alpha=alpha,
                sigma=sigma,
                centre_frequencies=FREQUENCIES,
                air=rt.Air(),
            )
            for c, s in enumerate(areas)
        ]
    )


def solution(seed: int, solver: str = "clarabel") -> JointResult:
    """Solve a random problem that some coefficients within the box and the constraints fulfil.

    Areas are from 0.1 to 300 m² and standard deviations from 1e-3 to 1, some 0.
    """
    rng = np.random.default_rng(seed)
    c, kind = int(rng.integers(2, 4)), int(rng.integers(len(CONSTRAINTS)))
    n = int(rng.integers(c + 2, 8))
    shape = (n, len(FREQUENCIES))
    alpha, sigma = rng.uniform(0.01, 0.95, shape), 10 ** rng.uniform(-3, 0, shape)
    sigma[rng.random(shape) < rng.choice([0, 0.2])] = 0
    areas = 10 ** rng.uniform(-1, 2.5, (c, n))
    near = alpha + sigma * rng.standard_normal(shape) * 10 ** rng.uniform(-1, 1)
    anywhere = np.where(sigma > 0, rng.uniform(0, 1, shape), alpha)
    true = np.clip([near, anywhere][rng.integers(2)], 0.001, 0.98)
    if kind == 2:
        sigma[[0, 2]] = np.maximum(sigma[[0, 2]], 1e-3)
        true[[0, 2]] *= np.minimum(1, 0.9 * MOST / (areas[0, [0, 2]] @ true[[0, 2]]))
    elif kind:
        sigma[:2] = np.maximum(sigma[:2], 1e-3)
        true[:2] = np.sort(true[:2], axis=0)
    configurations = _configurations(areas, alpha, sigma)
    times = [
        EYRING.time(room, s @ true) for room, s in zip(configurations.rooms, areas, strict=True)
    ]
    return compiled(c, n, kind).solve(times, configurations, solver=solver)


def optimum(answer: JointResult) -> np.ndarray | None:
    """Return the exact optimum as the nearest floats, (size,), None where the rows are dependent.

    The active set of the answer is the first guess. A set is accepted where bounds, rows and the signs
    of all multipliers hold exactly. Rows and limits are stated here anew, from areas and targets.
    """
    n_bands = len(FREQUENCIES)
    out = answer.numbers.mu.copy()
    for k in range(n_bands):
        exact = _band(answer, k, np.arange(k, len(out), n_bands))
        if exact is None:
            return None
        out[k::n_bands] = [float(a) for a in exact]
    return out


def _rows(answer: JointResult, k: int) -> list[tuple[np.ndarray, float, float]]:
    """Return coefficients and limits of each row of a band."""
    numbers, rows = answer.numbers, []
    for term in answer.composition.row_constraints:
        if isinstance(term, terms.ExactMatch):
            low, high = term.target_limits(numbers)
            rows += [(s, low[c, k], high[c, k]) for c, s in enumerate(numbers.areas)]
        elif isinstance(term, terms.AtMost):
            order = np.zeros(numbers.areas.shape[1])
            order[:2] = 1, -1
            rows.append((order, -np.inf, 0.0))
        else:
            own = np.zeros(numbers.areas.shape[1])
            own[[0, 2]] = numbers.areas[0, [0, 2]]
            rows.append((own, -np.inf, MOST))
    return rows


def _band(answer: JointResult, k: int, unknowns: np.ndarray) -> list[Fraction] | None:
    numbers, stated = answer.numbers, _rows(answer, k)
    mu, lower, upper = (
        [Fraction(v) for v in values[unknowns]]
        for values in (numbers.mu, numbers.lower, numbers.upper)
    )
    rows = range(len(stated))
    lines = [[Fraction(v) for v in line] for line, _, _ in stated]
    ends = [(low, high) for _, low, high in stated]
    equal = [low == high for low, high in ends]
    at = [int(a) for a in answer.at_bounds[unknowns]]
    sums = [float(line @ answer.unknowns[unknowns]) for line, _, _ in stated]
    near = [1e-9 * (1 + np.abs(line).sum()) for line, _, _ in stated]
    side = [
        1 if e or total > high - tiny else -1 if total < low + tiny else 0
        for e, total, (low, high), tiny in zip(equal, sums, ends, near, strict=True)
    ]
    weight = [Fraction(v) ** 2 for v in numbers.sigma[unknowns]]
    for _ in range(_ROUNDS):
        used = [r for r in range(len(rows)) if side[r]]
        free = [i for i, a in enumerate(at) if a == 0]
        alpha = [lower[i] if a < 0 else upper[i] if a > 0 else mu[i] for i, a in enumerate(at)]
        y = _solved(
            [
                [sum(lines[r][i] * weight[i] * lines[q][i] for i in free) for q in used]
                for r in used
            ],
            [
                sum(s * a for s, a in zip(lines[r], alpha, strict=True))
                - Fraction(ends[r][0 if side[r] < 0 else 1])
                for r in used
            ],
        )
        if y is None:
            return None
        pull = [sum(v * lines[r][i] for v, r in zip(y, used, strict=True)) for i in range(len(at))]
        for i in free:
            alpha[i] = mu[i] - weight[i] * pull[i]
        changed = False
        for i, a in enumerate(at):
            force = (alpha[i] - mu[i]) + weight[i] * pull[i]
            new = a
            if a == 0:
                new = (alpha[i] > upper[i]) - (alpha[i] < lower[i])
            elif a * force > 0:
                new = 0
            changed, at[i] = changed or new != a, new
        for r in range(len(rows)):
            new = side[r]
            total = sum(s * a for s, a in zip(lines[r], alpha, strict=True))
            if not side[r]:
                new = int(total > ends[r][1]) - int(total < ends[r][0])
            elif not equal[r] and y[used.index(r)] * side[r] < 0:
                new = 0
            changed, side[r] = changed or new != side[r], new
        if not changed:
            return alpha
    return None


def _solved(matrix: list[list[Fraction]], right: list[Fraction]) -> list[Fraction] | None:
    """Solve a system by elimination, None where it is singular."""
    system = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    n = len(system)
    for i in range(n):
        pivot = next((j for j in range(i, n) if system[j][i]), None)
        if pivot is None:
            return None
        system[i], system[pivot] = system[pivot], system[i]
        system[i] = [v / system[i][i] for v in system[i]]
        for j in range(n):
            if j != i and system[j][i]:
                factor = system[j][i]
                system[j] = [a - factor * b for a, b in zip(system[j], system[i], strict=True)]
    return [row[-1] for row in system]
