"""Broken files for every reader: what they are made from, and what must hold of each."""

import hashlib
import re
import struct
import time
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

import rtcal as rt
from rtcal.finder import Case
from rtcal.io import bras, catt, impulse_responses, obj, odeon, pyroomacoustics, tables
from rtcal.io.material_list import MaterialList, read_sigma
from rtcal.io.text import number
from rtcal.loop import Loop
from rtcal.support.checks import look_alike
from rtcal.support.errors import DataError
from tests import fuzz_native as native


@dataclass(frozen=True)
class Reader:
    """A reader and good files for it.

    ``holds`` raises AssertionError where what was read is nonsense. ``beside`` are files in the same
    folder that its files refer to.
    """

    read: Callable[[str], Any]
    suffix: str
    seeds: tuple[bytes, ...]
    holds: Callable[[Any], object] = bool
    beside: Mapping[str, bytes] = field(default_factory=dict)


CATT = (
    b";PROJECT:hall\r\nGLOBAL h = 8 ; height\r\nABS wood   = <12 10 8 7 5 4>  {213 220 160}\r\n"
    b"ABS audience = < 68 75 82 85 86 86 > L <30 40 50 60 70 80> {128 128 0}  ; Beranek\r\n"
    b"\tabs drape = <3 4.5 11 17 24 35 : 40 45>\r\nABS1 panel = <.28 .22 .17 .09 .10 .11 .12>\r\n"
    b"ABS floorabs = wood\r\nCORNERS\r\n1 0 0 0\r\n\r\nPLANES\r\n[1 floor / 4 3 2 1 / wood ]\r\n",
    b"panelwalls = < 21 12 9 6 9 13 > L < 15 13 11 9 7 5 >\nb\xe9ton = < 20 12 6 4 7 10 >\n",
)
ODEON = (
    b"100\tTransparent\r\n\t0.00000\t0.00000\t0.00000\t0\t0.5\t1\t1.0\t1.0\r\n\r\n"
    b"103 Rough concrete (Bobran, 1973)\r\n 0.02 0.03 0.03 0.03 0.04 0.07 0.07 0.07 \r\n",
)
PRA = (
    b'{"center_freqs": [125, 250, 500],\n "absorption": {"Walls": {"brick": {"description": "a", '
    b'"coeffs": [0.02, 3e-2, 0.03]},\n "felt": {"coeffs": [0.1, 0.2], "center_freqs": [500, 1000]}'
    b'}},\n "scattering": {"s": {"coeffs": [0.1, 0.2, 0.3]}}}\n',
    b'{"description": "b\xc3\xa9ton", "coeffs": [0.1, 0.2], "center_freqs": [500, 1000]}',
)
BRAS = (
    b"20, 25, 31.5, 40\r\n0.069, 0.055, 0.04, 0.023\r\n0.1, 0.1, 0.1, 0.1\r\n",
    b"room,set,material,100,125,160\nCR2,initial,ceiling,0.069,0.055,0.04\nCR2,fitted,floor,0,1,.5\n",
)
OBJ = (
    b"# box\no hall\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 2\nv 1 0 2\nv 1 1 2\nv 0 1 2\n"
    b"usemtl wood\ns off\nf 1 2 3 4\nf 5//1 6//1 7//1 8//1\nusemtl brick\nf 1/1 2/2 6/3 5/4\n"
    b"f 2 3 \\\n7 6\nf 3 4 8 7\nf -5 -8 -4 -1\n",
)
TABLES = (
    "Frequenz [Hz];T20 (s);D50 [%];Ts [ms]\r\n125;1,5;50;80\r\n250;1,4;55;-\r\n".encode("cp1252"),
    b"Source,Receiver,Parameter,125 Hz,1 kHz,2k\nS1,R1,T20,1.5,1.4,1.3\nS1,R1,EDT,1.2,,1e0\n",
    b'position\tparameter\tfrequency\tvalue\tunit\nR1\tC80\t500\t2,5\tdB\n"R 2"\tTs\t1k\t90\tms\n',
)
SIGMA = (b"material,sigma\nbrick,0.02\nfelt,.1\n", b"material,125,250\nbrick,0.02,0.03\n")
ROOM = (Path(str(rt.datasets.path("bras_cr2/room.toml"))).read_bytes(), *native.ROOM)
MEASURED = (Path(str(rt.datasets.path("bras_cr2/measured.csv"))).read_bytes(),)


def wav(samples: np.ndarray, rate: int = 8000) -> bytes:
    """A WAV file of 16 bits, one channel."""
    data = np.round(samples * 32767).astype("<i2").tobytes()
    head = struct.pack("<4sIHHIIHH", b"fmt ", 16, 1, 1, rate, 2 * rate, 2, 16)
    body = b"WAVE" + head + struct.pack("<4sI", b"data", len(data)) + data
    return struct.pack("<4sI", b"RIFF", len(body)) + body


def _decay() -> bytes:
    t = np.arange(4000) / 8000
    rng = np.random.default_rng(1)
    return wav(0.9 * np.exp(-6.9 * t / 0.3) * rng.uniform(-1, 1, len(t)))


def material_list_holds(result: MaterialList) -> None:
    """Every alpha is where the file has it, and writing it back changes nothing."""
    for material in result.materials:
        assert all(0 <= a <= 1 for a in material.alpha)
        for a, (begin, end) in zip(material.alpha, material.spans, strict=True):
            written = number(result.text.characters[begin:end], result.path)
            assert abs(written * material.unit - a) <= 1e-12
    # Materials of different bands may be refused: octaves of a few thirds cannot be had.
    if any(m.doubt for m in result.materials):
        return  # a room refuses them
    if look_alike(result.names):
        return  # and names that only upper case or blanks keep apart
    if len({m.centre_frequencies for m in result.materials}) == 1:
        room = result.room(name="", volume=1, areas=dict.fromkeys(result.names, 1.0))
        assert result.with_room(room)[0] == Path(result.path).read_bytes()


def table_holds(result: tables.MeasuredTable) -> None:
    native.measurement_holds(result.measurement)


READERS: dict[str, Reader] = {
    "catt": Reader(catt.read, ".geo", CATT, material_list_holds),
    "odeon": Reader(odeon.read, ".Li8", ODEON, material_list_holds),
    "pyroomacoustics": Reader(pyroomacoustics.read, ".json", PRA, material_list_holds),
    "bras": Reader(bras.read, ".csv", BRAS, material_list_holds),
    "obj": Reader(obj.read, ".obj", OBJ),
    "sigma": Reader(read_sigma, ".csv", SIGMA),
    "tables": Reader(tables.read, ".csv", TABLES, table_holds),
    "room": Reader(rt.Room.from_file, ".toml", ROOM, native.room_holds),
    "measurement": Reader(rt.Measurement.from_file, ".csv", MEASURED, native.measurement_holds),
    "wav": Reader(lambda p: impulse_responses.read(p, bands=[1000]), ".wav", (_decay(),)),
    "case": Reader(Case.from_file, ".json", native.CASE, native.case_holds),
    "case in TOML": Reader(
        Case.from_file, ".toml", native.CASE_TOML, native.case_holds, native.BESIDE_CASE
    ),
    "loop": Reader(Loop.load, ".json", native.LOOP, native.loop_holds),
    "result": Reader(rt.load, ".json", native.RESULT, native.result_holds),
    "object": Reader(native.read_objects, ".json", native.OBJECTS),
    "kept array": Reader(
        native.read_kept_array, ".array", native.KEPT_ARRAY, native.kept_array_holds
    ),
    "record": Reader(native.read_record, ".json", native.RECORD),
}

LINES = ("bras", "catt", "odeon", "pyroomacoustics", "sigma", "tables")
"""Readers whose messages always name a line; a mesh that does not close has none."""

LIMIT = 10.0
"""s of processor time per file."""
WORDS = rb"""1e999 -1 nan inf 1_0 0x1 1,5 1.5 < > { } " \ = ; : , # 1e-400 true [] {} '' null * RT60
2020-01-01 ../precious"""
BLANKS = (b"", b" ", b"\n", b"\r", b"\t", b"\x00", b"\xff", b"\xef\xbb\xbf", b"\\\n")
LONG = (b"9" * 400, b"[" * 2000, b"a.b.c=1\n", b"v 1e308 0 0\n", b"f 1 1 1\n")
NOT_ASCII = ("\u0661\u0662".encode(), "\u2028".encode(), b"\xff\xff\xff\xff", bytes(4))
TOKENS = (*WORDS.split(), *BLANKS, *LONG, *NOT_ASCII)


CORPUS = Path(__file__).with_name("fuzz_corpus")


def kept(name: str) -> list[bytes]:
    """Return the files of a reader that libFuzzer kept: each reached new lines of rtcal."""
    place = CORPUS / f"{name}.zip"
    if not place.exists():  # a new reader
        return []
    with zipfile.ZipFile(place) as archive:
        return [archive.read(member) for member in archive.namelist()]


def keep(name: str, contents: Iterable[bytes]) -> None:
    """Keep files of a reader in the repository: the same files give the same bytes."""
    CORPUS.mkdir(exist_ok=True)
    named = {hashlib.sha256(content).hexdigest()[:16]: content for content in contents}
    with zipfile.ZipFile(CORPUS / f"{name}.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file, content in sorted(named.items()):
            archive.writestr(zipfile.ZipInfo(file), content, zipfile.ZIP_DEFLATED)


@st.composite
def broken(draw: st.DrawFn) -> tuple[str, bytes]:
    """A reader's name and a file for it: a good one with up to five things done to it."""
    name = draw(st.sampled_from(sorted(READERS)))
    content = bytearray(draw(st.sampled_from(READERS[name].seeds)))
    for _ in range(draw(st.integers(0, 5))):
        kind = draw(st.integers(0, 6))
        n = len(content)
        a = draw(st.integers(0, n))
        b = min(n, a + draw(st.integers(0, 40)))
        if kind == 0 and a < n:
            content[a] = draw(st.integers(0, 255))
        elif kind == 1:
            del content[a:b]
        elif kind == 2:
            content[a:b] = draw(st.sampled_from(TOKENS))
        elif kind == 3:
            content[a:a] = content[a:b] * draw(st.sampled_from((1, 2, 50)))
        elif kind == 4:
            content = content[:a] if a > n // 2 else content
        elif kind == 5:
            numbers = list(re.finditer(rb"\d+(\.\d+)?", bytes(content[:4000])))
            if numbers:
                chosen = draw(st.sampled_from(numbers))
                content[chosen.start() : chosen.end()] = draw(st.sampled_from(TOKENS))
        else:
            lines = bytes(content).split(b"\n")
            i, j = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(lines) - 1))
            lines[i], lines[j] = lines[j], lines[i]
            content = bytearray(b"\n".join(lines))
    return name, bytes(content)


def check(name: str, content: bytes, folder: Path) -> bool:
    """Return whether the file was read; AssertionError unless it was refused as it must be."""
    path = folder / f"file{READERS[name].suffix}"
    path.write_bytes(content)
    for beside, text in READERS[name].beside.items():
        if not (folder / beside).exists():
            (folder / beside).write_bytes(text)
    start = time.process_time()  # not the clock, which a busy machine lets run on
    try:
        result = READERS[name].read(str(path))
    except DataError as error:
        message = str(error)
        # A file that names others may name one by its whole path.
        others = name == "case in TOML"
        elsewhere = name == "wav" or (others and message.startswith("/"))
        assert str(folder if others else path) in message or elsewhere, message
        if name in LINES:
            assert re.search(r"line \d+", message), message
        return False
    finally:
        assert time.process_time() - start < LIMIT, "a reader hangs"
    READERS[name].holds(result)
    return True
