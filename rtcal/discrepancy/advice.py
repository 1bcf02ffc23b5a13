"""The next measurement, and which effects the data can distinguish: distances between predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtcal.discrepancy.case import Case
from rtcal.discrepancy.effects import Effect, library
from rtcal.discrepancy.effects.checks import checked_effects
from rtcal.discrepancy.evidence import Evidence
from rtcal.discrepancy.features import Observed, observe
from rtcal.discrepancy.hypotheses import Hypotheses, predict_hypotheses
from rtcal.discrepancy.likelihood import alpha_covariance
from rtcal.discrepancy.model import FEATURES
from rtcal.discrepancy.model_error import ModelDiscrepancy, checked_discrepancy
from rtcal.discrepancy.prior import COEFFICIENTS, NONE, UNKNOWN
from rtcal.errors import DataError
from rtcal.support import checks, text
from rtcal.support.arguments import checked
from rtcal.support.threads import single_threaded_blas
from rtcal.support.types import Array

DISTINCT_NATS = 2.3
"""Evidence in nats from which two effects can be told apart: odds of ten to one."""
_USUAL = np.array([0.015, 0.03, 0.02, 0.5, 0.5])
"""Standard uncertainty of a mean over four positions that is not measured yet, by feature."""


def separation(
    predicted: Hypotheses, covariance: Array, mask: Array, first: int, second: str
) -> float:
    """Return the expected evidence in nats against effect ``second`` if ``first`` is true.

    It is ½ min d' C⁻¹ d over the parameters of ``second``, with the masked features.
    """
    rows = [i for i, n in enumerate(predicted.names) if n == second]
    inverse = np.linalg.inv(covariance[np.ix_(mask, mask)])
    d = predicted.features[rows].reshape(len(rows), -1)[:, mask]
    d = d - predicted.features[first].ravel()[mask]
    return float(0.5 * np.einsum("ni,ij,nj->n", d, inverse, d).min())


def _covariance(
    predicted: Hypotheses, discrepancy: ModelDiscrepancy, measured: Array, i: int
) -> Array:
    return np.asarray(alpha_covariance(predicted, i) + discrepancy.covariance + np.diag(measured))


def _variances(case: Case, observed: Observed) -> Array:
    """Measurement variance of every feature, also of features that were not measured."""
    shape = observed.used.shape
    table = np.broadcast_to(_USUAL[None, :, None] ** 2, shape).copy()
    table[observed.used] = np.diag(observed.covariance)
    return np.asarray(table.ravel())


def next_measurement(
    case: Case,
    observed: Observed,
    predicted: Hypotheses,
    discrepancy: ModelDiscrepancy,
    evidence: Evidence,
    candidates: Sequence[str],
) -> str:
    """Return the measurement that would decide between the candidates."""
    named = [c for c in candidates if c not in (UNKNOWN, COEFFICIENTS)]
    if candidates and candidates[0] == COEFFICIENTS:
        return (
            "look for another source of the coefficients, first for the material with the largest "
            "product of area and sigma; or measure with and without a known absorber"
        )
    if not named:
        return (
            "nothing to settle"
            if not candidates
            else "see in the residuals which band and parameter disagree, and measure these again"
        )
    best = named[0]
    rows = [i for i, n in enumerate(predicted.names) if n == best]
    first = rows[int(np.argmax(evidence.by_hypothesis()[rows]))]
    if len(named) == 1:
        if predicted.effects[best].removable:
            return f"confirm it: measure once without the {best}"
        return f"confirm it: check the {best} where it can be looked up or measured by itself"
    rival = named[1]
    variances = _variances(case, observed)
    covariance = _covariance(predicted, discrepancy, variances, first)
    used = observed.used
    now = separation(predicted, covariance, used.ravel(), first, rival)
    options = []
    for label, features in (
        ("EDT and T30", ("edt", "t30")),
        ("C80", ("c80",)),
        ("G, with a calibrated source", ("g",)),
    ):
        rows_f = [FEATURES.index(f) for f in features]
        more = used.copy()
        more[:, rows_f] = True
        if more.sum() > used.sum():
            options.append((separation(predicted, covariance, more.ravel(), first, rival), label))
    removable = {n: predicted.effects[n].removable for n in (best, rival)}
    if len(set(removable.values())) == 2:
        suspect = best if removable[best] else rival
        return (
            f"measure with and without the {suspect}. If it is that, T changes, and the uncertainty of "
            "alpha cancels in the difference"
        )
    if options and max(options)[0] > now + 1:
        gain, label = max(options)
        return (
            f"measure {label}: with it {best} and {rival} would differ by {gain:.1f} nats instead of "
            f"{now:.1f}"
        )
    if all(removable.values()):
        return (
            f"measure with and without the {best}, then with and without the {rival}. The uncertainty "
            "of alpha cancels in the difference"
        )
    return (
        f"look at the room: {best} and {rival} predict the same in every parameter, and one of them "
        "can be seen, or measured with a rule"
    )


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The effects that a case's data could distinguish.

    ``separations`` maps (effect, effect) to nats: the expected evidence for the first effect
    against the most similar size of the second. The first has the size whose relative change of T
    is nearest to ``change``. ``reached`` maps each effect to the change of T at this size.
    """

    parameters: tuple[str, ...]
    change: float
    reached: Mapping[str, float]
    separations: Mapping[tuple[str, str], float]
    more: Mapping[str, Mapping[tuple[str, str], float]]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""

        def rows(table: Mapping[tuple[str, str], float]) -> list[dict[str, Any]]:
            return [{"effect": a, "against": b, "nats": v} for (a, b), v in table.items()]

        return {
            "parameters": list(self.parameters),
            "change": self.change,
            "reached": dict(self.reached),
            "separations": rows(self.separations),
            "with_more": {label: rows(table) for label, table in self.more.items()},
        }

    def __repr__(self) -> str:
        """Return one line: the parameters, and how many pairs of effects they can distinguish."""
        names = list(self.reached)
        pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
        both, one_sided = _blind(self.separations, pairs)
        distinct = len(pairs) - len(both) - len(one_sided)
        return (
            f"<Plan with {', '.join(self.parameters)}: {distinct} of {len(pairs)} pairs of effects "
            "can be distinguished>"
        )

    def __str__(self) -> str:
        """Return the table of expected evidence, and the pairs that cannot be distinguished."""
        names = list(dict.fromkeys(a for a, _ in self.separations))
        lines = text.wrapped(
            f"Evidence to expect (nats) from {', '.join(p.upper() for p in self.parameters)}, if the "
            "effect of the row is in the room, against the effect of the column. Each effect has the "
            f"size whose change of T is nearest to {100 * self.change:g} % (second column). Above "
            f"{DISTINCT_NATS} nats, odds of ten to one, effects can be told apart. Above "
            f"{_MOST:.0f} nats no number is printed.",
            hanging="",
        )
        words = [["change", "of T"], *(n.replace("-", "- ").split() for n in (NONE, *names))]
        height = max(map(len, words))
        padded = [[""] * (height - len(column)) + column for column in words]
        header = [("", [column[row] for column in padded]) for row in range(height)]
        rows = []
        for a in names:
            cells = [f"{100 * self.reached[a]:.1f} %"]
            cells += ["." if a == b else _cell(self.separations[a, b]) for b in (NONE, *names)]
            rows.append((a, cells))
        lines += text.table(rows, header=header)
        pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
        both, one_sided = _blind(self.separations, pairs)
        unseen = [a for a in names if self.separations[a, NONE] < DISTINCT_NATS]
        if unseen:
            lines += text.wrapped(
                f"Cannot be told from a model that lacks nothing: {', '.join(unseen)}."
            )
        lines += _grouped("Cannot be told apart", both)
        lines += _grouped("Can pass for another, but not the other for it", one_sided)
        for label, table in self.more.items():
            still, half = _blind(table, pairs)
            gained = [p for p in both if p not in still and p not in half and p[::-1] not in half]
            gained += [p for p in one_sided if p not in half]
            lines += _grouped(f"Could also be told apart with {label}", gained)
        return "\n".join(lines)


_MOST = 99.0
"""Evidence in nats above which the table shows no number: the distinction is certain."""
Pairs = list[tuple[str, str]]


def _cell(nats: float) -> str:
    return f"{nats:.1f}" if nats <= _MOST else f">{_MOST:.0f}"


def _grouped(title: str, pairs: Pairs) -> list[str]:
    """Return a title, and a line per first effect of some pairs with all its second ones."""
    others: dict[str, list[str]] = {}
    for a, b in pairs:
        others.setdefault(a, []).append(b)
    if not others:
        return [f"{title}: none."]
    rows = [f"{a}: {', '.join(b)}" for a, b in others.items()]
    return [f"{title}:", *(line for row in rows for line in text.wrapped(row, indent="  "))]


def _blind(separations: Mapping[tuple[str, str], float], pairs: Pairs) -> tuple[Pairs, Pairs]:
    """Pairs indistinguishable both ways, and pairs where only the first can pass for the second."""
    both, one_sided = [], []
    for a, b in pairs:
        weak = (separations[a, b] < DISTINCT_NATS, separations[b, a] < DISTINCT_NATS)
        if all(weak):
            both.append((a, b))
        elif any(weak):
            one_sided.append((a, b) if weak[0] else (b, a))
    return both, one_sided


GENERIC_UNCERTAINTY = (0.04, 0.04, 0.02, 0.7, 0.7)
"""Standard deviation of the model's error before any engine has run, by feature."""


@single_threaded_blas()
@checked
def plan(
    case: Case,
    effects: Sequence[Effect] | None = None,
    change: float = 0.2,
    discrepancy: ModelDiscrepancy | None = None,
) -> Plan:
    """Return the effects that the case's data could distinguish, before they are measured.

    Parameters
    ----------
    case : Case
        Of its measurements, only the parameters and their uncertainties are used.
    effects : sequence of Effect, optional
        By default the whole library.
    change : float
        Relative change of T20 in the band that the effect changes most, above 0 and at most 1. Each
        effect has the size that comes nearest to it.
    discrepancy : ModelDiscrepancy, optional
        From the case's control rooms; by default `GENERIC_UNCERTAINTY`.

    Raises
    ------
    DataError
        If ``change`` is no such number, or an effect breaks a rule.
    """
    change = checks.number("change", change)
    if not 0 < change <= 1:
        raise DataError(f"change = {change:g} is not above 0 and at most 1 (a share of T)")
    observed, _ = observe(case)
    predicted = predict_hypotheses(case, library() if effects is None else checked_effects(effects))
    if discrepancy is None:
        shape = observed.used.shape
        spread = np.broadcast_to(np.array(GENERIC_UNCERTAINTY)[None, :, None] ** 2, shape).ravel()
        discrepancy = ModelDiscrepancy(np.zeros(spread.size), np.diag(spread))
    else:
        checked_discrepancy(case, discrepancy)
    variances = _variances(case, observed)
    base = predicted.features[0]
    names = [n for n in dict.fromkeys(predicted.names) if n != NONE]
    used = observed.used
    masks = {"": used}
    for label, features in (
        ("EDT and T30", ("edt", "t30")),
        ("C80 and G", ("c80", "g")),
    ):
        more = used.copy()
        more[:, [FEATURES.index(f) for f in features]] = True
        if more.sum() > used.sum():
            lacking = [i for i in range(len(case.configurations)) if (more[i] & ~used[i]).any()]
            where = [f'"{case.configurations[i].name}"' for i in lacking]
            there = len(where) < len(case.configurations)
            masks[label + (f" of {' and '.join(where)}" if there else "")] = more
    tables: dict[str, dict[tuple[str, str], float]] = {m: {} for m in masks}
    reached: dict[str, float] = {}
    for a in names:
        rows = [i for i, n in enumerate(predicted.names) if n == a]
        # The size whose largest change of T, over configurations (it may be taken away in some) and
        # bands, is nearest to the one asked for.
        moved = np.abs(np.expm1(predicted.features[rows][:, :, 0] - base[:, 0])).max((1, 2))
        nearest = int(np.argmin(np.abs(moved - change)))
        first, reached[a] = rows[nearest], float(moved[nearest])
        covariance = _covariance(predicted, discrepancy, variances, first)
        for label, mask in masks.items():
            for b in (NONE, *names):
                if a != b:
                    tables[label][a, b] = separation(predicted, covariance, mask.ravel(), first, b)
    measured = tuple(
        p
        for p in ("t20", "edt", "t30", "c80", "g")
        if any(p in c.measured.values for c in case.configurations)
    )
    with_more = {label: t for label, t in tables.items() if label}
    return Plan(measured, change, reached, tables[""], with_more)
