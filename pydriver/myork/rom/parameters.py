"""Parameters of a trained reduced model: keys of the deck with their ranges."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from myork.errors import InputError
from myork.types import F64

_POSSIBLE = (
    "load.activation, material.NAME.KEY with activation, sigma_max, fiber_angle, K and the other "
    "moduli, and prescribed values such as boundary.SET.u_z or boundary.SET.rotation are possible"
)
#: Displacements prescribed by a boundary condition
PRESCRIBED = ("u_x", "u_y", "u_z", "radial", "rotation")
#: Keys of one material: those of its muscle, and moduli that enter the energy linearly
_OF_MATERIALS = (
    "activation", "sigma_max", "fiber_angle",
    "K", "mu", "C1", "C2", "C3", "A10", "A01", "A20", "A11", "A02", "A30", "A21", "A12", "A03",
)  # fmt: skip


class Parameter(NamedTuple):
    """A key of the deck that a reduced model leaves free."""

    key: str  #: Key as in `--set`
    #: Range of the training
    low: float
    high: float
    kind: str  #: `activation`, `sigma_max`, `fiber_angle`, `modulus`, `load` or `rotation`
    tissues: tuple[int, ...]  #: Materials that it changes, from 0; empty for a load or a rotation
    end: float = 1.0  #: Final value of its amplitude, which multiplies the value of the key

    @property
    def grows(self) -> bool:
        """Whether the value grows from zero with the load; material parameters do not."""
        return self.kind in ("activation", "load", "rotation")

    @property
    def columns(self) -> int:
        """Prescribed fields that it scales: a rotation has two, for its sine and for 1 - cosine."""
        return {"load": 1, "rotation": 2}.get(self.kind, 0)


def number_in(item: str, text: str, option: str = "--vary") -> float:
    """A finite number in an item of an option."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{option} {item}: {text.strip()!r} is not a number")
    return value


def numbers_in(item: str, form: str, option: str = "--vary") -> tuple[str, list[float]]:
    """Key and numbers of an item of an option, as many as a form such as `KEY=LOW:HIGH` has."""
    key, _, text = item.partition("=")
    words = text.split(":")
    if not key.strip() or len(words) != form.count(":") + 1:
        raise InputError(f"{option} {item}: {form} is needed")
    return key.strip(), [number_in(item, word, option) for word in words]


def parse_vary(items: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Ranges from texts `KEY=LOW:HIGH` of the option `--vary`."""
    pairs = [numbers_in(item, "KEY=LOW:HIGH") for item in items]
    found = {key: (low, high) for key, (low, high) in pairs}
    if len(found) < len(pairs):
        raise InputError("--vary: a key is given twice; give each parameter one range")
    return found


#: Largest number of values of one key of a map
_MOST_VALUES = 1_000_000


def grid_in(item: str) -> tuple[str, F64]:
    """Key and values of an item `KEY=LOW:HIGH:N` of the option `--vary`."""
    key, (low, high, count) = numbers_in(item, "KEY=LOW:HIGH:N")
    if not 1 <= count <= _MOST_VALUES or count % 1:
        raise InputError(
            f"--vary {item}: N must be a whole number from 1 to {_MOST_VALUES:,}, not {count:g}"
        )
    # 0.1, and not the number next to it
    return key, np.array([float(f"{value:.15g}") for value in np.linspace(low, high, int(count))])


def numbers_of(items: Sequence[str]) -> dict[str, float]:
    """Numbers from texts `KEY=VALUE` of the option `--set`."""
    pairs = (numbers_in(item, "KEY=VALUE", "--set") for item in items)
    return {key: value for key, (value,) in pairs}


def as_parameters(
    ranges: Mapping[str, Sequence[float]], deck: Mapping[str, Any], key_of: Callable[[str], str]
) -> tuple[Parameter, ...]:
    """Parameters of a deck from their ranges; short names are replaced by keys.

    - `ranges`: lowest and highest value by key as in `--set`, or by its last word
    - `deck`: values of the deck
    - `key_of`: function that gives the full name of a key, as `deck_key`
    - raises InputError: a key that no reduced model can vary, or an empty range
    """
    if not ranges:
        raise InputError("a reduced model needs parameters: give a key and its range")
    found = []
    for name, (low, high) in ranges.items():
        if not (np.isfinite([low, high]).all() and low < high):
            raise InputError(f"{name}: a range needs LOW < HIGH, not {low} and {high}")
        key = key_of(name) if "." in name else name
        parameter = _resolved(key, float(low), float(high), deck)
        end, *others = ends_of(deck).get(parameter.key, {1.0})
        if others:
            raise InputError(
                f"{parameter.key}: its muscles follow amplitudes with different final values; "
                "give each of them an activation of its own"
            )
        if end == 0.0:
            raise InputError(
                f"{parameter.key}: its amplitude ends at 0, and a reduced model answers for the "
                "end of a programme, where it has no effect; leave it out"
            )
        found.append(parameter._replace(end=end))
    keys = [parameter.key for parameter in found]
    if len(set(keys)) < len(keys):
        raise InputError(f"a parameter is given twice: {', '.join(keys)}")
    return tuple(found)


def short_names(parameters: Sequence[Parameter]) -> dict[str, str]:
    """Keys by their short names: the last word, if it belongs to one parameter only."""
    last = [parameter.key.rsplit(".", 1)[-1] for parameter in parameters]
    names = {parameter.key: parameter.key for parameter in parameters}
    for word, parameter in zip(last, parameters, strict=True):
        if last.count(word) == 1:
            names[word] = parameter.key
    return names


def spread_points(parameters: Sequence[Parameter], count: int, seed: int) -> F64:
    """Points that fill the range evenly (Sobol), shape `(count, p)`."""
    from scipy.stats import qmc

    power = int(np.ceil(np.log2(max(count, 2))))
    unit = qmc.Sobol(len(parameters), seed=seed).random_base2(power)[:count]
    return np.array([p.low for p in parameters]) + unit * widths_of(parameters)


def widths_of(parameters: Sequence[Parameter]) -> F64:
    """Widths of the ranges, shape `(p,)`."""
    return np.array([p.high - p.low for p in parameters])


def check_possible(name: str, values: F64) -> None:
    """Refuse values that no deck may have, but which the equations would accept.

    - `name`: key, or its last word
    - raises InputError: a value outside the limits
    """
    key = name.rpartition(".")[2]
    low, high = float(values.min(initial=np.inf)), float(values.max(initial=-np.inf))
    if key == "activation" and (low < 0.0 or high > 1.0):
        other = low if low < 0.0 else high
        raise InputError(f"{name}: activations lie between 0 and 1, not {other:g}")
    if key == "fiber_angle" and max(-low, high) > 180.0:
        other = low if -low > 180.0 else high
        raise InputError(f"{name}: angles lie between -180 and 180 degrees, not {other:g}")
    if key in ("sigma_max", "K", "mu") and low <= 0.0:
        raise InputError(f"{name}: {key} must be above 0, not {low:g}")


def value_of(parameter: Parameter, deck: Mapping[str, Any]) -> float:
    """Value of a parameter in a deck."""
    table, *entry, key = parameter.key.split(".")
    found = deck[table]
    if entry:
        found = next(e for e in found if entry[0] in (e.get("name"), e.get("set")))
    return float(found.get(key, deck["load"].get(key)))


def ends_of(deck: Mapping[str, Any]) -> dict[str, set[float]]:
    """Final values of the amplitudes used by keys of a deck, 1 for keys without an amplitude.

    The common activation has several if its muscles follow different amplitudes.
    """
    last = {entry["name"]: float(entry["value"][-1]) for entry in deck["amplitude"]}
    found: dict[str, set[float]] = {}
    for entry in deck["boundary"]:
        for key in PRESCRIBED:
            if key in entry:
                own = f"boundary.{entry['set']}.{key}"
                found.setdefault(own, set()).add(last.get(entry.get("amplitude"), 1.0))
    for entry in deck["material"]:
        if entry["model"] == "muscle":
            own = f"material.{entry['name']}." if "activation" in entry else "load."
            name = entry.get("amplitude", deck["load"].get("amplitude"))
            found.setdefault(f"{own}activation", set()).add(last.get(name, 1.0))
    return found


def _resolved(name: str, low: float, high: float, deck: Mapping[str, Any]) -> Parameter:
    table, *entry, key = ["", "", *name.split(".")][-3:]
    if key == "activation":
        check_possible(name, np.array([low, high]))
    if name in ("activation", "load.activation"):
        common = tuple(
            i
            for i, m in enumerate(deck["material"])
            if m["model"] == "muscle" and "activation" not in m
        )
        if not common:
            raise InputError(
                f"{name}: no muscle of the deck uses this activation: each has its own"
            )
        return Parameter("load.activation", low, high, "activation", common)
    if table == "boundary" and key in PRESCRIBED:
        known = [f"boundary.{b['set']}.{u}" for b in deck["boundary"] for u in PRESCRIBED if u in b]
        if name not in known:
            raise InputError(
                f"{name}: the deck prescribes no such value; it prescribes {', '.join(known)}"
            )
        return Parameter(name, low, high, "rotation" if key == "rotation" else "load", ())
    if table not in ("material", "") or key not in _OF_MATERIALS:
        raise InputError(f"{name}: a reduced model cannot vary it; {_POSSIBLE}")
    return _of_material(name, entry[0], low, high, deck["material"])


def _of_material(
    name: str, entry: str, low: float, high: float, materials: Sequence[Mapping[str, Any]]
) -> Parameter:
    """A constant of the only material that has it, or of a material given by name."""
    key = name.rpartition(".")[2]
    own = [
        i
        for i, m in enumerate(materials)
        if entry in ("", m["name"])
        and (m["model"] == "muscle" if key == "activation" else m.get(key) is not None)
    ]
    if len(own) != 1:
        raise InputError(
            f"{name}: name one material that has it, as material.NAME.{key}; the deck has "
            + ", ".join(m["name"] for m in materials)
        )
    material = materials[own[0]]
    if isinstance(material.get(key), str):
        raise InputError(f"{name}: it is an expression; a reduced model can only vary numbers")
    check_possible(name, np.array([low, high]))
    kind = key if key in ("activation", "sigma_max", "fiber_angle") else "modulus"
    return Parameter(f"material.{material['name']}.{key}", low, high, kind, tuple(own))
