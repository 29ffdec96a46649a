"""Which material lies where in boxes and annuli, by expressions."""

from typing import Any

import pytest

from tests.scenes import box, loaded, neo, refused, solved

#: Rubbers with no Poisson's ratio at small strains: E = 2 mu, K = 2/3 mu
CORK, OAK = neo(1.0, 2 / 3, "cork"), neo(4.0, 8 / 3, "oak")


def pulled(*material: dict[str, Any]) -> dict[str, Any]:
    """A strip that is pulled with a stress of 1e-4 along x."""
    body, end = box(21, 5, size=[1, 0.2]), {"traction": [1e-4, 0]}
    return loaded("rkpm-gauss", body, material, "x0 x1", end, "end u_x 1 0.1", load={"steps": 1})


def end_of(tables: dict[str, Any]) -> float:
    return next(iter(solved(tables).last().values()))


def test_the_later_material_fills_what_two_hold() -> None:
    one = end_of(pulled(CORK, OAK | {"where": "x > 0.5"}))
    two = end_of(pulled(OAK, CORK | {"where": "x <= 0.5 and r >= 0"}))
    assert two == pytest.approx(one, rel=1e-9)


@pytest.mark.parametrize(("tables", "what"), [
    (pulled(CORK | {"where": "x < 0.5"}), "material.cork.where: no material is given at"),
    (pulled(CORK, OAK), "material.cork.label: missing"),
    (pulled(CORK, OAK | {"where": "x > 2"}), "material.oak.where: no point lies there"),
    (pulled(CORK, OAK | {"where": "x > q"}), "material.oak.where: 'x > q' is not an expressio"),
    (pulled(CORK | {"where": "x < 1"}, OAK), "material.oak.where: missing: only the first"),
    (pulled(CORK | {"label": 1}, OAK | {"where": "x < 1"}), "material.cork.label: cannot be given"),
])  # fmt: skip
def test_what_does_not_fit_is_refused(tables: dict[str, Any], what: str) -> None:
    assert what in refused(tables)
