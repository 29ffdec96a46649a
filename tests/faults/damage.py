"""Damage to the bytes of any file, as small edits that hypothesis finds, prints and shrinks.

An edit is (kind, position, argument). Positions beyond the end wrap around to the beginning.
"""

import io
import re
from collections.abc import Callable, Sequence
from typing import Any

import h5py
import numpy as np
from hypothesis import HealthCheck, Phase, reject, settings
from hypothesis import strategies as st

Edit = tuple[str, int, Any]
Way = Callable[[bytes, int, Any], bytes]

#: Replacement texts, and their number of repetitions
ODD = [
    *((text, 1) for text in (
        b"nan", b"inf", b"-inf", b"1e300", b"-1e300", b"1e-300", b"1e999", b"0", b"-0.0", b"-1",
        b"3", b"1000", b"2147483647", b"-2147483648", b"9223372036854775807", b"1_0", b"0x7fffffff",
        b"99999999999999999999", b"", b'""', rb'"\u0000"', rb'"\u0007\u001b[2J"', b"true", b"null",
        b"[]", b"[[]]", b"{}", b"[1,2,3,4,5]", b'["x",1]', b"1979-05-27", b"/dev/zero", b"[[", b'"',
        b"=", b"\xff\xfe")),
    (b"\0", 8), (b"\xc3\xa9", 50), (b"x", 5_000), (b"x", 500_000), (b"[", 300), (b"[", 100_000),
    (b'{"a":', 50_000), (b"{a=", 5_000),
]  # fmt: skip
REALS = (np.nan, np.inf, -np.inf, -1.0, 0.0, 0.5, 1e6, 1e19, 1e300, -1e300, 1e-300)
WHOLES = (-1, 0, 1, 2, 7, 64, 1000, 2**15 - 1, -(2**31), 2**31 - 1)
#: Replacements of an array; None removes it
ARRAYS: dict[str, Callable[[np.ndarray], Any]] = {
    "missing": lambda v: None,
    "empty": lambda v: v[:0],
    "scalar": lambda v: v.ravel()[0],
    "one less": lambda v: v[:-1],
    "one more": lambda v: np.concatenate([v, v[:1]]),
    "flat": np.ravel,
    "deep": lambda v: v.reshape((1,) * 6 + v.shape),
    "transposed": np.transpose,
    "falling": lambda v: v[::-1],
    "texts": lambda v: np.array([b"a"] * len(v)),
    "complex": lambda v: np.ones(v.shape, complex),
    "compound": lambda v: np.zeros(v.shape, [("a", "f8"), ("b", "i4")]),
    "single": lambda v: np.ones(v.shape, "f4"),
    "beyond": lambda v: np.full(v.shape, 2**33),
    "negated": np.negative,
    "shuffled": lambda v: np.random.default_rng(1).permutation(v.ravel()).reshape(v.shape),
    "last axis less": lambda v: v[..., :-1],
    "texts of any length": lambda v: np.array(["x"], h5py.string_dtype()),
    "opaque": lambda v: np.zeros(v.shape, "V3"),
    "nothing": lambda v: h5py.Empty("f8"),
    "logical": lambda v: np.zeros(v.shape, bool),
    "link": lambda v: h5py.SoftLink("/nowhere"),
    "another file": lambda v: h5py.ExternalLink("/dev/zero", "/x"),
    **{kind: lambda v, kind=kind: v.astype(kind) for kind in (
        "f2", "f4", ">f8", "f16", "i1", "i4", "i8", "u8")},
}  # fmt: skip
#: Changes to an array as a whole
MOVES = ("compressed", "exchanged", "group", "one more array")
_TEXT_ENDS = re.compile(rb"[^\t-\r -~\x80-\xff]")


def damaged(content: bytes, edits: Sequence[Edit]) -> bytes:
    """The same bytes after some edits."""
    for how, place, what in edits:
        content = _WAYS[how](content, place, what) if content else content
    return content


def _at(new: Callable[[bytes, Any], bytes], length: Callable[[Any], int]) -> Way:
    """Edit that replaces a number of bytes at a position."""

    def put(content: bytes, place: int, what: Any) -> bytes:
        at = place % len(content)
        end = at + length(what)
        return content[:at] + new(content[at:end], what) + content[end:]

    return put


def _odd(pattern: bytes) -> Way:
    """Edit that replaces the next match of a pattern in the text by something odd."""

    def put(content: bytes, place: int, what: tuple[bytes, int]) -> bytes:
        text = _TEXT_ENDS.split(content, maxsplit=1)[0]
        spans = [found.span() for found in re.finditer(pattern, text)]
        at, end = spans[place % len(spans)] if spans else (0, 0)
        return content[:at] + what[0] * what[1] + content[end:]

    return put


def _lines(content: bytes, place: int, what: tuple[int, int]) -> bytes:
    """Move some lines to another place; delete them if it is far away."""
    lines, (number, to) = content.splitlines(keepends=True), what
    at = place % len(lines)
    moved, lines[at : at + number] = lines[at : at + number], []
    return b"".join([*lines[:to], *moved, *lines[to:]] if to < 2 * len(lines) else lines)


def _array(content: bytes, place: int, what: str | tuple[int, float]) -> bytes:
    """Replace an array in an HDF5 file or NumPy archive, change one number of it, or remove it."""
    stream, changed = io.BytesIO(content), io.BytesIO()
    try:
        if content.startswith(b"PK"):
            with np.load(stream) as archive:
                arrays = dict(archive)
            name = sorted(arrays)[place % len(arrays)]
            arrays[name] = _other(arrays[name], what)
            np.savez(changed, **{key: v for key, v in arrays.items() if v is not None})
            return changed.getvalue()
        with h5py.File(stream, "r+") as file:
            names: list[str] = []
            file.visit(names.append)
            name, other = (names[k % len(names)] for k in (place, place // len(names)))
            values = file[name][()] if isinstance(file[name], h5py.Dataset) else np.zeros(0)
            if what == "one more array":
                file[f"{name} more"] = np.ones(3)
            elif what == "exchanged":
                file.move(name, "kept")
                if other != name:
                    file.move(other, name)
                file.move("kept", other)
            else:
                del file[name]
                if what == "group":
                    file.create_group(name)
                elif what == "compressed":
                    file.create_dataset(name, data=values, compression="gzip")
                elif what == "beyond" and values.ndim > 1:  # more than any disk holds
                    file.create_dataset(name, (2**40, 8), chunks=(1000, 8), dtype=float)
                elif (new := _other(values, what)) is not None:
                    file[name] = new
        return stream.getvalue()
    except Exception:  # earlier edits destroyed the file, or the array is missing
        reject()


def _other(values: np.ndarray, what: str | tuple[int, float]) -> Any:
    values = np.atleast_1d(values)
    if isinstance(what, str):
        return ARRAYS[what](values)
    values, (place, number) = values.copy(), what
    if values.dtype.kind != "f":
        number = WHOLES[place % len(WHOLES)]
    values.flat[place % values.size] = np.array(number).astype(values.dtype)
    return values


_WAYS: dict[str, Way] = {
    "cut": lambda content, place, _: content[: place % len(content)],
    "again": lambda content, place, _: content + content[place % len(content) :],
    "flip": _at(lambda old, bits: bytes([old[0] ^ bits]), lambda _: 1),
    "zeros": _at(lambda _, length: bytes(length), lambda length: length),
    "insert": _at(lambda _, odd: odd[0] * odd[1], lambda _: 0),
    "word": _odd(rb"[\w.+-]+"),
    "value": _odd(rb"(?<=[=:])[^\n]+"),
    "lines": _lines,
    "array": _array,
    # whole files from the tables of known damage
    "all": lambda content, _, what: what,
}

#: The same damage in every run; failures are shrunk and not stored
SETTINGS = settings(
    derandomize=True, database=None, deadline=None, report_multiple_bugs=False,
    suppress_health_check=list(HealthCheck), phases=[Phase.generate, Phase.shrink],
)  # fmt: skip


def _edits(how: str, what: st.SearchStrategy[Any]) -> st.SearchStrategy[Edit]:
    return st.tuples(st.just(how), st.integers(0, 400) | st.integers(0, 1 << 24), what)


_ODD, _BITS = st.sampled_from(ODD), st.integers(1, 255)
BYTES = st.one_of(
    _edits("cut", st.none()), _edits("again", st.none()), _edits("flip", _BITS),
    _edits("zeros", _BITS), _edits("insert", _ODD),
)  # fmt: skip
TEXT = st.one_of(
    _edits("word", _ODD), _edits("value", _ODD),
    _edits("lines", st.tuples(st.integers(1, 8), st.integers(0, 100))),
)  # fmt: skip
_NUMBER = st.tuples(st.integers(0, 1 << 16), st.sampled_from(REALS))
ARRAY = _edits("array", st.sampled_from([*sorted(ARRAYS), *MOVES]) | _NUMBER)
