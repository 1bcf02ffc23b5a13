"""A law: repeats at one place are one position, however they are named and wherever they enter."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import PositionsCase
from rtcal.loop.positions import calibrate_positions
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.support.errors import DataError
from tests.conftest import measurement_of, room_of

BANDS = [250.0, 500.0, 1000.0]
RNG = np.random.default_rng(3)
SWEEPS = 1.0 + 0.02 * RNG.standard_normal((5, 3))
"""T20 of five sweeps at one microphone."""
NAMES = {
    "numbered": ["R1", "R1#2", "R1#3", "R1#4", "R1#5"],
    "all numbered": ["R1#1", "R1#2", "R1#3", "R1#4", "R1#5"],
}


def of_names(receivers, **more):
    pairs = [("S1", name) for name in receivers]
    values = {"t20": SWEEPS[: len(receivers)]}
    return rt.Measurement(centre_frequencies=BANDS, values=values, pairs=pairs, **more)


def once():
    """Return one measurement with the repeats' mean."""
    return measurement_of(BANDS, [("S1", "R1")], t20=SWEEPS.mean(axis=0)[None])


def the_same(a, b):
    assert a.pairs == b.pairs
    np.testing.assert_allclose(a.mean("t20"), b.mean("t20"), rtol=1e-14)
    np.testing.assert_allclose(a.mean_uncertainty("t20"), b.mean_uncertainty("t20"), rtol=1e-14)


@pytest.mark.parametrize("names", NAMES.values(), ids=NAMES)
def test_by_name(names):
    repeated = of_names(names)
    the_same(repeated, once())
    # Five positions would have told more.
    alone = of_names([f"R{i}" for i in range(1, 6)]).mean_uncertainty("t20")
    assert (alone < 0.6 * repeated.mean_uncertainty("t20")).all()


def test_by_option_and_in_a_file(tmp_path):
    names = [f"R{i}" for i in range(1, 6)]
    by_option = of_names(names).with_repeats(receivers=dict.fromkeys(names[1:], "R1"))
    the_same(by_option, once())
    by_option.save(str(tmp_path / "t.csv"))
    the_same(rt.Measurement.from_file(str(tmp_path / "t.csv")), once())


@pytest.mark.parametrize("named", [True, False])
def test_in_a_table(named):
    rows = [
        ";".join([f"S1R1#{i + 1}" if named and i else "S1R1", *(f"{v:.6f}" for v in row)])
        for i, row in enumerate(SWEEPS)
    ]
    content = "\n".join(["Position;T20 250 Hz;T20 500 Hz;T20 1000 Hz", *rows]).encode()
    table = rt.io.tables.parse(content, repeats=not named)
    np.testing.assert_allclose(
        table.measurement.mean_uncertainty("t20"), once().mean_uncertainty("t20"), rtol=1e-6
    )
    assert "5 of S1 to R1" in str(table)
    if not named:
        with pytest.raises(DataError, match=r"given twice. If they are repeats at one position"):
            rt.io.tables.parse(content)


def box():
    room = room_of(
        {"walls": (74.0, 0.2, 0.05), "floor": (20.0, 0.2, 0.05)},
        BANDS,
        60.0,
        name="box",
        dimensions=(4.0, 5.0, 3.0),
    )
    geometry = rt.simulators.Polyhedron.shoebox(
        (4.0, 5.0, 3.0), {**dict.fromkeys(SHOEBOX_WALLS, "walls"), "floor": "floor"}
    )
    points = {"R1": (3.0, 4.0, 1.2), "R2": (3.0, 4.0, 1.2), "R3": (1.0, 3.5, 1.2)}
    tracer = rt.simulators.PathTracing(
        geometry=geometry,
        room=room,
        sources={"S1": (1.0, 1.0, 1.5)},
        receivers=points,
        n_paths=400,
        scattering=0.5,
    )
    return room, tracer


def test_by_position():
    """Two names at one place are one pair in a case and for every way to calibrate a simulator."""
    room, tracer = box()
    measured = of_names(["R1", "R2", "R3"])
    joined = measured.with_repeats(receivers={"R2": "R1"})
    case = PositionsCase(simulator=tracer, measured=measured)
    assert case.measured.pairs == joined.pairs
    for same in (case, case.only(case.pairs[:1])):
        assert [note for note in same.notes if "one position: 2 of S1 to R1" in note] != []
        assert len(same.notes) == 1
    assert PositionsCase(simulator=tracer, measured=joined).notes == ()
    to_all = calibrate_positions(
        tracer, room, measured, ("t20", "edt"), fit_scattering=False, more_paths=1
    )
    assert to_all.measured.observations.pairs == joined.pairs
    to_mean = rt.calibrate_simulator(tracer, room, measured, max_simulations=2)
    np.testing.assert_allclose(to_mean.wanted, joined.mean("t20"))
    for result in (to_all, to_mean):
        assert any("one position: 2 of S1 to R1" in note for note in result.notes)


def test_the_repeats_share_what_is_uncertain_at_their_place():
    """A stated uncertainty does not fall with the number of sweeps."""
    of_one = 0.03
    stated = of_names(NAMES["numbered"], uncertainty={"t20": np.full((5, 3), of_one)})
    np.testing.assert_allclose(stated.mean_uncertainty("t20"), of_one)


def test_seats_with_numbers_stay_positions():
    assert len(of_names(["Seat #1", "Seat #2", "Seat #3"]).pairs) == 3
