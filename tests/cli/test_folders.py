"""Output folders: one run at a time, earlier results stay whole, no solve without its command."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from myork.errors import FileError
from myork.files import claimed
from myork.results import Results
from myork.stations.solve import find_executable
from myork.summary import failures, renewing, update_summary

#: Longest wait for something that takes a second or two; a failure, not a measurement [s]
PATIENCE = 120

DECK = """\
title = "Sheared sheet"
[units]
force = "N"
length = "cm"
[scene]
dimension = 2
method = "rkcm"
[geometry]
kind = "box"
size = [4, 1]
source = [17, 5]
collocation = [33, 9]
[[material]]
name = "rubber"
model = "polynomial"
A10 = 37.3
K = 1e3
[[boundary]]
set = "y0"
u_x = 0
u_y = 0
[[boundary]]
set = "y1"
u_x = 1
u_y = 0
[load]
steps = 4
[[probe]]
name = "pull"
quantity = "force_x"
set = "y1"
"""
#: Takes many seconds, in steps of some hundredths of a second
LONG = ("--set", "load.steps=4000")


@pytest.fixture
def deck(tmp_path: Path) -> Path:
    path = tmp_path / "deck.toml"
    path.write_text(DECK)
    return path


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}


def solve(deck: Path, out: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [find_executable(), deck, "-o", out, "-t", "1", *words],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )


def start(deck: Path, out: Path, *words: str) -> subprocess.Popen[str]:
    """A long solve, handed over when its first step has converged."""
    run = subprocess.Popen(
        [find_executable(), deck, "-o", out, "-t", "1", *LONG, *words],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert run.stdout is not None
    while "step   1/" not in run.stdout.readline():
        assert run.poll() is None, run.stderr
    return run


def files_of(out: Path) -> dict[str, bytes]:
    return {
        name: (out / name).read_bytes()
        for name in ("results.vtkhdf", "history.csv", "run.log")
        if (out / name).is_file()
    }


def summary_of(out: Path) -> dict:
    return json.loads((out / "summary.json").read_text())


def wait_for(condition) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_folder_is_one_run_s(deck: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert solve(deck, out).returncode == 0
    before = files_of(out)
    run = start(deck, out)
    refused = solve(deck, out)
    assert refused.returncode == 2
    assert f"in use by another run (process {run.pid})" in refused.stderr
    with pytest.raises(FileError, match=f"process {run.pid}"), claimed(out):
        pass
    run.send_signal(signal.SIGINT)
    assert run.wait(PATIENCE) == 1
    assert files_of(out) == before
    assert solve(deck, out).returncode == 0, "the claim ends with the run"


def test_python_claims_a_folder_against_the_executable(deck: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with claimed(out):
        refused = solve(deck, out)
    assert refused.returncode == 2
    assert f"in use by another run (process {os.getpid()})" in refused.stderr
    assert not files_of(out)


def test_a_stopped_run_leaves_a_whole_one(deck: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert solve(deck, out).returncode == 0
    before = files_of(out)
    probes = summary_of(out)["steps"]
    run = start(deck, out)
    run.send_signal(signal.SIGINT)
    assert run.wait(PATIENCE) == 1
    assert run.stderr is not None
    assert "the results of an earlier run" in run.stderr.read()
    assert files_of(out) == before
    summary = summary_of(out)
    assert summary["steps"] == probes and summary["converged"] is True
    assert "topped" in summary["failed"]
    assert failures(summary)[0].startswith("The solution is that of an earlier run")
    with Results(out / "results.vtkhdf.part") as unfinished:
        assert unfinished.loads[-1] > 0.0, "what the stopped run reached can be read"
    assert solve(deck, out).returncode == 0
    assert "failed" not in summary_of(out)


def test_a_stopped_run_without_an_earlier_one_is_written(deck: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = start(deck, out)
    run.send_signal(signal.SIGTERM)
    assert run.wait(PATIENCE) == 1
    summary = summary_of(out)
    assert summary["converged"] is False
    with Results(out) as results:
        assert 0.0 < results.loads[-1] < 1.0
        assert results.loads[-1] == pytest.approx(summary["steps"][-1]["load"], rel=1e-15)


def test_a_run_that_fails_at_once_does_not_replace_states(deck: Path, tmp_path: Path) -> None:
    """The earlier run is unfinished as well, but it has states under load."""
    out = tmp_path / "out"
    run = start(deck, out)
    run.send_signal(signal.SIGINT)
    assert run.wait(PATIENCE) == 1
    before = files_of(out)
    failed = solve(deck, out, "--set", "solver.max_iterations=1", "--set", "load.max_halvings=0")
    assert failed.returncode == 1, failed.stderr
    assert files_of(out) == before


def test_no_reader_no_matter(deck: Path, tmp_path: Path) -> None:
    """Output into a pipe whose reader has gone: the run goes on and its results are written."""
    out = tmp_path / "out"
    run = subprocess.Popen(
        [find_executable(), deck, "-o", out, "-t", "1", "-v"],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert run.stdout is not None
    run.stdout.close()
    assert run.wait(PATIENCE) == 0
    assert summary_of(out)["converged"] is True


@pytest.mark.parametrize("loudness", ["-q", "-v"])
def test_a_solve_ends_with_the_command_that_started_it(
    deck: Path, tmp_path: Path, loudness: str
) -> None:
    """`kill -9` of `myork solve`: the executable stops after its iteration."""
    out = tmp_path / "out"
    parent = subprocess.Popen(
        [sys.executable, "-m", "myork", "solve", deck, "--out", out, *LONG, loudness],
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    log = out / "run.log.part"
    wait_for(lambda: log.is_file() and "step   2/" in log.read_text())
    solver = int((out / ".lock").read_text())
    assert solver != parent.pid
    parent.kill()
    parent.wait()
    wait_for(lambda: (out / "summary.json").is_file())
    summary = summary_of(out)
    assert summary["converged"] is False and summary["steps"][-1]["load"] > 0.0
    wait_for(lambda: not Path(f"/proc/{solver}").exists())


def test_a_station_that_fails_marks_what_it_leaves(tmp_path: Path) -> None:
    update_summary(tmp_path, {"model": {"volume": 1.0}, "units": {}})
    with pytest.raises(ValueError, match="no such slice"), renewing(tmp_path, "model", "tissue"):
        raise ValueError("no such slice")
    assert summary_of(tmp_path) == {
        "model": {"volume": 1.0, "failed": "no such slice"},
        "units": {},
    }
    assert failures(summary_of(tmp_path)) == [
        "The model is that of an earlier run; the last one: no such slice"
    ]
    with renewing(tmp_path, "model"):
        update_summary(tmp_path, {"model": {"volume": 2.0}})
    assert not failures(summary_of(tmp_path))


def test_a_full_disk_loses_nothing(deck: Path, tmp_path: Path) -> None:
    """Limits on the size of files stand for full disks, from none of the files to most of them."""
    import resource

    out = tmp_path / "out"
    assert solve(deck, out).returncode == 0
    before, summary = files_of(out), summary_of(out)
    failed = 0
    for size in np.geomspace(1, 2e5, 12).astype(int):

        def limit(size: int = int(size)) -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

        done = subprocess.run(
            [find_executable(), deck, "-o", out, "-t", "1"],
            env=environment(),
            preexec_fn=limit,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        if done.returncode == 0:
            assert summary_of(out)["steps"] == summary["steps"]
            continue
        failed += 1
        assert done.returncode == 2, done.stderr
        assert "too large" in done.stderr
        kept = summary_of(out)
        kept.pop("failed", None)
        assert kept == summary
        assert files_of(out) == before
    assert failed >= 6
