"""Several grey channels: level sets, walks and tissue see what one image does not show."""

import json

import numpy as np
import pytest

from myork.imaging.io import read_image, read_labels
from myork.records import Labels
from myork.segmentation.channels import noise_level, noise_weight
from myork.segmentation.scores import dice
from tests.images import centred, labels_in, save, segmented
from tests.scenes import refuses

SIZE = (48, 48, 3)
AFFINE = np.diag([1.5, 1.5, 6.0, 1.0])


def halves(seed=1):
    """A disc whose halves are alike in the anatomy and differ in a second image."""
    i, j, _ = centred(*SIZE)
    disc = np.hypot(i, j) < 20
    truth = np.where(disc, np.where(i + 4 * np.sin(j / 5.0) < 0, 1, 2), 0).astype(np.int32)
    random = np.random.default_rng(seed)
    anatomy = np.abs(disc * 300.0 + random.normal(0.0, 12.0, SIZE))
    return anatomy, np.choose(truth, [0.0, 30.0, 45.0]) + random.normal(0.0, 3.0, SIZE), truth


@pytest.fixture
def folder(tmp_path):
    anatomy, other, truth = halves()
    known = np.zeros(SIZE, np.int32)
    known[12, 20:28], known[36, 20:28] = 1, 2
    seeds = Labels(known, AFFINE, {1: "one", 2: "two"})
    save(tmp_path, AFFINE, anatomy=anatomy, t2=other, truth=truth, body=truth > 0, seeds=seeds)
    return tmp_path


def run(folder, keys):
    summary = segmented(folder, image={"body": "body.nii.gz", **keys})
    assert json.loads((folder / "out" / "summary.json").read_text())["segmentation"]
    return summary, labels_in(folder / "out")


def shares(folder, found):
    truth = labels_in(folder, "truth")
    return max(min(dice(found == a, truth == n) for n, a in ((1, k), (2, 3 - k))) for k in (1, 2))


@pytest.mark.parametrize("way", ["level sets", "walk"])
def test_a_channel_tells_what_the_anatomy_does_not(folder, way):
    walk = {"regions": 3, "split": "walk", "seeds": "seeds.nii.gz"}
    keys = walk if way == "walk" else {"regions": 2, "phase": "dark"}
    keys |= {"anatomy": "anatomy.nii.gz", "tolerance": 0.01}
    without = run(folder, keys)[1]
    summary, found = run(folder, keys | {"channels": ["t2.nii.gz"]})
    if way == "level sets":
        found = np.where(labels_in(folder, "truth") > 0, 2 - (found == 1), 0)
        without = np.where(found > 0, 2 - (without == 1), 0)
    assert shares(folder, without) < 0.93 < 0.97 < shares(folder, found)
    (channel,) = summary["segmentation"]["channels"]
    assert channel["name"].endswith("t2.nii.gz") and 1 / 16 <= channel["weight"] <= 16


def test_channels_count_by_their_noise(folder):
    truth = halves()[2]
    random = np.random.default_rng(3)
    for sigma in (0.02, 0.1):
        values = truth / 2.0 + random.normal(0.0, sigma, SIZE)
        assert noise_level(values, truth > 0) == pytest.approx(sigma, rel=0.1)
    assert noise_weight(0.02, 0.04) == pytest.approx(0.25)
    assert noise_weight(1.0, 1e-3) == 16.0 and noise_weight(1e-3, 1.0) == 1.0 / 16.0
    assert noise_weight(0.0, 1.0) == noise_weight(1.0, 0.0) == 1.0
    # channels belong to an anatomy
    refuses("image.channels needs image.anatomy", run, folder, {"channels": ["t2.nii.gz"]})


def echoes(folder):
    """A leg of muscle under fat, in two echoes whose phases wrap, in files; truth of both."""
    i, j, _ = centred(64, 64, 5)
    r, bone = np.hypot(i, j), np.hypot(i, j - 6)
    kind = np.select([r > 29, r > 21, bone > 7, bone > 4], [0, 2, 1, 3], 4)
    water, fat = (np.choose(kind, one) for one in ([0, 0.95, 0.06, 0.03, 0.06], [0, 0.04, 1, 0, 1]))
    fat = fat + np.where((kind == 1) & (i < 0), 0.15, 0.0)
    random = np.random.default_rng(1)
    for number, c in enumerate((1.0, -1.0)):
        signal = (water + c * fat) * np.exp(1j * (0.03 * i + number * (0.12 * j + 2.0)))
        signal = 500 * signal + random.normal(0.0, 20.0, (*i.shape, 2)) @ (1.0, 1j)
        save(folder, AFFINE, **{f"m{number}": np.abs(signal), f"p{number}": np.angle(signal)})
    return kind, fat / np.maximum(water + fat, 1e-9)


DIXON = {"magnitude": ["m0.nii.gz", "m1.nii.gz"], "phase": ["p0.nii.gz", "p1.nii.gz"]}


@pytest.mark.slow
def test_echoes_become_water_fat_and_tissue(tmp_path):
    kind, truth = echoes(tmp_path)
    keys = {"regions": 2, "phase": "bright"}
    tables = {"dixon": DIXON, "tissue": {"find": True}}
    summary, out = segmented(tmp_path, image=keys, **tables), tmp_path / "out"
    fraction = read_image(out / "fat_fraction.nii.gz").data
    inner, ring, body = kind == 1, kind == 2, (kind > 0) & (kind != 3)
    assert np.corrcoef(fraction[body], truth[body])[0, 1] > 0.98
    record = summary["segmentation"]
    assert record["maps"] == {"fat": "fat.nii.gz", "fat_fraction": "fat_fraction.nii.gz"}
    assert record["source"] == "m0.nii.gz" and not record["warnings"]
    # Water alone shows no fat; the body and its regions reach under the skin all the same.
    assert (labels_in(out, "regions")[ring] > 0).mean() > 0.75
    assert dice(labels_in(out) == 1, inner) > 0.95
    # Nothing is said of what the user takes from the body.
    save(tmp_path, AFFINE, inner=inner)
    segmented(tmp_path, "inner", image={**keys, "body": "inner.nii.gz"}, **tables)
    own = read_image(tmp_path / "inner" / "fat_fraction.nii.gz").data
    assert not own[~inner].any() and (own[inner] > 0).mean() > 0.9  # noise below zero is cut
    # Half of the muscle holds 4 % of fat, half 17 %.
    assert record["labels"]["muscle"]["fat_fraction"] == pytest.approx(0.10, abs=0.02)
    tissue = read_labels(out / "tissue.nii.gz")
    fat = tissue.data == next(n for n, name in tissue.names.items() if name == "fat")
    assert fat[ring].mean() > 0.95 and fat[inner].mean() < 0.02
    assert summary["tissue"]["maps"] == {"membership_fat": "membership_fat.nii.gz"}
    membership = read_image(out / "membership_fat.nii.gz").data
    assert membership[ring].mean() > 0.9 and membership[inner].mean() < 0.1


@pytest.mark.slow
def test_water_and_fat_of_the_scanner_are_as_good(tmp_path):
    kind, out = echoes(tmp_path)[0], tmp_path / "out"
    water, fat = (np.isin(kind, numbers) * 400.0 + 10.0 for numbers in ((1,), (2, 4)))
    save(tmp_path, AFFINE, water=water * (kind > 0), fat=fat * (kind > 0))
    keys = {"anatomy": "water.nii.gz", "fat": "fat.nii.gz", "phase": "bright"}
    assert not segmented(tmp_path, image=keys)["segmentation"]["warnings"]
    assert (labels_in(out, "regions")[kind == 2] > 0).mean() > 0.75
    assert (out / "fat_fraction.nii.gz").exists()
    # the fat of the folder itself is not deleted before it is read, and the dark of water is fat
    keys |= {"fat": str(out / "fat.nii.gz"), "phase": "dark"}
    (doubt,) = segmented(tmp_path, image=keys)["segmentation"]["warnings"]
    assert "of its signal is fat" in doubt and "image.phase should be 'bright'" in doubt
    del keys["fat"]
    segmented(tmp_path, image=keys)
    assert (labels_in(out, "regions")[kind == 2] > 0).mean() < 0.3
    assert not (out / "fat_fraction.nii.gz").exists()


@pytest.mark.parametrize(("image", "dixon", "message"), [
    ({}, {"magnitude": DIXON["magnitude"]}, "dixon.phase: missing"),
    ({"anatomy": "m0.nii.gz"}, DIXON, "take image.anatomy out"),
    ({"fat": "m0.nii.gz"}, DIXON, "take image.fat out"),
    ({}, DIXON | {"echo_times": [2.3, 4.6]}, "2 echoes need 2 different echo times and a fiel"),
    ({}, {key: names[:1] for key, names in DIXON.items()}, "1 echoes need"),
])  # fmt: skip
def test_echoes_that_do_not_make_water_and_fat(tmp_path, image, dixon, message):
    echoes(tmp_path)
    refuses(message, segmented, tmp_path, image=image, dixon=dixon)
