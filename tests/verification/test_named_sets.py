"""Boundary sets and regions of materials defined by decks, by side, normal or expression."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from myork import Scene, run_deck
from myork.core.deck import table_defaults
from myork.model.cloud import build_cloud
from myork.records import Labels, PointCloud
from tests import scenes
from tests.scenes import box, gripped, held, neo, probes, refused, scene, solved, voxels

#: Zero Poisson's ratio at small strains: E = 2 mu, K = 2/3 mu, so that a clamp disturbs no bending
CORK = neo(1.0, 2 / 3, "cork")
E = 2.0
PULL = 1e-5


def column(
    method: str, sets: list[dict[str, Any]], boundary: list[dict[str, Any]], **more: Any
) -> dict[str, Any]:
    """A column 1 wide and 8 high, clamped below."""
    return scene(
        method, box(9, 65, size=[1, 8], places=(9, 65)), material=[CORK], set=sets,
        boundary=[held("y0", 2), *boundary], load={"steps": 1},
    ) | more  # fmt: skip


def last(tables: dict[str, Any], cloud: PointCloud | None = None) -> NDArray[np.float64]:
    """Probes of the last state, shape `(probes, 3)`."""
    return np.array([value[-1] for value in solved(tables, cloud=cloud).probes.values()])


@pytest.mark.parametrize(("method", "border"), [
    ("rkpm-gauss", 0.5), ("rkpm-gauss", 0.43), ("rkpm-scni", 0.43),
])  # fmt: skip
def test_a_load_on_a_part_of_the_end_bends_the_column(method: str, border: float) -> None:
    """Beam theory holds away from the ends: N = p (1 - b), M = N e, u = -M y^2 / (2 E I)."""
    pad = {"name": "pad", "side": "y1", "where": f"x > {border}"}
    turn = {"name": "M", "quantity": "torque_z", "set": "pad", "about": [0.5, 8]}
    wanted = probes("N force_y pad", "R force_y y0", "u u_x 0.5 4", "end u_x pad", turn)
    load = [{"set": "pad", "traction": [0, PULL]}]
    found = solved(column(method, [pad], load, probe=wanted)).last()
    force = PULL * (1 - border)
    moment = force * 0.5 * border
    assert found["N"] == pytest.approx(force, rel=1e-5)
    assert found["M"] == pytest.approx(moment, rel=2e-3)
    assert found["R"] == pytest.approx(-force, rel=1e-5)
    assert found["u"] == pytest.approx(-moment * 4**2 / (2 * E / 12), rel=0.01)
    assert found["end"] == pytest.approx(-moment * 8**2 / (2 * E / 12), rel=0.01)


#: Parts of the end of a cube of 1, in the middle of cells and across several, and their areas
PARTS = [
    ("x < 0.109", 0.109),
    ("x < 0.0545", 0.0545),
    ("x >= 0.109", 0.891),
    ("x > 0.3 and x < 0.409", 0.109),
    # narrower than a cell, between its points
    ("abs(x - 0.6) < 0.02", 0.04),
    ("x > 0.1 and x < 0.209 and y > 0.3 and y < 0.409", 0.109**2),
    ("x + 0.3*y < 0.6", 0.45),
    ("abs(x - 0.5) + abs(y - 0.5) < 0.3", 0.18),
    ("(x - 0.5)^2 + (y - 0.5)^2 < 0.09", 0.09 * np.pi),
]


@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
def test_the_force_on_a_part_is_traction_times_area(method: str, tmp_path: Path) -> None:
    """Wherever the border lies: the probe of the set, the reaction and the area reported."""
    for where, area in PARTS:
        tables = scene(
            method, box(5, 5, 5), material=[neo(1.0, 2.0)],
            set=[{"name": "pad", "side": "z1", "where": where}],
            boundary=[held("z0"), {"set": "pad", "traction": [0, 0, PULL]}], load={"steps": 1},
            probe=probes("N force_z pad", "R force_z z0"),
        )  # fmt: skip
        summary = run_deck(tables, tmp_path, error=False)
        force = [summary["steps"][-1]["probes"][name] / PULL for name in ("N", "R")]
        assert force == pytest.approx([area, -area], rel=5e-4), where
        assert summary["sets"][0]["area"] == pytest.approx(area, rel=5e-4), where


def test_what_nothing_refers_to_is_named() -> None:
    sets = [{"name": name, "side": "y1", "where": "x > 0.5"} for name in ("pad", "seen", "other")]
    ramps = [{"name": name, "time": [0, 1], "value": [0, 1]} for name in ("up", "down")]
    load = [{"set": "pad", "traction": [0, PULL], "amplitude": "up"}]
    tables = column("rkpm-gauss", sets, load, amplitude=ramps, probe=probes("u u_x seen"))
    with Scene.from_tables(tables, overrides=["geometry.source=[3,9]"]) as opened:
        said = [text.partition(":")[0] for text in opened.solve(error=False).warnings]
    assert said[:2] == ["amplitude down", "set other"] and not {"set pad", "set seen"} & {*said}


@pytest.mark.parametrize(("what", "method"), [
    ({"u_x": 0.1, "u_y": 0.3}, "rkpm-gauss"),
    ({"u_x": 0.1, "u_y": 0.3}, "rkcm-mixed"),
    ({"traction": [0.01, 0.02]}, "rkpm-gauss"),
    ({"traction": [0.01, "0.02*x"]}, "rkcm"),
    ({"pressure": 0.01}, "rkpm-gauss"),
    ({"u_x": 0.1, "spring": [0, 2]}, "rkpm-scni"),
    ({"rotation": 10, "about": [0.5, 8]}, "rkpm-gauss"),
    ({"u_x": 0.1, "tendon": 2, "direction": [0, 1], "pull": 0.1}, "rkpm-gauss"),
])  # fmt: skip
def test_a_set_that_is_a_whole_side_is_that_side(what: dict[str, Any], method: str) -> None:
    """To the last bit, for all conditions."""
    points = "geometry.source=[4,13]", "geometry.collocation=[7,25]"
    end = [{"name": "end", "where": "ny > 0.7"}]
    side, own = (column(method, end, [{"set": name, **what}]) for name in ("y1", "end"))
    assert np.array_equal(solved(side, *points).states.x, solved(own, *points).states.x)


def sliding(left: str, low: str) -> dict[str, Any]:
    """A slide beside a clamped side, with forces as for a motion of both."""
    ends = [{"set": left, "u_x": 0}, held(low, 2), {"set": "x1", "u_y": 0, "traction": [3, 0]}]
    wanted = probes(f"slide force_x {left}", f"wall force_x {low}", "s cauchy_yy 0.5 0")
    return scene("rkpm-gauss", box(9, 9), material=[neo(10, 1e3)], boundary=ends, probe=wanted)


def ring(end: str, _: str) -> dict[str, Any]:
    """A quarter ring that is fixed at one end and pulled at its outer wall."""
    body, end = scenes.annulus(5, 9, radii=(1, 1.6), places=False), f"{end} outer"
    return scenes.loaded(
        "rkpm-gauss", body, neo(10, 200), end, {"traction": [0.3, 0.1]}, "u u_x 1.1 0.7",
        approximation={"order": 2}, galerkin={"essential": "transformation"},
    )  # fmt: skip


@pytest.mark.parametrize("body", [sliding, ring])
def test_a_whole_side_has_the_force_and_bars_of_that_side(body: Any) -> None:
    sets = [{"name": "left", "side": "x0"}, {"name": "low", "side": "y0"}]
    own, side = (
        solved(body(*ends) | {"set": sets}, error=True) for ends in (("left", "low"), ("x0", "y0"))
    )
    assert own.last() == side.last()
    assert [own.bar(name) for name in own.last()] == [side.bar(name) for name in side.last()]


@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni", "rkcm-mixed"])
def test_sets_that_turn_alike_agree_where_they_meet(method: str) -> None:
    """Two adjacent sides rotate the whole body, without any stress."""
    turn = {"rotation": 30, "about": [0.3, 0.2]}
    body = scene(
        method, box(5, 5), material=[neo(10, 100)],
        boundary=[{"set": "x0", **turn}, {"set": "y1", **turn}],
        probe=probes("u u_x 1 0", "s cauchy_yy 0.5 0.5"),
    )  # fmt: skip
    last = solved(body).last()
    cos, sin = np.cos(np.pi / 6), np.sin(np.pi / 6)
    assert last["u"] == pytest.approx(0.7 * (cos - 1) + 0.2 * sin, abs=1e-5)
    assert last["s"] == pytest.approx(0, abs=1e-4)
    other = {"set": "y1", "rotation": 20, "about": [0.3, 0.2]}
    body["boundary"][1] = other
    assert "meet and prescribe two displacements, -0.359808 and -0.255524, for" in refused(body)


def test_parts_add_to_the_whole() -> None:
    """Forces, torques and moved centroids of a glued end by its parts, one by its material."""
    wanted = [
        {"name": f"{part}{quantity}", "quantity": quantity, "set": part, **more}
        for quantity, more in (("force", {}), ("torque_z", {"about": [0, 8]}), ("u", {}))
        for part in ("y1", "soft", "stiff")
    ]
    sets = [{"name": "soft", "where": "x <= 0.5"}, {"name": "stiff", "on": "stiff"}]
    sets = [{**part, "side": "y1"} for part in sets]
    both = [CORK, neo(3.0, 2.0, "stiff", where="x > 0.5")]
    move = [{"set": "y1", "u_x": 0.2, "u_y": "0.1 + 0.1*x"}]
    tables = column("rkpm-gauss", sets, move, material=both, probe=wanted)
    tables["geometry"] |= {"size": [1, 2], "source": [9, 17], "collocation": [17, 33]}
    found = last(tables)
    for whole, one, other in (found[:3], found[3:6]):
        assert one + other == pytest.approx(whole, rel=1e-9)
    middle = 0.5 * (found[7] + found[8])
    assert middle == pytest.approx(found[6], rel=5e-3)
    assert abs(found[2, 1]) > 2.0 * abs(found[1, 1])


def test_linear_problems_have_named_sets() -> None:
    """Heat that enters through a part of a side, compared with the same by an expression."""
    tables = scene(
        "auto", box(9, 9, places=(9, 9)), linear={"problem": "poisson"},
        set=[{"name": "door", "side": "x1", "where": "y > 0.25 and y < 0.75"}],
        boundary=[{"set": "x0", "u": 0}, {"set": "door", "flux": 1}],
        probe=probes("u u 1 0.5"),
    )  # fmt: skip
    found = last(tables)
    tables["boundary"][1] = {"set": "x1", "flux": "y > 0.25 and y < 0.75"}
    assert found == pytest.approx(last(tables), rel=1e-12)
    # div u = 0: through every section flows 0.5
    assert 0.5 < found[0, 0] < 1.0


def test_all_of_a_curved_wall_by_its_normals() -> None:
    """An annulus: a set of all outer normals, and halves of it that add up."""
    tables = scene(
        "auto", scenes.annulus(7, 13, radii=(1, 2), places=(7, 13)), material=[CORK],
        set=[{"name": name, "side": "outer", "where": where}
             for name, where in (("steep", "nx > cos(pi/6)"), ("flat", "ny > 0.5"))],
        boundary=[*scenes.PLANES[:2], {"set": "outer", "pressure": 0.01}],
        probe=scenes.forces("outer", "steep", "flat"),
    )  # fmt: skip
    found = last(tables)
    # the border of both at 30 degrees lies on a lattice line
    assert found[1] + found[2] == pytest.approx(found[0], rel=1e-9)
    assert abs(found[1, 0]) > abs(found[1, 1])


def cylinder(h: float) -> PointCloud:
    """A cylinder of radius 0.5 and length 1.5 along z from 0, its axis off the voxels."""
    across = (np.arange(round(1 / h) + 6) - 0.5 * (round(1 / h) + 5)) * h
    disc = (across[:, None] - 0.03) ** 2 + (across + 0.01) ** 2 < 0.25
    affine = np.diag([10 * h] * 3 + [1.0])
    affine[:3, 3] = 10 * across[0], 10 * across[0], 5 * h
    labels = Labels(np.repeat(disc[:, :, None], round(1.5 / h), axis=2).astype(np.int32), affine)
    return build_cloud(labels, None, table_defaults("build"), "cm")[0]


@pytest.mark.slow
def test_sets_of_a_model() -> None:
    """Loads on parts of the wall of a cylinder act on its smooth area, not on its voxels'."""
    tables = scene(
        "auto", {}, material=[neo(10.0, 20 / 3)],
        set=[
            {"name": "right", "side": "surface", "where": "nx > -1e-9"},
            {"name": "upper", "side": "surface", "where": "z > 0.75"},
            {"name": "cap", "where": "nz > 0.7071"},
        ],
        boundary=[held("bottom"), {"set": "right", "traction": [0.01, 0, 0]},
                  {"set": "upper", "traction": [0, 0.02, 0]}],
        probe=probes("r force_x right", "u force_y upper", "b force bottom", "c u cap", "t u top"),
    )  # fmt: skip
    answer = solved(tables, cloud=cylinder(0.0625), error=True)
    assert answer.states.verdict != "refused"
    found = list(answer.ends().values())
    half = 0.5 * np.pi * 1.5
    # faces of voxels have 4/pi times as much
    assert found[0][0] == pytest.approx(0.01 * half, rel=0.04)
    assert found[1][0] == pytest.approx(0.02 * half, rel=0.04)
    assert found[2][:2] == pytest.approx([-found[0][0], -found[1][0]], rel=1e-6)
    assert found[3] == pytest.approx(found[4], rel=0.02, abs=1e-4)


def test_a_half_body_has_half_the_force() -> None:
    """The plane of symmetry of a cut label map has all faces of it, including those at its rim."""
    n = 8
    middle = np.arange(n) + 0.5 - n / 2
    disc = middle[:, None] ** 2 + middle**2 < (n / 2) ** 2
    whole = np.repeat(disc[:, :, None], n, axis=2)

    def stretched(data: NDArray[Any], *cut: dict[str, Any]) -> NDArray[np.float64]:
        sides = [f"cut force {entry['set']}" for entry in cut]
        tables = gripped("auto", {}, CORK, "bottom top", "f force_z bottom", *sides, u_z=1.0)
        tables["boundary"] += cut
        return last(tables, voxels(data))

    cut = {"set": "x0", "u_x": 0.0}
    half = stretched(whole[n // 2 :], cut)
    # the blocks at the plane have it in their middle or at their side: 1.2 %
    assert 2 * half[0, 0] == pytest.approx(stretched(whole)[0, 0], rel=0.02)
    assert half[1, 0] < 0.0 and half[1, 1:] == pytest.approx([0.0, 0.0], abs=1e-9)
    # the mirror image has the other side
    mirrored = stretched(whole[: n // 2], {**cut, "set": "x1"})
    assert mirrored[:, 0] == pytest.approx(half[:, 0] * [1, -1], rel=1e-6)


def test_a_plane_map_has_as_many_sets_as_asked() -> None:
    """A single slice with one side: its ends differ in their normals."""
    cloud = voxels(np.ones((24, 8, 1)), 1.0, source_stride=[2] * 3)
    assert cloud.set_names == ("surface",)
    tables = scene(
        "auto", {}, material=[CORK],
        set=[{"name": "left", "where": "nx < -0.7071"}, {"name": "right", "where": "nx > 0.7071"}],
        boundary=[held("left"), {"set": "right", "traction": [PULL, 0, 0]}],
        probe=probes("f force_x right", "u u_x right"),
    )  # fmt: skip
    found = last(tables, cloud)[:, 0]
    # normals are those of a smooth surface: edges are round, and corner voxels have two faces
    assert found[0] == pytest.approx(PULL * 0.8 * 0.1, rel=0.1)
    assert found[1] == pytest.approx(found[0] / 0.08 * 2.4 / E, rel=0.05)


SIDE = {"name": "pad", "side": "y1"}
HALF = {"name": "pad", "side": "y0", "where": "x > 0.5"}
OAK = neo(4.0, 8 / 3, "oak")
#: Between two load steps, at the time of an amplitude
PULSE = {"name": "pulse", "time": [0, 0.1, 0.11, 0.12, 1], "value": [0, 0, 1, 0, 0]}


def pulled(*material: dict[str, Any]) -> dict[str, Any]:
    """A strip in tension with a stress of 1e-4 along x."""
    body, end = box(21, 5, size=[1, 0.2]), {"traction": [1e-4, 0]}
    load = {"steps": 1}
    return scenes.loaded("rkpm-gauss", body, material, "x0 x1", end, "end u_x 1 0.1", load=load)


@pytest.mark.parametrize(("tables", "what"), [
    *((column("rkpm-gauss", sets, [boundary] if boundary else [], amplitude=[PULSE]), what)
      for sets, boundary, what in (
        ([SIDE | {"name": "x1"}], {}, "'x1' is a side of this body"),
        ([SIDE, SIDE], {}, "is already used"),
        ([SIDE, {"name": "b", "side": "pad"}], {}, "is not a side, but another"),
        ([SIDE | {"where": "1/(x - 0.5)"}], {}, "is not finite at (0.5, 8)"),
        ([SIDE | {"where": "ny < -0.7"}], {}, "no place of the surface lies in it; coordinates ar"),
        ([SIDE], {"set": "pda", "u_x": 0}, "'pda' is not a side of this box, which has only: x0"),
        ([SIDE], {"set": "y0", "u_x": 0}, "is already used"),
        ([HALF], {"set": "pad", "u_x": 0.1},
         "y0 and pad overlap and prescribe two displacements, 0 and 0.1, for component 1"),
        ([], {"set": "x0", "u_x": 0.1},
         "x0 and y0 meet and prescribe two displacements, 0.1 and 0, for component 1 at (0, 0): "),
        ([], {"set": "x0", "u_x": 0.1, "amplitude": "pulse"},
         "x0 and y0 meet and prescribe two displacements, 0.1 and 0, for comp"),
        ([HALF], {"set": "pad", "tendon": 1.0, "direction": [1, 0]},
         "prescribe two displacements, one of them by a tendon, as a plate, for component"),
        ([SIDE | {"where": "abs(x - 0.5) < 1e-9"}], {"set": "pad", "u_x": 0.1},
         "set pad: it contains 1 boundary points, but none of the"))),
    # position of each material
    (pulled(CORK | {"where": "x < 0.5"}), "material.cork.where: no material is given at"),
    (pulled(CORK, OAK), "material.oak.where: missing"),
    (pulled(CORK, OAK | {"where": "x > 2"}), "material.oak.where: no point lies there"),
    (pulled(CORK, OAK | {"where": "x > q"}), "material.oak.where: 'x > q' is not an expressio"),
    (pulled(CORK, OAK | {"where": "x**2 > 1"}), "; a power is written ^"),
    (pulled(CORK | {"where": "x < 1"}, OAK), "material.oak.where: missing: only the first"),
    (pulled(CORK | {"label": 1}, OAK | {"where": "x < 1"}), "material.cork.label: cannot be given"),
])  # fmt: skip
def test_sets_and_materials_that_cannot_be(tables: dict[str, Any], what: str) -> None:
    assert what in refused(tables)


def test_loads_of_sets_that_overlap_add() -> None:
    sets = [SIDE, {"name": "half", "side": "y1", "where": "x > 0.5"}]
    boundary = [{"set": "pad", "traction": [0, PULL]}, {"set": "half", "traction": [0, PULL]}]
    tables = column("rkpm-gauss", sets, boundary, probe=probes("f force_y pad"))
    assert solved(tables).last()["f"] == pytest.approx(1.5 * PULL, rel=1e-9)


@pytest.mark.slow
def test_areas_of_sets_are_written(tmp_path):
    sets = [{"name": "pad", "side": "y1", "where": "x > 0.3"}, {"name": "end", "where": "ny > 0.7"}]
    tables = column("auto", sets, [{"set": "pad", "traction": [0, 0.01]}])
    tables["geometry"] = box(5, 9, size=[1, 2], places=(5, 9))
    summary = run_deck(tables, tmp_path, error=False)
    sizes = {own["name"]: own["area"] for own in summary["sets"]}
    assert sizes == pytest.approx({"pad": 0.7, "end": 1.0}, rel=2e-3)


def test_the_later_material_fills_what_two_hold() -> None:
    one = last(pulled(CORK, OAK | {"where": "x > 0.5"}))
    two = last(pulled(OAK, CORK | {"where": "x <= 0.5 and r >= 0"}))
    assert two == pytest.approx(one, rel=1e-9)
