"""`rtcal.learn`: the model by dense algebra, what it finds, its library, its command, bad input."""

import json

import numpy as np
import pytest

import rtcal as rt
from rtcal.calibration import archive as model
from rtcal.calibration.archive import Evidence, RoomData, Spread
from rtcal.support.errors import DataError
from tests.conftest import also

SPREAD = Spread(table=0.9, between=0.3, room=0.05, together=0.1, equation=0.02, correlation=0.6)


def small():
    rng = np.random.default_rng(0)
    mu = rng.uniform(0.1, 0.5, (3, 2))
    sigma = 0.3 * mu
    rooms = []
    for r in range(4):
        areas = rng.uniform(10, 60, (1 + (r == 1), 3)) * (np.arange(3) != r)  # one has two states
        target = areas @ mu * rng.uniform(0.8, 1.2, 2)
        rooms.append(RoomData(areas, target, np.diag((0.02 * target.ravel()) ** 2)))
    return rooms, mu, sigma, np.log2([500.0, 1000.0])


def test_plausible_spreads_have_the_covariance_that_the_cost_leaves():
    evidence = Evidence(*small())
    fitted = evidence.fitted()
    centre = model._point(fitted)
    off = np.array([model._point(each) for each in evidence.plausible(fitted)]) - centre
    step = 0.02 * np.eye(len(centre))
    cost = lambda x: evidence._cost(centre + x, None)  # noqa: E731
    curvature = np.array(
        [
            [(cost(a + b) - cost(a - b) - cost(b - a) + cost(-a - b)) / (4 * 0.02**2) for a in step]
            for b in step
        ]
    )
    np.testing.assert_allclose(off.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(off.T @ off / len(off) @ curvature, np.eye(len(centre)), atol=0.1)


def test_the_posterior_is_that_of_all_unknowns_by_dense_algebra():
    """Every d, h, e and g as an unknown of its own, conditioned on b."""
    rooms, mu, sigma, octaves = small()
    n, k = mu.shape
    evidence = Evidence(rooms, mu, sigma, octaves)
    rho = np.array([[1, 0.6], [0.6, 1]])
    columns = []  # of b (rooms x states x bands) per unknown
    entry = []  # of the entries per unknown
    root = np.linalg.cholesky(rho)

    def of(room, values):
        return np.concatenate([(values if r == room else 0 * d.target).ravel() for r, d in each])

    each = list(enumerate(rooms))
    for i in range(n):
        for c in range(k):
            shift = SPREAD.table * sigma[i] * root[:, c]
            columns.append(sum(of(r, np.outer(d.areas[:, i], shift)) for r, d in each))
            entry.append(np.kron(np.eye(n)[i], shift))
    columns.append(sum(of(r, SPREAD.together * d.areas @ mu) for r, d in each))
    entry.append(SPREAD.together * mu.ravel())
    for r, d in each:
        for i in range(n):
            for c in range(k):
                shift = SPREAD.between * sigma[i] * root[:, c]
                columns.append(of(r, np.outer(d.areas[:, i], shift)))
                entry.append(np.zeros(n * k))
        columns.append(of(r, SPREAD.room * d.areas @ mu))
        entry.append(np.zeros(n * k))
        for one in np.eye(d.target.size).reshape(-1, *d.target.shape):
            columns.append(of(r, np.hypot(SPREAD.equation, 0.02) * d.target * one))
            entry.append(np.zeros(n * k))
    matrix, entries = np.array(columns).T, np.array(entry).T
    whole = matrix @ matrix.T
    np.testing.assert_allclose(evidence.covariance(SPREAD), whole, rtol=1e-10)
    miss = np.concatenate([(d.target - d.areas @ mu).ravel() for d in rooms])
    gain = entries @ matrix.T @ np.linalg.inv(whole)
    mean, covariance = evidence.posterior(SPREAD, np.ones(len(miss), dtype=bool))
    np.testing.assert_allclose(mean.ravel(), mu.ravel() + gain @ miss, rtol=1e-9)
    np.testing.assert_allclose(
        covariance, entries @ entries.T - gain @ matrix @ entries.T, atol=1e-12
    )
    assert np.abs(mean - mu).max() > 0.01
    pull = SPREAD.together * matrix[:, n * k]  # the column of h, in standard deviations
    expected = pull @ np.linalg.solve(whole, miss), pull @ np.linalg.solve(whole, pull)
    off, variance = evidence.together(SPREAD)
    np.testing.assert_allclose(off, expected[0], rtol=1e-9)
    np.testing.assert_allclose(variance, SPREAD.together**2 - expected[1], rtol=1e-9)
    assert abs(off) > 1e-3


@pytest.fixture(scope="module")
def rooms():
    room, _ = rt.datasets.bras_cr2()
    room = room.replace(surfaces=())
    t = 1.2 * rt.Eyring().reverberation_time(room)
    shapes = [1.0, [1, 2, 1, 0.5, 1], [2, 1, 1, 1, 0.5]]
    return [
        rt.calibrate(room.replace(name=name, areas=room.areas * shape), t)
        for name, shape in zip("ABC", shapes, strict=True)
    ]


def test_the_order_of_rooms_changes_nothing(rooms):
    archive = rt.learn(rooms)
    turned = rt.learn(rooms[::-1])
    order = [turned.materials.index(m) for m in archive.materials]
    np.testing.assert_allclose(turned.alpha[order], archive.alpha, atol=1e-4)
    left = rt.learn(rooms[:2])
    assert (left.seen == 2).all()
    assert (archive.mean_sigma <= left.mean_sigma + 5e-3).all()


@pytest.mark.parametrize("stated", [{"volume_sigma": 0.05}, *also({})])
def test_how_a_room_was_calibrated_does_not_matter(rooms, stated):
    """Nor does it where no coefficient gives the measured T, and the nearest within reach was taken."""
    priors = [r.prior.replace(**stated) for r in rooms]
    short = 0.04 * rooms[0].measured

    times = [short, *(r.measured for r in rooms[1:])]

    def learnt(method):
        each = zip(priors, times, strict=True)
        return rt.learn([rt.calibrate(p, t, method, unreachable="nearest") for p, t in each])

    exactly = learnt("mle")
    for method in ("lse", "soft", "robust"):
        other = learnt(method)
        np.testing.assert_array_equal(other.alpha, exactly.alpha)
        np.testing.assert_array_equal(other.sigma, exactly.sigma)
        assert other.lessons == exactly.lessons


def test_rooms_that_differ_too_far_give_no_room(rooms):
    far = [
        rt.calibrate(rooms[i % 3].prior.replace(name=str(i)), t, "soft", unreachable="nearest")
        for i, t in enumerate(rooms[i % 3].measured * f for i, f in enumerate([0.1, 20] * 4))
    ]
    archive = rt.learn(far)
    with pytest.raises(DataError, match="the archive's rooms differ from each other"):
        archive.apply(rooms[0].prior.replace(name="new"))


def test_configurations_are_learned_as_one_room(rooms, tmp_path):
    full = rooms[0].prior
    bare = full.replace(name="bare", areas=full.areas * [1, 1, 1, 1, 0.3])
    pair = rt.Configurations([full, bare])
    times = [rt.Eyring().reverberation_time(r.replace(alpha=0.8 * r.alpha)) for r in pair.rooms]
    joint = rt.calibrate(pair, times, "soft")
    archive = rt.learn([joint, *rooms[1:]])
    assert [lesson.room for lesson in archive.lessons] == ["A", "B", "C"]
    assert archive.lessons[0].degrees_of_freedom == 2 * full.n_bands
    assert (len(archive.measured), archive.seen.tolist()) == (4, [3] * 5)
    with pytest.raises(DataError, match="archive that contains these data"):
        rt.calibrate(archive.apply(bare), times[1])
    for i, result in enumerate((joint, *rooms[1:])):
        result.save(tmp_path / str(i))
    assert rt.learn(rt.archive.read_folder(tmp_path)).lessons == archive.lessons


def test_the_library_is_the_next_calibrations_input(rooms):
    archive = rt.learn(rooms, names={"floor": "linoleum"})
    new = rooms[0].prior.replace(name="new")
    known = archive.apply(new, names={"floor": "linoleum"})
    i = archive.materials.index("linoleum")
    assert (known.alpha[new.materials.index("floor")] == archive.alpha[i]).all()
    assert known.sources["floor"] == "archive of 3 rooms, in 3 of them"
    assert known.common_alpha_sigma == archive.room_sigma
    t = 1.01 * rooms[0].measured
    result = rt.calibrate(known, t)
    assert result.certificate.worst < 1e-9
    assert abs(result.gap_before).max() < abs(rooms[0].gap_before).max()
    again = rt.Room.from_text(known.to_text(), "room.toml")
    assert again.common_alpha_sigma == known.common_alpha_sigma
    other = new.replace(materials=[f"x{i}" for i in range(new.n_materials)], sources={})
    with pytest.raises(DataError, match="none of the materials"):
        archive.apply(other)
    with pytest.raises(DataError, match="is not a material of the archive"):
        archive.material("floor")
    with pytest.raises(DataError, match="names"):
        archive.apply(new, names={"roof": "linoleum"})


def test_a_name_with_another_table_is_another_material(rooms):
    """CR3's plaster absorbs twice as much by its table as CR2's: they have only the name in common."""
    room, other = rooms[0].prior, rooms[1].prior
    i = room.material_index("plaster")
    alpha = other.alpha.copy()
    alpha[i] += 1.5 * np.hypot(room.sigma[i], other.sigma[i])
    apart = rt.calibrate(other.replace(alpha=alpha), rooms[1].measured)
    archive = rt.learn([rooms[0], apart, rooms[2]])
    assert archive.materials[-1] == "plaster (B)"
    assert dict(zip(archive.materials, archive.seen.tolist(), strict=True)) == {
        **dict.fromkeys(room.materials, 3), "plaster": 2, "plaster (B)": 1
    }  # fmt: skip
    new = apart.prior.replace(name="new")
    assert (archive.apply(new).alpha[i] == alpha[i]).all()
    assert '"plaster"' in archive.left_as_stated(new)[0]
    for called, entry in (("plaster (B)", -1), ("plaster", i)):
        known = archive.apply(new, names={"plaster": called})
        assert (known.alpha[i] == archive.alpha[entry]).all()
    assert rt.learn([rooms[0], apart], names={"plaster": "plaster"}).materials == room.materials
    # With the record of an archive the same coefficients are no table.
    made = archive.apply(new, names={"plaster": "plaster"}).replace(alpha=alpha)
    again = rt.learn([rooms[0], rt.calibrate(made, 1.02 * rooms[1].measured)])
    assert again.materials == room.materials
    assert again.left_as_stated(made) == ()


def test_a_material_that_it_does_not_know_is_off_as_all_tables_are(rooms):
    """Its table moves by h and is less certain by it; an exact one, and what data made, do not."""
    archive = rt.learn(rooms)
    assert archive.together < -0.02  # T is 1.2 times what the tables say
    assert 0.01 < archive.together_sigma < archive.spread.together
    old = rooms[0].prior
    sigma = old.sigma.copy()
    sigma[2] = 0
    materials = ["plaster", "moss", "mirror", *old.materials[3:]]
    new = old.replace(name="new", materials=materials, sigma=sigma, sources={"moss": "a handbook"})
    known = archive.apply(new)
    np.testing.assert_allclose(known.alpha[1], (1 + archive.together) * new.alpha[1])
    off = archive.together_sigma * new.alpha[1]
    np.testing.assert_allclose(known.sigma[1], np.hypot(new.sigma[1], off))
    assert known.sources["moss"] == f"a handbook times {1 + archive.together:.2f}"
    assert (known.alpha[2] == new.alpha[2]).all()
    assert (known.sigma[2] == 0).all()
    assert archive.left_as_stated(new)[1].endswith('does not contain them: "mirror".')
    again = archive.apply(known)
    np.testing.assert_array_equal(again.alpha, known.alpha)
    assert again.sources == known.sources


def test_the_command_reads_a_folder_and_writes_a_room(rooms, tmp_path, rtcal):
    for result in rooms:
        result.save(tmp_path / "rooms" / result.prior.name)
    rooms[0].prior.save(str(tmp_path / "new.toml"))
    out = tmp_path / "library"
    learn = ("learn", tmp_path / "rooms", "--out", out, "--json")
    applied = ("--as", "floor=linoleum", "--apply", tmp_path / "new.toml")
    record = json.loads(rtcal(*learn, *applied))
    assert record["left_as_stated"] == []
    assert [m["rooms"] for m in record["materials"]] == [3] * 5
    made = rt.Room.from_file(str(out / "room.toml"))
    assert "linoleum" not in made.materials
    assert "archive" in made.sources["floor"]
    assert made.common_alpha_sigma > 0
    assert rt.load(out).materials[3] == "linoleum"

    # A name of the next room alone.
    renamed = rooms[0].prior.replace(materials=["gypsum", *rooms[0].prior.materials[1:]])
    renamed.replace(sources={}).save(str(tmp_path / "renamed.toml"))
    applied = ("--as", "gypsum=plaster", "--apply", tmp_path / "renamed.toml")
    assert json.loads(rtcal(*learn, *applied))["left_as_stated"] == []


def test_bad_input_is_named(rooms):
    for stated, message in (
        (([rooms[0]],), "1 calibrated rooms are given; an archive"),
        (([rooms[0], rooms[0]],), 'room "A" occurs twice'),
        (([rooms[0], "B"],), r"rooms\[1\]"),
        ((rooms, {"roof": "plaster"}), '"roof" is not a material of any room'),
        ((rooms, {"floor": "plaster"}), 'two of its materials are "plaster"'),
    ):
        with pytest.raises(DataError, match=message):
            rt.learn(*stated)
    room = rooms[0].prior.replace(
        name="other bands", centre_frequencies=[160, 315, 630, 1250, 2500, 5000]
    )
    apart = rt.calibrate(room, rooms[0].measured)
    with pytest.raises(DataError, match="no band in common"):
        rt.learn([rooms[0], apart])
