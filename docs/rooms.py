"""The rooms of the core, from the sources themselves: `python docs/rooms.py` prints them.

The first line of its meson.build says what a room holds, its `use` lines say what it uses. The site
has the table below `docs/rooms.md`.
"""

import re
from pathlib import Path

FORTRAN = Path(__file__).parent.parent / "fortran"


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
    """What a room holds, from the first line of its meson.build."""
    path = next(path for path in FORTRAN.rglob("meson.build") if path.parent.name == room)
    found = re.match(r"# Room: (.+)\.\n", path.read_text(encoding="utf-8"))
    if found is None:
        raise ValueError(f"{path}: the first line must say '# Room: what it holds.'")
    return found[1]


def page() -> str:
    """The table."""
    used = rooms()
    lines = ["| room | holds | uses |", "|---|---|---|"]
    for room in sorted(used):
        names = ", ".join(f"`{name}`" for name in sorted(used[room]))
        lines.append(f"| `{room}` | {purpose(room)} | {names} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page())
