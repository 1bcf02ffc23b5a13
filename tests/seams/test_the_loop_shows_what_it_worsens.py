"""A law: what was measured and not fitted is shown before and after, and named when it leaves."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

import rtcal as rt
from rtcal.report import page


@dataclass(frozen=True)
class Bent:
    """A simulator whose T20 falls with alpha, and whose EDT and C80 move with the first material."""

    room: rt.Room
    cost: float
    name: str = "bent"
    deterministic: bool = True
    smooth: bool = True

    @property
    def materials(self) -> tuple[str, ...]:
        return tuple(self.room.materials)

    @property
    def centre_frequencies(self) -> np.ndarray:
        return self.room.centre_frequencies

    def simulate(self, alpha: np.ndarray, *, seed: int = 0) -> rt.Measurement:
        times = 1.3 * rt.Eyring().time(self.room, self.room.areas @ alpha)
        moved = (alpha - self.room.alpha).sum(axis=0)
        return rt.Measurement.from_values(
            self.room.centre_frequencies, t20=times, edt=times, c80=self.cost * moved
        )


def calibrated(cost: float, more: Mapping[str, float | np.ndarray]) -> rt.LoopResult:
    room, measured = rt.datasets.bras_cr2()
    times = measured.decay_time().mean
    beside = {p: np.full(room.n_bands, v) for p, v in more.items()}
    heard = rt.Measurement.from_values(room.centre_frequencies, t20=times, **beside)
    return rt.calibrate_simulator(Bent(room, cost), room, heard)


@pytest.mark.parametrize("cost", [0.0, 30.0])
def test_a_parameter_that_leaves_is_named(cost: float) -> None:
    met_before = calibrated(cost, {}).before.mean("c80")
    result = calibrated(cost, {"c80": met_before})
    before, after = result.gaps("c80")
    np.testing.assert_allclose(before, 0.0, atol=1e-12)
    np.testing.assert_allclose(after, result.final.mean("c80") - met_before, atol=1e-12)
    assert result.farther == (("c80",) if cost else ())
    said = " ".join(str(result).split())
    assert ("C80, which was not fitted, left what was measured" in said) == bool(cost)
    assert "C80 / dB measured" in said
    assert "C80 / dB after" in said


def test_what_was_measured_is_saved_and_on_the_page() -> None:
    result = calibrated(30.0, {"c80": 1.5})
    saved = json.loads(result.to_json())["result"]
    np.testing.assert_allclose(saved["measured"]["c80"], 1.5)
    assert "C80, measured / dB" in page.loop_page(result)


def test_bands_of_t30_are_named() -> None:
    room, measured = rt.datasets.bras_cr2()
    times = measured.decay_time().mean
    t20 = times.copy()
    t20[:2] = np.nan
    both = rt.Measurement.from_values(room.centre_frequencies, t20=t20, t30=times)
    result = rt.calibrate_simulator(Bent(room, 0.0), room, both)
    said = " ".join(str(result).split())
    assert "T30 is matched at 125 Hz, 250 Hz in place of T20, which was not measured." in said
    assert "T20 wanted" not in said
