"""Parameters recovered from synthetic data."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import ReducedModel
from myork.cli import main
from myork.studies import identify
from myork.studies.forward import open_forward, ranges_of
from tests.scenes import contracting, deck_file, probes, refuses, rows_of, solved

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
    (f"{HEAD}\n0.1,0,x\n", "sigma_max", "row 1: could not convert string to float: 'x'"),
    (f"{HEAD}\n0.1,0\n", "sigma_max", "row 1: 2 fields: the header has 3"),
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


@pytest.mark.slow
def test_commands(trained: Path, deck: Path, tmp_path: Path, capsys: Any) -> None:
    words = [str(trained), "--out", str(tmp_path), "-q", "--threads", "1"]
    data = measured(deck, tmp_path / "data.csv", [TRUE], 0.0)
    assert main(["study", "identify", *words, "--data", str(data), "--free", "sigma_max"]) == 0
    assert "material.muscle.sigma_max: 3" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["study"])
