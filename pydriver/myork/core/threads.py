"""Threads of the compiled core."""

import operator
import os
from collections.abc import Iterator
from contextlib import contextmanager

from myork import _core
from myork.errors import InputError

#: More than any shared-memory machine has: the system would refuse to start them, and the
#: process would end
MOST_THREADS = 1024

# the threads of a parallel region do not outlive a fork
os.register_at_fork(after_in_child=_core.work_alone)


@contextmanager
def core_threads(number: int | None) -> Iterator[None]:
    """Let the core use a number of threads inside a block; None keeps the present number."""
    before = _core.set_threads(checked_threads(number))
    try:
        yield
    finally:
        _core.set_threads(before)


def checked_threads(number: int | None) -> int:
    """The number for the core, which takes 0 for all cores, as None and 0 mean.

    - raises InputError: it is not a whole number, or out of range
    """
    if number is None:
        return 0
    try:
        whole = operator.index(number)
    except TypeError:
        whole = -1
    if not 0 <= whole <= MOST_THREADS:
        raise InputError(
            f"the number of threads must be a whole number between 1 and {MOST_THREADS}, not "
            f"{number!r}"
        )
    return whole


def thread_count() -> int:
    """Number of threads that the core uses by default."""
    return int(_core.set_threads(0))
