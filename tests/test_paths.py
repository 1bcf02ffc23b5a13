"""Traced paths: both kernels, conservation of energy, image sources, Kuttruff's equation."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from rtcal.acoustics.observables import TARGET
from rtcal.datasets import halls
from rtcal.simulators import kernels, path_tracing
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import PathTracing, jackknife
from rtcal.support.errors import DataError
from tests.reference import in_place_of
from tests.reference import paths as reference

C = 343.0
BIN = 0.002 * C  # m


def trace(geometry, sources, receivers, scattering, seconds, **options):
    receivers = np.array(receivers, dtype=float)
    names = list(geometry.areas)
    settings = {"n_paths": 4000, "n_batches": 16, "scattering_model": "random", "seed": 1} | options
    return path_tracing.trace(
        geometry,
        np.array(sources, dtype=float),
        receivers,
        materials=np.array([names.index(m) for m in geometry.materials]),
        scattering=np.broadcast_to(np.asarray(scattering, dtype=float), (len(names),)),
        radii=np.minimum(0.075 * geometry.volume ** (1 / 3), geometry.wall_distance(receivers)),
        longest=seconds * C,
        **settings,
    )


THINNED = 0.1 * C
BOX = Polyhedron.shoebox((5, 7, 3), "wall")
SOURCE = [(1.2, 2.1, 1.4)]
RECEIVERS = [(3.5, 5.1, 1.6), (2.2, 4.4, 1.2), (4, 2, 1.5), (1.1, 5.9, 1.5)]


@pytest.fixture(scope="module")
def diffuse():
    """Purely diffuse paths in the box, long enough for alpha = 0.05."""
    return trace(BOX, SOURCE, RECEIVERS, 1.0, 2.8, n_paths=12000)


@pytest.mark.parametrize("scattering_model", ["random", "vector"])
def test_the_compiled_loops_trace_the_paths_of_numpy(scattering_model):
    hall = halls.lecture_hall()
    alpha = np.random.default_rng(0).uniform(0, 1, (9, 3))
    alpha[2, 1] = 1.0  # nothing comes back from it

    def found():
        made = trace(
            hall.geometry,
            [hall.sources["S1"]],
            list(hall.receivers.values()),
            np.linspace(0, 0.8, 9),
            0.2,
            n_paths=200,
            n_batches=2,
            scattering_model=scattering_model,
        )
        return made, made.energy(alpha, np.array([0, 1e-3, 1e-2]), BIN)

    first, energy = found()
    with in_place_of(kernels, reference):
        second, twin = found()
    for a, b in zip(first.batches[0], second.batches[0], strict=True):
        assert (a.events == b.events).all()
        assert (a.starts == b.starts).all()
        assert a.lengths == pytest.approx(b.lengths, rel=1e-6)
        assert a.weights == pytest.approx(b.weights, rel=1e-6)
        assert a.free_paths == pytest.approx(b.free_paths, rel=1e-9)
    assert twin == pytest.approx(energy, rel=1e-6)
    assert energy.sum() > 0


def test_energy_is_conserved_where_nothing_absorbs(diffuse):
    # In equilibrium every receiver hears c/V per second: over 0.3 to 2 s within three standard
    # errors, and they are small.
    energy = diffuse.energy(np.zeros((1, 1)), np.zeros(1), BIN)[:, 0, :, 0, 150:1000]
    batches = energy.mean(axis=(1, 2)) / (BIN / BOX.volume)
    error = batches.std(ddof=1) / np.sqrt(len(batches))
    assert error < 0.005
    assert abs(batches.mean() - 1) < 3 * error
    assert sum(b.lost for b in diffuse.batches[0]) == 0


def test_free_paths(diffuse):
    assert diffuse.free_paths[0] == pytest.approx(4 * BOX.volume / 142, rel=0.002)
    assert 0.3 < diffuse.free_paths[1] < 0.5  # Kuttruff 2009, Table 5.1: about 0.4


def test_kuttruffs_equation_with_the_paths_own_gamma_squared(diffuse):
    alpha = np.array([0.05, 0.1, 0.2, 0.3, 0.4])
    a = -np.log(1 - alpha)
    exponent = a * (1 - diffuse.free_paths[1] * a / 2)
    kuttruff = 24 * np.log(10) / C * BOX.volume / (142 * exponent)
    energy = diffuse.energy(alpha[np.newaxis], np.zeros(5), BIN).mean(axis=0)
    assert TARGET.value(energy[0], 0.002).mean(axis=0) == pytest.approx(kuttruff, rel=0.02)
    # 2 % would be no test if Eyring passed it as well.
    assert (
        abs(TARGET.value(energy[0], 0.002).mean(axis=0)[-1] / (kuttruff * exponent / a)[-1] - 1)
        > 0.08
    )


def test_air_and_absorption_weigh_the_same_paths(diffuse):
    plain = diffuse.energy(np.full((1, 1), 0.1), np.zeros(1), BIN)
    air = diffuse.energy(np.full((1, 1), 0.1), np.full(1, 0.01), BIN)
    heard = plain > 0
    length = BIN * np.arange(plain.shape[-1]) + diffuse.first[0][:, np.newaxis, np.newaxis]
    ratio = (air / np.where(heard, plain, 1))[heard]
    expected = np.broadcast_to(np.exp(-0.01 * (length + BIN / 2)), plain.shape)[heard]
    assert ratio == pytest.approx(expected, rel=0.01 * BIN)  # within a bin's width
    assert (diffuse.energy(np.ones((1, 1)), np.zeros(1), BIN)[..., 1:] == 0).all()


def image_sources(dimensions, source, receiver, alpha, longest, start):
    """Energies of a shoebox' image sources by `BIN` after ``start``, (n_bins,)."""
    counts = [np.arange(-int(longest / side) - 2, int(longest / side) + 3) for side in dimensions]
    parts = [
        np.stack(
            [
                np.concatenate([2 * n * side + s, 2 * n * side - s]) - r,
                np.concatenate([np.abs(2 * n), np.abs(2 * n - 1)]),
            ]
        )
        for n, side, s, r in zip(counts, dimensions, source, receiver, strict=True)
    ]
    x, y, z = (p[0] for p in parts)
    square = x[:, None, None] ** 2 + y[:, None] ** 2 + z**2
    order = parts[0][1][:, None, None] + parts[1][1][:, None] + parts[2][1]
    length = np.sqrt(square)
    here = length < longest
    energy = (1 - alpha) ** order[here] / (4 * np.pi * square[here])
    return np.histogram(length[here], np.arange(start - 1e-6, longest, BIN), weights=energy)[0]


def test_image_sources_at_scattering_0():
    # Sums over 50 ms: within the noise, which is small, and exact for the direct sound.
    seconds, alpha = 0.5, 0.15
    specular = trace(BOX, SOURCE, RECEIVERS, 0.0, seconds, n_paths=64000)
    energy = specular.energy(np.full((1, 1), alpha), np.zeros(1), BIN)[:, 0, :, 0]
    deviations, errors = [], []
    for r, receiver in enumerate(RECEIVERS):
        exact = image_sources(
            (5, 7, 3), SOURCE[0], receiver, alpha, seconds * C, specular.first[0, r]
        )
        assert exact[0] > 0.999 / (4 * np.pi * specular.direct[0, r] ** 2)
        n = 9  # of 50 ms, from the direct sound on
        wide = energy[:, r, : 25 * n].reshape(16, n, 25).sum(axis=2)
        exact = exact[: 25 * n].reshape(n, 25).sum(axis=1)
        deviations.append(wide.mean(axis=0) / exact - 1)
        errors.append(wide.std(axis=0, ddof=1) / 4 / exact)
    z = np.array(deviations) / np.array(errors)
    assert np.median(errors) < 0.05
    assert np.mean(np.abs(z) < 2) > 0.88  # 16 batches: Student's 2-sigma share is 94 %
    assert abs(np.mean(deviations)) < 0.01


def test_the_receivers_radius_does_not_bias_the_energy():
    # A sphere as large as its distance to the walls allows hears, reflection by reflection, what
    # a point hears: here the first reflections from six walls, 1 % with the noise.
    receiver = np.array([2.5, 4.4, 1.5])
    made = path_tracing.trace(
        BOX,
        np.array(SOURCE),
        receiver[np.newaxis],
        materials=np.zeros(6, dtype=np.int64),
        scattering=np.zeros(1),
        radii=np.array([1.49]),
        longest=20.0,
        n_paths=200_000,
        n_batches=4,
        scattering_model="random",
        seed=3,
    )
    heard = made.energy(np.full((1, 1), 0.999), np.zeros(1), BIN).sum(axis=-1).mean()
    walls = 0.0
    for axis, side in enumerate((5, 7, 3)):
        for plane in (0, side):
            image = np.array(SOURCE[0])
            image[axis] = 2 * plane - image[axis]
            walls += 1e-3 / (4 * np.pi * np.sum((image - receiver) ** 2))
    direct = 1 / (4 * np.pi * made.direct[0, 0] ** 2)
    assert (heard - direct) / walls == pytest.approx(1, rel=0.01)


def test_scattering_means_two_things():
    dimensions = halls.corridor().room.dimensions
    corridor = Polyhedron.shoebox(dimensions, "wall")
    receivers = list(halls.corridor().receivers.values())
    t = {}
    for s in (0.1, 1.0):
        for scattering_model in ("random", "vector"):
            made = trace(
                corridor, [(4, 1, 1.5)], receivers, s, 1.5, scattering_model=scattering_model
            )
            energy = made.energy(np.full((1, 1), 0.2), np.zeros(1), BIN).mean(axis=0)
            t[s, scattering_model] = TARGET.value(energy[0], 0.002).mean()
    assert t[1.0, "vector"] == pytest.approx(t[1.0, "random"], rel=1e-9)
    assert t[0.1, "random"] > 1.2 * t[0.1, "vector"]


def test_longer_paths_start_with_the_shorter_ones_and_threads_change_nothing():
    short = trace(BOX, SOURCE, RECEIVERS, 0.3, 0.2, n_paths=64, n_batches=4, workers=1)
    long = trace(BOX, SOURCE, RECEIVERS, 0.3, 0.4, n_paths=64, n_batches=4, workers=3)
    other = trace(BOX, SOURCE, RECEIVERS, 0.3, 0.4, n_paths=64, n_batches=4, seed=2)
    alpha, air = np.full((1, 2), [0.2, 0.3]), np.zeros(2)
    held, changed = np.ones((1, 1), dtype=bool), alpha[np.newaxis] / 2
    weighed = [
        (
            replace(long, workers=workers).energy(alpha, air, BIN),
            replace(long, workers=workers).energy_changed(alpha, air, BIN, held, changed),
        )
        for workers in (1, 3)
    ]
    assert all(np.array_equal(one, three) for one, three in zip(*weighed, strict=True))
    for a, b in zip(short.batches[0], long.batches[0], strict=True):
        for i in range(16):
            mine = a.events[a.starts[i] : a.starts[i + 1]]
            assert (b.events[b.starts[i] :][: len(mine)] == mine).all()
    assert not np.array_equal(long.batches[0][0].events[:50], other.batches[0][0].events[:50])
    assert not np.array_equal(long.batches[0][0].events[:50], long.batches[0][1].events[:50])


def test_paths_in_memory_are_cut_to_those_that_would_be_traced(monkeypatch):
    hall = halls.corridor()
    tracer = PathTracing(
        geometry=hall.geometry,
        room=hall.room,
        sources=hall.sources,
        receivers=hall.receivers,
        n_paths=320,
        scattering_model="vector",
    )
    alone = replace(tracer).simulate(hall.room.alpha, seed=1)
    tracer.trace_ahead(hall.room.alpha, 3.0, seed=1)
    fresh = tracer.afresh()
    monkeypatch.setattr(path_tracing, "trace", None)
    same = fresh.simulate(hall.room.alpha, seed=1)
    assert all(np.array_equal(of, same.values[key]) for key, of in alone.values.items())
    longer = tracer.simulate(hall.room.alpha, seed=1)
    assert not np.array_equal(longer.values["t20"], same.values["t20"])


def test_a_hidden_source_arrives_by_its_first_reflection():
    outline = np.array([[0, 0], [8, 0], [8, 2], [2, 2], [2, 8], [0, 8.0]])
    walls = [
        (f"wall {i}", "a", [[*a, 0], [*b, 0], [*b, 3], [*a, 3]])
        for i, (a, b) in enumerate(zip(outline, np.roll(outline, -1, axis=0), strict=True))
    ]
    floor, ceiling = np.c_[outline, np.zeros(6)], np.c_[outline, np.full(6, 3.0)]
    hall = Polyhedron.from_polygons([*walls, ("floor", "a", floor), ("ceiling", "a", ceiling)])
    made = trace(hall, [(7, 1, 1.5)], [(1, 7, 1.5), (4, 1, 1.5)], 0.5, 0.3)
    assert np.isnan(made.direct[0, 0])
    assert made.direct[0, 1] == pytest.approx(3)
    # The shortest way round the inner corner, which no path can beat.
    assert made.first[0, 0] > 2 * np.hypot(5, 1)
    energy = made.energy(np.full((1, 1), 0.2), np.zeros(1), BIN).mean(axis=0)[0, 0, 0]
    assert energy[0] > 0


def test_bad_input(diffuse):
    with pytest.raises(DataError, match="n_materials, n_bands"):
        diffuse.energy(np.zeros((2, 1)), np.zeros(1), BIN)


def test_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(0).normal(2, 1, (40, 3))
    error = jackknife(lambda mean: mean, values)
    assert error == pytest.approx(values.std(axis=0, ddof=1) / np.sqrt(40))


def test_one_sweep_changes_groups_of_faces_as_weighings_do():
    hall = halls.lecture_hall()
    names = list(hall.geometry.areas)
    made = trace(
        hall.geometry,
        [hall.sources["S1"]],
        list(hall.receivers.values()),
        0.4,
        0.2,
        n_paths=200,
        n_batches=2,
    )
    rng = np.random.default_rng(1)
    alpha, air = rng.uniform(0, 0.9, (len(names), 2)), np.array([0, 1e-3])
    changed = np.stack([alpha * 0.5, np.ones_like(alpha)])
    members = np.zeros((2, len(names)), dtype=bool)
    members[0, 0] = members[1, 1:4] = True
    swept = made.energy_changed(alpha, air, BIN, members, changed)
    for group, of_group in zip(members, swept, strict=True):
        for other, energy in zip(changed, of_group, strict=True):
            weighed = made.energy(np.where(group[:, None], other, alpha), air, BIN).mean(axis=0)
            assert energy == pytest.approx(weighed, rel=1e-6, abs=1e-12)


def test_thinned_paths_carry_the_energy_of_all():
    """Half of them after each 0.1 s, which weigh twice as much."""
    whole, thinned = (
        trace(BOX, SOURCE, RECEIVERS, 0.5, 0.8, n_paths=16000, thinned=length)
        for length in (np.inf, THINNED)
    )
    energies = [p.energy(np.array([[0.2]]), np.zeros(1), BIN)[:, 0, :, 0] for p in (whole, thinned)]
    edges = (THINNED / BIN * np.arange(0, 8)).astype(int)
    for begin, end in pairwise(edges):
        both = [e[..., begin:end].sum(axis=(1, 2)) for e in energies]
        noise = np.hypot(*(b.std(ddof=1) / np.sqrt(len(b)) for b in both))
        assert abs(both[0].mean() - both[1].mean()) < 4 * noise
        assert both[1].mean() == pytest.approx(both[0].mean(), rel=0.15)
    assert thinned.nbytes < 0.5 * whole.nbytes
