"""Fibers: signs, frames, bad tensors, noise, and flows where none were measured."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from myork.core.deck import table_defaults
from myork.errors import ConvergenceError, InputError
from myork.imaging.diffusion import fit_tensors, lead_vector, tensor_components
from myork.imaging.io import write_labels
from myork.imaging.phantom import make_phantom
from myork.model.averaging import best_average, tensor_logarithms, tensor_trust
from myork.model.cloud import build_cloud
from myork.model.fibers import fiber_field, fibers_at_points
from myork.model.flow import flow_fibers
from myork.model.slices import extruded
from myork.records import Image, Labels
from myork.stations.build import build
from tests.images import angle, built, phantom_dwi, save
from tests.scenes import held, scene


def stick(direction):
    """Tensor with a given lead eigenvector."""
    d = np.asarray(direction, float) / np.linalg.norm(direction)
    return tensor_components(1e-3 * (0.5 * np.eye(3) + np.outer(d, d)))


def test_lead_vector_of_known_tensors_points_upwards():
    for direction in ([1, 2, 3], [0, -1, 0], [-1, 0, 0], [1, 0, -1]):
        vector = lead_vector(stick(direction)[np.newaxis])[0]
        assert angle(vector, np.array(direction) / np.linalg.norm(direction)) < 1e-5
        last = vector[np.flatnonzero(np.abs(vector) > 1e-9)[-1]]
        assert last > 0


def test_bad_tensors_are_filled_and_counted_or_refused():
    data = np.tile(stick([0, 1, 3]), (6, 6, 3, 1))
    data[2, 2, 1] = np.nan
    data[3, 3, 1] = 0.0
    data[4, 4, 1] = -data[4, 4, 1]
    inside = np.ones((6, 6, 3), bool)
    fibers, *counts, _ = fiber_field(Image(data, np.eye(4), "dti.nii"), inside, 1.0)
    assert counts == [3, 0, 0.0, 1.0]
    exact = np.array([0, 1, 3]) / np.sqrt(10)
    assert angle(fibers.data[inside], exact).max() < 1e-5
    # Without smoothing nothing is near: the nearest voxel helps out, here a neighbour.
    fibers, *counts, _ = fiber_field(Image(data, np.diag([2.0, 2.0, 2.0, 1.0])), inside, 0.0)
    assert counts == [3, 3, 2.0, 0.0]
    assert angle(fibers.data[inside], exact).max() < 1e-5
    data[:, :, :] = 0.0
    with pytest.raises(InputError, match=r"dti.nii: 108 of 108 voxels .* voxel \(0, 0, 0\)"):
        fiber_field(Image(data, np.eye(4), "dti.nii"), inside, 1.0)


def test_missing_fibers_come_from_their_own_muscle():
    labels = np.ones((12, 4, 3), np.int32)
    labels[6:] = 2
    data = np.where((labels == 1)[..., None], stick([0, 0, 1]), stick([1, 0, 0]))
    data[3:6] = np.nan
    image = Image(data, np.eye(4), "dti.nii")
    found = fiber_field(image, labels, 0.0)
    assert (found.far, found.distance) == (36, 3.0)
    assert angle(found.fibers.data[labels == 1], np.array([0, 0, 1])).max() < 1e-5
    # A muscle without any tensor has those of its neighbour, and that is counted.
    data[:6] = np.nan
    found = fiber_field(image, labels, 0.0)
    assert (found.far, found.distance) == (72, 6.0)
    assert angle(found.fibers.data[labels == 1], np.array([1, 0, 0])).max() < 1e-5
    with pytest.raises(InputError, match="dti.nii: no voxel to find fibers in"):
        fiber_field(image, 0 * labels, None)


def test_fibers_of_muscles_that_touch_keep_their_direction_up_to_the_border():
    labels = np.ones((12, 8, 3), np.int32)
    labels[6:] = 2
    directions = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 1.0], [-0.5, 0.0, 1.0]])
    data = np.zeros((*labels.shape, 6))
    for number in (1, 2):
        data[labels == number] = stick(directions[number])
    image = Image(data, np.diag([1.0, 1.0, 4.0, 1.0]))
    wanted = (directions / np.maximum(np.linalg.norm(directions, axis=1), 1)[:, None])[labels]
    fibers = fiber_field(image, labels, 3.0).fibers.data
    assert angle(fibers, wanted).max() < 1e-4
    # As one tissue they would turn by half of the angle between them, 27 degrees, at the border.
    mixed = fiber_field(image, labels > 0, 3.0).fibers.data
    assert angle(mixed, wanted)[5:7].min() > 15.0


def test_signs_of_vectors_do_not_matter():
    random = np.random.default_rng(2)
    direction = np.array([0.3, 0.2, 0.9]) / np.linalg.norm([0.3, 0.2, 0.9])
    data = direction * random.choice([-1.0, 1.0], (6, 6, 4, 1))
    labels = Labels(np.ones((6, 6, 4), np.int32), np.eye(4))
    place = random.random((20, 3)) * [5, 5, 3]
    own = np.ones(20, np.int32)
    found = fibers_at_points(Image(data, np.eye(4)), labels, place, own, (2, 2, 1))
    assert angle(found, direction).max() < 1e-5


def test_labels_do_not_mix_and_one_may_have_no_fibers():
    data = np.zeros((8, 4, 2, 3))
    data[:4] = [0.0, 0.0, 1.0]
    data[4:6] = [1.0, 0.0, 0.0]
    label = np.repeat(np.array([1, 1, 1, 1, 2, 2, 3, 3], np.int32), 8).reshape(8, 4, 2)
    labels = Labels(label, np.eye(4), {3: "fat"})
    place = np.argwhere(label).astype(float)
    found = fibers_at_points(Image(data, np.eye(4)), labels, place, label.ravel(), (3, 3, 1))
    found = found.reshape(8, 4, 2, 3)
    assert angle(found[3], np.array([0, 0, 1.0])).max() < 1e-5
    assert angle(found[4], np.array([1.0, 0, 0])).max() < 1e-5
    assert not found[6:].any()


def test_hole_in_the_fibers_is_named():
    data = np.zeros((20, 3, 3, 3))
    data[:2] = [0, 0, 1.0]
    labels = Labels(np.ones((20, 3, 3), np.int32), np.eye(4), {1: "soleus"})
    place = np.argwhere(labels.data).astype(float)
    fibers, ones = Image(data, np.eye(4), "fibers"), np.ones(180, np.int32)
    with pytest.raises(InputError, match="fibers, soleus: .* have no usable fiber vector"):
        fibers_at_points(fibers, labels, place, ones, (1, 1, 1))


def bent(snr, radius=60.0, **keys):
    """Calf whose fibers lie on arcs, its fitted tensors, and angles of fibers to the true ones."""
    calf = make_phantom((96, 96, 7), (1.25, 1.25, 6.0), septum=0.0, growth=15.0, **keys)
    x, y, _ = np.indices(calf.truth.data.shape) * calf.truth.spacing[:, None, None, None]
    a, b = (x - x.mean()) / radius, (y - y.mean()) / radius
    way = np.stack([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)], axis=-1)
    muscle = calf.tissue.data == 1
    across = np.stack([np.cos(a), np.zeros_like(a), -np.sin(a)], axis=-1)
    full = 0.8e-3 * way[..., :, None] * way[..., None, :]
    full += 0.2e-3 * across[..., :, None] * across[..., None, :] + 1.3e-3 * np.eye(3)
    clean = np.where(muscle[..., None], tensor_components(full), calf.clean_tensor.data)
    images, table = phantom_dwi(replace(calf, clean_tensor=replace(calf.tensor, data=clean)), snr)
    tensor = fit_tensors(images, table)
    inside = calf.truth.data

    def wrong(smoothing, label=inside):
        found = fiber_field(tensor, label, smoothing)
        return angle(found.fibers.data, way)[inside > 0], found.smoothing

    return wrong, inside


@pytest.mark.slow
@pytest.mark.parametrize(("snr", "mean"), [(25.0, 2.5), (50.0, 2.0)])
def test_width_by_itself_is_right_up_to_the_edge(snr, mean):
    """Fat and connective tissue among the fibers, and voxels of fat in a mask that is too large."""
    wrong, inside = bent(snr, imat=0.03, imct=0.1)
    found, width = wrong(None)
    assert found.mean() <= mean and np.percentile(found, 95) <= 6.0
    assert found.mean() <= 1.25 * min(wrong(other)[0].mean() for other in (1.0, 2.0, 3.0, 4.0))
    large = np.where(inside > 0, inside, ndimage.grey_dilation(inside, (3, 3, 1)))
    found, _ = wrong(None, large)
    assert found.mean() <= mean and np.percentile(found, 95) <= 6.0
    assert 1.25 < width < 5.0


@pytest.mark.slow
def test_noise_asks_for_a_wider_average_than_bends():
    noisy, calm = bent(15.0)[0](None)[1], bent(60.0, radius=30.0)[0](None)[1]
    assert noisy > calm


@pytest.mark.parametrize("alike", [0.6, 0.9])
def test_noise_of_neighbours_that_is_alike_does_not_choose_the_width(alike):
    """Scanners interpolate: then each tensor is foretold best by the noise of its neighbours."""
    direction = np.array([0.3, 0.0, 1.0]) / np.hypot(0.3, 1.0)
    clean = stick(direction) + 1e-3 * np.array([1, 1, 1, 0, 0, 0])
    noise = np.random.default_rng(4).normal(0.0, 2e-4, (40, 40, 8, 6))
    noise = ndimage.gaussian_filter(noise, (alike, alike, 0.0, 0.0))
    image = Image(clean + noise, np.diag([1.5, 1.5, 5.0, 1.0]))
    label = np.ones((40, 40, 8), np.int32)
    found = fiber_field(image, label, None)
    assert found.smoothing > 4.0
    usual = angle(fiber_field(image, label, 2.4).fibers.data, direction).mean()
    assert angle(found.fibers.data, direction).mean() < 0.6 * usual


@pytest.mark.parametrize("alike", [0.0, 0.7])
def test_bends_are_no_noise_of_neighbours(alike):
    """Bent fibers are alike as well, but over any distance."""
    x = (np.indices((40, 40, 8))[0] - 20.0) * 1.5
    way = np.stack([np.sin(x / 40.0), 0 * x, np.cos(x / 40.0)], axis=-1)
    full = 1e-3 * (way[..., :, None] * way[..., None, :] + 1.5 * np.eye(3))
    noise = np.random.default_rng(5).normal(0.0, 6e-5 if alike else 3e-5, (40, 40, 8, 6))
    noise = ndimage.gaussian_filter(noise, (alike, alike, 0.0, 0.0))
    image = Image(tensor_components(full) + noise, np.diag([1.5, 1.5, 5.0, 1.0]))
    label = np.ones((40, 40, 8), np.int32)

    def wrong(width):
        return angle(fiber_field(image, label, width).fibers.data, way).mean()

    assert wrong(None) < 1.3 * min(wrong(width) for width in (0.9, 1.5, 2.4, 3.6, 4.8))


def herringbone(snr, seed, lean=0.4, alike=0.0):
    """Two families of fibers that lean against each other, one label; tensors with noise."""
    x, y, _ = np.indices((30, 24, 12)) * np.array([1.5, 1.5, 5.0]).reshape(3, 1, 1, 1)
    side = np.where(x < 21.0, lean, -lean)
    way = np.stack([side, 0 * side, np.ones_like(side)], -1)
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    full = 1.4e-3 * np.eye(3) + 0.8e-3 * way[..., :, None] * way[..., None, :]
    noise = np.random.default_rng(seed).normal(0, 1.0, (*x.shape, 6))
    noise = ndimage.gaussian_filter(noise, (alike, alike, 0, 0))
    data = tensor_components(full) + noise * 1.7e-3 / snr / noise.std()
    inside = (np.hypot((x - 22) / 21, (y - 18) / 17) < 1).astype(np.int32)
    return Image(data, np.diag([1.5, 1.5, 5.0, 1.0])), inside, way


@pytest.mark.parametrize(
    ("snr", "seed", "lean"), [(15.0, 11, 0.4), (25.0, 12, 0.4), (40.0, 13, 0.2)]
)
def test_families_of_fibers_in_one_label_are_not_blurred_into_each_other(snr, seed, lean):
    image, inside, way = herringbone(snr, seed, lean)

    def wrong(width, label=inside):
        return angle(fiber_field(image, label, width).fibers.data, way)[inside > 0]

    parted = wrong(None, np.where(way[..., 0] > 0, 1, 2) * inside)
    assert wrong(None).mean() < 0.35 * wrong(3.0).mean()
    assert wrong(None).mean() < parted.mean() + 0.3
    assert np.quantile(wrong(None), 0.95) < 3.0


def test_one_muscle_stays_one_family():
    """Fibers that bend or lean one way alone: parting them makes predictions worse."""
    image, inside, _ = herringbone(20.0, 3, 0.0)
    logarithm, usable = tensor_logarithms(image, inside > 0)
    trust = tensor_trust(logarithm, usable, inside)
    assert best_average(logarithm, trust, inside, image.spacing).label.max() == 1


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


@pytest.mark.parametrize(
    ("ends", "axis"), [({"x0", "x1"}, 0), ({"bottom", "top"}, 2), ({None}, 0), ({"bottom"}, 2)]
)
def test_the_flow_runs_between_held_ends_or_along_the_muscle(ends, axis):
    bar = Labels(np.ones((24, 8, 10), np.int32), np.diag([2.0, 1.0, 1.0, 1.0]))
    table = table_defaults("build") | {"flow": True, "source_stride": [2, 2, 2]}
    cloud, _ = build_cloud(bar, None, table, "mm", held=ends)
    # of a prism: exact but for the residual of the potential
    assert angle(cloud.fiber, np.eye(3)[axis]).max() < 0.1


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
