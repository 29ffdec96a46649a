"""Decks as Python sees them: the values that the compiled reader checked."""

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

#: What stands for the file in messages about tables
NAME_OF_TABLES = "tables"

# Bytes of the first try; a longer answer is asked for again with the length it has.
_CAPACITY = 1 << 16


def load_deck(
    deck: str | Path | Mapping[str, Any], overrides: Sequence[str] = (), command: str = ""
) -> dict[str, Any]:
    """Read and check a deck.

    - `deck`: deck file (TOML), or its tables as data: mappings with the keys of a deck, lists of
      them for arrays of tables. Without `title` a deck has the name of its file, data are called
      "scene"; data without `units` are in N and cm.
    - `overrides`: `table.key=value` each, as in `--set`; checked like the deck
    - `command`: command that will use the deck (`solve`, `rom`); the tables it needs must be there
    - returns tables by name with their defaults filled in: `deck["load"]["steps"]`, arrays of
      tables as lists: `deck["material"][0]["K"]` (an empty list where the deck has none). A key
      without a value and without a default is absent. Beside the tables `path`, `folder` (where
      relative paths of the deck start), `sha256` (of the text of the deck, followed by a line
      `--set key=value` for each override), `probe_units` (unit of each probe by its name, empty for
      ratios) and `result_units` (those of force, length, stress and volume). Of data `path` is
      "tables", and relative paths start in the current folder.
    - raises InputError: the deck or an override is wrong; the message has all complaints, a line
      each: by file and line, of data by the key
    - raises FileError: the deck cannot be read
    """
    if isinstance(deck, Mapping):
        return deck_values(NAME_OF_TABLES, text_of_tables(deck), overrides, command)
    return deck_values(deck, "", overrides, command)


def text_of_tables(tables: Mapping[str, Any]) -> str:
    """TOML text of a deck that is data; title and units have defaults.

    The units are those in which the schema's defaults of a muscle are given, newtons and
    centimetres.
    """
    return deck_text({"title": "scene", "units": {"force": "N", "length": "cm"}, **tables})


#: Load steps that give the snapshots of `[rom]` where the deck takes its load in one
_SNAPSHOTS = 10


def step_count(deck: Mapping[str, Any]) -> int:
    """Number of load or time steps that `myork rom` takes.

    A deck that takes its load in one step has ten if more than one mode is wanted, and no fewer
    than modes.
    """
    if "dynamics" in deck:
        return round(deck["dynamics"]["end_time"] / deck["dynamics"]["time_step"])
    steps, wanted = int(deck["load"]["steps"]), max(deck["rom"]["modes"])
    return max(_SNAPSHOTS, wanted) if steps == 1 < wanted else steps


@cache
def table_defaults(table: str) -> Mapping[str, Any]:
    """Values that the schema gives to keys of a table which a deck leaves out."""
    return MappingProxyType(load_deck({})[table])


def deck_key(path: str | Path, key: str, overrides: Sequence[str] = (), text: str = "") -> str:
    """The key that `--set` would set, with the name of its entry.

    - `path`: deck file, or its name for messages
    - `key`: key as in `--set`: `material.K` is that of the first material, `material.2.K` and
      `material.fat.K` that of the second
    - `overrides`: `table.key=value` each
    - `text`: text of the deck; empty for that of the file. It may have other faults.
    - raises InputError: the deck has no such key or entry
    - raises FileError: the deck cannot be read
    """
    full, stat, message = _core.deck_key(
        os.fsencode(path), text.encode() or b" ", as_texts(overrides), key.encode() or b" "
    )
    check_deck(stat, message, text)
    return str(full.decode().rstrip())


def as_texts(words: Sequence[str]) -> NDArray[np.bytes_]:
    """Texts as Fortran has them: all of one length, filled with blanks instead of NULs."""
    items = np.array([word.encode() for word in words] or [b""])
    return np.char.ljust(items, max(items.itemsize, 1))


def check_deck(stat: int, message: str | bytes, text: str) -> None:
    """Raise the core's error about a deck; lines of the text that tables became are left out."""
    if text and stat != 0:
        words = message.decode("utf-8", "replace") if isinstance(message, bytes) else message
        message = re.sub(rf"\b{NAME_OF_TABLES}(:\d+)+", NAME_OF_TABLES, words)
    errors.check(stat, message)


def deck_values(
    path: str | Path, text: str, overrides: Sequence[str], command: str
) -> dict[str, Any]:
    """Values of a deck, from its text where there is one."""
    for item in overrides:
        if any(letter in item for letter in "\n\r\0"):
            raise errors.InputError(f"--set {item!r}: an override must be a single line")
    given = os.fsencode(path), text.encode() or b" ", as_texts(overrides), command.encode()
    capacity, length = 0, _CAPACITY
    while length > capacity:
        capacity = length
        answer, length, stat, _ = _core.deck_json(*given, capacity)
    values = answer.decode("utf-8", "replace").rstrip(" ")
    check_deck(stat, values, text)
    deck: dict[str, Any] = json.loads(values)
    deck = {**deck.pop("tables"), **deck}
    for material in deck.get("material", []):
        # JSON has no infinity and holds the word
        if "K" in material:
            material["K"] = float(material["K"])
    return deck
