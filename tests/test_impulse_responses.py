"""Impulse responses to parameters: exact decays, noise, range, filters, files."""

import struct

import numpy as np
import pytest

from rtcal.io import impulse_responses as ir
from rtcal.io.impulse_responses import Floor, clipped_samples
from rtcal.support.errors import DataError
from tests.conftest import also
from tests.fuzz import wav

pyfar = pytest.importorskip("pyfar")
pytest.importorskip("pyrato")
soundfile = pytest.importorskip("soundfile")

RATE = 44100


def decay(t, rate=RATE, length=3.0):
    """Energy of an exact exponential decay that falls 60 dB in t."""
    return np.exp(-6 * np.log(10) / t * np.arange(int(length * t * rate)) / rate)


@pytest.mark.parametrize("t", [0.5, *also(1.0, 2.0)])
def test_noise_floors(t):
    e = decay(t)
    found, inr, *_ = ir.of_energy(e + 1e-5, RATE)
    assert found["t30"] == pytest.approx(t, rel=0.01)
    assert found["t20"] == pytest.approx(t, rel=0.01)
    assert inr == pytest.approx(50, abs=0.1)
    assert {*found} == {*ir.MINIMUM_RANGE}
    found, inr, floor, _ = ir.of_energy(e + 1e-4, RATE)
    assert found["t20"] == pytest.approx(t, rel=0.01)
    assert {*ir.MINIMUM_RANGE} - {*found} == {"t30"}
    assert inr == pytest.approx(40, abs=0.1)
    assert floor is Floor.NOISE
    lowered, *_ = ir.of_energy(e + 1e-4, RATE, {**ir.MINIMUM_RANGE, "t30": 38})
    assert lowered["t30"] == pytest.approx(t, rel=0.01)
    found, inr, *_ = ir.of_energy(e + 10**-2.5, RATE)
    assert {*ir.MINIMUM_RANGE} - {*found} == {"t20", "t30"}
    assert inr == pytest.approx(25, abs=0.1)


def test_nothing_above_the_noise():
    rng = np.random.default_rng(0)
    found, _, floor, _ = ir.of_energy(rng.standard_normal(RATE) ** 2, RATE)
    assert (found, floor) == ({}, Floor.FLAT)
    assert ir.of_energy(np.zeros(RATE), RATE)[2] is Floor.SHORT


def response(t, rng, rate=16000):
    e = decay(t, rate)
    noise = 1e-4 * rng.standard_normal(len(e) + 800)
    noise[800:] += np.sqrt(e) * rng.choice([-1.0, 1.0], len(e))
    return noise


def test_the_level_is_that_of_the_whole_energy(tmp_path):
    """A gain of 10 is 20 dB; another sampling rate and the peak of a file change nothing."""
    parts = [
        (1.0, response(0.8, np.random.default_rng(5))),
        (0.1, response(0.8, np.random.default_rng(5))),
        (0.3, response(0.4, np.random.default_rng(6))),
    ]
    for i, (gain, samples) in enumerate(parts):
        soundfile.write(tmp_path / f"S1-R{i}.wav", 0.2 * gain * samples, 16000, subtype="FLOAT")
    paths = sorted(tmp_path.glob("*.wav"))
    bands = [500.0, 1000.0]
    assert "level" not in ir.read(paths, bands=bands).measurement.values
    level = ir.read(paths, bands=bands, level=True).measurement.values["level"]
    np.testing.assert_allclose(level[0] - level[1], 20.0, atol=1e-4)
    # Half of T is half of the energy, but for the noise-like sequence.
    np.testing.assert_allclose(level[0] - level[2] + 20 * np.log10(0.3), 3.0, atol=1.5)
    # White noise of unit density: the band has its bandwidth over half the sampling rate.
    energy = 0.2**2 * decay(0.8, 16000).sum() / 16000
    share = ir.bandwidth_of(np.array(bands), 1) / 8000
    np.testing.assert_allclose(level[0], 10 * np.log10(energy * share), atol=1.0)


def test_levels_of_normalised_files_are_refused(tmp_path, rtcal):
    for i in range(2):
        samples = response(0.5 + i, np.random.default_rng(i))
        soundfile.write(tmp_path / f"S1-R{i}.wav", samples / np.abs(samples).max(), 16000)
    files = sorted(tmp_path.glob("*.wav"))
    assert "so they were normalised" in rtcal.refused("measure", *files, "--level")
    rtcal("measure", *files)


def test_silence_before_the_direct_sound_moves_nothing():
    direct = response(0.8, np.random.default_rng(5))[800:]
    direct[0] = 4.0  # the direct sound
    values = [
        ir.analyse({("S1", "R1"): pyfar.Signal(np.pad(direct, (n, 0)), 16000)}).measurement.values
        for n in (0, 16, 160, 16000)
    ]
    for others in values[1:]:
        for parameter, value in values[0].items():
            np.testing.assert_allclose(others[parameter], value, atol=1e-4)


def test_the_backward_filter_keeps_a_short_decay():
    # The energy that a filter's response h makes of white noise with a decay e, exactly: the decay
    # of conv(h², e) forwards, of the correlation backwards.
    t, rate, n = 0.1, 16000, 16000
    e = np.concatenate([decay(t, rate), np.zeros(n)])[:n]
    pulse = np.zeros(n)
    pulse[0] = 1
    h2 = ir.filtered(pulse[::-1], rate, 125.0, 1)[::-1]
    size = 2 * n
    spectrum = np.fft.rfft(h2, size)
    forward = np.fft.irfft(spectrum * np.fft.rfft(e, size), size)[:n]
    backward = np.fft.irfft(spectrum.conj() * np.fft.rfft(e, size), size)[:n]
    forwards = ir.of_energy(np.maximum(forward, 0)[int(np.argmax(forward)) :], rate)[0]["t20"]
    backwards = ir.of_energy(np.maximum(backward, 1e-16), rate)[0]["t20"]
    assert abs(backwards / t - 1) < 0.02  # B T = 8.9
    assert forwards / t - 1 > 0.05


def test_a_clipped_response_is_noted(tmp_path):
    samples = response(0.8, np.random.default_rng(10))
    samples /= np.abs(samples).max()
    for name, content in (("S1_R1", samples), ("S1_R2", np.clip(5 * samples, -1, 1))):
        (tmp_path / f"{name}.wav").write_bytes(wav(content, 16000))
    analysis = ir.read(sorted(tmp_path.iterdir()), bands=[1000])
    (note,) = [n for n in analysis.notes if "clipped" in n]
    n_clipped = int((np.abs(5 * samples) >= 1 - 0.5 / 32767).sum())
    assert note.startswith(f"clipped: {tmp_path / 'S1_R2.wav'} ({n_clipped} samples)")
    assert np.isfinite(analysis.measurement.values["edt"]).all()


OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0)


def straight(t, rate=16000, length=2.2):
    """Tones at the centres of `OCTAVES`, each of which falls 60 dB in t, over length times t."""
    time = np.arange(int(length * t * rate)) / rate
    phases = np.random.default_rng(3).uniform(0, 2 * np.pi, len(OCTAVES))
    tones = np.cos(2 * np.pi * np.outer(OCTAVES, time) + phases[:, np.newaxis])
    return tones.mean(axis=0) * 10 ** (-3 * time / t)


def damaged(how, h, t, rate=16000):
    """A response that falls 60 dB in t, with one thing done to it: "cut 40" cuts it 40 dB down."""
    kind, _, amount = how.partition(" ")
    n, rng = len(h), np.random.default_rng(1)
    at = int(float(amount or 0) / 60 * t * rate)
    if kind == "cut":
        return h[:at]
    if kind == "offset":
        return h + float(amount)
    if kind == "bits":
        return np.round(h * 2 ** (int(amount) - 1)) / 2 ** (int(amount) - 1)
    if kind == "noise":
        level = 10 ** (-float(amount) / 20) * np.sqrt(np.mean(h[: int(t * rate / 60)] ** 2))
        return np.concatenate([h, np.zeros(n)]) + level * rng.standard_normal(2 * n)
    g = h.copy()
    if kind == "sparse":
        rays = np.arange(n) % int(0.03 * rate) < int(0.003 * rate)
        g[at:] *= rays[at:] * np.sqrt(10)
    elif kind in ("zeros", "dither"):
        g[at:] = 0
        g[-1] = 1e-9
        if kind == "dither":
            g += rng.uniform(-1, 1, n) / 2**15
    return g


LEAST = {"t20": 35.0, "t30": 45.0, "edt": 20.0}


@pytest.mark.parametrize("t", [0.3, *also(1.0, 3.0)])
@pytest.mark.parametrize(
    "how",
    ["nothing", "offset 0.001", "offset 0.1", "sparse 60", "sparse 80", "bits 12", "bits 24"]
    + [f"{kind} {down}" for kind in ("cut", "zeros", "dither") for down in (15, 33, 52)]
    + also(*(f"{kind} {down}" for kind in ("cut", "zeros", "dither") for down in (28, 40, 66))),
)
def test_a_straight_decay_has_its_own_t_or_the_true_reason(how, t):
    signal = damaged(how, straight(t), t)
    analysis = ir.analyse(pyfar.Signal(signal, 16000), bands=OCTAVES)
    down = float(how.split()[1]) if how.startswith(("cut", "zeros", "dither")) else 100.0
    for parameter, needed in LEAST.items():
        values = analysis.measurement.values[parameter][0]
        if down > needed + 4:
            assert values == pytest.approx(t, rel=0.01)
        elif down < needed:
            assert np.isnan(values).all()
    assert bool(analysis.missing) == (down < 45)
    lacking = [k for k in range(len(OCTAVES)) if down < 45]
    assert not any(analysis.floors[0][k] is Floor.NOISE for k in lacking)


@pytest.mark.parametrize("down", [42, *also(55, 70)])
def test_noise_takes_what_it_covers_and_is_the_reason(down):
    analysis = ir.analyse(pyfar.Signal(damaged(f"noise {down}", straight(1.0), 1.0), 16000))
    centres = analysis.measurement.centre_frequencies
    ratios = analysis.impulse_to_noise_ratio[0]
    assert (ratios[np.isin(centres, OCTAVES)] > down).all()  # a tone against a band of noise
    for parameter in ("t20", "t30", "edt"):
        values = analysis.measurement.values[parameter][0, np.isin(centres, OCTAVES)]
        assert values[np.isfinite(values)] == pytest.approx(1.0, rel=0.03)
    for k in range(len(centres)):
        if any(np.isnan(v[0, k]) for v in analysis.measurement.values.values()):
            assert analysis.floors[0][k] in (Floor.NOISE, Floor.END, Floor.FLAT)


@pytest.mark.parametrize("below", [10, 15, 22])
@pytest.mark.parametrize("down", [26, 30, 33])
def test_a_cut_decay_is_none_where_noise_follows(down, below):
    rate, t = 8000, 1.0
    time = np.arange(int((down / 60 * t + 0.8) * rate)) / rate
    energy = np.where(time < down / 60 * t, 10 ** (-6 * time / t), 0.0)
    energy = energy + 10 ** (-(down + below) / 10)
    energy = energy * np.random.default_rng(down + below).standard_normal(len(time)) ** 2
    values, _, floor, _ = ir.of_energy(energy, rate)
    assert not {"t20", "t30"} & set(values)
    assert floor in (Floor.CUT, Floor.END, Floor.FLAT)  # each names the cut


CONTAINERS = "WAV FLAC AIFF W64 RF64 CAF"


@pytest.mark.parametrize(
    ("rate", "coding"), [(8000, "PCM_16"), *also((44100, "PCM_24"), (96000, "PCM_24"))]
)
def test_a_response_is_the_same_in_any_container(tmp_path, rate, coding):
    whole = np.round(0.9 * straight(0.5, rate) * 2 ** (int(coding[-2:]) - 1)).astype(np.int32)
    whole <<= 32 - int(coding[-2:])
    analyses = {}
    for container in CONTAINERS.split():
        path = tmp_path / container / f"S1-R1.{container.lower()}"
        path.parent.mkdir()
        soundfile.write(path, whole, rate, subtype=coding, format=container)
        analyses[container] = ir.read(path, bands=OCTAVES)
    for analysis in analyses.values():
        assert analysis.measurement.pairs == (("S1", "R1"),)
        assert analysis.measurement.values["t20"] == pytest.approx(0.5, rel=0.01)
        for parameter, values in analysis.measurement.values.items():
            np.testing.assert_array_equal(values, analyses["WAV"].measurement.values[parameter])


def test_a_file_that_lost_its_end_or_its_quiet_sound_is_in_doubt(tmp_path):
    path = tmp_path / "S1-R1.wav"
    content = wav(0.9 * straight(0.5, 8000), 8000)
    path.write_bytes(content[: len(content) // 2])
    (note,) = [n for n in ir.read(path, bands=[1000]).notes if "header" in n]
    assert note.startswith(f"{path}: ")
    flac = tmp_path / "S1-R2.flac"
    soundfile.write(flac, 0.9 * straight(0.5, 8000), 8000)
    flac.write_bytes(flac.read_bytes()[: flac.stat().st_size // 2])
    with pytest.raises(DataError, match=r"S1-R2\.flac: this file cannot be read as sound"):
        ir.read(flac, bands=[1000])
    lossy = tmp_path / "S1-R3.ogg"
    soundfile.write(lossy, 0.9 * straight(0.5, 8000), 8000, format="OGG", subtype="VORBIS")
    (note,) = [n for n in ir.read(lossy, bands=[1000]).notes if "lossy" in n]
    assert note.startswith(f"{lossy}: its coding, Vorbis, is lossy")


def no_impulse_response(kind, t, rng):
    """A recording in a room with T = t, 16 kHz, that is no impulse response."""
    rate = 16000
    h = rng.standard_normal(int(1.5 * t * rate)) * np.sqrt(decay(t, rate, 1.5))
    if kind == "sweep":
        time = np.arange(2 * rate) / rate
        return np.convolve(np.sin(2 * np.pi * 60 * 2 / np.log(100) * (100 ** (time / 2) - 1)), h)
    if kind == "maximum-length sequence":
        return np.convolve(rng.choice([-1.0, 1.0], 2 * rate), h)
    if kind == "two sounds":
        return np.concatenate([h, h])
    if kind in ("two stops", "two bursts"):
        long, short = (3.0, 1.0) if kind == "two stops" else (0.05, 0.05)
        parts = [no_impulse_response(on, t, rng) for on in (long, short)]
        return np.concatenate([parts[0], np.zeros(rate // 2), parts[1]])
    on = kind if isinstance(kind, float) else 0.5 * t
    if kind == "interrupted noise":
        on = 1.5 * max(t, 1.0)
    time = np.arange(int((on + 1.5 * t) * rate)) / rate
    level = np.where(time > on, 10 ** (-3 * (time - on) / t), 1.0)
    return rng.standard_normal(len(time)) * level


@pytest.mark.parametrize(("noise", "t"), [(60, 0.4), *also((30, 0.4), (30, 1.2), (60, 1.2))])
@pytest.mark.parametrize(
    "kind",
    [
        "sweep",
        "maximum-length sequence",
        "two sounds",
        "two stops",
        "two bursts",
        "interrupted noise",
        "a burst",
    ],
)
def test_what_is_no_impulse_response_is_not_evaluated(kind, noise, t):
    rng = np.random.default_rng(25)
    recorded = no_impulse_response(kind, t, rng)
    recorded /= np.abs(recorded).max()
    recorded += 10 ** (-noise / 20) / 4 * rng.standard_normal(len(recorded))
    analysis = ir.analyse(pyfar.Signal(recorded, 16000), bands=OCTAVES)
    for values in analysis.measurement.values.values():
        assert np.isnan(values).all()
    if noise > 30:  # else there may be too little range to see what it is
        (note,) = analysis.notes
        late = note.startswith("no decay") and "interrupted noise" in note
        # The pause between two stops may leave no range at all.
        assert late or (kind == "two stops" and note.startswith("hardly a decay"))
        assert not late or {*analysis.floors[0]} == {Floor.LATE}
    assert len(analysis.notes) == 1


@pytest.mark.parametrize("t", [0.3, 1.2])
@pytest.mark.parametrize("kind", ["direct sound", "late reflection", "slow rise", "nothing"])
def test_an_unusual_impulse_response_is_evaluated(kind, t):
    rng = np.random.default_rng(26)
    h = rng.standard_normal(24000) * np.sqrt(np.pad(decay(t, 16000), (0, 24000))[:24000])
    if kind == "direct sound":
        h[0] = 4 * np.sqrt((h**2).sum())
    elif kind == "late reflection":
        h[800] += np.sqrt((h**2).sum())
    elif kind == "slow rise":
        h *= np.sqrt(1 - np.exp(-np.arange(24000) / 160))
    analysis = ir.analyse(pyfar.Signal(h, 16000), bands=OCTAVES)
    assert np.isfinite(analysis.measurement.values["t20"]).all()
    assert not any(n.startswith("no decay") for n in analysis.notes)


def test_decays_are_not_taken_for_clipped():
    rng = np.random.default_rng(11)
    time = np.arange(16000) / 16000
    for bits in (10, 16, 24):
        low = np.exp(-7 * time) * np.sin(2 * np.pi * 30 * time)  # a top of many equal samples
        for samples in (low, response(0.8, rng)):
            rounded = np.round(samples / np.abs(samples).max() * 2**bits) / 2**bits
            assert clipped_samples(rounded) == 0
            assert clipped_samples(np.clip(rounded, -0.5, 0.5)) > 3


def test_files(tmp_path):
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


def test_repeats_are_averaged_or_refused(tmp_path, rtcal):
    rng = np.random.default_rng(27)
    sweeps = [0.5 * h / np.abs(h).max() for h in (response(0.5, rng) for _ in range(3))]
    for name, h in zip(("S1-R1", "S1-R1#2", "S1-R2"), sweeps, strict=True):
        (tmp_path / f"{name}.wav").write_bytes(wav(h, 16000))
    files = sorted(tmp_path.iterdir())
    named = ir.read(files, bands=[1000], repeats=True).measurement
    assert len(named.pairs) == 2
    (tmp_path / "take2").mkdir()
    (tmp_path / "take2" / "S1-R1.wav").write_bytes(wav(sweeps[1], 16000))
    both = [tmp_path / "S1-R1.wav", tmp_path / "take2" / "S1-R1.wav"]
    assert len(ir.read(both, bands=[1000], repeats=True).measurement.pairs) == 1
    apart = [tmp_path / "S1-R1.wav", tmp_path / "S1-R2.wav"]
    assert "--repeats has no effect" in rtcal.refused("measure", *apart, "--repeats")


def test_channels_are_no_receivers_unless_stated(tmp_path):
    pressure = response(0.5, np.random.default_rng(7))
    both = np.stack([pressure, 0.3 * pressure[::-1]], axis=1) / np.abs(pressure).max()
    mono = wav(0.9 * both.ravel(), 16000)
    path = tmp_path / "S1_R1.wav"
    path.write_bytes(mono[:22] + struct.pack("<HIIH", 2, 16000, 64000, 4) + mono[34:])
    for options, said in (
        ({}, r"S1_R1.wav: the file has 2 channels. Choose one"),
        ({"channels": 3}, "channel 3 does not exist"),
        ({"channels": "left"}, 'channels = "left" must be a number'),
    ):
        with pytest.raises(DataError, match=said):
            ir.read(path, bands=[1000], **options)
    first = ir.read(path, bands=[1000], channels=1)
    assert first.measurement.pairs == (("S1", "R1"),)
    assert first.measurement.mean("t20") == pytest.approx(0.5, rel=0.25)
    pairs = ir.read(path, bands=[1000], channels="receivers").measurement.pairs
    assert pairs == (("S1", "R1-1"), ("S1", "R1-2"))


@pytest.mark.parametrize(
    ("damage", "place"),
    [
        (lambda good: b"", "a.wav"),
        (lambda good: good[:36], "a.wav"),
        (lambda good: good[:22] + struct.pack("<H", 0) + good[24:], "a.wav"),
        (lambda good: good[:24] + struct.pack("<I", 500) + good[28:], "500 Hz"),
        (lambda good: wav(np.zeros(8000)), "silent"),
        (lambda good: wav(np.ones(2**22 + 1)), "4194305 samples"),
    ],
)
def test_bad_files(tmp_path, damage, place):
    path = tmp_path / "a.wav"
    path.write_bytes(damage(wav(np.exp(-np.arange(8000) / 800))))
    with pytest.raises(DataError, match=place):
        ir.read(path)


@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        ({"bands": "half"}, "bands"),
        ({"bands": [8000]}, "8000 Hz"),
        ({"bands": [440]}, "440 Hz"),
        ({"minimum_range": {"t99": 3.0}}, "t99"),
    ],
)
def test_bad_arguments(tmp_path, arguments, place):
    path = tmp_path / "a.wav"
    path.write_bytes(wav(np.exp(-np.arange(8000) / 800)))
    with pytest.raises(DataError, match=place):
        ir.read(path, **arguments)
