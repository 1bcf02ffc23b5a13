"""Contradicting constraints, explained by the smallest relaxation that makes them feasible."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from rtcal.calibration.numpy_model import NumpyModel
from rtcal.errors import InfeasibleError
from rtcal.support.types import Array

_NOTHING = 1e-9


def explain(model: NumpyModel) -> None:
    """Raise InfeasibleError, with the smallest relaxation, if the constraints contradict each other.

    An elastic linear programme (Chinneck 2008, ch. 6): minimise the sum of all relaxations, subject to
    every row and every bound of a term, relaxed. Relaxations are in absorption coefficients; a row's is
    divided by the sum of its coefficients of one sign. 0 <= alpha <= 1 and fixed unknowns are not
    relaxed.
    """
    from scipy.optimize import linprog

    data, layout = model.data, model.data.layout
    matrix = sp.csr_array(model.matrix)
    n_rows, size = matrix.shape
    sides = [np.asarray(part.maximum(0).sum(axis=1)).ravel() for part in (matrix, -matrix)]
    norm = np.maximum(*sides)
    norm[norm == 0] = 1.0
    scaled = sp.diags_array(1 / norm) @ matrix
    # Unknowns, then relaxations of rows up and down, then of the box down and up.
    low, high = model.row_lower / norm, model.row_upper / norm
    identity, none = sp.eye_array(n_rows), sp.csr_array((n_rows, size))
    square, empty = sp.eye_array(size), sp.csr_array((size, n_rows))
    above = sp.hstack([scaled, identity * 0, -identity, none, none])
    below = sp.hstack([-scaled, -identity, identity * 0, none, none])
    floor = sp.hstack([-square, empty, empty, -square, square * 0])
    ceiling = sp.hstack([square, empty, empty, square * 0, -square])
    limits = np.concatenate([high, -low, -model.lower, model.upper])
    system = sp.csr_array(sp.vstack([above, below, floor, ceiling]))
    used = np.isfinite(limits)
    held = ~model.movable
    hard_upper = np.where(np.arange(size) < layout.n_alpha, 1.0, np.inf)
    bounds = np.concatenate(
        [
            np.column_stack(
                [np.where(held, data.centre, 0.0), np.where(held, data.centre, hard_upper)]
            ),
            np.column_stack(
                [np.zeros(2 * n_rows + 2 * size), np.full(2 * n_rows + 2 * size, np.inf)]
            ),
        ]
    )
    cost = np.concatenate([np.zeros(size), np.ones(2 * n_rows + 2 * size)])
    program = linprog(cost, A_ub=system[used], b_ub=limits[used], bounds=bounds, method="highs")
    if program.status != 0 or program.fun <= _NOTHING:
        return
    relaxed = program.x[size:]
    raise InfeasibleError(
        "the constraints contradict each other. The smallest relaxation that removes it: "
        + "; ".join(_named(model, relaxed, norm))
    )


def _named(model: NumpyModel, relaxed: Array, norm: Array) -> list[str]:
    layout = model.data.layout
    n_rows, size = len(norm), layout.size
    labels = [
        term.label(row, layout)
        for term in model.row_constraints
        for row in range(len(term.row_scale(model.data)))
    ]
    out = []
    for side, (start, word) in enumerate(((0, "lower"), (n_rows, "higher"))):
        for row in np.flatnonzero(relaxed[start : start + n_rows] > _NOTHING):
            limit = (model.row_lower, model.row_upper)[side][row]
            by = relaxed[start + row] * norm[row]
            out.append(f"{labels[row]}: {limit:.4g} has to be {by:.4g} {word}")
    for start, limits, word in (
        (2 * n_rows, model.lower, "lower bound {:.4g} has to be {:.4g} lower"),
        (2 * n_rows + size, model.upper, "upper bound {:.4g} has to be {:.4g} higher"),
    ):
        for u in np.flatnonzero(relaxed[start : start + size] > _NOTHING):
            out.append(f"{layout.place(int(u))}: " + word.format(limits[u], relaxed[start + u]))
    return out
