"""Decks as Python data: their TOML text, and read-only tables."""

import json
import math
import os
import re
from collections.abc import Mapping
from typing import Any, NoReturn

from myork.errors import InputError

#: Entries of a checked deck that are not tables
NOT_TABLES = {"path", "folder", "sha256", "probe_units", "result_units"}
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def deck_text(tables: Mapping[str, Any]) -> str:
    """TOML text of a deck.

    - `tables`: tables by name, as in a deck: mappings, or lists of mappings for `[[name]]`
      in a deck. Values are texts, numbers, logicals, paths, lists and arrays of them.
    - returns text that `load_deck` can read from a file
    - raises InputError: a value that decks cannot contain; the message names its key
    """
    plain = {name: content for name, content in tables.items() if not _is_table(content)}
    lines = [_line(name, value, "") for name, value in plain.items()]
    for name, content in tables.items():
        if name in plain:
            continue
        many = not isinstance(content, Mapping)
        head = f"[[{_key(name)}]]" if many else f"[{_key(name)}]"
        for number, table in enumerate(content if many else [content], start=1):
            lines.append(head)
            place = f"{name}.{number}." if many else f"{name}."
            lines += [_line(key, value, place) for key, value in table.items()]
    return "\n".join(lines) + "\n"


def override_text(key: str, value: Any) -> str:
    """Override of a deck, `table.key=value`, from a Python value."""
    return f"{key}={_toml(value, key)}"


def _is_table(content: Any) -> bool:
    """Whether the content is a table or an array of tables."""
    if isinstance(content, list | tuple):
        return bool(content) and all(isinstance(entry, Mapping) for entry in content)
    return isinstance(content, Mapping)


def _line(key: Any, value: Any, place: str) -> str:
    return f"{_key(key)} = {_toml(value, f'{place}{key}')}"


def _key(key: Any) -> str:
    if not isinstance(key, str):
        raise InputError(f"tables: {key!r}: a key must be a text")
    return key if _BARE_KEY.fullmatch(key) else _toml(key, key)


def _toml(value: Any, place: str) -> str:
    """A value in TOML; `place` is its key for messages."""
    if hasattr(value, "tolist"):  # NumPy numbers and arrays
        value = value.tolist()
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, str | int | float):
        # JSON escapes everything that TOML requires, except the last of the control characters
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(entry, place) for entry in value) + "]"
    if isinstance(value, Mapping):
        inside = ", ".join(_line(key, entry, f"{place}.") for key, entry in value.items())
        return "{" + inside + "}"
    if value is None:
        raise InputError(f"tables: {place}: None is not a value; leave the key out")
    raise InputError(f"tables: {place}: a {type(value).__name__} is not a value of a deck")


def read_only(tables: Any) -> Any:
    """Tables whose keys and lists, at all depths, refuse any change with an `InputError`.

    They compare, print and convert to JSON like ordinary dicts and lists; a copy is an ordinary
    dict or list.
    """
    if isinstance(tables, dict):
        return _Table({key: read_only(value) for key, value in tables.items()})
    if isinstance(tables, list):
        return _List(read_only(value) for value in tables)
    return tables


def _refuse(self: object, *_: Any, **__: Any) -> NoReturn:
    raise InputError(
        "the deck of a scene that is open cannot be changed: open a new Scene with overrides, "
        "as in Scene(path, ['load.steps=20'])"
    )


class _Fixed:
    """Base of read-only objects; their copies can be changed."""

    __setitem__ = __delitem__ = __ior__ = __iadd__ = __imul__ = clear = pop = _refuse
    popitem = setdefault = update = append = extend = insert = remove = reverse = sort = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return json.loads, (json.dumps(self),)


class _Table(_Fixed, dict[str, Any]):
    """A read-only table."""


class _List(_Fixed, list[Any]):
    """A read-only list."""
