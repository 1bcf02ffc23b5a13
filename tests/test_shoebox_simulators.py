"""The scattering delay network and the image sources of a shoebox."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.observables import observable
from rtcal.simulators import base, kernels
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.shoebox import ImageSource, ScatteringDelayNetwork, lattice, mean_energy
from rtcal.support.errors import DataError, TooShortError
from tests.conftest import room_of
from tests.reference import shoebox as reference

SOURCE, RECEIVER = {"S": (4.5, 3.5, 2.0)}, {"R": (2.0, 2.0, 1.5)}
APART = {"R": (2.1, 2.3, 1.4)}  # no two first reflections arrive in one sample
DIMENSIONS = (5.0, 7.0, 3.0)
ALPHA = np.array([[0.1, 0.2], [0.2, 0.3], [0.3, 0.1], [0.15, 0.25], [0.4, 0.5], [0.05, 0.6]])


def box(air=None):
    """A shoebox of six materials, in two bands."""
    geometry = Polyhedron.shoebox(DIMENSIONS, {w: w for w in SHOEBOX_WALLS})
    return rt.Room.from_surfaces(
        name="box",
        volume=105,
        surfaces=geometry.surfaces,
        materials=[rt.Material(w, [0.3, 0.3], [0.1, 0.1]) for w in SHOEBOX_WALLS],
        centre_frequencies=[500, 4000],
        air=air,
        dimensions=DIMENSIONS,
    )


def first_order(air, alpha):
    """Length in m and amplitude (n_bands,) of the direct sound and the six first reflections."""
    source, receiver = np.array(SOURCE["S"]), np.array(APART["R"])
    found = [(float(np.linalg.norm(source - receiver)), np.ones(2))]
    for wall in range(6):
        image = source.copy()
        image[wall // 2] = 2 * (DIMENSIONS[wall // 2] if wall % 2 else 0.0) - image[wall // 2]
        found.append((float(np.linalg.norm(image - receiver)), np.sqrt(1 - alpha[wall])))
    return [(d, beta * np.exp(-air * d / 2) / d) for d, beta in found]


@pytest.mark.parametrize("air", [None, rt.Air(20, 50)])
def test_sdn_first_order_arrivals_are_the_image_sources(air):
    room = box(air)
    sdn = ScatteringDelayNetwork(room=room, sources=SOURCE, receivers=APART)
    response = sdn.impulse_responses(ALPHA, 0.05)[0]
    for length, amplitude in first_order(room.air_attenuation, ALPHA):
        position = length / room.speed_of_sound * sdn.sampling_rate
        sample = round(position)  # the nearest sample: within half a sample
        assert response[:, sample] == pytest.approx(amplitude, rel=1e-6)
        assert (response[:, sample - 1] == 0).all()
        assert (response[:, sample + 1] == 0).all()


def test_sdn_keeps_its_energy_without_absorption():
    sdn = ScatteringDelayNetwork(
        room=box(), sources=SOURCE, receivers=RECEIVER, line_of_sight=False
    )
    response = sdn.impulse_responses(np.zeros((6, 2)), 4.0)[0, 0]
    quarters = np.array_split(response[44100:] ** 2, 4)
    energies = np.array([q.mean() for q in quarters])
    assert energies.min() > 0
    assert energies.max() / energies.min() < 1.02


def test_sdn_numba_and_numpy_are_one_network():
    sdn = ScatteringDelayNetwork(room=box(), sources=SOURCE, receivers=RECEIVER, sampling_rate=8000)
    network, rng = sdn.networks[0], np.random.default_rng(1)
    gains = [rng.uniform(0.9, 1, shape) for shape in ((6, 5, 3), (6, 3), (6, 3), (6, 3))]
    delays = (network.lines, network.source_delays, network.tap_delays)
    one, two = (loops.blocks(*delays, *gains, 16000) for loops in (kernels, reference))
    assert np.abs(one).max() > 0.1
    assert one == pytest.approx(two, rel=0, abs=1e-12 * np.abs(one).max())


def test_sdn_is_as_long_as_it_has_to_be():
    sdn = ScatteringDelayNetwork(room=box(), sources=SOURCE, receivers=RECEIVER, longest=1.5)
    assert (sdn.simulate(ALPHA).values["t20"] > 0.1).all()
    with pytest.raises(TooShortError, match=r"S to R, 500 Hz is too short for T20: in 1\.49 s"):
        sdn.simulate(np.full((6, 2), 0.01))


def test_sdn_and_image_sources_decay_alike():
    """De Sena et al. 2015, Sect. V: the two agree in a room of usual absorption (10 % here)."""
    room = box(rt.Air(20, 50))
    alpha = np.full((6, 2), 0.3)
    receivers = {"A": (2.0, 2.0, 1.5), "B": (1.0, 5.0, 1.2), "C": (3.2, 5.6, 1.8)}
    sdn = ScatteringDelayNetwork(room=room, sources=SOURCE, receivers=receivers)
    images = ImageSource(room=room, sources=SOURCE, receivers=receivers, duration=0.5)
    one, two = (base.run(s, alpha).mean("t20") for s in (sdn, images))
    assert one == pytest.approx(two, rel=0.15)
    assert two[1] < two[0]  # the air


def test_image_sources_are_pyroomacoustics():
    pra = pytest.importorskip("pyroomacoustics")
    alpha, duration = 0.5, 0.2
    # Within 0.2 s of the direct sound (72 m) no image is of an order above 33.
    other = pra.ShoeBox(DIMENSIONS, fs=8000, materials=pra.Material(alpha), max_order=33)
    other.add_source(SOURCE["S"])
    other.add_microphone(RECEIVER["R"])
    other.image_source_model()
    theirs = other.sources[0].images.T
    order = other.sources[0].orders_xyz.T
    order = order if order.shape[1] == 3 else order.T
    radius = 25.0
    places, hits = lattice(np.array(DIMENSIONS), np.array(SOURCE["S"]), radius + 10)
    near = np.linalg.norm(theirs - RECEIVER["R"], axis=1) < radius
    ours = {}
    for (i, x), (j, y), (k, z) in _triples(places):
        if np.linalg.norm(np.array([x, y, z]) - RECEIVER["R"]) < radius:
            ours[tuple(np.round((x, y, z), 6) + 0.0)] = (
                hits[0][i].sum(),
                hits[1][j].sum(),
                hits[2][k].sum(),
            )
    assert len(ours) == near.sum() > 500
    for place, count in zip(theirs[near], order[near], strict=True):
        assert ours[tuple(np.round(place, 6) + 0.0)] == tuple(abs(count))
    room = room_of({"all": (142, alpha, 0.1)}, [1000], 105, name="box", dimensions=DIMENSIONS)
    images = ImageSource(room=room, sources=SOURCE, receivers=RECEIVER, duration=duration)
    length = np.linalg.norm(theirs - RECEIVER["R"], axis=1)
    direct = length.min()
    bins = np.floor((length - direct) / (room.speed_of_sound * 0.001) + 1e-9).astype(int)
    energy = (1 - alpha) ** other.sources[0].orders / (4 * np.pi * length**2)
    expected = np.bincount(bins, energy)[:200]
    assert images.decays(room.alpha)[0][0, 0] == pytest.approx(expected, rel=1e-9)
    t20 = float(observable("t20").value(expected, images.bin_width))
    assert 0.1 < t20 < 0.5
    assert images.simulate(room.alpha).mean("t20")[0] == pytest.approx(t20, rel=1e-9)


def test_late_images_have_their_mean_over_positions():
    """40 pairs are compared in three parts of the decay; the walls of each axis absorb alike."""
    room, of_axis = box(rt.Air(20, 50)), np.array([[0.1, 0.3], [0.35, 0.2], [0.2, 0.05]])
    rng = np.random.default_rng(4)
    sources, receivers = (
        {f"{n}{i}": rng.uniform(0.1, 0.9, 3) * DIMENSIONS for i in range(m)}
        for n, m in (("S", 5), ("R", 8))
    )
    images = ImageSource(room=room, sources=sources, receivers=receivers, duration=0.6)
    counted = images.decays(np.repeat(of_axis, 2, axis=0))[0]
    distances = np.array([np.linalg.norm(sources[s] - receivers[r]) for s, r in images.box.pairs])
    times = (np.arange(counted.shape[-1]) + 0.5) * images.bin_width
    mean = mean_energy(room, of_axis, distances, times) * images.bin_width
    for part in (slice(150, 300), slice(300, 450), slice(450, 600)):
        both = (e[..., part].sum(-1).mean(0) for e in (mean, counted))
        np.testing.assert_allclose(*both, rtol=0.03)


def _triples(places):
    x, y, z = (list(enumerate(p)) for p in places)
    return [(a, b, c) for a in x for b in y for c in z]


@pytest.mark.parametrize("dimensions", [(5, 7, 3), (2, 2.5, 2.2), (4, 40, 3)])
def test_the_lowest_sampling_rate_has_the_right_t20(dimensions):
    """Within 5.5 % of 44.1 kHz at alpha = 0.3, where delays are whole samples."""
    x, y, z = dimensions
    areas = [2 * (x * y + x * z + y * z)]
    room = rt.Room(
        name="box",
        volume=x * y * z,
        materials=["all"],
        areas=areas,
        alpha=[[0.3]],
        sigma=[[0.1]],
        centre_frequencies=[1000],
        dimensions=dimensions,
    )
    places = {
        "sources": {"S": np.array(dimensions) * [0.8, 0.4, 0.6]},
        "receivers": {
            "R": np.array(dimensions) * [0.3, 0.3, 0.45],
            "Q": np.array(dimensions) * [0.55, 0.7, 0.4],
        },
    }
    least = 10 * room.speed_of_sound * areas[0] / (4 * room.volume)
    low = ScatteringDelayNetwork(room=room, sampling_rate=least, **places)
    full = ScatteringDelayNetwork(room=room, **places)
    ratio = low.simulate(room.alpha).mean("t20") / full.simulate(room.alpha).mean("t20")
    assert ratio == pytest.approx(1.0, abs=0.055)
    with pytest.raises(DataError, match=r"sampling_rate = \S+ Hz is too low: at least"):
        ScatteringDelayNetwork(room=room, sampling_rate=0.99 * least, **places)
