"""A hundred small files with the oddities of real exports, and what must come out of each.

Written for this test after what measuring systems, spreadsheets and acoustics programs export: their
encodings, separators, line ends, decimal commas, units, merged headers and notes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

T20 = {"R1": {500: 1.52, 1000: 1.47, 2000: 1.31}, "R2": {500: 1.58, 1000: 1.44, 2000: 1.29}}
"""T20 in s by receiver and band, as most of the tables have it."""


@dataclass(frozen=True)
class Case:
    """A file and its answer.

    ``values`` of a table: (receiver, parameter, band in Hz) to value, for all that it holds.
    ``alpha`` of a material list: name to coefficients. ``volume`` of a mesh in m³. Else ``error``.
    """

    name: str
    reader: str
    content: bytes
    options: dict[str, Any] = field(default_factory=dict)
    values: dict[tuple[str, str, int], float] | None = None
    alpha: dict[str, list[float]] | None = None
    volume: float | None = None
    error: str | None = None
    said: str | None = None


def all_t20() -> dict[tuple[str, str, int], float]:
    return {(r, "t20", f): t for r, row in T20.items() for f, t in row.items()}


def number(value: float, comma: bool) -> str:
    return f"{value:g}".replace(".", "," if comma else ".")


def long(separator: str, comma: bool) -> str:
    rows = [separator.join(("Position", "Parameter", "Frequency [Hz]", "Value", "Unit"))]
    for receiver, row in T20.items():
        rows += [
            separator.join((receiver, "T20", str(f), number(t, comma), "s")) for f, t in row.items()
        ]
    return "\n".join(rows) + "\n"


def across(separator: str, comma: bool) -> str:
    rows = [separator.join(("Receiver", "Parameter", "500 Hz", "1 kHz", "2k"))]
    rows += [
        separator.join((receiver, "T20", *(number(t, comma) for t in row.values())))
        for receiver, row in T20.items()
    ]
    return "\n".join(rows) + "\n"


def down(separator: str, comma: bool) -> str:
    rows = [separator.join(("Position", "Frequency [Hz]", "T20 [s]"))]
    for receiver, row in T20.items():
        rows += [separator.join((receiver, str(f), number(t, comma))) for f, t in row.items()]
    return "\n".join(rows) + "\n"


def spreadsheets() -> list[Case]:
    """The three shapes with each separator, in each encoding, with each line end."""
    cases = []
    for shape in (long, across, down):
        for separator, comma in (
            (";", True),
            (";", False),
            ("\t", True),
            ("\t", False),
            (",", False),
        ):
            name = f"{shape.__name__} {separator!r} {'comma' if comma else 'point'}"
            cases.append(Case(name, "tables", shape(separator, comma).encode(), values=all_t20()))
    text = across(";", True)
    for codec in ("utf-8-sig", "utf-16", "cp1252", "latin-1"):
        said = {"utf-8-sig": "UTF-8", "utf-16": "UTF-16", "cp1252": "Windows-1252"}.get(codec)
        odd = "" if codec.startswith("utf") else "# Messung für die Prüfung\n"
        cases.append(
            Case(
                f"encoding {codec}",
                "tables",
                (odd + text).encode(codec),
                values=all_t20(),
                said=said,
            )
        )
    cases.append(
        Case(
            "encoding utf-16 big endian",
            "tables",
            b"\xfe\xff" + text.encode("utf-16-be"),
            values=all_t20(),
        )
    )
    for end in ("\r\n", "\r", "\n\n"):
        content = text.replace("\n", end).encode()
        cases.append(Case(f"line end {end!r}", "tables", content, values=all_t20()))
    cases.append(Case("no last line end", "tables", text.rstrip().encode(), values=all_t20()))
    return cases


def one(values: dict[int, float], parameter: str = "t20") -> dict[tuple[str, str, int], float]:
    """Values of a table without positions."""
    return {("R1", parameter, f): v for f, v in values.items()}


TWO = one({500: 1.5, 1000: 1.4})


def headers() -> list[Case]:
    """Spellings, units, titles above the header, merged headers."""
    down_with = "{}\n500;1.5\n1000;1.4\n"
    cases = [
        Case(f"header {header}", "tables", down_with.format(header).encode("cp1252"), values=TWO)
        for header in (
            "Frequenz [Hz];T20 [s]",
            "Frequenz in Hz;T20 in s",
            "f/Hz;T20/s",
            "f (Hz);RT20 (s)",
            "Oktave;Nachhallzeit T20 [s]",
            "Freq;T_20",
            '"Frequency";"T20 [s]"',
            "Frequency ;  T20",
            ";T20 [s]",
            "FREQUENCY;T20 S",
            "Octave band centre frequency [Hz];Reverberation time T20 [s]",
        )
    ]
    cases += [
        Case(
            "title lines",
            "tables",
            b"Hall A, 12.3.2024\nOperator;N.N.\nTemperature;21,5\n\nFrequency;T20\n500;1,5\n1000;1,4\n",
            values=TWO,
            said="the header is line 5; what stands before it is left out",
        ),
        Case(
            "Excel's separator line",
            "tables",
            b"sep=;\r\nFrequency;T20\r\n500;1,5\r\n1000;1,4\r\n",
            values=TWO,
        ),
        Case(
            "a line of units",
            "tables",
            b"f;T20;EDT\nHz;s;ms\n500;1.5;1200\n",
            values={("R1", "t20", 500): 1.5, ("R1", "edt", 500): 1.2},
            said="line 2 has the units",
        ),
        Case(
            "parameters down, under a header that names the bands",
            "tables",
            b"Band (Hz)\t500\t1000\nT20 (s)\t1.5\t1.4\nSPL (dB)\t60\t61\nTs (ms)\t90\t80\n",
            values={
                **{("R1", "t20", f): t for f, t in ((500, 1.5), (1000, 1.4))},
                **{("R1", "ts", f): t for f, t in ((500, 0.09), (1000, 0.08))},
            },
            said='as a parameter: "SPL (dB)"',
        ),
        Case(
            "merged parameters",
            "tables",
            b"Position;T20 [s];;EDT [s];\n;500;1000;500;1000\nR1;1,5;1,4;1,2;1,1\n",
            values={**TWO, ("R1", "edt", 500): 1.2, ("R1", "edt", 1000): 1.1},
            said="are one header of merged cells",
        ),
        Case(
            "merged bands",
            "tables",
            b";500 Hz;;1 kHz;\nPosition;T20;EDT;T20;EDT\nR1;1,5;1,2;1,4;1,1\n",
            values={**TWO, ("R1", "edt", 500): 1.2, ("R1", "edt", 1000): 1.1},
        ),
        Case(
            "parameter and band in each header",
            "tables",
            b"Receiver;T20 500 Hz;T20_1k;EDT @ 500 Hz\nR1;1.5;1.4;1.2\n",
            values={**TWO, ("R1", "edt", 500): 1.2},
        ),
        Case(
            "a line break in a header",
            "tables",
            b'Frequency;"T20\n[s]"\n500;1.5\n1000;1.4\n',
            values=TWO,
        ),
        Case(
            "separators at the line's end",
            "tables",
            b"Frequency;T20;;\n500;1.5;;\n1000;1.4;;\n",
            values=TWO,
        ),
        Case("an empty column", "tables", b"Frequency;;T20\n500;;1.5\n1000;;1.4\n", values=TWO),
        Case("notes", "tables", b"# DIRAC\nFrequency,T20\n# low\n500,1.5\n1000,1.4\n", values=TWO),
        Case("bands in kHz", "tables", b"f [kHz];T20\n0,5;1,5\n1;1,4\n", values=TWO),
        Case(
            "BRAS's 155 Hz",
            "tables",
            b"Frequency,T20\n155,1.5\n200,1.4\n",
            values=one({160: 1.5, 200: 1.4}),
            said="155 Hz is read as 160 Hz",
        ),
        Case("exact centres", "tables", b"Frequency,T20\n501.19,1.5\n1000.0,1.4\n", values=TWO),
        Case(
            "RT60, stated",
            "tables",
            b"Frequency,RT60\n500,1.5\n1000,1.4\n",
            {"decay_time": "t20"},
            TWO,
        ),
        Case(
            "RT60, not stated",
            "tables",
            b"Frequency,RT60\n500,1.5\n",
            error='"RT60" does not say which decay time it is',
        ),
        Case(
            "no header",
            "tables",
            b"500,0.9\n1000,0.8\n",
            {"parameter": "t20"},
            error='column "0.9" is no band',
        ),
        Case(
            "an unknown column",
            "tables",
            b"Frequency,T20,Floor\n500,1.5,3\n",
            error='column "Floor" is no parameter',
        ),
        Case(
            "unknown columns, all named at once",
            "tables",
            b"room_id,seat,band_hz,T20_s\nA,4,500,1.5\n",
            error='columns "room_id", "seat" are no parameter.*where={"room_id": "..."}',
        ),
        Case(
            "one room's rows, units behind underscores",
            "tables",
            b"room_id,band_hz,measured_t20_ms\nA,500,1500\nA,1000,1400\nB,500,900\n",
            {"where": {"room_id": "A"}},
            TWO,
        ),
        Case(
            "parameters without use beside it, and the whole range",
            "tables",
            b"frequency,T10 [s],T20 [s],IACC,Curvature\nwideband,1,1,1,1\n500,9,1.5,.5,3\n"
            b"1000,9,1.4,.5,2\n",
            values=TWO,
            said='left out, since rtcal has no use for it as a band: "wideband"',
        ),
        Case(
            "row numbers of pandas",
            "tables",
            b",Freqs,T20\n0,500,1.5\n1,1000,1.4\n",
            values=TWO,
            said="the first column has the rows' numbers",
        ),
        Case(
            "row numbers of pandas, read and written again",
            "tables",
            b"Unnamed: 0,Freqs,T20\n0,501.1872,1.5\n1,1000,1.4\n",
            values=TWO,
        ),
        Case(
            "columns aligned by blanks",
            "tables",
            b"  Frequency [Hz]   T20 [s]\n   500             1.5\n  1000             1.4\n",
            values=TWO,
            said="columns separated by blanks",
        ),
        Case(
            "a listing, no table",
            "tables",
            b"Descriptors of 500 Hz\nT_10 =  1.260952380952381\nT_20 =  1.237\n",
            error="no line names columns",
        ),
        Case(
            "two tables beside each other",
            "tables",
            b"T20,S1R1,S1R2,S1R1\n500,1.5,1.6,1.2\n",
            error='column "S1R1" is there 2 times',
        ),
        Case(
            "units behind the rows' parameters",
            "tables",
            b"Receiver,Parameter,500 Hz,1000 Hz\nR1,T20/ms,1500,1400\nR1,LF/%,20,30\n",
            values=TWO,
            said='as a parameter: "LF/%"',
        ),
        Case(
            "Ts in ms, not stated",
            "tables",
            b"Frequency,Ts\n500,85\n",
            error=r'is it in ms\? If so, write "Ts \[ms\]"',
        ),
        Case(
            "a value that is no measurement",
            "tables",
            b"Frequency,T20\n25,0.008\n",
            error="If it is no measurement, empty the cell",
        ),
        Case(
            "an unknown column, ignored",
            "tables",
            b"Frequency,T20,Floor\n500,1.5,3\n1000,1.4,2\n",
            {"ignore": ["Floor"]},
            TWO,
        ),
        Case(
            "a band that is none",
            "tables",
            b"Frequency,T20\n440,1.5\n",
            error="440 Hz is no octave or third-octave",
        ),
        Case("a title only", "tables", b"Measured T20\n", error="a header and at least one row"),
    ]
    return cases


def cells() -> list[Case]:
    """Numbers, units, signs and gaps in cells."""
    edt = {("R1", "t20", 500): 1.5}
    return [
        Case(
            "typographic minus",
            "tables",
            "f;C80\n500;−1,5\n1000;2\n".encode(),
            values=one({500: -1.5, 1000: 2}, "c80"),
        ),
        Case(
            "Windows' dash as a minus",
            "tables",
            b"f;C80;T20\n500;\x961,5;1,5\n",
            values={**edt, ("R1", "c80", 500): -1.5},
            said="Windows-1252",
        ),
        Case("Windows' dash as a gap", "tables", b"f;T20;EDT\n500;1,5;\x96\n", values=edt),
        Case("dash as a gap", "tables", "f;T20;EDT\n500;1,5;—\n".encode(), values=edt),
        Case("minus sign as a gap", "tables", "f;T20;EDT\n500;1,5;−\n".encode(), values=edt),
        Case("n.a. as a gap", "tables", b"f;T20;EDT\n500;1,5;n.a.\n", values=edt),
        Case("Excel's error as a gap", "tables", b"f;T20;EDT\n500;1,5;#DIV/0!\n", values=edt),
        Case(
            "a euro sign, Windows",
            "tables",
            b"f;T20\n500;1,5 \x80\n",
            error='line 2: "1.5 €" is not a finite number',
        ),
        Case(
            "a euro sign, UTF-8",
            "tables",
            "f;T20\n500;€\n".encode(),
            error='line 2: "€" is not a finite number',
        ),
        Case(
            "a byte that Windows lacks",
            "tables",
            b"f;T20\n500;\x81\n",
            error=r"line 2: .* is not a finite number",
        ),
        Case(
            "a cut UTF-16",
            "tables",
            "f;T20\n500;1.5\n".encode("utf-16")[:-1],
            error="is not UTF-16-LE, which the byte order mark promises",
        ),
        Case(
            "unit in the cell",
            "tables",
            b"f;T20;D50\n500;1,5 s;48 %\n",
            values={**edt, ("R1", "d50", 500): 0.48},
        ),
        Case(
            "percent column",
            "tables",
            b"f;D50 [%]\n500;48\n1000;51,5\n",
            values=one({500: 0.48, 1000: 0.515}, "d50"),
        ),
        Case(
            "percent without brackets",
            "tables",
            b"f;D50 %\n500;48\n1000;51.5\n",
            values=one({500: 0.48, 1000: 0.515}, "d50"),
        ),
        Case("percent, not stated", "tables", b"f;D50\n500;48\n", error="is it in percent"),
        Case(
            "percent unit of a row",
            "tables",
            b"f,parameter,unit,value\n500,D50,%,48\n",
            values={("R1", "d50", 500): 0.48},
        ),
        Case("milliseconds", "tables", b"f;T20 [ms]\n500;1500\n1000;1400\n", values=TWO),
        Case("milliseconds, not stated", "tables", b"f;T20\n500;1500\n", error="is it in seconds"),
        Case("quoted decimal commas", "tables", b'f,T20\n500,"1,5"\n1000,"1,4"\n', values=TWO),
        Case(
            "commas and points",
            "tables",
            b"f;T20\n500;1,5\n1000;1.4\n",
            error="decimal commas and decimal points in one table",
        ),
        Case("exponents", "tables", b"f;T20\n500;1.5E+00\n1000;14e-1\n", values=TWO),
        Case("no-break spaces", "tables", b"f;T20\n500;\xa01,5\n1000;1,4\xa0\n", values=TWO),
        Case(
            "a digit of another script",
            "tables",
            "f;T20\n500;١\n".encode(),
            error="is not a finite number",
        ),
        Case(
            "5,000 digits",
            "tables",
            b"f;T20\n500;" + b"9" * 5000 + b"\n",
            error="is not a finite number",
        ),
        Case(
            "a short row",
            "tables",
            b"f;T20;EDT\n500;1.5\n",
            error="line 2: 2 cells; the header has 3",
        ),
        Case("an open quote", "tables", b'f;T20\n500;"1.5\n', error="line 2: not a row of cells"),
        Case(
            "mean and single positions",
            "tables",
            b"Position;Parameter;500\nR1;T20;1.5\nR2;T20;1.7\nMean;T20;1.6\nStd;T20;0.1\n",
            values={("R1", "t20", 500): 1.5, ("R2", "t20", 500): 1.7},
            said="rows of means and deviations beside single positions are left out",
        ),
        Case(
            "mean and deviation",
            "tables",
            b"room,parameter,stat,500\nCR2,T30,mean,1.72\nCR2,T30,sd,0.14\nCR3,T30,mean,2\n",
            {"where": {"room": "CR2"}, "n_sources": 2, "n_receivers": 5},
            {("*", "t30", 500): 1.72},
        ),
        Case(
            "deviation, numbers not stated",
            "tables",
            b"stat,parameter,500\nmean,T20,1.5\nsd,T20,.1\n",
            error="needs the numbers of sources and receivers",
        ),
        Case(
            "means over stated positions",
            "tables",
            b"f,T20\n500,1.5\n1000,1.4\n",
            {"n_sources": 1, "n_receivers": 6},
            {("*", "t20", 500): 1.5, ("*", "t20", 1000): 1.4},
        ),
    ]


OCTAVES_6 = [0.02, 0.02, 0.03, 0.03, 0.04, 0.05]


def lists() -> list[Case]:
    """Material lists and meshes."""
    brick = {"brick": OCTAVES_6}
    eight = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
    box = (
        "v 0 0 0\nv 5 0 0\nv 5 4 0\nv 0 4 0\nv 0 0 3\nv 5 0 3\nv 5 4 3\nv 0 4 3\nusemtl wall\n"
        "f 1 2 3 4\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
    )
    in_mm = box.replace("v 5 4 3", "v 5000 4000 3000")
    for short, full in (
        ("5 0 0", "5000 0 0"),
        ("5 4 0", "5000 4000 0"),
        ("0 4 0", "0 4000 0"),
        ("0 0 3", "0 0 3000"),
        ("5 0 3", "5000 0 3000"),
        ("0 4 3", "0 4000 3000"),
    ):
        in_mm = in_mm.replace(f"v {short}\n", f"v {full}\n")
    return [
        Case("CATT", "catt", b"ABS brick = <2 2 3 3 4 5>\r\n", alpha=brick),
        Case(
            "CATT, lower case and tabs",
            "catt",
            b"\tabs\tbrick\t=\t<2\t2\t3\t3\t4\t5>\n",
            alpha=brick,
        ),
        Case(
            "CATT, Windows' comment",
            "catt",
            b"ABS brick = <2 2 3 3 4 5> ; f\xfcr 5 \x80 \x96 m\xb2\r\n",
            alpha=brick,
        ),
        Case(
            "CATT, UTF-8 with a mark",
            "catt",
            b"\xef\xbb\xbfABS brick = <2 2 3 3 4 5>\n",
            alpha=brick,
        ),
        Case("CATT, UTF-16", "catt", "ABS brick = <2 2 3 3 4 5>\n".encode("utf-16"), alpha=brick),
        Case(
            "CATT, old Mac's line ends", "catt", b"; hall\rABS brick = <2 2 3 3 4 5>\r", alpha=brick
        ),
        Case(
            "CATT, an umlaut in a name",
            "catt",
            b"ABS T\xfcr = <2 2 3 3 4 5>\n",
            alpha={"Tür": OCTAVES_6},
        ),
        Case(
            "CATT, decimal comma",
            "catt",
            b"ABS brick = <2,5 2 3 3 4 5>\n",
            error='line 1: "2,5" is not',
        ),
        Case(
            "CATT, a typographic minus",
            "catt",
            b"ABS brick = <\x962 2 3 3 4 5>\n",
            error=r"line 1: alpha -2 is not in \[0, 100\]",
        ),
        Case("CATT, fractions", "catt", b"ABS1 brick = <.02 .02 .03 .03 .04 .05>\n", alpha=brick),
        Case(
            "ODEON, tabs",
            "odeon",
            b"7\tfelt\r\n\t0.1\t0.2\t0.3\t0.4\t0.5\t0.6\t0.7\t0.8\r\n",
            alpha={"7 felt": eight},
        ),
        Case(
            "ODEON, Windows' dash",
            "odeon",
            b"7 felt \x96 40 mm\n.1 .2 .3 .4 .5 .6 .7 .8\n",
            alpha={"7 felt – 40 mm": eight},
        ),
        Case(
            "ODEON, a euro sign for a value",
            "odeon",
            b"7 felt\n\x80 .2 .3 .4 .5 .6 .7 .8\n",
            error='line 2: "€" is not a finite number',
        ),
        Case(
            "pyroomacoustics",
            "pyroomacoustics",
            b'{"coeffs": [0.1, 0.2], "center_freqs": [500, 1000]}',
            alpha={"material": [0.1, 0.2]},
        ),
        Case(
            "pyroomacoustics, UTF-8 with a mark",
            "pyroomacoustics",
            b'\xef\xbb\xbf{"a": {"coeffs": [0.1]}, "center_freqs": [500]}',
            alpha={"a": [0.1]},
        ),
        Case(
            "pyroomacoustics, a lone surrogate",
            "pyroomacoustics",
            b'{"\\ud800": {"coeffs": [0.1]}, "center_freqs": [500]}',
            error="line 1: .*control characters",
        ),
        Case(
            "pyroomacoustics, nested without end",
            "pyroomacoustics",
            b"[" * 100_000,
            error="nested deeper than 32 levels",
        ),
        Case(
            "pyroomacoustics, 5,000 digits",
            "pyroomacoustics",
            b'{"coeffs": [' + b"9" * 5000 + b'], "center_freqs": [500]}',
            error="line 1",
        ),
        Case(
            "pyroomacoustics, NaN",
            "pyroomacoustics",
            b'{"coeffs": [NaN], "center_freqs": [500]}',
            error='line 1: "NaN" is not a finite number',
        ),
        Case("BRAS, spaces", "bras", b"500 , 1000\r\n 0.1, 0.2 \r\n", alpha={"file": [0.1, 0.2]}),
        Case(
            "BRAS, 155 Hz", "bras", b"125,155,200\n0.1,0.2,0.3\n", alpha={"file": [0.1, 0.2, 0.3]}
        ),
        Case(
            "BRAS, percent",
            "bras",
            b"500,1000\n10,20\n",
            error=r"line 2: alpha 10 is not in \[0, 1\]",
        ),
        Case("a mesh in m", "obj", box.encode(), volume=60),
        Case("a mesh in mm, stated", "obj", in_mm.encode(), {"unit": 0.001}, volume=60),
        Case("a mesh in mm, not stated", "obj", in_mm.encode(), error="in mm"),
        Case("a mesh, Windows' line ends", "obj", box.replace("\n", "\r\n").encode(), volume=60),
        Case(
            "a mesh, decimal comma",
            "obj",
            box.replace("v 5 0 0", "v 5,0 0 0").encode(),
            error='line 2: "5,0" is not a finite number',
        ),
    ]


CASES = [*spreadsheets(), *headers(), *cells(), *lists()]
