"""Walls that are drawn as closed solids: the cavity between them is the room, or there is none."""

import itertools

import pytest

from rtcal.io import mesh
from rtcal.io.mend import MeshError
from rtcal.support.errors import DataError
from tests.conftest import also

Box = tuple[str, str, tuple[float, float, float], tuple[float, float, float]]
SIDES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6))
L, W, H, D = 7.0, 5.0, 3.0, 0.25
"""Length, width and height of the room, and the walls' thickness, in m."""
FLOOR = ("slab", "screed", (-D, -D, -D), (L + D, W + D, 0))
ROOF = ("roof", "concrete", (-D, -D, H), (L + D, W + D, H + D))
BUTT = [
    ("south", "brick", (-D, -D, 0), (L + D, 0, H)),
    ("north", "brick", (-D, W, 0), (L + D, W + D, H)),
    ("east", "brick", (L, 0, 0), (L + D, W, H)),
    ("west", "brick", (-D, 0, 0), (0, W, H)),
]
OVERLAPPING = [
    ("south", "brick", (-D, -D, 0), (L + D, 0, H)),
    ("north", "brick", (-D, W, 0), (L + D, W + D, H)),
    ("east", "brick", (L, -D, 0), (L + D, W + D, H)),
    ("west", "brick", (-D, -D, 0), (0, W + D, H)),
]
THROUGH = [  # walls that reach through slab and roof
    (name, material, (*low[:2], -D), (*high[:2], H + D))
    for name, material, low, high in OVERLAPPING
]


def obj(path, boxes, *, triangles=False, turned=False):
    rows, n = [], 0
    for name, material, low, high in boxes:
        rows += [f"o {name}", f"usemtl {material}"]
        for corner in itertools.product(*zip(low[::-1], high[::-1], strict=True)):
            rows.append("v " + " ".join(f"{x:.6g}" for x in corner[::-1]))
        for side in SIDES:
            face = [1 + n + k for k in (side[::-1] if turned else side)]
            parts = [face[:3], [face[0], *face[2:]]] if triangles else [face]
            rows += ["f " + " ".join(map(str, part)) for part in parts]
        n += 8
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("walls", [BUTT, OVERLAPPING, THROUGH])
@pytest.mark.parametrize("triangles", [False, True])
@pytest.mark.parametrize("turned", [False, *also(True)])
def test_the_cavity_between_solids_is_the_room(walls, triangles, turned, tmp_path):
    path = obj(tmp_path / "m.obj", [*walls, FLOOR, ROOF], triangles=triangles, turned=turned)
    done = mesh.room(path)
    assert done.volume == pytest.approx(L * W * H, rel=1e-4)
    areas = {"brick": 2 * (L + W) * H, "screed": L * W, "concrete": L * W}
    assert done.areas == pytest.approx(areas, rel=1e-3)
    # Joining may leave spikes of millimetres at joints, which are mended.
    assert done.defects[0].kind == "solids"
    assert done.volume_uncertainty < 1e-3 * done.volume


def test_furniture_stands_in_the_cavity(tmp_path):
    desk = ("desk", "wood", (2, 2, 0), (3, 3.5, 0.75))
    lamp = ("lamp", "steel", (2, 2, 2), (3, 3, 2.2))
    done = mesh.room(obj(tmp_path / "m.obj", [*BUTT, desk, FLOOR, lamp, ROOF]))
    assert done.volume == pytest.approx(L * W * H - 1.5 * 0.75 - 0.2, rel=1e-6)
    assert done.areas["wood"] == pytest.approx(1.5 + 2 * 2.5 * 0.75, rel=1e-6)
    assert done.areas["screed"] == pytest.approx(L * W - 1.5, rel=1e-6)
    assert done.areas["steel"] == pytest.approx(2 * 1 + 4 * 0.2, rel=1e-6)


@pytest.mark.parametrize("missing", [0, *also(*range(1, 6))])
def test_solids_without_a_cavity_bound_material_and_no_option_makes_a_room(
    missing, tmp_path, rtcal
):
    boxes = [*BUTT, FLOOR, ROOF]
    del boxes[missing]
    path = obj(tmp_path / "m.obj", boxes)
    with pytest.raises(MeshError, match="do not enclose a room"):
        mesh.room(path)
    for option in ([], ["--open"], ["--weld", "0.02"]):
        assert "do not enclose a room" in rtcal.refused("import", "check", path, *option)
    out = tmp_path / "room.toml"
    rtcal.refused("import", "catalogue", "--mesh", path, "--open", "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(("per_m", "unit"), [(1000, "mm"), (100, "cm"), (39.3701, "inches")])
def test_in_another_unit_the_cavity_is_the_room_too(per_m, unit, tmp_path):
    """The message proposed the volume with the walls in it."""
    boxes = [
        (name, material, tuple(per_m * x for x in low), tuple(per_m * x for x in high))
        for name, material, low, high in [*BUTT, FLOOR, ROOF]
    ]
    path = obj(tmp_path / "m.obj", boxes)
    try:
        said = " ".join(mesh.room(path).notes)
    except DataError as error:
        said = str(error)
    assert f"105 m³ in {unit}" in said
