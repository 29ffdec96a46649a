"""DICOM series, an extra of the package: a folder of slices as one image.

A series is one image if no two of its files share a position. Otherwise it is split into kinds
(magnitude, phase) and echoes, one of which is chosen by the headers that pydicom reads. dcm2niix
makes a NIfTI file of it: it knows the elements in which manufacturers write b values and
gradients, and mosaics that contain all slices of a volume.
"""

import re
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from myork.errors import FileError, InputError, optional

# File names that indicate DICOM
_SUFFIXES = (".dcm", ".dicom", ".ima")
_KEYS = ("series", "echo", "kind")
# Words of ImageType from the third on; those that the scanner may choose freely are kept as found.
_SPECIES = {
    **dict.fromkeys(("W", "WATER"), "water"),
    **dict.fromkeys(("F", "FAT"), "fat"),
    **dict.fromkeys(("IP", "IN_PHASE"), "in-phase"),
    **dict.fromkeys(("OP", "OPP_PHASE", "OUT_PHASE"), "opposed-phase"),
}
_PARTS = ("magnitude", "phase", "real", "imaginary")
# Private element in which GE codes the part of the image: 0 to 3
_GE_PART = (0x0043, 0x102F)
# Elements in which Siemens, Philips and GE keep b values; GE adds a flag
_WEIGHTS = ((0x0019, 0x100C), (0x2001, 0x1003), (0x0043, 0x1039))
_GE_FLAG = 1e9


class DicomFile(NamedTuple):
    """A file with pixels and its header."""

    path: Path
    data: Any


@dataclass(frozen=True)
class ListedImage:
    """An image of a folder."""

    files: Sequence[DicomFile]  #: Its files
    series: tuple[str, str]  #: Number and UID of its series
    echo: int  #: Number of the echo, from 1
    kind: str  #: Magnitude, phase, water and so on
    text: str = ""  #: Text that selects it, `series=5,echo=2`

    @property
    def weighted(self) -> bool:
        """Whether it is a diffusion series: several volumes, at least one with a b value."""
        volumes = len(self.files) > len({_place(file) for file in self.files})
        return volumes and any(_weighting(file.data) > 0 for file in self.files)

    @property
    def voxels(self) -> float:
        """Number of its voxels."""
        rows, columns = (_finite(self.files[0].data, key) or [0] for key in ("Rows", "Columns"))
        return len(self.files) * float(rows[0]) * float(columns[0])

    def fits(self, wanted: Mapping[str, str]) -> bool:
        """Whether it matches a choice."""
        own = {"series": self.series, "echo": (str(self.echo),), "kind": (self.kind,)}
        return all(value in own[key] for key, value in wanted.items())

    def about(self) -> list[str]:
        """Description, echo time, kind, slices, size and spacing."""
        data = self.files[0].data
        size = [_text(data, key) or "?" for key in ("Columns", "Rows")]
        steps = _finite(data, "PixelSpacing")
        thick = _finite(data, "SpacingBetweenSlices") or _finite(data, "SliceThickness")
        time = _finite(data, "EchoTime")
        slices = len({_place(file) for file in self.files})
        volumes = f" x {len(self.files) // slices}" if slices < len(self.files) else ""
        return [
            _text(data, "SeriesDescription")[:40] or "-",
            f"TE {time[0]:g} ms" if time else "-",
            self.kind,
            f"{slices} slice" + ("s" if slices > 1 else "") + volumes,
            " x ".join(size),
            " x ".join(f"{step:.3g}" for step in [*steps[::-1], *thick[:1]]) + " mm",
        ]


def split_choice(path: Path) -> tuple[Path, str]:
    """A folder and the choice in it, of `DIR:series=5,echo=2,kind=phase`.

    - `path`: as a deck names an image; without a choice it is unchanged, with an empty text
    """
    found = re.fullmatch(r"(.*):(\w+=[^:]*)", path.name)
    if found is None or path.exists():
        return path, ""
    return path.parent / found[1], found[2]  # also `DIR/:series=5`


def series_files(folder: Path, choice: str = "") -> list[DicomFile]:
    """Files of the one image of a folder that a choice selects.

    - `choice`: `series=5,echo=2,kind=phase`, or a part of it, or nothing. A series is given by its
      number or its UID, echoes are counted from 1 in the order of their times.
    """
    images = listed_images(dicom_files(folder))
    wanted = _wanted(folder, choice)
    fitting = [image for image in images if image.fits(wanted)]
    if len(fitting) == 1:
        return list(fitting[0].files)
    shown = fitting or images
    rows = [[f"{folder.name}:{image.text}", *image.about()] for image in shown]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    what = f"contains {len(shown)} images" + (f" with {choice}" if choice else "")
    if not fitting:
        what = f"contains no image with {choice}"
    raise InputError("\n  ".join([f"{folder}: {what}; write one of these in its place:", *lines]))


def listed_images(files: Sequence[DicomFile]) -> list[ListedImage]:
    """Images of files, by series, kind and echo.

    - `files`: files with pixels
    """
    # Some anonymisers leave no UID, or the same for all.
    series: dict[tuple[str, str], list[DicomFile]] = {}
    for file in files:
        key = _text(file.data, "SeriesNumber"), _text(file.data, "SeriesInstanceUID")
        series.setdefault(key, []).append(file)
    images = []
    for name, own in series.items():
        places = {_place(file) for file in own}
        if len(places) == len(own):
            images.append(ListedImage(own, name, 1, _kind(own[0].data)))
            continue
        parts: dict[tuple[str, float], list[DicomFile]] = {}
        for file in own:
            parts.setdefault((_kind(file.data), _echo(file.data)), []).append(file)
        times = sorted({time for _, time in parts})
        images += [
            ListedImage(parts[kind, time], name, times.index(time) + 1, kind)
            for kind, time in sorted(parts)
        ]
    return _choices(
        sorted(images, key=lambda one: (_number(one.series[0]), one.series, one.echo, one.kind))
    )


def _choices(images: Sequence[ListedImage]) -> list[ListedImage]:
    """Images with the shortest choice that selects each."""
    found = []
    all_series = {image.series for image in images}
    for image in images:
        number, uid = image.series
        alike = [one for one in all_series if one[0] == number]
        own = [one for one in images if one.series == image.series]
        words = [f"series={number if number and len(alike) == 1 else uid}"]
        words += [f"echo={image.echo}"] if len({one.echo for one in own}) > 1 else []
        words += [f"kind={image.kind}"] if len({one.kind for one in own}) > 1 else []
        text = ",".join(words[1:] if len(all_series) == 1 and words[1:] else words)
        found.append(replace(image, text=text))
    return found


def _wanted(folder: Path, choice: str) -> dict[str, str]:
    """Keys and values of a choice."""
    wanted = {}
    for part in filter(None, choice.split(",")):
        key, _, value = (word.strip() for word in part.partition("="))
        if key not in _KEYS or not value:
            raise InputError(
                f"{folder}:{choice}: {part!r} chooses nothing; write "
                "DIR:series=NUMBER,echo=NUMBER,kind=WORD or a part of it"
            )
        wanted[key] = value.lower() if key == "kind" else value
    return wanted


def _kind(data: Any) -> str:
    """Kind of the values: magnitude, phase, water and so on."""
    words = [word.upper() for word in _words(data, "ImageType")[2:]]
    for word in words:
        if word in _SPECIES:
            return _SPECIES[word]
    part = _part(data)
    if part is not None:
        return part
    heads = [re.split(r"[_ ]", word)[0] for word in words]
    for head in [*heads, _text(data, "ComplexImageComponent").upper()]:
        for name in _PARTS:
            if head in (name.upper(), name[0].upper()):
                return name
    return words[0].lower().replace(" ", "-") if words and words[0] else "unknown"


def _part(data: Any) -> str | None:
    """Magnitude, phase, real or imaginary in the private element of GE."""
    try:
        value = data[_GE_PART].value
        number = int.from_bytes(value[:2], "little") if isinstance(value, bytes) else int(value)
        return _PARTS[number]
    except Exception:  # missing or unreadable
        return None


def _weighting(data: Any) -> float:
    """Diffusion weighting [s/mm^2], from the standard element or a private one; 0 without."""
    found = _finite(data, "DiffusionBValue")
    for key in _WEIGHTS:
        try:
            value = data[key].value
            found = found or [float(np.ravel(value)[0]) % _GE_FLAG]
        except Exception:  # missing or unreadable
            continue
    if not found and "DIFFUSION" in _words(data, "ImageType"):
        return 1.0
    return found[0] if found else 0.0


def _echo(data: Any) -> float:
    """Echo time [ms]; without a time, the number of the echo."""
    found = _finite(data, "EchoTime") or _finite(data, "EchoNumbers")
    return round(found[0], 2) if found else 0.0


def _place(file: DicomFile) -> tuple[float, ...] | Path:
    """Position and orientation; the path of the file where it has none."""
    place = _finite(file.data, "ImagePositionPatient")
    turn = _finite(file.data, "ImageOrientationPatient")
    return tuple(np.round([*place, *turn], 3).tolist()) if len(place) == 3 else file.path


def _number(text: str) -> float:
    return float(text) if text.isdecimal() else float("inf")


def _words(data: Any, key: str) -> list[str]:
    """Words of an element; none where it is missing or damaged."""
    try:
        value = data.get(key)
    except Exception:  # pydicom converts on access, and raises any exception
        return []
    many = isinstance(value, Iterable) and not isinstance(value, str | bytes)
    return [str(one).strip() for one in (value if many else [value]) if one is not None]


def _text(data: Any, key: str) -> str:
    return " ".join(_words(data, key))


def _finite(data: Any, key: str) -> list[float]:
    """Finite numbers of an element; none if one of them is not finite."""
    try:
        found = [float(word) for word in _words(data, key)]
    except ValueError:
        return []
    return found if np.isfinite(found).all() else []


def stack_files(folder: Path, choice: str = "") -> list[DicomFile]:
    """Files of a series of single slices at even spacing; other series are refused.

    - `choice`: which of several images, see `series_files`
    """
    files = series_files(folder, choice)
    places = [_place(file) for file in files]
    without = [place for place in places if isinstance(place, Path)]
    if without and len(files) > 1:
        raise InputError(
            f"{without[0]}: has no ImagePositionPatient; only plain series of slices are read"
        )
    twin = next((n for n, place in enumerate(places) if place in places[:n]), None)
    if twin is not None:
        raise InputError(
            f"{folder}: {files[places.index(places[twin])].path.name} and {files[twin].path.name} "
            "lie at the same position, so there are several times, diffusion weightings or the "
            "like (those are for image.dwi), which their headers do not distinguish; keep the "
            "files of one image in a folder"
        )
    turn = _finite(files[0].data, "ImageOrientationPatient")
    if len(turn) == 6 and len(files) > 2:
        normal = np.cross(turn[:3], turn[3:])
        heights = [np.dot(normal, _finite(file.data, "ImagePositionPatient")) for file in files]
        gaps = np.diff(np.sort(heights))
        if np.ptp(gaps) > 0.05 * gaps.mean():
            raise InputError(
                f"{folder}: the spacing of the slices varies from {gaps.min():.3g} to "
                f"{gaps.max():.3g} mm; a slice is missing, or the series must be resampled"
            )
    return files


@contextmanager
def converted(
    folder: Path, files: Sequence[DicomFile], wanted: str, *options: str
) -> Iterator[Path]:
    """A NIfTI file of an image of a folder, made by dcm2niix; it exists while the context lasts.

    - `files`: of the image
    - `wanted`: suffix of the one file it must produce: `.nii`, or `.bvec` for a diffusion series
    - `options`: of dcm2niix
    """
    converter = optional("dcm2niix", "dicom", folder).bin
    with TemporaryDirectory(prefix="myork-") as place:
        there, made = Path(place, "dicom"), Path(place, "nifti")
        there.mkdir()
        made.mkdir()
        for number, file in enumerate(files):
            (there / f"{number}.dcm").symlink_to(file.path.resolve())
        # the folder contains one image: keep together what dcm2niix would split, as by echo
        command = [converter, "-b", "n", "-z", "n", *options, "-f", "image", "-o", made, there]
        try:
            done = subprocess.run(command, capture_output=True, text=True, errors="replace")
        except OSError as reason:
            raise FileError(f"{converter}: does not start: {reason.strerror}") from None
        found = sorted(made.glob(f"*{wanted}"))
        if len(found) != 1 or done.returncode != 0:
            said = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
            said = [line for line in said if line.startswith("Convert ")] or said[-3:]
            what = "images" if wanted == ".nii" else "tables of gradients"
            raise InputError(
                f"{folder}: dcm2niix made {len(found)} {what} of its {len(files)} files, "
                "one is needed; keep the files of one series, of one size and orientation, in a "
                f"folder; it said: {'; '.join(said).replace(str(made), '')}"
            )
        try:
            yield found[0].with_suffix(".nii")
        except (FileError, InputError) as reason:
            raise type(reason)(str(reason).replace(f"{made}/image", str(folder))) from None


def dicom_files(folder: Path) -> list[DicomFile]:
    """All DICOM images of a folder (at least one); of its subfolders if it contains none itself."""
    dicom = optional("pydicom", "dicom", folder)
    for paths in (folder.iterdir(), folder.rglob("*")):
        found = [_read(dicom, path) for path in sorted(paths) if path.is_file()]
        files = [file for file in found if file is not None]
        if files:
            return files
    raise FileError(f"{folder}: contains no DICOM images")


def _read(dicom: Any, path: Path) -> DicomFile | None:
    """A file with pixels; None for a file that is not a DICOM image."""
    try:
        with path.open("rb") as file:
            file.seek(128)
            marked = file.read(4) == b"DICM"
    except OSError as reason:
        raise FileError(f"{path}: cannot be read: {reason.strerror}") from None
    if not marked:
        if path.suffix.lower() in _SUFFIXES:
            raise FileError(
                f"{path}: is not a DICOM file, though its name says so; copy it again, or take "
                "it out of the folder"
            )
        return None
    try:
        data = dicom.dcmread(path)
        kinds = [getattr(head.get(key), "name", "") for head, key in (
            (data, "SOPClassUID"), (data.file_meta, "MediaStorageSOPClassUID"))]  # fmt: skip
        pixels = "PixelData" in data
    except Exception as reason:  # pydicom raises a different exception for each kind of damage
        raise FileError(
            f"{path}: is a damaged DICOM file: {reason}; copy it again, or take it out of the "
            "folder"
        ) from None
    if not pixels:
        if len(data) and not any("Image Storage" in str(kind) for kind in kinds):
            return None
        what = "is an image without pixels" if len(data) else "has no data behind its header"
        raise FileError(f"{path}: {what}; the file was cut off, copy it again")
    return DicomFile(path, data)
