"""Evidence in nats as odds, which pages print in place of it."""

from __future__ import annotations

import re
from functools import partial

import numpy as np

MOST = 1e6
"""Largest odds that are printed as a number: no model is known so well."""
_NUMBER = r"([+−-]?\d+(?:\.\d+)?)"
_ONE = rf"{_NUMBER} nats"
_TWO = rf"{_ONE}(; threshold:?|; it must exceed| instead of| of the) {_NUMBER}(?: nats)?"
_EXPLAINED = re.compile(
    r" ?(\(2\.3 nats are odds of ten to one\)|2\.3 nats are odds of ten to one\.)"
)
"""What explains nats, and nothing else."""
_FACTORS = (
    (rf"{_ONE} (more|less) probable", "{0} times {1} probable"),
    (rf"{_ONE} (better|worse)", "{0} times {1}"),
    (rf"a standard deviation of {_ONE}", "a standard deviation of a factor of {0}"),
)


def odds(nats: float) -> str:
    """Return evidence in nats as odds, to two digits.

    Examples
    --------
    >>> odds(2.3026), odds(-4.0), odds(0.0), odds(40.0)
    ('10 to 1', '1 to 55', 'even', 'over a million to 1')
    """
    times = _times(abs(nats))
    if times == "1":
        return "even"
    return f"{times} to 1" if nats > 0 else f"1 to {times}"


def in_odds(sentence: str) -> str:
    """Return a sentence with odds in place of nats.

    Examples
    --------
    >>> in_odds("Evidence: +4.6 nats; threshold 2.3.")
    'Evidence: odds of 99 to 1; threshold 10 to 1.'
    >>> in_odds("They are 3.0 nats less probable with the effect.")
    'They are 20 times less probable with the effect.'
    >>> in_odds("Evidence: +4.6 nats; it must exceed 3.0. 2.3 nats are odds of ten to one.")
    'Evidence: odds of 99 to 1; it must exceed 20 to 1.'
    >>> in_odds("its evidence is +1.6 nats instead of +4.6")
    'its evidence is odds of 5 to 1 instead of 99 to 1'
    """
    sentence = _EXPLAINED.sub("", sentence)
    for pattern, words in _FACTORS:
        sentence = re.sub(pattern, partial(_factor, words), sentence)
    sentence = re.sub(_TWO, lambda m: f"{_odds_of(m[1])}{m[2]} {odds(_value(m[3]))}", sentence)
    return re.sub(_ONE, lambda m: _odds_of(m[1]), sentence)


def _factor(words: str, found: re.Match[str]) -> str:
    return words.format(_times(abs(_value(found[1]))), *found.groups()[1:])


def _odds_of(text: str) -> str:
    return f"odds of {odds(_value(text))}"


def _value(text: str) -> float:
    return float(text.replace("−", "-"))


def _times(nats: float) -> str:
    """Return a factor to two digits."""
    factor = float(np.exp(min(nats, 50.0)))
    if factor > MOST:
        return "over a million"
    digits = max(0, int(np.floor(np.log10(factor))) - 1)
    rounded = round(factor / 10**digits) * 10**digits
    return f"{rounded:,}" if factor >= 3 else f"{factor:.2g}"
