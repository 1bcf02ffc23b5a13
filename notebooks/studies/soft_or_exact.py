"""CR2's six octaves, soft against exact: `python notebooks/studies/soft_or_exact.py [FIGURE]`.

Prints the roughness of alpha(f) and the residual of T in units of its own uncertainty u_T, and draws
both if a path for the figure is given (PNG, SVG or PDF).
"""

from __future__ import annotations

import sys

import numpy as np

import rtcal as rt
from rtcal.calibration.result import CalibrationResult
from rtcal.report import figures

METHODS = ("mle", "soft", "smooth", "robust")


def roughness(alpha: np.ndarray) -> float:
    """Root mean square of alpha's second difference over octaves."""
    return float(np.sqrt(np.mean(np.diff(alpha, 2, axis=1) ** 2)))


def solved() -> dict[str, CalibrationResult]:
    room, measured = rt.datasets.bras_cr2()
    return {method: rt.calibrate(room, measured, method=method) for method in METHODS}


def residual(result: CalibrationResult) -> np.ndarray:
    """(T after - T measured) / u_T, (n_bands,)."""
    return (result.reverberation_time_after - result.measured) / result.measured_uncertainty


def draw(results: dict[str, CalibrationResult], path: str) -> None:
    figure, axes = figures.new_figure(10.0, 4.2)
    figure.delaxes(axes)
    left, right = figure.subplots(1, 2)
    exact, soft = results["mle"], results["soft"]
    f = exact.prior.centre_frequencies
    for i, name in enumerate(exact.prior.materials):
        left.plot(f, exact.alpha[i], color=f"C{i}", marker="o", label=name)
        left.plot(f, soft.alpha[i], color=f"C{i}", marker="x", linestyle="--")
    left.set_ylabel("alpha (solid: exact match, dashed: soft)")
    left.legend(fontsize="small")
    for marker, (name, result) in zip("ox", (("exact", exact), ("soft", soft)), strict=True):
        right.plot(f, residual(result), marker=marker, label=name)
    right.axhspan(-1, 1, color="0.9", label="± u_T")
    right.set_ylabel("(T after - T measured) / u_T")
    right.legend(fontsize="small")
    for ax in (left, right):
        ax.set_xscale("log")
        ax.set_xticks(f, [f"{v:g}" for v in f])
        ax.minorticks_off()
        ax.set_xlabel("Octave band centre frequency / Hz")
    figures.save(figure, path)


def main() -> None:
    results = solved()
    first = results["mle"]
    print("BRAS CR2, six octaves              ", *(
        f"{f:8g}" for f in first.prior.centre_frequencies), "  roughness of alpha(f)")  # fmt: skip
    print(f"{'prior':55}{roughness(first.prior.alpha):50.4f}")
    for method, result in results.items():
        cells = " ".join(f"{v:8.3f}" for v in residual(result) + 0.0)
        print(f"{method:8} residual of T / u_T      {cells}  {roughness(result.alpha):16.4f}")
    if len(sys.argv) > 1:
        draw(results, sys.argv[1])
        print(f"Written: {sys.argv[1]}")


if __name__ == "__main__":
    main()
