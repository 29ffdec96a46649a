"""Errors of the package: one class for each code of the Fortran core, each with an exit status.

The core reports an error as a pair (code, message); `check` turns the pair into an exception.
Messages are full sentences that name the place (file, line, key, point or material), the
offending value and the remedy. `cure_of` gives the remedy for a missing shared library.
"""

import importlib
import re
from typing import Any

_MISSING = re.compile(r"(lib[\w.+-]+): cannot open shared object file")


class MyorkError(Exception):
    """Base of all errors that the package raises on purpose.

    `exit_code` is the exit status of the command `myork` that this error stops: 1 no convergence or
    a refused answer, 2 bad input, 3 a missing or broken part of the
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
    """A complete run whose answer its own checks refuse; it is written with the reasons."""


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
    """Raise the exception that belongs to a status of the core; none for success.

    - `stat`: code returned by the core, 0 for success
    - `message`: its message; trailing blanks (of a Fortran buffer) are removed
    """
    if stat == 0:
        return
    text = message.decode("utf-8", "replace") if isinstance(message, bytes) else message
    raise _BY_CODE.get(int(stat), MyorkError)(text.rstrip(" \0"))


def optional(name: str, extra: str, what: object = "this") -> Any:
    """An optional library; without it an error names what needs it and the extra to install."""
    try:
        return importlib.import_module(name)
    except ImportError as reason:
        raise InstallationError(
            f"{what} needs {name}: pip install 'myork[{extra}]' ({reason})"
        ) from None


def cure_of(complaint: str) -> str:
    """Remedy for an error message of the loader.

    - `complaint`: text of an exception, or output of a program that did not start
    - returns a sentence without a full stop
    """
    found = _MISSING.search(complaint)
    if found is None:
        return "install again (sh setup.sh, or pip install --force-reinstall)"
    return (
        f"the library {found[1]} is not on this machine, or another version of it: sh setup.sh "
        "installs it and builds again"
    )
