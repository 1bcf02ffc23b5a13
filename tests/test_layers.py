"""The shape of the house: imports go down only, and `import rtcal` stays light."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rtcal as rt

PACKAGE = Path(rt.__file__).parent

# Lower may not import higher; modules of one layer may import each other without a cycle.
LAYERS = {
    "types": 0, "errors": 0, "jit": 0, "checks": 0, "progress": 0,
    "acoustics": 1, "priors": 2, "calibration": 3, "simulators": 4,
    "loop": 5, "loop_rules": 5, "loop_state": 5, "loop_result": 5, "closed_loop": 5,
    "studies": 5, "discrepancy": 5,
    "io": 6, "report": 6, "datasets": 6, "cli": 7, "study_command": 7, "io_commands": 7,
    "loop_command": 7, "report_command": 7, "gap_command": 7, "console": 7,
}  # fmt: skip
SEPARATE = [("simulators", "calibration"), ("exact", "problem"), ("closed_form", "problem")]
ONE_DOOR = ("matplotlib", "pyroomacoustics", "pyrato", "pyfar", "numba", "tqdm", "jinja2")


def imports_of(path: Path) -> list[tuple[str, bool]]:
    """Every imported module, and whether it is imported for type checking only."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    checking = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for inner in ast.walk(node)
    }
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, id(node) in checking) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found += [(name, id(node) in checking) for name in names]
    return found


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def layer(name: str) -> int | None:
    parts = name.split(".")
    return LAYERS.get(parts[1]) if parts[0] == "rtcal" and len(parts) > 1 else None


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_down_only(path: Path) -> None:
    own = path.relative_to(PACKAGE).with_suffix("").parts
    if own == ("__init__",):
        return
    assert own[0] in LAYERS, f"{path} belongs to no layer"
    for name, checking in imports_of(path):
        other = layer(name)
        if other is not None and not checking:
            assert other <= LAYERS[own[0]], f"{'.'.join(own)} imports {name}, which stands above it"


def test_witnesses_and_simulators_stand_apart() -> None:
    for path in modules():
        own = path.relative_to(PACKAGE).with_suffix("").parts
        for first, second in SEPARATE:
            if first in own:
                for name, checking in imports_of(path):
                    assert checking or second not in name.split("."), f"{path} imports {name}"


@pytest.mark.parametrize("library", ONE_DOOR)
def test_each_optional_library_has_one_door(library: str) -> None:
    doors = {
        str(p.relative_to(PACKAGE)) for p in modules() for n, _ in imports_of(p)
        if n.split(".")[0] == library
    }  # fmt: skip
    assert len(doors) <= 1, f"{library} is imported by {sorted(doors)}"


def test_no_import_cycles() -> None:
    graph: dict[str, set[str]] = {}
    names = {
        ".".join(("rtcal", *p.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
        for p in modules()
    }
    for path in modules():
        own = ".".join(("rtcal", *path.relative_to(PACKAGE).with_suffix("").parts))
        own = own.removesuffix(".__init__")
        top = ast.parse(path.read_text(encoding="utf-8")).body
        graph[own] = set()
        for node in top:  # imports at module level only: an import inside a function makes no cycle
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    full = f"{node.module}.{alias.name}"
                    graph[own].add(full if full in names else node.module)
    state: dict[str, int] = {}

    def visit(name: str, path: tuple[str, ...]) -> None:
        if state.get(name) == 2 or name not in graph:
            return
        assert state.get(name) != 1, f"import cycle: {' -> '.join((*path, name))}"
        state[name] = 1
        for other in graph[name]:
            if other != name:
                visit(other, (*path, name))
        state[name] = 2

    for name in graph:
        visit(name, ())


def test_import_is_light() -> None:
    heavy = ("cvxpy", "scipy", "numba", "matplotlib", "clarabel", "osqp", "qpsolvers", "click")
    code = f"import rtcal, sys; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_resolves() -> None:
    own = [n for n, (_, attribute) in rt._EXPORTS.items() if attribute is not None]
    assert len(own) <= 20
    assert set(rt.__all__) == set(rt._EXPORTS)
    for name in rt.__all__:
        assert getattr(rt, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        _ = rt.nonsense
