"""Plain numbers and texts from files, and what the libraries that read them let pass."""

from pathlib import Path

import numpy as np

from myork.errors import FileError, InputError


def check_kind(name: str, kind: np.dtype) -> None:
    """Refuse values that are not one plain number each."""
    if kind.kind == "c":
        raise InputError(
            f"{name}: the values are complex ({kind}); save their magnitude (or one of the "
            "parts) as a separate image"
        )
    if kind.kind not in "biuf":
        raise InputError(
            f"{name}: the values are {'colours' if kind.names else 'no numbers'} ({kind}); save "
            "one grey value per voxel"
        )


def read_text(path: Path) -> str:
    """Text of a small file."""
    try:
        return path.read_text("utf-8-sig")
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file") from None
    except OSError as reason:
        raise FileError(f"{path}: cannot be read: {reason.strerror}") from None
    except UnicodeDecodeError as reason:
        raise InputError(f"{path}: is not text: {reason}") from None
