"""A law: whatever is given to a public class, reader or function, the error is a typed one.

What stays an error of Python's own is listed in `benchmarks.wrong_arguments.PLAIN`.
"""

from __future__ import annotations

import inspect
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks import wrong_arguments
from benchmarks.wrong_arguments import PLAIN, ends, functions, made_here


@pytest.fixture
def quiet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Warnings of values that are no numbers are not asked for here; what is written is thrown away."""
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield


def test_what_is_listed_is_public_and_raised(quiet: None) -> None:
    """An entry that is no longer needed is to be struck; no class and no reader is ever listed."""
    public = dict(functions({}))
    for name, parameter in PLAIN:
        assert parameter in inspect.signature(public[name]).parameters
        assert not made_here(name, public[name]), name
    own = {"rt.acoustics.observables.of_kind", "rt.acoustics.observables.register"}
    for name in (*own, "rt.terms.half_squares"):
        found = {end for _, end, _ in ends([(name, public[name])], ({}, {}))}
        assert "plain" in found, name
        assert "untyped" not in found, name


def test_classes_and_readers(tmp_path: Path, quiet: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """One call in seven; a class without its decorator, since its constructor checks by itself."""
    examples = wrong_arguments.instances(tmp_path, searched=False)
    made = [(name, f) for name, f in functions(examples[0]) if made_here(name, f)]
    for _, function in made:
        if inspect.isclass(function):
            create = inspect.unwrap(function.__init__)
            monkeypatch.setattr(function, "__init__", create)
    counts: Counter[str] = Counter()
    wrong = []
    for _, end, why in ends(made, examples, every=7):
        counts[end] += 1
        if end in ("untyped", "endless", "plain"):
            wrong.append(why)
    assert not wrong, "\n".join(wrong)
    assert counts["typed"] > 1500
    assert counts.total() > 2500


@pytest.mark.long
def test_every_public_function(tmp_path: Path, quiet: None) -> None:
    examples = wrong_arguments.instances(tmp_path)
    counts: Counter[str] = Counter()
    wrong = []
    for _, end, why in ends(functions(examples[0]), examples, seconds=5):
        counts[end] += 1
        if end in ("untyped", "endless"):
            wrong.append(why)
    assert counts.total() > 40_000
    assert not wrong, "\n".join(wrong)
