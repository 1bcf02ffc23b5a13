"""Hostile calls of every public function, for the law in `tests/seams/test_hostile_calls.py`.

Each function gets valid arguments, by the parameter's name or by "function.name" where that needs
another value. Then one of them is replaced by each of `WRONG`: None, texts, empty and object arrays,
NaN, wrong shapes, and by a generator. A call may work or raise a typed error (`rt.errors`). Public are
the names that the packages list, the functions of the modules among them, and the methods of the
classes for which `instances` has an example.

Classes and readers (`made_here`) check where an object is made or a file is opened: their errors are
all typed. A function that is given another type, or arrays that do not fit, may raise an error of
Python's or NumPy's own (`PLAIN`), and so may a call with an argument of an unknown name.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import signal
import time
import traceback
import types
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, is_dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from rtcal.acoustics.observables import OBSERVABLES
from rtcal.calibration.posterior import distribution
from rtcal.finder import Case, ChangedMaterial, Configuration, plan, verify
from rtcal.finder.effects import AppliedEffect
from rtcal.finder.search import find
from rtcal.io.material_list import Format
from rtcal.loop.closed import start
from rtcal.simulators.external import of_equation
from rtcal.simulators.geometry import SHOEBOX_WALLS, Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.simulators.shoebox import ImageSource
from rtcal.support.errors import RtcalError

LIMIT = 10.0
"""s of processor time per call, so that a busy machine changes nothing. `find` takes some 3 s."""
PLAIN = (TypeError, ValueError, AttributeError, IndexError, OverflowError)
"""Errors of Python's own that functions may raise for a wrong type or shape; nothing else may."""

ENDLESS: list[Any] = []
"""A list that is its own member."""
ENDLESS.append(ENDLESS)

WRONG: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    2.5,
    1e300,
    10**400,
    float("nan"),
    float("inf"),
    1j,
    "text",
    "",
    "nul\0",
    "half a pair \ud800",
    b"bytes",
    [],
    ["a", "b"],
    [[1.0], [1.0, 2.0]],
    [None, None],
    {},
    {"a": 1},
    {1: None},
    set(),
    object(),
    len,
    float,
    np.array([]),
    np.array([None, "a"], dtype=object),
    np.full(3, np.nan),
    np.full((3, 7), 0.1),
    np.full((2, 2, 2), 0.1),
    np.full((2, 2), np.nan),
    np.array([1j, 2j]),
    np.array(["a", "b"]),
    np.array(0.1),
    np.array(["2026-11-29"], dtype="datetime64[D]"),
    np.ma.masked_all(3),
    [True, 0.5],
    range(3),
    Decimal("0.5"),
    ENDLESS,
)


def public(name: str, thing: Any) -> Iterator[tuple[str, Any]]:
    """Yield every public function, class and method under a name."""
    if isinstance(thing, types.ModuleType):
        if not thing.__name__.startswith("rtcal"):
            return
        names = getattr(thing, "__all__", None) or [
            n
            for n, v in vars(thing).items()
            if not n.startswith("_") and getattr(v, "__module__", None) == thing.__name__
        ]
        for n in names:
            yield from public(f"{name}.{n}", getattr(thing, n))
    elif inspect.isclass(thing):
        if issubclass(thing, Exception) or inspect.isabstract(thing):
            return
        if getattr(thing, "_is_protocol", False):
            return
        yield name, thing
        for n, member in inspect.getmembers(thing):
            if not n.startswith("_") and (inspect.isfunction(member) or inspect.ismethod(member)):
                yield f"{name}.{n}", member
    elif inspect.isfunction(thing) and thing.__module__.startswith("rtcal"):
        yield name, thing
    elif isinstance(thing, Format):
        yield f"{name}.parse", thing.parse


def instances(folder: Path, *, searched: bool = True) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return examples by the name of their class, and by the name of a parameter.

    Without ``searched`` there is none of what `rtcal.find` returns, which takes 12 s.
    """
    f = [500.0, 1000.0]
    walls = zip(SHOEBOX_WALLS, (12.0, 12.0, 15.0, 15.0, 20.0, 20.0), "xxyyzz", strict=True)
    surfaces = [rt.Surface(w, "floor" if x == "z" else "wall", a, x) for w, a, x in walls]
    materials = [
        rt.Material("wall", [0.1, 0.2], [0.02, 0.02]),
        rt.Material("floor", [0.3, 0.3], [0.1, 0.1]),
    ]
    room = rt.Room.from_surfaces(
        name="room",
        volume=60,
        surfaces=surfaces,
        materials=materials,
        centre_frequencies=f,
        air=rt.Air(),
        dimensions=(5, 4, 3),
    )
    measured = rt.Measurement(
        centre_frequencies=f,
        values={"t20": [[0.5, 0.48]], "c80": [[5.0, 5.0]]},
        uncertainty={"t20": [[0.02, 0.02]], "c80": [[0.3, 0.3]]},
        pairs=[("S", "R")],
    )
    configurations = rt.Configurations([room])
    calibration = rt.Calibration(rt.terms.PriorDeviation() + rt.terms.SoftMatch())
    result = rt.calibrate(room, measured)
    geometry = Polyhedron.shoebox(
        (5, 4, 3), {w: "floor" if w in ("floor", "ceiling") else "wall" for w in SHOEBOX_WALLS}
    )
    change = ChangedMaterial(np.array([0.2, 0.2]), np.array([0.02, 0.02]))
    configuration = Configuration(name="A", measured=measured, distances=np.array([2.0]))
    case = Case(room=room, configurations=[configuration])
    finding = find(rt.datasets.hidden_room()[0]) if searched else None
    verification = verify(finding) if searched else None
    simulator = of_equation(rt.Eyring(), room)
    loop = start(room, measured)
    point = {"S": (1.0, 1.0, 1.0)}
    receivers = {"R": (3.0, 2.0, 1.5)}
    by_class: dict[str, Any] = {
        "Room": room,
        "Measurement": measured,
        "Air": rt.Air(),
        "Material": materials[0],
        "Surface": surfaces[0],
        "Configurations": configurations,
        "Calibration": calibration,
        "CalibrationResult": result,
        "JointResult": result.joint,
        "Equation": rt.Eyring(),
        "LinearEquation": rt.Eyring(),
        "Polyhedron": geometry,
        "Change": change,
        "Configuration": configuration,
        "Case": case,
        "Finding": finding,
        "Verification": verification,
        "Simulator": simulator,
        "of_equation": simulator,
        "Loop": loop,
        "Loop of a simulator": rt.calibrate_simulator(simulator, room, measured),
        "CalibrationProblem": calibration.build(room),
        "Posterior": distribution(result),
        "Calibrated": result,
        "Optimal": result,
        "ImageSource": ImageSource(room=room, sources=point, receivers=receivers, duration=0.2),
        "PathTracing": PathTracing(
            geometry=geometry,
            room=room,
            sources=point,
            receivers=receivers,
            n_paths=50,
            n_batches=2,
            workers=1,
            scattering=0.5,
        ),
        "ScatteringDelayNetwork": rt.simulators.ScatteringDelayNetwork(
            room=room, sources=point, receivers=receivers, sampling_rate=4000.0
        ),
        "Eyring": rt.Eyring(),
        "Sabine": rt.Sabine(),
        "Kuttruff": rt.Kuttruff(),
        "Millington": rt.Millington(),
        "Fitzroy": rt.Fitzroy(),
        "ArauPuchades": rt.ArauPuchades(),
        "AppliedEffect": AppliedEffect("opening", {"area": 2.0}),
        "Plan": plan(case),
        "DecaySlope": OBSERVABLES["t20"],
        "SigmaRule": rt.priors.SigmaRule(),
        "Recalibrated": rt.finder.recalibrate(case),
        "Generator": np.random.default_rng(1),
        "Term": rt.terms.PriorDeviation(),
        "ModelDiscrepancy": finding.discrepancy if finding is not None else None,
    }
    by_class = {name: example for name, example in by_class.items() if example is not None}
    room.save(str(folder / "room.toml"))
    measured.save(str(folder / "t.csv"))
    by_name: dict[str, Any] = {
        "alpha": room.alpha,
        "sigma": room.sigma,
        "mu": room.alpha,
        "areas": room.areas,
        "target": np.array([12.0, 13.0]),
        "t": np.array([0.5, 0.5]),
        "mean": np.array([0.1, 0.2]),
        "centre_frequencies": np.array(f),
        "frequencies": np.array(f),
        "wanted": f,
        "values": np.array([0.3, 0.2]),
        "uncertainty": np.array([0.1, 0.1]),
        "energy": 10 ** (-6 * np.arange(4000) * 1e-3 / 0.5)[None, None],
        "bin_width": 1e-3,
        "name": "t20",
        "parameter": "t20",
        "path": str(folder / "x.txt"),
        "absorption_area": np.array([12.0, 13.0]),
        "exponent": np.array([0.1, 0.2]),
        "contribution": np.array([0.1, 0.2]),
        "rng": np.random.default_rng(1),
        "room": room,
        "stated": room,
        "measured": measured,
        "volume": 60.0,
        "x": np.array([0.1]),
        "frequency": 500.0,
        "seed": 0,
        "sources": point,
        "receivers": receivers,
        "geometry": geometry,
        "duration": 0.2,
        "seconds": 0.2,
        "materials": materials,
        "surfaces": surfaces,
        "fraction": 0.3,
        "factor": 2.0,
        "model": np.array([0.5, 0.5]),
        "difference": np.array([1.0, 2.0]),
        "covariance": np.eye(2),
        "bound_active": False,
        "air_share": np.array([0.1, 0.1]),
        "active": np.zeros((2, 2)),
        "z": np.zeros(2),
        "marks": result.trust_marks,
        "per_octave": 0.5,
        "content": b"",
        "case": case,
        "finding": finding,
        "verification": verification,
        "result": result,
        "simulator": simulator,
        "equation": rt.Eyring(),
        "rooms": [room],
        "sigma_r": 0.05,
        "realisations": 10,
        "trials": 2,
        "text": "text",
        "place": "place",
        "probability": 0.5,
        "material": "wall",
        "band": 0,
        "points": [[1.0, 1.0, 1.0]],
        "dimensions": (5.0, 4.0, 3.0),
        "pairs": [("S", "R")],
        "signals": np.random.default_rng(1).standard_normal(8000) * np.exp(-np.arange(8000) / 500),
        "sampling_rate": 8000.0,
        "effects": None,
        "data": room.to_dict(),
        "simulated": measured,
        "measurement": measured,
        "lower": 0.0,
        "upper": 1.0,
        "gain": [1.0, 1.0],
        "names": ["a"],
        "folder": folder / "out",
        "changes": {"wall": change},
        "parameters": {"area": 2.0},
        "run": lambda alpha, seed: np.array([0.5, 0.5]),
        "title": "title",
        "p_value": 0.3,
        "area": 2.0,
        "key": "eyring",
        "protocol": rt.terms.Term,
        "ChangedMaterial.alpha": np.array([0.2, 0.2]),
        "ChangedMaterial.sigma": np.array([0.02, 0.02]),
        "Measurement.from_decays.energy": 10
        ** (-6 * np.arange(4000) * 1e-3 / np.full((1, 2, 1), 0.5)),
        "MeasuredModes.decays": np.array([2.0, 3.0]),
        "MeasuredModes.decay_uncertainty": np.array([0.1, 0.1]),
        "MeasuredModes.frequency_uncertainty": np.array([0.1, 0.1]),
        "Observed.matrix": np.eye(2, 4),
        "Polyhedron.shoebox.materials": dict.fromkeys(SHOEBOX_WALLS, "wall"),
        "Room.material.name": "wall",
        "Room.material_index.name": "wall",
        "Room.material_rows.names": ["wall"],
        "Step.simulated": np.array([0.5, 0.5]),
        "Step.noise": np.array([0.01, 0.01]),
        "Target.low": np.array([0.4, 0.4]),
        "Target.high": np.array([0.6, 0.6]),
        "gap_jnd.measured": np.array([0.5, 0.5]),
        "gap_jnd.simulated": np.array([0.5, 0.5]),
        "gradients.parameters": ["t20"],
        "material.name": "carpet_1.35_kg_m2",
        "observable.key": "t20",
        "of_energy.energy": 10 ** (-6 * np.arange(4000) * 1e-3 / 0.5),
    }
    return by_class, by_name


class _Endless(BaseException):
    pass


def _stop(*_: object) -> None:
    raise _Endless


def call(
    function: Callable[..., Any],
    keywords: dict[str, Any],
    plain: tuple[type[Exception], ...] = (),
) -> tuple[str, str]:
    """Return how a call ended (works, typed, plain, untyped or endless), and where and why.

    ``plain`` are the exceptions of Python's own that are allowed.
    """
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            function(**keywords)
        return "works", ""
    except RtcalError as error:
        return "typed", str(error)
    except _Endless:
        return "endless", ""
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        end = "plain" if isinstance(error, plain) else "untyped"
        return end, f"{type(error).__name__} in {Path(last.filename).name}:{last.lineno}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


OPTIONS = ("solver", "unreachable", "warm_start", "settings")
"""The options of a solve."""


def arguments(
    name: str, function: Callable[..., Any], by_class: dict[str, Any], by_name: dict[str, Any]
) -> dict[str, Any]:
    """Return valid arguments for what has no default: by the parameter's class, else its name.

    Those of a class are the fields of its example, if it is a dataclass.
    """
    example = by_class.get(getattr(function, "__name__", ""))
    if inspect.isclass(function) and is_dataclass(example) and isinstance(example, function):
        return {f.name: getattr(example, f.name) for f in fields(example) if f.init}
    out = {}
    for p in inspect.signature(function).parameters.values():
        if (
            p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
            or p.default is not p.empty
            or p.name == "self"
        ):
            continue
        kind = str(p.annotation).split(" | ")[0].strip()
        if kind in by_class:
            out[p.name] = by_class[kind]
        else:
            usual = by_name.get(p.name, "text" if kind == "str" else 1)
            out[p.name] = by_name.get(f"{function.__qualname__}.{p.name}", usual)
    return out


def functions(by_class: dict[str, Any]) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield each public function with a parameter once; a method of an instance is bound to it."""
    seen: set[Any] = set()
    for name, thing in public("rt", rt):
        function = thing
        if inspect.isfunction(thing) and "self" in inspect.signature(thing).parameters:
            owner = by_class.get(name.split(".")[-2])
            if not hasattr(owner, thing.__name__):  # none, or another class of this name
                continue
            function = getattr(owner, thing.__name__)
        key = getattr(thing, "__func__", thing)
        if key not in seen and inspect.signature(function).parameters:
            seen.add(key)
            yield name, function


def wrong_calls(
    function: Callable[..., Any], valid: dict[str, Any]
) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Yield a parameter, a wrong value and all arguments of the call.

    A function that takes the options of a solve gets each of them, and one that is unknown.
    """
    for p in inspect.signature(function).parameters.values():
        names = [p.name]
        if p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL):
            module = function.__module__.removeprefix("rtcal.calibration.")
            solves = module in ("methods", "problem")
            names = [*OPTIONS, "unknown"] * (solves and p.name == "options")
        for name in names:
            for wrong in (*WRONG, (member for member in ("a", "b"))):
                if p.default is not wrong or isinstance(wrong, float):
                    yield name, wrong, valid | {name: wrong}


READERS = ("rt.io.", "load", "from_", "read", "of_energy", "of_measurement", "parse", "page_of")
"""Parts of the names of what opens a file, or makes an object of plain values or of other objects."""


def made_here(name: str, function: Callable[..., Any]) -> bool:
    """Whether an object is made here, or a file opened or written: a class or one of `READERS`."""
    return inspect.isclass(function) or any(
        part in name if part.startswith("rt") else name.split(".")[-1].startswith(part)
        for part in READERS
    )


def ends(
    called: Iterable[tuple[str, Callable[..., Any]]],
    examples: tuple[dict[str, Any], dict[str, Any]],
    *,
    every: int = 1,
    seconds: float = np.inf,
) -> Iterator[tuple[str, str, str]]:
    """Yield the function's name, how a call ended, and the call with where and why.

    One call in ``every`` is made; which ones goes round from parameter to parameter. A function whose
    calls have taken ``seconds`` of processor time, such as one that renders figures, is left.
    """
    number = 0
    for name, function in called:
        began = time.process_time()
        for parameter, wrong, keywords in wrong_calls(
            function, arguments(name, function, *examples)
        ):
            number += 1
            if time.process_time() - began > seconds:
                break
            if number % every:
                continue
            end, why = call(function, keywords, () if made_here(name, function) else PLAIN)
            yield name, end, f"{name}({parameter}={str(wrong)[:30]!r}): {end} {why}"
