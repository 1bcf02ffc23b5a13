"""Every command that writes, with a fault at every event."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rtcal.command import finder as commands
from rtcal.finder.search import find
from rtcal.report import figures, gap_report, pages, study_report
from tests.test_discrepancy import controls_of, opened
from tests.test_fault_commands import WRITERS, attempt, fit_once, search_once


def once(patch: pytest.MonkeyPatch, module: Any, name: str) -> None:
    """Let a function that writes nothing run once, and return its answer from then on."""
    real = getattr(module, name)
    answers: list[Any] = []

    def same(*arguments: Any, **options: Any) -> Any:
        if not answers:
            answers.append(real(*arguments, **options))
        return answers[0]

    patch.setattr(module, name, same)


@pytest.fixture
def computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that take long and write nothing are done once; figures are drawn once for all."""
    fit_once(monkeypatch)
    search_once(monkeypatch)
    finding = find(opened(), controls=controls_of(opened()))
    monkeypatch.setattr(commands, "search_case", lambda *_, **__: finding)
    for name in ("verify", "figures", "finding_page"):
        once(monkeypatch, gap_report, name)
    once(monkeypatch, pages, "page_of")
    for module in (figures, gap_report, study_report):
        if hasattr(module, "rendered"):
            once(monkeypatch, module, "rendered")


@pytest.mark.study
@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.usefixtures("computed_once")
def test_a_command_writes_all_or_nothing_at_every_event(name: str, tmp_path: Path) -> None:
    tried, lost = attempt(name, tmp_path, 1)
    print(f"{name}: {tried} faults tried, {lost} states lost")
    assert tried > 40
    assert lost == 0
