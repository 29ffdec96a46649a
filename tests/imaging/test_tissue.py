"""Tissues: fuzzy clusters, tissues of a leg, bone as a boundary; shading; fractions in voxels."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from myork.chain import run_chain
from myork.core.deck import table_defaults, text_of_tables
from myork.imaging.io import read_image, read_labels
from myork.imaging.phantom import TISSUES, make_phantom, rician
from myork.model.boundary import boundary_sets
from myork.model.cloud import build_cloud
from myork.model.points import BONE, changed_volumes, coarsen, select, trimmed
from myork.model.shares import checked_parts, label_shares
from myork.records import Image, Labels
from myork.segmentation.fuzzy import bright_cluster
from myork.segmentation.images import Images, segment_images
from myork.segmentation.leg import _skin, find_bones, leg_tissues
from myork.segmentation.partial import label_parts
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice
from myork.segmentation.shading import joint_variation, shading, variation_doubt
from myork.stations.build import build
from myork.stations.segment import segment
from myork.summary import read_summary
from tests.images import affine_of, centred, save
from tests.scenes import neo, probes, refuses, scene

LEAST = 0.8e-3  # mean diffusivity of muscle


def two_greys(noise):
    data = np.where(np.arange(40)[:, None, None] < 25, 1.0, 3.0) * np.ones((40, 30, 2))
    truth = data > 2
    return data + np.random.default_rng(1).normal(0.0, noise, data.shape), truth


def test_centres_and_memberships_of_two_greys():
    data, truth = two_greys(0.2)
    found, centres = bright_cluster(data, np.ones(data.shape, bool))
    # The mean of some hundred values; fuzzy weights pull centres slightly towards each other.
    np.testing.assert_allclose(centres, [1.0, 3.0], atol=0.05)
    assert np.array_equal(found > 0.5, truth)
    # a region of any shape
    region = np.indices(data.shape)[1] % 3 > 0
    assert np.array_equal(bright_cluster(two_greys(0.0)[0], region)[0] > 0.5, truth & region)


def test_the_lesser_cluster_of_two_is_found():
    """A hundredth of the voxels, as connective tissue may be, beside two similar greys."""
    data = two_greys(0.2)[0]
    data[data > 2] -= 1.5
    lesser = np.random.default_rng(2).random(data.shape) < 0.01
    data[lesser] = 30.0
    found, centres = bright_cluster(data, np.ones(data.shape, bool))
    assert np.array_equal(found > 0.5, lesser) and centres[1] == pytest.approx(30.0, rel=0.01)


def test_bad_regions_are_named():
    data, _ = two_greys(0.1)
    everywhere = np.ones(data.shape, bool)
    refuses("the region is empty", bright_cluster, data, ~everywhere)
    refuses("one grey value only", bright_cluster, 0.0 * data, everywhere)
    data[0, 0, 0] = np.nan
    refuses("not finite", bright_cluster, data, everywhere)


@pytest.fixture(scope="module")
def leg():
    keys = {"septum": 0.6, "growth": 15.0, "imat": 0.05, "imct": 0.2}
    return make_phantom((90, 90, 3), (1.25, 1.25, 20.0), **keys)


def materials(leg, least=LEAST):
    return leg_tissues(leg.anatomy, fat=leg.fat, connective=leg.connective, tensor=leg.tensor,
                       least_diffusivity=least).labels  # fmt: skip


def test_materials_of_a_leg(leg):
    found = materials(leg)
    assert found.names == TISSUES
    scores = {name: dice(found.data == i, leg.tissue.data == i) for i, name in TISSUES.items()}
    # Sheets and streaks are one or two pixels wide: half of their pixels are on the rim.
    assert scores["muscle"] > 0.95 and scores["fat"] > 0.9 and scores["bone"] > 0.95
    assert scores["connective_tissue"] > 0.7
    assert dice(found.data > 0, leg.tissue.data > 0) > 0.99
    # tensors in another unit are reported
    refuses("tissue.least_diffusivity = 0.8; check its unit", materials, leg, 0.8)


def test_connective_tissue_is_parted_by_its_signal_over_that_of_muscle_around():
    """The published method clusters the image alone, which shading distorts; no threshold helps."""
    keys = {"septum": 0.6, "growth": 15.0, "aponeurosis": 1.5, "imat": 0.03, "imct": 0.1}
    leg = make_phantom((96, 96, 3), (1.25, 1.25, 18.0), **keys)
    truth, image, found = leg.tissue.data == 3, leg.connective.data, materials(leg).data
    soft = (found > 0) & (found < 4)
    clusters = dice(bright_cluster(image, soft)[0] > 0.5, truth)
    even = image / leg.bias.data
    best = max(dice(soft & (even > level), truth) for level in np.linspace(300.0, 800.0, 26))
    assert dice(found == 3, truth) > max(clusters + 0.02, best - 0.01)


@pytest.mark.slow
def test_fewer_images_give_fewer_materials(leg):
    found = leg_tissues(leg.anatomy).labels.data
    assert not (found == 3).any()
    # The skin, as grey as muscle, is separated from it by its position and counts as fat; the
    # anatomy shows sheets as muscle.
    for number, least in ((4, 0.95), (2, 0.9), (1, 0.85)):
        assert dice(found == number, leg.tissue.data == number) > least


def test_a_single_slice_is_a_leg_as_well():
    plain = make_phantom((90, 90, 3), (1.25, 1.25, 20.0), bias=0.0)  # as after its correction
    one = Image(plain.anatomy.data[:, :, 1:2], plain.anatomy.affine)
    found = leg_tissues(one).labels.data[..., 0]
    truth = plain.tissue.data[:, :, 1]
    # Pixels partly filled by fat between the muscles are muscle by their grey value.
    for number, least in ((1, 0.93), (2, 0.94), (4, 0.95)):
        assert dice(found == number, truth == number) > least


def test_skin_lies_along_air_only():
    body = np.ones((12, 12, 2), bool)
    body[:2, :, 1] = False
    skin = _skin(body, np.array([1.0, 1.0]))
    assert not skin[..., 0].any()  # the whole picture is body
    assert skin[2, :, 1].all() and not skin[:2, :, 1].any() and not skin[-1, :, 1].any()


def test_no_connective_tissue_and_no_bones_where_there_are_none(leg):
    plain = make_phantom((90, 90, 3), (1.25, 1.25, 20.0))
    found = materials(plain).data
    assert not (found == 3).any() and dice(found == 1, plain.tissue.data == 1) > 0.98
    plain = np.where(leg.tissue.data == 4, 1000.0, leg.anatomy.data)
    assert not find_bones(Image(plain, leg.anatomy.affine), leg.tissue.data > 0).any()


def disc(radius):
    return np.hypot(*centred(100, 100, 1)[:2]) < radius


def limb(muscle=0.4, fat=1.0, skin=45.0, core=34.0, gap=4, noise=0.02, bone=7.0):
    """A round section of four muscles around a bone, with fat between and around them."""
    i, j, _ = np.abs(centred(100, 100, 1))
    body, flesh = disc(skin), disc(core) & ~disc(bone) & (np.minimum(i, j) > gap // 2)
    grey = np.where(flesh, muscle, fat) * body
    grey[disc(bone) & ~disc(bone - 2.0)] = 0.02
    noisy = rician(grey, noise, np.random.default_rng(1))
    return Image(100 * noisy, affine_of((2.0, 2.0, 5.0))), flesh, body


def test_fat_between_muscles_is_fat_without_a_doubt():
    image, flesh, body = limb()
    found = leg_tissues(image)
    assert dice(found.labels.data == 1, flesh) > 0.98
    assert dice(found.labels.data == 2, body & ~flesh & ~disc(7.0)) > 0.98 and not found.doubts
    # a limb without a bone causes a doubt
    image = limb(bone=0.0)[0]
    (doubt,) = leg_tissues(image).doubts
    assert "no bone was found in 1 of 1 slices" in doubt
    assert not leg_tissues(image, body=disc(45.0)).doubts


def test_bone_of_images_of_water_and_fat():
    """Their sum shows fat and muscle alike; the weak signal of cortex is mostly noise."""
    whole, clean = limb(muscle=1.0)[0], limb(muscle=0.05, noise=0.0)[0].data
    clean[disc(7.0) & ~disc(5.0)] *= 0.1
    fat = rician(clean, 2.0, np.random.default_rng(2)) / np.maximum(whole.data, 1e-9)
    found = leg_tissues(whole, fat=Image(np.clip(fat, 0.0, 1.0) * disc(45.0), whole.affine))
    assert dice(found.labels.data == 4, disc(7.0)) > 0.95 and not found.doubts


@pytest.mark.parametrize(("keys", "doubt"), [
    ({"muscle": 0.93, "noise": 0.05, "bone": 0.0}, "of the voxels of fat have no other tissue"),
    ({"muscle": 1.0, "fat": 0.3}, "not under the skin|beyond what was taken for the skin"),
    ({"skin": 36.0, "gap": 2}, "of the voxels of fat have no other tissue beside them"),
])  # fmt: skip
def test_what_the_rule_supposes_is_checked(keys, doubt):
    assert re.search(doubt, " ".join(leg_tissues(limb(**keys)[0]).doubts))


@pytest.mark.parametrize(("radius", "muscle", "message"), [
    (3, 0.4, ""), (9, 0.4, "signal of .* lies beyond"), (3, 2.5, "phase should be 'bright'"),
])  # fmt: skip
def test_lost_limbs_and_exchanged_phases_are_noticed(radius, muscle, message):
    x, y, _ = centred(96, 96, 1)
    away, second = np.hypot(x + 20, y), np.hypot(x - 28, y) < radius
    data = np.where(away < 16, muscle, 1.0 * (away < 22)) + 0.1 * second
    noisy = rician(data, 0.01, np.random.default_rng(1))
    found = segment_images(Images(Image(noisy, np.eye(4))), table_defaults("image"))
    assert bool(found.warnings) == bool(message)
    assert re.search(message, "".join(found.warnings))


@pytest.mark.parametrize(("keys", "message"), [
    ({}, ""), ({"muscle": 0.8, "noise": 0.05}, ""),
    ({"muscle": 0.9, "noise": 0.05, "bone": 0.0}, "that by 2.3 times the noise"),
    ({"muscle": 1.0, "bone": 0.0}, "that by 1.6 times the noise"),
    ({"muscle": 0.93}, "labelled muscle, is 1 % of the region"),  # cortex
])  # fmt: skip
def test_phases_that_are_not_muscle_and_fat_are_noticed(keys, message):
    image, flesh, _ = limb(**keys)
    found = segment_images(Images(image), table_defaults("image"))
    right = dice((found.labels.data > 0) & ~disc(7.0), flesh) > 0.95
    assert right == (not message) == (not found.warnings)
    assert re.search(message, "".join(found.warnings))


@pytest.mark.parametrize("share", [0.3, 0.6, 0.75])
def test_muscles_lost_to_fat_are_noticed(share):
    """Two of four muscles hold fat evenly: half of it puts them into the phase of fat."""
    image, flesh, _ = limb()
    x, _, _ = centred(100, 100, 1)
    image.data[flesh & (x > 0)] += 60.0 * share
    found = segment_images(Images(image), table_defaults("image"))
    tissue = leg_tissues(image)
    for labels, doubts in ((found.labels, found.warnings), (tissue.labels, tissue.doubts)):
        right = dice((labels.data == 1) & ~disc(7.0), flesh) > 0.95
        assert right == (share < 0.4) == (not doubts)
        assert right or "It may be muscle infiltrated by fat" in "".join(doubts)


def test_slices_beyond_a_limb_have_no_label():
    """Slices of noise, also stronger; a limb far from the coil is kept."""
    image, noise = limb()[0], np.random.default_rng(2)
    ends = [100 * rician(np.zeros((100, 100)), s, noise) for s in (0.02, 0.05)]
    one = image.data[..., 0]
    for dim in (0.2, 1.0):
        stack = np.stack([ends[0], dim * one, one, one, one, ends[1]], axis=-1)
        image = replace(image, data=stack)
        assert (body_mask(image).sum(axis=(0, 1)) > 1000).tolist() == [False, *[True] * 4, False]
    found = segment_images(Images(image), table_defaults("image"))
    tissue = leg_tissues(image)
    for labels, doubts in ((found.labels, found.warnings), (tissue.labels, tissue.doubts)):
        assert (labels.data > 0).any(axis=(0, 1)).tolist() == [False, *[True] * 4, False]
        assert not doubts


def test_an_image_without_air_is_no_leg():
    image, _, _ = limb(gap=2, bone=0.0)
    inner = replace(image, data=image.data[30:-30, 30:-30])
    refuses("without air around the limb", leg_tissues, inner)


def test_a_trunk_is_no_limb():
    image = limb()[0]
    wide = Image(image.data, affine_of((4.0, 4.0, 5.0)))
    assert "1020 cm^2, more than a limb" in " ".join(leg_tissues(wide).doubts)
    # a thigh of 415 cm^2 of which 177 cm^2 are muscle is one
    obese = replace(limb(skin=46.0, core=30.0)[0], affine=affine_of((2.5, 2.5, 5.0)))
    assert not leg_tissues(obese).doubts


def test_another_echo_parts_what_one_image_does_not():
    """In the first image the noise is half of the difference; the second one has no shading."""
    first, flesh, body = limb(muscle=0.6, noise=0.15)
    second = limb(muscle=1.0, fat=0.5, noise=0.05)[0]
    alone, both = (
        dice(leg_tissues(first, others=others, body=body).labels.data == 1, flesh)
        for others in ((), (second,))
    )
    assert alone < 0.95 < 0.98 < both


def test_bone_bounds_the_model():
    away = np.hypot(*centred(41, 41, 4)[:2])
    data = np.select([away < 6, away < 16], [4, 1], 0).astype(np.int32)
    labels = trimmed(select(Labels(data, affine_of((1.0, 1.0, 5.0))), [1], None, [4]))
    assert set(np.unique(labels.data)) == {BONE, 0, 1}
    sets = boundary_sets(labels)
    assert sets.names == ("bottom", "top", "bone", "surface")
    radial = np.argwhere(labels.data > 0)[sets.point][:, :2] - 15.0
    radial /= np.linalg.norm(radial, axis=1, keepdims=True)
    outward = (sets.normal[:, :2] * radial).sum(axis=1)
    bone, skin = sets.set == 2, sets.set == 3
    # Outward from the muscle is into the bone.
    assert outward[bone].max() < -0.95 and outward[skin].min() > 0.95
    # A circle of pixels has its true length if facets are projected on the normal.
    for where, radius in ((bone, 6), (skin, 16)):
        assert sets.area[where].sum() == pytest.approx(2 * np.pi * radius * 20, rel=0.1)


@pytest.mark.parametrize("block", [[1, 1, 1], [2, 2, 1], [2, 2, 2]])
@pytest.mark.parametrize("side", [0, 1])
def test_bone_beyond_the_box_of_the_body_bounds_it(block, side):
    # A block of muscle with faces at the ends of the map: one towards bone, one towards nothing.
    data = np.zeros((24, 24, 4), np.int32)
    data[8:16, 6:18], data[(slice(16, 24), slice(0, 8))[side], 4:20] = 1, 7
    labels = Labels(data, affine_of((1.0, 1.0, 5.0)), {1: "muscle", 7: "bone"})
    own = {"ids": [1], "bone": [7], "collocation_stride": block, "source_stride": block}
    cloud, _ = build_cloud(labels, None, {**table_defaults("build"), **own}, "mm")
    assert cloud.set_names == ("bottom", "top", "bone", "surface")
    here = cloud.boundary_set == 2
    assert here.sum() == 12 * 4 // (block[1] * block[2])
    assert ((cloud.normal[here][:, 0] > 0) == (side == 0)).all()


def test_thin_sheets_keep_their_volume_where_no_block_is_theirs():
    data = np.ones((40, 40, 2), np.int32)
    data[::8] = 3
    labels = Labels(data, np.eye(4), {1: "muscle", 3: "sheet"})
    coarse = coarsen(labels, (4, 4, 1))
    assert not (coarse.data == 3).any()
    shares, numbers = label_shares(labels, coarse, (4, 4, 1), np.zeros(coarse.data.shape, bool))
    assert numbers.tolist() == [1, 3]
    # every second block contains a sheet through a quarter of it
    np.testing.assert_allclose(shares.sum(axis=0) * 16, [2800, 400])
    assert set(np.unique(shares[:, 1])) == {0.0, 0.25}
    assert changed_volumes(labels, {1: 2800.0, 3: 400.0}) == []
    said = "muscle has 3 cm^3 in the model and 2.8 cm^3 in the label map"
    assert changed_volumes(labels, {1: 3000.0, 3: 400.0})[0].startswith(said)
    (warning,) = changed_volumes(labels, {1: 2800.0})
    assert "sheet has 0 cm^3" in warning and "build.collocation_stride" in warning
    data[:] = np.where(np.random.default_rng(1).random(data.shape) < 0.3, 3, 1)
    sampled = coarsen(Labels(data, np.eye(4)), (2, 2, 1), "sample")
    assert np.mean(sampled.data == 3) == pytest.approx(0.3, abs=0.05)


# ---- bias fields against the truth ---------------------------------------------------------------


def shaded(ends, beside, *, slices=slice(1, 2), size=(160, 160, 3), spacing=(0.8, 0.8, 40.0)):
    """Calf under a coil beside it: image, body, true field."""
    phantom = make_phantom(size, spacing, snr=1e6, bias=0.0, septum=0.0, growth=15.0).anatomy
    whole = Image(phantom.data[:, :, slices], phantom.affine)
    mask, shape = body_mask(whole), whole.data.shape
    away = (np.stack(np.indices(shape), -1) - np.array(beside) * shape) * whole.spacing
    coil = (1.0 + (away**2).sum(-1) / 60.0**2) ** -1.5
    low, high = coil[mask].min(), coil[mask].max()
    field = ends[0] + (ends[1] - ends[0]) * (coil - low) / (high - low)
    noisy = rician(whole.data * field, 16.0, np.random.default_rng(1))
    return Image(noisy, whole.affine), mask, field


def likeness(found, truth, mask):
    return np.corrcoef(found[mask], truth[mask])[0, 1]


@pytest.mark.slow
@pytest.mark.parametrize("ends", [(0.4, 2.0), (0.75, 1.3)])
def test_one_slice_under_a_coil(ends):
    image, mask, truth = shaded(ends, (0.1, 0.2, 0.5))
    found = shading(image.data, body_mask(image), spacing=image.spacing)
    assert likeness(found.field, truth, mask) >= 0.98 and not found.doubt
    again = shading(np.where(mask, 5.0 * image.data, np.nan), mask, spacing=image.spacing / 10.0)
    assert likeness(again.field, truth, mask) >= 0.98


@pytest.mark.slow
def test_stack_under_a_strong_coil():
    size = {"slices": slice(None), "size": (96, 96, 9), "spacing": (1.25, 1.25, 10)}
    image, mask, truth = shaded((0.27, 2.4), (0.0, 0.2, 0.3), **size)
    found = shading(image.data, body_mask(image), spacing=image.spacing)
    assert likeness(found.field, truth, mask) >= 0.985


@pytest.mark.slow
def test_limbs_that_do_not_touch():
    """Slopes do not give the brightness of one leg relative to the other."""
    image, mask, truth = shaded((0.5, 1.5), (0.1, 0.2, 0.5))
    values, mask, truth = (
        np.concatenate([one, np.zeros_like(one[:40]), one if one is mask else 0.5 * one])
        for one in (image.data, mask, truth)
    )
    found = shading(values, mask, spacing=image.spacing)
    assert likeness(found.field, truth, mask) >= 0.98 and not found.doubt


def test_a_field_that_makes_tissues_scatter_more_is_doubted():
    i, j, _ = np.indices((60, 60, 1))
    tissue = np.where((i // 6 + j // 6) % 2, 1.0, 3.0)
    random = np.random.default_rng(2)
    even = tissue * 100.0 + random.normal(0.0, 5.0, tissue.shape)
    mask = even > 0
    # the scatter of both is 5, their difference 200; Otsu's threshold separates them
    assert joint_variation(even, mask) == pytest.approx(0.05, rel=0.05)
    field = 1.0 + 0.4 * np.sin(i / 9.0)
    assert not variation_doubt(even * field, field, mask)
    doubt = variation_doubt(even, field, mask)
    assert re.search(r"of bright and dark tissue from 0\.0\d+ to 0\.\d+; look", doubt)
    # an increase as small as that due to noise is no evidence
    slight = 1.0 + 0.01 * np.sin(i / 9.0)
    assert joint_variation(even / slight, mask) > joint_variation(even, mask)
    assert not variation_doubt(even, slight, mask)
    assert joint_variation(np.ones(mask.shape), mask) == 0.0
    # one tissue alone: its scatter is cut in two, and a field that increases it is no evidence
    alone = 100.0 + random.normal(0.0, 20.0, tissue.shape)
    assert joint_variation(alone, mask) == pytest.approx(np.sqrt(np.pi / 2 - 1), rel=0.03)
    spotted = random.choice([0.5, 1.0, 2.0], tissue.shape, p=[0.02, 0.96, 0.02])
    assert joint_variation(alone / spotted, mask) > joint_variation(alone, mask)
    assert not variation_doubt(alone, spotted, mask)


@pytest.mark.slow
def test_voxels_that_do_not_touch_have_no_slopes():
    mask = np.zeros((40, 40, 1), bool)
    mask[::4, ::4] = True
    found = shading(np.ones(mask.shape), mask, spacing=(1, 1, 1))
    np.testing.assert_allclose(found.field[mask], 1.0, atol=1e-6)
    assert not found.doubt


def test_nothing_to_look_at():
    nothing = np.zeros((8, 8, 1))
    few = np.indices((8, 8, 1))[0] < 2
    for values, where, said in (
        (nothing + 1.0, nothing > 0, "no voxel to estimate the field from"),
        (nothing + 1.0, few, "16 voxels are too few to estimate a field"),
        (nothing + np.nan, nothing == 0, "not finite"),
        (nothing, nothing == 0, "the body has no signal"),
        (nothing - 1.0, nothing == 0, "100% of the values in the body are negative"),
    ):
        refuses(said, shading, values, where, spacing=(1, 1, 1))


# ---- voxels of two labels: fractions from grey values, conserved by models -----------------------


# Anatomy, fat image and image of connective tissue: air, muscle, fat, connective tissue, bone
SIGNALS = np.array([[0, 0, 0], [400, 40, 250], [1000, 1000, 120], [150, 60, 1000], [60, 20, 700]])


def coarse(values):
    shape = values.shape[0] // 4, 4, values.shape[1] // 4, 4, *values.shape[2:]
    return values.reshape(shape).mean(axis=(1, 3))


def seen(fine, snr):
    """Images of fine labels in voxels four times as wide, shaded and with noise; true fractions."""
    clean = coarse(SIGNALS[fine].astype(float))
    x = np.linspace(-1, 1, clean.shape[0]).reshape(-1, 1, 1, 1)
    truth = coarse(np.stack([fine == n for n in range(5)], axis=-1).astype(float))
    return rician(clean * (1 + 0.15 * x), 400.0 / snr, np.random.default_rng(1)), truth


@pytest.mark.slow
def test_tissues_of_a_leg_have_their_volumes():
    """Muscle with streaks of fat and septa of 1.8 mm in pixels of 1.4 mm, not used for any tuning.

    Labels are the best possible (the majority of each voxel); their volumes are not correct.
    Tissues, including bone, are uniform, and the body has no skin.
    """
    keys = {"septum": 1.8, "imat": 0.08, "scale": 0.93, "growth": 8.0, "seed": 21}
    leg = make_phantom((352, 352, 3), (0.35, 0.35, 7.0), snr=1e6, bias=0.0, **keys)
    images, truth = seen(leg.tissue.data, snr=20)
    labels = truth.argmax(axis=-1).astype(np.int32)
    parts = label_parts(labels, images, (1.4, 1.4, 7.0))
    right = truth.sum(axis=(0, 1, 2))
    # muscle and fat
    off = parts[..., :2].sum(axis=(0, 1, 2)) / right[1:3] - 1.0
    hard = np.bincount(labels.ravel())[1:3] / right[1:3] - 1.0
    assert (np.abs(hard) > [0.03, 0.02]).all() and (np.abs(off) < 0.015).all()
    wrong = [np.sqrt(np.mean((one - truth[..., 1]) ** 2)) for one in (labels == 1, parts[..., 0])]
    assert wrong[1] < 0.55 * wrong[0]
    assert parts.min() >= 0.0
    inside = ndimage.binary_erosion(labels > 0, np.ones((3, 3, 3)), border_value=1)
    np.testing.assert_allclose(parts.sum(axis=-1)[inside], 1.0, atol=1e-12)


def halves(step, noise):
    """Two halves that differ by a step; the border lies within voxels."""
    share = np.clip(20.3 - np.indices((40, 40, 4))[0], 0.0, 1.0)
    grey = 1.0 + step * share + np.random.default_rng(2).normal(0.0, noise, share.shape)
    return np.where(share > 0.5, 2, 1).astype(np.int32), grey[..., None], share


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05, 0.15])
def test_a_border_within_voxels_is_found_as_well_as_noise_lets_it(noise):
    labels, grey, share = halves(1.0, noise)
    found = label_parts(labels, grey, (1.0, 1.0, 1.0))[..., 1]
    hard = abs((labels == 2).sum() / share.sum() - 1.0)
    assert abs(found.sum() / share.sum() - 1.0) < (0.002 if noise < 0.1 else hard)
    # whole voxels stay whole, up to the effect of noise
    assert np.abs(found - share)[np.abs(share - 0.5) == 0.5].mean() < 0.01
    assert np.abs(found - share)[20].mean() < 0.02 + noise


def test_labels_that_are_alike_or_not_to_be_mixed_keep_their_voxels():
    for step, unmixed in ((0.1, ()), (1.0, (2,))):
        labels, grey, _ = halves(step, 0.05)
        found = label_parts(labels, grey, (1.0, 1.0, 1.0), unmixed)
        np.testing.assert_array_equal(found[..., 1], labels == 2)
    # muscle beside fat and air: kinds below one take their fraction, without volumes
    labels, grey, share = halves(1.0, 0.01)
    labels = np.where(labels == 2, 2, -1)
    labels[:, 30:], grey[:, 30:] = 0, 0.0
    parts = label_parts(labels.astype(np.int32), grey, (1.0, 1.0, 1.0), unmixed=(0,))
    assert parts.shape == (40, 40, 4, 1)
    assert parts[:, :28].sum() == pytest.approx(share[:, :28].sum(), rel=2e-3)
    assert (parts[:19, 29] == 1.0).all() and not parts[:, 30:].any()


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_models_hold_the_parts_of_their_voxels(stride):
    """Volumes are those of the fractions, also outside the labels, in the chosen slices."""
    random = np.random.default_rng(4)
    i, j, _ = np.indices((24, 20, 14))
    away = np.hypot(i - 11.3, j - 9.6)
    parts = np.stack([np.clip(4.4 - away, 0, 1), np.clip(8.2 - away, 0, 1)], axis=-1)
    parts[..., 1] -= parts[..., 0]
    parts *= 1.0 - 0.2 * random.random((24, 20, 14, 1)) * (parts[..., :1] > 0)
    data = np.where(parts[..., 0] > 0.5, 1, np.where(parts.sum(axis=-1) > 0.5, 2, 0))
    affine = affine_of((-1.0, 1.0, 2.0))
    strides = dict.fromkeys(("source_stride", "collocation_stride"), [stride] * 3)
    table = {**table_defaults("build"), **strides, "slices": [1, 12]}
    labels, fractions = Labels(data.astype(np.int32), affine), Image(parts, affine)
    cloud, _ = build_cloud(labels, None, table, "mm", fractions=fractions)
    right = 2.0 * parts[:, :, 1:13].sum(axis=(0, 1, 2))
    assert cloud.label_volumes() == pytest.approx({1: right[0], 2: right[1]}, rel=1e-9)
    assert cloud.fraction.shape == (len(cloud.points), 2)
    mixed = (cloud.fraction > 0.05).all(axis=1)
    assert mixed.sum() > 0.1 * len(cloud.points)
    # the model has the orientation of the image
    middle = cloud.points[mixed][:, :2] - cloud.points[:, :2].mean(axis=0)
    assert np.median(np.hypot(*middle.T)) == pytest.approx(4.0, abs=0.5)


def test_parts_that_do_not_go_with_the_labels_are_refused():
    labels = Labels(np.array([[[0, 1, 3]]], np.int32), np.eye(4))
    parts = np.array([[[[0.1, 0.0], [1.0, 0.0], [0.4, 0.6]]]])
    assert np.array_equal(checked_parts(Image(parts, np.eye(4)), labels).data, parts)
    for change, said in (
        (parts[..., :1], r"1 volumes do not go with the labels \[1, 3\]"),
        (parts * 1.2, r"must be 0 at least and their sum 1 at most, but in 2 voxels"),
        (parts - 0.3, r"in 2 voxels they are not, first in \(0, 0, 0\)"),
        (parts * np.nan, r"in 3 voxels"),
    ):
        refuses(said, checked_parts, Image(change, np.eye(4)), labels)


@pytest.mark.parametrize(
    ("where", "becomes", "first"), [((4, 9), 2, 5), ((8, 12), 0, 9), ((8, 12), -1, 9)]
)
def test_labels_changed_by_hand_do_not_take_the_parts_of_before(where, becomes, first):
    """All voxels are whole except at a border within the fifth; then a label is redrawn."""
    data = np.where(np.arange(12) < 4, 2, 1).astype(np.int32)[:, np.newaxis, np.newaxis]
    parts = np.stack([data == 1, data == 2], axis=-1).astype(float)
    parts[4] = [0.3, 0.7]
    parts = Image(parts, np.eye(4))
    checked_parts(parts, Labels(data, np.eye(4)))
    data[slice(*where)] = becomes
    drawn = Labels(data, np.eye(4), {}, "drawn")
    said = refuses("the fractions belong to another label map", checked_parts, parts, drawn)
    assert f"the first is ({first}, 0, 0)" in said and "inside a label of drawn" in said


@pytest.mark.slow
def test_a_bar_of_two_tissues_pulls_with_their_parts(tmp_path):
    """`myork run` on a bar whose tissues meet within voxels; labels alone are 3.6 % too stiff."""
    stiff = np.clip(np.arange(18) - 8.35, 0.0, 1.0)[:, None, None] * np.ones((18, 12, 8))
    body = np.zeros((18, 12, 8), np.int32)
    body[3:15, 2:10] = 1
    random = np.random.default_rng(5)
    grey = (300.0 + 500.0 * stiff) * body + random.normal(0.0, 15.0, body.shape)
    seeds = np.zeros_like(body)
    seeds[4:6, 5:7], seeds[12:14, 5:7] = 1, 2
    affine = affine_of((2.0, 2.0, 3.0))
    seeds = Labels(seeds, affine, {1: "soft", 2: "stiff"})
    save(tmp_path, affine, a=np.abs(grey), body=body, seeds=seeds)
    moduli = {"soft": 3.0, "stiff": 12.0}
    image = {"anatomy": "a.nii.gz", "body": "body.nii.gz", "seeds": "seeds.nii.gz"}
    tables = scene(
        "auto", {"kind": "model"}, image={**image, "split": "walk", "partial": True},
        bias={"method": "none"},
        material=[neo(mu, 1e3 * mu, name, label=number)
                  for number, (name, mu) in enumerate(moduli.items(), 1)],
        boundary=[
            {"set": "bottom", "u_z": 0}, {"set": "top", "u_z": 2.4e-4},
            {"set": "left", "u_x": 0}, {"set": "front", "u_y": 0},
        ],
        set=[{"name": name, "side": "surface", "where": f"n{axis} < -0.9"}
             for name, axis in (("left", "x"), ("front", "y"))],
        probe=probes("F force_z top"),
    )  # fmt: skip
    deck, out = tmp_path / "bar.toml", tmp_path / "out"
    deck.write_text(text_of_tables(tables))
    section = 0.04 * np.array([(body - stiff * body)[..., 0].sum(), (stiff * body)[..., 0].sum()])
    right = 1e-4 * 3 * section @ list(moduli.values())

    def force(*more):
        run_chain(deck, out, overrides=more, error=False)
        return read_summary(out)["steps"][-1]["probes"]["F"]

    assert force() == pytest.approx(right, rel=0.003)
    summary = read_summary(out)
    assert summary["segmentation"]["maps"] == {"fractions": "fractions.nii.gz"}
    labels = summary["segmentation"]["labels"]
    for number, name in enumerate(moduli):
        assert labels[name]["volume_of_parts"] == pytest.approx(2.4 * section[number], rel=0.003)
        assert summary["model"]["volume"][name] == pytest.approx(labels[name]["volume_of_parts"])
    parts = read_image(out / "fractions.nii.gz", values=2).data
    np.testing.assert_allclose(parts.sum(axis=-1), body, atol=1e-6)
    assert "volume by fractions [cm³]" in (out / "report.html").read_text()
    # the same by name, and without fractions after a segmentation without them
    (out / "fractions.nii.gz").rename(tmp_path / "parts.nii.gz")
    named = build(deck, out, overrides=["build.fractions=parts.nii.gz"])
    assert named["model"]["volume"] == summary["model"]["volume"]
    assert abs(force("image.partial=false") / right - 1.0) > 0.03
    assert not (out / "fractions.nii.gz").exists()


@pytest.mark.slow
def test_materials_of_a_leg_have_their_volumes(tmp_path):
    """Sheets of one or two pixels, found by `[tissue]`: labels lose muscle to them."""
    deck = Path(__file__).parents[2] / "inputs" / "leg_section.toml"
    words = ["image.partial=true", "phantom.size=[96, 96, 5]"]
    tissue = segment(deck, tmp_path, overrides=words)["tissue"]
    assert tissue["maps"]["fractions"] == "tissue_fractions.nii.gz"
    truth, found = read_labels(tmp_path / "true_tissue.nii.gz"), tissue["labels"]
    for number, labels_off, parts_off in ((1, 0.06, 0.02), (3, 0.3, 0.06)):
        entry = found[TISSUES[number]]
        right = (truth.data == number).sum() * truth.spacing.prod() / 1000
        assert abs(entry["volume"] / right - 1.0) > labels_off
        assert abs(entry["volume_of_parts"] / right - 1.0) < parts_off
    for name, volume in build(deck, tmp_path, overrides=words)["model"]["volume"].items():
        assert volume == pytest.approx(found[name]["volume_of_parts"], rel=1e-3)
