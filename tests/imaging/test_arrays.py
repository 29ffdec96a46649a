"""From images to the points of a model without decks and folders."""

import numpy as np
import pytest

from myork.core.deck import table_defaults
from myork.imaging.diffusion import fit_tensors
from myork.imaging.phantom import make_phantom
from myork.model.cloud import build_cloud
from myork.model.fibers import fiber_field
from myork.model.slices import finer_fibers, finer_labels, slice_parts
from myork.records import Labels
from myork.segmentation.images import Images, segment_images
from tests.images import angle, phantom_dwi


@pytest.mark.slow
def test_from_images_to_points():
    calf = make_phantom((96, 96, 5), (1.25, 1.25, 8.0))
    found = segment_images(Images(calf.anatomy), table_defaults("image"), bias="auto")
    np.testing.assert_allclose(found.images.anatomy.data * found.field, calf.anatomy.data)
    assert not found.warnings
    truth = calf.truth.data > 0
    assert truth[found.regions.region == 0].mean() > 0.8
    tensor = fit_tensors(*phantom_dwi(calf))
    fibers = fiber_field(tensor, calf.truth.data, None).fibers
    assert angle(fibers.data, calf.fiber.data)[truth].mean() < 2.5
    thick = Labels((calf.truth.data == 1).astype(np.int32), calf.truth.affine, {1: "gm"})
    axis, parts = slice_parts(thick.spacing, 4.0)
    labels = finer_labels(thick, axis, parts)
    assert labels.data.shape == (96, 96, 10) and labels.spacing[2] == pytest.approx(4.0)
    way = finer_fibers(fibers, thick, labels, axis, parts)
    strides = {"collocation_stride": [2, 2, 1], "source_stride": [4, 4, 2]}
    cloud, _ = build_cloud(labels, way, {**table_defaults("build"), **strides}, "cm")
    assert cloud.label_names == {1: "gm"}
    volume = thick.data.sum() * 1.25 * 1.25 * 8.0 / 1000.0
    assert cloud.volume.sum() == pytest.approx(volume, rel=0.05)
    assert cloud.fiber.any(axis=1).all()
