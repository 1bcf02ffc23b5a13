"""SOFA files: responses and positions of rooms; what is no room is refused by name."""

import sys
import tomllib
import warnings

import numpy as np
import pytest
import sofar

from rtcal.acoustics.room import Directivity
from rtcal.command.main import main
from rtcal.io import balloon as balloons
from rtcal.io import impulse_responses, sofa
from rtcal.support.errors import DataError, MissingDependencyError
from tests.conftest import also

RATE = 8000


def decay(seconds, seed=1):
    time = np.arange(RATE) / RATE
    return np.random.default_rng(seed).normal(size=RATE) * 10 ** (-3 * time / seconds)


def file(path, times=(0.5, 0.6), convention="SingleRoomSRIR", **entries):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = sofar.Sofa(convention)
    n = len(times)
    made.Data_IR = np.array([[decay(t, i)] for i, t in enumerate(times)])
    made.Data_SamplingRate = RATE
    if convention == "SingleRoomSRIR":
        made.ListenerPosition = [[2.0 + i, 3.0, 1.2] for i in range(n)]
        made.SourcePosition = [[1.0, 1.0, 1.5]] * n
        made.MeasurementDate = [0.0] * n
        made.Data_Delay = [[0.0]] * n
    for name, value in entries.items():
        setattr(made, name, value)
    for name in ("ReceiverDescriptions", "EmitterDescriptions"):  # netCDF4 1.7.5 writes no texts
        if hasattr(made, name):
            made.delete(name)
    sofar.write_sofa(str(path), made)
    return path


def test_responses_and_positions(tmp_path):
    path = file(tmp_path / "hall.sofa")
    read = sofa.read(path)
    assert read.pairs == (("S1", "R1"), ("S1", "R2"))
    assert read.receivers == {"R1": (2, 3, 1.2), "R2": (3, 3, 1.2)}
    m = impulse_responses.read(path, bands=[500, 1000]).measurement
    assert m.pairs == read.pairs
    assert m.values["t20"] == pytest.approx(np.array([[0.5] * 2, [0.6] * 2]), rel=0.15)
    assert (m.values["t20"][0] < m.values["t20"][1]).all()


def test_spherical_positions(tmp_path):
    path = file(
        tmp_path / "a.sofa",
        SourcePosition=[[90.0, 0.0, 2.0], [90.0, 0.0, 2.0]],
        SourcePosition_Type="spherical",
        SourcePosition_Units="degree, degree, metre",
    )
    assert sofa.read(path).sources == {"S1": pytest.approx((0, 2, 0), abs=1e-9)}


def test_equal_positions_are_repeats_and_must_be_stated(tmp_path):
    path = file(tmp_path / "a.sofa", ListenerPosition=[[2.0, 3.0, 1.2]] * 2)
    with pytest.raises(DataError, match=r"source S1, receiver R1 is given twice"):
        impulse_responses.read(path)
    m = impulse_responses.read(path, bands=[1000], repeats=True).measurement
    assert m.pairs == (("S1", "R1"),)


@pytest.mark.parametrize("convention", ["FreeFieldHRIR", "SimpleFreeFieldHRIR", "GeneralTF"])
def test_what_is_no_room_is_refused_by_name(tmp_path, convention):
    path = tmp_path / "a.sofa"
    made = sofar.Sofa(convention)
    sofar.write_sofa(str(path), made)
    with pytest.raises(DataError, match=f"convention {convention} is not a response"):
        impulse_responses.read(path)


def test_bad_files(tmp_path):
    broken = tmp_path / "broken.sofa"
    broken.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200))
    with pytest.raises(DataError, match=r"broken\.sofa: cannot be read as SOFA"):
        sofa.read(broken)
    with pytest.raises(DataError, match="byte 0: is not a SOFA"):
        sofa.read(tmp_path / "none.sofa")
    free = tmp_path / "free.sofa"
    sofar.write_sofa(str(free), sofar.Sofa("GeneralFIR"))
    with pytest.raises(DataError, match="GeneralFIR in the free field is not a response in a room"):
        sofa.read(free)


def test_without_netcdf_the_extra_is_named(tmp_path, monkeypatch):
    path = file(tmp_path / "a.sofa")
    monkeypatch.setitem(sys.modules, "netCDF4", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'rtcal\[sofa\]'"):
        sofa.read(path)


def test_measure_writes_the_positions_for_the_room(tmp_path):
    path, out, scene = file(tmp_path / "a.sofa"), tmp_path / "t.csv", tmp_path / "scene.toml"
    with pytest.raises(SystemExit) as end:
        main(["measure", str(path), "--out", str(out), "--positions", str(scene), "-q"])
    assert not end.value.code
    assert out.exists()
    assert tomllib.loads(scene.read_text()) == {
        "sources": {"S1": [1.0, 1.0, 1.5]},
        "receivers": {"R1": [2.0, 3.0, 1.2], "R2": [3.0, 3.0, 1.2]},
    }


def balloon(path, convention="FreeFieldDirectivityTF", aim=(0, 1, 0), lowest=-90, **entries):
    """Write lobes of 0 and 6 dB (500 Hz, 1 kHz) on a grid of 10 degrees; the file's axis is +y."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = sofar.Sofa(convention)
    azimuth, elevation = np.meshgrid(np.arange(0, 360, 10), np.arange(lowest, 91, 10))
    at = np.stack([azimuth.ravel(), elevation.ravel(), np.ones(azimuth.size)], axis=1).astype(float)
    a, e = np.radians(at[:, 0]), np.radians(at[:, 1])
    directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    lobe = Directivity(index=(0, 6), aim=aim).gain(directions)
    made.N = [450.0, 500.0, 560.0, 900.0, 1000.0, 1100.0]
    pressure = np.sqrt(np.repeat(lobe, 3, axis=1))[np.newaxis]
    made.Data_Real, made.Data_Imag = 0.6 * pressure, 0.8 * pressure
    made.ReceiverPosition, made.ReceiverPosition_Type = at, "spherical"
    made.ReceiverPosition_Units = "degree, degree, metre"
    frame = {"SourceView": [[0.0, 1.0, 0.0]], "SourceView_Type": "cartesian"}
    frame |= {"SourceView_Units": "metre", "SourceUp": [[0.0, 0.0, 1.0]]}
    for name, value in frame.items():
        if hasattr(made, name):
            setattr(made, name, value)
        elif name.endswith(("Type", "Units")):
            made.add_attribute(name, value)
        else:
            made.add_variable(name, value, "double", "IC")
    for name, value in entries.items():
        setattr(made, name, value)
    for name in ("EmitterDescriptions", "Description"):  # netCDF4 1.7.5 writes no texts
        if hasattr(made, name):
            made.delete(name)
    sofar.write_sofa(str(path), made)
    return path


def test_a_balloon_gives_what_it_radiates_by_octave(tmp_path):
    read = balloons.read(balloon(tmp_path / "b.sofa"), [500, 1000], aim=(1, 0, 0))
    lobe = Directivity(index=[0, 6], aim=(1, 0, 0))
    directions = np.random.default_rng(0).standard_normal((500, 3))
    assert read.gain(directions) == pytest.approx(lobe.gain(directions), abs=0.05)


@pytest.mark.parametrize("convention", ["FreeFieldDirectivityTF", *also("GeneralTF")])
def test_a_balloon_is_turned_with_its_top(tmp_path, convention):
    """The loudspeaker's left in the file is its left in the room."""
    path = balloon(tmp_path / "b.sofa", convention=convention, aim=(-1, 2, 1))
    read = balloons.read(path, [1000], aim=(0, 0, -1), up=(0, 1, 0))
    # In the file the axis is +y and the top +z, so -x is left: now -z is ahead, +y above, -x left.
    # left = above x ahead = y x (-z) = -x
    ahead, above, left = np.array([[0, 0, -1], [0, 1, 0], [-1, 0, 0]])
    peak = 2 * ahead + above + left
    gains = read.gain([peak, 2 * ahead + above - left, 2 * ahead - above + left])[:, 0]
    assert 10 * np.log10(gains[0]) == pytest.approx(6, abs=0.3)
    assert (gains[1:] < 0.8 * gains[0]).all()


def test_a_balloon_that_says_too_little_is_refused(tmp_path):
    path = balloon(tmp_path / "b.sofa")
    with pytest.raises(DataError, match="no frequency in the octave of 4000 Hz"):
        balloons.read(path, [1000, 4000], (1, 0, 0))
    with pytest.raises(DataError, match="SingleRoomSRIR is not a directivity; rtcal reads"):
        balloons.read(file(tmp_path / "r.sofa"), [1000], (1, 0, 0))
    behind = balloon(tmp_path / "c.sofa", SourceView=[[0.0, -1.0, 0.0]])
    with pytest.raises(DataError, match="the source does not radiate along the file's axis"):
        balloons.read(behind, [1000], (1, 0, 0))
    half = balloon(tmp_path / "h.sofa", lowest=0)
    with pytest.raises(DataError, match="leave gaps, in which the nearest direction is up to 90"):
        balloons.read(half, [1000], (1, 0, 0))
    along = balloon(tmp_path / "u.sofa", SourceUp=[[0.0, -2.0, 0.0]])
    with pytest.raises(DataError, match="SourceUp is parallel to SourceView; it must point"):
        balloons.read(along, [1000], (1, 0, 0))
