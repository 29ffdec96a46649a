"""Commented decks to start from."""

from importlib.resources import files
from pathlib import Path

from myork.errors import InputError
from myork.files import INPUTS, write_text

_FOLDER = Path(__file__).parents[1] / "templates"

#: Kinds that are another deck but for some of its lines
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


def schema_file() -> Path:
    """JSON Schema of decks, by which editors complete and check keys."""
    # an editable installation has what the build made in another folder than the package
    return Path(str(files("myork") / "deck.schema.json"))


def new_deck(kind: str, path: Path | None = None) -> Path:
    """Write a deck to start from; its first line names the JSON Schema for editors.

    - `kind`: one of `KINDS`
    - `path`: file to write; default `KIND.toml` here
    - returns the file
    - raises InputError: an unknown kind, or a file that is there already
    """
    if kind not in KINDS:
        raise InputError(f"there is no deck of kind {kind!r}; there are {', '.join(KINDS)}")
    path = path or Path(f"{kind}.toml")
    if path.exists():
        raise InputError(f"{path}: is there already; name another file with -o")
    path.parent.mkdir(parents=True, exist_ok=True)
    source, changes = _LIKE.get(kind, (_FOLDER / f"{kind}.toml", {}))
    text = source.read_text(encoding="utf-8")
    for old, new in changes.items():
        text = text.replace(old, new)
    write_text(path, f"#:schema {schema_file().as_uri()}\n{text}")
    return path
