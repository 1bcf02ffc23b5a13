"""Law: a corrected room is the same in other programs' files, or the export says what they lack.

With what `ExportReport.lost` names put back (areas, volume, air), a file that is read again has every
material and its alpha to the file's decimals, and T with it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import Case
from rtcal.finder.apply import corrected_case
from rtcal.finder.effects import Effect, library
from rtcal.io import bras, catt, odeon, pyroomacoustics
from tests.seams.test_corrected_room import EVERY, of

FORMATS: dict[str, tuple[ModuleType, dict[str, str]]] = {
    "catt": (catt, {"missing_bands": "nearest"}),
    "odeon": (odeon, {"missing_bands": "nearest"}),
    "pyroomacoustics": (pyroomacoustics, {}),
    "bras": (bras, {}),
}
HALF_OF_THE_LAST_DECIMAL = 0.0005
OF_GEOMETRY = ("no place", "volume changed", "area changed")


@pytest.fixture(scope="module")
def case() -> Case:
    """The shipped room, with names that every program takes."""
    shipped = rt.datasets.hidden_room()[0]
    return Case.from_dict(json.loads(shipped.to_json().replace("material ", "material_")))


def corrected(case: Case, effect: Effect) -> Iterator[Case]:
    """Yield the case with the effect, small and large, alone and beside one that covers a wall."""
    (covered,) = (e for e in library() if e.name == "covered surface")
    p = of(effect, case, 0.35)
    yield replace(case, applied=[p])
    if p.name != covered.name:
        yield replace(case, applied=[of(covered, case, 0.5), of(effect, case, 1.0)])


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("effect", EVERY, ids=lambda e: str(e.name))
def test_a_file_of_a_corrected_room_is_the_room(
    case: Case, effect: Effect, name: str, tmp_path: Path
) -> None:
    module, how = FORMATS[name]
    for i, changed in enumerate(corrected(case, effect)):
        made = corrected_case(changed)
        room = made.room
        path = tmp_path / f"out{i}"
        report = module.write(room, path, **how)
        names = room.materials
        if name == "catt":
            names = tuple(m.replace(" ", "_") for m in names)
            assert ("Renamed" in " ".join(report.notes)) == (names != room.materials)
        assert {"areas and volume", "sigma"} <= set(report.lost)
        assert ("air" in report.lost) == (room.air is not None)
        assert ("where coefficients are from" in report.lost) == bool(room.sources)
        again = module.read(path).room(
            name=room.name,
            volume=room.volume,
            areas=dict(zip(names, room.areas, strict=True)),
            centre_frequencies=report.room.centre_frequencies,
            air=room.air,
        )
        assert again.materials == names
        shared = np.isin(room.centre_frequencies, again.centre_frequencies)
        missing = [float(f) for f in room.centre_frequencies[~shared]]
        assert list(report.bands_not_written) == missing
        of_file = np.isin(again.centre_frequencies, room.centre_frequencies)
        off = np.abs(again.alpha[:, of_file] - room.alpha[:, shared])
        assert off.max() <= HALF_OF_THE_LAST_DECIMAL * (1 + 1e-9)
        if not of_file.all():
            assert "is not in the room: alpha as at" in " ".join(report.notes)
        # The report states both T: that of the room, and that of the file.
        rows = rt.Eyring().reverberation_time(room)[shared]
        np.testing.assert_allclose(report.reverberation_time[of_file], rows, rtol=1e-12)
        read = rt.Eyring().reverberation_time(again)
        np.testing.assert_allclose(report.reverberation_time_as_read, read, rtol=1e-12)
        # d ln T / d alpha is largest where little absorbs: the decimals' share of what does.
        model = made.simulator().simulate(room.alpha).mean("t20")[shared]
        if all(note.code in OF_GEOMETRY for note in made.notes):
            np.testing.assert_allclose(rows, model, rtol=1e-9)
        absorbed = room.areas @ room.alpha[:, shared]
        share = HALF_OF_THE_LAST_DECIMAL * room.total_area / absorbed
        assert (np.abs(np.log(read[of_file] / rows)) <= 1.1 * share + 1e-9).all()
