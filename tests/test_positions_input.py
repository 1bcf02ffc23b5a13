"""Calibration to every position: bad input, other simulators, and the command."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import rtcal as rt
from rtcal.acoustics.observables import MATCH
from rtcal.command.calibrate import NOT_NEARER
from rtcal.command.main import cli
from rtcal.datasets import halls
from rtcal.loop import measured_pairs
from rtcal.loop.measured_pairs import response_noise
from rtcal.simulators import ImageSource, ScatteringDelayNetwork
from rtcal.support.errors import DataError
from tests.conftest import also, in_hall, measurement_of, room_of

HALL = halls.lecture_hall()
ROOM = HALL.room
PLACES = {
    "sources": {name: list(map(float, p)) for name, p in HALL.sources.items()},
    "receivers": {name: list(map(float, p)) for name, p in HALL.receivers.items()},
}


@pytest.fixture(scope="module")
def tracer():
    return in_hall(HALL, n_paths=160, scattering=0.5)


@pytest.fixture(scope="module")
def measured():
    """Data of many paths: to the noise of few no fit leads nearer."""
    return in_hall(HALL, n_paths=3000, scattering=0.5).simulate(ROOM.alpha * 1.1, seed=3)


FOLDER = {}
"""The folder of reference simulations, for `calibrate`."""


@pytest.fixture(autouse=True)
def few_runs(monkeypatch, kept):
    monkeypatch.setattr(measured_pairs, "RUNS", 2)
    monkeypatch.setitem(FOLDER, "cache", kept)


def test_too_few_paths_are_not_taken_for_too_much_absorption(measured):
    few = in_hall(HALL, n_paths=16, scattering=0.5)
    with pytest.raises(DataError, match="paths per source are too few"):
        rt.calibrate_positions(few, ROOM, measured, match=("t20", "edt"), more_paths=1)
    black = np.full(ROOM.alpha.shape, 0.999)
    with pytest.raises(DataError, match="too little sound is reflected"):
        few.observe(black, ("t20",))


def only(measured, rows, pairs=None, **values):
    return measurement_of(
        measured.centre_frequencies,
        pairs or [measured.pairs[i] for i in rows],
        **({p: v[rows] for p, v in measured.values.items()} | values),
    )


def calibrate(tracer, measured, match=("t20", "c80"), **options):
    return rt.calibrate_positions(tracer, ROOM, measured, match=match, **(FOLDER | options))


SHAPE = (len(HALL.sources) * len(HALL.receivers), ROOM.n_bands)
SURE = {p: np.full(SHAPE, 1e-9) for p in ("t20", "c80")}


@pytest.mark.parametrize(
    ("changed", "options", "place"),
    [
        (
            lambda _: rt.Measurement.from_values(
                ROOM.centre_frequencies, t20=np.ones(ROOM.n_bands)
            ),
            {},
            "a row for each source and receiver",
        ),
        (lambda m: only(m, [0], [("X", "Y")]), {}, "the measurement has X to Y"),
        (lambda m: m, {"match": ("level",)}, "none of level"),
        (lambda m: replace(m, uncertainty=SURE), {}, "the uncertainty of"),
        (lambda m: m, {"exclude": [("S9", "R1")]}, "exclude has S9 to R1"),
        (
            lambda m: m,
            {"exclude": [(s, r) for s in HALL.sources for r in HALL.receivers]},
            "no pair",
        ),
    ],
)
def test_what_cannot_be_matched_is_refused(tracer, measured, changed, options, place):
    with pytest.raises(DataError, match=place):
        calibrate(tracer, changed(measured), **options)


@pytest.mark.long
def test_stated_uncertainties_replace_the_assumed_ones(tracer, measured):
    rows, shape = list(range(len(measured.pairs))), measured.values["t20"].shape
    own, common = np.full(shape, 0.02), np.full(shape[1], 0.1)

    def covariance(**stated):
        m = dataclasses.replace(only(measured, rows), **stated)
        t = m.values["t20"][:, 0]
        first_band = np.s_[0 : t.size * shape[1] : shape[1]]
        return calibrate(tracer, m).measured.covariance[first_band, first_band], t

    alone, t = covariance(uncertainty={"t20": own})
    assert alone == pytest.approx(np.diag((0.02 / t) ** 2))
    both, _ = covariance(uncertainty={"t20": own}, common_uncertainty={"t20": common})
    assert both - alone == pytest.approx(0.01 / np.outer(t, t))
    made, _ = covariance()
    of_team, _ = covariance(common_uncertainty={"t20": common})
    assert np.diag(of_team - made) == pytest.approx(0.01 / t**2 - made[0, 1])


BOX = room_of(
    {"floor": (35, 0.3, 0.1), "other": (107, 0.2, 0.05)},
    [1000],
    105,
    name="box",
    dimensions=(5, 7, 3),
    surfaces=[
        rt.Surface("floor", "floor", 35.0),
        rt.Surface("ceiling", "other", 35.0),
        *(rt.Surface(w, "other", 21.0) for w in ("west", "east")),
        *(rt.Surface(w, "other", 15.0) for w in ("south", "north")),
    ],
)
IN_BOX = {
    "sources": {"S": (4.0, 3.5, 2.0)},
    "receivers": {"R": (2.0, 2.0, 1.5), "Q": (1.0, 5.0, 1.2)},
}


@pytest.mark.parametrize(
    "simulator",
    [
        ImageSource(room=BOX, duration=1.0, **IN_BOX),
        *also(ScatteringDelayNetwork(room=BOX, sampling_rate=8000, **IN_BOX)),
    ],
    ids=["image sources", "network"],
)
def test_shoebox_simulators_have_levels_and_are_calibrated(simulator):
    assert rt.simulators.base.derivatives(simulator) is simulator
    heard = simulator.observe(BOX.alpha, MATCH)
    assert heard.values.shape == (5, 2, 1)
    np.testing.assert_allclose(
        heard.natural("t20"), simulator.simulate(BOX.alpha).values["t20"], rtol=1e-12
    )
    slope = simulator.jacobian(BOX.alpha, MATCH)
    assert slope.shape == (5, 2, 1, 2)
    assert (slope[MATCH.index("level")] < 0).all()
    distance = np.linalg.norm(np.subtract(IN_BOX["sources"]["S"], IN_BOX["receivers"]["R"]))
    nothing = simulator.observe(np.full_like(BOX.alpha, 0.999), ("level",)).natural("level")
    assert nothing[0, 0] == pytest.approx(20 - 20 * np.log10(distance), abs=0.1)
    true = np.array([[0.4], [0.18]])
    seen = simulator.observe(true, MATCH)
    measured = measurement_of(
        [1000], seen.pairs, **{("g" if p == "level" else p): seen.natural(p) for p in MATCH}
    )
    result = rt.calibrate_positions(simulator, BOX, measured, match=MATCH)
    # Its reference simulations are path tracings, so its own decays are not taken at their word.
    assert result.interval is not None
    assert result.certificate.worst < 1e-9
    assert result.sigma[0, 0] < 0.95 * BOX.sigma[0, 0]


def test_noise_of_a_response_is_that_of_iso_3382_2():
    noise = response_noise(["t20", "t30"], 1.3, 355.0)
    expected = [a * np.sqrt((1 + b / 10) / (355.0 * 1.3)) for a, b in ((0.88, 1.90), (0.55, 1.52))]
    np.testing.assert_allclose(np.sqrt(np.diag(noise)), expected, rtol=0.1)


@pytest.fixture
def folder(tmp_path, tracer, measured):
    scattering = np.full(ROOM.alpha.shape, 0.5)
    scene = rt.Scene(mesh=tmp_path / "room.obj", **PLACES)
    ROOM.replace(scattering=scattering, scene=scene).save(str(tmp_path / "room.toml"))
    measured.save(str(tmp_path / "pairs.csv"))
    HALL.geometry.save(tmp_path / "room.obj")
    return tmp_path


def fit(folder, *options):
    files = [str(folder / name) for name in ("room.toml", "pairs.csv")]
    return CliRunner().invoke(cli, ["fit", *files, "--paths", "160", *options])


@pytest.mark.long
def test_a_fit_that_leads_no_nearer_writes_nothing_and_has_a_code_of_its_own(folder):
    """Nothing may move, so that the start is returned."""
    room = rt.Room.from_file(str(folder / "room.toml"))
    room.replace(sigma=np.zeros_like(room.sigma)).save(str(folder / "room.toml"))
    options = "--match", "t20", "--keep-scattering", "--out", str(folder / "made")
    done = fit(folder, *options)
    assert done.exit_code == NOT_NEARER == 7
    first = done.stdout.splitlines()[0]
    assert first.startswith(
        "No step reduced the deviation from the measurement, so the start is returned"
    )
    assert not (folder / "made").exists()
    forced = fit(folder, *options, "--force")
    assert forced.exit_code == NOT_NEARER
    written = rt.Room.from_file(str(folder / "made" / "room.toml"))
    np.testing.assert_array_equal(written.alpha, room.alpha)
    assert written.calibration is None
    assert fit(folder, *options, "--quiet").exit_code == NOT_NEARER
