"""A law: what was measured and not fitted is shown before and after, and named when it leaves."""

from dataclasses import dataclass

import numpy as np
import pytest

import rtcal as rt
from rtcal.loop import Loop
from rtcal.report import pages
from tests.conftest import also, measurement_of


@dataclass(frozen=True)
class Bent:
    """A simulator whose T20 falls with alpha, and whose EDT and C80 move with the first material."""

    room: rt.Room
    cost: float
    name: str = "bent"
    deterministic: bool = True

    @property
    def materials(self):
        return tuple(self.room.materials)

    @property
    def centre_frequencies(self):
        return self.room.centre_frequencies

    def simulate(self, alpha, *, seed=0):
        times = 1.3 * rt.Eyring().time(self.room, self.room.areas @ alpha)
        moved = (alpha - self.room.alpha).sum(axis=0)
        return rt.Measurement.from_values(
            self.room.centre_frequencies, t20=times, edt=times, c80=self.cost * moved
        )


@dataclass(frozen=True)
class AtPositions(Bent):
    """The same at two receivers."""

    def simulate(self, alpha, *, seed=0):
        mean = super().simulate(alpha, seed=seed)
        return measurement_of(
            mean.centre_frequencies,
            [("S", "R1"), ("S", "R2")],
            **{p: np.vstack([v, v * 1.05]) for p, v in mean.values.items()},
        )


def calibrated(cost, more):
    room, measured = rt.datasets.bras_cr2()
    times = measured.reverberation_time
    beside = {p: np.full(room.n_bands, v) for p, v in more.items()}
    heard = rt.Measurement.from_values(room.centre_frequencies, t20=times, **beside)
    return rt.calibrate_simulator(Bent(room, cost), room, heard)


@pytest.mark.parametrize("cost", [0.0, 30.0])
def test_a_parameter_that_leaves_is_named(cost):
    met_before = calibrated(cost, {}).before.mean("c80")
    result = calibrated(cost, {"c80": met_before})
    before, after = result.gaps_beside["c80"]
    np.testing.assert_allclose(before, 0.0, atol=1e-12)
    np.testing.assert_allclose(after, result.final.mean("c80") - met_before, atol=1e-12)
    assert result.farther == (("c80",) if cost else ())
    said = " ".join(str(result).split())
    assert ("C80, which was not fitted, now deviates more" in said) == bool(cost)


def by_hand(rtcal, folder, cost):
    """Return the loop of a program run by hand, what its last step printed, and its page."""
    room, measured = rt.datasets.bras_cr2()
    times, flat = measured.reverberation_time, np.full(room.n_bands, 1.5)
    heard = rt.Measurement.from_values(
        room.centre_frequencies, t20=times, edt=0.9 * times, c80=flat
    )
    stated, t, state, following, s = (
        folder / name for name in ("room.toml", "t.csv", "loop.json", "next.toml", "s.csv")
    )
    room.save(stated)
    heard.save(t)
    files = ("--state", state, "--out", following)
    rtcal("loop", "start", stated, t, *files)
    first = rt.Room.from_file(following).alpha
    for _ in range(3):
        alpha = rt.Room.from_file(following).alpha
        simulated = Bent(room, cost).simulate(alpha)
        values = {p: v[0] for p, v in simulated.values.items()}
        values["c80"] = flat + cost * (alpha - first).sum(axis=0)
        rt.Measurement.from_values(room.centre_frequencies, **values).save(s)
        printed = rtcal("loop", "next", stated, s, *files)
        if "Done" in printed:
            break
    return Loop.load(str(state)), printed, pages.page_of(state)


@pytest.mark.parametrize("cost", [30.0, *also(0.0)])
def test_a_loop_by_hand_shows_it_too(cost, tmp_path, rtcal):
    loop, printed, html = by_hand(rtcal, tmp_path, cost)
    assert set(loop.beside) == {"edt", "c80"}
    before, after = loop.gaps_beside["c80"]
    np.testing.assert_allclose(before, 0.0, atol=1e-9)
    assert loop.farther == (("c80",) if cost else ())
    assert np.abs(after).max() == pytest.approx(0.0, abs=1e-9) or cost
    for said in (printed, html):
        assert ("C80, which was not fitted, now deviates more" in said) == bool(cost)


@pytest.mark.parametrize("cost", [300.0, *also(0.0)])
def test_every_position_shows_it_too(cost):
    room, _ = rt.datasets.bras_cr2()
    simulator = AtPositions(room, cost)
    first = simulator.simulate(room.alpha)
    values = {"t20": 0.7 * first.values["t20"], "c80": first.values["c80"]}
    measured = measurement_of(room.centre_frequencies, first.pairs, **values)
    result = rt.calibrate_positions(simulator, room, measured, match=("t20", "ts"))
    assert result.parameters == ("t20",)
    assert result.beside.parameters == ("c80",)
    np.testing.assert_allclose(result.beside.gap_before, 0.0, atol=1e-9)
    after = simulator.simulate(result.alpha).values["c80"] - values["c80"]
    np.testing.assert_allclose(result.beside.gap_after[0], after, atol=1e-6)
    assert result.farther == (("c80",) if cost else ())
    printed = " ".join(str(result).split())
    html = pages.page(result)
    for said in (printed, html):
        assert ("C80, which was not fitted, now deviates more" in said) == bool(cost)
