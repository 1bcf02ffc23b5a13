"""A corrected room in the rest of the package: intervals, files, equations, simulators, the loop."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.room import Surface
from rtcal.calibration.posterior import distribution
from rtcal.finder import Case, recalibrate
from rtcal.finder.apply import corrected_case
from rtcal.finder.effects import AppliedEffect
from rtcal.simulators.base import Simulator, run
from rtcal.simulators.external import of_equation
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.shoebox import ImageSource
from rtcal.support.errors import DataError

pytestmark = pytest.mark.usefixtures("runs_kept")
OPENING = AppliedEffect("opening", {"area": 40.0}, (20.0, 56.0))


@pytest.fixture(scope="module")
def hidden() -> tuple[Case, np.ndarray]:
    case, truth = rt.datasets.hidden_room()
    return case, np.array(truth["alpha"])


@pytest.mark.parametrize("equation", ["eyring", "sabine", "kuttruff"])
def test_an_absorber_is_as_large_as_its_interval_reaches(
    hidden: tuple[Case, np.ndarray], equation: str
) -> None:
    """Up to 18 m² more than its 40 m²: there alpha = 1. The law of corrected rooms has the rest."""
    room = corrected_case(replace(hidden[0], equation=equation, applied=[OPENING])).room
    assert room.materials == (*hidden[0].room.materials, "opening")
    assert 40.0 < room.areas[-1] < 40.0 + 18.0  # an opening in a wall hides some of it
    assert (room.alpha[-1] + 1.6449 * room.sigma[-1]).max() == pytest.approx(1.0, rel=1e-3)
    assert "rtcal find: 40 m²" in room.sources["opening"]


def test_an_absorber_at_its_own_size_raises_no_alarm(
    hidden: tuple[Case, np.ndarray],
) -> None:
    """It may be larger as well as smaller: no bound is active, and p is printed."""
    room = corrected_case(replace(hidden[0], applied=[OPENING])).room
    t = rt.Eyring().reverberation_time(room)
    for factor in (0.97, 1.03):
        result = rt.calibrate(
            room, rt.Measurement.from_values(room.centre_frequencies, t20=t * factor)
        )
        assert not [m for m in result.trust_marks if m.kind == "at_bound"]
        assert result.plausibility.p_value is not None
        assert ((result.alpha[-1] - room.alpha[-1]) * (1 - factor) > 0).all()


def test_alpha_and_sizes_have_intervals(hidden: tuple[Case, np.ndarray]) -> None:
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


def test_the_model_is_a_simulator_that_the_loop_calibrates(
    hidden: tuple[Case, np.ndarray],
) -> None:
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


def boxed() -> Case:
    """A box of two materials whose opening of 8 m² is not in the model; its T is Eyring's."""
    walls = dict.fromkeys(SHOEBOX_WALLS, "walls") | {"floor": "floor"}
    geometry = Polyhedron.shoebox(SIDES, walls)
    areas = geometry.areas
    alpha = np.array([[0.2, 0.25], [0.25, 0.35]])
    room = rt.Room(
        name="box",
        volume=geometry.volume,
        materials=list(areas),
        areas=list(areas.values()),
        alpha=alpha,
        sigma=0.03 + 0 * alpha,
        centre_frequencies=[500, 1000],
        air=rt.Air(20, 50),
        dimensions=SIDES,
        surfaces=[
            Surface(name=n, material=m, area=float(a))
            for n, m, a in zip(geometry.names, geometry.materials, geometry.face_areas, strict=True)
        ],
    )
    opened = AppliedEffect("opening", {"area": 8.0}, (6.0, 10.0))
    state_ = rt.finder.Configuration(
        name="as built", measured=rt.Measurement.from_values([500, 1000], t20=[1.0, 1.0])
    )
    case = Case(room=room, configurations=[state_], applied=[opened])
    t20 = rt.Eyring().reverberation_time(corrected_case(case).room)
    measured = rt.Measurement.from_values([500, 1000], t20=t20)
    return replace(case, configurations=[replace(state_, measured=measured)])


def images(room: rt.Room) -> ImageSource:
    return ImageSource(
        room=room, sources={"S": (1.6, 2.1, 1.4)}, receivers={"R": (3.7, 5.4, 1.2)}, duration=0.45
    )


def test_a_geometric_simulator_takes_the_absorber_on_its_walls() -> None:
    case = boxed()
    made = corrected_case(case)
    room, sim = made.room, made.simulator(images)
    with_it = run(sim, room.alpha).mean("t20")
    without = run(images(case.room), case.room.alpha).mean("t20")
    # An image source model's T is not Eyring's; by how much the opening shortens it, nearly is.
    theory = rt.Eyring().reverberation_time(room) / rt.Eyring().reverberation_time(case.room)
    np.testing.assert_allclose(with_it / without, theory, rtol=0.05)
    assert (theory < 0.87).all()
    measured = case.configurations[0].measured
    done = rt.calibrate_simulator(sim, room, measured)
    assert set(done.status) == {"converged"}
    np.testing.assert_allclose(
        run(sim, done.room.alpha).mean("t20"), measured.mean("t20"), rtol=0.05
    )


@dataclass(frozen=True, kw_only=True)
class Drawn(rt.simulators.External):
    """A simulator with a geometry, whose T is an equation's."""

    geometry: Polyhedron


def drawn(height: float) -> Callable[[rt.Room], Simulator]:
    """Return what builds a simulator with the box's geometry at this height."""
    walls = dict.fromkeys(SHOEBOX_WALLS, "walls") | {"floor": "floor"}
    geometry = Polyhedron.shoebox((*SIDES[:2], height), walls)
    return lambda room: Drawn(
        room=room, run=of_equation(rt.Eyring(), room).run, name="drawn", geometry=geometry
    )


@pytest.mark.parametrize("changed", ["volume", "area"])
def test_a_geometry_without_what_the_finding_changed_is_refused(changed: str) -> None:
    case = boxed()
    walls = case.room.materials.index("walls")
    effect, said = {  # both are those of a box that is 3.6 m high
        "volume": (
            AppliedEffect("volume", {"ratio": 1.2}),
            "volume: the finding needs 126 m³, but the simulator's geometry has 105 m³",
        ),
        "area": (
            AppliedEffect("area", {"material": float(walls), "ratio": 121.4 / 107}),
            'area of "walls": the finding needs 121.4 m², but the simulator\'s geometry has 107 m²',
        ),
    }[changed]
    case = replace(case, applied=[effect])
    with pytest.raises(DataError, match=re.escape(said)):
        corrected_case(case).simulator(drawn(3.0))
    made = corrected_case(case)
    anew, room = made.simulator(drawn(3.6)), made.room
    np.testing.assert_allclose(
        anew.simulate(room.alpha).mean("t20"),
        made.simulator().simulate(room.alpha).mean("t20"),
        rtol=1e-9,
    )
    # What the finding leaves as stated may be drawn otherwise, as always.
    assert corrected_case(replace(case, applied=[])).simulator(drawn(3.6))
