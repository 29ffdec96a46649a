"""Calls into the core that take long, or that must not meet.

The core keeps one set of working arrays for each scene, and Python's threads run on while a
compiled call lasts. A long call runs in a thread of its own: the calling thread stays free for
Ctrl-C and progress, and always waits for the end of the call before it goes on.
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
    """What a function of the core gives before its status and message; a single value by itself.

    A status that is an error is raised.
    """
    *found, stat, message = function(*arguments)
    check(stat, message)
    return found[0] if len(found) == 1 else found


def answer(handle: int, question: str, *given: ArrayLike, word: str = "") -> dict[str, Any]:
    """What the core says of an open scene: arrays, numbers and texts by their names.

    - `question`: a question of rk_questions
    - `given`: the numbers that it needs, one after the other
    - `word`: the word that it needs
    """
    # the wrapper takes no empty arrays: one number more, which the core leaves out
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
    """Whose turn it is in a scene: short calls wait for each other, none waits for a solve."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._solver: int | None = None

    @contextmanager
    def short(self) -> Iterator[None]:
        """Have the scene alone for a moment."""
        if not self._lock.acquire(blocking=self._solver is None):
            raise InputError(_BUSY)
        try:
            yield
        finally:
            self._lock.release()

    @contextmanager
    def long(self) -> Iterator[None]:
        """Have the scene alone for a solve."""
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
        """Have the scene alone for good: a solve is asked to stop and waited for."""
        while not self._lock.acquire(timeout=_INTERVAL_S):
            stop()
        try:
            yield
        finally:
            self._lock.release()


#: What the numbers of an answer are, as in rk_handles
_REAL, _TEXT = "0", "2"

_BUSY = (
    "this scene is being solved: wait for the end of the solve, or open a scene of its own in each "
    "thread"
)

_INTERVAL_S = 0.05


#: A search for points that takes longer is a warning, which Python shows without being asked [s]
_LONG_S = 10.0
_LISTENER = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_char_p)


@contextmanager
def listening(progress: Callable[[str], None] | None) -> Iterator[int]:
    """Address of a C function to which a search for points hands its lines.

    The core calls it often, with empty lines between the others, and stops when it returns 1: a
    signal or an error of `progress` ends the search, and is raised at the end of the block.

    - `progress`: called with every line; without it lines go to the logger `myork`, as information,
      or as warnings where the search lasts
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
    """Run a compiled call in a thread and wait for its end, whatever happens meanwhile.

    - `work`: the call; what it raises is raised here
    - `poll`: called again and again while it runs; if it raises, the call is stopped and waited for
      first
    - `stop`: asks the call to end soon
    - returns whether Ctrl-C (or SIGTERM, where it is handled like that) came; the call was asked to
      stop
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
            # again and again: the call may only have begun and set itself going after a first one
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

    - `hear`: called at each with how many came so far
    - `all_handlers`: whether handlers that others have set are replaced as well, else only those
      that would raise KeyboardInterrupt at any place of this thread
    """
    caught: list[int] = []

    def hold(number: int, frame: FrameType | None) -> None:
        caught.append(number)
        hear(len(caught))

    before: dict[int, Any] = {}
    try:
        # only the main thread gets signals, and may set handlers
        if threading.current_thread() is threading.main_thread():
            for one in (signal.SIGTERM, signal.SIGINT):
                if all_handlers or signal.getsignal(one) is signal.default_int_handler:
                    before[one] = signal.signal(one, hold)
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
