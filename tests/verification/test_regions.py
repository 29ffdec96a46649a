"""Which material lies where in boxes and annuli, by expressions."""

from typing import Any

import pytest

from tests.scenes import PLANES, annulus, box, loaded, neo, probes, refused, scene, solved

#: Rubbers with no Poisson's ratio at small strains: E = 2 mu, K = 2/3 mu
CORK, OAK = neo(1.0, 2 / 3, "cork"), neo(4.0, 8 / 3, "oak")


def pulled(*material: dict[str, Any]) -> dict[str, Any]:
    """A strip that is pulled with a stress of 1e-4 along x."""
    body, end = box(21, 5, size=[1, 0.2]), {"traction": [1e-4, 0]}
    return loaded("rkpm-gauss", body, material, "x0 x1", end, "end u_x 1 0.1", load={"steps": 1})


def end_of(tables: dict[str, Any]) -> float:
    return next(iter(solved(tables).last().values()))


@pytest.mark.parametrize("border", [0.3, 0.37, 0.5])
def test_two_bodies_that_share_a_face_give_way_one_after_the_other(border: float) -> None:
    """Also where the border lies between the points."""
    found = end_of(pulled(CORK, OAK | {"where": f"x > {border}"}))
    assert found == pytest.approx(1e-4 * (border / 2 + (1 - border) / 8), rel=0.04)


def test_the_later_material_fills_what_two_hold() -> None:
    one = end_of(pulled(CORK, OAK | {"where": "x > 0.5"}))
    two = end_of(pulled(OAK, CORK | {"where": "x <= 0.5 and r >= 0"}))
    assert two == pytest.approx(one, rel=1e-9)


def test_a_stiff_lining_of_a_tube_holds_the_inner_wall_back() -> None:
    tables = scene(
        "auto", annulus(9, 9, radii=(1, 2)), material=[CORK],
        boundary=[*PLANES[:2], {"set": "outer", "traction": ["1e-4*x/r", "1e-4*y/r"]}],
        probe=probes("wall u_x 1 0"),
    )  # fmt: skip
    plain = end_of(tables)
    tables["material"] = [CORK, OAK | {"where": "r < 1.3"}]
    assert 0 < end_of(tables) < 0.7 * plain


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        (pulled(CORK | {"where": "x < 0.5"}), "material.cork.where: no material is given at"),
        (pulled(CORK, OAK), "material.cork.label: missing"),
        (pulled(CORK, OAK | {"where": "x > 2"}), "material.oak.where: no point lies there"),
        (pulled(CORK, OAK | {"where": "x > q"}), "material.oak.where: 'x > q' is not an expressio"),
        (pulled(CORK | {"where": "x < 1"}, OAK), "material.oak.where: missing, only the first"),
        (pulled(CORK | {"label": 1}, OAK | {"where": "x < 1"}),
         "material.cork.label: cannot be given"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(tables: dict[str, Any], what: str) -> None:
    assert what in refused(tables)
