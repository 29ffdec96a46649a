"""What the header of a file promises, against what the file can hold and memory can take.

Asked before anything is read: a damaged header must not make a library take all memory, and a
cut file must not end as an image with noise in its last slices.
"""

from __future__ import annotations

import gzip
import math
import os
import resource
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

import numpy as np

from myork.errors import FileError, InputError, ModelTooLargeError, MyorkError

__all__ = [
    "DEFLATE_RATIO",
    "check_kind",
    "check_memory",
    "check_promise",
    "check_stream",
    "read_arrays",
    "read_text",
]

# The most that deflate (gzip, zlib) can pack into a byte
DEFLATE_RATIO = 1032

# No list of names and no table of gradients is longer [bytes].
_LONGEST_TEXT = 1 << 24
# Read at a time [bytes]
_CHUNK = 1 << 20


def check_kind(name: str, kind: np.dtype) -> None:
    """Refuse values that are not one plain number each."""
    if kind.kind == "c":
        raise InputError(
            f"{name}: the values are complex ({kind}); save their magnitude (or the part that is "
            "wanted) as an image of its own"
        )
    if kind.kind not in "biuf":
        raise InputError(
            f"{name}: the values are {'colours' if kind.names else 'no numbers'} ({kind}); save "
            "one grey value a voxel"
        )


def check_promise(name: str, shape: Sequence[int], promised: int, stored: int) -> None:
    """Refuse a header that promises more than its file holds, or than memory can take.

    Parameters
    ----------
    name : str
        File, for the message.
    shape : sequence
        Of the values that the header promises.
    promised : int
        Their size, with all that stands before them [bytes].
    stored : int
        What the file holds, or holds at most once unpacked [bytes].
    """
    if not shape or min(shape) < 1:
        raise FileError(
            f"{name}: the header promises an image of {_times(shape)} voxels; it is empty or the "
            "header is damaged: write the file again"
        )
    if promised > stored:
        raise FileError(
            f"{name}: cannot be read: the header promises {_times(shape)} values "
            f"({_size(promised)}), the file holds {_size(stored)} at most; it was cut off or its "
            "header is damaged: copy or write it again"
        )
    check_memory(name, math.prod(shape))


def check_memory(name: str, values: int) -> None:
    """Refuse values that do not fit into memory as floating point numbers."""
    room = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        room = min(room, limit)
    if 8 * values > room:
        raise ModelTooLargeError(
            f"{name}: its {values} values need {_size(8 * values)} of memory, there are "
            f"{_size(room)}; cut out the part that is wanted, or resample it"
        )


def check_stream(path: Path, needed: int, start: int = 0) -> int:
    """Length of what is stored compressed (gzip, zlib), whose check sums must agree.

    Parameters
    ----------
    path : Path
        The file; it is not kept in memory.
    needed : int
        Length that the header promises; reading ends at twice of it [bytes].
    start : int
        Where the compressed data begin [byte].
    """
    total = 0
    try:
        with path.open("rb") as file:
            file.seek(start)
            for block in _unpacked(file):
                total += len(block)
                if total > 2 * needed:
                    break
    except Exception as reason:  # zlib has an error of its own
        raise FileError(
            f"{path}: cannot be read: the compressed data are damaged after {_size(total)}: "
            f"{reason}; copy the file again"
        ) from None
    return total


def _unpacked(file: IO[bytes]) -> Iterator[bytes]:
    """Pieces of what the rest of a file holds compressed."""
    magic = file.read(2)
    file.seek(-len(magic), os.SEEK_CUR)
    if magic == b"\x1f\x8b":  # of one or more parts
        with gzip.GzipFile(fileobj=file) as members:
            while block := members.read(_CHUNK):
                yield block
        return
    stream = zlib.decompressobj()
    while not stream.eof:
        content = stream.unconsumed_tail or file.read(_CHUNK)
        if not content:
            raise EOFError("the end is missing")
        yield stream.decompress(content, _CHUNK)


def read_arrays(path: Path, names: Sequence[str]) -> list[np.ndarray]:
    """Arrays of numbers from a NumPy archive."""
    wanted = f"{path}: needs the arrays {' and '.join(names)}"
    try:
        with zipfile.ZipFile(path) as archive:
            stored = path.stat().st_size
            members = {member.filename: member for member in archive.infolist()}
            found = []
            for name in names:
                member = members.get(f"{name}.npy")
                if member is None:
                    raise InputError(f"{wanted}: {name} is not there")
                with archive.open(member) as stream:
                    found.append(_array(path, name, stream, DEFLATE_RATIO * stored))
            return found
    except MyorkError:
        raise
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file") from None
    except Exception as reason:  # zip, zlib and NumPy each have errors of their own
        raise InputError(
            f"{wanted}: the archive is damaged: {' '.join(str(reason).split())}; write it again"
        ) from None


def _array(path: Path, name: str, stream: IO[bytes], most: int) -> np.ndarray:
    """An array of an archive, of which its header does not promise more than it can hold."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0
    shape, by_columns, kind = (read if version == (1, 0) else np.lib.format.read_array_header_2_0)(
        stream
    )
    check_kind(f"{path}: {name}", kind)
    count = math.prod(shape)
    if not count:
        return np.zeros(shape)
    check_promise(f"{path}: {name}", shape, count * kind.itemsize, most)
    content = stream.read(count * kind.itemsize + 1)
    if len(content) != count * kind.itemsize:
        raise FileError(
            f"{path}: {name}: the header promises {_times(shape)} values, the archive holds "
            f"{'more' if len(content) > count * kind.itemsize else 'fewer'}; write it again"
        )
    return np.frombuffer(content, kind).reshape(shape, order="F" if by_columns else "C")


def read_text(path: Path) -> str:
    """Text of a small file."""
    try:
        with path.open("rb") as file:
            content = file.read(_LONGEST_TEXT + 1)
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file") from None
    except OSError as reason:
        raise FileError(f"{path}: cannot be read: {reason.strerror}") from None
    if len(content) > _LONGEST_TEXT:
        raise InputError(f"{path}: is longer than {_size(_LONGEST_TEXT)}; a small table is needed")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        raise InputError(f"{path}: is not text: {reason}") from None
    if "\0" in text:
        raise InputError(f"{path}: is not text, it holds a zero byte")
    return text


def _times(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape)) or "no"


def _size(number: float) -> str:
    """Number of bytes in words."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} TB"
