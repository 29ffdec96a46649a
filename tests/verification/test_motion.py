"""Linear dynamics by central differences: d'Alembert's solution, orders, energies and limits."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import run_deck
from myork.errors import InputError, MyorkError
from tests.scenes import box, gripped, probes, scene, solved

INPUTS = Path(__file__).parents[2] / "inputs"


def error_of(deck: Any, *overrides: str) -> float:
    """Relative L2 error at the end."""
    return solved(deck, *overrides).states.errors["relative_L2"]


def string(points: int, step: float, **dynamics: Any) -> dict[str, Any]:
    """A free string of unit length, stiffness and density whose functions are finite elements."""
    return scene(
        "rkpm-gauss", box(points, places=(points,)), linear={"problem": "elasticity", "E": 1},
        approximation={"order": 1, "support": 1.0001}, boundary=[],
        dynamics={"density": 1, "time_step": step, "end_time": 10 * step} | dynamics,
    )  # fmt: skip


@pytest.mark.parametrize(("method", "rate"), [("rkcm", 1.5), ("rkpm-gauss", 1.85)])
def test_wave_against_d_alembert(method: str, rate: float) -> None:
    """Order 2 in time; collocation keeps an error of its points."""
    deck, steps = INPUTS / "wave_1d.toml", [0.2, 0.1, 0.05]
    form = f"scene.method={method}"
    found = [error_of(deck, form, f"dynamics.time_step={step}") for step in steps]
    assert found[0] < 0.02
    slope = np.polyfit(np.log(steps), np.log(found), 1)[0]
    assert slope > rate, f"order {slope:.2f} of {found}"


def test_limit_is_that_of_a_uniform_lattice() -> None:
    """Linear elements of a free bar: h/(c sqrt 3)."""
    limit = 1 / 20 / np.sqrt(3)
    solved(string(21, 0.999 * limit, velocity="cos(pi*x)"))
    with pytest.raises(MyorkError) as error:
        solved(string(21, 1.01 * limit, velocity="cos(pi*x)"))
    said = str(error.value).split("at most ")[1].split()[0]
    assert float(said) == pytest.approx(limit, rel=1e-3)


def test_free_bodies_fly() -> None:
    """A velocity that is the same everywhere stays."""
    found = solved(string(11, 0.02, velocity=2.0) | {"probe": probes("end u_x 1")})
    assert found.probes["end"][:, 0] == pytest.approx(2.0 * found.states.load, rel=1e-9)


def pulled(method: str, end: dict[str, Any]) -> dict[str, Any]:
    """u = t^2 sin(2x) + x t: a wall at rest, and an end that is pulled or moved."""
    return scene(
        method, box(21), boundary=[{"set": "x0", "u_x": 0}, {"set": "x1"} | end],
        linear={"problem": "elasticity", "E": 2, "source": "2*sin(2*x) + 8*t^2*sin(2*x)"},
        dynamics={"density": 1, "time_step": 0.01, "end_time": 1, "velocity": "x"},
    )  # fmt: skip


def forces_of(tables: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Times and forces of a body through x0 and x1, shape (times, 2)."""
    states, found, *_ = solved(tables | {"probe": probes("low force_x x0", "high force_x x1")})
    return np.asarray(states.load), np.stack([f[:, 0] for f in found.values()], axis=1)


#: Conditions of the end with u = t^2 sin(2x) + x t
MOVED, PULLED = {"u_x": "t^2*sin(2) + t"}, {"traction": ["4*t^2*cos(2) + 2*t"]}


@pytest.mark.parametrize("end", [MOVED, PULLED])
@pytest.mark.parametrize("method", ["rkcm", "rkpm-gauss"])
def test_loads_in_time(method: str, end: dict[str, Any]) -> None:
    """Values, traction and source that change with time, and the forces of wall and end."""
    tables = pulled(method, end)
    more = tables | {"approximation": {"order": 2}}
    assert error_of(more | {"linear": tables["linear"] | {"exact": "t^2*sin(2*x) + x*t"}}) < 3e-3
    if method == "rkpm-gauss":
        time, force = forces_of(tables)
        pull = 4 * time**2 * np.cos(2) + 2 * time
        near = 0.005 if end is MOVED else 1e-12
        np.testing.assert_allclose(force[:, 1], pull, rtol=0, atol=near)
        np.testing.assert_allclose(force[:, 0], -4 * time**2 - 2 * time, rtol=0, atol=3e-4)


@pytest.mark.parametrize("dimension", [1, 2])
def test_reactions_of_a_bar_that_swings(dimension: int) -> None:
    """u = sin(pi x) sin(pi t)/pi between two walls, which press with sin(pi t): order 2."""
    found = []
    for cells in (10, 20):
        n = [cells + 1, 3][:dimension]
        tables = gripped(
            "rkpm-gauss", box(*n, size=[1, 0.2][:dimension], places=n), [], "x0 x1",
            linear={"problem": "elasticity", "E": 1} | ({"nu": 0} if dimension > 1 else {}),
            dynamics={"density": 1, "time_step": 0.4 / cells, "end_time": 1,
                      "velocity": ["sin(pi*x)", "0"][:dimension]},
        )  # fmt: skip
        time, force = forces_of(tables)
        height = 0.2 if dimension > 1 else 1.0
        found.append(np.abs(force / height + np.sin(np.pi * time)[:, np.newaxis]).max())
    assert found[1] < 7e-4
    assert np.log2(found[0] / found[1]) > 1.8


def test_membrane_in_the_plane() -> None:
    """Poisson's operator moves as a membrane: sin(pi x) sin(pi y) cos(sqrt 2 pi t)."""
    tables = scene(
        "rkpm-gauss", box(25, 25, places=(25, 25)),
        linear={"problem": "poisson", "exact": "sin(pi*x)*sin(pi*y)*cos(sqrt(2)*pi*t)"},
        dynamics={"density": 1, "time_step": 0.01, "end_time": 0.5,
                  "displacement": "sin(pi*x)*sin(pi*y)"},
        boundary=[{"set": side, "u": 0} for side in ("x0", "x1", "y0", "y1")],
    )  # fmt: skip
    assert error_of(tables) < 0.03


def vibrating(unit: float, end: float, **linear: Any) -> dict[str, Any]:
    """A string that swings with period 2, its time in a unit."""
    return scene(
        "rkpm-gauss", box(21), linear={"problem": "elasticity", "E": 1} | linear,
        boundary=[{"set": "x0", "u_x": 0}, {"set": "x1", "u_x": 0}],
        dynamics={"density": unit**2, "time_step": 0.01 * unit, "end_time": end * unit,
                  "every": 5, "velocity": f"pi/{unit}*sin(pi*x)"},
        probe=probes("middle u_x 0.5"),
    )  # fmt: skip


@pytest.mark.parametrize("known", [{}, {"exact": "sin(pi*x)*sin(pi*t)"}])
def test_a_motion_that_ends_at_rest_is_judged_by_its_amplitude(
    known: dict[str, str], tmp_path: Path
) -> None:
    """The string passes through its straight line at time 2; bars are the largest errors so far."""
    found = run_deck(vibrating(1.0, 2.0, **known), tmp_path, threads=1, verbosity=-1)
    assert found["verdict"]["state"] == "accepted"
    bars = np.array([step["probe_errors"]["middle"] for step in found["steps"]])
    values = np.array([step["probes"]["middle"] for step in found["steps"]])
    time = np.array([step["load"] for step in found["steps"]])
    assert 0 < bars[-1] < 0.01
    # a second solution has the same time step, whose error is about (pi dt)^2/24 pi t
    assert (np.abs(values - np.sin(np.pi * time)) < bars + 4e-4).all()


def test_bars_of_a_motion_do_not_depend_on_the_unit_of_time(tmp_path: Path) -> None:
    steps = [
        run_deck(vibrating(unit, 1.3), tmp_path, threads=1, verbosity=-1)["steps"]
        for unit in (1.0, 100.0)
    ]
    for one, other in zip(*steps, strict=True):
        for key in ("probes", "probe_errors"):
            assert one[key]["middle"] == pytest.approx(other[key]["middle"], rel=1e-6)


def test_more_points_take_shorter_time_steps(tmp_path: Path) -> None:
    """Four cells across a plane beam: it is compared with eight, which need half the step."""
    tables = scene(
        "rkpm-gauss", box(9, 3, size=[2, 0.5]), boundary=[{"set": "x0", "u_x": 0, "u_y": 0}],
        linear={"problem": "elasticity", "E": 1, "nu": 0},
        dynamics={"density": 1, "time_step": 0.1, "end_time": 2, "velocity": ["0", "x^2"]},
        probe=probes("tip u_y 2 0.25"),
    )  # fmt: skip
    found = run_deck(tables, tmp_path, threads=1, verbosity=-1)
    assert 0 < found["steps"][-1]["probe_errors"]["tip"] < 0.1


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        (string(11, 0.01, end_time=0.033), "dynamics.end_time: must be a whole number of"),
        (string(11, 0.01, velocity=["1", "2"]), "dynamics.velocity: must have 1 item, one "),
        (string(11, 0.01, density="x - 1"), "dynamics.density: must be positive, not"),
        (string(11, 0.01, velocity="t"), "unknown name 't' at position 1"),
        # time has no meaning at rest
        (pulled("rkpm-gauss", {"u_x": "t"}) | {"dynamics": None}, "unknown name 't' at position 1"),
        (
            pulled("rkcm", {}) | {"probe": probes("pull force_x x0")},
            "probe.pull.quantity: force_x is not known",
        ),
    ],
)
def test_what_does_not_fit_is_refused(tables: dict[str, Any], what: str) -> None:
    with pytest.raises(InputError) as error:
        solved({key: table for key, table in tables.items() if table is not None})
    assert what in str(error.value)
