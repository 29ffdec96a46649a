"""Label maps with a single grey value: walks, nearest labels, references; muscles of regions."""

import json
import sys
from functools import partial

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from myork.core.deck import load_deck
from myork.errors import FileError, InputError, InstallationError
from myork.imaging.diffusion import tensor_components
from myork.imaging.io import read_labels, read_reference
from myork.imaging.phantom import KINDS, make_phantom, rician
from myork.records import Image, Labels
from myork.segmentation import grouping, walk
from myork.segmentation.bending import bend_labels
from myork.segmentation.channels import fiber_channels, smoothed_tensor
from myork.segmentation.grouping import Muscle, rule_seeds
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice, label_scores, pearson
from myork.segmentation.starts import seeded_regions
from myork.segmentation.walk import heights_of, random_walk
from myork.stations.segment import segment
from tests.images import affine_of, centred, labels_in, save, segmented
from tests.scenes import refuses

SPACING = np.array([1.5, 1.5, 6.0])
AFFINE = np.diag([*SPACING, 1.0])


def leg(slices=3):
    """Muscle in fat of the same grey, separated by a dark line of a pixel or two with gaps of
    four, and a bone in it; shading by a factor of three across, noise of a fortieth.
    """
    i, j, k = np.indices((84, 84, slices)) - np.reshape([41.5, 41.5, 0], (3, 1, 1, 1))
    r, angle, bone = np.hypot(i - k, j), np.arctan2(j, i - k), np.hypot(i - k, j - 6)
    edge = 27 + 1.5 * np.cos(3 * angle) + 0.5 * k
    here = np.select([r > 38, r > edge, bone > 7], [0, 2, 1], 3)
    grey = np.choose(here, [0.0, 1.0, 1.0, 0.7])
    line = np.abs(r - edge) < 0.9
    for start in (0.3, 2.0, -1.5):  # gaps
        line &= np.abs(angle - start) * 27 > 2
    grey[line & (here > 0)] *= 0.45
    grey[(bone < 9) & (here == 1)] = 0.1
    here[bone < 9] = 3
    grey *= np.exp(0.55 * (i + 0.5 * j) / 41.5)
    image = 400 * np.abs(grey + np.random.default_rng(0).normal(0, 1 / 40, grey.shape))
    return Image(image, AFFINE, "leg"), here.astype(np.int32)


def seeds(*voxels):
    return np.reshape(voxels, (-1, 3)) * SPACING


RULES = [
    Muscle("muscle", seeds((60, 42, 1), (25, 42, 1), (42, 25, 1))),
    Muscle("fat", seeds(), rim=4.0),
    Muscle("bone", seeds((43, 48, 1))),
]


def walked(image, truth, rules, weight=20.0):
    region = np.where(truth > 0, 0, -1).astype(np.int32)
    where, known = rule_seeds(region, image, rules, 4.0)
    heights = heights_of(image.data, truth > 0)
    return random_walk(heights, where, known, image.spacing, weight)


def test_walks_find_what_only_a_dark_line_with_gaps_parts():
    image, truth = leg()
    # Grey values do not separate them: they vary more within muscle than between muscle and fat.
    fat, muscle = (image.data[truth == number] for number in (2, 1))
    assert abs(fat.mean() - muscle.mean()) < 0.3 * muscle.std()
    found = walked(image, truth, RULES)
    assert np.array_equal(found >= 0, truth > 0)
    # The border may lie on either side of a line of two pixels on a body of 27: 1 - 2/27.
    for number, least in ((1, 0.95), (2, 0.93), (3, 0.85)):
        assert dice(found == number, truth == number) > least
    # Without `shyness`, the distances to the seeds decide.
    plain = walked(image, truth, RULES, weight=0.0)
    assert dice(plain == 1, truth == 1) < dice(found == 1, truth == 1) - 0.1
    # seeds of one slice reach all others
    image, truth = leg(slices=7)
    found = walked(image, truth, RULES)
    assert min(dice(found[..., k] == 1, truth[..., k] == 1) for k in range(7)) > 0.9


def test_what_no_seed_reaches_has_no_label():
    where = np.ones((6, 5, 1), bool)
    where[3] = False
    known = np.full(where.shape, -1, np.int32)
    known[0, 0, 0], known[1, 4, 0] = 1, 2
    flat = np.zeros((*where.shape, 1))
    found = random_walk(flat, where, known, np.ones(3), 1.0)
    assert (found[3:] == -1).all() and set(np.unique(found[:3])) == {1, 2}
    assert (random_walk(flat, where, 0 * known - 1, np.ones(3), 1.0) == -1).all()


def test_walks_on_a_strip_follow_the_resistances(monkeypatch):
    """One dimension in closed form: the border lies where the resistances to both are equal."""
    monkeypatch.setattr(walk, "_SLOPE", 0.0)
    heights = np.zeros((21, 1, 1, 1))
    heights[6:] = 1.0
    known = np.full((21, 1, 1), -1, np.int32)
    known[0], known[20] = 1, 2
    found = random_walk(heights, known < 9, known, np.ones(3), 3.0 * np.log(10.0))
    # Nineteen unit steps and one of ten at the edge: half of 29 is reached within it (5 to 15).
    assert found[:, 0, 0].tolist() == [1] * 6 + [2] * 15


def test_walks_that_cannot_be_are_refused(monkeypatch):
    image, truth = leg()
    # The preconditioner solves slices exactly; their coupling takes more than one step.
    monkeypatch.setattr(walk, "cg", partial(walk.cg, maxiter=1))
    refuses("walks from label 1 .* lower image.edge_weight = 20", walked, image, truth, RULES)
    # adjacent seeds, and images without signal
    rules = [Muscle("a", seeds((60, 42, 1))), Muscle("b", seeds((61, 42, 1)))]
    said = "muscle.a: the seed .* beside one of muscle.b; lower ima"
    refuses(said, walked, *leg(slices=2), rules)
    there = np.ones((3, 3, 1), bool)
    refuses("half of the voxels have no signal", heights_of, np.zeros(there.shape), there)


def test_regions_start_around_the_seeds_and_clusters_of_the_rest():
    random = np.random.default_rng(5)
    centre = np.array([[0, 0], [1, 0], [0, 1], [6, 6], [9, 0]])
    kind = np.repeat(np.arange(5), 40).reshape(20, 10, 1)
    values = centre[kind] + random.normal(0, 0.1, (20, 10, 1, 2))
    region = np.indices(kind.shape)[1] != 9
    known = np.full(kind.shape, -1, np.int32)
    known[9, 3, 0], known[0, 0, 0], known[5, 4, 0] = 1, 2, 3  # classes 2, 0, 1
    found = seeded_regions(values, region, known, 5)
    # Muscles in their order, then the clusters unlike all muscles, by their first channel
    wanted = np.array([1, 2, 0, 3, 4])[kind]
    assert np.array_equal(found[region], wanted[region]) and not found[~region].any()
    # With as many regions as muscles, every voxel belongs to one of them.
    assert set(np.unique(seeded_regions(values, region, known, 3))) == {0, 1, 2}


def test_smoothing_of_tensors_stays_inside_and_skips_what_is_not_finite():
    data = np.ones((9, 8, 3, 6))
    data[:4], data[6, 3, 1] = 7.0, np.nan
    region = np.indices((9, 8, 3))[0] >= 4
    smooth = smoothed_tensor(Image(data, AFFINE, "tensor"), region, 2.0)
    np.testing.assert_allclose(smooth.data[region], 1.0)


def two_muscles():
    """Two muscles that touch, in fat: no border between them in the image."""
    i, j, _ = centred(80, 70, 1)
    label = np.where((i / 24) ** 2 + (j / 18) ** 2 < 1, np.where(i + 0.3 * j > 4, 2, 1), 0)
    label[(np.hypot(i - 10, j) < 4)] = 0
    body = np.hypot(i, j * 1.2) < 36
    grey = np.select([label > 0, body], [250.0, 600.0], 0.0)
    noise = np.random.default_rng(3).normal(0, 10, grey.shape)
    return Image(np.abs(grey + noise), np.eye(4), "two"), label, body


def shifted(label, shift, degrees):
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()[:2, :2]
    centre = (np.array(label.shape[:2]) - 1) / 2
    offset = centre - turn @ (centre + shift)
    return ndimage.affine_transform(label[..., 0], turn, offset=offset, order=0)[..., None]


def parted(folder, muscles=(), **keys):
    return segmented(folder, image={"anatomy": "leg.nii.gz", **keys}, muscle=muscles)[
        "segmentation"
    ]


@pytest.fixture
def legs(tmp_path):
    """Truth of the leg, in a folder with its image."""
    image, truth = leg()
    names = {1: "muscle", 2: "fat", 3: "b"}
    save(tmp_path, AFFINE, leg=image, truth=Labels(truth, AFFINE, names))
    return truth


@pytest.mark.usefixtures("legs")
def test_segment_walks_from_the_seeds_of_the_deck(tmp_path):
    rules = [{"name": rule.name, "rim": rule.rim, "seeds": rule.seeds.ravel()} for rule in RULES]
    del rules[1]["seeds"]
    keys = dict(split="walk", seed_radius=4, tolerance=0.01, truth="truth.nii.gz", edge_weight=20)
    scores = parted(tmp_path, rules, **keys)["scores"]
    assert scores["muscle"]["dice"] > 0.95 and scores["fat"]["dice"] > 0.85


def drawn(truth):
    """A map of strokes: inside muscle and bone, and along the skin; 0 elsewhere."""
    strokes = np.zeros(truth.shape, np.int32)
    for number, depth in ((1, 6), (3, 4), (2, 2)):
        # distances within slices: those between slices are larger
        inside = np.pad(truth == number, ((1, 1), (1, 1), (0, 0)))
        depths = ndimage.distance_transform_edt(inside, sampling=(1, 1, 1000))[1:-1, 1:-1]
        strokes[depths > depth] = 10 * number
    return strokes


def test_segment_walks_from_a_map_of_seeds(legs, tmp_path):
    strokes = drawn(legs)
    strokes[0, 0, 0] = 10  # in the air
    names = {10: "muscle", 20: "background", 30: "bone"}
    save(tmp_path, AFFINE, seeds=Labels(strokes, AFFINE, names))
    found = parted(tmp_path, **WALK, truth="truth.nii.gz")
    assert found["scores"]["muscle"]["dice"] > 0.95
    assert set(found["labels"]) == {"muscle", "bone"}
    assert any("1 of" in line and "outside of the region" in line for line in found["warnings"])
    assert np.unique(labels_in(tmp_path / "out")).tolist() == [0, 10, 30]
    # muscle alone separates nothing
    save(tmp_path, AFFINE, seeds=strokes * (strokes == 10))
    said = "seeds of at least two labels .* there are \\[10\\]"
    refuses(said, parted, tmp_path, **WALK, truth="truth.nii.gz")


@pytest.mark.parametrize(("seed", "split", "said"), [
    ([30, 35, 0], "pieces", ""), ([40, 59, 0], "pieces", "lie in the bright phase"),
    ([30, 35, 0], "walk", "all voxels go to the only label"),
])  # fmt: skip
def test_a_seed_in_fat_or_alone_is_doubted(tmp_path, seed, split, said):
    save(tmp_path, np.eye(4), leg=two_muscles()[0])
    found = parted(tmp_path, [{"name": "soleus", "seeds": seed}], split=split, tolerance=0.01)
    warnings = " ".join(found["warnings"])
    assert said in warnings and (said or "phase" not in warnings)


#: Image keys of a walk from a seed map
WALK = {"split": "walk", "tolerance": 0.01, "seeds": "seeds.nii.gz"}


def bone(*seeds):
    return {"name": "bone", "seeds": seeds}


SEED = bone(39, 34, 0)


@pytest.mark.parametrize(("rules", "keys", "message"), [
    ([SEED], {"split": "nearest"}, "image.reference: missing: a text is needed"),
    ([], {"split": "walk"}, r"'walk' needs image.seeds or \[\[muscle\]\]"),
    ([SEED], {"reference": "old.nii.gz"}, "both define the muscles; leave one of them out"),
    ([bone(39, 2, 34, 0)], {}, "muscle.bone.seeds: three coordinates per point are needed, no"),
    ([bone(1, 34, 0)], {}, "muscle.bone: .* does not lie in the region to segment"),
    ([bone(-9, 34, 0)], {}, "muscle.bone: .* lies outside of"),
    ([bone(1, 34, 0)], {"split": "walk"}, "muscle.bone: .* does not lie in the"),
    ([bone(-9, 34, 0)], {"split": "walk"}, "muscle.bone: .* lies outside"),
    ([], {"reference": "nothing.nii.gz"}, "nothing.nii.gz: there is no such file"),
    ([], {"reference": "old.nii.gz"}, "old.nii.gz and .*leg.nii.gz do not overlap"),
])  # fmt: skip
def test_impossible_decks_are_refused_at_once(tmp_path, monkeypatch, rules, keys, message):
    image, truth, _ = two_muscles()
    save(tmp_path, affine_of(1.0, (500.0, 0, 0)), leg=image, old=truth)
    save(tmp_path, np.eye(4), seeds=10 * (truth == 1))

    def computed(*args, **kwargs):
        pytest.fail("the level sets ran")

    monkeypatch.setattr("myork.segmentation.images.segment_regions", computed)
    refuses(message, parted, tmp_path, rules, kind=(InputError, FileError), **keys)


def test_seeds_of_one_muscle_start_all_regions(tmp_path):
    image, truth, body = two_muscles()
    save(tmp_path, np.eye(4), leg=image)
    parted(tmp_path, [{**SEED, "name": "muscle"}], regions=3)
    assert dice(labels_in(tmp_path / "out") == 1, truth > 0) > 0.95
    # voxels unlike all seeds
    rest = labels_in(tmp_path / "out", "regions") > 1
    assert dice(rest, body & (truth == 0)) > 0.95


def test_segment_takes_a_reference_with_names_beside_it(tmp_path):
    image, truth, _ = two_muscles()
    off = shifted(truth, (4, -2), 5)
    save(tmp_path, np.eye(4), leg=image, old=off, truth=truth)
    for name in ("old", "truth"):
        (tmp_path / f"{name}.json").unlink()
    (tmp_path / "labels.json").write_text(json.dumps({"inner": 1, "outer": 2}))
    assert read_reference(tmp_path / "old.nii.gz", print).names == {1: "inner", 2: "outer"}
    keys = {"reference": "old.nii.gz", "truth": "truth.nii.gz"}
    scores = parted(tmp_path, split="nearest", **keys)["scores"]
    assert set(scores) == {"inner", "outer"}
    # Grey values correct the outer border of a displaced reference, not the one between muscles.
    for number, score in enumerate(scores.values(), start=1):
        assert score["dice"] > dice(off == number, truth == number)


def leaning_rods():
    """Two rods that touch and shift along z, with no edge between them, in 9 slices of 4 mm."""
    x, y, k = np.indices((40, 30, 9))
    inside = np.hypot((x - 14 - k) / 1.3, y - 15) < 10
    label = np.where(inside, np.where(x < 14 + k, 1, 2), 3).astype(np.int32)
    noise = np.random.default_rng(2).normal(0.0, 5.0, label.shape)
    return np.where(label == 3, 300.0, 100.0) + noise, label, np.array([1.0, 1.0, 4.0])


def test_the_number_of_the_background_does_not_matter(tmp_path):
    """Single voxels that no walk leaves are background, whether its seeds come first or last."""
    _, label, spacing = leaning_rods()
    random = np.random.default_rng(1)
    grey = np.choose(label, [0.0, 100.0, 140.0, 300.0]) * np.ones(label.shape)
    lone = (label == 3) & (random.random(label.shape) < 0.1)
    grey[lone] *= 12.0
    affine = affine_of(spacing)
    save(tmp_path, affine, leg=grey, body=np.ones(label.shape, np.int32))
    even = ndimage.uniform_filter(label * 1.0, (5, 5, 1)) == label
    drawn = np.isin(np.arange(9), (0, 4, 8)) & even
    found = []
    for order in ([1, 2, 3], [2, 3, 1]):
        known = np.where(drawn, np.array([0, *order])[label], 0).astype(np.int32)
        names = dict(zip(order, ("one", "two", "background"), strict=True))
        save(tmp_path, affine, seeds=Labels(known, affine, names))
        parted(tmp_path, **WALK, body="body.nii.gz")
        labels = read_labels(tmp_path / "out" / "segmentation.nii.gz")
        assert sorted(labels.names.values()) == ["one", "two"]
        found.append([labels.data == n for n in order[:2]])
    for first, second, number in zip(*found, (1, 2), strict=True):
        assert np.mean(first != second) < 1e-3
        assert np.mean(first[lone]) < 0.02 and dice(first, label == number) > 0.95


def bright_fat(folder, seed, contrast=3.0, rim=4.0, snr=20.0):
    """Two muscles, separated by a line of fat, in fat as bright as in T1 images, with a bone."""
    i, j, _ = centred(70, 70, 3)
    r, bone = np.hypot(i, j), np.hypot(i - 4, j - 9)
    kind = np.select([r > 32, r > 32 - rim, bone < 4, bone < 6, np.abs(i) < 0.9], [0, 3, 4, 5, 3],
                     np.where(i < 0, 1, 2))  # fmt: skip
    clean = 100.0 * np.choose(kind, [0, 1, 1.05, contrast, contrast * 0.9, 0.15])
    leg = rician(clean, 100 / snr, np.random.default_rng(seed))
    save(folder, AFFINE, leg=leg * (kind > 0))
    return kind.astype(np.int32)


def inside(region, size):
    """Voxels whose neighbours in the slice belong to the same region."""
    return ndimage.uniform_filter(region * 1.0, (size, size, 1)) > 0.99


@pytest.mark.parametrize("case", [dict(seed=1), dict(seed=2, contrast=2.2, rim=9.0, snr=12.0)])
def test_seeds_of_muscles_alone_leave_the_rest_without_a_label(tmp_path, case):
    kind = bright_fat(tmp_path, **case)
    strokes = inside(kind == 1, 9) + 2 * inside(kind == 2, 9)
    save(tmp_path, AFFINE, seeds=strokes)
    (warning,) = parted(tmp_path, **WALK)["warnings"]
    assert "resembles none of the seeds and becomes background" in warning
    found = labels_in(tmp_path / "out")
    assert min(dice(found == n, kind == n) for n in (1, 2)) > 0.95
    # one muscle alone, and all others as drawn
    strokes[strokes == 2] = 0
    save(tmp_path, AFFINE, seeds=strokes)
    parted(tmp_path, **WALK)
    strokes[inside(kind == 3, 3)], strokes[(kind == 4) | (kind == 5)] = 3, 4
    save(tmp_path, AFFINE, seeds=strokes)
    assert not parted(tmp_path, **WALK)["warnings"]


def test_a_band_of_fat_drawn_at_the_skin_is_kept(tmp_path):
    kind = bright_fat(tmp_path, 3)
    r = np.hypot(*(np.indices(kind.shape)[:2] - 34.5))
    places = [(r > 30) & (kind == 3), inside(kind == 1, 9), inside(kind == 2, 9), kind > 3]
    strokes = np.select(places, [3, 1, 2, 4], 0).astype(np.int32)
    names = {1: "a", 2: "b", 3: "fat", 4: "bone"}
    save(tmp_path, AFFINE, seeds=Labels(strokes, AFFINE, names))
    assert not parted(tmp_path, **WALK)["warnings"]
    fat, ring = labels_in(tmp_path / "out") == 3, (kind == 3) & (r > 28)
    # also on the outermost pixels
    assert fat[ring & (r > 30)].mean() > 0.99 and dice(fat & (r > 26), ring) > 0.97
    # a background seed over the skin does not bring it back
    save(tmp_path, AFFINE, seeds=Labels(strokes, AFFINE, names | {3: "background"}))
    assert "lie outside of the region" in parted(tmp_path, **WALK)["warnings"][0]


# ---- from regions to muscles; fiber channels; the six muscles of the phantom ---------------------


GRID = Image(np.zeros((8, 4, 1)), np.diag([2.0, 1.0, 1.0, 1.0]), "grid")


def muscle(name, *seeds):
    return Muscle(name, np.reshape(np.array(seeds, float), (-1, 3)))


def stripes(*numbers):
    """Columns of regions, each two voxels wide."""
    return np.repeat(np.repeat(numbers, 2)[:, None], 4, axis=1)[..., None].astype(np.int32)


def test_pieces_with_seeds():
    region = stripes(1, 0, 1, 2)
    rules = [muscle("a", 0, 1, 0), muscle("b", 4, 1, 0, 12, 1, 0)]
    label, warnings = grouping.group_by_rules(region, GRID, rules)
    assert np.array_equal(label, stripes(1, 2, 0, 2)) and not warnings
    both = grouping.group_by_rules(region, GRID, [muscle("a", 0, 1, 0, 8, 1, 0)])[0]
    assert np.array_equal(both, stripes(1, 0, 1, 0))
    # a shared component is split by the nearest seed, with a warning
    rules = [muscle("a", 0, 1, 0), muscle("b", 10, 1, 0)]
    label, warnings = grouping.group_by_rules(stripes(1, 1, 1, 0), GRID, rules)
    assert (label[:3] == 1).all() and (label[3:6] == 2).all() and not label[6:].any()
    assert "a, b share pieces of regions (24 voxels)" in warnings[0]
    # an empty slice parts the body, and the seeds lie on one side of it
    region = np.zeros((9, 2, 8), np.int32)
    region[..., 4] = -1
    label, warnings = grouping.group_by_rules(region, GRID, [muscle("a", 0, 1, 0)])
    assert not label[..., 4:].any() and "43 % of the body has no label: empty" in warnings[0]


def test_pieces_take_the_label_most_of_their_voxels_have():
    reference = Labels(stripes(4, 4, 0, 5), GRID.affine, {4: "four", 5: "five"})
    found = grouping.group_by_reference(stripes(1, 0, 0, 1), reference)
    assert np.array_equal(found.data[:2], stripes(4)) and np.array_equal(found.data[6:], stripes(5))
    assert found.names == {4: "four", 5: "five"}


def test_fiber_channels_do_not_know_the_sign_and_fade_without_direction():
    v = np.random.default_rng(0).normal(size=(5, 4, 3, 3))
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    full = 1e-3 * (np.eye(3) + v[..., :, None] * v[..., None, :])
    full[0] = 1e-3 * np.eye(3)
    tensor, there = Image(tensor_components(full), np.eye(4), "tensor"), np.ones((5, 4, 3), bool)
    dyads = fiber_channels(tensor, there, "dyad")
    assert np.abs(dyads[0]).max() < 1e-9
    apart = ((dyads[1:, :2] - dyads[1:, 2:]) ** 2).sum(-1)
    sine = 1 - (v[1:, :2] * v[1:, 2:]).sum(-1) ** 2
    np.testing.assert_allclose(apart, 2 * sine, atol=1e-9)
    assert (fiber_channels(tensor, there, "aligned")[..., 2] >= 0).all()
    flat = Image(0 * tensor.data, np.eye(4), "flat")
    refuses("the diffusion is isotropic everywhere", fiber_channels, flat, there, "dyad")


def few_slices(inputs, out, slices, *overrides):
    """Segmentation of the phantom by leg_muscles.toml, in few slices over its 84 mm."""
    deck, step = inputs / "leg_muscles.toml", 84 // (slices - 1)
    few = [f"phantom.size=[96, 96, {slices}]", f"phantom.spacing=[1.25, 1.25, {step}]"]
    for entry in load_deck(deck)["muscle"]:
        seeds = np.reshape(entry["seeds"], (-1, 3))
        seeds[:, 2] = step * np.rint(seeds[:, 2] / step)
        few.append(f"muscle.{entry['name']}.seeds={seeds.ravel().tolist()}")
    return segment(deck, out, overrides=[*few, *overrides])["segmentation"]


@pytest.mark.slow
def test_six_muscles_by_fibers_and_without(tmp_path, inputs):
    """The fibers separate muscles of equal grey value; five slices for speed."""
    means = {}
    for kind in ("dyad", "none"):
        found = few_slices(inputs, tmp_path / kind, 5, f"image.fiber_channels={kind}")
        scores = {name: score["dice"] for name, score in found["scores"].items()}
        assert len(scores) == 6 and (np.diff(found["energy"]) <= 0).all()
        means[kind] = np.mean(list(scores.values()))
        assert kind == "none" or scores["medial_gastrocnemius"] > 0.9
    assert means["dyad"] > 0.9
    # Without fibers the muscles are one region, split by the nearest seed.
    assert means["none"] < means["dyad"] - 0.08


@pytest.mark.slow
@pytest.mark.parametrize(("snr", "more"), [
    (10, {"seed": 3}), (25, {"seed": 5, "bias": 0.7}), (18, {"seed": 6, "pennation": 0.75}),
])  # fmt: skip
def test_other_phantoms_by_the_same_settings(tmp_path, inputs, snr, more, monkeypatch):
    """Phantoms not used to choose the deck's settings; three slices for speed."""
    monkeypatch.setitem(KINDS, "packed", KINDS["packed"] | more)
    found = few_slices(inputs, tmp_path, 3, f"phantom.snr={snr}")
    assert np.mean([score["dice"] for score in found["scores"].values()]) > 0.9


def test_dice_by_hand_and_pearson_against_numpy():
    a, m = np.array([1, 1, 1, 0, 0, 0]), np.array([0, 1, 1, 1, 1, 0])
    assert dice(a, m) == pytest.approx(2 * 2 / (3 + 4))
    assert dice(a, a) == 1.0 and dice(a, 1 - a) == 0.0 and np.isnan(dice(a * 0, a * 0))
    f, g = np.random.default_rng(0).random((2, 5, 7))
    assert pearson(f, g) == pytest.approx(np.corrcoef(f.ravel(), g.ravel())[0, 1], abs=1e-14)
    assert pearson(f, 3 * f + 2) == pytest.approx(1.0) and np.isnan(pearson(f, f * 0 + 1))
    # of labels and slices
    found = np.zeros((4, 4, 2), int)
    truth = found.copy()
    found[:2, :, 0], truth[1:3, :, 0] = 1, 7
    scores = label_scores(found, truth, {"a": (1, [7])})["a"]
    assert scores["dice"] == pytest.approx(0.5) and scores["dice_by_slice"][0] == pytest.approx(0.5)
    assert np.isnan(scores["dice_by_slice"][1])


# ---- a reference deformed onto an image by the image it was drawn in -----------------------------


def one_slice(image):
    affine = image.affine.copy()
    affine[:3, 3] += affine[:3, 2]
    return type(image)(np.ascontiguousarray(image.data[:, :, 1:2]), affine)


def visits(amount=6.0, size=(96, 96, 3), spacing=(1.25, 1.25, 6.0)):
    """Image and labels of today, and of an earlier visit: deformed, other contrast and noise."""
    today, earlier = (make_phantom(size, spacing, seed=seed) for seed in (1, 9))
    spacing = np.array(spacing)
    random = np.random.default_rng(4)
    shape = today.truth.data.shape
    fields = [ndimage.gaussian_filter(random.normal(size=shape), 30 / spacing) for _ in range(3)]
    places = [
        axis + amount * field / np.abs(field).max() / step
        for axis, field, step in zip(np.indices(shape), fields, spacing, strict=True)
    ]
    grey = ndimage.map_coordinates(earlier.anatomy.data, places, order=1, mode="nearest")
    label = ndimage.map_coordinates(earlier.truth.data, places, order=0, mode="nearest")
    affine = today.anatomy.affine
    return today, Image(grey.max() - grey, affine, "then"), Labels(label, affine)


def means(found, truth):
    """Dice of the six muscles."""
    numbers = range(1, 7)
    return np.array([dice(found.data == number, truth.data == number) for number in numbers])


@pytest.mark.slow
def test_every_muscle_of_a_slice_follows_its_own_bend():
    """The grid of the earlier visit may differ: finer, rotated, and with another origin."""
    today, then, drawn = visits()
    image, then, drawn, truth = map(one_slice, (today.anatomy, then, drawn, today.truth))
    found = bend_labels(drawn, then, image, body_mask(image))
    after = means(found, truth)
    assert means(drawn, truth).mean() < 0.89
    assert after.mean() > 0.95 and after.min() > 0.88
    np.testing.assert_array_equal(found.affine, image.affine)
    affine = then.affine @ np.diag([-0.5, 0.5, 1.0, 1.0])
    affine[:3, 3] = (then.affine @ [95.25, -0.25, 0.0, 1.0])[:3]
    drawn, then = (
        kind(np.flip(ndimage.zoom(one.data, (2, 2, 1), order=n, grid_mode=True, mode="nearest"), 0),
             affine) for kind, one, n in ((Labels, drawn, 0), (Image, then, 1))
    )  # fmt: skip
    other = bend_labels(drawn, then, image, body_mask(image))
    assert means(other, found).min() > 0.95 and means(other, truth).mean() > 0.96


@pytest.mark.slow
def test_stacks_are_bent():
    today, then, drawn = visits(5.0, (48, 48, 6), (2.5, 2.5, 6.0))
    found = bend_labels(drawn, then, today.anatomy, body_mask(today.anatomy))
    before, after = (means(one, today.truth) for one in (drawn, found))
    assert before.mean() < 0.88
    assert after.mean() > 0.93 and after.min() > 0.86


@pytest.mark.slow
def test_segment_bends_the_reference(tmp_path):
    today, then, drawn = visits()
    files = {"now": today.anatomy, "then": then, "old": drawn, "truth": today.truth}
    save(tmp_path, then.affine, **{name: one_slice(one) for name, one in files.items()})
    keys = {"anatomy": "now.nii.gz", "regions": 2, "phase": "dark", "split": "nearest",
            "reference": "old.nii.gz", "truth": "truth.nii.gz", "margin": 0}  # fmt: skip

    def run(**more):
        bias = {"method": "auto"}
        return segmented(tmp_path, image={**keys, **more}, bias=bias)["segmentation"]

    lies, bent = (
        [score["dice"] for score in run(**more)["scores"].values()]
        for more in ({}, {"reference_anatomy": "then.nii.gz"})
    )
    assert np.mean(bent) > np.mean(lies) + 0.05
    assert read_labels(tmp_path / "out" / "segmentation.nii.gz").data.shape == (96, 96, 1)
    # the earlier image shows more, including a label that is not in this one
    then, drawn = one_slice(then), one_slice(drawn)
    wide = ((20, 0), (0, 0), (0, 0))
    affine = then.affine.copy()
    affine[:3, 3] -= 20 * affine[:3, 0]
    beyond = np.pad(drawn.data, wide)
    beyond[:5, 40:50] = 9
    save(tmp_path, affine, then=np.pad(then.data, wide), old=beyond)
    summary = run(reference_anatomy="then.nii.gz")
    assert any("nothing is left of label 9" in text for text in summary["warnings"])


def test_what_cannot_be_bent_is_refused(monkeypatch):
    today, then, drawn = visits()
    image = one_slice(today.anatomy)
    refuses("must be one parallel to it", bend_labels, drawn, then, image, body_mask(image))
    few = "it takes 4 slices or more, or single ones"
    refuses(few, bend_labels, drawn, then, today.anatomy, body_mask(today.anatomy))
    today, then, drawn = visits(0.0, (48, 48, 6), (2.5, 2.5, 6.0))
    image, body = today.anatomy, body_mask(today.anatomy)
    far = affine_of(then.spacing, then.affine[:3, 3] + 500.0)
    labels = Labels(drawn.data, far)
    refuses("same part of the body", bend_labels, labels, Image(then.data, far), image, body)
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    refuses(r"myork\[seg\]", bend_labels, drawn, then, image, body, kind=InstallationError)
