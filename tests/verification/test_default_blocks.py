"""Blocks of voxels that a model gets where nobody chose them: finer across thin layers."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork.bench.materials import RUBBER
from myork.core.deck import text_of_tables
from myork.model_file import write_model
from myork.records import PointCloud
from tests import scenes
from tests.scenes import voxels


def built(filled: np.ndarray, stride: int = 2) -> PointCloud:
    """Model of a label map with voxels of 1 mm."""
    around = np.pad(filled, ((2, 2), (2, 2), (0, 0)))
    return voxels(around, 1.0, source_stride=[stride] * 3)


def layered(*shape: int, thick: int) -> np.ndarray:
    """Layers of two tissues that alternate along x."""
    return 1 + np.broadcast_to(np.arange(shape[0])[:, None, None] // thick % 2, shape)


def tables(tissues: int = 1) -> dict:
    materials = [
        {**RUBBER, "name": f"rubber {label}", "K": 1e3, "label": label}
        for label in range(1, tissues + 1)
    ]
    return scenes.gripped("auto", {"kind": "model"}, materials, "bottom top")


@pytest.fixture
def points(tmp_path: Path) -> Callable[..., int]:
    """Source points by `myork explain` of a model, which are the corners of its blocks."""

    def explained(cloud: PointCloud, tissues: int = 1, words: Any = (), **more: dict) -> int:
        write_model(tmp_path / "model.h5", cloud)
        (tmp_path / "deck.toml").write_text(text_of_tables({**tables(tissues), **more}))
        text = scenes.explained(tmp_path / "deck.toml", *words)
        blocks = map(int, re.search(r"(\d+) x (\d+) x (\d+) of voxels", text).groups())
        count = int(re.search(r"(\d+) source", text)[1])
        assert count == corners(*blocks)
        explained.said = text
        return count

    return explained


def corners(*blocks: int) -> int:
    """Corners of the blocks of a box."""
    return int(np.prod(np.array(blocks) + 1))


def test_layers_of_fewer_than_four_blocks_take_single_voxels(points) -> None:
    assert points(built(np.ones((8, 16, 16)))) == corners(4, 8, 8)
    assert points(built(np.ones((6, 16, 16)))) == corners(6, 8, 8)
    assert re.search("6 x 8 x 8 of voxels.*single voxels along x", points.said)
    # tissues shear along each other from the held ends on
    assert points(built(layered(16, 16, 16, thick=8)), 2) == corners(8, 8, 8)
    assert points(built(layered(16, 16, 16, thick=4)), 2) == corners(16, 8, 16)


def test_a_little_of_a_tissue_does_not_count(points) -> None:
    filled = np.ones((16, 16, 16), int)
    filled[:1] = 2
    assert points(built(filled), 2) == corners(16, 8, 16)
    filled[:1, 8:] = 1
    assert points(built(filled), 2) == corners(8, 8, 8)


def test_what_somebody_chose_stays(points) -> None:
    cloud = built(np.ones((6, 16, 16)))
    assert points(cloud, build={"source_stride": [2, 2, 2]}) == corners(3, 8, 8)
    assert points(cloud, words=("geometry.blocks=[2,4,5]",)) == corners(2, 4, 5)
    assert "single voxels" not in points.said
    # an override is a choice also where the deck has no [build]
    chosen = "build.source_stride=[2,2,2]"
    assert points(cloud, words=(chosen,)) == corners(3, 8, 8)
    assert points(cloud, build={"ids": [1]}, words=(chosen,)) == corners(3, 8, 8)
    assert points(built(np.ones((6, 16, 16)), stride=4)) == corners(2, 4, 4)
    assert points(built(np.ones((6, 16, 16)), stride=1)) == corners(6, 16, 16)


def test_blocks_become_finer_as_far_as_they_do_not_become_many(points) -> None:
    # along z the rows of a tissue are longer than across its layers: z gives way first
    assert points(built(layered(16, 32, 12, thick=4)), 2) == corners(16, 16, 12)
    assert points(built(layered(16, 32, 24, thick=4)), 2) == corners(16, 16, 12)
    assert points(built(layered(32, 32, 32, thick=4)), 2) == corners(16, 16, 16)
