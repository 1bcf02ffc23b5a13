"""The change between two measurements of one room, from T alone."""

from dataclasses import replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.room import times_of
from rtcal.finder import StatesCase
from tests.conftest import measurement_of
from tests.two_states import BANDS, measured, room, times


@pytest.fixture(scope="module")
def panels():
    """Return what is found of 12 m² of panels, from six sources."""
    return rt.find(room(), measured(times(12), 2, uneven=0.03), before=measured(times(), 1))


@pytest.fixture(scope="module")
def many():
    """The same of 24 m², with which T is met in every band."""
    return rt.find(room(), measured(times(24), 2, uneven=0.03), before=measured(times(), 1))


def test_panels_are_found_with_their_amount_and_spectrum(panels):
    assert panels.verdict == "family"
    assert panels.family.startswith("added absorption")
    assert panels.probabilities["none"] < 1e-6
    assert panels.spectrum == "rising with frequency"
    eyring = rt.Eyring()
    truth = np.diff([eyring.absorption_area(room(), times(n)) for n in (0, 12)], axis=0)[0]
    low, high = panels.change[1:]
    assert np.mean((low <= truth) & (truth <= high)) >= 5 / 6
    np.testing.assert_allclose(panels.size.mean, truth[2:5].mean(), rtol=0.15)
    assert panels.size.low < truth[2:5].mean() < panels.size.high
    assert panels.surfaces == {}
    assert "on which surface" in str(panels)


def test_changes_that_cancel_have_one_orientation():
    two = [
        measurement_of([500, 1000], u={"t20": [u]}, t20=[t])
        for t, u in (([1.0, 2.0], [0.125, 0.25]), ([2.0, 1.0], [0.25, 0.125]))
    ]
    some = room().replace(alpha=np.full((3, 2), 0.1), sigma=np.full((3, 2), 0.1),
                          centre_frequencies=[500, 1000])  # fmt: skip
    forth, back = (StatesCase(room=some, before=b, after=a) for b, a in (two, two[::-1]))
    assert forth.change.sum() == 0
    assert forth.falls != back.falls


def test_pairs_that_one_state_lacks_are_left_out_and_said():
    before, after = measured(times(), 1), measured(times(12), 2)
    some = after.select(after.pairs[:4])
    found = StatesCase(room=room(), before=before, after=some)
    assert found.change.shape == (4, 6)
    assert any("Only before has S4 to R1 and 1 more" in str(note) for note in found.notes)


def test_states_without_a_common_pair_are_refused():
    before = measured(times(), 1)
    other = replace(before, pairs=[(f"T{i}", "R1") for i in range(6)])
    with pytest.raises(rt.errors.DataError, match="no source-receiver pair in common"):
        StatesCase(room=room(), before=before, after=other)
    edt, shorter = (rt.Measurement.from_values(BANDS, edt=f * times()) for f in (1.0, 0.9))
    with pytest.raises(rt.errors.DataError, match="T20 or T30"):
        StatesCase(room=room(), before=edt, after=shorter)


@pytest.mark.long
def test_t_that_is_missed_is_never_supported(panels):
    """The gap shrinks from 9 to 1 JND; T at 1 kHz is off by more than 1 JND and than it may be."""
    verification = rt.finder.verify(panels)
    assert verification.gain > verification.needed
    assert verification.verdict == "unproven"
    (miss,) = verification.misses
    assert abs(miss.model / miss.measured - 1) > 0.05
    assert abs(miss.model - miss.measured) > miss.uncertainty


@pytest.mark.long
def test_an_earlier_finding_predicts_the_pairs_that_it_had_not(many):
    case = many.case
    some = case.before.pairs[:4]
    earlier = rt.find(case.room, case.after.select(some), before=case.before.select(some))
    result = rt.finder.verify(earlier, before=case.before, after=case.after)
    assert result.verdict == "supported"
    assert result.gaps.shape == (2, 1, 1, 2, 6)
    assert result.to_dict()["places"] == [" to ".join(p) for p in case.before.pairs[4:]]
    np.testing.assert_allclose(
        result.gaps[0, 0, 0], -many.case.change[4:] / np.log(1.05), rtol=1e-9
    )
    # Another change than the one that was found is not predicted.
    other = rt.finder.verify(earlier, before=case.after, after=case.before)
    assert other.verdict == "withdrawn"
    with pytest.raises(rt.errors.DataError, match="before and after have 0 pairs that were"):
        rt.finder.verify(earlier, before=case.before.select(some), after=case.after)
    with pytest.raises(rt.errors.DataError, match="after is missing"):
        rt.finder.verify(earlier, before=case.before)


def test_the_changed_room_has_t_of_the_second_state(panels):
    """The room spreads 12 m² on a wall over all materials, and says so."""
    changed = panels.apply()
    t = rt.Eyring().reverberation_time(changed.room)
    np.testing.assert_allclose(t, panels.case.times[1], rtol=0.08)
    np.testing.assert_allclose(
        changed.room.areas @ changed.room.alpha, panels.area + panels.change[0]
    )
    assert (changed.room.alpha <= 1).all()
    assert "surface unknown" in {note.code for note in changed.notes}
    says = changed.room.sources.values()
    assert list(says) == ["changed by rtcal find: two states"] * changed.room.n_materials
    assert np.isnan(times_of(changed.room)).all()  # the record's T is that of the first state
    result = rt.calibrate(changed.room, panels.case.after, method="soft")
    assert np.abs(result.shift_in_sigmas).max() < 1
    back = rt.find(panels.case.room, panels.case.before, before=panels.case.after).apply()
    # The same change in m² off the larger area of the second state: its noise counts, too.
    np.testing.assert_allclose(
        rt.Eyring().reverberation_time(back.room), panels.case.times[0], rtol=0.1
    )


def test_the_command_states_how_many_pairs_a_verification_needs(tmp_path, rtcal):
    after = measured(times(24), 2)
    few = rt.find(room(), after.select(after.pairs[:2]), before=measured(times(), 1))
    assert few.detected
    few.save(tmp_path / "changed")
    said = rtcal.refused("verify", tmp_path / "changed")
    assert "has 2 source-receiver pairs, but a verification needs at least 4" in said
    with pytest.raises(rt.errors.DataError, match="no change was found that can be verified"):
        rt.finder.verify(replace(few, verdict="none"))
