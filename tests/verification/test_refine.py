"""Source points added until the error bars are as small as requested."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import ReducedModel
from myork.core.galerkin import modal_products
from myork.core.scene import Scene
from myork.errors import ConvergenceError, InputError
from myork.report import make_report
from myork.rom.study import run_rom
from myork.stations.solve import run_deck
from myork.summary import read_summary
from tests import scenes
from tests.scenes import BEAM_TIP, beam, box, gripped, held, history, neo, probes, scene, solved


def cantilever(**refine: Any) -> dict[str, Any]:
    wanted = probes("tip u_y 4 0.5", "shear cauchy_xy 0.5 0.25")
    return beam(9, 3, places=(9, 3), refine=refine, probe=wanted)


@pytest.mark.parametrize("error", [0.01, 0.003])
def test_the_wanted_error_of_a_tip_is_met(error) -> None:
    with Scene.from_tables(beam(9, 3, places=(9, 3), refine={"accuracy": error})) as opened:
        points = opened.source_points
        found = solved(opened, error=True)
    states, tip = found.states, found.last()["tip"]
    assert tip == pytest.approx(BEAM_TIP, rel=error)
    assert states.probe_errors[-1, 0, 0] <= error * abs(tip)
    assert states.reasons[-1] == f"the target error of {100 * error:g} % is met"
    # uniform cells that reach this are 16 and 32 along it
    assert points < (17 * 5 if error == 0.01 else 33 * 9) * 1.45


def test_all_probes_are_wanted_by_default_and_cost_ends_the_search() -> None:
    states = solved(cantilever(accuracy=0.01, cost=0.15), error=True).states
    assert re.fullmatch(
        r"the target error of 1 % is not met: the next points, \[\d+,\d+\] cells, would take "
        r"about .* CPU s, more than refine\.cost",
        states.reasons[-1],
    )


def test_small_stresses_of_a_beam_are_known_to_a_part_of_themselves() -> None:
    """Three tenths of the mean stress, due to bending, were .0158 of .0009 off, with a bar of
    .0067. Truth: finite elements of order two, whose last three meshes agree to 2e-4.
    """
    yeoh = {"name": "m", "model": "yeoh", "C1": 5.0, "C2": 0.5, "C3": 0.02, "K": 300.0}
    deck = scene(
        "auto", box(size=[3, 1]), material=[yeoh],
        boundary=[held("x0", 2), {"set": "x1", "traction": [-0.0481, 0.1781]}],
        accuracy=0.05, probe=probes("middle cauchy_xx 1.5 0.5", "quarter cauchy_yy 0.75 0.25"),
    )  # fmt: skip
    found = solved(deck, error=True)
    for name, truth in {"middle": -0.0845, "quarter": 0.00086}.items():
        error = abs(found.last()[name] - truth)
        assert error < 0.05 * 0.0845 and error <= found.bar(name) + 2e-4


def wall(*boundary: dict[str, Any]) -> scenes.Answer:
    """Stress on the inner wall of a ring, at points and between them."""
    places = np.radians([45, 35.625, 46.875, 31.9])
    lines = [f"p{i} principal_max {np.cos(a):.12f} {np.sin(a):.12f}" for i, a in enumerate(places)]
    body = scenes.annulus(17, 13, radii=(1, 2), places=False)
    more = {"boundary": list(boundary), "probe": probes(*lines)}
    return solved(scene("auto", body, material=[neo(10, 300)], **more), error=True)


def test_bars_of_a_wall_are_the_same_between_its_points() -> None:
    """Its points lie on an arc. Between them, bars were .4 of those at the points."""
    found = wall(*scenes.PLANES[:2], {"set": "inner", "radial": 0.2})
    bars = [found.bar(name) for name in found.last()]
    assert max(bars) < 1.3 * min(bars)


def test_traction_on_a_free_wall_is_within_bars() -> None:
    """On a compressed wall without load, the largest principal stress is zero. It was 1.1
    to 2.6 bars off: with as few points around, half as many have the same error.
    """
    found = wall(held("y0", 2), held("x0", 2, u_x=0.05, u_y=-0.1))
    for name, value in found.last().items():
        assert abs(value) <= 1.001 * found.bar(name)


@pytest.mark.slow
def test_part_of_a_side_is_held_to_its_border() -> None:
    """A pad pressed into a sheet: finite elements that end at its border give 9.197, 9.101 and
    9.040 on finer and finer meshes, 8.93 in the limit. Prescribed at source points the force was 3
    to 9 % low. On points whose lattice contains the border it is 3 % high; half as many points show
    half of that.
    """
    deck = scene(
        "auto", box(size=[2, 1]), material=[neo(10, 1000)],
        set=[{"name": "pad", "side": "y1", "where": "x < 0.5"}],
        boundary=[{"set": "x0", "u_x": 0}, held("y0", 2), {"set": "pad", "u_x": 0, "u_y": -0.15}],
        probe=probes("force force_y pad"),
    ) | {"scene": {"dimension": 2}}  # fmt: skip
    found = solved(deck, error=True)
    assert abs(found.last()["force"] + 8.93) < found.bar("force") < 0.02 * 9.0


def test_a_search_that_its_cost_ends_writes_how_far_it_came(tmp_path: Path) -> None:
    """A microsecond is over before the first iteration."""
    ended = r"the first points of the search, \[8,2\] cells, have no solution within refine\.cost"
    with pytest.raises(ConvergenceError, match=ended + r".*on the way to load 1; .*\(written to"):
        run_deck(cantilever(accuracy=0.01, cost=1e-6), tmp_path)
    assert (tmp_path / "results.vtkhdf").exists()
    summary = read_summary(tmp_path)
    assert not summary["converged"] and not summary["refine"]["met"]
    assert summary["refine"]["points"] == [9, 3]


def test_the_answer_has_the_bars_by_which_its_search_ended(tmp_path: Path) -> None:
    """Also if the earlier points widened them: its second solution is that of the search."""
    found = run_deck(beam(9, 3, places=(9, 3), refine={"accuracy": 0.003}), tmp_path)["refine"]
    assert len(found["levels"]) > 1
    known = re.search(r"within (\S+) %", found["levels"][-1])
    assert known and float(known[1]) == pytest.approx(100 * found["reached"], rel=0.05)


def test_rounding_errors_of_a_body_that_is_turned_are_not_refined(tmp_path: Path) -> None:
    ends = [{"set": end, "rotation": 90.0, "about": [0.3, -1.0]} for end in ("x0", "x1")]
    wanted, material = probes("s cauchy_xx 1 0.5"), [neo(10.0, 200.0)]
    body = scene("auto", box(size=[2, 1]), material=material, boundary=ends, probe=wanted)
    found = run_deck(body, tmp_path)["refine"]
    assert len(found["levels"]) == 1 and found["reached"] == 0


def conducting(points: int, linear: dict[str, Any], *ends: Any, at: str) -> dict[str, Any]:
    """A heat-conducting square, at 0 on its left side, with the probe of a value."""
    return scene(
        "auto", box(*[points] * 2 if points else (), size=[1, 1]), probe=probes(f"value u {at}"),
        linear={"problem": "poisson", **linear}, boundary=[{"set": "x0", "u": 0}, *ends],
    )  # fmt: skip


@pytest.mark.parametrize("wall", [0.37, 0.55])
def test_layers_that_conduct_differently_have_kinks(wall) -> None:
    """-(k u')' = 0 with a flux of one: straight in each layer. Without kinks 17 % were accepted."""
    law, end = {"conductivity": f"1 + 99*(x > {wall})"}, {"set": "x1", "flux": 1}
    found = solved(conducting(13, law, end, at="1 0.3")).last()["value"]
    assert found == pytest.approx(wall + (1 - wall) / 100, rel=1e-3)


def test_a_skin_thinner_than_half_a_cell_has_no_kink_and_is_doubted() -> None:
    """-(k u')' = 1, k = 100 in the skin. With a kink the middle was 3.4 bars off, but accepted."""
    law = {"conductivity": "x < 0.001 ? 100 : 1", "source": "1"}
    found = solved(conducting(9, law, {"set": "x1", "u": 1}, at="0.5 0.3"), error=True)
    # no Gauss point lies in the skin: the answer is that without it, 1/2 + 1/8
    assert abs(found.last()["value"] - 0.625) < found.bar("value")
    assert found.states.verdict == "doubtful"
    assert "thinner than 1.5 spacings" in found.states.reasons[0]


def test_a_wedge_at_an_edge_is_no_thin_layer() -> None:
    """Heat flows across an inclined interface."""
    rise = "(x+y+z < 1.2 ? x+y+z : 1.2 + (x+y+z - 1.2)/5)"
    law = {"problem": "poisson", "conductivity": "x+y+z < 1.2 ? 1 : 5"}
    ends = [{"set": f"{axis}{end}", "u": rise} for axis in "xyz" for end in (0, 1)]
    body, wanted = box(9, 9, 9, size=[1, 1, 1]), probes("middle u 0.4 0.4 0.4")
    found = solved(scene("auto", body, linear=law, boundary=ends, probe=wanted), error=True)
    assert found.states.verdict == "accepted"


def long_beam(**geometry: Any) -> dict[str, Any]:
    """A beam ten times as long as high, bent upright by a dead load at its end: one step fails,
    smaller ones do not.
    """
    body, end = {"kind": "box", "size": [10, 1], **geometry}, {"traction": [0, 0.12]}
    return scenes.loaded("auto", body, neo(10.0, 1e3), "x0 x1", end, "end u_y 10 0.5")


def test_no_load_step_is_tried_twice(tmp_path: Path) -> None:
    """The last step before full load is halved whatever its size was."""
    run_deck(long_beam(source=[21, 5]), tmp_path)
    begun = [
        (line["load"], round(float(line["residual"]), 6))
        for line in history(tmp_path)
        if int(line["iteration"]) == 1
    ]
    assert len(begun) > 4 and len(set(begun)) == len(begun)


def test_the_points_that_follow_begin_with_the_load_steps_that_worked(tmp_path: Path) -> None:
    summary = run_deck(long_beam(source=[13, 5]) | {"accuracy": 0.005}, tmp_path)
    assert len(summary["refine"]["levels"]) > 1
    loads = [float(line["load"]) for line in history(tmp_path)]
    # none is given up
    assert loads[0] < 1 and loads == sorted(loads)


def test_points_of_a_linear_problem_are_searched(tmp_path: Path) -> None:
    """-u'' = sin(pi x) between ends at 0, the same at all heights."""
    deck = conducting(0, {"source": "sin(pi*x)"}, {"set": "x1", "u": 0}, at="0.5 0.5")
    deck["accuracy"] = 0.005
    with Scene.from_tables(deck) as opened:
        assert opened.points_found
        found = solved(opened, error=True)
    assert found.states.reasons[-1] == "the target error of 0.5 % is met"
    assert found.last()["value"] == pytest.approx(np.pi**-2, rel=0.005)
    # the search's own solution is the answer
    assert run_deck(deck, tmp_path)["timings_s"]["solve"] == 0
    deck["linear"]["exact"] = "sin(pi*x)/pi^2"
    with pytest.raises(InputError, match="refine: is not for linear problems whose solution is"):
        Scene.from_tables(deck).close()


def without_points(accuracy: float | None = None) -> dict[str, Any]:
    """The beam without a given number of points."""
    deck = beam(9, 3, geometry=box(size=[4, 1]))
    return deck if accuracy is None else deck | {"accuracy": accuracy}


def test_a_deck_without_points_meets_two_per_cent(tmp_path: Path) -> None:
    summary = run_deck(without_points(), tmp_path)
    found = summary["refine"]
    assert found["asked"] == 0.02 and found["met"] and 0 < found["reached"] <= 0.02
    assert found["points"] == summary["deck"]["geometry"]["source"]
    assert summary["steps"][-1]["probes"]["tip"] == pytest.approx(BEAM_TIP, rel=0.02)
    assert found["sources"] == {"tip": "other points"}
    # the search's own solution is the answer: its iterations are those of the run
    lines = (tmp_path / "history.csv").read_text().splitlines()[1:]
    assert len(lines) == summary["steps"][-1]["iterations"] > 0
    # each lattice has its line, the last is that of the answer
    assert re.match(r"refine 1: \[\d+,\d+\] points, tip within ", found["levels"][0])
    lattice = [int(n) for n in re.findall(r"\d+", found["levels"][-1].split("]")[0])[1:]]
    assert lattice == found["points"] and summary["source_points"] == np.prod(lattice)
    assert read_summary(tmp_path)["refine"] == found and found["cpu_s"] > 0
    assert found["reason"] in make_report(tmp_path).read_text(encoding="utf-8")


@pytest.mark.parametrize(("conditions", "sides"), [
    ([held("x0", 2)], ["x0", "y0", "y1"]),
    ([held("patch", 2)], ["x0", "y0", "y1"]),
    ([held("x0", 2), {"set": "y0", "u_y": 0.0}], ["x0", "y1"]),
    (scenes.PLANES[:2], []),
    ([{"set": "y1", "rotation": 0.0, "about": [0, 0]}], ["x0", "x1", "y1"]),
])  # fmt: skip
def test_points_that_are_searched_for_lie_closer_where_clamped_and_free_sides_meet(
    conditions, sides
):
    deck = without_points(accuracy=0.5)
    deck["set"] = [{"name": "patch", "side": "x0", "where": "y < 0.4"}]
    deck["boundary"] = [*conditions, deck["boundary"][1]]
    with Scene.from_tables(deck) as opened:
        assert opened.deck["geometry"]["graded"] == sides
        edges = [np.unique(opened.points()[:, axis]) for axis in (0, 1)]
    for axis, gaps in zip("xy", map(np.diff, edges), strict=True):
        for end in (0, 1):
            near, gap = f"{axis}{end}" in sides, gaps[-end] / gaps.mean()
            assert gap < 0.6 if near else gap > 0.99


def test_a_graded_lattice_is_nearer_to_the_truth() -> None:
    deck = beam(17, 5, places=(33, 9))
    even = solved(deck).last()["tip"]
    deck["geometry"]["graded"] = ["x0", "y0", "y1"]
    # the spacing is a half at the corners only; what a part of K adds to bending remains
    assert abs(solved(deck).last()["tip"] - BEAM_TIP) < 0.5 * abs(even - BEAM_TIP)


def test_a_penalty_is_as_stiff_as_the_points_at_its_side_are_close() -> None:
    """Moved as a whole, a body feels only the penalty: moduli over the spacing at the wall."""
    found = []
    for graded in ([], ["x0"], ["x1"]):
        deck = beam(9, 5, places=(9, 5))
        deck["geometry"]["graded"] = graded
        with Scene.from_tables(deck) as opened:
            shift = np.zeros((opened.dofs, 1))
            shift[::2] = 1.0
            resistance = modal_products(opened, shift)[0].sum()
            found.append(resistance * np.diff(np.unique(opened.points()[:, 0]))[0])
    assert found[1:] == pytest.approx(2 * [found[0]], rel=1e-9)


def test_an_accuracy_above_all_tables_is_met_and_the_scene_has_the_points() -> None:
    with Scene.from_tables(without_points(accuracy=0.002)) as opened:
        again = [word.split("=")[1] for word in opened.points_found]
        assert opened.deck["geometry"]["source"] == json.loads(again[0])
        found = solved(opened, error=True)
    assert found.states.reasons[-1] == "the target error of 0.2 % is met"
    assert found.last()["tip"] == pytest.approx(BEAM_TIP, rel=0.002)
    # with these points given, the same deck has the same state
    with Scene.from_tables(without_points(), overrides=opened.points_found) as other:
        assert "refine" not in other.deck
        np.testing.assert_array_equal(solved(other).states.x[-1], found.states.x[-1])


def test_points_of_a_programme_are_searched_by_all_its_states() -> None:
    """The load is removed again: at the end there is nothing to resolve."""
    deck = without_points(accuracy=0.01) | {
        "amplitude": [{"name": "on_off", "time": [0, 0.5, 1], "value": [0, 1, 0]}],
        "load": {"steps": 4},
    }
    deck["boundary"][1]["amplitude"] = "on_off"
    with Scene.from_tables(deck) as opened:
        found = solved(opened, error=True)
    tips = found.probes["tip"][:, 0]
    middle = int(np.argmax(abs(tips)))
    assert tips[middle] == pytest.approx(BEAM_TIP, rel=0.01) and abs(tips[-1]) < 1e-6
    assert found.states.reasons[-1] == "the target error of 1 % is met"


@pytest.mark.parametrize("asked", [{"accuracy": 0.05}, {"refine": {"cost": 60.0}}])
def test_a_reduced_model_has_one_set_of_points(tmp_path: Path, asked: dict[str, Any]) -> None:
    path = scenes.deck_file(tmp_path / "deck.toml", without_points() | asked)
    with pytest.raises(InputError, match=r"accuracy, \[refine\]: reduced models"):
        ReducedModel.train(path, {"material.rubber.A10": (30.0, 40.0)})


def test_the_path_reduction_of_a_deck_without_points(tmp_path: Path) -> None:
    """Displacements hold exactly there by default, which modes cannot follow."""
    found = run_rom(without_points() | {"rom": {"modes": [2]}}, tmp_path / "rom")
    assert found["models"][0]["e1"] < 0.05


def test_graded_points_above_the_direct_limit() -> None:
    """Their cells differ, for which there is no preconditioner: the tangent is factorised."""
    deck = beam(9, 3, places=(9, 3))
    deck["geometry"]["graded"] = ["x0"]
    one, other = (solved(deck, f"galerkin.direct_limit={n}").last()["tip"] for n in (60000, 10))
    assert one == other


def test_other_forms_take_the_points_at_which_a_search_begins() -> None:
    with Scene.from_tables(without_points(), overrides=["scene.method=rkcm-mixed"]) as opened:
        assert opened.deck["geometry"]["source"] == [33, 9]
        assert opened.deck["geometry"]["collocation"] == [65, 17]
        assert not opened.points_found and "refine" not in opened.deck


def bar(**refine: Any) -> Scene:
    """A bar of 16 voxels along its axis, sheared."""
    rubber, ends = {**scenes.RUBBER, "label": 1}, "bottom top"
    tables = gripped("auto", {}, rubber, ends, "force force_x top", u_x=0.5, refine=refine)
    return Scene.from_tables(tables, scenes.voxels(np.ones((4, 4, 16)), 2.5, source_stride=[2] * 3))


@pytest.mark.slow
def test_models_are_refined_up_to_their_voxels() -> None:
    with bar(accuracy=0.002) as opened:
        states = opened.solve()
        assert opened.source_points > 3 * 3 * 9
    assert states.reasons[-1].endswith(
        "every voxel has its own source points; give a label map of finer voxels"
    )


def test_what_voxels_leave_open_is_not_promised() -> None:
    """Four voxels across: a force depends on its faces, known to 0.08 of a voxel on each side."""
    with bar(accuracy=0.05) as opened:
        found = solved(opened, error=True)
    assert found.bar("force") > 0.08 * abs(found.last()["force"])
    assert (
        "is not met: the voxels leave an uncertainty of 8 %, however many"
        in found.states.reasons[-1]
    )


def test_without_a_probe_nothing_can_be_refined() -> None:
    assert "refine: needs a probe" in scenes.refused({**cantilever(accuracy=0.01), "probe": []})


def test_a_search_reports_and_can_be_stopped(caplog: pytest.LogCaptureFixture) -> None:
    """Lines of a scene that is opened in memory go to `progress`, otherwise to a logger."""
    lines: list[str] = []
    Scene.from_tables(without_points(0.02), progress=lines.append).close()
    assert lines and all(re.match(r"refine \d+: \[.*CPU s$", line) for line in lines)
    with caplog.at_level("INFO", logger="myork"):
        Scene.from_tables(without_points(0.02)).close()
    assert [re.sub(r", [^,]* CPU s", "", line) for line in caplog.messages] == [
        re.sub(r", [^,]* CPU s", "", line) for line in lines
    ]

    def interrupt(line: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Scene.from_tables(without_points(0.02), progress=interrupt)
