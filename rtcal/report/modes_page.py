"""The page of a calibration to room modes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rtcal.modes.result import ModesResult
from rtcal.modes.room_modes import DECAY
from rtcal.report import words
from rtcal.report.document import Heading, blocks, material_rows, render, source
from rtcal.report.figures import BLACK, BLUE, ORANGE, new_figure


def page(result: ModesResult, heading: Heading, step: Callable[[], None]) -> str:
    """Return the page as HTML; raises as `rtcal.report.page.calibration_page`."""
    room = result.prior
    measured = np.isfinite(result.data.reverberation_time)
    carries = np.where(result.below, np.where(result.carried, "modes", "–"), "T")
    return render(
        "modes.html",
        {
            "result": result,
            "decays": {
                "source": source(_decays(result), step),
                "alt": f"{room.name}: decay times of the modes, measured, before and after",
                "caption": "Decay time of each mode used: measured, with the stated coefficients, and "
                "after the calibration.",
            },
            "rows": result.mode_rows,
            "labels": [f"{f:g} Hz" for f in room.centre_frequencies],
            "blocks": blocks(room.n_bands),
            "carries": np.where(result.below | measured, carries, "–"),
            "materials": material_rows(
                room.materials,
                room.areas,
                room.alpha,
                result.alpha,
                result.interval,
                np.isin(result.alpha, (0.0, 1.0)),
            ),
            "doubts": words.doubts(result.trust_marks),
        },
        heading.completed(room.name, room.author),
    )


def _decays(result: ModesResult) -> Any:
    """Return the decay times of the modes used over their frequencies."""
    figure, axes = new_figure()
    f = result.modes.frequencies[result.used]
    t, relative = DECAY / result.measured, result.modes.decay_uncertainty[result.used]
    axes.errorbar(f, t, t * relative / result.measured, fmt="o", color=BLACK, label="measured")
    axes.plot(f, DECAY / result.before, "x", color=ORANGE, label="before")
    axes.plot(f, DECAY / result.after, "s", color=BLUE, fillstyle="none", label="after")
    axes.set_xlabel("frequency / Hz")
    axes.set_ylabel("T / s")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small")
    return figure
