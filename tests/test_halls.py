"""The invented halls are what their descriptions say."""

import numpy as np
import pytest

from rtcal.datasets import halls

HALLS = (halls.lecture_hall, halls.hard_hall, halls.theatre, halls.corridor)


@pytest.mark.parametrize("make", HALLS)
def test_points_lie_inside_and_held_out_receivers_apart(make):
    hall = make()
    for kind in ("sources", "receivers", "held_out"):
        assert hall.geometry.require_inside(kind, getattr(hall, kind)).shape[1] == 3
    seen = np.array([*hall.sources.values(), *hall.receivers.values()])
    for point in hall.held_out.values():
        assert np.linalg.norm(seen - point, axis=1).min() >= 0.5
    assert dict(zip(hall.room.materials, hall.room.areas, strict=True)) == pytest.approx(
        hall.geometry.areas
    )
    assert hall.room.volume == hall.geometry.volume
    assert "invented" in hall.room.name


def test_the_lecture_hall_has_what_the_paper_says():
    hall = halls.lecture_hall()
    areas = hall.geometry.face_areas
    assert len(areas) == 23
    assert hall.geometry.volume == pytest.approx(334, rel=1e-12)
    assert areas.max() / areas.min() == pytest.approx(66.6, rel=1e-12)


def test_the_theatre_has_thirty_materials_and_uneven_absorption():
    room = halls.theatre().room
    assert room.n_materials == 30
    assert room.alpha[:, 3].max() > 10 * room.alpha[:, 3].min()
