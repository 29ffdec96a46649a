"""Which material lies where in boxes and annuli, by expressions and by label maps over them."""

from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

from myork.core.deck import load_deck
from myork.imaging.io import read_labels
from myork.results import Results
from myork.stations.solve import run_deck
from tests.scenes import PLANES, box, loaded, neo, refused, scene, solved

#: Axes of an image that lies askew: 0.6, 0.8 is a right angle's triangle
TURNED = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])


def save(path, data, affine=None, form="sform", unit="mm", order="<") -> str:
    """Write an image, whose affine stands in one of the places of a header; its path."""
    affine = spaced(1, 0.5, 0.5) if affine is None else affine
    header = nibabel.Nifti1Header(endianness=order)
    header.set_data_dtype(data.dtype)
    image = nibabel.Nifti1Image(data, affine, header)
    image.set_sform(affine if form == "sform" else None, code=int(form == "sform"))
    image.set_qform(affine, code=int(form == "qform"))
    image.header.set_xyzt_units(unit)
    nibabel.save(image, path)
    return str(path)


def spaced(*size: float, at: Any = (0, 0, 0)) -> np.ndarray:
    """Affine of voxels of a size, the middle of the first one at a place."""
    affine = np.diag([*size, 1.0])
    affine[:3, 3] = at
    return affine


def halves() -> np.ndarray:
    """Ten voxels along x, five of label 5 and five of label 9."""
    data = np.full((10, 4, 4), 5, np.uint8)
    data[5:] = 9
    return data


SOFT, STIFF = neo(1.0, 100.0, "soft"), neo(4.0, 400.0, "stiff")


def bar(geometry: dict[str, Any], material: list[dict[str, Any]], **other: Any) -> dict[str, Any]:
    """A bar of 1 x 0.2 x 0.2 cm that is pulled along x."""
    body, end = box(11, 3, 3, size=[1, 0.2, 0.2]) | geometry, {"traction": [0.5, 0, 0]}
    return loaded("auto", body, material, "x0 x1", end, "end u_x 1 0.1 0.1") | other


def mapped(labels: str, **geometry: Any) -> dict[str, Any]:
    return bar({"labels": labels, **geometry}, [SOFT | {"label": 5}, STIFF | {"label": 9}])


def check_same(found: np.ndarray, expected: np.ndarray, name: str = "") -> None:
    """A map's borders are known to a thousandth of a voxel, here 1e-4 of the bar, by whose end's
    motion (1.25 to 1) the displacements change.
    """
    np.testing.assert_allclose(found, expected, 0, 2e-4 * np.abs(expected).max(), err_msg=name)


WHERE = [SOFT | {"where": "x < 0.5"}, STIFF | {"where": "x >= 0.5"}]


@pytest.mark.parametrize(
    ("method", "kind", "order", "suffix"),
    [
        *(pytest.param(method, np.uint8, "<", "nii.gz", marks=pytest.mark.slow)
          for method in ("rkpm-gauss", "rkpm-scni", "rkcm-mixed")),
        *(("auto", kind, ">", "nii.gz") for kind in (np.int16, np.float32, np.int64)),
        *(("auto", kind, "<", "nii.gz") for kind in (np.int8, np.uint32)),
        *(("auto", kind, "<", "nii") for kind in (np.float64, np.uint16, np.uint64)),
        *(("auto", kind, ">", "nii") for kind in (np.uint8, np.int32)),
    ],
)  # fmt: skip
def test_halves_by_a_map_are_halves_by_an_expression(method, kind, order, suffix, tmp_path):
    """In all forms, and by whole numbers of all types in either order of their bytes."""
    path = save(tmp_path / f"half.{suffix}", halves().astype(kind), order=order)
    override = f"scene.method={method}"
    check_same(solved(mapped(path), override).states.x, solved(bar({}, WHERE), override).states.x)


def test_maps_that_lie_otherwise(tmp_path: Path) -> None:
    """Axes turned round, in metres, by qform, without either, and a box inside of the map."""
    half, voxel = halves(), (0.5, 0.5)
    swapped = np.ascontiguousarray(half.transpose(1, 2, 0)), spaced(*voxel, 1)[[2, 0, 1, 3]]
    padded = np.pad(half, 3, constant_values=1), spaced(1, *voxel, at=(-2.5, -1.25, 38.75))
    maps: dict[str, Any] = {
        "back": (half[::-1], spaced(-1, *voxel, at=(30, -4, 7)), "qform"),
        "metres": (half, spaced(1e-3, 5e-4, 5e-4), "sform", "meter"),
        # without an affine x runs to the left
        "plain": (half[::-1], spaced(1, *voxel), "none"), "swapped": swapped, "wide": padded,
    }  # fmt: skip
    second = tmp_path / "second.nii.gz"
    nibabel.save(nibabel.Nifti2Image(half, spaced(1, *voxel)), second)
    paths = {name: save(tmp_path / f"{name}.nii", *how) for name, how in maps.items()}
    expected = solved(bar({}, WHERE)).states.x
    for name, path in {**paths, "second": str(second)}.items():
        more = {"labels_origin": [0, 0, 4]} if name == "wide" else {}
        check_same(solved(mapped(path, **more)).states.x, expected, name)


def test_points_have_the_labels_of_the_voxels_that_they_lie_in(tmp_path: Path) -> None:
    """A map askew against the box: the reader of images tells which voxel holds a point."""
    rng = np.random.default_rng(5)
    data = rng.choice(np.array([2, 7, 30], np.int16), (12, 11, 9))
    affine = np.eye(4)
    affine[:3, :3] = TURNED * [1.0, 1.5, 2.0]
    affine[:3, 3] = [-5, 3, 1]
    path = save(tmp_path / "askew.nii.gz", data, affine)
    origin = (affine @ [4, 3, 2, 1])[:3] / 10
    material = [SOFT | {"name": str(label), "label": label} for label in np.unique(data)]
    body = box(3, 3, 3, size=[0.37, 0.41, 0.83], places=(7, 8, 9), labels=path)
    tables = bar(body | {"labels_origin": origin.tolist()}, material, boundary=PLANES, probe=[])
    run_deck(tables, tmp_path / "out")
    with Results(tmp_path / "out") as results:
        points, label = np.asarray(results.points), np.asarray(results.label)
    labels = read_labels(Path(path))
    at = (10 * (points + origin) - labels.affine[:3, 3]) @ np.linalg.inv(labels.affine[:3, :3]).T
    sure = np.abs(at - np.floor(at) - 0.5).min(axis=1) > 0.01
    assert sure.sum() > 0.8 * len(points)
    voxel = np.rint(at[sure]).astype(int)
    np.testing.assert_array_equal(label[sure], labels.data[tuple(voxel.T)])
    assert len(np.unique(label)) == 3


@pytest.mark.slow
def test_materials_by_label_and_by_where_and_one_that_fills_the_rest(tmp_path: Path) -> None:
    path = save(tmp_path / "half.nii.gz", halves())
    end = STIFF | {"name": "end", "mu": 9.0, "where": "x > 0.8"}
    by_map = bar({"labels": path}, [SOFT, STIFF | {"label": 9}, end])
    by_text = bar({}, [SOFT, STIFF | {"where": "x >= 0.5"}, end])
    for tables in (by_map, by_text):
        tables["set"] = [{"name": "bare", "on": "stiff", "side": "z1"}]
        tables["boundary"].append({"set": "bare", "traction": [0, 0, 0.1]})
    check_same(solved(by_map).states.x, solved(by_text).states.x)


def test_a_plane_is_a_slice_of_the_map(inputs: Path, tmp_path: Path) -> None:
    """The deck of inputs/ and one of a map with its slice alone."""
    path = inputs / "label_section.toml"
    labels = read_labels(inputs / "images" / "two_muscles.nii.gz")
    one = save(tmp_path / "slice.nii", labels.data[:, :, 12].astype(np.uint8), labels.affine)
    expected = solved(path).states.x
    flat = [f'geometry.labels="{one}"', "geometry.labels_origin=[-0.046875,-0.046875,0]"]
    np.testing.assert_array_equal(solved(path, *flat).states.x, expected)
    tables = {key: load_deck(path)[key] for key in ("scene", "units", "material", "boundary")}
    found = solved(tables | {"geometry": box(33, 17, size=[3, 1.5], labels=one)}).states.x
    np.testing.assert_array_equal(found, expected)
    tables["geometry"] = box(9, 5, size=[3, 1.5], labels=inputs / "images" / "two_muscles.nii.gz")
    assert "has 24 slices: say with labels_origin at which height" in refused(tables)


@pytest.mark.parametrize(
    ("override", "what"),
    [
        ("material.stiff.label=7",
         "material.stiff.label: label 7 of 'HALF' is not in the box; in the box are 5, 9"),
        ("geometry.size=[0.4,0.2,0.2]",
         "material.stiff.label: label 9 of 'HALF' is not in the box; in the box are 5"),
        ("geometry.size=[1.1,0.2,0.2]",
         "geometry.labels: 'HALF' does not cover the box: the corner (1.1, 0, 0) lies at "
         "voxel (10.5, -0.5, -0.5), and the map has 10 x 4 x 4; make the box smaller"),
        ("geometry.labels_origin=[0,0,0]", "'HALF' does not cover the box: the corner (1, 0"),
        ("units.length=inch", "units.length: must be mm, cm or m, not inch: geometry.labels lays"),
        ("geometry.labels=nowhere.nii", "geometry.labels: 'nowhere.nii' cannot be read: there is"),
        ("geometry.labels=HOLE", "'HOLE' has the label 3 at (0.75, 0.075, 0.125), which no "
         "[[material]] has: add one, or leave label out of the first one"),
    ],
)  # fmt: skip
def test_maps_that_do_not_fit(override: str, what: str, tmp_path: Path) -> None:
    path = save(tmp_path / "half.nii.gz", halves())
    data = halves()
    data[7, 1, 2] = 3
    hole = save(tmp_path / "hole.nii.gz", data)
    said = refused(mapped(path), overrides=[override.replace("HOLE", hole)])
    assert what.replace("HALF", path).replace("HOLE", hole) in said


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (np.ones((4, 4, 4), np.complex64), "holds values of type COMPLEX64; save the label map"),
        (np.full((4, 4, 4), 0.5, np.float32), "has the value 0.500000; labels are whole numbers"),
        (np.full((4, 4, 4), 3e9), "has the label 3000000000.000000; labels are from"),
        (np.full((4, 4, 4), -3, np.int16), "has the label -3; labels are from 0"),
        (np.zeros((4, 4, 4, 2), np.int16), "is not a label map: it has 2 values per voxel"),
        (b"no image", "is not a readable NIfTI file"),
        (slice(-9), "ends before the values that its header promises"),
        (slice(300), "is not a readable NIfTI file"),
        (None, "scales its values"),
    ],
)
def test_files_that_are_no_label_maps(data: Any, what: str, tmp_path: Path) -> None:
    path = tmp_path / "map.nii"
    save(path, data if isinstance(data, np.ndarray) else halves(), spaced(10, 10, 10))
    if data is None:
        image = nibabel.Nifti1Image(halves(), np.eye(4))
        image.header.set_slope_inter(2.0, 0.0)
        nibabel.save(image, path)
    elif not isinstance(data, np.ndarray):
        path.write_bytes(data if isinstance(data, bytes) else path.read_bytes()[data])
    assert f"geometry.labels: '{path}' {what}" in refused(mapped(str(path)))


# ---- parts by expressions: two bodies that share a face ------------------------------------------

#: Rubbers with no Poisson's ratio at small strains: E = 2 mu, K = 2/3 mu
CORK, OAK = neo(1.0, 2 / 3, "cork"), neo(4.0, 8 / 3, "oak")


def pulled(*material: dict[str, Any]) -> dict[str, Any]:
    """A strip that is pulled with a stress of 1e-4 along x."""
    body, end = box(21, 5, size=[1, 0.2]), {"traction": [1e-4, 0]}
    return loaded("rkpm-gauss", body, material, "x0 x1", end, "end u_x 1 0.1", load={"steps": 1})


def end_of(tables: dict[str, Any]) -> float:
    return next(iter(solved(tables).last().values()))


def test_the_later_material_fills_what_two_hold() -> None:
    one = end_of(pulled(CORK, OAK | {"where": "x > 0.5"}))
    two = end_of(pulled(OAK, CORK | {"where": "x <= 0.5 and r >= 0"}))
    assert two == pytest.approx(one, rel=1e-9)


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        (pulled(CORK | {"where": "x < 0.5"}), "material.cork.where: no material is given at"),
        (pulled(CORK, OAK), "material.cork.label: missing"),
        (pulled(CORK, OAK | {"where": "x > 2"}), "material.oak.where: no point lies there"),
        (pulled(CORK, OAK | {"where": "x > q"}), "material.oak.where: 'x > q' is not an expressio"),
        (pulled(CORK | {"where": "x < 1"}, OAK), "material.oak.where: missing, only the first"),
        (pulled(CORK | {"label": 1}, OAK | {"where": "x < 1"}),
         "material.cork.label: cannot be given"),
        (bar({"labels": "half.nii"}, [SOFT | {"label": 1}, STIFF]),
         "material.stiff.label: missing, and so is `where`: only the first"),
        (bar({}, [SOFT | {"label": 1}, STIFF | {"where": "x > 0"}]),
         "in a box labels are those of a label map, geometry.labels"),
        (scene("auto", box(5, places=(5,), labels="half.nii"), linear={"problem": "poisson"},
               boundary=[{"set": "x0", "u": 0}]),
         "geometry.labels: is not used by a linear problem"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(tables, what, tmp_path, monkeypatch) -> None:
    save(tmp_path / "half.nii", halves())
    monkeypatch.chdir(tmp_path)
    assert what in refused(tables)
