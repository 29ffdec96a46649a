"""Files that are written completely or not at all."""

import csv
import fcntl
import io
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from errno import EISDIR
from importlib import resources
from pathlib import Path
from typing import Any

from myork.errors import FileError, InputError

#: Decks of the installation; those of the checkout for an editable one
INPUTS = Path(str(resources.files("myork") / "inputs" / "mg_muscle.toml")).parent


def open_output(path: Path, *, new: bool) -> int:
    """Open a path for output; the driver opens all output here, or below a path created here.

    Whoever can write to the folder may have put a link there; its target must not be
    overwritten.

    - `path`: the file
    - `new`: whether to create a new file in place of an existing one; otherwise an existing file is
      opened unchanged, and a missing one is created
    - returns descriptor for reading and writing
    - raises OSError: it cannot be opened, or the path of a file that is kept is a link
    """
    if new:
        path.unlink(missing_ok=True)
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
    return os.open(path, flags | (os.O_EXCL if new else 0), 0o666)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Lock an output folder while a station writes to it; it is created if it is missing.

    The executable `myork-solve` locks its folder in the same way. File systems without locks are
    accepted.

    - raises FileError: another run has locked the folder, or it cannot be written to
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = open_output(folder / ".lock", new=False)
    except OSError as reason:
        raise FileError(
            f"folder {folder} cannot be used for output: {reason.strerror or reason}"
        ) from None
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.read(file, 20).decode("ascii", "replace").strip()
            raise FileError(
                f"folder {folder} is in use by another run (process {owner or 'unknown'}): wait "
                "until it ends or name another folder"
            ) from None
        except OSError:
            pass
        else:
            os.ftruncate(file, 0)
            os.write(file, f"{os.getpid()}\n".encode())
        yield
    finally:
        os.close(file)


@contextmanager
def whole_file(path: Path, *, by_suffix: bool = False) -> Iterator[Path]:
    """Path to write to in a block; it is renamed to the final name when the block succeeds.

    - `path`: the file; it stays as it was until the new one is whole
    - `by_suffix`: whether the writer looks at the suffix: then `part.` is put before the name,
      otherwise `.part` after it
    - raises FileError: the file cannot be written
    """
    unfinished = path.with_name(f"part.{path.name}" if by_suffix else f"{path.name}.part")
    try:
        os.close(open_output(unfinished, new=True))
        yield unfinished
        os.replace(unfinished, path)
    except OSError as reason:
        raise FileError(f"{path}: cannot be written: {reason.strerror or reason}") from None


def check_writable(path: Path) -> None:
    """Refuse a file that `whole_file` could not write, before its content is computed.

    - raises FileError: it cannot be written
    """
    unfinished = path.with_name(f"{path.name}.part")
    try:
        if path.is_dir():
            raise IsADirectoryError(EISDIR, "it is a folder")
        os.close(open_output(unfinished, new=True))
        unfinished.unlink()
    except OSError as reason:
        raise FileError(f"{path}: cannot be written: {reason.strerror or reason}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file, in UTF-8, through `whole_file`."""
    with whole_file(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def read_text(path: Path) -> str:
    """Text of a small file, in UTF-8; FileError or InputError name the file."""
    try:
        return path.read_text("utf-8-sig")
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file") from None
    except OSError as reason:
        raise FileError(f"{path}: cannot be read: {reason.strerror}") from None
    except UnicodeDecodeError as reason:
        raise InputError(f"{path}: is not text: {reason}") from None


def json_text(value: Any, indent: int | None = None) -> str:
    """Mappings, lists, texts and numbers as JSON; numbers that are not finite become null."""
    return json.dumps(_finite(value), indent=indent, ensure_ascii=False)


def write_json(path: Path, value: Any) -> None:
    """Write a file of `json_text`."""
    write_text(path, json_text(value, indent=1) + "\n")


def write_csv(path: Path, head: Iterable[Any], rows: Iterable[Iterable[Any]]) -> None:
    """Write a table with a header row."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    write_text(path, text.getvalue())


def write_figure(path: Path, figure: Any) -> None:
    """Write a Matplotlib figure."""
    with whole_file(path) as unfinished:
        figure.savefig(unfinished, dpi=110, format="png")


def read_json(path: Path) -> dict[str, Any]:
    """Entries of a JSON file; FileError where it cannot be read or is not a single object."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except (OSError, ValueError) as reason:
        raise FileError(f"{path}: not a complete JSON file: {reason}") from None
    except RecursionError:
        raise FileError(f"{path}: not a complete JSON file: too deep") from None
    if not isinstance(content, dict):
        raise FileError(f"{path}: an object is needed, not {type(content).__name__}")
    return content


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is not a number that JSON can hold")


def _finite(value: Any) -> Any:
    """The same value with None in place of numbers that JSON cannot express."""
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
