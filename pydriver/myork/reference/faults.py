"""What a damaged file is for a benchmark or a test, and the ways in which any file is damaged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["Fault", "image_deck", "spoilt"]


@dataclass(frozen=True)
class Fault:
    """A damaged file and a command that reads it.

    Attributes
    ----------
    name : str
        Format and damage; no two have the same.
    path : Path
        The file, or the folder of a series.
    command : str
        `segment` or `build`.
    tables : mapping
        Deck of the command, as data; `path` stands in it.
    message : str or None
        Pattern of what the command must say beside the name of the file; None where the damage
        may leave a file that can be read.
    huge : bool
        Whether the file promises more than a machine's memory.
    """

    name: str
    path: Path
    command: str
    tables: Mapping[str, Any]
    message: str | None
    huge: bool = False


def image_deck(anatomy: Path, **keys: Any) -> dict[str, Any]:
    """Deck that segments an image by two regions in some tenths of a second.

    Parameters
    ----------
    anatomy : Path
        MR image.
    **keys
        Other keys of `[image]`; paths among them are made texts.
    """
    texts = {key: str(value) if isinstance(value, Path) else value for key, value in keys.items()}
    image = {"anatomy": str(anatomy), "iterations": 20, **texts}
    return {"scene": {"dimension": 3}, "image": image, "bias": {"method": "none"}}


def spoilt(content: bytes, cuts: int, flips: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """The same bytes cut off or changed at random places, with a word for each.

    Parameters
    ----------
    content : bytes
        Of a sound file.
    cuts, flips : int
        How many are cut, and in how many one to eight bytes are changed, half of them in the
        first 400.
    seed : int
        Start of the random numbers.
    """
    random = np.random.default_rng(seed)
    for number in range(cuts):
        yield f"cut-{number}", content[: int(random.integers(1, len(content)))]
    for number in range(flips):
        changed = bytearray(content)
        last = len(content) if number % 2 else min(400, len(content))
        for place in random.integers(0, last, int(random.integers(1, 9))):
            changed[place] ^= int(random.integers(1, 256))
        yield f"flip-{number}", bytes(changed)
