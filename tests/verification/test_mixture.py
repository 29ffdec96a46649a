"""Two tissues in one body: interfaces of smooth moduli, thesis section 4.2.2."""

import numpy as np
import pytest

from benchmarks.truths import bodies
from myork.errors import InputError
from tests import scenes
from tests.scenes import check_strong_rows, check_weak_tangent, held, scene, solved, voxels

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
        slip = [{"set": f"{axis}{k}", f"u_{axis}": 0} for axis in "yz" for k in (0, 1)]
        tables = scene(
            method, {}, approximation={"order": 2, "support": 3, "interface": width},
            material=materials, load={"steps": 3},
            boundary=[{"set": "x0", "u_x": 0}, {"set": "x1", "u_x": 0.3}, *slip],
        )  # fmt: skip
        return open_scene(tables, cloud=cloud)

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
    active = {**MUSCLE, "activation": 0.7}
    check_strong_rows(open_bar([SOFT, active], method=method))


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
    check_weak_tangent(open_plates("own"))


def test_strong_forms_refuse_fibers_that_jump(open_plates):
    with pytest.raises(InputError, match="interface_fibers: only for .* rkpm-gauss; here"):
        open_plates("own", method="rkcm")


def squeezed(bulk, layers):
    """Force on a cushion 1 x 1 x 2/3 of soft tissues between glued plates, squeezed by 5 %, of
    two halves with these bulk moduli, one above the other or side by side.
    """
    data = np.ones((6, 6, 4))
    data[(slice(None), slice(None), slice(2, None)) if layers else slice(3, None)] = 2
    soft = {"model": "neo-hookean", "mu": 1}
    tables = scene(
        "rkpm-scni", {}, boundary=[held("bottom"), held("top", u_z=-0.05)],
        material=[{"name": f"tissue {k}", "K": bulk[k], "label": k + 1, **soft} for k in (0, 1)],
        probe=[{"name": "F", "quantity": "force_z", "set": "top"}],
    )  # fmt: skip
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
