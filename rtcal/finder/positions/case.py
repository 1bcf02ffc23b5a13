"""A case in a geometry: a simulator, and what was measured at its pairs.

It is no `rtcal.finder.Case`: a tracer has one configuration and no equation, and a pair is compared by
its names.

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import LEVEL, MATCH, observable, parameter_label
from rtcal.acoustics.room import (
    LARGEST_INDEX,
    POSITION,
    UNKNOWN,
    Directivity,
    Room,
    checked_uncertainty,
)
from rtcal.finder.claim import Reason
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.positions.surfaces import Divided, Faces
from rtcal.io import geometry_files
from rtcal.loop.measured_pairs import Pair, history, refuse_unknown, with_t30
from rtcal.simulators.base import at_places
from rtcal.simulators.geometry import Polyhedron
from rtcal.simulators.path_tracing import PathTracing
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.text import shortened
from rtcal.support.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionsCase:
    """A simulator of a room, and what was measured at its source-receiver pairs.

    Parameters
    ----------
    simulator : PathTracing
        Geometry, sources, receivers, and the room with the prior of its coefficients.
    measured : Measurement
        A row per pair. Its pairs have the simulator's names of sources and receivers. Pairs at one
        place are repeats: the case has their mean, as one pair.
    match : sequence of str
        Parameters that are compared; T30 in place of T20 where T30 alone was measured. Where a
        source's directivity is unknown, reverberation times alone. The level is G of a calibrated
        source where ``g`` was measured. A measured ``level`` has any reference that all receivers of a
        source share.
    simulated : Measurement, optional
        What another program gave for the model as stated, in the room's bands, for every value that
        was measured. The disagreement is then that program's. How it depends on the surfaces is still
        what the simulator says.
    exclude : sequence of (source, receiver)
        Measured pairs that are left out.
    surfaces : mapping of str to sequence of str, optional
        Names of each surface's faces. By default the coplanar faces of one material are one surface.
    position_uncertainty : float
        Of sources and receivers, in m.
    notes : sequence of str
        Sentences on the data, which the finding prints; which pairs are repeats of one place is added.

    Attributes
    ----------
    faces : dict of str to int array
        Numbers of each surface's faces.

    Raises
    ------
    DataError
        If the measurement is a mean over pairs, if the room was calibrated already, if a pair of
        ``exclude`` was not measured, or for a surface, parameter or number that breaks its rule.
    """

    simulator: PathTracing
    measured: Measurement
    match: Sequence[str] = MATCH
    simulated: Measurement | None = None
    exclude: Sequence[Pair] = ()
    surfaces: Mapping[str, Sequence[str]] | None = None
    position_uncertainty: float = POSITION
    notes: Sequence[str] = ()
    faces: dict[str, Faces] = field(init=False)

    def __post_init__(self) -> None:
        checks.instance("simulator", self.simulator, PathTracing)
        checks.instance("measured", self.measured, Measurement)
        checked_uncertainty(self.position_uncertainty)
        put = partial(object.__setattr__, self)
        put("match", self.simulator.trusted(with_t30(self.match, self.measured)))
        put("exclude", checks.pairs("exclude", self.exclude))
        repeated: tuple[str, ...] = ()
        for name in ("simulated", "measured"):
            if (values := getattr(self, name)) is None:
                continue
            values, repeated = at_places(self.simulator, checks.instance(name, values, Measurement))
            put(name, values)
            if values.is_summary:
                raise DataError(
                    f"{name} holds means over pairs; to say where, it needs a row for each source and "
                    "receiver. Without a geometry rtcal.finder says what is missing"
                )
        put("notes", (*checks.listed("notes", self.notes), *repeated))
        refuse_unknown(self.exclude, self.measured)
        if self.simulated is not None:
            self._check_simulated(self.simulated)
        if history(self.room):
            raise DataError(
                f'room "{self.room.name}" is calibrated: its coefficients hide what it misses. Use the '
                "room as it was before"
            )
        if not self.room.sigma.any():
            raise DataError(
                f'room "{self.room.name}" states sigma = 0: every coefficient is exactly known'
            )
        put("faces", of_room.of_geometry(self.geometry, self.surfaces))

    def _check_simulated(self, simulated: Measurement) -> None:
        """Raise DataError unless there is a value for everything that was measured and is used."""
        frequencies = self.room.centre_frequencies
        if not np.array_equal(simulated.centre_frequencies, frequencies):
            raise DataError(
                f"simulated has {bands.span(simulated.centre_frequencies)}; the room has "
                f"{bands.span(frequencies)}"
            )
        if lacking := [pair for pair in self.pairs if pair not in simulated.pairs]:
            raise DataError(
                f"simulated lacks {' to '.join(lacking[0])}, which was measured; exclude the pair or "
                "add its rows"
            )
        measured, given = (m.select(self.pairs).values for m in (self.in_room, simulated))
        for name in self.match:
            kind = observable(name)
            key = kind.key_in(measured)
            if key not in measured:
                continue
            label = parameter_label(key)
            values = given.get(key, given.get(str(kind.stand_in)))
            if values is None:
                raise DataError(
                    f"simulated has no {label}, which was measured; leave {name} out of match"
                )
            for i, k in np.argwhere(np.isfinite(measured[key]) & ~np.isfinite(values)):
                raise DataError(
                    f"simulated lacks {label} from {' to '.join(self.pairs[i])} at "
                    f"{bands.label(frequencies[k])}, which was measured"
                )

    @classmethod
    def from_room(
        cls,
        room: Room,
        measured: Measurement,
        *,
        tracing: Mapping[str, Any] | None = None,
        **stated: Any,
    ) -> PositionsCase:
        """Return the case of a room that states its scene: mesh, sources, receivers, names of surfaces.

        Parameters
        ----------
        room : Room
        measured : Measurement
        tracing : mapping, optional
            Arguments of `PathTracing`, such as ``n_paths`` and ``scattering``.
        **stated
            Further parameters of `PositionsCase`.

        Raises
        ------
        DataError
            As `rtcal.io.geometry_files.path_tracing` and `PositionsCase` do.
        """
        options = checks.mapped("tracing", {} if tracing is None else tracing)
        checks.texts("tracing: names", options)
        return cls(
            simulator=geometry_files.path_tracing(room, **options),
            measured=measured,
            surfaces=room.scene.surfaces or None,
            position_uncertainty=room.scene.position_uncertainty,
            **stated,
        )

    @property
    def room(self) -> Room:
        """The simulator's room: materials and the prior of their coefficients."""
        return self.simulator.room

    @property
    def geometry(self) -> Polyhedron:
        """The simulator's geometry."""
        return self.simulator.geometry

    @cached_property
    def divided(self) -> Divided:
        """The geometry with its long surfaces divided."""
        return of_room.divided(self.geometry, self.faces)

    @cached_property
    def surfaces_of_materials(self) -> dict[int, list[int]]:
        """The numbers of the surfaces that are of one material alone, by the material's number."""
        made_of = np.array(self.room.material_rows(self.geometry.materials))
        out: dict[int, list[int]] = {}
        for j, faces in enumerate(self.faces.values()):
            if (made_of[faces] == made_of[faces[0]]).all():
                out.setdefault(int(made_of[faces[0]]), []).append(j)
        return dict(sorted(out.items()))

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The kind of each surface: "floor", "wall" or "ceiling"."""
        return tuple(of_room.kind(self.geometry, faces) for faces in self.faces.values())

    @cached_property
    def surface_alpha(self) -> Array:
        """Mean alpha of each surface, (n_surfaces, n_bands)."""
        alpha = self.room.alpha[self.room.material_rows(self.geometry.materials)]
        areas = self.geometry.face_areas
        faces = self.faces.values()
        return np.array([np.average(alpha[f], axis=0, weights=areas[f]) for f in faces])

    @property
    def areas(self) -> dict[str, float]:
        """Area of each surface in m²."""
        return {n: float(self.geometry.face_areas[f].sum()) for n, f in self.faces.items()}

    @cached_property
    def in_room(self) -> Measurement:
        """The measurement in the room's bands, NaN where it has none of them."""
        return self.measured.in_bands(self.room.centre_frequencies)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The measured pairs that are used, in the simulator's order."""
        return tuple(
            p for p in self.simulator.pairs if p in self.measured.pairs and p not in self.exclude
        )

    def only(self, pairs: Sequence[Pair]) -> PositionsCase:
        """Return the case with these measured pairs alone; DataError for one that it lacks."""
        wanted = checks.pairs("pairs", pairs)
        if lacking := [p for p in wanted if p not in self.pairs]:
            raise DataError(f"pairs has {' to '.join(lacking[0])}, which the case lacks")
        left = tuple(p for p in self.measured.pairs if p not in wanted)
        return replace(self, exclude=left)

    def __repr__(self) -> str:
        return (
            f'<PositionsCase "{shortened(self.room.name)}": {len(self.faces)} surfaces, '
            f"{len(self.pairs)} pairs, {bands.span(self.room.centre_frequencies)}>"
        )


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
