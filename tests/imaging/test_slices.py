"""Thick slices cut into thinner ones, against muscles that are known between them."""

import numpy as np
import pytest

from myork.model.slices import finer_fibers, finer_labels, finer_values, slice_parts
from myork.records import Image, Labels
from myork.segmentation.scores import dice
from tests.images import affine_of, angle, built, save

PARTS = 8


def stacked(thickness):
    """Affine whose lowest slice has its middle at half of its thickness."""
    return affine_of((1.0, 1.0, thickness), (0, 0, 0.5 * thickness))


def muscles(heights):
    """Two muscles that touch, lean, bend and taper, and their fibers, in slices at heights [mm]."""
    x, y = np.meshgrid(np.arange(110) - 55.0, np.arange(90) - 45.0, indexing="ij")
    labels = np.zeros((*x.shape, len(heights)), np.int32)
    fibers = np.zeros((*labels.shape, 3))
    for k, z in enumerate(heights):
        lean, bend = 0.35 * (z - 48.0), 10.0 * np.sin(z / 30.0)
        size = 1.0 - 0.45 * ((z - 48.0) / 48.0) ** 2
        inside = ((x - lean) / (30.0 * size)) ** 2 + ((y - bend) / (18.0 * size)) ** 2 < 1.0
        labels[..., k] = np.where(inside, np.where(x - lean + 0.4 * (y - bend) < 0, 1, 2), 0)
        way = np.array([[0, 0, 0], [0.35 + 0.003 * z, 0.1, 1.0], [-0.2, 0.3 - 0.004 * z, 1.0]])
        fibers[..., k, :] = way[labels[..., k]]
    return labels, fibers


@pytest.fixture(scope="module")
def stacks():
    """Labels and fibers of slices of 1 and of 8 mm; the lowest begins at height 0."""
    found = []
    for thickness, count in ((1.0, 96), (8.0, 12)):
        labels, fibers = muscles(thickness * (np.arange(count) + 0.5))
        affine = stacked(thickness)
        found += [Labels(labels, affine, {1: "a", 2: "b"}), Image(fibers, affine)]
    return found


def test_stack_of_8_mm_has_the_muscles_of_1_mm(stacks):
    fine, _, thick, _ = stacks
    assert slice_parts(thick.spacing, 1.0) == (2, PARTS)
    found = finer_labels(thick, 2, PARTS)
    np.testing.assert_allclose(found.affine, fine.affine)
    repeated = np.repeat(thick.data, PARTS, axis=2)
    for number in (1, 2):
        own, truth = found.data == number, fine.data == number
        assert dice(own, truth) >= max(0.975, dice(repeated == number, truth) + 0.02)
        assert own.sum() == pytest.approx(truth.sum(), rel=0.015)
    assert found.names == thick.names


def test_muscles_that_touch_leave_no_gap_and_keep_their_volumes():
    """A block of two, whose border leans to the one side in every second slice."""
    x, y, k = np.indices((40, 30, 6))
    edge = 20 + (-1.0) ** k * 5 * np.sin(2 * np.pi * y / 15)
    inside = (np.abs(x - 19.5) < 14) & (np.abs(y - 14.5) < 11)
    data = np.where(inside, np.where(x < edge, 1, 2), 0).astype(np.int32)
    found = finer_labels(Labels(data, stacked(8.0)), 2, PARTS).data
    assert (found[8:32, 6:24] > 0).all()
    for number in (1, 2):
        volume = (found == number).sum() / PARTS
        assert volume == pytest.approx((data == number).sum(), rel=0.005)


def test_a_muscle_that_begins_beside_another_does_not_bend_it():
    """Two cylinders; where the second begins, the middle of both together jumps by 19 mm."""
    x, y = np.meshgrid(np.arange(120) - 40.0, np.arange(60) - 30.0, indexing="ij")
    first = x**2 + y**2 < 20**2
    data = np.repeat(first[..., np.newaxis], 12, axis=2).astype(np.int32)
    data[((x - 38) ** 2 + y**2 < 20**2) & ~first, 6:] = 2
    found = finer_labels(Labels(data, stacked(8.0)), 2, PARTS).data
    assert min(dice(found[..., k] == 1, first) for k in range(12 * PARTS)) > 0.96
    heights = np.flatnonzero((found == 2).any(axis=(0, 1)))
    assert heights[0] == pytest.approx(5.5 * PARTS, abs=4) and heights[-1] == 12 * PARTS - 1


@pytest.mark.slow
def test_fibers_go_to_every_voxel_of_their_own_muscle(stacks):
    fine, way, thick, fibers = stacks
    labels = finer_labels(thick, 2, PARTS)
    found = finer_fibers(fibers, thick, labels, 2, PARTS).data
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), labels.data > 0, atol=1e-9)
    both = (labels.data == fine.data) & (fine.data > 0)
    true = way.data[both] / np.linalg.norm(way.data[both], axis=-1, keepdims=True)
    wrong = angle(found[both], true)
    assert wrong.mean() < 0.5 and wrong.max() < 2.0  # they turn by 1.8 degrees from slice to slice


@pytest.mark.slow
def test_any_axis_may_be_the_thick_one(stacks):
    thick, fibers = stacks[2:]
    turned = Labels(np.moveaxis(thick.data, 2, 0), affine_of((8.0, 1.0, 1.0)))
    assert slice_parts(turned.spacing, 2.0) == (0, 4)
    found, upright = finer_labels(turned, 0, 4), finer_labels(thick, 2, 4)
    np.testing.assert_array_equal(np.moveaxis(found.data, 0, 2), upright.data)
    vectors = Image(np.moveaxis(fibers.data, 2, 0), turned.affine)
    way = finer_fibers(vectors, turned, found, 0, 4).data
    same = finer_fibers(fibers, thick, upright, 2, 4).data
    np.testing.assert_allclose(np.moveaxis(way, 0, 2), same)


def test_values_beside_a_muscle_are_none_of_its(stacks):
    thick = stacks[2]
    found = finer_labels(thick, 2, PARTS)
    inside = found.data > 0
    assert (inside & (np.repeat(thick.data, PARTS, axis=2) == 0)).any()
    values = finer_values(Image(thick.data / 4.0, thick.affine), thick, found, 2, PARTS)
    np.testing.assert_array_equal(values.data[inside], found.data[inside] / 4.0)
    np.testing.assert_allclose(values.affine, found.affine)


def test_a_muscle_that_ends_between_slices_ends_half_of_the_way():
    data = np.zeros((20, 20, 4), np.int32)
    data[5:15, 5:15, 1] = 1
    area = finer_labels(Labels(data, stacked(8.0)), 2, PARTS).data.sum(axis=(0, 1))
    heights = np.flatnonzero(area)
    assert (heights.min(), heights.max()) == (8, 15) and area[8] < 0.3 * area[11]
    one = Labels(data[..., 1:2], stacked(8.0))
    np.testing.assert_array_equal(finer_labels(one, 2, 3).data, np.repeat(one.data, 3, axis=2))


def test_model_of_thick_slices(stacks, tmp_path):
    fine, _, thick, fibers = stacks
    save(tmp_path, thick.affine, labels=thick, fibers=fibers)
    model = built(
        tmp_path, labels="labels.nii.gz", fibers="fibers.nii.gz", slice_thickness=4,
        collocation_stride=[4, 4, 1], source_stride=[8, 8, 2],
    )  # fmt: skip
    assert model["volume"]["a"] == pytest.approx((fine.data == 1).sum(), rel=0.015)
    assert model["points_without_fiber"] == 0
