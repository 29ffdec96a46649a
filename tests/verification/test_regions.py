"""Materials in parts of boxes and annuli: two bodies that share a face."""

from typing import Any

import pytest

from myork.core.deck import load_deck
from myork.errors import InputError
from tests.scenes import annulus, box, held, refused, scene, solved

#: Rubbers with no Poisson's ratio at small strains: E = 2 mu, K = 2/3 mu
SOFT = {"name": "soft", "model": "neo-hookean", "mu": 1.0, "K": 2 / 3}
STIFF = {"name": "stiff", "model": "neo-hookean", "mu": 4.0, "K": 8 / 3}


def pulled(material: list[dict[str, Any]], method: str = "rkpm-gauss") -> dict[str, Any]:
    """A strip that is pulled with a stress of 1e-4 along x."""
    return scene(
        method, box(21, 5, size=[1, 0.2]), material=material, load={"steps": 1},
        boundary=[held("x0", 2), {"set": "x1", "traction": [1e-4, 0]}],
        probe=[{"name": "end", "quantity": "u_x", "point": [1, 0.1]}],
    )  # fmt: skip


def end_of(tables: dict[str, Any]) -> float:
    return next(iter(solved(tables).last().values()))


@pytest.mark.parametrize("border", [0.3, 0.37, 0.5])
def test_two_bodies_that_share_a_face_give_way_one_after_the_other(border: float) -> None:
    """Also where the border lies between the points."""
    found = end_of(pulled([SOFT, STIFF | {"where": f"x > {border}"}]))
    assert found == pytest.approx(1e-4 * (border / 2 + (1 - border) / 8), rel=0.04)


def test_side_by_side_they_share_the_load() -> None:
    found = end_of(pulled([SOFT, STIFF | {"where": "y < 0.1"}]))
    # the strip bends towards the soft half, which its middle does not feel
    assert 1e-4 / 8 < found < 1e-4 / 2


def test_the_later_material_fills_what_two_hold() -> None:
    one = end_of(pulled([SOFT, STIFF | {"where": "x > 0.5"}]))
    two = end_of(pulled([STIFF, SOFT | {"where": "x <= 0.5 and r >= 0"}]))
    assert two == pytest.approx(one, rel=1e-9)


def test_annulus() -> None:
    """A stiff lining of a tube holds the inner wall back."""
    tables = scene(
        "auto", annulus(9, 9, radii=(1, 2)), material=[SOFT],
        boundary=[
            {"set": "x0", "u_x": 0},
            {"set": "y0", "u_y": 0},
            {"set": "outer", "traction": ["1e-4*x/r", "1e-4*y/r"]},
        ],
        probe=[{"name": "wall", "quantity": "u_x", "point": [1, 0]}],
    )  # fmt: skip
    plain = end_of(tables)
    tables["material"] = [SOFT, STIFF | {"where": "r < 1.3"}]
    assert 0 < end_of(tables) < 0.7 * plain


@pytest.mark.parametrize(
    ("material", "what"),
    [
        ([SOFT | {"where": "x < 0.5"}], "material.soft.where: no material is given at"),
        ([SOFT, STIFF], "material.soft.label: missing"),
        ([SOFT, STIFF | {"where": "x > 2"}], "material.stiff.where: no point lies there"),
        ([SOFT, STIFF | {"where": "x > q"}], "material.stiff.where: 'x > q' is not an expression"),
        ([SOFT | {"where": "x < 1"}, STIFF], "material.stiff.where: missing, only the first"),
        ([SOFT | {"label": 1}, STIFF | {"where": "x < 1"}], "material.soft.label: cannot be given"),
    ],
)
def test_what_does_not_fit_is_refused(material: list[dict[str, Any]], what: str) -> None:
    assert what in refused(pulled(material))


def test_models_have_labels() -> None:
    tables = pulled([SOFT | {"where": "x < 1"}])
    tables["geometry"] = {"kind": "model"}
    with pytest.raises(InputError, match="where: only for geometry.kind = box or annulus"):
        load_deck(tables)
