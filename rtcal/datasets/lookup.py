"""What a name means that people use for a material: the thing, what it is mounted on, and its entry.

The words of a name are brought to those of ``material_names.toml``: endings, compounds, misspelt words
and other languages are understood. The name is then taken apart. "Plaster on brick" is plaster, and
brick is what it is mounted on; "concrete block, painted" is a block. An entry is meant only if its
names account for every word that decides how sound is absorbed. Of several, the one is meant whose
names have most of the words: a painted concrete block is no painted concrete.
"""

from __future__ import annotations

import difflib
import re
import tomllib
import unicodedata
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import pairwise
from typing import Any

__all__ = ["Meaning", "Name", "meaning", "name_of", "table", "unstated", "words"]
__dir__ = __all__.copy

_LEAST_LIKENESS = 0.83
"""Share of the letters that a misspelt word has in common with the right one: 0.86 for "curtian"."""
_LEAST_LETTERS = 5  # Shorter words are not taken for misspelt ones: "sand" is no "band"
_LEAST_PART = 3  # Letters of a part of a compound, such as "tür"
_LEAST_END = 4
"""Letters of the known end of a compound, of which the first part is not known: Lehmputz is plaster."""
_LINKS = ("", "s", "n", "en", "es", "er")  # Letters between the parts of a German compound
_ENDINGS = ("s", "es", "e", "n", "en", "er", "em", "ed")
_THICKNESSES = (25.0, 50.0, 75.0, 100.0)  # mm: thicknesses in which porous absorbers are tabulated
_SAME_SIZE = 1.25  # Largest ratio of two thicknesses, or weights, that count as one
_MM = {"mm": 1.0, "cm": 10.0} | dict.fromkeys(('"', "″", "”", "in", "inch", "inches", "''"), 25.4)
_OF_POROUS = {"minwool", "glasswool", "rockwool", "fibreglass", "foam", "woodwool", "insulation"}
"""Words of absorbers whose thickness decides."""
_LENGTH = re.compile(
    r"(\d{1,4}(?:[.,]\d{1,4})?|\d{1,2}/[1-9]\d?)\s*-?\s*(mm|cm|inches|inch|in\b|\"|″|”|'')"
)
_WEIGHTS = (200.0, 338.0, 475.0, 610.0)
"""g/m²: weights in which curtains are tabulated; 10, 14 and 18 oz/yd² are the last three."""
_G_PER_M2 = {"oz": 33.906, "g": 1.0, "gsm": 1.0, "kg": 1000.0}
"""Weight of an area in g/m² of each unit; an ounce is of a square yard."""
_WEIGHT = re.compile(
    r"(\d{1,4}(?:[.,]\d{1,4})?)\s*-?\s*"
    r"(?:(oz)\b(?:\s*(?:/|per)\s*(?:sq\.?\s*)?yd2?)?|(gsm)\b|(k?g)\s*/\s*(?:m2|sqm|qm))"
)
_CAMEL = re.compile(r"(?<=[a-zß-ÿ])(?=[A-ZÀ-Þ])")
"""Where a word begins within one, as in ConcreteBlock."""


@dataclass(frozen=True)
class Name:
    """Hold the words of a name, as ``material_names.toml`` has them.

    ``thing`` are those of the thing, ``mounting`` of what it is mounted on or filled with, ``noun`` is
    the last of the thing, "" if unknown, and ``foreign`` are those that the file does not know.
    """

    thing: frozenset[str]
    mounting: frozenset[str] = frozenset()
    noun: str = field(default="", compare=False)
    foreign: frozenset[str] = field(default=frozenset(), compare=False)


@dataclass(frozen=True)
class Meaning:
    """Hold the entry that a name means, None for none, and the entries that are nearest to it."""

    entry: str | None
    nearest: tuple[str, ...]


@cache
def table(name: str = "material_names.toml") -> dict[str, Any]:
    """Return a whole file of the catalogue, by default that of the names."""
    return tomllib.loads(resources.files("rtcal.datasets").joinpath(name).read_text("utf-8"))


def _folded(text: str) -> str:
    """Return a text in small letters without accents."""
    apart = unicodedata.normalize("NFKD", text.lower().replace("ß", "ss"))
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


@cache
def _listed(name: str) -> frozenset[str]:
    return frozenset(_folded(table()["lists"][name]).split())


@cache
def _passing() -> frozenset[str]:
    return _listed("places") | _listed("passing")


@cache
def _synonyms() -> dict[str, str]:
    """Return the file's word for each other one."""
    file = table()
    of = {**dict.fromkeys(file["words"]), **dict.fromkeys(file["noun_first"])}
    return {_folded(word): word for word in of} | {
        _folded(other): word
        for part in ("noun_first", "words")
        for word, others in file[part].items()
        for other in others.split()
    }


@cache
def _noun_first() -> frozenset[str]:
    return frozenset(_folded(" ".join(table()["noun_first"].values())).split())


@cache
def _known() -> dict[str, str]:
    """Return each word that the file has anywhere, as it stands in the file's names."""
    file, same = table(), _synonyms()
    texts = [
        *(text for part in ("names", "pieces") for pair in file[part].items() for text in pair),
        *file["near"],
        *file["phrases"].values(),
        *(
            _folded(file["lists"][each])
            for each in ("places", "passing", "vague", "deciding", "coverings")
        ),
    ]
    words = (word for text in texts for word in re.findall(r"[^\W\d_]{2,}", _folded(text)))
    return {**{word: same.get(word, word) for word in words}, **same}


def _word(word: str) -> tuple[list[str], str]:
    """Return the file's words for one word, and the part of it that the file does not know.

    >>> _word("holzboden"), _word("curtian"), _word("lehmputz")
    ((['wood', 'floor'], ''), (['curtains'], ''), (['lehm', 'plaster'], 'lehm'))
    """
    known = _known()
    apart = _apart(word) or _apart(re.sub("([aou])e", r"\1", word))
    if apart is not None:
        return apart, ""
    like = [each for each in known if each[:2] == word[:2] and len(each) >= _LEAST_LETTERS]
    near = difflib.get_close_matches(word, like, 1, _LEAST_LIKENESS)
    if near and len(word) >= _LEAST_LETTERS:
        return [known[near[0]]], ""
    ends = ((at, _apart(word[at:])) for at in range(_LEAST_PART, len(word) - _LEAST_END + 1))
    at, end = next((each for each in ends if each[1]), (0, None))
    if end is None or any(word[:k] in known for k in range(_LEAST_END, at)):
        return [word], word
    return [word[:at], *end], word[:at]


@cache
def _apart(word: str) -> list[str] | None:
    """Return the file's words for a word, or for the parts of a compound; None for another word."""
    known = _known()
    if word in known:
        return [known[word]]
    stems = (word.removesuffix(end) for end in _ENDINGS if word.endswith(end))
    if stem := next((known[each] for each in stems if len(each) > 2 and each in known), None):
        return [stem]
    for at in range(len(word) - _LEAST_PART, _LEAST_PART - 1, -1):
        for link in _LINKS:
            first = word[:at].removesuffix(link)
            whole = word[:at].endswith(link) and len(first) >= _LEAST_PART and first in known
            if whole and (rest := _apart(word[at:])) is not None:
                return [known[first], *rest]
    return None


def words(text: str) -> set[str]:
    """Return all words of a text that say what it is, as the file has them."""
    name = name_of(text)
    return {word for word in name.thing | name.mounting if not _of_size(word)} - _passing()


@cache
def name_of(text: str) -> Name:
    """Return the words of a name, taken apart.

    >>> name_of("Plaster on brick").thing, name_of("plaster on brick").mounting
    (frozenset({'plaster'}), frozenset({'brick'}))
    """
    read, tokens = _Reader(), re.findall(r"\d+(?:mm|gsm)|[^\W\d_]{2,40}|[,;:()]", _plainly(text))
    for before, token in pairwise(("", *tokens)):
        read.token(token, is_covered=before in _listed("covered"))
    last = "" if read.noun in read.foreign and read.noun_first else read.noun
    thing, mounting, foreign = map(frozenset, (read.thing, read.mounting, read.foreign))
    return Name(thing, mounting, read.stated or last, foreign)


def _plainly(text: str) -> str:
    """Return a text in small letters, with sizes and what is said in several words as words."""
    plain = _LENGTH.sub(_thickness, _WEIGHT.sub(_weight, _folded(_CAMEL.sub(" ", text))))
    plain = re.sub(r"[_\-/&+]", " ", plain)
    for phrase, word in sorted(table()["phrases"].items(), key=lambda each: -len(each[0])):
        plain = re.sub(rf"\b{_folded(phrase).replace(' ', '[ ]+')}s?\b", word, plain)
    return plain


class _Reader:
    """Read a name word by word: a word is of the thing, of its mounting, or of what it is without."""

    def __init__(self) -> None:
        self.thing = list[str]()
        self.mounting = list[str]()
        self.foreign = set[str]()
        self.noun = ""
        self._where = self.thing
        self._before = ""
        self._of_noun, self.noun_first = True, False
        self.stated = ""

    def token(self, token: str, *, is_covered: bool) -> None:
        """Read one word, thickness or mark; the word before may say that it covers the thing."""
        if token in ",;:()":
            self._of_noun = self._of_noun and not self.thing
            if token in "()" or self._where is not self.mounting:
                self._where = self.thing
        elif token in _listed("without"):
            self._where = []
        elif self.noun_first and token in _listed("of_noun_first"):
            self._before = token
        elif token in _listed("before_surface") and is_covered:
            self.mounting += self.thing
            self.thing.clear()
            self._where, self._of_noun = self.thing, True
        elif token in _listed("before_mounting"):
            self._before = token
            if self.thing and self._where is self.thing:
                self._where = self.mounting
        elif _of_size(token):
            self._where.append(token)
        else:
            self._add(token)

    def _add(self, token: str) -> None:
        words, foreign = _word(token)
        covers = self._before in _listed("with") and {*words} & _listed("coverings")
        moved = self._where is self.mounting and (covers or {*words} & _listed("deciding"))
        (self.thing if moved else self._where).extend(words)
        self.foreign |= {foreign} - {""}
        self.noun_first = self.noun_first or token in _noun_first()
        if self.noun_first and self._before in _listed("of_noun_first"):
            self.stated = self.stated or foreign
        if self._where is self.thing and self._of_noun:
            nouns = [word for word in words if word not in _passing()]
            self.noun = nouns[-1] if nouns else self.noun


def _of_size(word: str) -> bool:
    return word[0].isdigit()


def _thickness(found: re.Match[str]) -> str:
    """Return a thickness as a word, such as 50mm, of those in which absorbers are tabulated."""
    top, _, bottom = found[1].replace(",", ".").partition("/")
    return f" {_tabulated(float(top) / float(bottom or 1) * _MM[found[2]], _THICKNESSES):.0f}mm "


def _weight(found: re.Match[str]) -> str:
    """Return a weight of an area as a word, such as 610gsm, of those that curtains have."""
    unit = found[2] or found[3] or found[4]
    return f" {_tabulated(float(found[1].replace(',', '.')) * _G_PER_M2[unit], _WEIGHTS):.0f}gsm "


def _tabulated(size: float, sizes: Collection[float]) -> float:
    """Return the one of ``sizes`` that is nearest to a size; the size itself if none is the same."""
    near = min(sizes, key=lambda each: abs(each - size))
    return near if size > 0 and max(near / size, size / near) <= _SAME_SIZE else size


@cache
def _called(part: str) -> dict[Name, str]:
    """Return the entries of a table of the file by the names that people have for them."""
    return {
        name_of(each): entry for entry, names in table()[part].items() for each in names.split(",")
    }


def meaning(text: str, part: str, described: Mapping[str, str]) -> Meaning:
    """Return what a name means of the entries ``described``."""
    asked = name_of(text)
    passing, places = _passing(), _listed("places")
    stated = _called(part)
    others = (entry for entry in described if entry not in stated.values())
    called = {name_of(entry): entry for entry in others} | stated
    left, rank = dict[str, int](), dict[str, tuple[int, ...]]()
    for name, entry in called.items():
        if entry not in described or not name.thing or not name.thing <= asked.thing:
            continue
        if not name.mounting <= asked.mounting | asked.thing:
            continue
        own = name.thing | name.mounting | _own(entry, described[entry])
        unlike = _unaccounted(asked, name, own, weak=name.thing <= passing | _listed("vague"))
        value = (
            -len(unlike),
            len((name.thing | name.mounting) - passing),
            len((name.thing | name.mounting) - places),
            len(name.thing | name.mounting),
            asked.noun in name.thing,
            len(name.mounting & asked.mounting),
            -len(name.mounting - asked.mounting),
        )
        if value > rank.get(entry, (-99,)):
            rank[entry], left[entry] = value, len(unlike)
    order = sorted(rank, key=lambda entry: rank[entry], reverse=True)
    if order and not left[order[0]]:
        return Meaning(order[0], tuple(entry for entry in order[1:] if not left[entry]))
    named = [entry for entry in order if rank[entry][4]]
    return Meaning(None, (*dict.fromkeys((*named, *_near(asked.thing), *order)),))


def unstated(text: str, entry: str, description: str) -> list[str]:
    """Return the thicknesses and weights of a name that an entry does not state.

    >>> unstated("plywood, 18 mm", "plywood_10mm", "Plywood panelling, 1 cm thick")
    ['18 mm']
    """
    own = {word for word in _own(entry, description) if _of_size(word)}
    found = (*_LENGTH.finditer(_folded(text)), *_WEIGHT.finditer(_folded(text)))
    return [each[0].strip() for each in found if name_of(each[0]).thing - own]


def _own(entry: str, description: str) -> frozenset[str]:
    mounted = (how for how, of in table()["mounting"].items() if entry in of.split())
    of = (*map(name_of, (entry, description, *mounted)),)
    return frozenset().union(*(name.thing | name.mounting for name in of))


def _unaccounted(asked: Name, name: Name, own: Collection[str], weak: bool) -> set[str]:
    """Return words of a name that an entry, with its ``own`` words, does not account for.

    Words that the file does not know may stand beside a known noun, not beside a place alone
    (``weak``).
    """
    of_size = {word for word in asked.thing | asked.mounting if _of_size(word)}
    others = asked.thing - _passing() - asked.foreign - of_size
    if asked.noun in asked.foreign:
        others |= {asked.noun}
    if weak:
        others |= asked.foreign & asked.thing
    if asked.thing & _OF_POROUS and any(map(_of_size, own)):
        others |= of_size
    of_kind = {kind for kind, each in table()["kinds"].items() if {*each.split()} & {*own}}
    return {*others} - {*own} - of_kind


def _near(thing: frozenset[str]) -> list[str]:
    """Return the entries that the file has beside things of which there is no entry."""
    same = _known()
    return [
        entry.strip()
        for things, near in table()["near"].items()
        if thing & {same.get(each, each) for each in _folded(things).split()}
        for entry in near.split(",")
    ]
