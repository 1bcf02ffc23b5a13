"""A patch or material absorbs what was found, in whatever size and on whatever wall it is drawn."""

from dataclasses import replace

import numpy as np
import pytest

from rtcal.finder.apply import corrected_geometry
from rtcal.finder.effects import library
from rtcal.finder.positions.problem import on_surfaces
from rtcal.simulators import Polyhedron
from rtcal.simulators.geometry import SHOEBOX_WALLS
from tests.conftest import also
from tests.test_where_corrected import BANDS, SIZE, candidate, case_in


@pytest.mark.parametrize("form", ["patch", "material"])
@pytest.mark.parametrize("wall_alpha", [0.6, *also(0.05, 0.9)])
@pytest.mark.parametrize("size", [0.5, 12.0])
@pytest.mark.parametrize("effect", on_surfaces(library()), ids=lambda effect: effect.name)
def test_the_corrected_room_has_the_change_that_was_found(form, wall_alpha, size, effect):
    """6 m² of opening on a wall of 0.6 added 2.00 in place of 2.40 m²."""
    geometry = Polyhedron.shoebox(SIZE, {wall: f"{wall} wall" for wall in SHOEBOX_WALLS})
    stated = case_in(geometry, alpha=wall_alpha)
    kinds = [spectrum for _, spectrum in effect.on_surface(np.array(BANDS))]
    for spectrum in (kinds[0], kinds[-1]):
        found = replace(candidate("east", size), effect=effect.name, spectrum=spectrum)
        made = corrected_geometry(stated, found, form)
        assert made.form == form
        assert made.room.total_area == pytest.approx(stated.room.total_area)
        assert np.array_equal(made.simulator().scattering, made.room.scattering)
        added = made.room.absorption_area - stated.room.absorption_area
        assert added == pytest.approx(size * (spectrum - wall_alpha), rel=1e-6)
        in_geometry = made.room.alpha.T @ [
            geometry_area(made.geometry, m) for m in made.room.materials
        ]
        of_stated = stated.room.alpha.T @ [geometry.areas[m] for m in stated.room.materials]
        assert in_geometry - of_stated == pytest.approx(added, rel=1e-6)


def geometry_area(geometry: Polyhedron, material: str) -> float:
    return geometry.areas.get(material, 0.0)
