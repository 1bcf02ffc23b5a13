"""Whatever is asked of groups of paths and of derivatives holds wherever what they are of holds."""

import numpy as np
import pytest

from rtcal.simulators import PathTracing, Polyhedron
from tests.conftest import in_geometry

WALLS = ("west", "east", "south", "north", "floor", "ceiling")
MATCH = ("t20", "edt", "c80", "ts", "level")


def box(alpha: float, n_paths: int) -> PathTracing:
    geometry = Polyhedron.shoebox((5, 7, 3), {wall: wall for wall in WALLS})
    room = in_geometry(geometry, [1000], alpha)
    return PathTracing(
        geometry=geometry,
        room=room,
        sources={"S": (1.2, 1.0, 1.5)},
        receivers={"R1": (3.5, 5.2, 1.2), "R2": (3.4, 2.4, 1.3)},
        scattering=0.4,
        n_paths=n_paths,
    )


@pytest.mark.parametrize(("n_paths", "number", "seed"), [(400, 4, 1), (1600, 8, 0)])
def test_groups_of_paths_are_followed_for_as_long_as_they_need(n_paths, number, seed):
    tracer = box(0.6, n_paths)
    groups = tracer.observe_in_groups(tracer.room.alpha, number, MATCH, seed=seed)
    assert np.isfinite(groups).all()
