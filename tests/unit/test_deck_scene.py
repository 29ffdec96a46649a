"""What follows from a deck once its points are there: complaints with their lines, derived values.

The form of a deck is tested in test_deck.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import Results, Scene, run_deck
from myork.errors import InputError
from tests.scenes import annulus, box, held, scene

MUSCLE = {"name": "muscle", "model": "muscle", "A10": 6.43, "K": 5000, "fiber": [0, 0, 1]}
BARE = {key: MUSCLE[key] for key in MUSCLE if key != "fiber"}
CLAMPED, PULLED = held("z0"), {"set": "z1", "traction": [0, 0, 2.5]}
MID = {"name": "mid", "quantity": "cauchy_zz", "point": [0.5, 0.5, 1]}
PULL = {"name": "pull", "quantity": "force", "set": "z0"}
BLOCK = scene(
    "rkcm", box(3, 3, 5, size=[1, 1, 2], places=(4, 4, 7)), material=[MUSCLE],
    boundary=[CLAMPED, PULLED], load={"steps": 2, "activation": 0.01}, probe=[MID, PULL],
    reference=[
        {"probe": "mid", "activation": [0.005, 0.01], "value": [1, 2], "source": "nobody"}
    ],
)  # fmt: skip
#: Collocation locks in this block, which is refused
RIGHT = ("scene.method=rkpm-gauss", "approximation.order=1", "approximation.support=2")
SIDES = "is not a side of this box; there are x0, x1, y0, y1, z0, z1"

Write = Callable[[dict[str, Any]], Path]


def complaints(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        Scene(path, overrides)
    return str(caught.value).splitlines()


def place_of(path: Path, line: str) -> str:
    """File and line of a text of a deck."""
    return f"{path}:{path.read_text(encoding='utf-8').splitlines().index(line) + 1}"


def ended(**changes: Any) -> dict[str, Any]:
    """The end that is pulled is another set."""
    return {"boundary": [CLAMPED, PULLED | changes]}


def probed(*point: float) -> dict[str, Any]:
    """A probe at another point."""
    return {"probe": [MID | {"point": list(point)}, PULL]}


@pytest.mark.parametrize(
    ("change", "line", "message"),
    [
        (ended(set="z3"), 'set = "z3"', f"boundary.z3.set: 'z3' {SIDES}"),
        (ended(u_x=1, set="top"), 'set = "top"', f"boundary.top.set: 'top' {SIDES}"),
        (probed(2, 0, 0), "point = [2, 0, 0]", "probe.mid.point: (2, 0, 0) lies outside "),
        (probed(0, 0, -0.1), "point = [0, 0, -0.1]", "probe.mid.point: (0, 0, -0.1) lies out"),
        (
            {"material": [BARE]},
            "[[material]]",
            "material.muscle.fiber: missing, collocation point 1 ",
        ),
    ],
)
def test_wrong_line(write_deck: Write, change: dict[str, Any], line: str, message: str) -> None:
    """One complaint, at its line."""
    path = write_deck(BLOCK | change)
    (said,) = complaints(path)
    assert said.startswith(f"{place_of(path, line)}: {message}")
    assert "fiber" not in message or "give fiber or fiber_angle" in said


def test_points_on_the_surface_are_inside(write_deck: Write) -> None:
    path = write_deck(BLOCK)
    for point in ("[0,0,0]", "[1,1,2]", "[1,0,2.000000001]"):
        Scene(path, [f"probe.mid.point={point}"]).close()


def test_all_complaints_at_once(write_deck: Write) -> None:
    path = write_deck(BLOCK | ended(set="z3") | probed(0, 0, 3))
    lines = complaints(path, "probe.pull.set=left")
    assert [line.split(": ")[:2] for line in lines] == [
        [place_of(path, 'set = "z3"'), "boundary.z3.set"],
        [place_of(path, "point = [0, 0, 3]"), "probe.mid.point"],
        ["--set probe.pull.set=left", "probe.pull.set"],
    ]


def test_a_body_that_nothing_holds(write_deck: Write) -> None:
    free = [{"set": "z0", "traction": [0, 0, 0]}, PULLED]
    (line,) = complaints(write_deck(BLOCK | {"boundary": free}))
    assert "no displacement is prescribed on the body" in line and "can move freely" in line


def test_annulus(inputs: Path) -> None:
    for override, message in {
        "geometry.outer_radius=5": "must be greater than inner_radius = 6, not 5",
        "boundary.inner.u_x=1": "cannot be given beside u_x",
        "scene.dimension=3": "annulus needs scene.dimension = 2, not 3",
        "probe.radial_stress.quantity=u_z": "u_z is always zero in two dimensions",
        "boundary.inner.u_z=1": "only for scene.dimension = 3; here scene.dimension = 2",
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


def test_fiber_angle_gives_the_fiber(tmp_path: Path) -> None:
    """From the last axis towards x, in the deck's own words."""
    turned = BARE | {"fiber_angle": 30}
    words = ["load.steps=1", *RIGHT]
    run_deck(BLOCK | {"material": [turned]}, tmp_path / "out", overrides=words, verbosity=-1)
    with Results(tmp_path / "out") as results:
        fiber = results.fiber
    np.testing.assert_allclose(fiber, np.broadcast_to([0.5, 0, 0.75**0.5], fiber.shape), 1e-6)


@pytest.mark.parametrize(("full", "loads"), [(0.01, [0.5, 1.0]), (0.005, [1.0]), (0.0, [])])
def test_activations_of_references_become_loads(
    tmp_path: Path, full: float, loads: list[float]
) -> None:
    """Those that the run meets are compared; without activation it meets none."""
    overrides = [f"load.activation={full}", *RIGHT]
    summary = run_deck(BLOCK, tmp_path / "out", overrides=overrides, verbosity=-1)
    assert summary["reference"].get("mid", {}).get("load", []) == pytest.approx(loads)
