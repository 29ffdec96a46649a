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
# Attributes that the C++ reader also uses, in the order of the members of TableSpec and KeySpec
TABLE_MEMBERS = (
    "name", "many", "required", "named_by", "not_beside", "most", "needed_by", "at_least",
    "only_if", "keys",
)  # fmt: skip
KEY_MEMBERS = (
    "name", "type", "required", "default_toml", "choices", "min", "max", "above", "below", "length",
    "or_number", "scalar", "nonzero", "infinite", "unique", "ascending", "refers_to", "expression",
    "required_if", "only_if", "not_beside", "as_many_as", "default_if", "value_if",
)  # fmt: skip
TABLE_ATTRIBUTES = {*TABLE_MEMBERS, "about", "example", "record"} - {"name"}
KEY_ATTRIBUTES = {*KEY_MEMBERS, "default", "help", "unit"} - {"name", "default_toml"}
# Default maximum number of entries of an array of tables
MOST_ENTRIES = 1000
# Names that may occur in an expression in addition to pi
EXPRESSIONS = {
    "place": "x, y, z, r, theta",
    "surface": "x, y, z, r, theta and the outward normal nx, ny, nz",
    "time": "x, y, z, r, theta and in `[dynamics]` the time t",
    "energy": "I1, I2, I4, activation and the constants",
}
# Facts that deck_form.cpp derives besides the form, for conditions, in words for the reference
FACTS = {
    "order_two": "annuli of at least 3 points each way by `rkpm-gauss` that give neither order nor "
    "support",
    "plane_quadratic": "plane `rkpm-gauss` scenes of order 2 without support",
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
    for name, table in document.items():
        if "type" in table:
            tables[""]["keys"][name] = table
            continue
        own = ("keys", "only_if")
        tables[name] = {k: v for k, v in table.items() if k in own or not isinstance(v, dict)}
        keys = {k: v for k, v in table.items() if k not in own and isinstance(v, dict)}
        tables[name]["keys"] = {**keys, **tables[name].get("keys", {})}
    check(tables)
    return tables


def check(tables: dict[str, dict[str, Any]]) -> None:
    """Refuse a schema with unknown words, or with keys without an explanation."""
    wrong = []
    for name, table in tables.items():
        wrong += [f"[{name}]: {word}" for word in table.keys() - TABLE_ATTRIBUTES]
        if "about" not in table:
            wrong.append(f"[{name}]: about is missing")
        taken = table["record"] if isinstance(table.get("record"), list) else []
        for word in [table.get("named_by"), *table.get("at_least", []), *taken]:
            if word and word not in table["keys"]:
                wrong.append(f"[{name}]: no key {word}")
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
            choices = [*spec.get("default_if", []), *spec.get("value_if", [])]
            if any(not {"is", "when"} <= one.keys() <= {"is", "when", "why"} for one in choices):
                wrong.append(f"[{name}.{key}]: default_if and value_if take `is` and `when`")
                continue
            others = [other for choice in choices for other in choice["when"]]
            others += [*spec.get("not_beside", []), *spec.get("as_many_as", [])]
            others += [*table.get("only_if", {})]
            for other in [*spec.get("required_if", {}), *spec.get("only_if", {}), *others]:
                where, _, what = other.rpartition(".")
                if other in FACTS:
                    continue
                if what not in tables.get(where or name, {"keys": {}})["keys"]:
                    wrong.append(f"[{name}.{key}]: no key {other}")
    if wrong:
        sys.exit("schema.toml is wrong:\n" + "\n".join(wrong))


# ---- C++ ---------------------------------------------------------------------------------------


# Lengths given by the deck
LENGTHS = {"dimension": "dimension_length", "unknowns": "unknowns_length"}


def toml_text(value: object) -> str:
    """Write a value as in a deck."""
    return json.dumps(value)


def cpp(value: object) -> str:
    """C++ literal of a value: lists and maps in braces (JSON's escapes are C++'s)."""
    if isinstance(value, dict):
        value = [[key, one] for key, one in value.items()]
    if isinstance(value, list):
        return "{" + ", ".join(cpp(one) for one in value) + "}"
    return json.dumps(value)


def as_texts(values: list[Any]) -> list[str]:
    """Write values as in messages."""
    return [str(value) for value in values]


def conditions(wanted: dict[str, list[Any]]) -> dict[str, list[str]]:
    """Return the conditions with the values as texts."""
    return {key: as_texts(values) for key, values in wanted.items()}


def initialiser(members: tuple[str, ...], spec: dict[str, Any], own: dict[str, str]) -> str:
    """Initialiser of a structure: members from a table of the schema, some given by the caller."""
    texts = {word: cpp(value) for word, value in spec.items() if word in members} | own
    return "{" + ", ".join(f".{word} = {texts[word]}" for word in members if word in texts) + "}"


def cpp_key(name: str, spec: dict[str, Any]) -> str:
    """Initialiser of a KeySpec."""
    own = {"name": cpp(name), "type": f"Type::{spec['type']}"}
    if "default" in spec:
        own["default_toml"] = cpp(toml_text(spec["default"]))
    if "choices" in spec:
        own["choices"] = cpp(as_texts(spec["choices"]))
    if spec.get("length") in LENGTHS:
        own["length"] = LENGTHS[spec["length"]]
    for word in ("required_if", "only_if"):
        own[word] = cpp(conditions(spec.get(word, {})))
    own["default_if"] = cpp(
        [[toml_text(one["is"]), conditions(one["when"])] for one in spec.get("default_if", [])]
    )
    own["value_if"] = cpp(
        [
            [as_texts(one["is"]), conditions(one["when"]), one.get("why", "")]
            for one in spec.get("value_if", [])
        ]
    )
    return initialiser(KEY_MEMBERS, spec, own)


def most(table: dict[str, Any]) -> int:
    """State how often a table may occur in a deck."""
    return table.get("most", MOST_ENTRIES) if table.get("many") else 1


def cpp_table(tables: dict[str, dict[str, Any]]) -> str:
    """Source of ``rk::schema()``."""
    lines = []
    for name, table in tables.items():
        keys = ",\n".join(cpp_key(key, spec) for key, spec in table["keys"].items())
        own = {"name": cpp(name), "most": str(most(table)), "keys": f"{{\n{keys}}}"}
        lines.append(initialiser(TABLE_MEMBERS, table, own))
    head = '// Made from schema.toml by make_schema.py\n#include "deck.h"\n\n'
    head += "const std::vector<rk::TableSpec> &rk::schema() {\nusing namespace rk;\n"
    head += "static const std::vector<TableSpec> tables = {\n"
    return head + ",\n".join(lines) + "};\nreturn tables;\n}\n"


# ---- Fortran -----------------------------------------------------------------------------------

# Fortran components by type of key
COMPONENTS = {
    "text": "character(len=:), allocatable :: {}",
    "integer": "integer :: {} = 0",
    "integers": "integer, allocatable :: {}(:)",
    "number": "real(wp) :: {} = 0.0_wp",
    "numbers": "real(wp), allocatable :: {}(:)",
    "vector": "real(wp) :: {}(3) = 0.0_wp",
    "entry": "integer :: {} = 0",
    "value": "type(value_type) :: {}",
    "values": "type(value_type) :: {}(3)",
}


def component(spec: dict[str, Any]) -> str:
    """Return the key of COMPONENTS; empty for values that depend on more than their key."""
    kind = str(spec["type"])
    if "or_number" in spec:
        return ""
    if "refers_to" in spec:
        return "entry"
    if "expression" in spec:
        return "value" if kind == "number" else "values"
    return "vector" if kind == "numbers" and "length" in spec else kind


def records(tables: dict[str, dict[str, Any]], frame: str) -> str:
    """Write the module of the types of tables with `record`, and of their readers."""
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
    """Run the command line."""
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
