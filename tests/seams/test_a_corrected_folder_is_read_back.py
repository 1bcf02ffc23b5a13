"""A law: what a corrected room's folder holds absorbs what the corrected room does, in every file."""

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.apply import corrected_geometry
from rtcal.io import catt, geometry_files, obj, odeon, pyroomacoustics
from rtcal.simulators import Polyhedron
from tests.test_where_corrected import BANDS, L_PLAN, candidate, case_in, prism, triangulated

SHAPES = {"L": prism(L_PLAN), "triangles": triangulated(prism(L_PLAN))}
ROUNDED = 0.0005
"""Half of the last decimal of the coefficients in the lists."""


@pytest.mark.parametrize("form", ["patch", "material"])
@pytest.mark.parametrize("wall_alpha", [0.05, 0.6])
@pytest.mark.parametrize("surface", ["floor", "wall 5"])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_file_has_the_patch(shape, surface, wall_alpha, form, tmp_path):
    case = case_in(SHAPES[shape], alpha=wall_alpha)
    made = corrected_geometry(case, candidate(surface, 4.0), form)
    made.save(tmp_path)
    room = rt.Room.from_file(str(tmp_path / "room.toml"))
    mesh = obj.read(tmp_path / "room.obj")
    assert isinstance(mesh, Polyhedron)
    for name in ("alpha", "sigma", "areas", "scattering"):
        stated, read = getattr(made.room, name), getattr(room, name)
        np.testing.assert_allclose(read, stated, rtol=1e-9)
    assert made.material in room.materials
    places = (room.scene.sources, room.scene.receivers)
    assert places == (dict(case.simulator.sources), dict(case.simulator.receivers))
    assert geometry_files.read(room).areas == mesh.areas
    sizes = np.array([mesh.areas[m] for m in room.materials])
    np.testing.assert_allclose(sizes, [made.geometry.areas[m] for m in room.materials], rtol=1e-6)
    absorbed = made.room.absorption_area
    np.testing.assert_allclose(sizes @ room.alpha, absorbed, rtol=1e-6)
    lists = {"catt.txt": catt, "odeon.txt": odeon, "pyroomacoustics.json": pyroomacoustics}
    for file, program in lists.items():
        listed = program.read(tmp_path / file).materials
        columns = [list(listed[0].centre_frequencies).index(f) for f in BANDS]
        alpha = np.array([np.asarray(m.alpha)[columns] for m in listed])
        np.testing.assert_allclose(sizes @ alpha, absorbed, atol=1.01 * ROUNDED * sizes.sum())
        for read, stated in zip(listed, room.materials, strict=True):
            assert read.name.endswith(stated)  # ODEON's names begin with a number
