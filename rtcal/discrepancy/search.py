"""Find what a model lacks: compare the evidence of every effect, decide, estimate the effect's size."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.quality import mid_frequency_time, schroeder_frequency
from rtcal.discrepancy.advice import next_measurement
from rtcal.discrepancy.bootstrap import (
    Threshold,
    bootstrap_threshold,
    checked_controls,
    control_rooms,
)
from rtcal.discrepancy.cache import cached_control_rooms
from rtcal.discrepancy.case import Case
from rtcal.discrepancy.effects import Effect, Parameters, library
from rtcal.discrepancy.effects.checks import checked_effects
from rtcal.discrepancy.engines import ControlRooms, Report, no_report
from rtcal.discrepancy.evidence import (
    UNKNOWN,
    ModelDiscrepancy,
    evaluate,
    goodness_of_fit,
    standardized_residuals,
)
from rtcal.discrepancy.features import Observed, observe
from rtcal.discrepancy.finding import Finding
from rtcal.discrepancy.hypotheses import NONE, Hypotheses, predict_hypotheses
from rtcal.discrepancy.size import estimate_size
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.arguments import checked
from rtcal.support.threads import single_threaded_blas

CANDIDATE_NATS = 1.1
"""Evidence in nats by which a candidate may be below the best effect: odds of three to one. With ten to
one (2.3) the candidates include the truth more often, but are 1.5 times as many
(docs/discrepancy.md)."""


@single_threaded_blas()
@checked
def find(
    case: Case,
    effects: Sequence[Effect] | None = None,
    threshold: Threshold | float | None = None,
    seed: int = 0,
    *,
    engines: Sequence[str] = ("path tracing", "network"),
    controls: Sequence[ControlRooms] | None = None,
    cache: str | os.PathLike[str] | None = None,
    report: Report = no_report,
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
    engines : sequence of str
        At least two simulators that the control rooms go through.
    controls : sequence of ControlRooms, optional
        Control rooms that were simulated before.
    cache : path, optional
        Folder in which control rooms are kept, as `rtcal.discrepancy.cache` says.
    report : function, optional
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
    effects = library() if effects is None else checked_effects(effects)
    observed, notes = observe(case)
    predicted = predict_hypotheses(case, effects)
    if not isinstance(threshold, Threshold):
        if controls is None:
            if cache is None:
                controls = control_rooms(case, seed, engines, report)
            else:
                controls = cached_control_rooms(case, cache, seed, engines, report)
        else:
            controls = checked_controls(case, controls)
        bootstrapped = bootstrap_threshold(case, observed, predicted, controls, seed)
        limit = bootstrapped.value if threshold is None else checks.number("threshold", threshold)
        if not 0 <= limit < np.inf:
            raise DataError(f"threshold = {limit:g} nats is not finite and 0 or more")
        if threshold is not None:
            notes.append("the threshold was given, not bootstrapped")
    else:
        bootstrapped, limit = threshold, threshold.value
    return _conclude(case, observed, predicted, bootstrapped.discrepancy, limit, notes)


def _conclude(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    limit: float,
    notes: Sequence[str] = (),
) -> Finding:
    """Compare the hypotheses' evidence and return the finding."""
    evidence = evaluate(observed, predicted, discrepancy)
    table = {k: float(v) for k, v in evidence.by_effect().items()}
    over = {k: v - table[NONE] for k, v in table.items() if k != NONE}
    order = sorted(over, key=lambda k: -over[k])
    best, score = order[0], over[order[0]]
    candidates = tuple(k for k in order if over[k] > score - CANDIDATE_NATS)
    if score <= limit:
        verdict = "hint" if score > max(0.5 * limit, 0.5) else "none"
    elif best == UNKNOWN:
        verdict = "unknown"
    else:
        verdict = "named" if len(candidates) == 1 else "ambiguous"
    if verdict == "none":
        candidates = ()
    parameters: Parameters = {}
    size = None
    doubts: list[str] = []
    if verdict != "none" and best != UNKNOWN:
        parameters, size = estimate_size(case, observed, predicted, discrepancy, evidence, best)
        doubts = _doubts(case, observed, predicted, discrepancy, best, parameters)
    return Finding(
        case=case,
        verdict=verdict,
        effect=None if verdict == "none" else best,
        candidates=candidates,
        evidence={k: over[k] for k in order},
        score=score,
        threshold=limit,
        engines=discrepancy.engines,
        parameters=parameters,
        size=size,
        runner_up=order[1] if len(order) > 1 else NONE,
        advice=next_measurement(case, observed, predicted, discrepancy, evidence, candidates),
        residuals=standardized_residuals(observed, predicted, discrepancy),
        notes=(*doubts, *notes, *_notes(case)),
        discrepancy=discrepancy,
        effects=predicted.effects,
    )


_SURPRISING = 1e-3
"""Probability of the residuals below which a note says that the best effect does not explain them."""
_GROSS = np.log(2.0)
"""Change of ln T, a factor of two, beyond which a mistake in what is stated is the first suspicion."""


def _doubts(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    name: str,
    parameters: Parameters,
) -> list[str]:
    """Return reasons to doubt the best effect."""
    effect = predicted.effects[name]
    out = []
    change = float(np.nanmedian((observed.features - predicted.features[0])[:, 0]))
    if abs(change) > _GROSS:
        out.append(
            f"T is {np.exp(change):.2g} times the model's: look for a mistake in volume, areas, "
            "coefficients and units before any effect is believed"
        )
    fitted = predict_hypotheses(case, [effect], [[parameters]])
    times, probability = goodness_of_fit(observed, fitted, discrepancy, 1)
    if probability < _SURPRISING:
        out.append(
            f"{name} is the best of the effects and does not explain the measurement: with it in the "
            f"model it is {times:.1f} times as far off as all uncertainties allow. Check volume, "
            "areas, coefficients, units and bands"
        )
    sizes = [
        theta[effect.size]
        for n, theta in zip(predicted.names, predicted.parameters, strict=True)
        if n == name
    ]
    value, least, most = parameters[effect.size], min(sizes), max(sizes)
    at_end = bool(np.isclose(value, [least, most], rtol=1e-6).any())
    if effect.size not in effect.discrete and least < most and at_end:
        out.append(f"{name}: {value:.3g} is the end of what is tried ({least:.3g} to {most:.3g})")
    return out


def _notes(case: Case) -> list[str]:
    """Return reasons to doubt the result, whatever it is."""
    out = []
    for c in case.configurations:
        t = c.measured.decay_time().mean
        middle = mid_frequency_time(t, case.room.centre_frequencies)
        limit = float(schroeder_frequency(np.array(middle), case.room.volume))
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
