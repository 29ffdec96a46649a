"""Activation as a field of places, and decks of load programmes: stages, motions, own muscles."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import build, load_deck, run_deck
from myork.core.deck import table_defaults
from myork.errors import InputError
from myork.imaging.geometry import canonical
from myork.model.cloud import build_cloud
from myork.model_file import read_model, write_model
from myork.records import Image, Labels, PointCloud
from tests.scenes import box, gripped, refused, solved, voxels

MUSCLE = {"name": "muscle", "model": "muscle", "A10": 1.0, "K": 200, "fiber": [0, 0, 1]}


def block(material: Any, method: str = "rkpm-gauss", **more: Any) -> dict[str, Any]:
    """Held at both ends, across them free to widen."""
    body = box(5, 5, 5, size=[1, 1, 2], places=(5, 5, 5))
    return gripped(method, body, material, "z0 z1", "pull force_z z1", **more)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
def test_a_constant_field_is_a_number(method: str) -> None:
    """To the last bit: a half of 1 and all of a half."""
    table = [{"name": "flat", "x": [0, 2], "value": [0.3, 0.3]}]
    field = block(MUSCLE | {"activation": "flat(z)"}, method, table=table)
    number = block(MUSCLE | {"activation": 0.3}, method)
    assert np.array_equal(solved(field).states.x, solved(number).states.x)


def bar(share: float | None = None) -> PointCloud:
    """A bar of voxels; one half of them may have a share of the activation, the other none."""
    parts = (
        None if share is None else np.repeat([share, 0.0], 4)[:, None, None] * np.ones((8, 8, 12))
    )
    return voxels(np.ones((8, 8, 12)), 1.25, activation=parts, source_stride=[2] * 3)


def model_tables(method: str = "auto", **material: Any) -> dict[str, Any]:
    return gripped(method, {}, MUSCLE | material, "bottom top", "pull force_z top")


@pytest.mark.slow
def test_points_of_a_model_have_activations(tmp_path: Path) -> None:
    """From an image over the model file to the solve; a constant one keeps the bits of a number."""
    plain = bar()
    number = solved(model_tables(activation=0.3), cloud=plain).states.x
    constant = replace(plain, activation=np.full(len(plain.points), 0.3))
    assert np.array_equal(solved(model_tables(activation=1.0), cloud=constant).states.x, number)

    cloud = bar(0.3)
    assert cloud.activation is not None
    centre = cloud.points[:, 0].mean()
    assert cloud.activation[cloud.points[:, 0] < centre].mean() > 0.25
    assert cloud.activation[cloud.points[:, 0] > centre].mean() < 0.05
    write_model(tmp_path / "model.h5", cloud)
    again = read_model(tmp_path / "model.h5")
    assert np.array_equal(again.activation, cloud.activation)
    found = solved(model_tables(activation=1.0), cloud=again, error=True)
    # a coarser cloud, whose blocks have the mean of theirs, gives it an error bar
    assert np.isfinite(found.bars["pull"][-1, 0])
    whole = solved(model_tables(activation=0.3), cloud=plain).last()["pull"]
    assert found.last()["pull"] == pytest.approx(0.5 * whole, rel=0.1)
    # an expression of the deck stands in the place of the points' own
    field = model_tables(activation="0.3")
    assert np.array_equal(solved(field, cloud=again).states.x, number)


def test_images_on_turned_grids_are_turned() -> None:
    turned = canonical(Labels(np.ones((8, 8, 12), np.int32), np.diag([1.25, 1.25, 1.25, 1.0])))
    half = np.repeat([0.0, 1.0], 4)[:, None, None] * np.ones((8, 8, 12))
    image = Image(half, turned.affine)
    cloud = build_cloud(turned, None, table_defaults("build"), "cm", "", image)[0]
    assert cloud.activation is not None
    assert cloud.activation[cloud.points[:, 0] > cloud.points[:, 0].mean()].mean() > 0.8


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        (block(MUSCLE | {"activation": "1.5*x"}), "must be between 0 and 1"),
        (block(MUSCLE | {"activation": "1/x"}), "is not finite"),
        (block(MUSCLE | {"activation": "x +"}), "is not an expression"),
        (block(MUSCLE | {"activation": "x"}, "rkcm"), "an expression is only for scene.method ="),
    ],
)
def test_fields_that_cannot_be(tables: dict[str, Any], what: str) -> None:
    said = refused(tables)
    assert what in said and "activation" in said


def test_activations_of_points_that_cannot_be() -> None:
    plain = bar()
    n = len(plain.points)
    for method, values, message in (
        ("auto", np.full(3, 0.5), "'activation' has shape (3,), but (768,) is needed"),
        ("auto", np.full(n, 1.5), "'activation' must hold numbers from 0 to 1"),
        ("rkcm", np.full(n, 0.5), "collocation needs their gradients"),
        ("rkcm-mixed", np.full(n, 0.5), "collocation needs their gradients"),
    ):
        tables = model_tables(method, activation=1.0)
        assert message in refused(tables, replace(plain, activation=values))
    with pytest.raises(InputError, match=r"activation must lie between 0 and 1, but is 2"):
        bar(2.0)


def steps(deck: Path, out: Path, *overrides: str) -> dict[str, np.ndarray]:
    """Loads, smallest J and probes of all steps by name."""
    summary = run_deck(deck, out, overrides=overrides, error=False)
    rows = [step | step["probes"] for step in summary["steps"]]
    names = ("load", "min_J", *summary["steps"][0]["probes"])
    return {name: np.array([row[name] for row in rows]) for name in names}


@pytest.mark.slow
def test_two_muscles_share_the_force_of_a_joint(inputs: Path, tmp_path: Path) -> None:
    coarse = ("build.collocation_stride=[2,2,2]", "build.source_stride=[4,4,4]",
              "geometry.blocks=[8,4,6]")  # fmt: skip
    deck = inputs / "two_muscles.toml"
    build(deck, tmp_path, overrides=coarse)
    probe = {"name": "force_tissue", "quantity": "force_z", "set": "top", "material": "tissue"}
    tables = load_deck(deck, overrides=coarse)
    assert [table["name"] for table in tables["material"]] == ["agonist", "antagonist", "tissue"]
    found = steps(deck, tmp_path, *coarse)
    parts = steps(deck, tmp_path, *coarse, f'probe.force_agonist.material="{probe["material"]}"')
    total = found["force_agonist"] + found["force_antagonist"] + parts["force_agonist"]
    np.testing.assert_allclose(total, found["force"], rtol=1e-9)
    # contraction; the plate gives way; contraction of the other
    assert found["load"] == pytest.approx([0.3, 0.7, 1.0])
    agonist, antagonist = found["force_agonist"], found["force_antagonist"]
    assert agonist[0] > agonist[1] > 0
    assert found["stretch_agonist"][1] < found["stretch_agonist"][0] - 0.01
    assert found["stretch_antagonist"][1] > 1.0
    assert antagonist[2] > antagonist[1] + 4
    assert found["torque"][2] < found["torque"][1] < found["torque"][0]
    # what is between the muscles is pressed, not crushed
    assert found["min_J"].min() > 0.6
