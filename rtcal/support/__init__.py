"""The version, and what is imported at its first use: public names, optional libraries, their needs."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from typing import Any

from rtcal.support.errors import MissingDependencyError


def exports(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package (PEP 562).

    The public names are those that the package's ``__init__.py`` imports under ``if TYPE_CHECKING:``,
    each as ``from module import Name as Name``. Type checkers and editors read these imports; Python
    runs each of them when its name is first used. ``package`` and ``file`` are the package's
    ``__name__`` and ``__file__``::

        if TYPE_CHECKING:
            from rtcal.simulators.path_tracing import PathTracing as PathTracing
        else:
            __getattr__, __dir__, __all__ = support.exports(__name__, __file__)
    """
    modules = {
        alias.asname or alias.name: node.module or ""
        for block in ast.parse(Path(file).read_text(encoding="utf-8")).body
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if modules[name] == package:  # a module of the package itself
            return import_module(f"{package}.{name}")
        value = getattr(__import__(modules[name], fromlist=[name]), name)
        vars(import_module(package))[name] = value
        return value

    names = sorted(modules)
    return load, lambda: [*names], names


def library(message: str, name: str, *further: str) -> Any:
    """Return an optional library, with its ``further`` modules imported.

    ``name`` is that of the library. If it is not installed, raises MissingDependencyError with
    ``message``.
    """
    try:
        for module in further:
            import_module(module)
        return import_module(name)
    except ImportError as error:
        raise MissingDependencyError(message) from error


@contextmanager
def deferred(module: str, function: str) -> Iterator[None]:
    """Defer the import of a module that a library needs for one function, within a block.

    ``module`` is the name of the module, which is installed. A library that is imported in the block
    gets a ``function`` that imports the module at its first call. Any other name that is read from the
    module in the block imports it at once. If the module was imported before, nothing is deferred.
    """
    spec = None if module in sys.modules else find_spec(module)
    if spec is None:
        yield
        return
    stand_in = module_from_spec(spec)

    def given_back() -> None:
        if sys.modules.get(module) is stand_in:
            del sys.modules[module]

    def read(name: str) -> Any:
        given_back()
        return getattr(import_module(module), name)

    vars(stand_in)["__getattr__"] = read
    vars(stand_in)[function] = lambda *args, **options: read(function)(*args, **options)
    sys.modules[module] = stand_in
    try:
        yield
    finally:
        given_back()


__version__ = "0.1.0"
