"""Fibers: signs, frames, bad tensors, noise, flow fibers without measurement, muscle numbers."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from myork.core.deck import table_defaults
from myork.errors import ConvergenceError
from myork.imaging.diffusion import fit_tensors, lead_vector, tensor_components, tensor_maps
from myork.imaging.io import write_labels
from myork.imaging.phantom import make_phantom
from myork.model.architecture import Maps, cut_sides, muscle_numbers
from myork.model.averaging import best_average, tensor_logarithms, tensor_trust
from myork.model.cloud import build_cloud
from myork.model.fibers import fiber_field, fibers_at_points
from myork.model.flow import flow_fibers
from myork.model.points import extruded
from myork.records import Image, Labels
from myork.report import make_report
from myork.stations.build import build
from myork.stations.solve import pcsa_force
from tests.images import affine_of, angle, built, centred, phantom_dwi, save
from tests.scenes import MUSCLE, held, neo, probes, refuses, scene

#: Size of thick voxels [mm]
SLICES = (1.5, 1.5, 5.0)


def stick(direction):
    """Tensor with a given lead eigenvector."""
    d = np.asarray(direction, float) / np.linalg.norm(direction)
    return tensor_components(1e-3 * (0.5 * np.eye(3) + np.outer(d, d)))


def halves(*shape):
    """Two labels, side by side along x."""
    labels = np.ones(shape, np.int32)
    labels[shape[0] // 2 :] = 2
    return labels


def rough(size, seed, alike):
    """Noise of 40 x 40 x 8 tensors, smoothed within slices like images interpolated by scanners."""
    noise = np.random.default_rng(seed).normal(0.0, size, (40, 40, 8, 6))
    return ndimage.gaussian_filter(noise, (alike, alike, 0.0, 0.0))


def test_lead_vector_of_known_tensors_points_upwards():
    for direction in ([1, 2, 3], [0, -1, 0], [-1, 0, 0], [1, 0, -1]):
        vector = lead_vector(stick(direction)[np.newaxis])[0]
        assert angle(vector, np.array(direction) / np.linalg.norm(direction)) < 1e-5
        assert vector[np.flatnonzero(np.abs(vector) > 1e-9)[-1]] > 0


def test_bad_tensors_are_filled_and_counted_or_refused():
    data = np.tile(stick([0, 1, 3]), (6, 6, 3, 1))
    data[2, 2, 1], data[3, 3, 1], data[4, 4, 1] = np.nan, 0.0, -data[4, 4, 1]
    inside = np.ones((6, 6, 3), bool)
    # Without smoothing the average has no reach: the nearest voxel is used, here a neighbour.
    for size, width, wanted in ((1.0, 1.0, [3, 0, 0.0, 1.0]), (2.0, 0.0, [3, 3, 2.0, 0.0])):
        fibers, *counts, _ = fiber_field(Image(data, affine_of(size)), inside, width)
        assert counts == wanted
        assert angle(fibers.data[inside], np.array([0, 1, 3]) / np.sqrt(10)).max() < 1e-5
    said = r"dti.nii: 108 of 108 voxels .* voxel \(0, 0, 0\)"
    refuses(said, fiber_field, Image(np.zeros_like(data), np.eye(4), "dti.nii"), inside, 1.0)


def test_missing_fibers_come_from_their_own_muscle():
    labels = halves(12, 4, 3)
    data = np.where((labels == 1)[..., None], stick([0, 0, 1]), stick([1, 0, 0]))
    image = Image(data, np.eye(4), "dti.nii")
    # A muscle without any tensor takes those of its neighbour, and this is counted.
    for gone, wanted, way in (
        (slice(3, 6), (36, 3.0), [0, 0, 1]),
        (slice(6), (72, 6.0), [1, 0, 0]),
    ):
        data[gone] = np.nan
        found = fiber_field(image, labels, 0.0)
        assert (found.far, found.distance) == wanted
        assert angle(found.fibers.data[labels == 1], way).max() < 1e-5
    refuses("dti.nii: no voxel to find fibers in", fiber_field, image, 0 * labels, None)


def test_fibers_of_muscles_that_touch_keep_their_direction_up_to_the_border():
    labels = halves(12, 8, 3)
    directions = np.array([[0.5, 0.0, 1.0], [-0.5, 0.0, 1.0]])[labels - 1]
    data = np.where((labels == 1)[..., None], *map(stick, ([0.5, 0.0, 1.0], [-0.5, 0.0, 1.0])))
    image = Image(data, affine_of((1.0, 1.0, 4.0)))
    wanted = directions / np.linalg.norm([0.5, 1.0])
    assert angle(fiber_field(image, labels, 3.0).fibers.data, wanted).max() < 1e-4
    # As one tissue, they would turn at the border by half the angle between them, 27 degrees.
    mixed = fiber_field(image, labels > 0, 3.0).fibers.data
    assert angle(mixed, wanted)[5:7].min() > 15.0


def test_signs_of_vectors_do_not_matter():
    random = np.random.default_rng(2)
    direction = np.array([0.3, 0.2, 0.9]) / np.linalg.norm([0.3, 0.2, 0.9])
    data = Image(direction * random.choice([-1.0, 1.0], (6, 6, 4, 1)), np.eye(4))
    labels = Labels(np.ones((6, 6, 4), np.int32), np.eye(4))
    place = random.random((20, 3)) * [5, 5, 3]
    found = fibers_at_points(data, labels, place, np.ones(20, np.int32), (2, 2, 1))
    assert angle(found, direction).max() < 1e-5
    # a hole in the fibers is reported
    data = np.zeros((20, 3, 3, 3))
    data[:2] = [0, 0, 1.0]
    labels = Labels(np.ones((20, 3, 3), np.int32), np.eye(4), {1: "soleus"})
    points = np.argwhere(labels.data).astype(float), np.ones(180, np.int32), (1, 1, 1)
    said = "fibers, soleus: .* have no usable fiber vector"
    refuses(said, fibers_at_points, Image(data, np.eye(4), "fibers"), labels, *points)
    for empty in (0.0, np.nan):
        none = Image(np.full(data.shape, empty), np.eye(4), "fibers")
        refuses("fibers: contains no fiber: all", fibers_at_points, none, labels, *points)


def test_labels_do_not_mix_and_one_may_have_no_fibers():
    data = np.zeros((8, 4, 2, 3))
    data[:4], data[4:6] = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]
    label = np.repeat(np.array([1, 1, 1, 1, 2, 2, 3, 3], np.int32), 8).reshape(8, 4, 2)
    labels, place = Labels(label, np.eye(4), {3: "fat"}), np.argwhere(label).astype(float)
    found = fibers_at_points(Image(data, np.eye(4)), labels, place, label.ravel(), (3, 3, 1))
    found = found.reshape(data.shape)
    assert angle(found[3:5], data[3:5]).max() < 1e-5 and not found[6:].any()


def bent(snr, radius=60.0, **keys):
    """Calf whose fibers lie on arcs: angles between fitted and true fibers,
    by the width of the average, and its labels.
    """
    calf = make_phantom((96, 96, 7), (1.25, 1.25, 6.0), septum=0.0, growth=15.0, **keys)
    inside = calf.truth.data
    a, b, _ = centred(*inside.shape) * 1.25 / radius
    way = np.stack([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)], axis=-1)
    across = np.stack([np.cos(a), np.zeros_like(a), -np.sin(a)], axis=-1)
    full = 0.8e-3 * way[..., :, None] * way[..., None, :]
    full += 0.2e-3 * across[..., :, None] * across[..., None, :] + 1.3e-3 * np.eye(3)
    muscle = (calf.tissue.data == 1)[..., None]
    clean = np.where(muscle, tensor_components(full), calf.clean_tensor.data)
    images, table = phantom_dwi(replace(calf, clean_tensor=replace(calf.tensor, data=clean)), snr)
    tensor = fit_tensors(images, table)

    def wrong(smoothing, label=inside):
        found = fiber_field(tensor, label, smoothing)
        return angle(found.fibers.data, way)[inside > 0], found.smoothing

    return wrong, inside


@pytest.mark.slow
@pytest.mark.parametrize(("snr", "mean"), [(25.0, 2.5), (50.0, 2.0)])
def test_width_by_itself_is_right_up_to_the_edge(snr, mean):
    """Fat and connective tissue among the fibers, and fat voxels in a mask that is too large."""
    wrong, inside = bent(snr, imat=0.03, imct=0.1)
    best = min(wrong(other)[0].mean() for other in (1.0, 2.0, 3.0, 4.0))
    assert wrong(None)[0].mean() <= 1.25 * best and 1.25 < wrong(None)[1] < 5.0
    large = np.where(inside > 0, inside, ndimage.grey_dilation(inside, (3, 3, 1)))
    for label in (inside, large):
        found = wrong(None, label)[0]
        assert found.mean() <= mean and np.percentile(found, 95) <= 6.0


@pytest.mark.slow
def test_noise_asks_for_a_wider_average_than_bends():
    noisy, calm = bent(15.0)[0](None)[1], bent(60.0, radius=30.0)[0](None)[1]
    assert noisy > calm


@pytest.mark.parametrize("alike", [0.6, 0.9])
def test_noise_of_neighbours_that_is_alike_does_not_choose_the_width(alike):
    """Scanners interpolate: then each tensor is best predicted by the noise of its neighbours."""
    direction = np.array([0.3, 0.0, 1.0]) / np.hypot(0.3, 1.0)
    clean = stick(direction) + 1e-3 * np.array([1, 1, 1, 0, 0, 0])
    image = Image(clean + rough(2e-4, 4, alike), affine_of(SLICES))
    label = np.ones((40, 40, 8), np.int32)
    found, usual = (fiber_field(image, label, width) for width in (None, 2.4))
    own, other = (angle(one.fibers.data, direction).mean() for one in (found, usual))
    assert found.smoothing > 4.0 and own < 0.6 * other


@pytest.mark.parametrize("alike", [0.0, 0.7])
def test_bends_are_no_noise_of_neighbours(alike):
    """Bent fibers are correlated too, but over any distance."""
    x = (np.indices((40, 40, 8))[0] - 20.0) * 1.5
    way = np.stack([np.sin(x / 40.0), 0 * x, np.cos(x / 40.0)], axis=-1)
    full = 1e-3 * (way[..., :, None] * way[..., None, :] + 1.5 * np.eye(3))
    noise = rough(6e-5 if alike else 3e-5, 5, alike)
    image = Image(tensor_components(full) + noise, affine_of(SLICES))

    def wrong(width):
        found = fiber_field(image, np.ones(x.shape, np.int32), width)
        return angle(found.fibers.data, way).mean()

    assert wrong(None) < 1.3 * min(wrong(width) for width in (0.9, 1.5, 2.4, 3.6, 4.8))


def herringbone(snr, seed, lean=0.4):
    """Two families of fibers inclined against each other, one label; tensors with noise."""
    x, y, _ = np.indices((30, 24, 12)) * np.reshape(SLICES, (3, 1, 1, 1))
    side = np.where(x < 21.0, lean, -lean)
    way = np.stack([side, 0 * side, np.ones_like(side)], -1) / np.hypot(lean, 1.0)
    full = 1.4e-3 * np.eye(3) + 0.8e-3 * way[..., :, None] * way[..., None, :]
    noise = np.random.default_rng(seed).normal(0, 1.0, (*x.shape, 6))
    data = tensor_components(full) + noise * 1.7e-3 / snr / noise.std()
    inside = (np.hypot((x - 22) / 21, (y - 18) / 17) < 1).astype(np.int32)
    return Image(data, affine_of(SLICES)), inside, way


@pytest.mark.parametrize(("snr", "seed", "lean"), [(15, 11, 0.4), (25, 12, 0.4), (40, 13, 0.2)])
def test_families_of_fibers_in_one_label_are_not_blurred_into_each_other(snr, seed, lean):
    image, inside, way = herringbone(snr, seed, lean)

    def wrong(width, label=inside):
        return angle(fiber_field(image, label, width).fibers.data, way)[inside > 0]

    found, parted = wrong(None), wrong(None, np.where(way[..., 0] > 0, 1, 2) * inside)
    assert found.mean() < min(0.35 * wrong(3.0).mean(), parted.mean() + 0.3)
    assert np.quantile(found, 0.95) < 3.0


def test_one_muscle_stays_one_family():
    """Fibers that bend or lean one way only: splitting them makes predictions worse."""
    image, inside, _ = herringbone(20.0, 3, 0.0)
    logarithm, usable = tensor_logarithms(image, inside > 0)
    trust = tensor_trust(logarithm, usable, inside)
    assert best_average(logarithm, trust, inside, image.spacing).label.max() == 1


def cone(top=72):
    """A truncated cone with its tip at the origin and a slope of 0.35; directions from the tip."""
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
    # the flow enters and leaves through the flat ends; in between it comes from the tip
    straight = angle(np.array([0, 0, 1.0]), way)[middle].mean()
    assert angle(found, way)[middle].mean() < 0.25 * straight


def test_each_label_has_its_own_flow_in_any_orientation():
    data = np.zeros((40, 8, 30), np.int32)
    for k in range(30):
        data[k : k + 10, :, k] = 1
    data[:6, :, 20:24] = 2  # separate from it, and only four slices long
    labels = Labels(data, affine_of((1.0, 1.0, 2.0)))
    found = flow_fibers(labels).data
    leaning = np.array([0.5, 0, 1.0]) / np.hypot(0.5, 1.0)
    assert angle(found, leaning)[..., 8:22][data[..., 8:22] == 1].mean() < 4.0
    assert angle(found, np.array([0, 0, 1.0]))[data == 2].max() < 1e-3
    turn = np.array([[0, 0, 1.0, 3], [-1.0, 0, 0, 0], [0, 1.0, 0, -2], [0, 0, 0, 1]])
    again = flow_fibers(Labels(data, turn @ labels.affine))
    assert again.data.shape == (30, 40, 8, 3)  # its third axis is superior now
    assert np.linalg.norm(again.data, axis=-1).max() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("ends", "axis"), [({"x0", "x1"}, 0), ({"bottom", "top"}, 2), ({None}, 0), ({"bottom"}, 2)]
)
def test_the_flow_runs_between_held_ends_or_along_the_muscle(ends, axis):
    bar = Labels(np.ones((24, 8, 10), np.int32), affine_of((2, 1, 1)))
    table = table_defaults("build") | {"flow": True, "source_stride": [2, 2, 2]}
    cloud, _ = build_cloud(bar, None, table, "mm", held=ends)
    # for a prism: exact up to the residual of the potential
    assert angle(cloud.fiber, np.eye(3)[axis]).max() < 0.1


def test_a_flow_that_does_not_converge_is_reported(monkeypatch):
    monkeypatch.setattr("myork.model.flow._TOLERANCE", 0.0)
    inside = np.zeros((6, 6, 6), np.int32)
    inside[1:5, 1:5] = 1
    inside[2, 2, 1:4] = 0
    said = r"build.flow: .* component of \d+ voxels did not converge"
    with np.errstate(invalid="ignore"), pytest.raises(ConvergenceError, match=said):
        flow_fibers(Labels(inside, np.eye(4)))


def test_flows_that_decks_cannot_have(tmp_path):
    inside, way = cone(44)
    save(tmp_path, np.eye(4), l=inside, f=way, one=np.ones((6, 5, 1), np.int32))
    said = r"build\.flow .* there is build\.fibers"
    refuses(said, built, tmp_path, labels="l.nii.gz", fibers="f.nii.gz", flow=True)
    said = r"there is one slice only; set build\.extrude"
    refuses(said, built, tmp_path, dimension=2, labels="one.nii.gz", flow=True)


def test_prism_of_a_slice_lies_about_it():
    data = np.zeros((9, 7, 1), np.int32)
    data[2:7, 2:5] = 3
    # left, posterior, a placeholder for the thickness
    affine = affine_of((-2.0, -2.0, 1.0), (0, 0, 50.0))
    prism = extruded(Labels(data, affine, {3: "soleus"}), 40.0)
    assert prism.data.shape == (9, 7, 20) and prism.names == {3: "soleus"}
    np.testing.assert_allclose(prism.spacing, 2.0)
    height = prism.world(np.argwhere(prism.data))[:, 2]
    np.testing.assert_allclose([height.min(), height.mean(), height.max()], [31.0, 50.0, 69.0])
    refuses(r"build\.extrude .* this image has 20 of them", extruded, prism, 40.0)


def test_numbers_of_a_muscle_of_a_prism_are_those_of_its_section(tmp_path):
    """A rectangle of 20 x 10 mm, wider than the prism is long, whatever the slice's thickness."""
    data = np.zeros((24, 14, 1), np.int32)
    data[2:22, 2:12] = 1
    affine = affine_of((-1.0, -1.0, 3.0))
    fibers = np.tile([0.0, np.sin(LEAN), np.cos(LEAN)], (*data.shape, 1))
    save(tmp_path, affine, l=Labels(data, affine, {1: "soleus"}), f=fibers)
    (tmp_path / "out").mkdir()
    save(tmp_path / "out", affine, fa=0.3 + 0.0 * data)
    found = built(tmp_path, labels="l.nii.gz", fibers="f.nii.gz", extrude=12.0)
    (own,) = found["muscles"]
    assert (own["area [mm^2]"], own["volume [mm^3]"]) == pytest.approx((200.0, 2400.0))
    assert own["pennation [deg]"] == pytest.approx(np.degrees(LEAN), abs=0.1)
    assert own["FA [-]"] == pytest.approx(0.3)
    assert found["volume"]["soleus"] == pytest.approx(2400.0)


def test_a_label_without_a_name_has_that_of_its_material(tmp_path):
    write_labels(tmp_path / "l.nii.gz", Labels(halves(6, 6, 4), np.eye(4), {1: "soleus"}))
    deck = scene(
        "auto", {"kind": "model"}, build={"labels": tmp_path / "l.nii.gz"},
        material=[neo(1, 100, name, label=k) for k, name in ((1, "a"), (2, "fat"))],
        boundary=[held("bottom")],
    )  # fmt: skip
    found = build(deck, tmp_path / "out")["model"]
    assert list(found["volume"]) == ["soleus", "fat"]
    assert any("label 1 is soleus in the map, but a in" in text for text in found["warnings"])
    assert [row["muscle"] for row in found["muscles"]] == ["soleus", "fat"]


def test_a_label_without_a_material_is_named_and_fat_has_no_pcsa(tmp_path):
    data = halves(6, 6, 4)
    data[:, 3:] += 1  # 1, 2 and 3
    fibers = np.tile([0.0, 0.0, 1.0], (*data.shape, 1))
    save(tmp_path, np.eye(4), l=data, f=fibers)
    fat = neo(1, 100, "fat", label=2)
    deck = scene(
        "auto", {"kind": "model"}, boundary=[held("bottom")],
        build={"labels": tmp_path / "l.nii.gz", "fibers": tmp_path / "f.nii.gz"},
        material=[{**MUSCLE, "name": "a", "label": 1}, fat],
    )  # fmt: skip
    lines: list[str] = []
    warnings = build(deck, tmp_path / "out", progress=lines.append)["model"]["warnings"]
    assert any("label 3 (label 3) has no [[material]]" in text for text in warnings)
    assert any(line.startswith("a: the image cuts it") for line in lines)
    assert not any(line.startswith("fat: the image cuts it") for line in lines)


def test_a_cavity_of_the_labels_is_reported(tmp_path):
    data = np.ones((7, 7, 5), np.int32)
    for depth, said in ((1, True), (3, False)):
        data[2:5, 2:5, 2 : 2 + depth] = 0  # closed, then open at an end
        save(tmp_path, affine_of(2.0), l=data)
        warnings = built(tmp_path, labels="l.nii.gz")["warnings"]
        found = [text for text in warnings if "9 voxels without a label (72 mm^3)" in text]
        assert bool(found) == said


# ---- numbers of muscles --------------------------------------------------------------------------


# Thickness, offset of the ends along z and width of the body [mm], pennation; and the results:
# ratio of z to y along the fibers and their length [mm]
THICK, LONG, WIDE, LEAN = 16.0, 110.0, 30.0, np.radians(22.0)
SLOPE, LENGTH = 1.0 / np.tan(LEAN), THICK / np.sin(LEAN)
AXIAL = np.eye(3)
OBLIQUE = Rotation.from_euler("xyz", [25, -15, 40], degrees=True).as_matrix()


def unipennate(turn=AXIAL, spacing=(1.0, 1.0, 1.0), ends=0.0):
    """A plate of fibers from the plane y = -8 mm to the plane y = 8 mm, its ends cut along them."""
    low = np.array([0.0, 0.0, ends]) - 6.5 - 0.5 * np.array([WIDE, THICK, LONG + THICK * SLOPE])
    count = np.ceil(-2 * low / spacing).astype(int)
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = turn * spacing, turn @ low
    x, y, z = np.moveaxis(np.moveaxis(np.indices(count), 0, -1) * spacing + low, -1, 0)
    own = (abs(x) < 0.5 * WIDE) & (abs(y) < 0.5 * THICK) & (abs(z - y * SLOPE) < 0.5 * LONG)
    sign = np.random.default_rng(0).choice([-1.0, 1.0], (*count, 1))
    fibers = own[..., np.newaxis] * sign * (turn @ [0.0, np.sin(LEAN), np.cos(LEAN)])
    return Labels(own.astype(np.int32), affine, {1: "plate"}), Image(fibers, affine)


@pytest.mark.parametrize(("turn", "spacing"), [
    (AXIAL, (1.0, 1.0, 1.0)), (OBLIQUE, (1.0, 1.0, 1.0)), (OBLIQUE, (0.8, 0.8, 3.0)),
])  # fmt: skip
def test_a_plate_of_parallel_fibers(turn, spacing):
    labels, fibers = unipennate(turn, spacing)
    (found,) = muscle_numbers(labels, Maps(fibers))
    # the long axis is inclined like the ends: that of the covariance of y and z
    yy, yz, zz = np.array([0.0, 0.0, LONG**2 / 12]) + THICK**2 / 12 * np.array([1, SLOPE, SLOPE**2])
    volume, lean = THICK * LONG * WIDE, LEAN - 0.5 * np.arctan2(2 * yz, zz - yy)
    assert found.muscle == "plate" and not found.cut
    assert found.volume == pytest.approx(volume, rel=0.03)
    assert found.area == pytest.approx(THICK * WIDE, rel=0.03)
    assert found.fiber_length == pytest.approx(LENGTH, rel=0.04)
    assert found.pennation == pytest.approx(np.degrees(lean), abs=0.3)
    assert found.pcsa == pytest.approx(volume * np.cos(lean) / LENGTH, rel=0.05)
    assert (found.fat_fraction, found.fa, found.md) == (None, None, None)


def test_what_an_image_cuts_or_does_not_hold_is_left_out():
    labels, fibers = unipennate(ends=18.0)
    (found,) = muscle_numbers(labels, Maps(fibers))
    assert found.cut and found.pcsa is None
    assert found.fiber_length == pytest.approx(LENGTH, rel=0.04)
    labels, fibers = unipennate(ends=60.0)  # most fibers leave the image
    assert muscle_numbers(labels, Maps(fibers))[0].fiber_length is None
    (found,) = muscle_numbers(labels, Maps())
    assert found.volume > 0 and (found.fiber_length, found.pennation) == (None, None)
    nothing = Image(0.0 * fibers.data, fibers.affine)
    assert muscle_numbers(labels, Maps(nothing))[0].pennation is None
    assert muscle_numbers(labels, Maps(fibers), [1]) == []


def test_a_ball_has_no_long_axis_and_a_tight_box_cuts_no_muscle():
    ball = Labels(((centred(21, 21, 21) ** 2).sum(0) <= 100.5).astype(np.int32), np.eye(4))
    along = Image(np.tile([0.0, 0.0, 1.0], (21, 21, 21, 1)), np.eye(4))
    (found,) = muscle_numbers(ball, Maps(along))
    assert not found.cut and (found.pennation, found.pcsa) == (None, None)
    assert not cut_sides(ball, 1)
    assert found.volume == pytest.approx(4 / 3 * np.pi * 1000, rel=0.05)


@pytest.mark.parametrize(("flip", "turn"), [(1, 0), (-1, 0), (1, 1)])
def test_sides_of_an_image_that_cut_a_muscle(flip, turn):
    """A spindle whole, in its tightest box, and cut by two sides, for any order of voxels."""
    x, y, z = centred(51, 51, 41)
    own = ((x / 18) ** 2 + (y / 14) ** 2 < 1 - (z / 30) ** 2).astype(np.int32)
    step = np.diag([flip, 1.0, 3.0, 1.0])
    for box, sides in (
        ((slice(None), slice(None)), []),
        ((slice(8, 43), slice(12, 39)), []),
        ((slice(20, None), slice(None)), ["left" if flip > 0 else "right"]),
        ((slice(None), slice(17, 34)), ["anterior", "posterior"]),
    ):
        part = own[box] if not turn else own[box].transpose(2, 0, 1)
        affine = step if not turn else step[:, [2, 0, 1, 3]]
        assert cut_sides(Labels(part, affine), 1) == sides


def test_few_layers_of_a_muscle_at_a_side_of_the_image():
    """Half a cylinder is cut, a whole one that touches the side is not, nor is a plate."""
    for radius in (3.9, 4.9, 5.9, 7.9):
        x, y, _ = np.indices((12, 22, 12))
        half = Labels((np.hypot(x, y - 10) < radius).astype(np.int32), affine_of((2, 2, 3)))
        assert cut_sides(half, 1) == ["left"]
        turned = Labels(half.data[::-1].transpose(1, 0, 2), half.affine)
        assert cut_sides(turned, 1) == ["anterior"]
    for radius in np.arange(1.5, 5.0, 0.1):
        x, y, _ = np.indices((12, 22, 30))
        whole = np.hypot(x - np.floor(radius), y - 10) < radius
        assert not cut_sides(Labels(whole.astype(np.int32), np.eye(4)), 1)
    for layers in (2, 3, 4):
        plate = np.zeros((12, 22, 30), np.int32)
        plate[:layers, 4:16, 2:28] = 1
        assert not cut_sides(Labels(plate, np.eye(4)), 1)


@pytest.mark.slow
def test_build_writes_a_table_of_the_muscles(tmp_path):
    phantom = make_phantom((60, 60, 15), (2.0, 2.0, 6.0), snr=1e9, bias=0.0)
    out, affine = tmp_path / "out", phantom.truth.affine
    out.mkdir()
    save(tmp_path, affine, labels=phantom.truth, fibers=phantom.fiber)
    fraction = np.where(phantom.truth.data == 3, 0.25, 0.125)
    images = {"anatomy": 3.0 + 0 * fraction, "fat": 1.0 + 0 * fraction, "fat_fraction": fraction}
    save(out, affine, **tensor_maps(phantom.clean_tensor), **images)
    table = dict(
        labels="labels.nii.gz", fibers="fibers.nii.gz", collocation_stride=[3, 3, 1],
        source_stride=[6, 6, 2],
    )  # fmt: skip
    built(tmp_path, **table)
    rows = list(csv.DictReader((out / "muscles.csv").read_text().splitlines()))
    assert list(rows[0]) == [
        "muscle", "volume [mm^3]", "area [mm^2]", "fat_fraction [-]", "FA [-]", "MD [mm^2/s]",
        "fiber_length [mm]", "pennation [deg]", "PCSA [mm^2]",
    ]  # fmt: skip
    assert [row["muscle"] for row in rows] == list(phantom.truth.names.values())
    # the gastrocnemius: an ellipse with semi-axes of 23 and 11 mm at its belly, less by
    # 0.3 ((t - .55) / .55)^2
    t = np.arange(15) / 14
    sections = np.pi * 23 * 11 * (1 - 0.3 * ((t - 0.55) / 0.55) ** 2) ** 2
    values = np.array([2.1, 1.5, 1.3]) * 1e-3
    anisotropy = np.sqrt(1.5 * ((values - values.mean()) ** 2).sum() / (values**2).sum())
    cubic, area, pennation, md = (
        float(rows[0][key])
        for key in ("volume [mm^3]", "area [mm^2]", "pennation [deg]", "MD [mm^2/s]")
    )
    assert (area, cubic) == pytest.approx((sections.max(), 6 * sections.sum()), rel=0.02)
    assert pennation == pytest.approx(22.0, abs=1.0)
    for row, fat in zip(rows, (0.125, 0.125, 0.25, 0.125, 0.125, 0.125), strict=True):
        found = [float(row[key]) for key in ("FA [-]", "MD [mm^2/s]", "fat_fraction [-]")]
        assert found == pytest.approx([anisotropy, values.mean(), fat], rel=1e-3)
        assert row["PCSA [mm^2]"] == ""  # the stack cuts all of them
    paths = {key: tmp_path / table[key] for key in ("labels", "fibers")}
    lines: list[str] = []
    build({"scene": {"dimension": 3}, "build": {**table, **paths}}, out, progress=lines.append)
    for row in rows:  # the reason for empty cells is given
        what = "its PCSA is" if row["fiber_length [mm]"] else "fiber length and PCSA are"
        assert f"{row['muscle']}: the image cuts it, so that {what} left out" in lines
    first = json.loads((out / "summary.json").read_text())["model"]["muscles"][0]
    assert first["volume [cm^3]"] * 1000 == pytest.approx(cubic, rel=1e-4)
    assert first["MD [mm^2/s]"] == pytest.approx(md)
    page = make_report(out).read_text()
    assert "pennation [deg]" in page and "PCSA is volume times" in page


def solved(force, area=4.0, **changes):
    """Summary of a solve: a muscle of a PCSA at an activation of a half, sigma_max 30 N/cm^2."""
    return {
        "units": {"force": "N", "length": "cm"},
        "deck": {
            "geometry": {"kind": "model"},
            "material": [{"name": "m", "model": "muscle", "sigma_max": 30.0}],
            "probe": probes("pull force top", "stress cauchy_zz 0 0 0"),
        },
        "model": {"muscles": [{"muscle": "m", "PCSA [cm^2]": area}]},
        "steps": [{"activation": 0.5, "probes": {"pull": force, "stress": 1e4}}],
        **changes,
    }


@pytest.mark.parametrize(("force", "ratio"), [(48.0, 1.0), (9.0, 0.1875), (240.0, 5.0)])
def test_a_force_three_times_off_the_pcsa_is_named(force, ratio):
    entry, warning = pcsa_force(solved([0.6 * force * 1.25, 0.0, -0.8 * force * 1.25]))
    assert entry == {"value": 60.0, "probe": "pull", "ratio": pytest.approx(ratio)}
    assert bool(warning) == (ratio != 1.0)
    if warning:
        assert "probe pull is" in warning and "60 N" in warning


def test_no_estimate_without_what_it_needs():
    passive = [{"activation": 0.0, "probes": {"pull": 1.0}}]
    for lacking in ({"area": None}, {"steps": passive}, {"model": {}}):
        assert pcsa_force(solved(48.0, **lacking)) is None
    assert pcsa_force({}) is None
