"""The measured features of a case and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtcal.acoustics import bands
from rtcal.discrepancy.case import Case
from rtcal.discrepancy.configuration import Configuration
from rtcal.discrepancy.model import FEATURES
from rtcal.errors import DataError
from rtcal.support.types import Array

LARGEST_UNCERTAINTY = 0.15
"""Relative standard uncertainty of T beyond which a band is dropped: three JND of T (5 % each).

The evidence takes ln T as normal. With u = 15 % the mean of ln T is off by u²/2 = 1.1 %, which is 0.08
of its standard deviation; the error grows with u."""
UNSTATED_TIME = 0.03
"""Relative standard uncertainty of a decay time that states none.

Between teams T30 at one pair differed by 4.6 % (125 Hz) to 1.3 % (4 kHz) (standard deviations, Bork
2005; see `Measurement.mean_uncertainty`); 3 % is the middle. Half of it changes the finding in 1 of 8
rooms with single pairs, twice of it in none (benchmarks/unstated_uncertainty.py)."""
UNSTATED_LEVEL = 0.5
"""Standard uncertainty in dB of C80 and G that state none: half a JND (ISO 3382-1, Table A.1: 1 dB).

Chosen. Half of it changes the finding in none of 8 rooms with single pairs, twice of it in 2, whose
finding was ambiguous or a hint (benchmarks/unstated_uncertainty.py). State the uncertainty of G if the
source's calibration is less certain."""


@dataclass(frozen=True, eq=False)
class Observed:
    """The measured features.

    Attributes
    ----------
    features : array (n_configurations, n_features, n_bands)
        NaN where nothing was measured.
    used : bool array, same shape
    covariance : array (n_used, n_used)
        R, the measurement covariance of the features in use.
    """

    features: Array
    used: Array
    covariance: Array

    @property
    def values(self) -> Array:
        """The features in use, (n_used,)."""
        return np.asarray(self.features[self.used])


def observe(case: Case) -> tuple[Observed, list[str]]:
    """Return the measured features, and notes on the bands that were dropped.

    Raises
    ------
    DataError
        If no band is left.
    """
    notes: list[str] = []
    n, k = len(case.configurations), case.room.n_bands
    table = np.full((n, len(FEATURES), k), np.nan)
    blocks = np.zeros((n, k, len(FEATURES), len(FEATURES)))
    for c, configuration in enumerate(case.configurations):
        table[c], blocks[c] = _features(configuration)
        for b, f in enumerate(configuration.measured.centre_frequencies):
            if blocks[c, b, 0, 0] > LARGEST_UNCERTAINTY**2:
                u = 100 * float(np.sqrt(blocks[c, b, 0, 0]))
                notes.append(
                    f'"{configuration.name}": {bands.label(f)} dropped: T is known to {u:.0f} % only'
                )
                table[c, :, b] = np.nan
            elif np.isnan(table[c, 0, b]):
                notes.append(f'"{configuration.name}": {bands.label(f)} dropped: no T20')
                table[c, :, b] = np.nan
    used = np.isfinite(table)
    full = np.zeros((n, len(FEATURES), k, n, len(FEATURES), k))
    for c in range(n):
        for b in range(k):
            full[c, :, b, c, :, b] = np.nan_to_num(blocks[c, b])
    flat = used.ravel()
    size = flat.size
    if not used.any():
        raise DataError(
            "no band of any configuration has a T that can be trusted: " + "; ".join(notes)
        )
    return Observed(table, used, full.reshape(size, size)[np.ix_(flat, flat)]), notes


def _features(configuration: Configuration) -> tuple[Array, Array]:
    m = configuration.measured
    t20, t30, edt = m.mean("t20"), m.mean("t30"), m.mean("edt")
    relative = {p: m.mean_uncertainty(p) / m.mean(p) for p in ("t20", "t30", "edt")}
    amount, u = (t20, relative["t20"]) if "t20" in m.values else (t30, relative["t30"])
    with np.errstate(divide="ignore", invalid="ignore"):
        table = np.stack(
            [np.log(amount), np.log(edt / amount), np.log(t30 / amount), m.mean("c80"), m.mean("g")]
        )
    if "t20" not in m.values:
        table[2] = np.nan  # T30 replaces the missing T20, so the ratio would be 0 by construction
    k = len(t20)
    base = np.where(np.isfinite(u), u, UNSTATED_TIME)
    e, t = (np.where(np.isfinite(relative[p]), relative[p], UNSTATED_TIME) for p in ("edt", "t30"))
    block = np.zeros((k, 5, 5))
    block[:, 0, 0] = base**2
    block[:, 1, 1] = base**2 + e**2
    block[:, 2, 2] = base**2 + t**2
    # Both ratios have T20 in the denominator.
    block[:, 0, 1] = block[:, 1, 0] = block[:, 0, 2] = block[:, 2, 0] = -(base**2)
    block[:, 1, 2] = block[:, 2, 1] = base**2
    for row, p in ((3, "c80"), (4, "g")):
        stated = m.mean_uncertainty(p)
        block[:, row, row] = np.where(np.isfinite(stated), stated, UNSTATED_LEVEL) ** 2
    return table, block
