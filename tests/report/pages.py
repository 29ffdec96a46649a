"""Pages that a report wrote, as tests read them; points and surfaces as the core makes them."""

import json
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from myork.core.scene import Scene
from myork.types import F64, I32
from tests.scenes import RUBBER, annulus, box, held, scene

VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Checks that tags are closed in order; collects what the tests ask for."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.sections: list[str] = []
        self.targets: list[str] = []
        self.text = ""
        self.source = path.read_text(encoding="utf-8")
        self.feed(self.source)
        assert self.open == [], "tags left open"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(found)
        if tag == "section":
            self.sections.append(str(found["id"]))
        if tag == "a":
            self.targets.append(str(found["href"]))
        assert tag not in {"script", "link", "iframe"}, "nothing is loaded from elsewhere"

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] != ["style"]:
            self.text += data


def change_summary(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "summary.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def grid(*source: int, size: Any = None, ring: bool = False) -> tuple[F64, I32]:
    """Points in space and surface of a box, of unit cells by default, or of a quarter ring."""
    n = len(source)
    geometry = box(*source, size=size or [k - 1.0 for k in source], places=source)
    if ring:
        geometry = annulus(*source, radii=(1, 2), places=source)
    tables = scene(
        "rkcm", geometry, material=[RUBBER], boundary=[held("x0", n)],
        approximation={"order": 2, "support": 3.0},
    )  # fmt: skip
    with Scene.from_tables(tables) as opened:
        return np.pad(opened.points(), ((0, 0), (0, 3 - n))), opened.surface()


def lattice_of(points: F64) -> I32:
    """Place of each point of a block, shape `(n, 3)`."""
    places = [np.unique(np.round(axis, 9), return_inverse=True)[1] for axis in points.T]
    return np.stack(places, axis=1).astype(np.int32)
