"""Every command that writes, with a fault at every event."""

from __future__ import annotations

from pathlib import Path

import pytest

from rtcal.command import gap
from rtcal.discrepancy import find
from tests.test_discrepancy import controls_of, opened
from tests.test_fault_commands import WRITERS, attempt


@pytest.fixture
def one_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    """The finder runs once: it writes nothing."""
    finding = find(opened(), controls=controls_of(opened()))
    monkeypatch.setattr(gap, "_find", lambda *_: finding)


@pytest.mark.study
@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.usefixtures("one_finding")
def test_a_command_writes_all_or_nothing_at_every_event(name: str, tmp_path: Path) -> None:
    tried, lost = attempt(name, tmp_path, 1)
    print(f"{name}: {tried} events tried, {lost} states lost")
    assert tried > 20
    assert lost == 0
