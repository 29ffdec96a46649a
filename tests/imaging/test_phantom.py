"""The phantom: repeatable, and in agreement with its formulas."""

import numpy as np
import pytest
from scipy import ndimage

from benchmarks.truths.scanners import write_gradients
from myork.errors import FileError
from myork.imaging.diffusion import fit_tensors
from myork.imaging.gradients import GradientTable, read_gradients
from myork.imaging.phantom import make_phantom
from myork.records import Image, Labels
from tests.scenes import refuses


@pytest.fixture(scope="module")
def phantom():
    return make_phantom()


def test_six_muscles_in_every_slice_with_fibers_of_their_pennation(phantom):
    truth = phantom.truth.data
    assert all(set(np.unique(truth[:, :, k])) == set(range(7)) for k in range(truth.shape[2]))
    length = np.linalg.norm(phantom.fiber.data, axis=-1)
    np.testing.assert_allclose(length, truth > 0, atol=1e-12)
    both = phantom, make_phantom(pennation=0.5)
    lean, half = (np.arccos(own.fiber.data[truth == 3, 2]) for own in both)
    np.testing.assert_allclose(half, 0.5 * lean, atol=1e-12)


def test_noise_and_shading_are_those_asked_for(phantom):
    clean, again, plain = (make_phantom(snr=1e9, bias=b).anatomy.data for b in (0.3, 0.3, 0.0))
    assert np.array_equal(clean, again)
    noise = (phantom.anatomy.data - clean)[phantom.truth.data == 1]
    # Muscle has a brightness of 393 here; 5705 samples give the deviation to 1 %, Rician ones less.
    assert np.std(noise) == pytest.approx(400 / 25, rel=0.05)
    field, lit = phantom.bias.data, plain > 1.0
    assert np.abs(field - 1).max() == pytest.approx(0.3)
    np.testing.assert_allclose(clean[lit] / plain[lit], field[lit], rtol=1e-6)


@pytest.fixture(scope="module")
def old_leg():
    return make_phantom(imat=0.06, imct=0.3, aponeurosis=1.5, septum=0.6, growth=15.0)


def test_materials_fill_the_asked_parts_of_every_muscle(old_leg):
    for muscle in range(1, 7):
        tissue = old_leg.tissue.data[old_leg.truth.data == muscle]
        # Fractions are quantiles of fields on some thousand voxels.
        for number, part, near in ((1, 0.64, 0.004), (2, 0.06, 0.002), (3, 0.30, 0.002)):
            assert np.mean(tissue == number) == pytest.approx(part, abs=near)
    mg = old_leg.truth.data == 1
    rim = ndimage.binary_dilation(mg, np.ones((3, 3, 1))) & ~mg
    assert np.mean(old_leg.tissue.data[rim] == 3) > 0.9


def test_muscles_grow_until_they_meet(phantom, old_leg):
    before, after = (np.mean(p.truth.data[p.tissue.data > 0] > 0) for p in (phantom, old_leg))
    assert after > 1.3 * before
    # The medial gastrocnemius is unchanged.
    assert np.array_equal(old_leg.truth.data == 1, phantom.truth.data == 1)


def test_scale_changes_the_section():
    small = make_phantom(size=(80, 80, 5), scale=0.8, bias=0.0)
    # an ellipse with semi-axes of 23 and 11 mm, less towards both ends (test_fibers.py)
    exact = np.pi * 23.0 * 11.0 * (0.8 * (1.0 - 0.3 * (0.05 / 0.55) ** 2)) ** 2
    assert (small.truth.data[:, :, 2] == 1).sum() * 1.25**2 == pytest.approx(exact, rel=0.03)
    refuses("leaves no muscle", make_phantom, imat=0.5, imct=0.5)
    refuses("needs 112 x 112 mm", make_phantom, size=(40, 40, 5))


def test_gradients_come_back_in_any_orientation(tmp_path):
    directions = np.array([[0, 0, 0], [1, 0, 0], [0, 0.6, 0.8]])
    table = GradientTable(np.array([0.0, 500.0, 500.0]), directions)
    turned = np.array([[0, 0, -2.0, 0], [-1.0, 0, 0, 0], [0, 3.0, 0, 0], [0, 0, 0, 1]])
    for affine in (np.diag([2.0, 2, 6, 1]), np.diag([-2.0, 2, 6, 1]), turned):
        write_gradients(tmp_path, "a", table, affine)
        again = read_gradients(tmp_path / "a.bval", tmp_path / "a.bvec", affine, 3)
        np.testing.assert_allclose(again.direction, directions, atol=1e-8)
        np.testing.assert_array_equal(again.b, table.b)
        if affine is not turned:  # FSL: negated where the determinant is positive
            np.testing.assert_allclose(np.loadtxt(tmp_path / "a.bvec")[:, 1], [-1, 0, 0])


GRID, UNIT = np.zeros((2, 2, 2)), np.eye(3)


@pytest.mark.parametrize(("message", "record", "first", "second"), [
    ("needs? directions of shape", GradientTable, np.full(4, 500.0), UNIT),
    ("must not be negative", GradientTable, np.array([0.0, -1.0, 500.0]), UNIT),
    ("not finite", GradientTable, np.array([0.0, np.nan, 500.0]), UNIT),
    ("no b value is above", GradientTable, np.array([0.0, 0.5, 1.0]), UNIT),
    ("direction 1 has length 3", GradientTable, np.full(3, 500.0), 3.0 * UNIT),
    ("3 or 4 dimensions", Image, GRID[0], np.eye(4)), ("3 dim", Labels, GRID[None], np.eye(4)),
    ("not 4 x 4", Image, GRID, UNIT), ("singular", Labels, GRID, np.diag([1.0, 1, 0, 1])),
    ("a volume for each of 1 gradients", fit_tensors, Image(GRID, np.eye(4)),
     GradientTable(np.array([500.0]), UNIT[:1])),
])  # fmt: skip
def test_records_that_cannot_be_are_refused(message, record, first, second):
    refuses(message, record, first, second)


@pytest.mark.parametrize(("b", "v", "message"), [
    ("0 500", "0 1\n0 0\n0 0", "has 2 values .* there are 3 diffusion images"),
    ("0 500 500", "0 1\n0 0\n0 0", "2 directions"),
    ("0 500 500", "0 1 1\n0 0 0", r"three rows of components are needed, not \(2, 3\)|2 dir"),
    ("0 -500 500", "0 1 0\n0 0 1\n0 0 0", "must not be negative"),
    ("0 500 500", "0 1 0\n0 0 0\n0 0 0", "direction 3 has length 0 with b = 500"),
    ("0 500 500", "0 nan 0\n0 0 0\n0 0 1", "not finite"),
    ("0 500 x", "0 1 0\n0 0 0\n0 0 1", "rows of numbers"),
])  # fmt: skip
def test_bad_gradients_are_named(tmp_path, b, v, message):
    values, vectors = tmp_path / "dwi.bval", tmp_path / "dwi.bvec"
    values.write_text(b)
    vectors.write_text(v)
    refuses(message, read_gradients, values, vectors, np.eye(4), 3)
    missing = tmp_path / "no.bval"
    refuses("there is no such file", read_gradients, missing, vectors, np.eye(4), 3, kind=FileError)
