"""A reference bent onto an image by the image it was drawn in."""

import sys

import numpy as np
import pytest
from scipy import ndimage

from myork.errors import InputError, InstallationError
from myork.imaging.io import read_labels
from myork.imaging.phantom import make_phantom
from myork.records import Image, Labels
from myork.segmentation.bending import bend_labels
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice
from tests.images import affine_of, save, segmented
from tests.scenes import refuses


def one_slice(image):
    affine = image.affine.copy()
    affine[:3, 3] += affine[:3, 2]
    return type(image)(np.ascontiguousarray(image.data[:, :, 1:2]), affine)


def visits(amount=6.0, size=(96, 96, 3), spacing=(1.25, 1.25, 6.0)):
    """Image and labels of today, and of an earlier visit: bent, of another contrast and noise."""
    today, earlier = (make_phantom(size, spacing, seed=seed) for seed in (1, 9))
    spacing = np.array(spacing)
    random = np.random.default_rng(4)
    shape = today.truth.data.shape
    fields = [ndimage.gaussian_filter(random.normal(size=shape), 30 / spacing) for _ in range(3)]
    places = [
        axis + amount * field / np.abs(field).max() / step
        for axis, field, step in zip(np.indices(shape), fields, spacing, strict=True)
    ]
    grey = ndimage.map_coordinates(earlier.anatomy.data, places, order=1, mode="nearest")
    label = ndimage.map_coordinates(earlier.truth.data, places, order=0, mode="nearest")
    affine = today.anatomy.affine
    return today, Image(grey.max() - grey, affine, "then"), Labels(label, affine)


def means(found, truth):
    """Dice of the six muscles."""
    numbers = range(1, 7)
    return np.array([dice(found.data == number, truth.data == number) for number in numbers])


def one_slice_of(today, then, drawn):
    return [one_slice(image) for image in (today.anatomy, then, drawn, today.truth)]


@pytest.mark.slow
def test_every_muscle_of_a_slice_follows_its_own_bend():
    """The grid of the earlier visit may be another: finer, turned about, and begun elsewhere."""
    image, then, drawn, truth = one_slice_of(*visits())
    found = bend_labels(drawn, then, image, body_mask(image))
    after = means(found, truth)
    assert means(drawn, truth).mean() < 0.89
    assert after.mean() > 0.95 and after.min() > 0.88
    np.testing.assert_array_equal(found.affine, image.affine)
    affine = then.affine @ np.diag([-0.5, 0.5, 1.0, 1.0])
    affine[:3, 3] = (then.affine @ [95.25, -0.25, 0.0, 1.0])[:3]
    drawn, then = (
        kind(np.flip(ndimage.zoom(one.data, (2, 2, 1), order=n, grid_mode=True, mode="nearest"), 0),
             affine) for kind, one, n in ((Labels, drawn, 0), (Image, then, 1))
    )  # fmt: skip
    other = bend_labels(drawn, then, image, body_mask(image))
    assert means(other, found).min() > 0.95 and means(other, truth).mean() > 0.96


@pytest.mark.slow
def test_stacks_are_bent():
    today, then, drawn = visits(5.0, (48, 48, 6), (2.5, 2.5, 6.0))
    found = bend_labels(drawn, then, today.anatomy, body_mask(today.anatomy))
    before, after = (means(one, today.truth) for one in (drawn, found))
    assert before.mean() < 0.88
    assert after.mean() > 0.93 and after.min() > 0.86


@pytest.mark.slow
def test_segment_bends_the_reference(tmp_path):
    today, then, drawn = visits()
    files = {"now": today.anatomy, "then": then, "old": drawn, "truth": today.truth}
    save(tmp_path, then.affine, **{name: one_slice(one) for name, one in files.items()})
    keys = {"anatomy": "now.nii.gz", "regions": 2, "phase": "dark", "split": "nearest",
            "reference": "old.nii.gz", "truth": "truth.nii.gz", "margin": 0}  # fmt: skip

    def run(**more):
        bias = {"method": "auto"}
        return segmented(tmp_path, image={**keys, **more}, bias=bias)["segmentation"]

    lies, bent = (
        [score["dice"] for score in run(**more)["scores"].values()]
        for more in ({}, {"reference_anatomy": "then.nii.gz"})
    )
    assert np.mean(bent) > np.mean(lies) + 0.05
    assert read_labels(tmp_path / "out" / "segmentation.nii.gz").data.shape == (96, 96, 1)
    # the earlier image shows more, and a label that is not in this one
    then, drawn = one_slice(then), one_slice(drawn)
    wide = ((20, 0), (0, 0), (0, 0))
    affine = then.affine.copy()
    affine[:3, 3] -= 20 * affine[:3, 0]
    beyond = np.pad(drawn.data, wide)
    beyond[:5, 40:50] = 9
    save(tmp_path, affine, then=np.pad(then.data, wide), old=beyond)
    summary = run(reference_anatomy="then.nii.gz")
    assert any("nothing is left of label 9" in text for text in summary["warnings"])
    with pytest.raises(InputError, match="image.reference_anatomy: needs reference beside it"):
        keys = {"anatomy": "now.nii.gz"}
        run(reference_anatomy="then.nii.gz")


def test_what_cannot_be_bent_is_refused(monkeypatch):
    today, then, drawn = visits()
    image = one_slice(today.anatomy)
    refuses("must be one parallel to it", bend_labels, drawn, then, image, body_mask(image))
    few = "it takes 4 slices or more, or single ones"
    refuses(few, bend_labels, drawn, then, today.anatomy, body_mask(today.anatomy))
    today, then, drawn = visits(0.0, (48, 48, 6), (2.5, 2.5, 6.0))
    image, body = today.anatomy, body_mask(today.anatomy)
    far = affine_of(then.spacing, then.affine[:3, 3] + 500.0)
    labels = Labels(drawn.data, far)
    refuses("same part of the body", bend_labels, labels, Image(then.data, far), image, body)
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    refuses(r"myork\[seg\]", bend_labels, drawn, then, image, body, kind=InstallationError)
