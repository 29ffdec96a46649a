"""Load programmes: amplitudes, activations of single muscles, motions of boundary sets."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from myork import Scene, run_deck
from tests import scenes
from tests.scenes import box, held, refused, scene

RAMP = {"name": "pull", "time": [0, 1], "value": [0, 1]}
MUSCLE = {"name": "muscle", "model": "muscle", "A10": 1.0, "K": 500.0}
#: Forms with options that let a coarse block converge
METHODS: dict[str, Any] = {"rkpm-gauss": {}, "rkpm-scni": {}, "rkcm": {"order": 2, "support": 2.5}}


def block(method: str = "auto", **changes: Any) -> dict[str, Any]:
    """A block of muscle between two plates, of which the upper one moves."""
    tables = scene(
        method, box(3, 3, 3, places=(4, 4, 4)),
        material=[{**MUSCLE, "fiber": [0.3, 0, 1]}],
        boundary=[held("z0"), held("z1", u_z=0.2, amplitude="pull")],
        amplitude=[{"name": "pull", "time": [0, 0.4, 0.7, 1], "value": [0, 1, 1, 0.5]}],
        probe=scenes.probes("plate u_z 0.5 0.5 1", "pull force_z z1"),
    )  # fmt: skip
    return tables | {"approximation": METHODS.get(method, {})} | changes


def solved(deck: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Loads, values of the probes at each of them, unknowns of the last one."""
    states, probes, *_ = scenes.solved(deck)
    return states.load, np.stack([v[:, 0] for v in probes.values()], axis=1), states.x[-1]


@pytest.mark.parametrize("method", METHODS)
def test_a_plate_follows_its_amplitude_and_all_knots_are_steps(method: str) -> None:
    deck = block(method, load={"at": [0.5], "steps": 2})
    load, probes, _ = solved(deck)
    assert load.tolist() == [0.4, 0.5, 0.7, 1.0]
    # forms that hold plates by a penalty miss the value by a little
    np.testing.assert_allclose(probes[:, 0], [0.2, 0.2, 0.2, 0.1], atol=4e-3)
    # held still, nothing changes; drawn back, it pulls less
    # (weights of collocation follow the state, and its forces the weights)
    rtol = 1e-2 if method == "rkcm" else 1e-6
    np.testing.assert_allclose(probes[1:3, 1], probes[0, 1], rtol=rtol)
    assert 0 < probes[3, 1] < probes[0, 1]


def test_load_times_of_all_kinds_are_merged() -> None:
    """Those of any order, those that are there twice but for rounding, and 0, which is rest."""
    twice = {"name": "other", "time": [0, 0.25, 0.4 + 1e-12, 0.9], "value": [0, 1, 0, 1]}
    deck = block(load={"at": [0.9, 0.3, 0.4 - 1e-12, 0.3, 0.95]})
    deck["amplitude"] = [*deck["amplitude"], twice]
    wanted = [0.25, 0.3, 0.4, 0.7, 0.9, 0.95, 1.0]
    with Scene.from_tables(deck) as scene:
        assert scene.steps == len(wanted)
        assert scene.solve(error=False).load == pytest.approx(wanted, abs=1e-9)


def test_a_smooth_amplitude_has_no_slope_at_its_knots() -> None:
    deck = block(load={"at": [0.01, 0.25, 0.5, 0.99]})
    deck["amplitude"] = [RAMP | {"curve": "smooth"}]
    load, probes, _ = solved(deck)
    assert load.tolist() == [0.01, 0.25, 0.5, 0.99, 1.0]
    expected = load**3 * (10 - load * (15 - 6 * load))
    np.testing.assert_allclose(probes[:, 0], 0.2 * expected, atol=3e-3)
    np.testing.assert_allclose(probes[0, 0] / 0.2, expected[0], rtol=0.02)


def test_the_ramp_is_an_amplitude_like_others() -> None:
    load = {"steps": 3, "activation": 0.2}
    by_name, plain = block(load=load | {"amplitude": "pull"}, amplitude=[RAMP]), block(load=load)
    del plain["amplitude"], plain["boundary"][1]["amplitude"]
    for one, other in zip(solved(by_name), solved(plain), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)
    # an activation of zero, as at the end of a range of them, may follow one
    zero = with_amplitude({"amplitude": "pull", "activation": 0.0})
    np.testing.assert_array_equal(solved(zero)[1], solved(with_amplitude())[1])


def test_a_programme_that_ends_at_rest_is_judged_by_its_way(tmp_path: Path) -> None:
    deck = block(material=[{"name": "rubber", "model": "neo-hookean", "mu": 1.0, "K": 20.0}])
    deck["geometry"] |= {"source": [4] * 3, "collocation": [5] * 3}
    deck["amplitude"][0]["value"] = [0, 1, 1, 0]
    summary = run_deck(deck, tmp_path)
    assert summary["verdict"] == {"state": "accepted", "reasons": []}
    bars = [step["probe_errors"]["pull"] for step in summary["steps"]]
    pull = summary["steps"][0]["probes"]["pull"]
    # each state has a bar of its own: held still the same one, at rest hardly any
    assert 1e-3 * pull < bars[0] == pytest.approx(bars[1], rel=1e-6)
    assert bars[2] < 1e-5 * pull


def test_each_muscle_has_an_activation_of_its_own() -> None:
    common, own = block(load={"activation": 0.2, "amplitude": "pull"}), block()
    own["material"][0] |= {"activation": 0.2, "amplitude": "pull"}
    together = solved(common)
    for one, other in zip(together, solved(own), strict=True):
        np.testing.assert_array_equal(one, other)
    own["load"] = {"activation": 0.9}
    own["material"][0]["amplitude"] = "hold"
    own["amplitude"].append({"name": "hold", "time": [0, 0.2], "value": [0, 1]})
    load, probes, _ = solved(own)
    # active already while it is stretched
    assert load[0] == 0.2 and probes[0, 1] > together[1][0, 1] / 2


@pytest.mark.parametrize("method", METHODS)
def test_a_body_whose_ends_turn_together_turns_as_one(method: str) -> None:
    axis, about, angle = np.array([1.0, 2, -0.5]), np.array([0.2, 0, 1.5]), 150.0
    motion = {"rotation": angle, "axis": axis.tolist(), "about": about.tolist(), "u_x": 0.3}
    place = np.array([0.3, 0.6, 0.4])
    deck = block(
        method, boundary=[{"set": name, **motion, "amplitude": "turn"} for name in ("z0", "z1")],
        amplitude=[{"name": "turn", "time": [0, 0.5, 1], "value": [0, 1, 0.8]}],
        load={"steps": 1 if method != "rkcm" else 8},
        probe=scenes.probes("inside u 0.3 0.6 0.4", "stress cauchy_xy 0.3 0.6 0.4"),
    )  # fmt: skip
    states, probes, *_ = scenes.solved(deck)
    for load, part in ((0.5, 1.0), (1.0, 0.8)):
        step = states.load.tolist().index(load)
        turn = Rotation.from_rotvec(part * angle * axis / np.linalg.norm(axis), degrees=True)
        expected = about + turn.apply(place - about) - place + [0.3 * part, 0, 0]
        np.testing.assert_allclose(probes["inside"][step], expected, atol=1e-6)
        assert abs(probes["stress"][step, 0]) < 1e-5


def test_a_plane_body_turns_about_z() -> None:
    motion = {"rotation": -90, "about": [0.0, 0.0]}
    deck = scene(
        "auto", box(4, 4, places=(5, 5)), boundary=[{"set": y, **motion} for y in ("y0", "y1")],
        material=[{"name": "rubber", "model": "neo-hookean", "mu": 1.0, "K": 100.0}],
        probe=[{"name": "corner", "quantity": "u", "point": [1.0, 0.5]}],
    )  # fmt: skip
    corner = scenes.solved(deck).probes["corner"][-1, :2]
    np.testing.assert_allclose(corner, [-0.5, -1.5], atol=1e-9)


def with_amplitude(load: dict[str, Any] | None = None, **change: Any) -> dict[str, Any]:
    deck = block() if load is None else block(load=load)
    deck["amplitude"][0].update(change)
    return deck


def with_probe(method: str = "auto", **probe: Any) -> dict[str, Any]:
    return block(method, probe=[{"name": "p", **probe}])


@pytest.mark.parametrize(("deck", "complaint"), [
    (with_amplitude(time=[0.1, 0.2, 0.3, 1]), "pull.time: must start at 0, not 0.1"),
    (with_amplitude({"amplitude": "pull"}), "there is no activation to scale by it"),
    (with_amplitude({"amplitude": "pull", "activation": 0.7}, value=[0, 2, 1, 0]),
     "leads to an activation of 1.4 of muscle"),
    (with_probe(quantity="energy", set="z1"), "set: cannot be given for energy, a quantity of"),
    (with_probe("rkcm", quantity="force", set="z1", material="muscle"),
     "the force of one material needs a Galerkin form"),
])  # fmt: skip
def test_what_cannot_be_is_refused(deck: dict[str, Any], complaint: str) -> None:
    assert complaint in refused(deck)


def test_summary_tells_activations_where_they_differ(tmp_path: Path) -> None:
    deck = block(load={"activation": 0.2})
    deck["material"][0] |= {"activation": 0.1, "amplitude": "pull"}
    summary = run_deck(deck, tmp_path, error=False)
    assert [step["load"] for step in summary["steps"]] == [0.4, 0.7, 1.0]
    assert [step["activations"]["muscle"] for step in summary["steps"]] == [0.1, 0.1, 0.05]
    assert [step["activation"] for step in summary["steps"]] == pytest.approx([0.08, 0.14, 0.2])
    del deck["material"][0]["amplitude"], deck["material"][0]["activation"]
    assert "activations" not in run_deck(deck, tmp_path, error=False)["steps"][0]


#: Numbers of a muscle as a whole
WHOLE = [
    *scenes.probes("pull force_z z1"), {"name": "energy", "quantity": "energy"},
    {"name": "part", "quantity": "energy", "material": "muscle"},
    {"name": "stretch", "quantity": "fiber_stretch", "material": "muscle"},
    {"name": "angle", "quantity": "pennation", "normal": [0, 0, 2], "material": "muscle"},
]  # fmt: skip


def test_work_is_stored_energy_and_what_activation_adds() -> None:
    """Energy changes by the work of the plate, and by activation alone while the plate stands."""
    deck = block(load={"steps": 40}, probe=WHOLE)
    deck["material"][0] |= {"activation": 0.3, "amplitude": "excite"}
    deck["amplitude"] = [
        {"name": "pull", "time": [0, 0.25, 0.5, 0.75], "value": [0, 1, 1, -0.5]},
        {"name": "excite", "time": [0, 0.25, 0.5], "value": [0, 0, 1]},
    ]
    load, probes, _ = solved(deck)
    place = 0.2 * np.interp(load, [0, 0.25, 0.5, 0.75], [0, 1, 1, -0.5])
    pull, energy, part = probes[:, :3].T
    work = np.cumsum(0.5 * (pull[1:] + pull[:-1]) * np.diff(place))
    for first, last in ((0.05, 0.25), (0.5, 0.75)):
        i, j = (int(np.argmin(abs(load - at))) for at in (first, last))
        gained = work[j - 1] - work[i - 1]
        assert energy[j] - energy[i] == pytest.approx(gained, rel=5e-3)
    held = (load > 0.25) & (load < 0.5)
    assert np.ptp(place[held]) == 0
    assert np.ptp(energy[held]) > 0.1
    # supports give way a little and store the rest
    assert np.all(part <= energy)
    assert np.abs(part - energy).max() < 0.05 * np.abs(energy).max()


@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni", "rkcm"])
def test_stretch_and_pennation_of_a_stretched_block(method: str) -> None:
    """Uniform stretch: fibers of 30 degrees turn towards the pull."""
    stretch, across, angle = 1.2, 0.95, np.radians(30)
    grown = {"u_x": "-0.05 * x", "u_y": "-0.05 * y", "u_z": "0.2 * z"}
    deck = scene(
        method, box(4, 4, 4, places=(5, 5, 5)), approximation={"order": 2, "support": 2.5},
        material=[{**MUSCLE, "fiber_angle": 30.0}],
        boundary=[{"set": f"{a}{k}", **grown} for a in "xyz" for k in (0, 1)], probe=WHOLE[3:],
    )  # fmt: skip
    _, probes, _ = solved(deck)
    fiber = np.array([across * np.sin(angle), stretch * np.cos(angle)])
    expected = [np.linalg.norm(fiber), np.degrees(np.arctan2(*fiber))]
    np.testing.assert_allclose(probes[-1], expected, rtol=1e-6)
