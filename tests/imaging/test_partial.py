"""Voxels of two labels: parts from grey values, kept by models."""

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from myork.chain import run_chain
from myork.core.deck import table_defaults, text_of_tables
from myork.imaging.io import read_image, read_labels
from myork.imaging.phantom import TISSUES, make_phantom, rician
from myork.model.cloud import build_cloud
from myork.model.shares import checked_parts
from myork.records import Image, Labels
from myork.segmentation.partial import label_parts
from myork.stations.build import build
from myork.stations.segment import segment
from myork.summary import read_summary
from tests.images import affine_of, save
from tests.scenes import refuses, scene

# Anatomy, fat image and image of connective tissue: air, muscle, fat, connective tissue, bone
SIGNALS = np.array([[0, 0, 0], [400, 40, 250], [1000, 1000, 120], [150, 60, 1000], [60, 20, 700]])


def coarse(values, n=4):
    shape = values.shape[0] // n, n, values.shape[1] // n, n, *values.shape[2:]
    return values.reshape(shape).mean(axis=(1, 3))


def seen(fine, snr, seed=1, channels=(0, 1, 2)):
    """Images of fine labels in voxels four times as wide, shaded and with noise; true parts."""
    clean = coarse(SIGNALS[fine][..., list(channels)].astype(float))
    x = np.linspace(-1, 1, clean.shape[0]).reshape(-1, 1, 1, 1)
    truth = coarse(np.stack([fine == n for n in range(5)], axis=-1).astype(float))
    return rician(clean * (1 + 0.15 * x), 400.0 / snr, np.random.default_rng(seed)), truth


@pytest.mark.slow
def test_tissues_of_a_leg_have_their_volumes():
    """Muscle with streaks of fat and septa of 1.8 mm in pixels of 1.4 mm, as nothing was tuned on.

    Labels are as good as they can be, most of each voxel; their volumes are not. Tissues, also
    bone, are even, and the body has no skin.
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
    """Two halves that differ by a step, the border lies within voxels."""
    share = np.clip(20.3 - np.indices((40, 40, 4))[0], 0.0, 1.0)
    grey = 1.0 + step * share + np.random.default_rng(2).normal(0.0, noise, share.shape)
    return np.where(share > 0.5, 2, 1).astype(np.int32), grey[..., None], share


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05, 0.15])
def test_a_border_within_voxels_is_found_as_well_as_noise_lets_it(noise):
    labels, grey, share = halves(1.0, noise)
    found = label_parts(labels, grey, (1.0, 1.0, 1.0))[..., 1]
    hard = abs((labels == 2).sum() / share.sum() - 1.0)
    assert abs(found.sum() / share.sum() - 1.0) < (0.002 if noise < 0.1 else hard)
    # voxels that are whole stay so, but for what noise makes likely
    assert np.abs(found - share)[np.abs(share - 0.5) == 0.5].mean() < 0.01
    assert np.abs(found - share)[20].mean() < 0.02 + noise


def test_labels_that_are_alike_or_not_to_be_mixed_keep_their_voxels():
    for step, unmixed in ((0.1, ()), (1.0, (2,))):
        labels, grey, _ = halves(step, 0.05)
        found = label_parts(labels, grey, (1.0, 1.0, 1.0), unmixed)
        np.testing.assert_array_equal(found[..., 1], labels == 2)
    # a muscle beside fat and beside air takes its part: kinds below one, without volumes of theirs
    labels, grey, share = halves(1.0, 0.01)
    labels = np.where(labels == 2, 2, -1)
    labels[:, 30:], grey[:, 30:] = 0, 0.0
    parts = label_parts(labels.astype(np.int32), grey, (1.0, 1.0, 1.0), unmixed=(0,))
    assert parts.shape == (40, 40, 4, 1)
    assert parts[:, :28].sum() == pytest.approx(share[:, :28].sum(), rel=2e-3)
    assert (parts[:19, 29] == 1.0).all() and not parts[:, 30:].any()


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_models_hold_the_parts_of_their_voxels(stride):
    """Volumes are those of the parts, beyond the labels too, in the slices that were chosen."""
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
    # the model looks the way the image did
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
    """Parts of each voxel whole, but a border within the fifth; then a label is drawn anew."""
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
    """`myork run` on a bar whose tissues meet within voxels: labels alone are 3.6 % too stiff."""
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
        material=[
            {"name": name, "model": "neo-hookean", "mu": mu, "K": 1e3 * mu, "label": number}
            for number, (name, mu) in enumerate(moduli.items(), 1)
        ],
        boundary=[
            {"set": "bottom", "u_z": 0}, {"set": "top", "u_z": 2.4e-4},
            {"set": "left", "u_x": 0}, {"set": "front", "u_y": 0},
        ],
        set=[{"name": name, "side": "surface", "where": f"n{axis} < -0.9"}
             for name, axis in (("left", "x"), ("front", "y"))],
        probe=[{"name": "F", "quantity": "force_z", "set": "top"}],
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
    # the same by name, and none of it after a segmentation without parts
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
