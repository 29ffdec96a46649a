"""Sweeps: plans, tables, resumption after a kill, failures that end nothing, other workers."""

import csv
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from myork import Scene, sweep
from myork.cli import main
from myork.errors import InputError
from myork.sweeps.plan import make_plan

#: A strip that is pulled; quick to solve
STRIP = """
title = "strip"
[units]
force = "N"
length = "cm"
[scene]
dimension = 2
[geometry]
kind = "box"
size = [2, 1]
source = [5, 3]
collocation = [5, 3]
[[material]]
name = "rubber"
model = "neo-hookean"
mu = 10
K = 1000
[[boundary]]
set = "x0"
u_x = 0
u_y = 0
[[boundary]]
set = "x1"
u_x = 0.2
u_y = 0
[[probe]]
name = "pull"
quantity = "force_x"
set = "x1"
[[probe]]
name = "middle"
quantity = "u"
point = [1, 0.5]
"""


@pytest.fixture
def deck(tmp_path: Path) -> Path:
    path = tmp_path / "strip.toml"
    path.write_text(STRIP)
    return path


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "sweep.csv").open() as file:
        return list(csv.DictReader(file))


def test_plans() -> None:
    plan = make_plan(["a.b=0:1:3", "c=x,2"])
    assert plan.keys == ("a.b", "c")
    assert plan.points == [(0.0, "x"), (0.0, 2), (0.5, "x"), (0.5, 2), (1.0, "x"), (1.0, 2)]
    sampled = make_plan(["a=lhs(-1,1)", "b=1:2:2", "c=lhs(10,20)"], samples=16, seed=3)
    assert sampled.keys == ("b", "a", "c") and len(sampled.points) == 32
    a = np.sort([point[1] for point in sampled.points[:16]])
    # one sample in each sixteenth of the range
    assert (np.floor((a + 1) * 8) == np.arange(16)).all()
    assert make_plan(["a=lhs(-1,1)"], 4, 5) == make_plan(["a=lhs(-1,1)"], 4, 5)


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ([], "needs a key to vary"),
        (["a"], "is needed"),
        (["a=0:1"], "is needed"),
        (["a=0:x:3"], "'x' is not a number"),
        (["a=1,,2"], "a value is missing"),
        (["a=1,2", "a=3"], "a is named twice"),
        (["a=lhs(2,1)"], "2 is not below 1"),
        (["a=lhs(0,1)", "b=sobol(0,1)"], "cannot be mixed"),
        (["a=0:1:2000", "b=0:1:2000"], "at most 1000000"),
    ],
)
def test_wrong_plans(vary: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_plan(vary)


def test_table(deck: Path, tmp_path: Path) -> None:
    """The numbers are those of scenes solved one by one; a wrong point keeps its message."""
    out = tmp_path / "out"
    vary = ["material.rubber.mu=5,10,20", "boundary.x1.u_x=0.1,-1.9"]
    sweep(deck, vary, out, workers=2, overrides=["load.max_halvings=0"])
    rows = rows_of(out)
    assert len(rows) == 6
    for row in rows:
        over = [f"{key}={row[key]}" for key in ("material.rubber.mu", "boundary.x1.u_x")]
        if float(row["boundary.x1.u_x"]) < 0:
            # crushed to a twentieth in one step
            assert row["verdict"] in ("failed", "refused") and row["message"]
            continue
        assert row["verdict"] == "accepted"
        with Scene(deck, over) as scene:
            states = scene.solve()
            pull, middle = scene.probes(states.x[-1:], states.load[-1:])[0]
        assert float(row["pull"]) == pytest.approx(pull[0], rel=1e-12)
        assert float(row["middle_y"]) == pytest.approx(middle[1], abs=1e-12)
        assert float(row["pull_error"]) > 0 and float(row["cpu_s"]) > 0
    table = parquet.read_table(out / "sweep.parquet")
    assert table.num_rows == 6 and table.schema.metadata[b"unit_force"] == b"N"
    assert table["material.rubber.mu"].to_pylist() == [5, 5, 10, 10, 20, 20]


def test_csv_without_pyarrow(deck: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parquet is one of the optional packages: the table is written, and the lack told."""
    monkeypatch.setattr("myork.sweeps.store.find_spec", lambda name: None)
    said: list[str] = []
    table = sweep(deck, ["boundary.x1.u_x=0.1"], tmp_path / "out", progress=said.append)
    assert len(rows_of(table.parent)) == 1
    assert not (table.parent / "sweep.parquet").exists()
    assert "pip install 'myork[parquet]'" in said[-1]


def test_resumed_after_a_kill(deck: Path, tmp_path: Path) -> None:
    """A killed sweep loses no finished point; the table is that of a whole one."""
    out, whole = tmp_path / "out", tmp_path / "whole"
    words = [
        "sweep", str(deck), "--vary", "material.rubber.mu=5:20:12", "--workers", "1",
        "--set", "geometry.source=[17,9]", "-q",
    ]  # fmt: skip
    command = [sys.executable, "-m", "myork", *words, "--out", str(out)]
    for _ in range(2):
        process = subprocess.Popen(command, start_new_session=True)
        finished = len((out / "points.jsonl").read_text().splitlines()) if out.exists() else 0
        limit = time.monotonic() + 120
        while time.monotonic() < limit and process.poll() is None:
            path = out / "points.jsonl"
            if path.exists() and len(path.read_text().splitlines()) > max(finished, 1) + 1:
                break
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    before = (out / "points.jsonl").read_text().splitlines()
    # half a line of a run that was killed while it wrote
    (out / "points.jsonl").write_text("\n".join(before) + '\n{"point": 11, "pro')
    assert main([*words, "--out", str(out)]) == 0
    after = (out / "points.jsonl").read_text().splitlines()
    assert after[: len(before)] == before and len(after) == 13
    assert main([*words, "--out", str(whole)]) == 0
    for one, other in zip(rows_of(out), rows_of(whole), strict=True):
        assert one["pull"] == other["pull"]


def test_another_sweep_in_the_folder(deck: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    sweep(deck, ["material.rubber.mu=5,10"], out, workers=1)
    with pytest.raises(InputError, match="is of another sweep"):
        sweep(deck, ["material.rubber.mu=5,11"], out, workers=1)
    assert [row["material.rubber.mu"] for row in rows_of(out)] == ["5", "10"]


def test_wrong_keys_before_anything_runs(deck: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown key"):
        sweep(deck, ["material.rubber.nu=0.1,0.2"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_dry_run(deck: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    words = ["sweep", str(deck), "--vary", "material.rubber.mu=5:20:12", "--out", str(out)]
    assert main([*words, "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "12 points of material.rubber.mu" in said and "material.rubber.mu=5.0" in said
    assert not out.exists()


def test_dask(deck: Path, tmp_path: Path) -> None:
    """Workers of Dask give the same table."""
    vary = ["material.rubber.mu=5,10,20"]
    sweep(deck, vary, tmp_path / "dask", workers=2, dask="local")
    sweep(deck, vary, tmp_path / "local", workers=1)
    pulls = [[row["pull"] for row in rows_of(tmp_path / name)] for name in ("dask", "local")]
    assert pulls[0] == pulls[1] and not any(math.isnan(float(pull)) for pull in pulls[0])


def test_head_is_plain(deck: Path, tmp_path: Path) -> None:
    sweep(deck, ["material.rubber.mu=5"], tmp_path / "out", workers=1)
    head = json.loads((tmp_path / "out" / "points.jsonl").read_text().splitlines()[0])["sweep"]
    assert head["keys"] == ["material.rubber.mu"] and head["points"] == [[5]]


def test_an_array_of_jobs_finds_what_one_process_finds(
    deck: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each job runs its share from the script, one of them twice; then the line gathers."""
    vary = ["material.rubber.mu=5:20:5"]
    whole, out, script = tmp_path / "whole", tmp_path / "an array", tmp_path / "job.sh"
    sweep(deck, vary, whole, workers=1)
    sweep(deck, vary, out, workers=2, slurm=script)
    text = script.read_text()
    assert "#SBATCH --array=1-2\n" in text and "--part" in text and not out.exists()
    for number in ("1", "2", "2"):
        environment = {**os.environ, "SLURM_ARRAY_TASK_ID": number}
        subprocess.run(["sh", str(script)], env=environment, check=True, capture_output=True)
    assert len(rows_of(out / "part_1_of_2")) == 3 and len(rows_of(out / "part_2_of_2")) == 2
    monkeypatch.setattr("myork.sweeps.run._full", None)
    sweep(deck, vary, out)
    numbers = [{k: v for k, v in row.items() if k != "cpu_s"} for row in rows_of(whole)]
    assert [{k: v for k, v in row.items() if k != "cpu_s"} for row in rows_of(out)] == numbers
    assert main(["sweep", str(deck), "--vary", vary[0], "--dry-run", "--out", str(out)]) == 0
    assert "5 finished points took" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"is of another sweep"):
        sweep(deck, ["material.rubber.mu=5,6"], tmp_path / "an array" / ".." / "an array")
    with pytest.raises(InputError, match=r"--part 3/2: K/N is needed"):
        sweep(deck, vary, out, part="3/2")


def test_a_dry_run_tells_what_it_costs(
    deck: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["sweep", str(deck), "--vary", "material.rubber.mu=5:20:5", "--set", "load.steps=4"]
    assert main([*line, "--dry-run", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    once, point = re.search(r"alone: (\S+) s each, at least (\S+) CPU s a point", said).groups()
    assert float(point) == pytest.approx(12 * float(once), rel=0.06)
