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
    **dict.fromkeys(_words("unit einheit unidad unité"), "unit"),
}
"""What a column holds (`rtcal.io.table_columns.Column.kind`) by its header."""

STATISTICS = {
    **dict.fromkeys(
        (
            "mean",
            "average",
            "avg",
            "avg.",
            "mittel",
            "mittelwert",
            "mw",
            "durchschnitt",
            "arithm. mittel",
            "spatial average",
            "moyenne",
            "promedio",
            "media",
            "ø",
        ),
        "value",
    ),
    **dict.fromkeys(
        (
            "sd",
            "std",
            "std.",
            "stdev",
            "std. dev.",
            "std dev",
            "std. deviation",
            "stdabw",
            "stabw",
            "stabw.",
            "standardabw.",
            "std.abw.",
            "stddev",
            "sigma",
            "σ",
            "écart-type",
            "ecart-type",
            "desviación estándar",
            "dev. std",
            "dev. standard",
            "deviazione standard",
            "standard deviation",
            "standardabweichung",
        ),
        "standard_deviation",
    ),
    **dict.fromkeys(
        (
            "min",
            "max",
            "median",
            "minimum",
            "maximum",
            "range",
            "spannweite",
            "streuung",
            "number of measurements",
            "n",
            "count",
            "anzahl",
        ),
        "",
    ),
}
"""Names of statistics over positions: of means, of standard deviations, and of what is not read."""

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
