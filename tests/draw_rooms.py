"""Write the rooms of the core into docs/rooms.md, from the sources themselves.

    python tests/draw_rooms.py

What a room holds stands in the first line of its meson.build, whom it uses in its `use` lines.
tests/test_layers.py compares it with what this script would write.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
FORTRAN = ROOT / "fortran"
PAGE = ROOT / "docs" / "rooms.md"

_HEAD = """\
# Rooms of the core

Each folder of sources in `fortran/` is a room: a static library with one purpose. A room uses rooms
below it, never one above or beside it; `tests/test_layers.py` checks that. This page is
written by `python tests/draw_rooms.py` from the `use` lines of the sources; nobody edits it, and a
test compares it with them.
"""


def rooms() -> dict[str, set[str]]:
    """The rooms by name, each with the rooms that its files use."""
    home = {path.stem: path.parent.name for path in FORTRAN.rglob("*.f90")}
    used: dict[str, set[str]] = {room: set() for room in home.values()}
    for path in FORTRAN.rglob("*.f90"):
        names = re.findall(r"^\s*use\s+(rk_\w+)", path.read_text(encoding="utf-8"), re.M | re.I)
        used[path.parent.name] |= {home[name.lower()] for name in names} - {path.parent.name}
    headers = {path.name: path.parent.name for path in FORTRAN.rglob("*.h")}
    for path in FORTRAN.rglob("*.cpp"):
        names = re.findall(r'^#include "(\w+\.h)"', path.read_text(encoding="utf-8"), re.M)
        used.setdefault(path.parent.name, set())
        used[path.parent.name] |= {headers[name] for name in names} - {path.parent.name}
    return used


def purpose(room: str) -> str:
    """What a room holds, by the first line of its meson.build."""
    path = next(path for path in FORTRAN.rglob("meson.build") if path.parent.name == room)
    found = re.match(r"# Room: (.+)\.\n", path.read_text(encoding="utf-8"))
    if found is None:
        raise ValueError(f"{path}: the first line must say '# Room: what it holds.'")
    return found[1]


def page() -> str:
    """Text of docs/rooms.md."""
    used = rooms()
    lines = [_HEAD, "| room | holds | uses |", "|---|---|---|"]
    for room in sorted(used):
        names = ", ".join(f"`{name}`" for name in sorted(used[room]))
        lines.append(f"| `{room}` | {purpose(room)} | {names} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
