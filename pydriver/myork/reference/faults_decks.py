"""Mutated decks, made anew from the installed ones wherever they are wanted."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

__all__ = ["deck_fault"]

_NUMBERS = ("nan", "inf", "-inf", "1e300", "-1e300", "1e-300", "9e18", "9223372036854775807",
            "2147483647", "2147483648", "-2147483648", "1e999", "99999999999999999999", "0", "-0.0",
            "-1", "1_0", "0x7fffffff")  # fmt: skip
_OTHERS = ('""', '" "', '"\\u0000"', '"a\\u0000b"', '"\\u0007\\u001b[2J"', "true", "[]", "[[]]",
           "{}", '["x", 1]', "1979-05-27", "[1, 2, 3, 4, 5]", '"../../../etc/passwd"',
           '"äöü \\U0001F4AA"', "[nan, nan, nan]")  # fmt: skip
_LINE = re.compile(r"^([A-Za-z_]\w*) *= *(.*)$", re.MULTILINE)
_TABLE = re.compile(r"^\[\[?\w+\]?\]", re.MULTILINE)

Random = np.random.Generator


def deck_fault(seed: int, number: int, inputs: Path) -> tuple[str, bytes]:
    """A mutated deck and what was done to it; the same for the same numbers.

    Parameters
    ----------
    seed, number : int
        Start of the random numbers, and which deck of the corpus.
    inputs : Path
        Folder of the sound decks.
    """
    random = np.random.default_rng((seed, number))
    decks = sorted(inputs.glob("*.toml"))
    deck = decks[int(random.integers(len(decks)))]
    mutation = _MUTATIONS[number % len(_MUTATIONS)]
    content = mutation(random, deck.read_bytes())
    return f"{number} {deck.stem} {mutation.__name__.strip('_')}", content


def _pick(random: Random, choices: tuple[str, ...]) -> str:
    return choices[int(random.integers(len(choices)))]


def _place(random: Random, pattern: re.Pattern[str], text: str) -> re.Match[str]:
    found = list(pattern.finditer(text))
    return found[int(random.integers(len(found)))]


def _value(random: Random, content: bytes, values: tuple[str, ...]) -> bytes:
    text = content.decode()
    line = _place(random, _LINE, text)
    return (text[: line.start(2)] + _pick(random, values) + text[line.end(2) :]).encode()


def _number(random: Random, content: bytes) -> bytes:
    return _value(random, content, _NUMBERS)


def _number_in_array(random: Random, content: bytes) -> bytes:
    text = content.decode()
    numbers = re.compile(r"(?<=[\[, ])-?\d+\.?\d*(?=[,\]])")
    if not numbers.search(text):
        return _number(random, content)
    place = _place(random, numbers, text)
    return (text[: place.start()] + _pick(random, _NUMBERS) + text[place.end() :]).encode()


def _type(random: Random, content: bytes) -> bytes:
    return _value(random, content, _OTHERS)


def _long_text(random: Random, content: bytes) -> bytes:
    length = int(random.choice([5_000, 100_000, 500_000]))
    return _value(random, content, (f'"{"x" * length}"',))


def _key(random: Random, content: bytes) -> bytes:
    text = content.decode()
    line = _place(random, _LINE, text)
    name = line.group(1)
    at = int(random.integers(len(name)))
    words = (
        name[:at] + name[at + 1 :] or "k",
        name[:at] + "x" + name[at:],
        name.upper(),
        f'"{name}\\u0000"',
        f'"{name}\\n"',
        name * 1000,
        f"{name}.{name}",
    )
    return (text[: line.start(1)] + _pick(random, words) + text[line.end(1) :]).encode()


def _table(random: Random, content: bytes) -> bytes:
    text = content.decode()
    table = _place(random, _TABLE, text)
    name = table.group().strip("[]")
    words = (f"[{name}]", f"[[{name}]]", "[[", f"[{name}.{name}]", f"{name} = 1", f"[{name}s]", "")
    return (text[: table.start()] + _pick(random, words) + text[table.end() :]).encode()


def _truncation(random: Random, content: bytes) -> bytes:
    return content[: int(random.integers(len(content)))]


def _bytes(random: Random, content: bytes) -> bytes:
    changed = bytearray(content)
    for place in random.integers(0, len(changed), int(random.integers(1, 9))):
        changed[place] = int(random.integers(256))
    return bytes(changed)


def _nuls(random: Random, content: bytes) -> bytes:
    at = int(random.integers(len(content)))
    return content[:at] + b"\0" * int(random.integers(1, 9)) + content[at:]


def _nesting(random: Random, content: bytes) -> bytes:
    deep = int(random.choice([50, 300, 5_000, 100_000]))
    return _value(random, content, ("[" * deep, "[" * deep + "]" * deep, "{a=" * deep))


def _lines(random: Random, content: bytes) -> bytes:
    lines = content.splitlines(keepends=True)
    one, other = (int(at) for at in random.integers(0, len(lines), 2))
    how = int(random.integers(3))
    if how == 0:
        del lines[min(one, other) : max(one, other) + 1]
    elif how == 1:
        lines[one], lines[other] = lines[other], lines[one]
    else:
        lines[one:one] = lines[other : other + 8]
    return b"".join(lines)


_MUTATIONS: tuple[Callable[[Random, bytes], bytes], ...] = (
    _number,
    _type,
    _key,
    _number_in_array,
    _lines,
    _bytes,
    _table,
    _truncation,
    _number,
    _nuls,
    _nesting,
    _long_text,
)
