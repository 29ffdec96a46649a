"""Files that a deck names, looked for in a folder of one's own data."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from myork.core.deck import load_deck
from myork.errors import FileError, InputError
from myork.imaging.dicom_choice import split_choice

__all__ = ["PATHS", "data_overrides"]

#: Keys of decks that name an image, a label map, a surface or tracts
PATHS = (
    "image.anatomy",
    "image.tensor",
    "image.dwi",
    "image.channels",
    "image.fat",
    "image.truth",
    "image.region",
    "image.body",
    "image.reference",
    "image.reference_anatomy",
    "image.seeds",
    "dixon.magnitude",
    "dixon.phase",
    "build.labels",
    "build.fibers",
    "build.fractions",
    "build.activation",
    "build.surface",
    "build.tracts",
    "tissue.fat",
    "tissue.connective",
)


def data_overrides(
    deck: str | Path, data: str | Path, overrides: Sequence[str] = (), command: str = ""
) -> list[str]:
    """Overrides that say where the files of a deck lie.

    A file that lies where the deck says is left there; others are looked for by their names in
    all folders below `data`.

    Parameters
    ----------
    deck : str or Path
        Deck file.
    data : str or Path
        Folder.
    overrides : sequence of str
        Overrides of the deck, `"table.key=value"`, read first.
    command : str
        Command that will use the deck.

    Returns
    -------
    list of str
        `"table.key=value"` each.
    """
    folder = Path(data)
    if not folder.is_dir():
        raise FileError(
            f"{folder}: there is no such folder; --data wants the one your images are in"
        )
    values = load_deck(deck, overrides, command)
    found = []
    for key in PATHS:
        table, name = key.split(".")
        wanted = values.get(table, {}).get(name)
        names = wanted if isinstance(wanted, list) else [wanted] if wanted else []
        own = [split_choice(Path(values["folder"]) / one) for one in names]
        if all(path.exists() for path, _ in own):
            continue
        places = [
            f"{path.resolve() if path.exists() else _place(deck, key, path, folder)}"
            + (f":{choice}" if choice else "")
            for path, choice in own
        ]
        text = json.dumps(places)
        found.append(f"{key}={text if isinstance(wanted, list) else places[0]}")
    return found


def _place(deck: str | Path, key: str, wanted: Path, folder: Path) -> Path:
    """The one file (or folder) of a name below a folder."""
    places = sorted(place.resolve() for place in folder.rglob(wanted.name))
    if not places:
        raise FileError(f"{deck}: there is no {wanted.name} ({key}) below {folder}")
    if len(places) > 1:
        raise InputError(
            f"{deck}: {len(places)} files below {folder} are called {wanted.name} "
            f"({key}): {places[0]}, {places[1]}; say which by --set {key}=PATH"
        )
    return places[0]
