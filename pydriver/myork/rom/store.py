"""The file `.rom.h5`: arrays of a reduced model by name, with a head that says what they are.

Such files are passed on: rules that follow from the head hold for all arrays, when they are written
and when they are read. What is wrong is refused by the name of the file and of the array.
"""

import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from myork.arrays import (
    UNREADABLE,
    Rule,
    attribute,
    dataset,
    fitted,
    index,
    offsets,
    raw,
    real,
    whole,
)
from myork.errors import FileError, InputError
from myork.files import whole_file
from myork.model_file import model_of_bytes
from myork.rom.parameters import KINDS, Parameter
from myork.rom.probes import is_stress

FORMAT = "myork-rom 7"

_CELLS = {"all": int, "kept": int, "force": int}
_SPREAD = {"median": float, "max": float}
#: Types of the head; of a list those of each entry
_HEAD: dict[str, Any] = {
    "title": str,
    "units": {"force": str, "length": str, "stress": str, "volume": str},
    "parameters": [(str, float, float, str, [int], float)],
    "dimension": int,
    "force_amplitudes": int,
    "modes": int,
    "indicator_modes": int,
    "cells": _CELLS,
    "probes": [{"name": str, "quantity": str, "rows": [int], "index": int, "unit": str}],
    "probes_left_out": [str],
    "deck": str,
    "overrides": [str],
    "deck_sha256": str,
    "full_cpu_s": float,
    "tolerance": float,
    "full_solves": int,
    "solves_cpu_s": float,
    "offline_cpu_s": float,
}
#: Types of the certificate, where there is one
_CERTIFICATE: dict[str, Any] = {
    "points": int,
    "failed": int,
    "lost": int,
    "lost_unmarked": int,
    "u": _SPREAD,
    "force": _SPREAD,
    "over_estimate": float,
    "indicator_ratio": {"min": float, "max": float},
    "certified": {"points": int, "u": float, "force": float},
    "regression": {"force": _SPREAD, "cpu_us_per_state": float},
    "cpu_us_per_state": float,
    "full_cpu_s_per_state": float,
}


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write the arrays of a reduced model; the file is there whole or not at all.

    - raises InputError: an array is missing, wrong, or none of a reduced model
    """
    values = {name: np.asarray(v) for name, v in arrays.items() if name != "head"}
    head = np.asarray(np.bytes_(arrays["head"].encode()))
    values = _checked({**values, "head": head}) | {"head": head}
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs["format"] = np.bytes_(FORMAT)
        file.attrs["sha256"] = np.bytes_(_checksum(values))
        for name, value in values.items():
            file[name] = value
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content.getvalue())


def read_arrays(path: Path) -> dict[str, Any]:
    """Read what `write_arrays` wrote.

    - raises FileError: there is no such file, or its content is not what was written
    - raises InputError: it is of another format, or what it holds is no reduced model
    """
    if not path.is_file():
        raise FileError(f"{path}: there is no such reduced model; `myork rom train` writes one")
    try:
        with h5py.File(path, "r") as file:
            stamp = attribute(file, "format")
            if stamp != FORMAT:
                raise InputError(f"its format is '{stamp[:40]}', not '{FORMAT}'")
            names: list[str] = []
            file.visititems(
                lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
            )
            found = {name: dataset(file, name) for name in names}
            # nothing is compressed
            if sum(item.nbytes for item in found.values()) > path.stat().st_size:
                raise InputError("the shapes of its arrays declare more numbers than it contains")
            values = {name: np.asarray(item[()]) for name, item in found.items()}
            if attribute(file, "sha256") != _checksum(values):
                raise FileError("its content is damaged")
        return _checked(values)
    except (FileError, InputError) as reason:
        raise type(reason)(f"{path}: {reason}; train it again") from None
    except UNREADABLE as reason:
        raise FileError(f"{path}: is not a readable reduced model: {reason}") from None


def _checksum(values: Mapping[str, NDArray[Any]]) -> str:
    """Of names, types, shapes and numbers."""
    total = hashlib.sha256()
    for name, value in sorted(values.items()):
        total.update(f"{name} {value.dtype.str} {value.shape} ".encode())
        total.update(np.ascontiguousarray(value).tobytes())
    return total.hexdigest()


def _checked(values: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Arrays of the types that a reduced model takes, and the text of the head."""
    text = values.get("head")
    if text is None or text.shape != () or text.dtype.kind != "S":
        raise InputError("'head' is missing or not a text")
    words = bytes(text[()]).decode()
    head = json.loads(words)
    _check_head(head, _HEAD)
    if head.get("certificate"):
        _check_head(head["certificate"], _CERTIFICATE, "head.certificate")
        for key, ends in head["certificate"].get("ranges", {}).items():
            _check_head(ends, (float, float), f"head.certificate.ranges.{key}")
    rules, sizes = _rules(head)
    if "cloud" in values:
        rules["cloud"] = raw("u", np.uint8, "bytes")
    strange = sorted(values.keys() - rules.keys() - {"head"})
    if strange:
        raise InputError(f"it contains '{strange[0]}', which does not belong to this reduced model")
    arrays: dict[str, Any] = fitted(rules, values, sizes)
    _check_meaning(head, len(arrays["laws/fibers"]))
    if "cloud" in arrays:
        model_of_bytes(arrays["cloud"].tobytes(), "'cloud'")
    return arrays | {"head": words}


def _rules(head: Mapping[str, Any]) -> tuple[dict[str, Rule], dict[str, int]]:
    """Rules of the arrays that a head asks for, and the sizes that it knows."""
    kinds = [Parameter(*entry) for entry in head["parameters"]]
    quantities = {probe["name"]: probe["quantity"] for probe in head["probes"]}
    r, m = head["modes"], head["indicator_modes"]
    columns = 1 + sum(kind.columns for kind in kinds) + head["force_amplitudes"]
    forces = sum(len(probe["rows"]) for probe in head["probes"])
    sizes = {
        "dimension": head["dimension"],
        "parameters": len(kinds),
        "columns": columns,
        "forces": forces,
        "lifts": r * forces,
        # the core takes no empty arrays
        "moduli": max(1, sum(kind.kind == "modulus" for kind in kinds)),
        "places": sum(is_stress(quantity) for quantity in quantities.values()),
    }
    for group, n in (("online", r), ("indicator", m)):
        s = n + columns
        sizes |= {f"{group} modes": n, f"{group} amplitudes": s, f"{group} numbers": s + 1}
        sizes[f"{group} triples"] = (s + 1) * (s + 2) * (s + 3) // 6
    rules = {
        "laws/coefficients": real("tissues", 9),
        "laws/fibers": real("tissues", 7),
        "laws/fibered": raw("b", np.bool_, "tissues"),
        **{f"laws/{name}": real("tissues") for name in ("sigma_max", "activation", "angle")},
        "laws/modulus": real("moduli"),
        "laws/moduli": real("tissues", 2),
        "wanted": index("forces", of="columns"),
        "tractions": real("forces", "columns"),
        "training/parameters": real("states", "parameters"),
        "training/amplitudes": real("states", "indicator modes"),
        "training/forces": real("states", "forces"),
        "marks/values": real("marks", "parameters"),
        "marks/mark": whole("marks", least=1, most=3),
        "lifts/parameters": real("states of forces", "parameters"),
        "lifts/values": real("states of forces", "lifts"),
        "basis": real("unknowns", "online modes"),
        "points": real("points", "dimension"),
        "shapes": real("points", "components", "online modes"),
        **_cells("force", "force cells", "indicator amplitudes"),
    }
    for group in ("online", "indicator"):
        rules |= _cells(group, f"{group} cells", f"{group} amplitudes")
        rules |= {
            f"{group}/constant": real(*(2 * [f"{group} amplitudes"])),
            f"{group}/constant_slope": real(*(2 * [f"{group} amplitudes"]), "moduli"),
            f"{group}/volume": real(8, f"{group} triples", f"{group} pieces"),
            f"{group}/volume_slope": real(f"8 {group} pieces", "moduli"),
        }
    if sizes["places"]:
        rules |= _cells("places", "places", "online amplitudes")
        rules["places/pressure"] = real("places", *(3 * ["online numbers"]))
        rules["places/face"] = real(9, "places", "online amplitudes")
        rules |= {"places/normal": real("places", 3), "places/bulk": real("places")}
    for name, quantity in quantities.items():
        if quantity.startswith("u"):
            axes = "dimension" if quantity == "u" else 1
            rules[f"probes/{name}"] = real(axes, "indicator modes")
    return rules, sizes


def _cells(group: str, cells: str, amplitudes: str) -> dict[str, Rule]:
    """Rules of `Cells`; the core has room for one fiber of each tissue in a cell."""
    fibers = f"{group} fibers"
    rules = {
        "h": real(9, cells, amplitudes),
        "weight": real(cells),
        "local_bulk": real(cells),
        "a": real(9, cells),
        "first": offsets(cells, into=fibers, step="tissues"),
        "tissue": index(fibers, of="tissues", first=1),
        "fraction": real(fibers),
        "fiber": real(3, fibers),
        "a_slope": real(9, cells, "moduli"),
        "bulk_slope": real(cells, "moduli"),
        "layer": real(5, cells),
        "own": real(11, 2, cells),
        "own_slope": real(11, 2, cells, "moduli"),
        "pair": index(2, cells, of="tissues", first=1),
    }
    return {f"{group}/{key}": rule for key, rule in rules.items()}


def _check_head(value: Any, wanted: Any, where: str = "head") -> None:
    """Refuse an entry of the head that is missing or of another type."""
    inside: list[tuple[Any, Any, str]] = []
    kind = type(wanted) if isinstance(wanted, dict | list | tuple) else wanted
    if kind is dict and isinstance(value, dict):
        inside = [(value.get(key), types, f"{where}.{key}") for key, types in wanted.items()]
    elif kind is list and isinstance(value, list):
        inside = [(entry, wanted[0], f"{where}[{k}]") for k, entry in enumerate(value)]
    elif kind is tuple and isinstance(value, list) and len(value) == len(wanted):
        inside = [(value[k], types, f"{where}[{k}]") for k, types in enumerate(wanted)]
    elif not (
        (kind is int and type(value) is int and abs(value) < 2**31)
        or (kind is float and type(value) in (int, float))
        or (kind is str and isinstance(value, str))
    ):
        words = {dict: "a table", int: "a whole number", float: "a number", str: "a text"}
        need = words.get(kind, f"a list of {len(wanted)}" if kind is tuple else "a list")
        raise InputError(
            f"'head': {where.removeprefix('head.')} must be {need}, not {repr(value)[:40]}"
        )
    for entry in inside:
        _check_head(*entry)


def _check_meaning(head: Mapping[str, Any], tissues: int) -> None:
    """Refuse entries of the head that are out of range, or name what is not there."""
    r, m, probes = head["modes"], head["indicator_modes"], head["probes"]
    kinds = [Parameter(*entry) for entry in head["parameters"]]
    dimension = head["dimension"]
    if not (kinds and 2 <= dimension <= 3 and 1 <= r <= m and head["force_amplitudes"] >= 0):
        raise InputError(
            f"'head': {len(kinds)} parameters, {dimension} dimensions, {r} modes, {m} "
            f"indicator_modes, {head['force_amplitudes']} force_amplitudes: impossible numbers"
        )
    for p in kinds:
        if not (p.low < p.high and np.isfinite(p.high - p.low)):
            raise InputError(f"'head': the range of {p.key} is from {p.low} to {p.high}")
        if p.kind not in KINDS or not all(0 <= tissue < tissues for tissue in p.tissues):
            raise InputError(
                f"'head': {p.key} is {p.kind!r} of the tissues {p.tissues}; the model has {tissues}"
            )
    axes = [f"_{axis}" for axis in "xyz"[:dimension]]
    forces = {"force": dimension, **{f"force{axis}": 1 for axis in axes}}
    places = {"u", *(f"u{axis}" for axis in axes)}
    rows = [row for probe in probes for row in probe["rows"]]
    for probe in probes:
        quantity = probe["quantity"]
        if not (
            len(probe["rows"]) == forces.get(quantity, 0)
            and (quantity in forces or quantity in places or is_stress(quantity))
            and 0 <= probe["index"] < len(probes) + len(head["probes_left_out"])
        ):
            raise InputError(f"'head': impossible probe {repr(probe)[:120]}")
    for names in ([p.key for p in kinds], [probe["name"] for probe in probes]):
        if len(set(names)) < len(names):
            raise InputError(f"'head': one of {', '.join(names)} is named twice")
    if rows != list(range(len(rows))):
        raise InputError(f"'head': the rows of forces are {rows}, not in order from 0")
