"""Recorded sweeps and interrupted noise: known decays come back, and what is neither is refused."""

import numpy as np
import pytest

from rtcal.io import impulse_responses as ir
from rtcal.io import recordings
from rtcal.support.errors import DataError
from tests.conftest import also

pytest.importorskip("pyfar")
pytest.importorskip("pyrato")
soundfile = pytest.importorskip("soundfile")

BANDS = [250, 500, 1000, 2000]


def sweep(rate, seconds=3.0, low=60.0):
    """An exponential sweep up to 0.45 of the rate, faded in and out."""
    time, ratio = np.arange(int(seconds * rate)) / rate, np.log(0.45 * rate / low)
    fade = np.minimum(1, np.minimum(time, time[::-1]) * 50)
    return 0.5 * fade * np.sin(2 * np.pi * low * seconds / ratio * np.exp(time / seconds * ratio))


def response(t, rate, rng, late=0.0):
    """A direct sound and noise that decays by 60 dB in t; ``late``, of that energy, in 4 t."""
    time = np.arange(int(1.3 * (t if not late else 4 * t) * rate)) / rate
    energy = 10 ** (-6 * time / t) + late * 10 ** (-6 * time / (4 * t))
    return np.concatenate([[10.0], rng.standard_normal(len(time)) * np.sqrt(energy)])


def recorded(played, h, rate, lead=0.2):
    n = len(played) + len(h)
    sound = np.fft.irfft(np.fft.rfft(played, 2 * n) * np.fft.rfft(h, 2 * n), 2 * n)[:n]
    sound = np.concatenate([np.zeros(int(lead * rate)), sound])
    rng = np.random.default_rng(99)
    return 0.7 * sound / np.abs(sound).max() + 1e-5 * rng.standard_normal(len(sound))


def written(path, samples, rate):
    soundfile.write(path, samples, rate, subtype="PCM_24")
    return path


@pytest.mark.parametrize(
    ("rate", "t"), [(16000, 0.5), *also((44100, 1.2), (48000, 0.4), (8000, 3))]
)
def test_a_recorded_sweep_gives_the_parameters_of_the_response(tmp_path, rate, t):
    played, h = sweep(rate), response(t, rate, np.random.default_rng(1))
    files = [
        written(tmp_path / name, samples, rate)
        for name, samples in {
            "played.wav": np.concatenate([played, np.zeros(rate)]),
            "S1-R1.wav": recorded(played, h, rate),
            "S1-R2.wav": np.concatenate([np.zeros(rate // 5), 0.2 * h / np.abs(h).max()]),
        }.items()
    ]
    found = recordings.from_sweep(files[1], files[0], bands=BANDS[:3]).measurement.values
    direct = ir.read(files[2], bands=BANDS[:3]).measurement.values
    for parameter in ("t20", "t30", "edt"):
        assert found[parameter] == pytest.approx(direct[parameter], rel=0.01)
    assert found["c80"] == pytest.approx(direct["c80"], abs=0.15)
    scatter = 4 * 0.88 / np.sqrt(0.71 * np.array(BANDS[:3]) * t)
    assert (np.abs(found["t20"][0] / t - 1) < scatter).all()


def test_bands_are_those_that_the_sweep_excites(tmp_path):
    rate, played = 16000, sweep(16000, low=300)
    of = recorded(played, response(0.5, rate, np.random.default_rng(3)), rate)
    files = written(tmp_path / "r.wav", of, rate), written(tmp_path / "s.wav", played, rate)
    found = recordings.from_sweep(*files).measurement
    assert found.centre_frequencies.tolist() == [500, 1000, 2000, 4000]
    with pytest.raises(DataError, match=r"s\.wav: the sweep does not excite the whole band at 250"):
        recordings.from_sweep(*files, bands=[250, 500])


def image_sources(rate, rng):
    """A box of image sources to 0.3 s, of walls that absorb more at high frequencies, and noise."""
    size = rng.uniform([3, 3, 2.4], [20, 15, 7])
    source, receiver = rng.uniform(0.15, 0.85, (2, 3)) * size
    kept = np.sqrt(1 - rng.uniform(0.05, 0.4, (2, 3)))
    orders = np.stack(np.meshgrid(*[np.arange(-20, 21)] * 3, indexing="ij"), -1).reshape(-1, 1, 3)
    sides = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), -1).reshape(1, -1, 3)
    away = np.linalg.norm((1 - 2 * sides) * source + 2 * orders * size - receiver, axis=-1)
    gain = np.prod(kept[0] ** np.abs(orders - sides) * kept[1] ** np.abs(orders), axis=-1)
    near = away < 0.3 * 343
    h = np.bincount((away[near] / 343 * rate).astype(int), (gain / away)[near], int(0.6 * rate))
    # Above 1 kHz a screen takes 12 dB of the direct sound.
    first = int(away.min() / 343 * rate)
    low = np.exp(-2 * np.pi * 1000 / rate * np.arange(200)) * 2 * np.pi * 1000 / rate
    h[first : first + 200] += 0.75 * h[first] * (low - np.eye(200)[0])
    return h + 1e-4 * h.max() * rng.standard_normal(len(h))


@pytest.mark.parametrize(
    ("rooms", "rate", "noise"), [(3, 16000, 1e-4), *also((20, 44100, 1e-2), (20, 16000, 3e-2))]
)
def test_a_sweep_of_another_length_or_rate_is_refused_and_the_right_one_taken(rooms, rate, noise):
    rng = np.random.default_rng(15)
    for _ in range(rooms):
        seconds = rng.uniform(1.5, 4)
        played = sweep(rate, seconds)
        of = recorded(played, image_sources(rate, rng), rate, rng.uniform(0.1, 1))
        of += noise * np.abs(of).max() * rng.standard_normal(len(of))
        of *= rng.uniform(0.05, 1)
        given = [played, *(sweep(rate, seconds * f) for f in (0.92, 1.08))]
        # Read at another rate: 8 % shorter, and all frequencies 8 % higher.
        given.append(np.interp(np.arange(0, len(played) - 1, 1.08), np.arange(len(played)), played))
        for i, each in enumerate(given):
            _, ends = recordings._excited(each, rate, np.array(BANDS), 1)
            if not i:
                recordings.impulse_response(of, each, rate, ends, "r")
                continue
            with pytest.raises(DataError, match=r"later in one band than in another|is not found"):
                recordings.impulse_response(of, each, rate, ends, "r")


def test_noise_above_the_sweep_is_not_inverted():
    """48 kHz and a sweep to 21.6 kHz: noise above it hid the response of every third recording."""
    rate, rng = 48000, np.random.default_rng(16)
    played = sweep(rate, 1.0)
    of = recorded(played, response(0.5, rate, rng), rate)
    of += 0.02 * rng.standard_normal(len(of))
    _, ends = recordings._excited(played, rate, np.array(BANDS), 1)
    assert 20_500 < ends[1] < 0.455 * rate
    h = recordings.impulse_response(of, played, rate, ends, "r")
    peak = int(np.argmax(np.abs(h)))
    assert np.square(h[: peak - 100]).mean() < 1e-4 * h[peak] ** 2


def faults():
    """Recordings that hold no response, by kind, and what is said."""
    rate, rng = 16000, np.random.default_rng(4)
    played = sweep(rate)
    good = recorded(played, response(0.5, rate, rng), rate)
    return {
        "silence": (np.zeros(5 * rate), "r.wav: is silent"),
        "the sweep": (np.concatenate([0.3 * played, np.zeros(rate)]), "this is the sweep itself"),
        "noise": (0.1 * rng.standard_normal(6 * rate), "the sweep is not found in this recording"),
        "another sweep": (
            recorded(sweep(rate, 4.0, 200), response(0.5, rate, rng), rate),
            "not found",
        ),
        "begin lost": (good[int(0.7 * rate) :], "before the start of the recording"),
        "end lost": (good[: int(3.21 * rate)], "s after the end of the sweep"),
        "short": (good[: 2 * rate], "a recording must be longer than its sweep"),
    }


@pytest.mark.parametrize("kind", faults())
def test_what_holds_no_response_is_refused(tmp_path, kind):
    samples, words = faults()[kind]
    if kind == "begin lost":
        samples = np.concatenate([samples, np.zeros(16000)])
    played = written(tmp_path / "s.wav", sweep(16000), 16000)
    with pytest.raises(DataError, match=words):
        recordings.from_sweep(written(tmp_path / "r.wav", samples, 16000), played, bands=BANDS)


def test_exchanged_files_and_other_rates_are_refused(tmp_path):
    rate, played = 16000, np.concatenate([sweep(16000), np.zeros(4 * 16000)])
    of = recorded(sweep(rate), response(0.5, rate, np.random.default_rng(5)), rate)
    r, s = written(tmp_path / "r.wav", of, rate), written(tmp_path / "s.wav", played, rate)
    with pytest.raises(DataError, match=r"s\.wav: .*exchanged"):
        recordings.from_sweep(s, r, bands=BANDS)
    other = written(tmp_path / "other.wav", of, 2 * rate)
    with pytest.raises(DataError, match=r"rate is 32000 Hz, but that of the sweep .* is 16000 Hz"):
        recordings.from_sweep(other, s, bands=BANDS)
    with pytest.raises(DataError, match=r"receiver r is given twice"):
        recordings.from_sweep([r, r], s, bands=BANDS)
    with pytest.raises(DataError, match="the sweep is silent"):
        recordings.from_sweep(r, written(tmp_path / "0.wav", 0 * played, rate), bands=BANDS)


@pytest.mark.parametrize(
    ("gain", "note"), [(3.0, "clipped recording: "), (0.002, "below full scale")]
)
def test_a_wrong_gain_is_noted(tmp_path, gain, note):
    rate, played = 16000, sweep(16000)
    of = recorded(played, response(0.5, rate, np.random.default_rng(6)), rate)
    r = written(tmp_path / "r.wav", np.clip(gain * of, -1, 1), rate)
    notes = recordings.from_sweep(r, written(tmp_path / "s.wav", played, rate), bands=BANDS).notes
    assert sum(note in each for each in notes) == 1


def stopped(t, rate, rng, n=3, noise=0.001, late=0.0):
    """Noise through a response, on for 1.5 s and off for 1.5 T or 1 s, n times, with noise."""
    h = response(t, rate, rng, late)
    on, off = int(1.5 * rate), int(max(1.5 * (4 * t if late else t), 1.0) * rate)
    source = np.tile(np.concatenate([np.ones(on), np.zeros(off)]), n)
    source *= rng.standard_normal(len(source))
    size = 2 ** int(np.ceil(np.log2(len(source) + len(h))))
    sound = np.fft.irfft(np.fft.rfft(source, size) * np.fft.rfft(h, size), size)[: len(source)]
    sound /= 5 * sound[: on + off].std()
    return sound + 0.2 * noise * rng.standard_normal(len(sound))


@pytest.mark.parametrize(
    ("rate", "t"), [(16000, 0.5), *also((44100, 1.0), (48000, 0.3), (8000, 2.5))]
)
def test_stops_of_noise_give_t_within_their_uncertainty(tmp_path, rate, t):
    rng = np.random.default_rng(7)
    path = written(tmp_path / "S1-R1.wav", stopped(t, rate, rng, n=6), rate)
    analysis = recordings.interrupted(path, bands=BANDS)
    measured = analysis.measurement
    assert {*measured.values} == {"t20", "t30"}
    for parameter, factor in (("t20", 0.88), ("t30", 0.55)):
        value, u = measured.values[parameter][0], measured.uncertainty[parameter][0]
        # ISO 3382-2:2008, Eqs. 4 and 5; the response's own noise is the same in every stop.
        scatter = factor * np.sqrt((1 + 1.9 / 6) / (0.71 * np.array(BANDS) * t))
        assert (np.abs(value / t - 1) < 4 * scatter).all()
        assert (u > 0).all()
        assert (u < 4 * scatter * t).all()
    assert analysis.notes[0] == "stops per position: 6"


def test_stops_of_several_files_are_averaged_at_their_position(tmp_path):
    rate, rng = 16000, np.random.default_rng(9)
    names = ("S1-R1", "S1-R1#2", "S1-R2")
    files = [written(tmp_path / f"{n}.wav", stopped(0.6, rate, rng, n=2), rate) for n in names]
    analysis = recordings.interrupted(files, bands=[1000], repeats=True)
    assert analysis.measurement.pairs == (("S1", "R1"), ("S1", "R2"))
    assert analysis.notes[0].startswith("stops per position: 2 to 4; ISO 3382-2 asks for")
    one = recordings.interrupted(files[2], bands=[1000])
    assert one.measurement.values["t20"][0] == analysis.measurement.values["t20"][1]
    alone = written(tmp_path / "one.wav", stopped(0.6, rate, rng, n=1), rate)
    u = recordings.interrupted(alone, bands=[1000]).measurement.uncertainty["t20"]
    b, n, t = 0.71 * 1000, 1, recordings.interrupted(alone, bands=[1000]).measurement.values["t20"]
    assert u == pytest.approx(0.88 * np.sqrt((1 + 1.9 / n) * t / b), rel=1e-3)  # ISO 3382-2, Eq. 4


def test_stops_that_agree_by_chance_have_the_theoretical_uncertainty(tmp_path):
    """Three equal stops have no spread; a spread that is larger than the theory counts itself."""
    rate, rng = 16000, np.random.default_rng(18)
    once = stopped(0.6, rate, rng, n=1)
    path = written(tmp_path / "equal.wav", np.tile(once, 3), rate)
    analysis = recordings.interrupted(path, bands=[1000])
    for parameter, a, b in (("t20", 0.88, 1.9), ("t30", 0.55, 1.52)):
        t, u = (
            x[parameter][0, 0]
            for x in (analysis.measurement.values, analysis.measurement.uncertainty)
        )
        assert u == pytest.approx(a * np.sqrt((1 + b / 3) * t / (0.71 * 1000)), rel=1e-3)
    assert "the larger of the standard error over the stops" in analysis.notes[1]
    apart = np.concatenate([once, stopped(1.0, rate, rng, n=1), once])
    path = written(tmp_path / "apart.wav", apart, rate)
    u = recordings.interrupted(path, bands=[1000]).measurement.uncertainty["t20"][0, 0]
    assert u > 0.08  # the standard error of about 0.6, 1.0, 0.6 s is 0.13 s; the theory has 0.03 s


def test_a_high_noise_takes_t30_and_then_t20(tmp_path):
    for noise, missing in ((1e-2, {"t30"}), (0.05, {"t20", "t30"})):
        samples = stopped(0.6, 16000, np.random.default_rng(11), noise=noise)
        path = written(tmp_path / "r.wav", samples, 16000)
        analysis = recordings.interrupted(path, bands=[1000])
        values = analysis.measurement.values
        assert {p for p, v in values.items() if np.isnan(v).all()} == missing
        # Filtered, white noise has another share of a band than noise through the room.
        assert analysis.impulse_to_noise_ratio[0, 0] == pytest.approx(-20 * np.log10(noise), abs=3)


@pytest.mark.parametrize("kind", ["silence", "steady", "response", "short"])
def test_what_is_no_stopped_noise_is_refused(tmp_path, kind):
    rate, rng = 16000, np.random.default_rng(12)
    samples = {
        "silence": np.zeros(3 * rate),
        "steady": 0.1 * rng.standard_normal(3 * rate),
        "response": 0.2 * response(1.0, rate, rng),
        "short": 0.1 * rng.standard_normal(100),
    }[kind]
    with pytest.raises(DataError, match=r"r\.wav: no noise was found"):
        recordings.interrupted(written(tmp_path / "r.wav", samples, rate), bands=[1000])


def test_a_sweep_is_no_steady_noise(tmp_path):
    rate = 16000
    of = recorded(sweep(rate), response(0.5, rate, np.random.default_rng(13)), rate)
    for bands in ([500, 1000], "octave"):
        with pytest.raises(DataError, match=r"is not steady noise\. For a recorded sweep"):
            recordings.interrupted(written(tmp_path / "r.wav", of, rate), bands=bands)
    samples = stopped(0.5, rate, np.random.default_rng(17))
    hum = 0.2 * np.sin(2 * np.pi * 500 * np.arange(len(samples)) / rate) ** 3
    hum[: len(hum) // 2] = 0
    some = recordings.interrupted(written(tmp_path / "r.wav", samples + hum, rate), bands=BANDS)
    assert np.isfinite(some.measurement.values["t20"][0, 2:]).all()


def test_what_does_not_go_with_stopped_noise_is_refused(tmp_path, rtcal):
    n = written(tmp_path / "n.wav", np.zeros(8000), 8000)
    for wrong in (("--sweep", n), ("--uncertainty",)):
        said = rtcal.refused("measure", n, "--interrupted", *wrong)
        assert "cannot be given with --interrupted" in said
