"""Turn schema.toml into tables of C++ and records of Fortran, as the build does.

Usage::

    python make_schema.py --table schema.toml schema_table.cpp
    python make_schema.py --records schema.toml rk_deck_records.f90 deck_records.f90

Needs nothing but Python 3.10 and a TOML parser: ``tomllib`` (Python 3.11), ``tomli``, or the copy
of tomli inside pip.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

TYPES = ("text", "integer", "number", "boolean", "texts", "integers", "numbers")
TABLE_ATTRIBUTES = {
    "about", "example", "many", "named_by", "required", "needed_by", "not_beside", "at_least",
    "most", "record", "instead",
}  # fmt: skip
KEY_ATTRIBUTES = {
    "type", "help", "unit", "default", "required", "choices", "min", "max", "above", "below",
    "length", "or_number", "scalar", "nonzero", "infinite", "refers_to", "unique", "required_if",
    "only_if", "default_if", "expression", "not_beside", "as_many_as", "ascending",
}  # fmt: skip
#: Entries of an array of tables, where it does not say itself
MOST_ENTRIES = 1000
#: Names that may stand in an expression beside pi
EXPRESSIONS = {
    "place": "x, y, z, r, theta",
    "surface": "x, y, z, r, theta and the outward normal nx, ny, nz",
    "time": "x, y, z, r, theta and in `[dynamics]` the time t",
    "fields": "x, y, z, r, theta and the fields of the place: displacement u_x, u_y, u_z, J, "
    "fiber_stretch, deformation gradient F_xx, F_xy to F_zz, Cauchy stress cauchy_xx, cauchy_yy, "
    "cauchy_zz, cauchy_xy, cauchy_yz, cauchy_xz, pressure, principal_max and principal_min",
    "energy": "I1, I2, I4, activation and the constants",
}
#: What deck_form.cpp finds out beside the form, for conditions, in words of the reference
FACTS = {
    "order_two": "a plane `rkpm-gauss` scene with neither order nor support, of an annulus with 3 "
    "points or more each way or with a probe of a stress on the surface",
    "plane_quadratic": "a plane `rkpm-gauss` scene of order 2 without support",
    "points_chosen": "a deck for whose probes MyoRK chooses source points, without pressures, "
    "tendons, prescribed displacements of parts of sides, `penalty` and `direct_limit`",
    "compared_on_the_way": "a [[reference]] at less than the full load",
}


def read_schema(path: Path) -> dict[str, dict[str, Any]]:
    """Read the schema as ``{table: {"keys": {key: attributes}, ...}}``.

    Keys outside every table are in the table ``""``.
    """
    for name in ("tomllib", "tomli", "pip._vendor.tomli"):
        try:
            parser = importlib.import_module(name)
        except ImportError:
            continue
        document = parser.loads(path.read_text(encoding="utf-8"))
        break
    else:
        sys.exit(
            f"make_schema.py: {sys.executable} has no TOML parser; "
            "use Python 3.11 or newer, or install tomli"
        )
    tables: dict[str, dict[str, Any]] = {"": {"about": "", "keys": {}}}
    tables[""]["instead"] = document.pop("instead", {})
    for name, table in document.items():
        if "type" in table:
            tables[""]["keys"][name] = table
            continue
        own = ("keys", "instead")
        tables[name] = {k: v for k, v in table.items() if k in own or not isinstance(v, dict)}
        keys = {k: v for k, v in table.items() if k not in own and isinstance(v, dict)}
        tables[name]["keys"] = {**keys, **tables[name].get("keys", {})}
        tables[name].setdefault("instead", {})
    check(tables)
    return tables


def check(tables: dict[str, dict[str, Any]]) -> None:
    """Refuse a schema with words that are not known here, or with keys that nobody explains."""
    wrong = []
    for name, table in tables.items():
        wrong += [f"[{name}]: {word}" for word in table.keys() - TABLE_ATTRIBUTES - {"keys"}]
        if "about" not in table:
            wrong.append(f"[{name}]: about is missing")
        taken = table["record"] if isinstance(table.get("record"), list) else []
        for word in [table.get("named_by"), *table.get("at_least", []), *taken]:
            if word and word not in table["keys"]:
                wrong.append(f"[{name}]: no key {word}")
        wrong += [f"[{name}]: {key} is a key" for key in table["instead"] if key in table["keys"]]
        if table.get("not_beside", name) not in tables:
            wrong.append(f"[{name}]: no table {table['not_beside']}")
        for key, spec in table["keys"].items():
            wrong += [f"[{name}.{key}]: {word}" for word in spec.keys() - KEY_ATTRIBUTES]
            if spec.get("type") not in TYPES or not spec.get("help"):
                wrong.append(f"[{name}.{key}]: type or help is missing")
            if spec.get("expression", "place") not in EXPRESSIONS:
                wrong.append(f"[{name}.{key}]: unknown kind of expression")
            if "refers_to" in spec and spec["refers_to"] not in tables:
                wrong.append(f"[{name}.{key}]: no table {spec['refers_to']}")
            choices = spec.get("default_if", [])
            if any(choice.keys() != {"is", "when"} for choice in choices):
                wrong.append(f"[{name}.{key}]: default_if takes `is` and `when`")
                continue
            others = [other for choice in choices for other in choice["when"]]
            others += [*spec.get("not_beside", []), *spec.get("as_many_as", [])]
            for other in [*spec.get("required_if", {}), *spec.get("only_if", {}), *others]:
                where, _, what = other.rpartition(".")
                if other in FACTS:
                    continue
                if what not in tables.get(where or name, {"keys": {}})["keys"]:
                    wrong.append(f"[{name}.{key}]: no key {other}")
    if wrong:
        sys.exit("schema.toml is wrong:\n" + "\n".join(wrong))


# ---- C++ ---------------------------------------------------------------------------------------


def quoted(value: object) -> str:
    """C++ text of a value (JSON's escapes are C++'s)."""
    return json.dumps(str(value))


def toml_text(value: object) -> str:
    """Write a value as in a deck."""
    return json.dumps(value)


def number(spec: dict[str, Any], name: str) -> str:
    """C++ optional number of an attribute."""
    return f"{float(spec[name])!r}" if name in spec else "std::nullopt"


def texts(values: list[Any]) -> str:
    """C++ list of texts."""
    return "{" + ", ".join(quoted(v) for v in values) + "}"


def flag(spec: dict[str, Any], name: str) -> str:
    """C++ logical of an attribute."""
    return "true" if spec.get(name) else "false"


def conditions(wanted: dict[str, list[Any]]) -> str:
    """C++ list of Condition."""
    pairs = [f"{{{quoted(key)}, {texts(values)}}}" for key, values in wanted.items()]
    return "{" + ", ".join(pairs) + "}"


def choices(spec: dict[str, Any]) -> str:
    """C++ list of Choice of a key."""
    pairs = [
        f"{{{quoted(toml_text(choice['is']))}, {conditions(choice['when'])}}}"
        for choice in spec.get("default_if", [])
    ]
    return "{" + ", ".join(pairs) + "}"


def cpp_key(name: str, spec: dict[str, Any]) -> str:
    """Initialiser of a KeySpec, in the order of its members in deck.h."""
    length = spec.get("length", "any_length")
    members = [
        quoted(name),
        f"Type::{spec['type']}",
        flag(spec, "required"),
        quoted(toml_text(spec["default"])) if "default" in spec else "std::nullopt",
        texts(spec.get("choices", [])),
        *(number(spec, bound) for bound in ("min", "max", "above", "below")),
        "dimension_length" if length == "dimension" else str(length),
        *(flag(spec, word) for word in ("or_number", "scalar", "nonzero", "infinite")),
        *(flag(spec, word) for word in ("unique", "ascending")),
        quoted(spec.get("refers_to", "")),
        quoted(spec.get("expression", "")),
        conditions(spec.get("required_if", {})),
        conditions(spec.get("only_if", {})),
        texts(spec.get("not_beside", [])),
        texts(spec.get("as_many_as", [])),
        choices(spec),
    ]
    return "         {" + ", ".join(members) + "},\n"


def most(table: dict[str, Any]) -> int:
    """How often a table may stand in a deck."""
    return table.get("most", MOST_ENTRIES) if table.get("many") else 1


def cpp_table(tables: dict[str, dict[str, Any]]) -> str:
    """Source of ``rk::schema()``."""
    lines = [
        "// Made from schema.toml by make_schema.py\n",
        '#include "deck.h"\n\n',
        "namespace rk {\n\n",
        "const std::vector<TableSpec> &schema() {\n",
        "   static const std::vector<TableSpec> tables = {\n",
    ]
    for name, table in tables.items():
        # in the order of the members of TableSpec in deck.h
        head = [quoted(name), flag(table, "many"), flag(table, "required")]
        head.append(quoted(table.get("named_by", "")))
        head.append(quoted(table.get("not_beside", "")))
        head.append(str(most(table)))
        head += [texts(table.get(word, [])) for word in ("needed_by", "at_least")]
        pairs = [f"{{{quoted(k)}, {quoted(v)}}}" for k, v in table["instead"].items()]
        head.append("{" + ", ".join(pairs) + "}")
        keys = "".join(cpp_key(key, spec) for key, spec in table["keys"].items())
        lines.append(f"      {{{', '.join(head)}, {{\n{keys}      }}}},\n")
    lines.append("   };\n   return tables;\n}\n\n} // namespace rk\n")
    return "".join(lines)


# ---- Fortran -----------------------------------------------------------------------------------

#: Components by the types of keys
COMPONENTS = {
    "text": "character(len=:), allocatable :: {}",
    "integer": "integer :: {} = 0",
    "integers": "integer, allocatable :: {}(:)",
    "number": "real(wp) :: {} = 0.0_wp",
    "numbers": "real(wp), allocatable :: {}(:)",
    "boolean": "logical :: {} = .false.",
    "vector": "real(wp) :: {}(3) = 0.0_wp",
    "entry": "integer :: {} = 0",
    "value": "type(value_type) :: {}",
    "values": "type(value_type) :: {}(3)",
}


def component(spec: dict[str, Any]) -> str:
    """Key of COMPONENTS; empty where a value needs more than a look at its key."""
    kind = str(spec["type"])
    if "or_number" in spec:
        return ""
    if "refers_to" in spec:
        return "entry"
    if "expression" in spec:
        return "value" if kind == "number" else "values"
    return "vector" if kind == "numbers" and "length" in spec else kind


def records(tables: dict[str, dict[str, Any]], frame: str) -> str:
    """Types with the plain values of tables with `record`, and their readers, in their module."""
    types, readers = [], []
    for name, table in tables.items():
        if not table.get("record"):
            continue
        kinds = {key: component(spec) for key, spec in table["keys"].items()}
        if table["record"] is not True:
            kinds = {key: kinds[key] for key in table["record"]}
        plain = {key: kind for key, kind in kinds.items() if kind}
        parts = [f"      {COMPONENTS[kind].format(key)}\n" for key, kind in plain.items()]
        types.append(
            f"   public :: {name}_keys\n   type :: {name}_keys\n{''.join(parts)}   contains\n"
            f"      procedure :: read => read_{name}\n   end type {name}_keys\n\n"
        )
        getter = {key: "get_vector" if kind == "vector" else "get" for key, kind in plain.items()}
        parts = [f"   call deck%{getter[key]}(at//'.{key}', self%{key})\n" for key in plain]
        readers.append(
            f"\nsubroutine read_{name}(self, deck, at)\n"
            f"   class({name}_keys), intent(inout) :: self\n"
            "   type(deck_type), intent(in) :: deck\n   character(len=*), intent(in) :: at\n\n"
            f"{''.join(parts)}end subroutine read_{name}\n"
        )
    text = "".join(types) + "contains\n" + "".join(readers)
    return frame.replace("   include 'deck_records.inc'\n", text)


def main(arguments: list[str]) -> None:
    """Do what the command line says."""
    if len(arguments) == 3 and arguments[0] == "--table":
        Path(arguments[2]).write_text(cpp_table(read_schema(Path(arguments[1]))), encoding="utf-8")
    elif len(arguments) == 4 and arguments[0] == "--records":
        frame = Path(arguments[2]).read_text(encoding="utf-8")
        Path(arguments[3]).write_text(
            records(read_schema(Path(arguments[1])), frame), encoding="utf-8"
        )
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
