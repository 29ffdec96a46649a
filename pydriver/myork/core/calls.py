"""Calls into the core that take long, or that must not overlap.

The core keeps one set of working arrays for each scene, and other Python threads keep running
during a compiled call. A long call runs in a separate thread: the calling thread stays free for
Ctrl-C and progress, and always waits for the end of the call before it continues.
"""

import ctypes
import logging
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from myork import _core
from myork.errors import InputError, check


def called(function: Callable[..., Any], *arguments: Any) -> Any:
    """Results of a function of the core without its status and message; a single value by itself.

    An error status is raised as an exception.
    """
    *found, stat, message = function(*arguments)
    check(stat, message)
    return found[0] if len(found) == 1 else found


def answer(handle: int, question: str, *given: ArrayLike, word: str = "") -> dict[str, Any]:
    """Answer of the core about an open scene: arrays, numbers and texts by name.

    - `question`: a question of rk_questions
    - `given`: the numeric arguments of the question, one after the other
    - `word`: its text argument
    """
    # the wrapper takes no empty arrays: append one number, which the core ignores
    numbers = np.concatenate([np.ravel(array, order="F") for array in (*given, 0.0)])
    asked = handle, question.encode(), word.encode() or b" ", numbers
    forms, count = called(_core.scene_ask, *asked)
    values = _core.answer_numbers(handle, count) if count else np.empty(0)
    found: dict[str, Any] = {}
    for form in forms.decode().split("\n")[:-1]:
        name, kind, *extent = form.split()
        shape = tuple(map(int, extent))
        own, values = np.split(values, [math.prod(shape)])
        found[name] = own.reshape(shape, order="F")
        if kind != _REAL:
            found[name] = found[name].astype(np.int32)
        if kind == _TEXT:
            found[name] = own.astype(np.uint8).tobytes().decode("utf-8", "replace")
    return found


class Turn:
    """Access to a scene: short calls wait for each other, none waits for a solve."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._solver: int | None = None

    @contextmanager
    def short(self) -> Iterator[None]:
        """Exclusive access to the scene for a short call."""
        if not self._lock.acquire(blocking=self._solver is None):
            raise InputError(_BUSY)
        try:
            yield
        finally:
            self._lock.release()

    @contextmanager
    def long(self) -> Iterator[None]:
        """Exclusive access to the scene for a solve."""
        with self.short():
            self._solver = threading.get_ident()
            try:
                yield
            finally:
                self._solver = None

    @property
    def is_mine(self) -> bool:
        """Whether the calling thread is the one that solves."""
        return self._solver == threading.get_ident()

    @contextmanager
    def last(self, stop: Callable[[], None]) -> Iterator[None]:
        """Exclusive access for good: a running solve is asked to stop and waited for."""
        while not self._lock.acquire(timeout=_INTERVAL_S):
            stop()
        try:
            yield
        finally:
            self._lock.release()


#: Kinds of values in an answer, as in rk_handles
_REAL, _TEXT = "0", "2"

_BUSY = (
    "this scene is being solved: wait for the end of the solve, or open a scene of its own in each "
    "thread"
)

_INTERVAL_S = 0.05


#: A search for points that takes longer logs warnings, which Python shows by default [s]
_LONG_S = 10.0
_LISTENER = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_char_p)


@contextmanager
def listening(progress: Callable[[str], None] | None) -> Iterator[int]:
    """Address of a C function to which a search for points passes its lines.

    The core calls it often, with empty lines between the others, and stops when it returns 1: a
    signal or an error of `progress` ends the search, and is raised at the end of the block.

    - `progress`: called with every line; without it lines go to the logger `myork`, as information,
      or as warnings once the search takes long
    """
    began = time.monotonic()
    failures: list[BaseException] = []

    def logged(line: str) -> None:
        lasts = time.monotonic() - began > _LONG_S
        logging.getLogger("myork").log(logging.WARNING if lasts else logging.INFO, line)

    def hear(line: bytes) -> int:
        try:
            if line and not failures:
                (progress or logged)(line.decode("utf-8", "replace"))
        except BaseException as failure:
            failures.append(failure)
        return int(bool(failures))

    function = _LISTENER(hear)
    try:
        yield ctypes.cast(function, ctypes.c_void_p).value or 0
    finally:
        if failures:
            raise failures[0]


def call_in_thread(
    work: Callable[[], None], poll: Callable[[], None], stop: Callable[[], None]
) -> bool:
    """Run a compiled call in a thread and wait for its end in every case.

    - `work`: the call; its exceptions are raised here
    - `poll`: called repeatedly while it runs; if it raises, the call is stopped and waited for
      first
    - `stop`: asks the call to end soon
    - returns whether Ctrl-C (or SIGTERM, where it is handled likewise) arrived; the call was asked
      to stop
    """
    done = threading.Event()
    failures: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as failure:
            failures.append(failure)
        finally:
            done.set()

    with interrupts_held() as interrupts:
        threading.Thread(target=run, daemon=True).start()
        while not done.wait(_INTERVAL_S):
            # repeatedly: a call that has only just begun may clear the first request
            if interrupts or failures:
                stop()
                continue
            try:
                poll()
            except BaseException as failure:
                failures.append(failure)
    if failures:
        raise failures[0]
    return bool(interrupts)


@contextmanager
def interrupts_held(
    hear: Callable[[int], None] = lambda count: None, *, all_handlers: bool = False
) -> Iterator[list[int]]:
    """Collect SIGTERM and SIGINT while a block lasts.

    - `hear`: called at each signal with the number received so far
    - `all_handlers`: whether handlers set by others are replaced too; otherwise only those that
      would raise KeyboardInterrupt at any place of this thread
    """
    caught: list[int] = []

    def hold(number: int, frame: FrameType | None) -> None:
        caught.append(number)
        hear(len(caught))

    before: dict[int, Any] = {}
    try:
        # only the main thread receives signals and may set handlers
        if threading.current_thread() is threading.main_thread():
            for one in (signal.SIGTERM, signal.SIGINT):
                if all_handlers or signal.getsignal(one) is signal.default_int_handler:
                    before[one] = signal.signal(one, hold)
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
