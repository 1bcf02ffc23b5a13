"""On which wall something changed between two measurements, with and without the directivity."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.report.finding_words import headline
from tests.test_where import heard, stated, tracing

WALL = 1
"""The east wall's row of alpha."""
PLACES = {
    "S1": (1.2, 1.0, 1.5),
    "S2": (5.6, 3.9, 1.4),
    "S3": (6.2, 1.3, 1.6),
    "S4": (1.0, 4.2, 1.3),
    "S5": (3.6, 0.8, 1.5),
    "S6": (4.4, 4.3, 1.8),
}
POINT = rt.Directivity(index=0, aim=(1, 0, 0))
"""An omnidirectional source that says so."""


def noisy(clean, rng):
    """Return a measurement with noise of each value of its own: 2 %, and 0.2 dB."""
    values = {
        name: of * np.exp(0.02 * rng.standard_normal(of.shape))
        if name in ("t20", "edt", "ts")
        else of + 0.2 * rng.standard_normal(of.shape)
        for name, of in clean.values.items()
    }
    return replace(clean, values=values)


def moved(alpha, rows, share):
    """Return alpha of each wall with some moved by a share of the way to 1."""
    out = alpha.copy()
    out[rows] += share * (1 - out[rows])
    return out


def two_states():
    """Return the parameters before and after, by paths of other seeds that scatter otherwise."""
    room = stated()
    truth = tracing(room, scattering=0.5, n_paths=9600, sources=PLACES)
    rng = np.random.default_rng(3)
    base = 0.8 * room.alpha
    before, after = (heard(truth, moved(base, [WALL], share)) for share in (0.0, 0.5))
    return noisy(before, rng), noisy(after, rng)


@pytest.fixture(scope="module")
def states():
    return two_states()


def simulator(directivity):
    return tracing(stated(), directivity=directivity, sources=PLACES)


@pytest.fixture(scope="module")
def finding(states):
    model = simulator(dict.fromkeys(PLACES, POINT))
    return rt.find(model.room, states[1], model, before=states[0])


@pytest.mark.long
def test_the_wall_that_changed_is_claimed_and_no_other(finding):
    assert finding.identified_surfaces == ("east",)
    assert 'The change is on "east".' in headline(finding)
    assert finding.surfaces["east"] == max(finding.surfaces.values())
    np.testing.assert_allclose(sum(finding.sets.values()), 1, rtol=1e-9)


@pytest.mark.long
def test_without_the_directivity_something_changed_but_no_surface_is_named(states):
    model = simulator({})
    found = rt.find(model.room, states[1], model, before=states[0])
    assert found.detected
    assert found.surfaces == {}
    assert any("S1, S2, S3 and 3 more is not given" in str(note) for note in found.notes)


@pytest.mark.long
def test_the_changed_room_has_the_claimed_wall_as_a_material(finding, tmp_path):
    changed = finding.apply()
    assert changed.surfaces == ("east",)
    room = changed.room
    row = room.material_index("east, changed")
    assert room.areas[row] == pytest.approx(15)
    assert room.sources["east, changed"] == "changed by rtcal find: two states"
    np.testing.assert_allclose(room.areas @ room.alpha, finding.area + finding.change[0], rtol=0.02)
    # Half of what the wall reflected, of coefficients scaled to T before.
    assert (room.alpha[row] > 0.35).mean() > 0.5
    paths = changed.save(tmp_path)
    again = rt.io.geometry_files.path_tracing(rt.Room.from_file(paths[0]), n_paths=320)
    assert again.geometry.materials[1] == "east, changed"
    t = np.nanmean(again.simulate(again.room.alpha, seed=2).values["t20"], axis=0)
    after = finding.case.times[1]
    np.testing.assert_allclose(t, after, rtol=0.25)


# Law: a gain that changed between two states is said, and changes no result


@pytest.fixture(scope="module")
def states_gain():
    """Return two states whose level has a reference that nobody states."""
    before, after = (of_values(state, state.values) for state in two_states())
    return before, after


def of_values(state, values):
    renamed = {"level" if name == "g" else name: of for name, of in values.items()}
    return replace(state, values=renamed, uncertainty={}, common_uncertainty={})


def with_gain(state, gain):
    off = np.array([[gain.get(source, 0.0)] for source, _ in state.pairs])
    return of_values(state, {**state.values, "level": state.values["level"] + off})


def without_level(state):
    return of_values(state, {k: v for k, v in state.values.items() if k != "level"})


def found(before, after):
    model = simulator(dict.fromkeys(PLACES, POINT))
    return rt.find(model.room, after, model, before=before)


@pytest.mark.long
def test_another_gain_in_one_state_is_said_first_and_the_level_left_out(states_gain):
    before, after = states_gain
    wanted = found(without_level(before), without_level(after))
    for gain in (-3.0, 3.0, 37.0):
        got = found(with_gain(before, dict.fromkeys(PLACES, gain)), after)
        assert got.reasons[0].code == "gains differ"
        assert got.surfaces == pytest.approx(wanted.surfaces, abs=1e-6)
    of_one = found(before, with_gain(after, {"S2": 5.0}))  # the level of the other counts
    assert [*of_one.reasons[0].values["gains"]] == ["S2"]
    assert of_one.identified_surfaces == ("east",)


@pytest.mark.long
def test_one_gain_in_both_states_changes_nothing(states_gain):
    gain = {source: 20.0 * i for i, source in enumerate(PLACES)}
    plain, both = found(*states_gain), found(*(with_gain(state, gain) for state in states_gain))
    assert not any("level" in str(note) for note in plain.notes)
    assert (both.reasons, both.notes) == ((), plain.notes)
    assert both.surfaces == pytest.approx(plain.surfaces, abs=1e-6)
