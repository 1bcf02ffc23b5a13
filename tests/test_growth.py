"""Memory and work grow with the number of materials and configurations, not with its square."""

import time
import tracemalloc

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.methods import preset
from rtcal.io import mend
from rtcal.simulators import Polyhedron
from tests.conftest import also


def large_room(n_materials, seed=0, name="large"):
    rng = np.random.default_rng(seed)
    alpha = np.random.default_rng(1).uniform(0.05, 0.5, (n_materials, 6))
    areas = rng.uniform(1, 30, n_materials)
    return rt.Room(
        name=name,
        volume=float(areas.sum() ** 1.5 / 10),
        materials=[f"m{i}" for i in range(n_materials)],
        areas=areas,
        alpha=alpha,
        sigma=0.2 * alpha,
        centre_frequencies=[125, 250, 500, 1000, 2000, 4000],
        air=rt.Air(),
    )


def peak(calibration, room):
    t = 1.1 * rt.Eyring().reverberation_time(room)
    tracemalloc.start()
    calibration.build(room).solve(t)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


# An order is a constraint of alpha itself, a product of as many factors as there are coefficients.
ORDER = rt.Calibration(
    rt.terms.PriorDeviation(), [rt.terms.ExactMatch(), rt.terms.AtMost("m0", "m1")]
)


@pytest.mark.parametrize(
    "calibration", [preset("mle"), *also(*map(preset, ("soft", "robust", "smooth")), ORDER)]
)
def test_memory_of_a_calibration_is_linear_in_the_materials(calibration):
    peak(calibration, large_room(5))  # imports
    small, large = (peak(calibration, large_room(n)) for n in (200, 800))
    assert np.log(large / small) / np.log(4) < 1.2


def seconds_of_mending(n):
    """Processor time in s of mending a hall with n panels over its floor."""
    hall = Polyhedron.shoebox((40.0, 30.0, 8.0), "plaster")
    polygons = [hall.vertices[list(face)] for face in hall.faces]
    panel = np.array([[0, 0, 4], [0.4, 0, 4], [0.4, 0.4, 4.1], [0, 0.4, 4.1]])
    places = [(1 + 0.9 * (k % 40), 1 + 0.9 * (k // 40), 0) for k in range(n)]
    polygons += [panel + place for place in places]
    names = [f"face {i}" for i in range(len(polygons))]
    drawn = mend.Faces("hall.obj", polygons, ["plaster"] * len(names), names)
    begin = time.process_time()
    done = mend.mended(drawn)
    taken = time.process_time() - begin
    assert [defect.number for defect in done.defects] == [n]
    return taken


@pytest.mark.long
def test_time_of_mending_grows_with_the_faces_not_with_their_square():
    seconds_of_mending(20)  # imports
    small, large = (min(seconds_of_mending(n) for _ in range(2)) for n in (200, 800))
    assert np.log(large / small) / np.log(4) < 1.5
