"""Two tissues in one body: interfaces of smooth moduli, thesis section 4.2.2."""

import itertools

import numpy as np
import pytest

from myork.bench import materials
from myork.core.deck import table_defaults
from myork.errors import InputError
from myork.model.cloud import build_cloud
from myork.records import Labels, PointCloud

SOFT = {"name": "soft", "label": 1, "model": "polynomial", "A10": 5.0, "K": 20.0}
STIFF = {"name": "stiff", "label": 2, "model": "polynomial", "A10": 30.0, "A20": 80.0, "K": 120.0}
MUSCLE = {**materials.MUSCLE, "K": 500.0, "curve": "smooth", "label": 2, "fiber": [0.3, -0.5, 0.8]}
SIDES = [
    {"set": "x0", "u_x": 0},
    {"set": "x1", "u_x": 0.3},
    {"set": "sides", "u_y": 0, "u_z": 0},
]


def bar(cells, length, interface, spacing_ratio=2):
    """Points of a bar along x; label 2 beyond the interface."""
    size = np.array([length, 0.5, 0.5])
    source = [np.linspace(0, s, n + 1) for s, n in zip(size, cells, strict=True)]
    fine = [np.linspace(0, s, spacing_ratio * n + 1) for s, n in zip(size, cells, strict=True)]
    points = np.array(list(itertools.product(*fine)))
    sets = {"x0": [], "x1": [], "sides": []}
    for number, (x, *across) in enumerate(points):
        if x == 0.0:
            sets["x0"].append((number, [-1.0, 0, 0]))
        if x == length:
            sets["x1"].append((number, [1.0, 0, 0]))
        outward = [np.sign(a - 0.25) if a in (0.0, 0.5) else 0.0 for a in across]
        if any(outward):
            sets["sides"].append((number, np.array([0, *outward]) / np.linalg.norm(outward)))
    rows = [(p, s, n) for s, members in enumerate(sets.values()) for p, n in members]
    return PointCloud(
        source=np.array(list(itertools.product(*source))),
        spacing=size / np.array(cells),
        points=points,
        label=np.where(points[:, 0] > interface, 2, 1).astype(np.int32),
        fiber=np.zeros_like(points),
        volume=np.full(len(points), 1.0 / len(points)),
        boundary_point=np.array([row[0] for row in rows], np.int32),
        boundary_set=np.array([row[1] for row in rows], np.int32),
        normal=np.array([row[2] for row in rows], float),
        area=np.full(len(rows), 1.0 / len(rows)),
        set_names=tuple(sets),
        label_names={1: "soft", 2: "stiff"},
        length_unit="cm",
        source_images="",
    )


@pytest.fixture
def open_bar(open_scene):
    """Open a scene of a bar from materials and cells."""

    def open_(materials, cells=(8, 2, 2), method="rkcm", width=4, **tables):
        return open_scene(
            {
                "scene": {"dimension": 3, "method": method},
                "approximation": {"order": 2, "support": 3, "interface": width},
                "material": materials,
                "boundary": SIDES,
                "load": {"steps": 3},
                **tables,
            },
            cloud=bar(cells, 2.0, 0.97),
        )

    return open_


@pytest.mark.parametrize("method", ["rkcm", "rkcm-mixed"])
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


@pytest.mark.parametrize("method", ["rkcm", "rkcm-mixed"])
def test_rows_of_mixed_tissues_are_the_derivative_of_their_residuals(open_bar, method):
    """As in test_jacobian.py: truncation 1e-12, rounding 1e-9 of a strong form's terms."""
    scene = open_bar([SOFT, MUSCLE], method=method, load={"activation": 0.7})
    random = np.random.default_rng(11)
    x = 0.02 * random.standard_normal(scene.dofs)
    direction = random.standard_normal(scene.dofs)
    _, product = scene.linearise(x, 0.6, direction)
    step = 2e-5

    def residual(factor):
        return scene.linearise(x + factor * step * direction, 0.6, direction, start=x)[0]

    difference = (8 * (residual(1) - residual(-1)) - residual(2) + residual(-2)) / (12 * step)
    assert np.linalg.norm(difference - product) < 1e-7 * np.linalg.norm(product)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rkcm", "rkcm-mixed"])
def test_layers_in_series_carry_the_same_force(open_bar, method):
    """Confined sides make the bar one-dimensional: P_xx is the same everywhere. Without the
    gradient of the moduli in the strong form it would jump by their ratio, 6. The interface is
    a whole unit wide and resolved by 4, then by 8 spacings: of second order, an error of some
    per cent falls to a quarter of it.
    """
    errors = []
    for cells, width in ((8, 4), (16, 8)):
        scene = open_bar([SOFT, STIFF], cells=(cells, 2, 2), method=method, width=width)
        states = scene.solve()
        stress = scene.fields(states.x[-1], 1.0).cauchy[:, 0]
        errors.append(np.ptp(stress) / abs(stress.mean()))
    assert errors[1] < min(0.03, 0.4 * errors[0])


#: Voxels of a plate of soft tissue beside one of muscle, the latter from voxel 3 on
PLATES = (7, 3, 4)


@pytest.fixture
def open_plates(open_scene):
    """Open the Galerkin form of two plates by the treatment of fibers and the load."""
    data = np.ones(PLATES, np.int32)
    data[3:] = 2
    table = {
        "ids": [],
        "islands": "error",
        "collocation_stride": [1] * 3,
        "source_stride": [1] * 3,
        "bone": [],
        "normals": "distance",
        "merge": "majority",
    }
    labels = Labels(data, np.diag([10.0, 8.0, 12.0, 1.0]), {1: "soft", 2: "muscle"})
    cloud, _ = build_cloud(labels, None, table, "cm")

    def open_(fibers, method="rkpm"):
        return open_scene(
            {
                "scene": {"dimension": 3, "method": method},
                "approximation": {
                    "order": 1,
                    "support": 2,
                    "kernel": "cubic",
                    "interface": 2,
                    "interface_fibers": fibers,
                },
                "material": [SOFT, MUSCLE],
                "boundary": [{"set": "bottom", "u_x": 0, "u_y": 0, "u_z": 0}],
                "load": {"activation": 0.7},
            },
            cloud=cloud,
        )

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
    scene = open_plates(fibers)
    x, label = scene.points()[:, 0], np.repeat([1, 2], [3 * 12, 4 * 12])
    acts = (label == 2) | (fibers == "nearest")
    direction = np.array(MUSCLE["fiber"]) / np.linalg.norm(MUSCLE["fiber"])
    one = 30.0 * 0.7 * (np.outer(direction, direction) - np.eye(3) / 3)
    stress = scene.fields(np.zeros(scene.dofs), 1.0).cauchy[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
    expected = (plate_share(x) * acts)[:, np.newaxis, np.newaxis] * one
    assert np.abs(stress - expected).max() < 1e-12 * 30.0
    middle = np.isclose(scene.points()[:, 1], 0.8) & np.isclose(scene.points()[:, 2], 1.2)
    volume = stress[middle, 0, 1].sum() / one[0, 1]
    assert volume == pytest.approx(4.0 - (fibers == "own") * 7.40625 / 80.8125, rel=1e-12)


def test_tangent_where_only_a_part_has_fibers(open_plates):
    """As in test_galerkin.py: symmetric, and the derivative of the forces."""
    scene = open_plates("own")
    random = np.random.default_rng(7)
    x, direction, other = 0.01 * random.standard_normal((3, scene.dofs))
    _, product = scene.linearise(x, 0.6, direction)
    h = 0.02

    def residual(factor):
        return scene.linearise(x + factor * h * direction, 0.6, direction)[0]

    slope = (8 * (residual(1) - residual(-1)) - residual(2) + residual(-2)) / (12 * h)
    assert np.abs(product - slope).max() < 1e-8 * np.abs(slope).max()
    _, turned = scene.linearise(x, 0.6, other)
    assert other @ product == pytest.approx(direction @ turned, rel=1e-11)


def test_strong_forms_refuse_fibers_that_jump(open_plates):
    with pytest.raises(InputError, match="interface_fibers: only for .* rkpm-gauss; here"):
        open_plates("own", method="rkcm")


def squeezed(open_scene, bulk, layers):
    """Force on a cushion 1 x 1 x 2/3 of soft tissues between glued plates, squeezed by 5 %, of
    two halves with these bulk moduli, one above the other or side by side.
    """
    data = np.ones((6, 6, 4), np.int32)
    data[(slice(None), slice(None), slice(2, None)) if layers else slice(3, None)] = 2
    table = {**table_defaults("build"), "source_stride": [1] * 3, "collocation_stride": [1] * 3}
    labels = Labels(data, np.diag([10 / 6] * 3 + [1.0]), {1: "one", 2: "other"})
    cloud, _ = build_cloud(labels, None, table, "cm")
    scene = open_scene(
        {
            "scene": {"dimension": 3, "method": "rkpm-scni"},
            "material": [
                {
                    "name": f"tissue {k}",
                    "model": "neo-hookean",
                    "mu": 1,
                    "K": bulk[k],
                    "label": k + 1,
                }
                for k in (0, 1)
            ],
            "boundary": [
                {"set": "bottom", "u_x": 0, "u_y": 0, "u_z": 0},
                {"set": "top", "u_x": 0, "u_y": 0, "u_z": -0.05},
            ],
            "probe": [{"name": "F", "quantity": "force_z", "set": "top"}],
        },
        cloud=cloud,
    )
    return scene.probes(scene.solve().x[-1:], np.ones(1))[0, 0, 0]


@pytest.mark.slow
@pytest.mark.parametrize("layers", [True, False], ids=["above", "beside"])
def test_bulk_moduli_of_a_thousandfold_difference(open_scene, layers):
    """The softer half keeps its change of volume: the force lies half way between those of
    uniform cushions, as in felupe's quadratic elements (0.498 and 0.499 of the way, 4x4x4).
    Means of K in groups and interfaces made the whole cushion as stiff as its stiffer half (0.98
    and 1.00). A half with K = inf is no other than a stiff one.
    """
    soft, stiff = (squeezed(open_scene, (k, k), layers) for k in (1e2, 1e5))
    for bulk in ((1e2, 1e5), (1e2, np.inf)):
        way = (squeezed(open_scene, bulk, layers) - soft) / (stiff - soft)
        assert way == pytest.approx(0.5, abs=0.03)
