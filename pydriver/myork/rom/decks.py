"""Keys in which two decks differ, so that states of one are none of the other."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

__all__ = ["NOT_TABLES", "differing_keys", "in_words"]

#: Entries of a checked deck that are no tables
NOT_TABLES = {"path", "folder", "sha256", "probe_units", "result_units"}
#: Differences that are named
_MOST = 4


def differing_keys(
    one: Mapping[str, Any],
    other: Mapping[str, Any],
    tables: Collection[str] | None = None,
    apart: Collection[str] = (),
) -> dict[str, tuple[Any, Any]]:
    """Values of two decks where they differ, by key.

    Parameters
    ----------
    one, other : mapping
        Values of decks, defaults filled in.
    tables : collection of str, optional
        Tables that are looked at; default all.
    apart : collection of str
        Keys `table.key`, last words of keys and tables that are not.

    Returns
    -------
    dict
        Values of both by key, None where one has no such key.
    """

    def flat(value: Any, name: str) -> dict[str, Any]:
        last = name.rsplit(".", 1)[-1]
        if name in apart or last in apart:
            return {}
        if isinstance(value, Mapping):
            pairs = [(str(k), v) for k, v in value.items()]
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            pairs = [(str(v.get("name", v.get("set", i))), v) for i, v in enumerate(value, 1)]
        elif isinstance(value, list) and not value:
            return {}
        else:
            # JSON has no infinity and holds the word
            return {name: float(value) if last == "K" else np.asarray(value).tolist()}
        found: dict[str, Any] = {}
        for key, item in pairs:
            found |= flat(item, f"{name}.{key}")
        return found

    sides = []
    for deck in (one, other):
        found: dict[str, Any] = {}
        for table in deck if tables is None else tables:
            if table in deck and table not in NOT_TABLES:
                found |= flat(deck[table], table)
        sides.append(found)
    left, right = sides
    return {
        key: (left.get(key), right.get(key))
        for key in sorted({*left, *right})
        if left.get(key) != right.get(key)
    }


def in_words(different: Mapping[str, tuple[Any, Any]]) -> str:
    """Differences as text: keys, with both values where these are plain."""
    named = []
    for key, (one, other) in list(different.items())[:_MOST]:
        plain = all(isinstance(v, (int, float, str, bool)) for v in (one, other))
        named.append(f"{key} ({one}, not {other})" if plain else key)
    if len(different) > _MOST:
        named.append(f"{len(different) - _MOST} other keys")
    return ", ".join(named)
