"""The room of a page: its data, its still pictures, its table, and what may run."""

import base64
import hashlib
import json
import re

import numpy as np
import pytest

import rtcal as rt
from rtcal.report import document, pages, room_view
from rtcal.simulators.geometry import Polyhedron
from tests.report.pages import EVIL, no_figure
from tests.report.rooms import calibrated

pytest.importorskip("jinja2", reason="needs the extra report")

BOX = Polyhedron.shoebox((5, 7, 3), {w: w for w in rt.simulators.geometry.SHOEBOX_WALLS})


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return calibrated(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="module")
def html(result):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(document, "source", no_figure)
        return pages.page(result)


def data_of(html):
    (text,) = re.findall(r'<script type="application/json" id="room-data">(.*?)</script>', html)
    return json.loads(text)


def test_the_data_are_the_rooms_and_the_calibrations(html, result):
    data = data_of(html)
    assert data["parts"] == list(result.prior.materials)
    corners = np.array(data["points"]).reshape(-1, 3)[data["triangles"]].reshape(-1, 3, 3) / 1000
    areas = (
        np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        / 2
    )
    of_part = np.bincount(data["owners"], areas)
    np.testing.assert_allclose(of_part, result.prior.areas, rtol=1e-4)  # rounded to millimetres
    after, shift, before = (np.array(q["values"], dtype=float) for q in data["quantities"])
    np.testing.assert_allclose(after[:, 1:], result.alpha, atol=5e-5)
    np.testing.assert_allclose(after[:, 0], result.alpha.mean(axis=1), atol=5e-5)
    np.testing.assert_allclose(before[:, 1:], result.prior.alpha, atol=5e-5)
    moved = (result.alpha - result.prior.alpha) / result.prior.sigma
    np.testing.assert_allclose(shift[:, 1:], moved, atol=5e-5)
    assert data["quantities"][1]["high"] >= np.abs(moved).max()


def test_nothing_but_the_rooms_script_may_run(html, result):
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]+)"', html)
    (script,) = re.findall(r"<script>(.*?)</script>", html, re.S)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy.endswith(f"script-src 'sha256-{digest}'")
    assert "default-src 'none'" in policy
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)|\bfetch\b|import\(|eval\(", script)
    without = pages.page(rt.calibrate(*rt.datasets.bras_cr2()))
    assert "script" not in without


def test_evil_names_are_text(tmp_path, result):
    """In the data, in the table and in the pictures."""
    names = [EVIL, *result.prior.materials[1:]]
    box = rt.Room(
        name="box",
        volume=105,
        dimensions=(5, 7, 3),
        materials=[EVIL],
        areas=[142],
        alpha=[[0.1]],
        sigma=[[0.02]],
        centre_frequencies=[1000],
        scene=rt.Scene(sources={EVIL: (1, 1, 1)}, receivers={"R": (3, 3, 1)}),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(document, "source", no_figure)
        text = pages.page(rt.calibrate(box, [1.0]))
    assert data_of(text)["parts"] == names[:1]
    assert data_of(text)["stands"][0]["name"] == EVIL
    assert "<script>alert" not in text
    assert text.count("</script>") == 2
    assert text.count("&lt;script&gt;alert(1)") >= 3  # materials' tables and the picture


def test_a_mesh_that_is_gone_is_said_and_the_page_is_there(tmp_path):
    gone = calibrated(tmp_path)
    (tmp_path / "room.obj").unlink()
    (said,) = room_view.of_calibration(gone)
    assert "The room is not drawn" in said.text
    assert "room.obj" in said.text


def test_a_still_shows_three_walls_of_a_box_from_inside(result):
    (section,) = room_view.of_calibration(result)
    for tilt, seen in ((room_view.ABOVE, [0, 0, 1]), (room_view.BELOW, [0, 0, -1])):
        into = room_view.into_picture(section.turn(tilt), tilt)
        assert np.linalg.norm(into) == pytest.approx(1)
        inside = BOX.normals[BOX.normals @ into > 0]
        assert len(inside) == 3
        assert (-np.array(seen) == inside).all(axis=1).any()
    picture = section.stills[0]
    above, below, _ = picture.figure.axes
    for axes, wanted in ((above, room_view.ABOVE), (below, room_view.BELOW)):
        assert np.radians(axes.elev) == pytest.approx(wanted)
        (walls,) = axes.collections
        facing = section.geometry.normals @ room_view.into_picture(section.turn(wanted), wanted)
        assert len(walls.get_facecolor()) == (facing > 0).sum()
