"""Arrays checked against a table of rules, both when they are written and when they are read."""

from collections.abc import Mapping
from itertools import accumulate
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from myork.errors import InputError

#: Exceptions that h5py raises on damaged files, and json on damaged texts
UNREADABLE = (
    OSError, LookupError, ArithmeticError, ValueError, TypeError, RuntimeError, AttributeError,
    MemoryError,
)  # fmt: skip

_LEAST, _MOST = np.iinfo(np.int32).min, np.iinfo(np.int32).max


class Rule(NamedTuple):
    """What an array must be: kind of numbers, type, shape and range."""

    kinds: str  #: Kinds of numbers allowed, as in `numpy.dtype.kind`
    dtype: type  #: Type to which it is converted
    #: Numbers, or names of sizes such as `"points"`. An unknown size is set by the first array that
    #: has it, and is at least one.
    shape: tuple[int | str, ...]
    #: Range of its numbers; with the name of a size as `most`, they are indices from zero below it
    least: float = -np.inf
    most: float | str = np.inf


def real(*shape: int | str, least: float = -np.inf, most: float = np.inf) -> Rule:
    """Finite numbers."""
    return Rule("iuf", np.float64, shape, least, most)


def whole(*shape: int | str, least: float = _LEAST, most: float = _MOST) -> Rule:
    """Whole numbers of 32 bits."""
    return Rule("iu", np.int32, shape, least, most)


def index(*shape: int | str, of: str) -> Rule:
    """Indices from zero, smaller than a named size."""
    return Rule("iu", np.int32, shape, 0, of)


def attribute(file: h5py.File, name: str) -> str:
    """Text attribute of a file."""
    found = file.attrs.get(name)
    if not isinstance(found, bytes | str):
        raise InputError(f"the attribute '{name}' is missing or not a text")
    return found if isinstance(found, str) else found.decode()


def holds(file: h5py.Group, name: str) -> bool:
    """Whether a file contains something by this name."""
    return bool(file.id.links.exists(name.encode()))


def dataset(file: h5py.Group, name: str) -> h5py.Dataset:
    """Dataset of a file; its numbers are not read yet.

    - raises InputError: it is missing or not an array of numbers, its numbers are in another file,
      or its shape declares more numbers than this file can contain
    """
    for part in accumulate(name.split("/"), "{}/{}".format):
        if not holds(file, part):
            raise InputError(f"'{name}' is missing")
        # opening another file may wait for its other end
        if file.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
            raise InputError(f"'{name}' is a link, which may lead to another file")
    found = file[name]
    if (
        not isinstance(found, h5py.Dataset)
        or found.shape is None
        or found.dtype.kind not in "biufcS"
    ):
        raise InputError(f"'{name}' is not an array of numbers")
    if found.is_virtual or found.external:
        raise InputError(f"'{name}' has its numbers in another file")
    # Deflate shrinks by a factor of 1032 at most; a damaged header may declare any shape
    if found.nbytes > 1100 * found.id.get_storage_size():
        raise InputError(f"the shape of '{name}' declares far more numbers than the file contains")
    return found


def fitted(
    table: Mapping[str, Rule], found: Mapping[str, Any], sizes: Mapping[str, int]
) -> dict[str, NDArray[Any]]:
    """Arrays checked and converted by their table of rules.

    - `table`: rules by name
    - `found`: arrays by name, or datasets of a file, which are read when all shapes are right
    - `sizes`: known sizes
    - raises InputError: an array is missing or wrong; the message names it and the fault
    """
    known = dict(sizes)
    for name, rule in table.items():
        if name not in found:
            raise InputError(f"'{name}' is missing")
        _check_shape(name, found[name], rule, known)
    return {name: _checked(name, found[name][()], rule, known) for name, rule in table.items()}


def _check_shape(name: str, found: Any, rule: Rule, known: dict[str, int]) -> None:
    """Refuse a wrong shape or kind of numbers, and record sizes that were not known."""
    if found.dtype.kind not in rule.kinds:
        words = {"iuf": "numbers", "iu": "whole numbers"}[rule.kinds]
        raise InputError(f"'{name}' must contain {words}, not {found.dtype.name}")
    wanted = [known.get(n) if isinstance(n, str) else n for n in rule.shape]
    if len(found.shape) == len(wanted):
        for k, item in enumerate(rule.shape):
            if wanted[k] is None and found.shape[k] > 0:
                known[str(item)] = wanted[k] = found.shape[k]
    if found.shape != tuple(wanted):
        words = ", ".join(str(n if n is not None else item) for n, item in
                          zip(wanted, rule.shape, strict=True))  # fmt: skip
        raise InputError(
            f"'{name}' has shape {found.shape}, but ({words}{',' * (len(wanted) == 1)}) is needed"
        )


def _checked(name: str, found: Any, rule: Rule, known: Mapping[str, int]) -> NDArray[Any]:
    """Numbers of the wanted type, with an error where one is out of range."""
    values = np.asarray(found)
    if rule.dtype is np.float64:
        with np.errstate(over="ignore"):
            values = values.astype(float, copy=False)
    most = known[rule.most] - 1 if isinstance(rule.most, str) else rule.most
    good = (values >= rule.least) & (values <= most) & np.isfinite(values)
    if not good.all():
        at = np.unravel_index(int(np.argmin(good)), good.shape)
        entry = ", ".join(str(int(k)) for k in at)
        raise InputError(
            f"'{name}' must contain {_words(rule, most)}, but entry "
            f"{entry if len(at) == 1 else f'({entry})'} is {values[at]:.10g}"
        )
    return values.astype(rule.dtype, copy=False)


def _words(rule: Rule, most: Any) -> str:
    if isinstance(rule.most, str):
        return f"indices from {rule.least} to {most}"
    if rule.dtype is np.int32:
        return f"whole numbers from {rule.least} to {most}"
    if np.isfinite(most):
        return f"numbers from {rule.least:g} to {most:g}"
    if rule.least > 0:
        return "finite numbers above 0"
    return "finite numbers" + " not below 0" * (rule.least == 0)
