"""A case with another program's values in place of rtcal's own: its file, and what is compared."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.apply import corrected_geometry
from rtcal.loop import ControlRuns
from rtcal.simulators import RayTracing
from rtcal.support.errors import DataError
from tests.test_where import BANDS, RECEIVERS, SOURCES, measured, stated, tracing
from tests.test_where_corrected import candidate

pytest.importorskip("pyroomacoustics", reason="the other program")

MATCH = ("t20", "edt", "c80", "ts")


def read(folder: Path, measured: str = "measured.csv") -> rt.finder.PositionsCase:
    room = rt.Room.from_file(str(folder / "room.toml"))
    return rt.finder.case_of(
        room,
        rt.Measurement.from_file(str(folder / measured)),
        tracing={"scattering": 0.4, "n_paths": 4800},
        match=MATCH,
        simulated=rt.Run(room, rt.Measurement.from_file(str(folder / "simulated.csv"))),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's files: what pyroomacoustics says of the model, and of the room with 10 m² more."""
    where = tmp_path_factory.mktemp("program")
    room = stated()
    case = rt.finder.PositionsCase(simulator=tracing(room), measured=measured(False))
    made = corrected_geometry(case, replace(candidate("east", 10.0), spectrum=np.ones(len(BANDS))))

    def program(geometry: object, of: rt.Room, seed: int) -> rt.Measurement:
        tracer = RayTracing(
            geometry=geometry,  # type: ignore[arg-type]
            room=of,
            sources=SOURCES,
            receivers=RECEIVERS,
            scattering=0.4,
            n_rays=16_000,
        )
        return tracer.simulate(of.alpha, seed=seed)

    scene = rt.Scene(sources=SOURCES, receivers=RECEIVERS)
    room.replace(scene=scene).save(str(where / "room.toml"))
    program(case.geometry, room, 1).save(str(where / "simulated.csv"))
    program(case.geometry, room, 2).save(str(where / "same.csv"))
    program(made.geometry, made.room, 3).save(str(where / "measured.csv"))
    return where


@pytest.mark.long
def test_the_disagreement_is_the_programs(folder: Path) -> None:
    """Its own error cancels: what it says of the same room twice differs by its noise alone."""
    same = rt.find(read(folder, "same.csv"), cache=folder / "kept")
    other = rt.find(read(folder), cache=folder / "kept")
    assert np.sqrt(np.nanmean(same.map**2)) < 1.0
    assert same.verdict == "none"
    assert np.nanmean(other.map[0]) > 1.0  # T20 is measured shorter
    assert other.score > same.score + 3
    best = other.best
    assert best is not None
    assert best.family.startswith("added absorption") or best.surface is None


@pytest.mark.long
def test_what_neither_has_is_left_out(folder: Path) -> None:
    """A program's blank cell made every probability NaN."""
    case = read(folder)
    assert case.simulated is not None

    def blank(data: rt.Measurement) -> rt.Measurement:
        values = {name: data.values[name].copy() for name in MATCH}
        values["ts"][2, 0] = np.nan
        return rt.Measurement(centre_frequencies=BANDS, pairs=data.pairs, values=values)

    less = replace(
        case,
        simulator=replace(case.simulator, n_paths=600),
        measured=blank(case.measured),
        simulated=blank(case.simulated),
    )
    pairs = less.measured.pairs
    errors = 0.1 * np.random.default_rng(1).normal(size=(8, len(MATCH), len(pairs), len(BANDS)))
    controls = ControlRuns(parameters=MATCH, pairs=pairs, errors=errors)
    finding = rt.find(less, controls=controls)
    assert np.isfinite(finding.score)
    assert np.isnan(finding.map).sum() == 1


def rows(folder: Path) -> list[str]:
    return (folder / "simulated.csv").read_text().splitlines()


@pytest.mark.long
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda r: not r.startswith("S2,R3,"), "simulated lacks S2 to R3, which was measured"),
        (lambda r: ",C80," not in r, "simulated has no C80, which was measured; leave c80 out"),
        (lambda r: ",TS," not in r, "simulated has no Ts, which was measured; leave ts out"),
        (lambda r: ",2000.0," not in r, "simulated lacks T20 from S1 to R1 at 2000 Hz"),
        (
            lambda r: not r.startswith("S1,R2,EDT,1000.0,"),
            "simulated lacks EDT from S1 to R2 at 1000 Hz, which was measured",
        ),
    ],
)
def test_a_file_that_lacks_something_is_refused(
    folder: Path, tmp_path: Path, changed: object, message: str
) -> None:
    """Pairs and values that lacked had been left out without a word."""
    for name in ("room.toml", "measured.csv"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    kept = [row for row in rows(folder) if changed(row)]  # type: ignore[operator]
    assert len(kept) < len(rows(folder))
    (tmp_path / "simulated.csv").write_text("\n".join(kept) + "\n")
    with pytest.raises(DataError, match=re.escape(message)):
        read(tmp_path)


def test_a_level_without_its_reference_is_no_g(folder: Path) -> None:
    """G is absolute; a program's level that is not must not be compared with it."""
    case = read(folder)
    given = case.simulated
    assert given is not None
    level = np.zeros((len(given.pairs), len(BANDS)))
    values = {name: given.values[name] for name in MATCH} | {"level": level}
    with pytest.raises(DataError, match="simulated has no G, which was measured"):
        rt.finder.PositionsCase(
            simulator=case.simulator,
            measured=measured(False),
            simulated=rt.Measurement(
                centre_frequencies=given.centre_frequencies, pairs=given.pairs, values=values
            ),
        )


def test_a_run_at_positions_has_the_coefficients_of_the_room(folder: Path) -> None:
    case = read(folder)
    assert case.simulated is not None
    at = rt.Run(case.room.replace(alpha=0.9 * case.room.alpha), case.simulated)
    with pytest.raises(DataError, match="at positions a run is at the room's own coefficients"):
        rt.finder.case_of(case.room, case.measured, case.simulator, simulated=at)
