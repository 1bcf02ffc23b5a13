"""Find what is other than stated in a geometry, and where (docs/where_method.md).

One effect in one place is weighed against another; no sets are formed as on means. The positions
decide, and means over them give probabilities of the groups, too. A noisy pair is no evidence that the
room is other than stated.

With another program's run two rooms err as the reference simulations do: the real one, and that of the
program. What then no effect explains, or what a second room or another scattering would, counts as the
program's own (`rtcal.finder.claim.of_program`).

Something that no effect explains is no rival of the effects: a room may lack both. Its larger error is
weighed alone and beside every effect, and is as probable in both ways.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from rtcal.acoustics.changes import facing
from rtcal.acoustics.observables import TARGET, observable
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import UNKNOWN as UNAIMED
from rtcal.finder.case import Case, Configuration, PositionsCase
from rtcal.finder.claim import (
    CLAIMED,
    DISTINCT_NATS,
    FIELD,
    MOST,
    Candidate,
    Detection,
    Reason,
    conclude,
    of_program,
    summed,
    with_added,
)
from rtcal.finder.effects import Effect, checked_effects
from rtcal.finder.evidence import (
    COEFFICIENTS,
    NONE,
    SCALES,
    UNKNOWN,
    left_out_of,
    log_mixture,
    probability_off,
)
from rtcal.finder.finding import Finding
from rtcal.finder.means.search import find as find_by_means
from rtcal.finder.model import FEATURES
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.positions.problem import (
    COUPLED,
    NOISE,
    POSITION,
    WHOLE,
    Likelihood,
    Likelihoods,
    PositionsHypotheses,
    PositionsProblem,
    ShiftHypothesis,
    on_parts,
    on_surfaces,
    shifts,
    spreads,
)
from rtcal.finder.positions.weighing import (
    AIMED,
    LIKELY_GAINS,
    LIKELY_INDEX,
    LIKELY_LOBES,
    MISCALIBRATED,
    parameters,
    responses_of,
    with_index,
)
from rtcal.loop.measured_pairs import T30_ALONE, ControlRuns, simulated_controls, with_t30
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import Progress, TaskProgress, single_threaded_blas
from rtcal.support.types import Array

TEMPER = 1.25
"""Divisor of log evidences: the mean square of a hypothesis' standardised projection in reference rooms
of development rooms. It would be 1 if few reference simulations gave their covariance without error."""
TOLD_TEMPER = 2.0
"""Divisor of log evidences where effects and surfaces are told apart. Their probabilities are then as
often right as they say in 79 rooms that had been read. The shifts of two
surfaces differ by less than the simulator errs by, in ways that reference simulations do not show."""
MEANS_POWER = 0.5
"""Power of the families' probabilities by means over positions, which are multiplied into those of the
positions, chosen in the same rooms. Both see the same T, so neither
counts in full."""
LEAST_BY_MEANS = 1e-3
"""Least probability of a family by means: they have other effects, and err by more than they know."""
_NEGLIGIBLE = 15.0
"""Evidence in nats by which larger errors are less likely than those assumed, from which they are not
weighed beside each effect."""
_TINY = 1e-9  # prior probability below which nothing else than a noisy pair is tried


def evaluate(likelihoods: Likelihoods, hypotheses: PositionsHypotheses, residual: Array) -> Array:
    """Return the log evidence of a residual (n_values,) by hypothesis, (n,)."""
    stated, off, unknown = likelihoods
    every = hypotheses.shifts

    def mean(
        some: Sequence[Likelihood], shares: Sequence[float], shifts: Sequence[ShiftHypothesis]
    ) -> tuple[Array, Array]:
        """Return the log of the mean density if nothing is other, and with each of the shifts."""
        under = [(one, one.of(residual)) for one in some]
        both = ([one.stated(r) for one, r in under], [one.shifted(shifts, r) for one, r in under])
        nothing, shifted = (logsumexp(np.log(shares) + np.transpose(of), axis=-1) for of in both)
        return np.asarray(nothing), np.asarray(shifted)

    as_stated = stated.of(residual)
    none, shifts = stated.stated(as_stated), stated.shifted(every, as_stated)
    shares = [share for _, share in SCALES]
    together, others = mean(off, shares, every if hypotheses.off > 0 else ())
    if len(others):
        shifts = log_mixture(shifts, others, hypotheses.off)
    equal = [1 / len(unknown)] * len(unknown)
    alone, _ = mean(unknown, equal, ())
    beside = np.full_like(shifts, -np.inf) if hypotheses.unknown else shifts[:0]
    # Errors that explain even less than what nothing explains do so beside an effect, too.
    if len(beside) and alone >= none - _NEGLIGIBLE:
        _, beside = mean(unknown, equal, every)
    spreads = [stated.spread(spread, as_stated) for spread in hypotheses.spreads]
    return np.concatenate([[none, together, alone], *spreads, shifts, beside])


def scores(
    posterior: Array, hypotheses: PositionsHypotheses, own: Sequence[str] = ()
) -> tuple[float, float]:
    """Return ln Bayes factors that something differs, and that a pair is noisy, from log weights.

    The first one counts a noisy pair, and effects of the groups ``own``, as nothing.
    """
    noisy = np.array(hypotheses.by_row("effect")) == NOISE
    nothing_else = np.isin(hypotheses.by_row("family"), [NONE, *own])
    other = ~(noisy | nothing_else)
    prior = np.logaddexp.reduce(hypotheses.log_prior[~other])  # of nothing
    score = 0.0
    if prior < -_TINY:
        nothing = np.logaddexp.reduce(posterior[~other])
        score = logsumexp(posterior[other]) - nothing - np.log1p(-np.exp(prior)) + prior
    of_pair = np.logaddexp.reduce(posterior[noisy], initial=-np.inf)
    return float(score), float(of_pair - posterior[0])


def weights(evidence: Array, hypotheses: PositionsHypotheses, temper: float = TEMPER) -> Array:
    """Return log posterior weights of tempered evidences, (n,); that of "none" is its prior."""
    return np.asarray(hypotheses.log_prior + (evidence - evidence[0]) / temper)


def gain(other: Array, evidence: Array, hypotheses: PositionsHypotheses) -> float:
    """Return the ln Bayes factor of one likelihood over another, summed over all hypotheses."""
    more, less = (logsumexp(weights(each, hypotheses)) for each in (other, evidence))
    return float(more - less + (other[0] - evidence[0]) / TEMPER)


def with_families(
    posterior: Array, hypotheses: PositionsHypotheses, families: Mapping[str, float]
) -> Array:
    """Return log weights times the families' by means to `MEANS_POWER` (Genest & Zidek 1986)."""
    least = [
        max(families.get(family, 0.0), LEAST_BY_MEANS) for family in hypotheses.by_row("family")
    ]
    return np.asarray(posterior + MEANS_POWER * np.log(least))


THRESHOLD = 2.5
"""Of the evidence of the positions, in nats. In situ 1 of 23 rooms for development with nothing hidden
exceeds it without level, and 1 with it."""
OWN = (FIELD, UNKNOWN)
"""Groups of effects that count as the own error of a program whose run is compared. With them, and with
the error counted for two rooms, none of 64 draws of 16 empty rooms was flagged
(benchmarks/studies/pairs)."""


def evidence_of_means(
    case: PositionsCase,
    effects: Sequence[Effect] | None = None,
    cache: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
) -> Finding | None:
    """Return the finding from means over the positions of a case; None without a T to trust."""
    try:
        return find_by_means(of_means(case), effects, cache=cache, scheduler=scheduler)
    except DataError:
        return None


def of_means(case: PositionsCase) -> Case:
    """Return the case without its geometry; DataError where it has no T that can be trusted."""
    tracer = case.simulator
    measured = Configuration(
        name="measured",
        measured=case.in_room.select(case.pairs),
        distances=np.array(
            [math.dist(tracer.sources[s], tracer.receivers[r]) for s, r in case.pairs]
        ),
    )
    along = facing(case.room, case.geometry)
    means = Case(room=case.room, configurations=[measured], facing=along)
    names = {observable(name).stand_in or name for name in case.match}
    return means.only(*names.intersection(FEATURES))


_SPACING = 0.1  # standard deviation of ln size within the grid's distance, which is 0.26


@dataclass(frozen=True, eq=False)
class Summary:
    """Hold the probabilities of what may differ from the model, by effect, group and surface."""

    candidates: tuple[Candidate, ...]
    probabilities: dict[str, float]
    families: dict[str, float]
    surfaces: dict[str, float]
    on_surfaces: float  # that something on a surface is missing
    unexplained: float  # that an unknown effect is there, alone or beside another


def summary_of(case: PositionsCase, hypotheses: PositionsHypotheses, posterior: Array) -> Summary:
    """Return the probabilities that follow from log posterior weights."""
    chances = np.exp(posterior - logsumexp(posterior))
    of_spreads, of_shifts, beside = hypotheses.of_groups(chances)
    unexplained = float(chances[2] + sum(some.sum() for some in beside))
    if hypotheses.unknown:
        of_shifts = [one + other for one, other in zip(of_shifts, beside, strict=True)]
    grouped: dict[tuple[str, int | None, str], list[tuple[ShiftHypothesis, Array]]] = {}
    for shift, some in zip(hypotheses.shifts, of_shifts, strict=True):
        grouped.setdefault((shift.effect, shift.surface, shift.place), []).append((shift, some))
    candidates = [_candidate(case, members) for members in grouped.values()]
    for spread, some in zip(hypotheses.spreads, of_spreads, strict=True):
        share = _shares(some)  # of the sizes that are tried
        likely = spread.sizes[share >= min(0.05, share.max())]
        candidates.append(
            Candidate(
                effect=spread.effect,
                family=spread.family,
                place=spread.place,
                probability=float(some.sum()),
                size=float(np.clip(share @ spread.sizes, likely.min(), likely.max())),
                low=float(likely.min()),
                high=float(likely.max()),
                unit=spread.unit,
            )
        )
    for effect, chance in zip((COEFFICIENTS, UNKNOWN), chances[1:3].tolist(), strict=True):
        if chance > 0:
            candidates.append(Candidate(effect=effect, family=effect, probability=chance))
    candidates.sort(key=lambda c: -c.probability)
    none = (NONE, float(chances[0]))
    effects = summed([none, *((c.effect, c.probability) for c in candidates)])
    families = summed([none, *((c.family, c.probability) for c in candidates)])
    standing = [(c.surface, c.probability) for c in candidates if c.surface is not None]
    surfaces = summed([*((name, 0.0) for name in case.faces), *standing])
    on_surfaces = sum(surfaces.values())
    shares = {n: p / on_surfaces if on_surfaces > 0 else 0.0 for n, p in surfaces.items()}
    families = with_added(families)
    return Summary(tuple(candidates), effects, families, shares, on_surfaces, unexplained)


def _shares(chances: Array) -> Array:
    """Return probabilities over their sum, equal ones where all are 0."""
    total = chances.sum()
    return chances / total if total > 0 else np.full(len(chances), 1 / len(chances))


def _candidate(case: PositionsCase, members: Sequence[tuple[ShiftHypothesis, Array]]) -> Candidate:
    """Return the candidate of an effect in one place: spread over a surface, and on its parts."""
    shift = members[0][0]
    chances = np.concatenate([some for _, some in members])
    sizes = np.concatenate([member.sizes for member, _ in members])
    share = _shares(chances)
    signed = bool((sizes <= 0).any())
    scale = sizes if signed else np.log(sizes)
    mean = float(share @ scale)
    more = 0.0 if signed else _SPACING**2 + shift.size_error**2
    deviation = float(np.sqrt(share @ (scale - mean) ** 2 + more))
    ends = mean + NORMAL_90 * deviation * np.array([0.0, -1.0, 1.0])
    ends = ends if signed else np.exp(ends)
    surface = None if shift.surface is None else list(case.faces)[shift.surface]
    if surface is not None and shift.unit == "m²":  # no more stands on a surface than it has
        ends = np.minimum(ends, case.areas[surface])
    size, low, high = ends.tolist()
    return Candidate(
        effect=shift.effect,
        family=shift.family,
        surface=surface,
        place=surface or shift.place,
        probability=float(chances.sum()),
        size=size,
        low=low,
        high=high,
        unit=shift.unit,
        parameters=[p for member, _ in members for p in member.parameters][int(np.argmax(share))],
        spectrum=np.asarray(share @ np.concatenate([member.spectra for member, _ in members])),
        parts=tuple(
            (case.divided.parts[member.part].middle, float(some.sum()))
            for member, some in members
            if member.part is not None
        ),
    )


def tried(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names of everything that is tried with a library of effects."""
    names = [e.name for e in effects]
    return (
        *(e.name for e in on_surfaces(effects)),
        *(name for name in (COUPLED.name, *WHOLE) if name in names),
        POSITION,
        NOISE,
        COEFFICIENTS,
        UNKNOWN,
    )


MORE_PATHS = 3
"""Factor of the number of paths of the reference simulations. Over 16 pairs of seeds the score of four
empty development rooms had a standard deviation of at most 0.2 nats, and that of a room with an
absorber one of 0.47. With 6 it had 0.32; the shipped room then takes 1.4 times as long."""


@single_threaded_blas()
def find(
    case: PositionsCase,
    *,
    effects: Sequence[Effect] | None = None,
    controls: ControlRuns | None = None,
    cache: str | os.PathLike[str] | None = None,
    seed: int = 0,
    only: Sequence[str] = (),
    without: Sequence[str] = (),
    progress: TaskProgress | None = None,
    scheduler: str | None = None,
) -> Finding:
    """Find whether a room differs from its model, by which effect, and where (`rtcal.find`)."""
    checks.whole("seed", seed, 0)
    every = checked_effects(effects)
    left_out = left_out_of(only, without, tried(every))
    means = None
    if not left_out and case.simulated is None:
        # The means know neither fewer effects nor another program's values.
        means = evidence_of_means(case, every, cache, scheduler)
    found = find_by_positions(
        case, every, controls, cache, seed, left_out, progress, means, scheduler
    )
    return found if means is None else replace(found, mistake=means.mistake)


def controls_of(
    case: PositionsCase,
    seed: int = 0,
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> ControlRuns:
    """Return the reference simulations of a search."""
    controls = simulated_controls(
        case.simulator,
        case.room,
        parameters(case),
        seed=seed,
        position_uncertainty=case.position_uncertainty,
        cache=cache,
        progress=progress,
        more_paths=MORE_PATHS,
        scheduler=scheduler,
    )
    if controls is None:  # a PathTracing has reference simulations always
        raise DataError(
            f"{case.simulator.name} has no geometry, which is needed to trace paths; use "
            "PathTracing"
        )
    return controls


@dataclass(frozen=True, eq=False)
class _Search:
    """The numbers of a case and its hypotheses."""

    case: PositionsCase
    numbers: PositionsProblem
    hypotheses: PositionsHypotheses

    def evidence(self, sources: Array | float = 0.0) -> Array:
        """Return the log evidence by hypothesis, (n,); for ``sources`` see `likelihoods`."""
        likelihoods = self.numbers.likelihoods(sources)
        return evaluate(likelihoods, self.hypotheses, self.numbers.residual)

    def with_gains(self, evidence: Array, sources: Array | float = 0.0) -> Array:
        """Return the evidence, where the sources may also have been calibrated wrongly."""
        for gains in self.numbers.gains:
            evidence = log_mixture(evidence, self.evidence(sources + gains), MISCALIBRATED)
        return evidence


@single_threaded_blas()
def find_by_positions(
    case: PositionsCase,
    effects: Sequence[Effect],
    controls: ControlRuns | None,
    cache: str | os.PathLike[str] | None,
    seed: int,
    left_out: Sequence[str],
    progress: TaskProgress | None = None,
    means: Finding | None = None,
    scheduler: str | None = None,
) -> Finding:
    """Return the finding of the positions; ``means`` is from `evidence_of_means`, or None."""
    if controls is None:
        reported = progress and partial(progress, "reference simulations")
        controls = controls_of(case, seed, cache, reported, scheduler)
    made = responses_of(case, seed, cache, progress, scheduler)
    threshold, own_groups = THRESHOLD, () if case.simulated is None else OWN

    def searched(case: PositionsCase) -> _Search:
        numbers = PositionsProblem(case, made, controls)
        return _Search(case, numbers, every_hypothesis(case, numbers, effects, left_out))

    search = searched(case)
    evidence = search.evidence()
    score, noise = scores(weights(evidence, search.hypotheses), search.hypotheses, own_groups)
    # A gain or a lobe that is off may pass for the noise of a pair, which is no evidence by itself.
    disagree = max(score, noise) > threshold
    of_gain = -np.inf
    if disagree and len(search.numbers.gains):
        as_calibrated, evidence = evidence, search.with_gains(evidence)
        of_gain = gain(evidence, as_calibrated, search.hypotheses)
    names = search.numbers.data.observations.parameters
    reverberation = any(observable(p).part == "late" for p in names)
    indexed = list(with_index(case.simulator))
    aimed, unexplained, doubted = 0.0, False, False
    if disagree and search.numbers.aimed is not None:
        lobes = search.with_gains(search.evidence(search.numbers.aimed), search.numbers.aimed)
        aimed = gain(lobes, evidence, search.hypotheses)
        if indexed and reverberation:
            posterior = weights(evidence, search.hypotheses, TOLD_TEMPER)
            unexplained = summary_of(case, search.hypotheses, posterior).unexplained >= CLAIMED
        doubted = aimed > (LIKELY_INDEX if indexed else LIKELY_LOBES) or unexplained
        if doubted and reverberation:
            # Directivities are unknown of which nothing or an index is stated.
            tracer = case.simulator
            stated = {name: tracer.directivity.get(name, UNAIMED) for name in tracer.sources}
            tracer = replace(tracer, directivity=stated | dict.fromkeys(indexed, UNAIMED))
            search, of_gain = searched(replace(case, simulator=tracer)), -np.inf
            evidence = search.evidence()
            means = (
                None if means is None else evidence_of_means(search.case, effects, cache, scheduler)
            )
        elif doubted:  # nothing is left that says as much whatever the source
            evidence = lobes
        else:
            evidence = log_mixture(evidence, lobes, AIMED)
    score, noise = scores(weights(evidence, search.hypotheses), search.hypotheses, own_groups)
    detected = Detection(
        score=score,
        threshold=threshold,
        noise=noise if np.isfinite(noise) else None,
        means=None if means is None else means.score,
    )
    posterior = weights(evidence, search.hypotheses, TOLD_TEMPER)
    if means is not None:
        posterior = with_families(posterior, search.hypotheses, means.families)
    finding = _finding(search, posterior, detected, effects)
    notes = [*finding.notes]
    if doubted and indexed:
        code = "index off" if aimed > LIKELY_INDEX else "nothing explains the level"
        notes.append(Reason(code, {"nats": aimed, "sources": indexed}))
    elif aimed > -np.log(AIMED):
        code = "lobes" if aimed > LIKELY_LOBES else "lobes possible"
        notes.append(Reason(code, {"nats": aimed}))
    said = finding.effect or finding.family
    if means is not None and said is None and (name := means.effect or means.family) is not None:
        # What means over positions identify where positions do not.
        probability = (means.probabilities if means.effect else means.families)[name]
        notes.insert(0, Reason("means alone", {"effect": name, "probability": probability}))
    if of_gain > LIKELY_GAINS:
        notes.append(Reason("gains", {"nats": of_gain}))
    # What only means try. What changes no surface (air, a formula) is the path tracing's own affair.
    own = [e for e in effects if e.removable or e.family == Effect.family]
    if without := sorted(e.name for e in own if not e.stands_on):
        notes.append(Reason("not tried", {"effects": without}))
    if left_out:
        notes.append(Reason("chosen"))
    return replace(finding, left_out=tuple(left_out), notes=tuple(notes))


def every_hypothesis(
    case: PositionsCase,
    numbers: PositionsProblem,
    effects: Sequence[Effect],
    left_out: Sequence[str] = (),
) -> PositionsHypotheses:
    """Return the hypotheses of a search, but for some effects."""
    p, i, k = numbers.shape
    errors = (numbers.measurement + numbers.simulator_error).reshape(k, p, i, k, p, i)
    places = spreads(numbers.data.observations.pairs, numbers.moved, errors)
    return PositionsHypotheses(
        shifts=on_parts(case, shifts(case, effects, left_out)),
        spreads=[spread for spread in places if spread.effect not in left_out],
        off=0.0 if COEFFICIENTS in left_out else probability_off(case.room),
        unknown=UNKNOWN not in left_out,
    )


def _finding(
    search: _Search, posterior: Array, detected: Detection, effects: Sequence[Effect]
) -> Finding:
    case, numbers = search.case, search.numbers
    likelihood = numbers.likelihoods()[0].with_one_level()
    summary = summary_of(case, search.hypotheses, posterior)
    in_families = [effect.name for effect in effects if not effect.alone]
    # The library as a whole is weighed against what it does not explain, and not each of its effects.
    known = dict(summary.probabilities)
    if known.get(UNKNOWN, 0.0) < MOST * (1 - known[NONE]):
        known.pop(UNKNOWN, None)
    weak = None if case.simulated is None else of_program(summary.families)
    claim = conclude(detected.verdict, known, summary.families, in_families, weak=weak)
    is_claimed = claim.verdict in ("named", "family", "ambiguous")
    reasons = claim.reasons
    if is_claimed and case.simulator.unknown_sources:
        reasons = (Reason("directivity unknown"),)
    elif is_claimed and (best := summary.candidates[0]).surface and best.effect == COUPLED.name:
        # In both judged rooms in which one was detected, its aperture was on another surface than the
        # most probable one (benchmarks/studies/pairs). A box with scattering of 0.05, assumed to have
        # 0.3, had been named a coupled room.
        reasons = (Reason("second room anywhere"),)
    first = next(iter(summary.surfaces))
    sure = summary.surfaces[first] * summary.on_surfaces >= CLAIMED
    observations, (p, i, k) = numbers.data.observations, numbers.shape
    (instead,) = with_t30([TARGET.key], case.measured)
    assumed = [
        T30_ALONE if instead != TARGET.key and instead in case.match else "",
        *case.simulator.notes,
        "" if case.surfaces is not None else of_room.merged(case.geometry, case.faces),
    ]
    off = np.where(
        numbers.used, -numbers.residual / np.sqrt(np.diag(likelihood.covariance)), np.nan
    )
    return Finding(
        case=case,
        verdict=claim.verdict,
        named=claim.named,
        family=claim.family,
        surface=first if is_claimed and sure and not reasons else None,
        surfaces=summary.surfaces,
        unexplained=summary.unexplained,
        groups=_groups(case, search.hypotheses, summary, likelihood),
        candidates=summary.candidates,
        probabilities=summary.probabilities,
        families=summary.families,
        detection=detected,
        map=np.moveaxis(off.reshape(k, p, i), 0, 2),
        parameters=observations.parameters,
        pairs=observations.pairs,
        modelled=(numbers.stated if case.simulated is None else case.simulated,),
        reasons=reasons,
        notes=(*filter(None, assumed), *case.notes, *numbers.data.notes),
        controls=numbers.controls,
        effects={effect.name: effect for effect in effects},
    )


def _groups(
    case: PositionsCase,
    hypotheses: PositionsHypotheses,
    summary: Summary,
    likelihood: Likelihood,
) -> tuple[tuple[str, ...], ...]:
    """Return the surfaces that the most probable effect, in its size, does not distinguish.

    Two are distinguished where the shift of one, on the best size of the other, leaves more than
    `DISTINCT_NATS` to be expected; and those that are less probable by as much.
    """
    best = next((c for c in summary.candidates if c.surface is not None), None)
    if best is None:
        return ()
    names, vectors, inverse = [], [], likelihood.inverse
    least = np.exp(-DISTINCT_NATS) * max(summary.surfaces.values())
    for shift in hypotheses.shifts:
        if shift.effect != best.effect or shift.surface is None or shift.part is not None:
            continue
        name = list(case.faces)[shift.surface]
        if summary.surfaces[name] < least:
            continue
        near = np.abs(np.log(np.maximum(shift.sizes, 1e-9) / best.size))
        unlike = np.abs(shift.spectra - best.spectrum).max(axis=1)
        row = int(np.argmin(near + unlike))
        if name == best.surface:
            inverse = likelihood.inverse_with_place(shift, row)
        names.append(name)
        vectors.append(likelihood.changes(shift)[row].ravel())
    if not vectors:
        return ()
    every = np.array(vectors)
    gram = every @ inverse @ every.T
    size = np.maximum(np.diag(gram), 1e-12)
    nats = 0.5 * (size[:, np.newaxis] - gram**2 / size) / TOLD_TEMPER
    number, group = connected_components(np.minimum(nats, nats.T) < DISTINCT_NATS)
    groups = [tuple(n for n, g in zip(names, group, strict=True) if g == i) for i in range(number)]
    return tuple(members for members in groups if len(members) > 1)
