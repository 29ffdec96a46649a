"""Expressions in coordinates and tables as functions in them: what they give, what is refused."""

from typing import Any

import numpy as np
import pytest

from myork import Scene
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
    ("0.1*q", "unknown name 'q' at position 5; names are x, y, r, theta, pi; functions are"),
    ("z", "unknown name 'z' at position 1"),
    ("nx", "unknown name 'nx' at position 1"),
    ("sin(3*)", "unexpected ')' at position 7"),
    ("x**2", "unexpected '*' at position 3; a power is written x^2"),
    ("x = 2", "= sets a value at position 3, == compares"),
    ("1 +", "it ends where a value is missing"),
    ("x, y", "several values with commas"),
    ('"x"', "a text in quotes at position 1"),
    ("1/x", "'1/x' is not finite at (0, 0)"),
])  # fmt: skip
def test_what_is_no_expression_is_told_with_its_place(text: str, what: str) -> None:
    said = refused(plate([{"set": "x0", "u_x": 0, "u_y": text}]))
    assert "boundary.x0.u_y: " in said and what in said
    if what.startswith("unknown name"):
        # an item of an array is named by its number
        said = refused(plate([{"set": "x0", "traction": [1, text]}]))
        assert f"traction: item 2, '{text}' is not an expression" in said


def heat(**tables: Any) -> dict[str, Any]:
    """A rod of length 1 by Gauss points, its temperature 0 at the left end."""
    return scene(
        "auto", box(11, places=(11,)), linear={"problem": "poisson"},
        boundary=[{"set": "x0", "u": 0}, {"set": "x1", "flux": 1}],
        probe=[{"name": "u", "quantity": "u", "point": [1]}],
    ) | tables  # fmt: skip


STEP = {"name": "k", "x": [0, 0.5, 1], "value": [1, 1, 3]}
BY_TABLE = {"problem": "poisson", "conductivity": "k(x)"}


def temperature(**tables: Any) -> float:
    """At the right end of the rod."""
    return solved(heat(**tables)).last()["u"]


def test_a_table_is_the_expression_that_it_samples() -> None:
    """Straight parts and smooth ones against the same by arithmetic, to rounding."""
    t, plain = "((x - 0.5)/0.5)", {"problem": "poisson"}
    smooth = f"{t}^3*(10 - 15*{t} + 6*{t}^2)"
    for curve, rise in (("linear", t), ("smooth", smooth)):
        own = {**plain, "source": "2*k(x) - k(x - 5) + k(9)"}
        found = temperature(linear=own, table=[STEP | {"curve": curve}])
        wanted = temperature(linear={**plain, "source": f"2 + (x > 0.5 ? 4*{rise} : 0) + 2"})
        assert found == pytest.approx(wanted, rel=1e-12)


def test_a_pulse_by_table_of_the_time() -> None:
    """A bar that is pushed at one end: sums, products and the time go into tables as well."""
    tables = heat(
        geometry=box(21, places=(21,)),
        linear={"problem": "elasticity", "E": 1},
        dynamics={"density": 1, "time_step": 0.01, "end_time": 0.5, "every": 50},
        boundary=[{"set": "x0", "u_x": 0}, {"set": "x1", "traction": ["pulse(2*t)"]}],
        table=[{"name": "pulse", "x": [0, 0.5, 1], "value": [0, 1, 0]}],
        probe=[{"name": "u", "quantity": "u_x", "point": [0.5]}],
    )
    own = solved(tables).last()["u"]
    tables["boundary"][1] = {"set": "x1", "traction": ["t < 0.25 ? 4*t : 2 - 4*t"]}
    assert own == pytest.approx(solved(tables).last()["u"], rel=1e-12)


def test_tables_of_two_scenes_with_one_name() -> None:
    """Each has its own, also while both are open."""
    one = heat(linear=BY_TABLE, table=[STEP])
    two = heat(linear=BY_TABLE, table=[STEP | {"value": [4, 4, 12]}])
    with Scene.from_tables(one) as first, Scene.from_tables(two) as second:
        found = [solved(opened).last()["u"] for opened in (first, second)]
    assert found[0] == pytest.approx(4 * found[1], rel=1e-9)
    # items that are neither numbers nor texts
    said = refused(plate([{"set": "x0", "traction": [1, True]}]))
    assert "item 2 must be a number or an expression, not true" in said


@pytest.mark.parametrize(("table", "what"), [
    ({"name": "k", "x": [0, 0], "value": [1, 2]}, "must increase: item 2, 0, follows 0"),
    ({"name": "sin", "x": [0], "value": [1]}, "is already used in expressions"),
    ({"name": "2k", "x": [0], "value": [1]}, "must consist of letters, digits and _"),
    ({"name": "other", "x": [0], "value": [1]}, "unknown name 'k'"),
])  # fmt: skip
def test_tables_that_cannot_be(table: dict[str, Any], what: str) -> None:
    assert what in refused(heat(linear=BY_TABLE, table=[table]))


@pytest.mark.parametrize("text", ["k", "k(x, 1)", "rk_table(0, x)", "k()", "kk(x)"])
def test_calls_that_cannot_be(text: str) -> None:
    linear = BY_TABLE | {"conductivity": text}
    assert "is not an expression" in refused(heat(linear=linear, table=[STEP]))
