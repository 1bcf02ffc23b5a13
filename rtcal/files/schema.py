"""Files as types: msgspec checks a file's content against classes, and tomli-w writes it.

A table of a file is a dataclass, the object that the table describes, or a class derived from
`FileTable`: its fields are the keys that the table may have, with their types. What a type does not
say (ranges of physical values, lengths that must fit) is checked by the object's constructor. Text is
parsed strictly before.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
import sys
import tomllib
import types
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from rtcal.files.disk import read_bytes
from rtcal.support import checks
from rtcal.support.checks import shown
from rtcal.support.errors import DataError
from rtcal.support.text import decimal_comma

T = TypeVar("T")

_LARGEST = sys.float_info.max
Number = Annotated[float, msgspec.Meta(ge=-_LARGEST, le=_LARGEST)]
"""A finite number."""
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Point = tuple[Number, Number, Number]


# A text with half of a UTF-16 pair is a UnicodeEncodeError. From Python 3.13 on, msgspec takes an array
# or a range for a table, and asks it for its keys.
_REFUSED = msgspec.ValidationError, UnicodeEncodeError, IndexError, TypeError


class FileTable(msgspec.Struct, forbid_unknown_fields=True):
    """Describe a table of a file: its fields are the keys that the table may have."""


def read(kind: type[T], data: object, place: str = "") -> T:
    """Return the content of a file, or of a part of it, as a value of the type ``kind``.

    ``data`` is of `json_object` or `toml_table`, and ``place`` its name in messages. Raises DataError
    with place, value and rule.

    >>> class Material(FileTable):
    ...     name: str
    ...     alpha: list[float]
    >>> read(list[Material], [{"name": "wall", "alpha": [0.1, "a"]}], "material")
    Traceback (most recent call last):
    rtcal.support.errors.DataError: material "wall": alpha[1] = 'a' must be a number
    """
    checks.text("place", place)
    try:
        made = msgspec.convert(data, kind)
    except _REFUSED as error:
        fault = _fault(kind, data, place, refused=True)
        raise DataError(fault or f"{_whole(place)}: {error}") from error
    if wrong := _fault(kind, data, place, refused=False):
        raise DataError(wrong)
    return made


def _whole(place: str) -> str:
    return place.rstrip(":") or "the file"


def within(place: str, key: str) -> str:
    """Return the name of a key of a table in messages."""
    return f"{place} {key}" if place.endswith(":") else f"{place}.{key}" if place else key


def _fault(kind: Any, value: Any, place: str, *, refused: bool) -> str | None:
    """Return the first thing in a value that its type does not allow; None if there is none.

    Of what msgspec has not ``refused`` it is a key, since msgspec passes over those of dataclasses.
    """
    cause = None
    if refused:
        try:
            msgspec.convert(value, kind)
            return None
        except _REFUSED as error:
            cause = error.__cause__
    for option in _options(kind):
        if wrong := _wrong_key(option, value, place):
            return wrong
        for where, of, part in _parts(option, value, place):
            is_nested = isinstance(part, Mapping | list)
            if (refused or is_nested) and (fault := _fault(of, part, where, refused=refused)):
                return fault
    if not refused:
        return None
    if isinstance(cause, DataError):  # of the constructor
        return _of_part(kind, place, str(cause))
    if isinstance(value, int) and abs(value) > 1e300:
        return f"{place} = {shown(value)} is too large"
    most = max((m.le or m.lt or 0 for _, m in map(_bounds, _options(kind)) if m), default=0)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if number and not math.isfinite(value):
        return f"{place} = {value:g} must be finite"
    percent = checks.IN_PERCENT if number and most == 1 < value <= 100 else ""
    rule = " or ".join(dict.fromkeys(_words(option) for option in _options(kind)))
    comma = decimal_comma(value) if isinstance(value, str) else ""
    return f"{_whole(place)} = {shown(value)} must be {rule}{percent}{comma}"


def _of_part(kind: Any, place: str, message: str) -> str:
    """Return the message of a part's constructor behind the part's place, joined by a dot to a key."""
    if message.startswith(place):
        return message
    keys = {key for option in _options(kind) if _is_table(option) for key in _fields(option)}
    begins = re.match(r"\w*", message)
    is_key = begins is not None and begins[0] in keys
    return within(place, message) if is_key or not place else f"{place.rstrip(':')}: {message}"


def _is_list(kind: Any) -> bool:
    origin = get_origin(kind)
    return origin in (list, Sequence) or (origin is tuple and Ellipsis in get_args(kind))


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and (
        issubclass(kind, msgspec.Struct) or dataclasses.is_dataclass(kind)
    )


def _fields(table: Any) -> dict[str, bool]:
    """Return the keys of a table, and whether it must have each."""
    if not dataclasses.is_dataclass(table):
        return {f.name: f.required for f in msgspec.structs.fields(table)}
    missing = dataclasses.MISSING
    return {
        f.name: f.default is missing and f.default_factory is missing
        for f in dataclasses.fields(table)
    }


def _options(kind: Any) -> tuple[Any, ...]:
    """Return the types of a union without None; others are a single one."""
    if get_origin(kind) in (Union, types.UnionType):
        return tuple(o for each in get_args(kind) for o in _options(each) if each is not type(None))
    return (kind,)


def _bounds(kind: Any) -> tuple[Any, msgspec.Meta | None]:
    """Return an annotated type and its limits; None where it has none."""
    if get_origin(kind) is Annotated:
        bare, meta = get_args(kind)
        return bare, meta
    return kind, None


def _wrong_key(kind: Any, value: Any, place: str) -> str | None:
    """Return which key a table lacks, or has and may not; None if its keys are right."""
    if not (_is_table(kind) and isinstance(value, Mapping)):
        return None
    fields = _fields(kind)
    for key in value:
        if key not in fields:
            name = str(key)[:40]
            near = get_close_matches(name, fields, 1)
            among = get_close_matches(name, fields, 12, 0)
            more = ", ..." if len(fields) > len(among) else ""
            known = f". Known keys: {', '.join(among)}{more}"
            meant = f'; did you mean "{near[0]}"?' if near else known
            return f'{_whole(place)} has an unknown key, "{name}"{meant}'
    lacking = (name for name, needed in fields.items() if needed and name not in value)
    return next((f'{_whole(place)} lacks the key "{name}"; add it' for name in lacking), None)


def _parts(kind: Any, value: Any, place: str) -> Iterator[tuple[str, Any, Any]]:
    """Yield place, type and value of what a value of a type consists of."""
    bare, _ = _bounds(kind)
    origin, args = get_origin(bare), get_args(bare)
    if _is_table(bare) and isinstance(value, Mapping):
        hints = get_type_hints(bare, include_extras=True)
        yield from ((within(place, k), hints[k], v) for k, v in value.items() if k in hints)
    elif origin in (dict, Mapping) and isinstance(value, Mapping):
        yield from ((f"{place}: a name", args[0], key) for key in value)
        yield from ((f'{place}["{shown(k)[1:-1]}"]', args[1], v) for k, v in value.items())
    elif _is_list(bare) and isinstance(value, list | tuple):
        for i, each in enumerate(value):
            if _is_table(args[0]):
                name = each.get("name") if isinstance(each, Mapping) else None
                named = f'"{shown(name)[1:-1]}"' if isinstance(name, str) else str(i + 1)
                yield f"{place} {named}:", args[0], each
            else:
                yield f"{place}[{i}]", args[0], each
    elif origin is tuple and isinstance(value, list | tuple) and len(value) == len(args):
        yield from (
            (f"{place}[{i}]", a, v) for i, (a, v) in enumerate(zip(args, value, strict=True))
        )


_SCALARS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}


def _words(kind: Any) -> str:
    """Return what a type allows, in words."""
    bare, meta = _bounds(kind)
    origin, args = get_origin(bare), get_args(bare)
    if origin is Literal:
        return " or ".join(f'"{option}"' for option in args)
    if _is_list(bare) or origin is tuple:
        members = dict.fromkeys(_words(option) for option in _options(args[0]))
        plural = [f"lists{m[6:]}" if m.startswith("a list") else f"{m[2:]}s" for m in members]
        most = f"at most {meta.max_length} " if meta and meta.max_length else ""
        count = most if _is_list(bare) else f"{len(args)} "
        return f"a list of {count}{' or '.join(plural)}"
    if origin in (dict, Mapping):
        return f"a table{' with an entry' if meta else ''}"
    if meta is None or meta.le == _LARGEST:
        return _SCALARS.get(bare, "a table")
    ends = (("from {:g}", meta.ge), ("above {:g}", meta.gt), ("to {:g}", meta.le))
    limits = " ".join(words.format(end) for words, end in ends if end is not None)
    return f"{_SCALARS[bare]} {limits}"


MAX_DEPTH = 20
"""Largest nesting depth of a file; rtcal's formats need at most 6."""
MAX_DIGITS = 400
"""Largest number of digits of an integer; the largest float has 309."""
MAX_DOTS = 500
"""Largest number of parts of a dotted TOML key; tomllib's time grows with its square."""


def json_object(text: str) -> dict[str, Any]:
    """Return the object that a JSON text holds."""
    try:
        value = json.loads(
            text, object_pairs_hook=_unique, parse_constant=_no_number, parse_int=_integer
        )
    except RecursionError as error:
        raise DataError(f"the JSON cannot be read: {_TOO_DEEP}") from error
    except ValueError as error:
        raise DataError(f"not valid JSON: {error}{_decimal_comma(text, error)}") from error
    if not isinstance(value, dict):
        raise DataError("the file must hold one JSON object: {...}")
    _check_levels(value)
    return value


def toml_table(text: str) -> dict[str, Any]:
    """Return the table that a TOML text holds; DataError for a text that is no TOML."""
    if not isinstance(text, str):
        raise DataError(f"content = {shown(text)} must be a text")
    if any(line.count(".") > MAX_DOTS for line in text.split("\n") if "=" not in line[:MAX_DOTS]):
        raise DataError(f"a key has more than {MAX_DOTS} parts")
    if pairs := _PAIRS.search(text):
        line = text.count("\n", 0, pairs.start(1)) + 1
        raise DataError(f"line {line}: {pairs[1]} has decimal commas{decimal_comma(pairs[1])}")
    try:
        value = tomllib.loads(text)
    except RecursionError as error:
        raise DataError(f"the TOML cannot be read: {_TOO_DEEP}") from error
    except ValueError as error:
        raise DataError(f"not valid TOML: {error}{_decimal_comma(text, error)}") from error
    _check_levels(value)
    return value


_TOO_DEEP = f"more than {MAX_DEPTH} levels"
_PAIRS = re.compile(
    r"^[^#\"\n]*(\[\s*(?:0,\d+,\s+)+0,\d+\s*\]|\[(?:0,\d\d+,)+0,\d\d+\])", re.MULTILINE
)
"""A list of decimals with commas, which TOML would read as twice as many whole numbers."""


def _decimal_comma(text: str, error: ValueError) -> str:
    """Return words on the decimal comma at which a parser has stopped; "" if it was another fault."""
    at = re.search(r"line (\d+),? column (\d+)", str(error))
    line, column = text.split("\n")[int(at[1]) - 1][:200] if at else "", int(at[2]) if at else 0
    spans = (m for m in re.finditer(r"[\d,]+", line) if m.start() < column <= m.end() + 1)
    return next((decimal_comma(m[0]) for m in spans), "")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for i, key in enumerate(keys) if key in keys[:i])
        raise ValueError(f"the key {twice[:40]!r} is given twice")
    return table


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is not a number in JSON")


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer has {len(text)} digits; at most {MAX_DIGITS} are read")
    return int(text)


def _check_levels(value: Any) -> None:
    """Refuse too many levels, and text that cannot be written to a file again."""
    level: list[Any] = [value]
    for _ in range(MAX_DEPTH + 1):
        below: list[Any] = []
        for each in level:
            if isinstance(each, dict):
                below += each.keys()
                below += each.values()
            elif isinstance(each, list):
                below += each
            elif isinstance(each, str) and not each.isascii():
                try:
                    each.encode()
                except UnicodeEncodeError as error:
                    raise DataError(
                        f"{each[:40]!r} has an incomplete character (half of a surrogate pair)"
                    ) from error
        if not below:
            return
        level = below
    raise DataError(_TOO_DEEP)


ROOM = "a room"
_FIRST = "Give the room first, and then the measurement"
_HOLDS = {
    "rtcal": ("a saved result", "For its page use `rtcal report {0}`"),
    "configuration": ("a case", "A case names its measurements: give it alone, `rtcal find {0}`"),
    "variant": ("a file of variants", "Give it as `rtcal predict --change {0}`"),
    "treatment": ("a file of treatments", "Give it as `rtcal design --treatments {0}`"),
    "volume": (ROOM, _FIRST),
    "centre_frequencies": (ROOM, _FIRST),
}
"""What a file is by a key that no other kind has, and which command takes it."""
TABLE = "a table of values"
RESULT = "a saved result"
MADE = (
    "Make one first, such as `rtcal calibrate room.toml t.csv --out calibrated` or `rtcal find "
    "room.toml t.csv --out found`"
)
RESPONSE = "a recording or impulse response"
_HINTS = dict(_HOLDS.values()) | {
    TABLE: _FIRST,
    RESPONSE: "`rtcal measure {0}` makes a table of T from it",
}
_NEEDED = {RESULT: MADE, RESPONSE: "Give a sound file (WAV, FLAC) or a SOFA file"}
"""What to give where a kind is needed; for the others it follows from the file that was given."""
_EXAMPLE = dict.fromkeys(
    ("a file of variants", "a file of treatments"), "`rtcal example change` writes such a file"
) | {"a case": "`rtcal find` also takes a room, followed by its measurement"}
_NO_TABLE = re.compile(r"\s*(?:\[|\{|[\w.\"-]+\s*=)")
_MOST_OF_A_FILE = 2**25
_MOST_OF_TOML = 2**20  # Larger than any file of rtcal's in TOML; the parser needs seconds for more
_SOUNDS = (b"RIFF", b"RF64", b"riff", b"fLaC", b"FORM", b"OggS", b"caff", b"\x89HDF")
"""First bytes of WAV, W64, FLAC, AIFF, Ogg, CAF and SOFA files."""


def kind_of(path: str | os.PathLike[str]) -> str:
    """Return the kind of a file, such as "a room", "a case" or `RESULT`; "" for an unknown kind."""
    if _starts(path).startswith(_SOUNDS):
        return RESPONSE
    with suppress(DataError, UnicodeDecodeError):
        content = read_bytes(path, _MOST_OF_A_FILE)
        if content.startswith(b"PK"):
            return TABLE if b"xl/workbook" in content else ""
        text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "latin-1")
        is_json = text.lstrip()[:1] == "{"
        if is_json or len(text) <= _MOST_OF_TOML:
            with suppress(DataError):
                held = (json_object if is_json else toml_table)(text.replace("\r\n", "\n"))
                return next((kind for key, (kind, _) in _HOLDS.items() if key in held), "")
        first = [line for line in text.splitlines() if line.strip() and line.strip()[0] != "#"][:2]
        cells = [line for line in first if re.search(r"[,;\t]", line) and not _NO_TABLE.match(line)]
        return TABLE if len(cells) == 2 and "\0" not in text else ""
    return ""


def _starts(path: str | os.PathLike[str]) -> bytes:
    """Return the first bytes of a file, which may be too large to be read whole."""
    with suppress(OSError, ValueError):
        if os.path.isfile(path):
            with open(path, "rb") as stream:
                return stream.read(4)
    return b""


class OtherKindError(DataError):
    """Report a file of another kind than the one that is needed."""

    path: str
    needed: str
    hint: str = ""


@contextmanager
def expecting(kind: str, path: str | os.PathLike[str]) -> Iterator[None]:
    """Add the file's name to errors of reading it.

    OtherKindError if it is another kind of rtcal's files.
    """
    place = os.fspath(checks.path("path", path))
    try:
        yield
    except DataError as error:
        found = kind_of(place)
        if found not in ("", kind):
            needless = _HINTS[found] == _FIRST and kind not in (ROOM, TABLE)
            hint = _NEEDED.get(kind, _EXAMPLE.get(kind, "") if needless else _HINTS[found])
            hint = f". {hint.format(place)}" if hint else ""
            other = OtherKindError(f"{place} is {found}, but {kind} is needed here{hint}")
            other.path, other.needed, other.hint = place, kind, hint
            raise other from error
        if str(error).startswith((f"{place}:", f"{place},")):
            raise
        raise DataError(
            f"{place}{', ' if str(error).startswith('line ') else ': '}{error}"
        ) from error


def toml_text(table: Mapping[str, Any]) -> str:
    """Return plain values as the text of a TOML file, with each list of numbers on one line.

    Lists of tables, which must not contain further tables, stand at the end as ``[[key]]``.
    """
    import tomli_w

    lists = {k: v for k, v in table.items() if isinstance(v, list) and v and isinstance(v[0], dict)}
    texts = [tomli_w.dumps({k: v for k, v in table.items() if k not in lists})]
    for key, tables in lists.items():
        texts += [f"[[{key}]]\n{tomli_w.dumps(each)}" for each in tables]
    # tomli-w writes a text on one line, so that no line of a text begins so.
    return re.sub(
        r"\[\n((?: +[-+.\deinfa]+,\n)+) *\]",
        lambda found: f"[{', '.join(found[1].replace(',', ' ').split())}]",
        "\n".join(texts),
    )
