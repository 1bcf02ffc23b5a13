"""`rtcal measure`, `table`, `import` and `export`."""

from __future__ import annotations

import shutil
from pathlib import Path

import click
import numpy as np
import pytest

import rtcal as rt
from rtcal.command.main import main
from tests import fuzz


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_a_catt_model_in_and_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hall, mesh = tmp_path / "hall.geo", tmp_path / "hall.obj"
    hall.write_bytes(
        b"ABS wood = <10 10 10 10 10 10> ; old\r\nABS brick = <2 2 2 2 2 2>\r\nCORNERS\r\n"
    )
    mesh.write_bytes(fuzz.OBJ[0])
    room = tmp_path / "room.toml"
    assert run("import", "catt", hall, "--mesh", mesh, "--out", room) == 0
    assert "V = 2 m³, S = 10 m²" in capsys.readouterr().out
    before = rt.Room.from_file(str(room))
    target = rt.Eyring().reverberation_time(before) * 0.8
    result = rt.calibrate(before, rt.Measurement.from_values(before.centre_frequencies, t20=target))
    result.room.save(str(tmp_path / "calibrated.toml"))
    assert run("export", "catt", tmp_path / "calibrated.toml", hall) == 0
    assert "change, JND" in capsys.readouterr().out
    after = hall.read_bytes()
    assert after.startswith(b"ABS wood = <1")
    assert b"> ; old\r\nABS brick = <" in after
    assert after.endswith(b">\r\nCORNERS\r\n")
    read = rt.io.catt.read(hall)
    assert np.abs(read.materials[0].alpha - result.alpha[0]).max() <= 5.01e-4
    assert read.materials[0].alpha[0] != 0.1
    assert run("import", "catt", hall, "--volume", 5, "--area", "wood=3", "--out", room) == 0
    assert rt.Room.from_file(str(room)).areas.tolist() == [3.0]
    assert run("import", "catt", hall, "--out", room) == 2
    assert run("import", "catt", hall, "--volume", 5, "--area", "wood", "--out", room) == 2
    assert "is not NAME=M2" in capsys.readouterr().err


def test_a_table_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "in.csv", tmp_path / "t.csv"
    path.write_bytes(fuzz.TABLES[0])
    assert run("table", path, "--out", out) == 0
    assert '"T20 (s)": T20' in capsys.readouterr().out
    assert rt.Measurement.from_file(str(out)).values["t20"].tolist() == [[1.5, 1.4]]
    path.write_bytes(b"f,RT60\n500,1.5\n")
    assert run("table", path, "--out", out) == 2
    assert 'state decay_time="t20"' in capsys.readouterr().err
    assert run("table", path, "--decay-time", "t20") == 0


def test_responses_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyfar")
    pytest.importorskip("pyrato")
    path, out = tmp_path / "S1_R1.wav", tmp_path / "t.csv"
    path.write_bytes(fuzz.READERS["wav"].seeds[0])
    assert run("measure", path, "--out", out) == 0
    shown = capsys.readouterr().out
    assert "T20    1000 Hz 0." in shown
    mean = rt.Measurement.from_file(str(out)).mean("t20")
    assert mean[-2:] == pytest.approx(0.3, rel=0.3)
    assert run("measure", path, "--minimum-range", "t30=99") == 0
    assert "T30 needs 99 dB" in capsys.readouterr().out
    assert run("measure", path, "--minimum-range", "t99=1") == 2


def test_no_command_writes_over_what_it_reads(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hall.geo").write_bytes(b"ABS wood = <10 10 10 10 10 10>\r\n")
    Path("t.csv").write_text("Frequency,T20\n500,0.9\n")
    Path("link.csv").symlink_to("t.csv")
    shutil.copy(rt.datasets.path("bras_cr2/room.toml"), "room.toml")
    shutil.copy(rt.datasets.path("bras_cr2/measured.csv"), "measured.csv")
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    loop = ("loop", "start", "room.toml", "measured.csv")
    for arguments in (
        ("import", "catt", "hall.geo", "--volume", 5, "--area", "wood=3", "--out", "hall.geo"),
        ("table", "t.csv", "--out", "./t.csv"),
        ("table", "t.csv", "--out", "link.csv"),
        ("calibrate", "room.toml", "measured.csv", "--out", "."),
        (*loop, "--state", "room.toml", "--out", "next.toml"),
        (*loop, "--state", "loop.json", "--out", "room.toml"),
        (*loop, "--state", "same", "--out", "same"),
    ):
        assert run(*arguments) == 2
        assert "would be written over" in capsys.readouterr().err
    assert run("calibrate", "room.toml", "measured.csv", "--out", "") == 2
    assert "--out is empty" in capsys.readouterr().err
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_an_area_is_stated_once_and_what_is_left_out_is_said(tmp_path: Path, capsys) -> None:
    hall, room = tmp_path / "hall.geo", tmp_path / "room.toml"
    hall.write_bytes(b"ABS wood = <10 10 10 10 10 10>\r\nABS felt = <2 2 2 2 2 2>\r\n")
    command = ("import", "catt", hall, "--volume", 5, "--out", room, "--area", "wood=3")
    assert run(*command, "--area", "wood=4") == 2
    assert '"wood" is given twice' in capsys.readouterr().err
    assert run(*command) == 0
    assert "Left out, without area: felt" in capsys.readouterr().out


def test_a_table_is_written_before_it_is_shown(tmp_path: Path, monkeypatch) -> None:
    """Into ``| head`` the page may end half-way; the file must not."""
    path, out = tmp_path / "in.csv", tmp_path / "t.csv"
    path.write_bytes(fuzz.TABLES[0])

    def closed(*_: object, **__: object) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr(click, "echo", closed)
    assert run("table", path, "--out", out) != 0
    assert rt.Measurement.from_file(str(out)).values["t20"].tolist() == [[1.5, 1.4]]


def test_a_table_without_a_header_is_not_taken_for_one(tmp_path: Path, capsys) -> None:
    path = tmp_path / "in.csv"
    path.write_text("500,0.9\n1000,0.8\n")
    assert run("table", path, "--parameter", "t20") == 2
    assert 'column "0.9" is no band' in capsys.readouterr().err
    path.write_text("12.5,16\n1.3,0.8\n")
    assert run("table", path, "--parameter", "t20") == 0


def test_a_range_is_0_db_or_more(tmp_path: Path, capsys) -> None:
    pytest.importorskip("pyfar")
    pytest.importorskip("pyrato")
    path = tmp_path / "S1_R1.wav"
    path.write_bytes(fuzz.READERS["wav"].seeds[0])
    for value in ("-5", "inf"):
        assert run("measure", path, "--minimum-range", f"t30={value}") == 2
        assert "dB is not finite and 0 or more" in capsys.readouterr().err
    assert run("measure", tmp_path) == 2
    assert "not a file" in capsys.readouterr().err
