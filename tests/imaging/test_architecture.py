"""Numbers of muscles: a body of parallel fibers in closed form, and the phantom's ellipses."""

import csv
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from myork.imaging.diffusion import tensor_maps
from myork.imaging.phantom import make_phantom
from myork.model.architecture import Maps, cut_sides, muscle_numbers
from myork.records import Image, Labels
from myork.report import make_report
from myork.stations.build import build
from myork.stations.solve import pcsa_force
from tests.images import built, centred, save

# Thickness, distance of the ends along z and width of the body [mm], pennation; and what follows:
# ratio of z to y along the fibers and their length [mm]
THICK, LONG, WIDE, LEAN = 16.0, 110.0, 30.0, np.radians(22.0)
SLOPE, LENGTH = 1.0 / np.tan(LEAN), THICK / np.sin(LEAN)
AXIAL = np.eye(3)
OBLIQUE = Rotation.from_euler("xyz", [25, -15, 40], degrees=True).as_matrix()


def unipennate(turn=AXIAL, spacing=(1.0, 1.0, 1.0), ends=0.0):
    """A plate of fibers from the plane y = -8 mm to the plane y = 8 mm, its ends cut along them."""
    low = np.array([0.0, 0.0, ends]) - 6.5 - 0.5 * np.array([WIDE, THICK, LONG + THICK * SLOPE])
    count = np.ceil(-2 * low / spacing).astype(int)
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = turn * spacing, turn @ low
    x, y, z = np.moveaxis(np.moveaxis(np.indices(count), 0, -1) * spacing + low, -1, 0)
    own = (abs(x) < 0.5 * WIDE) & (abs(y) < 0.5 * THICK) & (abs(z - y * SLOPE) < 0.5 * LONG)
    sign = np.random.default_rng(0).choice([-1.0, 1.0], (*count, 1))
    fibers = own[..., np.newaxis] * sign * (turn @ [0.0, np.sin(LEAN), np.cos(LEAN)])
    return Labels(own.astype(np.int32), affine, {1: "plate"}), Image(fibers, affine)


@pytest.mark.parametrize(("turn", "spacing"), [
    (AXIAL, (1.0, 1.0, 1.0)), (OBLIQUE, (1.0, 1.0, 1.0)), (OBLIQUE, (0.8, 0.8, 3.0)),
])  # fmt: skip
def test_a_plate_of_parallel_fibers(turn, spacing):
    labels, fibers = unipennate(turn, spacing)
    (found,) = muscle_numbers(labels, Maps(fibers))
    # the long axis leans after the ends: that of the covariance of y and z
    yy, yz, zz = np.array([0.0, 0.0, LONG**2 / 12]) + THICK**2 / 12 * np.array([1, SLOPE, SLOPE**2])
    volume, lean = THICK * LONG * WIDE, LEAN - 0.5 * np.arctan2(2 * yz, zz - yy)
    assert found.muscle == "plate" and not found.cut
    assert found.volume == pytest.approx(volume, rel=0.03)
    assert found.area == pytest.approx(THICK * WIDE, rel=0.03)
    assert found.fiber_length == pytest.approx(LENGTH, rel=0.04)
    assert found.pennation == pytest.approx(np.degrees(lean), abs=0.3)
    assert found.pcsa == pytest.approx(volume * np.cos(lean) / LENGTH, rel=0.05)
    assert (found.fat_fraction, found.fa, found.md) == (None, None, None)


def test_what_an_image_cuts_or_does_not_hold_is_left_out():
    labels, fibers = unipennate(ends=18.0)
    (found,) = muscle_numbers(labels, Maps(fibers))
    assert found.cut and found.pcsa is None
    assert found.fiber_length == pytest.approx(LENGTH, rel=0.04)
    labels, fibers = unipennate(ends=60.0)  # most fibers leave the image
    assert muscle_numbers(labels, Maps(fibers))[0].fiber_length is None
    (found,) = muscle_numbers(labels, Maps())
    assert found.volume > 0 and (found.fiber_length, found.pennation) == (None, None)
    nothing = Image(0.0 * fibers.data, fibers.affine)
    assert muscle_numbers(labels, Maps(nothing))[0].pennation is None
    assert muscle_numbers(labels, Maps(fibers), [1]) == []


def test_a_ball_has_no_long_axis_and_a_tight_box_cuts_no_muscle():
    ball = Labels(((centred(21, 21, 21) ** 2).sum(0) <= 100.5).astype(np.int32), np.eye(4))
    along = Image(np.tile([0.0, 0.0, 1.0], (21, 21, 21, 1)), np.eye(4))
    (found,) = muscle_numbers(ball, Maps(along))
    assert not found.cut and (found.pennation, found.pcsa) == (None, None)
    assert not cut_sides(ball, 1)
    assert found.volume == pytest.approx(4 / 3 * np.pi * 1000, rel=0.05)


@pytest.mark.parametrize(("flip", "turn"), [(1, 0), (-1, 0), (1, 1)])
def test_sides_of_an_image_that_cut_a_muscle(flip, turn):
    """A spindle whole, in its tightest box, and cut by two sides, whatever the order of voxels."""
    x, y, z = centred(51, 51, 41)
    own = ((x / 18) ** 2 + (y / 14) ** 2 < 1 - (z / 30) ** 2).astype(np.int32)
    step = np.diag([flip, 1.0, 3.0, 1.0])
    for box, sides in (
        ((slice(None), slice(None)), []),
        ((slice(8, 43), slice(12, 39)), []),
        ((slice(20, None), slice(None)), ["left" if flip > 0 else "right"]),
        ((slice(None), slice(17, 34)), ["anterior", "posterior"]),
    ):
        part = own[box] if not turn else own[box].transpose(2, 0, 1)
        affine = step if not turn else step[:, [2, 0, 1, 3]]
        assert cut_sides(Labels(part, affine), 1) == sides


@pytest.mark.slow
def test_build_writes_a_table_of_the_muscles(tmp_path):
    phantom = make_phantom((60, 60, 15), (2.0, 2.0, 6.0), snr=1e9, bias=0.0)
    out, affine = tmp_path / "out", phantom.truth.affine
    out.mkdir()
    save(tmp_path, affine, labels=phantom.truth, fibers=phantom.fiber)
    fraction = np.where(phantom.truth.data == 3, 0.25, 0.125)
    images = {"anatomy": 3.0 + 0 * fraction, "fat": 1.0 + 0 * fraction, "fat_fraction": fraction}
    save(out, affine, **tensor_maps(phantom.clean_tensor), **images)
    table = dict(
        labels="labels.nii.gz", fibers="fibers.nii.gz", collocation_stride=[3, 3, 1],
        source_stride=[6, 6, 2],
    )  # fmt: skip
    built(tmp_path, **table)
    rows = list(csv.DictReader((out / "muscles.csv").read_text().splitlines()))
    assert list(rows[0]) == [
        "muscle", "volume [mm^3]", "area [mm^2]", "fat_fraction [-]", "FA [-]", "MD [mm^2/s]",
        "fiber_length [mm]", "pennation [deg]", "PCSA [mm^2]",
    ]  # fmt: skip
    assert [row["muscle"] for row in rows] == list(phantom.truth.names.values())
    # the gastrocnemius: an ellipse with semi-axes of 23 and 11 mm at its belly, less by
    # 0.3 ((t - .55) / .55)^2
    t = np.arange(15) / 14
    sections = np.pi * 23 * 11 * (1 - 0.3 * ((t - 0.55) / 0.55) ** 2) ** 2
    values = np.array([2.1, 1.5, 1.3]) * 1e-3
    anisotropy = np.sqrt(1.5 * ((values - values.mean()) ** 2).sum() / (values**2).sum())
    cubic, area, pennation, md = (
        float(rows[0][key])
        for key in ("volume [mm^3]", "area [mm^2]", "pennation [deg]", "MD [mm^2/s]")
    )
    assert (area, cubic) == pytest.approx((sections.max(), 6 * sections.sum()), rel=0.02)
    assert pennation == pytest.approx(22.0, abs=1.0)
    for row, fat in zip(rows, (0.125, 0.125, 0.25, 0.125, 0.125, 0.125), strict=True):
        found = [float(row[key]) for key in ("FA [-]", "MD [mm^2/s]", "fat_fraction [-]")]
        assert found == pytest.approx([anisotropy, values.mean(), fat], rel=1e-3)
        assert row["PCSA [mm^2]"] == ""  # the stack cuts all of them
    paths = {key: tmp_path / table[key] for key in ("labels", "fibers")}
    lines: list[str] = []
    build({"scene": {"dimension": 3}, "build": {**table, **paths}}, out, progress=lines.append)
    for row in rows:  # why cells are empty is said
        what = "its PCSA is" if row["fiber_length [mm]"] else "fiber length and PCSA are"
        assert f"{row['muscle']}: the image cuts it, so that {what} left out" in lines
    first = json.loads((out / "summary.json").read_text())["model"]["muscles"][0]
    assert first["volume [cm^3]"] * 1000 == pytest.approx(cubic, rel=1e-4)
    assert first["MD [mm^2/s]"] == pytest.approx(md)
    page = make_report(out).read_text()
    assert "pennation [deg]" in page and "PCSA is volume times" in page


def solved(force, area=4.0, **changes):
    """Summary of a solve: a muscle of a PCSA at an activation of a half, sigma_max 30 N/cm^2."""
    return {
        "units": {"force": "N", "length": "cm"},
        "deck": {
            "geometry": {"kind": "model"},
            "material": [{"name": "m", "model": "muscle", "sigma_max": 30.0}],
            "probe": [
                {"name": "pull", "quantity": "force", "set": "top"},
                {"name": "stress", "quantity": "cauchy_zz", "point": [0, 0, 0]},
            ],
        },
        "model": {"muscles": [{"muscle": "m", "PCSA [cm^2]": area}]},
        "steps": [{"activation": 0.5, "probes": {"pull": force, "stress": 1e4}}],
        **changes,
    }


@pytest.mark.parametrize(("force", "ratio"), [(48.0, 1.0), (9.0, 0.1875), (240.0, 5.0)])
def test_a_force_three_times_off_the_pcsa_is_named(force, ratio):
    entry, warning = pcsa_force(solved([0.6 * force * 1.25, 0.0, -0.8 * force * 1.25]))
    assert entry == {"value": 60.0, "probe": "pull", "ratio": pytest.approx(ratio)}
    assert bool(warning) == (ratio != 1.0)
    if warning:
        assert "probe pull is" in warning and "60 N" in warning


def test_no_estimate_without_what_it_needs():
    passive = [{"activation": 0.0, "probes": {"pull": 1.0}}]
    for lacking in ({"area": None}, {"steps": passive}, {"model": {}}):
        assert pcsa_force(solved(48.0, **lacking)) is None
    assert pcsa_force({}) is None
