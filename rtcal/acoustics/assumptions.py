"""Assumptions on the errors of a prediction."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.errors import DataError


@checked
@dataclass(frozen=True, kw_only=True)
class Assumptions:
    """Standard deviations of what a prediction cannot know; docs/prediction_study.md tests them.

    Parameters
    ----------
    volume, areas : float
        Relative errors of V, and of the area of each material, where the room states none.
    common : float
        Error of ln T that the equation makes in all states of a room alike. It also stands for
        handbook coefficients that are wrong together: T alone cannot tell the two apart.
    own : float
        Error of ln T that the equation makes in each state on its own.
    changed : float
        Least sigma of alpha of a material whose area changes. A coefficient with sigma 0 is exact and
        stays so.
    time : float
        Relative uncertainty of a measured T that states none: one just noticeable difference.
    band_correlation : float
        Correlation of the errors of ln T in bands an octave apart; it falls as
        band_correlation ** octaves. Only the probability of all bands together uses it.

    Raises
    ------
    DataError
        If one is below 0 or above 1.

    Examples
    --------
    >>> Assumptions(volume=0.01).own
    0.06
    """

    volume: float = 0.03
    areas: float = 0.03
    common: float = 0.2
    own: float = 0.06
    changed: float = 0.1
    time: float = 0.05
    band_correlation: float = 0.7

    def __post_init__(self) -> None:
        for each in fields(self):
            value = checks.number(each.name, getattr(self, each.name))
            if not (np.isfinite(value) and 0 <= value <= 1):
                raise DataError(f"{each.name} = {value:g} is not from 0 to 1")
        if self.band_correlation == 1:
            raise DataError("band_correlation = 1 is not below 1")
