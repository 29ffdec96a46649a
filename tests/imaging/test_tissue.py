"""Tissues: fuzzy clusters, the materials of a leg, bone as a boundary."""

import re

import numpy as np
import pytest

from myork.core.deck import table_defaults
from myork.imaging.phantom import TISSUES, make_phantom, rician
from myork.model.boundary import boundary_sets
from myork.model.cloud import build_cloud
from myork.model.points import BONE, changed_volumes, coarsen, select, trimmed
from myork.model.shares import label_shares
from myork.records import Image, Labels
from myork.segmentation.fuzzy import bright_cluster
from myork.segmentation.leg import _skin, find_bones, leg_tissues
from myork.segmentation.scores import dice
from tests.images import affine_of, centred
from tests.scenes import refuses

LEAST = 0.8e-3  # of the mean diffusivity of muscle


def two_greys(noise):
    data = np.where(np.arange(40)[:, None, None] < 25, 1.0, 3.0) * np.ones((40, 30, 2))
    truth = data > 2
    return data + np.random.default_rng(1).normal(0.0, noise, data.shape), truth


def test_centres_and_memberships_of_two_greys():
    data, truth = two_greys(0.2)
    found, centres = bright_cluster(data, np.ones(data.shape, bool))
    # The mean of some hundred values; fuzzy weights pull centres towards each other a little.
    np.testing.assert_allclose(centres, [1.0, 3.0], atol=0.05)
    assert np.array_equal(found > 0.5, truth)
    # a region of any shape
    region = np.indices(data.shape)[1] % 3 > 0
    assert np.array_equal(bright_cluster(two_greys(0.0)[0], region)[0] > 0.5, truth & region)


def test_the_lesser_cluster_of_two_is_found():
    """A hundredth of the voxels, as connective tissue may be, beside two greys alike."""
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
    # Sheets and streaks are a pixel or two wide: half of their pixels are rim.
    assert scores["muscle"] > 0.95 and scores["fat"] > 0.9 and scores["bone"] > 0.95
    assert scores["connective_tissue"] > 0.7
    assert dice(found.data > 0, leg.tissue.data > 0) > 0.99
    # tensors in another unit are named
    refuses("tissue.least_diffusivity = 0.8; check its unit", materials, leg, 0.8)


def test_connective_tissue_is_parted_by_its_signal_over_that_of_muscle_around():
    """Published are clusters of the image alone, which shading moves; no threshold is better."""
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
    # The skin, as grey as muscle, is parted from it by its place and counts as fat; the anatomy
    # takes sheets for muscle.
    for number, least in ((4, 0.95), (2, 0.9), (1, 0.85)):
        assert dice(found == number, leg.tissue.data == number) > least


def test_a_single_slice_is_a_leg_as_well():
    plain = make_phantom((90, 90, 3), (1.25, 1.25, 20.0), bias=0.0)  # as after its correction
    one = Image(plain.anatomy.data[:, :, 1:2], plain.anatomy.affine)
    found = leg_tissues(one).labels.data[..., 0]
    truth = plain.tissue.data[:, :, 1]
    # Pixels that fat between the muscles fills in part are muscle by their grey value.
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
    # a limb without a bone is doubted
    image = limb(bone=0.0)[0]
    (doubt,) = leg_tissues(image).doubts
    assert "no bone was found in 1 of 1 slices" in doubt
    assert not leg_tissues(image, body=disc(45.0)).doubts


def test_bone_of_images_of_water_and_fat():
    """Their sum shows fat and muscle alike, what little signal cortex has is mostly noise."""
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


def test_a_trunk_is_no_limb():
    image = limb()[0]
    wide = Image(image.data, affine_of((4.0, 4.0, 5.0)))
    assert "1020 cm^2, more than a limb" in " ".join(leg_tissues(wide).doubts)


def test_another_echo_parts_what_one_image_does_not():
    """In the first image noise is half of the difference; the second one knows no shading."""
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
    # Out of the muscle is into the bone.
    assert outward[bone].max() < -0.95 and outward[skin].min() > 0.95
    # A circle of pixels has its true length where facets are projected on the normal.
    for where, radius in ((bone, 6), (skin, 16)):
        assert sets.area[where].sum() == pytest.approx(2 * np.pi * radius * 20, rel=0.1)


@pytest.mark.parametrize("block", [[1, 1, 1], [2, 2, 1], [2, 2, 2]])
@pytest.mark.parametrize("side", [0, 1])
def test_bone_beyond_the_box_of_the_body_bounds_it(block, side):
    # A block of muscle whose faces look at the ends of the map: one at bone, one at nothing.
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
    # every second block has a sheet through a quarter of it
    np.testing.assert_allclose(shares.sum(axis=0) * 16, [2800, 400])
    assert set(np.unique(shares[:, 1])) == {0.0, 0.25}
    assert changed_volumes(labels, {1: 2800.0, 3: 400.0}) == []
    (warning,) = changed_volumes(labels, {1: 2800.0})
    assert "sheet has 0 cm^3" in warning and "build.collocation_stride" in warning
    data[:] = np.where(np.random.default_rng(1).random(data.shape) < 0.3, 3, 1)
    sampled = coarsen(Labels(data, np.eye(4)), (2, 2, 1), "sample")
    assert np.mean(sampled.data == 3) == pytest.approx(0.3, abs=0.05)
