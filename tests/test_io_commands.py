"""`rtcal measure`, `table`, `import` and `export`."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import rtcal as rt
from tests import fuzz
from tests.conftest import run


def test_a_catt_model_in_and_out(tmp_path, rtcal):
    hall, mesh = tmp_path / "hall.geo", tmp_path / "hall.obj"
    hall.write_bytes(
        b"ABS wood = <10 10 10 10 10 10> ; old\r\nABS brick = <2 2 2 2 2 2>\r\nCORNERS\r\n"
    )
    mesh.write_bytes(fuzz.OBJ[0])
    room = tmp_path / "room.toml"
    rtcal("import", "catt", hall, "--mesh", mesh, "--out", room)
    before = rt.Room.from_file(str(room))
    target = rt.Eyring().reverberation_time(before) * 0.8
    result = rt.calibrate(before, rt.Measurement.from_values(before.centre_frequencies, t20=target))
    result.room.save(str(tmp_path / "calibrated.toml"))
    rtcal("export", "catt", tmp_path / "calibrated.toml", hall)
    after = hall.read_bytes()
    assert after.startswith(b"ABS wood = <1")
    assert b"> ; old\r\nABS brick = <" in after
    assert after.endswith(b">\r\nCORNERS\r\n")
    read = rt.io.catt.read(hall)
    assert np.abs(read.materials[0].alpha - result.alpha[0]).max() <= 5.01e-4
    assert read.materials[0].alpha[0] != 0.1
    rtcal("import", "catt", hall, "--volume", 5, "--area", "wood=3", "--out", room)
    assert rt.Room.from_file(str(room)).areas.tolist() == [3.0]
    rtcal.refused("import", "catt", hall, "--out", room)
    bare = ("--volume", 5, "--area", "wood")
    assert "MATERIAL=M2" in rtcal.refused("import", "catt", hall, *bare, "--out", room)


def test_responses_in(tmp_path, rtcal):
    pytest.importorskip("pyfar")
    pytest.importorskip("pyrato")
    path, out = tmp_path / "S1_R1.wav", tmp_path / "t.csv"
    path.write_bytes(fuzz.READERS["wav"].seeds[0])
    rtcal("measure", path, "--out", out)
    mean = rt.Measurement.from_file(str(out)).mean("t20")
    assert mean[-2:] == pytest.approx(0.3, rel=0.3)
    assert "99 dB for T30" in rtcal("measure", path, "--minimum-range", "t30=99")
    rtcal.refused("measure", path, "--minimum-range", "t99=1")


def test_no_command_writes_over_what_it_reads(tmp_path, monkeypatch, rtcal):
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
        assert "would overwrite" in rtcal.refused(*arguments)
    assert "is empty" in rtcal.refused("calibrate", "room.toml", "measured.csv", "--out", "")
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before


LIST = b"ABS wood = <10 12 14 16 18 20>\r\nABS felt = <2 2 2 2 2 2> L <30 30 30 30 30 30>\r\n"
BOTH = ("--volume", 60, "--area", "wood=40", "--area", "felt=60")


def imported(folder, *options, content=LIST):
    (folder / "hall.geo").write_bytes(content)
    out = folder / "room.toml"
    assert run("import", "catt", folder / "hall.geo", "--out", out, *options) == 0
    return rt.Room.from_file(str(out))


def test_import_takes_sigma_air_bands_and_scattering(tmp_path, rtcal):
    table = tmp_path / "sigma.csv"
    table.write_text("material,125,250,500,1000,2000,4000\nfelt,.05,.05,.04,.04,.03,.02\n")
    options = "--sigma-relative 0.1 --sigma-minimum 0.02 --in-situ-factor 2 --temperature 22"
    more = ("--scattering", 0.1, "--sigma", table, "--bands", "500,1000")
    room = imported(tmp_path, *BOTH, *options.split(), *more)
    assert room.centre_frequencies.tolist() == [500, 1000]
    assert room.sigma == pytest.approx(np.array([[0.04, 0.04], [0.04, 0.04]]))
    assert (room.air.temperature, room.air.humidity) == (22, 50)
    assert room.scattering == pytest.approx(np.array([[0.1, 0.1], [0.3, 0.3]]))
    room = imported(tmp_path, *BOTH, "--bands", "third-octave", "--iso-12999-2")
    assert room.n_bands == 18
    assert room.alpha[0, :4] == pytest.approx([0.1, 0.1, 0.1, 0.12])
    assert (room.sigma >= rt.priors.sigma_iso_12999_2(room.alpha, room.centre_frequencies)).all()
    table.write_text("material,sigma\nfelt,0.05\n")
    assert imported(tmp_path, *BOTH, "--sigma", table).sigma[1] == pytest.approx([0.05] * 6)
    table.write_text("material,sigma\nglass,0.05\n")
    made = ("import", "catt", tmp_path / "hall.geo", *BOTH, "--out", tmp_path / "room.toml")
    assert '"glass" is not a material of the room' in rtcal.refused(*made, "--sigma", table)


def test_materials_are_proposed_from_the_catalogue_and_never_guessed(tmp_path, rtcal):
    pytest.importorskip("pyroomacoustics")
    (tmp_path / "hall.geo").write_bytes(LIST)
    command = ("import", "catt", tmp_path / "hall.geo", *BOTH, "--area", "brick wall=20")
    out = ("--out", tmp_path / "room.toml")
    message = rtcal.refused(*command, *out)
    assert '"brick wall" is similar to brick_unglazed' in message
    assert '--catalogue "brick wall=ENTRY"' in message
    assert not (tmp_path / "room.toml").exists()
    rtcal(*command, "--catalogue", "brick wall=brick_wall_rough", *out)
    room = rt.Room.from_file(str(tmp_path / "room.toml"))
    expected = rt.datasets.catalogue.material("brick_wall_rough", room.centre_frequencies)
    assert room.alpha[2] == pytest.approx(expected.alpha)
    assert "Vorländer 2008" in room.sources["brick wall"]
    for entry, said in (
        ("none_such", '"none_such" is not a material of the catalogue'),
        ("brick", "Similar entries: brick_unglazed"),
    ):
        assert said in rtcal.refused(*command, "--catalogue", f"brick wall={entry}", *out)
    program = ("import", "catalogue", "--volume", 60, "--area", "material=90", *out)
    assert '"material" is similar to no entry' in rtcal.refused(*program)
