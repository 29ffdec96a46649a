"""Units of probes: the core writes them once, and they tell how numbers change with the deck's.

Each scene is solved in N and cm and again in mN and mm. The ratio of a probe's two numbers must be
that of the powers of 1000 and 10 which its unit names, in space, in the plane and on a line; in
other forms test_metamorphic asks for the same numbers.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork import Results, Scene
from myork.stations.solve import run_deck
from myork.summary import printed
from tests.scenes import box, held, neo, probes, scene, solved, tomllib

ROOT = Path(__file__).parents[2]
FORCE, LENGTH = 1000.0, 10.0
#: All quantities of the schema whose units are known; that of an expression is what the deck says
SCHEMA = tomllib.loads((ROOT / "fortran/deck/schema.toml").read_text(encoding="utf-8"))
QUANTITIES = set(SCHEMA["probe"]["quantity"]["choices"]) - {"expression"}
PULL = (("x", 0.1), ("y", 0.05), ("z", 0.05))
PLANE = {q for q in QUANTITIES if not re.search(r"z|torque_[xy]", q)} | {"torque_z", "cauchy_zz"}
UNITS = {"force": "N", "length": "cm"}


def body(dimension, quantities, force=1.0, length=1.0) -> dict:
    """A muscle that is pulled askew, with all probes, its numbers times powers of two units."""
    stress = force / length**2
    probes = []
    for quantity in sorted(quantities):
        probe = {"name": quantity, "quantity": quantity}
        if quantity.startswith(("force", "torque")):
            probe["set"] = "x1"
        elif quantity in ("fiber_stretch", "pennation"):
            probe["material"] = "muscle"
        elif quantity != "energy":
            probe["point"] = [length * x for x in (0.4, 0.3, 0.6)[:dimension]]
        if quantity == "pennation" or quantity.startswith("section"):
            probe["normal"] = [1, 0, 0][:dimension]
        probes.append(probe)
    pull = {f"u_{axis}": move * length for axis, move in PULL[:dimension]}
    return scene(
        "rkpm-gauss", box(*[4] * dimension, size=length, places=[5] * dimension), units=UNITS,
        material=[
            {"name": "muscle", "model": "muscle", "A10": 5 * stress, "K": 50 * stress,
             "sigma_max": 30 * stress, "fiber_angle": 60, "activation": 0.1}
        ],
        boundary=[held("x0", dimension), {"set": "x1", **pull}], probe=probes,
    )  # fmt: skip


def bar(dimension: int, force: float = 1.0, length: float = 1.0) -> dict:
    """An elastic body that is pulled, linear; on a line its forces are stresses."""
    ratio = {"nu": 0.3} if dimension > 1 else {}
    middle = " ".join([str(0.5 * length)] * dimension)
    return scene(
        "rkpm-gauss", box(*[5] * dimension, size=length, places=[5] * dimension), units=UNITS,
        linear={"problem": "elasticity", "E": 100 * force / length**2, **ratio},
        boundary=[held("x0", dimension), {"set": "x1", "u_x": 0.1 * length}],
        probe=probes("pull force_x x1", f"half u_x {middle}", f"stress cauchy_xx {middle}"),
    )  # fmt: skip


def numbers(tables: dict) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    with Scene.from_tables(tables) as opened:
        return solved(opened).ends(), opened.probe_units


def factor(unit: str) -> float:
    """What a number is multiplied by when N and cm become mN and mm."""
    value, sizes = 1.0, {"N": FORCE, "cm": LENGTH, "degree": 1.0}
    for words, sign in zip(unit.split("/"), (1, -1), strict=False):
        for name, power in re.findall(r"(\w+)\^?(\d*)", words):
            value *= sizes[name] ** (sign * int(power or 1))
    return value


@pytest.mark.parametrize(
    ("make", "dimension", "quantities"),
    [(body, 3, [QUANTITIES]), (body, 2, [PLANE]), (bar, 1, []), (bar, 2, [])],
    ids=["space", "plane", "line", "linear"],
)
def test_units_tell_how_numbers_change(make, dimension: int, quantities) -> None:
    one, units = numbers(make(dimension, *quantities))
    other, _ = numbers(make(dimension, *quantities, FORCE, LENGTH))
    for name, value in one.items():
        value = value[:dimension]
        assert np.abs(value).max() > 1e-3, name
        assert_allclose(other[name][:dimension], factor(units[name]) * value, rtol=1e-8,
                        atol=1e-8 * np.abs(other[name]).max(), err_msg=name)  # fmt: skip


def test_log_summary_and_tables_show_one_unit(tmp_path: Path) -> None:
    """Of a plane body the force was N on the terminal and N/cm in the report."""
    tables = body(2, {"force_x", "energy", "J", "u", "cauchy_xx"})
    tables["material"] = [neo(10, 50)]
    summary = run_deck(tables, tmp_path, threads=1)
    line = r"^  (\w+) .*\+- (?:\([^)]*\)|\S+)(.*?)(?:  not resolved)?$"
    said = dict(re.findall(line, (tmp_path / "run.log").read_text(), re.M))
    assert summary["probe_units"] == {name: unit.strip() for name, unit in said.items()}
    assert summary["probe_units"]["force_x"] == "N/cm" and summary["probe_units"]["energy"] == "N"
    with Results(tmp_path) as results:
        units = results.history().attrs["units"]
        assert units["u_x"] == units["u_y_error"] == "cm" and units["J"] == ""
        assert "N/cm^2" in results._repr_html_()


def test_rounding_below_a_bar_is_printed_as_zero(tmp_path: Path) -> None:
    """By symmetry the middle of a pulled plate does not move sideways."""
    tables = body(2, set())
    tables["material"] = [neo(10, 50)]
    tables["boundary"] = [held("x0", 2), held("x1", 2, u_x=0.1)]
    tables["probe"] = probes("middle u 0.5 0.5")
    step = run_deck(tables, tmp_path, threads=1)["steps"][-1]
    found, shown = step["probes"]["middle"], printed(step)["middle"]
    assert 0 < abs(found[1]) < 1e-6 * step["probe_errors"]["middle"][1]
    assert shown == [found[0], 0.0]
    assert re.search(r"middle \(0\.05\d*, 0\) \+-", (tmp_path / "run.log").read_text())
