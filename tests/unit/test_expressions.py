"""Conditions as expressions in coordinates: what they give, what is said of wrong ones."""

from typing import Any

import numpy as np
import pytest

from tests.scenes import box, refused, scene, solved


def plate(boundary: list[dict[str, Any]], **other: Any) -> dict[str, Any]:
    """Tables of a small plate, of one compressible rubber, with a probe at its middle."""
    return scene(
        "rkpm-gauss", box(6, 6), boundary=boundary, title="plate",
        material=[{"name": "rubber", "model": "neo-hookean", "mu": 1.0, "K": 10.0}],
        probe=[{"name": "middle", "quantity": "u", "point": [0.5, 0.5]}],
    ) | other  # fmt: skip


def probes_of(tables: dict[str, Any], *overrides: str) -> np.ndarray:
    """Last values of the probes, shape (probes, 3)."""
    return np.array([value[-1] for value in solved(tables, *overrides).probes.values()])


def probe_of(tables: dict[str, Any], *overrides: str) -> np.ndarray:
    """The displacement in the middle, shape (2,)."""
    return probes_of(tables, *overrides)[0, :2]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.01", 0.01),
        ("0.01*sin(pi/2)", 0.01),
        ("x > 0.5 and not(x < 0.5) ? 0.01 : 7", 0.01),
        ("0.01*(r >= 1)*(theta >= 0 or 0)", 0.01),
        ("0.1*sqrt(0.1^2)", 0.01),
    ],
)
def test_expressions_that_are_a_number(text: str, value: float) -> None:
    """On x = 1 all of these are the same number, and so are the answers."""
    held = {"set": "x0", "u_x": 0, "u_y": 0}
    plain = probe_of(plate([held, {"set": "x1", "u_x": value}]))
    assert probe_of(plate([held, {"set": "x1", "u_x": text}])) == pytest.approx(plain, rel=1e-12)


def test_eccentric_traction_bends() -> None:
    """A traction that is odd about the axis has no resultant, and turns the end."""
    held = {"set": "x0", "u_x": 0, "u_y": 0}
    tables = plate([held, {"set": "x1", "traction": ["0.1*(0.5 - y)", 0]}])
    tables["probe"] = [
        {"name": "pull", "quantity": "force_x", "set": "x1"},
        {"name": "low", "quantity": "u_x", "point": [1, 0]},
        {"name": "high", "quantity": "u_x", "point": [1, 1]},
    ]
    pull, low, high = probes_of(tables)[:, 0]
    assert abs(pull) < 1e-12
    assert low > 1e-3 > -1e-3 > high


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("0.1*q", "unknown name 'q' at position 5; names are x, y, r, theta, pi; functions are"),
        ("z", "unknown name 'z' at position 1"),
        ("t", "unknown name 't' at position 1"),
        ("nx", "unknown name 'nx' at position 1"),
        ("sin(3*)", "unexpected ')' at position 7"),
        ("x**2", "unexpected '*' at position 3; a power is written x^2"),
        ("x = 2", "= sets a value at position 3, == compares"),
        ("sin(x", "a parenthesis is not closed"),
        ("1 +", "it ends where a value is missing"),
        ("x, y", "several values with commas"),
        ('"x"', "a text in quotes at position 1"),
        ("1/x", "'1/x' is not finite at (0, 0)"),
    ],
)
def test_what_is_no_expression_is_told_with_its_place(text: str, what: str) -> None:
    said = refused(plate([{"set": "x0", "u_x": 0, "u_y": text}]))
    assert "boundary.x0.u_y: " in said and what in said
    if what.startswith("unknown name"):
        # an item of an array is named by its number
        said = refused(plate([{"set": "x0", "traction": [1, text]}]))
        assert f"traction: item 2, '{text}' is not an expression" in said


def test_items_that_are_neither_numbers_nor_texts() -> None:
    said = refused(plate([{"set": "x0", "traction": [1, True]}]))
    assert "item 2 must be a number or an expression, not true" in said


def test_overrides_may_be_expressions() -> None:
    tables = plate([{"set": "x0", "u_x": 0, "u_y": 0}, {"set": "x1", "u_x": 1}])
    found = probe_of(tables, "boundary.x1.u_x=0.01*x")
    assert found == pytest.approx(probe_of(tables, "boundary.x1.u_x=0.01"), rel=1e-12)
