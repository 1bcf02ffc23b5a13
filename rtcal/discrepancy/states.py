"""A case's room, as a state that can be predicted, with what has been added to its model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtcal.discrepancy.case import AppliedEffect, Case
from rtcal.discrepancy.configuration import Configuration
from rtcal.discrepancy.effect_checks import changed
from rtcal.discrepancy.model import State
from rtcal.support.types import Array


def state(case: Case, configuration: Configuration, alpha: Array | None = None) -> State:
    """Return the case's room in one configuration, with what `Finding.apply` has put there.

    ``alpha`` (n_materials, n_bands) replaces the room's; a configuration's changes come after.
    """
    room = case.room
    values = np.array(room.alpha if alpha is None else alpha)
    for material, change in configuration.changes.items():
        values[room.material_index(material)] = change.alpha
    air = configuration.air or room.air
    made = State(
        volume=room.volume,
        areas=room.areas,
        alpha=values,
        facing=case.facing,
        air=np.zeros(room.n_bands) if air is None else air.attenuation(room.centre_frequencies),
        frequencies=room.centre_frequencies,
        speed_of_sound=room.speed_of_sound,
        equation=case.equation,
    )
    return with_applied(made, case.applied, configuration)


def with_applied(
    made: State, applied: Sequence[AppliedEffect], configuration: Configuration
) -> State:
    """Return the state with the effects that have been added to the model."""
    for added in applied:
        if not (configuration.suspect_removed and added.effect.removable):
            (made,) = changed(added.effect, made, [added.parameters])
    return made


def distances(case: Case, configuration: Configuration) -> Array:
    """Return the source-receiver distances in m, (n_pairs,)."""
    if configuration.distances is not None:
        return configuration.distances
    return np.array([0.5 * case.room.volume ** (1 / 3)])
