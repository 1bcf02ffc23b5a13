"""The page of what changed between two measurements of one room."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rtcal.finder.states.finding import StatesFinding
from rtcal.finder.states.verification import verify
from rtcal.report.document import Heading, blocks, render, source
from rtcal.report.figures import BLACK, BLUE, ORANGE, band_axis, new_figure
from rtcal.support.arguments import checked


@checked
def page(finding: StatesFinding, heading: Heading, step: Callable[[], None]) -> str:
    """Return the page as HTML; raises as `rtcal.report.page.page`."""
    found = finding.case.differences
    measured = found.measured
    frequencies = found.centre_frequencies[measured]
    mean, low, high = finding.change[:, measured]
    name = finding.case.room.name
    return render(
        "states.html",
        {
            "headline": finding.headline,
            "verified": verify(finding).sentence if finding.can_be_verified else None,
            "sentences": list(finding.sentences),
            "surfaces": [
                (name, 100 * p, "claimed" if name in finding.claimed_surfaces else "")
                for name, p in finding.surfaces.items()
            ],
            "can_be_added": finding.can_be_added,
            "kinds": [
                (k.name, 100 * k.probability, k.size.words)
                for k in finding.kinds
                if finding.best is not None
            ],
            "rows": [
                ("T before / s", found.before[measured], 2, False),
                ("T after / s", found.after[measured], 2, False),
                ("absorption area before / m²", finding.area[measured], 1, False),
                ("change / m²", mean, 1, True),
                ("90 % interval: from / m²", low, 1, True),
                ("to / m²", high, 1, True),
            ],
            "blocks": blocks(len(frequencies)),
            "labels": [f"{f:g} Hz" for f in frequencies],
            "times": {
                "source": source(_times(finding), step),
                "alt": f"{name}: T before and after, by band",
                "caption": "T by band, mean over the pairs that both states have.",
            },
            "change": {
                "source": source(change_figure(finding), step),
                "alt": f"{name}: change of the absorption area, by band",
                "caption": "Change of the absorption area with its 90 % interval, if it changed.",
            },
            "equation": finding.case.equation.name,
            "n_pairs": len(found.pairs),
        },
        heading.completed(name, finding.case.room.author),
    )


def _times(finding: StatesFinding) -> Any:
    """Return T(f) before and after."""
    found = finding.case.differences
    k = found.measured
    figure, axes = new_figure()
    frequencies = found.centre_frequencies[k]
    axes.plot(frequencies, found.before[k], color=BLACK, linestyle="--", marker=".", label="before")
    axes.plot(frequencies, found.after[k], color=ORANGE, marker="o", label="after")
    band_axis(axes, frequencies)
    axes.set_ylim(0, 1.1 * float(max(found.before[k].max(), found.after[k].max())))
    axes.set_ylabel("T / s")
    axes.legend(fontsize="small")
    return figure


@checked
def change_figure(finding: StatesFinding) -> Any:
    """Return the change of the absorption area by band, with its interval."""
    k = finding.case.differences.measured
    figure, axes = new_figure()
    frequencies = finding.case.room.centre_frequencies[k]
    mean, low, high = finding.change[:, k]
    ends = np.maximum(np.array([mean - low, high - mean]), 0.0)
    axes.axhline(0, color=BLACK, linewidth=0.8)
    axes.errorbar(frequencies, mean, yerr=ends, color=BLUE, marker="s", capsize=3)
    band_axis(axes, frequencies)
    axes.set_ylabel("change of the absorption area / m²")
    return figure
