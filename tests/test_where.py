"""Say where: the wall of a shoebox on which something stands, and what follows from it."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.claim import Detection
from rtcal.finder.effects import Absorber, library
from rtcal.finder.positions.search import THRESHOLD, find_by_positions, of_means
from rtcal.finder.positions.surfaces import merged, of_geometry, patched
from rtcal.simulators import PathTracing, Polyhedron
from rtcal.simulators.geometry import SHOEBOX_WALLS
from rtcal.support.errors import DataError, ModelError
from tests.conftest import in_geometry, measurement_of, room_of
from tests.test_where_corrected import L_PLAN, prism, triangulated

BANDS = (500.0, 1000.0, 2000.0)
SIZE = (7.0, 5.0, 3.0)
SOURCES = {"S1": (1.2, 1.0, 1.5), "S2": (5.6, 3.9, 1.4)}
RECEIVERS = {"R1": (5.5, 1.2, 1.2), "R2": (3.4, 2.4, 1.3), "R3": (1.5, 3.8, 1.2)}
ALPHA = {"west": 0.15, "east": 0.10, "south": 0.20, "north": 0.12, "floor": 0.15, "ceiling": 0.25}
MATCH = ("t20", "edt", "c80", "ts", "level")
HIDDEN = 6.0  # m², an opening in the middle of the east wall of 15 m²


def stated():
    box = Polyhedron.shoebox(SIZE, {w: f"{w} wall" for w in SHOEBOX_WALLS})
    alpha = np.array([[ALPHA[w]] * len(BANDS) for w in SHOEBOX_WALLS])
    return in_geometry(box, BANDS, alpha, surfaces=box.surfaces, dimensions=SIZE)


def tracing(room, geometry=None, **options):
    settings = {"n_paths": 1600, "scattering": 0.4} | options
    box = Polyhedron.shoebox(SIZE, {w: f"{w} wall" for w in SHOEBOX_WALLS})
    settings = {"geometry": geometry or box, "sources": SOURCES, "receivers": RECEIVERS} | settings
    return PathTracing(room=room, **settings)


def heard(tracer, alpha, level="g", match=MATCH):
    """Return what a tracing measures, with stated noise: 1 %, and 0.1 dB."""
    seen = tracer.observe(alpha, match, seed=7)
    rng = np.random.default_rng(3)
    values, uncertainty = {}, {}
    for p in match:
        name, value = (level if p == "level" else p), seen.natural(p)
        sigma = np.full(value.shape, 0.1) if p in ("c80", "level") else 0.01 * value
        values[name] = value + sigma * rng.standard_normal(value.shape)
        uncertainty[name] = sigma
    return measurement_of(BANDS, seen.pairs, u=uncertainty, **values)


@functools.cache
def measured(hidden, level="g", match=MATCH, scattering=0.5):
    """Return a measurement in the box, with other scattering; with or without the opening."""
    room = stated()
    tracer = tracing(room)
    geometry, alpha = tracer.geometry, room.alpha
    if hidden:
        made = patched(geometry, [1], HIDDEN, "hole", "hole")
        assert made is not None
        areas = np.append(room.areas, HIDDEN)
        areas[1] -= HIDDEN
        alpha = np.vstack([alpha, np.ones(len(BANDS))])
        room = room.replace(
            materials=[*room.materials, "hole"],
            areas=areas,
            alpha=alpha,
            sigma=np.vstack([room.sigma, room.sigma[:1]]),
            surfaces=(),
        )
        geometry = made
    return heard(tracing(room, geometry, scattering=scattering, n_paths=19200), alpha, level, match)


@pytest.fixture(scope="module")
def finding(kept):
    case = rt.finder.PositionsCase(simulator=tracing(stated()), measured=measured(True))
    return rt.find(case, cache=kept)


@pytest.fixture(scope="module")
def of_openings(kept):
    """The same of one effect alone, which is quick."""
    case = rt.finder.PositionsCase(simulator=tracing(stated()), measured=measured(True))
    return rt.find(case, only=["opening"], cache=kept)


@pytest.mark.long
def test_an_opening_is_found_on_its_wall(finding):
    assert finding.detected
    assert next(iter(finding.surfaces)) == "east"
    best = finding.best
    assert best.surface == "east"
    opening = next(c for c in finding.candidates if (c.effect, c.surface) == ("opening", "east"))
    assert opening.low < HIDDEN < opening.high
    assert finding.family.startswith("added absorption")


@pytest.mark.long
def test_nothing_is_found_where_nothing_is_hidden(kept):
    case = rt.finder.PositionsCase(simulator=tracing(stated()), measured=measured(False))
    finding = rt.find(case, cache=kept)
    assert finding.verdict in ("none", "hint")
    assert finding.surface is None
    with pytest.raises(DataError, match="Nothing to add"):
        finding.apply()


@pytest.mark.parametrize("name", ["score", "noise", "means"])
def test_a_score_that_is_no_number_is_refused(name):
    with pytest.raises(ModelError, match=rf"odds of {name} cannot be calculated"):
        Detection(**({"score": 0.0, "threshold": THRESHOLD} | {name: float("nan")}))


@pytest.mark.long
def test_an_absorbing_ceiling_over_walls_that_scatter_little_lacks_nothing(kept):
    room = stated()
    alpha = np.vstack([room.alpha[:-1], np.full((1, len(BANDS)), 0.6)])
    room = room.replace(alpha=alpha, sigma=0.1 * alpha)
    heard_little = heard(tracing(room, scattering=0.1, n_paths=19200), alpha)
    case = rt.finder.PositionsCase(simulator=tracing(room), measured=heard_little)
    finding = find_by_positions(case, library(), None, kept, 0, ())
    assert finding.score < 0.0
    assert finding.verdict == "none"


def test_the_user_says_where_on_which_surface(of_openings):
    """The most probable candidate on the surface at that place."""
    finding = of_openings
    made = finding.apply(at=(7.0, 2.2, 1.4))
    assert made.added.surface == "east"
    hole = made.geometry.names.index(made.material)
    middle = made.geometry.vertices[list(made.geometry.faces[hole])].mean(axis=0)
    assert middle == pytest.approx([7.0, 2.2, 1.4])
    others = tuple(c for c in finding.candidates if c.surface != "west")
    with pytest.raises(DataError, match="west"):
        replace(finding, candidates=others).apply(at=(0, 2, 1))
    with pytest.raises(DataError, match=r"at = \(3, 2, 1\) m"):
        finding.apply(at=(3, 2, 1))


@pytest.mark.long
def test_the_gap_shrinks_at_pairs_that_were_not_fitted(finding, kept):
    result = rt.finder.verify(finding, cache=kept)
    assert result.gaps.shape == (3, 1, 5, 6, 3)
    assert np.isfinite(result.gaps[-1]).all()
    assert result.verdict == "supported"
    assert finding.surface is None
    assert result.after < 0.8 * result.before
    assert result.gain > 0
    assert len(result.places) == len(finding.pairs)


def test_what_is_kept_is_not_simulated_again(of_openings, kept):
    again = rt.find(of_openings.case, only=["opening"], cache=kept)
    assert again.score == of_openings.score


def test_surfaces_join_the_faces_of_a_plane():
    box = Polyhedron.shoebox(SIZE, "plaster")
    made = patched(box, [1], 4.0, "plaster", "hole")
    room = room_of(
        {"plaster": (sum(made.areas.values()), 0.1, 0.02)}, BANDS, made.volume, name="box"
    )
    simulator = tracing(room, made)
    case = rt.finder.PositionsCase(simulator=simulator, measured=measured(False))
    assert len(case.faces) == 6
    assert max(len(faces) for faces in case.faces.values()) == 5
    two = rt.finder.PositionsCase(
        simulator=simulator,
        measured=measured(False),
        surfaces={"side": ["west"], "ends": ["south", "north"]},
    )
    assert {name: len(faces) for name, faces in two.faces.items()} == {"side": 1, "ends": 2}


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"surfaces": {"side": ["wset"]}}, "wset"),
        ({"surfaces": {}}, "surfaces"),
        ({"surfaces": {"a": ["west"], "b": ["west"]}}, "west"),
        ({"match": ("t20", "t15")}, "t15"),
        ({"position_uncertainty": 0.0}, "position_uncertainty"),
        ({"measured": rt.Measurement.from_values(BANDS, t20=[1, 1, 1])}, "means over pairs"),
        ({"exclude": [("S1", "R9")]}, "R9"),
        ({"exclude": [("S1", "R1", "R2")]}, "exclude"),
        ({"simulator": "calibrated"}, "calibrated"),
        ({"only": ["door"]}, "door"),
    ],
)
def test_a_wrong_case_is_refused(changes, place, kept):
    room, data = stated(), measured(False)
    options = {"only": changes.pop("only")} if "only" in changes else {}
    if changes.get("simulator") == "calibrated":
        changes = {"simulator": tracing(rt.calibrate(room, data).room)}
    arguments = {"simulator": tracing(room), "measured": data} | changes
    with pytest.raises(DataError, match=place):
        rt.find(rt.finder.PositionsCase(**arguments), cache=kept, **options)


@pytest.mark.long
def test_coefficients_that_are_all_off_are_no_surface(kept):
    """Half as much again of all coefficients, with the prior of a handbook, names no surface."""
    truth = tracing(stated(), n_paths=19200, scattering=0.5)
    room = stated().replace(sigma=0.3 * stated().alpha)
    data = heard(truth, 1.5 * stated().alpha)
    finding = rt.find(rt.finder.PositionsCase(simulator=tracing(room), measured=data), cache=kept)
    assert finding.surface is None


def test_the_next_position_is_free_and_informative(of_openings):
    finding = of_openings
    places = rt.finder.positions.next_position(finding, number=6)
    assert len(places) == 6 * len(SOURCES)
    assert places[0].pairs > places[-1].pairs > 0
    points = np.array([p.point for p in places])
    assert finding.case.geometry.contains(points).all()
    assert (finding.case.geometry.wall_distance(points) > 0.69).all()
    with pytest.raises(DataError, match="number = 0"):
        rt.finder.positions.next_position(finding, number=0)


# An effect of a user's own is one class, and both observation models find it where it may stand


@dataclass(frozen=True)
class Hatch(Absorber):
    """The hidden opening, under a name that rtcal does not have."""

    name: ClassVar[str] = "hatch"
    family: ClassVar[str] = "added absorption, hatches"
    stands_on: ClassVar[Sequence[str]] = ("wall",)

    def spectrum(self, frequencies, parameters):
        return np.full(len(frequencies), 0.98)


OWN = [e for e in rt.finder.library() if e.name != "opening"] + [Hatch()]


@pytest.fixture(scope="module")
def case():
    return rt.finder.PositionsCase(
        simulator=tracing(stated(), n_paths=800), measured=measured(True)
    )


@pytest.mark.long
def test_it_is_found_on_the_wall_where_it_stands(case, kept):
    finding = rt.find(case, effects=OWN, cache=kept)
    hatches = [c for c in finding.candidates if c.effect == "hatch"]
    assert hatches[0].surface == "east"
    assert hatches[0].low < 6.0 < hatches[0].high
    assert {c.surface for c in hatches} == {"east", "west", "north", "south"}
    assert finding.probabilities["hatch"] > 0.05
    assert "opening" not in finding.probabilities
    verified = rt.finder.verify(finding, cache=kept)
    assert verified.after < 0.9 * verified.before


@pytest.mark.long
def test_it_is_found_by_means_over_positions(case):
    finding = rt.find(of_means(case), effects=OWN)
    assert finding.families["added absorption, hatches"] > 0.05


# A pair that is left out is as one that was not measured; what is taken together is said


def test_a_pair_left_out_is_as_one_that_is_not_there():
    """T20 alone refused ``exclude``."""
    room, heard = stated(), measured(False)
    out = [pair for pair in heard.pairs if pair[1] == "R3"]
    some = {name: place for name, place in RECEIVERS.items() if name != "R3"}
    left_out = rt.calibrate_simulator(tracing(room, n_paths=800), room, heard, exclude=out)
    absent = rt.calibrate_simulator(
        tracing(room, n_paths=800, receivers=some),
        room,
        heard.select([pair for pair in heard.pairs if pair not in out]),
    )
    np.testing.assert_allclose(left_out.room.alpha, absent.room.alpha, rtol=1e-9)
    assert "Left out, as asked for: S1 to R3, S2 to R3." in left_out.notes


def test_faces_of_other_names_on_one_surface_are_said():
    mesh = triangulated(prism(L_PLAN))
    assert merged(mesh, of_geometry(mesh)) == ""
    part = mesh.names.index("wall 1 2")
    names = ["panel" if i == part else name for i, name in enumerate(mesh.names)]
    panelled = replace(mesh, names=names)
    assert "panel as part of wall 1" in merged(panelled, of_geometry(panelled))
