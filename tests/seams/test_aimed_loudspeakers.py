"""A loudspeaker that aims somewhere is not taken for absorption, where the room's file says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.finder import PositionsCase
from rtcal.finder.finding import Finding
from tests.test_where import heard, stated, tracing

pytestmark = pytest.mark.long  # three searches, each with reference simulations of its own sources

LOBE = np.linspace(1, 8, 3)
"""dB per band."""


@pytest.fixture(scope="module")
def findings(kept: Path) -> dict[str, Finding]:
    """Return what is found of a room with nothing hidden, measured with aimed loudspeakers."""
    base = tracing(stated(), n_paths=1600)
    aimed = {name: rt.Directivity(index=LOBE, aim=(0.3, 1, -0.2)) for name in base.sources}
    truth = tracing(stated(), scattering=0.5, n_paths=19200)
    measured = heard(replace(truth, directivity=aimed), base.room.alpha)
    sources = {"omnidirectional": {}, "unknown": dict.fromkeys(aimed, "unknown"), "stated": aimed}
    return {
        name: rt.find(
            PositionsCase(simulator=replace(base, directivity=of), measured=measured), cache=kept
        )
        for name, of in sources.items()
    }


def test_where_nothing_is_stated_nothing_is_claimed_and_the_lobes_are_said(
    findings: dict[str, Finding],
) -> None:
    """It was an alarm: "none" had less than 0.1 before lobes counted as far as they are likely."""
    found = findings["omnidirectional"]
    assert not found.detected
    said = "so the sources are not taken as omnidirectional."
    assert any(said in str(note) for note in found.notes)


def test_stated_nothing_is_claimed(findings: dict[str, Finding]) -> None:
    found = findings["stated"]
    assert found.verdict == "none"
    assert not any("omnidirectional" in str(note) for note in found.notes)


def test_unknown_nothing_is_claimed_and_times_alone_are_asked(
    findings: dict[str, Finding],
) -> None:
    found = findings["unknown"]
    assert found.parameters == ("t20",)
    assert found.verdict == "none"
    assert found.surface is None
    assert any("The directivity of S1, S2 is unknown" in str(note) for note in found.notes)
