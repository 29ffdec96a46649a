"""Damaged NRRD and MetaImage files and DICOM series."""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.reference.faults import Fault, image_deck, spoilt

__all__ = ["volume_faults"]

_NRRD = {
    "type": "float",
    "dimension": "3",
    "space": "right-anterior-superior",
    "sizes": "32 32 2",
    "space directions": "(2,0,0) (0,2,0) (0,0,5)",
    "kinds": "domain domain domain",
    "endian": "little",
    "encoding": "raw",
    "space origin": "(0,0,0)",
}
_META = {
    "ObjectType": "Image",
    "NDims": "3",
    "BinaryData": "True",
    "BinaryDataByteOrderMSB": "False",
    "CompressedData": "False",
    "TransformMatrix": "1 0 0 0 1 0 0 0 1",
    "Offset": "0 0 0",
    "ElementSpacing": "2 2 5",
    "DimSize": "32 32 2",
    "ElementType": "MET_FLOAT",
    "ElementDataFile": "LOCAL",
}
_BROKEN = "cannot be read"

#: Changed lines of a NRRD header, and what must be said of them
_NRRD_LINES: tuple[tuple[str, dict[str, str], str], ...] = (
    ("negative-size", {"sizes": "-32 32 2"}, _BROKEN),
    ("zero-size", {"sizes": "32 0 2"}, _BROKEN),
    ("sizes-beyond", {"sizes": "4294967296 4294967296 2"}, _BROKEN),
    ("few-sizes", {"sizes": "32 32"}, _BROKEN),
    ("more-slices", {"sizes": "32 32 3"}, _BROKEN),
    ("fewer-slices", {"sizes": "32 32 1"}, "more than its header promises"),
    ("99-axes", {"dimension": "99"}, _BROKEN),
    ("two-axes-of-three", {"dimension": "2"}, _BROKEN),
    ("block", {"type": "block"}, _BROKEN),
    ("unknown-type", {"type": "quaternion"}, _BROKEN),
    ("other-type", {"type": "short"}, "more than its header promises"),
    ("unknown-encoding", {"encoding": "morse"}, _BROKEN),
    ("not-packed", {"encoding": "gzip"}, _BROKEN),
    ("unknown-unit", {"space units": '"ell" "ell" "ell"'}, "space units .* not understood"),
    ("zero-voxel", {"space directions": "(0,0,0) (0,2,0) (0,0,5)"}, f"{_BROKEN}|singular"),
    ("nan-voxel", {"space directions": "(nan,0,0) (0,2,0) (0,0,5)"}, f"{_BROKEN}|singular"),
    ("huge-voxel", {"space directions": "(1e30,0,0) (0,2,0) (0,0,5)"}, f"{_BROKEN}|implausible"),
    ("sheared", {"space directions": "(2,0,0) (1,2,0) (0,0,5)"}, "perpendicular|cannot be read"),
    ("far-away", {"space origin": "(1e30,0,0)"}, "implausible"),
    ("no-data", {"data file": "gone.raw"}, "names the data file 'gone.raw'"),
    ("own-data", {"data file": "own-data.nrrd"}, "names the data file"),
)
#: Changed lines of a MetaImage header
_META_LINES: tuple[tuple[str, dict[str, str], str], ...] = (
    ("thousand-axes", {"NDims": "1000"}, "the header gives 1000 axes"),
    ("99-axes", {"NDims": "99"}, "the header gives 99 axes"),
    ("negative-axes", {"NDims": "-3"}, "gives ndims = '-3'"),
    ("no-axes", {"NDims": "none"}, "gives ndims = 'none'"),
    ("two-axes-of-three", {"NDims": "2"}, "gives dimsize"),
    ("negative-size", {"DimSize": "-32 32 2"}, "gives dimsize = '-32 32 2'"),
    ("zero-size", {"DimSize": "32 0 2"}, "gives dimsize"),
    ("more-slices", {"DimSize": "32 32 3"}, "cut off or its header"),
    ("fewer-slices", {"DimSize": "32 32 1"}, "more than its header promises"),
    ("zero-voxel", {"ElementSpacing": "0 2 5"}, "gives elementspacing"),
    ("negative-voxel", {"ElementSpacing": "-2 2 5"}, "gives elementspacing"),
    ("nan-voxel", {"ElementSpacing": "nan 2 5"}, "gives elementspacing"),
    ("few-voxels", {"ElementSpacing": "2"}, "gives elementspacing"),
    ("singular", {"TransformMatrix": "0 0 0 0 1 0 0 0 1"}, f"{_BROKEN}|singular"),
    ("few-directions", {"TransformMatrix": "1 0 0"}, "gives transformmatrix"),
    ("unknown-type", {"ElementType": "MET_OTHER"}, "values of type MET_OTHER are not read"),
    ("array-type", {"ElementType": "MET_UCHAR_ARRAY"}, "values of type MET_UCHAR_ARRAY"),
    ("other-type", {"ElementType": "MET_SHORT"}, "more than its header promises"),
    ("many-channels", {"ElementNumberOfChannels": "100000"}, "cut off or its header"),
    ("no-channels", {"ElementNumberOfChannels": "-1"}, "gives elementnumberofchannels"),
    ("not-packed", {"CompressedData": "True"}, _BROKEN),
    ("no-data", {"ElementDataFile": "gone.raw"}, "names the data file 'gone.raw'"),
    ("own-data", {"ElementDataFile": "own-data.mha"}, "names the data file"),
    ("device", {"ElementDataFile": "/dev/zero"}, "names the data file"),
    ("no-file", {"ElementDataFile": ""}, _BROKEN),
)
_HUGE = "100000 100000 9"

#: Changed elements of the second of three DICOM slices, and what must be said of them
_ELEMENTS: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("no-position", {"ImagePositionPatient": None}, "1.dcm: has no ImagePositionPatient"),
    ("short-position", {"ImagePositionPatient": [0, 0]}, "1.dcm: ImagePositionPatient is"),
    ("short-axes", {"ImageOrientationPatient": [1, 0, 0, 0, 1]}, "1.dcm: ImageOrientation"),
    ("zero-axes", {"ImageOrientationPatient": [0] * 6}, "different orientations"),
    ("one-spacing", {"PixelSpacing": [2]}, "1.dcm: PixelSpacing is"),
    ("zero-spacing", {"PixelSpacing": [0, 0]}, "different pixel sizes"),
    ("no-rows", {"Rows": None}, "1.dcm: Rows cannot be read"),
    ("zero-rows", {"Rows": 0}, "1.dcm: has 0 rows"),
    ("many-rows", {"Rows": 65535}, "different sizes"),
    ("colours", {"SamplesPerPixel": 3}, "1.dcm: has 3 values"),
    ("frames", {"NumberOfFrames": 7}, "1.dcm: has 7 frames"),
    ("bits", {"BitsAllocated": 13}, "1.dcm: the pixels cannot be decoded"),
    ("no-bits", {"BitsAllocated": None}, "1.dcm: the pixels cannot be decoded"),
    ("few-pixels", {"PixelData": bytes(100)}, "1.dcm: the pixels cannot be decoded"),
    ("no-pixels", {"PixelData": None}, "1.dcm: is an image without pixels"),
    ("two-slopes", {"RescaleSlope": [1, 2]}, "1.dcm: RescaleSlope is"),
    ("same-place", {"ImagePositionPatient": [0, 0, 0]}, "lie at the same position"),
    ("other-series", {"SeriesInstanceUID": "1.2.3"}, "holds 2 images; write one"),
)


def volume_faults(
    folder: Path, sound: NDArray[np.float32], affine: NDArray[np.float64]
) -> list[Fault]:
    """Write damaged volumes of a sound image into a folder."""
    data = np.ascontiguousarray(sound.T).tobytes()
    return [
        *_nrrd(folder, data),
        *_meta(folder, data),
        *_series(folder, sound, affine),
    ]


def _fault(path: Path, kind: str, content: bytes, message: str | None, huge: bool = False) -> Fault:
    path.write_bytes(content)
    return Fault(f"{kind}-{path.stem}", path, "segment", image_deck(path), message, huge)


def _nrrd(folder: Path, data: bytes) -> Iterator[Fault]:
    def content(lines: dict[str, str], data: bytes = data) -> bytes:
        text = "".join(f"{key}: {value}\n" for key, value in {**_NRRD, **lines}.items())
        return b"NRRD0004\n" + text.encode() + b"\n" + data

    def fault(name: str, content: bytes, message: str | None, huge: bool = False) -> Fault:
        return _fault(folder / f"{name}.nrrd", "nrrd", content, message, huge)

    for name, lines, message in _NRRD_LINES:
        yield fault(name, content(lines), message)
    for encoding in ("raw", "ascii", "gzip"):
        lines = {"sizes": _HUGE, "encoding": encoding}
        yield fault(f"huge-{encoding}", content(lines), "cut off or its header", huge=True)
    yield fault("no-header", data, _BROKEN)
    yield fault("nothing", b"", _BROKEN)
    yield fault("only-a-header", content({}, b""), _BROKEN)
    packed = zlib.compressobj(wbits=31)
    content_packed = content({"encoding": "gzip"}, packed.compress(data) + packed.flush())
    for name, changed in spoilt(content({}), 5, 8, seed=3):
        yield fault(name, changed, None if "flip" in name else _BROKEN)
    for name, changed in spoilt(content_packed, 5, 8, seed=4):
        yield fault(f"packed-{name}", changed, None if "flip" in name else _BROKEN)


def _meta(folder: Path, data: bytes) -> Iterator[Fault]:
    def content(lines: dict[str, str], data: bytes = data) -> bytes:
        lines = {**_META, **lines, "ElementDataFile": lines.get("ElementDataFile", "LOCAL")}
        last = lines.pop("ElementDataFile")
        text = "".join(f"{key} = {value}\n" for key, value in lines.items())
        return f"{text}ElementDataFile = {last}\n".encode() + data

    def fault(name: str, content: bytes, message: str | None, huge: bool = False) -> Fault:
        return _fault(folder / f"{name}.mha", "metaimage", content, message, huge)

    for name, lines, message in _META_LINES:
        yield fault(name, content(lines), message)
    yield fault("huge", content({"DimSize": _HUGE}), "cut off or its header", huge=True)
    lines = {"DimSize": _HUGE, "CompressedData": "True"}
    yield fault("huge-packed", content(lines), "cut off or its header", huge=True)
    yield fault("no-header", data, _BROKEN)
    yield fault("nothing", b"", _BROKEN)
    yield fault("only-a-header", content({}, b""), _BROKEN)
    yield fault("no-axes-at-all", content({}).replace(b"NDims = 3\n", b""), "gives ndims")
    content_packed = content({"CompressedData": "True"}, zlib.compress(data))
    for name, changed in spoilt(content({}), 5, 8, seed=5):
        yield fault(name, changed, None if "flip" in name else _BROKEN)
    for name, changed in spoilt(content_packed, 5, 8, seed=6):
        yield fault(f"packed-{name}", changed, None if "flip" in name else _BROKEN)


def _series(
    folder: Path, sound: NDArray[np.float32], affine: NDArray[np.float64]
) -> Iterator[Fault]:
    """DICOM series of three slices."""
    pixels = [np.rint(sound[:, :, k].T).astype(np.uint16) for k in (0, 1, 0)]
    size = [float(affine[k, k]) for k in range(3)]

    def series(name: str, elements: dict[str, Any]) -> Path:
        home = folder / f"dicom-{name}"
        home.mkdir()
        for number, slice_ in enumerate(pixels):
            _slice(home / f"{number}.dcm", slice_, size, number, elements if number == 1 else {})
        return home

    def fault(name: str, home: Path, message: str | None) -> Fault:
        return Fault(f"dicom-{name}", home, "segment", image_deck(home), message)

    for name, elements, message in _ELEMENTS:
        yield fault(name, series(name, elements), message)
    home = series("gap", {})
    for number in (3, 5):
        _slice(home / f"{number}.dcm", pixels[0], size, number, {})
    yield fault("gap", home, "a slice is missing")
    content = (series("sound", {}) / "2.dcm").read_bytes()
    ends: list[tuple[str, bytes, str | None]] = [
        ("empty-file", b"", "2.dcm: is not a DICOM file"),
        ("text", b"no image " * 50, "2.dcm: is not a DICOM file"),
        *((name, changed, "2.dcm: ") for name, changed in spoilt(content, 6, 0, seed=7)),
        *((name, changed, None) for name, changed in spoilt(content, 0, 12, seed=8)),
    ]
    for name, changed, what in ends:
        home = series(name, {})
        (home / "2.dcm").write_bytes(changed)
        yield fault(name, home, what)


def _slice(
    path: Path, pixels: NDArray[np.uint16], size: list[float], number: int, other: dict[str, Any]
) -> None:
    """Write a slice; an element that is None is left out."""
    dicom = importlib.import_module("pydicom")
    sets, uid = importlib.import_module("pydicom.dataset"), importlib.import_module("pydicom.uid")
    meta = sets.FileMetaDataset()
    meta.MediaStorageSOPClassUID = uid.MRImageStorage
    meta.MediaStorageSOPInstanceUID = f"1.2.826.0.1.{number + 1}"
    meta.TransferSyntaxUID = uid.ExplicitVRLittleEndian
    data = sets.FileDataset(None, {}, file_meta=meta, preamble=bytes(128))
    elements = {
        "SOPClassUID": meta.MediaStorageSOPClassUID,
        "SOPInstanceUID": meta.MediaStorageSOPInstanceUID,
        "SeriesInstanceUID": "1.2.826.0.2",
        "Rows": pixels.shape[0],
        "Columns": pixels.shape[1],
        "PixelSpacing": size[:2],
        "ImageOrientationPatient": [1, 0, 0, 0, 1, 0],
        "ImagePositionPatient": [0.0, 0.0, size[2] * number],
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "BitsAllocated": 16,
        "BitsStored": 16,
        "HighBit": 15,
        "PixelRepresentation": 0,
        "PixelData": pixels.tobytes(),
        **other,
    }
    strict = dicom.config.settings.writing_validation_mode
    dicom.config.settings.writing_validation_mode = dicom.config.IGNORE
    try:
        for key, value in elements.items():
            if value is not None:
                setattr(data, key, value)
        data.save_as(path, enforce_file_format=True)
    finally:
        dicom.config.settings.writing_validation_mode = strict
