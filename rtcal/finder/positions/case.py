"""What sources may have for directivity and gain beside what is stated of them.

Sources of which nothing is stated are omnidirectional, or loudspeakers that are aimed. A lobe moves the
level and the early parameters, and T hardly at all. So does much that a room may lack: taken as
omnidirectional, twelve aimed loudspeakers in a laboratory with nothing hidden passed for a second room
(benchmarks/studies/pairs). So what is detected with omnidirectional sources is compared with the same
where the sources have some lobe. It is an error of what is simulated: its index is of the order of
`LOBE_INDEX` and varies from band to band, its aim is any, and all sources may aim at the receivers
together. The evidence is the mean of both. Where lobes are certain, the directivities are unknown.

A stated index says how strong a lobe is, to some dB, and little of its shape. Taken as exact in a box
with ten loudspeakers and nothing hidden, an index that is 1.5 dB off gives more than 20 nats for
another volume or a displaced source (tests/test_where_unstated_sources.py). So a source with a stated
index is tried with another one, too. What then agrees with nothing that is tried ("unknown") may be the
lobes' shape, and is no finding of the room.

G needs a calibrated source, and its calibration may be wrong by more than the uncertainty of a right
one. In a box of another's tracer with nothing hidden, G that was 2 dB off gave 18 nats for another
volume; one that was 1 to 3 dB off by source and band gave 85 nats for a second room. So what is
detected with G is the mean of three likelihoods: as calibrated, with another gain, and with one in each
band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rtcal.acoustics.observables import LEVEL
from rtcal.acoustics.room import (
    LARGEST_INDEX,
    UNKNOWN,
    Directivity,
)
from rtcal.finder.case import PositionsCase
from rtcal.finder.claim import Reason
from rtcal.loop.measured_pairs import Pair
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support.types import Array

LOBE_INDEX = 6.0
"""Directivity index in dB of the lobes that are weighed. A measured two-way loudspeaker has 0.5 to 8 dB
from 250 Hz to 4 kHz (R3VIVAL, CC BY 4.0)."""


INDEX_ERROR = 2.0
"""Standard deviation in dB of a stated index, common to all sources that state one."""


OWN_INDEX_ERROR = 0.5
"""That of each source beside the others. With 2 dB of each source's own, ten sources paid so much for
their freedom that another volume stayed likelier."""


AIMED = 0.04
"""Prior probability that sources have other lobes than stated: what is detected is the mean of two
likelihoods. Taken for certain from 2.5 nats, they hid a covered wall from omnidirectional sources."""
LIKELY_LOBES = 10.0
"""Evidence in nats from which lobes are certain, and so strong that their shape counts, which no index
tells. In a box weak lobes (1 to 4 dB) have 2 to 6 nats, strong ones (2 to 8 dB) 40 to 50."""
LIKELY_INDEX = 2.5
"""The same where an index is stated: what is off is then little, and the shape counts the more."""
GAIN, OWN_GAIN, BAND_GAIN = 4.0, 1.0, 2.0
"""Standard deviations in dB of a gain that was calibrated wrongly: of all sources, of each, and of each
in each band."""
MISCALIBRATED = 0.1
"""Prior probability that it was, where no common uncertainty of G is stated: alike in all bands, and
as much again band by band."""
LIKELY_GAINS = 1.0
"""Evidence in nats for gains that may be off from which it is said."""


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


def as_unknown(case: PositionsCase) -> PositionsCase:
    """Return the case where directivities are unknown of which nothing or an index is stated."""
    tracer = case.simulator
    stated = {name: tracer.directivity.get(name, UNKNOWN) for name in tracer.sources}
    stated |= dict.fromkeys(with_index(tracer), UNKNOWN)
    return replace(case, simulator=replace(tracer, directivity=stated))


def covariances_of_gains(
    parameters: Sequence[str], pairs: Sequence[Pair], n_bands: int
) -> tuple[Array, Array]:
    """Return the covariances in dB² of levels of other gains, (n, n), by band, parameter and pair.

    The first is of gains that are alike in all bands, the second of gains that differ between bands.
    """
    sources = np.array([source for source, _ in pairs])
    same = (sources[:, np.newaxis] == sources).astype(float)
    level = np.diag([float(name == LEVEL.key) for name in parameters])
    alike = np.kron(level, GAIN**2 + OWN_GAIN**2 * same)
    own = np.kron(level, BAND_GAIN**2 * same)
    together = np.asarray(np.kron(np.ones((n_bands, n_bands)), alike))
    return together, np.asarray(together + np.kron(np.eye(n_bands), own))


def of_lobes(nats: float, stated: Sequence[str]) -> Reason | None:
    """Return a note that the sources may have other lobes; None where they are as taken.

    ``stated`` are sources of which an index is stated, where it is not taken as stated.
    """
    if stated:
        code = "index off" if nats > LIKELY_INDEX else "nothing explains the level"
        return Reason(code, {"nats": nats, "sources": list(stated)})
    if nats <= -np.log(AIMED):
        return None
    return Reason("lobes" if nats > LIKELY_LOBES else "lobes possible", {"nats": nats})
