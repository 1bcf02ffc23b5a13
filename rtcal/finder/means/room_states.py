"""The state of a case's room in one configuration, with the effects added to its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rtcal.acoustics.air import Air
from rtcal.finder.case import AppliedEffect, Case
from rtcal.finder.configuration import Configuration
from rtcal.finder.effects.checks import changed_states
from rtcal.finder.model import State
from rtcal.support.types import Array

USUAL_DISTANCE = 0.66
"""Source-receiver distance over the cube root of the volume, where it is not stated: the mean distance
between two points of a cube (Robbins 1978)."""
DISTANCE_ERROR = 0.35
"""Standard deviation of its logarithm: that of the distance between two points of a cube is 0.45 of one
pair, less of a mean over pairs."""
_STEP = 1e-4
"""Step of alpha for a derivative."""


def state(case: Case, configuration: Configuration, alpha: Array | None = None) -> State:
    """Return the case's room in one configuration, with the applied effects.

    ``alpha`` (n_materials, n_bands) replaces the room's; the configuration's changes apply on top.
    """
    room = case.room
    values = np.array(room.alpha if alpha is None else alpha)
    for material, change in configuration.changes.items():
        values[room.material_index(material)] = change.alpha
    unchanged = replace(State.of_room(room, case.facing, case.equation), alpha=values)
    if air := configuration.air:
        unchanged = replace(
            unchanged,
            air=air.attenuation(room.centre_frequencies),
            speed_of_sound=air.speed_of_sound,
        )
    return with_applied(unchanged, case.applied, configuration)


def with_applied(
    unchanged: State, applied: Sequence[AppliedEffect], configuration: Configuration
) -> State:
    """Return the state with effects; removable effects are left out if the suspect was removed."""
    for added in applied:
        if not (configuration.suspect_removed and added.effect.removable):
            (unchanged,) = changed_states(added.effect, unchanged, [added.parameters])
    return unchanged


def air_of(case: Case, configuration: Configuration) -> Air | None:
    """Return the climate of a configuration, with the applied effects."""
    air = configuration.air or case.room.air
    for added in case.applied:
        air = added.effect.air(air, added.parameters)
    return air


def seen(case: Case, configuration: Configuration) -> Array:
    """Return d (alpha of the state) / d (alpha of the room), (n_materials, n_bands).

    It is 1 but where an applied effect changes alpha: what is covered is not seen.
    """
    at = np.array(case.room.alpha)
    unchanged = replace(configuration, changes={})
    after = state(case, unchanged, at).alpha
    if np.array_equal(after, at):
        return np.ones_like(at)
    step = np.where(at < 0.5, _STEP, -_STEP)
    return np.asarray((state(case, unchanged, at + step).alpha - after) / step)


def distances(case: Case, configuration: Configuration) -> Array:
    """Return the source-receiver distances in m, (n_pairs,); where none are stated, the usual one."""
    if configuration.distances is not None:
        return configuration.distances
    return np.array([USUAL_DISTANCE * case.room.volume ** (1 / 3)])
