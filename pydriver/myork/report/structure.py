"""What a report needs the entries of `summary.json` to be.

Entries may be absent or null but for those with an exclamation mark.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from myork.errors import FileError

__all__ = ["check_summary"]


class _Each(dict[str, Any]):
    """Entries of any names, all alike; the only value says how."""


# Beyond this a number is damage: drawing squares and adds them
_LARGEST = 1e150

_NUMBER, _TEXT, _FLAG = "a number", "a text", "true or false"
# A number, or a list of numbers for a vector
_VALUE = "a number or a list of numbers"
# A word, a number or a list of them
_ENTRY = "a word, a number or a list of them"

_EXACT = {"value": _VALUE, "reference": _NUMBER, "relative_error": _NUMBER}
_REFERENCE = {
    **dict.fromkeys(("load", "activation", "value", "reference!", "relative_error"), [_NUMBER]),
    "source": _TEXT,
}
_STEP = {
    **dict.fromkeys(("load", "activation", "iterations", "min_J", "max_J"), _NUMBER),
    "probes": _Each(each=_VALUE),
    "probe_errors": _Each(each=_VALUE),
    "printed": _Each(each=_VALUE),
}
_MODEL = {
    "kind!": _TEXT,
    **dict.fromkeys(
        ("r!", "points", "e1", "e2", "stress_error", "force_error", "offline_s",
         "online_s_per_state", "speedup_vs_full", "speedup_vs_dgels"),
        _NUMBER,
    ),
    "probes": _Each(each=[_VALUE]),
}  # fmt: skip
_LABEL = {"pixels": _NUMBER, "volume": _NUMBER, "volume_of_parts": _NUMBER,
          "fat_fraction": _NUMBER}  # fmt: skip
_SEGMENTATION = {
    **dict.fromkeys(("failed", "source"), _TEXT),
    "labels": _Each(each=_LABEL),
    "scores": _Each(each={"dice": _NUMBER, "pcc": _NUMBER}),
    "energy": [_NUMBER],
    "maps": _Each(each=_TEXT),
    "channels": [{"name!": _TEXT, "weight!": _NUMBER}],
    "warnings": [_TEXT],
    "sets": [{"name!": _TEXT, "boundary_points!": _NUMBER, "area!": _NUMBER, "unit": _TEXT}],
    "orientation": [{"axes!": _TEXT, "crossing": _NUMBER, "agreement": _NUMBER}],
}
_DECK = {
    "probe": [{"name": _TEXT, "quantity": _TEXT, "set": _TEXT, "point": [_NUMBER]}],
    "geometry": {
        **dict.fromkeys(("kind", "file"), _TEXT),
        "size": [_NUMBER],
        **dict.fromkeys(("inner_radius", "outer_radius"), _NUMBER),
    },
    "material": [{"name": _TEXT}],
    "boundary": [_Each(each=_ENTRY)],
    "load": {"activation": _ENTRY},
    "build": {"labels": _TEXT, "surface": _TEXT},
}
_SUMMARY = {
    **dict.fromkeys(("title", "version", "method", "deck_sha256"), _TEXT),
    **dict.fromkeys(
        ("dimension", "source_points", "collocation_points", "dofs", "rows", "threads",
         "memory_peak_bytes", "force_imbalance", "work_mismatch"),
        _NUMBER,
    ),
    "converged": _FLAG,
    "verdict": {"state!": _TEXT, "reasons": [_TEXT]},
    "refine": {"met!": _FLAG, "reason!": _TEXT, "error!": _NUMBER, "levels": [_TEXT]},
    "units": _Each(each=_TEXT),
    "probe_units": _Each(each=_TEXT),
    "solver": {
        **dict.fromkeys(("asked", "used", "why"), _TEXT),
        **dict.fromkeys(("backward_error", "reciprocal_condition"), _NUMBER),
    },
    "overrides": [_TEXT],
    "warnings": [_TEXT],
    "sets": [{"name!": _TEXT, "boundary_points!": _NUMBER, "area!": _NUMBER, "unit": _TEXT}],
    "steps": [_STEP],
    "deck": _DECK,
    "companion": {
        "method": _TEXT, "same_points": _FLAG, "source_points": _NUMBER, "difference": _NUMBER,
    },
    "model": {"volume": _Each(each=_NUMBER)},
    "exact": _Each(each=_EXACT),
    "reference": _Each(each=_REFERENCE),
    "timings_s": _Each(each=_NUMBER),
    "rom": {
        "failed": _TEXT,
        "snapshots": _NUMBER,
        "pov": [_NUMBER],
        "full": {"load!": [_NUMBER], "probes": _Each(each=[_VALUE])},
        "models": [_MODEL],
    },
    "segmentation": _SEGMENTATION,
    "tissue": _SEGMENTATION,
}  # fmt: skip


def check_summary(path: Path, summary: Mapping[str, Any]) -> dict[str, Any]:
    """The summary without null entries of mappings, or an error that names the wrong entry.

    Parameters
    ----------
    path : Path
        `summary.json`, for messages.
    summary : mapping
        Its content.
    """
    found: dict[str, Any] = _checked(path, "", summary, _SUMMARY)
    for where, one, others in _of_one_length(found):
        for name, other in others.items():
            if len(other) != len(one):
                raise FileError(
                    f"{path}: {where}.{name}: {len(one)} values are needed, not {len(other)}; "
                    "the file is damaged"
                )
    for where, values in _of_one_width(found):
        if len({len(v) if isinstance(v, list) else 1 for v in values if v is not None}) > 1:
            raise FileError(
                f"{path}: {where}: as many components are needed everywhere; the file is damaged"
            )
    return found


def _checked(path: Path, where: str, value: Any, wanted: Any) -> Any:
    """The value, without null entries of mappings, if it is what is wanted."""
    if value is None:
        return None
    if isinstance(wanted, _Each) and isinstance(value, dict):
        wanted = _Each(dict.fromkeys(value, wanted["each"]))
    if isinstance(wanted, dict) and isinstance(value, dict):
        entries = {}
        for mark, how in wanted.items():
            name = mark if isinstance(wanted, _Each) else mark.removesuffix("!")
            entry = _checked(path, f"{where}.{name}".lstrip("."), value.get(name), how)
            if entry is None and mark != name:
                raise FileError(f"{path}: {where}: {name} is missing; the file is damaged")
            # null is a number that is not finite, and nothing else
            if entry is not None or (name in value and how in (_NUMBER, _VALUE)):
                entries[name] = entry
        return entries
    if isinstance(wanted, list) and isinstance(value, list):
        items = [_checked(path, f"{where}[{i}]", v, wanted[0]) for i, v in enumerate(value)]
        if None not in items or wanted[0] in (_NUMBER, _VALUE):
            return items
        where, value, wanted = f"{where}[{items.index(None)}]", None, wanted[0]
    if isinstance(wanted, str) and _is(value, wanted):
        return value
    kinds = {dict: "an object", list: "a list"}
    need = wanted if isinstance(wanted, str) else kinds[list if isinstance(wanted, list) else dict]
    said = "null" if value is None else repr(value)[:60]
    raise FileError(f"{path}: {where}: {need} is needed, not {said}; the file is damaged")


def _is(value: Any, wanted: str) -> bool:
    if wanted == _TEXT:
        return isinstance(value, str)
    if wanted == _FLAG:
        return isinstance(value, bool)
    if wanted == _ENTRY and isinstance(value, list):
        return all(part is None or _is(part, _ENTRY) for part in value)
    if wanted == _ENTRY and isinstance(value, str | bool):
        return True
    if wanted == _VALUE and isinstance(value, list):
        return 0 < len(value) <= 3 and all(part is None or _is(part, _NUMBER) for part in value)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value) and abs(value) <= _LARGEST


def _of_one_length(summary: Mapping[str, Any]) -> list[tuple[str, list[Any], dict[str, list[Any]]]]:
    """Lists that are drawn against each other: place, the first of them, the others by name."""
    found = []
    for name, entry in summary.get("reference", {}).items():
        lists = {key: value for key, value in entry.items() if isinstance(value, list) and value}
        if lists:
            found.append((f"reference.{name}", next(iter(lists.values())), lists))
    rom = summary.get("rom", {})
    full, models = rom.get("full", {}), rom.get("models", [])
    drawn = [("rom.full", full), *(("rom.models", model) for model in models)] if full else []
    for where, part in drawn:
        found.append((f"{where}.probes", full.get("load", []), part.get("probes", {})))
    return found


def _of_one_width(summary: Mapping[str, Any]) -> list[tuple[str, list[Any]]]:
    """Values of which a curve is made, with their place."""
    steps = [step.get("probes", {}) for step in summary.get("steps", [])]
    names = {name for step in steps for name in step}
    found = [(f"probe {name} of steps", [step.get(name) for step in steps]) for name in names]
    rom = summary.get("rom", {})
    for part in (rom.get("full", {}), *rom.get("models", [])):
        found += [(f"rom: probe {name}", values) for name, values in part.get("probes", {}).items()]
    return found
