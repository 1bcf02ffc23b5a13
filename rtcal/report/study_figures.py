"""Figures of the stochastic study, like Figs. 2 and 4 of Bellows & Katz (2025)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rtcal.acoustics.priors import TruncatedNormal
from rtcal.report.figures import new_figure
from rtcal.studies.study import Table
from rtcal.support.arguments import checked

__all__ = ["priors", "spread"]
__dir__ = __all__.copy

_STYLES = ("-", "--", "-.", ":", (0, (9, 3)), (0, (7, 2, 1, 2, 1, 2)))
_MARKERS = "os^Dv*"
NAMES = {"none": "BASE", "scaling": "REF", "lse": "LSE", "mle": "MLE"}


@checked
def priors(mu: Sequence[float], sigma: Sequence[float], title: str) -> Any:
    """Return the figure of truncated normal densities on [0, 1] (Figs. 2 and 4a)."""
    figure, axes = new_figure()
    alpha = np.linspace(0, 1, 1001)
    for i, (m, s) in enumerate(zip(mu, sigma, strict=True)):
        density = TruncatedNormal(np.asarray(m), np.asarray(s)).pdf(alpha)
        label = f"μ = {m:g}, σ = {s:g}"
        axes.plot(
            alpha,
            density,
            linestyle=_STYLES[i % len(_STYLES)],
            marker=_MARKERS[(i + i // len(_STYLES)) % len(_MARKERS)],
            markevery=[int(density.argmax())],
            label=label,
        )
    axes.set_xlabel("Absorption coefficient α")
    axes.set_ylabel("Probability density")
    axes.set_xlim(0, 1)
    axes.set_ylim(bottom=0)
    axes.set_title(title)
    axes.legend()
    return figure


@checked
def spread(table: Table, aace: Sequence[float], title: str) -> Any:
    """Return the box plot of the root of EMSE over realisations (Fig. 4b).

    ``table`` is `Study.spread`'s, ``aace`` the mean line of each of its rows.
    """
    figure, axes = new_figure()
    boxes = [
        {
            "label": NAMES[str(r.method)] + ("\nbounded" if r.bounded else ""),
            "whislo": r.least,
            "q1": r.first_quartile,
            "med": r.median,
            "q3": r.third_quartile,
            "whishi": r.most,
            "mean": mean,
        }
        for r, mean in zip(table, aace, strict=True)
    ]
    axes.bxp(boxes, showfliers=False, showmeans=True, meanline=True)
    axes.set_ylabel("Root of EMSE of α, over realisations")
    axes.set_ylim(bottom=0)
    axes.set_title(title + " (dashed: AACE)")
    axes.set_xlabel("Calibration method")
    return figure
