"""A sweep as an array of jobs of Slurm: a script, parts in folders of their own, gathered."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from myork.errors import InputError
from myork.files import write_text
from myork.sweeps.inputs import Inputs
from myork.sweeps.store import read_points

__all__ = ["gathered", "part_folder", "share_of", "write_script"]

#: Jobs of an array where nothing else is asked for
_JOBS = 64


def share_of(part: str, count: int) -> range:
    """Numbers of the points of a part, such as "3/16": every sixteenth, from the third.

    Neighbours in a grid cost alike, so that parts of points far apart end together.
    """
    found = re.fullmatch(r"(\d+)/(\d+)", part)
    number, parts = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= number <= parts:
        raise InputError(f"--part {part}: K/N is needed, K from 1 to N, as in 3/16")
    return range(number - 1, count, parts)


def part_folder(out: Path, part: str) -> Path:
    """Folder of a part of a sweep; jobs of an array write side by side."""
    return out / f"part_{part.replace('/', '_of_')}"


def gathered(out: Path, inputs: Inputs) -> list[dict[str, Any]]:
    """Finished points of all parts of this very sweep."""
    found: dict[int, dict[str, Any]] = {}
    for path in sorted(out.glob("part_*_of_*/points.jsonl")):
        found |= read_points(path, inputs)
    return list(found.values())


def write_script(path: Path, line: Sequence[str], points: int, jobs: int | None, out: Path) -> str:
    """Write the script of an array.

    Parameters
    ----------
    path : Path
        The script.
    line : sequence of str
        Words of `myork sweep` without `--part`.
    points : int
        Number of points.
    jobs : int, optional
        Number of jobs; default 64, or as many as there are points.
    out : Path
        Folder of the sweep.

    Returns
    -------
    str
        What to type to run it and to gather what it found.
    """
    jobs = min(jobs or _JOBS, points)
    words = shlex.join([sys.executable, "-m", "myork", *line])
    log = out.resolve() / "slurm-%A_%a.log"
    write_text(
        path,
        f"""#!/bin/sh
#SBATCH --job-name=myork-sweep
#SBATCH --array=1-{jobs}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --output={log}
# Time and memory of a job are a cluster's own: #SBATCH --time=1:00:00, #SBATCH --mem=4G.
# A job solves up to {-(-points // jobs)} of {points} points; submitted again it goes on.
# When all have ended the same line without --part gathers what they found:
#   {words}
cd {shlex.quote(str(Path.cwd()))} || exit 2
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
exec {words} --workers 1 --part "$SLURM_ARRAY_TASK_ID/{jobs}"
""",
    )
    return f"mkdir -p {shlex.quote(str(out))} && sbatch {shlex.quote(str(path))}"
