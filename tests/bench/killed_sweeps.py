"""Sweeps that are killed twice and resumed find what an undisturbed one finds; run by hand.

    python tests/bench/killed_sweeps.py [--points N] [--full N] FOLDER

A sweep of a reduced model, one of full solves by processes, and one by workers of Dask of which one
is killed. Each must end with the table of the sweep that nobody disturbed, but for its times.
"""

from __future__ import annotations

import argparse
import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

# The published block with fewer points, to a small activation
DECK = Path(__file__).parents[2] / "inputs" / "muscle_block.toml"
SMALL = ["geometry.source=[7, 7, 13]", "geometry.collocation=[7, 7, 13]", "load.activation=0.15"]
MYORK = [sys.executable, "-m", "myork"]


def finished(folder: Path) -> int:
    """Finished points of a sweep."""
    path = folder / "points.jsonl"
    return len(path.read_text().splitlines()) - 1 if path.exists() else 0


def killed(line: list[str], folder: Path, after: int) -> int:
    """Start a sweep, kill all its processes after some points; how many it had finished."""
    child = subprocess.Popen(line, stdout=subprocess.DEVNULL, start_new_session=True)
    while child.poll() is None and finished(folder) < after:
        time.sleep(0.001)
    if child.poll() is None:
        os.killpg(child.pid, signal.SIGKILL)
    child.wait()
    return finished(folder)


def table(folder: Path) -> list[dict[str, str]]:
    """Rows without what a second run measures anew."""
    with (folder / "sweep.csv").open() as file:
        return [{k: v for k, v in row.items() if k != "cpu_s"} for row in csv.DictReader(file)]


def alike(one: Path, other: Path) -> bool:
    """Whether tables are the same; batches of a reduced model of other sizes differ by rounding."""
    rows = list(zip(table(one), table(other), strict=True))
    return all(_same(row[key], twin.get(key, "")) for row, twin in rows for key in row)


def _same(one: str, other: str) -> bool:
    try:
        a, b = float(one), float(other)
    except ValueError:
        return one == other
    return abs(a - b) <= 1e-12 * abs(a) or one == other


def compare(name: str, line: list[str], folder: Path, count: int) -> None:
    """Undisturbed beside killed twice and resumed."""
    start = time.monotonic()
    subprocess.run([*line, "-q", "--out", str(folder / "whole")], check=True)
    alone = time.monotonic() - start
    out = folder / "killed"
    again = [*line, "-q", "--out", str(out)]
    kills = [killed(again, out, count * part // 3) for part in (1, 2)]
    start = time.monotonic()
    subprocess.run(again, check=True)
    rest = time.monotonic() - start
    same = alike(out, folder / "whole")
    verdicts = [row["verdict"] for row in table(out)]
    told = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
    print(
        f"{name}: {len(verdicts)} points ({told}), killed at {kills[0]} and {kills[1]}, "
        f"{'the same table' if same else 'ANOTHER TABLE'}; {alone:.1f} s undisturbed, "
        f"{rest:.1f} s to end the killed one",
        flush=True,
    )
    assert same and len(verdicts) == count


def dask_worker_killed(line: list[str], folder: Path, count: int) -> None:
    """Two workers of Dask, one killed after some points."""
    scheduler = f"tcp://127.0.0.1:{os.getpid() % 20000 + 20000}"
    dask = [sys.executable, "-m"]
    port = scheduler.rpartition(":")[2]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    processes = [
        subprocess.Popen([*dask, "distributed.cli.dask_scheduler", "--host", "127.0.0.1",
                          "--port", port, "--no-dashboard"], **quiet)
    ]  # fmt: skip
    for _ in range(2):
        processes.append(
            subprocess.Popen([*dask, "distributed.cli.dask_worker", scheduler, "--nthreads",
                              "1", "--no-nanny", "--no-dashboard"], **quiet)
        )  # fmt: skip
    out = folder / "dask"
    try:
        time.sleep(8.0)
        child = subprocess.Popen([*line, "-q", "--dask", scheduler, "--out", str(out)])
        while child.poll() is None and finished(out) < count // 3:
            time.sleep(0.01)
        processes[1].kill()
        at = finished(out)
        child.wait()
        same = alike(out, folder / "whole")
        print(f"Dask: one of two workers killed at {at} points, "
              f"{'the same table' if same else 'ANOTHER TABLE'}", flush=True)  # fmt: skip
        assert same
    finally:
        for process in processes:
            process.kill()
            process.wait()


def main() -> None:
    """All three."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--points", type=int, default=200)
    parser.add_argument("--full", type=int, default=12)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    folder = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    model = folder / "block.rom.h5"
    choices = [word for item in SMALL for word in ("--set", item)]
    sigma, load = "material.muscle.sigma_max", "load.activation"
    full = [*MYORK, "sweep", str(DECK), *choices, "--vary", f"{sigma}=20:40:{options.full // 3}"]
    full += ["--vary", f"{load}=0.1,0.2,0.3", "--workers", "2"]
    (folder / "full").mkdir(exist_ok=True)
    compare("full", full, folder / "full", options.full // 3 * 3)
    dask_worker_killed(full, folder / "full", options.full // 3 * 3)
    train = [*MYORK, "rom", "train", str(DECK), *choices]
    train += ["--vary", f"{sigma}=20:40", "--vary", f"{load}=0:0.3"]
    subprocess.run([*train, "-q", "-o", str(model)], check=True)
    reduced = [
        *MYORK,
        "sweep",
        str(DECK),
        *choices,
        "--model",
        str(model),
        "--samples",
        str(options.points),
    ]
    reduced += ["--vary", f"{sigma}=lhs(20,40)", "--vary", f"{load}=lhs(0,0.3)"]
    (folder / "reduced").mkdir(exist_ok=True)
    compare("reduced", reduced, folder / "reduced", options.points)


if __name__ == "__main__":
    main()
