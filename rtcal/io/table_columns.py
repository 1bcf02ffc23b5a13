"""The columns of a table of measured values, and the words of their headers, rows and cells.

A header names a parameter, a band, a position or a value, with or without its unit, in the usual
English and German spellings; in Spanish, French, Italian and Portuguese as exports of measuring systems
and of students' programs have them. A word is compared without case, blanks and punctuation (`plain`).
"RT60" may be T20 or T30, which the user must state.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from rtcal.acoustics import bands
from rtcal.acoustics.observables import (
    OBSERVABLES,
    REVERBERATION,
    Observable,
    observable,
    parameter_label,
)
from rtcal.io.text import shown
from rtcal.support.errors import DataError
from rtcal.support.types import Array


def plain(text: str) -> str:
    """Return a word as it is compared.

    Examples
    --------
    >>> plain("Octave band"), plain("T-30"), plain("T60(20)")
    ('octaveband', 't30', 't6020')
    """
    return re.sub(r"[\W_]+", "", text.lower())


def _words(text: str) -> list[str]:
    return text.split()


def parameters() -> Mapping[str, str]:
    """Return an observable's key by its spellings, of those that are registered by now."""
    return _by_spelling(tuple(OBSERVABLES.values()))


@lru_cache(maxsize=1)  # every cell of a table asks
def _by_spelling(observables: tuple[Observable, ...]) -> Mapping[str, str]:
    return {plain(word): o.key for o in observables for word in (o.key, o.label, *o.spellings)}


OPEN_DECAY_TIMES = frozenset(
    _words(
        "rt rt60 rt60s t60 t tr tr60 reverberationtime reverbtime nachhallzeit tiempodereverberacion "
        "tempsdereverberation tempsderéverbération tempodiriverbero tempoderiverbero "
        "tempodiriverberazione tempodereverberação tempodereverberacao"
    )
)
"""Names of a decay time that do not say over which range it was taken."""

MEASURED = re.compile(r"measured|gemessene?|medido|mesuré|mesure")
"""A word before a parameter's name, as in "measured T30"."""

UNUSED_PARAMETERS = frozenset(
    _words(
        "t10 t15 t40 t50 topt toptstart toptend t60m tc tmid br bassratio treble brilliance "
        "c20 c7 c30 ct edtt tt lf lfc lfcearly lj lg glg stearly stlate st1 st2 sttotal "
        "spl lf80 lfc80 lg80 iacc iacce iaccearly iaccl iacclate tiacc wiacc inr snr itdg "
        "r r2 correlation correltn curvature nonlinearity xi leq lmax lbk "
        "lsg lno stg tus pks mscn imp signal noise tuser peakiness millisecs impulsivs "
        "btt20 bkt20 nlt20 cut20 sdt20 btt30 bkt30 nlt30 cut30 sdt30"
    )
)
"""Parameters and signs of quality that exports have beside those that are read. T10 is one of them: the
slope from -5 to -15 dB is no EDT, and programs write both. StG is AcouPar's strength:
its file does not say whether the level was calibrated. Nor does Aurora's, `UNCALIBRATED`."""

UNCALIBRATED = "strenGth"
"""Aurora's spelling of its strength."""

REMARKS = frozenset(
    _words(
        "remark remarks comment comments bemerkung bemerkungen kommentar kommentare observaciones"
    )
)
"""Headers of columns of words on a row, which are left out."""

WHOLE_RANGES = frozenset(
    _words(
        "full wideband broadband bb all global overall total lin linear a dba mid single wide "
        "gesamt breitband bandaancha awtd aweighted cwtd"
    )
)
"""What stands in a column of bands for the whole range."""

COLUMNS = {
    **dict.fromkeys(
        _words(
            "source src quelle sourceposition fuente schallquelle quellposition lautsprecher "
            "loudspeaker speaker sender altavoz"
        ),
        "source",
    ),
    **dict.fromkeys(
        _words(
            "receiver rec mic microphone position pos empfänger empfaenger mikrofon receiverposition "
            "measurement messposition posición posicion micrófono microfono receptor"
        ),
        "receiver",
    ),
    **dict.fromkeys(_words("parameter quantity metric parámetro parametro"), "parameter"),
    **dict.fromkeys(
        _words(
            "band bands frequency frequencies freq freqs f fc frequenz frequenzen octaveband octave "
            "octaves oktave terz oktavband terzband thirdoctaveband octavebandcentrefrequency "
            "octavebandcenterfrequency mittenfrequenz centrefrequency centerfrequency "
            "centrefrequencies centerfrequencies bandcentre bandcenter hz "
            "frecuencia frecuencias fréquence fréquences frequence frequenza frequenze "
            "frequência frequencia banda bandas bande frqband"
        ),
        "band",
    ),
    **dict.fromkeys(_words("value wert mean mittelwert measured gemessen valor valeur"), "value"),
    **dict.fromkeys(_words("stat statistic statistik"), "statistic"),
    **dict.fromkeys(_words("uncertainty unsicherheit"), "uncertainty"),
    "commonuncertainty": "common_uncertainty",
    **dict.fromkeys(
        _words("standarddeviation stdev std sd standardabweichung"), "standard_deviation"
    ),
    **dict.fromkeys(_words("file filename datei dateiname fichier archivo"), "file"),
    "sources": "sources",
    "receivers": "receivers",
    **dict.fromkeys(_words("unit einheit unidad unidade unité unità"), "unit"),
}
"""What a column holds (`rtcal.io.table_columns.Column.kind`) by its header."""

_MEANS = frozenset(
    _words(
        "mean means meanvalue average averages averaged avg mittel mittelwert mittelwerte mw mittelung "
        "gemittelt durchschnitt moyenne moyennes moy promedio media média medio medie gemiddelde "
        "gesamt gesamtmittel gesamtmittelwert raummittel raummittelwert insgesamt total overall "
        "ensemble ø ∅ µ x̄"
    )
)
_DEVIATIONS = frozenset(
    _words(
        "sd std stdev stddev stdabw stabw standardabw standardabweichung stdabweichung abw sigma σ "
        "deviation deviazione desviación desviacion desvio écart ecart dev"
    )
)
_OTHER_STATISTICS = frozenset(
    _words(
        "min max minimum maximum median mediane médiane mediana range spannweite streuung variance "
        "varianz standardfehler sem error cv percentile perzentil quantile uncertainty unsicherheit "
        "messunsicherheit incertitude incertidumbre incertezza incerteza"
    )
)
_COUNTS = frozenset(_words("n count anzahl nombre"))
_NO_POSITIONS = frozenset(
    _words(
        "soll sollwert target limit grenzwert anforderung requirement toleranz tolerance result "
        "ergebnis résultat resultado risultato summe sum somme suma summary zusammenfassung jnd"
    )
)
"""What is no place either: a row called so is refused, since it may be anything."""
_ALL = frozenset(_words("all alle every tous toutes todos todas tutti tutte"))
_SHORT = frozenset(_words("mw moy sd std dev abw sigma σ µ"))
"""Statistics that numbered places may be called, too: "MW 1" is a place, "Mean 1" is in doubt."""
_BEFORE_COUNT = frozenset(
    _words("n k of von aus over über ueber sur de des di dei del do da su sobre")
)
_OF_STATISTICS = frozenset(
    _words(
        "all alle aller allen every the der die das les la le el los las y and und et tous toutes "
        "todos todas tutti tutte pos position positions positionen posiciones posición posicion "
        "posizioni posições mic mics microphone microphones mikrofon mikrofone mikrofonen receiver "
        "receivers empfänger receptores récepteurs source sources quelle quellen measurement "
        "measurements messung messungen medidas mesures misure point points punkt punkte punkten "
        "puntos punti value values wert werte valor valeur room raum spatial spatiale räumlich "
        "räumliche räumlicher räumliches espacial spaziale arithmetic arithm arithmetisch "
        "arithmetische arithmetischer arithmetisches arithmétique aritmética aritmetica number "
        "standard estándar estandar padrão padrao type pairs paare combinations kombinationen s sec "
        "ms"
    )
)
_SEPARATORS = re.compile(r"[\s()\[\]{},;:=/_+.\-\u2013]+")
_IN_BRACKETS = re.compile(r"[(\[]\s*(\d+)\s*[)\]]")
_EXPANDED = re.compile(r"u\w?\s*[(\[]?\s*k\s*=.*")

DOUBTFUL = "?"
"""`statistic_of` a name that may be a statistic's, and may be a place's."""


def statistic_of(name: str) -> str | None:
    """Return the statistic over positions that a row, column or sheet is called after.

    It is "value" for a mean, "standard_deviation", and "" for one that is not read (the least, the
    median, a number of positions). `DOUBTFUL` is returned for a name with such a word and others, and
    None for any other name.

    Examples
    --------
    >>> [statistic_of(n) for n in ("Mean (n=2)", "T20 mean", "Mittel (alle)", "écart-type", "Max of 6")]
    ['value', 'value', 'value', 'standard_deviation', '']
    >>> [statistic_of(n) for n in ("Mean stalls", "Mean 2", "Mittelgang", "R2", "MW 2")]
    ['?', '?', None, None, None]
    """
    name = name.strip().lower()
    if not name or len(name) > _LONGEST_STATISTIC:
        return None
    if _EXPANDED.fullmatch(name):
        return ""
    in_brackets = _IN_BRACKETS.findall(name)
    words = [w for token in _SEPARATORS.split(name) if token for w in _parts(token)]
    if len(words) == 1 and words[0] in _COUNTS:
        return ""
    if words and all(w in _NO_POSITIONS or _is_parameter(w) for w in words):
        return DOUBTFUL if any(w in _NO_POSITIONS for w in words) else None
    if {"number", "nombre", "anzahl"} & {*words[:1]} and all(
        w in _OF_STATISTICS | _BEFORE_COUNT | _COUNTS for w in words
    ):
        return ""
    named = [w for w in words if w in _MEANS | _DEVIATIONS | _OTHER_STATISTICS]
    if not named:
        of_all = {*words} & _ALL and {*words} <= _OF_STATISTICS | _BEFORE_COUNT
        return DOUBTFUL if of_all else None
    bare = False
    for i, word in enumerate(words):
        if word.isdecimal():
            before, after = words[i - 1] if i else "", words[i + 1] if i + 1 < len(words) else ""
            bare |= not (word in in_brackets or before in _BEFORE_COUNT or after in _OF_STATISTICS)
        elif word not in named and not (
            word in _OF_STATISTICS | _BEFORE_COUNT or _is_parameter(word)
        ):
            return None if {*named} <= _OTHER_STATISTICS else DOUBTFUL
    if bare:
        return None if {*named} <= _SHORT | _OTHER_STATISTICS else DOUBTFUL
    if any(w in _OTHER_STATISTICS for w in named):
        return ""
    return "standard_deviation" if any(w in _DEVIATIONS for w in named) else "value"


def is_count(name: str) -> bool:
    """Return whether a row is called after the number of positions, as a place to the north may be."""
    return name.strip().lower() in _COUNTS


_LONGEST_STATISTIC = 80


def _parts(token: str) -> list[str]:
    """Return the words of one that is written together, as "T20mean" and "Mean6" are."""
    if token in _MEANS or _is_parameter(token):
        return [token]
    for word in sorted(_MEANS, key=len, reverse=True):
        if len(word) > 2 and token != word and word in (token[: len(word)], token[-len(word) :]):
            rest = token[len(word) :] if token.startswith(word) else token[: -len(word)]
            if rest.isdecimal() or _is_parameter(rest):
                return [word, rest] if token.startswith(word) else [rest, word]
    return [token]


def _is_parameter(word: str) -> bool:
    return word in parameters() or word in OPEN_DECAY_TIMES or word in UNUSED_PARAMETERS


FORMULA_ERRORS = ("#div/0!", "#wert!", "#value!")
"""What a spreadsheet shows for a formula that has no result."""

_MISSING = frozenset(["k. a.", *_words("na n/a n.a. k.a. #n/a #nv"), *FORMULA_ERRORS])
_NO_DIGIT = re.compile(r"[-*.,\s\u2212\u2013\u2014]*")


def is_missing(cell: str) -> bool:
    """Return whether a cell has no value: it is empty, a dash of any kind or a word for it.

    Examples
    --------
    >>> is_missing("--.--"), is_missing("N/A"), is_missing("-1.5")
    (True, True, False)
    """
    return bool(_NO_DIGIT.fullmatch(cell)) or cell.lower() in _MISSING


MAX_HEADER = 200
"""Largest length of a header in characters; the patterns are slow on longer ones."""

LEAST_BAND = 10.0
"""Least centre frequency in Hz. A smaller number is no band but a value, so the line is no header."""

BAND_TOLERANCE = 0.03
"""Largest relative difference of a stated frequency from the exact centre of its band. Neighbouring
thirds are 26 % apart. BRAS's published tables write 155 Hz for the third of 158.5 Hz, which is
called 160 Hz."""

DECAY_TIMES_OF_RT60 = tuple(o.key for o in REVERBERATION)
"""What a column RT60 may hold (ISO 3382-2). An early decay time is never called so."""

_SCALES: dict[str, dict[str, float]] = {
    "s": {"s": 1, "sec": 1, "ms": 1e-3},
    "dB": {"db": 1},
    "": {"%": 0.01, "percent": 0.01, "-": 1, "1": 1},
}
UNIT_WORDS = {"hz", "khz", "s", "sec", "ms", "db", "%", "percent", "-", "1"}

_POSITION = re.compile(
    r"(L?S\d+|[FQ]\d+|(?:src|source|quelle|lautsprecher)[\s_.]*\d+)[\s_,-]*"
    r"((?:(?:MP|M|R|P)|(?:rec|receiver|mic|microphone|mikrofon|pos|position)[\s_.]*)\d+"
    r"(?:\s*#\d+)?)",
    re.I | re.ASCII,
)  # source and receiver; F1-P1 is Spanish, Q1-M1 German
_RECEIVER = re.compile(
    r"(?:MP|M|R|P|rec|receiver|mic|microphone|pos|position|mikrofon|messposition)"
    r"[\s_.-]*\d+(?:\s*#\d+)?",
    re.I | re.ASCII,
)
_REPEAT = re.compile(
    r"(.*?\d)(?:\s*\((\d+)\)|_(\d+)|[\s_]+(?:sweep|take|run|rep|repeat|messung|wdh)[\s_.-]*(\d+))",
    re.I | re.ASCII,
)
_CHANNEL = re.compile(r"(?<![A-Za-z])(?:ch|channel)[\s._]*(\d+)(?!\w)", re.I | re.ASCII)
_BRACKETS = re.compile(r"([^\[\](]*(?:\(\d+\))?)\s*[\[(]\s*([^\])]*?)\s*[\])]")
_UNIT_WITHIN = re.compile(r"([^\[\](]*\S)\s*[\[(]\s*(%|percent|m?s|sec|db)\s*[\])]\s*(\S.*)", re.I)
_SUFFIX = re.compile(r"(.*?\S)(?:\s*/\s*|\s+in\s+|\s+|_)(%|percent|k?hz|m?s|sec|db)", re.I)
_BOTH = re.compile(r"(\S.*?)[\s_@:,]+(?:at\s+)?(\d[\d.,]*\s*k?(?:hz)?)", re.I)
_CORRELATION = re.compile(r"-?\s*r[\s(]*T\d+\s*\)?")
"""Of a decay with a straight line, as "r(T20)", "-r T30" and "rT30"; "RT30" is T30."""
_OF_WHOLE_RANGE = re.compile(rf"(\S.*?)[\s_@:,]+(?:{'|'.join(sorted(WHOLE_RANGES))})", re.I)
_FREQUENCY = re.compile(r"(\d{1,6}(?:[.,]\d{1,6})?)\s*(k?)(?:Hz)?", re.I | re.ASCII)


@dataclass(frozen=True)
class Column:
    """The meaning of a column.

    Parameters
    ----------
    kind : str
        "data" for a column of values of the ``parameter``, the ``band`` or both. Other columns hold:
        "source", "receiver", "parameter", "band", "value", "unit", "statistic", "uncertainty",
        "common_uncertainty", "standard_deviation", "sources", "receivers" or "file", whose name may
        have source and receiver in it; "" for an ignored column.
    header : str
    parameter : str
        Empty if each row names it.
    band : float
        In Hz; NaN if each row names it.
    unit : str
        Empty if the header has none.
    decay_time_open : bool
        Whether the header, such as "RT60", does not say which decay time it is.
    source, receiver : str
        The position of all values of the column, such as "S1R2"; empty if each row names it.
    """

    kind: str
    header: str = ""
    parameter: str = ""
    band: float = np.nan
    unit: str = ""
    decay_time_open: bool = False
    source: str = ""
    receiver: str = ""

    @property
    def has_band(self) -> bool:
        """Whether the header names a band."""
        return bool(np.isfinite(self.band))

    def completed(self, below: Column) -> Column | None:
        """Return the column of two merged headers, such as one with the parameter, one with the band.

        None for headers that are no values, that state the same, or of which one states nothing.
        """
        if self.kind != "data" or below.kind != "data":
            return None
        both = [
            (bool(c.parameter), c.has_band, bool(c.receiver)) for c in (self, below)
        ]  # what each states
        if not all(map(any, both)) or any(a and b for a, b in zip(*both, strict=True)):
            return None
        named = self if self.parameter else below
        placed = self if self.receiver else below
        return replace(
            self,
            header=f"{self.header}, {below.header}",
            parameter=named.parameter,
            band=self.band if self.has_band else below.band,
            unit=named.unit,
            decay_time_open=named.decay_time_open,
            source=placed.source,
            receiver=placed.receiver,
        )

    def description(self, stated: str | None) -> str:
        """Return the meaning of the column in words; ``stated`` is the user's parameter."""
        content = self.kind.replace("_", " ") or "left out"
        if self.kind == "data":
            name = self.parameter or stated
            content = parameter_label(name) if name else "the row's parameter"
            if self.has_band:
                content += f" at {bands.label(self.band)}"
            if self.receiver:
                content += f" of {self.source or 'S1'} to {self.receiver}"
            scale = scale_of(self.parameter, self.unit, "") if self.parameter else 1
            if scale != 1:
                content += f", times {scale:g}"
        return f'"{self.header}": {content}'


def position_of(text: str) -> tuple[str, str] | None:
    """Return source and receiver of a position's name, "" for no source; None for another text.

    Examples
    --------
    >>> position_of("S1R2#2"), position_of("Src1 Mic2"), position_of("Mic 3"), position_of("T20")
    (('S1', 'R2#2'), ('Src1', 'Mic2'), ('', 'Mic 3'), None)
    """
    text = text.strip()
    if len(text) <= MAX_HEADER:
        if both := _POSITION.fullmatch(text):
            return both[1], both[2]
        if _RECEIVER.fullmatch(text):
            return "", text
    return None


def repeat_of(text: str) -> str | None:
    """Return the name of a repeat that is named in another usual way; None for another text.

    Examples
    --------
    >>> [repeat_of(name) for name in ("S1R3 (1)", "S1R3_2", "S1R3 sweep 3", "S1R3")]
    ['S1R3#1', 'S1R3#2', 'S1R3#3', None]
    """
    match = _REPEAT.fullmatch(text.strip()) if len(text) <= MAX_HEADER else None
    if not match or "#" in match[1] or not position_of(match[1]):
        return None
    return f"{match[1].strip()}#{match[2] or match[3] or match[4]}"


def with_repeats(cells: Sequence[str]) -> list[str]:
    """Return a row's cells with the names of repeats as ``S1R3#2``: numbered, where they are alike.

    Examples
    --------
    >>> with_repeats(["Hz", "S1R1", "S1R3", "S1R3"]), with_repeats(["Hz", "S1R3 (1)", "S1R3 (2)"])
    (['Hz', 'S1R1', 'S1R3', 'S1R3#2'], ['Hz', 'S1R3#1', 'S1R3#2'])
    """
    named = [repeat_of(cell) or cell for cell in cells]
    of_place: dict[str, int] = {}
    for i, name in enumerate(named):
        if position_of(name):
            of_place[name] = of_place.get(name, 0) + 1
            if of_place[name] > 1:
                named[i] = f"{name}#{of_place[name]}"
    return named


def position_in(text: str) -> tuple[str, str] | None:
    """Return source and receiver that stand within a text, such as a file's name.

    Examples
    --------
    >>> position_in("hall S1_R2 06/11"), position_in("hall")
    (('S1', 'R2'), None)
    """
    both = re.search(rf"(?<![A-Za-z0-9]){_POSITION.pattern}(?![A-Za-z0-9])", text, _POSITION.flags)
    return (both[1], both[2]) if both else None


def channel_in(text: str) -> str | None:
    """Return the channel's number in a title or a position's name; None without one.

    Examples
    --------
    >>> channel_in("S1_R1 Ch 2"), channel_in("Channel 1 Parameters"), channel_in("Church 2")
    ('2', '1', None)
    """
    match = _CHANNEL.search(text) if len(text) <= MAX_HEADER else None
    return match[1] if match else None


def parameter_of(text: str, place: str, decay_time: str | None) -> str | None:
    """Return the parameter of a spelling, None for an unknown one; DataError for "RT60"."""
    if (word := _parameter_word(text)) in (known := parameters()):
        return known[word]
    if word in OPEN_DECAY_TIMES:
        if decay_time is None:
            raise DataError(
                f'{place}: "{shown(text)}" does not say which decay time it is; state '
                'decay_time="t20" or decay_time="t30"'
            )
        return decay_time
    return None


def leaves_decay_time_open(text: str) -> bool:
    """Return whether a spelling, such as "RT60", does not say which decay time it is."""
    return _parameter_word(text) in OPEN_DECAY_TIMES


def is_unused(text: str) -> bool:
    """Return whether a spelling is a parameter that rtcal has no use for, such as IACC.

    Examples
    --------
    >>> is_unused("IACC"), is_unused("T10 [s]"), is_unused("T10_500"), is_unused("T20")
    (True, True, True, False)
    """
    name = name_and_unit(text)[0]
    both = _BOTH.fullmatch(name)
    if name.partition(" ")[0] == UNCALIBRATED:
        return True
    if plain(name) in UNUSED_PARAMETERS or _CORRELATION.fullmatch(text.strip()):
        return True
    return bool(both and plain(both[1]) in UNUSED_PARAMETERS)


def _is_of_whole_range(name: str) -> bool:
    """Return whether a header is of a parameter over the whole range, such as "T20_A"."""
    of = _OF_WHOLE_RANGE.fullmatch(name)
    return bool(of and (is_unused(of[1]) or _parameter_word(of[1]) in parameters()))


def _parameter_word(text: str) -> str:
    word = plain(text)
    return MEASURED.sub("", word, count=1) if MEASURED.match(word) else word


def frequency_of(text: str) -> float | None:
    """Return a frequency in Hz, with or without its unit; None if the text is none."""
    match = _FREQUENCY.fullmatch(text.strip())
    if not match:
        return None
    value = float(match.group(1).replace(",", ".")) * (1000 if match.group(2) else 1)
    return value if value > 0 else None


def nearest_band(frequency: float) -> float | None:
    """Return the nominal band whose exact centre is within 3 % of a frequency, None without one.

    Examples
    --------
    >>> nearest_band(155), nearest_band(440)
    (160.0, None)
    """
    steps = np.arange(-19, 14)  # thirds from 12.5 Hz to 20 kHz
    exact: Array = 1000 * 10 ** (steps / 10)  # IEC 61260-1, Eq. 2
    nominal = [12.5, 16.0, *bands.THIRD_OCTAVES]
    nearest = int(np.argmin(np.abs(np.log(exact / frequency))))
    if frequency not in nominal and abs(frequency / exact[nearest] - 1) > BAND_TOLERANCE:
        return None
    return float(nominal[nearest])


def nominal_band(frequency: float, place: str) -> float:
    """Return the nominal band of a frequency; DataError if it is none within 3 %."""
    band = nearest_band(frequency)
    if band is None:
        raise DataError(f"{place}: {frequency:g} Hz is no octave or third-octave (IEC 61260-1)")
    return band


def column_of(header: str, place: str, decay_time: str | None) -> Column | None:
    """Return the column of a header, None if the header is unknown.

    Raises
    ------
    DataError
        If the header is incomplete: an unknown unit, "RT60", a frequency that is no band.
    """
    if len(header) > MAX_HEADER:
        return None
    name, unit = name_and_unit(header)
    if unit.lower() not in UNIT_WORDS and plain(header) in parameters():  # as in "RT60 (T20)"
        name, unit = header, ""
    frequency = frequency_of(name if unit.lower() in ("", "hz", "khz") else header)
    if frequency is not None:
        frequency *= 1000 if unit.lower() == "khz" else 1
        if frequency < LEAST_BAND:
            raise DataError(
                f'{place}: column "{shown(header)}" is no band; is the line with the names of the '
                "columns missing?"
            )
        return Column("data", header, band=nominal_band(frequency, place))
    if plain(name) in COLUMNS:
        kind = COLUMNS[plain(name)]
        units = {"band": ("", "hz", "khz"), "value": UNIT_WORDS | {""}}
        if unit.lower() not in units.get(kind, ("",)):
            raise DataError(f'{place}: column "{shown(header)}": the unit is not known')
        return Column(kind, header, unit=unit)
    if is_unused(header) or _is_of_whole_range(name) or plain(header) in REMARKS:
        return Column("", header)
    if position := position_of(header):
        return Column("data", header, source=position[0], receiver=position[1])
    parameter = parameter_of(name, place, decay_time)
    if parameter is not None:
        scale_of(parameter, unit, place)
        open_time = leaves_decay_time_open(name)
        return Column("data", header, parameter, unit=unit, decay_time_open=open_time)
    both = _BOTH.fullmatch(name)
    if both:
        parameter, frequency = parameter_of(both[1], place, decay_time), frequency_of(both[2])
        if parameter is not None and frequency is not None:
            frequency *= 1000 if unit.lower() == "khz" else 1
            unit = unit if unit.lower() not in ("hz", "khz") else ""
            scale_of(parameter, unit, place)
            band, open_time = nominal_band(frequency, place), leaves_decay_time_open(both[1])
            return Column("data", header, parameter, band, unit, decay_time_open=open_time)
    return None


def name_and_unit(header: str) -> tuple[str, str]:
    """Return the parts of "T20 [s]", "T20 (s)", "T20 / s", "T20 in s", "T20 s" or "T20_s".

    Of "T20 [s] 500 Hz" they are "T20 500 Hz" and "s".
    """
    if within := _UNIT_WITHIN.fullmatch(header):
        return f"{within[1]} {within[3].strip('_ ')}", within[2]
    match = _BRACKETS.fullmatch(header) or _SUFFIX.fullmatch(header)
    if not match or (match[2].isdigit() and len(match[2]) > 1):  # "D(50)" has no unit
        return header, ""
    return match[1].strip(), match[2]


def scale_of(parameter: str, unit: str, place: str) -> float:
    """Return the factor from a unit to the parameter's own; DataError for another unit."""
    scales = _SCALES[observable(parameter).unit]
    if unit and unit.lower() not in scales:
        raise DataError(
            f'{place}: {parameter_label(parameter)} in "{shown(unit)}"; known are {", ".join(scales)}'
        )
    return scales[unit.lower()] if unit else 1.0
