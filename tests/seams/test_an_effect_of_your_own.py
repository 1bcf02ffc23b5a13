"""An effect of a user's own is one class, and both observation models find it where it may stand."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder.effects import Absorber, Parameters
from rtcal.finder.positions.search import of_means
from rtcal.support.types import Array
from tests.test_where import measured, stated, tracing


@dataclass(frozen=True)
class Hatch(Absorber):
    """The hidden opening, under a name that rtcal does not have."""

    name: ClassVar[str] = "hatch"
    family: ClassVar[str] = "added absorption, hatches"
    stands_on: ClassVar[Sequence[str]] = ("wall",)

    def spectrum(self, frequencies: Array, parameters: Parameters) -> Array:
        return np.full(len(frequencies), 0.98)


OWN = [e for e in rt.finder.library() if e.name != "opening"] + [Hatch()]


@pytest.fixture(scope="module")
def case():
    return rt.finder.PositionsCase(
        simulator=tracing(stated(), n_paths=800), measured=measured(True)
    )


@pytest.mark.long
def test_it_is_found_on_the_wall_where_it_stands(case, kept):
    finding = rt.find(case, effects=OWN, cache=kept)
    hatches = [c for c in finding.candidates if c.effect == "hatch"]
    assert hatches[0].surface == "east"
    assert hatches[0].low < 6.0 < hatches[0].high
    assert {c.surface for c in hatches} == {"east", "west", "north", "south"}
    assert finding.probabilities["hatch"] > 0.05
    assert "opening" not in finding.probabilities
    verified = rt.finder.verify(finding, cache=kept)
    assert verified.after < 0.9 * verified.before


@pytest.mark.long
def test_it_is_found_by_means_over_positions(case):
    finding = rt.find(of_means(case), effects=OWN)
    assert finding.families["added absorption, hatches"] > 0.05
