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
