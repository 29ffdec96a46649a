"""Settings shared by all tests."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Before numpy and the core are imported: OpenMP and OpenBLAS read these once. One thread is the
# only count whose speed does not collapse on a shared machine; tests of threads ask for two.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest  # noqa: E402


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-reference",
        action="store_true",
        help="write the values that regression tests find into their JSON references",
    )


@pytest.fixture(scope="session")
def inputs() -> Path:
    """Folder with the decks of the checkout."""
    return Path(__file__).parent.parent / "inputs"


#: A deck as Python data: tables, or lists of them
Tables = dict[str, Any]


def deck_text(tables: Tables) -> str:
    """TOML of a deck. Strings, numbers and lists are written alike in TOML and JSON."""
    plain = {key: value for key, value in tables.items() if not is_table(value)}
    lines = [f"{key} = {json.dumps(value)}" for key, value in plain.items()]
    for name, content in tables.items():
        if name in plain:
            continue
        many = isinstance(content, list)
        for table in content if many else [content]:
            lines.append(f"[[{name}]]" if many else f"[{name}]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


def is_table(value: Any) -> bool:
    if isinstance(value, list):
        return bool(value) and isinstance(value[0], dict)
    return isinstance(value, dict)


@pytest.fixture
def write_deck(tmp_path: Path) -> Callable[..., Path]:
    """Write tables as a deck; units and title need not be given."""

    def write(tables: Tables) -> Path:
        path = tmp_path / "deck.toml"
        path.write_text(
            deck_text({"title": "test", "units": {"force": "N", "length": "cm"}, **tables}),
            encoding="utf-8",
        )
        return path

    return write


@pytest.fixture
def open_scene(write_deck: Callable[..., Path]) -> Iterator[Callable[..., Any]]:
    """Open scenes from tables or from the path of a deck; all are closed at the end."""
    from myork.core.scene import Scene

    scenes = []

    def open_(deck: Tables | Path, *overrides: str) -> Scene:
        path = write_deck(deck) if isinstance(deck, dict) else deck
        scenes.append(Scene(path, overrides))
        return scenes[-1]

    yield open_
    for scene in scenes:
        scene.close()
