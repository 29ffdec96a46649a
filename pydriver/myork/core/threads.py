"""Threads of the compiled core."""

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
    if number is not None and not 0 <= number <= MOST_THREADS:
        raise InputError(
            f"the number of threads must be between 1 and {MOST_THREADS}, not {number}"
        )
    before = _core.set_threads(number or 0)
    try:
        yield
    finally:
        _core.set_threads(before)


def thread_count() -> int:
    """Number of threads that the core uses by default."""
    return int(_core.set_threads(0))
