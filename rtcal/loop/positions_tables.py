"""The printed tables of a calibration to every position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.acoustics.observables import parameter_label
from rtcal.acoustics.quality import rms
from rtcal.acoustics.room import Room
from rtcal.loop.measured_pairs import Pair
from rtcal.loop.scattering import Scattering
from rtcal.support.text import number
from rtcal.support.types import Array

Table = tuple[list[str], list[list[str]]]
"""Header and rows."""


def gap_rows(
    pairs: Sequence[Pair], before: Array, after: Array
) -> list[tuple[str, list[tuple[float, float]]]]:
    """Return the name of each pair and of all, with the rms gap before and after by parameter.

    Gaps are (n_parameters, n_pairs, n_bands) in JND.
    """
    every = [(" to ".join(pair), [i]) for i, pair in enumerate(pairs)]
    every.append(("all", list(range(len(pairs)))))
    ends = [
        [rms(gap[:, some], axis=(1, 2)).tolist() for gap in (before, after)] for _, some in every
    ]
    return [
        (name, list(zip(*of_some, strict=True)))
        for (name, _), of_some in zip(every, ends, strict=True)
    ]


def gap_table(
    parameters: Sequence[str],
    pairs: Sequence[Pair],
    before: Array,
    after: Array,
    title: str = "rms gap / JND",
) -> Table:
    """Return the header and rows of `gap_rows`."""
    rows = [
        [name, *(" to ".join(number(x, ".1f") for x in ends) for ends in cells)]
        for name, cells in gap_rows(pairs, before, after)
    ]
    return [title, *(parameter_label(p) for p in parameters)], rows


def material_table(
    room: Room,
    learned: Sequence[tuple[str, float, float]],
    shift: Array,
    pulls: Array,
    pairs: Sequence[Pair],
    scattering: Scattering | None,
) -> Table:
    """Return what was learned of each material, in the order of ``learned``.

    ``shift`` (n_materials, n_bands) and ``pulls`` (n_pairs, n_materials, n_bands) are in prior sigmas.
    """
    header = ["", "sigma before", "after", "shift / sigma", "pulled most by"]
    if scattering is not None:
        header.append("scattering")
    strength = np.abs(pulls).mean(axis=2)
    moved = np.sqrt((shift**2).mean(axis=1))
    rows = []
    for name, before, after in learned:
        i = room.material_index(name)
        pair = "-"
        if strength[:, i].any():
            pair = " to ".join(pairs[int(np.argmax(strength[:, i]))])
        row = [name, f"{before:.3f}", f"{after:.3f}", f"{moved[i]:.1f}", pair]
        if scattering is not None:
            s, sigma = (a[i].mean() for a in (scattering.coefficients, scattering.sigma))
            row.append(f"{s:.2f} ± {sigma:.2f}")
        rows.append(row)
    return header, rows


def farther_in_words(gaps: Sequence[tuple[str, float, float]], *, fitted: bool) -> str:
    """Return that a calibrated simulator is not to be used, by parameter with its gaps in JND.

    ``fitted`` says whether its scattering was fitted.
    """
    names = ", ".join(f"{parameter_label(p)} ({old:.1f} to {new:.1f} JND)" for p, old, new in gaps)
    start = "The"
    if fitted:
        start = (
            "The fitted scattering may have ended at a poor fit: try another seed, or state other "
            "scattering. Else the"
        )
    return (
        f"In {names} the calibrated simulator is farther from what was measured than before: do not "
        f"simulate with it. {start} model misses something, or a constraint keeps alpha away."
    )
