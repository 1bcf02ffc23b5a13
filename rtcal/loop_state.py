"""The closed loop between two runs of a program: its state as a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.equations import Eyring, Kuttruff, LinearEquation, Sabine
from rtcal.acoustics.files import read_text
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_files import parse_room, room_text
from rtcal.errors import DataError
from rtcal.loop_rules import RULES
from rtcal.types import Array

if TYPE_CHECKING:
    from rtcal.closed_loop import Loop, LoopResult

KIND = "loop 2"
"""What the key ``rtcal`` of a saved loop says."""
MAX_BYTES = 2**25
MOST_DECIMALS = 12

_STEP = ("target", "alpha", "simulated", "noise")
_EQUATIONS = {e.name: e for e in (Sabine, Eyring, Kuttruff)}


def text(loop: Loop, result: Mapping[str, Any] | None = None) -> str:
    """Return a loop as JSON text; the room as the text of its file, ``result`` as `ends` gives it."""
    equation = loop.equation or Eyring()
    steps = [{name: _plain(getattr(step, name)) for name in _STEP} for step in loop.steps]
    return json.dumps({
        "rtcal": KIND, "room": room_text(loop.room), "measured": loop.measured,
        "wanted": _plain(loop.wanted), "rule": loop.rule, "method": loop.method,
        "equation": {"name": equation.name, **asdict(equation)}, "decimals": loop.decimals,
        "tolerance": loop.tolerance, "steps": steps,
        **({} if result is None else {"result": dict(result)}),
    }, indent=1, ensure_ascii=False)  # fmt: skip


def read(
    path: str, room: Room | None = None, equation: LinearEquation | None = None
) -> tuple[dict[str, Any], list[dict[str, Array]]]:
    """Return a saved loop's attributes and its steps'.

    With a room, a state of another one is refused; with an equation, it takes the place of the
    state's, which has to be Sabine's, Eyring's or Kuttruff's. DataError if the file is no loop.
    """
    content = read_text(path, MAX_BYTES)
    try:
        data = json.loads(content)
        if not isinstance(data, dict) or data.get("rtcal") != KIND:
            raise DataError(f"{path} is no state of a loop: it lacks the mark of one")
        own = parse_room(data["room"], f"{path}, room")
        if room is not None and fingerprint(room) != fingerprint(own):
            raise DataError(
                f'{path} is the state of another room, or room "{room.name}" was changed since'
            )
        if data["rule"] not in RULES:
            raise KeyError("rule")
        decimals = data["decimals"]
        if decimals is not None and (
            type(decimals) is not int or not 1 <= decimals <= MOST_DECIMALS
        ):
            raise ValueError(f"decimals = {decimals!r}")
        steps = [{name: _array(step[name]) for name in _STEP} for step in data["steps"]]
        fields = {
            "room": own if room is None else room, "wanted": _array(data["wanted"]),
            "measured": str(data["measured"]), "rule": data["rule"], "method": str(data["method"]),
            "equation": equation or _equation(data["equation"]), "decimals": decimals,
            "tolerance": float(data["tolerance"]),
        }  # fmt: skip
        if not fields["tolerance"] > 0:
            raise ValueError("tolerance is not above 0")
    except (
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        RecursionError,
        OverflowError,
    ) as error:
        if isinstance(error, DataError):
            raise
        what = f"{error} is missing or unknown" if isinstance(error, KeyError) else error
        raise DataError(f"{path} is no state of a loop: {what}") from error
    shape = own.alpha.shape
    vectors = [fields["wanted"], *(s[name] for s in steps for name in _STEP if name != "alpha")]
    if any(v.shape != shape[1:] for v in vectors) or any(s["alpha"].shape != shape for s in steps):
        raise DataError(f"{path} is no state of a loop: its shapes are not the room's")
    return fields, steps


def ends(result: LoopResult) -> dict[str, Any]:
    """Return what a simulator had before and after, means by parameter and band; JSON-able."""
    found = {"before": result.before, "after": result.final}
    return {
        "simulator": result.simulator,
        "confirmed": result.confirmation is not None,
        "status": list(result.status),
        **{
            name: {p: _plain(measurement.mean(p)) for p in measurement.values}
            for name, measurement in found.items()
        },
    }


def fingerprint(room: Room) -> str:
    """Return a short name of a room's materials, areas, bands, air and prior."""
    plain = (tuple(room.materials), room.volume, room.speed_of_sound)
    digest = hashlib.sha256(repr(plain).encode())
    for values in (
        room.areas, room.centre_frequencies, room.air_attenuation, room.alpha, room.sigma,
    ):  # fmt: skip
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


def _equation(stated: Mapping[str, Any]) -> LinearEquation:
    own = dict(stated)
    return _EQUATIONS[own.pop("name")](**own)


def _plain(values: Array) -> list[object]:
    """JSON has no NaN."""
    return [
        _plain(v) if v.ndim else (None if np.isnan(v) else float(v)) for v in np.asarray(values)
    ]


def _array(values: object) -> Array:
    return np.array(values, dtype=float)
