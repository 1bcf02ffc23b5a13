"""cvxpy's compiled problem, and how it is filled with numbers.

cvxpy compiles a DPP problem once into maps that are affine in its parameters. This module applies
the maps itself, in three products, which takes a tenth of the time that cvxpy takes. The interfaces
of Clarabel, OSQP and qpsolvers share one form:

    minimise ½ x'Px + q'x  subject to  A x = b (the first n_equal rows)  and  A x <= b (the others).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from rtcal.calibration.layout import Layout
from rtcal.support.types import Array

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


class CompiledQP:
    """A cvxpy problem that is built, with its unknown and its constraints in order."""

    def __init__(self, problem: Any, x: Any, rows: tuple[Any, ...], lower: Any, upper: Any) -> None:
        self.problem = problem
        self.x = x
        self.rows = rows
        self.lower = lower
        self.upper = upper
        self._program: Any = None

    def _compile(self) -> None:
        # cvxpy compiles only parameters that have a value of the right size.
        data, self._chain, self._inverse = self.problem.get_problem_data(cp.OSQP)
        program = data["param_prob"]
        program.reduced_A.cache()
        program.reduced_P.cache()
        self._program = program
        self._size = int(data["n_var"])
        self._n_equal = int(data["n_eq"])
        self._places = [
            (parameter, program.param_id_to_col[parameter.id]) for parameter in program.parameters
        ]
        indices, indptr, shape = program.reduced_A.problem_data_index
        self._last = int(indptr[self._size])  # where the constants begin, after the last column
        self._index = (indices[: self._last], indptr[: self._size + 1])
        self._constants = indices[self._last :]
        self._n_rows = int(shape[0])
        # cvxpy's rows are A x + b in a cone; as A x <= b the inequalities change sign.
        sign = np.where(np.arange(self._n_rows) < self._n_equal, 1.0, -1.0)
        self._sign = sign
        self._entry_sign = sign[self._index[0]]
        indices, indptr, _ = program.reduced_P.problem_data_index
        columns = np.repeat(np.arange(self._size), np.diff(indptr))
        self._upper = indices <= columns
        counts = np.bincount(columns[self._upper], minlength=self._size)
        self._upper_index = (indices[self._upper], np.concatenate([[0], np.cumsum(counts)]))

    @property
    def size(self) -> int:
        """Number of variables of the compiled problem, helper variables included."""
        return self._size

    @property
    def column(self) -> int:
        """Index of the first unknown among the compiled variables."""
        return int(self._program.var_id_to_col[self.x.id])

    def matrices(self) -> Matrices:
        """Return the matrices for the numbers that the parameters now hold."""
        if self._program is None:
            self._compile()
        program = self._program
        theta = np.empty(program.total_param_size + 1)
        theta[-1] = 1.0  # the constant part of the maps
        for parameter, column in self._places:
            theta[column : column + parameter.size] = np.ravel(parameter.value, order="F")
        values = program.reduced_A.reduced_mat @ theta
        offset = np.zeros(self._n_rows)
        offset[self._constants] = values[self._last :]
        matrix = sp.csc_matrix(
            (values[: self._last] * self._entry_sign, *self._index), (self._n_rows, self._size)
        )
        upper = (program.reduced_P.reduced_mat @ theta)[self._upper]
        quadratic = sp.csc_matrix((upper, *self._upper_index), (self._size, self._size))
        linear = np.asarray(program.q @ theta).ravel()[: self._size]
        return Matrices(quadratic, linear, matrix, -self._sign * offset, self._n_equal)

    def unpack(self, x: Array, y: Array, iterations: int, seconds: float) -> None:
        """Let cvxpy set the values and duals of its variables and constraints."""
        info = SimpleNamespace(
            status_val=_OSQP_SOLVED, obj_val=0.0, iter=iterations, run_time=seconds
        )
        answer = SimpleNamespace(x=x, y=y, info=info)
        self.problem.unpack_results(answer, self._chain, self._inverse)
