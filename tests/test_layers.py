"""The shape of the house: imports go down only, and `import rtcal` stays light."""

import ast
import functools
import graphlib
import math
import subprocess
import sys
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
SEPARATE = [("simulators", "calibration"), ("exact", "calibration"), ("posterior", "calibration")]


def modules():
    return sorted(PACKAGE.rglob("*.py"))


def own_name(path):
    parts = ("rtcal", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(parts).removesuffix(".__init__")


NAMES = {own_name(path) for path in modules()}


@functools.cache
def imports_of(path):
    """Every module that a file imports: at its head, inside functions and under TYPE_CHECKING."""
    imported = set()
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


def package(name):
    parts = name.split(".")
    return parts[1] if parts[0] == "rtcal" and len(parts) > 1 else None


def test_imports_go_down_only():
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


def places(name):
    """Return a module's packages and its name; its compiled loops are of one name with it."""
    return [part.removesuffix("_kernel") for part in name.split(".")]


def test_independent_solvers_and_simulators_stand_apart():
    for path in modules():
        for first, second in SEPARATE:
            if first in places(own_name(path)):
                for name in imports_of(path):
                    parts = places(name)
                    assert first in parts or second not in parts, f"{path} imports {name}"


def test_no_import_circles():
    graph = {own_name(path): imports_of(path) & NAMES - {own_name(path)} for path in modules()}
    del graph["rtcal"]  # the public names
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError


def test_a_deferred_module_is_imported_at_the_first_call(tmp_path, monkeypatch):
    (tmp_path / "slow").mkdir()
    (tmp_path / "slow" / "__init__.py").write_text("def given(x):\n    return 2 * x\nother = 5\n")
    monkeypatch.syspath_prepend(tmp_path)
    with deferred("slow", "given"):
        from slow import given
    assert "slow" not in sys.modules
    assert given(4) == 8
    assert sys.modules.pop("slow").given is not given
    with deferred("slow", "given"):  # another name is imported at once
        from slow import other
    assert other == sys.modules.pop("slow").other == 5


def test_cvxpy_is_imported_without_the_statistics_that_it_hardly_needs():
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


def test_import_is_light():
    heavy = ("cvxpy", "scipy", "numba", "matplotlib", "clarabel", "osqp", "qpsolvers", "click")
    code = f"import rtcal, sys; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
