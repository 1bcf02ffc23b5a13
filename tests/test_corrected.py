"""A corrected room in the rest of the package: intervals, files, equations, simulators, the loop."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.posterior import distribution
from rtcal.finder import Case, recalibrate
from rtcal.finder.apply import corrected_case
from rtcal.finder.effects import AppliedEffect
from rtcal.simulators.base import Simulator
from rtcal.simulators.external import of_equation
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.support.errors import DataError

pytestmark = pytest.mark.usefixtures("runs_kept")
OPENING = AppliedEffect("opening", {"area": 40.0}, (20.0, 56.0))


@pytest.fixture(scope="module")
def hidden():
    case, truth = rt.datasets.hidden_room()
    return case, np.array(truth["alpha"])


def test_alpha_and_sizes_have_intervals(hidden):
    case, truth = hidden
    found = recalibrate(replace(case, applied=[OPENING]))
    low, high = found.interval
    assert ((low <= found.alpha) & (found.alpha <= high)).all()
    inside = np.mean((low <= truth) & (truth <= high))
    assert inside > 0.8
    # The sampled posterior of the same QP, within the bounds, is about as wide.
    drawn = distribution(found.joint, 1500)
    rows = [found.joint.materials.index(m) for m in case.room.materials]
    ratio = found.sigma / drawn.sigma[rows]
    assert 0.9 < ratio.mean() < 1.1  # 1,500 samples know a sigma to 2 %; bounds cut some
    assert (found.sigma <= case.room.sigma * (1 + 1e-9)).all()
    (effect,) = found.to_dict()["effects"]
    assert effect["size_interval"] == [20.0, 56.0]
    assert effect["unit"] == "m²"
    assert 20 < effect["size"] < 56
    record = json.loads(json.dumps(found.to_dict()))
    np.testing.assert_allclose(record["materials"][0]["low"], low[0])
    # Without the effect alpha moves far outside what was known, and its intervals miss the truth.
    bent = recalibrate(case)
    wrong = np.mean((bent.interval[0] <= truth) & (truth <= bent.interval[1]))
    assert wrong < inside - 0.1


def test_the_model_is_a_simulator_that_the_loop_calibrates(hidden):
    """Also where no equation gives T: a coupled room's decay is bent."""
    shape = AppliedEffect("coupled room", {"aperture": 15.0, "volume": 400.0, "alpha": 0.1})
    case = replace(hidden[0], applied=[shape])
    made = corrected_case(case)
    sim, room = made.simulator(), made.room
    assert isinstance(sim, Simulator)
    wanted = sim.simulate(np.clip(1.2 * room.alpha, 0, 1))
    assert wanted.mean("edt") != pytest.approx(wanted.mean("t20"), rel=0.01)
    done = rt.calibrate_simulator(sim, room, wanted)
    assert set(done.status) == {"converged"}
    reached = sim.simulate(done.room.alpha).mean("t20")
    np.testing.assert_allclose(reached, wanted.mean("t20"), rtol=0.05)


SIDES = (5.0, 7.0, 3.0)
WALLS = dict.fromkeys(SHOEBOX_WALLS, "walls") | {"floor": "floor"}


def boxed(applied):
    """A box of two materials, with an effect."""
    room = rt.Room.from_geometry(
        Polyhedron.shoebox(SIDES, WALLS),
        name="box",
        materials=[rt.Material(name, [0.2, 0.25], [0.03] * 2) for name in ("walls", "floor")],
        centre_frequencies=[500, 1000],
        air=rt.Air(20, 50),
        dimensions=SIDES,
    )
    measured = rt.Measurement.from_values([500, 1000], t20=[1.0, 1.0])
    as_built = rt.finder.Configuration(name="as built", measured=measured)
    return Case(room=room, configurations=[as_built], applied=[applied])


@dataclass(frozen=True, kw_only=True)
class Drawn(rt.simulators.External):
    """A simulator with a geometry, whose T is an equation's."""

    geometry: Polyhedron


def drawn(height):
    """Return what builds a simulator with the box's geometry at this height."""
    geometry = Polyhedron.shoebox((*SIDES[:2], height), WALLS)
    return lambda room: Drawn(
        room=room, run=of_equation(rt.Eyring(), room).run, name="drawn", geometry=geometry
    )


@pytest.mark.parametrize(
    ("effect", "parameters", "needed"),
    [  # both are those of a box that is 3.6 m high
        ("volume", {"ratio": 1.2}, "volume: the finding needs 126 m³"),
        ("area", {"ratio": 121.4 / 107}, 'area of "walls": the finding needs 121.4 m²'),
    ],
)
def test_a_geometry_without_what_the_finding_changed_is_refused(effect, parameters, needed):
    walls = float(boxed(OPENING).room.materials.index("walls"))
    material = {"material": walls} if effect == "area" else {}
    case = boxed(AppliedEffect(effect, parameters | material))
    made = corrected_case(case)
    with pytest.raises(DataError, match=needed):
        made.simulator(drawn(3.0))
    np.testing.assert_allclose(
        made.simulator(drawn(3.6)).simulate(made.room.alpha).mean("t20"),
        made.simulator().simulate(made.room.alpha).mean("t20"),
        rtol=1e-9,
    )
    # What the finding leaves as stated may be drawn otherwise, as always.
    assert corrected_case(replace(case, applied=[])).simulator(drawn(3.6))
