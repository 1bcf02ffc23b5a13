"""`tracing` belongs to a search that traces the room's scene, and is refused elsewhere."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.datasets.examples import example
from rtcal.support.errors import DataError

TRACING = {"n_paths": 300, "scattering": 0.3}


@pytest.fixture
def scene(tmp_path):
    """A room with a scene, a measurement of each pair, and its mean."""
    for name, content in example("where").files.items():
        (tmp_path / name).write_bytes(content)
    room = rt.Room.from_file(tmp_path / "room.toml")
    pairs = [(s, r) for s in room.scene.sources for r in room.scene.receivers]
    times = np.tile(np.linspace(0.8, 0.6, room.n_bands), (len(pairs), 1))
    of_pairs = rt.Measurement(
        centre_frequencies=room.centre_frequencies, values={"t20": times}, pairs=pairs
    )
    return room, of_pairs, rt.Measurement.from_values(room.centre_frequencies, t20=times[0])


def test_it_is_refused_elsewhere_and_why_is_true(scene):
    room, of_pairs, mean = scene
    bare = room.replace(scene=type(room.scene)())
    simulator = rt.finder.case_of(room, of_pairs, tracing=TRACING)
    needs = (
        "^tracing needs positions: a room with sources and receivers, and a measurement with values"
    )
    for stated, measured in ((room, mean), (bare, of_pairs), (bare, mean)):
        for before in (None, measured):
            with pytest.raises(DataError, match=needs) as refused:
                rt.find(stated, measured, before=before, tracing=TRACING)
            assert ("before and after" in str(refused.value)) == (before is not None)
    with pytest.raises(DataError, match=r"^tracing and simulator are both given"):
        rt.find(room, of_pairs, simulator.simulator, tracing=TRACING)
    with pytest.raises(DataError, match="tracing cannot be given with a case"):
        rt.find(simulator, tracing=TRACING)
