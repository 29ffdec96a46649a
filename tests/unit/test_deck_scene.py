"""What follows from a deck once its points are there: complaints with their lines, derived values.

The form of a deck is tested in test_deck.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from myork import Results, Scene, run_deck
from myork.errors import InputError
from tests.scenes import annulus, scene

#: The tests below change lines of it; lines count from 1
BLOCK = """\
title = "block"
units = {force = "N", length = "cm"}
[scene]
dimension = 3
method = "rkcm"
[geometry]
kind = "box"
size = [1, 1, 2]
source = [3, 3, 5]
collocation = [4, 4, 7]
[[material]]
name = "muscle"
model = "muscle"
A10 = 6.43
K = 5000
fiber = [0, 0, 1]
[[boundary]]
set = "z0"
u_x = 0
u_y = 0
u_z = 0
[[boundary]]
set = "z1"
traction = [0, 0, 2.5]
[load]
steps = 2
activation = 0.01
[[probe]]
name = "mid"
quantity = "cauchy_zz"
point = [0.5, 0.5, 1]
[[probe]]
name = "pull"
quantity = "force"
set = "z0"
[[reference]]
probe = "mid"
activation = [0.005, 0.01]
value = [1, 2]
source = "nobody"
"""
#: Collocation locks in this block, which is refused
RIGHT = ("scene.method=rkpm-gauss", "approximation.order=1", "approximation.support=2")
SIDES = "is not a side of this box; there are x0, x1, y0, y1, z0, z1"

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Write a deck and stand beside it, so that messages start with the short name."""
    monkeypatch.chdir(tmp_path)

    def write_deck(text: str) -> Path:
        path = Path("case.toml")
        path.write_text(text)
        return path

    return write_deck


def complaints(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        Scene(path, overrides)
    return str(caught.value).splitlines()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('set = "z1"', 'set = "z3"', f"boundary.z3.set: 'z3' {SIDES}"),
        ('set = "z1"', 'u_x = 1\nset = "top"', f"boundary.top.set: 'top' {SIDES}"),
        ("point = [0.5, 0.5, 1]", "point = [2, 0, 0]", "probe.mid.point: (2, 0, 0) lies outside "),
        ("point = [0.5, 0.5, 1]", "point = [0, 0, -0.1]", "probe.mid.point: (0, 0, -0.1) lies out"),
    ],
)
def test_wrong_line(write: Write, old: str, new: str, message: str) -> None:
    """One complaint, at the last of the lines that replace a good one."""
    assert BLOCK.count(f"{old}\n") == 1
    number = BLOCK.splitlines().index(old) + 1 + new.count("\n")
    lines = complaints(write(BLOCK.replace(f"{old}\n", f"{new}\n")))
    assert len(lines) == 1, lines
    assert lines[0].startswith(f"case.toml:{number}: {message}")


def test_points_on_the_surface_are_inside(write: Write) -> None:
    path = write(BLOCK)
    for point in ("[0,0,0]", "[1,1,2]", "[1,0,2.000000001]"):
        Scene(path, [f"probe.mid.point={point}"]).close()


def test_a_muscle_needs_a_direction(write: Write) -> None:
    lines = complaints(write(BLOCK.replace("fiber = [0, 0, 1]\n", "")))
    assert len(lines) == 1, lines
    assert lines[0].startswith("case.toml:11: material.muscle.fiber: missing, collocation point 1 ")
    assert "give fiber or fiber_angle" in lines[0]


def test_all_complaints_at_once(write: Write) -> None:
    text = BLOCK.replace('set = "z1"', 'set = "z3"').replace("[0.5, 0.5, 1]", "[0, 0, 3]")
    lines = complaints(write(text), "probe.pull.set=left")
    assert [line.split(": ")[:2] for line in lines] == [
        ["case.toml:23", "boundary.z3.set"],
        ["case.toml:31", "probe.mid.point"],
        ["--set probe.pull.set=left", "probe.pull.set"],
    ]


def test_a_body_that_nothing_holds(write: Write) -> None:
    text = BLOCK.replace("u_x = 0\nu_y = 0\nu_z = 0\n", "traction = [0, 0, 0]\n")
    (line,) = complaints(write(text))
    assert "no displacement is prescribed on the body" in line and "can move freely" in line


def test_annulus(inputs: Path) -> None:
    """Sides and points of an annulus."""
    for override, message in {
        "probe.radial_stress.point=[1,1]": "probe.radial_stress.point: (1, 1) lies outside the ann",
        "probe.radial_stress.point=[-0.1,7]": "(-0.1, 7) lies outside the annulus",
        "boundary.inner.set=z0": "'z0' is not a side of this annulus; there are inner, outer, x0",
    }.items():
        assert any(message in line for line in complaints(inputs / "tube.toml", override)), override


def test_radial_displacements_are_for_round_sides() -> None:
    tables = scene(
        "auto", annulus(3, 5, radii=(1, 2)),
        material=[{"name": "rubber", "model": "neo-hookean", "mu": 1, "K": 10}],
        boundary=[{"set": "outer", "radial": 1}, {"set": "y0", "radial": 1}],
    )  # fmt: skip
    message = "^tables: boundary.y0.radial: only on the sets inner and outer$"
    with pytest.raises(InputError, match=message):
        Scene.from_tables(tables)


def test_fiber_angle_gives_the_fiber(write: Write, tmp_path: Path) -> None:
    """From the last axis towards x, in the deck's own words."""
    run_deck(
        write(BLOCK.replace("fiber = [0, 0, 1]", "fiber_angle = 30")),
        tmp_path / "out",
        overrides=["load.steps=1", *RIGHT],
        verbosity=-1,
    )
    with Results(tmp_path / "out") as results:
        fiber = results.fiber
    np.testing.assert_allclose(fiber, np.broadcast_to([0.5, 0, 0.75**0.5], fiber.shape), 1e-6)


@pytest.mark.parametrize(("full", "loads"), [(0.01, [0.5, 1.0]), (0.005, [1.0]), (0.0, [])])
def test_activations_of_references_become_loads(
    write: Write, tmp_path: Path, full: float, loads: list[float]
) -> None:
    """Those that the run meets are compared; without activation it meets none."""
    overrides = [f"load.activation={full}", *RIGHT]
    summary = run_deck(write(BLOCK), tmp_path / "out", overrides=overrides, verbosity=-1)
    assert summary["reference"].get("mid", {}).get("load", []) == pytest.approx(loads)
