"""Stations: one signature, decks that are files or data, and the names that the package exports."""

import inspect

import pytest

import myork
from myork import _core
from myork.console import silent
from myork.core.threads import core_threads


def test_public_names() -> None:
    wanted = (
        "Scene Results segment build run_deck run_rom run_demo make_report load_deck MyorkError"
    )
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
    common = {"overrides": (), "threads": None, "progress": silent}
    plain = [p.name for p in parameters.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert plain == (["out"] if name == "run_demo" else ["deck", "out"])
    for key, default in common.items():
        assert parameters[key].kind is inspect.Parameter.KEYWORD_ONLY
        assert parameters[key].default == default


@pytest.mark.slow
def test_labels_and_points_of_tables(tmp_path) -> None:
    """A phantom needs nothing but sizes; the stations leave their files in one folder."""
    tables = {
        "scene": {"dimension": 3},
        "image": {"phase": "dark", "label": "muscle", "iterations": 20},
        "bias": {"method": "none"},
        "phantom": {"size": [48, 48, 3], "spacing": [2.5, 2.5, 20]},
        "build": {"collocation_stride": [4, 4, 1], "source_stride": [8, 8, 1], "islands": "drop"},
    }
    labels = myork.segment(tables, tmp_path, threads=1)["segmentation"]["labels"]
    model = myork.build(tables, tmp_path)["model"]
    # a point for 16 voxels, and more at the border, where blocks hold some that are no muscle
    pixels = labels["muscle"]["pixels"]
    assert pixels / 16 < model["collocation_points"] < 1.4 * pixels / 16
    # the volume is that of the voxels, but for specks that were dropped
    assert model["volume"]["muscle"] == pytest.approx(pixels * 0.125, rel=0.02)


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
