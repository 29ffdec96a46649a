"""Scenes in memory: handles, shapes, forces, edges, loads and materials that change while open."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.truths import bodies
from myork import Scene
from myork.errors import ConvergenceError
from myork.records import PointCloud
from tests.scenes import box, held, neo, probes, refused, refuses, scene, solved

TABLES = scene(
    "rkcm", box(3, 3, 4, size=[1, 1, 2], places=(4, 4, 6)),
    material=[{"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 100.0}],
    boundary=[held("z0"), held("z1", u_z=0.2)], load={"steps": 2},
    probe=probes("bottom force z0", "top force z1", "middle u 0.5 0.5 1"),
)  # fmt: skip
#: Planes of symmetry at three sides
SLIP = [{"set": f"{axis}0", f"u_{axis}": 0} for axis in "zxy"]


def test_a_closed_scene_is_recognised(open_scene):
    opened = open_scene(TABLES)
    x = np.zeros(opened.dofs)
    opened.close()
    opened.close()
    for use, *words in (
        (opened.solve,), (opened.fields, x, 1.0), (opened.probes, x[None], [1.0]),
        (opened.linearise, x, 1.0, x), (opened.reduce, np.ones((len(x), 1))),
    ):  # fmt: skip
        refuses("this scene is closed", use, *words)
    # another scene in its place is a different one
    assert open_scene(TABLES).solve().load[-1] == 1.0
    refuses("closed", opened.solve)


def test_scenes_opened_at_once_do_not_meet(write_deck):
    """From several Python threads; each has a separate scene."""
    path = write_deck(TABLES)
    with ThreadPoolExecutor(8) as pool:
        scenes = list(pool.map(lambda _: Scene(path), range(40)))
    assert len({one.solve(error=False).x.tobytes() for one in scenes[::8]}) == 1
    for one in scenes:
        one.close()


@pytest.mark.parametrize("method", ["rkcm", "rkpm-gauss"])
def test_settings_of_a_solve_that_cannot_be_are_refused(method):
    tables = TABLES | {"scene": {"dimension": 3, "method": method}}
    for threads in (-1, 2.5, "a", 5000):
        refuses("whole number between 1 and 1024", Scene.from_tables, tables, threads=threads)
    with Scene.from_tables(tables) as opened:
        refuses("unknown least squares solver dgel", opened.solve, "dgel")


def test_wrong_shapes_are_refused(open_scene):
    opened = open_scene(TABLES)
    x, one = np.zeros(opened.dofs), np.ones((opened.dofs, 1))
    for use, *words in (
        (opened.fields, x[:-1], 1.0), (opened.fields, x.reshape(-1, 3), 1.0),
        (opened.probes, x[None], [0.5, 1.0]), (opened.probes, x[None, :-3], [1.0]),
        (opened.linearise, x, 1.0, x[:3]), (opened.reduce, x),
        (opened.reduce, np.ones((opened.dofs - 1, 2))), (opened.reduce, one[:, :0]),
    ):  # fmt: skip
        refuses("must have shape", use, *words)
    for value in (np.nan, np.inf):
        refuses("finite", opened.reduce, value * one)
    refuses("no reduced model", opened.solve_reduced, "dgels")
    n = np.zeros((opened.collocation_points, 3))
    for force, stress, what in ((n, n, "stress"), (n + np.nan, n[..., None] * n[:1], "body_force")):
        said = f"{what} must be finite and have shape"
        refuses(said, opened.set_fields, force, n, stress)


def test_essential_conditions_beat_tractions_at_edges():
    """Points shared by a dead load and rollers keep both: homogeneous, with P_xx = 5."""
    load = {"set": "x1", "traction": [5.0, 0.0, 0.0]}
    walls = [load, *SLIP, {"set": "y1", "u_y": 0}, {"set": "z1", "u_z": 0}]
    tables = {**TABLES, "boundary": walls, "probe": probes("side force x1")}
    found = solved(tables, "load.steps=1")
    f = found.fields.f
    assert f[0, 0, 0] > 1.02
    assert_allclose([f[:, 1, 1], f[:, 2, 2]], 1.0, rtol=0, atol=1e-6)
    assert_allclose(found.probes["side"][-1], [5.0 * 2.0, 0, 0], rtol=0, atol=1e-5)


def test_a_free_component_of_a_condition_is_free_of_traction():
    """A frictionless plate: no shear traction where only the normal component is prescribed."""
    smooth = {**TABLES, "boundary": [held("z0"), {"set": "z1", "u_z": -0.1}]}
    top = solved(smooth).probes["top"][-1]
    assert top[2] < -1.0 and abs(top[:2]).max() < 1e-8 * abs(top[2])


METHODS = ["rkcm", "rkcm-mixed", "rkpm-gauss", "rkpm-scni"]


@pytest.mark.parametrize("method", METHODS)
def test_contradicting_conditions_are_refused(method):
    contradiction = {**TABLES, "boundary": [held("z0"), {"set": "x0", "u_x": 0.5}]}
    said = refused(contradiction, overrides=[f'scene.method="{method}"'])
    assert said.startswith("tables: ") and "two displacements, " in said
    assert "component 1 at (0, 0, 0)" in said
    # sets that meet and move alike may be described differently
    turned = {"set": "z1", "rotation": 10, "axis": [0, 0, 1], "about": [0, 0, 2]}
    opposite = {**turned, "set": "x0", "rotation": -10, "axis": [0, 0, -1]}
    ramp = {"set": "x0", "u_x": 0, "u_y": 0, "u_z": "0.1*z", "amplitude": "up"}
    for agreeing in (
        [*TABLES["boundary"], {"set": "x0", "u_x": 0}], [turned, opposite],
        [{**turned, "rotation": 0}, {"set": "x0", "u_x": 0}], [*TABLES["boundary"], ramp],
    ):  # fmt: skip
        up = [{"name": "up", "time": [0, 1], "value": [0, 1]}]
        tables = {**TABLES, "boundary": agreeing, "amplitude": up, "load": {"steps": 1}}
        assert method != "rkcm" or solved(tables).states.load[-1] == 1.0


def test_every_load_is_met_exactly_also_after_halvings():
    """A step too large to converge at once: compressed to a fifth."""
    pressed = {**TABLES, "boundary": [*SLIP, {"set": "z1", "u_z": -1.8}]}
    found = solved(pressed, "load.steps=3", "solver.max_iterations=8")
    assert found.states.load.tolist() == [1 / 3, 2 / 3, 1.0]
    assert max(found.states.iterations) > 4, "nothing was halved"
    assert_allclose(found.fields.f[:, 2, 2], 0.1, rtol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_answers_do_not_depend_on_what_was_asked_before(method, open_scene):
    """The same bits after any earlier requests or solves, and those of a separate scene."""
    tables = {**TABLES, "probe": [*TABLES["probe"], *probes("stress cauchy_zz 0.4 0.5 1.2")]}
    override = f'scene.method="{method}"'
    opened = open_scene(tables, override)
    states = opened.solve()

    def answers(asked, step):
        x, load = states.x[step], states.load[step]
        fields = asked.fields(x, load)
        probes = asked.probes(x[None], [load])
        rows = asked.linearise(x, load, states.x[1 - step])
        return [part.tobytes() for part in (fields.u, fields.f, fields.cauchy, probes, *rows)]

    first, last = answers(opened, 0), answers(opened, 1)
    assert all(one != other for one, other in zip(first, last, strict=True))
    assert answers(opened, 0) == first
    opened.solve()
    assert answers(opened, 0) == first
    assert answers(open_scene(tables, override), 1) == last
    together = opened.probes(states.x[::-1], states.load[::-1])
    assert [values.tobytes() for values in together[::-1, None]] == [first[3], last[3]]


PULLED = scene(
    "rkpm-gauss", box(4, 4, 5, size=[1, 1, 2], places=(5, 5, 7)),
    material=[{"name": "muscle", "model": "muscle", "A10": 10, "K": 300, "fiber_angle": 30}],
    boundary=[
        held("z0"), held("z1", u_z=0.2, amplitude="pull"), {"set": "x1", "traction": [0.1, 0, 0]},
    ],
    amplitude=[{"name": "pull", "time": [0, 0.5, 1], "value": [0, 1, 1]}],
    load={"steps": 2, "activation": 0.1},
    probe=probes("force force_z z1"),
)  # fmt: skip


@pytest.mark.parametrize("method", ["rkpm-gauss", "rkcm-mixed"])
def test_changes_are_fresh_scenes(method):
    """One after the other, also with other points, fibers or unknowns."""
    tables = {**PULLED, "scene": {"dimension": 3, "method": method}}
    changes = [
        {"material.muscle.K": 120.0, "load.steps": 3}, {"amplitude.pull.value": [0, 0.4, 1]},
        {"material.muscle.K": float("inf")}, {"geometry.source": [3, 3, 4]},
        {"material.muscle.fiber_angle": 10, "boundary.x1.traction": [0.4, 0, 0.1]},
    ]  # fmt: skip
    overrides: dict[str, str] = {}
    with Scene.from_tables(tables, threads=1) as opened:
        opened.solve(error=False)
        for change in changes:
            opened.update(change)
            overrides = {key: word for key, word in overrides.items() if key not in change}
            overrides |= {key: f"{key}={value}" for key, value in change.items()}
            found = opened.solve()
            with Scene.from_tables(tables, overrides=[*overrides.values()], threads=1) as fresh:
                expected = fresh.solve()
                assert (opened.deck, opened.steps, opened.rows) == (
                    fresh.deck, fresh.steps, fresh.rows,
                )  # fmt: skip
            assert np.array_equal(found.x, expected.x)
            assert np.array_equal(found.probe_errors, expected.probe_errors, equal_nan=True)


@pytest.mark.parametrize(("changes", "message"), [
    ({"boundary.z1.set": "z9"}, "z9"),
    ({"material.muscle.K": -1}, "material.muscle.K: "),
    ({"material.muscle.KK": 1}, "KK"),
    ({"load.activation": None}, "None is not a value"),
])  # fmt: skip
def test_a_wrong_change_leaves_the_scene(open_scene, changes, message):
    opened = open_scene(PULLED)
    before, deck = opened.solve(error=False), dict(opened.deck)
    refuses(message, opened.update, {"load.steps": 4, **changes})
    assert dict(opened.deck) == deck and np.array_equal(opened.solve(error=False).x, before.x)


@pytest.mark.parametrize("method", ["rkcm", "rkpm-gauss"])
def test_loads_of_a_linear_problem_are_those_of_its_deck(open_scene, method):
    linear = {"problem": "poisson", "source": "1"}
    tables = scene(method, box(5, 5), linear=linear, boundary=[{"set": "x0", "u": 0.0}])
    opened = open_scene(tables)
    n = len(opened.field_points())
    fields = np.ones((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 3))
    refuses("loads of a linear problem", opened.set_fields, *fields)


@pytest.mark.parametrize("method", ["rkcm", "rkcm-mixed", "rkpm-scni", "rkpm-gauss"])
def test_a_column_carries_its_weight(open_scene, method):
    """The reaction balances a body force; the material does not contract."""
    column = scene(
        method, box(4, 4, 7, size=[1, 1, 2], places=(5, 5, 9)), material=[neo(100, 200 / 3)],
        boundary=[held("z0")], probe=probes("foot force z0"), load={"steps": 1},
    )  # fmt: skip
    opened = open_scene(column)
    n = len(opened.field_points())
    load = np.tile([0, 0, -0.05], (n, 1))
    opened.set_fields(load, 0 * load, np.zeros((n, 3, 3)))
    states = opened.solve()
    foot = opened.probes(states.x, states.load)[-1, 0]
    assert_allclose(foot, [0, 0, 0.1], rtol=0, atol=5e-4)
    assert states.force_imbalance < 0.02
    assert [r for r in states.reasons if "set point by point" not in r] == []


@pytest.mark.parametrize("method", ["rkcm", "rkpm-scni", "rkpm-gauss"])
def test_loads_of_its_own_have_no_second_solution(open_scene, method):
    """Nothing can support such an answer: it is doubtful; and the scene cannot be changed."""
    tables = {key: value for key, value in PULLED.items() if key != "amplitude"}
    tables |= {"boundary": [PULLED["boundary"][0]], "scene": {"dimension": 3, "method": method}}
    opened = open_scene(tables)
    n = len(opened.field_points())
    opened.set_fields(np.ones((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 3)))
    refuses("set_fields", opened.update, {"load.activation": 0.2})
    states = opened.solve()
    assert np.any(states.x) and np.isnan(states.probe_errors).all()
    assert states.verdict != "accepted"
    assert any("set point by point" in reason for reason in states.reasons)


def test_a_reduced_model_is_made_anew_after_a_change(open_scene):
    opened = open_scene({key: value for key, value in PULLED.items() if key != "probe"})
    modes, _ = np.linalg.qr(opened.solve(error=False).x.T)
    opened.reduce(modes)
    opened.update({"load.activation": 0.2})
    refuses(".", opened.solve_reduced, "")


# ---- supports of a body, and runs with meaningless numbers ---------------------------------------

RUBBER = [{"name": "rubber", "model": "polynomial", "A10": 10.0, "K": 500.0}]


def tables(nd: int, method: str, **sets: str) -> dict[str, Any]:
    """A block, or its plane, with the given components of these sets at rest."""
    geometry = box(*[3, 3, 4][:nd], size=[1, 1, 2][:nd], places=[4, 4, 7][:nd])
    approximation = {"order": 1 if method.startswith("rkpm") else 2, "support": 2.5}
    still = [{"set": name, **{f"u_{axis}": 0 for axis in axes}} for name, axes in sets.items()]
    return scene(method, geometry, boundary=still, approximation=approximation, material=RUBBER)


#: Motions that prescribed components do not constrain, counted by hand; in the last line of space
#: the rotation axis lies in both planes
FREE = [
    (3, {"x1": "x"}, "slide along y, to slide along z, to turn about an axis along x"),
    (3, {"z0": "z", "z1": "z"}, "slide along x, to slide along y, to turn about an axis along z"),
    (3, {"x0": "yz"}, "slide along x, to turn about an axis along y, to turn about an axis along"),
    (3, {"z0": "xy", "x0": "z"}, "turn about an axis along y"),
    (2, {"x0": "y"}, "slide along x, to turn in its plane"),
]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("dimension", "sets", "motions"), FREE)
def test_motions_that_nothing_hinders(dimension, sets, motions, method):
    assert f"leave the body free to {motions}" in refused(tables(dimension, method, **sets))


def test_a_volume_that_is_prescribed_leaves_the_pressure_of_rigid_volumes_open() -> None:
    """With one side free, or with a compliant material, it follows."""
    sides = dict.fromkeys(("x0", "x1", "y0", "y1"), "xy")
    deck = tables(2, "rkpm-gauss", **sides)
    Scene.from_tables(deck).close()
    deck["material"] = [{**deck["material"][0], "K": float("inf")}]
    assert "leaves its pressure undetermined" in refused(deck)
    Scene.from_tables({**deck, "boundary": deck["boundary"][:3]}).close()


def pinned(points: np.ndarray) -> PointCloud:
    cube = bodies.box((1.0, 1.0, 1.0), (4, 4, 4), (4, 4, 4))
    place = [np.linalg.norm(cube.points - point, axis=1).argmin() for point in points]
    n = len(place)
    return replace(
        cube, boundary_point=np.array(place, np.int32), boundary_set=np.zeros(n, np.int32),
        normal=np.tile([0.0, 0, -1], (n, 1)), area=np.full(n, 1 / 16), set_names=("pins",),
    )  # fmt: skip


def test_a_hinge_is_no_support_and_three_pins_are() -> None:
    """Points constrained on a diagonal leave the rotation about it; one beside it prevents that."""
    deck = scene(
        "rkcm", {}, material=RUBBER, boundary=[held("pins")],
        approximation={"order": 2, "support": 3},
    )  # fmt: skip
    diagonal = np.array([[0, 0, 0], [1 / 3, 1 / 3, 0], [2 / 3, 2 / 3, 0], [1, 1, 0]])
    assert "free to turn about an axis along (1, 1, 0);" in refused(deck, pinned(diagonal))
    Scene.from_tables(deck, pinned(np.vstack([diagonal, [1, 0, 0]]))).close()


#: A stiffness relative to which the stress of the muscle, 1.5, is less than a rounding error
DROWNED = (
    "geometry.source=[4,4,5]", "geometry.collocation=[7,7,9]", "load.steps=2",
    "load.activation=0.05", "material.A10=9e18",
)  # fmt: skip


@pytest.mark.parametrize("method", ["rkcm", "rkpm-gauss"])
def test_a_load_that_drowns_in_rounding_has_no_answer(inputs, open_scene, method: str) -> None:
    opened = open_scene(inputs / "muscle_block.toml", *DROWNED, f"scene.method={method}")
    refuses(r"rounding errors of a stiffness of 1\.8E\+19", opened.solve, kind=ConvergenceError)
    # a missing load is no error
    opened = open_scene(inputs / "muscle_block.toml", *DROWNED[:3], "load.activation=0")
    assert not opened.solve().x.any()


@pytest.mark.parametrize(("changes", "message"), [
    # as many collocation points as source points, and hardly any on a boundary
    ({"geometry": box(9, 9, 9, size=[1, 1, 2], places=(3, 3, 3))}, "more collocation points"),
    # a support below their distance: source points between them are in no equation
    ({"geometry": box(3, 3, 30, size=[1, 1, 2], places=(33, 33, 4)),
      "approximation": {"order": 2, "support": 3.0}}, "1089 points around .* not connected"),
])  # fmt: skip
def test_too_few_equations_are_refused(changes, message):
    refuses(message, solved, {**TABLES, **changes})


# ---- expressions in coordinates: their values, and refusals --------------------------------------


#: The left side at rest
HELD = held("x0", 2)


def plate(boundary: list[dict[str, Any]], **other: Any) -> dict[str, Any]:
    """Tables of a small plate, of one compressible rubber, with a probe at its middle."""
    return scene(
        "rkpm-gauss", box(6, 6), boundary=boundary, title="plate",
        material=[neo(1.0, 10.0)], probe=probes("middle u 0.5 0.5"),
    ) | other  # fmt: skip


def probe_of(tables: dict[str, Any], *overrides: str) -> np.ndarray:
    """The displacement in the middle, shape (2,)."""
    return solved(tables, *overrides).probes["middle"][-1, :2]


@pytest.mark.parametrize("text", [
    "0.01", "0.01*sin(pi/2)", "x > 0.5 and not(x < 0.5) ? 0.01 : 7",
    "0.01*(r >= 1)*(theta >= 0 or 0)", "0.1*sqrt(0.1^2)",
])  # fmt: skip
def test_expressions_that_are_a_number(text: str) -> None:
    """On x = 1 all of these are the same number, and so are the answers, also with an override."""
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
