"""Stations: one signature, decks as files or data, names of the package; new and check."""

import inspect
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import myork
from myork import _core, load_deck, run_deck
from myork.cli import main
from myork.console import silent
from myork.core.threads import core_threads
from myork.errors import MyorkError
from myork.stations.check import check_deck
from myork.stations.new import KINDS, new_deck
from tests.images import save
from tests.scenes import deck_file, refuses, scene


def test_public_names() -> None:
    wanted = "Scene Results segment build run_deck run_rom run_demo make_report load_deck"
    assert set(wanted.split()) <= set(myork.__all__) <= set(dir(myork))
    for name in myork.__all__:
        value = getattr(myork, name)
        assert isinstance(value, str if name == "__version__" else object), name
        assert not inspect.ismodule(value), name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = myork.nothing


@pytest.mark.parametrize("name", ["segment", "build", "run_deck", "run_rom", "run_demo"])
def test_one_signature(name: str) -> None:
    parameters = inspect.signature(getattr(myork, name)).parameters
    plain = [p.name for p in parameters.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert plain == (["out"] if name == "run_demo" else ["deck", "out"])
    for key, default in {"overrides": (), "threads": None, "progress": silent}.items():
        assert parameters[key].kind is inspect.Parameter.KEYWORD_ONLY
        assert parameters[key].default == default


def test_threads_of_the_core_are_given_back() -> None:
    before = _core.set_threads(0)
    with core_threads(before + 2):
        assert _core.set_threads(0) == before + 2
        with pytest.raises(ZeroDivisionError), core_threads(1):
            assert _core.set_threads(0) == 1
            raise ZeroDivisionError
        with core_threads(None):
            assert _core.set_threads(0) == before + 2
    assert _core.set_threads(0) == before


RUBBER = {"model": "polynomial", "A10": 1, "K": 100}
MATERIALS = [{"name": "muscle", "label": 1, **RUBBER}, {"name": "fat", "label": 4, **RUBBER}]


@pytest.fixture
def build(tmp_path: Path) -> Callable[..., Any]:
    labels = np.ones((8, 8, 6), np.int16)
    labels[4:] = 2
    save(tmp_path, np.eye(4), map=labels)

    def run(**table: Any) -> Any:
        table = {"labels": "map.nii.gz", **table}
        tables = scene("auto", {"kind": "model"}, build=table, material=MATERIALS)
        return myork.build(deck_file(tmp_path / "body.toml", tables), tmp_path / "out")

    return run


@pytest.mark.parametrize(("table", "message"), [
    ({"labels": "nothing.nii.gz"}, "build.labels: .*nothing.nii.gz: there is no such file"),
    ({"fibers": "map.nii.gz"}, "build.fibers: .*a 4-D image with 3 volumes"),
    (
        {"source_stride": [3, 3, 1], "collocation_stride": [2, 2, 1]},
        "build.source_stride = .* must be a multiple",
    ),
])  # fmt: skip
def test_errors_begin_with_file_line_and_key(build, tmp_path, table, message):
    said = refuses(message, build, **table, kind=MyorkError)
    lines = (tmp_path / "body.toml").read_text().splitlines()
    line = next(k for k, own in enumerate(lines, 1) if own.startswith(f"{[*table][0]} ="))
    assert f"body.toml:{line}: build." in said


def test_a_label_of_a_material_that_the_map_lacks_is_named(build) -> None:
    said = build(source_stride=[4, 4, 2])["model"]["warnings"][0]
    assert "material.fat.label: no voxel of " in said and "4; the labels there are 1, 2" in said


# ---- example decks, and self-checks of decks -----------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_new_decks_are_right(kind: str, tmp_path: Path) -> None:
    path = new_deck(kind, tmp_path / "deck.toml")
    assert load_deck(path, (), "solve")["title"]
    assert path.read_text().startswith("#")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["box", "annulus", "muscle"])
def test_new_decks_are_accepted(kind: str, tmp_path: Path) -> None:
    """Decks with their own geometry are solved, with a trustworthy answer."""
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
    """For an incompressible body displacements only; the report says that, and why."""
    deck = new_deck("muscle", tmp_path / "deck.toml")
    found = check_deck(deck, overrides=[override], quick=True)[0]
    assert found.name == "tangent" and found.passed, found.detail
    left = "along pressures of infinite K not checked: their rows" in found.detail
    assert left == ("inf" in override)


def test_check_finds_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A softening matrix and a muscle without fibers are reported, and the exit status is 1."""
    deck = new_deck("muscle", tmp_path / "deck.toml")
    text = deck.read_text().replace("A20 = 0.94", "A20 = -2.5")
    deck.write_text(text)
    assert main(["check", str(deck), "--quick"]) == 1
    captured = capsys.readouterr()
    assert "passive matrix softens" in captured.out
    assert "failed checks: material muscle" in captured.err
