"""Shared by all simulators: public names, read-only data, typed errors."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.simulators.base import Simulator
from rtcal.support.errors import DataError
from tests.conftest import room_of

SHOEBOX = room_of(
    {"all": (142, 0.3, 0.1)}, [1000], 105, name="box", dimensions=(5, 7, 3), scattering=[[0.3]]
)
SOURCE, RECEIVER = {"S": (4.5, 3.5, 2)}, {"R": (2, 2, 1.5)}
SIMULATORS = {
    "PathTracing": {"n_paths": 64, "geometry": None},
    "RayTracing": {"n_rays": 16, "n_batches": 2, "geometry": None},
    "ScatteringDelayNetwork": {},
    "ImageSource": {"duration": 0.3},
}


def build(name, **changes):
    """A simulator of the shoebox by its public name."""
    if name == "RayTracing":
        pytest.importorskip("pyroomacoustics")
    arguments = {"room": SHOEBOX, "sources": SOURCE, "receivers": RECEIVER} | SIMULATORS[name]
    if "geometry" in arguments:
        arguments["geometry"] = rt.simulators.Polyhedron.shoebox((5, 7, 3), "all")
    return getattr(rt.simulators, name)(**(arguments | changes))


@pytest.mark.parametrize("name", SIMULATORS)
def test_rows_and_columns_are_the_rooms(name):
    simulator = build(name)
    assert isinstance(simulator, Simulator)
    assert simulator.materials == tuple(SHOEBOX.materials)
    assert np.array_equal(simulator.centre_frequencies, SHOEBOX.centre_frequencies)
    assert simulator.deterministic == (name not in ("PathTracing", "RayTracing"))


def arrays_in(value, seen):
    """Every array that a simulator holds, in tuples, mappings and data classes."""
    if id(value) in seen or isinstance(value, rt.Room):
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple | list):
        for member in value:
            yield from arrays_in(member, seen)
    elif isinstance(value, dict):
        yield from arrays_in(list(value.values()), seen)
    elif hasattr(value, "__dataclass_fields__"):
        yield from arrays_in([getattr(value, f) for f in value.__dataclass_fields__], seen)


@pytest.mark.parametrize("name", SIMULATORS)
def test_what_a_simulator_holds_is_read_only(name):
    simulator = build(name)
    result = simulator.simulate(SHOEBOX.alpha, seed=1)  # a tracer keeps its paths
    arrays = [*arrays_in(simulator, set()), *arrays_in(result, set())]
    assert len(arrays) >= 5
    for array in arrays:
        assert not array.flags.writeable


@pytest.mark.parametrize(
    ("name", "argument", "values"),
    [
        ("PathTracing", "geometry", [None, "box", 5]),
        ("PathTracing", "n_paths", [0, 1, "many", None, 2.5, np.nan]),
        ("PathTracing", "n_batches", [1, "2", None]),
        ("PathTracing", "scattering", [-0.1, "rough", [[0.1, 0.2]], np.nan, [None]]),
        ("PathTracing", "scattering_model", [5, "", ["random"]]),
        ("PathTracing", "radius", [0, -1, "1", np.inf]),
        ("PathTracing", "bin_width", [0, None, "1", np.nan]),
        ("PathTracing", "workers", [0, "2", 1.5]),
        ("RayTracing", "n_rays", [0, 1, "many", None]),
        ("RayTracing", "bin_width", [0.0007, 0, None]),
        ("ScatteringDelayNetwork", "sampling_rate", [0, 10, None, "44100", np.inf]),
        ("ScatteringDelayNetwork", "longest", [0, None, np.nan]),
        ("ScatteringDelayNetwork", "line_of_sight", [None, 1, "no"]),
        ("ImageSource", "duration", [0, None, "1", np.nan, 10]),
        ("ImageSource", "bin_width", [0, 1, None]),
    ],
)
def test_wrong_settings_are_typed_errors(name, argument, values):
    for value in values:
        with pytest.raises(DataError):
            build(name, **{argument: value})


@pytest.mark.parametrize("name", SIMULATORS)
def test_wrong_alpha_and_seed_are_typed_errors(name):
    simulator = build(name)
    for alpha in (None, "x", 0.3, [0.3], [[np.nan]], [[1.1]], [[0.1, 0.2]], [[[0.1]]], [["a"]], {}):
        with pytest.raises(DataError):
            simulator.simulate(alpha)
    for seed in (-1, 0.5, "1", None):
        with pytest.raises(DataError):
            simulator.simulate(SHOEBOX.alpha, seed=seed)


def test_equation_simulators_take_an_equation_and_a_room():
    for equation, room in ((None, SHOEBOX), (rt.Eyring, SHOEBOX), (rt.Eyring(), None)):
        with pytest.raises(DataError):
            rt.simulators.of_equation(equation, room)
    with pytest.raises(DataError, match="nothing absorbs"):
        rt.simulators.of_equation(rt.Eyring(), SHOEBOX).simulate([[0.0]])


@pytest.mark.parametrize("name", SIMULATORS)
def test_a_simulator_shows_as_one_line(name):
    assert repr(build(name)) == f'<{name} of "box": 1 material, 1 band, 1000 Hz>'
