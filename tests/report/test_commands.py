"""Properties that all commands have in common, and the command that writes the page."""

import json
from pathlib import Path

import pytest

import rtcal as rt
from rtcal.report import document, figures
from rtcal.support.errors import MissingDependencyError
from tests.conftest import run
from tests.report.pages import no_figure


def test_report_command(result, evil, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(document, "source", no_figure)
    folder = tmp_path / "calibrated"
    folder.mkdir()
    (folder / "result.json").write_text(evil.to_json(), encoding="utf-8")
    assert run("report", folder) == 0
    assert capsys.readouterr().out.split() == ["Written:", str(folder / "report.html")]
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert run("report", folder / "result.json", "--out", folder / "b.html", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"written": [str(folder / "b.html")], "bytes": len(text.encode())}
    assert (folder / "b.html").read_text(encoding="utf-8") == text
    kept = sorted(p.name for p in folder.iterdir() if not p.name.startswith(".rtcal_files"))
    for out, said in (
        (folder / "no" / "p.html", "no such file"),
        (folder, "is a directory"),
        (folder / "result.json", "would overwrite"),
        ("", "--out is empty"),
    ):
        assert run("report", folder / "result.json", "--out", out) == 2
        assert said in capsys.readouterr().err
    for name in figures.FILES:  # what calibrate keeps there stays as it is, however it is named
        (folder / name).touch()
        before = (folder / name).read_bytes()
        for source in (folder, folder / "result.json"):
            assert run("report", source, "--out", folder / ".." / folder.name / name) == 2
            assert f"would overwrite {folder / name}" in capsys.readouterr().err
        assert (folder / name).read_bytes() == before
    kept = sorted(p.name for p in folder.iterdir() if not p.name.startswith(".rtcal_files"))
    (folder / "result.json").write_text("{}")
    assert run("report", folder) == 2
    assert (folder / "report.html").read_text(encoding="utf-8") == text
    assert sorted(p.name for p in folder.iterdir() if not p.name.startswith(".rtcal_files")) == kept
    monkeypatch.setitem(__import__("sys").modules, "jinja2", None)
    document._environment.cache_clear()
    with pytest.raises(MissingDependencyError, match=r"rtcal\[report\]"):
        document.render(document.Page("x", "", "", []))


def test_quiet_and_json(result, loop, tmp_path, monkeypatch, capsys):
    """Quiet prints nothing; JSON is JSON and nothing else, and both write the same files."""
    monkeypatch.chdir(tmp_path)
    room, measured = rt.datasets.bras_cr2()
    room.save("room.toml")
    measured.save("t.csv")
    Path("hall.geo").write_bytes(b"ABS wood = <10 10 10 10 10 10>\r\n")
    Path("table.csv").write_text("f,T20\n500,1.5\n1000,1.4\n")
    rt.Measurement.from_values(room.centre_frequencies, t20=[1.0] * 6).save("s.csv")
    state = ["--state", "loop.json", "--out", "next.toml"]
    calls = [
        (
            ["import", "catt", "hall.geo", "--volume", 9, "--area", "wood=30", "--out", "w.toml"],
            "areas",
        ),
        (["export", "catt", "w.toml", "hall.geo"], "change_jnd"),
        (["table", "table.csv", "--out", "u.csv"], "values"),
        (["loop", "start", "room.toml", "t.csv", *state], "simulate"),
        (["loop", "next", "room.toml", "s.csv", *state, "--again"], "finished"),
        (["loop", "back", "room.toml", *state], "simulations"),
        (["study", "--trials", 0, "--realisations", 20, "--sigma-r", 0.1], "studies"),
        (["calibrate", "room.toml", "t.csv"], "materials"),
    ]
    for arguments, key in calls:
        assert run(*arguments, "--quiet") == 0
        said = capsys.readouterr()
        assert said.out == said.err == ""
        assert run(*arguments, "--json") == 0
        said = capsys.readouterr()
        assert key in json.loads(said.out)
        assert said.err == ""
    assert Path("w.toml").exists()
    assert Path("u.csv").exists()
    assert run("study", "--trials", 0, "--realisations", 20, "--sigma-r", -1) == 2
