"""Whether every public attribute of a result is of the type that its class states."""

from __future__ import annotations

import inspect
import sys
import types
import typing
from collections.abc import Iterable, Mapping
from functools import cached_property
from importlib import import_module
from typing import Any, ClassVar, Literal, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

from rtcal.files.saved import Result
from rtcal.support import typing_imports


def _names(module: types.ModuleType) -> dict[str, Any]:
    """Return the names of a module, with those that it imports for type checkers only."""
    imports = typing_imports(inspect.getsource(module))
    found = {name: getattr(import_module(origin), name, Any) for name, origin in imports.items()}
    return found | vars(module)


def fits(annotation: Any, value: Any) -> bool:
    """Whether a value is of an annotated type: True is no number, a text no sequence of texts."""
    origin, args = get_origin(annotation), get_args(annotation)
    if annotation in (Any, object):
        return True
    if annotation in (None, types.NoneType):
        return value is None
    if annotation in (float, int):
        kinds = (int, np.integer) if annotation is int else (int, float, np.integer, np.floating)
        return isinstance(value, kinds) and not isinstance(value, bool)
    if annotation is bool:
        return isinstance(value, bool | np.bool_)
    if annotation == ArrayLike or origin is np.ndarray or annotation is np.ndarray:
        return isinstance(value, np.ndarray)
    if origin in (typing.Union, types.UnionType):
        return any(fits(each, value) for each in args)
    if origin is Literal:
        return value in args
    if origin is tuple and Ellipsis not in args:
        return len(value) == len(args) and all(map(fits, args, value))
    if origin is None:
        return not isinstance(annotation, type) or isinstance(value, annotation)
    if not isinstance(origin, type) or not args:
        return True
    if not isinstance(value, origin) and not (
        isinstance(value, np.ndarray) and issubclass(origin, Iterable)
    ):
        return False
    if issubclass(origin, Mapping):
        return all(fits(args[0], k) and fits(args[1], v) for k, v in value.items())
    if issubclass(origin, Iterable):
        return not isinstance(value, str) and all(fits(args[0], each) for each in value)
    return True


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
        kind: Any = eval(annotation, _names(source))
        if get_origin(kind) is ClassVar or kind is ClassVar:
            continue
        value = getattr(result, name)
        if not fits(kind, value):
            wrong.append(f"{type(result).__name__}.{name} = {value!r:.60} is no {annotation}")
    return wrong
