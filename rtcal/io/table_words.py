"""The words of tables of measured values: headers, statistics, and what is no band or no value.

English and German, and of Spanish, French, Italian and Portuguese what exports of measuring systems and
of students' programs have. A word is compared without case, blanks and punctuation (`plain`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

from rtcal.acoustics.observables import OBSERVABLES, Observable


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
