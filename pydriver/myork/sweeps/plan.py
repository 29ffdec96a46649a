"""Points of a sweep, by grids, lists and samples of the keys of a deck, and the files they read."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.core.cloud import model_path
from myork.core.deck import load_deck
from myork.errors import FileError, InputError, MyorkError
from myork.rom.parameters import grid_in, number_in
from myork.rom.probes import probe_columns
from myork.stations.solve import BEFORE

_FORMS = "KEY=LOW:HIGH:N, KEY=value,value,... or KEY=lhs(LOW,HIGH)"

#: More points are considered a mistake
_MOST = 1_000_000
#: Columns of a table after keys, probes and error bars
LAST_COLUMNS = ("verdict", "message", "cpu_s")


class Plan(NamedTuple):
    """Points of a sweep."""

    keys: tuple[str, ...]  #: Keys as in `--set`
    points: list[tuple[Any, ...]]  #: Values of the keys: numbers, or words of a list
    deck: Path = Path()
    overrides: tuple[str, ...] = ()  #: Overrides of the deck for all points

    def settings(self, point: tuple[Any, ...]) -> list[str]:
        """Overrides for a point, without those for all points."""
        return [f"{key}={value}" for key, value in zip(self.keys, point, strict=True)]

    def items(self, number: int) -> list[str]:
        """All overrides of a point, by its number."""
        return [*self.overrides, *self.settings(self.points[number])]

    def tables(self, number: int) -> dict[str, Any]:
        """The deck of a point, checked, by its number."""
        return load_deck(self.deck, self.items(number), "solve")


def make_plan(vary: Sequence[str], samples: int = 32, seed: int = 0) -> Plan:
    """All points: the product of grids and lists with the common samples of the sampled keys.

    - `vary`: `KEY=LOW:HIGH:N` for a grid, `KEY=a,b,c` for a list, `KEY=lhs(LOW,HIGH)` for
      samples
    - `samples`: number of samples
    - raises InputError: a wrong form, a repeated key, too many points
    """
    if not vary:
        raise InputError(f"a sweep needs a key to vary: {_FORMS}")
    grids: dict[str, list[Any]] = {}
    ranges: dict[str, tuple[float, float]] = {}
    for item in vary:
        key, sign, text = (part.strip() for part in item.partition("="))
        if not (key and sign and text):
            raise InputError(f"--vary {item}: {_FORMS} is needed")
        if (table := key.partition(".")[0]) in BEFORE:
            raise InputError(
                f"--vary {item}: a sweep solves one model, and [{table}] acts before it is made; "
                "call `myork run` with each value"
            )
        if key in grids or key in ranges:
            raise InputError(f"--vary {item}: {key} is given twice")
        if sampled := re.fullmatch(r"lhs\(([^,]+),([^,]+)\)", text):
            low, high = number_in(item, sampled[1]), number_in(item, sampled[2])
            if not low < high:
                raise InputError(f"--vary {item}: {low:g} is not below {high:g}")
            ranges[key] = (low, high)
        elif ":" in text:
            grids[key] = grid_in(item)[1].tolist()
        else:
            # commas within a vector are kept
            grids[key] = [_value(word) for word in re.split(r",(?![^\[]*\])", text)]
            if "" in grids[key]:
                raise InputError(f"--vary {item}: a value is missing between two commas")
            if len({*map(str, grids[key])}) < len(grids[key]):
                raise InputError(f"--vary {item}: a value is given twice")
    count = int(np.prod([len(values) for values in grids.values()])) * (samples if ranges else 1)
    if not 1 <= count <= _MOST:
        raise InputError(f"{count} points: the number must be between 1 and {_MOST}")
    keys = (*grids, *ranges)
    drawn = _samples(ranges, samples, seed) if ranges else [()]
    points = [(*on_grid, *row) for on_grid in product(*grids.values()) for row in drawn]
    return Plan(keys, points)


def _value(text: str) -> Any:
    """The text as a number if it is one, otherwise unchanged."""
    word = text.strip()
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word


def _samples(
    ranges: dict[str, tuple[float, float]], count: int, seed: int
) -> list[tuple[float, ...]]:
    from scipy.stats import qmc

    if count < 1:
        raise InputError(f"{count} samples: at least 1 is needed")
    low, high = np.array(list(ranges.values())).T
    unit = qmc.LatinHypercube(len(ranges), seed=seed).random(count)
    return [tuple(float(v) for v in row) for row in low + unit * (high - low)]


def identity(
    plan: Plan, home: Path, model: Path | None = None, model_probes: Sequence[str] = ()
) -> dict[str, Any]:
    """Identity of a sweep: sweeps with equal contents are equal, wherever their files are.

    - `plan`: points and their deck
    - `home`: folder in which the model file of the deck is looked for first
    - `model`, `model_probes`: reduced model used, and names of the probes that it knows
    - returns digests of the files by kind (`inputs`), overrides, keys and points
    - raises InputError: two columns of the table would have the same name
    - raises FileError: a file cannot be read
    """
    paths = {"deck": plan.deck} | ({} if model is None else {"--model": model})
    # the files that are read depend on words and integers: files, methods, names
    chosen = {
        tuple(value for value in point if not isinstance(value, float)): number
        for number, point in reversed(list(enumerate(plan.points)))
    }
    for number in chosen.values():
        try:
            one = plan.tables(number)
        except MyorkError:
            # incompatible words: these points fail with the message
            continue
        probes = one["probe"]
        if model is None:
            file = model_path(one, Path(one["folder"]), home)
            paths |= {} if file is None else {f"geometry.file = {one['geometry']['file']}": file}
        else:
            probes = [probe for probe in probes if probe["name"] in model_probes]
        _check_columns(plan.keys, probes, one["scene"]["dimension"], plan.deck)
    return {
        "inputs": {name: _digest(path) for name, path in paths.items()},
        "overrides": list(plan.overrides),
        "keys": list(plan.keys),
        "points": [list(point) for point in plan.points],
    }


def refusal(head: Mapping[str, Any], other: Any, path: Path) -> str:
    """Why the points in a file are of another sweep, by both identities; "" if they are not."""
    if other == head:
        return ""
    anew = f"or sweep into another folder than {path.parent}"
    if not isinstance(other, dict) or any(
        other.get(kind) != head[kind] for kind in ("overrides", "keys", "points")
    ):
        return f"{path}: is of another sweep, with other keys, points or --set: remove it, {anew}"
    known = other.get("inputs", {})
    changed = [name for name, digest in head["inputs"].items() if known.get(name) != digest]
    return (
        f"{path}: is of another sweep, from before {', '.join(changed) or 'its files'} changed: "
        f"put the earlier file back, {anew}"
    )


def _check_columns(
    keys: Sequence[str], probes: Sequence[Mapping[str, Any]], dimension: int, deck: Path
) -> None:
    """Refuse probes whose columns another column of the table would overwrite."""
    taken = {key: f"the varied key {key}" for key in keys}
    taken |= dict.fromkeys(LAST_COLUMNS, "every sweep")
    for probe in probes:
        own = probe_columns(probe, dimension)
        for column in (*own, *(f"{name}_error" for name in own)):
            if column in taken:
                raise InputError(
                    f"{deck}: probe.{probe['name']}: its column {column} of sweep.csv is also a "
                    f"column of {taken[column]}: rename the probe"
                )
            taken[column] = f"the probe {probe['name']}"


def _digest(path: Path) -> str:
    """SHA-256 of a file."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as reason:
        raise FileError(f"{path}: cannot be read: {reason.strerror or reason}") from None
