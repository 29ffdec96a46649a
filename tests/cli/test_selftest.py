"""What users run after installing: it passes here, and it tells what does not work."""

import json
from pathlib import Path

import pytest

from myork import selftest
from myork.cli import main
from myork.errors import FileError


@pytest.mark.slow
def test_this_installation_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["selftest", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    kept = json.loads((tmp_path / "out" / "selftest.json").read_text())
    assert [check["name"] for check in kept["checks"] if check["passed"] is not True] == []
    assert said.count(" ok ") == len(kept["checks"]) >= 13
    # both programs are named with their libraries
    assert "openblas" in kept["facts"]["libraries of Python"]
    assert "hdf5" in kept["facts"]["of myork-solve"]
    assert said.splitlines()[-1].endswith("the installation works")


@pytest.mark.slow
def test_what_fails_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unreadable(folder: Path) -> tuple[bool, str]:
        raise FileError(f"{folder}: damaged")

    monkeypatch.setattr(selftest, "check_deck", lambda *given, **more: [])
    monkeypatch.setattr(selftest, "_PATCH", 0.0)
    monkeypatch.setattr(selftest, "_files", unreadable)
    assert main(["selftest"]) == 1
    said = capsys.readouterr()
    assert "FileError" in said.out and "damaged" in said.out
    assert "patch, rkpm-gauss" in said.err and "results and report" in said.err
    assert "known answer" not in said.err
