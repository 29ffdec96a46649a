"""Damaged images, label maps and tables of gradients, made anew wherever they are wanted.

Each is a sound file with one thing wrong. A command must refuse it by name, or do the right
thing; none may end otherwise.
"""

from __future__ import annotations

import gzip
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from nibabel.nifti1 import header_dtype
from numpy.typing import NDArray

from myork.reference.faults import Fault, image_deck, spoilt
from myork.reference.faults_meshes import mesh_faults
from myork.reference.faults_volumes import volume_faults

__all__ = ["image_faults", "sound_image"]

_AFFINE = np.diag([2.0, 2.0, 5.0, 1.0])

#: Changed fields of a NIfTI header of 32 x 32 x 2 voxels, and what must be said of them
_HEADERS: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("no-axes", {"dim": [0, 32, 32, 2, 1, 1, 1, 1]}, "header"),
    ("nine-axes", {"dim": [9, 32, 32, 2, 1, 1, 1, 1]}, "not a readable NIfTI"),
    ("negative-axes", {"dim": [-3, 32, 32, 2, 1, 1, 1, 1]}, "not a readable NIfTI"),
    ("negative-size", {"dim": [3, -32, 32, 2, 1, 1, 1, 1]}, "-32 x 32 x 2 .* damaged"),
    ("two-negative-sizes", {"dim": [3, -32, -32, 2, 1, 1, 1, 1]}, "-32 x -32 x 2 .* damaged"),
    ("zero-size", {"dim": [3, 32, 0, 2, 1, 1, 1, 1]}, "32 x 0 x 2 .* is empty"),
    ("one-slice-too-many", {"dim": [3, 32, 32, 3, 1, 1, 1, 1]}, "cut off or its header"),
    ("one-slice-too-few", {"dim": [3, 32, 32, 1, 1, 1, 1, 1]}, "more than its header promises"),
    ("narrower", {"dim": [3, 16, 32, 2, 1, 1, 1, 1]}, "more than its header promises"),
    ("offset-far", {"vox_offset": 1e30}, "cut off or its header|not a readable NIfTI"),
    ("offset-beyond", {"vox_offset": 20000.0}, "cut off or its header"),
    ("offset-nan", {"vox_offset": np.nan}, "not a readable NIfTI"),
    ("offset-infinite", {"vox_offset": np.inf}, "not a readable NIfTI"),
    ("offset-negative", {"vox_offset": -352.0}, "not a readable NIfTI|inside of the header"),
    ("offset-in-header", {"vox_offset": 16.0}, "not a readable NIfTI|inside of the header"),
    ("type-none", {"datatype": 0}, "not a readable NIfTI|no numbers"),
    ("type-bit", {"datatype": 1}, "not a readable NIfTI|no numbers"),
    ("type-unknown", {"datatype": 9999}, "not a readable NIfTI"),
    ("type-complex", {"datatype": 32, "bitpix": 64}, "values are complex"),
    ("type-colours", {"datatype": 128, "bitpix": 24}, "values are colours"),
    ("type-colours-with-opacity", {"datatype": 2304, "bitpix": 32}, "values are colours"),
    ("type-longer", {"datatype": 64, "bitpix": 64}, "cut off or its header"),
    ("type-shorter", {"datatype": 4, "bitpix": 16}, "more than its header promises"),
    ("voxel-zero", {"pixdim": [1, 0, 2, 5, 1, 1, 1, 1], "sform_code": 0}, "affine is singular"),
    ("voxel-nan", {"pixdim": [1, np.nan, 2, 5, 1, 1, 1, 1], "sform_code": 0}, "not finite"),
    ("voxel-huge", {"pixdim": [1, 1e30, 2, 5, 1, 1, 1, 1], "sform_code": 0}, "is implausible"),
    ("voxel-tiny", {"srow_x": [1e-9, 0, 0, 0]}, "affine is implausible"),
    ("affine-zero", {"srow_x": [0, 0, 0, 0]}, "affine is singular"),
    ("affine-nan", {"srow_y": [0, np.nan, 0, 0]}, "not finite"),
    ("affine-infinite", {"srow_z": [0, 0, np.inf, 0]}, "not finite"),
    ("affine-parallel", {"srow_x": [2, 2, 0, 0], "srow_y": [2, 2, 0, 0]}, "affine is singular"),
    ("affine-sheared", {"srow_x": [2, 1, 0, 0]}, "not perpendicular"),
    ("far-away", {"srow_x": [2, 0, 0, 1e20]}, "affine is implausible"),
    ("quaternion-long", {"sform_code": 0, "qform_code": 1, "quatern_b": 9.0}, "readable NIfTI"),
    ("unit-unknown", {"xyzt_units": 7}, "unit of length 7"),
    ("unit-metre", {"xyzt_units": 1}, "affine is implausible"),
    ("slope-infinite", {"scl_slope": np.inf}, "scale of the values is inf"),
    ("slope-huge", {"scl_slope": 3e38}, "beyond 1e\\+30|not finite"),
    ("shift-infinite", {"scl_slope": 1.0, "scl_inter": np.inf},
     "not a readable NIfTI|not finite|cannot be read"),
    ("shift-negative", {"scl_slope": 1.0, "scl_inter": -1e4}, "no value is above zero"),
    ("magic", {"magic": b"abc"}, "not a readable NIfTI|convert it"),
)  # fmt: skip

#: Sizes that promise 90 GB and more
_HUGE = {"90-gigabytes": [3, 10000, 10000, 224, 1, 1, 1, 1], "all": [7, *[32767] * 7]}

#: Texts in the place of names of labels
_NAMES = {
    "list": "[]",
    "text": "soleus",
    "nothing": "",
    "binary": "\x00\x01",
    "swapped": '{"1": "soleus"}',
    "half": '{"soleus": 1.5}',
    "negative": '{"soleus": -1}',
    "infinite": '{"soleus": 1e999}',
    "not-a-number": '{"soleus": NaN}',
    "long": '{"soleus": ' + "9" * 5000 + "}",
    "logical": '{"soleus": true}',
    "twice": '{"soleus": 1, "tibialis": 1}',
    "same-name": '{"soleus": 1, "soleus": 2}',
    "table": '{"soleus": {"label": 1}}',
    "deep": "[" * 100_000,
    "cut": '{"soleus": 1, "tibi',
}


def sound_image(size: tuple[int, int, int] = (32, 32, 2)) -> NDArray[np.float32]:
    """A bright disc with a dark one in it, in air, with a little noise."""
    i, j, _ = np.indices(size)
    middle = (np.array(size[:2]) - 1) / 2
    away = np.hypot(i - middle[0], j - middle[1]) / middle.min()
    dark = np.hypot(i - middle[0], j - middle[1] - 0.2 * size[1]) / middle.min() < 0.4
    noise = np.random.default_rng(3).normal(0.0, 4.0, size)
    image = np.where(dark, 120.0, np.where(away < 0.9, 300.0, 2.0)) + noise
    return np.abs(image).astype(np.float32)


def image_faults(folder: Path, meshes: bool = True) -> list[Fault]:
    """Write all damaged files into a folder.

    Parameters
    ----------
    folder : Path
        An empty folder.
    meshes : bool
        Whether surfaces, which are read slowly, are among them.
    """
    for name in ("nifti", "values", "volumes", "labels", "gradients", "meshes"):
        (folder / name).mkdir(parents=True)
    sound = sound_image()
    faults = [
        *_headers(folder / "nifti", sound),
        *_packed(folder / "nifti", sound),
        *_values(folder / "values", sound),
        *_no_files(folder / "values"),
        *volume_faults(folder / "volumes", sound, _AFFINE),
        *_labels(folder / "labels", sound),
        *_gradients(folder / "gradients", sound),
    ]
    return faults + (mesh_faults(folder / "meshes") if meshes else [])


def _save(path: Path, data: NDArray[Any], affine: NDArray[np.float64] = _AFFINE) -> Path:
    file = nibabel.Nifti1Image(data, affine, dtype=data.dtype)
    file.header.set_xyzt_units("mm")
    nibabel.save(file, path)
    return path


def _changed(content: bytes, fields: dict[str, Any]) -> bytes:
    """A file with other values in its header."""
    size = header_dtype.itemsize
    header = np.frombuffer(content[:size], header_dtype).copy()
    for field, value in fields.items():
        header[field] = value
    return header.tobytes() + content[size:]


def _headers(folder: Path, sound: NDArray[Any]) -> Iterator[Fault]:
    """NIfTI files whose header is wrong, or whose bytes are damaged anywhere."""
    content = _save(folder / "sound.nii", sound).read_bytes()

    def fault(name: str, content: bytes, message: str | None, huge: bool = False) -> Fault:
        path = folder / f"{name}.nii"
        path.write_bytes(content)
        return Fault(f"nifti-{name}", path, "segment", image_deck(path), message, huge)

    for name, fields, message in _HEADERS:
        yield fault(name, _changed(content, fields), message)
    for name, sizes in _HUGE.items():
        yield fault(name, _changed(content, {"dim": sizes}), "header|3-D image", huge=True)
    yield fault("other-order", _changed(content, {"sizeof_hdr": 1543569408}), None)
    yield fault("two-axes", _changed(content, {"dim": [2, 32, 64, 1, 1, 1, 1, 1]}), None)
    yield fault("five-axes", _changed(content, {"dim": [5, 32, 32, 1, 1, 2, 1, 1]}), "3-D image")
    yield fault("header-only", content[:352], "cut off or its header")
    yield fault("half-a-header", content[:100], "not a readable NIfTI")
    yield fault("nothing", b"", "not a readable NIfTI")
    yield fault("text", b"no image at all\n" * 100, "not a readable NIfTI")
    yield fault("zeros", bytes(len(content)), "not a readable NIfTI")
    yield fault("longer", content + content, "more than its header promises")
    yield fault("packed-without-saying", gzip.compress(content), "not a readable NIfTI")
    for name, changed in spoilt(content, 6, 24, seed=1):
        yield fault(name, changed, None if "flip" in name else "NIfTI|cut off")


def _packed(folder: Path, sound: NDArray[Any]) -> Iterator[Fault]:
    """Compressed NIfTI files, whose damage shows in check sums only."""
    plain = (folder / "sound.nii").read_bytes()
    content = gzip.compress(plain, mtime=0)

    def fault(name: str, content: bytes, message: str | None, huge: bool = False) -> Fault:
        path = folder / f"{name}.nii.gz"
        path.write_bytes(content)
        return Fault(f"gzip-{name}", path, "segment", image_deck(path), message, huge)

    wrong = bytearray(content)
    wrong[-6] ^= 1
    big = _changed(plain, {"dim": _HUGE["90-gigabytes"]})
    # A gigabyte of zeros packs well: the file could hold what the header says.
    full = gzip.compress(big + bytes(100_000_000), 1)
    yield fault("check-sum", bytes(wrong), "compressed data are damaged")
    yield fault("plain", plain, "not a readable NIfTI")
    yield fault("tail", content + b"tail", "compressed data are damaged")
    yield fault("90-gigabytes", gzip.compress(big), "cut off or its header", huge=True)
    yield fault("bomb", full, "cut off or its header|of memory", huge=True)
    yield fault("longer", gzip.compress(plain + plain), "more than its header promises")
    for name, changed in spoilt(content, 6, 14, seed=2):
        yield fault(name, changed, None if "flip" in name else "NIfTI|damaged|cut off")


def _values(folder: Path, sound: NDArray[Any]) -> Iterator[Fault]:
    """Sound files of values that are none, or of no image."""
    one = (4, 5, 1)

    def with_one(value: float) -> NDArray[Any]:
        changed = sound.astype(np.float64)
        changed[one] = value
        return changed

    shaded = np.where(np.indices(sound.shape)[0] < 16, -sound, sound)
    colours = np.zeros(sound.shape, [("R", "u1"), ("G", "u1"), ("B", "u1")])
    cases: tuple[tuple[str, NDArray[Any], str | None], ...] = (
        ("nan", with_one(np.nan), r"1 voxels are not finite, the first at voxel \(4, 5, 1\)"),
        ("infinite", with_one(np.inf), "1 voxels are not finite"),
        ("all-nan", np.full_like(sound, np.nan), "2048 voxels are not finite"),
        ("huge-value", with_one(1e300), "1 values are beyond"),
        ("bright-spot", with_one(1e20), "the file is damaged there"),
        ("zeros", np.zeros_like(sound), "no value is above zero"),
        ("constant", np.ones_like(sound), "contrast"),
        ("negative", -sound, "no value is above zero"),
        ("complex", sound * (1 + 1j), "values are complex"),
        ("colours", colours, "values are colours"),
        ("volumes", np.stack([sound] * 3, -1), "3-D image is needed"),
        ("five-axes", np.stack([sound] * 2, -1)[:, :, :, None], "3-D image is needed"),
        ("one-voxel", sound[:1, :1, :1], "no body found"),
        ("one-row", sound[:, 15:16, :1], None),
        ("one-slice", sound[:, :, 0], None),
        ("whole-numbers", sound.astype(np.int16), None),
        ("lifted", sound - 1000.0 + 900.0, None),
    )
    for name, data, message in cases:
        path = _save(folder / f"{name}.nii.gz", data)
        yield Fault(f"values-{name}", path, "segment", image_deck(path), message)
    needles = _save(folder / "needles.nii.gz", sound, np.diag([50.0, 1e-3, 1e-3, 1.0]))
    for path, message in (
        (_save(folder / "sign.nii.gz", shaded), "of the values in the body are negative"),
        (needles, None),
    ):
        deck = {**image_deck(path), "bias": {"method": "level-sets"}}
        yield Fault(f"values-{path.name[:-7]}", path, "segment", deck, message)


def _no_files(folder: Path) -> Iterator[Fault]:
    """Places at which no file can be read."""

    def fault(path: Path, message: str) -> Fault:
        return Fault(f"place-{path.name}", path, "segment", image_deck(path), message)

    yield fault(folder / "missing.nii", "there is no such file")
    (folder / "folder.nii").mkdir()
    yield fault(folder / "folder.nii", "holds no DICOM images")
    os.mkfifo(folder / "pipe.nii")
    yield fault(folder / "pipe.nii", "not a regular file")
    (folder / "loop.nii").symlink_to("loop.nii")
    yield fault(folder / "loop.nii", "there is no such file")
    (folder / "format.mgz").write_bytes(gzip.compress(bytes(400)))
    yield fault(folder / "format.mgz", "NIfTI")
    (folder / "format.nrrd.txt").write_text("NRRD0004\n")
    yield fault(folder / "format.nrrd.txt", "not a readable NIfTI")


def _labels(folder: Path, sound: NDArray[Any]) -> Iterator[Fault]:
    """Label maps and their names."""
    anatomy = _save(folder / "anatomy.nii.gz", sound)
    label = ((sound > 60) & (sound < 200)).astype(np.int16)

    def fault(name: str, key: str, data: NDArray[Any], message: str, **other: Any) -> Fault:
        path = _save(folder / f"{name}.nii.gz", data, other.pop("affine", _AFFINE))
        deck = image_deck(anatomy, **{key: path}, **other)
        return Fault(f"labels-{name}", path, "segment", deck, message)

    empty, moved, corner = np.zeros_like(label), _AFFINE + np.eye(4, k=3), np.zeros_like(label)
    corner[0, 0] = 1
    yield fault("empty-reference", "reference", empty, "the reference is empty")
    yield fault("reference-in-air", "reference", corner, "the segmentation is empty")
    yield fault("empty-truth", "truth", empty, "no voxel has one of image.truth_labels")
    yield fault("empty-region", "region", empty, "the region is empty")
    yield fault("other-truth", "truth", label, "no voxel has one of", truth_labels=[7])
    yield fault("real-reference", "reference", label / 3.0, "must hold integers, not float64")
    yield fault("complex-truth", "truth", label * 1j, "values are complex")
    yield fault("negative-reference", "reference", -label, "must not be negative")
    yield fault("large-reference", "reference", label.astype(np.int64) * 2**40, "must not exceed")
    yield fault("other-grid", "reference", label[:, :, :1], "resample one to the grid")
    yield fault("other-place", "truth", label, "different affines", affine=moved)
    yield fault("four-axes", "reference", np.stack([label] * 2, -1), "3-D image is needed")
    for name, text in _NAMES.items():
        (folder / f"names-{name}.json").write_text(text, encoding="utf-8")
        path = _save(folder / f"names-{name}.nii.gz", label)
        deck = image_deck(anatomy, reference=path)
        beside = path.with_name(f"names-{name}.json")
        yield Fault(f"names-{name}", beside, "segment", deck, "must hold|twice|not text")


def _gradients(folder: Path, sound: NDArray[Any]) -> Iterator[Fault]:
    """Diffusion-weighted images and their tables."""
    anatomy = _save(folder / "anatomy.nii.gz", sound)
    table = np.random.default_rng(5).normal(size=(3, 8))
    table /= np.linalg.norm(table, axis=0)
    table[:, 0] = 0.0
    values = np.full(8, 500.0)
    values[0] = 0.0
    dwi = _save(folder / "dwi.nii.gz", sound[..., None] * np.exp(-values * 1.5e-3))
    rows = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in table)
    line = " ".join(f"{value:g}" for value in values)
    (folder / "sound.bval").write_text(line)
    (folder / "sound.bvec").write_text(rows)
    cases: tuple[tuple[str, str, str | bytes, str], ...] = (
        ("nothing.bval", "bval", "", "is empty"),
        ("comment.bval", "bval", "# none\n", "is empty"),
        ("words.bval", "bval", "no gradient", "rows of numbers are needed"),
        ("binary.bval", "bval", bytes(range(256)), "is not text"),
        ("short.bval", "bval", line[:-4], "has 7 values"),
        ("negative.bval", "bval", line.replace("500", "-500", 1), "must not be negative"),
        ("nan.bval", "bval", line.replace("500", "nan", 1), "not finite"),
        ("other-unit.bval", "bval", line.replace("500", "5e8"), "is implausible"),
        ("two-rows.bvec", "bvec", rows.rsplit("\n", 1)[0], "three rows of components"),
        ("ragged.bvec", "bvec", rows[:-9], "rows of numbers are needed"),
        ("long.bvec", "bvec", rows.replace("0.", "3.", 6), "must be unit vectors"),
        ("infinite.bvec", "bvec", rows.replace("0.000000", "inf", 1), "not finite"),
        ("huge.bvec", "bvec", "1e300 " * 8 + "\n" + "0 " * 8 + "\n" + "0 " * 8, "unit vectors"),
        ("one-line.bvec", "bvec", " ".join("1" * 24), "three rows of components"),
    )
    for name, key, text, message in cases:
        path = folder / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        tables = {"bval": folder / "sound.bval", "bvec": folder / "sound.bvec", key: path}
        deck = image_deck(anatomy, dwi=dwi, **tables)
        yield Fault(f"gradients-{name}", path, "segment", deck, message)
    still = folder / "still.bval"
    still.write_text(" ".join("0" * 8))
    deck = image_deck(anatomy, dwi=dwi, bval=still, bvec=folder / "sound.bvec")
    yield Fault("gradients-still", dwi, "segment", deck, "8 gradients do not determine a tensor")
    path = folder / "sparse.bval"
    with path.open("wb") as file:
        file.truncate(90_000_000_000)
    deck = image_deck(anatomy, dwi=dwi, bval=path, bvec=folder / "sound.bvec")
    yield Fault("gradients-sparse", path, "segment", deck, "is longer than", huge=True)
    for name, data in (("nan", np.nan), ("zero", 0.0), ("infinite", np.inf), ("negative", -1.0)):
        path = _save(folder / f"{name}-tensor.nii.gz", np.full((*sound.shape, 6), data))
        deck = image_deck(anatomy, tensor=path)
        yield Fault(f"tensor-{name}", path, "segment", deck, "no usable diffusion tensor")
    path = _save(folder / "grey-tensor.nii.gz", sound)
    yield Fault(
        "tensor-grey", path, "segment", image_deck(anatomy, tensor=path), "4-D image with 6"
    )
    path = _save(folder / "complex.nii.gz", np.ones((*sound.shape, 8), np.complex64))
    tables = {"bval": folder / "sound.bval", "bvec": folder / "sound.bvec"}
    deck = image_deck(anatomy, dwi=path, **tables)
    yield Fault("dwi-complex", path, "segment", deck, "values are complex")
