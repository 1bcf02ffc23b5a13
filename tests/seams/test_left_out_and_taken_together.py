"""A pair that is left out is as one that was not measured; what is taken together is said."""

from dataclasses import replace

import numpy as np

import rtcal as rt
from rtcal.finder.positions.surfaces import merged, of_geometry
from tests.test_where import RECEIVERS, measured, stated, tracing
from tests.test_where_corrected import L_PLAN, prism, triangulated


def test_a_pair_left_out_is_as_one_that_is_not_there():
    """T20 alone refused ``exclude``."""
    room, heard = stated(), measured(False)
    out = [pair for pair in heard.pairs if pair[1] == "R3"]
    some = {name: place for name, place in RECEIVERS.items() if name != "R3"}
    left_out = rt.calibrate_simulator(tracing(room, n_paths=800), room, heard, exclude=out)
    absent = rt.calibrate_simulator(
        tracing(room, n_paths=800, receivers=some),
        room,
        heard.select([pair for pair in heard.pairs if pair not in out]),
    )
    np.testing.assert_allclose(left_out.room.alpha, absent.room.alpha, rtol=1e-9)
    assert "Left out, as asked for: S1 to R3, S2 to R3." in left_out.notes


def test_faces_of_other_names_on_one_surface_are_said():
    mesh = triangulated(prism(L_PLAN))
    assert merged(mesh, of_geometry(mesh)) == ""
    part = mesh.names.index("wall 1 2")
    names = ["panel" if i == part else name for i, name in enumerate(mesh.names)]
    panelled = replace(mesh, names=names)
    assert "panel as part of wall 1" in merged(panelled, of_geometry(panelled))
