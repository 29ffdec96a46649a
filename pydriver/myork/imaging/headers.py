"""Header data of a measurement: echo time and field strength, from DICOM or JSON files (BIDS).

Reference: The Brain Imaging Data Structure, version 1.10: file names, the inheritance principle,
metadata of magnetic resonance images
"""

import json
import math
from collections.abc import Mapping
from glob import escape
from pathlib import Path
from typing import Any, NamedTuple

from myork.errors import InputError
from myork.files import read_text
from myork.imaging.dicom import series_files, split_choice


class Header(NamedTuple):
    """Values found in a header; None where missing."""

    echo_time: float | None  #: Time of the echo [ms]
    field: float | None  #: Field of the scanner [T]


def read_header(path: Path) -> Header:
    """Echo time and field of an image.

    - `path`: a file, described by the JSON files of BIDS (with the same name beside it, or for
      several images, in a folder above), or a folder of DICOM images, see `read_image`
    """
    folder, choice = split_choice(path)
    if folder.is_dir():
        found, to_ms = series_files(folder, choice)[0].data, 1.0
    else:
        found = {k: v for file in described_by(path, "json") for k, v in _table(file).items()}
        to_ms = 1000.0
    time, field = (
        _number(path, found, key, factor)
        for key, factor in (("EchoTime", to_ms), ("MagneticFieldStrength", 1.0))
    )
    return Header(time, field)


def bids_name(path: Path) -> tuple[dict[str, str], str]:
    """Entities and suffix of a BIDS name: `sub-1_echo-2_MEGRE.nii` has `sub`, `echo` and MEGRE."""
    *parts, suffix = path.name.split(".")[0].split("_")
    pairs = (part.partition("-") for part in parts)
    return {key: value for key, sign, value in pairs if sign}, suffix


def described_by(path: Path, kind: str) -> list[Path]:
    """Files that describe an image by BIDS inheritance, the nearest and most specific last.

    They have the suffix of the image and no entity that its name lacks. A name without entities
    inherits within its folder only, and nothing from another image there.

    - `path`: image
    - `kind`: of the files: json, bval or bvec
    """
    entities, suffix = bids_name(path)
    own = path.with_name(f"{path.name.removesuffix('.gz').removesuffix('.nii')}.{kind}")
    above = path.parent.parents[:4] if entities else ()
    found: list[Path] = []
    for folder in reversed([path.parent, *above]):
        fitting = []
        for file in folder.glob(f"*{suffix}.{kind}"):
            parts = file.stem.split("_")
            fits = parts[-1] == suffix and set(parts) <= set(own.stem.split("_"))
            others = not entities and any(folder.glob(f"{escape(file.stem)}.nii*"))
            if fits and file != own and not others:
                fitting.append((len(parts), file))
        found += [file for _, file in sorted(fitting)]
    return [*found, own] if own.is_file() else found


def _table(file: Path) -> dict[str, Any]:
    try:
        table = json.loads(read_text(file))
    except (ValueError, RecursionError) as reason:
        raise InputError(f"{file}: is not readable JSON: {reason}") from None
    return table if isinstance(table, dict) else {}


def _number(path: Path, table: Mapping[str, Any], key: str, factor: float) -> float | None:
    """A number above zero, scaled; None where it is missing."""
    value = table.get(key)
    if value is None:
        return None
    try:
        number = float(value) * factor
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 < number < math.inf:
        raise InputError(
            f"{path}: {key} of its header is {value!r}, a number above zero is needed; correct it, "
            "or give dixon.echo_times and dixon.field_strength"
        )
    return number
