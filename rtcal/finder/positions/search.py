"""Find what is other than stated in a geometry, and where."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rtcal.acoustics.observables import TARGET, observable
from rtcal.finder.claim import CLAIMED, DISTINCT_NATS, claimed
from rtcal.finder.effects import Effect, checked_effects, library
from rtcal.finder.evidence import log_mixture
from rtcal.finder.finding import Candidate, Detection
from rtcal.finder.means.finding import MeansFinding
from rtcal.finder.means.search import CHOSEN
from rtcal.finder.positions import surfaces as of_room
from rtcal.finder.positions.case import (
    AIMED,
    LIKELY_INDEX,
    LIKELY_LOBES,
    MISCALIBRATED,
    PositionsCase,
    as_unknown,
    gains_in_words,
    lobes_in_words,
    with_index,
)
from rtcal.finder.positions.finding import MOST, PositionsFinding
from rtcal.finder.positions.hypotheses import (
    COUPLED,
    WHOLE,
    on_parts,
    on_surfaces,
    shifts,
    spreads,
)
from rtcal.finder.positions.posterior import (
    NOISE,
    OF_PROGRAMS,
    POSITION,
    THRESHOLD,
    TOLD_TEMPER,
    Likelihood,
    PositionsHypotheses,
    ShiftHypothesis,
    Summary,
    evaluate,
    evidence_of_means,
    gain,
    scores,
    summary_of,
    unconfirmed,
    weights,
    with_families,
)
from rtcal.finder.positions.problem import PositionsProblem, problem_of
from rtcal.finder.positions.weighing import PairShifts, parameters, responses_of
from rtcal.finder.prior import COEFFICIENTS, NONE, UNKNOWN, left_out_of, probability_off
from rtcal.finder.records import record_of_positions
from rtcal.loop.control_runs import ControlRuns, simulated_controls
from rtcal.loop.measured_pairs import T30_ALONE, with_t30
from rtcal.support import checks
from rtcal.support.errors import DataError
from rtcal.support.speed import Progress, TaskProgress, single_threaded_blas
from rtcal.support.types import Array


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


EFFECTS = tried(library())
"""Names of what is tried with rtcal's own library."""
_AIMED = (
    "A source's directivity is unknown: where it aims looks like absorption on the other surfaces."
)
_ANYWHERE = (
    "A second room gives its energy back to all positions alike. In both judged rooms in which "
    "one was detected, its aperture was on another surface than the most probable one. A room that "
    "scatters less than assumed has such decays, too: compare with a lower --scattering."
)
"""Why the surface of an aperture is not claimed (docs/where_study.md). A box with scattering of 0.05,
assumed to have 0.3, had been named a coupled room."""


MORE_PATHS = 3
"""Factor of the number of paths of the control runs. Over 16 pairs of seeds the score of four empty
development rooms had a standard deviation of at most 0.2 nats, and that of a room with an absorber one
of 0.47. With 6 it had 0.32; the shipped room then takes 1.4 times as long (docs/where_study.md)."""


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
) -> PositionsFinding:
    """Return whether a room is other than stated, in what, and where.

    Parameters
    ----------
    case : Case
    effects : sequence of Effect, optional
        The effects to try; the whole library if not given. Those that stand on surfaces are sought on
        each of them (`Effect.stands_on`).
    controls : ControlRuns, optional
        The simulator's error, as another finding's ``controls``.
    cache : path, optional
        Folder in which control runs and weighings are kept, by a hash of all that they depend on.
    seed : int
        Of control runs and paths.
    only, without : sequence of str
        Effects to try alone, or to leave out; by default names of `EFFECTS`.
    progress : callable, optional
        Called with what is computed, the number of finished steps and their total.

    Raises
    ------
    DataError
        For an unknown effect, too few pairs, or control runs of another simulator.
    """
    checks.whole("seed", seed, 0)
    every = checked_effects(effects)
    left_out = left_out_of(only, without, tried(every))
    means = None
    if not left_out and case.simulated is None:
        # The means know neither fewer effects nor another program's values.
        means = evidence_of_means(case, every, cache)
    found = find_by_positions(case, every, controls, cache, seed, left_out, progress, means)
    return found if means is None else replace(found, mistake=means.mistake)


def controls_of(
    case: PositionsCase,
    seed: int = 0,
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> ControlRuns:
    """Return the control runs of a search."""
    controls = simulated_controls(
        case.simulator,
        case.room,
        parameters(case),
        seed=seed,
        position_uncertainty=case.position_uncertainty,
        cache=cache,
        progress=progress,
        more_paths=MORE_PATHS,
    )
    if controls is None:  # a PathTracing has control runs always
        raise DataError(f"{case.simulator.name} has no geometry to trace")
    return controls


@single_threaded_blas()
def find_by_positions(
    case: PositionsCase,
    effects: Sequence[Effect],
    controls: ControlRuns | None,
    cache: str | os.PathLike[str] | None,
    seed: int,
    left_out: Sequence[str],
    progress: TaskProgress | None = None,
    means: MeansFinding | None = None,
) -> PositionsFinding:
    """Return what the positions say; ``means`` as `evidence_of_means`, None if they were not asked."""

    def run_finished(done: int, total: int) -> None:
        if progress is not None:
            progress("control runs", done, total)

    if controls is None:
        controls = controls_of(case, seed, cache, run_finished)
    made = responses_of(case, seed, cache, progress)
    threshold = THRESHOLD if case.simulated is None else OF_PROGRAMS

    def searched(
        case: PositionsCase,
    ) -> tuple[PositionsProblem, PositionsHypotheses, Array]:
        numbers = problem_of(case, made, controls)
        hypotheses = every_hypothesis(case, made, numbers, effects, left_out)
        return numbers, hypotheses, evaluated(numbers, hypotheses)

    def evaluated(
        numbers: PositionsProblem, hypotheses: PositionsHypotheses, sources: Array | float = 0.0
    ) -> Array:
        residuals = numbers.residual[:, np.newaxis]
        return evaluate(numbers.likelihoods(sources=sources), hypotheses, residuals)

    def with_gains(
        numbers: PositionsProblem,
        hypotheses: PositionsHypotheses,
        evidence: Array,
        sources: Array | float = 0.0,
    ) -> Array:
        for gains in numbers.gains:
            regained = evaluated(numbers, hypotheses, sources + gains)
            evidence = log_mixture(evidence, regained, MISCALIBRATED)
        return evidence

    numbers, hypotheses, evidence = searched(case)
    score, noise = scores(weights(evidence, hypotheses), hypotheses)
    # A gain or a lobe that is off may pass for the noise of a pair, which is no evidence by itself.
    disagree = max(score[0], noise[0]) > threshold
    of_gain = -np.inf
    if disagree and len(numbers.gains):
        as_calibrated = evidence
        evidence = with_gains(numbers, hypotheses, evidence)
        of_gain = float(gain(evidence, as_calibrated, hypotheses)[0])
        score, noise = scores(weights(evidence, hypotheses), hypotheses)
    reverberation = any(observable(p).part == "late" for p in numbers.data.observations.parameters)
    indexed = list(with_index(case.simulator))
    aimed, unexplained, doubted = 0.0, False, False
    if disagree and numbers.aimed is not None:
        lobes = evaluated(numbers, hypotheses, numbers.aimed)
        lobes = with_gains(numbers, hypotheses, lobes, numbers.aimed)
        aimed = float(gain(lobes, evidence, hypotheses)[0])
        if indexed and reverberation:
            told = summary_of(case, hypotheses, weights(evidence, hypotheses, TOLD_TEMPER))
            unexplained = told.unexplained >= CLAIMED
        doubted = aimed > (LIKELY_INDEX if indexed else LIKELY_LOBES) or unexplained
        if doubted and reverberation:
            case, of_gain = as_unknown(case), -np.inf
            numbers, hypotheses, evidence = searched(case)
            means = None if means is None else evidence_of_means(case, effects, cache)
        elif doubted:  # nothing is left that says as much whatever the source
            evidence = lobes
        else:
            evidence = log_mixture(evidence, lobes, AIMED)
        score, noise = scores(weights(evidence, hypotheses), hypotheses)
    detected = Detection(
        score=float(score[0]),
        threshold=threshold,
        noise=float(noise[0]) if np.isfinite(noise[0]) else None,
        means=None if means is None else means.score,
    )
    posterior = weights(evidence, hypotheses, TOLD_TEMPER)
    if means is not None:
        posterior = with_families(posterior, hypotheses, means.families)
    likelihood = numbers.likelihoods()[0].with_one_level()
    finding = _finding(case, numbers, hypotheses, posterior, likelihood, detected, effects)
    notes = (*finding.notes, lobes_in_words(aimed, indexed if doubted else ()))
    if means is not None and finding.effect is None and finding.family is None:
        notes = (unconfirmed(means), *notes)
    notes = (*notes, gains_in_words(of_gain), untried(effects), *([CHOSEN] if left_out else []))
    return replace(finding, left_out=tuple(left_out), notes=tuple(filter(None, notes)))


def every_hypothesis(
    case: PositionsCase,
    made: PairShifts,
    numbers: PositionsProblem,
    effects: Sequence[Effect],
    left_out: Sequence[str] = (),
) -> PositionsHypotheses:
    """Return the hypotheses of a search, but for some effects."""
    observations, (p, i, k) = numbers.data.observations, numbers.shape
    columns = [case.simulator.pairs.index(pair) for pair in observations.pairs]
    scale = np.moveaxis(numbers.scale.reshape(k, p, i), 0, 2)[..., np.newaxis]
    moved = {
        name: shift * scale
        for name, shift in made.at(observations.parameters, columns).columns.items()
        if name.startswith(("source ", "receiver "))
    }
    errors = (numbers.measurement + numbers.simulator_error()).reshape(k, p, i, k, p, i)
    places = spreads(observations.pairs, moved, errors)
    return PositionsHypotheses(
        shifts=on_parts(case, shifts(case, effects, left_out)),
        spreads=[spread for spread in places if spread.effect not in left_out],
        off=0.0 if COEFFICIENTS in left_out else probability_off(case.room),
        unknown=UNKNOWN not in left_out,
    )


def _finding(
    case: PositionsCase,
    numbers: PositionsProblem,
    hypotheses: PositionsHypotheses,
    posterior: Array,
    likelihood: Likelihood,
    detected: Detection,
    effects: Sequence[Effect],
) -> PositionsFinding:
    summary = summary_of(case, hypotheses, posterior)
    groups = _groups(case, hypotheses, summary, likelihood)
    in_families = [effect.name for effect in effects if not effect.alone]
    # The library as a whole is weighed against what it does not explain, and not each of its effects.
    known = dict(summary.probabilities)
    if known.get(UNKNOWN, 0.0) < MOST * (1 - known[NONE]):
        known.pop(UNKNOWN, None)
    verdict, family = claimed(detected.verdict, known, summary.families, in_families)
    best = next(e for e in known if e != NONE)
    placed = _first_placed(summary, verdict)
    reasons = _reasons(case, verdict, placed)
    first = next(iter(summary.surfaces))
    sure = summary.surfaces[first] * summary.on_surfaces >= CLAIMED
    located = verdict in ("named", "family", "ambiguous") and sure and not reasons
    observations = numbers.data.observations
    return PositionsFinding(
        case=case,
        verdict=verdict,
        effect=best if verdict == "named" else None,
        family=family,
        surface=first if located else None,
        surfaces=summary.surfaces,
        unexplained=summary.unexplained,
        groups=groups,
        candidates=summary.candidates,
        probabilities=summary.probabilities,
        families=summary.families,
        detection=detected,
        map=_map(numbers, likelihood),
        parameters=observations.parameters,
        pairs=observations.pairs,
        reasons=reasons,
        notes=(
            record_of_positions(case.room, observations.parameters),
            *_assumed(case),
            *case.notes,
            *numbers.data.notes,
        ),
        controls=numbers.controls,
        effects={effect.name: effect for effect in effects},
    )


def _assumed(case: PositionsCase) -> tuple[str, ...]:
    """Return notes of what the search takes together."""
    tracer = case.simulator
    together = "" if case.surfaces is not None else of_room.merged(case.geometry, case.faces)
    (instead,) = with_t30([TARGET.key], case.measured)
    alone = T30_ALONE if instead != TARGET.key and instead in case.match else ""
    return tuple(note for note in (alone, *tracer.notes, together) if note)


def untried(effects: Sequence[Effect]) -> str:
    """Return a note of what only means over positions try; "" where there is nothing.

    What changes no surface of the library (air, a formula) is the path tracing's own affair.
    """
    own = Effect.family
    names = sorted(e.name for e in effects if (e.removable or e.family == own) and not e.stands_on)
    if not names:
        return ""
    return (
        f"Not tried, since they stand on no surface: {', '.join(names)}. Means over positions "
        "(rtcal.find without a simulator) try them."
    )


def _first_placed(summary: Summary, verdict: str) -> Candidate | None:
    """Return the most probable candidate, if it is claimed and stands on a surface."""
    if verdict not in ("named", "family", "ambiguous"):
        return None
    first = summary.candidates[0]
    return first if first.surface is not None else None


def _reasons(case: PositionsCase, verdict: str, best: Candidate | None) -> tuple[str, ...]:
    """Return why the most probable surface is not claimed."""
    if verdict in ("named", "family", "ambiguous") and case.simulator.unknown_sources:
        return (_AIMED,)
    return (_ANYWHERE,) if best is not None and best.effect == COUPLED.name else ()


def _map(numbers: PositionsProblem, likelihood: Likelihood) -> Array:
    """Return simulated less measured in standard deviations, (n_parameters, n_pairs, n_bands)."""
    p, i, k = numbers.shape
    variance = np.diag(likelihood.covariance).copy()
    z = np.where(numbers.used, -numbers.residual / np.sqrt(variance), np.nan)
    return np.asarray(np.moveaxis(z.reshape(k, p, i), 0, 2))


def _groups(
    case: PositionsCase,
    hypotheses: PositionsHypotheses,
    summary: Summary,
    likelihood: Likelihood,
) -> tuple[tuple[str, ...], ...]:
    """Return the surfaces that the most probable effect, in its size, does not tell apart.

    Two surfaces are told apart where the shift of one, on the best size of the other, leaves more than
    `DISTINCT_NATS` to be expected, as far as the place on the most probable surface is known. Those
    that the data leave less probable than the first by more than that were told apart, too.
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
        row = int(np.argmin(near + _unlike(shift, best)))
        nodes = likelihood.nodes[shift.response]
        if name == best.surface:
            inverse = likelihood.inverse_with_place(shift, row)
        names.append(name)
        vectors.append(np.einsum("kn,krn->kr", shift.weights[row], nodes).ravel())
    if not vectors:
        return ()
    every = np.array(vectors).T
    gram = every.T @ inverse @ every
    size = np.maximum(np.diag(gram), 1e-12)
    nats = 0.5 * (size[:, np.newaxis] - gram**2 / size) / TOLD_TEMPER
    return _joined(names, np.minimum(nats, nats.T) < DISTINCT_NATS)


def _unlike(shift: ShiftHypothesis, best: Candidate) -> Array:
    """Return how far each hypothesis' spectrum is from the candidate's, (n_hypotheses,)."""
    return np.asarray(np.abs(shift.spectra - best.spectrum).max(axis=1))


def _joined(names: Sequence[str], alike: Array) -> tuple[tuple[str, ...], ...]:
    """Return the connected groups of two and more names."""
    left, out = set(range(len(names))), []
    while left:
        group = [left.pop()]
        for member in group:
            near = {other for other in left if alike[member, other]}
            left -= near
            group += sorted(near)
        if len(group) > 1:
            out.append(tuple(names[g] for g in sorted(group)))
    return tuple(out)
