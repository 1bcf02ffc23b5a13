"""cvxpy's compiled problem, how terms build its expressions, and how it is filled with numbers.

cvxpy compiles a DPP problem once into maps that are affine in its parameters. This module applies
the maps itself, in one product, which takes a tenth of the time that cvxpy takes. The interfaces
of Clarabel, OSQP and qpsolvers share one form:

    minimise ½ x'Px + q'x  subject to  A x = b (the first n_equal rows)  and  A x <= b (the others).

Derived parameters keep the problem DPP (disciplined parametrized programming). In the whitened unknowns
x (u = centre + scale x) a coefficient such as area times sigma would be a product of two parameters,
which is not DPP. A term therefore states how its coefficients of alpha follow from a `ProblemData`,
and the `Context` computes the coefficients of x and the constant outside cvxpy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from rtcal.calibration.layout import Integers, Layout
from rtcal.calibration.problem_data import ProblemData
from rtcal.support.types import Array

_BLOCK = 256
"""Number of factors compiled together: 2 MB of memory, and few enough blocks to compile quickly."""

Coefficients = Callable[[ProblemData], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Factors:
    """Parameters that multiply a cvxpy vector elementwise, and the product.

    cvxpy compiles a product of n factors with memory for n² numbers, so long vectors are cut.
    """

    blocks: list[Any]
    product: Any

    @classmethod
    def of(cls, vector: Any) -> Factors:
        """Return the factors of a vector (n,)."""
        starts = range(0, vector.size, _BLOCK)
        if len(starts) == 1:
            blocks = [cp.Parameter(vector.size)]
            return cls(blocks, cp.multiply(blocks[0], vector))
        parts = [vector[start : start + _BLOCK] for start in starts]
        blocks = [cp.Parameter(part.size) for part in parts]
        products = [cp.multiply(*pair) for pair in zip(blocks, parts, strict=True)]
        return cls(blocks, cp.hstack(products))

    def fill(self, values: Array) -> None:
        """Set the factors, (n,)."""
        for i, block in enumerate(self.blocks):
            # save_value: the setter's checks of shape and kind cost more than the numbers.
            block.save_value(values[i * _BLOCK : (i + 1) * _BLOCK])


@dataclass(frozen=True, eq=False)
class Affine:
    """Rows that are affine in the unknowns: the cvxpy expression (n_rows,) and how to refresh it."""

    expression: Any
    rows: Integers
    columns: Integers
    n_rows: int
    compute: Coefficients
    coefficients: Factors
    constant: Any

    def update(self, data: ProblemData) -> None:
        """Set the derived parameters for ``data``."""
        values, constant = self.compute(data)
        self.coefficients.fill(values * data.scale[self.columns])
        moved = values * data.centre[self.columns]
        self.constant.save_value(constant + np.bincount(self.rows, moved, minlength=self.n_rows))


class Context:
    """The unknowns of a problem under construction, and its derived parameters."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.x = cp.Variable(layout.size, name="x")
        self._affine: list[Affine] = []
        self._factors: list[tuple[Factors, Callable[[ProblemData], Array]]] = []
        self._parameters: list[tuple[Any, Callable[[ProblemData], Array]]] = []

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.layout.size

    def variable(self, size: int) -> Any:
        """Return helper variables for a term's expression, such as positive and negative parts."""
        return cp.Variable(size)

    def affine(
        self, rows: Integers, columns: Integers, n_rows: int, compute: Coefficients
    ) -> Affine:
        """Return rows that are affine in the unknowns.

        Parameters
        ----------
        rows, columns : array (n_entries,)
            Positions of the coefficients, fixed when the problem is built.
        n_rows : int
        compute : function of ProblemData
            Returns the coefficients of the unknowns (n_entries,) and the constants (n_rows,).
        """
        constant = cp.Parameter(n_rows)
        picked = self.x
        if not np.array_equal(columns, np.arange(self.size)):
            entries = np.arange(len(columns))
            ones = np.ones(len(columns))
            picked = sp.csr_array((ones, (entries, columns)), (len(columns), self.size)) @ self.x
        factors = Factors.of(picked)
        terms = factors.product
        if not np.array_equal(rows, np.arange(n_rows)):
            entries = np.arange(len(rows))
            terms = sp.csr_array((np.ones(len(rows)), (rows, entries)), (n_rows, len(rows))) @ terms
        affine = Affine(
            terms + constant,
            np.asarray(rows),
            np.asarray(columns),
            n_rows,
            compute,
            factors,
            constant,
        )
        self._affine.append(affine)
        return affine

    def multiply(self, vector: Any, compute: Callable[[ProblemData], Array]) -> Any:
        """Return a cvxpy vector times ``compute(data)``, elementwise."""
        factors = Factors.of(vector)
        self._factors.append((factors, compute))
        return factors.product

    def parameter(
        self,
        shape: int | tuple[int, ...],
        compute: Callable[[ProblemData], Array],
        **attributes: bool,
    ) -> Any:
        """Return a cvxpy parameter with the value ``compute(data)``."""
        parameter = cp.Parameter(shape, **attributes)
        self._parameters.append((parameter, compute))
        return parameter

    def match_pattern(self) -> tuple[Integers, Integers, int]:
        """Return rows, columns and number of rows of S'alpha, one row per configuration and band.

        The coefficients come in the order (configuration, row of alpha, band), then
        (configuration, further unknown, band).
        """
        layout = self.layout
        c, n, k, p = layout.n_configurations, layout.n_rows, layout.n_bands, len(layout.further)
        configuration, unknown, band = np.meshgrid(
            np.arange(c), np.arange(n), np.arange(k), indexing="ij"
        )
        rows, columns = configuration * k + band, unknown * k + band
        configuration, unknown, band = np.meshgrid(
            np.arange(c), np.arange(p), np.arange(k), indexing="ij"
        )
        more_rows, more_columns = configuration * k + band, layout.n_alpha + unknown
        return (
            np.concatenate([rows.ravel(), more_rows.ravel()]),
            np.concatenate([columns.ravel(), more_columns.ravel()]),
            c * k,
        )

    def update(self, data: ProblemData) -> None:
        """Set every derived parameter for ``data``."""
        for affine in self._affine:
            affine.update(data)
        for factors, compute in self._factors:
            factors.fill(compute(data))
        for parameter, compute in self._parameters:
            parameter.save_value(compute(data))


# OSQP's status code SOLVED, from which cvxpy reads the answer's status.
_OSQP_SOLVED = 1


@dataclass(frozen=True, repr=False)
class Matrices:
    """The matrices of one QP; its first ``n_equal`` rows are equalities.

    ``P_upper`` is the upper triangle of P, sparse by columns, as Clarabel and OSQP require.
    """

    P_upper: Any
    q: Array
    A: Any
    b: Array
    n_equal: int

    def __repr__(self) -> str:
        rows, size = self.A.shape
        return (
            f"<Matrices: {size} variables, {self.n_equal} equalities, "
            f"{rows - self.n_equal} inequalities>"
        )

    @property
    def P(self) -> Any:
        """P in full, sparse by columns."""
        return sp.csc_matrix(self.P_upper + sp.triu(self.P_upper, 1).T)


@dataclass(frozen=True, repr=False)
class WhitenedQP:
    """One calibration as a QP in the whitened unknowns, for use with any QP solver.

    The unknowns of the calibration are ``centre + scale * x[first : first + len(centre)]``; other
    entries of x are helper variables.
    """

    matrices: Matrices
    centre: Array
    scale: Array
    first: int
    layout: Layout

    def __repr__(self) -> str:
        return f"<WhitenedQP: {self.layout!r}>"

    def alpha(self, x: Array) -> Array:
        """Return the absorption coefficients of a point x, (n_materials, n_bands)."""
        inner = x[self.first : self.first + len(self.centre)]
        return self.layout.expand(self.centre + self.scale * inner)


class Numbers(NamedTuple):
    """The entries of one QP's matrices, in the order of their sparse columns."""

    P: Array
    q: Array
    A: Array
    b: Array


class CompiledQP:
    """A cvxpy problem that is built, with its unknown and its constraints in order.

    ``workspaces`` keeps the last one of each solver that can update its numbers in place.
    """

    def __init__(self, problem: Any, x: Any, rows: tuple[Any, ...], lower: Any, upper: Any) -> None:
        self.problem = problem
        self.x = x
        self.rows = rows
        self.lower = lower
        self.upper = upper
        self.workspaces: dict[str, tuple[Mapping[str, Any], Any]] = {}
        self._program: Any = None

    def _compile(self) -> None:
        # cvxpy compiles only parameters that have a value of the right size.
        data, chain, inverse = self.problem.get_problem_data(cp.OSQP)
        program = data["param_prob"]
        program.reduced_A.cache()
        program.reduced_P.cache()
        size = self._size = int(data["n_var"])
        self.n_equal = int(data["n_eq"])
        self._places = [
            (parameter, program.param_id_to_col[parameter.id]) for parameter in program.parameters
        ]
        self._theta = np.ones(program.total_param_size + 1)  # its last entry is the maps' constant
        indices, indptr, shape = program.reduced_A.problem_data_index
        last = int(indptr[size])  # where the constants begin, after the last column
        self._A = (indices[:last], indptr[: size + 1])
        self._constants = indices[last:]
        self.n_rows = int(shape[0])
        indices, indptr, _ = program.reduced_P.problem_data_index
        columns = np.repeat(np.arange(size), np.diff(indptr))
        upper = indices <= columns
        counts = np.bincount(columns[upper], minlength=size)
        self._P = (indices[upper], np.concatenate([[0], np.cumsum(counts)]))
        # cvxpy's rows are A x + b in a cone; as A x <= b the inequalities change sign.
        sign = np.where(np.arange(self.n_rows) < self.n_equal, 1.0, -1.0)
        signs = np.concatenate([sign[self._A[0]], -sign[self._constants]])
        maps = [
            program.reduced_P.reduced_mat.tocsr()[upper],
            sp.csr_array(program.q)[:size],
            sp.diags_array(signs) @ program.reduced_A.reduced_mat,
        ]
        self._map = sp.csr_array(sp.vstack(maps))
        # Of an independent prior with an exact match only A and b have parameters.
        self.fixed_objective = sp.vstack(maps[:2]).tocsc()[:, :-1].nnz == 0
        self._parts = np.cumsum([0, int(upper.sum()), size, last, len(self._constants)]).tolist()
        self.column = int(program.var_id_to_col[self.x.id])
        self._unknowns = slice(self.column, self.column + self.x.size)
        self._program = program
        self._trace(chain, inverse)

    def _trace(self, chain: Any, inverse: Any) -> None:
        """Let cvxpy unpack the rows' numbers once: where it puts them is where the duals go."""
        info = SimpleNamespace(status_val=_OSQP_SOLVED, obj_val=0.0, iter=0, run_time=0.0)
        numbered = np.arange(1.0, self.n_rows + 1)
        answer = SimpleNamespace(x=np.zeros(self._size), y=numbered, info=info)
        self.problem.unpack_results(answer, chain, inverse)
        duals = (np.ravel(c.dual_value) for c in (*self.rows, self.lower, self.upper))
        self._duals = [(np.abs(d).astype(np.intp) - 1, np.sign(d)) for d in duals]

    @property
    def size(self) -> int:
        """Number of variables of the compiled problem, helper variables included."""
        return self._size

    def numbers(self) -> Numbers:
        """Return the matrices' entries for the numbers that the parameters now hold."""
        if self._program is None:
            self._compile()
        for parameter, column in self._places:
            values = np.ravel(parameter.value, order="F")
            self._theta[column : column + len(values)] = values
        values = self._map @ self._theta
        quadratic, linear, matrix, constants = (values[a:b] for a, b in pairwise(self._parts))
        limits = np.zeros(self.n_rows)
        limits[self._constants] = constants
        return Numbers(quadratic, linear, matrix, limits)

    def matrices(self, numbers: Numbers | None = None) -> Matrices:
        """Return the matrices of these numbers, or for those that the parameters now hold."""
        quadratic, linear, matrix, limits = self.numbers() if numbers is None else numbers
        return Matrices(
            sp.csc_matrix((quadratic, *self._P), (self._size, self._size)),
            linear,
            sp.csc_matrix((matrix, *self._A), (self.n_rows, self._size)),
            limits,
            self.n_equal,
        )

    def unpack(self, x: Array, y: Array) -> tuple[Array, list[Array]]:
        """Return the unknowns, and the duals of the row constraints and of the box's two sides."""
        # A copy: the solver may update its x in place.
        return x[self._unknowns].copy(), [sign * y[place] for place, sign in self._duals]


_ROUNDS = 8


def from_closed_form(data: ProblemData) -> tuple[Array, list[Array]]:
    """Return x (size,) and the duals of the exact match and of the two sides of the box.

    Coefficients that the closed form puts outside the box are fixed at their bound, and the closed form
    is solved again for the others (Bellows & Katz 2025, Sect. 3.3). This is only a start: coefficients
    once fixed are not released.
    """
    areas = data.areas[0]
    centre, scale = data.alpha(data.centre), data.alpha(data.scale)
    lower, upper = data.alpha(data.lower), data.alpha(data.upper)
    alpha = centre
    held = scale == 0
    pull = np.zeros(alpha.shape[1])
    for _ in range(_ROUNDS):
        free = np.where(held, 0.0, scale)
        moves = data.matched[0] & ((areas @ free) > 0)
        excess = areas @ np.where(held, alpha, centre) - data.target[0]
        pull = np.divide(excess, areas**2 @ free**2, out=pull, where=moves)  # D of Eqs. 23 to 25
        trial = np.where(held, alpha, centre - pull * areas[:, np.newaxis] * free**2)
        alpha = np.clip(trial, lower, upper)
        if np.array_equal(alpha, trial):
            break
        held = held | (alpha != trial)
    x = np.divide(alpha - centre, scale, out=np.zeros_like(alpha), where=scale > 0)
    force = np.divide(x, scale, out=np.zeros_like(x), where=scale > 0)
    force = np.where(held & (scale > 0), force + pull * areas[:, np.newaxis], 0.0)
    size = np.sqrt(areas**2 @ scale**2)
    return x.ravel(), [pull * size, np.maximum(force, 0).ravel(), np.maximum(-force, 0).ravel()]
