"""Studies: parameters recovered from made measurements, moved label maps."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest

from myork import ReducedModel
from myork.cli import main
from myork.errors import FileError, InputError
from myork.records import Labels
from myork.studies import identify, uncertainty
from myork.studies.forward import open_forward, ranges_of
from myork.studies.uncertainty import Doubt, perturbed
from tests.scenes import contracting, deck_file, held, probes, refuses, rows_of, solved

BLOCK = contracting(3, 3, 5, probe=probes("reaction force_z z1", "belly u 1 0.5 1"))
RANGES = {"load.activation": (0.0, 0.8), "boundary.z1.u_z": (-0.1, 0.2)}
RANGES |= {"material.muscle.sigma_max": (20.0, 45.0)}
TRUE = "material.muscle.sigma_max=36"
STRETCHES = [(0.1, 0.0), (0.3, 0.1), (0.6, 0.05), (0.8, -0.05), (0.5, 0.15), (0.0, 0.15)]


@pytest.fixture(scope="module")
def deck(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return deck_file(tmp_path_factory.mktemp("studies") / "block.toml", BLOCK)


@pytest.fixture(scope="module")
def trained(deck: Path) -> Path:
    rom = ReducedModel.train(deck, RANGES, full_solves=14, tests=0, threads=1)
    return rom.save(deck.parent / "block.rom.h5")


def measured(deck: Path, path: Path, changes: Sequence[str], noise: float) -> Path:
    """What full solves of a deck with changes say, with noise of a part of the largest force."""
    rows = []
    for activation, u_z in STRETCHES:
        state = [f"load.activation={activation}", f"boundary.z1.u_z={u_z}"]
        rows.append([activation, u_z, *solved(deck, *changes, *state).last().values()])
    table, rng = np.array(rows), np.random.default_rng(5)
    for values in table.T[2:]:
        values += noise * np.abs(values).max() * rng.standard_normal(len(table))
    head = "load.activation,boundary.z1.u_z,reaction,belly_x"
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.12g")
    return path


def test_sigma_max_by_a_reduced_model(deck: Path, trained: Path, tmp_path: Path) -> None:
    data = measured(deck, tmp_path / "data.csv", [TRUE], 0.01)
    found = identify(trained, data, ["sigma_max"], tmp_path, threads=1)
    low, high = found["parameters"]["material.muscle.sigma_max"]["interval"]
    assert low < 36 < high and high - low < 6
    assert found["warnings"] == [] and found["measurements"] == 12
    assert found["cost"]["by"] == "the reduced model"
    # the same measurements, the deck's own value: the fit is off by what it says
    rows = rows_of(tmp_path / "identify.csv")
    off = [float(r["reaction"]) - float(r["reaction_fitted"]) for r in rows]
    assert len(rows) == 6 and np.abs(off).max() < 0.05 * max(float(r["reaction"]) for r in rows)


@pytest.mark.slow
def test_muscle_matrix_and_fibers_by_full_solves(deck: Path, tmp_path: Path) -> None:
    """Largest stress, a modulus of the matrix and the angle of the fibers."""
    true = {"sigma_max": 36.0, "A10": 5.8, "fiber_angle": 14.0}
    changes = [f"material.muscle.{key}={value}" for key, value in true.items()]
    data = measured(deck, tmp_path / "data.csv", changes, 0.0)
    free = ["sigma_max=20:45", "A10=4.5:7.5", "fiber_angle=5:25"]
    found = identify(deck, data, [f"material.muscle.{f}" for f in free], tmp_path, threads=1)
    for key, value in true.items():
        entry = found["parameters"][f"material.muscle.{key}"]
        assert entry["value"] == pytest.approx(value, rel=5e-3)
        assert entry["interval"][0] < entry["value"] < entry["interval"][1]
    assert found["cost"]["by"] == "full solves"


def test_data_that_do_not_tell(trained: Path, deck: Path, tmp_path: Path) -> None:
    """At rest sigma_max has no effect, and activation takes its part elsewhere."""
    data = tmp_path / "data.csv"
    data.write_text("load.activation,boundary.z1.u_z,reaction\n0,0.1,0.8\n0,0.15,1.3\n")
    found = identify(trained, data, ["sigma_max"], tmp_path, threads=1)
    assert found["warnings"]
    low, high = found["parameters"]["material.muscle.sigma_max"]["interval"]
    assert not high - low < 25
    data.write_text("u_z,reaction\n0.0,5.0\n0.01,5.1\n0.02,5.2\n")
    found = identify(trained, data, ["sigma_max", "activation"], tmp_path, threads=1)
    assert any("do not distinguish" in line for line in found["warnings"])


@pytest.mark.slow
def test_measurements_with_errors(deck: Path, trained: Path, tmp_path: Path) -> None:
    """Wider errors, wider intervals; errors that are too small are reported."""
    plain = measured(deck, tmp_path / "data.csv", [TRUE], 0.0)
    head, *rows = (line.split(",")[:3] for line in plain.read_text().splitlines())

    def fitted(error: float, wrong: Callable[[float], float] = float) -> Any:
        lines = [f"{a},{u},{wrong(float(force))!r},{error}" for a, u, force in rows]
        plain.write_text("\n".join([",".join([*head, "reaction_error"]), *lines]))
        return identify(trained, plain, ["sigma_max"], tmp_path, threads=1)

    widths = []
    for error in (0.1, 0.3):
        low, high = fitted(error)["parameters"]["material.muscle.sigma_max"]["interval"]
        assert low < 36 < high
        widths.append(high - low)
    assert widths[1] == pytest.approx(3 * widths[0], rel=0.05)
    warnings = fitted(0.01, lambda force: 1.1 * force + 1)["warnings"]
    assert any("times the standard errors" in line for line in warnings)


HEAD = "load.activation,u_z,reaction"


@pytest.mark.parametrize(("text", "free", "message"), [
    ("load.activation,u_z,push\n0.1,0,1\n", "sigma_max", "no column has the name of a probe"),
    ("load.activation,reaction\n0.1,1\n", "sigma_max", "needed for boundary.z1.u_z"),
    (f"{HEAD}\n0.1,0,x\n", "sigma_max", "'x' is not a number"),
    (f"{HEAD}\n0.1,0\n", "sigma_max", "row 1 has 2 fields"),
    (f"sigma_max,{HEAD}\n30,0.1,0,1\n", "sigma_max", "is fitted"),
    (f"{HEAD}\n,0,1\n", "sigma_max", "needs a number for each key"),
    (f"{HEAD},reaction_error\n0.1,0,1,0\n", "sigma_max", "above 0"),
    (f"{HEAD}\n0.1,0,1\n", "sigma_max=3", "KEY=LOW:HIGH is needed"),
    (f"{HEAD}\n0.1,0,1\n", "K=1:2", "K: not a parameter"),
])  # fmt: skip
def test_wrong_data(trained, tmp_path, text, free, message):
    data = tmp_path / "data.csv"
    data.write_text(text)
    refuses(message, identify, trained, data, [free], tmp_path / "out", threads=1)


def test_ranges(trained: Path, deck: Path) -> None:
    forward, full = open_forward(trained), open_forward(deck)
    found = ranges_of(forward, ["activation", "boundary.2.u_z=0:0.1"])
    assert found == {"load.activation": (0.0, 0.8), "boundary.z1.u_z": (0.0, 0.1)}
    assert list(ranges_of(full, ["material.K=1:2"])) == ["material.muscle.K"]
    for of, twice in ((forward, ["activation", "load.activation=0:1"]),
                      (full, ["material.K=1:2", "material.1.K=1:2"])):  # fmt: skip
        refuses("given twice", ranges_of, of, twice)
    full.close()
    refuses("is not a number", open_forward, trained, ["activation=much"])


def cylinder() -> Labels:
    """Radius 12 mm, voxels of 1 x 1 x 3 mm; within, a core of 6 mm."""
    x, y, _ = np.indices((40, 40, 12))
    radius = np.hypot(x - 19.5, y - 19.5)
    data = np.where(radius < 6, 2, np.where(radius < 12, 1, 0)).astype(np.int32)
    return Labels(data, np.diag([1.0, 1.0, 3.0, 1.0]), {1: "muscle", 2: "core"})


def filled(labels: Labels, shift: float, noise: float, length: float, seed: int) -> int:
    moved = perturbed(labels, shift, noise, length, np.random.default_rng(seed))
    return int((moved.data > 0).sum())


@pytest.mark.parametrize("shift", [-0.7, -0.2, 0.0, 0.3, 0.8])
def test_moved_by_less_than_a_voxel(shift: float) -> None:
    """Volumes follow the move also where it is below half a voxel."""
    labels = cylinder()
    whole = (labels.data > 0).sum()
    changes = [filled(labels, shift, 0.0, 10.0, k) / whole - 1 for k in range(8)]
    assert np.mean(changes) == pytest.approx((1 + shift / 12) ** 2 - 1, abs=0.012)
    assert shift or changes == [0.0] * 8


def test_borders_between_labels_stay() -> None:
    """Both sides are moved alike: the core keeps its size on average, the outside grows."""
    labels = cylinder()
    whole = (labels.data > 0).sum()
    moved = perturbed(labels, 1.0, 0.0, 10.0, np.random.default_rng(1)).data
    assert (moved > 0).sum() > 1.1 * whole
    assert (moved == 2).sum() == pytest.approx((labels.data == 2).sum(), rel=0.1)
    noisy = [filled(labels, 0.0, 0.8, 8.0, k) for k in range(12)]
    assert np.std(noisy) > 0.002 * whole
    assert np.mean(noisy) == pytest.approx(whole, rel=0.03)


@pytest.fixture
def spindle(tmp_path: Path) -> Path:
    """A label map of one muscle and its deck."""
    x, y, z = np.meshgrid(*(np.arange(n) + 0.5 for n in (18, 18, 20)), indexing="ij")
    labels = (np.hypot(x - 9, y - 9) < 5 + 2 * np.sin(np.pi * z / 20)).astype(np.int16)
    nibabel.save(nibabel.Nifti1Image(labels, np.diag([1, 1, 1, 1])), tmp_path / "labels.nii.gz")
    tables = BLOCK | {
        "build": {"labels": "labels.nii.gz", "source_stride": [4, 4, 4],
                  "collocation_stride": [2, 2, 2]},
        "geometry": {"kind": "model"},
        "material": [{**BLOCK["material"][0], "label": 1, "fiber": [0, 0, 1]}],
        "boundary": [held("bottom"), held("top")],
        "load": {"steps": 2, "activation": 0.2}, "probe": probes("force force_z top"),
    }  # fmt: skip
    del tables["material"][0]["fiber_angle"]
    return deck_file(tmp_path / "spindle.toml", tables)


@pytest.mark.slow
def test_segmentation_carried_to_force(spindle, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["study", "uncertainty", str(spindle), "--samples", "6", "--shift", "0.6", "--noise",
             "0.3", "--out", str(out), "-q"]  # fmt: skip
    assert main(words) == 0
    assert "95 % of the maps from" in capsys.readouterr().out
    found = json.loads((out / "uncertainty.json").read_text())
    assert found["maps"] == 6 and found["failed"] == 0
    # a force of fibers grows with its section
    assert found["explained_by_volume"] > 0.6 and 0.4 < found["force_per_volume"] < 2.0
    assert 0.03 < found["relative_standard_deviation"] < 0.4
    assert found["as_it_is"] == pytest.approx(found["mean"], rel=0.3)
    assert len(rows_of(out / "uncertainty.csv")) == 7
    # a bias moves all of them
    wider = uncertainty(spindle, out, doubt=Doubt(bias=1.0, shift=0.2, noise=0.0), samples=3)
    assert wider["mean"] > 1.15 * wider["as_it_is"]
    assert wider["as_it_is"] == pytest.approx(found["as_it_is"], rel=1e-9)


def test_wrong_doubts(spindle: Path, tmp_path: Path) -> None:
    for how, kind, message in (
        ({"doubt": Doubt(shift=-1.0)}, InputError, "must not be negative"),
        ({"samples": 1}, InputError, "at least 2 are needed"),
        ({"fixed": ["build.labels=none.nii"]}, FileError, "no label map"),
        ({"samples": 2, "probe": "pull"}, InputError, "--probe pull: there are force"),
    ):
        with pytest.raises(kind, match=message):
            uncertainty(spindle, tmp_path / "out", **how)


@pytest.mark.slow
def test_commands(trained: Path, deck: Path, tmp_path: Path, capsys: Any) -> None:
    words = [str(trained), "--out", str(tmp_path), "-q", "--threads", "1"]
    data = measured(deck, tmp_path / "data.csv", [TRUE], 0.0)
    assert main(["study", "identify", *words, "--data", str(data), "--free", "sigma_max"]) == 0
    assert "material.muscle.sigma_max: 3" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["study"])
