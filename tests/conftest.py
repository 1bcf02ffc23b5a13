"""Shared by all tests: one derandomised Hypothesis profile, and where the extra data lie."""

import gc
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import settings

import rtcal as rt
from rtcal.command.main import main
from rtcal.finder.claim import Candidate
from rtcal.prediction import changed_time
from rtcal.simulators import Polyhedron

settings.register_profile("rtcal", derandomize=True, deadline=None, max_examples=60)
settings.register_profile("quick", settings.get_profile("rtcal"), max_examples=20)
settings.load_profile("rtcal")


def pytest_configure(config: pytest.Config) -> None:
    """Let the quick suite try fewer examples of each law."""
    if "not long" in config.option.markexpr:
        settings.load_profile("quick")


# xdist sets it in its processes, as some shells do: the commands would wrap their messages to it.
os.environ.pop("COLUMNS", None)

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_collection_finish() -> None:
    """Freeze what is imported: it lives to the end, and no pass of the garbage collector walks it."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def shared_data():
    """The folder with data that are not part of the package."""
    if not SHARED.is_dir():
        pytest.skip(f"needs the shared data folder {SHARED.name}/ beside the checkout")
    return SHARED


@pytest.fixture(scope="session")
def kept(tmp_path_factory):
    """A folder for reference simulations and weighings, one for all tests and processes of a run.

    What is kept has the name of all that it depends on, and is written whole: no process waits.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "kept"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="module")
def runs_kept(kept):
    """Let commands keep reference rooms in `kept`, instead of beside each test's own files."""
    from rtcal.finder.means import engines

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engines, "FOLDER", str(kept))
        yield


@pytest.fixture
def cr2():
    """The shipped real room and its measurement."""
    return rt.datasets.bras_cr2()


@pytest.fixture
def few_draws(monkeypatch):
    """Draw 1024 rooms of each prediction, for what holds in every draw."""
    monkeypatch.setattr(changed_time, "DRAWS", 1024)


@pytest.fixture
def compilations(monkeypatch):
    """Every time that cvxpy builds the chain of reductions, which is what compiling is."""
    rt.calibration.forget()
    seen: list[object] = []
    original = cp.Problem._construct_chain

    def counted(self: cp.Problem, *args: Any, **kwargs: Any) -> Any:
        seen.append(self)
        return original(self, *args, **kwargs)

    monkeypatch.setattr(cp.Problem, "_construct_chain", counted)
    return seen


def also(*values: Any) -> list[Any]:
    """Parameters of a test that `make test-all` adds, where `make test` has one of their kind.

    A tuple is one set of several parameters.
    """
    sets = (value if isinstance(value, tuple) else (value,) for value in values)
    return [pytest.param(*each, marks=pytest.mark.long) for each in sets]


def run(*arguments: object) -> int:
    """Run the command in this process and return its exit code."""
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    return int(end.value.code or 0)


class Commands:
    """Runs commands in this process, and returns the words that they print, whatever their lines."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object) -> str:
        """What a command prints that succeeds; its warnings are in ``warned``."""
        code, (out, err) = run(*arguments), self._capsys.readouterr()
        assert code == 0, err
        self.warned = " ".join(err.split())
        return " ".join(out.split())

    def refused(self, *arguments: object) -> str:
        """The error of a command that ends with 2."""
        assert run(*arguments) == 2
        return " ".join(self._capsys.readouterr().err.split())


@pytest.fixture
def rtcal(capsys):
    return Commands(capsys)


def in_hall(hall: rt.datasets.halls.Hall, **options: Any) -> rt.simulators.PathTracing:
    """Trace a shipped hall between its own sources and receivers, unless an option says otherwise."""
    places = {"sources": hall.sources, "receivers": hall.receivers}
    given = {"geometry": hall.geometry, "room": hall.room, **places} | options
    return rt.simulators.PathTracing(**given)


def random_room(
    rng: np.random.Generator, n: int = 6, k: int = 8, air: rt.Air | None = None
) -> rt.Room:
    """A room whose coefficients stay well inside the box under a usual calibration."""
    return rt.Room(
        name="random",
        volume=200.0,
        materials=[f"m{i}" for i in range(n)],
        areas=rng.uniform(5, 60, n),
        alpha=rng.uniform(0.2, 0.6, (n, k)),
        sigma=rng.uniform(0.02, 0.1, (n, k)),
        centre_frequencies=np.array([63, 125, 250, 500, 1000, 2000, 4000, 8000][:k]),
        air=air,
    )


def room_of(
    materials: Mapping[str, tuple[float, Any, Any]],
    bands: Sequence[float],
    volume: float = 100.0,
    /,
    **stated: Any,
) -> rt.Room:
    """A room of materials with area, alpha and sigma; one number stands for all bands."""
    areas, *rows = zip(*materials.values(), strict=True)
    alpha, sigma = ([np.broadcast_to(row, len(bands)) for row in each] for each in rows)
    of_all = {"volume": volume, "centre_frequencies": bands, "materials": [*materials]}
    parts = {"areas": areas, "alpha": np.array(alpha), "sigma": np.array(sigma)}
    return rt.Room(**{"name": "room", **of_all, **parts, **stated})


def measurement_of(
    bands: Any, pairs: Any = None, u: Mapping[str, Any] | None = None, **values: Any
) -> rt.Measurement:
    """A measurement of parameters, (n_pairs, n_bands) each, with standard uncertainties ``u``."""
    stated = {"pairs": pairs, "uncertainty": u}
    given = {name: value for name, value in stated.items() if value is not None}
    return rt.Measurement(centre_frequencies=bands, values=values, **given)


def in_geometry(geometry: Polyhedron, bands: Sequence[float], alpha: Any, **stated: Any) -> rt.Room:
    """The room of a geometry's materials with alpha, one number or (n_materials, n_bands)."""
    rows = np.full((len(geometry.areas), len(bands)), alpha)
    measures = {"volume": geometry.volume, "areas": [*geometry.areas.values()]}
    of_all = {"materials": [*geometry.areas], "centre_frequencies": bands, "air": rt.Air(20, 50)}
    return rt.Room(
        **{"name": "room", "alpha": rows, "sigma": 0.1 * rows, **measures, **of_all, **stated}
    )


def in_order(room: rt.Room, order: Sequence[int]) -> rt.Room:
    """Return a room with its materials in another order."""
    names = ("areas", "alpha", "sigma", "area_sigma", "scattering", "alpha_min")
    rows = {name: getattr(room, name) for name in names}
    moved = {name: np.asarray(v)[order] for name, v in rows.items() if v is not None}
    return room.replace(materials=[room.materials[i] for i in order], **moved)


def true_times(rng: np.random.Generator, room: rt.Room, equation: rt.Eyring) -> np.ndarray:
    """T of a room drawn from the prior: what a calibration is given."""
    drawn = room.alpha + room.sigma * rng.standard_normal(room.alpha.shape)
    return equation.time(room, room.areas @ np.clip(drawn, 0.01, 0.99))


def program_of(room: rt.Room) -> rt.simulators.External:
    """A program that has the room's T by Eyring's equation."""
    return rt.simulators.External(
        room=room,
        name="program",
        run=lambda alpha, seed: rt.Eyring().time(room, room.areas @ alpha),
    )


def candidates_of(*effects: str) -> tuple[Candidate, ...]:
    """Return candidates of which nothing but their effects is known."""
    return tuple(Candidate(effect=e, family=e, probability=0.0) for e in effects)


def pytest_make_parametrize_id(val: object) -> str | None:
    """Return no name of bytes: workbooks hold the time, so that two workers had other tests."""
    return "bytes" if isinstance(val, bytes) else None
