"""Legs of three materials, large enough that the tangent is never formed: iterations and cost.

    python benchmarks/large_leg.py [--steps N] [--threads N] [SIZE ...]

A size is 36, 54 or 72, or any other number of voxels across the phantom of
`inputs/leg_section.toml`; every voxel is a point. Load steps are those of ten to activation 0.95.
Prints a row of the table in docs/galerkin.md for each size. 36 takes a minute, 72 up to an hour.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

DECK = Path(__file__).parents[1] / "inputs/leg_section.toml"


def options(across: int, steps: int) -> list[str]:
    """Keys of a leg of 115 x 115 x 150 mm with so many voxels across."""
    slices = round(across * 25 / 72)
    keys = {
        "phantom.size": f"[{across},{across},{slices}]",
        "phantom.spacing": f"[{115.2 / across:.4g},{115.2 / across:.4g},{150 / slices:.4g}]",
        "build.source_stride": "[1,1,1]",
        "build.collocation_stride": "[1,1,1]",
        "approximation.support": "1.82",
        "galerkin.penalty": "10",
        "galerkin.direct_limit": "0",
        "load.steps": f"{steps}",
        "load.activation": f"{0.095 * steps}",
    }
    return [f"--set={key}={value}" for key, value in keys.items()]


def row(across: int, steps: int, threads: int) -> str:
    """Solve a leg and tell what it took."""
    with tempfile.TemporaryDirectory() as folder:
        run = [sys.executable, "-m", "myork"]
        rest = [*options(across, steps), "--out", folder, str(DECK)]
        for station in ("segment", "build"):
            subprocess.run([*run, station, *rest], check=True, capture_output=True)
        said = subprocess.run(
            [*run, "solve", "-v", "--no-error", f"--threads={threads}", *rest],
            check=True, capture_output=True, text=True,
        )  # fmt: skip
        summary = json.loads((Path(folder) / "summary.json").read_text())
    counts = [int(n) for n in re.findall(r"in (\d+) iterations", said.stdout + said.stderr)]
    return (
        f"| {summary['source_points']:,} | {summary['dofs']:,} | {sum(counts) / steps:.0f}, "
        f"{len(counts) / steps:.1f} | {summary['cpu_s']:.0f} "
        f"| {summary['timings_s']['total']:.0f} | {summary['memory_peak_bytes'] / 1e9:.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("size", nargs="*", type=int, default=[36, 54])
    parser.add_argument("--steps", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    given = parser.parse_args()
    print("| points | unknowns | iterations, solves a step | CPU [s] | wall [s] | memory [GB] |")
    print("|---|---|---|---|---|---|")
    for across in given.size:
        print(row(across, given.steps, given.threads), flush=True)


if __name__ == "__main__":
    main()
