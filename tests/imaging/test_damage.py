"""Damaged slices: found where they are, and none in whole images."""

import json
from pathlib import Path

import nibabel
import numpy as np
import pytest

from myork.imaging.damage import damaged_slices, missing_slices
from myork.imaging.phantom import make_phantom
from myork.records import Image, Labels
from myork.stations.build import build
from myork.stations.segment import segment

AFFINE = np.diag([1.5, 1.5, 4.0, 1.0])


def stack(seed: int, slices: int = 16) -> np.ndarray:
    """A limb that gets thinner along the stack, with noise and a signal that falls to its ends."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(*(np.linspace(-1, 1, 40),) * 2, indexing="ij")
    radius = 0.8 - 0.3 * random.random() * np.linspace(0, 1, slices)
    coil = 1.0 - 0.4 * random.random() * np.linspace(-1, 1, slices) ** 2
    body = 300.0 * coil * (np.hypot(x, y)[..., None] < radius)
    noise = random.normal(0.0, 15.0, (2, 40, 40, slices))
    return np.hypot(body + noise[0], noise[1])


def image(data: np.ndarray) -> Image:
    return Image(data, AFFINE, "t1.nii")


@pytest.mark.parametrize("seed", range(25))
def test_each_fault_is_found_and_no_other(seed: int) -> None:
    random = np.random.default_rng([seed, 1])
    assert damaged_slices(image(stack(seed))) == []
    at = int(random.integers(3, 13))
    empty, repeated, jump, moved, ghost, lower = (stack(seed) for _ in range(6))
    empty[..., at] *= 0.01
    repeated[..., at] = repeated[..., at - 1]
    jump[..., at] *= random.choice([0.5, 0.6, 1.6, 2.0])
    lower[..., at:] *= 0.6
    axis = int(random.integers(2))
    moved[..., at] = np.roll(moved[..., at], random.choice([-6, 5]), axis)
    ghost[..., at] += random.uniform(0.08, 0.25) * np.roll(ghost[..., at], 20, axis)
    for data, why in (
        (empty, "no signal"),
        (repeated, "the values of"),
        (jump, "a signal more"),
        (lower, "a signal more"),
        (moved, "a place 3 voxels"),
        (ghost, "a copy of the body"),
    ):
        (fault,) = damaged_slices(image(data))
        assert fault.slices == [at] and fault.why.startswith(why)


def test_what_is_no_fault() -> None:
    padded = np.pad(stack(1), ((0, 0), (0, 0), (3, 2)))
    assert damaged_slices(image(padded)) == []
    # a coarser image stretched; volumes of a series; a single slice; nothing at all
    assert damaged_slices(image(np.repeat(stack(2), 2, axis=2))) == []
    assert damaged_slices(image(np.stack([stack(3), 0.3 * stack(4)], axis=3))) == []
    assert damaged_slices(image(stack(5)[..., :1])) == []
    assert damaged_slices(image(np.zeros((4, 4, 6)))) == []
    phantom = make_phantom(size=(48, 48, 12), spacing=(2.5, 2.5, 6.0))
    assert damaged_slices(phantom.anatomy) == missing_slices(phantom.truth) == []


@pytest.mark.slow
def test_segment_and_build_name_the_slices(tmp_path: Path) -> None:
    data = stack(6)
    data[..., 7:9] = 0.0
    nibabel.save(nibabel.Nifti1Image(data, AFFINE), tmp_path / "t1.nii")
    found = segment({"image": {"anatomy": tmp_path / "t1.nii", "regions": 2}}, tmp_path)
    (entry,) = found["damaged_slices"]
    assert entry == {
        "file": entry["file"], "slices": [7, 8], "why": "no signal", "station": "segment",
    }  # fmt: skip
    assert "slices 7, 8 (from 0) have no signal" in "\n".join(found["segmentation"]["warnings"])
    labels = np.ones((6, 6, 9), "i2")
    labels[..., 4] = 0
    nibabel.save(nibabel.Nifti1Image(labels, AFFINE), tmp_path / "labels.nii")
    table = {"labels": tmp_path / "labels.nii", "ids": [1]}
    build({"scene": {"dimension": 3}, "build": table}, tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [own["slices"] for own in summary["damaged_slices"]] == [[7, 8], [4]]
    assert any("cuts the body in two" in text for text in summary["model"]["warnings"])


def test_gaps_of_labels() -> None:
    data = np.zeros((4, 4, 8), int)
    data[1:3, 1:3, 2:7] = 3
    assert missing_slices(Labels(data, AFFINE)) == []
    data[..., 4] = 0
    assert missing_slices(Labels(data, AFFINE))[0].slices == [4]
