"""Expressions in coordinates: what they give, what is refused."""

from typing import Any

import numpy as np
import pytest

from tests.scenes import box, held, probes, refused, scene, solved

#: The left side at rest
HELD = held("x0", 2)


def plate(boundary: list[dict[str, Any]], **other: Any) -> dict[str, Any]:
    """Tables of a small plate, of one compressible rubber, with a probe at its middle."""
    return scene(
        "rkpm-gauss", box(6, 6), boundary=boundary, title="plate",
        material=[{"name": "rubber", "model": "neo-hookean", "mu": 1.0, "K": 10.0}],
        probe=probes("middle u 0.5 0.5"),
    ) | other  # fmt: skip


def probe_of(tables: dict[str, Any], *overrides: str) -> np.ndarray:
    """The displacement in the middle, shape (2,)."""
    return solved(tables, *overrides).probes["middle"][-1, :2]


@pytest.mark.parametrize("text", [
    "0.01", "0.01*sin(pi/2)", "x > 0.5 and not(x < 0.5) ? 0.01 : 7",
    "0.01*(r >= 1)*(theta >= 0 or 0)", "0.1*sqrt(0.1^2)",
])  # fmt: skip
def test_expressions_that_are_a_number(text: str) -> None:
    """On x = 1 all of these are the same number, and so are the answers, also of an override."""
    plain = probe_of(plate([HELD, {"set": "x1", "u_x": 0.01}]))
    for written, overrides in ((text, ()), (1, (f"boundary.x1.u_x={text}",))):
        tables = plate([HELD, {"set": "x1", "u_x": written}])
        assert probe_of(tables, *overrides) == pytest.approx(plain, rel=1e-12)


@pytest.mark.parametrize(("text", "what"), [
    ("0.1*q", "\"q\" found at position 4. Names are x, y, r, theta, pi; functions are"),
    ("z", "\"z\" found"),
    ("nx", "\"nx\" found"),
    ("sin(3*)", "Unexpected parenthesis"),
    ("x**2", "Unexpected operator"),
    ("x = 2", "= sets a value at position 2, == compares"),
    ("1 +", "Unexpected end of expression"),
    ("x, y", "several values with commas"),
    ('"x"', "a text in quotes at position 0"),
    ("1/x", "'1/x' is not finite at (0, 0)"),
])  # fmt: skip
def test_what_is_no_expression_is_told_with_its_place(text: str, what: str) -> None:
    said = refused(plate([{"set": "x0", "u_x": 0, "u_y": text}]))
    assert "boundary.x0.u_y: " in said and what in said
    if "found" in what:
        # an item of an array is named by its number
        said = refused(plate([{"set": "x0", "traction": [1, text]}]))
        assert f"traction: item 2, '{text}' is not an expression" in said


def test_items_that_are_neither_numbers_nor_texts() -> None:
    said = refused(plate([{"set": "x0", "traction": [1, True]}]))
    assert "item 2 must be a number or an expression, not true" in said
