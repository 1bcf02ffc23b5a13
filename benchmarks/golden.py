"""The figures that a user gets, stored to see what a change moves.

    python -m benchmarks.golden store               # about ten minutes of processor time
    python -m benchmarks.golden compare             # prints each figure that moved; exit code 1 then
    python -m benchmarks.golden compare --all       # every development room; hours
    python -m benchmarks.golden compare --only calibrate    # a kind, or the beginning of a name

Kinds, by what their names begin with:

- ``means``, ``several``, ``pairs``, ``positions``: verdicts and fits of development rooms;
- ``real``: real rooms of which something is left out (those whose data are beside the repository);
- ``calibrate``, ``export``: every room that ships, by every method, into every format;
- ``find``: the hidden rooms that ship, found and verified; two states of a room;
- ``predict``, ``design``, ``loop``, ``modes``, ``archive``: of rooms that ship;
- ``example``: the numbers (not the words) that the commands of ``rtcal example`` print as text and as
  JSON, and those of every file that they write.

A number has moved where it differs by more than the `TOLERANCE` of its kind and by more than
`ROUNDING`; smaller differences are counted below the list, with the largest. Stored numbers have every
bit. Nothing that judges is read.
`store` replaces the figures of the tasks that it ran.
"""

from __future__ import annotations

import argparse
import contextlib
import glob
import gzip
import html
import io
import itertools
import json
import multiprocessing
import os
import re
import runpy
import shlex
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import rtcal as rt
from benchmarks.studies.geometric_world import load as geometric
from benchmarks.studies.means import judged
from benchmarks.studies.means.judging import one
from benchmarks.studies.means.real_cases import every_case
from benchmarks.studies.position_rooms import load as positions
from rtcal.acoustics.equations import EQUATIONS
from rtcal.acoustics.observables import MATCH
from rtcal.calibration.methods import METHODS
from rtcal.command.main import main as rtcal_command
from rtcal.datasets import examples, halls
from rtcal.finder import Case, control_rooms, verify
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.problem import MOST
from rtcal.finder.search import find
from tests.test_modes import BOX, TRUTH, heard
from tests.test_modes import ROOM as BOX_ROOM
from tests.test_modes import times as times_of_box
from tests.two_states import measured as measured_state
from tests.two_states import room as room_of_states
from tests.two_states import times as times_of_state

STORED = Path(__file__).parent / "golden.json.gz"
PATHS = 2000
"""Of the geometric and the position rooms: their figures are compared with themselves alone."""
SHORT_MEANS = {1: 6, 2: 6}
"""Rooms of each world in the short form, every kind once as far as they go."""
SHORT_SEVERAL, SHORT_GEOMETRIC, SHORT_POSITIONS = 2, 2, 1
TOLERANCE = {
    "calibrate": 1e-9,
    "export": 1e-9,
    "archive": 1e-7,
    "modes": 1e-7,
    "predict": 1e-7,
    "design": 1e-6,
    "loop": 1e-7,
    "find": 1e-6,
    "example": 1e-6,
    "means": 1e-6,
    "several": 1e-6,
    "pairs": 1e-6,
    "positions": 1e-6,
    "real": 1e-6,
}
"""Of each kind: the difference, as a share of a table's largest number, from which on it has moved.

The numbers of a text and of a file are no table: each is compared with itself.

A calibration is a certified QP, alpha within 1e-12 of the optimum. The others search, iterate or
sample from there, which enlarges rounding. One machine gives the same bits twice.
"""
TEXTS = ("example", "export")
ROUNDING = 1e-12
"""A difference below this is none: alpha is certified to it, and a gap that is closed is rounding."""
SHIPPED_CASES = {
    "case": lambda: rt.datasets.hidden_room()[0],
    "closed": lambda: rt.datasets.hidden_room("closed")[0],
    "named": lambda: rt.datasets.hidden_room("identified")[0],
    "not told": lambda: rt.datasets.hidden_room("not_identified")[0],
}
HALLS = ("lecture_hall", "hard_hall", "theatre", "corridor")
CRASHED = "crashed"
SLOW_EXAMPLES = ("where",)
"""Two minutes per search: their commands are run once, as text, and not again as JSON."""


@dataclass(frozen=True)
class Task:
    """A room by name, and what makes its figures."""

    name: str
    figures: Callable[[], dict[str, Any]]


def plain(value: Any) -> Any:
    """Return a value as JSON keeps it, every bit of a number included; NaN is None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def of_finding(finding: Any, gaps: bool) -> dict[str, Any]:
    """The figures of a finding on means; with ``gaps`` those of its verification."""
    size = finding.size
    row = {
        "verdict": finding.verdict,
        "effect": finding.effect,
        "family": finding.family,
        "candidates": finding.names,
        "probabilities": finding.probabilities,
        "families": finding.families,
        "evidence": finding.evidence,
        "score": finding.score,
        "threshold": finding.threshold,
        "parameters": {} if finding.best is None else finding.best.parameters,
        "size": None if size is None else [size.mean, size.low, size.high],
        "residuals": finding.residuals,
    }
    if gaps and finding.can_be_added:
        seen = verify(finding)
        row |= {
            "verification": seen.verdict,
            "gaps": {
                f"{place}, {quantity}": gaps
                for p, place in enumerate(seen.places)
                for q, quantity in enumerate(seen.quantities)
                if np.isfinite(gaps := seen.sizes[-2:, 0, q, p]).all()
            },
            "alpha": seen.corrected.alpha,
            "plain alpha": seen.uncorrected.alpha,
        }
    return row


def means(plain_case: Any) -> dict[str, Any]:
    """A room of a world: as it is stated, and cut down to one configuration."""
    case = Case.from_dict(plain_case)
    controls = control_rooms(case)
    first = [ControlRooms(c.engine, c.errors[:, :1]) for c in controls]
    return {
        "one": of_finding(find(one(case), controls=first), gaps=False),
        "all": of_finding(find(case, controls=controls), gaps=True),
    }


def several(plain_case: Any) -> dict[str, Any]:
    """A room of the first world, searched for several effects at once."""
    found = find(Case.from_dict(plain_case), most=MOST)
    return {
        "verdict": found.verdict,
        "named": found.named,
        "named families": found.named_families,
        "named set": found.named_set,
        "probabilities": found.probabilities,
        "families": found.families,
        "numbers": found.numbers,
        "sets": {" + ".join(names): p for names, p in found.sets.items()},
        "alpha": found.alpha,
    }


def on_pairs(index: int, statement: str, paths: int) -> dict[str, Any]:
    """A geometric room, searched at every position; what was found is verified on other pairs."""
    room = geometric.load(0, index, statement)
    case = rt.finder.PositionsCase(
        simulator=room.simulator(n_paths=paths), measured=room.measured, match=MATCH
    )
    found = rt.find(case)
    row = {
        "verdict": found.verdict,
        "effect": found.effect,
        "family": found.family,
        "surface": found.surface,
        "surfaces": found.surfaces,
        "probabilities": found.probabilities,
        "families": found.families,
        "score": found.score,
        "threshold": found.threshold,
        "candidates": {
            f"{c.effect}, {c.place}": [c.probability, c.size, c.low, c.high, c.spectrum]
            for c in found.candidates[:20]
        },
        "map": found.map,
    }
    if found.can_be_added:
        seen = rt.finder.verify(found)
        row |= {"verification": seen.verdict, "gain": seen.gain, "gaps": seen.gaps[-1]}
    return row


def at_positions(index: int, prior: str, paths: int) -> dict[str, Any]:
    """A position room, calibrated to every position."""
    case = positions.load(0, index, prior)
    result = rt.calibrate_positions(
        case.simulator(n_paths=paths), case.room, case.measured, match=MATCH
    )
    return {
        "alpha": result.alpha,
        "sigma": result.sigma,
        "gap before": result.gap_before,
        "gap after": result.gap_after,
        "scattering": result.tracer.scattering,
    }


def real(name: str, more: Path) -> dict[str, Any]:
    """A real room of which something is left out; {} where its data are not here."""
    (each,) = (c for c in every_case() if c.name == name)
    try:
        case = each.make(more)
    except FileNotFoundError:
        return {}
    return of_finding(find(case), gaps=True)


def invented(room: rt.Room, seed: int) -> rt.Measurement:
    """T20 of a room whose coefficients are off by 20 % each, by a draw, with 3 % uncertainty."""
    off = np.exp(0.2 * np.random.default_rng(seed).standard_normal(room.alpha.shape))
    t = rt.Eyring().time(room, room.areas @ np.clip(off * room.alpha, 0, 0.99))
    return rt.Measurement(
        centre_frequencies=room.centre_frequencies,
        values={"t20": t[np.newaxis]},
        uncertainty={"t20": 0.03 * t[np.newaxis]},
    )


def shipped_rooms() -> dict[str, tuple[rt.Room, rt.Measurement]]:
    """Every room that ships, with what was measured in it, or an invented measurement."""
    rooms = {"BRAS CR2": rt.datasets.bras_cr2()}
    for seed, name in enumerate(HALLS):
        room = getattr(halls, name)().room
        rooms[name] = room, invented(room, seed)
    for name, make in SHIPPED_CASES.items():
        case = make()
        rooms[f"hidden, {name}"] = case.room, case.configurations[0].measured
    folder = examples.path("where_room")
    rooms["where"] = (
        rt.Room.from_file(folder / "room.toml"),
        rt.Measurement.from_file(folder / "pairs.csv"),
    )
    # Uncertain geometry and climate, correlated bands, a common error: every unknown beside alpha.
    room, measured = rooms["BRAS CR2"]
    rooms["BRAS CR2, uncertain"] = (
        room.replace(
            volume_sigma=0.03,
            area_sigma=0.05,
            common_area_sigma=0.02,
            common_alpha_sigma=0.1,
            climate_sigma=(1.0, 10.0),
        ),
        measured,
    )
    rooms["BRAS CR2, correlated"] = (
        room.replace(band_correlation=0.7, material_correlation={("plaster", "concrete"): 0.5}),
        measured,
    )
    return rooms


def of_calibration(result: Any) -> dict[str, Any]:
    """The figures of a calibration."""
    likely = result.plausibility
    return {
        "alpha": result.alpha,
        "sigma": result.posterior_sigma,
        "interval": result.interval,
        "gap before": result.gap_before,
        "gap after": result.gap_after,
        "shift in sigmas": result.shift_in_sigmas,
        "Q": likely.q,
        "degrees of freedom": likely.degrees_of_freedom,
        "p": likely.p_value,
        "p together": likely.p_together,
        "z": likely.z,
        "at a bound": result.active,
        "effects": result.effects,
        "air's share": result.air_share,
    }


def calibrated_or_refused(*given: Any, **options: Any) -> dict[str, Any]:
    """The figures of a calibration, or which error refuses it."""
    try:
        return of_calibration(rt.calibrate(*given, **options))
    except rt.errors.RtcalError as error:
        return {"refused": type(error).__name__}


def calibrated(name: str) -> dict[str, Any]:
    """A shipped room, calibrated by every method with every equation that has a linear target."""
    room, measured = shipped_rooms()[name]
    return {
        f"{equation}, {method}": calibrated_or_refused(
            room, measured, method=method, equation=EQUATIONS[equation]()
        )
        for equation in ("eyring", "sabine", "kuttruff")
        for method in METHODS
    } | {
        f"{equation}, T": kind().reverberation_time(room)
        for equation, kind in EQUATIONS.items()
        if equation not in ("fitzroy", "arau") or room.dimensions
    }


def several_states() -> dict[str, Any]:
    """Three states of one room, calibrated together by every method; with bounds and limits."""
    room, measured = rt.datasets.bras_cr2()
    room = room.replace(surfaces=())
    states = [
        room,
        room.replace(name="less ceiling", areas=room.areas * [1, 1, 1, 1, 0.6]),
        room.replace(name="more floor", areas=room.areas * [1, 1, 1, 1.5, 1]),
    ]
    t = measured.reverberation_time
    together = rt.Configurations(states)
    out = {}
    for method in ("soft", "smooth", "robust", "joint"):
        joint = rt.calibrate(together, [f * t for f in (1.0, 1.1, 0.9)], method=method)
        for state, result in zip(states, joint.results, strict=True):
            out[f"{method}, {state.name}"] = of_calibration(result)
    composed = rt.Calibration(
        objective=rt.terms.PriorDeviation() + rt.terms.SoftMatch(relative=0.05),
        constraints=[
            rt.terms.Bounds(0.03, 0.09),
            rt.terms.AtMost("concrete", "ceiling", band=250),
        ],
    ).build(room)
    for solver in ("clarabel", "osqp"):
        out[f"composed, {solver}"] = of_calibration(composed.solve(measured, solver=solver))
    return out


def found(name: str) -> dict[str, Any]:
    """A hidden room that ships: searched, verified, and with what was found in its model."""
    finding = find(SHIPPED_CASES[name]())
    row = of_finding(finding, gaps=True)
    if finding.can_be_added:
        row["applied"] = finding.apply().case.to_dict()
    return row


def found_between_states(panels: float) -> dict[str, Any]:
    """Two states of a room, with so many m² of panels in the second."""
    before = measured_state(times_of_state(), 1)
    after = measured_state(times_of_state(panels), 2)
    seen = rt.find(room_of_states(), after, before=before)
    row = {
        "verdict": seen.verdict,
        "family": seen.family,
        "families": seen.families,
        "score": seen.score,
        "threshold": seen.threshold,
        "candidates": {c.effect: [c.probability, c.size] for c in seen.candidates},
        "change": seen.change,
        "shift": seen.shift,
        "climate": seen.climate,
    }
    if seen.can_be_added:
        row["changed alpha"] = seen.apply().room.alpha
    return row


PANEL = rt.Material("panel", [0.2, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)


def predicted() -> dict[str, Any]:
    """BRAS CR2, predicted after each kind of change, by every method and from what was stated."""
    p, (room, measured) = rt.prediction, rt.datasets.bras_cr2()
    changes = {
        "none": [],
        "cover": p.Change(cover="ceiling", by=PANEL, area=20),
        "add": p.Change(add=PANEL, area=15),
        "remove": p.Change(remove="windows"),
        "open": p.Change(open="windows", area=3),
        "climate": p.Change(air=rt.Air(26, 60)),
        "volume": p.Change(volume=130.0),
        "both": [p.Change(cover="ceiling", by=PANEL, area=20), p.Change(air=rt.Air(26, 60))],
    }
    known = {m: rt.calibrate(room, measured, method=m) for m in ("mle", "soft", "robust")}
    out = {}
    for (how, of), (what, change) in itertools.product(
        {**known, "stated": room}.items(), changes.items()
    ):
        after = p.predict(of, change)
        out[f"{how}, {what}"] = {
            "T": after.mean,
            "interval": after.interval,
            "before": after.time_before,
            "u before": after.uncertainty_before,
        }
    ends = [0.5] * 6, [1.0] * 6
    variants = [p.Variant(n, c) for n, c in changes.items() if n in ("cover", "add")]
    side = p.predict_variants(known["mle"], variants, target=p.Target(*ends))
    out["compared"] = {v.name: v.probability(*ends) for v in side.predictions}
    return out


def designed(method: str) -> dict[str, Any]:
    """BRAS CR2, the cheapest treatments for a target, with two treatments."""
    p, (room, measured) = rt.prediction, rt.datasets.bras_cr2()
    trap = rt.Material("trap", [0.6, 0.5, 0.3, 0.2, 0.2, 0.2], [0.1] * 6)
    design = rt.design(
        rt.calibrate(room, measured, method=method),
        [
            p.Treatment("panels", PANEL, 40, cost=90, covers="ceiling", unit=1.44),
            p.Treatment("traps", trap, 20, cost=120, covers="concrete"),
        ],
        p.Target([np.nan] * 6, [1.0, 0.9, 0.8, 0.8, 0.8, 0.8]),
    )
    return {
        "areas": design.areas,
        "cost": design.cost,
        "probability": design.probability,
        "together": design.probability_together,
        "frontier": design.frontier,
        "T": design.prediction.mean,
    }


def looped(rule: str) -> dict[str, Any]:
    """The lecture hall, calibrated to a program that is off, and to rtcal's tracer."""
    hall = halls.lecture_hall()
    measured = invented(hall.room, 0)
    shape = np.linspace(1.25, 0.9, len(hall.room.centre_frequencies))

    def run(alpha: Any, seed: int) -> rt.Measurement:
        t = shape * rt.Sabine().time(hall.room, hall.room.areas @ alpha)
        return rt.Measurement.from_values(hall.room.centre_frequencies, t20=t, edt=0.9 * t)

    program = rt.simulators.External(room=hall.room, name="program", run=run)
    tracer = rt.simulators.PathTracing(
        geometry=hall.geometry,
        room=hall.room,
        sources=hall.sources,
        receivers=hall.receivers,
        n_paths=PATHS,
    )
    out = {}
    for name, simulator, more in (
        ("program", program, {"decimals": 3}),
        ("tracer", tracer, {"max_simulations": 5}),
    ):
        result = rt.calibrate_simulator(simulator, hall.room, measured, rule, **more)
        out[name] = {
            "alpha": result.alpha,
            "status": result.status,
            "gap": result.gap,
            "final": result.final.reverberation_time,
        }
    return out


def of_modes(with_times: bool) -> dict[str, Any]:
    """A box with its modes' decays, without or with T; and the closed loop that takes them along."""
    t = times_of_box(TRUTH)
    result = rt.calibrate_modes(BOX_ROOM, heard(TRUTH), t if with_times else None, geometry=BOX)
    out = {
        "alpha": result.alpha,
        "sigma": result.sigma,
        "interval": result.interval,
        "before": result.before,
        "after": result.after,
        "used": result.used,
        "carried": result.carried,
        "Q": result.plausibility.q,
        "p": result.plausibility.p_value,
    }
    if not with_times:
        program = rt.simulators.External(
            room=BOX_ROOM,
            name="program",
            run=lambda alpha, seed: 1.1 * rt.Eyring().time(BOX_ROOM, BOX_ROOM.areas @ alpha),
        )
        measured = rt.Measurement.from_values(BOX_ROOM.centre_frequencies, t20=t)
        out["loop's alpha"] = rt.calibrate_simulator(program, result, measured).alpha
    return out


def archived() -> dict[str, Any]:
    """Four rooms of the materials of BRAS CR2, learned from; and applied to a fifth."""
    room, measured = rt.datasets.bras_cr2()
    room = room.replace(surfaces=())
    rng = np.random.default_rng(3)
    rooms = []
    for name in "ABCD":
        one_room = room.replace(name=name, areas=room.areas * rng.uniform(0.5, 2, 5))
        of_room = 0.85 * np.exp(0.1 * rng.standard_normal(room.alpha.shape)) * room.alpha
        t = rt.Eyring().time(one_room, one_room.areas @ of_room)
        rooms.append(rt.calibrate(one_room, t))
    archive = rt.learn(rooms)
    known = archive.apply(room.replace(name="next"))
    then = rt.calibrate(known, measured, method="soft")
    return {
        "alpha": archive.alpha,
        "sigma": archive.sigma,
        "mean sigma": archive.mean_sigma,
        "off": archive.off,
        "together": [archive.together, archive.together_sigma],
        "seen": archive.seen,
        "room's sigma": archive.room_sigma,
        "record": numbers_of(archive.to_dict()),
        "next": of_calibration(then),
    }


def exported(name: str) -> dict[str, Any]:
    """A shipped room, calibrated, as its own file and as every list of materials; read back."""
    room, measured = shipped_rooms()[name]
    room = rt.calibrate(room, measured, method="soft").room
    out = {"room.toml": numbers_in(room.to_text())}
    formats = {kind: getattr(rt.io, kind) for kind in ("catt", "odeon", "pyroomacoustics", "bras")}
    with tempfile.TemporaryDirectory() as folder:
        for kind, module in formats.items():
            path = Path(folder, f"{kind}.txt")
            # BRAS and pyroomacoustics write the room's own bands.
            more = {"missing_bands": "nearest"} if kind in ("catt", "odeon") else {}
            try:
                report = module.write(room, path, **more)
            except rt.errors.RtcalError as error:
                out[kind] = {"refused": type(error).__name__}
                continue
            out[kind] = {
                "effect of the rounding": numbers_in(str(report)),
                "file": numbers_in(path.read_text(encoding="utf-8")),
                "read back": {m.name: m.alpha for m in module.read(path).materials},
            }
        path = Path(folder, "room.toml")
        room.save(path)
        out["read back"] = {"alpha": rt.Room.from_file(path).alpha}
    return out


_NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w]|\.\d)")
_UNSEEN = re.compile(r"<(script|style|svg)\b.*?</\1>|<[^>]*>", re.S)


def numbers_in(text: str) -> list[float]:
    """Return the numbers of a text, in order; no digits of words, versions and digests.

    Examples
    --------
    >>> numbers_in("T20 at 125 Hz: 1.40 s, z = −2.5; rtcal 0.1.0")
    [125.0, 1.4, -2.5]
    """
    return [float(n.replace("−", "-")) for n in _NUMBER.findall(text)]


def numbers_of(record: Any) -> list[float]:
    """Return the numbers of a record that JSON keeps, in order; not those of versions and clocks."""
    if isinstance(record, Mapping):
        return [
            n for k, v in record.items() if k not in ("versions", "seconds") for n in numbers_of(v)
        ]
    if isinstance(record, (list, tuple)):
        return [n for v in record for n in numbers_of(v)]
    return [float(record)] if isinstance(record, (int, float)) else []


def numbers_of_file(path: Path) -> list[float] | None:
    """Return the numbers of a file that a command wrote; of a page those that one reads."""
    if path.suffix in (".png", ".wav", ".array") or path.name.startswith("."):
        return None
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return numbers_of(json.loads(text))
    return numbers_in(html.unescape(_UNSEEN.sub(" ", text)) if path.suffix == ".html" else text)


@contextlib.contextmanager
def in_folder(path: str) -> Iterator[None]:
    """Run what is inside in a folder."""
    before = Path.cwd()
    os.chdir(path)
    try:
        yield
    finally:
        os.chdir(before)


def printed(command: str, *more: str) -> str:
    """Run a command of an example in this process and folder; return its standard output.

    What stands on the other stream depends on how long the command takes.
    """
    words = [w for each in shlex.split(command) for w in (sorted(glob.glob(each)) or [each])]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        if words[0] == "python":
            runpy.run_path(words[1], run_name="__main__")
        else:
            try:
                rtcal_command([*words[1:], *more])
            except SystemExit as end:
                if end.code:
                    raise RuntimeError(
                        f"{command}: exit code {end.code}\n{err.getvalue()}"
                    ) from end
    return out.getvalue()


def example(name: str) -> dict[str, Any]:
    """The numbers of what an example's commands print and write."""
    project = examples.example(name)
    # A search that is written to a folder is the one that was printed.
    commands = [
        c for c in project.commands if not any(o.startswith(f"{c} --out") for o in project.commands)
    ]
    ran: dict[str, Any] = {}
    for form, more in (("text", ()), ("JSON", ("--json",))):
        if more and name in SLOW_EXAMPLES:
            continue
        with tempfile.TemporaryDirectory() as folder, in_folder(folder):
            for file, content in project.files.items():
                Path(file).write_bytes(content)
            for command in commands:
                # A script has no --json, and a page's record is how many bytes it has.
                if more and not command.startswith("rtcal "):
                    printed(command)
                    continue
                if more and command.startswith("rtcal report "):
                    continue
                said = printed(command, *more)
                ran[f"{command}, {form}"] = (
                    numbers_of(json.loads(said)) if more else numbers_in(said)
                )
            if not more:
                for path in sorted(Path().rglob("*")):
                    if path.is_file() and path.read_bytes() != project.files.get(str(path)):
                        figures = numbers_of_file(path)
                        if figures is not None:
                            ran[str(path)] = figures
    return ran


def of_worlds(every: bool) -> list[Task]:
    """Rooms of both worlds: in the short form one of each kind, as many as are affordable."""
    tasks = []
    for world, number in SHORT_MEANS.items():
        cases, truths = (judged.read(world, 0, part) for part in ("case", "truth"))
        kinds: dict[str, int] = {}
        for i, truth in enumerate(truths):
            kinds.setdefault(str(truth["kind"] if world == 2 else truth["seed"][1]), i)
        rooms = range(len(cases)) if every else sorted(kinds.values())[:number]
        tasks += [Task(f"means: world {world}, room {i}", partial(means, cases[i])) for i in rooms]
        if world == 1:
            double = [i for i, truth in enumerate(truths) if len(truth["effects"]) == 2]
            chosen = double if every else double[:SHORT_SEVERAL]
            tasks += [
                Task(f"several: world 1, room {i}", partial(several, cases[i])) for i in chosen
            ]
    return tasks


def every_task(every: bool, more: Path) -> list[Task]:
    """All rooms with what makes their figures; those of development only."""
    paths = 3 * PATHS if every else PATHS
    rooms = list(geometric.stored(0, "rooms"))
    tasks = of_worlds(every)
    tasks += [
        Task(f"pairs: room {i}, {statement}", partial(on_pairs, i, statement, paths))
        for i in (rooms if every else rooms[:SHORT_GEOMETRIC])
        for statement in (
            (geometric.IN_SITU, geometric.HANDBOOK) if every else (geometric.IN_SITU,)
        )
    ]
    rooms = list(positions.stored(0, "rooms"))
    tasks += [
        Task(f"positions: room {i}, {prior}", partial(at_positions, i, prior, paths))
        for i in (rooms if every else rooms[:SHORT_POSITIONS])
        for prior in ("wide", "narrow")
    ]
    cases = [c for c in every_case() if c.part == "development"]
    tasks += [
        Task(f"real: {c.name}", partial(real, c.name, more))
        for c in (cases if every else cases[:: max(1, len(cases) // 4)])
    ]
    names = list(shipped_rooms())
    tasks += [Task(f"calibrate: {name}", partial(calibrated, name)) for name in names]
    tasks += [Task("calibrate: several states, composed", several_states)]
    tasks += [Task(f"export: {name}", partial(exported, name)) for name in names]
    tasks += [Task(f"find: {name}", partial(found, name)) for name in SHIPPED_CASES]
    tasks += [
        Task(f"find: two states, {area:g} m²", partial(found_between_states, area))
        for area in (0.0, 15.0)
    ]
    tasks += [Task("predict: BRAS CR2", predicted)]
    tasks += [Task(f"design: BRAS CR2, {m}", partial(designed, m)) for m in ("mle", "soft")]
    tasks += [Task(f"loop: {rule}", partial(looped, rule)) for rule in ("secant", "safeguarded")]
    tasks += [Task("modes: alone", partial(of_modes, False))]
    tasks += [Task("modes: with T", partial(of_modes, True))]
    tasks += [Task("archive: four rooms", archived)]
    tasks += [Task(f"example: {name}", partial(example, name)) for name in examples.NAMES]
    return tasks


def made(task: Task) -> tuple[str, dict[str, Any], float]:
    """Return a task's name, its figures and the processor time that they took, in s.

    An error is a figure: one task that no longer runs does not hide what moved in the others.
    """
    warnings.simplefilter("ignore")
    begin = time.process_time()
    try:
        figures = task.figures()
    except Exception as error:
        figures = {CRASHED: "".join(traceback.format_exception(error)[-3:])}
    # As they are read back, so that a fresh figure and a stored one are alike.
    return task.name, json.loads(json.dumps(plain(figures))), time.process_time() - begin


def run(tasks: list[Task], jobs: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and figures of the tasks whose data are here."""
    spent = 0.0
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for n, (name, figures, seconds) in enumerate(pool.imap_unordered(made, tasks), 1):
            spent += seconds
            print(f"{n}/{len(tasks)}  {seconds:6.1f} s  {name}", file=sys.stderr, flush=True)
            if figures:
                yield name, figures
    print(f"{spent:.0f} s of processor time", file=sys.stderr)


def read() -> dict[str, dict[str, Any]]:
    """Return the stored figures, by room."""
    if not STORED.exists():
        return {}
    with gzip.open(STORED, "rt", encoding="utf-8") as file:
        return dict(json.load(file))


def write(figures: Mapping[str, dict[str, Any]]) -> None:
    """Store figures; the file has no date, so that the same figures are the same bytes."""
    text = json.dumps(dict(sorted(figures.items())), separators=(",", ":"))
    STORED.write_bytes(gzip.compress(text.encode(), mtime=0))


@dataclass
class Differences:
    """What moved, a line each, and how many numbers differ by less, with the largest difference.

    ``alone`` compares each number with itself, not with the largest of its table.
    """

    alone: bool = False
    lines: list[str] = field(default_factory=list)
    within: int = 0
    largest: float = 0.0

    def add(self, before: Any, now: Any, tolerance: float, place: str = "") -> None:
        """Compare two figures, or mappings of them.

        Tables of numbers of one shape get one line: how many moved, and by how much at most. Lists of
        numbers of unequal length, of a text that has one more or less, are compared as sets.
        """
        if isinstance(before, dict) and isinstance(now, dict):
            rows = _rows_of_numbers(before, now)
            if rows is not None:
                self._tables(*rows, tolerance, place)
                return
            for key in dict.fromkeys((*before, *now)):
                at = f"{place}, {key}" if place else key
                if key not in before or key not in now:
                    self.lines.append(f"{at}: {'new' if key in now else 'gone'}")
                else:
                    self.add(before[key], now[key], tolerance, at)
            return
        old, new = _numbers(before), _numbers(now)
        if old is None or new is None:
            if json.dumps(before) != json.dumps(now):
                self.lines.append(f"{place}: {before} -> {now}")
        elif old.shape == new.shape:
            self._tables(old, new, tolerance, place)
        else:
            gone, come = _unmatched(old.ravel(), new.ravel(), tolerance)
            self.lines.append(
                f"{place}: {old.size} numbers -> {new.size}; "
                + ("the same values" if not gone + come else f"gone {_few(gone)}; new {_few(come)}")
            )

    def _tables(self, old: np.ndarray, new: np.ndarray, tolerance: float, place: str) -> None:
        unlike = ~((old == new) | (np.isnan(old) & np.isnan(new)))
        if not unlike.any():
            return
        by = np.abs(new - old)
        scale = np.abs(old) if self.alone else np.nanmax(np.abs(old), initial=0.0)
        # A difference of NaN: a number came or went.
        far = unlike & ~(by <= np.maximum(tolerance * scale, ROUNDING))
        small = by[unlike & ~far]
        self.within += small.size
        self.largest = max(self.largest, float(small.max(initial=0.0)))
        if not far.any():
            return
        most = np.nanmax(by[far], initial=0.0)
        if old.size == 1:
            self.lines.append(f"{place}: {old.item():.6g} -> {new.item():.6g}, by {most:.2g}")
        else:
            self.lines.append(f"{place}: {far.sum()} of {old.size} numbers, by {most:.2g} at most")


def _rows_of_numbers(before: Any, now: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """Return two mappings of the same names to one number each as arrays, else None."""
    if before.keys() != now.keys() or len(before) < 2:
        return None
    rows = [[each[key] for key in before] for each in (before, now)]
    if any(
        isinstance(n, bool) or not isinstance(n, (int, float, type(None))) for r in rows for n in r
    ):
        return None
    old, new = (np.array(row, dtype=float) for row in rows)
    return old, new


def _numbers(value: Any) -> np.ndarray | None:
    """Return a value as an array of numbers, None where it is none."""
    if isinstance(value, (bool, str)) or value is None:
        return None
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        return None


def _unmatched(
    old: np.ndarray, new: np.ndarray, tolerance: float
) -> tuple[list[float], list[float]]:
    """Return the numbers of each list that the other one lacks."""
    digits = max(1, round(-np.log10(tolerance)))
    counts = [Counter(float(f"{n:.{digits}g}") for n in each) for each in (old, new)]
    return list((counts[0] - counts[1]).elements()), list((counts[1] - counts[0]).elements())


def _few(numbers: list[float]) -> str:
    return ", ".join(f"{n:.6g}" for n in numbers[:6]) + (
        f" and {len(numbers) - 6} more" if len(numbers) > 6 else "" if numbers else "none"
    )


def kind_of(name: str) -> str:
    """Return the kind of a task, the beginning of its name."""
    return name.partition(":")[0]


def compare(stored: Mapping[str, Any], now: Mapping[str, Any]) -> int:
    """Print what moved in the rooms that both have; return the number of rooms with a change."""
    changed = 0
    small: dict[str, list[Differences]] = {}
    for name, figures in now.items():
        kind = kind_of(name)
        found = Differences(alone=kind in TEXTS)
        if name in stored:
            found.add(stored[name], figures, TOLERANCE[kind])
        else:
            found.lines.append("not stored")
        changed += bool(found.lines)
        small.setdefault(kind, []).append(found)
        for line in found.lines:
            print(f"{name}: {line}")
    for kind, each in small.items():
        within = sum(d.within for d in each)
        if within:
            largest = max(d.largest for d in each)
            print(
                f"{kind}: {within} numbers differ within the tolerance of {TOLERANCE[kind]:g}, "
                f"by {largest:.2g} at most"
            )
    print(f"{changed} of {len(now)} rooms changed")
    return changed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("store", "compare"))
    parser.add_argument("--all", action="store_true", help="every development room; hours")
    parser.add_argument(
        "--only", default="", help=f"a kind ({', '.join(TOLERANCE)}), or how names begin"
    )
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--more", type=Path, default=Path("."), help="folder of further real data")
    given = parser.parse_args()
    tasks = [t for t in every_task(given.all, given.more) if t.name.startswith(given.only)]
    if not tasks:
        parser.error(f"--only {given.only}: no name begins so")
    now = {}
    for name, figures in run(tasks, given.jobs):
        now[name] = figures
        if given.what == "store" and CRASHED in figures:
            sys.exit(f"{name}: {figures[CRASHED]}")
        if given.what == "store":
            write({**read(), **now})
    if given.what == "compare" and compare(read(), now):
        sys.exit(1)


if __name__ == "__main__":
    main()
