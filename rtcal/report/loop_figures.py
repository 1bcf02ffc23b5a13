"""The figure of a closed loop's steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.quality import gap_jnd
from rtcal.errors import DataError
from rtcal.report.figures import BLACK, BLUE, ORANGE, band_axis, jnd_band, new_figure, shown
from rtcal.support.arguments import checked

if TYPE_CHECKING:
    from rtcal.loop.state import Loop

__all__ = ["path"]
__dir__ = __all__.copy

_MARKERS = "o^vDPX<>"
_STYLES = ("-", "--", "-.", ":")


@checked
def path(loop: Loop) -> Any:
    """Return the figure of a loop's path, like Fig. 7 of Bellows & Katz (2025).

    Above: the measured T20 with its band of one JND, and the simulated T20 of the first, the
    intermediate and each band's best step. Below: each band's gap in JND over the simulations.

    Raises
    ------
    DataError
        If nothing has been simulated yet.
    """
    if not loop.steps:
        raise DataError("the loop has no simulation yet: there is no path to show")
    figure, (above, below) = new_figure(6.2, 7.6, 2, 1)
    f, wanted = loop.room.centre_frequencies, loop.wanted
    jnd_band(above, f, wanted)
    above.plot(f, wanted, color=BLACK, marker="o", markersize=4, label="measured")
    simulated = np.array([step.simulated for step in loop.steps])
    for number, times in enumerate(simulated[1:-1], start=2):
        above.plot(
            f,
            times,
            color="0.45",
            linestyle=":",
            linewidth=1,
            label="in between" if number == 2 else None,
        )
    above.plot(f, simulated[0], color=ORANGE, marker="s", linestyle="--", label="first simulation")
    above.plot(
        f,
        simulated[loop.best, np.arange(len(f))],
        color=BLUE,
        marker="o",
        markersize=10,
        markerfacecolor="none",
        label="nearest, by band",
    )
    band_axis(above, f)
    above.set_ylabel(f"{loop.matched.label.removeprefix('the ')} / s")
    above.set_ylim(bottom=0)
    above.set_title(shown(loop.room.name, 45))
    above.legend(fontsize=9)
    gaps = np.array([gap_jnd(times, wanted) for times in simulated])
    steps = np.arange(1, len(gaps) + 1)
    below.axhspan(-1, 1, color="0.85")
    below.axhline(0, color=BLACK, linewidth=0.8)
    greys = np.linspace(0.0, 0.6, len(f))
    for k, frequency in enumerate(f):
        blue = (greys[k], 0.25 + 0.65 * greys[k], 0.45 + 0.35 * greys[k])
        below.plot(
            steps,
            gaps[:, k],
            color=blue,
            marker=_MARKERS[k % len(_MARKERS)],
            linestyle=_STYLES[(k + k // len(_MARKERS)) % len(_STYLES)],
            label=f"{frequency:g} Hz",
        )
    below.set_xticks(steps)
    below.set_xlim(0.7, len(steps) + 0.3)
    reach = 1.2 * max(1.5, float(np.nanmax(np.abs(gaps), initial=0.0)))
    below.set_ylim(-reach, reach)
    below.set_xlabel("Simulation number")
    below.set_ylabel("Gap (simulated - measured) / JND")
    below.set_title("Gap by simulation (grey: within 1 JND)")
    below.legend(fontsize=9, ncols=2 if len(f) > 8 else 1)
    return figure
