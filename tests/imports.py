"""Imports of the modules of a test world: a truth shares nothing with what it judges."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from pathlib import Path


def imported_by(folder: Path, besides: Collection[str] = ()) -> Iterator[str]:
    """Yield each module that the files of a folder import, "." for a relative import.

    ``besides`` names files that are left out.
    """
    for path in folder.glob("*.py"):
        if path.name in besides:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                yield node.module or "."
