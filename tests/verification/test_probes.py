"""Probes of sets and sections, and their units.

A block is fixed at one end, and its other end is moved: every section carries the force of the
ends, and the moments of both ends about one point balance.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork import Results, Scene
from myork.stations.solve import run_deck
from myork.summary import printed
from tests.scenes import (
    MUSCLE,
    PLANES,
    box,
    gripped,
    held,
    neo,
    probes,
    refused,
    scene,
    solved,
    tomllib,
)

ABOUT = [0.3, 0.2, 0.1]
PLACES = (0.05, 0.6, 1.0, 1.37, 1.98)


def block(method: str, source: list[int], bulk: float) -> dict:
    """Block with probes of its ends and of sections between them."""
    cut = {"quantity": "section_force", "normal": [0, 0, 2]}
    rubber = {"name": "rubber", "model": "polynomial", "A10": 10, "K": bulk}
    return gripped(
        method, box(*source, size=[1, 1.2, 2]), rubber, "z0 z1",
        "force0 force z0", "force1 force z1", "own torque_y z1", "middle u z1", "side u_z x1",
        *({"name": f"section{z}", "point": [0.4, 0.5, z], **cut} for z in PLACES),
        *({"name": f"torque{a}{k}", "quantity": f"torque_{a}", "set": f"z{k}", "about": ABOUT}
          for a in "xyz" for k in (0, 1)),
        load={"steps": 2}, u_x=0.3, u_y=0.1, u_z=0.2,
    )  # fmt: skip


@pytest.mark.parametrize(("method", "bulk", "tolerance"), [
    ("rkpm-gauss", 50.0, 1e-5), ("rkpm-gauss", float("inf"), 1e-5), ("rkpm-scni", 50.0, 1e-5),
    # least squares balance forces only approximately: 4 % on this cloud
    ("rkcm-mixed", 50.0, 0.06),
])  # fmt: skip
def test_sections_carry_the_force_of_the_ends_and_torques_balance(method, bulk, tolerance):
    found = solved(block(method, [4, 4, 5], bulk)).ends()
    force = found["force1"]
    near = tolerance * np.linalg.norm(force)
    assert_allclose(found["force0"], -force, atol=near)
    for z in PLACES:
        assert_allclose(found[f"section{z}"], force, atol=near)
    for axis in "xyz":
        ends = [found[f"torque{axis}{end}"][0] for end in (0, 1)]
        assert ends[1] == pytest.approx(-ends[0], abs=2 * near)
    # about its own centre an end carries the moment that bends the block: less than that of the
    # force about the far end, and of its sign
    assert found["own"][0] * force[0] < 0
    assert 0.3 < -found["own"][0] / (2 * force[0]) < 1.1
    assert_allclose(found["middle"], [0.3, 0.1, 0.2], atol=2e-4)
    assert found["side"][0] == pytest.approx(0.06, abs=0.02)


BLOCK = block("rkpm-gauss", [3, 3, 3], 50.0)


def test_a_cloud_without_room_for_a_section_tells_the_force_as_well():
    """Two cells along the block: every source point is in the support of an end."""
    found = solved(BLOCK).ends()
    for z in PLACES:
        assert_allclose(found[f"section{z}"], found["force1"], rtol=1e-4)


def test_the_executable_writes_them_with_error_bars(tmp_path):
    tables = block("rkpm-gauss", [4, 4, 5], 50.0)
    summary = run_deck(tables, tmp_path, threads=1)
    last = summary["steps"][-1]
    inside = solved(tables, error=True)
    for probe in tables["probe"]:
        name, wide = probe["name"], probe["quantity"] in ("u", "force", "section_force")
        value, bar = last["probes"][name], last["probe_errors"][name]
        n = 3 if wide else 1
        assert_allclose(value, inside.probes[name][-1, :n].squeeze(), rtol=1e-9, atol=1e-9)
        assert_allclose(bar, inside.bars[name][-1, :n].squeeze(), rtol=1e-6)
        assert np.all(np.asarray(bar) > 0)
    assert "torque" in json.dumps(summary["deck"]["probe"])


def test_a_section_outside_of_the_body_is_no_probe():
    cut = {"name": "p", "quantity": "section_force", "normal": [0, 0, 1], "point": [0.5, 0.5, 3]}
    assert "outside" in refused(BLOCK | {"probe": [cut]})


@pytest.mark.parametrize(
    ("method", "essential"),
    [("rkpm-gauss", "penalty"), ("rkpm-gauss", "transformation"), ("rkpm-scni", "penalty")],
)
def test_materials_share_a_section_by_their_stresses(method, essential):
    """Two layers along a sheet with the same ratio of moduli: each has a uniform stress."""
    cut = {"quantity": "section_force_x", "normal": [1, 0]}
    tables = scene(
        method, box(9, 9, size=[2, 1]), galerkin={"essential": essential},
        material=[neo(2.0, 20.0, "a"), neo(6.0, 60.0, "b", where="y > 0.5625")],
        boundary=[*PLANES[:2], {"set": "x1", "u_x": 0.2}],
        probe=[{"name": f"{side}{x}", "point": [x, 0.4], **cut, **own} for x in (0.05, 0.97)
               for side, own in (("a", {"material": "a"}), ("b", {"material": "b"}), ("S", {}))],
    )  # fmt: skip
    found = solved(tables | {"solver": {"tolerance": 1e-10}}).last()
    for x in (0.05, 0.97):
        # stabilisation, of which no material has a part, does nothing where F is uniform: 2e-6
        assert found[f"a{x}"] + found[f"b{x}"] == pytest.approx(found[f"S{x}"], rel=1e-5)
        # nodal cells mix the materials at the interface
        near = 0.12 if method == "rkpm-scni" else 0.01
        assert found[f"b{x}"] == pytest.approx(3 * 7 / 9 * found[f"a{x}"], rel=near)


@pytest.mark.parametrize("source", [[9, 33], [5, 17]])
def test_sections_near_an_end_carry_the_loads_beyond_them(source):
    """A bar with tractions along its sides: near its ends the cut lies farther inside."""
    places = (0.03, 0.1, 0.3, 2.0, 3.9, 3.98)
    tables = scene(
        "rkpm-gauss", box(*source, size=[2, 4]), material=[neo(50.0, 200.0)],
        boundary=[held("y0", 2), {"set": "y1", "traction": [0, 0.2]},
                  *({"set": side, "traction": [0, 1.0]} for side in ("x0", "x1"))],
        probe=[{"name": f"{y}", "quantity": "section_force_y", "point": [1.0, y],
                "normal": [0, 1]} for y in places],
    )  # fmt: skip
    found = solved(tables).last()
    for y in places:
        # surface points have half a spacing each, whose load may count whole or not at all
        near = 2 * 4 / (source[1] - 1) / 8
        assert found[f"{y}"] == pytest.approx(2 * (4 - y) + 0.4, abs=near)


def test_springs_belong_to_the_part_of_a_body_that_they_hold():
    """A sheet on springs: a section has one force, whichever side its normal points to."""
    spring = {"set": "y0", "spring": [3.0, 0.0]}
    tables = scene(
        "rkpm-gauss", box(17, 9, size=[2, 1]), material=[neo(10.0, 40.0)],
        boundary=[held("x0", 2), held("x1", 2, u_x=0.2), spring],
        probe=[*probes("left force_x x0", "right force_x x1", "own force_x y0"),
               *({"name": f"{n}{x}", "quantity": "section_force_x", "point": [x, 0.5],
                  "normal": [n, 0]} for n in (1, -1) for x in (0.05, 1.0, 1.95))],
    )  # fmt: skip
    found = solved(tables).last()
    assert found["own"] < -0.1 * found["right"]
    for x in (0.05, 1.0, 1.95):
        assert found[f"1{x}"] == pytest.approx(-found[f"-1{x}"], rel=1e-6)
    # the springs pull on the right part most
    forces = [-found["left"], *(found[f"1{x}"] for x in (0.05, 1.0, 1.95)), found["right"]]
    assert (np.diff(forces) > 0).all() and (np.diff(forces, 2)[:2] > 0).all()


@pytest.mark.parametrize("load", [{"spring": [0, 5.0]}, {"pressure": 1.0}])
def test_loads_of_a_side_act_on_the_materials_behind_it(load):
    lines = ("whole force_y y0", "a force_y y0", "b force_y y0")
    wanted = [probe | ({"material": probe["name"]} if len(probe["name"]) == 1 else {})
              for probe in probes(*lines)]  # fmt: skip
    tables = scene(
        "rkpm-gauss", box(17, 9, size=[2, 1]), probe=wanted,
        material=[neo(10.0, 40.0, "a"), neo(20.0, 80.0, "b", where="y > 0.5")],
        boundary=[held("x0", 2), held("x1", 2, u_y=0.1), {"set": "y0", **load}],
    )  # fmt: skip
    found = solved(tables).last()
    assert abs(found["whole"]) > 0.1 and abs(found["b"]) < 1e-12
    assert found["a"] == pytest.approx(found["whole"], rel=1e-9)


def test_fibers_without_stress_stretch_like_others():
    """A muscle whose fibers carry nothing; other materials have none to measure."""
    wanted = [
        {"name": quantity, "quantity": quantity, "material": "m"} | more
        for quantity, more in (("fiber_stretch", {}), ("pennation", {"normal": [1, 0]}))
    ]
    muscle = {"name": "m", "model": "muscle", "A10": 5.0, "K": 300.0, "fiber": [1, 1, 0]}
    tables = gripped("rkpm-gauss", box(9, 5, size=[2, 1]), muscle, "x0 x1", u_x=0.3)
    found = []
    for stress in (0.0, 1e-9):
        tables["material"] = [muscle | {"sigma_max": stress}]
        found.append(solved(tables | {"probe": wanted}).last())
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    assert found[0]["fiber_stretch"] > 1.01
    tables["material"] = [neo(10.0, 300.0, "m")]
    assert "no fibers" in refused(tables | {"probe": wanted})


# ---- units of probes -----------------------------------------------------------------------------

ROOT = Path(__file__).parents[2]
FORCE, LENGTH = 1000.0, 10.0
#: All quantities of the schema
SCHEMA = tomllib.loads((ROOT / "fortran/deck/schema.toml").read_text(encoding="utf-8"))
QUANTITIES = set(SCHEMA["probe"]["quantity"]["choices"])
PULL = (("x", 0.1), ("y", 0.05), ("z", 0.05))
PLANE = {q for q in QUANTITIES if not re.search(r"z|torque_[xy]", q)} | {"torque_z", "cauchy_zz"}
UNITS = {"force": "N", "length": "cm"}


def body(dimension, quantities, force=1.0, length=1.0) -> dict:
    """A muscle in oblique tension, with all probes, its numbers times powers of two units."""
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
    """An elastic body in tension, linear; on a line its forces are stresses."""
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
    """Factor of a number when N and cm become mN and mm."""
    value, sizes = 1.0, {"N": FORCE, "cm": LENGTH, "degree": 1.0}
    for words, sign in zip(unit.split("/"), (1, -1), strict=False):
        for name, power in re.findall(r"(\w+)\^?(\d*)", words):
            value *= sizes[name] ** (sign * int(power or 1))
    return value


@pytest.mark.parametrize(("make", "dimension", "quantities"), [
    (body, 3, [QUANTITIES]), (body, 2, [PLANE]), (bar, 1, []), (bar, 2, []),
], ids=["space", "plane", "line", "linear"])  # fmt: skip
def test_units_tell_how_numbers_change(make, dimension: int, quantities) -> None:
    one, units = numbers(make(dimension, *quantities))
    other, _ = numbers(make(dimension, *quantities, FORCE, LENGTH))
    for name, value in one.items():
        value = value[:dimension]
        assert np.abs(value).max() > 1e-3, name
        assert_allclose(other[name][:dimension], factor(units[name]) * value, rtol=1e-8,
                        atol=1e-8 * np.abs(other[name]).max(), err_msg=name)  # fmt: skip


def test_log_summary_and_tables_show_one_unit(tmp_path: Path) -> None:
    """For a plane body the force was N on the terminal and N/cm in the report."""
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


def test_rounding_below_a_bar_is_printed_as_zero(tmp_path: Path) -> None:
    """By symmetry the middle of a stretched plate does not move sideways."""
    tables = body(2, set())
    tables["material"] = [neo(10, 50)]
    tables["boundary"] = [held("x0", 2), held("x1", 2, u_x=0.1)]
    tables["probe"] = probes("middle u 0.5 0.5")
    step = run_deck(tables, tmp_path, threads=1)["steps"][-1]
    found, shown = step["probes"]["middle"], printed(step)["middle"]
    assert 0 < abs(found[1]) < 1e-6 * step["probe_errors"]["middle"][1]
    assert shown == [found[0], 0.0]
    assert re.search(r"middle \(0\.05\d*, 0\) \+-", (tmp_path / "run.log").read_text())


@pytest.mark.parametrize("points", [4, 5, 6])
@pytest.mark.parametrize("bulk", [1.0, 4.0, 100.0])
def test_the_pressure_is_that_of_all_of_k(points, bulk):
    """Though a part of K acts at each Gauss point, more in groups of a single cell: a block of
    mu = 1 in a rigid tube, shorter by a tenth.
    """
    sides = [{"set": f"{axis}{end}", f"u_{axis}": 0} for axis in "xy" for end in (0, 1)]
    tables = scene(
        "auto", box(*[points] * 3), material=[neo(1.0, bulk)],
        boundary=[*sides, {"set": "z0", "u_z": 0}, {"set": "z1", "u_z": -0.1}],
        probe=probes("p pressure 0.4 0.5 0.6", "s cauchy_zz 0.4 0.5 0.6", "force force_z z1"),
    )  # fmt: skip
    found = solved(tables).last()
    shear = 0.9 ** (-5 / 3) * (2 / 3 * 0.9**2 - 2 / 3)
    assert found["s"] == pytest.approx(shear - 0.1 * bulk, rel=1e-6)
    assert found["force"] == pytest.approx(found["s"], rel=1e-6)
    assert abs(found["p"]) == pytest.approx(0.1 * bulk, rel=1e-6)


@pytest.mark.parametrize("method", ["rkcm", "rkcm-mixed", "rkpm-gauss", "rkpm-scni"])
def test_the_energy_has_its_volumetric_part(method: str) -> None:
    """Sides moved alike: the energy of a change of volume alone, K/2 (J-1)^2."""
    sides = [{"set": f"{axis}1", f"u_{axis}": 0.1} for axis in "xyz"]
    tables = scene(
        method, box(4, 4, 4), material=[neo(1.0, 5.0)], boundary=[*PLANES, *sides],
        load={"steps": 1}, probe=probes("all energy", "J J 0.5 0.5 0.5"),
    )  # fmt: skip
    found = solved(tables).last()
    assert found["J"] == pytest.approx(1.1**3, rel=1e-6)
    assert found["all"] == pytest.approx(0.5 * 5.0 * (1.1**3 - 1) ** 2, rel=1e-4)


LATERAL = {"uniaxial": (1, 2), "equibiaxial": (2,)}


@pytest.mark.parametrize(("fiber", "solution", "amount"), [
    ([1, 0, 0], "uniaxial", 1.2), ([0, 1, 0], "uniaxial", 0.8), ([0, 1, 0], "equibiaxial", 1.1),
])  # fmt: skip
def test_exact_solutions_of_active_muscle(
    fiber: list[int], solution: str, amount: float, tmp_path: Path
) -> None:
    """The sides are free of stress, also where fibers make their stretches different."""
    moved = ["x1"] if solution == "uniaxial" else ["x1", "y1"]
    names = ("xx", "yy", "zz")
    tables = scene(
        "rkpm-gauss", box(3, 3, 3), material=[{**MUSCLE, "fiber": fiber, "activation": 0.2}],
        boundary=[*PLANES, *({"set": side, f"u_{side[0]}": amount - 1} for side in moved)],
        load={"steps": 4},
        probe=probes(*(f"{c} cauchy_{c} 0.5 0.5 0.5" for c in names), "J J 0.5 0.5 0.5"),
        exact=[{"probe": p, "solution": solution, "amount": amount} for p in (*names, "J")],
    )  # fmt: skip
    exact = run_deck(tables, tmp_path, error=False)["exact"]
    for k, name in enumerate((*names, "J")):
        if k in LATERAL[solution]:
            assert exact[name]["reference"] == 0 and exact[name]["relative_error"] is None
        else:
            assert exact[name]["relative_error"] < 1e-9
    turned = scene(
        "rkpm-gauss", box(3, 3, 3), material=[{**MUSCLE, "fiber_angle": 45.0}],
        boundary=PLANES, probe=tables["probe"], exact=tables["exact"],
    )  # fmt: skip
    assert "is homogeneous only if the fibers lie along x, y or z" in refused(turned)


def test_references_are_compared_at_loads_that_exist(tmp_path: Path) -> None:
    """With the activation that the material really has."""
    end, muscle = {"probe": "f", "source": "none"}, {**MUSCLE, "fiber": [0, 0, 1]}
    tables = gripped(
        "rkpm-gauss", box(3, 3, 3), {**muscle, "activation": 0.2}, "z0 z1", "f force_z z1",
        load={"steps": 2, "activation": 0.4}, reference=[
            {**end, "load": [0.3, 0.5], "value": [1.0, 1.0]},
        ],
    )  # fmt: skip
    summary = run_deck(tables, tmp_path, error=False)
    said = [text for text in summary["warnings"] if "reference of f:" in text]
    assert len(said) == 1 and "load (0.3)" in said[0] and "end at (0.5, 1)" in said[0]
    assert summary["reference"]["f"]["activation"] == pytest.approx([0.1])
    tables["reference"] = [{**end, "activation": [0.1, 0.2], "value": [1.0, 0.0]}]
    found = run_deck(tables, tmp_path, error=False)["reference"]["f"]
    assert found["load"] == [0.5, 1.0] and found["relative_error"][1] is None
