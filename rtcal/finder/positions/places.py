"""Places for a further receiver that would tell the surfaces apart that are in question."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from rtcal.finder.case import PositionsCase
from rtcal.finder.claim import Candidate
from rtcal.finder.finding import Finding
from rtcal.finder.positions.weighing import Weighing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.types import Array

MARGIN = 0.7
"""Smallest distance in m between a proposed position and any wall or source."""
_RIVALS = 3  # most surfaces that are compared


@dataclass(frozen=True)
class Place:
    """Hold a proposed position for a further receiver: a ``point`` (x, y, z) in m.

    A measurement from the ``source`` to this point is expected to distinguish the most probable
    surfaces as well as ``pairs`` of the measured pairs, each as good as their mean.
    """

    point: tuple[float, float, float]
    source: str
    pairs: float


def next_position(finding: Finding, *, number: int = 16, seed: int = 0) -> tuple[Place, ...]:
    """Return positions for a further receiver that best show on which surface the effect is.

    Parameters
    ----------
    finding : Finding
        Result of `rtcal.find` for values at positions, in which two or more surfaces are possible. The
        three most probable ones are compared.
    number : int
        Number of positions that are tried, on a grid over the room at the mean height of the measured
        receivers, 0.7 m or more from walls and sources.
    seed : int
        Seed of the random numbers of the simulation.

    Returns
    -------
    tuple of Place
        Every position that was tried with every source, the best first.

    Raises
    ------
    DataError
        If fewer than two surfaces are possible, if only one pair was measured, or if the room is too
        small for so many positions.
    """
    checks.whole("number", number, 1)
    # The most probable candidate on each surface that is in question.
    case, rivals = finding.case, list[Candidate]()
    for name in list(finding.surfaces)[:_RIVALS]:
        best = next((c for c in finding.candidates if c.surface == name), None)
        if best is not None and finding.surfaces[name] > 0:
            rivals.append(best)
    if len(finding.pairs) < 2:
        raise DataError("a plan needs at least 2 measured pairs, but the finding has only 1")
    if len(rivals) < 2:
        raise DataError(
            "a plan needs at least two candidate surfaces to distinguish, but at most one is left"
        )
    places, divided = _grid(case, number), case.divided
    proposed = {f"place {i + 1}": p for i, p in enumerate(places)}
    tracer = replace(
        case.simulator,
        geometry=divided.geometry,
        receivers={**case.simulator.receivers, **proposed},
    )
    weighing = Weighing(tracer, finding.parameters, seed)
    alpha = weighing.alpha
    stated, shifts = weighing.observe(alpha), list[Array]()
    for rival in rivals:
        # Spread over the part that holds at least half of its probability, else over its surface.
        faces = divided.surfaces[list(case.faces).index(str(rival.surface))]
        if rival.middle is not None:
            faces = next(part.faces for part in divided.parts if part.middle == rival.middle)
        share = min(rival.size / float(divided.geometry.face_areas[faces].sum()), 1.0)
        changed = alpha.copy()
        changed[faces] += share * (rival.spectrum - changed[faces])
        shifts.append(weighing.observe(np.clip(changed, 0.0, 0.99)) - stated)
    weights = [finding.surfaces[str(rival.surface)] for rival in rivals[1:]]
    # Coefficients and size follow what all pairs have in common, so only what a pair has for itself
    # distinguishes. Its error is that of the control runs within a run; the noise of the tracing stands
    # for that of a response.
    errors = finding.controls.at(finding.parameters, finding.pairs).errors
    within = errors - errors.mean(axis=2, keepdims=True)
    rows = np.moveaxis(within, 2, 1).reshape(len(errors) * errors.shape[2], -1)
    sample = rows.T @ rows / max(len(rows) - len(errors), 1)
    # Far from singular: a tenth of the variance is each value's own.
    own = 0.1 * np.diag(np.diag(sample)) + 1e-9 * np.eye(len(sample))
    precision = np.linalg.inv(0.9 * sample + own)
    measured = np.array([pair in finding.pairs for pair in tracer.pairs])
    distinction = np.zeros(len(measured))
    for shift, weight in zip(shifts[1:], weights, strict=True):
        apart = np.moveaxis(shifts[0] - shift, 1, 0).reshape(len(measured), -1)
        apart -= apart[measured].mean(axis=0)
        distinction += weight * np.einsum("in,nm,im->i", apart, precision, apart)
    in_pairs = distinction / distinction[measured].mean()
    points = dict(zip(proposed, places.tolist(), strict=True))
    every = [
        Place((points[r][0], points[r][1], points[r][2]), s, float(n))
        for (s, r), n in zip(tracer.pairs, in_pairs, strict=True)
        if r in points
    ]
    return tuple(sorted(every, key=lambda place: -place.pairs))


def _grid(case: PositionsCase, number: int) -> Array:
    """Return up to ``number`` free places, (n, 3), spread over the room."""
    corners = case.geometry.vertices
    low, high = corners.min(axis=0), corners.max(axis=0)
    height = float(np.mean([p[2] for p in case.simulator.receivers.values()]))
    sources = np.array(list(case.simulator.sources.values()))
    for steps in range(2, 40):
        across = (np.arange(steps) + 0.5) / steps
        plan = [low[:2] + np.array(at) * (high - low)[:2] for at in product(across, across)]
        points = np.array([[*at, height] for at in plan])
        apart = np.linalg.norm(points[:, np.newaxis] - sources, axis=2).min(axis=1)
        free = points[
            case.geometry.contains(points)
            & (case.geometry.wall_distance(points) > MARGIN)
            & (apart > MARGIN)
        ]
        if len(free) >= number:
            chosen = np.linspace(0, len(free) - 1, number).round().astype(int)
            return np.asarray(free[chosen])
    raise DataError(
        f"the room is too small for {number} positions that are {MARGIN:g} m away from "
        "walls and sources: plan fewer positions"
    )
