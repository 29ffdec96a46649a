"""Load programmes: amplitudes, activations of muscles and of places, motions of boundary sets."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import Scene, build, load_deck, run_deck
from myork.model_file import read_model, write_model
from myork.records import PointCloud
from tests import scenes
from tests.scenes import box, gripped, held, refused, refuses, scene, voxels

RAMP = {"name": "pull", "time": [0, 1], "value": [0, 1]}
MUSCLE = {"name": "muscle", "model": "muscle", "A10": 1.0, "K": 500.0}
#: Forms with options with which a coarse block converges
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


def times(time: list[float], name: str = "other") -> dict[str, Any]:
    """An amplitude that nothing uses: its times are load steps."""
    return {"name": name, "time": time, "value": [0] * len(time)}


# with so few points collocation has saddles on the path, and its answer is refused
@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
def test_a_plate_follows_its_amplitude_and_all_knots_are_steps(method: str) -> None:
    deck = block(method, load={"steps": 2})
    load, probes, _ = solved(deck)
    assert load.tolist() == [0.4, 0.5, 0.7, 1.0]
    # forms that prescribe plates by a penalty miss the value slightly
    np.testing.assert_allclose(probes[:, 0], [0.2, 0.2, 0.2, 0.1], atol=4e-3)
    # with a fixed plate nothing changes; moved back, it pulls less
    np.testing.assert_allclose(probes[1:3, 1], probes[0, 1], rtol=1e-6)
    assert 0 < probes[3, 1] < probes[0, 1]


def test_load_times_of_all_kinds_are_merged() -> None:
    """Equal steps and knots, without duplicates up to rounding, and without 0, which is rest."""
    others = times([0, 0.25, 0.4 + 1e-12, 0.9]), times([0, 0.3, 0.4 - 1e-12, 0.95], "third")
    deck = block(load={"steps": 2})
    deck["amplitude"] = [*deck["amplitude"], *others]
    wanted = [0.25, 0.3, 0.4, 0.5, 0.7, 0.9, 0.95, 1.0]
    with Scene.from_tables(deck) as scene:
        assert scene.steps == len(wanted)
        assert scene.solve(error=False).load == pytest.approx(wanted, abs=1e-9)


def test_a_smooth_amplitude_has_no_slope_at_its_knots() -> None:
    deck = block()
    deck["amplitude"] = [RAMP | {"curve": "smooth"}, times([0, 0.01, 0.25, 0.5, 0.99])]
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
    # an activation of zero, as at the end of a range, may follow an amplitude
    zero = with_amplitude({"amplitude": "pull", "activation": 0.0})
    np.testing.assert_array_equal(solved(zero)[1], solved(with_amplitude())[1])


def test_states_of_a_programme_are_compared_at_their_own_loads() -> None:
    """Also where the second solution needs more steps than the answer."""
    flat = gripped(
        "auto", box(7, 7, 7, size=[2, 2, 0.6]), scenes.neo(10, 500), "z0 z1", "pull force_z z1",
        u_z=0.35, amplitude=[RAMP], load={"steps": 3},
    )  # fmt: skip
    flat["boundary"][1]["amplitude"] = "pull"
    with Scene.from_tables(flat) as opened:
        states = opened.solve()
    assert states.verdict == "accepted"
    bars = states.probe_errors[:, 0, 0]
    assert 0 < bars[0] < bars[1] < bars[2] < 2


def test_a_programme_that_ends_at_rest_is_judged_by_its_way(tmp_path: Path) -> None:
    deck = block(material=[{"name": "rubber", "model": "neo-hookean", "mu": 1.0, "K": 20.0}])
    deck["geometry"] |= {"source": [4] * 3, "collocation": [5] * 3}
    deck["amplitude"][0]["value"] = [0, 1, 1, 0]
    summary = run_deck(deck, tmp_path)
    assert summary["verdict"] == {"state": "accepted", "reasons": []}
    bars = [step["probe_errors"]["pull"] for step in summary["steps"]]
    pull = summary["steps"][0]["probes"]["pull"]
    # each state has its own bar: the same with a fixed plate, almost none at rest
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
    # already active while it is stretched
    assert load[0] == 0.2 and probes[0, 1] > together[1][0, 1] / 2


def with_amplitude(load: dict[str, Any] | None = None, **change: Any) -> dict[str, Any]:
    deck = block() if load is None else block(load=load)
    deck["amplitude"][0].update(change)
    return deck


@pytest.mark.parametrize(("deck", "complaint"), [
    (with_amplitude(time=[0.1, 0.2, 0.3, 1]), "pull.time: must start at 0, not 0.1"),
    (with_amplitude({"amplitude": "pull"}), "there is no activation to scale by it"),
    (with_amplitude({"amplitude": "pull", "activation": 0.7}, value=[0, 2, 1, 0]),
     "leads to an activation of 1.4 of muscle"),
    (block("rkcm", probe=[{**scenes.probes("p force z1")[0], "material": "muscle"}]),
     "the force of one material needs a Galerkin form"),
])  # fmt: skip
def test_what_cannot_be_is_refused(deck: dict[str, Any], complaint: str) -> None:
    assert complaint in refused(deck)


def test_summary_tells_activations_where_they_differ(tmp_path: Path) -> None:
    deck = block(load={"activation": 0.2})
    deck["material"][0] |= {"activation": 0.1, "amplitude": "pull"}
    summary = run_deck(deck, tmp_path, error=False)
    assert [step["load"] for step in summary["steps"]] == [0.4, 0.7, 1.0]
    # what the only muscle gets, not load.activation
    assert [step["activation"] for step in summary["steps"]] == pytest.approx([0.1, 0.1, 0.05])
    assert "activations" not in summary["steps"][0]
    other = {**deck["material"][0], "name": "other", "where": "x > 0.5", "activation": 0.4}
    deck["material"].append({key: value for key, value in other.items() if key != "amplitude"})
    steps = run_deck(deck, tmp_path, error=False)["steps"]
    assert [step["activations"]["muscle"] for step in steps] == pytest.approx([0.1, 0.1, 0.05])
    assert [step["activations"]["other"] for step in steps] == pytest.approx([0.16, 0.28, 0.4])


#: Numbers of a muscle as a whole
WHOLE = [
    *scenes.probes("pull force_z z1"), {"name": "energy", "quantity": "energy"},
    {"name": "part", "quantity": "energy", "material": "muscle"},
    {"name": "stretch", "quantity": "fiber_stretch", "material": "muscle"},
    {"name": "angle", "quantity": "pennation", "normal": [0, 0, 2], "material": "muscle"},
]  # fmt: skip


def test_work_is_stored_energy_and_what_activation_adds() -> None:
    """Energy changes by the work of the plate, and by activation alone while the plate is fixed."""
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
    # compliant supports store the rest
    assert np.all(part <= energy)
    assert np.abs(part - energy).max() < 0.05 * np.abs(energy).max()


def test_energy_of_the_body_is_without_that_of_springs() -> None:
    """Half the work of a small pull is stored, in part by the spring."""
    deck = scene(
        "auto", box(3, 3, 3), material=[scenes.neo(10, 500)], load={"steps": 1},
        boundary=[held("z0"), {"set": "z1", "traction": [0, 0, 0.01], "spring": [0, 0, 30]}],
        probe=[*WHOLE[1:2], *scenes.probes("end u_z z1")],
    )  # fmt: skip
    last = scenes.solved(deck).last()
    body, spring = last["energy"], 15 * last["end"] ** 2
    assert body + spring == pytest.approx(0.01 * last["end"] / 2, rel=0.02)
    assert 0.5 < spring / body < 2


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


# ---- activation as a field of places -------------------------------------------------------------

CALF = {"name": "muscle", "model": "muscle", "A10": 1.0, "K": 200, "fiber": [0, 0, 1]}


def grip(material: Any, method: str = "rkpm-gauss", **more: Any) -> dict[str, Any]:
    """Fixed at both ends, free to widen across them."""
    body = box(5, 5, 5, size=[1, 1, 2], places=(5, 5, 5))
    return gripped(method, body, material, "z0 z1", "pull force_z z1", **more)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
def test_a_constant_field_is_a_number(method: str) -> None:
    """To the last bit: half of 1 equals all of a half."""
    field = grip(CALF | {"activation": "z > 5 ? 0 : 0.3"}, method)
    number = grip(CALF | {"activation": 0.3}, method)
    assert np.array_equal(scenes.solved(field).states.x, scenes.solved(number).states.x)


def bar(share: float | None = None) -> PointCloud:
    """A bar of voxels; one half of them may have a share of the activation, the other none."""
    parts = (
        None if share is None else np.repeat([share, 0.0], 4)[:, None, None] * np.ones((8, 8, 12))
    )
    return voxels(np.ones((8, 8, 12)), 1.25, activation=parts, source_stride=[2] * 3)


def model_tables(method: str = "auto", **material: Any) -> dict[str, Any]:
    return gripped(method, {}, CALF | material, "bottom top", "pull force_z top")


@pytest.mark.slow
def test_points_of_a_model_have_activations(tmp_path: Path) -> None:
    """From an image through the model file to the solve; constant fields equal numbers bitwise."""
    plain = bar()
    number = scenes.solved(model_tables(activation=0.3), cloud=plain).states.x
    constant = replace(plain, activation=np.full(len(plain.points), 0.3))
    assert np.array_equal(
        scenes.solved(model_tables(activation=1.0), cloud=constant).states.x, number
    )

    cloud = bar(0.3)
    assert cloud.activation is not None
    centre = cloud.points[:, 0].mean()
    assert cloud.activation[cloud.points[:, 0] < centre].mean() > 0.25
    assert cloud.activation[cloud.points[:, 0] > centre].mean() < 0.05
    write_model(tmp_path / "model.h5", cloud)
    again = read_model(tmp_path / "model.h5")
    assert np.array_equal(again.activation, cloud.activation)
    found = scenes.solved(model_tables(activation=1.0), cloud=again, error=True)
    # a coarser cloud, whose blocks take the mean activation, gives it an error bar
    assert np.isfinite(found.bars["pull"][-1, 0])
    whole = scenes.solved(model_tables(activation=0.3), cloud=plain).last()["pull"]
    assert found.last()["pull"] == pytest.approx(0.5 * whole, rel=0.1)
    # an expression in the deck replaces the activation of the points
    field = model_tables(activation="0.3")
    assert np.array_equal(scenes.solved(field, cloud=again).states.x, number)


def test_activations_of_points_that_cannot_be() -> None:
    plain = bar()
    n = len(plain.points)
    for method, values, message in (
        ("auto", np.full(3, 0.5), "'activation' has shape (3,), but (768,) is needed"),
        ("auto", np.full(n, 1.5), "'activation' must contain numbers from 0 to 1"),
        ("rkcm", np.full(n, 0.5), "collocation needs their gradients"),
    ):
        tables = model_tables(method, activation=1.0)
        assert message in refused(tables, replace(plain, activation=values))
    refuses(r"activation must lie between 0 and 1, but is 2", bar, 2.0)
    said = refused(grip(CALF | {"activation": "1.5*x"}))
    assert "activation" in said and "must be between 0 and 1" in said


def steps(deck: Path, out: Path, *overrides: str) -> dict[str, np.ndarray]:
    """Loads, smallest J and probes of all steps by name."""
    summary = run_deck(deck, out, overrides=overrides, error=False)
    rows = [step | step["probes"] for step in summary["steps"]]
    names = ("load", "min_J", *summary["steps"][0]["probes"])
    return {name: np.array([row[name] for row in rows]) for name in names}


@pytest.mark.slow
def test_two_muscles_share_the_force_of_a_joint(inputs: Path, tmp_path: Path) -> None:
    coarse = ("build.collocation_stride=[2,2,2]", "build.source_stride=[4,4,4]",
              "geometry.blocks=[8,4,6]")  # fmt: skip
    deck = inputs / "two_muscles.toml"
    build(deck, tmp_path, overrides=coarse)
    probe = {"name": "force_tissue", "quantity": "force_z", "set": "top", "material": "tissue"}
    tables = load_deck(deck, overrides=coarse)
    assert [table["name"] for table in tables["material"]] == ["agonist", "antagonist", "tissue"]
    found = steps(deck, tmp_path, *coarse)
    parts = steps(deck, tmp_path, *coarse, f'probe.force_agonist.material="{probe["material"]}"')
    total = found["force_agonist"] + found["force_antagonist"] + parts["force_agonist"]
    np.testing.assert_allclose(total, found["force"], rtol=1e-9)
    # contraction; the plate yields; contraction of the other
    assert found["load"] == pytest.approx([0.3, 0.7, 1.0])
    agonist, antagonist = found["force_agonist"], found["force_antagonist"]
    assert agonist[0] > agonist[1] > 0
    assert found["stretch_agonist"][1] < found["stretch_agonist"][0] - 0.01
    assert found["stretch_antagonist"][1] > 1.0
    assert antagonist[2] > antagonist[1] + 4
    assert found["torque"][2] < found["torque"][1] < found["torque"][0]
    # the tissue between the muscles is compressed, not crushed
    assert found["min_J"].min() > 0.6
