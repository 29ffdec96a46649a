"""Decks that name no method, order, support, curve or load steps: all of them converge."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork import run_deck
from myork.bench import materials
from myork.core.deck import load_deck, text_of_tables
from myork.model_file import write_model
from myork.records import PointCloud
from tests import scenes
from tests.scenes import PLANES, RUBBER, annulus, beam, box, gripped, neo, scene, solved, voxels

SOFT = neo(2.0, 6.0, "soft")
#: The rubber of the reference, table 5.1, nearly incompressible
STIFF = {**RUBBER, "name": "stiff", "K": 1e5}
MUSCLE = {**materials.MUSCLE, "K": 5e3}


def cube(points: int, material: Any = RUBBER, *wanted: str, **geometry: float) -> dict[str, Any]:
    """A cube between glued plates, 30 % shorter."""
    return gripped("auto", box(*[points] * 3, **geometry), material, "z0 z1", *wanted, u_z=-0.3)


def sheet(material: dict[str, Any]) -> dict[str, Any]:
    return gripped("auto", box(9, 5, size=[2, 1]), material, "x0 x1", u_x=1.0)


#: Tables and the method that they get
DECKS: dict[str, tuple[dict[str, Any], str]] = {
    "soft sheet": (sheet(SOFT), "rkpm-gauss"),
    "stiff sheet": (sheet(STIFF), "rkpm-gauss"),
    "soft cube": (cube(5, SOFT), "rkpm-gauss"),
    "stiff cube": (cube(5, STIFF), "rkpm-gauss"),
    "stiff cube, even number of points": (cube(6, STIFF), "rkpm-gauss"),
    "cube of nodal cells": (cube(5) | {"scene": {"dimension": 3, "method": "rkpm"}}, "rkpm-scni"),
    "tube": (
        scene("auto", annulus(5, 15), material=[STIFF],
              boundary=[*PLANES[:2], {"set": "inner", "radial": 4}]), "rkpm-gauss",
    ),
    "beam": (beam(17, 5), "rkpm-gauss"),
    "beam far beyond its length": (beam(17, 5, load=20.0), "rkpm-gauss"),
    "muscle": (
        gripped("auto", box(4, 4, 7, size=[1, 1, 2]), {**MUSCLE, "fiber_angle": 30}, "z0 z1",
                load={"activation": 0.3}), "rkpm-gauss",
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", DECKS)
def test_one_load_step_ends_where_eight_do(name: str) -> None:
    """Elastic bodies do not know the way; step and gradient end at 1e-6 of the first ones."""
    tables, method = DECKS[name]
    deck = load_deck(tables)
    assert deck["scene"]["method"] == method and deck["load"]["steps"] == 1
    states = solved(tables, error=True).states
    slow = {**tables, "load": {**tables.get("load", {}), "steps": 8}}
    wanted = solved(slow).states.x[-1]
    assert len(states.x) == 1 and states.load[-1] == 1.0
    assert_allclose(states.x[-1], wanted, rtol=0, atol=1e-5 * np.abs(wanted).max())
    assert states.force_imbalance < 1e-8


def test_slow_iterations_of_a_hard_load_arrive() -> None:
    """A sheet sheared by 1.5 takes 17 iterations: without a halving left they are let run."""
    body, load = box(17, 9, size=[2, 1]), {"max_halvings": 0}
    states = solved(gripped("auto", body, RUBBER, "y0 y1", u_x=1.5, load=load)).states
    assert states.load[-1] == 1.0 and states.iterations.sum() > 10


def test_halved_steps_are_reported_and_given_up_early(tmp_path: Path) -> None:
    """Three load steps of 25 iterations failed before one of an eighth of the load arrived: 103."""
    summary = run_deck(beam(17, 5, load=20.0), tmp_path / "out", threads=1, verbosity=-1)
    assert [step["load"] for step in summary["steps"] if step["load"] > 0] == [1.0]
    assert sum(step["iterations"] for step in summary["steps"]) < 60
    lines = (tmp_path / "out" / "run.log").read_text(encoding="utf-8").splitlines()
    said = [line for line in lines if "the load step is halved to" in line]
    assert said and all(line.startswith("  load ") for line in said)
    assert not any("halved" in text for text in summary["warnings"])


# ---- blocks of voxels that nobody chose: finer across thin layers --------------------------------


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
