"""Errors of the package: one class for each code of the Fortran core, each with an exit status.

The core reports an error as a pair (code, message); `check` turns the pair into an exception.
Messages are full sentences that name the place (file, line, key, point or material), the
offending value and what to do. `cure_of` says what to do where a shared library is missing.
"""

import importlib
import re
from typing import Any

_MISSING = re.compile(r"(lib[\w.+-]+): cannot open shared object file")


class MyorkError(Exception):
    """Base of all errors that the package raises on purpose.

    `exit_code` is the exit status of the command `myork` where this error ends it: 1 the run ended
    without convergence or its answer is refused, 2 bad input, 3 a missing or broken part of the
    installation.
    """

    exit_code = 1


class InputError(MyorkError):
    """Impossible value, bad deck or bad shape: the input must change."""

    exit_code = 2


class FileError(MyorkError):
    """A file is missing, unreadable or cannot be written."""

    exit_code = 2


class ConvergenceError(MyorkError):
    """The nonlinear solution was not reached; the last state is written."""


class RefusedError(MyorkError):
    """The answer of a whole run is refused by its own checks; it is written with the reasons."""


class LinalgError(MyorkError):
    """A factorisation failed or a matrix is singular."""


class ModelTooLargeError(MyorkError):
    """The scene does not fit into memory."""

    exit_code = 2


class StoppedError(MyorkError):
    """Stopped by the user; the last converged state is written."""


class InstallationError(MyorkError):
    """A part of the installation is missing or broken."""

    exit_code = 3


# The err_* constants of fortran/base/rk_error.f90
_BY_CODE: dict[int, type[MyorkError]] = {
    2: InputError,
    3: FileError,
    4: ConvergenceError,
    5: LinalgError,
    6: ModelTooLargeError,
    7: StoppedError,
}


def check(stat: int, message: str | bytes) -> None:
    """Raise the exception of a core status, if it is one.

    - `stat`: code returned by the core, 0 for success
    - `message`: its message; blanks at the end (a Fortran buffer) are cut off
    """
    if stat == 0:
        return
    text = message.decode("utf-8", "replace") if isinstance(message, bytes) else message
    raise _BY_CODE.get(int(stat), MyorkError)(text.rstrip(" \0"))


def optional(name: str, extra: str, what: object = "this") -> Any:
    """A library that only some need, or an error that says what needs it and names the extra."""
    try:
        return importlib.import_module(name)
    except ImportError as reason:
        raise InstallationError(
            f"{what} needs {name}: pip install 'myork[{extra}]' ({reason})"
        ) from None


def cure_of(complaint: str) -> str:
    """What to do about a complaint of the loader.

    - `complaint`: text of an exception, or what a program said that did not start
    - returns a sentence without a full stop
    """
    found = _MISSING.search(complaint)
    if found is None:
        return "install again (sh setup.sh, or pip install --force-reinstall)"
    return (
        f"the library {found[1]} is not on this machine, or another version of it: sh setup.sh "
        "installs it and builds again"
    )
