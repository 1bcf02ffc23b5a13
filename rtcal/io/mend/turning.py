"""Faces that are drawn with the other orientation."""

from __future__ import annotations

import numpy as np

from rtcal.io.mend.mending import Mending
from rtcal.io.mend.shapes import normal_of
from rtcal.simulators.geometry import Polyhedron
from rtcal.support.types import Array


def tell_turned(mend: Mending, geometry: Polyhedron) -> None:
    """Note the drawn faces whose orientation differs from that of most."""
    normals = {
        _key_of(np.asarray(p)): normal_of(np.asarray(p)) for p in mend.drawn.polygons if len(p) > 2
    }
    agree = {}
    for name, face, normal in zip(geometry.names, geometry.faces, geometry.normals, strict=True):
        drawn = normals.get(_key_of(geometry.vertices[list(face)]))
        if drawn is not None:
            agree[name] = float(drawn @ normal) > 0
    against = [n for n, same in agree.items() if not same]
    if len(against) > len(agree) / 2:
        against = [n for n, same in agree.items() if same]
    if against:
        mend.found("turned", "faces with the other orientation than most are turned", against)


def _key_of(corners: Array) -> tuple[float, ...]:
    return tuple(np.round(corners.mean(axis=0), 3).tolist())
