"""The reference of decks from the schema: `python docs/reference.py` writes docs/decks.md."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "fortran" / "deck"))

from make_schema import EXPRESSIONS, FACTS, most, read_schema, toml_text  # noqa: E402

INTRODUCTION = """# Decks

<!-- Made from fortran/deck/schema.toml by `python docs/reference.py` -->

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
        each = {"dimension": "one per dimension", "unknowns": "one per unknown"}
        parts.append(each.get(spec["length"], f"{spec['length']} items"))
    if spec.get("refers_to"):
        parts.append(f"name of a [[{spec['refers_to']}]]")
    parts += [word for word in ("unique", "ascending") if spec.get(word)]
    if "as_many_as" in spec:
        parts.append(f"as many as {' or '.join(code([word]) for word in spec['as_many_as'])}")
    if "not_beside" in spec:
        parts.append(f"not together with {code(spec['not_beside'])}")
    if "expression" in spec:
        parts.append("in " + EXPRESSIONS[spec["expression"]])
    parts += [
        f"{code(choice['is'])} only for {condition_text(choice['when'])}"
        for choice in spec.get("value_if", [])
    ]
    return "; ".join(parts)


def needed(spec: dict[str, Any]) -> str:
    """Default of a key, or when it is needed."""
    if spec.get("required") and "only_if" not in spec:
        return "needed"
    words = [
        f"`{toml_text(choice['is'])}` for {condition_text(choice['when'])}"
        for choice in spec.get("default_if", [])
    ]
    if "default" in spec:
        words.append(f"{'otherwise ' * bool(words)}`{toml_text(spec['default'])}`")
    if "only_if" in spec:
        need, text = "needed" if spec.get("required") else "only", condition_text(spec["only_if"])
        words.append(f"{need} {text if text.startswith('together') else 'for ' + text}")
    return "; ".join(words)


def condition_text(conditions: dict[str, list[Any]]) -> str:
    """Conditions in words, long lists cut short."""
    parts = []
    for key, values in conditions.items():
        if key in FACTS:
            parts.append(FACTS[key])
            continue
        if not values:
            parts.append(f"together with {code([key])}")
            continue
        if key == "scene.method" and sorted(values) == ["rkpm-gauss", "rkpm-scni"]:
            parts.append("Galerkin forms")
            continue
        if values == ["none"]:
            parts.append("scenes without `[linear]`")
            continue
        short = [*values[:2], "…", values[-1]] if len(values) > 4 else values
        parts.append(f"{key} = {' or '.join(str(value) for value in short)}")
    return " and ".join(parts)


def example(name: str, table: dict[str, Any]) -> str:
    """The deck of inputs/ in which the table has most keys, in words."""
    head = rf"\[\[{name}\]\]" if table.get("many") else rf"\[{name}\]"
    keys_in: dict[str, int] = {}
    for path in sorted([*ROOT.glob("inputs/*.toml"), *ROOT.glob("inputs/images/*.toml")]):
        tables = re.findall(rf"^{head}.*\n((?:[^\[\n].*\n)+)", path.read_text("utf-8"), re.M)
        counts = [len(re.findall(r"^\w+ = ", text, re.M)) for text in tables]
        keys_in[path.relative_to(ROOT).as_posix()] = max(counts, default=0)
    return f"Example: `{max(keys_in, key=lambda one: keys_in[one])}`."


def section(name: str, table: dict[str, Any]) -> str:
    """Heading, table of keys and an example."""
    title = f"[[{name}]]" if table.get("many") else f"[{name}]"
    sentences = [table["about"]]
    if table.get("required"):
        sentences.append("Needed in every deck.")
    if "needed_by" in table:
        sentences.append(f"Needed by {code(table['needed_by'])}.")
    if "not_beside" in table:
        sentences.append(f"It is not needed together with `[{table['not_beside']}]`.")
    if "only_if" in table:
        sentences.append(f"Only for {condition_text(table['only_if'])}.")
    if "named_by" in table:
        sentences.append(f"An entry is named by its `{table['named_by']}`.")
    if table.get("many"):
        sentences.append(f"There may be {most(table):,} at most.")
    if "at_least" in table:
        sentences.append(f"At least one of {code(table['at_least'])}.")
    if name and "example" not in table:
        sentences.append(example(name, table))
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
    if "example" in table:
        lines.append(f"\n```toml\n{table['example']}```\n")
    return "".join(lines)


def reference(tables: dict[str, dict[str, Any]]) -> str:
    """Text of docs/decks.md."""
    return INTRODUCTION + "".join(section(name, table) for name, table in tables.items())


if __name__ == "__main__":
    schema = read_schema(ROOT / "fortran" / "deck" / "schema.toml")
    (ROOT / "docs" / "decks.md").write_text(reference(schema), encoding="utf-8")
