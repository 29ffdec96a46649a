"""Decks: the one call into the compiled reader."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from myork import _core, errors

# Bytes of the first try; a longer answer is asked for again with the length it has.
_CAPACITY = 1 << 16


def deck_json(path: str | Path, overrides: Sequence[str], command: str) -> str:
    """Read and check a deck.

    Parameters
    ----------
    path : str or Path
        Deck file.
    overrides : sequence of str
        `table.key=value` each.
    command : str
        Command whose tables must be there; empty for none.

    Returns
    -------
    str
        JSON text of all values, defaults included.

    Raises
    ------
    InputError
        The deck or an override is wrong; the message has all complaints, a line each.
    FileError
        The deck cannot be read.
    """
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
