"""Three rooms from what a consultant has to the page, by the commands of README.md and docs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from rtcal.command.main import main
from rtcal.io import odeon
from rtcal.simulators.geometry import Polyhedron
from tests.fuzz import wav

OCTAVES = [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]


def run(*arguments: object) -> None:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    assert stop.value.code == 0


def to_the_page(folder: Path) -> tuple[str, rt.Room]:
    """The last two commands of every room: the page, and the calibrated room."""
    run("calibrate", folder / "room.toml", folder / "t.csv", "--out", folder / "calibrated")
    run("report", folder / "calibrated", "--out", folder / "report.html")
    page = (folder / "report.html").read_text(encoding="utf-8")
    return page, rt.Room.from_file(str(folder / "calibrated" / "room.toml"))


def responses(folder: Path, times: dict[float, float], rate: int = 16000) -> list[Path]:
    """Four responses of noise whose octaves decay with the T given, and half a second of zeros."""
    rng, n = np.random.default_rng(1), int(1.5 * rate)
    frequency, t = np.fft.rfftfreq(n, 1 / rate), np.arange(n) / rate
    paths = []
    for name in ("S1_R1", "S1_R2", "S2_R1", "S2_R2"):
        sound = np.zeros(n)
        for centre, time in times.items():
            spectrum = np.fft.rfft(rng.standard_normal(n))
            in_band = (frequency >= centre / np.sqrt(2)) & (frequency < centre * np.sqrt(2))
            sound += np.fft.irfft(spectrum * in_band, n) * 10 ** (-3 * t / time)
        sound = np.concatenate([np.zeros(400), sound, np.zeros(rate // 2)])
        paths.append(folder / f"{name}.wav")
        paths[-1].write_bytes(wav(0.9 * sound / np.abs(sound).max(), rate))
    return paths


@pytest.mark.long
def test_impulse_responses_and_an_obj(tmp_path: Path, capsys) -> None:
    for library in ("pyfar", "pyrato", "pyroomacoustics", "jinja2", "matplotlib"):
        pytest.importorskip(library)
    box = Polyhedron.shoebox((9, 7, 3.2), "plaster")
    floor = int(np.argmin([box.vertices[list(f), 2].max() for f in box.faces]))
    materials = ["carpet" if i == floor else "plaster" for i in range(len(box.faces))]
    mesh = tmp_path / "room.obj"
    Polyhedron(vertices=box.vertices, faces=box.faces, materials=materials).save(mesh)
    truth = dict(zip(OCTAVES, (1.5, 1.3, 1.1, 0.95, 0.85, 0.75), strict=True))
    run("measure", *responses(tmp_path, truth), "--out", tmp_path / "t.csv")
    shown = capsys.readouterr().out
    assert "digital silence at the end is left out" in shown
    assert "S2_R2.wav" in shown
    chosen = ("--catalogue", "carpet=carpet_cotton", "--catalogue", "plaster=hard_surface")
    air = ("--temperature", 20, "--humidity", 45)
    run("import", "catalogue", "--mesh", mesh, *chosen, *air, "--out", tmp_path / "room.toml")
    assert "V = 201.6 m³" in capsys.readouterr().out
    page, room = to_the_page(tmp_path)
    t = rt.Eyring().reverberation_time(room)[:6]
    # Four responses, each of which scatters by 0.88 / sqrt(B T): four standard deviations.
    limit = 4 * 0.88 / np.sqrt(0.71 * np.array(OCTAVES) * list(truth.values())) / np.sqrt(4)
    assert (np.abs(t / list(truth.values()) - 1) < limit).all()
    assert "Vorländer 2008" in str(dict(room.sources))
    assert "8000" in page  # not measured, and said


def test_a_table_of_thirds_and_an_odeon_list(tmp_path: Path, capsys) -> None:
    library = tmp_path / "hall.Li8"
    library.write_bytes(
        b"103 Rough concrete\r\n 0.02 0.03 0.03 0.03 0.04 0.04 0.05 0.05\r\n"
        b"908 Audience on benches\r\n 0.3 0.4 0.5 0.7 0.8 0.85 0.85 0.8\r\n"
    )
    thirds = rt.acoustics.bands.third_octaves(100, 5000)
    times = 2.1 - 0.05 * np.arange(len(thirds))
    rows = [
        f"{f:g};{t:.2f};{0.9 * t:.2f}".replace(".", ",") for f, t in zip(thirds, times, strict=True)
    ]
    table = "Messung im Saal\r\nFrequenz [Hz];RT60 [s];EDT [s]\r\n" + "\r\n".join(rows) + "\r\n"
    (tmp_path / "dirac.csv").write_bytes(table.encode("cp1252"))
    run(
        "table",
        tmp_path / "dirac.csv",
        "--decay-time",
        "t30",
        "--sources",
        2,
        "--receivers",
        6,
        "--out",
        tmp_path / "t.csv",
    )
    areas = ("--volume", 2000, "--area", "Rough concrete=900", "--area", "Audience on benches=180")
    run("import", "odeon", library, *areas, "--temperature", 20, "--out", tmp_path / "room.toml")
    assert "Left out" not in capsys.readouterr().out
    page, room = to_the_page(tmp_path)
    assert "T is converted from third-octaves to octaves" in page
    measured = rt.Eyring().reverberation_time(room)[2]
    rates = [1 / round(times[k], 2) for k in (3, 4, 5)]
    assert measured == pytest.approx(1 / np.mean(rates), rel=1e-9)
    run("export", "odeon", tmp_path / "calibrated" / "room.toml", library)
    written = odeon.read(library).listed("Rough concrete").alpha[3]
    assert written == pytest.approx(room.alpha[0, 3], abs=5e-6)
