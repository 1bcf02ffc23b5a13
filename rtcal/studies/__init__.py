"""Stochastic studies of calibration methods (Bellows & Katz 2025, Sect. 3.4).

Examples
--------
>>> from rtcal import studies
>>> table = studies.analytic_scores(studies.paper.SHOEBOX, sigma_r=0.1, realisations=1000, seed=1)
>>> print(table.method[table.score.argmax()])
mle
"""

from rtcal.studies import paper
from rtcal.studies.paper import analytic_emse
from rtcal.studies.study import (
    analytic_scores,
    run,
)

__all__ = [
    "analytic_emse",
    "analytic_scores",
    "paper",
    "run",
]
__dir__ = __all__.copy
