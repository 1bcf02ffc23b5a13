"""The JSON file that keeps the state of a closed loop between two runs of a program.

The codec of `rtcal.loop.state.Loop`: it turns JSON text into a plain dict and checks the entries.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields as fields_of
from pathlib import Path
from typing import Any

import numpy as np

from rtcal.acoustics.curvature import BentDecay
from rtcal.acoustics.equations import LinearEquation, linear_equation
from rtcal.acoustics.observables import EARLY, TARGET
from rtcal.acoustics.room import Room
from rtcal.calibration.presets import preset
from rtcal.errors import DataError
from rtcal.loop.beside import SHOWN
from rtcal.loop.matched import Matched
from rtcal.loop.rules import RULES
from rtcal.loop.steps import Step
from rtcal.support import checks
from rtcal.support.decode import Entries, json_object
from rtcal.support.files import json_numbers, read_text
from rtcal.support.types import Array

KIND = "loop 2"
"""Value of the key ``rtcal`` in a saved loop."""
MAX_BYTES = 2**25
MAX_DECIMALS = 12

_T_LIMITS = (
    1e-6,
    1e6,
)  # s; wide, since T of a hard room without air is longer than any measured one
_MEANS = (-1e6, 1e6)
"""In s or dB; wide, since a simulator may give what no room has."""
_KEYS = (
    "room",
    "measured",
    "wanted",
    "rule",
    "method",
    "equation",
    "decimals",
    "tolerance",
    "steps",
)
_STEP_KEYS = ("target", "alpha", "simulated", "noise")


def text(data: Mapping[str, Any]) -> str:
    """Return `Loop.to_dict`'s dict as JSON text."""
    return json.dumps({"rtcal": KIND, **data}, indent=1, ensure_ascii=False, allow_nan=False)


def is_state(path: Path) -> bool:
    """Return whether a file is the state of a loop; a file that cannot be read is none."""
    if not path.is_file():
        return False
    try:
        return json_object(read_text(path, MAX_BYTES)).get("rtcal") == KIND
    except DataError:
        return False


def read(path: str) -> dict[str, Any]:
    """Return the dict that a state's file holds; DataError if it is no JSON object of that kind."""
    content = read_text(path, MAX_BYTES)
    try:
        data = json_object(content)
    except DataError as error:
        raise DataError(f"{path} is no state of a loop: {error}") from error
    if data.get("rtcal") != KIND:
        raise DataError(f'{path} is no state of a loop: its "rtcal" is not "{KIND}"')
    return data


def attributes(
    data: Mapping[str, Any], equation: LinearEquation | None
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the attributes of a loop, and of its steps, from the dict that `read` returns.

    ``equation`` replaces the one in the dict. Raises DataError or ModelError for an entry that
    breaks a rule.
    """
    state = Entries("", data, _KEYS, ("rtcal", "coefficients", "bent", EARLY.key, "beside"))
    room = Room.from_text(state.text("room"), "room")
    method = state.text("method")
    preset(method, room)
    wanted = state.array("wanted", (room.n_bands,), _T_LIMITS, missing=True)
    if np.isnan(wanted).all():
        raise DataError("wanted = null in every band: there is nothing to calibrate to")
    what = _matched(data[EARLY.key], wanted) if EARLY.key in data else Matched.t20(wanted)
    loop = {
        "room": room,
        "matched": what,
        "measured": state.text("measured"),
        "rule": state.choice("rule", RULES),
        "method": method,
        "equation": equation or _equation(data["equation"]),
        "decimals": checked_decimals(data["decimals"]),
        "tolerance": checks.positive("tolerance", data["tolerance"], "JND"),
        "bent": tuple(_bent(i, band) for i, band in enumerate(state.listed("bent", ()))),
        "beside": _means(state, "beside", room),
    }
    steps = [_step(i, step, room, what.wanted) for i, step in enumerate(state.listed("steps"))]
    return loop, steps


def matched_record(matched: Matched) -> dict[str, Any]:
    """Return what is matched as plain values: T20 as "wanted", and a share of EDT as "edt"."""
    record: dict[str, Any] = {"wanted": json_numbers(matched.measured[TARGET.key])}
    if EARLY.key in matched.shares:
        record[EARLY.key] = {
            "measured": json_numbers(matched.measured[EARLY.key]),
            "share": json_numbers(matched.shares[EARLY.key]),
        }
    return record


def _matched(data: Any, t20: Array) -> Matched:
    edt = Entries(f"{EARLY.key}.", data, ("measured", "share"))
    share = edt.array("share", t20.shape, (0.0, 1.0))
    measured = edt.array("measured", t20.shape, _T_LIMITS, missing=True)
    return Matched(
        measured={TARGET.key: t20, EARLY.key: measured},
        shares={TARGET.key: 1 - share, EARLY.key: share},
    )


def _bent(i: int, data: Any) -> BentDecay:
    band = Entries(f"bent[{i}].", data, ("frequency", "text"))
    return BentDecay(band.number("frequency", limits=(0.0, 1e6)), band.text("text"))


def means_record(means: Mapping[str, Array]) -> dict[str, Any]:
    """Return means by parameter and band as plain values."""
    return {parameter: json_numbers(values) for parameter, values in means.items()}


def step_record(step: Step) -> dict[str, Any]:
    """Return a step as plain values."""
    arrays = {name: json_numbers(getattr(step, name)) for name in _STEP_KEYS}
    return {**arrays, "heard": means_record(step.heard)}


def _means(of: Entries, key: str, room: Room) -> dict[str, Array]:
    """Return means by parameter and band; {} in files of before they were kept."""
    if key not in of:
        return {}
    means = of.entries(key, (), SHOWN)
    return {p: means.array(p, (room.n_bands,), _MEANS, missing=True) for p in means.values}


def _step(i: int, data: Any, room: Room, wanted: Array) -> dict[str, Any]:
    step = Entries(f"steps[{i}].", data, _STEP_KEYS, ("heard",))
    bands = (room.n_bands,)
    target = step.array("target", bands, _T_LIMITS, missing=True)
    if (lacking := np.flatnonzero(np.isnan(target) & np.isfinite(wanted))).size:
        raise DataError(f"{step.place}target[{lacking[0]}] = null, but the band has a measured T")
    return {
        "target": target,
        "alpha": step.array("alpha", room.alpha.shape, (0.0, 1.0)),
        "simulated": step.array("simulated", bands, _T_LIMITS, missing=True),
        "noise": step.array("noise", bands, (0.0, _T_LIMITS[1]), missing=True),
        "heard": _means(step, "heard", room),
    }


def checked_decimals(decimals: Any) -> int | None:
    """Return the decimals of alpha that a program reads, None for all; DataError where not 1 to 12."""
    if decimals is None:
        return None
    if (number := checks.whole("decimals", decimals, 1)) > MAX_DECIMALS:
        raise DataError(f"decimals = {number} is more than {MAX_DECIMALS}")
    return number


def coefficients_digest(alpha: Array) -> str:
    """Return a short identifier of absorption coefficients, (n_materials, n_bands), to nine decimals.

    The state and the room to simulate hold it, so that T of other coefficients can be refused.
    """
    rounded = np.round(alpha, 9) + 0.0  # no -0
    return hashlib.sha256(repr(rounded.shape).encode() + rounded.tobytes()).hexdigest()[:12]


def fingerprint(room: Room) -> str:
    """Return a short identifier of a room's materials, areas, bands, air and prior."""
    plain = (tuple(room.materials), room.volume, room.speed_of_sound)
    digest = hashlib.sha256(repr(plain).encode())
    for values in (
        room.areas,
        room.centre_frequencies,
        room.air_attenuation,
        room.alpha,
        room.sigma,
    ):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


def _equation(data: Any) -> LinearEquation:
    parameters = checks.mapped("equation", data)
    named = {"name": parameters.pop("name", None)}
    equation = linear_equation(Entries("equation.", named, ["name"]).text("name"))
    needed = [field.name for field in fields_of(equation)]
    return equation(**Entries("equation.", parameters, needed).values)
