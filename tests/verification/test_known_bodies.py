"""Bodies with known answers: the muscle block, voxels of true shapes, walls of tubes.

References are finite elements of the true shape, and the radial boundary value problem, whose
solution is the same at every angle.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.runner import sized_tables
from benchmarks.runs import solve_case
from benchmarks.truths import exact
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.truths.finite_elements import solve_deck
from benchmarks.unseen import answers, problem_of
from benchmarks.unseen_maps import AS_THEY_ARE, TRUTHS, body_of
from benchmarks.voxel_bodies import BODIES, Body, body_cloud, box_tables
from myork.bench.runs import read_deck
from myork.console import silent
from myork.core.deck import table_defaults
from myork.model.cloud import build_cloud
from myork.records import Labels
from myork.stations.solve import run_deck
from tests.scenes import PLANES, RUBBER, annulus, neo, scene, solved

# ---- the block between fixed ends at the smallest useful size, 5 x 5 x 9 at order 4 --------------

SIZE = ("geometry.source=[5,5,9]", "geometry.collocation=[9,9,17]")


@pytest.mark.slow
def test_inclined_fibers_meet_finite_elements(inputs: Path, tmp_path: Path) -> None:
    """Within 1.5 % of the deck's references to activation 0.15 in all six quantities.

    Measured: 1.2 %. With full weight of the rows on faces it is 2.1 %, with weights that do not
    decrease towards the edges 3 % or more: the bound fixes the row weights at those of the study.
    """
    overrides = (*SIZE, "load.steps=3", "load.activation=0.15")
    summary = run_deck(inputs / "muscle_fibers.toml", tmp_path, overrides=overrides, threads=1)
    assert summary["converged"] and len(summary["reference"]) == 6
    for name, entry in summary["reference"].items():
        assert len(entry["relative_error"]) == 3, name
        assert max(entry["relative_error"]) < 0.015, name


# ---- bodies from label maps ----------------------------------------------------------------------

#: Largest error of each probe with 4 to 8 source points across [-]: about 1.2 times the measured
#: one; with twice as many points the errors are less than half of these
BOUNDS = {
    "cylinder": {"mid": 0.001, "force x": 0.01, "force z": 0.008},
    "spindle": {"quarter": 0.015, "force z": 0.01},
    "bracket": {"tip": 0.024, "force z": 1e-6},
    # the rest is due to the map: 0.9 % of the force with half as large voxels
    "three": {"interface": 0.037, "side": 0.01, "force z": 0.022},
}

#: Values that the bars of these voxels must reach, and the largest bar, relative to the error and
#: to the value. For the cylinder half as many blocks differ by 0.1 % in the pull, which is 0.6 %
#: off due to stairs; the uncertainty of a component is a share of its whole vector, nine times the
#: error across the cylinder.
BARS = {
    "cylinder": {"force x": (22.19, 10.0, 1.0), "force z": (41.77, 10.0, 1.0)},
    "three": {"interface": (0.0407, np.inf, 0.1), "side": (-0.0368, np.inf, 0.15),
              "force z": (6.411, np.inf, 0.1)},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_coarse_voxels_against_elements_of_the_true_shape(body) -> None:
    deck = read_deck(box_tables(body))
    rival = solve_deck(deck, body.elements[-2], labels=body.part, warp=body.warp)
    cloud = body_cloud(body, body.sizes[0])
    case = solve_case(dict(body.tables), (), cloud=cloud, limit=120)
    assert case["outcome"] == "converged" and case["method"] == "rkpm-gauss"
    off = [abs(case["probes"][name] / value - 1) for name, value in rival["probes"].items()]
    assert max(off) < 0.05 or case["verdict"]["state"] == "doubtful", off
    kind = body.name.split()[0]
    if kind == "three":
        assert case["verdict"] == {"state": "accepted", "reasons": []}
    for name, (value, errors, share) in BARS.get(kind, {}).items():
        error = abs(case["probes"][name] - value)
        assert error < case["probe_errors"][name] < min(errors * error, share * abs(value)), name
    for name, bound in BOUNDS[kind].items():
        assert case["probes"][name] == pytest.approx(rival["probes"][name], rel=bound), name


def test_a_traction_acts_on_the_end_of_a_dome_not_on_its_slice() -> None:
    """Half a voxel further inside, the section is half as large again, and so was the load.

    The area of the end follows from the two slices before it to within a tenth: their voxel counts
    are off by five of 76, and the areas are extrapolated along a parabola, not its tangent.
    """
    top, load = 0.4, 0.5
    ends = held("bottom"), {"set": "top", "traction": [0, 0, -load]}
    dome = Body(
        "dome", (2.0, 2.0, 1.0),
        deck("dome", {"kind": "model"}, (neo(10.0, 300.0, label=1),), ends,
             (force("f_z", "z", "bottom"),)),
        lambda x: ((x[..., :2] - 1.0) ** 2).sum(-1) < 1.0 - (1.0 - top**2) * x[..., 2] ** 2,
        (0.2,), (),
    )  # fmt: skip
    case = solve_case(dict(dome.tables), (), cloud=body_cloud(dome, 0.2), limit=120)
    area = np.pi * top**2
    assert case["probes"]["f_z"] == pytest.approx(load * area, rel=0.1)
    # the end is narrower than its slice by a third, a fifth of which is left uncertain
    assert case["probe_errors"]["f_z"] > 0.2 * 0.3 * load * area


@pytest.mark.slow
def test_a_stress_is_judged_by_the_size_of_its_own_tissue() -> None:
    """In a soft core that carries a tenth of its surroundings the stress is 27 % off: relative to
    the mean of all tissues, that was accepted.
    """
    (found,) = answers({5: body_of(5)}, TRUTHS, silent, (), AS_THEY_ARE)
    assert found["off"] > 0.05 and found["verdict"] == "doubtful", found


# ---- walls of tubes, at planes of symmetry and between them --------------------------------------


#: Radii, motion of the inner wall, bulk modulus
TUBE = (6.0, 8.0, 6.0, 1e3)
STIFF = (6.0, 8.0, 6.0, 1e7)
#: Angles of the probes: on the planes of symmetry and between them
ANGLES = {"x": 0.0, "between": np.pi / 4, "y": np.pi / 2}


def tube_deck(tube: tuple[float, ...], source: list[int]) -> dict[str, Any]:
    """Quarter of a rubber tube with probes of the radial stress on its inner wall and of the hoop
    stress on its outer one; no form or order is given.
    """
    inner, outer, moved, bulk = tube
    wanted = [
        probe(f"{wall} {name}", quantity, (radius * np.round([np.cos(a), np.sin(a)], 15)).tolist())
        for name, a in ANGLES.items()
        for wall, radius, quantity in (("inner", inner, "cauchy_rr"), ("outer", outer, "cauchy_tt"))
    ]
    return scene(
        "auto", annulus(*source, radii=(inner, outer)), material=[{**RUBBER, "K": bulk}],
        boundary=[*PLANES[:2], {"set": "inner", "radial": moved}], probe=wanted,
    )  # fmt: skip


def wall_stresses(inner: float, outer: float, moved: float, bulk: float) -> dict[str, float]:
    """Radial stress on the inner wall, and hoop stress on the outer one."""
    law = exact.Polynomial.from_deck(RUBBER, bulk)
    found = exact.tube(law, inner, outer, moved, [inner, outer])
    return {"inner": float(found.radial[0]), "outer": float(found.hoop[1])}


@pytest.mark.slow
@pytest.mark.parametrize(("tube", "source"), [
    (TUBE, [9, 51]), (STIFF, [9, 51]), ((10.0, 11.0, 5.0, 1e3), [5, 51]),
    ((6.0, 8.0, -1.0, 1e3), [9, 51]),
])  # fmt: skip
def test_stress_on_the_walls_is_as_right_as_the_run_says(tube, source):
    """With a support of 2.5 the walls were 20 and 6 % off at planes of symmetry, but accepted."""
    walls = wall_stresses(*tube)
    found = solved(tube_deck(tube, source), error=True)
    assert found.states.verdict == "accepted", found.states.reasons
    for name, value in found.last().items():
        truth, bar = walls[name.split()[0]], found.bar(name)
        assert abs(value - truth) <= bar, f"{name}: {value} instead of {truth}, bar {bar}"
        assert bar < 0.05 * abs(truth), f"{name}: bar of {bar / abs(truth):.1%}"


@pytest.mark.parametrize(("tube", "bound"), [
    (TUBE, 3.5e-5), (STIFF, 3.5e-5), ((6.0, 8.0, 6.0, 20.0), 3e-5), ((1.0, 3.0, 0.7, 1e3), 3.5e-4),
    ((10.0, 11.0, 2.0, 1e4), 5e-5),
])  # fmt: skip
def test_force_of_order_two_falls_with_the_third_power_of_the_spacing(tube, bound) -> None:
    """The cut carries the pressure on the bore. Where they meet, tractions are of order two over a
    length of one spacing; from a motion of the cut alone, which jumps there, errors with few points
    are 3 to 7 times larger.
    """
    truth = wall_stresses(*tube)["inner"] * (tube[0] + tube[2])
    errors = []
    for source in ([5, 26], [9, 51]):
        tables = tube_deck(tube, source)
        tables["probe"] = [force("cut", "x", "x0"), force("bore", "x", "inner")]
        found = solved(tables).last()
        assert found["bore"] == pytest.approx(-found["cut"], rel=1e-6)
        errors.append(abs(found["cut"] / truth - 1.0))
    assert errors[0] < bound and 6.5 < errors[0] / errors[1] < 25.0


@pytest.mark.parametrize("essential", ["penalty", "transformation"])
@pytest.mark.parametrize(("source", "bound"), [([5, 26], 5e-4), ([5, 51], 1.5e-4), ([9, 51], 1e-4)])
def test_the_wall_bears_what_its_supports_exert(source, bound, essential) -> None:
    """From derivatives of the displacement and pressures of groups, the errors at the plane of
    symmetry are 1.2e-2 and 3.6e-3 (5x26, 9x51); from one-sided fits there 2.9e-4 (5x51).
    """
    tables = tube_deck(TUBE, source) | {"galerkin": {"essential": essential}}
    found, truth = solved(tables).last(), wall_stresses(*TUBE)["inner"]
    assert [found["inner x"], found["inner y"]] == pytest.approx([truth] * 2, rel=bound)
    assert found["inner between"] == pytest.approx(truth, rel=0.7 * bound)


def test_a_glued_end_bears_what_its_supports_exert() -> None:
    """A bent quarter ring fixed at both ends, in the middle of one end: otherwise 10 % off.

    Finite elements of four meshes give -0.2404, with a doubt of 0.8 %.
    """
    tables = sized_tables(problem_of(48).tables, [9, 17])
    tables["probe"] = [probe("s_end", "cauchy_xx", (0.0, 1.125))]
    assert solved(tables).last()["s_end"] == pytest.approx(-0.2404, rel=0.02)


#: Radii of muscle on a round bone, its shear modulus, displacement and traction of the skin
BONE, SKIN, MU, MOVED, PULL = 0.8, 2.0, 5.0, 0.02, 0.05


def on_bone(voxel: tuple[float, float], stride: int, **skin: Any) -> Any:
    """Antiplane shear of a ring of length 1, whose middle is that of no voxel."""
    count = [int(np.ceil(2.2 * SKIN / size)) for size in voxel]
    x, y = (
        (np.arange(n) - 0.5 * (n - 1) - off) * size
        for n, off, size in zip(count, (0.13, 0.31), voxel, strict=True)
    )
    r = np.hypot(x[:, np.newaxis], y)
    labels = np.select([r < BONE, r < SKIN], [3, 1]).astype(np.int32)
    affine = np.diag([*voxel, 0.25, 0.1]) * 10.0
    affine[:3, 3] = 10.0 * np.array([x[0], y[0], 0.125])
    table = {**table_defaults("build"), "bone": [3], "source_stride": [stride, stride, 1]}
    label_map = Labels(np.repeat(labels[:, :, np.newaxis], 4, 2), affine, {}, "ring")
    cloud, _ = build_cloud(label_map, None, table, "cm")
    ends = [{"set": end, "u_x": 0.0, "u_y": 0.0} for end in ("bottom", "top")]
    wanted = [force("force", "z", "bone"), probe("u", "u_z", (0.0, 1.8, 0.5))]
    boundary = [*ends, held("bone"), {"set": "surface", **skin}]
    rubber = {"name": "m", "label": 1, "model": "neo-hookean", "mu": MU, "K": 500.0}
    tables = deck("ring on bone", {"kind": "model"}, (rubber,), boundary, wanted)
    return solved(tables, cloud=cloud, error=True)


@pytest.mark.parametrize(("voxel", "stride"), [
    ((0.1, 0.1), 1), ((0.12, 0.17), 1), ((0.05, 0.05), 4),
])  # fmt: skip
def test_bone_holds_muscle_at_its_surface(voxel, stride) -> None:
    """Not at the edges of its voxels: forces were 5 to 9 % too large, beyond bars of 1 to 5 %."""
    truth = -2 * np.pi * MU * MOVED / np.log(SKIN / BONE)
    found = on_bone(voxel, stride, u_x=0.0, u_y=0.0, u_z=MOVED)
    assert found.states.verdict == "accepted"
    assert abs(found.last()["force"] - truth) < min(found.bar("force"), 0.022 * abs(truth))
    truth = PULL * SKIN / MU * np.log(1.8 / BONE)
    found = on_bone(voxel, stride, traction=[0.0, 0.0, PULL])
    assert found.states.verdict == "accepted"
    assert abs(found.last()["u"] - truth) < min(found.bar("u"), 0.03 * truth)


# ---- decks of inputs/ against stored answers -----------------------------------------------------

#: Value, tolerance and origin of each number; those of this program are changed by hand when a
#: change of the method alters them
REFERENCES = Path(__file__).parents[1] / "references"


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted(REFERENCES.glob("*.json")), ids=lambda file: file.stem)
def test_deck(file: Path, inputs: Path) -> None:
    """Probes by name and component, and the iterations of all steps."""
    reference = json.loads(file.read_text(encoding="utf-8"))
    answer = solved(inputs / f"{file.stem}.toml", *reference["overrides"])
    ends = answer.ends() | {"iterations": answer.states.iterations.sum(keepdims=True)}
    for name, entry in reference["values"].items():
        probe, _, axis = name.partition(".")
        found = ends[probe]["xyz".find(axis)]
        assert found == pytest.approx(entry["value"], rel=0, abs=entry["tolerance"]), name
