"""Decks in Python: the values that the compiled reader has checked."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork import _core, errors
from myork.tables import deck_text

#: Name used in place of a file name in messages about tables
NAME_OF_TABLES = "tables"

# Bytes of the first attempt; a longer answer is requested again with its reported length.
_CAPACITY = 1 << 16


def load_deck(
    deck: str | Path | Mapping[str, Any], overrides: Sequence[str] = (), command: str = ""
) -> dict[str, Any]:
    """Read and check a deck.

    - `deck`: deck file (TOML), or its tables as data: mappings with the keys of a deck, lists of
      them for arrays of tables. Without `title`, a deck is named after its file and data are named
      "scene"; data without `units` are in N and cm.
    - `overrides`: `table.key=value` each, as in `--set`; checked like the deck
    - `command`: command that will use the deck (`solve`, `rom`); the tables it needs must be there
    - returns tables by name with their defaults filled in: `deck["load"]["steps"]`, arrays of
      tables as lists: `deck["material"][0]["K"]` (an empty list where the deck has none). A key
      without a value and without a default is absent. Besides the tables: `path`, `folder` (base of
      relative paths in the deck), `sha256` (of the text of the deck, followed by a line
      `--set key=value` for each override), `probe_units` (unit of each probe by name, empty for
      ratios) and `result_units` (those of force, length, stress and volume). For data, `path` is
      "tables", and relative paths start in the current folder.
    - raises InputError: the deck or an override is wrong; the message lists all errors, one per
      line, by file and line, or by key for data
    - raises FileError: the deck cannot be read
    """
    if isinstance(deck, Mapping):
        return deck_values(NAME_OF_TABLES, text_of_tables(deck), overrides, command)
    return deck_values(deck, "", overrides, command)


def text_of_tables(tables: Mapping[str, Any]) -> str:
    """TOML text of a deck given as data; title and units have defaults.

    The units are those of the schema's default muscle parameters: newtons and
    centimetres.
    """
    return deck_text({"title": "scene", "units": {"force": "N", "length": "cm"}, **tables})


#: Load steps that give the snapshots of `[rom]` where the deck applies its load in one step
_SNAPSHOTS = 10


def step_count(deck: Mapping[str, Any]) -> int:
    """Number of load or time steps that `myork rom` takes.

    A deck that applies its load in one step gets ten steps if more than one mode is wanted, and at
    least as many as modes.
    """
    if "dynamics" in deck:
        return round(deck["dynamics"]["end_time"] / deck["dynamics"]["time_step"])
    steps, wanted = int(deck["load"]["steps"]), max(deck["rom"]["modes"])
    return max(_SNAPSHOTS, wanted) if steps == 1 < wanted else steps


@cache
def table_defaults(table: str) -> Mapping[str, Any]:
    """Default values in the schema for the keys of a table."""
    return MappingProxyType(load_deck({})[table])


def deck_key(path: str | Path, key: str, overrides: Sequence[str] = (), text: str = "") -> str:
    """The key that `--set` would set, with the name of its entry.

    - `path`: deck file, or its name in messages
    - `key`: key as in `--set`: `material.K` is that of the first material, `material.2.K` and
      `material.fat.K` that of the second
    - `overrides`: `table.key=value` each
    - `text`: text of the deck; if empty, that of the file. It may have other faults.
    - raises InputError: the deck has no such key or entry
    - raises FileError: the deck cannot be read
    """
    full, stat, message = _core.deck_key(
        os.fsencode(path), text.encode() or b" ", as_texts(overrides), key.encode() or b" "
    )
    check_deck(stat, message, text)
    return str(full.decode().rstrip())


def checked_overrides(overrides: Sequence[str]) -> Sequence[str]:
    """Overrides, refused unless they are texts of a line each."""
    if isinstance(overrides, str | Mapping):
        example = "table.key=value" if isinstance(overrides, Mapping) else overrides
        raise errors.InputError(
            f"overrides must be a list of texts, [{example!r}], not {type(overrides).__name__}"
        )
    for item in overrides:
        if any(letter in item for letter in "\n\r\0"):
            raise errors.InputError(f"--set {item!r}: an override must be a single line")
    return overrides


def as_texts(words: Sequence[str]) -> NDArray[np.bytes_]:
    """Texts in Fortran form: all of one length, padded with blanks instead of NULs."""
    items = np.array([word.encode() for word in words] or [b""])
    return np.char.ljust(items, max(items.itemsize, 1))


def check_deck(stat: int, message: str | bytes, text: str) -> None:
    """Raise the core's error about a deck; lines of a text generated from tables are left out."""
    if text and stat != 0:
        words = message.decode("utf-8", "replace") if isinstance(message, bytes) else message
        message = re.sub(rf"\b{NAME_OF_TABLES}(:\d+)+", NAME_OF_TABLES, words)
    errors.check(stat, message)


def deck_values(
    path: str | Path, text: str, overrides: Sequence[str], command: str
) -> dict[str, Any]:
    """Values of a deck, from its text where there is one."""
    if not isinstance(text, str):
        raise errors.InputError(f"a deck must be tables or a text, not {type(text).__name__}")
    if text.endswith(".toml") and "\n" not in text:
        raise errors.InputError(f"{text!r} is the name of a deck, not its text: open it as a file")
    words = checked_overrides(overrides)
    given = os.fsencode(path), text.encode() or b" ", as_texts(words), command.encode()
    capacity, length = 0, _CAPACITY
    while length > capacity:
        capacity = length
        answer, length, stat, _ = _core.deck_json(*given, capacity)
    values = answer.decode("utf-8", "replace").rstrip(" ")
    check_deck(stat, values, text)
    deck: dict[str, Any] = json.loads(values)
    deck = {**deck.pop("tables"), **deck}
    for material in deck.get("material", []):
        # JSON has no infinity, so the value is the word
        if "K" in material:
            material["K"] = float(material["K"])
    return deck
