"""Water and fat from two or more echoes, and segmentation by several channels, against truth."""

import json
from functools import partial

import numpy as np
import pytest

from myork.errors import InputError
from myork.imaging.dixon import echo, fat_factors, separate, separate_many, water_and_fat
from myork.imaging.io import read_image, read_labels
from myork.records import Image, Labels
from myork.segmentation.channels import noise_level, noise_weight
from myork.segmentation.scores import dice
from tests.images import centred, labels_in, save, segmented
from tests.scenes import refuses

SPACING = np.array([1.5, 1.5, 6.0])


def legs(times, strength, *, snr=25.0, turns=1.4, seed=1, rim=5.0):
    """Two legs: fat under the skin, muscle, and marrow of fat behind a dark ring.

    The phase between the echoes varies by `turns` turns across both, nonlinearly.
    """
    i, j, k = np.indices((140, 64, 3))
    water, fat = np.zeros((2, *i.shape))
    for centre in (34, 105):
        r, bone = np.hypot(i - centre, j - 32), np.hypot(i - centre, j - 38)
        kind = np.select([r > 28, r > 28 - rim / 1.5, bone > 9, bone > 6], [0, 2, 1, 3], 4)
        water += np.choose(kind, [0.0, 0.97, 0.1, 0.05, 0.08])
        fat += np.choose(kind, [0.0, 0.03, 1.1, 0.0, 1.0])
    phase = np.pi * turns * (i / 70.0 - 1.0) + 1.5 * np.sin(j / 14.0) + 0.3 * k + 2.0
    random = np.random.default_rng(seed)
    echoes = [
        (water + c * fat) * np.exp(1j * (0.05 * i - 0.02 * j + number * phase))
        + random.normal(0.0, 1.0 / snr, (*i.shape, 2)) @ (1.0, 1j)
        for number, c in enumerate(fat_factors(times, strength) if times else (1.0, -1.0))
    ]
    return echoes, water, fat, phase


def decayed(times, strength, *, snr=25.0, hertz=60.0, rim=5.0, seed=1):
    """Echoes of the legs with decaying water and fat [1/s] in an uneven field; truth of all."""
    _, water, fat, _ = legs(None, 0.0, rim=rim)
    i, j, k = np.indices(water.shape)
    turn = 2e-3 * np.pi * hertz * (i / 70.0 - 1.0 + 0.5 * np.sin(j / 14.0) + 0.1 * k)
    rate = (30.0 * water + 60.0 * fat) / np.maximum(water + fat, 1e-9)
    random = np.random.default_rng(seed)
    echoes = [
        (water + c * fat) * np.exp((1j * turn - 1e-3 * rate) * time + 1j * (0.05 * i - 0.02 * j))
        + random.normal(0.0, 1.0 / snr, (*i.shape, 2)) @ (1.0, 1j)
        for time, c in zip(times, fat_factors(times, strength), strict=True)
    ]
    return echoes, water, fat, rate


def scores(found, water, fat):
    """Dice of water and of fat, and the agreement of their fractions."""
    body, true, mine = water + fat > 0.5, fat > water, found.fraction > 0.5
    return (
        dice(~mine & body, ~true & body),
        dice(mine & body, true & body),
        np.corrcoef(found.fraction[body], (fat / np.maximum(water + fat, 1e-9))[body])[0, 1],
    )


@pytest.mark.parametrize(
    ("times", "strength"), [(None, 0.0), ((2.3, 4.6), 1.5), ((2.46, 1.23), 3.0), ((1.4, 2.6), 3.0)]
)
def test_water_and_fat_over_turns_of_the_phase(times, strength):
    """Both legs and the marrow behind its dark ring, wherever the phase wraps."""
    (one, two), water, fat, phase = legs(times, strength)
    factors = fat_factors(times, strength) if times else (1.0, -1.0)
    body = water + fat > 0
    found = separate(one, two, body, spacing=SPACING, factors=factors)
    assert min(scores(found, water, fat)) >= 0.98 and not found.doubt
    away = np.abs(np.angle(np.exp(1j * (found.phase - phase))))[water + fat > 0.5]
    assert np.quantile(away, 0.99) < 0.25
    assert not found.water[~body].any() and not found.fraction[~body].any()


def test_amounts_without_noise_are_exact():
    times = ((2.3, 4.6), 1.5)
    (one, two), water, fat, _ = legs(*times, snr=1e9, turns=0.0)
    found = separate(one, two, water + fat > 0, spacing=SPACING, factors=fat_factors(*times))
    # The rest is due to averaging a curved phase.
    np.testing.assert_allclose([found.water, found.fat], [water, fat], atol=0.02)


def test_echoes_in_the_wrong_order_are_reported():
    """Fat in muscle (30 %, also 6 %) is dark in opposed phase, which no mixture is in phase."""
    (one, two), water, fat, _ = legs(None, 0.0)
    body = water + fat > 0
    for part in (0.3, 0.06):
        mixed = [one, two - (water > 0.9) * 2.0 * part * two]
        assert not separate(*mixed, body, spacing=SPACING).doubt
        doubt = separate(*mixed[::-1], body, spacing=SPACING).doubt
        assert "with the echoes swapped" in doubt and "dixon.echo_times" in doubt
    # the fat under the skin decides; without any, there is a doubt
    (one, two), water, fat, _ = legs(None, 0.0, rim=0.0)
    bare = separate(one, two, water + fat > 0, spacing=SPACING)
    assert "fractions differ by" in bare.doubt and "are swapped" in bare.doubt


def test_echoes_at_which_fat_turns_by_few_degrees():
    """At 3 T echoes at 2.3 and 4.6 ms are both in phase; 15 degrees are too few, 27 are few."""
    (one, two), water, fat, _ = legs((2.3, 4.6), 1.5)
    parts = partial(separate, one, two, water + fat > 0, spacing=SPACING)
    alike, few, more = (
        fat_factors((2.3, 4.6), 3.0), *((1.0, np.exp(1j * np.radians(a))) for a in (15.0, 27.0))
    )  # fmt: skip
    refuses("same phase in both echoes.* cannot separate water", parts, factors=alike)
    refuses("the noise of water and fat 5.4 times", parts, factors=few)
    assert "noise of water and fat" in parts(factors=more).doubt


def test_slices_along_another_axis_are_no_other_image():
    (one, two), water, fat, _ = legs(None, 0.0)
    turned = [np.moveaxis(x, 2, 0) for x in (one, two, water + fat > 0)]
    found = separate(*turned, spacing=SPACING[[2, 0, 1]])
    back = found._replace(fraction=np.moveaxis(found.fraction, 0, 2))
    assert min(scores(back, water, fat)) > 0.98


@pytest.mark.parametrize(("turn", "offset"), [
    (2 * np.pi, 0.0), (360.0, 180.0), (4096.0, 2048.0), (8192.0, 0.0), (2000 * np.pi, 0.0),
])  # fmt: skip
def test_a_turn_follows_from_the_range_of_the_phases(turn, offset):
    angle = np.linspace(-np.pi, 0.999 * np.pi, 1000)
    stored = angle / (2 * np.pi) * turn + offset
    found = echo(np.ones(1000), np.floor(stored) if turn > 100 else stored)
    turned = np.exp(1j * (angle + 2 * np.pi * offset / turn))
    assert np.abs(found - turned).max() < 0.03


def test_what_cannot_be_separated_is_refused():
    one = np.ones((4, 4, 2), complex)
    everywhere = np.ones((4, 4, 2), bool)
    refuses("one of the echoes has no signal", separate, one, 0 * one, everywhere, spacing=SPACING)
    refuses("the body is empty", separate, one, one, ~everywhere, spacing=SPACING)
    refuses("not finite in the body", separate, one, one * np.nan, everywhere, spacing=SPACING)
    with pytest.raises(InputError, match=r"span 1e\+06, more than one turn in any usual unit"):
        echo(np.ones(2), np.array([0.0, 1e6]))


@pytest.mark.slow
@pytest.mark.parametrize("rim", [5.0, 2.0])
@pytest.mark.parametrize(("times", "strength"), [
    ((1.2, 2.2, 3.2, 4.2, 5.2, 6.2), 3.0), ((1.15, 2.3, 3.45, 4.6, 5.75, 6.9), 1.5),
    ((1.1, 1.9, 2.7), 3.0), ((1.2, 2.0, 3.1, 4.0), 3.0),
])  # fmt: skip
def test_many_echoes_part_what_two_do_not(times, strength, rim):
    """With little fat under the skin two echoes are exchanged, with a doubt; many are right."""
    echoes, water, fat, rate = decayed(times, strength, rim=rim)
    affine = np.diag([*SPACING, 1.0])
    images = [[Image(f(x), affine) for x in echoes] for f in (np.abs, np.angle)]
    body, bright = water + fat > 0, water + fat > 0.5
    found = water_and_fat(*images, body, times=times, strength=strength)
    assert min(scores(found, water, fat)) >= 0.995 and not found.doubt
    assert abs(np.median((found.decay - rate)[bright])) < 2.0
    assert np.abs(found.decay - rate)[bright].mean() < 12.0
    keys = {"spacing": SPACING, "factors": fat_factors(times[:2], strength)}
    two = separate(*echoes[:2], body, **keys)
    pair = water_and_fat(*(one[:2] for one in images), body, times=times[:2], strength=strength)
    np.testing.assert_allclose(pair.fraction, two.fraction, atol=1e-9)
    assert (min(scores(two, water, fat)) > 0.98) == (rim == 5.0) == (not two.doubt)
    # a scanner that stores phases with the opposite sign
    turned = [Image(-one.data, affine) for one in images[1]]
    again = water_and_fat(images[0], turned, body, times=times, strength=strength)
    assert min(scores(again, water, fat)) >= 0.995 or "under the skin" in again.doubt
    with pytest.raises(InputError, match="2 magnitudes and 1 phases; each echo"):
        water_and_fat(images[0][:2], images[1][:1], body)


@pytest.mark.slow
def test_phases_that_wrap_between_echoes_of_a_strong_shim_error():
    """200 Hz either way: several turns over the interval of the pair."""
    times = (1.3, 2.9, 4.2, 5.6)
    echoes, water, fat, _ = decayed(times, 3.0, hertz=200.0, snr=15.0, seed=9)
    keys = {"spacing": SPACING, "factors": fat_factors(times, 3.0)}
    found = separate_many(echoes, water + fat > 0, times=times, **keys)
    assert min(scores(found, water, fat)) >= 0.98 and not found.doubt


# ---- several grey channels separate what one image does not --------------------------------------


SIZE = (48, 48, 3)
AFFINE = np.diag([1.5, 1.5, 6.0, 1.0])


def halves(seed=1):
    """A disc whose halves are equal in the anatomy and differ in a second image."""
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
    # channels need an anatomy
    refuses("image.channels needs image.anatomy", run, folder, {"channels": ["t2.nii.gz"]})


def echoes(folder):
    """A leg of muscle under fat, in two echoes with wrapped phases, in files; truth of both."""
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
    keys = {"regions": 2}  # of water the bright phase is muscle, without image.phase
    tables = {"dixon": DIXON, "tissue": {"find": True}}
    summary, out = segmented(tmp_path, image=keys, **tables), tmp_path / "out"
    fraction = read_image(out / "fat_fraction.nii.gz").data
    inner, ring, body = kind == 1, kind == 2, (kind > 0) & (kind != 3)
    assert np.corrcoef(fraction[body], truth[body])[0, 1] > 0.98
    record = summary["segmentation"]
    assert record["maps"] == {"fat": "fat.nii.gz", "fat_fraction": "fat_fraction.nii.gz"}
    assert record["source"] == "m0.nii.gz" and not record["warnings"]
    # Water alone does not show fat; the body and its regions still extend under the skin.
    assert (labels_in(out, "regions")[ring] > 0).mean() > 0.75
    assert dice(labels_in(out) == 1, inner) > 0.95
    # There is no warning about voxels that the user takes from the body.
    save(tmp_path, AFFINE, inner=inner)
    segmented(tmp_path, "inner", image={**keys, "body": "inner.nii.gz"}, **tables)
    own = read_image(tmp_path / "inner" / "fat_fraction.nii.gz").data
    assert not own[~inner].any() and (own[inner] > 0).mean() > 0.9  # noise below zero is cut off
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
    keys = {"anatomy": "water.nii.gz", "fat": "fat.nii.gz"}
    assert not segmented(tmp_path, image=keys)["segmentation"]["warnings"]
    assert (labels_in(out, "regions")[kind == 2] > 0).mean() > 0.75
    assert (out / "fat_fraction.nii.gz").exists()
    # the folder's own fat is read before it is deleted, and the dark part of water is fat
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
    ({"anatomy": "m0.nii.gz", "fat": "m0.nii.gz"}, {}, "image.anatomy and image.fat: .* same val"),
    ({}, DIXON | {"magnitude": ["m1.nii.gz"] * 2}, "dixon.magnitude: .* same values"),
    ({}, DIXON | {"phase": DIXON["magnitude"]}, "dixon.magnitude and dixon.phase: .* same values"),
    ({}, DIXON | {"echo_times": [2.3, 4.6]}, "2 echoes need 2 different echo times and a fiel"),
    ({}, {key: names[:1] for key, names in DIXON.items()}, "1 echoes need"),
])  # fmt: skip
def test_echoes_that_do_not_make_water_and_fat(tmp_path, image, dixon, message):
    echoes(tmp_path)
    refuses(message, segmented, tmp_path, image=image, dixon=dixon)
