"""Fibers where none were measured, and bodies of a single slice."""

import numpy as np
import pytest

from myork.errors import ConvergenceError, InputError
from myork.imaging.io import write_labels
from myork.model.flow import flow_fibers
from myork.model.slices import extruded
from myork.records import Labels
from myork.stations.build import build
from tests.images import angle, built, save
from tests.scenes import held, scene


def cone(top=72):
    """A part of a cone with its tip at the origin and half a slope of 0.35; directions from it."""
    side = np.arange(60) - 29.5
    x, y, z = np.meshgrid(side, side, np.arange(40, top) + 0.5, indexing="ij")
    away = np.stack([x, y, z], axis=-1)
    return np.hypot(x, y) < 0.35 * z, away / np.linalg.norm(away, axis=-1, keepdims=True)


def test_flow_follows_a_muscle_that_grows_wider():
    inside, way = cone()
    found = flow_fibers(Labels(inside.astype(np.int32), np.eye(4))).data
    np.testing.assert_allclose(np.linalg.norm(found[inside], axis=-1), 1.0)
    assert not found[~inside].any()
    middle = inside.copy()
    middle[:, :, :8] = middle[:, :, -8:] = False
    # the flow enters and leaves across the flat ends; between them it comes from the tip
    straight = angle(np.array([0, 0, 1.0]), way)[middle].mean()
    assert angle(found, way)[middle].mean() < 0.25 * straight


def test_each_label_has_its_own_flow_in_any_orientation():
    data = np.zeros((40, 8, 30), np.int32)
    for k in range(30):
        data[k : k + 10, :, k] = 1
    data[:6, :, 20:24] = 2  # apart from it, and only four slices long
    labels = Labels(data, np.diag([1.0, 1.0, 2.0, 1.0]))
    found = flow_fibers(labels).data
    leaning = np.array([0.5, 0, 1.0]) / np.hypot(0.5, 1.0)
    middle = np.zeros_like(data)
    middle[:, :, 8:22] = data[:, :, 8:22]
    assert angle(found, leaning)[middle == 1].mean() < 4.0
    assert angle(found, np.array([0, 0, 1.0]))[data == 2].max() < 1e-3
    turn = np.array([[0, 0, 1.0, 3], [-1.0, 0, 0, 0], [0, 1.0, 0, -2], [0, 0, 0, 1]])
    again = flow_fibers(Labels(data, turn @ labels.affine))
    assert again.data.shape == (30, 40, 8, 3)  # its third axis is superior now
    assert np.linalg.norm(again.data, axis=-1).max() == pytest.approx(1.0)


def test_a_flow_that_is_not_found_is_told(monkeypatch):
    monkeypatch.setattr("myork.model.flow._TOLERANCE", 0.0)
    inside = np.zeros((6, 6, 6), np.int32)
    inside[1:5, 1:5] = 1
    inside[2, 2, 1:4] = 0
    said = r"build.flow: .* component of \d+ voxels did not converge"
    with np.errstate(invalid="ignore"), pytest.raises(ConvergenceError, match=said):
        flow_fibers(Labels(inside, np.eye(4)))


def test_measured_fibers_and_a_flow_are_one_too_many(tmp_path):
    inside, way = cone(44)
    save(tmp_path, np.eye(4), l=inside, f=way)
    with pytest.raises(InputError, match=r"build\.flow .* there is build\.fibers"):
        built(tmp_path, labels="l.nii.gz", fibers="f.nii.gz", flow=True)


def test_one_slice_has_no_ends_for_a_flow(tmp_path):
    save(tmp_path, np.eye(4), l=np.ones((6, 5, 1), np.int32))
    with pytest.raises(InputError, match=r"there is one slice only; set build\.extrude"):
        built(tmp_path, dimension=2, labels="l.nii.gz", flow=True)


def test_prism_of_a_slice_lies_about_it():
    data = np.zeros((9, 7, 1), np.int32)
    data[2:7, 2:5] = 3
    affine = np.diag([-2.0, -2.0, 1.0, 1.0])  # left, posterior, a placeholder for the thickness
    affine[2, 3] = 50.0
    prism = extruded(Labels(data, affine, {3: "soleus"}), 40.0)
    assert prism.data.shape == (9, 7, 20) and prism.names == {3: "soleus"}
    np.testing.assert_allclose(prism.spacing, 2.0)
    place = np.argwhere(prism.data) @ prism.affine[:3, :3].T + prism.affine[:3, 3]
    np.testing.assert_allclose(place.mean(axis=0)[2], 50.0)
    np.testing.assert_allclose([place[:, 2].min(), place[:, 2].max()], [31.0, 69.0])
    with pytest.raises(InputError, match=r"build\.extrude .* this image has 20 of them"):
        extruded(prism, 40.0)


def test_a_label_without_a_name_has_that_of_its_material(tmp_path):
    data = np.ones((6, 6, 4), np.int32)
    data[3:] = 2
    write_labels(tmp_path / "l.nii.gz", Labels(data, np.eye(4), {1: "soleus"}))
    rubber = {"model": "neo-hookean", "mu": 1, "K": 100}
    deck = scene(
        "auto", {"kind": "model"}, build={"labels": tmp_path / "l.nii.gz"},
        material=[{"name": "a", "label": 1, **rubber}, {"name": "fat", "label": 2, **rubber}],
        boundary=[held("bottom")],
    )  # fmt: skip
    found = build(deck, tmp_path / "out")["model"]
    assert list(found["volume"]) == ["soleus", "fat"]
    assert [row["muscle"] for row in found["muscles"]] == ["soleus", "fat"]
