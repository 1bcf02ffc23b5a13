"""The shape of the house: imports go down only, and `import rtcal` stays light."""

from __future__ import annotations

import ast
import functools
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import rtcal as rt
from rtcal.support import deferred

PACKAGE = Path(rt.__file__).parent

# From the ground up. A package imports itself and what stands before it: no two may import each other.
ORDER = (
    "support",
    "files",
    "acoustics",
    "simulators",
    "io",
    "prediction",
    "calibration",
    "modes",
    "loop",
    "studies",
    "finder",
    "datasets",
    "report",
    "command",
    "__main__",
)
SEPARATE = [
    ("simulators", "calibration"),
    ("exact", "calibration"),
    ("posterior", "calibration"),
]


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def own_name(path: Path) -> str:
    parts = ("rtcal", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(parts).removesuffix(".__init__")


NAMES = {own_name(path) for path in modules()}


@functools.cache
def imports_of(path: Path) -> set[str]:
    """Every module that a file imports: at its head, inside functions and under TYPE_CHECKING."""
    imported: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                imported.add(full if full in NAMES else node.module)
        elif (
            isinstance(node, ast.Call) and getattr(node.func, "id", "") == "library"
        ):  # of `support`
            imported |= {name.value for name in node.args[1:] if isinstance(name, ast.Constant)}
    return imported


def package(name: str) -> str | None:
    parts = name.split(".")
    return parts[1] if parts[0] == "rtcal" and len(parts) > 1 else None


def test_imports_go_down_only() -> None:
    wrong = []
    for path in modules():
        own = package(own_name(path))
        if own is None:
            continue  # the public names
        assert own in ORDER, f"{path} belongs to no layer"
        for name in imports_of(path):
            other = package(name)
            if name == "rtcal" or (other is not None and ORDER.index(other) > ORDER.index(own)):
                wrong.append(f"{own_name(path)} imports {name}, which stands above it")
    assert wrong == []


def places(name: str) -> list[str]:
    """Return a module's packages and its name; its compiled loops are of one name with it."""
    return [part.removesuffix("_kernel") for part in name.split(".")]


def test_independent_solvers_and_simulators_stand_apart() -> None:
    for path in modules():
        for first, second in SEPARATE:
            if first in places(own_name(path)):
                for name in imports_of(path):
                    parts = places(name)
                    assert first in parts or second not in parts, f"{path} imports {name}"


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the first circle found from each module, as the names along it."""
    done: set[str] = set()
    found = []

    def visit(name: str, trail: list[str]) -> None:
        if name in trail:
            found.append([*trail[trail.index(name) :], name])
        elif name not in done:
            for other in sorted(graph.get(name, ())):
                if other != name:
                    visit(other, [*trail, name])
            done.add(name)

    for name in sorted(graph):
        visit(name, [])
    return found


def test_no_import_circles() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}}) == [["a", "b", "c", "a"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}}) == []
    graph = {own_name(path): imports_of(path) & NAMES for path in modules()}
    del graph["rtcal"]  # the public names
    assert [" -> ".join(circle) for circle in circles(graph)] == []


@pytest.fixture
def slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    package = tmp_path / "slow"
    package.mkdir()
    (package / "__init__.py").write_text("def given(x):\n    return 2 * x\nother = 5\n")
    (package / "part.py").write_text("from slow import other\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield
    for name in ("slow", "slow.part"):
        sys.modules.pop(name, None)


@pytest.mark.usefixtures("slow")
def test_a_deferred_module_is_imported_at_the_first_call() -> None:
    with deferred("slow", "given"):
        from slow import given
    assert "slow" not in sys.modules
    assert given(4) == 8
    assert sys.modules["slow"].given is not given


@pytest.mark.usefixtures("slow")
def test_other_names_of_a_deferred_module_are_imported_at_once() -> None:
    with deferred("slow", "given"):
        from slow.part import other
    assert other == 5
    assert sys.modules["slow"].other == 5
    before = sys.modules["slow"]
    with deferred("slow", "given"):
        assert sys.modules["slow"] is before


def test_cvxpy_is_imported_without_the_statistics_that_it_hardly_needs() -> None:
    code = """
import sys
from rtcal.calibration.unknowns import cp
cp.Variable
print("scipy.stats" in sys.modules)
entropy = sys.modules["cvxpy.atoms.quantum_rel_entr"].entropy
print(entropy([1, 1]), "scipy.stats" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    value, loaded = second.split()
    assert (first, loaded) == ("False", "True")
    assert float(value) == pytest.approx(math.log(2))


def test_import_is_light() -> None:
    heavy = ("cvxpy", "scipy", "numba", "matplotlib", "clarabel", "osqp", "qpsolvers", "click")
    code = f"import rtcal, sys; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
