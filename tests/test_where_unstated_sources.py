"""Sources of which nothing, or an index, is stated: their lobes are not claimed of the room."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.positions import search
from rtcal.finder.positions.problem import covariance_of_lobes
from rtcal.finder.positions.weighing import lobes
from tests.test_where import MATCH, RECEIVERS, SOURCES, heard, stated, tracing

MICROPHONE = {"M": (3.9, 2.2, 1.3)}
SPEAKERS = {
    f"L{n}": (3.9 + 1.6 * np.cos(angle), 2.2 + 1.6 * np.sin(angle), 1.3 + 0.1 * (-1) ** n)
    for n, angle in enumerate(np.deg2rad(np.arange(10, 360, 36)))
}


INDEX = (3.0, 6.0, 8.0)
"""Of the loudspeakers, in dB."""


def box(**options):
    return tracing(stated(), sources=SPEAKERS, receivers=MICROPHONE, **options)


def aimed(index):
    """The loudspeakers' lobes, which aim at the microphone."""
    return {
        name: rt.Directivity(index=index, aim=tuple(np.subtract(MICROPHONE["M"], point)))
        for name, point in SPEAKERS.items()
    }


@pytest.fixture(scope="module")
def measured():
    """The box as it is stated, measured with loudspeakers that aim at the microphone."""
    lobes = aimed(INDEX)
    return heard(box(scattering=0.45, n_paths=9600, directivity=lobes), stated().alpha)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return tmp_path_factory.mktemp("kept")


@pytest.mark.long
@pytest.mark.parametrize("match", [MATCH, MATCH[1:]], ids=["all", "without T"])
def test_loudspeakers_of_which_nothing_is_stated_are_not_claimed_of_the_room(
    measured, kept, monkeypatch, match
):
    case = rt.finder.PositionsCase(simulator=box(n_paths=800), measured=measured, match=match)
    finding = rt.find(case, cache=kept)
    assert not finding.detected
    assert any("not taken as omnidirectional" in str(note) for note in finding.notes)
    unknown = finding.case.simulator.unknown_sources
    assert unknown == (tuple(SPEAKERS) if "t20" in match else ())
    monkeypatch.setattr(search, "LIKELY_LOBES", np.inf)
    monkeypatch.setattr(search, "AIMED", 1e-300)
    taken = rt.find(case, cache=kept)
    assert taken.detection.score > finding.detection.score + 3
    assert taken.detected


@pytest.mark.long
def test_where_a_directivity_is_unknown_times_alone_are_asked(measured, kept):
    simulator = box(n_paths=800, directivity=dict.fromkeys(SPEAKERS, "unknown"))
    found = rt.find(rt.finder.PositionsCase(simulator=simulator, measured=measured), cache=kept)
    assert found.parameters == ("t20",)
    assert found.verdict == "none"
    assert found.surface is None


def test_lobes_are_those_of_sources_of_which_nothing_or_an_index_is_stated():
    made = lobes(tracing(stated(), directivity={"S1": "unknown"}))
    assert [list(lobes) for lobes in made] == [["S2"]] * 7
    middle = np.mean(list(RECEIVERS.values()), axis=0)
    assert made[0]["S2"].aim == pytest.approx(middle - SOURCES["S2"])
    among = tracing(stated(), sources={"S": tuple(middle)})
    assert np.linalg.norm(lobes(among)[0]["S"].aim) > 0
    balloon = rt.Directivity(gains=np.ones((3, 7, 4)), aim=(1, 0, 0))
    omnidirectional = rt.Directivity(index=0, aim=(1, 0, 0))
    exact = tracing(stated(), directivity={"S1": balloon, "S2": omnidirectional})
    assert lobes(exact) == [{}] * 7
    lobe = rt.Directivity(index=[3, 6, 24], aim=(0, 1, 0))
    together, own = lobes(tracing(stated(), directivity={"S1": lobe, "S2": balloon}))[:2]
    assert together["S1"].index == pytest.approx([5, 8, 25])
    assert own["S1"].index == pytest.approx([3.5, 6.5, 24.5])
    assert together["S1"].aim == own["S1"].aim == lobe.aim


def test_the_covariance_is_that_of_aims_that_are_drawn():
    rng = np.random.default_rng(1)
    pairs, f = [("A", "1"), ("A", "2"), ("B", "1")], np.array([500.0, 2000.0])
    nodes = rng.standard_normal((2, 6, 7))
    got = covariance_of_lobes(nodes, pairs, f)
    band = np.linalg.cholesky([[1, 0.7**2], [0.7**2, 1]])
    n = 200_000
    together = np.einsum("kl,nl->nk", band, rng.standard_normal((n, 2)))
    drawn = np.einsum("kv,nk->nkv", nodes[..., 0], together)
    for source in "AB":
        own = np.einsum("kl,nal->nka", band, rng.standard_normal((n, 6, 2))) / np.sqrt(6)
        here = np.array([p[0] == source for p in pairs] * 2)
        drawn[..., here] += np.einsum("kva,nka->nkv", nodes[:, here, 1:], own)
    flat = drawn.reshape(n, -1)
    assert got == pytest.approx(flat.T @ flat / n, abs=0.05)
