"""Find what a model lacks: compare the evidence of every effect, decide, estimate the effect's size."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np

from rtcal.acoustics import bands
from rtcal.errors import DataError
from rtcal.finder.case import Case
from rtcal.finder.claim import by_family, claim, credible_set, posterior
from rtcal.finder.effects import Effect, library
from rtcal.finder.effects.checks import checked_effects
from rtcal.finder.means.advice import next_measurement
from rtcal.finder.means.bootstrap import (
    Threshold,
    bootstrap_threshold,
    checked_controls,
    control_rooms,
)
from rtcal.finder.means.bootstrap import score as evidence_of_something
from rtcal.finder.means.cache import cached_control_rooms
from rtcal.finder.means.doubts import Doubt, schroeder_limit
from rtcal.finder.means.engines import ControlRooms
from rtcal.finder.means.evidence import evaluate_beyond
from rtcal.finder.means.features import Observed, observe
from rtcal.finder.means.finding import Finding
from rtcal.finder.means.hypotheses import Hypotheses, predict_hypotheses
from rtcal.finder.means.likelihood import standardized_residuals
from rtcal.finder.means.model_error import ModelDiscrepancy
from rtcal.finder.means.verdict import Fit, doubted, doubts, fit
from rtcal.finder.prior import (
    COEFFICIENTS,
    NONE,
    Prior,
    checked_odds,
    chosen_effects,
    prior_of,
)
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.progress import TaskProgress
from rtcal.support.threads import single_threaded_blas


@single_threaded_blas()
@checked
def find(
    case: Case,
    effects: Sequence[Effect] | None = None,
    threshold: Threshold | float | None = None,
    seed: int = 0,
    *,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    prior: Mapping[str, float] | None = None,
    engines: Sequence[str] = ("path tracing", "network"),
    controls: Sequence[ControlRooms] | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: TaskProgress | None = None,
) -> Finding:
    """Find what the case's model lacks.

    Parameters
    ----------
    case : Case
    effects : sequence of Effect, optional
        The effects to try; the whole library if not given.
    threshold : Threshold or float, optional
        Of an earlier bootstrap of the same case, or a number of nats; the model's discrepancy is then
        estimated from ``controls``. Bootstrapped if not given.
    seed : int
        Of the control rooms and of the bootstrap.
    without, only : sequence of str
        Names of effects that are not tried, or of the ones that are. ``without`` may have
        "coefficients" and "unknown".
    prior : mapping of str to float, optional
        Prior odds of effects against the others, in place of their own: ``{"opening": 2.0}``. Those
        of "none" are against anything missing, those of "coefficients" against coefficients as stated.
    engines : sequence of str
        At least two simulators that the control rooms go through.
    controls : sequence of ControlRooms, optional
        Control rooms that were simulated before.
    cache : path, optional
        Folder in which control rooms are kept, as `rtcal.finder.means.cache` says.
    progress : callable, optional
        Called with an engine's name, the number of finished control rooms and their total.

    Returns
    -------
    Finding

    Raises
    ------
    DataError
        If fewer than two engines are given, or control rooms of another case; if the room was
        calibrated on one of the case's T already; for an effect that breaks a rule, which the message
        names.
    """
    checks.instance("case", case, Case).require_fresh()
    checks.whole("seed", seed, 0)
    effects, left_out = effects_to_try(effects, without, only)
    observed, notes = observe(case)
    if len(without) or len(only) or prior:
        notes = [*notes, CHOSEN]
    before = prior_of(case.room, effects, checked_odds(effects, prior), left_out)
    predicted = predict_hypotheses(case, effects)
    if not isinstance(threshold, Threshold):
        if controls is None:
            if cache is None:
                controls = control_rooms(case, seed, engines, progress)
            else:
                controls = cached_control_rooms(case, cache, seed, engines, progress)
        else:
            controls = checked_controls(case, controls)
        bootstrapped = bootstrap_threshold(case, observed, predicted, controls, before, seed)
        limit = bootstrapped.value if threshold is None else checks.number("threshold", threshold)
        if not 0 <= limit < np.inf:
            raise DataError(f"threshold = {limit:g} nats is not finite and 0 or more")
        if threshold is not None:
            notes.append("the threshold was given, not bootstrapped")
    else:
        bootstrapped, limit = threshold, threshold.value
    return _conclude(case, observed, predicted, bootstrapped.discrepancy, limit, before, notes)


def effects_to_try(
    effects: Sequence[Effect] | None, without: Sequence[str], only: Sequence[str]
) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """Return the effects that a search tries, and what else is left out; the library if None."""
    return chosen_effects(library() if effects is None else checked_effects(effects), without, only)


CHOSEN = (
    "effects were left out or weighted by hand: the probabilities are among those that were tried, and "
    "how often such findings were right was measured with the whole library"
)
"""What a finding says of effects that were not tried."""


def _conclude(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    limit: float,
    prior: Prior,
    notes: Sequence[str] = (),
) -> Finding:
    """Compare the hypotheses' evidence and return the finding."""
    predicted, evidence = evaluate_beyond(case, observed, predicted, discrepancy, prior.off)
    table = {k: float(v) for k, v in evidence.by_effect().items()}
    over = {k: v - table[NONE] for k, v in table.items() if k != NONE}
    probabilities = posterior(table, prior)
    families = by_family(probabilities, predicted.effects)
    order = [k for k in probabilities if k != NONE]
    best, score = order[0], float(evidence_of_something(evidence, prior))
    detected = None if score > limit else "hint" if score > 0 else "none"
    rough = [name for name, effect in predicted.effects.items() if not effect.alone]
    verdict, family = claim(detected, probabilities, families, rough)
    fits, found = dict[str, Fit](), tuple[Doubt, ...]()

    def fitted(name: str) -> None:
        if name in predicted.effects or name == COEFFICIENTS:
            fits[name] = fit(
                case, observed, predicted, discrepancy, evidence, name, precise=name == best
            )

    if verdict != "none":
        fitted(best)
        if best in fits:
            found = doubts(case, observed, predicted, discrepancy, evidence, fits[best], over[best])
            verdict = doubted(verdict, family, found)
    candidates: tuple[str, ...] = ()
    if verdict != "none":
        candidates = (best,) if verdict == "named" else credible_set(probabilities)
    for name in candidates:
        if name != best:
            fitted(name)
    return Finding(
        case=case,
        verdict=verdict,
        effect=None if verdict in ("none", "family") else best,
        family=family,
        candidates=candidates,
        evidence={k: over[k] for k in sorted(over, key=lambda k: -over[k])},
        probabilities=probabilities,
        families=families,
        prior=prior,
        score=score,
        threshold=limit,
        engines=discrepancy.engines,
        fits=fits,
        runner_up=order[1] if len(order) > 1 else NONE,
        advice=next_measurement(case, observed, predicted, discrepancy, evidence, candidates),
        residuals=standardized_residuals(observed, predicted, discrepancy),
        reasons=tuple(doubt.words for doubt in found),
        notes=(*notes, observed.origin, *_notes(case)),
        discrepancy=discrepancy,
        effects=predicted.effects,
    )


def _notes(case: Case) -> list[str]:
    """Return reasons to doubt the result, whatever it is."""
    out = []
    for c in case.configurations:
        limit = schroeder_limit(case, c.measured.decay_time().mean)
        low = [f for f in case.room.centre_frequencies if f < limit]
        if low:
            out.append(
                f'"{c.name}": {", ".join(bands.label(f) for f in low)} under Schroeder\'s frequency '
                f"({limit:.0f} Hz), where no field is diffuse"
            )
        if {"t20", "t30"} <= set(c.measured.values):
            curved = 100 * (c.measured.mean("t30") / c.measured.mean("t20") - 1)
            for f, v in zip(case.room.centre_frequencies, curved, strict=True):
                if abs(v) > 10:
                    out.append(
                        f'"{c.name}": the decay at {bands.label(f)} is not straight: curvature '
                        f"{v:+.0f} % (ISO 3382-2, Annex B, at most 10 %)"
                    )
    if case.room.air is None:
        out.append("no air is stated: the model's air absorbs nothing")
    return out
