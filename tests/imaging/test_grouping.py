"""From regions to muscles; fiber channels; the six muscles of the phantom."""

import numpy as np
import pytest

from myork.core.deck import load_deck
from myork.imaging.diffusion import tensor_components
from myork.imaging.phantom import KINDS
from myork.records import Image, Labels
from myork.segmentation.channels import fiber_channels
from myork.segmentation.grouping import Muscle, check_seeds, group_by_reference, group_by_rules
from myork.segmentation.scores import dice, label_scores, pearson
from myork.stations.segment import segment
from tests.scenes import refuses

GRID = Image(np.zeros((8, 4, 1)), np.diag([2.0, 1.0, 1.0, 1.0]), "grid")


def muscle(name, *seeds):
    return Muscle(name, np.reshape(np.array(seeds, float), (-1, 3)))


def stripes(*numbers):
    """Columns of regions, each two voxels wide."""
    return np.repeat(np.repeat(numbers, 2)[:, None], 4, axis=1)[..., None].astype(np.int32)


def test_pieces_with_seeds():
    region = stripes(1, 0, 1, 2)
    rules = [muscle("a", 0, 1, 0), muscle("b", 4, 1, 0, 12, 1, 0)]
    label, warnings = group_by_rules(region, GRID, rules)
    assert np.array_equal(label, stripes(1, 2, 0, 2)) and not warnings
    both = group_by_rules(region, GRID, [muscle("a", 0, 1, 0, 8, 1, 0)])[0]
    assert np.array_equal(both, stripes(1, 0, 1, 0))
    # a piece that is shared is split by the nearest seed, with a warning
    rules = [muscle("a", 0, 1, 0), muscle("b", 10, 1, 0)]
    label, warnings = group_by_rules(stripes(1, 1, 1, 0), GRID, rules)
    assert (label[:3] == 1).all() and (label[3:6] == 2).all() and not label[6:].any()
    assert "a, b share pieces of regions (24 voxels)" in warnings[0]
    # seeds outside of the region
    region, rules = stripes(1, 0, 2, -1), [muscle("a", 0, 1, 0), muscle("b", 14, 1, 0)]
    said = "muscle.b: .* not lie in the region to segment"
    refuses(said, check_seeds, region >= 0, GRID, rules)


def test_pieces_take_the_label_most_of_their_voxels_have():
    reference = Labels(stripes(4, 4, 0, 5), GRID.affine, {4: "four", 5: "five"})
    found = group_by_reference(stripes(1, 0, 0, 1), reference)
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
    """The fibers part what has one grey value; five slices to be quick."""
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
    """What the deck's settings were not chosen on; three slices to be quick."""
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
