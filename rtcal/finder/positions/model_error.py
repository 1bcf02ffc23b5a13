"""The error of what is compared with the measurement: scattering, noise, control runs, and lobes.

How much the whole room scatters is not known, nor how far each material departs from that, nor how
scattering depends on frequency. The first changes too much for a derivative: in a flat room T20 moves
twice as far towards little scattering as towards much. So it is traced at several levels (`levels`).
The traced paths tell what the others change (`PathTracing.scattering_jacobian`), with the prior of a
calibration to every position (`rtcal.loop.scattering`). Control runs tell the rest, without the noise
of their few paths. What is compared has noise of its own, and so have the derivatives.

Sources of which nothing is stated are omnidirectional, or loudspeakers that are aimed. A lobe moves the
level and the early parameters, and T hardly at all. So does much that a room may lack: taken as
omnidirectional, twelve aimed loudspeakers in a laboratory with nothing hidden passed for a second room
(docs/where_study.md). So what is detected with omnidirectional sources is compared with the same where
the sources have some lobe. It is an error of what is simulated: its index is of the order of
`LOBE_INDEX` and varies from band to band, its aim is any, and all sources may aim at the receivers
together. Where the lobes are likelier, the directivities are taken as unknown.

A stated index says how strong a lobe is, to some dB, and little of its shape. Taken as exact in a box
with ten loudspeakers and nothing hidden, an index that is 1.5 dB off gives more than 20 nats for
another volume or a displaced source (tests/test_where_unstated_sources.py). So a source with a stated
index is tried with another one, too. What then agrees with nothing that is tried ("unknown") may be the
lobes' shape, and is no finding of the room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp

from rtcal.acoustics import bands
from rtcal.acoustics.directivity import LARGEST_INDEX, Directivity
from rtcal.acoustics.scene import UNKNOWN
from rtcal.finder.positions.case import PositionsCase
from rtcal.finder.positions.evidence import ScatteringLevels
from rtcal.loop.control_runs import ControlRuns
from rtcal.loop.measured_pairs import Pair
from rtcal.loop.scattering import COMMON as OF_ROOM
from rtcal.loop.scattering import OWN as OF_MATERIAL
from rtcal.loop.scattering import MaterialScattering
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.text import first_of
from rtcal.support.types import Array

MORE_PATHS = 3
"""Factor of the number of paths of the control runs. Over 16 pairs of seeds the score of four empty
development rooms had a standard deviation of at most 0.2 nats, and that of a room with an absorber one
of 0.47. With 6 it had 0.32; the shipped room then takes 1.4 times as long (docs/where_study.md)."""
OWN = 0.1
"""Share of the control runs' variance that is each value's own. Without it, combinations of values
decide that hardly differ between so few runs."""
COMMON = 0.25
"""Share of the variance common to all pairs that is assumed. Control runs scatter from hardly at all to
nearly everything, by which T of the whole room differs most."""
BETWEEN_OCTAVES = 0.7
"""Correlation of the scattering's part of each band between bands an octave apart. Without that part
what was measured in a flat room that scatters little was less likely by 8 to 11 nats."""


@dataclass(frozen=True, eq=False)
class TracingError:
    """The simulator's error at the pairs and parameters of a search.

    Attributes
    ----------
    runs : ControlRuns
        Without their noise.
    rest : array (n, n)
        Covariance by the scattering of the materials and by noise, n = parameters x pairs x bands.
    common : float
        Share of the variance common to all pairs that is assumed.
    """

    runs: ControlRuns
    rest: Array
    common: float = COMMON

    @property
    def assumed(self) -> Array:
        """The errors, what is common to all pairs as large as is assumed; (n_runs, p, i, k)."""
        return self.runs.with_common(self.common**0.5).errors

    def covariance(self, without: NDArray[np.int64] | None = None) -> Array:
        """Return the covariance, (n, n), from all runs but some."""
        kept = np.ones(len(self.runs.errors), dtype=bool)
        if without is not None:
            kept[without] = False
        runs = replace(self.runs, errors=self.assumed[kept], levels=None, models=())
        covariance = runs.covariance()
        of_runs = (1 - OWN) * covariance + OWN * np.diag(np.diag(covariance))
        return np.asarray(of_runs + self.rest)


def simulator_error(
    controls: ControlRuns,
    noise: Array,
    scattering: Array,
    scattering_noise: Array,
    tracings: int,
    centre_frequencies: Array,
) -> TracingError:
    """Return the error of the mean of some tracings.

    Parameters
    ----------
    controls : ControlRuns
        With as many paths as a group of the tracings, or `ControlRuns.more_paths` times as many.
    noise : array (n_groups, n_parameters, n_pairs, n_bands)
        Deviations of all groups of paths from the mean of their tracing.
    scattering : array (n_parameters, n_pairs, n_bands, n_materials)
        Derivatives by the log odds of each material's scattering coefficient.
    scattering_noise : array (n_groups, n_parameters, n_pairs, n_bands, n_materials)
        Deviations of those of all groups of paths from the mean of their tracing.
    tracings : int
    centre_frequencies : array (n_bands,)
    """
    free = len(noise) - tracings
    variance = (noise**2).sum(axis=0).mean(axis=1) / free  # (n_parameters, n_bands)
    slope = _alike(scattering).reshape(-1, scattering.shape[-1])
    prior = MaterialScattering(slope=slope, traced=np.zeros(slope.shape[1])).prior
    alike = _alike(scattering_noise)

    def runs_of(errors: Array) -> ControlRuns:
        return replace(controls, errors=errors, levels=None, models=())

    def mean_of(errors: Array) -> Array:
        return np.asarray(runs_of(errors).covariance() / free)

    def of_scattering(prior: Array) -> Array:
        """Return the covariance by other scattering, and by the noise of the derivatives."""
        # What they err by counts as often as the scattering that they belong to may be other.
        by_material = np.moveaxis(alike @ np.linalg.cholesky(prior), -1, 0)
        return np.asarray(slope @ prior @ slope.T + sum(map(mean_of, by_material)))

    # A control run is the difference of two tracings, whose noise is taken off. Errors as large as the
    # noise of one are assumed instead: without them, what was measured was likelier by 5 nats in 27
    # rooms, and the right surface less likely. In them all pairs are alike, so that no pattern of
    # the paths counts.
    runs = controls.without_noise(2 * variance)
    of_paths = runs_of(noise).alike() * len(noise) / free
    between = bands.correlation(centre_frequencies, BETWEEN_OCTAVES)
    between = np.tile(between, 2 * [len(slope) // len(between)])
    # Parameters and bands share the paths, and the pairs of a source, too.
    in_all_bands = of_scattering(OF_MATERIAL**2 * np.eye(len(prior)))
    of_scattering_alone = in_all_bands + of_scattering(prior) * between
    return TracingError(runs, of_paths + mean_of(noise) + of_scattering_alone)


TRACED = (-2.0, -1.0, 1.5)
"""Changes of the log odds at which the whole room is traced, from what is stated or assumed. From 0.4
they lead to 0.08, 0.2 and 0.75."""
_LEVELS = np.linspace(-2.4, 2.4, 9)
"""Changes that are integrated over, what is heard interpolated by a cubic spline."""


def levels(traced: Array) -> ScatteringLevels:
    """Return what scattering changes, at levels with the prior of a calibration to every position.

    All pairs are taken to hear the mean change. ``traced`` (n_bands, n_parameters, n_pairs, n_traced)
    has the shifts at `TRACED`.
    """
    alike = np.broadcast_to(traced.mean(axis=2, keepdims=True), traced.shape)
    middle = int(np.searchsorted(TRACED, 0.0))
    nodes, known = np.insert(TRACED, middle, 0.0), np.insert(alike, middle, 0.0, axis=-1)
    shifts = CubicSpline(nodes, known, axis=-1, bc_type="natural")(_LEVELS)
    log = -0.5 * (_LEVELS / OF_ROOM) ** 2
    return ScatteringLevels(shifts.reshape(-1, len(_LEVELS)), np.asarray(log - logsumexp(log)))


def _alike(derivatives: Array) -> Array:
    """Return the mean over pairs at each pair: what derivatives differ by there is mostly noise."""
    return np.broadcast_to(derivatives.mean(axis=-3, keepdims=True), derivatives.shape)


LOBE_INDEX = 6.0
"""Directivity index in dB of the lobes that are weighed. A measured two-way loudspeaker has 0.5 to 8 dB
from 250 Hz to 4 kHz (R3VIVAL, CC BY 4.0)."""
INDEX_ERROR = 2.0
"""Standard deviation in dB of a stated index, common to all sources that state one."""
OWN_INDEX_ERROR = 0.5
"""That of each source beside the others. With 2 dB of each source's own, ten sources paid so much for
their freedom that another volume stayed likelier."""
LIKELY_LOBES = 2.5
"""Evidence in nats from which other lobes are taken to explain what was measured."""
AIMS = (None, *(tuple(sign * axis) for axis in np.eye(3) for sign in (-1.0, 1.0)))
"""Where the lobes aim: all at the middle of the receivers, or along an axis."""


def with_index(tracer: PathTracing) -> dict[str, Directivity]:
    """Return the directivities that an index above 0 states, by source."""
    stated = {n: of for n, of in tracer.directivity.items() if isinstance(of, Directivity)}
    return {n: of for n, of in stated.items() if of.gains is None and of.index.any()}


def lobes(tracer: PathTracing) -> list[dict[str, Directivity]]:
    """Return what the sources may have for lobes, for each of `AIMS`.

    Sources of which nothing is stated have `LOBE_INDEX`. Those of which an index is stated aim as
    stated, and have one that is larger: together by `INDEX_ERROR`, each for itself by
    `OWN_INDEX_ERROR`. All others are as stated.
    """
    middle = tracer.to_receivers.mean(axis=1)
    # A source in the middle of its receivers aims at none of them.
    middle[~middle.any(axis=1)] = np.eye(3)[0]
    index = np.full(tracer.room.n_bands, LOBE_INDEX)
    unstated = [s for s, name in enumerate(tracer.sources) if name not in tracer.directivity]
    names = [list(tracer.sources)[s] for s in unstated]

    def changed(decibels: float) -> dict[str, Directivity]:
        return {
            name: replace(of, index=np.minimum(of.index + decibels, LARGEST_INDEX))
            for name, of in with_index(tracer).items()
        }

    towards = [Directivity(index=index, aim=tuple(middle[s])) for s in unstated]
    along = [Directivity(index=index, aim=aim) for aim in AIMS if aim is not None]
    own = changed(OWN_INDEX_ERROR)
    return [
        changed(INDEX_ERROR) | dict(zip(names, towards, strict=True)),
        *(own | dict.fromkeys(names, lobe) for lobe in along),
    ]


def covariance_of_lobes(nodes: Array, pairs: Sequence[Pair], frequencies: Array) -> Array:
    """Return the covariance of what lobes change, (n, n), in the order (band, parameter, pair).

    Parameters
    ----------
    nodes : array (n_bands, n_values, n_aims)
        Shifts by the lobes of `lobes`, in the order (parameter, pair).
    pairs : sequence of (source, receiver)
    frequencies : array (n_bands,)
    """
    n_bands, n_values, _ = nodes.shape
    of_source = np.array([source for source, _ in pairs] * (n_values // len(pairs)))
    same = of_source[:, np.newaxis] == of_source
    octaves = np.abs(np.subtract.outer(*(2 * [np.log2(frequencies)])))
    together, own = nodes[..., 0], nodes[..., 1:]
    every = np.einsum("kv,lw->kvlw", together, together)
    every += np.einsum("kva,lwa->kvlw", own, own) / own.shape[-1] * same[:, np.newaxis]
    every *= (0.7**octaves)[:, np.newaxis, :, np.newaxis]
    return np.asarray(every.reshape(n_bands * n_values, -1))


def as_unknown(case: PositionsCase) -> PositionsCase:
    """Return the case where directivities are unknown of which nothing or an index is stated."""
    tracer = case.simulator
    stated = {name: tracer.directivity.get(name, UNKNOWN) for name in tracer.sources}
    stated |= dict.fromkeys(with_index(tracer), UNKNOWN)
    return replace(case, simulator=replace(tracer, directivity=stated))


def lobes_in_words(nats: float, stated: Sequence[str]) -> str:
    """Return a note that the sources may have other lobes; "" where they are as taken.

    ``stated`` are sources of which an index is stated.
    """
    if nats > LIKELY_LOBES and not stated:
        return (
            "Sources that are not omnidirectional explain what was measured better than what the room "
            f"may lack: {nats:+.1f} nats. So they are not taken as omnidirectional. State them with "
            "[directivity]; an omnidirectional source has the index 0."
        )
    if not stated:
        return ""
    better = (
        f"Other lobes explain what was measured better than what the room may lack: {nats:+.1f} nats."
        if nats > LIKELY_LOBES
        else "Nothing that is tried explains the level and the early parameters."
    )
    return (
        f"{better} An index does not tell a lobe's shape. So the directivity of "
        f"{first_of(stated, 3)} is not taken as stated. State measured balloons to use all parameters."
    )
