"""The model's error: its bias and covariance, as control rooms show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rtcal.finder.case import Case
from rtcal.finder.means.engines import ControlRooms, bias_estimates
from rtcal.finder.model import FEATURES
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

COMMON_UNCERTAINTY: Mapping[str, float] = {"edt": 0.05, "t30": 0.018, "c80": 0.5, "g": 0.5}
"""Standard uncertainty of the model common to all bands and configurations, in ln and dB. The scatter
of one engine does not show it; that between engines does."""
COMMON_CORRELATION = 0.85
"""Its correlation from octave to octave."""
SHRINKAGE = 0.4
"""Weight of the diagonal in the model's covariance, which is estimated from few control rooms.
0.2 and 0.8 change no count of the development rooms."""
INFLATION = 1.2
"""Factor on the model's covariance. Chosen on development rooms, so that the threshold also holds on an
engine that it was not estimated from (docs/discrepancy.md); 1.0 and 1.5 change no count there."""


@dataclass(frozen=True, eq=False)
class ModelDiscrepancy:
    """Bias and covariance of the model's error, over all features raveled.

    ``factor`` (n, r), where it is given, has the covariance's low rank: without factor factor' it is
    diagonal.
    """

    bias: Array
    covariance: Array
    engines: tuple[str, ...] = ()
    factor: Array | None = None


def checked_discrepancy(case: Case, discrepancy: object) -> ModelDiscrepancy:
    """Return a discrepancy of this case's shape; DataError otherwise."""
    checked = checks.instance("discrepancy", discrepancy, ModelDiscrepancy)
    n = len(case.configurations) * len(FEATURES) * case.room.n_bands
    if checked.bias.shape != (n,) or checked.covariance.shape != (n, n):
        raise DataError(
            f"discrepancy has a bias of shape {checked.bias.shape}; this case's is ({n},): it is of "
            "another case"
        )
    return checked


def estimate_discrepancy(case: Case, controls: Sequence[ControlRooms]) -> ModelDiscrepancy:
    """Return bias and covariance of the model's discrepancy from control rooms.

    The bias is the mean of `bias_estimates`. The covariance is the scatter within each engine plus the
    scatter between these estimates. A sample covariance of few rooms is shrunk towards its diagonal.
    """
    n, k = len(case.configurations), case.room.n_bands
    size = n * len(FEATURES) * k
    estimates = bias_estimates(controls)
    bias = np.nanmean(estimates, axis=0)
    degrees = np.maximum(np.isfinite(estimates).sum(axis=0) - 1, 1)
    between = (np.nan_to_num(estimates - bias) / np.sqrt(degrees)).reshape(len(estimates), size)
    rows = [between]
    for c in controls:
        centred = np.nan_to_num(c.errors - c.mean).reshape(-1, size)
        rows.append(centred / np.sqrt(max(len(centred) - 1, 1) * len(controls)))
    octaves = np.log2(case.room.centre_frequencies)
    over_bands = COMMON_CORRELATION ** np.abs(np.subtract.outer(octaves, octaves))
    root = np.linalg.cholesky(over_bands).T
    for name, uncertainty in COMMON_UNCERTAINTY.items():
        common = np.zeros((k, n, len(FEATURES), k))
        common[:, :, FEATURES.index(name)] = uncertainty * root[:, None]
        rows.append(common.reshape(k, size))
    factor = np.concatenate(rows).T * np.sqrt(INFLATION)
    full = factor @ factor.T
    factor *= np.sqrt(1 - SHRINKAGE)
    shrunk = (1 - SHRINKAGE) * full + SHRINKAGE * np.diag(np.diag(full))
    return ModelDiscrepancy(bias.ravel(), shrunk, tuple(c.engine for c in controls), factor)
