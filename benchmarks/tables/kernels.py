"""Kernels of a solve, beside what this machine can do."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
BLOCK = "inputs/muscle_block.toml"
COLLOCATION = (
    "scene.method=rkcm",
    "solver.weight_essential=ns-c4",
    "solver.weight_traction=1",
    "material.curve=published",
)
TUBE = (
    "scene.method=rkpm-gauss",
    "approximation.support=3",
    "approximation.kernel=quintic",
    "galerkin.gauss=3",
)
#: Program, deck and settings of each problem
PROBLEMS = {
    "block, collocation": ("bench_kernels", BLOCK, COLLOCATION),
    "block, Galerkin form": ("bench_galerkin", BLOCK, ("scene.method=rkpm-gauss",)),
    "tube, Galerkin form": ("bench_galerkin", "inputs/tube.toml", TUBE),
}
SOLVERS = "auto refined normal sparse-normal dgels"


def measured(build: str, name: str, solvers: str = "auto") -> list[list[str]]:
    """Lines of the program that runs a problem, in words, on one thread."""
    program, deck, settings = PROBLEMS[name]
    tuned = {"OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"}
    environment = {key: value for key, value in os.environ.items() if key not in tuned}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "BENCH_SOLVERS": solvers}
    answer = subprocess.run(
        [Path(build).resolve() / "benchmarks" / program, deck, "5", *settings],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [line.split() for line in answer.stdout.splitlines()]


def kernels(build: str, before: str = "") -> Iterator[tuple[str, ...]]:
    """Processor time of each kernel of an iteration, its operations and bytes, beside the peaks.

    `build` is a build folder where `ninja benchmarks/bench_kernels benchmarks/bench_galerkin` ran,
    `before` one of an earlier state of the code. Operations are those that the formulas need, bytes
    those of arrays that go in and out, once; `dgemm` and `triad` are the peaks. The least of five.
    """
    yield "problem", "kernel", "before, ms", "ms", "GFLOP/s", "of peak", "GB/s", "of peak"
    for name in PROBLEMS:
        now, old = (
            {line[1]: [float(word) for word in line[2:5]]
             for line in (measured(place, name) if place else []) if line[0] == "kernel"}
            for place in (build, before)
        )  # fmt: skip
        peak, stream = now["dgemm"][1] / now["dgemm"][0], now["triad"][2] / now["triad"][0]
        for kernel, (seconds, flops, moved) in now.items():
            row = [name, f"`{kernel}`", f"{1e3 * old[kernel][0]:.1f}" if kernel in old else ""]
            row.append(f"{1e3 * seconds:.1f}")
            for amount, most in ((flops, peak), (moved, stream)):
                rate = amount / seconds
                row += [f"{1e-9 * rate:.3g}", f"{100 * rate / most:.0f} %"] if amount else ["", ""]
            yield tuple(row)


def solvers(build: str) -> Iterator[tuple[str, ...]]:
    """Each solver on the equations of the block by collocation; docs/solvers.md explains them."""
    yield "solver", "s", "times `dgels`", "backward error", "distance", "condition", "refinements"
    found = [line[1:] for line in measured(build, "block, collocation", SOLVERS)
             if line[0] == "solver"]  # fmt: skip
    dgels = next(float(words[1]) for words in found if words[0] == "dgels")
    for name, seconds, backward, misfit, condition, _, refined in found:
        spent = float(seconds)
        times = f"{dgels / spent:.1f}"
        yield f"`{name}`", f"{spent:.2f}", times, backward, misfit, condition, refined
