"""From images to the points of a model on arrays."""

import numpy as np
import pytest

from myork import imaging
from myork.errors import InputError
from myork.imaging.phantom import make_phantom
from tests.images import angle, phantom_dwi


@pytest.fixture(scope="module")
def calf():
    return make_phantom((96, 96, 5), (1.25, 1.25, 8.0))


def test_functions_are_found_by_name():
    assert set(imaging.__all__) <= set(dir(imaging))
    assert all(callable(getattr(imaging, name)) for name in imaging.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = imaging.nothing


@pytest.mark.slow
def test_from_images_to_points(calf):
    affine = calf.anatomy.affine
    even, field, doubt = imaging.correct_bias(calf.anatomy.data, affine)
    np.testing.assert_allclose(even * field, calf.anatomy.data)
    assert not doubt
    regions = imaging.segment(even, affine, regions=2)
    assert set(np.unique(regions)) == {0, 1, 2}
    dark = regions == 1
    truth = calf.truth.data > 0
    assert truth[dark].mean() > 0.8
    images, table = phantom_dwi(calf)
    tensor = imaging.fit_tensors(images.data, affine, table.b, 3.0 * table.direction)
    fibers = imaging.mean_fibers(tensor, affine, calf.truth.data)
    assert angle(fibers, calf.fiber.data)[truth].mean() < 2.5
    gastrocnemius = np.where(calf.truth.data == 1, 1, 0)
    labels, finer, way = imaging.resample(gastrocnemius, affine, 4.0, fibers)
    assert labels.shape == (96, 96, 10) and finer[2, 2] == pytest.approx(4.0)
    cloud, _ = imaging.build_points(
        labels, finer, way, names={1: "gm"}, collocation_stride=[2, 2, 1], source_stride=[4, 4, 2]
    )
    assert cloud.label_names == {1: "gm"}
    volume = gastrocnemius.sum() * 1.25 * 1.25 * 8.0 / 1000.0
    assert cloud.volume.sum() == pytest.approx(volume, rel=0.05)
    assert cloud.fiber.any(axis=1).all()


def test_shapes_that_do_not_fit_are_told():
    cube, affine = np.ones((4, 4, 4)), np.eye(4)
    with pytest.raises(InputError, match="an array with 3 axes"):
        imaging.correct_bias(cube[0], affine)
    with pytest.raises(InputError, match=r"a body of the shape \(4, 4, 4\)"):
        imaging.segment(cube, affine, cube[:3])
    with pytest.raises(InputError, match="2 volumes need as many b values"):
        imaging.fit_tensors(np.ones((4, 4, 4, 2)), affine, [0.0], [[1, 0, 0]])
    with pytest.raises(InputError, match=r"labels with the shape \(4, 4, 4\)"):
        imaging.mean_fibers(np.ones((4, 4, 4, 6)), affine, cube[:3])
    with pytest.raises(InputError, match="an affine of 4 x 4"):
        imaging.resample(cube, np.eye(3), 1.0)
    with pytest.raises(InputError, match=r"fibers of the shape \(4, 4, 4, 3\)"):
        imaging.resample(cube, affine, 1.0, np.ones((3, 4, 4, 3)))
    with pytest.raises(InputError, match="image.regionz"):
        imaging.segment(cube, affine, cube, regionz=3)


@pytest.mark.parametrize("thickness", [0.0, -1.0, np.nan, np.inf])
def test_a_thickness_is_above_zero(thickness):
    with pytest.raises(InputError, match="a thickness above zero"):
        imaging.resample(np.ones((4, 4, 4)), np.eye(4), thickness)


def test_values_that_are_none_are_told():
    cube, affine = np.ones((4, 4, 4)), np.eye(4)
    with pytest.raises(InputError, match="labels are whole numbers"):
        imaging.resample(0.5 * cube, affine, 1.0)
    with pytest.raises(InputError, match="values that are not finite"):
        imaging.correct_bias(np.nan * cube, affine)
    with pytest.raises(InputError, match="of the values in the body are negative"):
        imaging.correct_bias(-cube, affine, cube)
    with pytest.raises(InputError, match="b values and directions are finite"):
        imaging.fit_tensors(np.ones((4, 4, 4, 2)), affine, [0.0, np.nan], np.eye(3)[:2])
