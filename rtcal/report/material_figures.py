"""The figures of a calibration by material: coefficients, shares of the absorption, a plane of two."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.priors import NORMAL_90
from rtcal.report.figures import (
    BEFORE,
    BLACK,
    BLUE,
    GREEN,
    MOST_PANELS,
    band_places,
    new_figure,
    panels,
    shown,
)
from rtcal.support.errors import DataError
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.calibration.result import CalibrationResult

__all__ = ["coefficients", "intervals", "plane", "shares"]
__dir__ = __all__.copy

_SHARES = (
    ("#0072B2", ""),
    ("#E69F00", "//"),
    ("#009E73", ".."),
    ("#CC79A7", "xx"),
    ("#56B4E9", "\\\\"),
    ("#D55E00", "++"),
    ("#F0E442", "--"),
)


def coefficients(result: CalibrationResult) -> Any:
    """Return the figure of alpha by material and band: prior and calibrated, with 90 % intervals.

    Of more than twelve materials, it shows those with the largest absorption area. The prior's
    interval is mu ± 1.645 sigma within the bounds. The interval of the calibrated coefficients is
    exact if it was computed, else alpha ± 1.645 sigma of the linear estimate within the bounds.
    """
    size = np.max(result.prior.areas[:, np.newaxis] * result.alpha, axis=1)
    drawn = np.sort(np.argsort(-size, kind="stable")[:MOST_PANELS])
    low, high = intervals(result)
    f = result.prior.centre_frequencies
    figure, small = panels(len(drawn), f)
    apart = float(f[1] / f[0]) ** 0.08 if len(f) > 1 else 1.0
    for axes, i in zip(small, drawn, strict=True):
        prior, after, bound = result.prior.alpha[i], result.alpha[i], result.active[i] != 0
        spread = NORMAL_90 * result.prior.sigma[i]
        ends = np.clip([prior - spread, prior + spread], 0, 1)
        error = np.abs(ends - prior)
        style = {"markersize": 4, "markerfacecolor": "white", "capsize": 2}
        style |= {**BEFORE, "linestyle": "none"}
        axes.errorbar(f / apart, prior, yerr=error, **style, label="before (prior), 90 %")
        error = np.maximum([after - low[i], high[i] - after], 0)
        style = {"color": BLUE, "marker": "o", "markersize": 5, "linestyle": "none"}
        style |= {"capsize": 3, "linewidth": 1.8}
        axes.errorbar(f * apart, after, yerr=error, **style, label="calibrated, 90 %")
        style = {"color": BLACK, "marker": "*", "markersize": 11, "linestyle": "none", "zorder": 5}
        at = f[bound] * apart, after[bound]
        (stars,) = axes.plot(*at, **style, clip_on=False, label="at a bound")
        stars.set_in_layout(False)
        axes.set_ylabel("α", fontsize=9)
        axes.set_ylim(0, None)
        axes.margins(y=0.1)
        axes.set_title(
            f"{shown(result.prior.materials[i], 28)}, {result.prior.areas[i]:.4g} m²", fontsize=9
        )
    handles, labels = small[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(drawn), 2), fontsize=9)
    figure.suptitle("α by band (each panel has its own scale)", fontsize=11)
    return figure


def intervals(calibration: CalibrationResult) -> tuple[Array, Array]:
    """Return the ends of the calibrated coefficients' 90 % intervals, (n_materials, n_bands)."""
    if calibration.interval is not None:
        return calibration.interval[0], calibration.interval[1]
    spread = NORMAL_90 * calibration.posterior_sigma
    return np.clip(calibration.alpha - spread, 0, 1), np.clip(calibration.alpha + spread, 0, 1)


def shares(result: CalibrationResult) -> Any:
    """Return the figure of each material's share of the calibrated absorption by band, in %.

    It includes effects and the air. The smallest materials are one part.
    """
    names, parts = absorption_shares(result, len(_SHARES))
    figure, axes = new_figure(6.4, 4.4)
    at = band_places(axes, result.prior.centre_frequencies)
    below = np.zeros(len(at))
    styles = [*_SHARES[: len(names) - 1], ("#FFFFFF", "")]
    for name, part, (color, hatch) in zip(names, parts, styles, strict=True):
        style = {"facecolor": color, "hatch": hatch, "edgecolor": BLACK, "linewidth": 0.6}
        axes.bar(at, part, 0.75, bottom=below, **style, label=shown(name, 26))
        below = below + part
    axes.set_ylabel("Share of the absorption / %")
    axes.set_ylim(0, 100)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside right upper", fontsize=9)
    axes.set_title("Who absorbs, after calibration")
    return figure


def absorption_shares(calibration: CalibrationResult, most: int) -> tuple[list[str], Array]:
    """Return names and shares in %, (n_names, n_bands), of materials, effects and, last, the air.

    There are at most ``most`` names beside the air, so the smallest materials are one part.
    """
    area = calibration.prior.areas[:, np.newaxis] * calibration.alpha
    order = np.argsort(-area.sum(axis=1), kind="stable")
    effects = bool(np.any(calibration.added_absorption))
    single = len(order) if len(order) + effects <= most else most - 1 - effects
    names = [calibration.prior.materials[i] for i in order[:single]]
    parts = [area[i] for i in order[:single]]
    if single < len(order):
        names.append(f"{len(order) - single} other materials")
        parts.append(area[order[single:]].sum(axis=0))
    if effects:
        names.append("effects: " + ", ".join(calibration.effects))
        parts.append(calibration.added_absorption)
    surfaces = np.sum(parts, axis=0)
    of_surfaces = 100 * (1 - calibration.air_share) / np.where(surfaces > 0, surfaces, 1.0)
    return [*names, "air"], np.array(
        [*(p * of_surfaces for p in parts), 100 * calibration.air_share]
    )


def plane_of(
    result: CalibrationResult,
    pair: tuple[str, str] | None = None,
    frequency: float | None = None,
) -> Any:
    """Return the figure of a calibration in the plane of two of its materials; see `plane`.

    The other materials keep their calibrated coefficients. By default the plane has the two materials
    with the largest S sigma, which a calibration changes most, in the band with the largest gap.

    Raises
    ------
    DataError
        For a material or a band that the room lacks, a band that was not matched, or a room of one
        material.
    """
    if len(result.prior.materials) < 2:
        raise DataError("a plane takes two materials; the room has one")
    k = _band(result, frequency)
    if pair is None:
        weight = result.prior.areas * result.prior.sigma[:, k]
        rows = np.sort(np.argsort(-weight, kind="stable")[:2])
    else:
        if missing := [name for name in pair if name not in result.prior.materials]:
            raise DataError(f'the room has no material "{missing[0]}"')
        rows = np.array([result.prior.materials.index(name) for name in pair])
        if rows[0] == rows[1]:
            raise DataError(f'a plane takes two materials, not "{pair[0]}" twice')
    others = np.delete(np.arange(len(result.prior.areas)), rows)
    left = result.target[k] - result.added_absorption[k]
    left -= result.prior.areas[others] @ result.alpha[others, k]
    names = result.prior.materials[rows[0]], result.prior.materials[rows[1]]
    correlation = 0.0
    for pair_of, value in result.prior.material_correlation.items():
        if set(pair_of) == set(names):
            correlation = value
    fixed = f", the {len(others)} others as calibrated" if len(others) else ""
    return plane(
        result.prior.alpha[rows, k],
        result.prior.sigma[rows, k],
        result.prior.areas[rows],
        float(left),
        result.alpha[rows, k],
        names=names,
        correlation=correlation,
        title=f"{result.prior.centre_frequencies[k]:g} Hz{fixed}",
    )


def _band(calibration: CalibrationResult, frequency: float | None) -> int:
    """Index of the matched band at ``frequency``; for None, of that with the largest gap before."""
    if frequency is None:
        if not calibration.matched.any():
            raise DataError("no band was matched, so there is no plane to show")
        gap = np.abs(np.where(calibration.matched, np.nan_to_num(calibration.gap_before), -1.0))
        return int(np.argmax(np.where(calibration.matched, gap, -1.0)))
    matching = np.flatnonzero(
        (calibration.prior.centre_frequencies == frequency) & calibration.matched
    )
    if not len(matching):
        raise DataError(f"{frequency:g} Hz is no band of the room that was matched")
    return int(matching[0])


def plane(
    mu: Array,
    sigma: Array,
    areas: Array,
    target: float,
    alpha: Array,
    *,
    names: tuple[str, str] = ("1", "2"),
    correlation: float = 0.0,
    truth: Array | None = None,
    title: str = "",
) -> Any:
    """Return the figure of a calibration of two coefficients (Bellows & Katz 2025, Figs. 1 and 3).

    It shows the prior's ellipses of 1, 2 and 3 standard deviations about mu, the line S'alpha = b
    of all coefficients with the measured T, and the step from mu to the likeliest point of the
    line.

    Parameters
    ----------
    mu, sigma, areas, alpha : array (2,)
        Prior, areas in m², calibrated coefficients.
    target : float
        b in m².
    names : (str, str)
    correlation : float
        Correlation of the two priors.
    truth : array (2,), optional
        True coefficients, if they are known.
    title : str
    """
    mu, sigma, areas, alpha = (np.asarray(v, dtype=float) for v in (mu, sigma, areas, alpha))
    figure, axes = new_figure(5.6, 5.9)
    turn = np.linspace(0, 2 * np.pi, 361)
    circle = np.array([np.cos(turn), np.sin(turn)])
    root = np.array([[1.0, 0.0], [correlation, np.sqrt(1 - correlation**2)]])
    for n, style in ((1, "-"), (2, "--"), (3, ":")):
        ellipse = mu[:, np.newaxis] + n * sigma[:, np.newaxis] * (root @ circle)
        axes.plot(*ellipse, color="0.45", linestyle=style, linewidth=1, label=f"prior, {n} σ")
    points = [mu, alpha] if truth is None else [mu, alpha, np.asarray(truth, dtype=float)]
    reach = np.maximum(3.3 * sigma, 1.2 * np.max(np.abs(np.array(points) - mu), axis=0))
    reach = np.maximum(reach, 0.02)
    low, high = np.maximum(mu - reach, -0.02), np.minimum(mu + reach, 1.02)
    across = np.linspace(low[0], high[0], 2)
    line = (target - areas[0] * across) / areas[1]
    axes.plot(across, line, color=BLACK, linewidth=1.8, label="gives the measured T")
    axes.annotate(
        "", xy=alpha, xytext=mu, arrowprops={"arrowstyle": "->", "color": BLUE, "linewidth": 1.5}
    )
    square = {**BEFORE, "linestyle": "none", "markersize": 8, "markerfacecolor": "white"}
    axes.plot(*mu, **square, label="before (prior)")
    axes.plot(*alpha, color=BLUE, marker="o", markersize=8, linestyle="none", label="calibrated")
    if truth is not None:
        axes.plot(
            *points[2], color=GREEN, marker="*", markersize=13, linestyle="none", label="true"
        )
    for end in (0.0, 1.0):
        axes.axvline(end, color=BLACK, linewidth=0.6, linestyle="-.")
        axes.axhline(end, color=BLACK, linewidth=0.6, linestyle="-.")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel(f"α of {shown(names[0], 30)}, {areas[0]:.4g} m²")
    axes.set_ylabel(f"α of {shown(names[1], 30)}, {areas[1]:.4g} m²")
    axes.set_title(title)
    figure.legend(loc="outside lower center", ncols=3, fontsize=9)
    return figure
