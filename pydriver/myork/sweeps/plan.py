"""Points of a sweep: grids, lists and samples of the keys of a deck."""

import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.core.deck import load_deck
from myork.errors import InputError
from myork.rom.parameters import grid_in, number_in

_FORMS = "KEY=LOW:HIGH:N, KEY=value,value,... , KEY=lhs(LOW,HIGH) or KEY=sobol(LOW,HIGH)"

#: More points are a slip of the pen
_MOST = 1_000_000


class Plan(NamedTuple):
    """Points of a sweep."""

    keys: tuple[str, ...]  #: Keys as in `--set`
    points: list[tuple[Any, ...]]  #: Values of the keys: numbers, or words of a list
    deck: Path = Path()
    overrides: tuple[str, ...] = ()  #: Overrides of the deck for all points
    #: How many points there were after each call that added some; none: all are of the first
    calls: tuple[int, ...] = ()

    def beside(self, points: Sequence[Sequence[Any]], calls: Sequence[int]) -> "Plan":
        """These points behind those of earlier calls, each point once."""
        earlier = [tuple(point) for point in points]
        known = set(earlier)
        every = [*earlier, *(point for point in self.points if point not in known)]
        more = (len(every),) if len(every) > len(earlier) else ()
        return self._replace(points=every, calls=(*calls, *more))

    def settings(self, point: tuple[Any, ...]) -> list[str]:
        """Overrides that make a point of the deck, without those for all."""
        return [f"{key}={value}" for key, value in zip(self.keys, point, strict=True)]

    def items(self, number: int) -> list[str]:
        """All overrides of a point, by its number."""
        return [*self.overrides, *self.settings(self.points[number])]

    def tables(self, number: int) -> dict[str, Any]:
        """The deck of a point, checked, by its number."""
        return load_deck(self.deck, self.items(number), "solve")


def make_plan(vary: Sequence[str], samples: int = 32, seed: int = 0) -> Plan:
    """All points: the product of grids and lists with the common samples of the sampled keys.

    - `vary`: `KEY=LOW:HIGH:N` for a grid, `KEY=a,b,c` for a list, `KEY=lhs(LOW,HIGH)` or
      `KEY=sobol(LOW,HIGH)` for samples
    - `samples`: number of samples
    - raises InputError: a wrong form, a key twice, too many points
    """
    if not vary:
        raise InputError(f"a sweep needs a key to vary: {_FORMS}")
    grids: dict[str, list[Any]] = {}
    ranges: dict[str, tuple[float, float]] = {}
    kinds = set()
    for item in vary:
        key, sign, text = (part.strip() for part in item.partition("="))
        if not (key and sign and text):
            raise InputError(f"--vary {item}: {_FORMS} is needed")
        if key in grids or key in ranges:
            raise InputError(f"--vary {item}: {key} is named twice")
        if sampled := re.fullmatch(r"(lhs|sobol)\(([^,]+),([^,]+)\)", text):
            kinds.add(sampled[1])
            low, high = number_in(item, sampled[2]), number_in(item, sampled[3])
            if not low < high:
                raise InputError(f"--vary {item}: {low:g} is not below {high:g}")
            ranges[key] = (low, high)
        elif ":" in text:
            grids[key] = grid_in(item)[1].tolist()
        else:
            grids[key] = [_value(word) for word in text.split(",")]
            if "" in grids[key]:
                raise InputError(f"--vary {item}: a value is missing between two commas")
    if len(kinds) > 1:
        raise InputError(
            "lhs and sobol cannot be mixed: the samples of all keys are drawn together"
        )
    count = int(np.prod([len(values) for values in grids.values()])) * (samples if ranges else 1)
    if not 1 <= count <= _MOST:
        raise InputError(f"{count} points: at least 1 and at most {_MOST} are possible")
    keys = (*grids, *ranges)
    drawn = _samples(ranges, kinds.pop(), samples, seed) if ranges else [()]
    points = [(*on_grid, *row) for on_grid in product(*grids.values()) for row in drawn]
    return Plan(keys, points)


def _value(text: str) -> Any:
    """A number where it is one, else the word."""
    word = text.strip()
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word


def _samples(
    ranges: dict[str, tuple[float, float]], kind: str, count: int, seed: int
) -> list[tuple[float, ...]]:
    from scipy.stats import qmc

    if count < 1:
        raise InputError(f"{count} samples: at least 1 is needed")
    low, high = np.array(list(ranges.values())).T
    if kind == "lhs":
        unit = qmc.LatinHypercube(len(ranges), seed=seed).random(count)
    else:
        power = int(np.ceil(np.log2(max(count, 2))))
        unit = qmc.Sobol(len(ranges), seed=seed).random_base2(power)[:count]
    return [tuple(float(v) for v in row) for row in low + unit * (high - low)]
