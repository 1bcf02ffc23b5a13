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
from benchmarks.studies.means.judging import first_of, one
from benchmarks.studies.means.real_cases import RealCase, every_case
from benchmarks.studies.position_rooms import load as positions
from benchmarks.studies.stored import plain
from rtcal.acoustics.equations import EQUATIONS
from rtcal.acoustics.observables import MATCH
from rtcal.calibration.methods import METHODS
from rtcal.command.main import main as rtcal_command
from rtcal.datasets import examples, halls
from rtcal.finder import Case, control_rooms, verify
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
    **dict.fromkeys(("calibrate", "export"), 1e-9),
    **dict.fromkeys(("archive", "modes", "predict", "loop"), 1e-7),
    **dict.fromkeys(
        ("design", "find", "example", "means", "several", "pairs", "positions", "real"), 1e-6
    ),
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
    "case": "case",
    "closed": "closed",
    "named": "identified",
    "not told": "not_identified",
}
"""Rooms in which something is hidden, by the names of their figures."""
HALLS = ("lecture_hall", "hard_hall", "theatre", "corridor")
CRASHED = "crashed"
SLOW_EXAMPLES = ("where",)
"""Two minutes per search: their commands are run once, as text, and not again as JSON."""


Figures = dict[str, Any]
Tasks = dict[str, Callable[[], Figures]]
"""By the name of a room what makes its figures."""


def attributes(of: Any, *names: str, **renamed: str) -> Figures:
    """Return the values of an object's attributes, with blanks in their names, or by other names."""
    every = {**{name: name for name in names}, **renamed}
    return {key.replace("_", " "): getattr(of, name) for key, name in every.items()}


def of_finding(finding: Any, gaps: bool) -> Figures:
    """The figures of a finding on means; with ``gaps`` those of its verification."""
    size = finding.size
    names = ("verdict", "effect", "family", "probabilities", "families", "evidence", "score")
    row = attributes(finding, *names, "threshold", "residuals", candidates="names")
    row["parameters"] = {} if finding.best is None else finding.best.parameters
    row["size"] = None if size is None else [size.mean, size.low, size.high]
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


def means(plain_case: Any) -> Figures:
    """A room of a world: as it is stated, and cut down to one configuration."""
    case = Case.from_dict(plain_case)
    controls = control_rooms(case)
    return {
        "one": of_finding(find(one(case), controls=first_of(controls)), gaps=False),
        "all": of_finding(find(case, controls=controls), gaps=True),
    }


def several(plain_case: Any) -> Figures:
    """A room of the first world, searched for several effects at once."""
    found = find(Case.from_dict(plain_case), most=MOST)
    names = ("verdict", "named", "named_families", "named_set", "probabilities", "families")
    row = attributes(found, *names, "numbers", "alpha")
    return row | {"sets": {" + ".join(names): p for names, p in found.sets.items()}}


def on_pairs(index: int, statement: str, paths: int) -> Figures:
    """A geometric room, searched at every position; what was found is verified on other pairs."""
    room = geometric.load(0, index, statement)
    case = rt.finder.PositionsCase(
        simulator=room.simulator(n_paths=paths), measured=room.measured, match=MATCH
    )
    found = rt.find(case)
    names = ("verdict", "effect", "family", "surface", "surfaces", "probabilities", "families")
    row = attributes(found, *names, "score", "threshold", "map")
    row["candidates"] = {
        f"{c.effect}, {c.place}": [c.probability, c.size, c.low, c.high, c.spectrum]
        for c in found.candidates[:20]
    }
    if found.can_be_added:
        seen = rt.finder.verify(found)
        row |= {"verification": seen.verdict, "gain": seen.gain, "gaps": seen.gaps[-1]}
    return row


def at_positions(index: int, prior: str, paths: int) -> Figures:
    """A position room, calibrated to every position."""
    case = positions.load(0, index, prior)
    result = rt.calibrate_positions(
        case.simulator(n_paths=paths), case.room, case.measured, match=MATCH
    )
    row = attributes(result, "alpha", "sigma", "gap_before", "gap_after")
    return row | {"scattering": result.tracer.scattering}


def real(each: RealCase) -> Figures:
    """A real room of which something is left out; {} where its data are not here."""
    try:
        return of_finding(find(each.make()), gaps=True)
    except FileNotFoundError:
        return {}


def invented(room: rt.Room, seed: int) -> rt.Measurement:
    """T20 of a room whose coefficients are off by 20 % each, by a draw, with 3 % uncertainty."""
    off = np.exp(0.2 * np.random.default_rng(seed).standard_normal(room.alpha.shape))
    t = rt.Eyring().time(room, room.areas @ np.clip(off * room.alpha, 0, 0.99))
    return rt.Measurement(
        centre_frequencies=room.centre_frequencies,
        values={"t20": t[np.newaxis]},
        uncertainty={"t20": 0.03 * t[np.newaxis]},
    )


def shipped_case(name: str) -> Case:
    """Return a room in which something is hidden."""
    return rt.datasets.hidden_room(SHIPPED_CASES[name])[0]


def shipped_rooms() -> dict[str, tuple[rt.Room, rt.Measurement]]:
    """Every room that ships, with what was measured in it, or an invented measurement."""
    rooms = {"BRAS CR2": rt.datasets.bras_cr2()}
    for seed, name in enumerate(HALLS):
        room = getattr(halls, name)().room
        rooms[name] = room, invented(room, seed)
    for name in SHIPPED_CASES:
        case = shipped_case(name)
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


def of_calibration(result: Any) -> Figures:
    """The figures of a calibration."""
    names = ("alpha", "interval", "gap_before", "gap_after", "shift_in_sigmas", "effects")
    likely = {"Q": "q", "p": "p_value", "p_together": "p_together", "z": "z"}
    return {
        **attributes(result, *names, sigma="posterior_sigma", at_a_bound="active"),
        **attributes(result.plausibility, "degrees_of_freedom", **likely),
        "air's share": result.air_share,
    }


def calibrated_or_refused(*given: Any, **options: Any) -> Figures:
    """The figures of a calibration, or which error refuses it."""
    try:
        return of_calibration(rt.calibrate(*given, **options))
    except rt.errors.RtcalError as error:
        return {"refused": type(error).__name__}


def calibrated(name: str) -> Figures:
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


def several_states() -> Figures:
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


def found(name: str) -> Figures:
    """A hidden room that ships: searched, verified, and with what was found in its model."""
    finding = find(shipped_case(name))
    row = of_finding(finding, gaps=True)
    if finding.can_be_added:
        row["applied"] = finding.apply().case.to_dict()
    return row


def found_between_states(panels: float) -> Figures:
    """Two states of a room, with so many m² of panels in the second."""
    before = measured_state(times_of_state(), 1)
    after = measured_state(times_of_state(panels), 2)
    seen = rt.find(room_of_states(), after, before=before)
    names = ("verdict", "family", "families", "score", "threshold", "change", "shift", "climate")
    row = attributes(seen, *names)
    row["candidates"] = {c.effect: [c.probability, c.size] for c in seen.candidates}
    if seen.can_be_added:
        row["changed alpha"] = seen.apply().room.alpha
    return row


PANEL = rt.Material("panel", [0.2, 0.6, 0.9, 0.9, 0.9, 0.9], [0.1] * 6)


def predicted() -> Figures:
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
        names = {"T": "mean", "before": "time_before", "u_before": "uncertainty_before"}
        out[f"{how}, {what}"] = attributes(after, "interval", **names)
    ends = [0.5] * 6, [1.0] * 6
    variants = [p.Variant(n, c) for n, c in changes.items() if n in ("cover", "add")]
    side = p.predict_variants(known["mle"], variants, target=p.Target(*ends))
    out["compared"] = {v.name: v.probability(*ends) for v in side.predictions}
    return out


def designed(method: str) -> Figures:
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
    row = attributes(design, "areas", "cost", "probability", "frontier")
    return {**row, "together": design.probability_together, "T": design.prediction.mean}


def looped(rule: str) -> Figures:
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
        out[name] = attributes(result, "alpha", "status", "gap")
        out[name]["final"] = result.final.reverberation_time
    return out


def of_modes(with_times: bool) -> Figures:
    """A box with its modes' decays, without or with T; and the closed loop that takes them along."""
    t = times_of_box(TRUTH)
    result = rt.calibrate_modes(BOX_ROOM, heard(TRUTH), t if with_times else None, geometry=BOX)
    names = ("alpha", "sigma", "interval", "before", "after", "used", "carried")
    out = attributes(result, *names)
    out |= attributes(result.plausibility, Q="q", p="p_value")
    if not with_times:
        program = rt.simulators.External(
            room=BOX_ROOM,
            name="program",
            run=lambda alpha, seed: 1.1 * rt.Eyring().time(BOX_ROOM, BOX_ROOM.areas @ alpha),
        )
        measured = rt.Measurement.from_values(BOX_ROOM.centre_frequencies, t20=t)
        out["loop's alpha"] = rt.calibrate_simulator(program, result, measured).alpha
    return out


def archived() -> Figures:
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
    names = ("alpha", "sigma", "mean_sigma", "off", "seen")
    return {
        **attributes(archive, *names, **{"room's_sigma": "room_sigma"}),
        "together": [archive.together, archive.together_sigma],
        "record": numbers_of(archive.to_dict()),
        "next": of_calibration(then),
    }


def exported(name: str) -> Figures:
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


def run_example(name: str, form: str) -> Iterator[tuple[str, list[float]]]:
    """Yield the numbers of what an example's commands print as text or as JSON; of text also of files.

    A search that is written to a folder is the one that was printed.
    """
    project, as_json = examples.example(name), form == "JSON"
    for file, content in project.files.items():
        Path(file).write_bytes(content)
    for command in project.commands:
        if any(other.startswith(f"{command} --out") for other in project.commands):
            continue
        # A script has no --json, and a page's record is how many bytes it has.
        if as_json and not command.startswith("rtcal "):
            printed(command)
        elif as_json and not command.startswith("rtcal report "):
            yield f"{command}, JSON", numbers_of(json.loads(printed(command, "--json")))
        elif not as_json:
            yield f"{command}, text", numbers_in(printed(command))
    for path in () if as_json else sorted(Path().rglob("*")):
        if path.is_file() and path.read_bytes() != project.files.get(str(path)):
            figures = numbers_of_file(path)
            if figures is not None:
                yield str(path), figures


def example(name: str) -> Figures:
    """The numbers of what an example's commands print and write."""
    ran: Figures = {}
    for form in ("text",) if name in SLOW_EXAMPLES else ("text", "JSON"):
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            ran |= run_example(name, form)
    return ran


def of_worlds(every: bool) -> Tasks:
    """Rooms of both worlds: in the short form one of each kind, as many as are affordable."""
    tasks: Tasks = {}
    for world, number in SHORT_MEANS.items():
        cases, truths = (judged.read(world, 0, part) for part in ("case", "truth"))
        kinds: dict[str, int] = {}
        for i, truth in enumerate(truths):
            kinds.setdefault(str(truth["kind"] if world == 2 else truth["seed"][1]), i)
        rooms = range(len(cases)) if every else sorted(kinds.values())[:number]
        tasks |= {f"means: world {world}, room {i}": partial(means, cases[i]) for i in rooms}
        if world == 1:
            double = [i for i, truth in enumerate(truths) if len(truth["effects"]) == 2]
            chosen = double if every else double[:SHORT_SEVERAL]
            tasks |= {f"several: world 1, room {i}": partial(several, cases[i]) for i in chosen}
    return tasks


def every_task(every: bool) -> Tasks:
    """All rooms with what makes their figures; those of development only."""
    paths = 3 * PATHS if every else PATHS
    geometric_rooms = list(geometric.stored(0, "rooms"))[: None if every else SHORT_GEOMETRIC]
    position_rooms = list(positions.stored(0, "rooms"))[: None if every else SHORT_POSITIONS]
    statements = (geometric.IN_SITU, geometric.HANDBOOK)[: None if every else 1]
    cases = [c for c in every_case() if c.part == "development"]
    names = list(shipped_rooms())
    return {
        **of_worlds(every),
        **{
            f"pairs: room {i}, {statement}": partial(on_pairs, i, statement, paths)
            for i, statement in itertools.product(geometric_rooms, statements)
        },
        **{
            f"positions: room {i}, {prior}": partial(at_positions, i, prior, paths)
            for i, prior in itertools.product(position_rooms, positions.PRIORS)
        },
        **{
            f"real: {c.name}": partial(real, c)
            for c in (cases if every else cases[:: max(1, len(cases) // 4)])
        },
        **{f"calibrate: {name}": partial(calibrated, name) for name in names},
        "calibrate: several states, composed": several_states,
        **{f"export: {name}": partial(exported, name) for name in names},
        **{f"find: {name}": partial(found, name) for name in SHIPPED_CASES},
        **{
            f"find: two states, {area:g} m²": partial(found_between_states, area)
            for area in (0.0, 15.0)
        },
        "predict: BRAS CR2": predicted,
        **{f"design: BRAS CR2, {m}": partial(designed, m) for m in ("mle", "soft")},
        **{f"loop: {rule}": partial(looped, rule) for rule in ("secant", "safeguarded")},
        "modes: alone": partial(of_modes, False),
        "modes: with T": partial(of_modes, True),
        "archive: four rooms": archived,
        **{f"example: {name}": partial(example, name) for name in examples.NAMES},
    }


def made(task: tuple[str, Callable[[], Figures]]) -> tuple[str, Figures, float]:
    """Return a task's name, its figures and the processor time that they took, in s.

    An error is a figure: one task that no longer runs does not hide what moved in the others.
    """
    warnings.simplefilter("ignore")
    name, make = task
    begin = time.process_time()
    try:
        figures = make()
    except Exception as error:
        figures = {CRASHED: "".join(traceback.format_exception(error)[-3:])}
    # As they are read back, so that a fresh figure and a stored one are alike.
    return name, json.loads(json.dumps(plain(figures))), time.process_time() - begin


def run(tasks: Tasks, jobs: int) -> Iterator[tuple[str, Figures]]:
    """Yield name and figures of the tasks whose data are here."""
    spent = 0.0
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for n, (name, figures, seconds) in enumerate(pool.imap_unordered(made, tasks.items()), 1):
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
        old, new = _numbers(before), _numbers(now)
        if isinstance(before, dict) and isinstance(now, dict):
            if old is not None and new is not None and before.keys() == now.keys():
                self._tables(old, new, tolerance, place)
                return
            for key in dict.fromkeys((*before, *now)):
                at = f"{place}, {key}" if place else key
                if key not in before or key not in now:
                    self.lines.append(f"{at}: {'new' if key in now else 'gone'}")
                else:
                    self.add(before[key], now[key], tolerance, at)
        elif old is None and _alike(before, now):
            for i, pair in enumerate(zip(before, now, strict=True)):
                self.add(*pair, tolerance, f"{place} [{i}]")
        elif old is None or new is None:
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


def _alike(before: Any, now: Any) -> bool:
    """Whether two figures are lists of one length."""
    return isinstance(before, list) and isinstance(now, list) and len(before) == len(now)


def _numbers(value: Any) -> np.ndarray | None:
    """Return a value as an array of numbers, None where it is none; of two and more by name as well."""
    if isinstance(value, dict):
        kinds = {type(n) for n in value.values()}
        if len(value) < 2 or kinds - {int, float, type(None)}:
            return None
        return np.array([*value.values()], dtype=float)
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
        print("".join(f"{name}: {line}\n" for line in found.lines), end="")
    for kind, each in small.items():
        if within := sum(d.within for d in each):
            print(
                f"{kind}: {within} numbers differ within the tolerance of {TOLERANCE[kind]:g}, "
                f"by {max(d.largest for d in each):.2g} at most"
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
    given = parser.parse_args()
    every = every_task(given.all)
    tasks = {name: task for name, task in every.items() if name.startswith(given.only)}
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
