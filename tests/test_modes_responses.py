"""Modes of impulse responses: known poles, what is left out, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

import rtcal as rt
from rtcal.command.main import cli
from rtcal.errors import DataError
from rtcal.modes import find_modes
from tests.test_modes import BOX, ROOM, SHOEBOX_WALLS, SIDES, TRUTH, C, times

RATE = 800.0
SOURCE, RECEIVERS = (
    (0.2, 0.3, 0.2),
    [(4.9, 0.3, 1.2), (2.2, 3.5, 1.3), (1, 2.1, 0.4), (4.2, 2.5, 2.3)],
)
PAIRS = [("S", f"R{k}") for k in range(4)]
SCENE = rt.Scene(sources={"S": SOURCE}, receivers={f"R{k}": r for k, r in enumerate(RECEIVERS)})


def heard(alpha=TRUTH, noise=50.0, seconds=2.5, seed=0):
    """Return poles of the box and responses, with noise this many dB below the largest sample."""
    modes = rt.modes.box_modes(SIDES, SHOEBOX_WALLS, 170, C)
    poles = modes.poles(lambda f: rt.modes.admittance(alpha[:, 0]))
    at = [modes.shapes(np.array(p)) @ poles.mixtures for p in ([SOURCE], RECEIVERS)]
    t = np.arange(int(seconds * RATE)) / RATE
    waves = np.exp(poles.values[:, np.newaxis] * t) / poles.values[:, np.newaxis]
    signals = ((at[0] * at[1]) @ waves).real
    rng = np.random.default_rng(seed)
    signals += 10 ** (-noise / 20) * np.abs(signals).max() * rng.standard_normal(signals.shape)
    return poles, signals


def test_poles_of_a_box_within_their_uncertainty():
    poles, signals = heard()
    found = find_modes(signals, RATE, PAIRS, highest=90)
    nearest = np.abs(poles.frequencies - found.frequencies[:, np.newaxis]).argmin(axis=1)
    alone = [
        k
        for k, n in enumerate(nearest)
        if np.sort(np.abs(poles.frequencies - poles.frequencies[n]))[1] > 4
    ]
    assert len(alone) >= 4
    z = ((found.decays - poles.decays[nearest]) / found.decay_uncertainty)[alone]
    assert np.abs(z).max() < 4
    np.testing.assert_allclose(found.decays[alone], poles.decays[nearest][alone], rtol=0.15)
    np.testing.assert_allclose(
        found.frequencies[alone], poles.frequencies[nearest][alone], rtol=5e-3
    )
    assert "ESPRIT" in found.notes[0]
    assert "order" in found.notes[0]


def test_uncertainty_is_that_of_repeated_noise():
    """One mode, fifty draws of noise: the spread is the stated uncertainty."""
    t = np.arange(2000) / RATE
    one = np.exp(-6 * t) * np.cos(2 * np.pi * 47.3 * t)
    decays, stated = [], []
    for seed in range(50):
        noise = 0.02 * np.random.default_rng(seed).standard_normal((3, t.size))
        found = find_modes(np.array([one, -0.6 * one, 0.8 * one]) + noise, RATE, PAIRS[:3],
                           lowest=38, highest=60)  # fmt: skip
        k = int(np.abs(found.frequencies - 47.3).argmin())
        decays.append(found.decays[k])
        stated.append(found.decay_uncertainty[k])
    assert np.mean(decays) == pytest.approx(6, rel=0.02)
    assert 0.6 < np.std(decays) / np.mean(stated) < 1.5


def test_responses_to_coefficients():
    poles, signals = heard()
    del poles
    modes = find_modes(signals, RATE, PAIRS, highest=100)
    room = ROOM.replace(scene=SCENE)
    result = rt.calibrate_modes(room, modes, times(TRUTH), geometry=BOX)
    by_t = rt.calibrate(room, times(TRUTH))
    error = [np.abs(a[:, 0] - TRUTH[:, 0]).mean() for a in (result.alpha, by_t.alpha)]
    assert len(result.used) >= 5
    assert error[0] < 0.8 * error[1]


def test_two_modes_in_one_are_left_out():
    """66.0 Hz stands twice in this box: 2 0 0 and 0 0 1."""
    _, signals = heard()
    modes = find_modes(signals, RATE, PAIRS, highest=100)
    result = rt.calibrate_modes(ROOM.replace(scene=SCENE), modes, times(TRUTH))
    assert not np.any(np.abs(modes.frequencies[result.used] - 66.0) < 0.5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: {"responses": s[:1], "pairs": PAIRS[:1]}, "has 1 pair"),
        (lambda s: {"responses": s[:3]}, "shape"),
        (lambda s: {"responses": np.where(np.arange(s.shape[1]) == 9, np.nan, s)}, "not finite"),
        (lambda s: {"responses": np.clip(s, -np.abs(s).max() / 9, np.abs(s).max() / 9)}, "clipped"),
        (lambda s: {"responses": 0 * s}, "silent"),
        (lambda s: {"responses": s[:, :400]}, "at least 1 s"),
        (lambda s: {"highest": 500.0}, "rate / 2.5"),
        (lambda s: {"rate": -1.0}, "rate"),
        (
            lambda s: {"responses": np.random.default_rng(0).standard_normal(s.shape)},
            "above its noise",
        ),
    ],
)
def test_what_is_refused(change, words):
    _, signals = heard()
    arguments = {"responses": signals, "rate": RATE, "pairs": PAIRS, **change(signals)}
    with pytest.raises(DataError, match=words):
        find_modes(**arguments)


def test_responses_of_a_sofa_file():
    _, signals = heard()
    pairs = [PAIRS[0], *PAIRS]  # the first was measured twice
    samples = np.concatenate([signals[:1], 0 * signals[:1], signals[1:]])[:, np.newaxis]
    given = rt.io.sofa.Responses(
        pairs=tuple(pairs),
        samples=samples,
        sampling_rate=RATE,
        sources=dict(SCENE.sources),
        receivers=dict(SCENE.receivers),
        convention="SingleRoomSRIR",
    )
    room = ROOM.replace(scene=SCENE)
    by_file = rt.calibrate_modes(room, given, times(TRUTH))
    by_hand = rt.calibrate_modes(room, find_modes(signals, RATE, PAIRS), times(TRUTH))
    np.testing.assert_array_equal(by_file.alpha, by_hand.alpha)


def test_command_takes_a_sofa_file(tmp_path):
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
    files = [str(tmp_path / name) for name in ("room.toml", "t.csv")]
    told = CliRunner().invoke(cli, ["calibrate", *files, "--modes", str(path)])
    assert told.exception is None, told.exception
    assert "tells most of" in told.stdout
    assert "ESPRIT" in told.stdout
