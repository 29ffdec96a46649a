"""Two tissues in one body: parts of voxels that a surface or an interface cuts, smooth moduli."""

from dataclasses import replace
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from benchmarks.truths import bodies, exact
from myork.bench.materials import RUBBER
from myork.errors import InputError
from myork.model_file import read_model, write_model
from myork.records import PointCloud, Voxels
from tests import scenes
from tests.scenes import box, check_strong_rows, gripped, held, neo, scene, slip, solved, voxels

TWO = {"source_stride": [2] * 3, "collocation_stride": [2] * 3}
COLLOCATION = pytest.mark.parametrize("method", ["rkcm", "rkcm-mixed"])
GALERKIN = pytest.mark.parametrize("method", ["rkpm-scni", "rkpm-gauss"])


def rubbers(*mu: float, bulk: float) -> list[dict[str, Any]]:
    """Soft materials of labels 1, 2 and so on, K a multiple of the shear modulus."""
    return [neo(m, bulk * m, f"m{k}", label=k) for k, m in enumerate(mu, 1)]


def brick(share: NDArray[Any], slices: int) -> PointCloud:
    """Voxels of edge 0.5 in a block, all slices filled alike, with a set for each face."""
    n = (*share.shape, slices)
    middles = bodies.box(0.5 * (np.array(n) - 1.0), n, n)
    index = np.rint(middles.points / 0.5).astype(np.int32)
    return replace(
        middles, source=middles.source + 0.25, points=middles.points + 0.25,
        volume=np.repeat(share.ravel(), slices) * 0.125, area=np.full(len(middles.area), 0.25),
        voxels=Voxels(index, np.full(3, 0.5), np.full(3, 0.25)),
    )  # fmt: skip


@GALERKIN
@pytest.mark.parametrize("end", [{"u_z": 0.6}, {"traction": [0.0, 0.0, 4.0]}], ids=str)
def test_uniaxial_tension_is_exact_however_full_the_voxels_are(end, method) -> None:
    """Linear displacements leave no force on any point; the section is the sum of its shares."""
    share = np.random.default_rng(3).uniform(0.3, 1.3, (4, 3))
    tables = scene(
        method, {}, material=[RUBBER], boundary=[*scenes.PLANES, {"set": "z1", **end}],
        solver={"tolerance": 1e-10},
        probe=scenes.probes("F force_z z0", "s cauchy_zz 1 0.7 1.1", "u u_z 0.5 0.7 3"),
    )  # fmt: skip
    found = solved(tables, cloud=brick(share, 6)).last()
    stress = exact.uniaxial(exact.Polynomial.from_deck(RUBBER), 1 + found["u"] / 3.0)
    assert found["s"] == pytest.approx(stress, rel=1e-7)
    if "traction" in end:
        assert found["F"] == pytest.approx(-4.0 * 0.25 * share.sum(), rel=1e-7)
    else:
        whole = solved(tables, cloud=brick(share**0, 6)).last()["F"]
        assert found["F"] == pytest.approx(whole * share.mean(), rel=1e-7)


def test_force_of_a_cylinder_off_the_lattice() -> None:
    """Without contraction across, the force is that of the section of the label map."""
    rubber = rubbers(3.0, bulk=2 / 3)  # E = 2 mu
    tables = gripped("rkpm-scni", {}, rubber, "bottom top", "F force_z top", u_z=2e-5)
    errors = []
    for h in (0.25, 0.125):
        x = (np.arange(int(2.5 / h)) + 0.5) * h - 1.25
        a, b = np.meshgrid(x - 0.3 * h, x - 0.17 * h, indexing="ij")
        disc = a**2 + b**2 < 1
        data = np.repeat(disc[:, :, np.newaxis], int(2 / h), axis=2)
        cloud = voxels(data, 10 * h, **TWO)
        assert cloud.volume.sum() == pytest.approx(data.sum() * h**3, rel=1e-12)
        force = solved(tables, cloud=cloud).last()["F"] / 1e-5
        assert force == pytest.approx(6.0 * disc.sum() * h**2, rel=1e-3)
        errors.append(abs(force / (6.0 * np.pi) - 1.0))
    assert errors[0] < 0.02 and errors[1] < 0.8 * errors[0]


@GALERKIN
def test_tissues_beside_each_other_within_voxels(method) -> None:
    """Nearly incompressible tissues stretched together carry by their parts of the section."""
    part = np.repeat([0.0, 0.0, 0.3, 1.0, 1.0], 3).reshape(5, 3)
    fraction = np.repeat(part.ravel(), 6)
    cloud = replace(
        brick(np.ones((5, 3)), 6),
        label_names={1: "soft", 2: "stiff"},
        fraction=np.column_stack([1.0 - fraction, fraction]),
    )
    tables = scene(
        method, {}, material=rubbers(3.0, 12.0, bulk=1e3), probe=scenes.probes("F force_z z1"),
        boundary=[*scenes.PLANES, {"set": "z1", "u_z": 3e-5}],
    )  # fmt: skip
    # by labels alone it would be 7.6 % less
    right = 1e-5 * 3 * 0.25 * (3.0 * (1 - part) + 12.0 * part).sum()
    assert solved(tables, cloud=cloud).last()["F"] == pytest.approx(right, rel=5e-3)


def test_labels_keep_their_volumes_when_voxels_merge() -> None:
    """A ring around a core with a strip along it: smooth curved interfaces, any stride."""
    x, y, _ = np.meshgrid(*[np.arange(n) + 0.5 for n in (52, 52, 24)], indexing="ij")
    radius = np.hypot(x - 26.3, y - 25.9)
    data = np.select([radius < 14, radius < 16, radius < 22], [1, 3, 2], 0)
    for stride in (1, 2, 3, 4, 6):
        warnings: list[str] = []
        strides = {"source_stride": [stride] * 3, "collocation_stride": [stride] * 3}
        cloud = voxels(data, 1.0, "mm", said=warnings, **strides)
        # the ring is 2 voxels thick, the others more at the least stride
        assert all("source points across" in text for text in warnings)
        assert stride > 1 or [text.split(" has ")[0] for text in warnings] == ["label 3"]
        volumes = {label: (data == label).sum() for label in (1, 2, 3)}
        assert cloud.label_volumes() == pytest.approx(volumes, rel=1e-12)
        assert (cloud.fraction is None) == (stride == 1)
        # no voxel is nearly empty, none stands for two
        filled = cloud.volume / stride**3
        assert filled.min() >= 1 / 3 and filled.max() < 1.5


@pytest.mark.slow
def test_muscle_in_points_of_other_tissues_asks_for_no_fiber() -> None:
    """Points that the cloud of the error bar merges from fat and tendon must not become muscle."""
    cloud = brick(np.ones((8, 8)), 8)
    index = cloud.voxels.index
    label = np.full(len(cloud.points), 1, np.int32)
    fraction = np.zeros((len(cloud.points), 3))
    fraction[:, 0] = 1.0
    fiber = np.tile([0.0, 0.0, 1.0], (len(cloud.points), 1))
    inside = ((index >= 2) & (index < 4)).all(axis=1)
    first = inside & (index[:, 0] == 2)
    label[inside], fiber[inside] = 3, 0.0
    fraction[inside] = [0.45, 0.0, 0.55]
    label[first], fraction[first] = 2, [0.45, 0.55, 0.0]
    names = {1: "muscle", 2: "fat", 3: "tendon"}
    cloud = replace(cloud, label=label, fraction=fraction, fiber=fiber, label_names=names)
    muscle = {"name": "muscle", "model": "muscle", "A10": 1.0, "K": 200, "sigma_max": 30}
    muscle |= {"activation": 0.1, "label": 1}
    soft = neo(1.0, 200.0, "fat", label=2), neo(4.0, 200.0, "tendon", label=3)
    tables = gripped("auto", {}, [muscle, *soft], "z0 z1", "F force_z z1")
    assert np.isfinite(solved(tables, cloud=cloud, error=True).bars["F"][-1, 0])


@pytest.mark.slow
def test_a_label_without_fractions_leaves_no_error_bar() -> None:
    """The cloud of the bar has no point of a label without fractions: an answer without it."""
    cloud = brick(np.ones((8, 8)), 8)
    low = cloud.voxels.index[:, 2] < 4
    fraction = np.where(low[:, None], [0.25, 0.75], [1.0, 0.0])
    label = np.where(low, 3, 1).astype(np.int32)
    cloud = replace(cloud, label=label, fraction=fraction, label_names={1: "fat", 2: "tendon"})
    tissues = [neo(mu, 200.0, f"m{k}", label=k) for k, mu in ((1, 1.0), (2, 4.0), (3, 2.0))]
    tables = gripped("auto", {}, tissues, "z0 z1", "F force_z z1", u_z=0.1)
    found = solved(tables, cloud=cloud, error=True)
    assert found.last()["F"] > 0.0
    assert np.isnan(found.bars["F"][-1, 0])


def test_fractions_need_materials_and_sums(tmp_path) -> None:
    data = np.ones((4, 4, 4))
    data[0] = 2
    cloud = voxels(data, 1.0, "mm", **TWO)
    tables = scene("auto", {}, material=rubbers(1, bulk=5), boundary=[held("bottom")])
    assert "label 2 has no material" in scenes.refused(tables, cloud)
    tables["material"] = rubbers(1, 1, bulk=5)
    path = tmp_path / "model.h5"
    write_model(path, cloud)
    np.testing.assert_array_equal(read_model(path).fraction, cloud.fraction)
    with h5py.File(path) as file:
        assert file["fraction_label"][:].tolist() == [1, 2]
    cloud.fraction[1, 0] += 0.1
    assert "their sum must be 1" in scenes.refused(tables, cloud)


SOFT = {"name": "soft", "label": 1, "model": "polynomial", "A10": 5.0, "K": 20.0}
STIFF = {"name": "stiff", "label": 2, "model": "polynomial", "A10": 30.0, "A20": 80.0, "K": 120.0}
MUSCLE = {**scenes.MUSCLE, "label": 2, "fiber": [0.3, -0.5, 0.8]}


@pytest.fixture
def open_bar(open_scene):
    """Open a scene of a bar along x between sides that slip, label 2 beyond the interface."""

    def open_(materials, cells=(8, 2, 2), method="rkcm", width=4):
        n, places = ([k * count + 1 for count in cells] for k in (1, 2))
        cloud = bodies.box((2.0, 0.5, 0.5), n, places)
        cloud.label[cloud.points[:, 0] > 0.97] = 2
        tables = scene(
            method, {}, approximation={"order": 2, "support": 3, "interface": width},
            material=materials, load={"steps": 3},
            boundary=[held("x0", 1), held("x1", 1, u_x=0.3), *slip("yz")],
        )  # fmt: skip
        return open_scene(tables, cloud=cloud)

    return open_


@COLLOCATION
def test_two_tissues_of_one_law_are_one_tissue(open_bar, method):
    """The fractions add up to one, their gradients to zero: both to rounding."""
    whole = {key: SOFT[key] for key in SOFT if key != "label"}
    x = 0.02 * np.random.default_rng(5).standard_normal(open_bar([whole], method=method).dofs)
    one, two = (
        open_bar(materials, method=method).linearise(x, 0.6, x)
        for materials in ([whole], [SOFT, {**SOFT, "name": "same", "label": 2}])
    )
    for expected, found in zip(one, two, strict=True):
        assert np.linalg.norm(found - expected) < 1e-12 * np.linalg.norm(expected)


@COLLOCATION
def test_rows_of_mixed_tissues_are_the_derivative_of_their_residuals(open_bar, method):
    active = {**MUSCLE, "activation": 0.7}
    check_strong_rows(open_bar([SOFT, active], method=method))


@pytest.mark.slow
@COLLOCATION
def test_layers_in_series_carry_the_same_force(open_bar, method):
    """Confined sides: P_xx is the same everywhere, to second order in the spacing."""
    errors = []
    for cells, width in ((8, 4), (16, 8)):
        opened = open_bar([SOFT, STIFF], cells=(cells, 2, 2), method=method, width=width)
        stress = solved(opened).fields.cauchy[:, 0]
        errors.append(np.ptp(stress) / abs(stress.mean()))
    assert errors[1] < min(0.03, 0.4 * errors[0])


#: Voxels of a plate of soft tissue beside one of muscle, the latter from voxel 3 on
PLATES = (7, 3, 4)


@pytest.fixture
def open_plates(open_scene):
    """Open the Galerkin form of two plates by the treatment of fibers and the load."""
    data = np.ones(PLATES)
    data[3:] = 2

    def open_(fibers, method="rkpm"):
        tables = scene(
            method, {}, material=[SOFT, MUSCLE], boundary=[held("bottom")],
            approximation={**scenes.LINEAR, "interface": 2, "interface_fibers": fibers},
            load={"activation": 0.7},
        )  # fmt: skip
        return open_scene(tables, cloud=voxels(data, (10.0, 8.0, 12.0)))

    return open_


def plate_share(x):
    """Fraction of muscle at places across the plates [cm]: quintic weights that reach two
    spacings, normalised in the body; the directions along the plates cancel.
    """
    q = np.abs(np.asarray(x)[:, np.newaxis] - np.arange(PLATES[0])) / 2
    weight = sum(c * np.maximum(k - 3 * q, 0.0) ** 5 for c, k in ((1, 3), (-6, 2), (15, 1)))
    return weight[:, 3:].sum(axis=1) / weight.sum(axis=1)


@pytest.mark.parametrize("fibers", ["nearest", "own"])
def test_fibers_of_shares_beside_a_muscle(open_plates, fibers):
    """Undeformed, the only stress is that of the fibers: sigma_max, activation and share times
    the deviator of N N, to rounding. A plane interface leaves the volume that contracts as it
    is, unless soft tissue has no fibers; then half the mean reach of the weights is missing,
    which over one spacing is that of the neighbour's weight, 7.40625 of 80.8125.
    """
    opened = open_plates(fibers)
    x, label = opened.points()[:, 0], np.repeat([1, 2], [3 * 12, 4 * 12])
    acts = (label == 2) | (fibers == "nearest")
    direction = np.array(MUSCLE["fiber"]) / np.linalg.norm(MUSCLE["fiber"])
    one = 30.0 * 0.7 * (np.outer(direction, direction) - np.eye(3) / 3)
    stress = opened.fields(np.zeros(opened.dofs), 1.0).cauchy[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
    expected = (plate_share(x) * acts)[:, np.newaxis, np.newaxis] * one
    assert np.abs(stress - expected).max() < 1e-12 * 30.0
    middle = np.isclose(opened.points()[:, 1], 0.8) & np.isclose(opened.points()[:, 2], 1.2)
    volume = stress[middle, 0, 1].sum() / one[0, 1]
    assert volume == pytest.approx(4.0 - (fibers == "own") * 7.40625 / 80.8125, rel=1e-12)


def test_tangent_where_only_a_part_has_fibers(open_plates):
    scenes.check_weak_tangent(open_plates("own"))


def test_strong_forms_refuse_fibers_that_jump(open_plates):
    with pytest.raises(InputError, match="interface_fibers: only for .* rkpm-gauss; here"):
        open_plates("own", method="rkcm")


def squeezed(bulk, layers):
    """Force on a cushion 1 x 1 x 2/3 of soft tissues between glued plates, squeezed by 5 %, of
    two halves with these bulk moduli, one above the other or side by side.
    """
    data = np.ones((6, 6, 4))
    data[(slice(None), slice(None), slice(2, None)) if layers else slice(3, None)] = 2
    soft = [neo(1, bulk[k], f"tissue {k}", label=k + 1) for k in (0, 1)]
    tables = gripped("rkpm-scni", {}, soft, "bottom top", "F force_z top", u_z=-0.05)
    return solved(tables, cloud=voxels(data, 10 / 6)).last()["F"]


@pytest.mark.slow
@pytest.mark.parametrize("layers", [True, False], ids=["above", "beside"])
def test_bulk_moduli_of_a_thousandfold_difference(layers):
    """The softer half keeps its change of volume: the force lies half way between those of
    uniform cushions, as in felupe's quadratic elements (0.498 and 0.499 of the way, 4x4x4).
    Means of K in groups and interfaces made the whole cushion as stiff as its stiffer half (0.98
    and 1.00). A half with K = inf is no other than a stiff one.
    """
    soft, stiff = (squeezed((k, k), layers) for k in (1e2, 1e5))
    for bulk in ((1e2, 1e5), (1e2, np.inf)):
        way = (squeezed(bulk, layers) - soft) / (stiff - soft)
        assert way == pytest.approx(0.5, abs=0.03)


def confined_stress(stretch, mu, bulk):
    """P_xx of a neo-Hookean solid stretched along x between sides that do not move."""
    reduced = stretch - (stretch**2 + 2.0) / (3.0 * stretch)
    return mu * stretch ** (-2.0 / 3.0) * reduced + bulk * (stretch - 1.0)


def series_force(length, pull, soft, stiff):
    """Force of two confined layers in series, the soft one of this length, both 1 long."""

    def apart(stretch):
        other = (1.0 + pull - stretch * length) / (1.0 - length)
        return confined_stress(stretch, *soft) - confined_stress(other, *stiff)

    reach = 0.99 * abs(pull) / length
    return confined_stress(brentq(apart, 1.0 - reach, 1.0 + reach, xtol=1e-14), *soft)


FORCE = scenes.probes("force force_x x1")


@pytest.mark.parametrize("pull", [0.1, -0.1])
@pytest.mark.parametrize(
    ("length", "source"), [(0.5, [9, 5]), (0.53, [9, 5]), (0.57, [9, 5]), (0.53, [9, 4, 4])]
)
def test_layers_in_series_give_way_as_they_should(length, source, pull):
    """Each layer is strained evenly; smooth functions were 8 to 14 % too stiff."""
    # functions with a kink have it, but for what fades where two of four neighbours lie far beyond
    # the plane, which stands on, beside and between lines of nine points along the bar
    soft, stiff = (1.0, 4.0), (20.0, 80.0)
    tables = scene(
        "rkpm-gauss", box(*source, size=[1.0, 0.5, 1.0][: len(source)], places=False),
        material=[neo(*soft, "soft"), neo(*stiff, "stiff", where=f"x > {length}")],
        boundary=[*slip("xyz"[: len(source)])[2:], held("x0", 1), held("x1", 1, u_x=pull)],
        probe=FORCE,
    )  # fmt: skip
    exact = 0.5 * series_force(length, pull, soft, stiff)
    assert abs(solved(tables).last()["force"] - exact) < 0.01 * abs(exact)


@pytest.mark.parametrize(
    ("where", "stiff"),
    [("y > 0.31 and y < 0.7 and z > 0.37 and z < 0.6", 0.39 * 0.23), ("z > 0.45 or y > 0.8", 0.64)],
)
def test_parallel_bars_carry_their_areas_share(where, stiff):
    """Pulled between planes that slip, bars of one ratio of moduli have one strain, whatever their
    section: the force is that of their areas, to the tolerance of the iteration.
    """

    def force(*materials):
        tables = scene(
            "rkpm-gauss", box(4, 6, 5, places=False), material=materials, probe=FORCE,
            boundary=[*scenes.PLANES, {"set": "x1", "u_x": 0.1}],
        )  # fmt: skip
        return solved(tables).last()["force"]

    both = force(neo(1.0, 30.0, "gel"), neo(20.0, 600.0, "bar", where=where))
    assert both == pytest.approx((1 + 19 * stiff) * force(neo(1.0, 30.0)), rel=1e-6)


@pytest.mark.parametrize("where", ["x + 0.4*y > 0.72", "x > 0.43 and y > 0.37"])
@pytest.mark.parametrize("source", [[7, 6], [5, 5, 4]])
def test_layers_have_the_tangent_of_their_stress(open_scene, source, where):
    """Muscle beside fat: across the axes in layers, whose jump is found anew in each state, or cut
    by planes.
    """
    nd = len(source)
    fiber = [0.6, 0.8, 0.0] if nd == 3 else [0.8, 0.6, 0.0]
    muscle = {**scenes.MUSCLE, "fiber": fiber, "activation": 0.4}
    tables = scene(
        "rkpm-gauss", box(*source, size=[1.0, 0.8, 0.6][:nd], places=False),
        material=[muscle, neo(1.0, 30.0, "fat", where=where)], boundary=[held("x0", nd)],
    )  # fmt: skip
    scenes.check_weak_tangent(open_scene(tables))


@pytest.mark.parametrize("cut", [0.36, 0.47])
def test_a_trace_of_a_compressible_tissue_leaves_the_other_incompressible(cut):
    """K of a million times the shear modulus is as good as infinite."""

    def force(bulk: float) -> Any:
        tables = gripped(
            "rkpm-gauss", box(17, 17, places=False),
            [neo(1.0, bulk, "a"), neo(20.0, 30.0, "b", where=f"y > {cut}")],
            "y0 y1", "force force y1", u_x=0.1, u_y=0.05,
        )  # fmt: skip
        return solved(tables).ends()["force"][:2]

    np.testing.assert_allclose(force(np.inf), force(1e6), rtol=1e-4)


def test_a_sheet_that_points_hardly_see_is_refused() -> None:
    """Points lie in it, and a sixth of their volume's width is six times as much."""
    sheet = neo(1e3, 30.0, "sheet", where="abs(x - 0.5) < 0.002")
    tables = scene(
        "rkpm-gauss", box(9, 9, places=False), material=[neo(1.0, 30.0, "gel"), sheet],
        boundary=[held("y0", 2)],
    )  # fmt: skip
    said = scenes.refused(tables)
    assert "material.sheet.where: " in said and "thinner than can be seen at" in said
