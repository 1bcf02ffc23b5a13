"""What the API pages show: the names that a user calls or is handed, found anew at each build.

Public are

- the names that the packages export (`__all__`, from `rtcal` downwards), the errors among them;
- the names that a page or a tutorial imports, or writes with their path, as `rtcal.io.text.Sheet`;
- the classes that a public function takes or returns;
- the bases of a public class and the classes that its members name, if an API page has their name in
  backquotes: to show one, say there what hands it out.

Of a public class every documented member is shown, except where a class in its signature is not public,
and of a module its text, if it is exported. What is exported is labelled with the path by which it is
reached. In a module the shortest paths come first, functions before classes, then what else is public.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from math import inf
from pathlib import Path
from typing import Any

import griffe

ROOT = Path(__file__).parent
API = [page.read_text(encoding="utf-8") for page in sorted(ROOT.glob("docs/api/*.md"))]
GUIDES = [
    page.read_text(encoding="utf-8")
    for pages in ("docs/*.md", "notebooks/tutorials/*.ipynb")
    for page in sorted(ROOT.glob(pages))
]


class PublicNames(griffe.Extension):
    """Mark what is public in the package; the option `filters: public` then shows nothing else."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Mark every object of the package as public or not."""
        reached = exported(pkg)
        public = public_names(pkg)
        length = {one.path: path.count(".") for path, one in reached.items()}
        modules = [pkg]
        for module in modules:
            if module.path not in length:
                module.docstring = None
            own = [one for one in module.members.values() if not one.is_alias]
            own.sort(key=lambda one: (length.get(one.path, inf), not one.is_function))
            module.exports = [one.name for one in own]
            for one in own:
                if one.is_module:
                    modules.append(one)
                one.public = one.path in public
                for member in one.members.values() if one.is_class else ():
                    if not member.is_alias:
                        classes = (named for named in _named_by(member) if named.is_class)
                        known = all(named.path in public for named in classes)
                        member.public = known and not member.name.startswith("_")
        for path, one in reached.items():
            one.labels.add(path.replace("rtcal", "rt", 1))


def public_names(pkg: griffe.Module) -> dict[str, griffe.Object]:
    """Return what is public at the head of the package's modules, by the path of its definition."""
    written = filter(None, (_found(pkg, path) for path in _written()))
    waiting = [
        one
        for one in (*exported(pkg).values(), *written)
        if not one.is_module and one.parent.is_module
    ]
    public = {one.path: one for one in waiting}
    handed = set(re.findall(r"`(\w+)`", "\n".join(API)))
    for one in waiting:
        for named in _named_by(one):
            if named.path not in public and (not one.is_class or named.name in handed):
                public[named.path] = named
                waiting.append(named)
    return public


def exported(pkg: griffe.Module, package: str = "rtcal") -> dict[str, griffe.Object]:
    """Return what a package exports, and what the modules among it do, by the path of its name."""
    found = {}
    for name in import_module(pkg.modules_collection[package].canonical_path).__all__:
        path = f"{package}.{name}"
        if one := _found(pkg, path):
            found[path] = one
            if one.is_module:
                found |= exported(pkg, path)
    return found


def _written() -> Iterator[str]:
    """Return the paths that pages and tutorials write or import, and those by a module's short name."""
    for page in (*API, *GUIDES):
        text = re.sub("^:::.*", "", page, flags=re.M)
        for path in re.findall(r"\brt(?:cal)?((?:\.\w+)+)", text):
            yield f"rtcal{path}"
        for module, names in re.findall(r"from (rtcal[\w.]*) import \(?([\w, ]+)", text):
            for name in names.replace(" ", "").split(","):
                yield f"{module}.{name}"
                for inner in re.findall(rf"\b{name}\.(\w+)", text):
                    yield f"{module}.{name}.{inner}"


def _found(pkg: griffe.Module, path: str) -> griffe.Object | None:
    """Return what the package has at a path, where it is defined."""
    try:
        one = pkg.modules_collection[path]
        return one.final_target if one.is_alias else one
    except (KeyError, griffe.AliasResolutionError):
        return None


def _named_by(one: griffe.Object) -> Iterator[griffe.Object]:
    """Return the package's classes and types that the signature of an object names."""
    if one.is_function:
        stated = [one.returns, *(parameter.annotation for parameter in one.parameters)]
    elif one.is_class:
        stated = list(one.bases)
        for member in one.members.values():
            if not (member.is_alias or member.name.startswith("_")):
                yield from _named_by(member)
    elif isinstance(one.value, griffe.ExprCall):  # a constant, made by its class
        stated = [one.annotation, one.value.function]
    else:
        stated = [one.annotation]
    for expression in stated:
        yield from _types(one, expression)


def _is_type_variable(one: griffe.Object) -> bool:
    """Return whether an object is a type variable, which no reader of a page needs."""
    value = one.value if one.is_attribute else None
    return isinstance(value, griffe.ExprCall) and str(value.function) == "TypeVar"


def _types(one: griffe.Object, expression: str | griffe.Expr | None) -> Iterator[griffe.Object]:
    """Return the classes of the package in an annotation, and those behind an alias of types."""
    if not isinstance(expression, griffe.Expr):
        return
    for name in expression.iterate(flat=True):
        named = _found(one, name.canonical_path) if isinstance(name, griffe.ExprName) else None
        if (
            named is None
            or named.is_module
            or not named.parent.is_module
            or _is_type_variable(named)
        ):
            continue
        yield named
        if named.is_attribute and not isinstance(named.value, griffe.ExprCall):
            yield from _types(named, named.value)
