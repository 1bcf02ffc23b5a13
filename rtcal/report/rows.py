"""Rows of the pages' tables of absorption coefficients."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtcal.support.types import Array


def material_rows(
    names: Iterable[str],
    areas: Array,
    before: Array,
    after: Array,
    interval: tuple[Array, Array] | None = None,
    at_bound: NDArray[np.bool_] | None = None,
) -> list[dict[str, Any]]:
    """Return one row per material: name, area, and a cell per band.

    Parameters
    ----------
    names : iterable of str (n_materials,)
    areas : array (n_materials,)
        m².
    before, after : array (n_materials, n_bands)
        Coefficients as stated and as calibrated.
    interval : (array, array), optional
        Ends of the calibrated coefficients' 90 % intervals, each (n_materials, n_bands).
    at_bound : array of bool (n_materials, n_bands), optional
        Which coefficients stand at a bound; they get a star.
    """
    rows = []
    for i, name in enumerate(names):
        cells: list[dict[str, Any]] = [
            {"before": b, "after": a, "star": ""} for b, a in zip(before[i], after[i], strict=True)
        ]
        for k, cell in enumerate(cells):
            if interval is not None:
                cell |= {"low": interval[0][i, k], "high": interval[1][i, k]}
            if at_bound is not None and at_bound[i, k]:
                cell["star"] = "*"
        rows.append({"name": name, "area": areas[i], "cells": cells})
    return rows
