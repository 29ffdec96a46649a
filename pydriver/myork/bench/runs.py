"""Solves of decks by name, on one thread, each giving one record."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from myork.core.cloud import with_cloud
from myork.core.deck import load_deck
from myork.errors import InputError, RefusedError
from myork.files import INPUTS
from myork.model_file import write_model
from myork.records import PointCloud
from myork.stations.solve import run_deck
from myork.summary import read_summary

#: A deck file, the name of one in `INPUTS`, or tables
Deck = str | Path | Mapping[str, Any]


def read_deck(deck: Deck, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """All values of a deck, defaults and overrides included; see `load_deck`."""
    return load_deck(deck if isinstance(deck, Mapping) else path_of(deck), overrides)


def lattice(source: Sequence[int], collocation: Sequence[int] = ()) -> tuple[str, str]:
    """Overrides for source points along each edge, and collocation points.

    Without `collocation`, one collocation point is put between each two source points.
    """
    sizes = source, collocation or [2 * n - 1 for n in source]
    words = ("[" + ",".join(str(n) for n in size) + "]" for size in sizes)
    one, other = (
        f"geometry.{k}={w}" for k, w in zip(("source", "collocation"), words, strict=True)
    )
    return one, other


def solved(
    deck: Deck,
    overrides: Sequence[str] = (),
    *,
    cloud: PointCloud | None = None,
    look: Callable[[Path], Mapping[str, Any]] | None = None,
) -> dict[str, Any]:
    """Solve a deck with one thread, without error bars.

    - `cloud`: points of the body, for tables that need a model
    - `look`: called with the folder of the results before it is removed; the record is extended by
      what it returns
    - returns the summary with `iterations` of all steps, `probes` of the last one, and `history`,
      all steps
    - raises ConvergenceError: the full load was not reached
    """
    with tempfile.TemporaryDirectory(prefix="myork-") as folder:
        out = Path(folder)
        if cloud is not None:
            write_model(out / "model.h5", cloud)
            deck = with_cloud(dict(deck), cloud) if isinstance(deck, Mapping) else deck
        source = deck if isinstance(deck, Mapping) else path_of(deck)
        try:
            summary = run_deck(
                source, out, overrides=overrides, threads=1, verbosity=-1, error=False
            )
        except RefusedError:
            # a refused answer has converged all the same, and its numbers are on record
            summary = read_summary(out)
        seen = look(out) if look else {}
    steps = summary["steps"]
    more = {
        "iterations": sum(step["iterations"] for step in steps),
        "probes": steps[-1]["probes"],
        "history": steps,
    }
    return {**summary, **more, **seen}


def path_of(deck: str | Path) -> Path:
    """Path of a deck file."""
    path = deck if isinstance(deck, Path) else INPUTS / f"{deck}.toml"
    if not path.is_file():
        raise InputError(f"{path}: there is no such deck")
    return path
