"""A scene in memory, from a deck and its model file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from myork.core_scene import CoreScene
from myork.deck import load_deck
from myork.errors import FileError
from myork.model.store import read_model
from myork.records import PointCloud

__all__ = ["Scene"]


class Scene(CoreScene):
    """A scene in memory: solve, evaluate and reduce it without files.

    Parameters
    ----------
    path : str or Path
        Deck file.
    overrides : sequence of str
        `"table.key=value"` each.
    out : Path, optional
        Folder in which the model file of the deck is looked for first.
    threads : int, optional
        Number of threads of a solve; default all cores.

    Attributes
    ----------
    deck : dict
        The effective deck, defaults and overrides included.

    Raises
    ------
    InputError
        The deck, the model or the points are wrong; the message says where.
    FileError
        The model file is missing.

    Examples
    --------
    >>> from myork import Scene
    >>> with Scene("inputs/shear_3d.toml", ["load.steps=20"]) as scene:  # doctest: +SKIP
    ...     states = scene.solve()
    ...     stress = scene.fields(states.x[-1], 1.0).cauchy
    """

    def __init__(
        self,
        path: str | Path,
        overrides: Sequence[str] = (),
        out: Path | None = None,
        threads: int | None = None,
    ) -> None:
        self.deck = load_deck(path, overrides, "solve")
        super().__init__(
            str(path), overrides, _model_of(self.deck, Path(path).parent, out), threads
        )


def _model_of(deck: dict[str, Any], folder: Path, out: Path | None) -> PointCloud | None:
    """The model file of a deck; None where the deck has a geometry of its own."""
    geometry = deck["geometry"]
    if geometry["kind"] != "model":
        return None
    name = Path(geometry["file"])
    for place in (out, folder):
        if place is not None and (place / name).is_file():
            return read_model(place / name)
    raise FileError(
        f"geometry.file: no model {name} in {out or folder} or beside the deck: "
        "run `myork build` first"
    )
