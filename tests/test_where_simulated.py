"""A case with another program's values in place of rtcal's own: its file, and what is compared."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.apply import corrected_geometry
from rtcal.finder.verification import OF_RUNS, _less, verify
from rtcal.simulators import RayTracing
from rtcal.simulators.base import Observations
from rtcal.support.errors import DataError
from tests.test_where import BANDS, RECEIVERS, SOURCES, measured, stated, tracing
from tests.test_where_corrected import candidate

pytest.importorskip("pyroomacoustics", reason="the other program")

MATCH = ("t20", "edt", "c80", "ts")


def read(folder, measured="measured.csv"):
    room = rt.Room.from_file(str(folder / "room.toml"))
    return rt.finder.case_of(
        room,
        rt.Measurement.from_file(str(folder / measured)),
        tracing={"scattering": 0.4, "n_paths": 4800},
        match=MATCH,
        simulated=rt.Run(room, rt.Measurement.from_file(str(folder / "simulated.csv"))),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A user's files: what pyroomacoustics says of the model, and of the room with 10 m² more."""
    where = tmp_path_factory.mktemp("program")
    room = stated()
    case = rt.finder.PositionsCase(simulator=tracing(room), measured=measured(False))
    made = corrected_geometry(case, replace(candidate("east", 10.0), spectrum=np.ones(len(BANDS))))

    def program(geometry, of, seed):
        tracer = RayTracing(
            geometry=geometry,
            room=of,
            sources=SOURCES,
            receivers=RECEIVERS,
            scattering=0.4,
            n_rays=16_000,
        )
        return tracer.simulate(of.alpha, seed=seed)

    scene = rt.Scene(sources=SOURCES, receivers=RECEIVERS)
    room.replace(scene=scene).save(str(where / "room.toml"))
    program(case.geometry, room, 1).save(str(where / "simulated.csv"))
    program(case.geometry, room, 2).save(str(where / "same.csv"))
    program(made.geometry, made.room, 3).save(str(where / "measured.csv"))
    program(made.geometry, made.room, 4).save(str(where / "corrected.csv"))
    return where


@pytest.fixture(scope="module")
def finding(folder):
    """The same, with one effect alone, which is quick."""
    return rt.find(read(folder), only=["opening"], cache=folder / "kept")


@pytest.mark.long
def test_a_second_run_is_compared_at_pairs(finding, folder):
    """The program simulates what is hidden, so that only its noise is left, by pair."""
    second = rt.Measurement.from_file(str(folder / "corrected.csv"))
    found = replace(finding, verdict="family", family="added absorption, flat")
    chosen = {"effect": "opening", "at": (7.0, 2.2, 1.4)}
    made = verify(found, simulated=second, **chosen)
    assert made.models == OF_RUNS
    assert made.runs == OF_RUNS[:1]
    assert made.gaps.shape[0] == 3
    assert len(made.places) == len(finding.pairs)
    first, calibrated, corrected = made.by_seed.mean(axis=1)
    assert corrected < 0.7 * calibrated <= 0.71 * first
    # As simulated is the run itself, whatever the tracer gives.
    (whole,) = found.comparisons
    deviations = np.abs(whole.at_pairs["t20"])
    assert np.nanmean(np.abs(made.gaps[0, 0, 0])) == pytest.approx(np.nanmean(deviations))
    assert np.nanmean(np.abs(made.again)) < 0.5 * np.nanmean(np.abs(made.gaps[0]))
    # A run with the calibrated coefficients takes the tracer's place; T is matched.
    given = verify(found, simulated=second, calibrated=finding.case.simulated, **chosen)
    assert given.runs == OF_RUNS
    assert not given.counted[0].any()
    assert given.counted[1:].all()
    np.testing.assert_allclose(given.gaps[1], given.gaps[0])
    with pytest.raises(DataError, match="simulated is the same simulation as that of the search"):
        verify(found, simulated=finding.case.simulated, **chosen)
    with pytest.raises(DataError, match="calibrated is given without simulated"):
        verify(found, calibrated=second)
    with pytest.raises(DataError, match="effect is given without simulated"):
        verify(found, effect="opening")


def beside(run, of):
    return rt.finder.PositionsCase(simulator=tracing(stated()), measured=of, simulated=run)


def given(*parameters):
    pairs = [(s, r) for s in SOURCES for r in RECEIVERS]
    values = {p: np.ones((len(pairs), len(BANDS))) for p in parameters}
    return rt.Measurement(centre_frequencies=BANDS, pairs=pairs, values=values)


def with_values(data, **values):
    """Return the measurement with other values; those of None are taken out."""
    kept = {p: v for p, v in {**data.values, **values}.items() if v is not None}
    return rt.Measurement(centre_frequencies=data.centre_frequencies, pairs=data.pairs, values=kept)


def blank(values, where):
    out = np.array(values)
    out[where] = np.nan
    return out


def test_what_a_run_lacks_is_left_out_and_named():
    whole = given(*MATCH)
    pairs = [pair for pair in whole.pairs if pair != ("S2", "R3")]
    edt = blank(whole.values["edt"], (slice(None), -1))
    ts = blank(whole.values["ts"], (0, 0))
    run = with_values(whole, c80=None, edt=edt, ts=ts).select(pairs)
    case = beside(run, whole)
    assert ("S2", "R3") not in case.pairs
    assert len(case.pairs) == len(pairs)
    assert "c80" not in case.match
    assert np.isnan(case.in_room.values["edt"][:, -1]).all()
    assert np.isnan(case.in_room.values["ts"]).sum() == 1
    source, receiver = pairs[0]
    (note,) = [n for n in case.notes if "the run does not have" in n]
    assert note == (
        f"Not compared: C80, S2 to R3, EDT at {BANDS[-1]:g} Hz and Ts from {source} to {receiver} at "
        f"{BANDS[0]:g} Hz, which the run does not have."
    )
    also = rt.compare(stated(), whole, rt.Run(stated(), run))
    assert also.left_out == [note]
    assert replace(case, match=case.match).notes == case.notes


def test_a_measurement_less_an_offset_keeps_its_relative_uncertainty():
    """A calibration to it is that of the tracer plus the offset to the measurement."""
    whole = given(*MATCH)
    own = {"t20": np.full_like(whole.values["t20"], 0.02)}
    common = {"t20": np.full(len(BANDS), 0.03), "c80": np.full(len(BANDS), 0.4)}
    whole = replace(whole, uncertainty=own, common_uncertainty=common)
    offset = np.random.default_rng(2).normal(0, 0.1, (len(MATCH), len(whole.pairs), len(BANDS)))
    less = _less(whole, MATCH, whole.pairs, offset)
    left = [Observations.of_measurement(of, MATCH, whole.pairs).values for of in (whole, less)]
    np.testing.assert_allclose(left[0] - left[1], offset)
    np.testing.assert_allclose(less.uncertainty["t20"] / less.values["t20"], 0.02)
    share = less.common_uncertainty["t20"] / less.values["t20"].mean(axis=0)
    np.testing.assert_allclose(share, 0.03, rtol=1e-6)
    np.testing.assert_allclose(less.common_uncertainty["c80"], 0.4)


def test_a_run_with_nothing_that_was_measured_is_refused():
    with pytest.raises(DataError, match=r"no value in common: the simulation has T30 .* has T20"):
        beside(given("t30"), given("t20"))
    first, last = given("t20").select([("S1", "R1")]), given("t20").select([("S2", "R3")])
    with pytest.raises(
        DataError, match=r"no source-receiver pair in common: .* S1 to R1, .* S2 to R3"
    ):
        beside(first, last)
