"""Draw the rooms of the core into docs/rooms.md and rooms.svg, from the sources themselves.

    python tests/draw_rooms.py

What a room holds stands in the first line of its meson.build, whom it uses in its `use` lines.
tests/test_layers.py compares both with what this script would write.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
FORTRAN = ROOT / "fortran"
PAGE = ROOT / "docs" / "rooms.md"
PICTURE = ROOT / "docs" / "rooms.svg"

_HEAD = """\
# Rooms of the core

Each folder of sources in `fortran/` is a room: a static library with one purpose. A room uses rooms
below it, never one above or beside it; `tests/test_layers.py` checks that. This page is
written by `python tests/draw_rooms.py` from the `use` lines of the sources; nobody edits it, and a
test compares it with them. A line goes down from a room to one that it uses; lines that follow from
others are left out, as are those to `base`, which every room uses.
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


def layers(used: dict[str, set[str]]) -> list[list[str]]:
    """Rooms by the longest way down to a room that uses none, lowest first."""
    depth: dict[str, int] = {}

    def depth_of(room: str) -> int:
        if room not in depth:
            depth[room] = 1 + max((depth_of(other) for other in used[room]), default=-1)
        return depth[room]

    found: list[list[str]] = [[] for _ in range(1 + max(map(depth_of, used)))]
    for room in sorted(used):
        found[depth[room]].append(room)
    return found


def direct(used: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Arrows that do not follow from others."""

    def reached(room: str) -> set[str]:
        return used[room].union(*(reached(other) for other in used[room]))

    return [
        (room, other)
        for room in sorted(used)
        for other in sorted(used[room] - {"base"})
        if not any(other in reached(third) for third in used[room] - {other})
    ]


def places(used: dict[str, set[str]]) -> tuple[list[list[str]], list[tuple[str, str]]]:
    """Rows of the drawing, highest first, and lines from row to row.

    An arrow that passes a row has a place in it, `user>used`; places are ordered so that lines
    cross little.
    """
    levels = layers(used)[1:][::-1]
    row_of = {room: number for number, row in enumerate(levels) for room in row}
    rows = [list(row) for row in levels]
    lines = []
    for room, other in direct(used):
        before = room
        for number in range(row_of[room] + 1, row_of[other]):
            passing = f"{room}>{other} {number}"
            rows[number].append(passing)
            lines.append((before, passing))
            before = passing
        lines.append((before, other))
    for turn in range(24):
        down = turn % 2 == 0
        for number in range(1, len(rows)) if down else range(len(rows) - 2, -1, -1):
            fixed = rows[number - 1 if down else number + 1]

            def mean(name: str, fixed: list[str] = fixed, down: bool = down) -> float:
                near = [
                    fixed.index(a if down else b) for a, b in lines if (b if down else a) == name
                ]
                return sum(near) / len(near) if near else len(fixed) / 2

            rows[number].sort(key=mean)
    return rows, lines


def drawing() -> str:
    """Text of docs/rooms.svg."""
    rows, lines = places(rooms())
    wide, high, step, gap = 108, 26, 62, 14
    width = max(sum(gap if ">" in name else wide + gap for name in row) + 2 * gap for row in rows)
    at: dict[str, tuple[float, float]] = {}
    for number, row in enumerate(rows):
        whole = sum(gap if ">" in name else wide + gap for name in row)
        x = (width - whole) / 2
        for name in row:
            room = gap if ">" in name else wide + gap
            at[name] = (x + room / 2, gap + number * step + high / 2)
            x += room
    height = gap * 2 + (len(rows) - 1) * step + high
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" font-family="sans-serif" font-size="13">',
        "<title>Rooms of the core; a line goes down to a room that is used</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
        '<g fill="none" stroke="#5b6b7b" stroke-width="1.2">',
    ]
    for upper, lower in lines:
        (x1, y1), (x2, y2) = at[upper], at[lower]
        y1 += 0 if ">" in upper else high / 2
        y2 -= 0 if ">" in lower else high / 2
        bend = (y2 - y1) / 2
        out.append(
            f'<path d="M{x1:.1f} {y1:.1f}C{x1:.1f} {y1 + bend:.1f} {x2:.1f} {y2 - bend:.1f} '
            f'{x2:.1f} {y2:.1f}"/>'
        )
    out.append('</g><g fill="#e8f1f8" stroke="#0072b2">')
    boxes = [(name, x, y) for name, (x, y) in at.items() if ">" not in name]
    out += [
        f'<rect x="{x - wide / 2:.1f}" y="{y - high / 2:.1f}" width="{wide}" height="{high}" '
        'rx="5"/>'
        for _, x, y in boxes
    ]
    out.append('</g><g text-anchor="middle" fill="#1a1a1a">')
    out += [f'<text x="{x:.1f}" y="{y + 4.5:.1f}">{name}</text>' for name, x, y in boxes]
    return "\n".join([*out, "</g></svg>"]) + "\n"


def page() -> str:
    """Text of docs/rooms.md."""
    used = rooms()
    lines = [_HEAD, "![rooms and what they use](rooms.svg)"]
    lines += ["", "| room | holds | uses |", "|---|---|---|"]
    for layer in layers(used):
        for room in layer:
            names = ", ".join(f"`{name}`" for name in sorted(used[room]))
            lines.append(f"| `{room}` | {purpose(room)} | {names} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    PICTURE.write_text(drawing(), encoding="utf-8")
    sys.exit(0)
