"""Find several effects at once, and say of each whether it is there at all."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rtcal.discrepancy.case import AppliedEffect, Case
from rtcal.discrepancy.coefficients import OffTogether
from rtcal.discrepancy.effects import Effect
from rtcal.discrepancy.engines import ControlRooms, Report, no_report
from rtcal.discrepancy.evidence import evaluate
from rtcal.discrepancy.features import Observed, observe
from rtcal.discrepancy.finding import Finding
from rtcal.discrepancy.hypotheses import predict_hypotheses
from rtcal.discrepancy.model_error import ModelDiscrepancy
from rtcal.discrepancy.prior import COEFFICIENTS, NONE
from rtcal.discrepancy.probabilities import family_of, narrowest_family
from rtcal.discrepancy.search import find
from rtcal.discrepancy.set_posterior import EXPECTED, MOST, Names, SetPosterior, set_posterior
from rtcal.discrepancy.sets import compare
from rtcal.discrepancy.size import Size
from rtcal.discrepancy.verdict import CLAIMED, Fit, doubts, fit
from rtcal.discrepancy.wording import amount, listed
from rtcal.errors import DataError
from rtcal.support import checks, text
from rtcal.support.arguments import checked
from rtcal.support.threads import single_threaded_blas

RIGHT = (41, 44)
"""Families claimed that were right, and families claimed, in judging rooms of the first hidden world:
50 with two effects, 16 with one, 9 with none (`python -m benchmarks.several_effects table`)."""
_SAID = 0.03
"""Probability below which an effect is not printed."""


@dataclass(frozen=True, eq=False)
class Member:
    """An effect of the most probable set.

    Attributes
    ----------
    alone, together : Fit
        Its parameters and size if it were the only one, and with the others in the model.
    stand_ins : tuple of str
        Effects that explain the data as well in its place.
    reasons : tuple of str
        Why it is not claimed, though its probability would allow it.
    """

    alone: Fit
    together: Fit
    stand_ins: tuple[str, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class SeveralFinding:
    """What the data say of several effects at once.

    Attributes
    ----------
    single : Finding
        The search for one effect; its threshold decides whether anything is missing.
    expected : float
        Expected number of effects, before anything was measured.
    verdict : {"none", "hint", "named", "ambiguous"}
        ``none`` and ``hint`` as the single search says. ``named``: at least one effect or family is
        there with a probability of 0.9, and passes every check. ``ambiguous``: something is missing,
        and nothing of it reaches 0.9.
    named : tuple of str
        The effects that are claimed.
    named_families : tuple of str
        The families that are claimed; those of ``named`` among them.
    probabilities : mapping of str to float
        Of each effect, "coefficients" and "unknown" that it is there at all, the most probable first.
        They do not sum to 1.
    families : mapping of str to float
        The same of each family.
    numbers : tuple of float
        Probabilities of 0, 1, 2, ... effects.
    sets : mapping of tuple of str to float
        Probabilities of the sets of effects, the most probable first; () is "none".
    members : mapping of str to Member
        The effects of the most probable set, in the order in which they act.
    likely : sequence of (tuple of AppliedEffect, float)
        The most probable sets with their parameters, and their probabilities, which sum to 1: what
        `plan` goes on from.
    """

    single: Finding
    expected: float
    verdict: str
    named: tuple[str, ...]
    named_families: tuple[str, ...]
    probabilities: Mapping[str, float]
    families: Mapping[str, float]
    numbers: tuple[float, ...]
    sets: Mapping[Names, float]
    members: Mapping[str, Member]
    likely: Sequence[tuple[tuple[AppliedEffect, ...], float]]

    @property
    def case(self) -> Case:
        """The case that was searched."""
        return self.single.case

    @property
    def discrepancy(self) -> ModelDiscrepancy:
        """Bias and covariance of the model's error."""
        return self.single.discrepancy

    @property
    def coefficients(self) -> OffTogether | None:
        """How the coefficients are off together, if that is likely beside the most probable set."""
        every = [m.together.coefficients for m in self.members.values()]
        return every[-1] if every else None

    @property
    def can_be_added(self) -> bool:
        """Whether `apply` has something to add."""
        return self.verdict in ("named", "ambiguous") and bool(self.members)

    @checked
    def apply(self, case: Case | None = None) -> Case:
        """Return the case with the most probable set of effects in its model.

        Each has its size with the others in the model. Where the coefficients are off together, the
        room's alpha is moved and its sigma widened. An effect that the case has already is left as it
        is.

        Raises
        ------
        DataError
            If the verdict is "none" or "hint".
        """
        case = self.case if case is None else case
        if not self.can_be_added:
            raise DataError(f'the verdict is "{self.verdict}"; there is no effect to add')
        if self.coefficients is not None:
            case = self.coefficients.apply(case)
        present = {a.name for a in case.applied}
        added = [
            _applied(self.single.effects[name], m.together)
            for name, m in self.members.items()
            if name not in present
        ]
        return replace(case, applied=(*case.applied, *added))

    @property
    def notes(self) -> tuple[str, ...]:
        """Data that were dropped, origins of the uncertainties, and reasons to doubt the result."""
        return self.single.notes

    @property
    def reason_for_none(self) -> str | None:
        """Why there is no effect to add, in words; None where there is one."""
        return None if self.can_be_added else self.single.reason_for_none

    @property
    def added(self) -> str:
        """What `apply` adds, in words."""
        titles = [
            f"{self.single.effects[n].title(m.together.parameters, self.case.room)} "
            f"({self.percent(n)})"
            for n, m in self.members.items()
        ]
        share = 100 * next(p for s, p in self.sets.items() if s == tuple(self.members))
        return f"Added {listed(titles)}, the most probable set ({share:.0f} %; verdict {self.verdict})."

    def percent(self, name: str) -> str:
        """The probability that an effect is there at all, in percent."""
        return f"{100 * self.probabilities.get(name, 0.0):.0f} %"

    @property
    def sentence(self) -> str:
        """What the verdict says of the model."""
        if self.verdict in ("none", "hint"):
            return self.single.sentence
        likely = listed([f"{n} ({self.percent(n)})" for n in self.members])
        if self.verdict == "ambiguous":
            return f"Something is missing; most probable is {likely}."
        families = [f for f in self.named_families if f not in self._families_of_named]
        claimed = [f"{n} ({self.percent(n)})" for n in self.named]
        claimed += [f"{f} ({100 * self.families[f]:.0f} %)" for f in families]
        return f"Missing from the model, or not as stated: {listed(claimed)}."

    @property
    def _families_of_named(self) -> set[str]:
        return {family_of(n, self.single.effects) for n in self.named}

    @property
    def numbers_in_words(self) -> str:
        """The probabilities of none, one and more effects."""
        return "number of effects: " + ", ".join(
            f"{n} {100 * p:.0f} %" for n, p in enumerate(self.numbers) if p >= 0.005
        )

    def in_words(self, name: str) -> list[str]:
        """One effect of the most probable set: probability, sizes, what stands for it, doubts."""
        m = self.members[name]
        effect = self.single.effects[name]
        title = effect.title(m.together.parameters, self.case.room)
        said = f"{title}: there with {self.percent(name)}"
        if m.together.size is None:
            said += f"; {effect.describe(m.together.parameters)}"
        else:
            said += f"; {_sized(m.together.size)}"
            if len(self.members) > 1 and m.alone.size is not None:
                said += f", without the others {_sized(m.alone.size)}"
        out = [said]
        if m.stand_ins:
            out.append(f"{name} may stand for {listed(m.stand_ins)}")
        return [*out, *m.reasons]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "expected": self.expected,
            "named": list(self.named),
            "named_families": list(self.named_families),
            "probabilities": dict(self.probabilities),
            "families": dict(self.families),
            "numbers": list(self.numbers),
            "sets": [{"effects": list(s), "probability": p} for s, p in self.sets.items()],
            "members": {
                name: {
                    "parameters": dict(m.together.parameters),
                    "size": _plain(m.together.size),
                    "size_without_others": _plain(m.alone.size),
                    "stand_ins": list(m.stand_ins),
                    "reasons": list(m.reasons),
                }
                for name, m in self.members.items()
            },
            "single": self.single.to_dict(),
        }

    def __repr__(self) -> str:
        """Return one line: verdict and the most probable set."""
        likely = text.shortened(", ".join(f"{n} {self.percent(n)}" for n in self.members))
        return f"<SeveralFinding {self.verdict}: {likely or 'no effect'}>"

    def __str__(self) -> str:
        """Return verdict, probabilities, numbers, sets, sizes and doubts."""
        lines = text.wrapped(f"{self.verdict}: {self.sentence}")
        likely = ", ".join(
            f"{n} {self.percent(n)}" for n, p in self.probabilities.items() if p >= _SAID
        )
        sets = ", ".join(
            f"{' + '.join(s) or NONE} {100 * p:.0f} %" for s, p in self.sets.items() if p >= _SAID
        )
        sentences = [self.numbers_in_words, f"there at all: {likely or 'nothing'}", f"sets: {sets}"]
        for name in self.members:
            sentences += self.in_words(name)
        if self.members and self.coefficients is not None:
            words = self.coefficients.words(self.case.room.centre_frequencies)
            sentences.append(f"the coefficients are off together: {words}")
        if self.verdict == "named":
            right, of = RIGHT
            sentences.append(f"families claimed like this were right in {right} of {of} test cases")
        sentences += [f"note: {n}" for n in self.notes]
        for sentence in sentences:
            lines += text.wrapped(sentence, indent="  ")
        return "\n".join(lines)


def _sized(size: Size) -> str:
    return f"{amount(size.mean, size.unit)} (90 %: {size.low:.3g} to {size.high:.3g})"


def _plain(size: Size | None) -> dict[str, Any] | None:
    if size is None:
        return None
    return {"mean": size.mean, "low": size.low, "high": size.high, "unit": size.unit}


def _applied(effect: Effect, fitted: Fit) -> AppliedEffect:
    """Return an effect with its size and interval, to be put into a case."""
    ends = None if fitted.size is None else (fitted.size.low, fitted.size.high)
    return AppliedEffect.of(effect, fitted.parameters, ends)


@single_threaded_blas()
@checked
def find_several(
    case: Case,
    effects: Sequence[Effect] | None = None,
    expected: float = EXPECTED,
    most: int = MOST,
    seed: int = 0,
    *,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    prior: Mapping[str, float] | None = None,
    engines: Sequence[str] = ("path tracing", "network"),
    controls: Sequence[ControlRooms] | None = None,
    cache: str | os.PathLike[str] | None = None,
    report: Report = no_report,
) -> SeveralFinding:
    """Find what the case's model lacks, where it may lack several effects at once.

    Parameters
    ----------
    case : Case
    effects : sequence of Effect, optional
        The effects to try; the whole library if not given.
    expected : float
        Expected number of effects: the mean of a Poisson distribution, above 0.
    most : int
        Largest number of effects in a set, from 1 to 3.
    seed : int
        Of the control rooms and of the bootstrap.
    without, only, prior, engines, controls, cache, report
        As `rtcal.discrepancy.find` takes them. Prior odds of "none" decide in the single search
        alone; ``expected`` takes their place for sets.

    Returns
    -------
    SeveralFinding

    Raises
    ------
    DataError
        If ``expected`` or ``most`` is out of its range, and as `rtcal.discrepancy.find` does.

    Examples
    --------
    >>> import rtcal as rt
    >>> case, truth = rt.datasets.hidden_room()
    >>> print(rt.discrepancy.find_several(case))  # doctest: +SKIP
    """
    expected = checks.positive("expected", expected)
    most = checks.whole("most", most, 1)
    if most > MOST:
        raise DataError(f"most = {most} is not from 1 to {MOST}")
    single = find(
        case,
        effects,
        seed=seed,
        without=without,
        only=only,
        prior=prior,
        engines=engines,
        controls=controls,
        cache=cache,
        report=report,
    )
    observed, _ = observe(case)
    predicted = predict_hypotheses(case, list(single.effects.values()))
    compared = compare(case, observed, predicted, single.discrepancy)
    posterior = set_posterior(compared, single.prior, expected=expected, most=most)
    probabilities = posterior.effects()
    families = posterior.families(predicted.effects)
    verdict, members = single.verdict, {}
    named: list[str] = []
    named_families: list[str] = []
    if single.score > single.threshold:
        members = _members(case, observed, single, posterior, predicted.parameters)
        named, named_families = _claims(members, probabilities, families, predicted.effects)
        verdict = "named" if named or named_families else "ambiguous"
    return SeveralFinding(
        single=single,
        expected=expected,
        verdict=verdict,
        named=tuple(named),
        named_families=tuple(named_families),
        probabilities=probabilities,
        families=families,
        numbers=posterior.numbers(),
        sets=posterior.sets,
        members=members,
        likely=[
            (
                tuple(
                    AppliedEffect.of(predicted.effects[predicted.names[i]], predicted.parameters[i])
                    for i in rows
                ),
                p,
            )
            for rows, p in posterior.likely
        ],
    )


def _members(
    case: Case,
    observed: Observed,
    single: Finding,
    posterior: SetPosterior,
    parameters: Sequence[Mapping[str, float]],
) -> dict[str, Member]:
    """Return the effects of the most probable set, each with its size alone and with the others."""
    best = posterior.best
    rows = posterior.rows[best]
    stand_ins = posterior.stand_ins()
    model = {
        name: AppliedEffect.of(single.effects[name], parameters[i])
        for name, i in zip(best, rows, strict=True)
    }
    alone = {name: _fitted(case, observed, single, name)[0] for name in best}
    together: dict[str, Fit] = {}
    reasons: dict[str, tuple[str, ...]] = {}
    # The others' sizes enter each fit, so the first is fitted again.
    for name in (*best, best[0]) if len(best) > 1 else best:
        others = [model[n] for n in best if n != name]
        together[name], reasons[name] = _fitted(
            replace(case, applied=(*case.applied, *others)), observed, single, name
        )
        model[name] = _applied(single.effects[name], together[name])
    return {n: Member(alone[n], together[n], stand_ins[n], reasons[n]) for n in best}


def _fitted(
    case: Case, observed: Observed, single: Finding, name: str
) -> tuple[Fit, tuple[str, ...]]:
    """Return one effect's fit in a case whose model has the others, and the doubts about it."""
    predicted = predict_hypotheses(case, [single.effects[name]])
    evidence = evaluate(observed, predicted, single.discrepancy, single.prior.off)
    table = evidence.by_effect()
    nats = float(table[name] - table[NONE])
    fitted = fit(case, observed, predicted, single.discrepancy, evidence, name, precise=True)
    return fitted, doubts(case, observed, predicted, single.discrepancy, evidence, fitted, nats)


def _claims(
    members: Mapping[str, Member],
    probabilities: Mapping[str, float],
    families: Mapping[str, float],
    effects: Mapping[str, Effect],
) -> tuple[list[str], list[str]]:
    """Return the effects and the families that are probable enough and pass every check."""
    sound = [n for n, m in members.items() if not m.reasons]
    named = [n for n in sound if probabilities[n] >= CLAIMED and effects[n].alone]
    if probabilities.get(COEFFICIENTS, 0.0) >= CLAIMED:
        named.append(COEFFICIENTS)
    claimed = []
    for name in sound:
        family = family_of(name, effects)
        wide = family.split(",")[0]
        narrow = narrowest_family({f: families[f] for f in (family, wide)}, CLAIMED)
        if narrow is not None and narrow not in claimed:
            claimed.append(narrow)
    return named, claimed
