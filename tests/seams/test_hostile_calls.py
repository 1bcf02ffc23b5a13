"""A law: whatever is given to a public class or reader, the error is a typed one.

Functions may raise Python's own errors for a wrong type or shape: the kinds in `tests.hostile.PLAIN`.
"""

from __future__ import annotations

import inspect
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests import hostile
from tests.hostile import ends, functions, made_here


@pytest.fixture
def quiet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Warnings of values that are no numbers are not asked for here; what is written is thrown away."""
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield


def test_classes_and_readers(tmp_path: Path, quiet: None) -> None:
    """One call in three. A constructor's error names the argument, as a rule."""
    examples = hostile.instances(tmp_path, searched=False)
    made = [(name, f) for name, f in functions(examples[0]) if made_here(name, f)]
    counts: Counter[str] = Counter()
    wrong = []
    classes = {name for name, function in made if inspect.isclass(function)}
    named = Counter[bool]()
    for name, end, why in ends(made, examples, every=3):
        counts[end] += 1
        if end in ("untyped", "endless"):
            wrong.append(why)
        if end == "typed" and name in classes:
            call, _, message = why.partition("): typed ")
            parameter = call.removeprefix(f"{name}(").partition("=")[0]
            named[parameter.removesuffix("s") in message] += 1
    assert not wrong, "\n".join(wrong)
    assert (
        named[True] > 0.8 * named.total()
    )  # where not, an example lacks, or another rule is first
    assert named.total() > 1000
    assert counts["typed"] > 3500
    assert counts.total() > 5000


@pytest.mark.long
def test_every_public_function(tmp_path: Path, quiet: None) -> None:
    examples = hostile.instances(tmp_path)
    counts: Counter[str] = Counter()
    wrong = []
    for _, end, why in ends(functions(examples[0]), examples, seconds=5):
        counts[end] += 1
        if end in ("untyped", "endless"):
            wrong.append(why)
    assert counts.total() > 30_000
    assert not wrong, "\n".join(wrong)
