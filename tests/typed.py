"""Whether every public attribute of a result is of the type that its class states."""

from __future__ import annotations

import sys
from functools import cached_property
from typing import Any, ClassVar, get_origin

from rtcal.support.arguments import _rule, _typing_names
from rtcal.support.saved import Result


def stated_types(kind: type) -> dict[str, tuple[str, str]]:
    """Return annotation and module of each public field and property of a class, by name."""
    stated: dict[str, tuple[str, str]] = {}
    for base in reversed(kind.__mro__):
        own = dict(vars(base).get("__annotations__", {}))
        for name, value in vars(base).items():
            if isinstance(value, property):
                own[name] = value.fget.__annotations__.get("return", "Any")
            elif isinstance(value, cached_property):
                own[name] = value.func.__annotations__.get("return", "Any")
        stated |= {n: (str(a), base.__module__) for n, a in own.items() if not n.startswith("_")}
    return stated


def wrongly_typed(result: Result) -> list[str]:
    """Return the attributes whose value is not of the stated type."""
    wrong = []
    for name, (annotation, module) in stated_types(type(result)).items():
        source = sys.modules[module]
        kind: Any = eval(annotation, _typing_names(source) | vars(source))
        if get_origin(kind) is ClassVar or kind is ClassVar:
            continue
        rule, value = _rule(kind), getattr(result, name)
        if rule is not None and not rule[0](value):
            wrong.append(f"{type(result).__name__}.{name} = {value!r:.60} is not {rule[1]}")
    return wrong


def types_by_attribute(*kinds: type) -> dict[str, set[str]]:
    """Return the types that classes state of an attribute of one name, without what may be None."""
    found: dict[str, set[str]] = {}
    for kind in kinds:
        for name, (annotation, _) in stated_types(kind).items():
            if "ClassVar" not in annotation:
                found.setdefault(name, set()).add(annotation.removesuffix(" | None"))
    return found
