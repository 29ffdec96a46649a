"""Prints a table of docs/: how settings of a method change its error and cost, what images give.

    python benchmarks/choices.py NAME [ARGUMENT...]

NAME is a function in `benchmarks/tables`, whose docstring tells what its table shows and which
arguments it takes. Tables about images take `tuned`, the cases on which settings were chosen, or
`other`, on which none was. Printed is Markdown, a row as soon as it is known. One thread, unless
they say otherwise; processor times include the set-up of a scene. Most take minutes.
"""

from __future__ import annotations

import inspect
import sys
from importlib import import_module
from pathlib import Path

import myork

#: Tables of each module
TABLES = {
    "forms": ("walls", "bulk", "newton", "own_loads", "wave", "mixed"),
    "large_leg": ("large_leg",),
    "gradient_axes": ("gradient_axes",),
    "partial_volume": ("partial_volume",),
    "real_images": ("real_images",),
    "shading_fields": ("shading_fields",),
    "tissues": ("tissues",),
    "thick_slices": ("thick_slices",),
    "walks": ("walks", "outlines"),
    "water_fat": ("water_fat",),
}


def main(name: str = "", *arguments: str) -> None:
    """Print the table that is named."""
    modules = {table: module for module, tables in TABLES.items() for table in tables}
    if name not in modules:
        sys.exit(f"{__doc__}\nThere are {', '.join(modules)}; no table {name!r}.")
    sys.path.insert(0, str(Path(__file__).parents[1]))
    table = getattr(import_module(f"benchmarks.tables.{modules[name]}"), name)
    wanted = inspect.signature(table)
    halves = "half" not in wanted.parameters or arguments[:1] in (("tuned",), ("other",))
    try:
        wanted.bind(*arguments)
    except TypeError:
        halves = False
    if not halves:
        sys.exit(f"{name}{wanted}\n\n{inspect.getdoc(table)}")
    print(f"MyoRK {myork.__version__}\n\n## {name}: {inspect.getdoc(table)}\n")
    for number, row in enumerate(table(*arguments)):
        print(f"| {' | '.join(row)} |", flush=True)
        if number == 0:
            print("|" + "---|" * len(row))


if __name__ == "__main__":
    main(*sys.argv[1:])
