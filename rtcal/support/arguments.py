"""Check the arguments of public functions against their annotations, after a call has failed.

`checked` does nothing if a call succeeds or raises one of `rt.errors`. After any other exception it
compares the arguments with the annotations. An argument of another type becomes a DataError that names
function, argument, value and rule. So does a number or nothing in place of an array, and so do arrays
whose shapes NumPy cannot combine. A successful call costs no check, and the functions' own, more
precise messages take precedence.

typeguard and beartype check before each call and take annotations literally. This module is looser: a
list or a tuple of numbers counts as an array, and an int as a float. It is also stricter: True is no
number, and a text is no sequence of texts. The two libraries also cost import time.
"""

from __future__ import annotations

import functools
import inspect
import numbers
import sys
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import InitVar
from importlib import import_module
from typing import Any, Literal, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

from rtcal.support import typing_imports
from rtcal.support.checks import public_name, shown
from rtcal.support.errors import DataError, RtcalError

F = TypeVar("F", bound=Callable[..., Any])
Test = Callable[[Any], bool]
Rule = tuple[Test, str]
"""A test of a value against an annotation, and the annotation in words."""

_OPTIONS = "**"
"""Key of the rules of a function whose further keyword arguments a TypedDict lists."""
_FEW = 1000
"""Largest number of members of a list or mapping that are checked; longer ones are not."""


def checked(target: F) -> F:
    """Decorate a function or class to name the wrong argument of a call that fails.

    It stands above ``@dataclass``, and below ``@classmethod`` and ``@staticmethod``.

    Examples
    --------
    >>> @checked
    ... def area(width: float, heights: "Sequence[float]" = ()) -> float:
    ...     return width * sum(heights)
    >>> area(2, [1, 3])
    8
    >>> area("2", [1.5])
    Traceback (most recent call last):
    rtcal.support.errors.DataError: arguments.area: width = '2' is not a number
    """
    if isinstance(target, type):
        target.__init__ = _wrapped(target.__init__, target.__name__)  # type: ignore[misc]
        return typing.cast("F", target)
    return typing.cast("F", _wrapped(target))


def _wrapped(function: Callable[..., Any], called: str = "") -> Callable[..., Any]:
    parameters = list(inspect.signature(function).parameters.values())
    positional = [
        p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)
    ]
    rules: dict[str, Rule | None] = {}

    def violation(args: tuple[Any, ...], kwargs: Mapping[str, Any], error: Exception) -> str | None:
        if not rules:
            rules.update(_rules(function, parameters))
        place = called or _place(function)
        values = dict([*zip(positional, args, strict=False), *kwargs.items()])
        if _OPTIONS in rules and (unknown := [name for name in kwargs if name not in rules]):
            known = ", ".join(name for name in rules if name not in ("self", _OPTIONS))
            return f"{place}: {unknown[0]} is no argument; it has {known}"
        for name, value in values.items():
            rule = rules.get(name)
            if rule is not None and not rule[0](value):
                return f"{place}: {name} = {shown(value)} is not {rule[1]}"
        arrays = {n: v for n, v in values.items() if v is not None and _of_arrays(rules.get(n))}
        reason = _unfit(arrays, error)
        return None if reason is None else f"{place}: {reason}"

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except RtcalError:
            raise
        except Exception as error:
            message = violation(args, kwargs, error)
            if message is None:
                raise
            raise DataError(message) from error

    return call


def check_fields(instance: Any) -> None:
    """Raise DataError for the first field of a dataclass that its annotation does not allow.

    For a class that only keeps its fields, so that a wrong one would fail where it is used. It is
    called at the end of ``__post_init__``.
    """
    kind: Any = type(instance)
    for name, rule in _rules_of(kind).items():
        if rule is not None and name != "self" and not rule[0](value := getattr(instance, name)):
            raise DataError(f"{kind.__name__}: {name} = {shown(value)} is not {rule[1]}")


@functools.cache
def _rules_of(kind: type) -> dict[str, Rule | None]:
    create = kind.__init__  # type: ignore[misc]
    return _rules(create, list(inspect.signature(create).parameters.values()))


def _place(function: Callable[..., Any]) -> str:
    """Return ``Class.method``, or a function's name after that of the package that has it."""
    if "." in function.__qualname__:
        return function.__qualname__
    return ".".join(public_name(function).split(".")[-2:])


_SHAPE_WORDS = (
    "broadcast",
    "matmul",
    "shape",
    "dimension",
    "mismatch",
    "out of bounds",
    "too many indices",
    "axis",
    "setting an array element",
    "zip()",
)
"""Parts of the messages about shapes and lengths that NumPy and Python raise."""


def _of_arrays(rule: Rule | None) -> bool:
    """Whether a rule asks for an array or a list of numbers, and not for a single number either."""
    if rule is None or "a number" in rule[1].split(" or "):
        return False
    return rule[0](np.ones(1)) and not rule[0]("")


def _unfit(arrays: Mapping[str, Any], error: Exception) -> str | None:
    """Return why arrays of the right type may have raised an error, None if nothing tells."""
    arrays = {n: v for n, v in arrays.items() if np.ndim(v) or isinstance(v, numbers.Real)}
    for name, value in arrays.items():
        if np.ndim(value) == 0:
            return f"{name} = {shown(value)} is a single number; an array is needed"
        if np.size(value) == 0:
            return f"{name} is empty"
        if isinstance(value, list | tuple) and type(value).__name__ in str(error):
            return f"{name} = {shown(value)} is a {type(value).__name__}; an array is needed"
    if isinstance(error, ValueError | IndexError) and any(w in str(error) for w in _SHAPE_WORDS):
        shapes = ", ".join(f"{name} {np.shape(value)}" for name, value in arrays.items())
        return f"shapes that do not fit: {shapes} ({error})" if shapes else None
    return None


def _rules(
    function: Callable[..., Any], parameters: list[inspect.Parameter]
) -> dict[str, Rule | None]:
    """Return a rule per parameter, None if any value is accepted. A default always is."""
    plain = inspect.unwrap(function)
    module = sys.modules[plain.__module__]
    names = _typing_names(module) | vars(module)
    out: dict[str, Rule | None] = {"self": None}
    for p in parameters:
        if p.kind is p.VAR_KEYWORD and "Unpack[" not in str(p.annotation):
            continue
        annotation = p.annotation
        if isinstance(annotation, str):
            try:
                annotation = eval(annotation, names)
            except NameError:  # imported for type checkers only
                annotation = Any
        if p.kind is p.VAR_KEYWORD:
            keywords = (
                typing.get_type_hints(get_args(annotation)[0]) if annotation is not Any else {}
            )
            out |= {name: _rule(of_keyword) for name, of_keyword in keywords.items()}
            out[_OPTIONS] = None
            continue
        rule = None if annotation is p.empty else _rule(annotation)
        out[p.name] = rule
    return out


def _typing_names(module: types.ModuleType) -> dict[str, Any]:
    """Return the names that a module imports only for type checkers, with their values."""
    try:
        imports = typing_imports(inspect.getsource(module))
    except OSError:  # no source file
        return {}
    return {name: getattr(import_module(origin), name, Any) for name, origin in imports.items()}


def _rule(annotation: Any) -> Rule | None:
    """Return the rule of an annotation, None if any value is accepted."""
    if isinstance(annotation, InitVar):
        annotation = annotation.type
    if annotation is None or annotation is types.NoneType:
        return lambda v: v is None, "None"
    origin, args = get_origin(annotation), get_args(annotation)
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    if annotation == ArrayLike or origin is np.ndarray or annotation is np.ndarray:
        return _is_array, "an array of real numbers"
    if origin in (typing.Union, types.UnionType):
        rules = [_rule(a) for a in args]
        return None if None in rules else _either(rules)
    if origin is Literal:
        return (
            lambda v: isinstance(v, str | int) and v in args,
            f"one of {', '.join(map(repr, args))}",
        )
    if origin is tuple and Ellipsis not in args:
        return _tuple([_rule(a) for a in args])
    if origin is not None and isinstance(origin, type):
        if issubclass(origin, Mapping):
            return _mapping(*[_rule(a) for a in args])
        if origin is not type and issubclass(origin, Iterable) and args:
            return _listing(origin, args[0])
        if origin is typing.get_origin(Callable[..., Any]):
            return _function(args[0] if args else ...)
        annotation = origin
    if not isinstance(annotation, type):
        return None
    if getattr(annotation, "_is_protocol", False) and not getattr(
        annotation, "_is_runtime_protocol", False
    ):
        return None
    if annotation is object:
        return None
    if annotation is type:
        return lambda v: isinstance(v, type), "a class"
    return lambda v: isinstance(v, annotation) and not isinstance(v, type), _article(annotation)


def _either(rules: list[Rule | None]) -> Rule:
    alternatives = [rule for rule in rules if rule is not None]
    tests = [test for test, _ in alternatives]
    return (
        lambda v: any(test(v) for test in tests),
        " or ".join(dict.fromkeys(words for _, words in alternatives)),
    )


def _listing(origin: type, member: Any) -> Rule:
    rule = _rule(member)
    words = "a list" if rule is None else f"a list whose members are each {rule[1]}"

    def test(value: Any) -> bool:
        if isinstance(value, str | bytes | Mapping) and not issubclass(origin, Mapping):
            return False
        if not isinstance(value, Iterable) or (isinstance(value, np.ndarray) and value.ndim == 0):
            return False
        if issubclass(origin, Collection) and not isinstance(value, Collection):
            return False  # a generator has no length, and is empty the second time
        if rule is None or not isinstance(value, Collection) or len(value) > _FEW:
            return True
        if rule is _SCALARS[float] and isinstance(value, np.ndarray):
            return value.ndim == 1 and _is_array(value)
        return all(rule[0](v) for v in value)

    return test, words


def _function(parameters: Any) -> Rule:
    """Return the rule of a function of so many arguments; of any number where they are not listed."""
    if not isinstance(parameters, list):
        return callable, "a function"

    def test(value: Any) -> bool:
        if not callable(value):
            return False
        try:
            signature = inspect.signature(value)
        except (TypeError, ValueError):  # written in C, and it does not tell
            return True
        try:
            signature.bind(*parameters)
        except TypeError:
            return False
        return True

    return test, f"a function of {len(parameters)} argument{'s' * (len(parameters) != 1)}"


def _tuple(rules: list[Rule | None]) -> Rule:
    def test(value: Any) -> bool:
        if isinstance(value, str | bytes | Mapping) or not isinstance(value, Collection):
            return False
        return len(value) == len(rules) and all(
            rule is None or rule[0](v) for rule, v in zip(rules, value, strict=True)
        )

    words = ", ".join("anything" if rule is None else rule[1] for rule in rules)
    return test, f"a tuple of {len(rules)}: {words}"


def _mapping(keys: Rule | None = None, values: Rule | None = None) -> Rule:
    def test(value: Any) -> bool:
        if not isinstance(value, Mapping):
            return False
        if len(value) > _FEW:
            return True
        return all(keys is None or keys[0](k) for k in value) and all(
            values is None or values[0](v) for v in value.values()
        )

    words = "" if values is None else f" whose values are each {values[1]}"
    return test, f"a mapping{words}"


def _is_number(value: Any) -> bool:
    if type(value) is float:
        return True
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    return isinstance(value, int | float | np.integer | np.floating) and _is_finite(value)


def _is_finite(value: object) -> bool:
    """Whether a number is no True and no whole number beyond double precision."""
    return not isinstance(value, bool) and (
        not isinstance(value, int) or abs(value) <= sys.float_info.max
    )


def _is_array(value: Any) -> bool:
    """Whether a value turns into an array of real numbers, without a text or None in it."""
    if value is None or isinstance(value, str | bytes | Mapping):
        return False
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        return False
    if array.dtype.kind == "O":
        members = array.ravel().tolist()
        return bool(members) and all(isinstance(v, numbers.Real) and _is_finite(v) for v in members)
    return array.dtype.kind in "fiub"


def _article(kind: type) -> str:
    name = public_name(kind) if kind.__module__.startswith("rtcal.") else kind.__name__
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"


_SCALARS: dict[Any, Rule | None] = {
    Any: None,
    float: (_is_number, "a number"),
    int: (
        lambda v: isinstance(v, int | np.integer) and not isinstance(v, bool),
        "a whole number",
    ),
    bool: (lambda v: isinstance(v, bool | np.bool_), "true or false"),
    str: (lambda v: isinstance(v, str), "a text"),
    bytes: (lambda v: isinstance(v, bytes), "bytes"),
}
