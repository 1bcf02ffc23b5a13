"""Hypotheses: the return of a second room, and the error of what stands on a part of a surface."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rtcal.acoustics.observables import observable
from rtcal.finder.evidence import with_columns
from rtcal.finder.positions.density_kernel import LANES, of_own_errors
from rtcal.finder.positions.problem import (
    Likelihood,
    ScatteringLevels,
    ShiftHypothesis,
    uneven_amount,
    uneven_columns,
    unevenness,
)
from rtcal.finder.positions.search import _candidate
from rtcal.finder.positions.weighing import SECOND_ROOMS, Aperture
from tests.conftest import room_of

WIDTH = 0.002


def room():
    return room_of({"wall": (210.0, [0.1, 0.2], [0.01, 0.02])}, [500, 1000], 200.0)


def balances(aperture, first, seconds):
    """Integrate the two balances step by step; the energy of the first room, (n_bands, n_bins)."""
    second = aperture.second_rate(room())
    c = room().speed_of_sound
    step, out = WIDTH / 20, []
    e1, e2 = np.ones(2), np.zeros(2)
    for _ in range(int(seconds / WIDTH)):
        out.append(e1)
        for _ in range(20):
            out_of = c * aperture.area / 4
            e1, e2 = (
                e1 + step * (-first * e1 + out_of / 200.0 * e2),
                e2 + step * (-second * e2 + out_of / aperture.volume * e1),
            )
    return np.array(out).T


@pytest.mark.parametrize(("volume", "alpha"), [(60.0, 0.03), (400.0, 0.05), (400.0, 0.9)])
def test_the_return_is_that_of_two_coupled_rooms(volume, alpha):
    aperture, first = Aperture(8.0, volume, alpha), np.array([12.0, 18.0])
    t = WIDTH * np.arange(800)
    opened = np.tile(np.exp(-first[:, np.newaxis] * t), (2, 1, 1))  # two receivers of one source
    opened[..., 0] *= 3  # a direct sound, which the second room does not hear
    heard = aperture.returned_to(opened, room(), WIDTH, 1)
    expected = balances(aperture, first, WIDTH * heard.shape[-1])
    got = observable("t20").value(heard[0], WIDTH)
    assert got == pytest.approx(observable("t20").value(expected, WIDTH), rel=0.03)
    assert (got > 1.001 * observable("t20").value(opened[0], WIDTH)).all()


@pytest.mark.parametrize(("area", "within"), [(40.0, False), (9.0, True)])
def test_a_size_ends_with_its_surface(area, within):
    sizes = np.array([2.0, 4.0, 8.0])
    made = replace(shift(0.0)[0], sizes=sizes, parameters=[{}] * 3, spectra=np.ones((3, 2)))
    case = SimpleNamespace(faces={"north": [0]}, areas={"north": area})
    found = _candidate(case, [(made, np.array([0.0, 0.1, 0.9]))])
    assert (found.high == area) == within
    assert found.size <= found.high <= area


def shift(uneven):
    """Return one hypothesis of two bands, and its change in the order (band, parameter, pair)."""
    rng = np.random.default_rng(3)
    nodes = -rng.uniform(0.1, 0.3, (2, 2 * 3, 1))
    made = ShiftHypothesis(
        effect="opening",
        family="added absorption, flat",
        surface=0,
        response="surface 0",
        weights=np.ones((1, 2, 1)),
        odds=np.ones(1),
        sizes=np.ones(1),
        unit="m²",
        parameters=[{}],
        spectra=np.ones((1, 2)),
        error=np.array([[0.04, 0.02], [0.02, 0.04]]),
        uneven=np.array([uneven]),
    )
    return made, nodes


@pytest.mark.parametrize("uneven", [0.0, 1.5])
def test_the_error_of_a_place_is_integrated_as_a_covariance(uneven):
    hypothesis, nodes = shift(uneven)
    names, n_pairs, n = ("t20", "level"), 3, 12
    rng = np.random.default_rng(4)
    root = rng.standard_normal((n, n)) / 10
    covariance = root @ root.T + 0.01 * np.eye(n)
    columns = uneven_columns(names, n_pairs)
    likelihood = Likelihood(
        covariance,
        np.ones(n, dtype=bool),
        {"surface 0": nodes},
        uneven=columns,
        amount=uneven_amount(names, n_pairs),
        levels=ScatteringLevels(np.zeros((n, 1)), np.zeros(1)),
    )
    residual = 0.1 * rng.standard_normal(n)
    change = nodes[:, :, 0]
    of_bands = np.zeros((n, 2))
    of_bands[:6, 0], of_bands[6:, 1] = change
    amount = -change.mean(axis=1)  # both parameters fall with the absorption
    of_pairs = uneven * np.vstack([a * columns for a in amount])
    full = covariance + of_bands @ hypothesis.error @ of_bands.T + of_pairs @ of_pairs.T
    off = residual - change.ravel()
    square = off @ np.linalg.solve(full, off)
    assert square < n  # so that the density is normal
    expected = -square / 2 - np.linalg.slogdet(full)[1] / 2
    assert likelihood.shifted([hypothesis], likelihood.of(residual)) == pytest.approx(
        [expected], abs=1e-4
    )
    # Groups of surfaces that are not told apart know of it, too.
    with_place = np.linalg.inv(covariance + of_pairs @ of_pairs.T)
    assert likelihood.inverse_with_place(hypothesis, 0) == pytest.approx(with_place, abs=1e-6)


@pytest.mark.parametrize("n", [1, LANES, LANES + 1])
def test_errors_side_by_side_are_those_of_woodburys_identity(n):
    n_bands, n_columns, m = 3, 4, 2
    rng = np.random.default_rng(7)
    root = rng.standard_normal((n_bands * (1 + n_columns), 30)) / 5
    form = (root @ root.T).reshape(n_bands, 1 + n_columns, n_bands, 1 + n_columns)
    change = rng.uniform(-1, 1, (n, n_bands))
    across = rng.standard_normal((n, n_bands + n_columns, m))
    # Columns of the change in each band, and those that are common to all bands.
    factor = np.broadcast_to(form[:, 0, :, 0], (n, n_bands, n_bands))
    side = np.einsum("hk,kcl->hcl", change, form[:, 1:, :, 0])
    own = np.einsum("hk,hl,kcld->hcd", change, change, form[:, 1:, :, 1:])
    inner = np.block([[factor, side.swapaxes(1, 2)], [side, own]])
    square, half = with_columns(np.zeros((n, m)), 0.0, across, inner)
    one, other = np.tril_indices(n_bands)
    both = form[one, 1:, other, 1:] + form[other, 1:, one, 1:]
    both[one == other] /= 2
    products = np.ascontiguousarray(both.swapaxes(0, 1))
    explained, more = of_own_errors(factor.copy(), side, change, products, across)
    assert explained == pytest.approx(-square, rel=1e-12)
    assert more == pytest.approx(half[:, 0], rel=1e-12)


def test_what_covers_a_whole_surface_is_even():
    factors = unevenness(np.array([1.0, 0.5, 1 / 9, 0.01]))
    assert factors == pytest.approx([0.0, 1.0, np.sqrt(8), np.sqrt(8)])


@pytest.mark.parametrize("parameter", ["t20", "t30"])
def test_the_decay_with_a_second_room_holds_a_decay_time(parameter):
    """Even where the paths end before the decay does."""
    t = WIDTH * np.arange(220)
    energy = np.exp(-13.8 * t / np.array([[0.4], [0.6]]))[np.newaxis].repeat(2, axis=0)
    for volume, alpha in SECOND_ROOMS:
        aperture = Aperture(2.0, volume * 200.0, alpha)
        heard = aperture.returned_to(energy, room(), WIDTH, 2)
        assert not observable(parameter).too_short(heard).any()
