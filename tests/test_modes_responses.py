"""Modes of impulse responses: known poles, what is left out, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.modes import find_modes
from rtcal.modes.room_modes import box_modes
from rtcal.support.errors import DataError
from tests.conftest import also
from tests.test_modes import ROOM, SHOEBOX_WALLS, SIDES, TRUTH, C, times

RATE = 800.0
SOURCE, RECEIVERS = (
    (0.2, 0.3, 0.2),
    [(4.9, 0.3, 1.2), (2.2, 3.5, 1.3), (1, 2.1, 0.4), (4.2, 2.5, 2.3)],
)
PAIRS = [("S", f"R{k}") for k in range(4)]
SCENE = rt.Scene(sources={"S": SOURCE}, receivers={f"R{k}": r for k, r in enumerate(RECEIVERS)})


PLACED = ROOM.replace(scene=SCENE)


def heard(alpha=TRUTH, noise=50.0, seconds=2.5, seed=0, sides=SIDES):
    """Return poles of the box and responses, with noise this many dB below the largest sample."""
    modes = box_modes(np.array(sides), SHOEBOX_WALLS, 170, C)
    poles = modes.poles(lambda f: rt.modes.admittance(alpha[:, 0]))
    at = [modes.shapes(np.array(p)) @ poles.mixtures for p in ([SOURCE], RECEIVERS)]
    t = np.arange(int(seconds * RATE)) / RATE
    waves = np.exp(poles.values[:, np.newaxis] * t) / poles.values[:, np.newaxis]
    signals = ((at[0] * at[1]) @ waves).real
    rng = np.random.default_rng(seed)
    signals += 10 ** (-noise / 20) * np.abs(signals).max() * rng.standard_normal(signals.shape)
    return poles, signals


def test_modes_of_a_box_within_their_uncertainty():
    """Those that overlap, too: 66.0 Hz stands twice in this box, as 2 0 0 and 0 0 1."""
    poles, signals = heard()
    found = find_modes(PLACED, signals, RATE, PAIRS, highest=100)
    there = np.flatnonzero((poles.frequencies > 20) & (poles.frequencies < 100))
    assert len(set(found.calculated) & set(there)) >= 0.8 * len(there)
    true = poles.values[found.calculated]
    z = (found.decays + true.real) / found.decay_uncertainty
    assert np.abs(z).max() < 3
    np.testing.assert_allclose(found.frequencies, true.imag / (2 * np.pi), rtol=0.02)
    twice = np.flatnonzero(np.abs(C * np.hypot(0, [1 / 5.2, 0.5 / 2.6]) - 66.0) < 0.1)
    assert len(twice) == 2
    near = np.abs(poles.frequencies - 66.0) < 1.5
    assert near.sum() == 2
    assert set(np.flatnonzero(near)) <= set(found.calculated)
    assert "were found" in found.notes[0]


def test_the_constant_pressure_is_no_mode():
    """It decays twice as fast as modes, and is heard at all positions alike, up into the band."""
    poles, signals = heard()
    t = np.arange(signals.shape[1]) / RATE
    signals += 0.5 * np.abs(signals).max() * np.exp(-30 * t)
    found = find_modes(PLACED, signals, RATE, PAIRS, highest=100)
    z = (found.decays + poles.values[found.calculated].real) / found.decay_uncertainty
    assert np.abs(z).max() < 3


def test_frequencies_that_are_all_off_are_found_as_the_rooms_own():
    poles, signals = heard()
    warmer = PLACED.replace(air=rt.Air(32, 50))
    found = find_modes(warmer, signals, RATE, PAIRS, highest=100)
    true = poles.frequencies[found.calculated]
    np.testing.assert_allclose(found.frequencies, true, rtol=0.02)


@pytest.mark.parametrize("wrong", ["exchanged", *also("late", "other room")])
def test_what_the_rooms_modes_do_not_explain(wrong):
    _, signals = heard()
    room = PLACED
    if wrong == "exchanged":
        signals = signals[[1, 0, 3, 2]]
    elif wrong == "late":
        signals = np.roll(signals, int(0.02 * RATE), axis=1)
    else:
        _, signals = heard(sides=(6.4, 3.7, 2.9))
    with pytest.raises(DataError, match="Check dimensions, positions"):
        find_modes(room, signals, RATE, PAIRS, highest=100)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: {"responses": s[:1], "pairs": PAIRS[:1]}, "has 1 pair"),
        (lambda s: {"pairs": [*PAIRS[:3], ("S", "R9")]}, "S to R9 has no position"),
        (lambda s: {"pairs": [*PAIRS[:3], PAIRS[1]]}, "S to R1 occurs twice"),
        (
            lambda s: {
                "room": PLACED.replace(
                    scene=rt.Scene(sources={"S": (0, 0, 9)}, receivers=dict(SCENE.receivers))
                )
            },
            r"S at \(0, 0, 9\) m: a position lies outside the room's walls",
        ),
        (lambda s: {"responses": s[:3]}, "shape"),
        (lambda s: {"responses": np.where(np.arange(s.shape[1]) == 9, np.nan, s)}, "not finite"),
        (lambda s: {"responses": np.clip(s, -np.abs(s).max() / 9, np.abs(s).max() / 9)}, "clipped"),
        (lambda s: {"responses": s[:, :400]}, "at least 1 s"),
        (lambda s: {"highest": 500.0}, "rate / 2.5"),
        (lambda s: {"rate": -1.0}, "rate"),
        (
            lambda s: {"responses": np.random.default_rng(0).standard_normal(s.shape)},
            "do not decay by 15 dB",
        ),
    ],
)
def test_what_is_refused(change, words):
    _, signals = heard()
    arguments = {
        "room": PLACED,
        "responses": signals,
        "rate": RATE,
        "pairs": PAIRS,
        **change(signals),
    }
    with pytest.raises(DataError, match=words):
        find_modes(**arguments)


def sofa(**changes):
    """Return responses as a SOFA file has them."""
    given = {
        "pairs": tuple(PAIRS),
        "sampling_rate": RATE,
        "sources": dict(SCENE.sources),
        "receivers": dict(SCENE.receivers),
        "convention": "SingleRoomSRIR",
    }
    return rt.io.sofa.Responses(**given | changes)


def test_responses_of_a_sofa_file():
    """Its first pair was measured twice; then its positions have other names, and one is far off."""
    _, signals = heard()
    twice = np.concatenate([signals[:1], 0 * signals[:1], signals[1:]])[:, np.newaxis]
    turned = {f"R{k}": RECEIVERS[3 - k] for k in range(4)}
    named = sofa(
        pairs=tuple(PAIRS[::-1]),
        samples=signals[:, np.newaxis],
        sources={"S": (0.21, 0.33, 0.2)},
        receivers=turned,
    )
    by_hand = rt.calibrate_modes(PLACED, find_modes(PLACED, signals, RATE, PAIRS), times(TRUTH))
    by_file, by_place = (
        rt.calibrate_modes(PLACED, given, times(TRUTH))
        for given in (sofa(pairs=(PAIRS[0], *PAIRS), samples=twice), named)
    )
    np.testing.assert_array_equal(by_file.alpha, by_hand.alpha)
    np.testing.assert_array_equal(by_place.alpha, by_hand.alpha)
    assert "receiver R0 is R3" in str(by_place.notes)
    far = replace(named, receivers={**turned, "R1": (3.0, 3.0, 1.0)})
    with pytest.raises(DataError, match=r"receiver R1 of the SOFA file is at \(3, 3, 1\) m, 0.99"):
        rt.calibrate_modes(PLACED, far)


def test_command_takes_a_sofa_file(tmp_path, rtcal):
    pytest.importorskip("sofar")
    from tests.test_sofa import file

    _, signals = heard()
    path = file(
        tmp_path / "heard.sofa",
        (0.5,) * 4,
        Data_IR=signals[:, np.newaxis],
        Data_SamplingRate=RATE,
        ListenerPosition=RECEIVERS,
        SourcePosition=[SOURCE] * 4,
    )
    names = rt.io.sofa.read(path)
    room = ROOM.replace(scene=rt.Scene(sources=names.sources, receivers=names.receivers))
    room.save(tmp_path / "room.toml")
    rt.Measurement.from_values(ROOM.centre_frequencies, t20=times(TRUTH)).save(tmp_path / "t.csv")
    files, out = (tmp_path / "room.toml", tmp_path / "t.csv"), tmp_path / "calibrated"
    told = rtcal("calibrate", *files, "--modes", path, "--out", out)
    amplitudes = rt.load(out).modes.amplitudes
    assert amplitudes.dtype == complex
    assert amplitudes.shape[1] == len(PAIRS)
    rtcal("report", out)
    assert "walls that matter most" in told
    assert "were found" in told
