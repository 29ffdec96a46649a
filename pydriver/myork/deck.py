"""Decks as Python sees them: the values that the compiled reader checked."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from myork.core_deck import deck_json
from myork.errors import InputError

__all__ = ["load_deck"]


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
            raise InputError(f"--set {text!r}: an override is a single line")
    deck: dict[str, Any] = json.loads(deck_json(path, overrides, command))
    for material in deck.get("material", []):
        # JSON has no infinity and holds the word
        if "K" in material:
            material["K"] = float(material["K"])
    return deck
