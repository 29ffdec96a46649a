"""Turn schema.toml into tables of C++, records of Fortran and docs/decks.md.

Usage::

    python make_schema.py --table schema.toml schema_table.cpp
    python make_schema.py --records schema.toml rk_deck_records.f90 deck_records.f90
    python make_schema.py --reference

The build does the first two.

Needs nothing but Python 3.10 and a TOML parser: ``tomllib`` (Python 3.11), ``tomli``, or the copy
of tomli inside pip.
"""

from __future__ import annotations

import importlib
import json
import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
TYPES = ("text", "integer", "number", "boolean", "texts", "integers", "numbers")
TABLE_ATTRIBUTES = {
    "about", "example", "many", "named_by", "required", "needed_by", "not_beside", "at_least",
    "most", "record",
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
    for name, table in document.items():
        if "type" in table:
            tables[""]["keys"][name] = table
            continue
        tables[name] = {k: v for k, v in table.items() if not isinstance(v, dict)}
        keys = {k: v for k, v in table.items() if isinstance(v, dict)}
        named = keys.pop("keys", {})
        tables[name]["keys"] = {**keys, **named}
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


# ---- reference -----------------------------------------------------------------------------------

INTRODUCTION = """# Decks

<!-- Made from fortran/deck/schema.toml by `python fortran/deck/make_schema.py --reference` -->

A deck is a TOML file that both `myork` and `myork-solve` read. Unknown keys, wrong types, missing
keys and impossible values are errors, all listed at once, each as `file:line: table.key: what`.
Paths are relative to the deck. Numbers are in the units that `[units]` declares; a number may be
written as an integer, never as `nan`, and as `inf` only where the key allows it. A table that is absent takes its defaults.
Arrays have at most 100,000 items; of more than 100 errors the first 100 found are listed.

`--set table.key=value` replaces a value and is checked like the deck. It addresses a table, the
first entry of an array of tables (`material.K`), or an entry by its name (`material.fat.K`,
`boundary.x1.u_x`, `probe.mid.point`) or number (`reference.2.source`). Values are written as in
TOML (`geometry.source=[5,5,9]`); a word needs no quotes (`solver.linear=dgels`).

Where a key takes an expression, a text stands in place of a number: `"0.1*sin(pi*x)"`. It may have
the coordinates x, y, z, the distance r from the z axis and the angle theta about it, pi, numbers,
`+ - * / ^`, comparisons, `and`, `or`, `not( )`, `c ? a : b` and functions: `sin cos tan asin acos
atan atan2 sinh cosh tanh asinh acosh atanh exp ln log2 log10 sqrt abs sign rint min max sum avg`
(`log` is `ln`). What is not an expression, and a name that has no meaning there, is an error with its
position.

A point on the edge of two boundary sets takes a displacement component where either set prescribes
it. Traction rows there use the normal of the traction set, the mean normal where two traction sets
meet.
"""


def code(words: list[str]) -> str:
    """Words in code type."""
    return ", ".join(f"`{word}`" for word in words)


def allowed(spec: dict[str, Any]) -> str:
    """Range, choices and length of a key, in words."""
    parts = []
    if "choices" in spec:
        parts.append(code(spec["choices"]))
    signs = {"min": "≥", "above": ">", "max": "≤", "below": "<"}
    parts += [f"{sign} {spec[word]}" for word, sign in signs.items() if word in spec]
    if spec.get("infinite"):
        parts.append("or `inf`")
    if "length" in spec:
        one_each = spec["length"] == "dimension"
        parts.append("one per dimension" if one_each else f"{spec['length']} items")
    if spec.get("refers_to"):
        parts.append(f"name of a [[{spec['refers_to']}]]")
    parts += [word for word in ("unique", "ascending") if spec.get(word)]
    if "as_many_as" in spec:
        parts.append(f"as many as {' or '.join(code([word]) for word in spec['as_many_as'])}")
    if "not_beside" in spec:
        parts.append(f"not beside {code(spec['not_beside'])}")
    if "expression" in spec:
        parts.append("in " + EXPRESSIONS[spec["expression"]])
    return "; ".join(parts)


def needed(spec: dict[str, Any]) -> str:
    """Default of a key, or when it is needed."""
    if spec.get("required") and "only_if" not in spec:
        return "needed"
    words = []
    if "default" in spec:
        words.append(f"`{toml_text(spec['default'])}`")
    words += [
        f"`{toml_text(choice['is'])}` for {condition_text(choice['when'])}"
        for choice in spec.get("default_if", [])
    ]
    if "only_if" in spec:
        need, text = "needed" if spec.get("required") else "only", condition_text(spec["only_if"])
        words.append(f"{need} {text if text.startswith('beside') else 'for ' + text}")
    return ", ".join(words)


def condition_text(conditions: dict[str, list[Any]]) -> str:
    """Conditions in words, long lists cut short."""
    parts = []
    for key, values in conditions.items():
        if key in FACTS:
            parts.append(FACTS[key])
            continue
        if not values:
            parts.append(f"beside {code([key])}")
            continue
        short = [*values[:2], "…", values[-1]] if len(values) > 4 else values
        parts.append(f"{key} = {' or '.join(str(value) for value in short)}")
    return " and ".join(parts)


def example(name: str, table: dict[str, Any]) -> str:
    """The table as the deck of inputs/ with most of its keys has it, or as the schema says."""
    head = rf"\[\[{name}\]\]" if table.get("many") else rf"\[{name}\]"
    found = "", table.get("example", "")
    folder = HERE.parents[1] / "inputs"
    for path in sorted([*folder.glob("*.toml"), *folder.glob("images/*.toml")]):
        text = path.read_text(encoding="utf-8")
        for block in re.findall(rf"^{head}[^\n]*\n(?:[^\[\s][^\n]*\n| [^\n]*\n)+", text, re.M):
            keys, best = (len(re.findall(r"^\w+ = ", own, re.M)) for own in (block, found[1]))
            if keys > best and block.count("\n") < 17 and "example" not in table:
                found = f"inputs/{path.relative_to(folder).as_posix()}", block
    where, text = found
    if not text:
        return ""
    return f"\n```toml\n{text}```\n" + (f"\nFrom `{where}`.\n" if where else "")


def section(name: str, table: dict[str, Any]) -> str:
    """Heading, table of keys and an example."""
    title = f"[[{name}]]" if table.get("many") else f"[{name}]"
    sentences = [table["about"]]
    if table.get("required"):
        sentences.append("Needed in every deck.")
    if "needed_by" in table:
        sentences.append(f"Needed by {code(table['needed_by'])}.")
    if "not_beside" in table:
        sentences.append(f"It is not needed beside `[{table['not_beside']}]`.")
    if "named_by" in table:
        sentences.append(f"An entry is named by its `{table['named_by']}`.")
    if table.get("many"):
        sentences.append(f"There may be {most(table):,} at most.")
    if "at_least" in table:
        sentences.append(f"At least one of {code(table['at_least'])}.")
    lines = [f"\n## `{title}`\n\n" if name else "\n## Before the first table\n"]
    lines.append(" ".join(sentences) + "\n\n" if name else "\n")
    lines.append("| key | type | default | allowed | unit | meaning |\n|---|---|---|---|---|---|\n")
    for key, spec in table["keys"].items():
        kind = spec["type"]
        if spec.get("or_number") or spec.get("scalar"):
            kind += " or single value" if "expression" in spec else " or number"
        if "expression" in spec:
            kind = kind.replace("texts", "expressions").replace("text", "expression")
            kind += "" if "expression" in kind else " or expression"
        cells = [f"`{key}`", kind, needed(spec), allowed(spec), spec.get("unit", ""), spec["help"]]
        lines.append("| " + " | ".join(cells) + " |\n")
    return "".join(lines) + (example(name, table) if name else "")


def reference(tables: dict[str, dict[str, Any]]) -> str:
    """Text of docs/decks.md."""
    return INTRODUCTION + "".join(section(name, table) for name, table in tables.items())


def main(arguments: list[str]) -> None:
    """Do what the command line says."""
    if len(arguments) == 3 and arguments[0] == "--table":
        Path(arguments[2]).write_text(cpp_table(read_schema(Path(arguments[1]))), encoding="utf-8")
    elif len(arguments) == 4 and arguments[0] == "--records":
        frame = Path(arguments[2]).read_text(encoding="utf-8")
        Path(arguments[3]).write_text(
            records(read_schema(Path(arguments[1])), frame), encoding="utf-8"
        )
    elif arguments == ["--reference"]:
        target = HERE.parents[1] / "docs" / "decks.md"
        target.parent.mkdir(exist_ok=True)
        target.write_text(reference(read_schema(HERE / "schema.toml")), encoding="utf-8")
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
