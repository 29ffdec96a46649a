"""Threads of the compiled core."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from myork import _core

__all__ = ["core_threads", "thread_count"]


@contextmanager
def core_threads(number: int | None) -> Iterator[None]:
    """Let the core use so many threads inside a block, None for as many as before."""
    before = _core.set_threads(number or 0)
    try:
        yield
    finally:
        _core.set_threads(before)


def thread_count() -> int:
    """Number of threads that the core uses where nothing else is said."""
    return int(_core.set_threads(0))
