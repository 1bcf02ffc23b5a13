"""Find what a model misses: screen, locate, name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.special import logsumexp

from rtcal.acoustics import bands
from rtcal.acoustics.quality import mid_frequency_time, schroeder_frequency
from rtcal.discrepancy.advice import next_measurement
from rtcal.discrepancy.bootstrap import Threshold, checked_controls, control_rooms
from rtcal.discrepancy.bootstrap import threshold as bootstrapped
from rtcal.discrepancy.case import AppliedEffect, Case
from rtcal.discrepancy.effect_checks import checked
from rtcal.discrepancy.effects import Effect, Parameters, library
from rtcal.discrepancy.engines import ControlRooms, Report, no_report
from rtcal.discrepancy.evidence import (
    NONE,
    UNKNOWN,
    Evidence,
    Hypotheses,
    ModelDiscrepancy,
    Observed,
    goodness_of_fit,
    hypotheses,
    log_likelihood,
    observe,
    standardized_residuals,
    weigh,
)
from rtcal.discrepancy.wording import (
    NATS,
    amount,
    best,
    in_words,
    material_of,
    runner_up,
    wrong,
)
from rtcal.errors import DataError
from rtcal.support import checks
from rtcal.support.types import Array

CANDIDATE_NATS = 1.1
"""Nats within which an effect is a candidate beside the best: odds of three to one. Ten to one (2.3)
holds the truth more often, in sets half as large again: docs/discrepancy.md."""
_NOWHERE = 8.0
"""Nats under the best, where no size need be tried."""
FEATURE_NAMES = ("T20", "EDT/T20", "T30/T20", "C80", "G")


@dataclass(frozen=True)
class Size:
    """How much there is of an effect: mean and 90 % interval, in ``unit``."""

    mean: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True, eq=False)
class Finding:
    """What a case's data say of its model.

    Attributes
    ----------
    verdict : {"none", "hint", "named", "ambiguous", "unknown"}
        ``named``: one effect explains the data; ``ambiguous``: those in ``candidates`` cannot be
        told apart with these data; ``unknown``: something is there that no effect of the library
        explains; ``hint``: less than the threshold, more than half of it.
    effect : str or None
        The best supported effect, unless the verdict is "none".
    candidates : tuple of str
        Effects within `CANDIDATE_NATS` nats of the best, the best first.
    evidence : mapping of str to float
        Nats over "none", by effect, and for "unknown".
    score, threshold : float
        The best effect's evidence and what it must exceed, in nats.
    engines : tuple of str
        The simulators whose control rooms the threshold and the model's discrepancy were learnt from.
    parameters : mapping of str to float
        The best effect's.
    size : Size or None
        How much there is of it, where it has a size.
    runner_up : str
        The second best.
    advice : str
        The next measurement that would settle it.
    residuals : array (n_configurations, n_features, n_bands)
        Measured less modelled over its standard deviation: amount (ln T20), shape (EDT/T20,
        T30/T20), level (C80, G). NaN where nothing was measured.
    notes : tuple of str
        What was dropped, and what not to believe.
    """

    case: Case
    verdict: str
    effect: str | None
    candidates: tuple[str, ...]
    evidence: Mapping[str, float]
    score: float
    threshold: float
    engines: tuple[str, ...]
    parameters: Mapping[str, float]
    size: Size | None
    runner_up: str
    advice: str
    residuals: Array
    notes: tuple[str, ...]
    discrepancy: ModelDiscrepancy = field(repr=False)
    effects: Mapping[str, Effect] = field(repr=False)

    def apply(self, case: Case | None = None) -> Case:
        """Return the case with the named effect in its model; what has it already is returned as it is.

        Raises DataError for a verdict without a named effect to add ("none", "hint", "unknown"). An
        ambiguous one adds the best candidate.
        """
        case = self.case if case is None else case
        if self.verdict in ("none", "hint") or self.effect in (None, UNKNOWN):
            raise DataError(f'the verdict is "{self.verdict}"; there is no named effect to add')
        if any(p.name == self.effect for p in case.applied):
            return case
        ends = None if self.size is None else (self.size.low, self.size.high)
        effect = self.effects[str(self.effect)]
        own = None if effect in library() else effect
        added = AppliedEffect(str(self.effect), dict(self.parameters), ends, own)
        return replace(case, applied=(*case.applied, added))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        size = self.size
        return {
            "verdict": self.verdict,
            "effect": self.effect,
            "candidates": list(self.candidates),
            "evidence": dict(self.evidence),
            "score": self.score,
            "threshold": self.threshold,
            "engines": list(self.engines),
            "parameters": dict(self.parameters),
            "material": material_of(self.parameters, self.case.room),
            "size": None
            if size is None
            else {"mean": size.mean, "low": size.low, "high": size.high, "unit": size.unit},
            "runner_up": self.runner_up,
            "advice": self.advice,
            "notes": list(self.notes),
            "residuals": [
                {
                    "configuration": c.name,
                    "feature": FEATURE_NAMES[f],
                    "values": [None if np.isnan(v) else round(float(v), 2) for v in row],
                }
                for c, table in zip(self.case.configurations, self.residuals, strict=True)
                for f, row in enumerate(table)
                if np.isfinite(row).any()
            ],
        }

    def __str__(self) -> str:
        """Return what a user reads."""
        return "\n".join(_lines(self))


def find(
    case: Case,
    effects: Sequence[Effect] | None = None,
    threshold: Threshold | float | None = None,
    seed: int = 0,
    *,
    engines: Sequence[str] = ("path tracing", "network"),
    controls: Sequence[ControlRooms] | None = None,
    report: Report = no_report,
) -> Finding:
    """Find what the case's model misses.

    Parameters
    ----------
    case : Case
    effects : sequence of Effect, optional
        Those to try; the whole library if not given.
    threshold : Threshold or float, optional
        Of an earlier bootstrap of the same case, or a number of nats; the model's discrepancy is then
        estimated from ``controls``. Bootstrapped if not given.
    seed : int
        Of the control rooms and of the bootstrap.
    engines : sequence of str
        At least two simulators that the control rooms go through.
    controls : sequence of ControlRooms, optional
        Control rooms that were run before.

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
    effects = library() if effects is None else checked(effects)
    observed, notes = observe(case)
    predicted = hypotheses(case, effects)
    if not isinstance(threshold, Threshold):
        if controls is None:
            controls = control_rooms(case, seed, engines, report)
        else:
            controls = checked_controls(case, controls)
        learnt = bootstrapped(case, observed, predicted, controls, seed)
        limit = learnt.value if threshold is None else checks.number("threshold", threshold)
        if not 0 <= limit < np.inf:
            raise DataError(f"threshold = {limit:g} nats is not finite and 0 or more")
        if threshold is not None:
            notes.append("the threshold was given, not bootstrapped")
    else:
        learnt, limit = threshold, threshold.value
    return judge(case, observed, predicted, learnt.discrepancy, limit, notes)


def judge(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    limit: float,
    notes: Sequence[str] = (),
) -> Finding:
    """Weigh the hypotheses and say what follows; `find` calls it."""
    evidence = weigh(observed, predicted, discrepancy)
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
        parameters, size = _size(case, observed, predicted, discrepancy, evidence, best)
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


def _size(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    evidence: Evidence,
    name: str,
) -> tuple[Parameters, Size | None]:
    """The effect's most probable parameters, and its size with a 90 % interval.

    The grid's best is improved by a search; then the size is tried in fine steps around the most
    probable others.
    """
    effect = predicted.effects[name]
    rows = [i for i, n in enumerate(predicted.names) if n == name]
    likelihood = evidence.log_likelihood[rows]
    grid = [predicted.parameters[i] for i in rows]

    def weighed(thetas: Sequence[Parameters]) -> Array:
        tried = hypotheses(case, [effect], [thetas])
        return log_likelihood(observed, tried, discrepancy, observed.values[None])[1:, 0]

    best = _searched(grid, grid[int(np.argmax(likelihood))], effect.discrete, weighed)
    if not np.isfinite(effect.neutral):
        return best, None
    weights = np.exp(likelihood - logsumexp(likelihood))
    others: dict[tuple[tuple[str, float], ...], float] = {}
    for theta, w in zip(grid, weights, strict=True):
        others[_others(theta, effect)] = others.get(_others(theta, effect), 0.0) + float(w)
    most = sorted(others, key=lambda k: -others[k])[:3]
    likely = list(dict.fromkeys([_others(best, effect), *most]))
    sizes = np.array([theta[effect.size] for theta in grid])
    logs = bool(sizes.min() > 0)
    low, high = float(sizes.min()), float(sizes.max())
    first, last = (np.log(low / 3), np.log(high * 3)) if logs else (low - 10, high + 10)

    def size_of(x: Array) -> Array:
        return np.exp(x) if logs else x

    def at(x: Array, kinds: Sequence[Any]) -> Array:
        return weighed([{**dict(k), effect.size: float(s)} for k in kinds for s in size_of(x)])

    coarse = np.linspace(first, last, 25)
    log_p = at(coarse, likely[:1])
    there = coarse[log_p > log_p.max() - _NOWHERE]
    step = coarse[1] - coarse[0] + 2.6 * effect.size_error
    fine = np.linspace(there[0] - step, there[-1] + step, 37)
    log_p = at(fine, likely)
    by_size = np.exp(log_p - logsumexp(log_p)).reshape(len(likely), len(fine)).sum(0)
    by_size = _widened(by_size, fine, effect.size_error)
    cumulated = np.cumsum(by_size) - 0.5 * by_size
    ends = [float(np.interp(q, cumulated, size_of(fine))) for q in (0.05, 0.95)]
    return best, Size(float(by_size @ size_of(fine)), ends[0], ends[1], effect.unit)


_SURPRISING = 1e-3
"""Probability under which the best effect is said not to explain the measurement."""
_GROSS = np.log(2.0)
"""Of ln T, beyond which what is stated is to be looked at before anything is believed."""


def _doubts(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    name: str,
    parameters: Parameters,
) -> list[str]:
    """What speaks against the best effect, though no other is better."""
    effect = predicted.effects[name]
    out = []
    change = float(np.nanmedian((observed.features - predicted.features[0])[:, 0]))
    if abs(change) > _GROSS:
        out.append(
            f"T is {np.exp(change):.2g} times the model's: look for a mistake in volume, areas, "
            "coefficients and units before any effect is believed"
        )
    here = hypotheses(case, [effect], [[parameters]])
    times, probability = goodness_of_fit(observed, here, discrepancy, 1)
    if probability < _SURPRISING:
        out.append(
            f"{name} is the best of the effects and does not explain the measurement: with it in the "
            f"model it is {times:.1f} times as far off as all uncertainties allow. Check volume, "
            "areas, coefficients, units and bands"
        )
    tried = [
        theta[effect.size]
        for n, theta in zip(predicted.names, predicted.parameters, strict=True)
        if n == name
    ]
    value, least, most = parameters[effect.size], min(tried), max(tried)
    at_end = bool(np.isclose(value, [least, most], rtol=1e-6).any())
    if effect.size not in effect.discrete and least < most and at_end:
        out.append(f"{name}: {value:.3g} is the end of what is tried ({least:.3g} to {most:.3g})")
    return out


def _widened(p: Array, at: Array, spread: float) -> Array:
    """The probabilities p on an even grid, convolved with a normal distribution."""
    if spread == 0:
        return p
    kernel = np.exp(-0.5 * (np.subtract.outer(at, at) / spread) ** 2)
    # What would leave the grid stays at its ends.
    return np.asarray(kernel / kernel.sum(0) @ p)


def _others(theta: Parameters, effect: Effect) -> tuple[tuple[str, float], ...]:
    return tuple((k, v) for k, v in theta.items() if k != effect.size)


def _searched(
    grid: Sequence[Parameters],
    start: Parameters,
    discrete: Sequence[str],
    weighed: Callable[[Sequence[Parameters]], Array],
) -> Parameters:
    """Improve the grid's best parameters within the grid's range, the discrete ones held.

    Each round tries a lattice around the best, as wide as the last one's steps.
    """
    names = [k for k in start if k not in discrete and len({theta[k] for theta in grid}) > 1]
    if not names:
        return start
    values = np.array([[theta[k] for k in names] for theta in grid])
    logs = values.min(0) > 0
    scaled = np.log(np.where(logs, values, 1.0)) + np.where(logs, 0.0, values)
    low, width = scaled.min(0), np.ptp(scaled, axis=0)
    at = (scaled[grid.index(start)] - low) / width
    step = np.array([1 / (len(np.unique(column)) - 1) for column in values.T])

    def theta_of(x: Array) -> Parameters:
        own = low + width * x
        own = np.where(logs, np.exp(np.where(logs, own, 0.0)), own)
        return {**start, **dict(zip(names, own.tolist(), strict=True))}

    points, rounds = {1: (9, 3), 2: (5, 5)}.get(len(names), (3, 5))
    lattice = np.array(list(product(np.linspace(-1, 1, points), repeat=len(names))))
    for _ in range(rounds):
        tried = np.unique(np.clip(at + lattice * step, 0, 1), axis=0)
        at = tried[np.argmax(weighed([theta_of(x) for x in tried]))]
        step = step * 2 / (points - 1) if points > 3 else step / 2
    return theta_of(at)


def _notes(case: Case) -> list[str]:
    """What not to believe, whatever is found."""
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


def _lines(finding: Finding) -> list[str]:
    f = finding
    others = [c for c in f.candidates if c != f.effect]
    what = {
        "none": "No disagreement beyond what prior, measurement and model error allow.",
        "hint": f"A hint of {best(f)}, under the threshold.",
        "named": f"{wrong(f)}: {best(f)}.",
        "ambiguous": f"{wrong(f)}: one of {', '.join([best(f), *others])}.",
        "unknown": "Something is missing that no effect of the library explains.",
    }[f.verdict]
    lines = [f"{f.verdict}: {what}"]
    if f.size is not None and f.verdict in ("named", "ambiguous"):
        s = f.size
        rest = in_words(f.parameters, without=f.effects[str(f.effect)].size)
        lines.append(
            f"  size of {best(f)}: {amount(s.mean, s.unit)} (mean; 90 %: {s.low:.3g} to {s.high:.3g})"
            + (f"; {rest}" if rest else "")
        )
    elif f.parameters:
        lines.append("  " + in_words(f.parameters))
    lines.append(
        f"  evidence {f.score:+.1f} nats ({NATS}); threshold {f.threshold:.1f}, bootstrapped on "
        f"{' and '.join(f.engines) or 'no engine'}; runner-up {runner_up(f)}"
    )
    for c, table in zip(f.case.configurations, f.residuals, strict=True):
        lines.append(f'  residuals of "{c.name}", in standard deviations (measured - model):')
        heads = "".join(f"{bands.label(x):>9}" for x in f.case.room.centre_frequencies)
        lines.append(f"    {'':9}{heads}")
        for name, row in zip(FEATURE_NAMES, table, strict=True):
            if np.isfinite(row).any():
                cells = "".join("        -" if np.isnan(v) else f"{v:+9.1f}" for v in row)
                lines.append(f"    {name:9}{cells}")
    lines.append(f"  next: {f.advice}")
    lines += [f"  note: {n}" for n in f.notes]
    return lines
