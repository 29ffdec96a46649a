"""Decks of a new user, and finite elements beside them."""

import pytest

from benchmarks.problems import BY_NAME, DECKS
from benchmarks.runner import WRONG, Truth, Truths, sized_tables
from benchmarks.truths.deck_parts import probe
from benchmarks.truths.finite_elements import solve_deck
from benchmarks.voxel_bodies import body_cloud
from myork import Scene
from myork.bench.runs import read_deck, solve_case

pytestmark = pytest.mark.nightly


def test_there_are_twenty_and_they_name_nothing() -> None:
    assert len({problem.name for problem in DECKS}) == 20
    for problem in DECKS:
        tables = problem.tables
        assert set(tables) == {
            "title", "units", "scene", "geometry", "material", "boundary", "load", "probe",
        }  # fmt: skip
        assert set(tables["scene"]) == {"dimension"} and set(tables["load"]) == {"activation"}
        assert not any("curve" in material for material in tables["material"])


def test_few_cells_in_the_plane_are_compared_with_more() -> None:
    """Half of four cells made this answer, 1.6 % off, doubtful with a bar of 12 %."""
    problem = BY_NAME["soft sheet"]
    tables = sized_tables(problem.tables, problem.sizes[0])
    rival = solve_deck(read_deck(tables), (32, 16))["probes"]
    case = solve_case(tables, error=True)
    assert case["verdict"]["state"] == "accepted"
    assert case["companion"]["source_points"] == 17 * 9
    for name, (value,) in rival.items():
        # the mesh changes by 2e-4 from half as many elements
        bar = case["probe_errors"][name] + 2e-4 * abs(value)
        assert abs(case["probes"][name] - value) <= bar < WRONG * abs(value), name


def test_a_body_that_nothing_pulls_at_is_in_balance() -> None:
    """A muscle with a free end: its forces are rounding, of which all was left."""
    problem = BY_NAME["free muscle"]
    tables = sized_tables(problem.tables, problem.sizes[0])
    with Scene.from_tables(tables, threads=1) as scene:
        states = scene.solve(error=False)
        moved = scene.probes(states.x, states.load)[-1, 0, 0]
    assert states.verdict == "accepted" and states.force_imbalance < 1e-6
    assert moved < -0.2


def test_errors_of_an_answer() -> None:
    known = {"u": Truth(2.0, 0.02), "f": Truth(-1.0, 0)}
    truths = Truths({"u": "displacement", "f": "force"}, known)
    found = truths.errors({"u": 2.1, "f": -1.0}, {"u": 0.06})
    assert found["error"] == {"u": pytest.approx(0.05), "f": 0.0}
    assert found["off"] == pytest.approx(0.04) and found["held"] == "0 of 1"
    assert found["error displacement"] == pytest.approx(0.05) and found["bar force"] is None
    # a force that symmetry makes zero, beside another
    zero = Truths({"f": "force", "g": "force"}, {"f": Truth(10.0, 0), "g": Truth(1e-15, 0)})
    assert zero.errors({"f": 10.0, "g": 1e-4}, {})["error"]["g"] == pytest.approx(0.01)


def test_two_cells_across_are_looked_at_again() -> None:
    """Half of four cells made the free muscle, 1.4 % off, doubtful with a bar of 11 %."""
    problem = BY_NAME["free muscle"]
    case = solve_case(sized_tables(problem.tables, problem.sizes[0]), error=True)
    assert case["companion"]["source_points"] == 4 * 4 * 10
    assert case["verdict"] == {"state": "accepted", "reasons": []}
    # 9x9x25 points
    for name, value in (("end", -0.27302), ("belly", 0.02571)):
        assert abs(case["probes"][name] - value) < case["probe_errors"][name] < 0.2 * abs(value)


def test_corners_inside_out_are_doubtful() -> None:
    """J is negative in the glued corners of the pad, where no stress exists."""
    problem = BY_NAME["pad between plates"]
    tables = sized_tables(problem.tables, problem.sizes[0])
    case = solve_case(tables, error=True)
    assert case["min_J"] < 0 and case["verdict"]["state"] == "doubtful"
    (reason,) = case["verdict"]["reasons"]
    assert "the material is inverted (in 0.29 % of the volume)" in reason
    assert case["warnings"][-1] == reason
    corner = {**tables, "probe": [*tables["probe"], probe("corner", "u_x", (2.9, 0.9))]}
    case = solve_case(corner, error=True)
    assert case["verdict"]["state"] == "doubtful"
    assert any("near probe corner" in text for text in case["verdict"]["reasons"])


def test_thin_tissues_are_compared_with_three_quarters_of_their_blocks() -> None:
    """Half of the two blocks across the fat moved its side by 40 %."""
    body = BY_NAME["three tissues of voxels"]
    words = ["geometry.blocks=[8,4,16]"]
    case = solve_case(body.tables, words, cloud=body_cloud(body, body.sizes[0]), error=True)
    for name, value in (("interface", 0.0407), ("side", -0.0368), ("force z", 6.411)):
        assert abs(case["probes"][name] - value) < case["probe_errors"][name] < 0.2 * abs(value)
