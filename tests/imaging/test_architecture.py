"""Numbers of muscles: a body of parallel fibers in closed form, and the phantom's ellipses."""

import csv
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from myork.imaging.diffusion import tensor_maps
from myork.imaging.io import write_image, write_labels
from myork.imaging.phantom import make_phantom
from myork.model.architecture import Maps, muscle_numbers
from myork.records import Image, Labels
from myork.report import make_report
from myork.stations.build import build
from myork.stations.solve import pcsa_force
from tests.images import built

# Thickness, distance of the ends along z and width of the body [mm], pennation [degree]
THICK, LONG, WIDE, LEAN = 16.0, 110.0, 30.0, 22.0
AXIAL = np.eye(3)
OBLIQUE = Rotation.from_euler("xyz", [25, -15, 40], degrees=True).as_matrix()


def unipennate(turn=AXIAL, spacing=(1.0, 1.0, 1.0), margin=6.5, ends=0.0):
    """A plate of fibers between two planes, its ends cut along the fibers; labels and fibers.

    Each fiber is as long as the others: from one plane, y = -8 mm, to the other.
    """
    reach = np.array([0.5 * WIDE, 0.5 * THICK, 0.5 * LONG + 0.5 * THICK / np.tan(np.radians(LEAN))])
    low = -np.array([*(reach[:2] + margin), reach[2] + margin - ends])
    count = np.ceil(-2 * low / spacing).astype(int)
    affine = np.eye(4)
    affine[:3, :3] = turn * spacing
    affine[:3, 3] = turn @ low
    grid = Labels(np.zeros(count, np.int32), affine, {1: "plate"})
    x, y, z = np.moveaxis(np.indices(count), 0, 0) * np.reshape(spacing, (3, 1, 1, 1)) + np.reshape(
        low, (3, 1, 1, 1)
    )
    slope = 1.0 / np.tan(np.radians(LEAN))
    own = (abs(x) < 0.5 * WIDE) & (abs(y) < 0.5 * THICK) & (abs(z - y * slope) < 0.5 * LONG)
    grid.data[own] = 1
    direction = turn @ [0.0, np.sin(np.radians(LEAN)), np.cos(np.radians(LEAN))]
    sign = np.random.default_rng(0).choice([-1.0, 1.0], (*count, 1))
    return grid, Image(own[..., np.newaxis] * sign * direction, affine)


def truth():
    """Volume, section, length, pennation and PCSA of the plate."""
    slope = 1.0 / np.tan(np.radians(LEAN))
    volume, length = THICK * LONG * WIDE, THICK / np.sin(np.radians(LEAN))
    # the long axis leans after the ends: that of the covariance of y and z
    yy, yz, zz = THICK**2 / 12, THICK**2 / 12 * slope, LONG**2 / 12 + THICK**2 / 12 * slope**2
    tilt = 0.5 * np.degrees(np.arctan2(2 * yz, zz - yy))
    pcsa = volume * np.cos(np.radians(LEAN - tilt)) / length
    return volume, THICK * WIDE, length, LEAN - tilt, pcsa


@pytest.mark.parametrize(
    ("turn", "spacing"),
    [(AXIAL, (1.0, 1.0, 1.0)), (OBLIQUE, (1.0, 1.0, 1.0)), (OBLIQUE, (0.8, 0.8, 3.0))],
)
def test_a_plate_of_parallel_fibers(turn, spacing):
    labels, fibers = unipennate(turn, spacing)
    (found,) = muscle_numbers(labels, Maps(fibers))
    volume, area, length, pennation, pcsa = truth()
    assert found.muscle == "plate" and not found.cut
    assert found.volume == pytest.approx(volume, rel=0.03)
    assert found.area == pytest.approx(area, rel=0.03)
    assert found.fiber_length == pytest.approx(length, rel=0.04)
    assert found.pennation == pytest.approx(pennation, abs=0.3)
    assert found.pcsa == pytest.approx(pcsa, rel=0.05)
    assert (found.fat_fraction, found.fa, found.md) == (None, None, None)


def test_fibers_along_the_axis_have_a_pennation_of_zero():
    inside = np.zeros((8, 8, 20), np.int32)
    inside[2:6, 2:6, 3:17] = 1
    along = Image(np.broadcast_to([0.0, 0.0, 1.0], (*inside.shape, 3)).copy(), np.eye(4))
    (found,) = muscle_numbers(Labels(inside, np.eye(4)), Maps(along))
    assert found.pennation == pytest.approx(0.0, abs=1e-5)
    assert found.pcsa == pytest.approx(16.0, rel=0.05)


def test_what_an_image_cuts_or_does_not_hold_is_left_out():
    labels, fibers = unipennate(ends=18.0)
    (found,) = muscle_numbers(labels, Maps(fibers))
    assert found.cut and found.pcsa is None
    assert found.fiber_length == pytest.approx(truth()[2], rel=0.04)
    labels, fibers = unipennate(ends=60.0)  # most fibers leave the image
    assert muscle_numbers(labels, Maps(fibers))[0].fiber_length is None
    (found,) = muscle_numbers(labels, Maps())
    assert found.volume > 0 and (found.fiber_length, found.pennation) == (None, None)
    nothing = Image(0.0 * fibers.data, fibers.affine)
    assert muscle_numbers(labels, Maps(nothing))[0].pennation is None
    assert muscle_numbers(labels, Maps(fibers), [1]) == []


def test_a_ball_has_no_long_axis_and_a_tight_box_cuts_no_muscle():
    at = np.indices((21, 21, 21)) - 10
    ball = Labels((np.hypot(*at[:2]) ** 2 + at[2] ** 2 <= 100.5).astype(np.int32), np.eye(4))
    along = Image(np.broadcast_to([0.0, 0.0, 1.0], (21, 21, 21, 3)).copy(), np.eye(4))
    (found,) = muscle_numbers(ball, Maps(along))
    assert not found.cut and (found.pennation, found.pcsa) == (None, None)
    assert found.volume == pytest.approx(4 / 3 * np.pi * 1000, rel=0.05)


@pytest.fixture(scope="module")
def phantom():
    return make_phantom((60, 60, 15), (2.0, 2.0, 6.0), snr=1e9, bias=0.0)


@pytest.mark.slow
def test_build_writes_a_table_of_the_muscles(phantom, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    write_labels(tmp_path / "labels.nii.gz", phantom.truth)
    write_image(tmp_path / "fibers.nii.gz", phantom.fiber)
    maps = tensor_maps(phantom.clean_tensor)
    fraction = np.where(phantom.truth.data == 3, 0.25, 0.125)
    maps["anatomy"] = Image(np.full(fraction.shape, 3.0), phantom.truth.affine)
    maps["fat"] = Image(np.full(fraction.shape, 1.0), phantom.truth.affine)
    maps["fat_fraction"] = Image(fraction, phantom.truth.affine)
    for name, image in maps.items():
        write_image(out / f"{name}.nii.gz", image)
    table = dict(
        labels="labels.nii.gz", fibers="fibers.nii.gz", collocation_stride=[3, 3, 1],
        source_stride=[6, 6, 2], islands="drop",
    )  # fmt: skip
    built(tmp_path, **table)
    rows = list(csv.DictReader((out / "muscles.csv").read_text().splitlines()))
    assert list(rows[0]) == [
        "muscle", "volume [mm^3]", "area [mm^2]", "fat_fraction [-]", "FA [-]", "MD [mm^2/s]",
        "fiber_length [mm]", "pennation [deg]", "PCSA [mm^2]",
    ]  # fmt: skip
    assert [row["muscle"] for row in rows] == list(phantom.truth.names.values())
    gastrocnemius = rows[0]
    # an ellipse with semi-axes of 23 and 11 mm at its belly, less by 0.3 ((t - .55) / .55)^2
    t = np.arange(15) / 14
    sections = np.pi * 23 * 11 * (1 - 0.3 * ((t - 0.55) / 0.55) ** 2) ** 2
    assert float(gastrocnemius["area [mm^2]"]) == pytest.approx(sections.max(), rel=0.02)
    assert float(gastrocnemius["volume [mm^3]"]) == pytest.approx(6 * sections.sum(), rel=0.02)
    assert float(gastrocnemius["pennation [deg]"]) == pytest.approx(22.0, abs=1.0)
    values = np.array([2.1, 1.5, 1.3]) * 1e-3
    anisotropy = np.sqrt(1.5 * ((values - values.mean()) ** 2).sum() / (values**2).sum())
    for row, fat in zip(rows, (0.125, 0.125, 0.25, 0.125, 0.125, 0.125), strict=True):
        assert float(row["FA [-]"]) == pytest.approx(anisotropy, rel=1e-3)
        assert float(row["MD [mm^2/s]"]) == pytest.approx(values.mean(), rel=1e-3)
        assert float(row["fat_fraction [-]"]) == pytest.approx(fat, rel=1e-3)
        assert row["PCSA [mm^2]"] == ""  # the stack cuts all of them
    paths = {key: tmp_path / table[key] for key in ("labels", "fibers")}
    lines: list[str] = []
    build({"scene": {"dimension": 3}, "build": {**table, **paths}}, out, progress=lines.append)
    for row in rows:  # why cells are empty is said
        what = "its PCSA is" if row["fiber_length [mm]"] else "fiber length and PCSA are"
        assert f"{row['muscle']}: the image cuts it, so that {what} left out" in lines
    summary = json.loads((out / "summary.json").read_text())
    first = summary["model"]["muscles"][0]
    cubic = float(gastrocnemius["volume [mm^3]"])
    assert first["volume [cm^3]"] * 1000 == pytest.approx(cubic, rel=1e-4)
    assert first["MD [mm^2/s]"] == pytest.approx(float(gastrocnemius["MD [mm^2/s]"]))
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
    assert entry == {"value": 60.0, "probe": "pull", "ratio": pytest.approx(ratio * 1.0)}
    assert bool(warning) == (ratio != 1.0)
    if warning:
        assert "probe pull is" in warning and "60 N" in warning


def test_no_estimate_without_what_it_needs():
    assert pcsa_force(solved(48.0, area=None)) is None
    assert pcsa_force(solved(48.0, steps=[{"activation": 0.0, "probes": {"pull": 1.0}}])) is None
    assert pcsa_force(solved(48.0, model={})) is None
    assert pcsa_force({}) is None
