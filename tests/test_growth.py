"""Memory and work grow with the number of materials and configurations, not with its square."""

from __future__ import annotations

import time
import tracemalloc
from unittest.mock import Mock

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration.composition import Composition
from rtcal.calibration.result import JointResult
from rtcal.io import mend
from rtcal.simulators import Polyhedron


def large_room(n_materials: int, seed: int = 0, name: str = "large") -> rt.Room:
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


def peak_of_calibration(room: rt.Room, method: str) -> float:
    t = 1.1 * rt.Eyring().reverberation_time(room)
    tracemalloc.start()
    rt.calibrate(room, t, method=method)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.parametrize("method", ["mle", "soft", "robust", "smooth"])
def test_memory_of_a_calibration_is_linear_in_the_materials(method: str) -> None:
    rt.calibrate(large_room(5), np.full(6, 0.8), unreachable="nearest")  # imports
    small, large = (peak_of_calibration(large_room(n), method) for n in (100, 400))
    assert np.log(large / small) / np.log(4) < 1.2


def test_memory_of_an_order_of_materials_is_linear_in_them() -> None:
    """A constraint of alpha itself, which is a product of as many factors as there are coefficients."""
    order = rt.Calibration(
        rt.terms.PriorDeviation(), [rt.terms.ExactMatch(), rt.terms.AtMost("m0", "m1")]
    )

    def peak(room: rt.Room) -> float:
        t = 1.1 * rt.Eyring().reverberation_time(room)
        tracemalloc.start()
        order.build(room).solve(t)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    order.build(large_room(5)).solve(np.full(6, 0.8), unreachable="nearest")  # imports
    small, large = (peak(large_room(n)) for n in (200, 800))
    assert np.log(large / small) / np.log(4) < 1.2


def test_what_configurations_share_is_calculated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    rooms = [large_room(4, seed, f"state {seed}") for seed in range(5)]
    times = [1.1 * rt.Eyring().reverberation_time(room) for room in rooms]
    joint = rt.calibrate(rt.Configurations(rooms), times, method="joint")
    innovation, density = Mock(side_effect=JointResult.innovation.func), Mock()
    monkeypatch.setattr(JointResult.innovation, "func", innovation)
    monkeypatch.setattr(JointResult, "density", density)
    records = [result.to_dict() for result in joint.results]
    assert innovation.call_count == 1
    assert density.call_count == 0
    assert [record["room"] for record in records] == [room.name for room in rooms]
    assert all(m["interval_after"] for record in records for m in record["materials"])


def test_derivative_with_respect_to_every_time_takes_two_assemblies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rooms = [large_room(4, seed, f"state {seed}") for seed in range(5)]
    times = [1.1 * rt.Eyring().reverberation_time(room) for room in rooms]
    joint = rt.calibrate(rt.Configurations(rooms), times, method="joint")
    assembled = Mock(side_effect=Composition.numbers, autospec=True)
    joint.numbers  # noqa: B018 (those of the solve itself)
    monkeypatch.setattr(Composition, "numbers", lambda *given: assembled(*given))
    derivative = joint.by_time()
    assert assembled.call_count == 2
    # Against calibrating again with one T changed.
    step = 1e-4
    changed = [t.copy() for t in times]
    changed[2][3] *= 1 + step
    again = rt.calibrate(rt.Configurations(rooms), changed, method="joint")
    difference = (again.alpha - joint.alpha) / (step * times[2][3])
    np.testing.assert_allclose(derivative[:, :, 2, 3], difference, rtol=2e-3, atol=1e-7)


def seconds_of_mending(n: int) -> float:
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


def seconds_of_joining(n: int) -> float:
    """Processor time in s of mending a box whose walls are drawn as n x n pairs of triangles."""
    box, at, polygons = Polyhedron.shoebox((20.0, 15.0, 8.0), "plaster"), np.arange(n) / n, []
    halves = np.array([[0, 0], [1, 0], [1, 1]]), np.array([[0, 0], [1, 1], [0, 1]])
    for a, b, _, d in (box.vertices[list(face)] for face in box.faces):
        corners = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 1, 2)
        polygons += [a + (corners + half / n) @ np.array([b - a, d - a]) for half in halves]
    drawn = np.concatenate(polygons)
    names = ["wall"] * len(drawn)
    begin = time.process_time()
    done = mend.mended(mend.Faces("box.obj", list(drawn), names, names))
    assert len(done.geometry.faces) == 6
    assert done.volume == pytest.approx(2400)
    return time.process_time() - begin


@pytest.mark.long
def test_time_of_joining_triangles_grows_with_their_number() -> None:
    """99,372 triangles took 58 s, as their number to the power of 1.5."""
    seconds_of_joining(16)  # imports
    small, large = (min(seconds_of_joining(n) for _ in range(2)) for n in (20, 60))
    assert np.log(large / small) / np.log(9) < 1.2


@pytest.mark.long
def test_time_of_mending_grows_with_the_faces_not_with_their_square() -> None:
    seconds_of_mending(20)  # imports
    small, large = (min(seconds_of_mending(n) for _ in range(2)) for n in (200, 800))
    assert np.log(large / small) / np.log(4) < 1.5
