"""Impulse responses to parameters: exact decays, noise, range, filters, files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from rtcal.io import impulse_responses as ir
from rtcal.io.wav import clipped_samples
from rtcal.support.errors import DataError
from tests.fuzz import wav

pyfar = pytest.importorskip("pyfar")
pytest.importorskip("pyrato")

RATE = 44100


class NotFinite:
    """A signal that pyfar would refuse to make."""

    sampling_rate = 8000.0

    def __init__(self, samples: np.ndarray) -> None:
        self.time = samples[np.newaxis]


def decay(t: float, rate: int = RATE, length: float = 3.0) -> np.ndarray:
    """Energy of an exact exponential decay that falls 60 dB in t."""
    return np.exp(-6 * np.log(10) / t * np.arange(int(length * t * rate)) / rate)


@pytest.mark.parametrize("t", [0.3, 1.0, 2.5])
def test_exact_decays(t: float) -> None:
    found, inr, missing = ir.of_energy(decay(t), RATE)
    for parameter in ("edt", "t20", "t30"):
        assert found[parameter] == pytest.approx(t, rel=1e-6)
    ratio = 10 ** (6 * 0.05 / t) - 1  # energy before over energy after 50 ms
    assert found["c50"] == pytest.approx(10 * np.log10(ratio), abs=2e-3)
    assert found["d50"] == pytest.approx(ratio / (1 + ratio), rel=1e-3)
    assert found["ts"] == pytest.approx(t / (6 * np.log(10)), rel=1e-3)
    assert inr > 100
    assert missing == ()


@pytest.mark.parametrize("t", [0.5, 1.0, 2.0])
def test_noise_floors(t: float) -> None:
    e = decay(t)
    found, inr, missing = ir.of_energy(e + 1e-5, RATE)
    assert found["t30"] == pytest.approx(t, rel=0.01)
    assert found["t20"] == pytest.approx(t, rel=0.01)
    assert inr == pytest.approx(50, abs=0.1)
    assert missing == ()
    found, inr, missing = ir.of_energy(e + 1e-4, RATE)
    assert found["t20"] == pytest.approx(t, rel=0.01)
    assert "t30" not in found
    assert inr == pytest.approx(40, abs=0.1)
    assert missing == ("T30 needs 45 dB between sound and noise (ISO 3382); there are 40.0 dB",)
    lowered, _, _ = ir.of_energy(e + 1e-4, RATE, minimum_range={"t30": 38})
    assert lowered["t30"] == pytest.approx(t, rel=0.01)
    found, inr, missing = ir.of_energy(e + 10**-2.5, RATE)
    assert "t20" not in found
    assert "t30" not in found
    assert inr == pytest.approx(25, abs=0.1)
    assert len(missing) == 2


def test_nothing_above_the_noise() -> None:
    rng = np.random.default_rng(0)
    found, _, missing = ir.of_energy(rng.standard_normal(RATE) ** 2, RATE)
    assert found == {}
    assert len(missing) == 1
    assert ir.of_energy(np.zeros(RATE), RATE)[2][0].startswith("no decay: the response is silent")


def response(t: float, rng: np.random.Generator, rate: int = 16000) -> np.ndarray:
    e = decay(t, rate)
    noise = 1e-4 * rng.standard_normal(len(e) + 800)
    noise[800:] += np.sqrt(e) * rng.choice([-1.0, 1.0], len(e))
    return noise


def test_bands_of_noise_like_responses() -> None:
    rng = np.random.default_rng(3)
    t = 0.8
    signals = {("S1", f"R{i}"): pyfar.Signal(response(t, rng), 16000) for i in range(10)}
    analysis = ir.analyse(signals, bands=[500, 1000, 2000])
    mean = analysis.measurement.mean("t20")
    f = analysis.measurement.centre_frequencies
    # One response scatters by 0.88 / sqrt(B T); four standard deviations of the mean of ten.
    limit = 4 * 0.88 / np.sqrt(0.71 * f * t) / np.sqrt(10)
    assert (np.abs(mean / t - 1) < limit).all()
    assert analysis.notes == ()
    assert np.isfinite(analysis.measurement.values["c80"]).all()
    row = next(line for line in str(analysis).splitlines() if line.startswith("T20 / s"))
    assert [float(cell) for cell in row.split()[3:]] == np.round(mean, 3).tolist()


def test_a_renamed_copy_of_a_recording_is_told() -> None:
    rng = np.random.default_rng(5)
    one, other = (pyfar.Signal(response(0.8, rng), 16000) for _ in range(2))
    named = {("S1", "R1"): one, ("S1", "R2"): other, ("S1", "R3"): one}
    (note,) = ir.analyse(named, bands=[500, 1000]).notes
    assert "S1 to R3 and S1 to R1. If one is a copy" in note


def test_the_backward_filter_keeps_a_short_decay() -> None:
    # The energy that a filter's response h makes of white noise with a decay e, exactly: the decay
    # of conv(h², e) forwards, of the correlation backwards.
    t, rate, n = 0.1, 16000, 16000
    e = np.concatenate([decay(t, rate), np.zeros(n)])[:n]
    pulse = np.zeros(n)
    pulse[0] = 1
    h2 = ir._filtered(pulse[::-1], rate, 125.0, 1)[::-1]
    size = 2 * n
    spectrum = np.fft.rfft(h2, size)
    forward = np.fft.irfft(spectrum * np.fft.rfft(e, size), size)[:n]
    backward = np.fft.irfft(spectrum.conj() * np.fft.rfft(e, size), size)[:n]
    forwards = ir.of_energy(np.maximum(forward, 0)[int(np.argmax(forward)) :], rate)[0]["t20"]
    backwards = ir.of_energy(np.maximum(backward, 1e-16), rate)[0]["t20"]
    assert abs(backwards / t - 1) < 0.02  # B T = 8.9
    assert forwards / t - 1 > 0.05


@pytest.mark.parametrize("silence", [0.25, 0.5, 2.0])
@pytest.mark.parametrize("offset", [0.0, 0.01])
def test_digital_silence_at_the_end_is_left_out(silence: float, offset: float) -> None:
    """Half a second of zeros had taken the decay of every band with it."""
    rng = np.random.default_rng(8)
    signal = response(0.8, rng)[: int(0.9 * 16000)]
    signal = np.round(signal * 2**23) / 2**23
    padded = np.concatenate([signal, np.zeros(int(silence * 16000))]) + offset
    plain = ir.analyse(pyfar.Signal(signal + offset, 16000), bands=[500, 1000])
    analysis = ir.analyse(pyfar.Signal(padded, 16000), bands=[500, 1000])
    t20 = analysis.measurement.values["t20"]
    assert t20 == pytest.approx(plain.measurement.values["t20"], rel=1e-3)
    assert t20 == pytest.approx(0.8, rel=0.25)
    assert [n for n in analysis.notes if "silence" in n] == [
        f"S1 to R1: the last {silence:.2f} s are digital silence, left out"
    ]


def double_slope(rng: np.random.Generator, rate: int = 16000) -> np.ndarray:
    """Noise whose energy falls with T = 0.4 s at first, and with 1.6 s from -15 dB on."""
    early, late = decay(0.4, rate, 8.0), decay(1.6, rate, 2.0)
    energy = early[: len(late)] + 0.02 * late[: len(early)]
    return np.sqrt(energy) * rng.standard_normal(len(energy))


def test_a_double_slope_is_flagged() -> None:
    rng = np.random.default_rng(9)
    bent = {("S1", f"R{i}"): pyfar.Signal(double_slope(rng), 16000) for i in range(4)}
    analysis = ir.analyse(bent, bands=[500, 1000, 2000])
    for band in ("500 Hz", "1000 Hz", "2000 Hz"):
        assert any(n.startswith(f"{band}: the decay is bent, curvature") for n in analysis.notes)
    straight = {("S1", f"R{i}"): pyfar.Signal(response(0.8, rng), 16000) for i in range(4)}
    assert not ir.analyse(straight, bands=[500, 1000, 2000]).notes


def test_a_recorded_sweep_is_no_decay() -> None:
    """T20 of a recording of the excitation was 0.27 s, and the notes said that the decay is bent."""
    time = np.arange(2 * 16000) / 16000
    sweep = np.sin(2 * np.pi * 100 * 2 / np.log(70) * (70 ** (time / 2) - 1))
    rng = np.random.default_rng(10)
    recorded = np.convolve(sweep, response(0.8, rng))[: 4 * 16000]
    signals = {("S1", "R1"): response(0.8, rng), ("S1", "R2"): recorded}
    analysis = ir.analyse(
        {pair: pyfar.Signal(samples, 16000) for pair, samples in signals.items()},
        bands=[250, 500, 1000, 2000],
    )
    (note,) = [n for n in analysis.notes if n.startswith("no decay")]
    assert note.startswith("no decay: impulse response S1/R2. The energy arrives late")


def test_a_clipped_response_is_noted(tmp_path: Path) -> None:
    """EDT of a response five times too loud was 20 % too long, without a word."""
    samples = response(0.8, np.random.default_rng(10))
    samples /= np.abs(samples).max()
    for name, content in (("S1_R1", samples), ("S1_R2", np.clip(5 * samples, -1, 1))):
        (tmp_path / f"{name}.wav").write_bytes(wav(content, 16000))
    analysis = ir.read(sorted(tmp_path.iterdir()), bands=[1000])
    (note,) = [n for n in analysis.notes if "clipped" in n]
    n_clipped = int((np.abs(5 * samples) >= 1 - 0.5 / 32767).sum())
    assert note.startswith(
        f"clipped: {tmp_path / 'S1_R2.wav'} ({n_clipped} samples). Their largest"
    )
    assert np.isfinite(analysis.measurement.values["edt"]).all()


def test_a_file_without_a_decay_is_named(tmp_path: Path) -> None:
    """The text named the pair alone, band by band."""
    rng = np.random.default_rng(10)
    for name, content in (
        ("S1_R1", response(0.8, rng)),
        ("S1_R2", 0.1 * rng.standard_normal(32000)),
    ):
        (tmp_path / f"{name}.wav").write_bytes(wav(content / np.abs(content).max(), 16000))
    analysis = ir.read(sorted(tmp_path.iterdir()), bands=[500, 1000, 2000])
    (note,) = [n for n in analysis.notes if "no decay" in n]
    assert f"{tmp_path / 'S1_R2.wav'} (3 of 3 bands). Look whether" in note
    assert "S1_R1" not in note


def test_a_step_after_silence_is_no_silence_at_the_end(tmp_path: Path) -> None:
    """Found by fuzzing: what was left without its end was 0 everywhere, and no number times 0."""
    path = tmp_path / "step.wav"
    path.write_bytes(wav(np.concatenate([np.zeros(4000), np.full(4000, 0.5)])))
    measured = ir.read(str(path), bands=[1000]).measurement
    assert all(np.isnan(values).all() for values in measured.values.values())


def test_decays_are_not_taken_for_clipped() -> None:
    rng = np.random.default_rng(11)
    time = np.arange(16000) / 16000
    for bits in (10, 16, 24):
        low = np.exp(-7 * time) * np.sin(2 * np.pi * 30 * time)  # a top of many equal samples
        for samples in (low, response(0.8, rng)):
            rounded = np.round(samples / np.abs(samples).max() * 2**bits) / 2**bits
            assert clipped_samples(rounded) == 0
            assert clipped_samples(np.clip(rounded, -0.5, 0.5)) > 3


def test_short_decays_are_noted() -> None:
    rng = np.random.default_rng(5)
    analysis = ir.analyse(pyfar.Signal(response(0.04, rng)[:4000], 16000), bands=[63, 125, 1000])
    assert any("125 Hz: B T = " in note and "below 4" in note for note in analysis.notes)
    assert not any("1000 Hz" in note for note in analysis.notes)


def test_files(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    for name in ("room_LS1_MP2", "room_LS1_MP3", "other"):
        samples = response(0.5, rng)
        (tmp_path / f"{name}.wav").write_bytes(wav(0.5 * samples / np.abs(samples).max(), 16000))
    paths = sorted(tmp_path.iterdir())
    analysis = ir.read(paths, bands=[1000, 2000])
    assert analysis.measurement.pairs == (("S1", "other"), ("LS1", "MP2"), ("LS1", "MP3"))
    assert analysis.measurement.mean("t20") == pytest.approx(0.5, rel=0.15)
    with pytest.raises(DataError, match="source LS1, receiver MP2 is given twice"):
        ir.read([paths[1], paths[1]])


def test_channels_are_no_receivers_unless_stated(tmp_path: Path) -> None:
    pressure = response(0.5, np.random.default_rng(7))
    both = np.stack([pressure, 0.3 * pressure[::-1]], axis=1) / np.abs(pressure).max()
    mono = wav(0.9 * both.ravel(), 16000)
    path = tmp_path / "S1_R1.wav"
    path.write_bytes(mono[:22] + struct.pack("<HIIH", 2, 16000, 64000, 4) + mono[34:])
    with pytest.raises(DataError, match=r"S1_R1.wav: 2 channels; state which one"):
        ir.read(path, bands=[1000])
    first = ir.read(path, bands=[1000], channels=1)
    assert first.measurement.pairs == (("S1", "R1"),)
    assert first.measurement.mean("t20") == pytest.approx(0.5, rel=0.25)
    with pytest.raises(DataError, match="2 channels; there is no channel 3"):
        ir.read(path, bands=[1000], channels=3)
    with pytest.raises(DataError, match='channels = "left" is neither'):
        ir.read(path, bands=[1000], channels="left")
    pairs = ir.read(path, bands=[1000], channels="receivers").measurement.pairs
    assert pairs == (("S1", "R1-1"), ("S1", "R1-2"))


def test_a_file_that_cannot_be_used_is_named_first(tmp_path: Path) -> None:
    """A NaN was "cannot be read as WAV", and a silent file "silent, or a sample is not finite"."""
    good = wav(np.exp(-np.arange(8000) / 800))
    for name, content in (("a", good), ("b", wav(np.zeros(99))), ("c", wav(np.zeros(9)))):
        (tmp_path / f"{name}.wav").write_bytes(content)
    done: list[None] = []
    with pytest.raises(DataError, match=r"b\.wav, .*c\.wav: silent, .* leave them out$"):
        ir.read(sorted(tmp_path.iterdir()), progress=lambda: done.append(None))
    assert not done
    samples = np.exp(-np.arange(8000) / 800).astype("f4")
    for value, rule in ((np.nan, "nan"), (np.inf, "inf")):
        samples[41] = value
        wavfile.write(tmp_path / "n.wav", 8000, samples)
        with pytest.raises(
            DataError, match=rf"n\.wav: sample 42 of 8000 is {rule}, not a finite number$"
        ):
            ir.read(tmp_path / "n.wav")
        with pytest.raises(
            DataError, match=f"^impulse response S1/R1: sample 42 of 8000 is {rule}"
        ):
            ir.analyse(NotFinite(samples))


def test_bad_input(tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    good = wav(np.exp(-np.arange(8000) / 800))
    for content, rule in (
        (b"", "byte 0: not a WAV file"),
        (good[:100], "byte 36: chunk 'data' is longer than the file"),
        (good[:36], "no samples"),
        (
            good.replace(struct.pack("<HH", 1, 1), struct.pack("<HH", 2, 1), 1),
            "format 2 of 16 bits",
        ),
        (good[:34] + struct.pack("<H", 8) + good[36:], "format 1 of 8 bits"),
        (good[:22] + struct.pack("<H", 0) + good[24:], "0 channels"),
        (wav(np.zeros(8000)), r"a\.wav: silent, every sample is 0; leave it out"),
        (wav(np.ones(900_001)), "900001 samples in 1 channels; at most 900000"),
    ):
        path.write_bytes(content)
        with pytest.raises(DataError, match=rule):
            ir.read(path)
    path.write_bytes(good)
    for arguments, rule in (
        ({"bands": "half"}, 'bands = "half"'),
        ({"bands": [8000]}, "8000 Hz; it is no octave below half"),
        ({"bands": [440]}, "440 Hz; it is no octave"),
        ({"minimum_range": {"t99": 3.0}}, r"minimum_range\[t99\]"),
    ):
        with pytest.raises(DataError, match=rule):
            ir.read(path, **arguments)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="no such file"):
        ir.read(tmp_path / "none.wav")
    with pytest.raises(DataError, match="no file of an impulse response"):
        ir.read([])
