"""Law: in a diffuse box the simulator at positions and the equation predict one T of a change."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.changes import Variant
from rtcal.loop import ControlRuns, predict_positions
from rtcal.prediction import Change, changed
from rtcal.prediction.words import SIZES
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.support.errors import DataError
from tests.conftest import in_geometry

pytest.importorskip("matplotlib", reason="needs the extra report")

SIZE = (7.0, 5.5, 4.0)
BANDS = [500.0, 1000.0]
SOURCES = {"S1": (1.5, 1.4, 1.5), "S2": (5.0, 1.2, 1.7)}
RECEIVERS = {"R1": (5.4, 4.2, 1.3), "R2": (1.6, 3.9, 1.2)}
PANEL = rt.Material("panel", [0.6, 0.7], [0.08, 0.08])
WALLS = dict.fromkeys(("west", "east", "south", "north", "floor"), "plaster") | {"ceiling": "tiles"}


def a_room():
    geometry = Polyhedron.shoebox(SIZE, WALLS)
    alpha = np.array([[0.12, 0.14], [0.25, 0.3]])
    scene = rt.Scene(sources=SOURCES, receivers=RECEIVERS)
    of_box = {"surfaces": geometry.surfaces, "dimensions": SIZE, "scene": scene}
    stated = {"sigma": 0.25 * alpha, "scattering": np.full((2, 2), 0.6), "air": None}
    return in_geometry(geometry, BANDS, alpha, **of_box, **stated)


def tracing(room, **options):
    return PathTracing(
        geometry=Polyhedron.shoebox(SIZE, WALLS),
        room=room,
        sources=SOURCES,
        receivers=RECEIVERS,
        **({"n_paths": 800} | options),
    )


TRUTH = np.array([[0.15, 0.12], [0.2, 0.33]])


@pytest.fixture(scope="module")
def measured():
    other = tracing(a_room(), n_paths=16000, scattering=0.7)
    return other.simulate(TRUTH, seed=9)


@pytest.fixture(scope="module")
def result(measured):
    match = ("t20", "edt", "c80", "ts")
    return rt.calibrate_positions(tracing(a_room()), a_room(), measured, match)


HALF = Variant("half the tiles", (Change(cover="tiles", by=PANEL, area=SIZE[0] * SIZE[1] / 2),))


@pytest.fixture(scope="module")
def predicted(result):
    variants = [
        HALF,
        Variant("window", (Change(open="plaster", area=3.0),)),
        Variant("nothing", ()),
    ]
    return predict_positions(result, variants)


@pytest.mark.long
def test_the_truth_of_the_change_is_within(predicted):
    """The change as another tracing hears it, whose new material is as stated."""
    other = tracing(a_room(), n_paths=16000, scattering=0.7)
    alpha = TRUTH.copy()
    alpha[1] = (TRUTH[1] + np.array(PANEL.alpha)) / 2
    found = predicted.predictions[0]
    heard = other.observe(alpha, found.parameters, seed=10).values
    off = (heard.mean(axis=1) - found.middle[:, -1]) / found.sigma[:, -1]
    assert np.sqrt(np.mean(off**2)) < 1.6
    assert np.max(np.abs(off)) < 3.5


@pytest.mark.long
def test_an_uncertain_room_counts_before_and_after_the_change(result, predicted):
    """Its volume is in what was heard, too: calibrating takes out what both states share."""
    vague = replace(result, prior=result.prior.replace(volume_sigma=0.1))
    found, exact = predict_positions(vague, [HALF]).predictions[0], predicted.predictions[0]
    assert SIZES not in exact.parts("t20")
    assert (found.parts("t20")[SIZES] > 0).all()
    assert (found.sigma[0, -1] > exact.sigma[0, -1]).all()
    alone = np.sqrt(found.uncalibrated_sigma[0, -1] ** 2 - exact.uncalibrated_sigma[0, -1] ** 2)
    assert alone == pytest.approx([0.1, 0.1], rel=0.2)  # without air T is nearly as V
    shared = np.sqrt(found.sigma[0, -1] ** 2 * found.parts("t20")[SIZES])
    assert (shared < 0.5 * alone).all()


@pytest.fixture(scope="module")
def small():
    """Few paths: what is refused is refused before they count."""
    few = tracing(a_room(), n_paths=160)
    controls = ControlRuns(
        parameters=("t20",), pairs=few.pairs, errors=0.1 * np.ones((4, 1, len(few.pairs), 2))
    )
    heard = few.simulate(TRUTH, seed=9)
    return rt.calibrate_positions(
        few, a_room(), heard, ("t20",), controls=controls, more_paths=1, fit_scattering=False
    )


def test_what_can_be_checked_is_refused_before_anything_is_simulated(small):
    def told(done, total):
        raise AssertionError("a reference simulation was simulated")

    for change, said in (
        (Change(cover="tiles", by=PANEL, area=50), 'cover 50 m² of "tiles" by "panel": area = 50'),
        (Change(open="door"), '"door" is not a material'),
    ):
        with pytest.raises(DataError, match=said):
            predict_positions(small, [HALF, Variant("wrong", (change,))], progress=told)
    with pytest.raises(DataError, match="t99"):
        predict_positions(small, [HALF], wanted=("t99",), progress=told)
    after = rt.Measurement.from_values(a_room().centre_frequencies, t20=[1.0, 1.0])
    with pytest.raises(DataError, match=r"variants\[0\] has simulated"):
        predict_positions(small, [Variant("run", (), simulated=after)], progress=told)


def test_before_is_what_was_measured_and_the_change_is_the_equations(small):
    variants = [HALF, Variant("nothing", ())]
    half, nothing = predict_positions(small, variants, wanted=("t20",)).predictions
    measured = small.measured.observations.natural("t20").mean(axis=0)
    assert nothing.mean("t20") == pytest.approx(measured, rel=0.02)
    assert nothing.change("t20") == pytest.approx(np.zeros((5, 2)), abs=1e-9)
    assert half.before_change("t20") == pytest.approx(nothing.at_pairs("t20"))
    times = [
        rt.Eyring().reverberation_time(of) for of in (changed(small.room, HALF.changes), small.room)
    ]
    ratio = half.mean("t20") / nothing.mean("t20")
    assert ratio == pytest.approx(times[0] / times[1], rel=0.05)
