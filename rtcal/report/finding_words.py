"""The words of a finding: a sentence for each code, and the blocks of text, page and notebook.

Answer, cautions, evidence, notes: in this order for every kind of data. Evidence is printed as odds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
    amount,
    family_of,
    over_frequency,
)
from rtcal.finder.effects import IN_RUN, library
from rtcal.finder.evidence import COEFFICIENTS, NO_EFFECT, NONE, UNKNOWN, probability_off
from rtcal.finder.finding import Finding, feature_names
from rtcal.finder.means.planning import Plan
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
from rtcal.finder.states import ADDED, AIR, REMOVED
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
_FEW = 3  # most effects or sources that a sentence lists
_INTERVAL = "90 % interval"  # of a size in print, which a table's heading states for all sizes
_DEVIATION = "Deviation (model minus measurement) in standard deviations of this difference"
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
    # The answer.
    "differs": "Nothing is identified as missing, but the {who} differs from the measurement, most in "
    "{most}.",
    "coefficients suffice": "The uncertainty of the coefficients, together with {error}, can explain "
    "this difference.",
    "other coefficients suffice": "The program's coefficients, which are not the input's, together "
    "with {error}, can explain this difference.",
    "agrees": "The {who} agrees with the measurement: within the uncertainty of input values, "
    "measurement and {who}, nothing is found to be missing from the {lacks}.",
    "agrees at pairs": "The {who} agrees with the measurement in the mean over the pairs: at every "
    "pair within the uncertainty of input values, measurement and simulator, nothing is found to be "
    "missing from the {lacks}.",
    "weak": "Nothing is identified; {best} is only a weak indication.",
    "weak, nothing likelier": "Nothing is identified: the most probable explanation is that nothing is "
    "missing ({nothing:p}), and the most probable effect is {best}.",
    "group": 'The data identify the group of effects "{family}" ({probability:p}), but not which '
    "effect of it.",
    "one of the library": "Of the effects in the library, {kind} explains most ({share:p} of the "
    "rest){place}.",
    "more differs": "This does not explain everything that was measured: something else also differs "
    "from the model ({probability:p}).",
    "most is unknown": "Something is missing that no effect of the library explains ({probability:p}).",
    "several": "More than one effect is missing ({several:p}); most likely together: {names:and} "
    "({together:p}).",
    # Why something is not identified, or not by its name.
    "nothing likely": "That nothing is missing has a probability of {probability:p}, so nothing is "
    "identified.",
    "no effect likely": "No effect and no group of effects has a probability of {least:p}, so nothing "
    "is identified.",
    **dict.fromkeys(
        (LEADING, MISTAKE),
        "T is {factor:.2g} times the model's: look for a mistake in volume, areas, coefficients and "
        "units first.",
    ),
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
    "size unbounded": "The measurement does not bound the size of {effect:name}: {size.words}; any "
    "{other} size fits as well.",
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
    "directions first": "State in which direction the room's surfaces face, and search again, before "
    "you look for {effect:name}.",
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
    "simulate twice": "Simulate with half and with twice the scattering coefficients and search with "
    "each run, which shows what is missing whatever the program scatters. Draw a second room if there "
    "is one.",
    "calibrate program": "Calibrate your program (`rtcal loop start` with the same --simulated).",
    "calibrate": "Calibrate the room (`rtcal {command}`).",
    "without run": "Search again without the run, or with tables of means over positions, where "
    "--program names the kind of program.",
    "one more receiver": "Measure at one more receiver: `rtcal plan` proposes where.",
    "look on surfaces": "Look for the effect on {surfaces:quoted}. If you do not find it there, "
    "measure at one more receiver: `rtcal plan` proposes where.",
    "look for it": "Look in the room for {effect:name}. If it can be removed, measure once with it and "
    "once without it.",
    # Why nothing is added to the model, or not without a choice.
    "nothing to add": "Nothing to add: nothing is identified as missing.",
    "too weak to add": "Nothing to add: nothing was detected. {best:name} is only a weak indication "
    "(verdict hint). Measure more and search again: `rtcal plan` proposes what. If you know that it is "
    "in the room, choose it by its name (`rtcal apply --effect NAME`).",
    "none of the library": "Nothing to add: no effect of the library explains what is missing "
    "(verdict unknown).",
    "no surface": "Nothing to add: the effect that was found is not on a surface.",
    "second room": "{best:name}: {why}.",
    "no change to add": "Nothing to add: no change was identified.",
    "climate changed": "Nothing to add: the climate of the air changed. Enter temperature and humidity "
    "in the room's file.",
    "effect undecided": "No effect is chosen, and the most probable one has a probability of less than "
    "{least:p}. Candidates: {candidates:options}. Choose one: effect = NAME.",
    "place undecided": "Neither an effect nor a place is chosen, and the most probable group on one "
    "surface has a probability of less than {least:p}. Candidates: {candidates:options}. Choose one: "
    "effect = NAME, or its place: at = X,Y,Z.",
    "volume undecided": "effect = volume has a probability of {probability:p}, but rtcal changes the "
    "room's volume only from {least:p} upwards. Measure the volume and enter it in the room's "
    "file{others:else}.",
    "support": "{best:name} (probability {best.probability:p}){others:rivals}",
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
    "from the room (odds of {nats:odds}), so the sources are not taken as omnidirectional. Enter "
    "their [directivity]; an omnidirectional source has the index 0.",
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
    "no directivity": "The directivity of {sources:few} is not given, so no surface is identified. "
    "Give every source a directivity, with index = 0 for an omnidirectional one.",
    # What could be measured next.
    "EDT and T30": "EDT and T30",
    "C80": "C80",
    "G": "G, with a calibrated source",
    "more positions": "{positions} more positions",
    "another climate": "air of {temperature:.0f} °C, {humidity:.0f} % humidity",
    "covered": '{thickness:.0f} mm mineral wool on "{material}"',
    "removed": "an emptied room, openings closed",
    "planned": 'configuration "{configuration}"',
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
    "input changed": "The input {what}: it was {before:.4g}{unit} and is now {now:.4g}{unit}.",
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
    # What else is known of the candidates.
    "climate likeliest": "The climate of the air changed, and nothing else (probability "
    "{probability:p}), or {change}.",
    "changes too": "A change of the climate explains a part of the change (probability "
    "{probability:p}).",
    "by seed": "The odds are near the required ones. They vary with the simulator's random numbers by "
    "a factor of {factor:.1f}: search with another --seed as well.",
    "common error": "If the coefficients have a common error, the room has {low:.2f} to {high:.2f} "
    "times the absorption area of the input, by band: look for another source of the coefficients.",
    "not judged": "{effect:name} is not judged, because {why}.",
    "stands for it": "{effect:name} is not judged, because {why}. If it is there, {others:or} may be "
    "identified in its place.",
    "evidence": "In the mean over all effects, the data{of} give {given} that {which}. A detection "
    'requires {required}. The verdict in the files is "{verdict}"{meaning}.',
    "before": "Before the measurement, the probability that nothing {what} was {before:p}; with "
    "these odds it is {after:p}.",
    "before, not alone": "Before the measurement, the probability that nothing {what} was "
    "{before:p}; these odds alone would make it {alone:p}. It is {after:p}, because {why}.",
    "program errs": "The program is assumed to err as much as the reference simulations do, in "
    "addition to the errors of the model.",
    "noisy value": "A single noisy value is the better explanation (odds of {nats:odds}).",
    "by means": "The means over positions alone give odds of {nats:odds} that something {what}.",
    # What could be measured, as a plan says it.
    "settled": "Measure nothing further: the data already settle which effects are there.",
    "propose": "Measure next: {what}. In {cost:g} h, this removes {share} of the uncertainty about "
    "what is missing{best}. So far, the uncertainty is that of {number:.1f} equally probable effects.",
    "in order": "Best order, with the uncertainty that each measurement removes after those before it: "
    "{order}.",
    "detectable": "If one effect alone were missing, {measured:and} would detect {shown} of {number} "
    "effects (odds by the data of at least {nats:odds}). Each effect has the size that changes T by "
    "{change:g} % in one band, or as much as it can. The last column counts the other effects that fit "
    "as well (odds below {nats:odds}{more}).",
    "no receiver": "Measure no further receiver: no surfaces are in question.",
    "plan others": "To plan other measurements, name a case or a measurement of means over positions.",
    "receiver": "Measure next with a receiver at {at} and source {source}. Of the positions that were "
    "tried, it is expected to distinguish {surfaces:quoted} best: as well as {pairs:.1f} of the "
    "{number} measured pairs.",
    "not enough": "All measured pairs together do not distinguish them, so one more may not be enough.",
}
"""The sentence of each code of a `rtcal.finder.claim.Reason`; `_FORMS` has the forms of its values.
What does not end with a point stands within another sentence."""

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
_ORIGINS = {
    "stated": "as given",
    "made": "estimated from scatter over pairs, theory and reproducibility, because none is given",
}
"""Where uncertainties come from."""
_VERDICTS = {
    "named": ": one effect is identified",
    "family": ": a group of effects is identified",
    "ambiguous": ": detected, but not identified",
    "hint": ": a weak indication",
    "unknown": ": detected, but not explained",
}
"""What a verdict says, where its name alone does not."""


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


def called(effect: str | Candidate) -> str:
    """Return the printed name of an effect, or of a candidate with its place.

    >>> called("porous"), called("noise floor"), called("added porous")
    ('porous absorber', 'noise floor', 'added porous absorber')
    >>> called(Candidate(effect="membrane", family="", probability=0.5, surface="west"))
    'panel absorber on "west"'
    """
    if isinstance(effect, Candidate):
        return f"{called(effect.shown_as)} {effect.where}".rstrip()
    side, _, kind = effect.partition(" ")
    if side in (ADDED, REMOVED) and kind:
        return f"{side} {'unknown absorber' if kind == UNKNOWN else NAMES.get(kind, kind)}"
    return NAMES.get(effect, effect)


def likely(effect: str | Candidate, probability: float | None = None) -> str:
    """Return a name with its probability, by default that of the candidate."""
    if isinstance(effect, Candidate) and probability is None:
        probability = effect.probability
    return called(effect) if probability is None else f"{called(effect)} ({percent(probability)})"


def choice(some: Sequence[tuple[str | Candidate, float]], lead: str = "most likely") -> str:
    """Return candidates with their probabilities in words.

    ``some`` are names and probabilities, the most probable first. ``lead`` begins the text.

    >>> choice([("furniture", 0.45), ("opening", 0.39)])
    'most likely furniture (probability 45 %), but opening (39 %) fits nearly as well'
    """
    (first, most), *others = some
    near = [likely(*one) for one in others if one[1] >= _NEAR * most]
    far = [likely(*one) for one in others if one[1] < _NEAR * most]
    said = f"{lead} {called(first)} (probability {percent(most)})"
    said += f", but {listed(near)} fit{'s' * (len(near) == 1)} nearly as well" if near else ""
    return said + (f"; less likely {'are' if far[1:] else 'is'} {listed(far)}" if far else "")


def unexplained(names: Sequence[str]) -> str:
    """Return in words that the effects with these names do not explain the measurement.

    >>> unexplained(["air"]), unexplained(["opening", "porous", "curtain", "people"])
    ('air does not explain the data', 'no effect that was tried explains the data')
    """
    if len(names) > _FEW:
        return "no effect that was tried explains the data"
    return f"{listed([*map(called, names)])} {'does' if len(names) == 1 else 'do'} not explain the data"


def quoted(names: Sequence[str], last: str = "and") -> str:
    """Return names in quotes, as a sentence lists them."""
    return listed([f'"{name}"' for name in names], last=last)


def _options(some: Sequence[Candidate | tuple[str, float]]) -> str:
    """Return candidates by the names that an option takes."""
    every = [(v.title, v.probability) if isinstance(v, Candidate) else v for v in some]
    return listed([f"{name} ({percent(p)})" for name, p in every], last="or")


def _range(values: Sequence[float]) -> str:
    ends = dict.fromkeys([f"{min(values):.0f}", f"{max(values):.0f}"])
    return f"{' to '.join(ends)} %"


_FORMS: Mapping[str, Callable[[Any], str]] = {
    "p": percent,
    "odds": odds,
    "name": called,
    "and": lambda some: listed([*map(likely, some)]),
    "or": lambda some: listed([*map(likely, some)], last="or"),
    "few": lambda some: first_of([*map(likely, some)], _FEW),
    "else": lambda some: f", or choose another effect: {_FORMS['or'](some)}" if some else "",
    "rivals": lambda some: (
        f", which these data do not distinguish from {_FORMS['few'](some)}" if some else ""
    ),
    "check": lambda effect: CHECKS.get(effect, _CHECK),
    "options": _options,
    "quoted": quoted,
    "origins": lambda of: "; that of ".join(
        f"{listed(names)} is {_ORIGINS[k]}" for k, names in of.items() if names
    ),
    "unexplained": unexplained,
    "where": lambda of: bands.where(*of),
    "range": _range,
    "gains": lambda of: first_of([f"{name} (by {g:+z.1f} dB)" for name, g in of.items()], _FEW),
}
"""The forms of values in `SENTENCES`: probabilities, odds, effects, sizes and lists."""


class _Words(Formatter):
    def format_field(self, value: Any, form: str) -> str:
        return _FORMS[form](value) if form in _FORMS else str(super().format_field(value, form))


def say(code: str, **values: Any) -> str:
    """Return the sentence of a code, with values in its slots."""
    words = _Words().vformat(SENTENCES[code], (), values)
    return words[:1].upper() + words[1:] if words.endswith(".") else words


def sentence(reason: Reason) -> str:
    """Return the sentence of a reason."""
    return say(reason.code, **reason.values)


# The answer.


def headline(f: Finding) -> list[str]:
    """Return the answer in sentences, the first alone is enough; a doubt about T leads it."""
    answer, *more = _ANSWERS[f.kind](f)
    if f.leading is not None and f.verdict != NONE:
        answer = f"{f.leading} If there is no such mistake: {answer}"
    known = f.verdict == NONE or (f.verdict == "hint" and _nothing_likelier(f))
    if not known and (nothing := f.probabilities.get(NONE, 0.0)) >= _NOTHING:
        more.append(f"The probability that nothing {_missing(f)} is {percent(nothing)}.")
    return [answer, *more]


def _missing(f: Finding) -> str:
    return "changed" if f.kind == "states" else "is missing"


def title(f: Finding) -> str:
    """Return the best effect, or the most probable set, as a sentence names it."""
    return listed([name_of(f, n) for n in f.members or (str(f.best_effect),)])


def name_of(f: Finding, effect: str) -> str:
    """Return the name in print of an effect, with the place of its candidate."""
    return called(f.candidate(effect) or effect)


def absorbs(change: Array, end: str = "") -> str:
    """Return in words how much more or less the room absorbs than the model.

    ``change`` (3, n_bands) is the relative change of the absorption area: its mean, and both ends of
    its 90 % interval. ``end`` is "least" or "most" if only one end is known (`Size`), else "".

    >>> absorbs(np.array([[0.2, 0.6], [0.1, 0.3], [0.3, 0.9]]))
    'The room absorbs 40 % more than the model (90 % interval 20 to 60 %), rising with frequency'
    """
    mean, *ends = 100 * np.abs(change.mean(1))
    low, high = sorted(ends)
    by, interval = f"{mean:.0f} %", f" ({_INTERVAL} {low:.0f} to {high:.0f} %)"
    if end:
        by, interval = f"at {end} {low if end == 'least' else high:.0f} %", ""
    more = "more" if change[0].mean() > 0 else "less"
    trend = over_frequency(change[0])
    return f"The room absorbs {by} {more} than the model{interval}, {trend}"


def _of_means(f: Finding) -> list[str]:
    if len(f.members) > 1 or (f.named and f.named != f.members):
        return _of_several(f)
    if f.verdict == NONE:
        return _nothing_missing(f)
    if f.verdict == "hint":
        return [str(reason) for reason in f.reasons if _leads(f, reason)] or [_weak(f)]
    if f.verdict == UNKNOWN:
        return [f"Something is missing from the model: {unexplained(tuple(f.effects))}."]
    some = [(c, f.probabilities.get(c.effect, 0.0)) for c in f.candidates]
    cause = f"The cause is {choice(some)}."
    if f.verdict == "ambiguous":
        return [f"{_contradiction(f)}, but the data do not show what. {cause}"]
    best, subject = f.best, _contradiction(f)
    if best is not None and best.absorption is not None:
        subject = absorbs(best.absorption, best.end)
    if f.verdict == "family":
        return [f"{subject}. {cause}", _group(f)]
    probability = f.probabilities.get(str(f.best_effect), 0.0)
    if f.best_effect == COEFFICIENTS:
        return [f"The input coefficients have a common error ({percent(probability)})."]
    return [f"{subject}: {title(f)} ({percent(probability)})."]


def _group(f: Finding) -> str:
    """Return the group of effects that is identified, where no effect is."""
    return say("group", family=f.family, probability=f.families.get(str(f.family), 0.0))


def _weak(f: Finding) -> str:
    """Return the answer of a hint: the most probable candidate, after what is likelier than it."""
    best = likely(*next(one for one in f.probabilities.items() if one[0] != NONE))
    code = "weak, nothing likelier" if _nothing_likelier(f) else "weak"
    return say(code, best=best, nothing=f.probabilities.get(NONE, 0.0))


def _leads(f: Finding, reason: Reason) -> bool:
    """Return whether a reason is the answer: the program's error, if no less likely than nothing."""
    return reason.code == OWN_FIELD and reason.values["probability"] >= f.probabilities[NONE]


def _nothing_likelier(f: Finding) -> bool:
    """Return whether nothing missing or changed is more probable than any candidate."""
    return f.kind != "states" and next(iter(f.probabilities)) == NONE


def _nothing_missing(f: Finding) -> list[str]:
    """Return that nothing is missing, and whether model or run agree with the measurement."""
    who, lacks = ("program", "room") if f.case.has_run else ("model", "model")
    off = [str(n) for n in f.notes if isinstance(n, Reason) and n.code == EQUATION_OFF][:1]
    if not f.differs:
        agrees = "agrees at pairs" if f.kind == "positions" else "agrees"
        return [*off, say(agrees, who=who, lacks=lacks)]
    error = f"the error of the {'program' if f.case.has_run else 'equation'}"
    error = "scattering" if f.kind == "positions" else error
    _, most = max(map(largest, f.comparisons))
    suffices = "coefficients suffice"
    if any(c.had_other_coefficients.any() for c in f.comparisons):
        suffices = "other coefficients suffice"
    return [say("differs", who=who, most=most), say(suffices, error=error), *off]


def largest(c: Comparison) -> tuple[float, str]:
    """Return the largest deviation that is noticed, in JND, and its words; 0 where all agrees."""
    each = {p: np.where(c.disagrees[p], off, 0.0) for p, off in c.deviation.items()}
    p = max(each, key=lambda p: np.abs(each[p]).max())
    k = int(np.argmax(np.abs(each[p])))
    at = bands.label(c.run.room.centre_frequencies[k])
    return abs(each[p][k]), f"{parameter_label(p)} at {at} by {each[p][k]:+.1f} JND"


def _of_several(f: Finding) -> list[str]:
    """Return the claims about effects, families and sets of families; what is likely without one."""
    if f.verdict == "ambiguous":
        some = [likely(n, f.probabilities[n]) for n in f.members]
        said = [f"Something is missing from the model; most likely {listed(some)}."]
        beyond = f.probabilities.get(UNKNOWN, 0.0)
        if beyond > max(f.probabilities[n] for n in f.members):
            said.append(say("most is unknown", probability=beyond))
        return said
    of_named = {family_of(n, f.effects) for n in f.named}
    identified = [likely(n, f.probabilities[n]) for n in f.named]
    identified += [likely(n, f.families[n]) for n in f.named_families if n not in of_named]
    said = [f"{_contradiction(f)}: {listed(identified)}."] if identified else []
    if names := f.named_set:
        several, together = sum(f.numbers[2:]), f.family_sets[names]
        said.append(say("several", several=several, names=names, together=together))
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


def _at_positions(f: Finding) -> list[str]:
    if f.best is None:
        return _nothing_missing(f)
    if f.verdict == "hint":
        return [_weak(f)]
    known = [c for c in f.candidates if c.effect != UNKNOWN]
    if f.verdict == UNKNOWN:
        said = ["Something differs from the model that no effect of the library explains."]
        if f.likeliest is not None:
            kind = f.likeliest.kind
            alike = sum(c.probability for c in known if c.kind == kind)
            share = alike / sum(c.probability for c in known)
            said.append(say("one of the library", kind=kind, share=share, place=_place(f)))
        return said
    kind = known[0].kind if known else ""
    if kind == COEFFICIENTS and np.isfinite(known[0].size):
        kind = f"{'less' if known[0].size < 1 else 'added'} absorption"
    subject = {
        "added absorption": "The room absorbs more than the model",
        "less absorption": "The room absorbs less than the model",
    }.get(kind, "The room or the measurement differs from the model")
    said = [f"{subject}{_place(f)}."]
    effects = {c.effect for c in f.candidates if c.probability >= SAID}
    if f.verdict == "family":
        said.append(_group(f))
    elif f.verdict == "named":
        effect = str(f.effect)
        said.append(f"The effect is identified: {likely(effect, f.probabilities[effect])}.")
    elif effects:
        some = choice([one for one in f.probabilities.items() if one[0] in effects])
        said.append(f"The effect is not identified: it is {some}.")
    if f.unexplained >= MOST:
        said.append(say("more differs", probability=f.unexplained))
    return said


def _place(f: Finding) -> str:
    """Return where something differs, as far as the positions show it, as the end of a sentence."""
    best = f.likeliest
    if best is None or not best.place:
        return ""
    if best.surface is None:
        return f"; most likely {likely(best)}"
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
    at = bands.label(f.middle[0])
    if len(f.middle) > 1:
        at = f"{f.middle[0]:g} to {f.middle[-1]:g} Hz"
    if size.low < 0 < size.high:
        ends = f"{size.low:+.3g} to {size.high:+.3g} m² (90 % interval)"
        return f"the room's absorption at {at} changed by {ends}"
    low, high = sorted((abs(size.low), abs(size.high)))
    much = amount(abs(size.mean), "m²", (low, high))
    which = "more" if size.mean > 0 else "less"
    said = f"the room has {much} {which} absorption at {at} than before"
    return f"{said}, {f.spectrum}" if f.spectrum else said


def _of_states(f: Finding) -> list[str]:
    if f.verdict == NONE:
        return ["No change was detected beyond the noise of both measurements."]
    if f.verdict == "hint":
        return [f"No change is identified; there is only a weak indication that {_change(f)}."]
    if f.family == "climate":
        return ["The climate of the air changed, and nothing else."]
    on = quoted(f.identified_surfaces)
    said = as_sentence(_change(f))
    if next(iter(f.probabilities)) == AIR:
        said = say("climate likeliest", probability=f.probabilities[AIR], change=_change(f))
    return [
        said,
        *([] if f.family is None else [_group(f)]),
        *([f"The change is on {on}."] if on else []),
    ]


_ANSWERS = {"means": _of_means, "positions": _at_positions, "states": _of_states}


# The next step, cautions, details, evidence.


def without_measuring(f: Finding) -> str:
    """Return the next step of a finding that needs no measurement, such as calibration; "" for none."""
    if any(reason.code == OWN_FIELD for reason in f.reasons):
        return say("simulate twice")
    if f.verdict != NONE or not f.differs:
        return ""
    if f.kind != "states" and f.case.has_run:
        return say("calibrate program")
    return say("calibrate", command="fit" if f.kind == "positions" else "calibrate")


def next_step(f: Finding, verification: Verification | None = None) -> str:
    """Return the next step, a measurement or not, in a sentence; "" where nothing is left to do."""
    if step := without_measuring(f):
        return step
    if any(_leads_in_place(f, reason) for reason in _not_judged(f)):
        return say("directions first", effect=f.best_effect)
    if f.advice is not None:
        return str(f.advice)
    if f.kind != "positions" or f.verdict == NONE or f.best is None:
        return ""
    if f.verdict == "hint":
        return say("without run" if f.case.has_run else "one more receiver")
    if verification is not None and not (verification.misses or verification.verdict == "unproven"):
        return USE[verification.verdict]
    if f.likely_surfaces and f.surface is None:
        return say("look on surfaces", surfaces=f.likely_surfaces)
    return say("look for it", effect=f.likeliest or f.best)


def first_step(f: Finding, verification: Verification | None = None) -> str:
    """Return the next step, after the check of what a caution calls a likely typing error."""
    checked = dict.fromkeys(d.checked for m in _measured(f) for d in _doubts(f, m) if d.is_error)
    step = next_step(f, verification)
    if not step or not checked:
        return step
    return f"First check {listed([*checked])}. If nothing is mistyped, {step[:1].lower()}{step[1:]}"


def _doubts(f: Finding, measured: Measurement) -> Sequence[marks.TrustMark]:
    """Return the input of the room that may be mistyped, by one measurement."""
    room = f.case.room
    return marks.of_input(room, measured.in_bands(room.centre_frequencies).reverberation_time)


_CLIMATE = 0.75
"""Probability of another climate from which a caution names it. It is 0.5 before the measurement."""


def cautions(f: Finding) -> list[str]:
    """Return reasons to doubt the answer, and likely typing errors in the input."""
    off, typed = f.coefficients, list[str]()
    for measured in _measured(f):
        typed += [doubt.sentence for doubt in _doubts(f, measured)]
        typed += [*unusual(measured), *map(as_sentence, marks.given_twice(measured))]
    said = [str(r) for r in f.reasons if r is not f.leading and not _leads(f, r)]
    if f.kind == "positions":
        said = [*without_place(f.case.measured, f.case.simulator.pairs), *said]
    elif (
        f.kind == "states" and f.verdict != NONE and f.family != "climate" and f.climate >= _CLIMATE
    ):
        said.append(say("changes too", probability=f.climate))
    if off is not None and f.best_effect != COEFFICIENTS:
        said.append(f"The input coefficients may have a common error ({percent(off.probability)}).")
    if f.kind == "positions" and abs(f.score - f.threshold) < BY_SEED:
        said.append(say("by seed", factor=np.exp(BY_SEED)))
    said += [str(reason) for reason in _not_judged(f) if _leads_in_place(f, reason)]
    return [*map(as_sentence, dict.fromkeys(typed)), *said]


def _measured(f: Finding) -> list[Measurement]:
    """Return every measurement of a finding."""
    if f.kind == "means":
        return [c.measured for c in f.case.configurations]
    return [f.case.before, f.case.after] if f.kind == "states" else [f.case.measured]


def details(f: Finding) -> list[str]:
    """Return sentences on sizes, sets of effects, and effects that cannot be distinguished."""
    return {"means": _details_of_means, "positions": _undistinguished, "states": _others}[f.kind](f)


def _others(f: Finding) -> list[str]:
    """Return which surfaces may have changed between two states, beside those that are identified."""
    some = [likely(f'"{n}"', p) for n, p in f.surfaces.items() if 1 - CLAIMED <= p < CLAIMED]
    said = f"One or several of these surfaces may have changed as well: {listed(some)}."
    return [said] if some else []


def _undistinguished(f: Finding) -> list[str]:
    """Return which surfaces these positions do not distinguish."""
    said = [f"These positions do not distinguish {quoted(g)}." for g in f.groups]
    grouped = {name for group in f.groups for name in group}
    asked = f.likely_surfaces if grouped and f.surface is None else ()
    if left := [name for name in asked if name not in grouped]:
        said.append(f"Less probable, but not ruled out: {quoted(left)}.")
    return said


def _details_of_means(f: Finding) -> list[str]:
    each = {n: f.probabilities.get(n, 0.0) for n in f.names}
    least = max(SAID, _SIZED * max(each.values(), default=0.0))
    said = [f"{size}." for n, p in each.items() if p >= least and (size := size_of(f, n))]
    if f.coefficients is not None:
        ratio = f.coefficients.ratio
        said.append(say("common error", low=ratio.min(), high=ratio.max()))
    if f.more_than_one:
        said += [
            f"{called(name)} may be {listed([*map(called, others)], last='or')} instead."
            for name, others in f.stand_ins.items()
            if others and len(f.members) > 1
        ]
        numbers = zip(("none", "one", "two", "three"), f.numbers, strict=False)
        several = ", ".join(likely(*each) for each in numbers if each[1] >= 0.005)
        said.append(f"The number of missing effects is {several}.")
        sets = [likely(set_of(names), p) for names, p in f.likely_sets.items()]
        said.append(f"The most probable sets of effects are {', '.join(sets)}.")
    return said + [str(reason) for reason in _not_judged(f) if not _leads_in_place(f, reason)]


def _not_judged(f: Finding) -> list[Reason]:
    """Return which effects are not judged, with those that may be identified in their place."""
    families = {effect.name: effect.family for effect in library()}
    out = []
    for name, why in f.not_judged.items():
        others = [k for k, e in f.effects.items() if e.family == families.get(name)]
        code = "stands for it" if others and why != IN_RUN else "not judged"
        out.append(Reason(code, {"effect": name, "why": why, "others": others}))
    return out


def _leads_in_place(f: Finding, reason: Reason) -> bool:
    """Return whether the most probable effect may be identified in place of one that is not judged."""
    return reason.code == "stands for it" and f.best_effect in reason.values["others"]


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
    effect, size = f.effects[name], found.in_words
    others = effect.describe(found.parameters, without=effect.size if size else "")
    return f"{called(found)}: {'; '.join(filter(None, [size, others]))}"


def evidence(f: Finding) -> str:
    """Return the odds that something is missing, the odds required for detection, and the verdict."""
    found, what = f.detection, _missing(f)
    part, of = found, ""
    if found.deciding is not None:
        part = found.parts[found.deciding]
        of = f" (only {found.deciding}, as all data give lower odds)"
    required = odds(part.threshold)
    required = "more than even odds" if required == "even" else f"odds of more than {required}"
    given, which = f"odds of {odds(abs(part.score))}", f"something {what}"
    if odds(part.score) == "even":
        given = "even odds"
    elif part.score < 0:  # odds below 1 are read more easily the other way round
        which, required = f"nothing {what}", f"{required} that something {what}"
    stated = {"verdict": f.verdict, "meaning": _VERDICTS.get(f.verdict, ""), "required": required}
    said = [say("evidence", of=of, given=given, which=which, **stated), _from_prior(f)]
    if f.kind == "positions" and f.case.has_run:
        said.append(say("program errs"))
    if found.verdict is not None and found.noise is not None and found.noise > 0:
        said.append(say("noisy value", nats=found.noise))
    if found.means is not None:
        said.append(say("by means", nats=found.means, what=what))
    return " ".join(filter(None, said))


def _from_prior(f: Finding) -> str:
    """Return how prior and odds give the probability of nothing beside which a hint is printed."""
    after = f.probabilities.get(NONE, 0.0)
    if f.verdict != "hint" or f.more_than_one or after < _NOTHING:
        return ""
    before = NO_EFFECT
    if f.kind == "positions" and COEFFICIENTS not in f.left_out:
        before *= 1 - probability_off(f.case.room)
    elif f.kind == "means":
        before = float(np.exp(f.prior.log_probability[NONE]))
    alone = before / (before + (1 - before) * np.exp(f.score))
    values = {"what": _missing(f), "before": before, "alone": alone, "after": after}
    if percent(alone) == percent(after):
        return say("before", **values)
    return say("before, not alone", why=_why_not_alone(f), **values)


def _why_not_alone(f: Finding) -> str:
    """Return why the probability of nothing is not what prior and odds alone would make it."""
    if f.kind == "positions":
        too = "" if f.detection.means is None else " and those of means over positions too"
        return f"probabilities count deviations at single positions less{too}"
    if f.kind == "means" and f.case.program:
        return "the odds count an uneven sound field as nothing missing"
    return (
        "probabilities favour the most probable explanation the more, the better the coefficients are "
        "known"
    )


# How often such findings were right.


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
    return f"an effect was reported in {_of(share, 'rooms', 'with nothing missing')}"


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
    if not (f.more_than_one and f.detected):
        return record_of_means(f.verdict, data_of(f.case))
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


def record_of_means(verdict: str, data: str) -> str:
    """Return how often this verdict was right with this kind of data, as `records` names both."""
    record = record_of("means", data)
    rooms = "data of several configurations or with C80 or G" if data == ALL else data
    flagged = _flagged(record["flagged"])
    if verdict == UNKNOWN:
        return _in_rooms(rooms, flagged)
    if verdict not in record:
        detected = record["detected"]
        missed = _of(Share(detected.of - detected.count, detected.of), "hidden effects", "were not")
        missed = missed.replace("were not", "were not detected")
        proof = "so a search without a result does not prove that nothing is missing"
        return _in_rooms(rooms, f"{missed}, {proof}")
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
    if f.kind != "means":
        some = [c for c in f.candidates if c.probability >= SAID and f.verdict != NONE]
        rows = [
            Row(called(c), [percent(c.probability), c.in_words.replace(f"({_INTERVAL} ", "(")])
            for c in some[:8]
        ]
        corner = "change" if f.kind == "states" else "effect"
        return Table(["probability", f"size ({_INTERVAL})"], rows, corner=corner) if rows else None
    rows = [
        Row(called(name), [percent(p), odds(f.evidence[name]) if name in f.evidence else ""])
        for name, p in f.probabilities.items()
        if p >= least
    ]
    there, title = (
        "probability of being there",
        "Candidates. Odds: the model with the effect against ",
    )
    title += "the model without it."
    if not f.more_than_one:
        there = "probability"
        title += " Probability: these odds times the prior odds of the effect, as a share of all."
    return Table([there, "odds by the data"], rows, title, corner="effect")


def numbers(f: Finding) -> list[Block]:
    """Return tables by band: deviations for means; T and its change for two states.

    Means in several configurations have one table, of the rows in which a band deviates much.
    """
    if f.kind == "states":
        return [_of_two(f)]
    tables = deviations(f, f.residuals) if f.kind == "means" else []
    if len(tables) < 2:
        return [*tables]
    rows = [
        replace(row, name=f'{row.name} of "{c.name}"')
        for c, table in zip(f.case.configurations, tables, strict=True)
        for row in table.rows
    ]
    large = [r for r in rows if np.nanmax(np.abs(np.asarray(r.values, float))) >= marks.LARGE_Z]
    if not large:
        return [
            Note(f"{_DEVIATION}: less than {marks.LARGE_Z:g} in every band of every parameter.")
        ]
    left_out = len(rows) - len(large)
    less = f"{left_out} rows with values below {marks.LARGE_Z:g} in every band are left out."
    return [Table(tables[0].columns, large, _DEVIATION, note=less if left_out else "")]


def _of_two(f: Finding) -> Table:
    """Return T of two states and the change of the absorption area, by band."""
    case, measured = f.case, np.flatnonzero(f.case.known)
    width = f.change[2] - f.change[1]
    known = width[np.isfinite(width) & (width > 0)]
    # So many decimals that the interval shows its width.
    digits = int(np.clip(np.ceil(-np.log10(known.min() / 2)), 1, 6)) if len(known) else 1
    columns = {
        "T before / s": [f"{t:.2f}" for t in case.times[0, measured]],
        "T after / s": [f"{t:.2f}" for t in case.times[1, measured]],
        "absorption area / m²": [f"{area:.1f}" for area in f.area[measured]],
        f"change / m² ({_INTERVAL})": [
            f"{mean:+.{digits}f} ({low:+.{digits}f} to {high:+.{digits}f})"
            if np.isfinite([mean, low, high]).all()
            else "not tried"
            for mean, low, high in f.change[:, measured].T
        ],
    }
    return Table.of_columns(bands.labels(case.room.centre_frequencies[measured]), columns)


def deviations(f: Finding, residuals: Array, of: str = "") -> list[Table]:
    """Return tables of the deviations of each configuration; ``of`` names the effects in the model."""
    made, labels = list[Table](), bands.labels(f.case.room.centre_frequencies)
    for c, by_feature in zip(f.case.configurations, residuals, strict=True):
        named = zip(feature_names(c.measured), by_feature, strict=True)
        rows = [
            Row(name, row, "+z.1f", row / _STRONG) for name, row in named if np.isfinite(row).any()
        ]
        where = f' of "{c.name}"' if len(f.case.configurations) > 1 else ""
        made.append(Table(labels, rows, _DEVIATION.replace(" (", f"{where}{of} (", 1)))
    return made


def blocks(f: Finding, verification: Verification | None = None) -> list[Block]:
    """Return a finding as blocks: the answer, cautions, next step, candidates, data and evidence."""
    table, step = candidates(f), first_step(f, verification)
    first = [
        " ".join(headline(f)),
        *(f"Caution: {said}" for said in cautions(f)),
        "" if verification is None else verification.sentence,
        f"Next: {step}" if step else "",
    ]
    last = [evidence(f), track_record(f), *(f"Note: {n}" for n in noted(f))]
    return [
        *map(Note, filter(None, first)),
        *([] if table is None else [table]),
        *(Note(said, "  ") for said in details(f)),
        *numbers(f),
        *map(Note, filter(None, last)),
    ]


def noted(f: Finding) -> list[str]:
    """Return the notes as sentences, without those that the answer or a caution states already."""
    known = {"Schroeder"} if any(r.code == "below Schroeder" for r in f.reasons) else set()
    known |= {EQUATION_OFF} if f.verdict == NONE else set()

    def adds(note: Reason | str) -> bool:
        if isinstance(note, str) or note.code != "uncertainties":
            return isinstance(note, str) or note.code not in known
        return bool(note.values["origins"].get("made"))

    return [as_sentence(str(n)) for n in f.notes if adds(n)]


def added(f: Finding, members: tuple[str, ...]) -> str:
    """Return a sentence on the effects that `Finding.apply` adds, and on the other candidates."""
    each = [(name_of(f, n), percent(f.probabilities.get(n, 0.0))) for n in members]
    some = listed([f"{name} (probability {p})" for name, p in each])
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
    rows, alike_of = list[Row](), list[Block]()
    for name, change in p.reached.items():
        others = [other for other in p.reached if other != name]
        alike = [called(n) for n in others if p.separations[name, n] < DISTINCT_NATS]
        apart = [called(n) for n in others if p.separations[name, n] >= DISTINCT_NATS]
        nats, counted = p.separations[name, NONE], f"{len(alike)} of {len(others)}"
        rows.append(Row(called(name), [f"{100 * change:.1f} %", odds(nats), counted]))
        said = listed(alike) or "no other effect"
        if len(alike) > len(apart):
            said = f"all but {listed(apart)}" if apart else "all others"
        alike_of.append(Note(f"{called(name)}: {said}", "  "))
    detectable = say(
        "detectable",
        measured=[parameter_label(n) for n in p.parameters],
        shown=sum(p.separations[name, NONE] >= DISTINCT_NATS for name in p.reached),
        number=len(rows),
        nats=DISTINCT_NATS,
        change=100 * p.change,
        more="" if every else "; --all names them",
    )
    named = Note("Effects that these data do not distinguish:", hanging="")
    return [
        *_proposed(p),
        Note(detectable, hanging=""),
        Table(["change of T", "odds by the data", "not distinguished from"], rows, corner="effect"),
        *([named, *alike_of] if every else []),
    ]


def _proposed(p: Plan) -> list[Block]:
    """Return what to measure next, the best first; nothing where nothing is proposed."""
    if not p.proposals:
        return []
    if p.uncertainty < _OPEN:
        return [Note(say("settled"), hanging=""), Note("")]

    def share(information: float) -> str:
        return f"{100 * information / p.uncertainty:.0f} %"

    rows = [
        Row(str(m.measurement), [share(m.information), f"{m.cost:g} h", share(m.per_cost)])
        for m in p.proposals
    ]
    first = p.sequence[0]
    best = ", more per hour than any other proposal" * (len(rows) > 1)
    stated = {"share": share(first.information), "number": np.exp(p.uncertainty), "best": best}
    order = listed([f"{m.measurement} ({share(m.information)})" for m in p.sequence])
    return [
        Note(say("propose", what=first.measurement, cost=first.cost, **stated), hanging=""),
        Table(["uncertainty removed", "time", "per hour"], rows, corner="measurement"),
        Note(say("in order", order=order), hanging=""),
        Note(""),
    ]


def of_places(f: Finding, places: Sequence[Place]) -> list[Block]:
    """Return where a further receiver would distinguish the surfaces that are in question."""
    answer = Note(" ".join(headline(f)))
    if not places:
        return [Note(say("no receiver")), answer, Note(say("plan others"))]
    where = [f"{', '.join(f'{x:.2f}' for x in p.point)} m" for p in places]
    rows = [Row(at, [p.source, f"{p.pairs:.1f}"]) for at, p in zip(where, places, strict=True)]
    best, number = places[0], len(f.pairs)
    of_best = {"source": best.source, "pairs": best.pairs, "surfaces": f.likely_surfaces}
    said = [say("receiver", at=where[0], number=number, **of_best)]
    said += [say("not enough")] if number / 2 < best.pairs else []
    table = Table(["source", "worth in measured pairs"], rows, corner="receiver")
    return [Note(" ".join(said)), answer, table]


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
    title = f"alpha{of_pieces} ± half its {_INTERVAL}, means over bands"
    return [Table([*alphas], rows, title), *(Note(line, "  ") for line in effects_of(r))]
