"""Sweeps: plans, tables, resumption after a kill, failures that stop nothing, other workers."""

import contextlib
import csv
import json
import math
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from myork import sweep
from myork.cli import main
from myork.core.deck import text_of_tables
from myork.errors import InputError, InstallationError
from myork.model_file import write_model
from myork.sweeps import run
from myork.sweeps.plan import make_plan
from tests import scenes
from tests.scenes import probes, refuses, solved, wait_for
from tests.unit.test_scene_from_tables import BLOCK, cloud

WANTED = probes("pull force_x x1", "middle u 1 0.5")
STRIP = text_of_tables(scenes.strip(5, 3, places=(5, 3), probe=WANTED))
#: Result of a point that is not solved
SOLVED = {"verdict": "failed", "message": "", "probes": {}, "errors": {}, "cpu_s": 1.0}
MU = "material.rubber.mu"


@pytest.fixture
def deck(tmp_path: Path) -> Path:
    path = tmp_path / "strip.toml"
    path.write_text(STRIP)
    return path


def rows_of(folder: Path) -> list[dict[str, str]]:
    return scenes.rows_of(folder / "sweep.csv")


def test_plans() -> None:
    plan = make_plan(["a.b=0:1:3", "c=x,2"])
    assert plan.keys == ("a.b", "c")
    assert plan.points == [(0.0, "x"), (0.0, 2), (0.5, "x"), (0.5, 2), (1.0, "x"), (1.0, 2)]
    assert make_plan(["a=[0,0,1],[0,1,1]"]).points == [("[0,0,1]",), ("[0,1,1]",)]
    sampled = make_plan(["a=lhs(-1,1)", "b=1:2:2", "c=lhs(10,20)"], samples=16, seed=3)
    assert sampled.keys == ("b", "a", "c") and len(sampled.points) == 32
    a = np.sort([point[1] for point in sampled.points[:16]])
    # one sample in each sixteenth of the range
    assert (np.floor((a + 1) * 8) == np.arange(16)).all()
    assert make_plan(["a=lhs(-1,1)"], 4, 5) == make_plan(["a=lhs(-1,1)"], 4, 5)


def test_keys_are_those_of_set(deck: Path, tmp_path: Path) -> None:
    for vary, message in (
        (["material.mu=5", f"{MU}=6"], "material.mu and material.rubber.mu are both material"),
        (["material.mv=5"], r"strip.toml: material.mv: unknown key; did you mean"),
    ):
        refuses(message, sweep, deck, vary, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("vary", "message"), [
    ([], "needs a key to vary"), (["a"], "is needed"), (["a=0:1"], "is needed"),
    (["a=0:x:3"], "'x' is not a number"), (["a=1,,2"], "a value is missing"),
    (["a=1,2", "a=3"], "a is given twice"), (["a=lhs(2,1)"], "2 is not below 1"),
    (["a=1,2,1"], "a value is given twice"),
    (["build.source_stride=[1,1,1],[2,2,2]"], "acts before it is made"),
    (["a=0:1:2000", "b=0:1:2000"], "between 1 and 1000000"),
])  # fmt: skip
def test_wrong_plans(vary: list[str], message: str) -> None:
    refuses(message, make_plan, vary)


@pytest.mark.slow
def test_table(deck: Path, tmp_path: Path) -> None:
    """The numbers are those of scenes solved one by one; a wrong point keeps its message."""
    out = tmp_path / "out"
    vary = ["material.rubber.mu=5,10,20", "boundary.x1.u_x=0.1,-1.9"]
    sweep(deck, vary, out, workers=2, overrides=["load.max_halvings=0"])
    rows = rows_of(out)
    assert len(rows) == 6
    for row in rows:
        over = [f"{key}={row[key]}" for key in (MU, "boundary.x1.u_x")]
        if float(row["boundary.x1.u_x"]) < 0:
            # compressed to a twentieth in one step
            assert row["verdict"] in ("failed", "refused") and row["message"]
            continue
        assert row["verdict"] == "accepted"
        pull, middle = solved(deck, *over).ends().values()
        assert float(row["pull"]) == pytest.approx(pull[0], rel=1e-12)
        assert float(row["middle_y"]) == pytest.approx(middle[1], abs=1e-12)
        assert float(row["pull_error"]) > 0 and float(row["cpu_s"]) > 0
    table = parquet.read_table(out / "sweep.parquet")
    units = {"pull": "N/cm", "middle_x": "cm", "middle_y": "cm"}
    assert json.loads((out / "sweep.json").read_text())["units"] == units
    kept = {f"unit_{name}".encode(): unit.encode() for name, unit in units.items()}
    assert table.num_rows == 6 and table.schema.metadata == kept
    assert table[MU].to_pylist() == [5, 5, 10, 10, 20, 20]


@pytest.mark.parametrize(("values", "status"), [("-1.9,-1.8", 1), ("-1.9,0.1", 0)])
def test_a_sweep_without_any_answer_fails(
    deck: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], values: str, status: int
) -> None:
    """One good point is enough for status 0; without any the command fails, also when resumed."""
    out = tmp_path / "out"
    for _ in range(2):
        # a strip compressed to a twentieth in one step
        words = ["sweep", str(deck), "--vary", f"boundary.x1.u_x={values}", "--out", str(out)]
        assert main([*words, "--set", "load.max_halvings=0", "-q"]) == status
        said = capsys.readouterr().err
        failed = "no point of the sweep has an answer: all 2 failed or were refused" in said
        assert failed == (status == 1)
    rows = rows_of(out)
    assert [row["verdict"] == "accepted" for row in rows] == [False, status == 0]
    assert not failed or rows[0]["message"] in said


@pytest.mark.slow
def test_csv_without_pyarrow(deck: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parquet is one of the optional packages: the table is written, and the lack reported."""
    monkeypatch.setattr("myork.sweeps.store.find_spec", lambda name: None)
    said: list[str] = []
    table = sweep(deck, ["boundary.x1.u_x=0.1"], tmp_path / "out", progress=said.append)
    assert len(rows_of(table.parent)) == 1
    assert not (table.parent / "sweep.parquet").exists()
    assert "pip install 'myork[parquet]'" in said[-1]


def long_sweep(deck: Path, points: int) -> list[str]:
    """Words of a sweep whose points take a while."""
    return ["sweep", str(deck), "--vary", f"{MU}=5:20:{points}", "-q",
            "--set", "geometry.source=[17,9]"]  # fmt: skip


def started(*words: str) -> subprocess.Popen[bytes]:
    """The command in a separate process group."""
    return subprocess.Popen([sys.executable, "-m", "myork", *words], start_new_session=True)


@pytest.mark.slow
def test_resumed_after_a_kill(deck: Path, tmp_path: Path) -> None:
    """A killed sweep loses no finished point; the table is that of a whole one."""
    out, whole = tmp_path / "out", tmp_path / "whole"
    path = out / "points.jsonl"

    def lines() -> list[str]:
        return path.read_text().splitlines() if path.exists() else []

    words = [*long_sweep(deck, 12), "--workers", "1"]
    for _ in range(2):
        more, process = max(len(lines()), 1) + 2, started(*words, "--out", str(out))
        wait_for(lambda n=more, run=process: len(lines()) >= n or run.poll() is not None)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    before = lines()
    # half a line of a run that was killed while it wrote
    path.write_text("\n".join(before) + '\n{"point": 11, "pro')
    assert main([*words, "--out", str(out)]) == 0
    after = lines()
    assert after[: len(before)] == before and len(after) == 13
    assert main([*words, "--out", str(whole)]) == 0
    for one, other in zip(rows_of(out), rows_of(whole), strict=True):
        assert one["pull"] == other["pull"]


def processes_below(pid: int) -> list[int]:
    """Processes started by the threads of a process, and their children."""
    lists = Path("/proc", str(pid), "task").glob("*/children")
    own = [int(child) for path in lists for child in path.read_text().split()]
    return [*own, *(other for child in own for other in processes_below(child))]


@pytest.mark.slow
def test_workers_end_with_their_sweep(deck: Path, tmp_path: Path) -> None:
    """A SIGKILL of the sweep alone, in the middle of solves, leaves no process behind."""
    out = tmp_path / "out"
    sweeping = started(*long_sweep(deck, 200), "--workers", "2", "--out", str(out))
    try:
        wait_for(lambda: (out / "points.jsonl").exists() or sweeping.poll() is not None)
        workers = processes_below(sweeping.pid)
        assert len(workers) >= 2
        sweeping.kill()
        sweeping.wait()
        wait_for(lambda: not any((Path("/proc") / str(pid)).exists() for pid in workers))
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(sweeping.pid, signal.SIGKILL)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points are solved in this process, without the seconds in which others start."""

    team = run._Team(lambda: ThreadPoolExecutor(1), 1, (RuntimeError,))
    monkeypatch.setattr(run, "_workers", lambda *_: contextlib.nullcontext(team))


def stop_after_one(line: str) -> None:
    """Stop a sweep when its first point is on disk."""
    if line.startswith("point 1/"):
        raise KeyboardInterrupt


def write_inputs(folder: Path) -> None:
    """A strip, and a block from a model file."""
    folder.mkdir()
    (folder / "deck.toml").write_text(STRIP)
    (folder / "block.toml").write_text(text_of_tables(BLOCK))
    write_model(folder / "model.h5", cloud())


@pytest.mark.parametrize(
    ("deck", "file"),
    [("deck.toml", "deck.toml"), ("block.toml", "block.toml"), ("block.toml", "model.h5")],
)
def test_a_sweep_is_of_the_contents_of_its_files(tmp_path, monkeypatch, here, deck, file):
    """A sweep continues with its files' contents, wherever they are, and with no others."""
    made, out = tmp_path / "made", tmp_path / "out"
    write_inputs(made)
    monkeypatch.setattr(run, "solve_point", lambda *call: SOLVED)
    vary = ["load.steps=1,2,3"]
    before = (made / file).read_bytes()
    changed = before + b"\n"
    with pytest.raises(KeyboardInterrupt):
        sweep(made / deck, vary, out, progress=stop_after_one)
    (made / file).write_bytes(changed)
    name = "deck" if file == deck else rf".*{file}"
    refuses(rf"from before {name} changed: put the earlier file", sweep, made / deck, vary, out)
    assert len(rows_of(out)) == 1
    more = "other keys, points or --set: remove it"
    refuses(more, sweep, made / deck, ["load.steps=1,2,3,4"], out)
    # the same contents in another place
    (made / file).write_bytes(before)
    sweep(made.rename(tmp_path / "moved") / deck, vary, out)
    assert len(rows_of(out)) == 3


def test_files_that_are_varied_are_known_by_their_contents(tmp_path, monkeypatch, here):
    made, out = tmp_path / "made", tmp_path / "out"
    write_inputs(made)
    content = (made / "model.h5").read_bytes()
    (made / "other.h5").write_bytes(content)
    monkeypatch.setattr(run, "solve_point", lambda *call: SOLVED)
    vary = ["geometry.file=model.h5,other.h5"]
    sweep(made / "block.toml", vary, out)
    assert len(rows_of(out)) == 2
    (made / "other.h5").write_bytes(content + b"\n")
    refuses(r"before geometry\.file = other\.h5 changed", sweep, made / "block.toml", vary, out)


#: A repeated point, one that the sweep does not have, and one without a number
LINE = '{"point": %s, "probes": {}, "errors": {}, "verdict": "failed", "message": "", "cpu_s": 1}'


@pytest.mark.parametrize(
    "damage",
    ['{"point": 1, "ver', "3", "{}", '{"point": 1}', *(LINE % n for n in ("0", "2", "-1", '"1"'))],
)
def test_points_that_are_read_back_are_checked(deck, tmp_path, monkeypatch, here, damage):
    monkeypatch.setattr(run, "solve_point", lambda *call: SOLVED)
    sweep(deck, [f"{MU}=5,10"], tmp_path)
    path = tmp_path / "points.jsonl"
    *before, last = path.read_text().splitlines()
    path.write_text("\n".join([*before, damage]) + "\n")
    with pytest.raises(InputError, match=r"points\.jsonl:3: is not what a sweep wrote; remove"):
        sweep(deck, [f"{MU}=5,10"], tmp_path)
    path.write_text("\n".join(before) + "\n")
    sweep(deck, [f"{MU}=5,10"], tmp_path)
    assert path.read_text().splitlines() == [*before, last]


COLUMNS = {"verdict": "every sweep", "cpu_s": "every sweep", "middle_x": "the probe middle_x",
           "middle_y_error": "the probe middle_y_error",
           "material.rubber.mu": "the varied key material.rubber.mu"}  # fmt: skip


@pytest.mark.parametrize(("name", "owner"), COLUMNS.items())
def test_columns_cannot_overwrite_each_other(deck, tmp_path, name: str, owner: str) -> None:
    """Refused before anything is solved or written, also in a dry run."""
    deck.write_text(STRIP.replace('"pull"', f'"{name}"'))
    for dry in (True, False):
        with pytest.raises(InputError, match=r"rename the probe") as ended:
            sweep(deck, [f"{MU}=5,10"], tmp_path / "out", dry_run=dry)
        assert f"its column {name} of sweep.csv is also a column of {owner}" in str(ended.value)
    assert not (tmp_path / "out").exists()


def test_a_spreadsheet_runs_no_cell(deck, tmp_path, monkeypatch, here):
    name, bad = "=1+1", "@SUM(1)"
    deck.write_text(STRIP.replace('"pull"', f'"{name}"'))
    probes = {name: -1.5, "middle_x": -0.1, "middle_y": 0.0}
    solved = {"verdict": "accepted", "message": bad, "probes": probes, "errors": {}, "cpu_s": 1.0}
    monkeypatch.setattr(run, "solve_point", lambda *call: solved)
    sweep(deck, ["boundary.x1.u_x=-0.1", "title=+x"], tmp_path / "out")
    with (tmp_path / "out" / "sweep.csv").open() as file:
        head, row = csv.reader(file)
    assert head[:3] == ["boundary.x1.u_x", "title", "'=1+1"]
    assert row[:3] == ["-0.1", "'+x", "-1.5"] and row[-2] == "'@SUM(1)"
    # types tell text from formulas there
    assert parquet.read_table(tmp_path / "out" / "sweep.parquet")[name].to_pylist() == [-1.5]


@pytest.mark.parametrize(
    ("error", "caught"), [(KeyError("a mistake"), KeyError), (RuntimeError("killed"), None)]
)
def test_only_a_death_costs_a_point_a_message(deck, tmp_path, monkeypatch, here, error, caught):
    def solve_point(*call: str) -> None:
        raise error

    monkeypatch.setattr(run, "solve_point", solve_point)
    said: list[str] = []
    with pytest.raises(caught) if caught else contextlib.nullcontext():
        sweep(deck, [f"{MU}=5,6"], tmp_path, progress=said.append)
    if caught is None:
        # the reason of the first, whatever the number of the others
        assert sum(line.startswith("failed at material.rubber.mu=5: ") for line in said) == 1
        (message,) = {row["message"] for row in rows_of(tmp_path)}
        assert "out of memory" in message and message.endswith(": killed")
        lines: list[str] = []
        sweep(deck, [f"{MU}=5,6"], tmp_path, dry_run=True, progress=lines.append)
        assert "nan" not in "".join(lines)


def test_the_folder_of_a_sweep_keeps_the_whole_name(deck, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    deck.rename("strip.1.toml")

    def table(deck, vary, out, **_):
        out.mkdir(parents=True)
        (out / "sweep.csv").write_text("verdict,message\naccepted,\n")
        return out / "sweep.csv"

    monkeypatch.setattr("myork.sweeps.sweep", table)
    assert main(["sweep", "strip.1.toml", "--vary", "material.rubber.mu=5,6"]) == 0
    assert "strip.1_sweep" in capsys.readouterr().out


def test_dry_run(deck: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    words = ["sweep", str(deck), "--vary", "material.rubber.mu=5:20:12", "--out", str(out)]
    assert main([*words, "--set", "load.steps=4", "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "12 points of material.rubber.mu" in said and "material.rubber.mu=5.0" in said
    point, hours = re.search(r"about (\S+) CPU s per point, (\S+) CPU hours", said).groups()
    assert float(point) > 0 and float(hours) == pytest.approx(12 * float(point) / 3600, rel=0.06)
    assert not out.exists()


@pytest.mark.slow
def test_dask(deck: Path, tmp_path: Path) -> None:
    """Workers of Dask give the same table."""
    vary = [f"{MU}=5,10,20"]
    sweep(deck, vary, tmp_path / "dask", workers=2, dask="local")
    sweep(deck, vary, tmp_path / "local", workers=1)
    pulls = [[row["pull"] for row in rows_of(tmp_path / name)] for name in ("dask", "local")]
    assert pulls[0] == pulls[1] and not any(math.isnan(float(pull)) for pull in pulls[0])


@pytest.mark.slow
def test_a_scheduler_that_is_killed(deck: Path, tmp_path: Path) -> None:
    """Finished points are kept, the message names the remedy, and a second call does the rest."""
    out, vary = tmp_path / "out", ["material.rubber.mu=5,10,20,30"]
    serve = (
        "import distributed; cluster = distributed.LocalCluster(n_workers=1, processes=False, "
        "threads_per_worker=1, host='127.0.0.1', protocol='tcp', dashboard_address=None); "
        "print(cluster.scheduler_address, flush=True); input()"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", serve], stdin=pipe, stdout=pipe) as scheduler:
        address = scheduler.stdout.readline().decode().strip()

        def after_the_first(line: str) -> None:
            if line.startswith("point 1/"):
                scheduler.kill()

        with pytest.raises(InstallationError, match=r"scheduler has ended .* the same line again"):
            sweep(deck, vary, out, dask=address, progress=after_the_first)
    before = (out / "points.jsonl").read_text()
    assert 1 <= len(rows_of(out)) < 4
    sweep(deck, vary, out, workers=1)
    assert (out / "points.jsonl").read_text().startswith(before)
    assert {row["verdict"] for row in rows_of(out)} == {"accepted"} and len(rows_of(out)) == 4
