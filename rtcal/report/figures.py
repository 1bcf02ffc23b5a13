"""The figures of a calibration over frequency, and its folder. No other module imports matplotlib.

The figures can be read in grey and by colour-blind readers: each line has its own marker and style,
each bar its own hatch, and the colours are Okabe and Ito's (2008).
"""

from __future__ import annotations

import io
import os
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtcal.acoustics.marks import letters
from rtcal.acoustics.observables import TARGET
from rtcal.files.disk import make_folder, write_all, write_bytes
from rtcal.files.saved import NUMBERS
from rtcal.io.mend import Faces
from rtcal.simulators.geometry import Polyhedron
from rtcal.support import checks
from rtcal.support.errors import DataError, MissingDependencyError
from rtcal.support.text import number
from rtcal.support.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rtcal.calibration.result import CalibrationResult
    from rtcal.loop.positions_result import PositionsResult
    from rtcal.modes.result import ModesResult

__all__ = ["gap", "rendered", "reverberation_time", "save"]
__dir__ = __all__.copy


def wireframe(mesh: Polyhedron | Faces, open_edges: Array | None = None) -> Any:
    """Return the figure of a mesh, drawn or mended, with its open edges, (n, 2, 3) in m, in red.

    Each material has its own shade; the legend names those of the largest areas.
    """
    if isinstance(mesh, Polyhedron):
        polygons = [mesh.vertices[list(face)] for face in mesh.faces]
    else:
        polygons = [np.asarray(polygon) for polygon in mesh.polygons]
    figure, _ = new_figure(9.0, 7.0)
    figure.clear()
    axes = figure.add_subplot(projection="3d")
    of_material: dict[str, list[Array]] = {}
    for polygon, material in zip(polygons, mesh.materials, strict=True):
        of_material.setdefault(material, []).append(np.concatenate([polygon, polygon[:1]]))
    for material, loops in of_material.items():
        between = np.full((1, 3), np.nan)
        line = np.concatenate([part for loop in loops for part in (loop, between)])
        axes.plot(*line.T, linewidth=0.6, label=shown(material))
    if open_edges is not None and len(open_edges):
        gaps = np.concatenate([np.concatenate([e, np.full((1, 3), np.nan)]) for e in open_edges])
        axes.plot(*gaps.T, color="red", linewidth=2, label=f"{len(open_edges)} open edges")
    corners = np.concatenate(polygons)
    axes.set_box_aspect(np.maximum(np.ptp(corners, axis=0), 1e-3), zoom=0.9)
    for axis in "xyz":
        getattr(axes, f"set_{axis}label")(f"{axis} / m")
    if len(of_material) <= 20:
        figure.legend(fontsize="x-small", loc="outside right upper")
    return figure


BLACK, ORANGE, BLUE, GREEN = "#000000", "#D55E00", "#0072B2", "#009E73"
MEASURED: dict[str, Any] = {"color": BLACK, "marker": "o", "linestyle": "none"}
BEFORE: dict[str, Any] = {"color": ORANGE, "marker": "s", "linestyle": "--"}
AFTER: dict[str, Any] = {"color": BLUE, "marker": "o", "markersize": 10, "markerfacecolor": "none"}
"""Lines of what was measured, and of a model before and after its calibration."""
_LONGEST_NAME = 40
_MANY_BANDS = 10
MOST_PANELS = 12
"""Largest number of materials of which a figure draws one each; the table of a page lists more."""
_FEW = 6
ROOM, FIGURE = "room.toml", "reverberation_time.png"
FILES = (ROOM, NUMBERS, FIGURE)
"""Files of a calibration's folder."""
_MOST_AXES = 10_000  # a panel takes 0.1 MB


def new_figure(
    width: float = 7.0, height: float = 4.2, rows: int = 1, columns: int = 1
) -> tuple[Any, Any]:
    """Return a figure of that size in inches and its axes, drawn without a screen.

    Axes as ``matplotlib.figure.Figure.subplots`` gives them. Raises MissingDependencyError without
    matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingDependencyError(
            "figures need matplotlib: pip install 'rtcal[report]'"
        ) from error
    checks.positive("width", width, "in")
    checks.positive("height", height, "in")
    if checks.whole("rows", rows, 1) * checks.whole("columns", columns, 1) > _MOST_AXES:
        raise DataError(f"rows and columns of more than {_MOST_AXES} panels")
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns)


def shown(name: str, longest: int = _LONGEST_NAME) -> str:
    r"""Return a name for a figure, whole, in short lines; a dollar, which begins a formula, is escaped.

    Examples
    --------
    >>> shown("a $10 panel")
    'a \\$10 panel'
    >>> shown("perforated gypsum board", 16)
    'perforated\ngypsum board'
    """
    line = "".join(c if c.isprintable() else "?" for c in name)
    return "\n".join(textwrap.wrap(line, longest) or [line]).replace("$", r"\$")


def panels(number: int, frequencies: Array) -> tuple[Any, list[Any]]:
    """Return a figure with small axes over the bands, and these: one for each material, at most twelve.

    Few stand in two columns, which a phone shows legibly; more in three.
    """
    columns = min(2 if number <= _FEW else 3, number)
    rows = -(-number // columns)
    figure, grid = new_figure(max(5.0, 3.1 * columns), 2.4 * rows + 0.7, rows, columns)
    every = [*np.atleast_1d(grid).ravel()]
    for axes in every[number:]:
        axes.set_visible(False)
    for axes in every[:number]:
        band_axis(axes, frequencies)
        few = frequencies[:: -(-len(frequencies) // 4)]
        axes.set_xticks(few, [f"{f:g}" for f in few], rotation=0)
        axes.tick_params(labelsize=8.5)
        axes.set_xlabel("Band / Hz", fontsize=9)
    return figure, every[:number]


def band_axis(axes: Axes, frequencies: Array, below: list[str] | None = None) -> None:
    """Make x a logarithmic axis with the bands' centres, each with its text of ``below``."""
    many = len(frequencies) > _MANY_BANDS
    labels = [f"{f:g}" for f in frequencies]
    if below is not None:
        labels = [f"{a}{' ' if many else chr(10)}{b}" for a, b in zip(labels, below, strict=True)]
    axes.set_xscale("log")
    axes.set_xticks(frequencies, labels, rotation=90 if many else 0)
    axes.minorticks_off()
    axes.set_xlabel("Band centre frequency / Hz")


def band_places(axes: Axes, frequencies: Array) -> NDArray[np.int64]:
    """Make x an axis with one place per band, of bars or cells; return the places."""
    places = np.arange(len(frequencies))
    turn = 90 if len(places) > _MANY_BANDS else 0
    axes.set_xticks(places, [f"{f:g}" for f in frequencies], rotation=turn)
    axes.set_xlabel("Band centre frequency / Hz")
    return places


def number_map(
    axes: Axes,
    table: Array,
    rows: Sequence[str],
    ends: tuple[float, float],
    colours: str,
    form: str,
) -> Any:
    """Draw numbers (n_rows, n_columns), each on a ground of its colour, and return the image.

    Rows have names. The colours saturate at the ``ends``. An empty ``form`` prints no number.
    """
    image = axes.imshow(table, cmap=colours, vmin=ends[0], vmax=ends[1], aspect="auto")
    axes.set_yticks(range(len(rows)), rows, fontsize=9)
    for (i, k), value in np.ndenumerate(table):
        if form and np.isfinite(value):
            colour = "white" if abs(value) > 0.6 * ends[1] else BLACK
            style: dict[str, Any] = {"ha": "center", "va": "center", "color": colour, "fontsize": 9}
            axes.text(k, i, number(value, form), **style)
    return image


def jnd_band(axes: Axes, frequencies: Array, measured: Array) -> None:
    """Draw T ± one JND in grey; bands without T interrupt it."""
    low, high = (1 - TARGET.jnd) * measured, (1 + TARGET.jnd) * measured
    axes.fill_between(frequencies, low, high, color="0.85", label="measured ± 1 JND")
    axes.vlines(frequencies, low, high, color="0.85", linewidth=8)  # visible also for a single band


def reverberation_time(result: CalibrationResult) -> Any:
    """Return the figure of T(f): measured with its band of one JND, before and after.

    Letters below the bands are those of the trust marks.
    """
    figure, axes = new_figure()
    f, measured = result.prior.centre_frequencies, result.measured
    has_t = np.isfinite(measured)
    jnd_band(axes, f, measured)
    axes.errorbar(
        f[has_t],
        measured[has_t],
        yerr=np.nan_to_num(result.measured_uncertainty)[has_t],
        **MEASURED,
        capsize=3,
        label="measured, ± standard uncertainty",
    )
    axes.plot(f, result.reverberation_time_before, **BEFORE, label="model before calibration")
    axes.plot(f, result.reverberation_time_after, **AFTER, label="model after calibration")
    band_axis(axes, f, [letters(result.trust_marks, v) for v in f])
    marks = [f"{m.letter} {m.title}".strip() for m in result.trust_marks]
    if marks:
        key = f"\ndo not trust: {', '.join(dict.fromkeys(marks))}"
        axes.set_xlabel(axes.get_xlabel() + key)
    axes.set_ylabel("Reverberation time T / s")
    axes.set_ylim(bottom=0)
    said = f"{result.prior.name}: {result.method}, {result.equation.name}"
    axes.set_title(shown(said, 70))
    axes.legend()
    return figure


def gap(result: CalibrationResult) -> Any:
    """Return the figure of the gap to the measured T, before and after, in JND by band."""
    figure, axes = new_figure(7.0, 3.2)
    at = band_places(axes, result.prior.centre_frequencies)
    axes.axhspan(-1, 1, color="0.85", label="within 1 JND (5 %)")
    axes.axhline(0, color=BLACK, linewidth=0.8)
    bars = {"facecolor": "#F5C9A6", "edgecolor": ORANGE, "hatch": "//"}
    axes.bar(at, result.gap_before, 0.5, **bars, label="model before calibration")
    dots = {"color": BLUE, "marker": "o", "linestyle": "none", "markersize": 8}
    axes.plot(at, result.gap_after, **dots, label="model after calibration")
    axes.set_ylabel("Gap of T (model - measured) / JND")
    axes.set_title(shown(result.prior.name, 70))
    axes.legend()
    return figure


def rendered(figure: Figure, kind: str) -> bytes:
    """Return a figure as the bytes of a ``png``, ``svg`` or ``pdf`` file, the same each time."""
    import matplotlib

    _check_kind(kind, kind)
    stream = io.BytesIO()
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with warnings.catch_warnings(), matplotlib.rc_context({"svg.hashsalt": "rtcal"}):
        # Characters that the font lacks appear as boxes, without a warning.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        figure.savefig(stream, format=kind, dpi=150, metadata=undated)
    return stream.getvalue()


def save(figure: Any, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG, SVG or PDF by the path's ending, whole or not at all."""
    kind = os.path.splitext(os.fspath(path))[1].lstrip(".").lower()
    _check_kind(kind, os.fspath(path))
    write_bytes(path, rendered(figure, kind))


def _check_kind(kind: str, place: str) -> None:
    if kind not in ("png", "svg", "pdf"):
        raise DataError(f'{place}: a figure ends with .png, .svg or .pdf, not ".{kind}"')


def write_folder(result: CalibrationResult, folder: Path) -> list[Path]:
    """Write room, numbers and figure, all or none, and return their paths.

    Without matplotlib there is no figure, and a warning says so.

    Raises
    ------
    DataError
        If the folder cannot be made, or a file cannot be written.
    """
    return write_with_figures(result, folder, {FIGURE: lambda: reverberation_time(result)})


def write_with_figures(
    result: CalibrationResult | PositionsResult | ModesResult,
    folder: Path,
    draw: Mapping[str, Callable[[], Any]],
) -> list[Path]:
    """Write room, numbers and the figures that ``draw`` makes by file name; see `write_folder`."""
    contents = {
        folder / ROOM: result.room.to_text(folder).encode(),
        folder / NUMBERS: result.to_json(folder).encode(),
    }
    try:
        pictures = {name: rendered(figure(), "png") for name, figure in draw.items()}
        contents |= {folder / name: picture for name, picture in pictures.items()}
    except MissingDependencyError as error:
        warnings.warn(f"no figure{'s' * (len(draw) > 1)}: {error}", stacklevel=checks.stack_level())
    make_folder(folder)
    write_all(contents)
    return list(contents)
