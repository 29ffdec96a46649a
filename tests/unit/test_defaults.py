"""Defaults of a deck without method, order, support, load steps or blocks of voxels."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork.core.deck import load_deck, text_of_tables
from myork.model_file import write_model
from myork.records import PointCloud
from tests import scenes
from tests.scenes import annulus, box, contracting, held, probes, scene, solved, voxels

#: Tables of small bodies, and the form chosen by default
RUBBER = {"name": "rubber", "model": "polynomial", "A10": 10.0, "K": 500.0}
SHEET = scene("auto", box(5, 3, size=[2, 1]), material=[RUBBER], boundary=[held("y0", 2)])
del SHEET["scene"]["method"]
ANNULUS = annulus(5, 9, radii=(1, 2))
#: A point inside the sheet
_WITHIN = [0.5, 0.5]


@pytest.mark.parametrize(("tables", "method"), [
    ({}, "rkpm-gauss"),
    ({"scene": {"dimension": 2, "method": "auto"}}, "rkpm-gauss"),
    ({"scene": {"dimension": 2, "method": "rkpm"}}, "rkpm-scni"),
    ({"scene": {"dimension": 2, "method": "rkcm"}}, "rkcm"),
    ({"geometry": ANNULUS}, "rkpm-gauss"),
    ({"scene": {"dimension": 3}, "geometry": {"kind": "model"}}, "rkpm-gauss"),
    ({"material": [{**RUBBER, "K": float("inf")}]}, "rkpm-gauss"),
    ({"material": [{**RUBBER, "K": 1e7}]}, "rkpm-gauss"),
])  # fmt: skip
def test_the_form_that_auto_takes(tables: dict[str, Any], method: str) -> None:
    """Linear problems: test_linear.test_patch."""
    assert load_deck({**SHEET, **tables})["scene"]["method"] == method


@pytest.mark.parametrize(("change", "essential"), [
    ({}, "transformation"), ({"galerkin": {"gauss": 3}}, "transformation"),
    *((change, "penalty") for change in (
        {"probe": []}, {"geometry": SHEET["geometry"]}, {"galerkin": {"penalty": 50.0}},
        {"galerkin": {"direct_limit": 0}},
        {"boundary": [held("y0", 2), {"set": "y1", "pressure": 1.0}]},
        {"boundary": [held("y0", 2), {"set": "part", "u_x": 0.1}],
         "set": [{"name": "part", "side": "y1", "where": "x < 1"}]},
    )),
])  # fmt: skip
def test_a_search_holds_displacements_exactly(change: dict[str, Any], essential: str) -> None:
    free = {**SHEET, "geometry": {"kind": "box", "size": [2, 1]}, "probe": probes("tip u_y 1 1")}
    assert load_deck({**free, **change})["galerkin"]["essential"] == essential


@pytest.mark.parametrize(("size", "source"), [
    ([1, 1, 1], [7, 7, 7]), ([10, 1, 1], [25, 7, 7]), ([3, 3, 1], [13, 13, 7]),
    ([2, 1, 0.2], [17, 9, 7]), ([2, 1], [17, 9]), ([40, 1], [65, 9]),
])  # fmt: skip
def test_points_where_a_search_begins(size: list[float], source: list[int]) -> None:
    """A plate gets no more of them in total than a bar."""
    tables = {"scene": {"dimension": len(size)}, "geometry": {"kind": "box", "size": size}}
    tables["boundary"] = [held("y0", len(size))]
    assert load_deck({**SHEET, **tables})["geometry"]["source"] == source


@pytest.mark.parametrize(("where", "steps"), [
    ({"load": [0.5, 1.0]}, 10), ({"load": [1.0]}, 1), ({"activation": [0.2]}, 10),
])  # fmt: skip
def test_references_on_the_way_ask_for_steps(where: dict[str, Any], steps: int) -> None:
    reference = {"probe": "there", "source": "nobody", **where}
    reference["value"] = [0.0] * len(next(iter(where.values())))
    tables = probed("u_x", _WITHIN, reference=[reference], load={"activation": 0.4})
    assert load_deck({**SHEET, **tables})["load"]["steps"] == steps


def probed(quantity: str, point: list[float], **tables: Any) -> dict[str, Any]:
    return tables | {"probe": [{"name": "there", "quantity": quantity, "point": point}]}


#: Defaults of a form for order 1 and for order 2
FIRST, SECOND = {"order": 1, "support": 2.0}, {"order": 2, "support": 3.0}
#: Narrower supports leave oscillations at walls that meet a plane of symmetry. On annuli windows
#: turn with the angle, and a large penalty would corrupt the force.
WIDE = SECOND | {"kernel": "quintic", "gauss": 2, "window": "product", "penalty": 100.0}
TURNED = WIDE | {"window": "polar", "penalty": 10.0}
NARROW = WIDE | {"kernel": "cubic"}
WALL = ("cauchy_xx", [0.0, 1.0])


@pytest.mark.parametrize(("tables", "wanted"), [
    # a support that suits the order
    *(({"approximation": {"order": n}}, {"order": n, "support": n + 1.0}) for n in range(1, 5)),
    (probed(*WALL), FIRST),
    (probed(*WALL, approximation={"support": 1.8}), FIRST | {"support": 1.8}),
    (probed(*WALL, scene={"dimension": 2, "method": "rkcm"}), SECOND),
    (probed(*WALL, scene={"dimension": 2, "method": "rkpm-scni"}), FIRST),
    # annuli have order 2 if they have enough points
    (probed("u_x", [0.9, 1.2], geometry={**ANNULUS, "source": [2, 9]}), FIRST),
    # with a spline and Gauss points for it
    (probed(*WALL, approximation={"order": 2}), WIDE),
    (probed(*WALL, geometry=ANNULUS), TURNED),
    (probed(*WALL, geometry=ANNULUS, approximation={"order": 2}), TURNED),
    (probed(*WALL, geometry=ANNULUS, approximation={"order": 2, "support": 2.5}),
     NARROW | {"support": 2.5}),
    (probed(*WALL, geometry=ANNULUS, approximation={"order": 1}), NARROW | FIRST),
])  # fmt: skip
def test_approximation_by_what_is_asked(tables: dict[str, Any], wanted: dict[str, Any]) -> None:
    deck = load_deck({**SHEET, **tables})
    (support,) = set(deck["approximation"]["support"])
    found = {**deck["galerkin"], **deck["approximation"], "support": support}
    assert {key: found[key] for key in wanted} == wanted


@pytest.mark.parametrize(("units", "given", "warned"), [
    (("N", "mm"), False, True), (("N", "mm"), True, False), (("N", "cm"), False, False),
    (("kN", "cm"), False, True),
])  # fmt: skip
def test_the_default_stress_of_muscle_is_in_other_units(
    units: tuple[str, str], given: bool, warned: bool
) -> None:
    """30 N/cm^2 is 0.3 N/mm^2, and the default is a number without a unit."""
    block = contracting(3, 3, 5, load={"activation": 0.1})
    block["units"] = dict(zip(("force", "length"), units, strict=True))
    if not given:
        del block["material"][0]["sigma_max"]
    said = [text for text in solved(block).states.warnings if "sigma_max is the default" in text]
    assert len(said) == warned
    if said:
        assert f"30 N/cm^2, but its unit in this deck is {units[0]}/{units[1]}^2" in said[0]


# ---- default blocks of voxels: finer across thin layers ------------------------------------------


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
    """Source points of a model (the corners of its blocks) by `myork explain`."""

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
    """Number of corners of the blocks of a box."""
    return int(np.prod(np.array(blocks) + 1))


def test_layers_of_fewer_than_four_blocks_take_single_voxels(points) -> None:
    assert points(built(np.ones((8, 16, 16)))) == corners(4, 8, 8)
    assert points(built(np.ones((6, 16, 16)))) == corners(6, 8, 8)
    assert re.search("6 x 8 x 8 of voxels.*single voxels along x", points.said)
    # tissues shear along each other from the fixed ends on
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
    # an override is a choice even if the deck has no [build]
    chosen = "build.source_stride=[2,2,2]"
    assert points(cloud, words=(chosen,)) == corners(3, 8, 8)
    assert points(cloud, build={"ids": [1]}, words=(chosen,)) == corners(3, 8, 8)
    assert points(built(np.ones((6, 16, 16)), stride=4)) == corners(2, 4, 4)
    assert points(built(np.ones((6, 16, 16)), stride=1)) == corners(6, 16, 16)


def test_blocks_become_finer_as_far_as_they_do_not_become_many(points) -> None:
    # along z the rows of a tissue are longer than across its layers: z is coarsened first
    assert points(built(layered(16, 32, 12, thick=4)), 2) == corners(16, 16, 12)
    assert points(built(layered(16, 32, 24, thick=4)), 2) == corners(16, 16, 12)
    assert points(built(layered(32, 32, 32, thick=4)), 2) == corners(16, 16, 16)
