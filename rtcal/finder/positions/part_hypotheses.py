"""Hypotheses on parts of large surfaces, beside those that are spread over a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rtcal.finder.positions import unevenness
from rtcal.finder.positions.case import Case
from rtcal.finder.positions.hypotheses import surface_alpha
from rtcal.finder.positions.parts import Part
from rtcal.finder.positions.responses import SHARES
from rtcal.finder.positions.shift import Shift, interpolation, towards
from rtcal.support.types import Array

LOCATED = 0.5
"""Prior probability that something which fits on a part of its surface stands on one alone."""


def on_parts(case: Case, shifts: Sequence[Shift]) -> list[Shift]:
    """Return the hypotheses with those of each part beside those of its surface.

    `LOCATED` of the odds of a size go to the parts that hold it. The others stay with what is spread
    over the surface. So the odds of a surface do not depend on the number of its parts. What covers a
    stated absorber is a share of the whole surface, and has no parts; nor has an aperture.
    """
    stated, every = surface_alpha(case), list(enumerate(case.divided.parts))
    out = []
    for shift in shifts:
        own = [(p, part) for p, part in every if part.surface == shift.surface]
        if not own or not shift.divisible:
            out.append(shift)
            continue
        holds = np.array([shift.sizes <= part.area for _, part in own])
        number = holds.sum(axis=0)
        out.append(replace(shift, odds=np.where(number > 0, 1 - LOCATED, 1.0) * shift.odds))
        for (p, part), rows in zip(own, holds, strict=True):
            if rows.any():
                out.append(_on_part(shift, p, part, stated[part.surface], rows, number))
    return out


def _on_part(
    shift: Shift, p: int, part: Part, stated: Array, rows: NDArray[np.bool_], number: Array
) -> Shift:
    spectra = shift.spectra[rows]
    moved = shift.sizes[rows, np.newaxis] / part.area * (spectra - stated)
    return replace(
        shift,
        part=p,
        response=f"part {p}",
        weights=interpolation(SHARES, towards(moved, stated)),
        odds=LOCATED * shift.odds[rows] / number[rows],
        sizes=shift.sizes[rows],
        parameters=[q for q, holds in zip(shift.parameters, rows, strict=True) if holds],
        spectra=spectra,
        uneven=unevenness.factor(shift.sizes[rows] / part.area),
    )
