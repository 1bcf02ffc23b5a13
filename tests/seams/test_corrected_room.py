"""Law: what a model's state has, its corrected room, simulator and files have, or they say what not."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

import rtcal as rt
from rtcal.acoustics.equations import mean_equation
from rtcal.finder import Case, recalibrate
from rtcal.finder.apply import corrected_case
from rtcal.finder.effects import AppliedEffect, Effect, checked_grid, library
from rtcal.finder.means.problem import distances, state
from rtcal.finder.model import FEATURES, RoomState, predict
from rtcal.simulators.external import of_equation
from rtcal.support.errors import DataError
from tests.conftest import also, measurement_of

ROUNDING = 1e-9
ONLY_DECAY = "decay not in a room"


@dataclass(frozen=True)
class Own(Effect):
    """A user's effect, which changes a state as a function says."""

    called: str
    by: Callable[[RoomState, float], RoomState]

    size = "much"
    unit = ""

    @property
    def name(self):
        return self.called

    def grid(self, state):
        return [{"much": x} for x in (0.2, 0.5, 0.9)]

    def change(self, state, parameters):
        return self.by(state, parameters["much"])


def repainted(s, much):
    """Change some bands of one material, and raise another."""
    alpha = np.array(s.alpha)
    alpha[0, ::2] *= 1 - much
    alpha[-1] += much * (1 - alpha[-1])
    return replace(s, alpha=alpha)


def hung_and_bent(s, much):
    """Absorb, and listen at the end of a decay with a noise floor."""
    return replace(s.covered(20 * much, np.full_like(s.air, 0.8)), floor_db=-40.0)


OWN = [
    Own("repainted", repainted),
    Own("taken out", lambda s, much: s.with_objects(-10 * much * np.ones_like(s.air))),
    Own(
        "shelf",
        lambda s, much: s.covered(20 * much, np.full_like(s.air, 0.7)).with_objects(9 * much),
    ),
    Own("hung and bent", hung_and_bent),
    Own("damp air", lambda s, much: replace(s, air=s.air + 1e-3 * much)),
    Own("helium", lambda s, much: replace(s, speed_of_sound=s.speed_of_sound * (1 + much))),
]
EVERY = [*library(), *OWN]


@pytest.fixture(scope="module")
def case():
    return rt.datasets.hidden_room()[0]


def of(effect, case, place):
    """Return the effect with the parameters at this place of its grid, from 0 to 1."""
    grid = checked_grid(effect, state(case, case.configurations[0]), case.room)
    return AppliedEffect(effect, grid[round(place * (len(grid) - 1))])


def same(got, wanted, what):
    np.testing.assert_allclose(got, wanted, rtol=ROUNDING, atol=1e-12, err_msg=what)


def agree(case):
    """Compare everything that is made of a case with its state."""
    (first,) = (replace(c, changes={}, air=None) for c in case.configurations[:1])
    whole, at = state(case, first), distances(case, first)
    wanted = predict([whole], at).features[0]
    if all(p.effect in library() for p in case.applied):
        again = Case.from_dict(json.loads(case.to_json()))
        np.testing.assert_array_equal(predict([state(again, first)], at).features[0], wanted)

    made = corrected_case(case)
    room, absent = made.room, made.notes
    model = made.simulator().simulate(room.alpha)
    rows = dict(zip(FEATURES, wanted, strict=True))
    t20 = np.exp(rows["t20"])
    for name, value in (
        ("t20", t20),
        ("edt", t20 * np.exp(rows["edt"])),
        ("t30", t20 * np.exp(rows["t30"])),
        ("c80", rows["c80"]),
        ("g", rows["g"]),
    ):
        same(model.mean(name), value, f"the model's {name}")

    equation = mean_equation(whole.equation)
    absorbed = equation.exponent(room.areas @ equation.contribution(room.alpha) / room.total_area)
    got = room.total_area * absorbed + 4 * room.air_attenuation * room.volume
    area = whole.surface_absorption + whole.objects + 4 * whole.air * whole.volume
    lacks = {note.code for note in absent if "effect" in note.values} - {ONLY_DECAY}
    # A room's speed of sound is that of its air, as the model's is. What a user's own effect does to
    # it is said.
    speeds = whole.speed_of_sound, room.speed_of_sound
    if not any(p.name == "helium" for p in case.applied):
        assert speeds[0] == speeds[1]
    assert any(note.code == "speed of sound" for note in absent) == (speeds[0] != speeds[1])
    time = 6 * np.log(10) / whole.rate * speeds[0] / speeds[1]
    if lacks:
        assert np.abs(got / area - 1).max() > ROUNDING  # else the note would be wrong
        if lacks <= {"hides wall", "takes absorption"}:
            assert (got >= area * (1 - ROUNDING)).all()  # they keep the stated areas, which absorb
    else:
        same(got, area, "the room's absorption area")
        same(equation.reverberation_time(room), time, "the room's T")
    read = rt.Room.from_text(room.to_text(), "room.toml")
    same(equation.reverberation_time(read), equation.reverberation_time(room), "the file's T")

    if whole.equation == "millington":
        return  # it counts a patch otherwise than a wall that is as absorbing on average
    spread, refused = None, ""
    try:
        spread = made.simulator(lambda r: of_equation(equation, r))
    except DataError as error:
        refused = str(error)
    if spread is None:
        effects = [str(note.values.get("effect", "-")) for note in absent]
        assert any(effect in refused.lower() for effect in effects), refused
        return
    # Walls that absorb less on average represent what no further material does.
    same(spread.simulate(room.alpha).mean("t20"), time, "the simulator's T")


def test_what_is_stated_of_the_areas_stays_in_the_corrected_room(case):
    room = case.room.replace(area_sigma=0.05, surfaces=())
    porous = next(e for e in library() if e.name == "porous")
    made = corrected_case(replace(case, room=room, applied=[of(porous, case, 0.5)])).room
    assert made.area_sigma.tolist() == [*[0.05] * room.n_materials, 0.0]


@pytest.mark.parametrize("equation", ["eyring", *also("millington", "sabine", "kuttruff")])
@pytest.mark.parametrize("effect", EVERY, ids=lambda e: str(e.name))
def test_an_effect_alone(case, effect, equation):
    for place in (0.0, 1.0):
        p = of(effect, case, place)
        changed = replace(case, equation=equation, applied=[p])
        agree(changed)
        ends = (0.9, 1.0)
        if np.isfinite(effect.neutral) and effect.size not in effect.discrete:
            size = p.parameters[effect.size]
            interval = tuple(sorted(x * size for x in ends))
            agree(replace(changed, applied=[replace(p, size_interval=interval)]))


@pytest.mark.parametrize("every", [5, *also(1)])
@pytest.mark.parametrize("i", range(len(EVERY)), ids=lambda i: str(EVERY[i].name))
def test_two_effects(case, i, every):
    """Each pair once, or one in so many; of an effect's pairs, every second has it first."""
    for j in range(i % every, i, every):
        applied = [of(EVERY[i], case, 0.5), of(EVERY[j], case, 0.65)]
        agree(replace(case, applied=applied if (i + j) % 2 else applied[::-1]))


@pytest.mark.parametrize("effect", EVERY, ids=lambda e: str(e.name))
def test_the_calibrated_room_has_the_calibrated_model_s_time(case, effect):
    """And that is the measured one: here that of the model with the effect, known to 3 %."""
    (first,) = case.configurations[:1]
    applied = [of(effect, case, 0.35)]
    times = predict(
        [state(replace(case, applied=applied), first, 0.95 * case.room.alpha)],
        distances(case, first),
    ).reverberation_time
    measured = measurement_of(case.room.centre_frequencies, u={"t20": 0.03 * times}, t20=times)
    at = replace(first, changes={}, air=None, distances=None, measured=measured)
    changed = replace(case, applied=applied, configurations=[at])
    calibrated = recalibrate(changed)
    assert calibrated.off < 0.5
    known = {"equation", "no place", "speed of sound", "input changed"}
    if any(note.code not in known for note in corrected_case(changed).notes):
        return  # `agree` shows that the room lacks it
    after = state(changed, at)
    equation = replace(mean_equation(after.equation), speed_of_sound=after.speed_of_sound)
    same(
        equation.reverberation_time(calibrated.room),
        np.exp(calibrated.features[0, FEATURES.index("t20")]),
        "the calibrated room's T",
    )
