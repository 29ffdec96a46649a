"""Decks as Python sees them: the values that the compiled reader checked."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork import _core, errors

__all__ = ["load_deck"]

# Bytes of the first try; a longer answer is asked for again with the length it has.
_CAPACITY = 1 << 16


def load_deck(path: str | Path, overrides: Sequence[str] = (), command: str = "") -> dict[str, Any]:
    """Read and check a deck.

    Parameters
    ----------
    path : str or Path
        Deck file (TOML).
    overrides : sequence of str
        `table.key=value` each, as in `--set`; checked like the deck.
    command : str
        Command that will use the deck (`solve`, `rom`); the tables it needs must be there.

    Returns
    -------
    dict
        Tables by name with their defaults filled in: `deck["load"]["steps"]`, arrays of tables as
        lists: `deck["material"][0]["K"]` (an empty list where the deck has none). A key without
        a value and without a default is absent. Beside the tables `path`, `folder` (where
        relative paths of the deck start) and `sha256` (of the text of the deck, followed by a
        line `--set key=value` for each override).

    Raises
    ------
    InputError
        The deck or an override is wrong; the message has all complaints, a line each.
    FileError
        The deck cannot be read.
    """
    for text in overrides:
        if "\n" in text:
            raise errors.InputError(f"--set {text!r}: an override is a single line")
    deck: dict[str, Any] = json.loads(_deck_json(path, overrides, command))
    for material in deck.get("material", []):
        # JSON has no infinity and holds the word
        if "K" in material:
            material["K"] = float(material["K"])
    return deck


def _deck_json(path: str | Path, overrides: Sequence[str], command: str) -> str:
    """JSON text of all values of a deck, defaults included."""
    items = np.array([text.encode() for text in overrides] or [b""])
    padded = np.char.ljust(items, max(items.itemsize, 1))  # blanks, not NULs, as Fortran has it
    capacity = _CAPACITY
    while True:
        text, length, stat, _ = _core.deck_json(
            os.fsencode(path), padded, command.encode(), capacity
        )
        if length <= capacity:
            break
        capacity = length
    answer = text.decode("utf-8", "replace").rstrip(" ")
    errors.check(stat, answer)
    return answer
