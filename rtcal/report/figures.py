"""The pictures. The one module that imports matplotlib."""

from __future__ import annotations

import io
import os
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.files import write_bytes
from rtcal.acoustics.quality import JND, letters
from rtcal.errors import DataError, MissingDependencyError

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

# Told apart in grey and by colour-blind eyes (Okabe & Ito 2008), and by their markers.
_MEASURED, _BEFORE, _AFTER = "#000000", "#D55E00", "#0072B2"


def new_figure(width: float = 7.0, height: float = 4.2) -> tuple[Any, Any]:
    """Return a figure of that size in inches and its axes, drawn without a screen.

    Raises MissingDependencyError without matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingDependencyError(
            "figures need matplotlib: pip install 'rtcal[report]'"
        ) from error
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots()


def reverberation_time(result: CalibrationResult) -> Any:
    """Return the figure of T(f): measured with its band of one JND, before and after."""
    figure, axes = new_figure()
    room, measured = result.prior, result.measured
    f = room.centre_frequencies
    here = np.isfinite(measured)
    jnd = JND["t20"] * measured[here]
    axes.fill_between(
        f[here], measured[here] - jnd, measured[here] + jnd, color="0.85", label="measured ± 1 JND"
    )
    uncertainty = np.nan_to_num(result.measured_uncertainty)
    axes.errorbar(
        f[here], measured[here], yerr=uncertainty[here], color=_MEASURED, marker="o", capsize=3,
        linestyle="none", label="measured, ± standard uncertainty",
    )  # fmt: skip
    axes.plot(
        f, result.reverberation_time_before, color=_BEFORE, marker="s", linestyle="--",
        label="before calibration",
    )  # fmt: skip
    axes.plot(
        f, result.reverberation_time_after, color=_AFTER, marker="o", markersize=10,
        markerfacecolor="none", label="after calibration",
    )  # fmt: skip
    axes.set_xscale("log")
    many = len(f) > 10
    marked = [f"{v:g}{' ' if many else chr(10)}{letters(result.trust_marks, v)}" for v in f]
    axes.set_xticks(f, marked, rotation=90 if many else 0)
    axes.minorticks_off()
    found = [f"{m.letter} {m.title}".strip() for m in result.trust_marks]
    key = f"\ndo not trust: {', '.join(dict.fromkeys(found))}" if found else ""
    axes.set_xlabel(f"Octave or third-octave band centre frequency / Hz{key}")
    axes.set_ylabel("Reverberation time T / s")
    axes.set_ylim(bottom=0)
    # A name is a name, also with dollars in it.
    axes.set_title(f"{room.name}: {result.method}, {result.equation.name}", parse_math=False)
    axes.legend()
    return figure


def rendered(figure: Any, kind: str) -> bytes:
    """Return a figure as the bytes of a ``png``, ``svg`` or ``pdf`` file."""
    stream = io.BytesIO()
    with warnings.catch_warnings():
        # A name in a script that the font lacks is shown as boxes; it stops nothing.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        figure.savefig(stream, format=kind, dpi=150)
    return stream.getvalue()


def save(figure: Any, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG, SVG or PDF by the path's ending, whole or not at all."""
    kind = os.path.splitext(os.fspath(path))[1].lstrip(".").lower()
    if kind not in ("png", "svg", "pdf"):
        raise DataError(f'{path}: a figure ends with .png, .svg or .pdf, not ".{kind}"')
    write_bytes(path, rendered(figure, kind))
