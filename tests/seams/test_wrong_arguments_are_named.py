"""A law: an argument of another kind is named by a typed error, in the newest functions, too."""

from __future__ import annotations

import numpy as np
import pytest

import rtcal as rt
from rtcal.errors import RtcalError
from rtcal.loop import start


@pytest.mark.parametrize(
    "wrong",
    [
        {"equation": np.ones(3)},
        {"method": np.ones(3)},
        {"rule": np.ones(3)},
        {"tolerance": [None]},
    ],
    ids=str,
)
def test_of_a_loop(wrong: dict[str, object]) -> None:
    room, measured = rt.datasets.bras_cr2()
    with pytest.raises(RtcalError, match=next(iter(wrong))):
        start(room, measured, **wrong)


def test_a_generator_in_place_of_a_sequence() -> None:
    room, measured = rt.datasets.bras_cr2()
    program = rt.simulators.External(room=room, name="p", run=lambda alpha, seed: np.ones(6))
    with pytest.raises(RtcalError, match="exclude"):
        rt.calibrate_simulator(program, room, measured, exclude=(pair for pair in measured.pairs))
