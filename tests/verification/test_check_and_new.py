"""Decks to start from, and self-checks of decks."""

import json
from pathlib import Path

import pytest

from myork import load_deck, run_deck
from myork.cli import main
from myork.stations.check import check_deck
from myork.stations.new import KINDS, new_deck


@pytest.mark.parametrize("kind", KINDS)
def test_new_decks_are_right(kind: str, tmp_path: Path) -> None:
    path = new_deck(kind, tmp_path / "deck.toml")
    assert load_deck(path, (), "solve")["title"]
    assert path.read_text().startswith("#")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["box", "annulus", "muscle"])
def test_new_decks_are_accepted(kind: str, tmp_path: Path) -> None:
    """What has a geometry of its own is solved, with an answer that can be trusted."""
    summary = run_deck(new_deck(kind, tmp_path / "deck.toml"), tmp_path / "out")
    assert summary["verdict"]["state"] == "accepted"


def test_new_overwrites_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("precious")
    assert main(["new", "box", "-o", str(path)]) == 2
    assert "already exists" in capsys.readouterr().err and path.read_text() == "precious"
    assert main(["new", "sphere", "-o", str(tmp_path / "s.toml")]) == 2
    assert "choose one of box, annulus" in capsys.readouterr().err


@pytest.mark.slow
def test_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    deck = new_deck("muscle", tmp_path / "deck.toml")
    assert main(["check", str(deck), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "check.json").read_text())["checks"]
    assert [check["name"] for check in found] == [
        "tangent", "material muscle", "fibers", "solve and balance", "restart",
    ]  # fmt: skip
    assert all(check["passed"] for check in found) and said.count("ok") == 5


@pytest.mark.parametrize(
    "override",
    [*(f"scene.method={form}" for form in ("rkcm", "rkcm-mixed", "rkpm-scni", "rkpm-gauss")),
     "material.muscle.K=inf"],
)  # fmt: skip
def test_tangents_of_all_forms(override: str, tmp_path: Path) -> None:
    """Of an incompressible body displacements only: pressures are said not to be, and why."""
    deck = new_deck("muscle", tmp_path / "deck.toml")
    found = check_deck(deck, overrides=[override], quick=True)[0]
    assert found.name == "tangent" and found.passed, found.detail
    left = "along pressures of infinite K not checked: their rows" in found.detail
    assert left == ("inf" in override)


def test_check_finds_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A matrix that softens and a muscle without fibers are told, and the exit says so."""
    deck = new_deck("muscle", tmp_path / "deck.toml")
    text = deck.read_text().replace("A20 = 0.94", "A20 = -2.5")
    deck.write_text(text)
    assert main(["check", str(deck), "--quick"]) == 1
    captured = capsys.readouterr()
    assert "passive matrix softens" in captured.out
    assert "failed checks: material muscle" in captured.err
