"""Scenes from data, decks as dicts and points as arrays; consequences of decks that have points.

The form of a deck is tested in test_deck.
"""

import copy
import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.truths import bodies
from myork import Scene, run_deck
from myork.core.deck import load_deck
from myork.model_file import read_model, write_model
from myork.records import PointCloud
from myork.tables import deck_text
from tests.scenes import box, deck_file, held, loaded, refused, refuses, scene, solved, tomllib

RUBBER = {"name": "rubber", "model": "polynomial", "A10": 10.0, "K": 500.0}
CUBE = loaded(
    "rkcm", box(4, 4, 4, places=[6] * 3), RUBBER, "z0 z1", {"u_z": 0.1}, "pull force z1",
    load={"steps": 2},
)  # fmt: skip
BOX = [("kind", "box"), ("size", [1] * 3), ("source", [3] * 3), ("collocation", [4] * 3)]
#: The points of a body replace the geometry
PULLED = {key: CUBE[key] for key in ("scene", "material", "boundary", "load", "probe")}
#: The same points from a file
BLOCK = {**PULLED, "geometry": {"kind": "model", "file": "model.h5"}}


def cloud() -> PointCloud:
    """Block of 1 x 1 x 1.5, source points 4 x 4 x 5, collocation points twice as dense; its ends
    are sets.
    """
    body = bodies.box((1.0, 1.0, 1.5), (4, 4, 5), (7, 7, 9))
    end = body.boundary_set >= 4
    ends = {name: getattr(body, name)[end] for name in ("boundary_point", "normal", "area")}
    number = body.boundary_set[end] - 4
    return replace(body, **ends, boundary_set=number, set_names=("z0", "z1"))


def test_values_of_all_kinds() -> None:
    tables = {
        "text": 'a "b" \\ \n\t\x01\x7f é 筋', "path": Path("folder") / "file",
        "numbers": np.array([1.5, np.inf, 1e-300, 0.1]), "whole": (np.int32(3), 2**40),
        "yes": [True, np.bool_(False)], "odd key": {"inner": {"x y": 1}, "none": []},
        "many": [{"a": 1}, {}],
    }  # fmt: skip
    plain = {"path": str(tables["path"]), "numbers": [1.5, float("inf"), 1e-300, 0.1],
             "whole": [3, 2**40], "yes": [True, False]}  # fmt: skip
    assert tomllib.loads(deck_text(tables)) == tables | plain
    # an array of tables may be without entries
    for nothing in ([], ()):
        assert load_deck({**CUBE, "probe": nothing})["probe"] == []


@pytest.mark.parametrize("wrong", [
    {"boundary": [*CUBE["boundary"], {"set": "x0", "u_x": 0, "u_q": 0}]},
    {"load": {"stepz": 3}}, {"laod": {"steps": 3}}, {"lists": []}, {"load": {"steps": "many"}},
    {"material": [{**CUBE["material"][0], "K": -1}]}, {"material": CUBE["material"][0]},
    {"geometry": [CUBE["geometry"]]}, {"boundary": [{"set": "z9", "u_x": 0}]}, {"scene": {}},
    {"probe": [{**CUBE["probe"][0], "quantity": "forze"}], "load": {"steps": 0}},
])  # fmt: skip
def test_a_dict_gets_the_message_of_the_deck(wrong: dict, tmp_path: Path) -> None:
    """All of it except the line number, which a dict does not have."""
    tables = {**CUBE, **wrong}
    path = deck_file(tmp_path / "deck.toml", tables)
    lines = [line.removeprefix(f"{path}:") for line in complaints(path)]
    texts = [line.partition(": ")[2] for line in lines]
    assert refused(tables).splitlines() == [f"tables: {text}" for text in texts]


@pytest.mark.parametrize(("tables", "message"), [
    ({"load": {"steps": None}}, "load.steps: None is not a value; leave the key out"),
    ({"probe": [{}, {"name": {1, 2}}]}, "probe.2.name: a set is not a value of a deck"),
    ({"load": {3: 4}}, "3: a key must be a text"),
])  # fmt: skip
def test_what_no_deck_can_hold(tables: dict, message: str) -> None:
    assert refused({**CUBE, **tables}) == f"tables: {message}"
    refuses("a deck must be tables or a text, not NoneType", Scene.from_tables, None)
    refuses("use Scene.from_tables for its tables", Scene, CUBE)
    refuses("'cube.toml' is the name of a deck", Scene.from_tables, "cube.toml")
    for words in ("load.steps=2", {"load.steps": 2}):
        refuses("overrides must be a list of texts", run_deck, CUBE, "out", overrides=words)
    with Scene.from_tables(CUBE) as cube:
        refuses("start must be finite", cube.solve, start=np.full(cube.dofs, np.nan))


def test_fibers_of_a_deck_are_those_of_its_points() -> None:
    """A direction beside a map of others had replaced the map without a word."""
    tables = {**PULLED, "material": [{**BARE, "fiber": [0, 0, -2]}]}
    points = cloud()
    along, across = (np.tile(np.array(axis, float), (len(points.points), 1))
                     for axis in ([0, 0, 1], [0, 1, 0]))  # fmt: skip
    Scene.from_tables(tables, replace(points, fiber=along)).close()
    refuses("muscle.fiber: the model has fibers of its own", Scene.from_tables,
            tables, replace(points, fiber=across))  # fmt: skip


def test_a_label_without_points_is_refused_with_those_there_are() -> None:
    points = cloud()
    label = np.where(np.arange(len(points.points)) < 9, 4, 2)
    tables = {**PULLED, "material": [{**CUBE["material"][0], "label": 7}]}
    said = "rubber.label: no point has label 7; the labels of the points are 2, 4"
    refuses(said, Scene.from_tables, tables, replace(points, label=label))


@pytest.mark.parametrize("change", [
    lambda deck: deck["load"].update(steps=5),
    lambda deck: deck.__setitem__("load", {}),
    lambda deck: deck.pop("probe"),
    lambda deck: deck["boundary"].sort(key=str),
    lambda deck: deck["boundary"][1].__setitem__("u_z", 0.3),
    lambda deck: deck["geometry"]["source"].__setitem__(0, 9),
    lambda deck: deck.__ior__({"load": {"steps": 3}}),
])  # fmt: skip
def test_the_deck_of_a_scene_cannot_be_changed(change) -> None:
    with Scene.from_tables(CUBE) as scene:
        before = json.dumps(scene.deck)
        refuses("open a new Scene with overrides", change, scene.deck)
        assert json.dumps(scene.deck) == before


def test_copies_of_the_deck_may_be_changed() -> None:
    with Scene.from_tables(CUBE) as scene:
        for again in (copy.deepcopy(scene.deck), pickle.loads(pickle.dumps(scene.deck))):
            assert again == scene.deck
            again["boundary"][1]["u_z"] = 0.3
            again["probe"].append({})
        assert scene.deck["boundary"][1]["u_z"] == 0.1 and len(scene.deck["probe"]) == 1


def test_arrays_are_the_model_file_that_holds_them(tmp_path: Path) -> None:
    points, file = cloud(), tmp_path / "model.h5"
    write_model(file, points)
    with_file = {**PULLED, "geometry": {"kind": "model"}}
    answers = set()
    for opened in (
        Scene(deck_file(tmp_path / "deck.toml", with_file)),
        Scene.from_tables(PULLED, points),
        Scene.from_tables(with_file, read_model(file)),
        Scene.from_tables({**PULLED, "geometry": {"kind": "model", "file": file}}),
    ):
        with opened:
            found = solved(opened)
            assert np.abs(found.states.x[-1]).max() > 0.05
            answers.add((found.states.x.tobytes(), found.fields.cauchy.tobytes()))
    assert len(answers) == 1


def test_units_of_length_are_those_of_the_cloud() -> None:
    points, given = replace(cloud(), length_unit="mm"), {"units": {"force": "N", "length": "cm"}}
    with Scene.from_tables(PULLED, points) as scene:
        assert scene.deck["units"] == {"force": "N", "length": "mm"}
    said = r"units.length: 'cm', but the lengths .* are in mm"
    refuses(said, Scene.from_tables, PULLED | given, points)
    said = "a PointCloud is needed, not ndarray"
    refuses(said, Scene.from_tables, PULLED, np.zeros((4, 3)))
    # title and units have defaults
    deck = load_deck(CUBE)
    assert (deck["title"], deck["units"]) == ("scene", {"force": "N", "length": "cm"})
    named = load_deck({**CUBE, "title": "cube", "units": {"force": "kN", "length": "m"}})
    assert (named["title"], named["units"]) == ("cube", {"force": "kN", "length": "m"})


@pytest.mark.parametrize(("geometry", "overrides", "message"), [
    (CUBE["geometry"], [], "tables: geometry.kind: 'box', but a cloud was given"),
    ({"kind": "model", "file": "m.h5"}, [], "tables: geometry.file: 'm.h5', but a cloud was"),
    ({}, [f"geometry.{key}={value}" for key, value in BOX], "--set geometry.kind=box: a cloud"),
])  # fmt: skip
def test_a_cloud_and_a_geometry_contradict(geometry, overrides, message) -> None:
    tables = {**PULLED, "geometry": geometry}
    assert message in refused(tables, cloud(), overrides=overrides)


@pytest.mark.parametrize(("name", "value", "message"), [
    ("points", np.zeros((5, 2)), "'points' has shape (5, 2), but (5, 3) is needed"),
    ("fiber", np.zeros((3, 3)), "'fiber' has shape (3, 3), but (441, 3) is needed"),
    ("label", np.ones(440, int), "'label' has shape (440,), but (441,) is needed"),
    ("label", np.ones(441), "'label' must contain whole numbers, not float64"),
    ("area", np.ones(3), "'area' has shape (3,), but (98,) is needed"),
    ("spacing", 0.3, "'spacing' has shape (), but (80, 3) is needed"),
    (
        "boundary_point",
        np.full(98, 441),
        "'boundary_point' must contain indices from 0 to 440, but entry 0 is 441",
    ),
])  # fmt: skip
def test_arrays_that_do_not_fit_are_named(name, value, message) -> None:
    assert refused(PULLED, replace(cloud(), **{name: value})) == f"cloud: {message}"


MUSCLE = {"name": "muscle", "model": "muscle", "A10": 6.43, "K": 5000, "fiber": [0, 0, 1]}
BARE = {key: MUSCLE[key] for key in MUSCLE if key != "fiber"}
CLAMPED, DRAWN = held("z0"), {"set": "z1", "traction": [0, 0, 2.5]}
MID = {"name": "mid", "quantity": "cauchy_zz", "point": [0.5, 0.5, 1]}
PULL = {"name": "pull", "quantity": "force", "set": "z0"}
MARKED = scene(
    "rkcm", box(3, 3, 5, size=[1, 1, 2], places=(4, 4, 7)), material=[MUSCLE],
    boundary=[CLAMPED, DRAWN], load={"steps": 2, "activation": 0.01}, probe=[MID, PULL],
    reference=[{"probe": "mid", "activation": [0.005, 0.01], "value": [1, 2], "source": "nobody"}],
)  # fmt: skip
#: Collocation locks in this block, which is refused
RIGHT = ("scene.method=rkpm-gauss", "approximation.order=1", "approximation.support=2")
SIDES = "is not a side of this box, which has only: x0, x1, y0, y1, z0, z1"

Write = Callable[[dict[str, Any]], Path]


def complaints(path: Path, *overrides: str) -> list[str]:
    return refuses(".", Scene, path, overrides).splitlines()


def place_of(path: Path, line: str) -> str:
    """File and line of a text in a deck."""
    return f"{path}:{path.read_text(encoding='utf-8').splitlines().index(line) + 1}"


def ended(**changes: Any) -> dict[str, Any]:
    """The end in tension is another set."""
    return {"boundary": [CLAMPED, DRAWN | changes]}


def probed(*point: float) -> dict[str, Any]:
    return {"probe": [MID | {"point": list(point)}, PULL]}


@pytest.mark.parametrize(("change", "line", "message"), [
    (ended(set="z3"), 'set = "z3"', f"boundary.z3.set: 'z3' {SIDES}"),
    (ended(u_x=1, set="top"), 'set = "top"', f"boundary.top.set: 'top' {SIDES}"),
    (probed(2, 0, 0), "point = [2, 0, 0]", "probe.mid.point: (2, 0, 0) lies outside "),
    (probed(0, 0, -0.1), "point = [0, 0, -0.1]", "probe.mid.point: (0, 0, -0.1) lies out"),
    ({"material": [BARE]}, "[[material]]", "material.muscle.fiber: missing, collocation point 1 "),
    ({"approximation": {"order": 2, "support": 1.05}}, "[geometry]", "geometry: point 1 at (0"),
])  # fmt: skip
def test_wrong_line(write_deck: Write, change: dict[str, Any], line: str, message: str) -> None:
    """One complaint, at its line."""
    path = write_deck(MARKED | change)
    (said,) = complaints(path)
    assert said.startswith(f"{place_of(path, line)}: {message}")
    assert "fiber" not in message or "give fiber or fiber_angle" in said


def test_all_complaints_at_once(write_deck: Write) -> None:
    path = write_deck(MARKED | ended(set="z3") | probed(0, 0, 3))
    lines = complaints(path, "probe.pull.set=left")
    assert [line.split(": ")[:2] for line in lines] == [
        [place_of(path, 'set = "z3"'), "boundary.z3.set"],
        [place_of(path, "point = [0, 0, 3]"), "probe.mid.point"],
        ["--set probe.pull.set=left", "probe.pull.set"],
    ]


def test_a_body_that_nothing_holds(write_deck: Write) -> None:
    free = [{"set": "z0", "traction": [0, 0, 0]}, DRAWN]
    (line,) = complaints(write_deck(MARKED | {"boundary": free}))
    assert "no displacement is prescribed on the body" in line and "can move freely" in line
    # points on the surface count as inside
    path = write_deck(MARKED)
    for point in ("[0,0,0]", "[1,1,2]", "[1,0,2.000000001]", "[1,0,2.0000015]"):
        Scene(path, [f"probe.mid.point={point}"]).close()


def test_annulus(inputs: Path) -> None:
    for override, message in {
        "geometry.outer_radius=5": "must be greater than inner_radius = 6, not 5",
        "probe.radial_stress.point=[1,1]": "probe.radial_stress.point: (1, 1) lies outside the ann",
        "probe.radial_stress.point=[-0.1,7]": "(-0.1, 7) lies outside the annulus",
        "boundary.x0.set=z0": "'z0' is not a side of this annulus, which has only: inner, outer",
    }.items():
        assert any(message in line for line in complaints(inputs / "tube.toml", override)), override


@pytest.mark.parametrize(("full", "loads"), [(0.01, [0.5, 1.0]), (0.005, [1.0]), (0.0, [])])
def test_activations_of_references_become_loads(tmp_path, full, loads):
    """References at activations that the run reaches are compared; without activation, none."""
    overrides = [f"load.activation={full}", *RIGHT]
    summary = run_deck(MARKED, tmp_path / "out", overrides=overrides, verbosity=-1)
    assert summary["reference"].get("mid", {}).get("load", []) == pytest.approx(loads)
