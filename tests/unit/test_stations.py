"""Stations: one signature, decks that are files or data, and the names that the package exports."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import myork
from myork import _core
from myork.console import silent
from myork.core.threads import core_threads
from myork.errors import MyorkError
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


def test_labels_and_materials_that_do_not_meet(build: Callable[..., Any]) -> None:
    """What a solve will refuse is a warning when the model is built."""
    warnings = build()["model"]["warnings"]
    assert any("material fat: no voxel has its label 4; the labels are 1, 2" in w for w in warnings)
    assert any("label 2 has no material" in w for w in warnings)
