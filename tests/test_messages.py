"""The list of messages on the site has those of all three languages, as users see them."""

import importlib.util
from pathlib import Path

import pytest

_FILE = Path(__file__).parent.parent / "docs" / "messages.py"
_SPEC = importlib.util.spec_from_file_location("list_of_messages", _FILE)
assert _SPEC is not None and _SPEC.loader is not None
_LIST = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_LIST)
_MESSAGES = _LIST.messages()


@pytest.mark.parametrize(("file", "message"), [
    ("fortran/scene/rk_cloud.f90", "normal of boundary entry {i} at {points} is not a unit vector"),
    ("fortran/solve/rk_verdict.f90", "the displacements differ by # of their norm{reference}"),
    ("fortran/deck/deck_check.cpp", "missing, the table {title} is needed"),
    ("pydriver/myork/imaging/plain.py", "{path}: there is no such file"),
])  # fmt: skip
def test_lists_messages_of_all_languages(file: str, message: str) -> None:
    assert message in _MESSAGES[file]


def test_words_of_the_field_stand_in_messages() -> None:
    """None of the words that the project avoids; see CONTRIBUTING."""
    avoided = ("foretold", "led astray", "that is none", "as they are")
    found = [
        f"{file}: {text}"
        for file, texts in _MESSAGES.items()
        for text in texts
        if any(word in text for word in avoided)
    ]
    assert not found, "\n".join(found)
