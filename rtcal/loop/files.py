"""The closed loop between two runs of a program: its state as a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from dataclasses import fields as fields_of
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics.equations import Eyring, Kuttruff, LinearEquation, Sabine
from rtcal.acoustics.room import Room
from rtcal.acoustics.room_files import parse_room, room_text
from rtcal.calibration.presets import preset
from rtcal.errors import DataError, ModelError
from rtcal.loop.rules import RULES
from rtcal.support import checks
from rtcal.support.files import json_numbers, read_text
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.loop.result import LoopResult
    from rtcal.loop.state import Loop

KIND = "loop 2"
"""What the key ``rtcal`` of a saved loop says."""
MAX_BYTES = 2**25
MOST_DECIMALS = 12

_LIMITS = (1e-6, 1e6)  # s, of T: a hard room without air has a longer one than was ever measured
_KEYS = (
    "rtcal",
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
_STEP = ("target", "alpha", "simulated", "noise")
_EQUATIONS = {e.name: e for e in (Sabine, Eyring, Kuttruff)}


def text(loop: Loop, result: Mapping[str, Any] | None = None) -> str:
    """Return a loop as JSON text; the room as the text of its file, ``result`` as `ends` gives it."""
    equation = loop.equation or Eyring()
    steps = [{name: json_numbers(getattr(step, name)) for name in _STEP} for step in loop.steps]
    return json.dumps(
        {
            "rtcal": KIND,
            "room": room_text(loop.room),
            "measured": loop.measured,
            "wanted": json_numbers(loop.wanted),
            "rule": loop.rule,
            "method": loop.method,
            "equation": {"name": equation.name, **asdict(equation)},
            "decimals": loop.decimals,
            "tolerance": loop.tolerance,
            "steps": steps,
            **({} if result is None else {"result": dict(result)}),
        },
        indent=1,
        ensure_ascii=False,
    )


def read(
    path: str, room: Room | None = None, equation: LinearEquation | None = None
) -> tuple[dict[str, Any], list[dict[str, Array]]]:
    """Return a saved loop's attributes and its steps'.

    With a room, a state of another one is refused; with an equation, it takes the place of the
    state's, which has to be Sabine's, Eyring's or Kuttruff's. DataError if the file is no loop.
    """
    content = read_text(path, MAX_BYTES)
    try:
        data = json.loads(content, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path} is no state of a loop: not JSON: {error}") from error
    if not isinstance(data, dict) or data.get("rtcal") != KIND:
        raise DataError(f"{path} is no state of a loop: it lacks the mark of one")
    try:
        fields, steps = _read(data, equation)
    except (DataError, ModelError) as error:
        raise DataError(f"{path} is no state of a loop: {error}") from error
    if room is not None:
        if fingerprint(room) != fingerprint(fields["room"]):
            raise DataError(
                f'{path} is the state of another room, or room "{room.name}" was changed since'
            )
        fields["room"] = room
    return fields, steps


def _read(
    data: dict[str, Any], equation: LinearEquation | None
) -> tuple[dict[str, Any], list[dict[str, Array]]]:
    _keys("the file", data, _KEYS, ("result",))
    for key in ("room", "measured", "rule", "method"):
        if not isinstance(data[key], str):
            raise DataError(f"{key} = {str(data[key])[:40]!r} is not a text")
    own = parse_room(data["room"], "room")
    if data["rule"] not in RULES:
        raise DataError(f'rule = "{data["rule"][:40]}" is not one of {", ".join(RULES)}')
    preset(data["method"], own)
    shape = own.alpha.shape
    fields = {
        "room": own,
        "wanted": _times("wanted", data["wanted"], own.n_bands, missing=True),
        "measured": data["measured"],
        "rule": data["rule"],
        "method": data["method"],
        "equation": equation or _equation(data["equation"]),
        "decimals": readable(data["decimals"]),
        "tolerance": checks.positive("tolerance", data["tolerance"], "JND"),
    }
    if np.isnan(fields["wanted"]).all():
        raise DataError("wanted = null in every band: there is nothing to calibrate to")
    if not isinstance(data["steps"], list):
        raise DataError(f"steps = {str(data['steps'])[:40]!r} is not a list")
    steps = []
    for i, step in enumerate(data["steps"]):
        at = f"steps[{i}]"
        _keys(at, step, _STEP)
        target = _times(f"{at}.target", step["target"], own.n_bands, missing=True)
        if (lacking := np.flatnonzero(np.isnan(target) & np.isfinite(fields["wanted"]))).size:
            raise DataError(f"{at}.target[{lacking[0]}] = null, but the band has a measured T")
        simulated = _times(f"{at}.simulated", step["simulated"], own.n_bands, missing=True)
        steps.append(
            {
                "target": target,
                "alpha": _array(f"{at}.alpha", step["alpha"], shape, (0.0, 1.0)),
                "simulated": simulated,
                "noise": _array(
                    f"{at}.noise", step["noise"], shape[1:], (0.0, _LIMITS[1]), missing=True
                ),
            }
        )
    return fields, steps


def ends(result: LoopResult) -> dict[str, Any]:
    """Return what a simulator had before and after, means by parameter and band; JSON-able."""
    found = {"before": result.before, "after": result.final}
    return {
        "simulator": result.simulator,
        "confirmed": result.confirmation is not None,
        "status": list(result.status),
        **{
            name: {p: json_numbers(measurement.mean(p)) for p in measurement.values}
            for name, measurement in found.items()
        },
    }


def readable(decimals: Any) -> int | None:
    """Return the decimals of alpha that a program reads, None for all; DataError where not 1 to 12."""
    if decimals is None:
        return None
    if (found := checks.whole("decimals", decimals, 1)) > MOST_DECIMALS:
        raise DataError(f"decimals = {found} is more than {MOST_DECIMALS}")
    return found


def fingerprint(room: Room) -> str:
    """Return a short name of a room's materials, areas, bands, air and prior."""
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


def _equation(stated: Any) -> LinearEquation:
    own = dict(checks.mapped("equation", stated))
    name = own.pop("name", None)
    if not isinstance(name, str) or name not in _EQUATIONS:
        raise DataError(f"equation.name = {str(name)[:40]!r} is not one of {', '.join(_EQUATIONS)}")
    kind = _EQUATIONS[name]
    _keys("equation", own, [f.name for f in fields_of(kind)])
    return kind(**own)


def _keys(place: str, found: Any, needed: Sequence[str], more: Sequence[str] = ()) -> None:
    """Raise DataError unless it is an object with these keys and no others."""
    if not isinstance(found, dict):
        raise DataError(f"{place} = {str(found)[:40]!r} is not an object")
    if missing := [key for key in needed if key not in found]:
        raise DataError(f"{place} lacks {missing[0]}")
    if unknown := [key for key in found if key not in (*needed, *more)]:
        raise DataError(f'{place} has the key "{unknown[0][:40]}", which means nothing')


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is no number of JSON's")


def _times(place: str, values: Any, n_bands: int, missing: bool = False) -> Array:
    return _array(place, values, (n_bands,), _LIMITS, missing)


def _array(
    place: str,
    values: Any,
    shape: tuple[int, ...],
    limits: tuple[float, float],
    missing: bool = False,
) -> Array:
    """Return nested lists of numbers within the limits, null where one is missing, as an array."""
    if shape:
        if not isinstance(values, list) or len(values) != shape[0]:
            raise DataError(f"{place} is not a list of {shape[0]} values")
        return np.array(
            [_array(f"{place}[{i}]", v, shape[1:], limits, missing) for i, v in enumerate(values)]
        )
    if values is None and missing:
        return np.array(np.nan)
    value = checks.number(place, values)
    if not limits[0] <= value <= limits[1]:
        raise DataError(f"{place} = {value:g} is not from {limits[0]:g} to {limits[1]:g}")
    return np.array(value)
