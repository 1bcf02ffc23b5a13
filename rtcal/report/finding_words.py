"""The words of a finding: a sentence for each code, and the blocks of text, page and notebook.

Answer, cautions, evidence, notes: in this order for every kind of data. Evidence is printed as odds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from string import Formatter
from typing import TYPE_CHECKING, Any

import numpy as np

from rtcal.acoustics import bands, marks
from rtcal.acoustics.comparison import Comparison
from rtcal.acoustics.measurement import Measurement
from rtcal.acoustics.observables import LEVEL, parameter_label
from rtcal.acoustics.priors import NORMAL_90
from rtcal.acoustics.room import Room
from rtcal.finder.claim import (
    CLAIMED,
    DISTINCT_NATS,
    EQUATION_OFF,
    LEADING,
    MISTAKE,
    MOST,
    OWN_FIELD,
    SAID,
    Candidate,
    Reason,
    Size,
    amount,
    family_of,
    over_frequency,
)
from rtcal.finder.effects import IN_RUN, checked_effects
from rtcal.finder.evidence import COEFFICIENTS, NONE, UNKNOWN
from rtcal.finder.finding import Finding, feature_names
from rtcal.finder.means.planning import COSTS, Plan
from rtcal.finder.means.recalibration import Recalibrated
from rtcal.finder.records import (
    ALL,
    RUN,
    WITH_LEVEL,
    WITHOUT_LEVEL,
    Share,
    data_of,
    record_of,
    statement_of,
    stored,
)
from rtcal.finder.states import ADDED, REMOVED
from rtcal.finder.verification import Verification
from rtcal.io.tables import unusual
from rtcal.loop.measured_pairs import without_place
from rtcal.support.blocks import Block, Note, Row, Table
from rtcal.support.text import as_sentence, first_of, listed, with_uncertainty
from rtcal.support.types import Array

if TYPE_CHECKING:
    from rtcal.finder.positions.places import Place

MOST_ODDS = 1e6
"""Largest odds that are printed as a number: no model is known so well."""
BY_SEED = 0.5
"""Standard deviation of the score in nats at positions by random numbers, in a development room in
which something is detected (room 0.7 of benchmarks/studies/geometric_world, four seeds)."""
_NOTHING = 0.1  # probability that nothing is missing from which the answer states it
_NEAR = 0.5  # probability over the first candidate's from which another one fits nearly as well
_STRONG = 4.0  # deviation in standard deviations at which the ground of a number saturates
_SIZED = 0.25  # probability over the first candidate's from which a text gives a candidate's size
_SEVERAL = (
    2  # configurations from which on a text has one table of what deviates much, not one of each
)
_INTERVAL = (
    "90 % interval"  # interval of a size in print, which a table's heading states for all sizes
)
_DEVIATION = "Deviation (model minus measurement) in standard deviations of this difference"
_FEW = 3  # most effects or sources that a sentence lists
NAMES = {
    "porous": "porous absorber",
    "resonator": "Helmholtz resonator",
    "membrane": "panel absorber",
    "formula": "reverberation equation",
    "position": "another position",
    "noise": "a noisy value",
    NONE: "nothing missing",
    COEFFICIENTS: "common error of the coefficients",
    UNKNOWN: "effect not in the library",
}
"""Names in print, where they are others than those of the options."""

SENTENCES: dict[str, str] = {
    # Why something is not identified, or not by its name.
    "nothing likely": "That nothing is missing has a probability of {probability:p}, so nothing is "
    "identified.",
    "no effect likely": "No effect and no group of effects has a probability of {least:p}, so nothing "
    "is identified.",
    LEADING: "T is {factor:.2g} times the model's: look for a mistake in volume, "
    "areas, coefficients and units first.",
    MISTAKE: "T is {factor:.2g} times the model's: look for a mistake in volume, areas, "
    "coefficients and units before you believe any effect.",
    "not explained": "{effect:name} fits best of all effects and does not explain the measurement: "
    "with it, the differences are {times:.1f} times as large as all uncertainties allow. Check volume, "
    "areas, coefficients, units and bands.",
    "gap grows": "With {effect:name} in the model, the deviation that coefficients cannot remove grows "
    "from {before:.2f} to {after:.2f} JND.",
    "gap may grow": "With {effect:name} in the model, the deviation that coefficients cannot remove "
    "may grow from {before:.2f} to {after:.2f} JND (by more than {little:g} JND with a probability of "
    "{probability:p}).",
    "contradicted": "Decay shape, level and the other configurations speak against {effect:name} "
    "(odds of {nats:odds}).",
    "size unbounded": "The measurement does not bound the size of {effect:name}: {size}; any {other} "
    "size fits as well.",
    "too large": "{effect:name} would take {share:p} of all surfaces; a size above {most:p} is not "
    "plausible.",
    "below Schroeder": "The odds for {effect:name} rest on the data at {bands:and}, below the "
    "Schroeder frequency, where the sound field is not diffuse. By all data they are {nats:odds}; "
    "without the data at {bands:and}, they are {without:odds}.",
    "directivity unknown": "The surface is not identified, because the directivity of a source is "
    "unknown: where a source aims looks like absorption on the other surfaces.",
    "second room anywhere": "The surface is not identified, because a second room has the same effect "
    "at all positions. A room that scatters less than assumed has the same decays: repeat the search "
    "with a lower --scattering.",
    "one file": "Before and after have the same T at every pair: check that they are not the same "
    "file.",
    "not the climate alone": "Another climate of the air is the most probable single change, but it "
    "does not fully explain T (p = {chance:.2g} by chi-square over the bands).",
    "not as asked": "There is a difference, and {effects:unexplained} ({probability:p}); only a "
    "spectrum that none of the chosen effects has can explain the difference.",
    "gains differ": "The level of {gains:gains} changes differently from T, so the gain of the source "
    "was not the same before and after; its level is left out. Measure both configurations with the "
    "same reference.",
    OWN_FIELD: "Nothing is identified in the room, because the difference may come from the program "
    "itself ({probability:p}), which may scatter differently or lack a second room, or from "
    "something that no effect describes.",
    # What to do next.
    "another source": "Look for another source of the coefficients, first for the material with the "
    "largest product of area and uncertainty; or measure with and without a known absorber.",
    "measure again": "Find in the deviations the band and the parameter that disagree, and measure "
    "them again.",
    "nothing to distinguish": "These data leave nothing to distinguish, which does not confirm the "
    "model.",
    "look it up": "Confirm {effect:name}: {effect:check}.",
    "measure without": "Confirm {effect:name}: measure once without it.",
    "confirmed": "{effect:name} was already measured with and without it; nothing else could confirm "
    "it.",
    "with and without": "Measure with and without {effect:name}: if it is the cause, T changes, and "
    "the uncertainty of the coefficients cancels in the difference.",
    "measure further": "Measure {what}: {effect:name} and {rival:name} would then be distinguished "
    "with odds of {nats:odds} instead of {now:odds}.",
    "each taken out": "Look in the room for what may be missing from the model: {effect:name} or "
    "{rival:name}. Measure once without each that you find (removed, closed or covered): the "
    "uncertainty of the coefficients cancels in the difference to the first measurement.",
    "look at the room": "Find out in the room, or from its documents, whether {effect:name} or "
    "{rival:name} is the cause. Both predict nearly the same values of every parameter, so measuring "
    "a further parameter would not distinguish them.",
    # Why nothing is added to the model, or not without a choice.
    "nothing to add": "Nothing to add: nothing is identified as missing.",
    "too weak to add": "Nothing to add: nothing was detected. {best:name} is only a weak indication "
    "(verdict hint). Measure more and search again: `rtcal plan` proposes what. If you know that it is "
    "in the room, choose it by its name (`rtcal apply --effect NAME`).",
    "none of the library": "Nothing to add: no effect of the library explains what is missing "
    "(verdict unknown).",
    "no surface": "Nothing to add: the effect that was found is not on a surface.",
    "second room": "{best:name}: {why}",
    "no change to add": "Nothing to add: no change was identified.",
    "climate changed": "Nothing to add: the climate of the air changed. Enter temperature and humidity "
    "in the room's file.",
    "effect undecided": "No effect is chosen, and the most probable one has a probability of less than "
    "{least:p}. Candidates: {candidates:options}. Choose one: effect = NAME.",
    "place undecided": "Neither an effect nor a place is chosen, and the most probable group on one "
    "surface has a probability of less than {least:p}. Candidates: {candidates:options}. Choose one: "
    "effect = NAME, or its place: at = X,Y,Z.",
    "volume undecided": "effect = volume has a probability of {probability:p}, but rtcal changes the "
    "room's volume only from {least:p} upwards. Measure the volume and enter it in the room's file, "
    "or choose another effect: {others:or}.",
    "volume alone undecided": "effect = volume has a probability of {probability:p}, but rtcal "
    "changes the room's volume only from {least:p} upwards. Measure the volume and enter it in the "
    "room's file.",
    "support": "{best:spelt out}, which these data do not distinguish from {others:likeliest}",
    "sole": "{best:spelt out}",
    "not predicted": "considering their uncertainty, these data give odds of {nats:odds} for it, less "
    "than the {least:odds} required",
    # What to know of the data and of the search.
    "chosen": "Effects were left out or weighted by hand, so the probabilities are relative to the "
    "effects that were tried. How often such findings are right was measured only with the "
    "whole library.",
    "T uncertain": '{band} of "{configuration}" is left out: the uncertainty of T is {u:.0f} %',
    "no T": '{band} of "{configuration}" is left out: it has neither T20 nor T30',
    "uncertainties": "The uncertainty of {origins:origins}.",
    "level off": '{parameter} of "{configuration}" is {by:.1f} dB {side} what T and the room give, by '
    "the same amount in all bands. Either its calibration or the room is off. If its reference is "
    'uncertain, name it "level".',
    "Schroeder": 'At {bands:and}, below the Schroeder frequency of "{configuration}" ({limit:.0f} Hz), '
    "the sound field is not diffuse.",
    "not used": "A search by means over positions uses {known:and}, and not {parameters:and} of "
    '"{configuration}".',
    "curved": 'The decay of "{configuration}" is curved at {bands:and} (ISO 3382-2, Annex B: at most '
    "{most:.0f} %).",
    "run lacks": "{said}",
    EQUATION_OFF: "{equation}'s T is {by:range} {side} than the program's {bands:where}.",
    "no air": "The room has no air, so the model's air absorbs nothing.",
    "means alone": "Means over positions identify {effect:name} ({probability:p}), which the "
    "differences between positions do not confirm.",
    "not tried": "Effects that are not on a surface were not tried ({effects:and}): a search by means "
    "over positions tries them.",
    "gains": "G agrees better with the room if its calibration may be off, by the same amount in all "
    "bands or band by band (odds of {nats:odds}), and is weighted accordingly. If its "
    'reference is uncertain, name it "level".',
    "lobes": "Directional sources explain the measurement better than anything that may be missing "
    "from the room (odds of {nats:odds}), so the sources are not taken as omnidirectional. "
    "Enter their [directivity]; an omnidirectional source has the index 0.",
    "lobes possible": "Directional sources may explain the measurement better than anything that may "
    "be missing from the room (odds of {nats:odds}), and are weighted by their probability. Enter "
    "their [directivity]; an omnidirectional source has the index 0.",
    "index off": "Other directivities explain the measurement better than anything that may be missing "
    "from the room (odds of {nats:odds}), so the directivity index of {sources:few} is not "
    "relied on. Enter measured balloons to use all parameters.",
    "nothing explains the level": "None of the effects explains the level and the early parameters, "
    "so the directivity index of {sources:few} is not relied on. Enter measured balloons to use all "
    "parameters.",
    "no geometry": "T alone does not show on which surface something changed.",
    # What could be measured next.
    "EDT and T30": "EDT and T30",
    "C80": "C80",
    "G": "G, with a calibrated source",
    "more positions": "{positions} more positions",
    "another climate": "air of {temperature:.0f} °C, {humidity:.0f} % humidity",
    "covered": '{thickness:.0f} mm mineral wool on "{material}"',
    "removed": "an emptied room, openings closed",
    "planned": 'configuration "{configuration}"',
    "no directivity": "The directivity of {sources:few} is not given, so no surface is identified. "
    "Give every source a directivity, with index = 0 for an omnidirectional one.",
    # What a corrected room does not hold, and what was assumed for it.
    "decay not in a room": "{effect:name}: a room's file has surfaces and air only.",
    "air of no climate": "{effect:name}: no temperature and humidity give the air attenuation that "
    "was found (ISO 9613-1).",
    "absorbs too much": "{effect:name}: a further material would need more than the whole surface to "
    "absorb so much.",
    "hides wall": "{effect:name}: it would cover a surface that absorbs more than the effect does at "
    "{bands:and}. The room keeps the absorption of this surface.",
    "takes absorption": "{effect:name}: it removes absorption from an unknown surface.",
    "equation": "The equation, because a room's file does not name one. Calibrate the room with "
    "{equation}.",
    "speed of sound": "The speed of sound: the model has {model:.1f} m/s, and the room, by its air, "
    "{room:.1f} m/s, so that its T differs by {by:+.1f} %.",
    "no place": "The {lost:and}: they do not have the areas or the volume that were found.",
    "volume changed": "The input volume: it was {before:.4g} m³ and is now {now:.4g} m³.",
    "area changed": 'The input area of "{material}": it was {before:.4g} m² and is now {now:.4g} m².',
    "number changed": 'The input number of "{material}": it was {before:.4g} and is now {now:.4g}.',
    "patch too large": 'A patch of {patch:.3g} m² does not fit on "{surface}" of {area:.3g} m²: the '
    "whole surface gets the new material.",
    "patch drawn larger": "The patch has {drawn:.2f} m² in the mesh instead of the {size:.3g} m² that "
    "were found, and lower coefficients, so that a calibration can make it absorb more or less.",
    "bands unknown": "T was not measured in both configurations at {bands:and}, so the room keeps the "
    "coefficients of the first configuration there.",
    "surface unknown": "It is unknown on which surface something changed, so the change is "
    "distributed over all materials.",
    "change does not fit": "At {band} the surfaces that changed cannot hold {rest:.1f} m² of the "
    "change of {change:+.1f} m².",
    "T before out of reach": "At {band} no coefficients of the room give T before: its absorption area "
    "is off by {off:+.1f} m².",
    "kind unknown": "It is unknown what was changed ({kinds:or}), so the room contains only the "
    "change of its absorption.",
    # Why a verification does not support a finding.
    "gains little": "only a decrease by more than {least:.2f} JND would support the correction",
    "misses": "the corrected model does not reproduce the values that it was matched to",
    "little left": "a calibration without the effect leaves only {before:.2f} JND there, so a second "
    "run cannot reduce it by the {least:.2f} JND that are required",
    "halves differ": "the halves of the pairs found something else than all pairs did",
    "still missed": "with it, the model still deviates from these data by {gap:.2f} JND on average",
    "grows": "the deviation of {quantity} grows from {before:.2f} to {after:.2f} JND",
    "nothing claimed": "no effect and no group of effects is identified",
}
"""The sentence of each code of a `rtcal.finder.claim.Reason`; `_Forms` has the forms of its values."""


_CHECK = "look it up in the documents of the room, or measure it directly"
CHECKS = {
    "area": "compare the areas with the drawings, or measure them in the room",
    "number": "count the pieces in the room",
    "volume": "compare the volume with the drawings, or measure it in the room",
    "formula": "simulate the room with a geometrical program, which needs no equation, and search with "
    "its result (rtcal find --simulated)",
    "noise floor": "look at the decays of the impulse responses. If they end in noise, evaluate them "
    "again with the noise subtracted (rtcal measure subtracts it)",
    "direct sound": "look up the directivity of the source, or turn the source and measure again",
    "air": "look up the temperature and the humidity during the measurement",
    "non-diffuse field": "simulate the room with a geometrical program, which includes such a field, "
    "and search with its result (rtcal find --simulated)",
}
"""How an effect is confirmed that cannot be taken out of the room; `_CHECK` for any other."""


_CLAUSES = (
    *("support", "sole", "not predicted", "gains little", "misses", "halves differ"),
    "little left",
    *("still missed", "grows", "nothing claimed"),
    *COSTS,
)
"""Codes whose words stand within another sentence."""


_ORIGINS = {
    "stated": "as given",
    "made": "estimated from scatter over pairs, theory and reproducibility, because none is given",
}
"""Where uncertainties come from."""


class _Forms(Formatter):
    """The forms of values in `SENTENCES`: probabilities, odds, effects, sizes and lists."""

    def format_field(self, value: Any, form: str) -> str:
        if form == "p":
            return percent(value)
        if form == "odds":
            return odds(value)
        if form == "name":
            return called(value) if isinstance(value, str) else named(value)
        if form in ("few", "and", "or"):
            names = [called(v) if isinstance(v, str) else likeliness(v) for v in value]
            return first_of(names, _FEW) if form == "few" else listed(names, last=form)
        if form == "spelt out":
            return f"{named(value)} (probability {percent(value.probability)})"
        if form == "likeliest":
            return first_of([likeliness(v) for v in value], _FEW)
        if form == "check":
            return CHECKS.get(value, _CHECK)
        if form == "options":  # with the names that an option takes
            some = [(v.title, v.probability) if isinstance(v, Candidate) else v for v in value]
            return listed([f"{name} ({percent(p)})" for name, p in some], last="or")
        if form == "origins":
            every = [(names, _ORIGINS[k]) for k, names in value.items() if names]
            return "; that of ".join(f"{listed(names)} is {origin}" for names, origin in every)
        if form == "unexplained":
            return unexplained(value)
        if form == "where":
            return bands.where(*value)
        if form == "range":
            low, high = f"{min(value):.0f}", f"{max(value):.0f}"
            return f"{low} %" if low == high else f"{low} to {high} %"
        if form == "gains":
            return first_of([f"{source} (by {g:+z.1f} dB)" for source, g in value.items()], _FEW)
        if isinstance(value, Size):
            return value.words
        if isinstance(value, Candidate):
            return likeliness(value)
        return str(super().format_field(value, form))


def sentence(reason: Reason) -> str:
    """Return the sentence of a reason."""
    words = _Forms().vformat(SENTENCES[reason.code], (), reason.values)
    return words if reason.code in _CLAUSES else words[:1].upper() + words[1:]


def odds(nats: float) -> str:
    """Return a ln Bayes factor ``nats`` as odds with two digits.

    Examples
    --------
    >>> odds(2.3026), odds(-4.0), odds(0.0), odds(40.0)
    ('10 to 1', '1 to 55', 'even', 'over a million to 1')
    """
    factor = float(np.exp(min(abs(nats), 50.0)))
    digits = max(0, int(np.floor(np.log10(factor))) - 1)
    times = f"{round(factor / 10**digits) * 10**digits:,}" if factor >= 3 else f"{factor:.2g}"
    times = "over a million" if factor > MOST_ODDS else times
    if times == "1":
        return "even"
    return f"{times} to 1" if nats > 0 else f"1 to {times}"


def percent(probability: float) -> str:
    """Return a probability in percent; a probability near 0 or 1 is not rounded to 0 or 100 %.

    >>> percent(0.334), percent(0.9996), percent(1e-4), percent(0.0)
    ('33 %', 'over 99 %', 'under 1 %', '0 %')
    """
    if 0 < probability < 0.005 or probability >= 0.995:
        return "under 1 %" if probability < 0.5 else "over 99 %"
    return f"{100 * probability:.0f} %"


def called(effect: str) -> str:
    """Return the printed name of an effect.

    >>> called("porous"), called("noise floor"), called("added porous")
    ('porous absorber', 'noise floor', 'added porous absorber')
    """
    side, _, kind = effect.partition(" ")
    if side in (ADDED, REMOVED) and kind:
        return f"{side} {'unknown absorber' if kind == UNKNOWN else NAMES.get(kind, kind)}"
    return NAMES.get(effect, effect)


def named(c: Candidate) -> str:
    """Return the printed name of a candidate's effect, with its place.

    >>> named(Candidate(effect="membrane", family="", probability=0.5, surface="west"))
    'panel absorber on "west"'
    """
    return f"{called(c.shown_as)} {c.where}".rstrip()


def likely(name: str, probability: float) -> str:
    """Return a name with its probability."""
    return f"{called(name)} ({percent(probability)})"


def likeliness(c: Candidate) -> str:
    """Return the name of a candidate with its probability."""
    return likely(named(c), c.probability)


def choice(some: Sequence[tuple[str, float]], lead: str = "most likely") -> str:
    """Return candidates with their probabilities in words.

    ``some`` are names and probabilities, the most probable first. ``lead`` begins the text.

    >>> choice([("furniture", 0.45), ("opening", 0.39)])
    'most likely furniture (probability 45 %), but opening (39 %) fits nearly as well'
    """
    first, *others = some
    near = [likely(*one) for one in others if one[1] >= _NEAR * first[1]]
    far = [likely(*one) for one in others if one[1] < _NEAR * first[1]]
    said = f"{lead} {called(first[0])} (probability {percent(first[1])})"
    said += f", but {listed(near)} fit{'s' * (len(near) == 1)} nearly as well" if near else ""
    if far:
        said += f"; less likely {'are' if far[1:] else 'is'} {listed(far)}"
    return said


def unexplained(names: Sequence[str]) -> str:
    """Return in words that the effects with these names do not explain the measurement.

    >>> unexplained(["air"]), unexplained(["opening", "porous", "curtain", "people"])
    ('air does not explain the data', 'none of the effects that were tried explains the data')
    """
    if len(names) > _FEW:
        return "none of the effects that were tried explains the data"
    some = listed([called(name) for name in names])
    return f"{some} {'does' if len(names) == 1 else 'do'} not explain the data"


# The answer.


def headline(f: Finding) -> list[str]:
    """Return the answer in sentences, the first alone is enough; a doubt about T leads it."""
    answer, *more = _ANSWERS[f.kind](f)
    if f.leading is not None and f.verdict != "none":
        answer = f"{f.leading} If there is no such mistake: {answer}"
    known = f.verdict == "none" or (f.verdict == "hint" and _nothing_likelier(f))
    if not known and f.probabilities.get(NONE, 0.0) >= _NOTHING:
        what = "changed" if f.kind == "states" else "is missing"
        more.append(f"The probability that nothing {what} is {percent(f.probabilities[NONE])}.")
    return [answer, *more]


def title(f: Finding) -> str:
    """Return the best effect, or the most probable set, as a sentence names it."""
    return listed([name_of(f, n) for n in f.members or (str(f.best_effect),)])


def name_of(f: Finding, effect: str) -> str:
    """Return the name in print of an effect, with the place of its candidate."""
    found = f.candidate(effect)
    return called(effect) if found is None else named(found)


def absorbs(change: Array, end: str = "") -> str:
    """Return in words how much more or less the room absorbs than the model.

    ``change`` (3, n_bands) is the relative change of the absorption area: its mean, and both ends of
    its 90 % interval. ``end`` is "least" or "most" if only one end is known (`Size`), else "".

    >>> absorbs(np.array([[0.2, 0.6], [0.1, 0.3], [0.3, 0.9]]))
    'The room absorbs 40 % more than the model (90 % interval 20 to 60 %), rising with frequency'
    """
    mean, *ends = 100 * np.abs(change.mean(1))
    more = "more" if change[0].mean() > 0 else "less"
    if end:
        bound = min(ends) if end == "least" else max(ends)
        said = f"at {end} {bound:.0f} % {more} than the model"
    else:
        said = f"{mean:.0f} % {more} than the model "
        said += f"(90 % interval {min(ends):.0f} to {max(ends):.0f} %)"
    return f"The room absorbs {said}, {over_frequency(change[0])}"


def _of_means(f: Finding) -> list[str]:
    if len(f.members) > 1 or (f.named and f.named != f.members):
        return _of_several(f)
    if f.verdict == "none":
        return _nothing_missing(f)
    best = f"{title(f)} ({percent(f.probabilities.get(str(f.best_effect), 0.0))})"
    if f.verdict == "hint":
        return [str(reason) for reason in f.reasons if _leads(f, reason)] or [_weak(f)]
    if f.verdict == UNKNOWN:
        library = {effect.name for effect in checked_effects(None)}
        whole = library <= {*f.effects, *f.not_judged}
        which = (
            "no effect of the library explains the data" if whole else unexplained(tuple(f.effects))
        )
        return [f"Something is missing from the model: {which}."]
    subject = _contradiction(f)
    if f.verdict != "ambiguous" and f.best is not None and f.best.absorption is not None:
        subject = absorbs(f.best.absorption, f.best.end)
    some = [(named(c), f.probabilities.get(c.effect, 0.0)) for c in f.candidates]
    if f.verdict == "ambiguous":
        return [f"{subject}, but the data do not show what. {_cause(some)}"]
    if f.verdict == "family":
        return [f"{subject}. {_cause(some)}", _group(f)]
    if f.best_effect == COEFFICIENTS:
        return [
            f"The input coefficients have a common error ({percent(f.probabilities[COEFFICIENTS])})."
        ]
    return [f"{subject}: {best}."]


def _cause(some: Sequence[tuple[str, float]]) -> str:
    """Return a sentence on the most probable cause and the others that are likely."""
    return f"The cause is {choice(some)}."


def _group(f: Finding) -> str:
    """Return the group of effects that is identified, where no effect is."""
    group = f'"{f.family}" ({percent(f.families.get(str(f.family), 0.0))})'
    return f"The data identify the group of effects {group}, but not which effect of it."


def _weak(f: Finding) -> str:
    """Return the answer of a hint: the most probable candidate, after what is likelier than it."""
    best = likely(*next(one for one in f.probabilities.items() if one[0] != NONE))
    if not _nothing_likelier(f):
        return f"Nothing is identified; {best} is only a weak indication."
    return (
        "Nothing is identified: the most probable explanation is that nothing is missing "
        f"({percent(f.probabilities[NONE])}), and the most probable effect is {best}."
    )


def _leads(f: Finding, reason: Reason) -> bool:
    """Return whether a reason is the answer: the program's error, if no less likely than nothing."""
    return reason.code == OWN_FIELD and reason.values["probability"] >= f.probabilities[NONE]


def without_measuring(f: Finding) -> str:
    """Return the next step of a finding that needs no measurement, such as calibration; "" for none."""
    if any(reason.code == OWN_FIELD for reason in f.reasons):
        return (
            "Simulate with half and with twice the scattering coefficients and search with each run, "
            "which shows what is missing whatever the program scatters. Draw a second room if there is "
            "one."
        )
    if f.verdict != NONE or not f.differs:
        return ""
    if f.kind != "states" and f.case.has_run:
        return "Calibrate your program (`rtcal loop start` with the same --simulated)."
    command = "fit" if f.kind == "positions" else "calibrate"
    return f"Calibrate the room (`rtcal {command}`)."


USE = {
    "supported": "Use the corrected model for T and level, not the calibration without the effect. Do "
    "not quote its coefficients before the effect is confirmed.",
    "not tested": "Measure C80 or G, or a second configuration, before you use the corrected model, "
    "because the finding was fitted to all that was measured.",
    "unproven": "Confirm the effect before the corrected model is used: measure with it and without "
    "it, or look at the room, because these measurements neither confirm it nor rule it out.",
    "withdrawn": "Use neither calibration: with the effect in the model the measurements fit worse.",
}
"""What may be done with the corrected model, by verification."""


def next_step(f: Finding, verification: Verification | None = None) -> str:
    """Return the next step, a measurement or not, in a sentence; "" where nothing is left to do."""
    if step := without_measuring(f):
        return step
    if f.advice is not None:
        return str(f.advice)
    if f.kind != "positions" or f.verdict == NONE or f.best is None:
        return ""
    if f.verdict == "hint":
        if f.case.has_run:
            return (
                "Search again without the run, or with tables of means over positions, where --program "
                "names the kind of program."
            )
        return "Measure at one more receiver: `rtcal plan` proposes where."
    if verification is not None and not (verification.misses or verification.verdict == "unproven"):
        return USE[verification.verdict]
    if f.likely_surfaces and f.surface is None:
        names = listed([f'"{name}"' for name in f.likely_surfaces])
        return (
            f"Look for the effect on {names}. If you do not find it there, measure at one more "
            "receiver: `rtcal plan` proposes where."
        )
    what = f.likeliest or f.best
    return (
        f"Look in the room for {named(what)}. If it can be removed, measure once with it and once "
        "without it."
    )


def first_step(f: Finding, verification: Verification | None = None) -> str:
    """Return the next step, after the check of what a caution calls a likely typing error."""
    step, checked = next_step(f, verification), listed([*dict.fromkeys(_mistyped(f))])
    if not step or not checked:
        return step
    return f"First check {checked}. If nothing is mistyped, {step[:1].lower()}{step[1:]}"


def _mistyped(f: Finding) -> list[str]:
    """Return the input that may be mistyped, as the cautions name it."""
    room = f.case.room
    doubts = [
        doubt
        for measured in _measured(f)
        for doubt in marks.of_input(
            room, measured.in_bands(room.centre_frequencies).reverberation_time
        )
    ]
    return [doubt.checked for doubt in doubts if doubt.is_error]


def _nothing_likelier(f: Finding) -> bool:
    """Return whether nothing missing or changed is more probable than any candidate."""
    return f.kind != "states" and next(iter(f.probabilities)) == NONE


def _nothing_missing(f: Finding) -> list[str]:
    """Return that nothing is missing, and whether model or run agree with the measurement."""
    program, at_pairs = f.case.has_run, f.kind == "positions"
    off = [str(n) for n in f.notes if isinstance(n, Reason) and n.code == EQUATION_OFF][:1]
    who = "program" if program else "model"
    if f.differs:
        _, most = max(map(_largest, f.comparisons))
        open_ = (
            "scattering" if at_pairs else f"the error of the {'program' if program else 'equation'}"
        )
        return [
            f"Nothing is identified as missing, but the {who} differs from the measurement, most in "
            f"{most}.",
            "The uncertainty of the coefficients, together with "
            f"{open_}, can explain this difference.",
            *off,
        ]
    return [
        *off,
        f"The {who} agrees with the measurement{' in the mean over the pairs' * at_pairs}: "
        f"{'at every pair ' * at_pairs}within the uncertainty of input values, measurement and "
        f"{'simulator' if at_pairs else who}, nothing is found to be missing from the "
        f"{'room' if program else 'model'}.",
    ]


def _of_several(f: Finding) -> list[str]:
    """Return the claims about effects, families and sets of families; what is likely without one."""
    some = [likely(n, f.probabilities[n]) for n in f.members]
    if f.verdict == "ambiguous":
        said = [f"Something is missing from the model; most likely {listed(some)}."]
        if f.probabilities.get(UNKNOWN, 0.0) > max(f.probabilities[n] for n in f.members):
            beyond = percent(f.probabilities[UNKNOWN])
            said.append(f"Something is missing that no effect of the library explains ({beyond}).")
        return said
    of_named = {family_of(n, f.effects) for n in f.named}
    identified = [likely(n, f.probabilities[n]) for n in f.named]
    identified += [likely(n, f.families[n]) for n in f.named_families if n not in of_named]
    said = [f"{_contradiction(f)}: {listed(identified)}."] if identified else []
    if f.named_set:
        several, together = percent(sum(f.numbers[2:])), percent(f.family_sets[f.named_set])
        said.append(
            f"More than one effect is missing ({several}); most likely together: "
            f"{listed(f.named_set)} ({together})."
        )
    return said


def _contradiction(f: Finding) -> str:
    """Return whether the candidates contradict an input value, or add to the model, or either."""
    contradicting = {
        name == COEFFICIENTS or (name in f.effects and f.effects[name].contradicts(f.case.room))
        for name in f.names
    }
    if len(contradicting) > 1:
        return "Something is missing from the model, or an input value is off"
    off = contradicting == {True}
    return "An input value of the model is off" if off else "Something is missing from the model"


def _largest(c: Comparison) -> tuple[float, str]:
    """Return the largest deviation that is noticed, in JND, and its words; 0 where all agrees."""
    each = {p: np.where(c.disagrees[p], off, 0.0) for p, off in c.deviation.items()}
    p = max(each, key=lambda p: np.abs(each[p]).max())
    k = int(np.argmax(np.abs(each[p])))
    at = bands.label(c.run.room.centre_frequencies[k])
    return abs(each[p][k]), f"{parameter_label(p)} at {at} by {each[p][k]:+.1f} JND"


def _at_positions(f: Finding) -> list[str]:
    if f.best is None:
        return _nothing_missing(f)
    if f.verdict == "hint":
        return [_weak(f)]
    known = [c for c in f.candidates if c.effect != UNKNOWN]
    if f.verdict == UNKNOWN:
        said = ["Something differs from the model that no effect of the library explains."]
        if f.likeliest is not None:
            alike = sum(c.probability for c in known if c.kind == f.likeliest.kind)
            share = percent(alike / sum(c.probability for c in known))
            place = _place(f)
            said.append(
                f"Of the effects in the library, {f.likeliest.kind} explains most ({share} of the "
                f"rest){place}."
            )
        return said
    kind = known[0].kind if known else ""
    if kind == COEFFICIENTS and np.isfinite(known[0].size):
        kind = f"{'less' if known[0].size < 1 else 'added'} absorption"
    subject = {
        "added absorption": "The room absorbs more than the model",
        "less absorption": "The room absorbs less than the model",
    }.get(kind, "The room or the measurement differs from the model")
    said = [f"{subject}{_place(f)}."]
    effects = dict.fromkeys(c.effect for c in f.candidates if c.probability >= SAID)
    if f.verdict == "family":
        said.append(_group(f))
    elif f.verdict == "named":
        effect = likely(str(f.effect), f.probabilities[str(f.effect)])
        said.append(f"The effect is identified: {effect}.")
    elif effects:
        some = choice([one for one in f.probabilities.items() if one[0] in effects])
        said.append(f"The effect is not identified: it is {some}.")
    if f.unexplained >= MOST:
        said.append(
            "This does not explain everything that was measured: something else also differs "
            f"from the model ({percent(f.unexplained)})."
        )
    return said


def _place(f: Finding) -> str:
    """Return where something differs, as far as the positions show it, as the end of a sentence."""
    best = f.likeliest
    if best is None or not best.place:
        return ""
    if best.surface is None:
        return f"; most likely {likeliness(best)}"
    if f.surface is not None:
        at = None if f.located is None else f.located.middle
        about = f", about ({', '.join(f'{x:.1f}' for x in at)}) m" if at is not None else ""
        return f' on "{f.surface}" (probability {percent(f.surfaces[f.surface])}){about}'
    some = [(f'"{name}"', f.surfaces[name]) for name in f.likely_surfaces]
    return f", {choice(some, 'most likely on')}" if some else ""


def _change(f: Finding) -> str:
    """Return the change in a clause: more or less absorption, its amount and its spectrum."""
    size = f.size
    if f.family == "climate" or size is None or not np.isfinite(size.mean):
        return "the climate of the air changed"
    more = f.families.get(f"{ADDED} absorption", 0.0) > (1 - f.probabilities[NONE]) / 2
    at = bands.label(f.middle[0])
    if len(f.middle) > 1:
        at = f"{f.middle[0]:g} to {f.middle[-1]:g} Hz"
    low, high = sorted((abs(size.low), abs(size.high)))
    said = f"the room has {amount(abs(size.mean), 'm²', (low, high))} "
    said += f"{'more' if more else 'less'} absorption at {at} than before"
    return f"{said}, {f.spectrum}" if f.spectrum else said


def _of_states(f: Finding) -> list[str]:
    if f.verdict == NONE:
        return ["No change was detected beyond the noise of both measurements."]
    if f.verdict == "hint":
        return [f"No change is identified; there is only a weak indication that {_change(f)}."]
    if f.family == "climate":
        return ["The climate of the air changed, and nothing else."]
    said = [as_sentence(_change(f))]
    if f.family is not None:
        said.append(_group(f))
    if f.identified_surfaces:
        places = listed([f'"{name}"' for name in f.identified_surfaces])
        said.append(f"The change is on {places}.")
    return said


_ANSWERS = {"means": _of_means, "positions": _at_positions, "states": _of_states}


# Cautions, candidates, evidence.


def cautions(f: Finding) -> list[str]:
    """Return reasons to doubt the answer, and likely typing errors in the input."""
    room, off, typed = f.case.room, f.coefficients, list[str]()
    for measured in _measured(f):
        t = measured.in_bands(room.centre_frequencies).reverberation_time
        typed += [doubt.sentence for doubt in marks.of_input(room, t)]
        typed += [*unusual(measured), *map(as_sentence, marks.given_twice(measured))]
    said = [str(r) for r in f.reasons if r is not f.leading and not _leads(f, r)]
    if f.kind == "positions":
        said = [*without_place(f.case.measured, f.case.simulator.pairs), *said]
    elif f.kind == "states" and f.verdict != NONE and f.family != "climate" and f.climate >= MOST:
        said.append(
            "A change of the climate explains a part of the change (probability "
            f"{percent(f.climate)})."
        )
    if off is not None and f.best_effect != COEFFICIENTS:
        said.append(f"The input coefficients may have a common error ({percent(off.probability)}).")
    if f.kind == "positions" and abs(f.score - f.threshold) < BY_SEED:
        said.append(
            "The odds are near the required ones. They vary with the simulator's random numbers by a "
            f"factor of {np.exp(BY_SEED):.1f}: search with another --seed as well."
        )
    return [*map(as_sentence, dict.fromkeys(typed)), *said]


def _measured(f: Finding) -> list[Measurement]:
    """Return every measurement of a finding."""
    if f.kind == "means":
        return [c.measured for c in f.case.configurations]
    return [f.case.before, f.case.after] if f.kind == "states" else [f.case.measured]


def details(f: Finding) -> list[str]:
    """Return sentences on sizes, sets of effects, and effects that cannot be distinguished."""
    if f.kind != "states":
        of_kind = _details_of_means if f.kind == "means" else _details_at_positions
        return [*filter(None, of_kind(f))]
    some = [likely(f'"{n}"', p) for n, p in f.surfaces.items() if 1 - CLAIMED <= p < CLAIMED]
    return (
        [f"One or several of these surfaces may have changed as well: {listed(some)}."]
        if some
        else []
    )


def _details_of_means(f: Finding) -> list[str]:
    each = {n: f.probabilities.get(n, 0.0) for n in f.names}
    least = max(SAID, _SIZED * max(each.values(), default=0.0))
    sizes = [size_of(f, n) for n, p in each.items() if p >= least]
    said = [f"{size}." for size in sizes if size]
    if f.coefficients is not None:
        low, high = f.coefficients.ratio.min(), f.coefficients.ratio.max()
        said.append(
            f"If the coefficients have a common error, the room has {low:.2f} to {high:.2f} times the "
            "absorption area of the input, by band: look for another source of the coefficients."
        )
    if f.more_than_one:
        said += [
            f"{called(name)} may be {listed([called(o) for o in others], last='or')} instead."
            for name, others in f.stand_ins.items()
            if others and len(f.members) > 1
        ]
        words = zip(("none", "one", "two", "three"), f.numbers, strict=False)
        several = ", ".join(likely(*w) for w in words if w[1] >= 0.005)
        said.append(f"The number of missing effects is {several}.")
        sets = [likely(set_of(names), p) for names, p in f.likely_sets.items()]
        said.append(f"The most probable sets of effects are {', '.join(sets)}.")
    library = {effect.name: effect for effect in checked_effects(None)}
    for name, reason in f.not_judged.items():
        family = library[name].family if name in library else None
        others = [called(k) for k, e in f.effects.items() if e.family == family]
        alike = [] if reason == IN_RUN else others
        stands = (
            f" If it is there, {listed(alike, last='or')} may be identified in its place."
            if alike
            else ""
        )
        said.append(f"{called(name)} is not judged, because {reason}.{stands}")
    return said


def set_of(names: Sequence[str]) -> str:
    """Return the printed names of a set of effects, joined.

    >>> set_of(("porous", "opening")), set_of(())
    ('porous absorber + opening', 'nothing missing')
    """
    return " + ".join(map(called, names)) or called(NONE)


def size_of(f: Finding, name: str) -> str:
    """Return a candidate's size with its interval, and its other parameters; "" without any."""
    found = f.candidate(name)
    if found is None or not found.parameters:
        return ""
    effect = f.effects[name]
    if found.extent is None:
        return f"{named(found)}: {effect.describe(found.parameters)}"
    others = effect.describe(found.parameters, without=effect.size)
    return f"{named(found)}: {found.extent.words}" + (f"; {others}" if others else "")


def _quoted(names: Sequence[str]) -> str:
    """Return names in quotes, as a sentence lists them."""
    return listed([f'"{name}"' for name in names])


def _details_at_positions(f: Finding) -> list[str]:
    said = [f"These positions do not distinguish {_quoted(g)}." for g in f.groups]
    grouped = {name for group in f.groups for name in group}
    asked = f.likely_surfaces if grouped and f.surface is None else ()
    if left := [name for name in asked if name not in grouped]:
        said.append(f"Less probable, but not ruled out: {_quoted(left)}.")
    return said


_VERDICTS = {
    "named": ": one effect is identified",
    "family": ": a group of effects is identified",
    "ambiguous": ": detected, but not identified",
    "hint": ": a weak indication",
    "unknown": ": detected, but not explained",
}
"""What a verdict says, where its name alone does not."""


def evidence(f: Finding) -> str:
    """Return the odds that something is missing, the odds required for detection, and the verdict."""
    found, what = f.detection, "changed" if f.kind == "states" else "is missing"
    part: Any = f
    of = ""
    if found.deciding is not None:
        part = found.parts[found.deciding]
        of = f" (only {found.deciding}, as all data give lower odds)"
    required = odds(part.threshold)
    required = "more than even odds" if required == "even" else f"odds of more than {required}"
    given, which, again = f"odds of {odds(abs(part.score))}", f"something {what}", ""
    if odds(part.score) == "even":
        given = "even odds"
    elif part.score < 0:  # odds below 1 are read more easily the other way round
        which, again = f"nothing {what}", f" that something {what}"
    said = (
        f"In the mean over all effects, the data{of} give {given} that {which}. A detection requires "
        f'{required}{again}. The verdict in the files is "{f.verdict}"{_VERDICTS.get(f.verdict, "")}.'
    )
    if f.kind == "positions" and f.case.has_run:
        said += (
            " The program is assumed to err as much as the reference simulations do, in addition to "
            "the errors of the model."
        )
    if found.verdict is not None and found.noise is not None and found.noise > 0:
        said += f" A single noisy value is the better explanation (odds of {odds(found.noise)})."
    if found.means is not None:
        alone = odds(found.means)
        said += f" The means over positions alone give odds of {alone} that something {what}."
    return said


_OF_INTERVAL = "95 % interval"


def interval(share: Share) -> str:
    """Return the interval in percent: "0 to 41 %, 95 % interval"."""
    low, high = share.interval
    return f"{100 * low:.0f} to {100 * high:.0f} %, {_OF_INTERVAL}"


def _of(share: Share, what: str, verb: str) -> str:
    """Return a share as a clause: "3 of 18 rooms were flagged (4 to 41 %, 95 % interval)"."""
    return f"{share.count} of {share.of} {what} {verb} ({interval(share)})"


def _flagged(share: Share) -> str:
    """Return in how many rooms with nothing missing an effect was reported, as a clause."""
    return (
        f"an effect was reported in {share.count} of {share.of} rooms with nothing missing "
        f"({interval(share)})"
    )


def _in_rooms(data: str, *counts: str, version: str = "`find`") -> str:
    """Return a sentence with counts in simulated rooms that were not used to make the finder."""
    return (
        f"{version} was tested in simulated rooms that were not used to develop it, with {data}: "
        f"{', and '.join(counts)}."
    )


def track_record(f: Finding) -> str:
    """Return how many such findings were right, in rooms that were not used to make the finder."""
    if f.kind == "states":
        return ""
    if f.case.has_run and (f.kind == "positions" or f.more_than_one):
        return "How often such findings with a simulation are right was not counted."
    if f.kind == "positions":
        return record_of_positions(f.case.room, f.parameters)
    if f.more_than_one and f.detected:
        claimed = {"families": f.named_families, "sets of families": f.named_set}
        kinds = [
            _of(
                Share(*stored()["several"][kind]),
                f"identified {kind.replace('families', 'groups')}",
                "were right",
            )
            for kind, names in claimed.items()
            if names
        ]
        return _in_rooms("one or two hidden effects", *kinds) if kinds else ""
    return record_of_means(f.verdict, data_of(f.case))


def record_of_positions(room: Room, match: Sequence[str]) -> str:
    """Return how often `find` detected hidden effects, and flagged empty rooms, with similar data."""
    stated, data = statement_of(room), WITH_LEVEL if LEVEL.key in match else WITHOUT_LEVEL
    record = record_of("positions", stated, data)
    found = [
        _of(record["family"], "identified effects or groups", "were right"),
        _of(record["surface claimed"], "identified surfaces", "were right"),
        _of(record["surface"], "detected absorbers", "were on the most probable surface"),
    ]
    counted = _in_rooms(
        f"coefficients {stated}",
        _of(record["detected"], "hidden effects", "were detected"),
        _flagged(record["flagged"]),
        version="An earlier version of `find`",
    )
    first, once, rest = f"{counted} {listed(found)}.".partition(f", {_OF_INTERVAL}")
    return f"{first}{once}{rest.replace(f', {_OF_INTERVAL}', '')}"


_SEVERAL_DATA = "data of several configurations or with C80 or G"
"""`rtcal.finder.records.ALL` as a sentence says it."""


def record_of_means(verdict: str, data: str) -> str:
    """Return how often this verdict was right with this kind of data, as `records` names both."""
    record = record_of("means", data)
    rooms = _SEVERAL_DATA if data == ALL else data
    flagged = _flagged(record["flagged"])
    if verdict == UNKNOWN:
        return _in_rooms(rooms, flagged)
    if verdict not in record:
        missed = Share(record["detected"].of - record["detected"].count, record["detected"].of)
        said = _of(missed, "hidden effects", "were not detected")
        return _in_rooms(
            rooms, f"{said}, so a search without a result does not prove that nothing is missing"
        )
    kinds = {
        "named": ("identified effects", "were right"),
        "family": ("identified groups of effects", "were right"),
        "ambiguous": ("sets of candidates", "contained the right effect"),
    }
    counts = _of(record[verdict], *kinds[verdict])
    if data == RUN:
        return _in_rooms(rooms, counts, flagged)
    said = _in_rooms(rooms, counts)
    if verdict == "ambiguous":
        return said
    measured = stored()["measured"]
    wrong = Share(measured["wrong"], measured["claims"])
    return (
        f"{said} In {measured['cases']} cases in measured rooms, an earlier version identified "
        f"{wrong.of} effects or groups, and {wrong.count or 'none'} of these "
        f"{'was' if wrong.count < 2 else 'were'} wrong (error rate {interval(wrong)})."
    )


# Blocks.


def candidates(f: Finding, least: float = SAID) -> Table | None:
    """Return the table of effects: with odds for means, with sizes otherwise; None without any.

    ``least`` is the smallest probability of an effect of means in the table.
    """
    if f.kind == "means":
        there = "probability" if not f.more_than_one else "probability of being there"
        rows = [
            Row(called(name), [percent(p), odds(f.evidence[name]) if name in f.evidence else ""])
            for name, p in f.probabilities.items()
            if p >= least
        ]
        title = "Candidates. Odds: the model with the effect against the model without it."
        if not f.more_than_one:
            title += (
                " Probability: these odds times the prior odds of the effect, as a share of all."
            )
        return Table([there, "odds by the data"], rows, title, corner="effect")
    some = [c for c in f.candidates if c.probability >= SAID and f.verdict != NONE]
    rows = [
        Row(named(c), [percent(c.probability), c.in_words.replace(f"({_INTERVAL} ", "(")])
        for c in some[:8]
    ]
    corner = "change" if f.kind == "states" else "effect"
    return Table(["probability", f"size ({_INTERVAL})"], rows, corner=corner) if rows else None


def numbers(f: Finding) -> list[Block]:
    """Return tables by band: deviations for means; T and its change for two states."""
    if f.kind != "states":
        if f.kind != "means":
            return []
        every = deviations(f, f.residuals)
        return [*every] if len(every) < _SEVERAL else [_largest_deviations(f, every)]
    case, measured = f.case, np.flatnonzero(f.case.known)
    width = f.change[2] - f.change[1]
    known = width[np.isfinite(width) & (width > 0)]
    # So many decimals that the interval shows its width.
    digits = int(np.clip(np.ceil(-np.log10(known.min() / 2)), 1, 6)) if len(known) else 1
    columns = {
        "T before / s": [f"{t:.2f}" for t in case.times[0, measured]],
        "T after / s": [f"{t:.2f}" for t in case.times[1, measured]],
        "absorption area / m²": [f"{area:.1f}" for area in f.area[measured]],
        "change / m² (90 % interval)": [
            f"{mean:+.{digits}f} ({low:+.{digits}f} to {high:+.{digits}f})"
            if np.isfinite([mean, low, high]).all()
            else "not tried"
            for mean, low, high in f.change[:, measured].T
        ],
    }
    return [Table.of_columns(bands.labels(case.room.centre_frequencies[measured]), columns)]


def _largest_deviations(f: Finding, tables: Sequence[Table]) -> Block:
    """Return one table of several configurations, with the rows in which a band deviates much."""
    rows, left_out = list[Row](), 0
    for c, table in zip(f.case.configurations, tables, strict=True):
        for row in table.rows:
            large = np.nanmax(np.abs(np.asarray(row.values, float))) >= marks.LARGE_Z
            left_out += not large
            if large:
                rows.append(replace(row, name=f'{row.name} of "{c.name}"'))
    if not rows:
        return Note(f"{_DEVIATION}: less than {marks.LARGE_Z:g} in every band of every parameter.")
    title = _DEVIATION
    less = f"{left_out} rows with values below {marks.LARGE_Z:g} in every band are left out."
    return Table(tables[0].columns, rows, title, note=less if left_out else "")


def deviations(f: Finding, residuals: Array, of: str = "") -> list[Table]:
    """Return tables of the deviations of each configuration; ``of`` names the effects in the model."""
    made, labels = list[Table](), bands.labels(f.case.room.centre_frequencies)
    for c, by_feature in zip(f.case.configurations, residuals, strict=True):
        named = zip(feature_names(c.measured), by_feature, strict=True)
        rows = [
            Row(name, row, "+z.1f", row / _STRONG) for name, row in named if np.isfinite(row).any()
        ]
        where = f' of "{c.name}"' if len(f.case.configurations) > 1 else ""
        heading = _DEVIATION.replace("Deviation", f"Deviation{where}{of}", 1)
        made.append(Table(labels, rows, heading))
    return made


def blocks(f: Finding, verification: Verification | None = None) -> list[Block]:
    """Return a finding as blocks: the answer, cautions, next step, candidates, data and evidence."""
    table = candidates(f)
    step = first_step(f, verification)
    last = [evidence(f), track_record(f), *(f"Note: {n}" for n in noted(f))]
    return [
        Note(" ".join(headline(f))),
        *(Note(f"Caution: {said}") for said in cautions(f)),
        *([] if verification is None else [Note(verification.sentence)]),
        *([Note(f"Next: {step}")] if step else []),
        *([] if table is None else [table]),
        *(Note(said, "  ") for said in details(f)),
        *numbers(f),
        *(Note(said) for said in last if said),
    ]


def noted(f: Finding) -> list[str]:
    """Return the notes as sentences, without those that the answer or a caution states already."""
    left = {"Schroeder"} if any(r.code == "below Schroeder" for r in f.reasons) else set()
    left |= {EQUATION_OFF} if f.verdict == NONE else set()
    return [
        as_sentence(str(n))
        for n in f.notes
        if isinstance(n, str)
        or n.code not in {"uncertainties", *left}
        or (n.code == "uncertainties" and n.values["origins"].get("made"))
    ]


def added(f: Finding, members: tuple[str, ...]) -> str:
    """Return a sentence on the effects that `Finding.apply` adds, and on the other candidates."""
    some = listed(
        [
            f"{called(name_of(f, n))} (probability {percent(f.probabilities.get(n, 0.0))})"
            for n in members
        ]
    )
    if len(members) > 1:
        some += f", the most probable set ({percent(f.sets[members])})"
    elif members != f.members:
        some += ", as chosen"
    others = listed([likely(n, f.probabilities.get(n, 0.0)) for n in f.names if n not in members])
    beside = f" Other candidates are {others}." if others and len(members) == 1 else ""
    return f"The corrected model contains {some}.{beside}"


# A plan.


_OPEN = 0.01
"""Uncertainty of the effects in nats below which a further measurement has nothing to settle."""


def of_plan(p: Plan, *, every: bool = False) -> list[Block]:
    """Return a plan as blocks: what to measure next, and which effects the data distinguish.

    If ``every`` is True, effects that the data do not distinguish are named, else they are counted.
    """
    seen, named_ = list[Row](), list[Block]()
    for name, change in p.reached.items():
        nats = p.separations[name, NONE]
        others = [other for other in p.reached if other != name]
        alike = [called(n) for n in others if p.separations[name, n] < DISTINCT_NATS]
        apart = [called(n) for n in others if p.separations[name, n] >= DISTINCT_NATS]
        alike_of = f"{len(alike)} of {len(others)}"
        seen.append(Row(called(name), [f"{100 * change:.1f} %", odds(nats), alike_of]))
        said = listed(alike) or "no other effect"
        if len(alike) > len(apart):
            said = f"all but {listed(apart)}" if apart else "all others"
        named_.append(Note(f"{called(name)}: {said}", "  "))
    measured, enough = listed([parameter_label(n) for n in p.parameters]), odds(DISTINCT_NATS)
    shown = sum(p.separations[name, NONE] >= DISTINCT_NATS for name in p.reached)
    return [
        *_proposed(p),
        Note(
            f"If one effect alone were missing, {measured} would detect {shown} of {len(seen)} effects "
            f"(odds by the data of at least {enough}). Each effect has the size that changes T by "
            f"{100 * p.change:g} % in one band, or as much as it can. The last column counts the other "
            f"effects that fit as well (odds below {enough}{'' if every else '; --all names them'}).",
            hanging="",
        ),
        Table(["change of T", "odds by the data", "not distinguished from"], seen, corner="effect"),
        *([Note("Effects that these data do not distinguish:", hanging="")] if every else []),
        *(named_ if every else []),
    ]


def _proposed(p: Plan) -> list[Block]:
    """Return what to measure next, the best first; nothing where nothing is proposed."""
    if not p.proposals:
        return []
    if p.uncertainty < _OPEN:
        settled = "Measure nothing further: the data already settle which effects are there."
        return [Note(settled, hanging=""), Note("")]

    def share(information: float) -> str:
        return f"{100 * information / p.uncertainty:.0f} %"

    rows = [
        Row(str(m.measurement), [share(m.information), f"{m.cost:g} h", share(m.per_cost)])
        for m in p.proposals
    ]
    first = p.sequence[0]
    return [
        Note(
            f"Measure next: {first.measurement}. In {first.cost:g} h, this removes "
            f"{share(first.information)} of the uncertainty about what is missing"
            f"{', more per hour than any other proposal' * (len(rows) > 1)}. So far, the uncertainty "
            f"is that of {np.exp(p.uncertainty):.1f} equally probable effects.",
            hanging="",
        ),
        Table(["uncertainty removed", "time", "per hour"], rows, corner="measurement"),
        Note(
            "Best order, with the uncertainty that each measurement removes after those before it: "
            + listed([f"{m.measurement} ({share(m.information)})" for m in p.sequence])
            + ".",
            hanging="",
        ),
        Note(""),
    ]


def of_places(f: Finding, places: Sequence[Place]) -> list[Block]:
    """Return where a further receiver would distinguish the surfaces that are in question."""
    answer = Note(" ".join(headline(f)))
    if not places:
        return [
            Note(
                "Measure no further receiver: no surfaces are in question that it would distinguish."
            ),
            answer,
            Note(
                "To plan other measurements, name a case or a measurement of means over positions."
            ),
        ]
    names = listed([f'"{name}"' for name in f.likely_surfaces])
    where = [f"{', '.join(f'{x:.2f}' for x in p.point)} m" for p in places]
    rows = [Row(at, [p.source, f"{p.pairs:.1f}"]) for at, p in zip(where, places, strict=True)]
    enough = len(f.pairs) / 2 < places[0].pairs
    return [
        Note(
            f"Measure next with a receiver at {where[0]} and source {places[0].source}. Of the "
            f"positions that were tried, it is expected to distinguish {names} best: as well as "
            f"{places[0].pairs:.1f} of the {len(f.pairs)} measured pairs."
            + " All measured pairs together do not distinguish them, so one more may not be enough."
            * (not enough)
        ),
        answer,
        Table(["source", "worth in measured pairs"], rows, corner="receiver"),
    ]


# A calibration with what was found.


def effects_of(r: Recalibrated) -> list[str]:
    """Return a line per effect in a calibrated model, with its size."""
    out = []
    for p in r.case.applied:
        of = p.effect.describe(p.parameters)
        if p.name in r.sizes:
            of = amount(p.size, p.effect.unit_in(p.parameters, r.case.room), p.size_interval)
        out.append(f"{p.effect.title(p.parameters, r.case.room)}: {of}")
    return out


def of_recalibration(r: Recalibrated, plain: Recalibrated | None = None) -> list[Block]:
    """Return tables of each material's input and calibrated alpha, and of the effects."""
    room, beside = (plain or r).case.room, {} if plain is None else {"calibrated": plain}
    alphas = {"input": (room.alpha, NORMAL_90 * room.sigma)}
    for name, c in {**beside, "corrected and calibrated": r}.items():
        alphas[name] = (c.alpha, np.subtract(*c.interval[::-1]) / 2)
    rows = [
        Row(m, [with_uncertainty(a[i].mean(), half[i].mean(), 3) for a, half in alphas.values()])
        for i, m in enumerate(room.materials)
    ]
    of_pieces = f" (of {listed(room.pieces)} in m² per piece)" if room.pieces else ""
    title = f"alpha{of_pieces} ± half its 90 % interval, means over bands"
    return [Table([*alphas], rows, title), *(Note(line, "  ") for line in effects_of(r))]
