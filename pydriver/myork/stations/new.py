"""Commented example decks."""

from pathlib import Path

from myork.errors import InputError
from myork.files import INPUTS, write_text

_FOLDER = Path(__file__).parents[1] / "templates"

#: Kinds that equal another deck except for some of its lines
_LIKE = {
    "leg": (
        INPUTS / "leg_section.toml",
        {"steps = 5\nactivation = 0.95       # section 4.2.5": "activation = 0.2"},
    ),
    "reduced": (
        _FOLDER / "muscle.toml",
        {"[7, 7, 13]": "[5, 5, 9]", "steps = 3 ": "steps = 10", "[1, 2]    ": "[1, 2, 5] "},
    ),
}
#: Kinds of decks
KINDS = ("box", "annulus", "muscle", "labels", "images", "leg", "reduced")


def new_deck(kind: str, path: Path | None = None) -> Path:
    """Write a deck to start from.

    - `kind`: one of `KINDS`
    - `path`: file to write; default `KIND.toml` here
    - returns the file
    - raises InputError: an unknown kind, or the file already exists
    """
    if kind not in KINDS:
        raise InputError(f"unknown kind of deck {kind!r}; choose one of {', '.join(KINDS)}")
    path = path or Path(f"{kind}.toml")
    if path.exists():
        raise InputError(f"{path}: already exists; choose another file with -o")
    path.parent.mkdir(parents=True, exist_ok=True)
    source, changes = _LIKE.get(kind, (_FOLDER / f"{kind}.toml", {}))
    text = source.read_text(encoding="utf-8")
    for old, new in changes.items():
        text = text.replace(old, new)
    write_text(path, text)
    return path
