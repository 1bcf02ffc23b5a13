"""`rtcal measure`, `table`, `import` and `export`."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import click
import numpy as np
import pytest

import rtcal as rt
from rtcal.command.main import main
from rtcal.io import geometry_files
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
    shown = capsys.readouterr().out
    assert "hall.geo: list with its coefficients replaced" in " ".join(shown.split())
    assert "change / JND" in shown
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
    assert "state --decay-time t20 or --decay-time t30" in capsys.readouterr().err
    assert run("table", path, "--decay-time", "t20") == 0


def test_responses_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyfar")
    pytest.importorskip("pyrato")
    path, out = tmp_path / "S1_R1.wav", tmp_path / "t.csv"
    path.write_bytes(fuzz.READERS["wav"].seeds[0])
    assert run("measure", path, "--out", out) == 0
    shown = capsys.readouterr().out
    assert re.search(r"^T20 / s +0\.\d{3} ", shown, re.M)
    mean = rt.Measurement.from_file(str(out)).mean("t20")
    assert mean[-2:] == pytest.approx(0.3, rel=0.3)
    assert run("measure", path, "--minimum-range", "t30=99") == 0
    assert "99 dB for T30" in " ".join(capsys.readouterr().out.split())
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
    assert 'with --columns "from line 1 to 2: band; ?"' in capsys.readouterr().err
    path.write_text("12.5,16,20\n1.3,0.8,0.7\n")
    assert run("table", path, "--parameter", "t20") == 2
    columns = "from line 2 to 2: value at 12.5 Hz; value at 16 Hz; value at 20 Hz"
    assert f'with --columns "{columns}"' in capsys.readouterr().err
    assert run("table", path, "--parameter", "t20", "--columns", columns) == 0


def test_a_measurement_without_any_value_is_not_written(tmp_path: Path, capsys) -> None:
    """It had been a CSV of empty values, with exit code 0."""
    pytest.importorskip("pyfar")
    pytest.importorskip("pyrato")
    path, out = tmp_path / "S1_R1.wav", tmp_path / "t.csv"
    path.write_bytes(fuzz.wav(np.random.default_rng(1).uniform(-1, 1, 300)))
    assert run("measure", path, "--out", out) == 2
    said = capsys.readouterr().err
    assert "t.csv: not written, since no parameter could be determined. 63 Hz: no" in said
    assert not out.exists()
    assert run("measure", path) == 0


LIST = b"ABS wood = <10 12 14 16 18 20>\r\nABS felt = <2 2 2 2 2 2> L <30 30 30 30 30 30>\r\n"
BOTH = ("--volume", 60, "--area", "wood=40", "--area", "felt=60")


def imported(folder: Path, *options: object, content: bytes = LIST) -> rt.Room:
    (folder / "hall.geo").write_bytes(content)
    out = folder / "room.toml"
    assert run("import", "catt", folder / "hall.geo", "--out", out, *options) == 0
    return rt.Room.from_file(str(out))


def test_import_takes_sigma_air_bands_and_scattering(tmp_path: Path, capsys) -> None:
    table = tmp_path / "sigma.csv"
    table.write_text("material,125,250,500,1000,2000,4000\nfelt,.05,.05,.04,.04,.03,.02\n")
    options = (
        "--sigma-relative",
        0.1,
        "--sigma-minimum",
        0.02,
        "--sigma",
        table,
        "--in-situ-factor",
        2,
        "--temperature",
        22,
        "--scattering",
        0.1,
    )
    room = imported(tmp_path, *BOTH, *options, "--bands", "500,1000")
    assert room.centre_frequencies.tolist() == [500, 1000]
    assert room.sigma == pytest.approx(np.array([[0.04, 0.04], [0.04, 0.04]]))
    assert (room.air.temperature, room.air.humidity) == (22, 50)
    assert room.scattering == pytest.approx(np.array([[0.1, 0.1], [0.3, 0.3]]))
    shown = capsys.readouterr().out
    assert "sigma = 2 max(0.1 alpha, 0.02); from the file: felt" in shown
    room = imported(tmp_path, *BOTH, "--bands", "third-octave", "--iso-12999-2")
    assert room.n_bands == 18
    assert room.alpha[0, :4] == pytest.approx([0.1, 0.1, 0.1, 0.12])
    assert (room.sigma >= rt.priors.sigma_iso_12999_2(room.alpha, room.centre_frequencies)).all()
    table.write_text("material,sigma\nfelt,0.05\n")
    assert imported(tmp_path, *BOTH, "--sigma", table).sigma[1] == pytest.approx([0.05] * 6)
    table.write_text("material,sigma\nglass,0.05\n")
    assert (
        run(
            "import",
            "catt",
            tmp_path / "hall.geo",
            *BOTH,
            "--sigma",
            table,
            "--out",
            tmp_path / "room.toml",
        )
        == 2
    )
    assert '"glass" is no material of the room' in capsys.readouterr().err


def test_materials_are_proposed_from_the_catalogue_and_never_guessed(
    tmp_path: Path, capsys
) -> None:
    pytest.importorskip("pyroomacoustics")
    (tmp_path / "hall.geo").write_bytes(LIST)
    command = ("import", "catt", tmp_path / "hall.geo", *BOTH, "--area", "brick wall=20")
    out = ("--out", tmp_path / "room.toml")
    assert run(*command, *out) == 2
    message = capsys.readouterr().err
    assert '- "brick wall" is like brick_wall_rough' in message
    assert 'or an entry of the catalogue: --catalogue "brick wall=ENTRY"' in message
    assert not (tmp_path / "room.toml").exists()
    assert run(*command, "--catalogue", "brick wall=brick_wall_rough", *out) == 0
    shown = capsys.readouterr().out
    room = rt.Room.from_file(str(tmp_path / "room.toml"))
    expected = rt.datasets.catalogue.material("brick_wall_rough", room.centre_frequencies)
    assert room.alpha[2] == pytest.approx(expected.alpha)
    assert "Vorländer 2008" in room.sources["brick wall"]
    assert "brick wall: pyroomacoustics" in shown
    assert run(*command, "--catalogue", "brick wall=none_such", *out) == 2
    assert '"none_such" is no material of the catalogue' in capsys.readouterr().err
    assert run(*command, "--catalogue", "brick wall=brick", *out) == 2
    assert "it is like facing_brick: " in capsys.readouterr().err
    program = ("import", "catalogue", "--volume", 60, "--area", "material=90", *out)
    assert run(*program) == 2
    assert '--catalogue "material=carpet" names the entries' in capsys.readouterr().err


def test_an_entry_that_has_an_equals_sign_is_stated_after_the_first_one(tmp_path: Path) -> None:
    """The name had ended at the last =, and "Product 200 mm (aw" was no material."""
    products, out = tmp_path / "products.csv", tmp_path / "room.toml"
    products.write_text("product;125;250;500\nPanel 40 mm (aw=0.90);0.2;0.6;0.9\n")
    command = ("import", "library", products, "--volume", 60, "--area", "ceiling=90")
    assert run(*command, "--as", "ceiling=Panel 40 mm (aw=0.90)", "--out", out) == 0
    assert rt.Room.from_file(out).alpha[0].tolist() == [0.2, 0.6, 0.9]


def test_an_entry_that_is_stated_wins_and_unknown_names_are_refused(tmp_path: Path, capsys) -> None:
    """--as had no effect where the list had the name itself, and none for names that nothing had."""
    products, out = tmp_path / "products.csv", tmp_path / "room.toml"
    products.write_text("product;125;250;500\nwall;0.1;0.1;0.1\nhard wall;0.02;0.02;0.02\n")
    command = ("import", "library", products, "--volume", 60, "--area", "wall=90", "--out", out)
    for refused, words in (
        ("plastr=wall", '--as: "plastr" is no material of the room; --area has wall'),
        ("wall=hrd", '--as "wall=hrd": "hrd" is no material of'),
    ):
        assert run(*command, "--as", refused) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert words in said
        assert not out.exists()
    assert run(*command, "--as", "wall=hard wall", "--catalogue", "wall=brickwork") == 2
    assert '"wall" is in --as and in --catalogue' in capsys.readouterr().err
    assert run(*command, "--as", "wall=hard wall") == 0
    assert "Left out, without area: wall" in capsys.readouterr().out
    assert rt.Room.from_file(out).alpha.tolist() == [[0.02] * 3]


def test_a_description_of_an_odeon_library_can_be_stated(tmp_path: Path, capsys) -> None:
    """Its number was needed, though the message named the description."""
    library, out = tmp_path / "hall.Li8", tmp_path / "room.toml"
    library.write_text(f"101 wall\n{'0.1 ' * 8}\n102 doors\n{'0.2 ' * 8}\n")
    command = ("import", "odeon", library, "--volume", 60, "--area", "wall=90", "--out", out)
    for entry in ("doors", "102 doors"):
        assert run(*command, "--as", f"wall={entry}") == 0
        assert (rt.Room.from_file(out).alpha == 0.2).all()


def test_a_mesh_alone_takes_its_materials_from_the_catalogue(tmp_path: Path, capsys) -> None:
    pytest.importorskip("pyroomacoustics")
    mesh, out = tmp_path / "hall.obj", tmp_path / "room.toml"
    mesh.write_bytes(fuzz.OBJ[0])
    command = ("import", "catalogue", "--mesh", mesh, "--out", out)
    assert run(*command) == 2
    said = capsys.readouterr().err
    assert '"wood" is like ' in said
    assert 'State --catalogue "wood=ENTRY" --catalogue "brick=ENTRY"' in " ".join(said.split())
    chosen = ("--catalogue", "wood=wood_16mm", "--catalogue", "brick=brickwork")
    assert run(*command, *chosen) == 0
    room = rt.Room.from_file(str(out))
    assert room.volume == 2
    assert geometry_files.read(room).areas == rt.io.obj.read(mesh).areas
    assert "Left out" not in capsys.readouterr().out


def test_a_table_with_the_number_of_its_pairs(tmp_path: Path, capsys) -> None:
    path, out = tmp_path / "in.csv", tmp_path / "t.csv"
    path.write_text(
        "room,parameter,stat,500,1000\nA,T20,mean,1.5,1.4\nA,T20,sd,0.1,0.2\nB,T20,mean,9,9\n"
    )
    command = ("table", path, "--where", "room=A", "--out", out)
    assert run(*command) == 2
    assert "state --sources and --receivers" in capsys.readouterr().err
    assert run(*command, "--sources", 2, "--receivers", 5) == 0
    measured = rt.Measurement.from_file(str(out))
    assert (measured.n_sources, measured.n_receivers) == (2, 5)
    assert measured.standard_deviation["t20"].tolist() == [0.1, 0.2]
    assert run("table", path, "--where", "room", "--out", out) == 2
    assert '--where: "room" is not NAME=ENTRY' in capsys.readouterr().err


def test_a_room_goes_back_into_the_list_that_as_took_it_from(tmp_path: Path, capsys) -> None:
    listed = tmp_path / "list.Li8"
    row = "0.10 0.10 0.20 0.30 0.40 0.50 0.60 0.60"
    listed.write_text(f"4002 Gypsum board\n{row}\n7001 thin carpet\n{row}\n", encoding="utf-8")
    room = str(tmp_path / "room.toml")
    areas = ["--area", "drywall=120", "--area", "thin_carpet=30", "--volume", "100"]
    taken = ["import", "odeon", str(listed), *areas, "--as", "drywall=4002 Gypsum board"]
    # A mesh's exporter has written an underscore for a blank.
    assert run(*taken, "--out", room) == 0
    out = str(tmp_path / "new.Li8")
    back = ["export", "odeon", room, out, "--template", str(listed)]
    capsys.readouterr()
    assert run(*back) == 2
    assert 'Which is it? State --as "drywall=NAME"' in capsys.readouterr().err
    assert run(*back, "--as", "drywall=4002 Gypsum board") == 0
    assert Path(out).read_bytes() == listed.read_bytes()
    assert run(*back, "--as", "wall=4002 Gypsum board") == 2
    assert '--as: "wall" is no material of the room' in capsys.readouterr().err
