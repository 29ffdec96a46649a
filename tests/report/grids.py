"""Points and surfaces of blocks, as the core makes them."""

from typing import Any

import numpy as np

from myork.core.scene import Scene
from myork.types import F64, I32
from tests.scenes import RUBBER, annulus, box, held, scene


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
