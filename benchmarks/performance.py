"""Measure the kernels of a solve on this machine and write docs/performance.md.

Usage::

    python benchmarks/performance.py BUILD_FOLDER [--part collocation|galerkin] [--repeats 5]
        [--before FOLDER DATE]

`bench_kernels` and `bench_galerkin` are built by `ninja -C BUILD_FOLDER benchmarks/bench_kernels
benchmarks/bench_galerkin`. Each part of the page comes from one run with one thread, in processor
time, with the peaks of the machine at that time; a part that is not asked for stays as it is. A
build folder of an earlier state of the code gives the times before of the Galerkin form.
"""

import argparse
import os
import subprocess
from pathlib import Path

from myork.bench.machine import machine

ROOT = Path(__file__).parents[1]
DECK = "inputs/muscle_block.toml"
SETTINGS = (
    "scene.method=rkcm",
    "solver.weight_essential=ns-c4",
    "solver.weight_traction=1",
    "material.curve=published",
)
SOLVERS = "auto refined normal sparse-normal dgels"

#: Bodies of the Galerkin form: title, deck and overrides
BODIES = (
    ("Inclined block, 9x9x17 points, order 1", DECK, ("scene.method=rkpm-gauss",)),
    (
        "Tube, 9x51 points, order 2",
        "inputs/tube.toml",
        (
            "scene.method=rkpm-gauss",
            "approximation.support=3",
            "approximation.kernel=quintic",
            "galerkin.gauss=3",
        ),
    ),
)

#: What a kernel does, and what is known of its limit
KERNELS = {
    "dgemm": "peak of one core: product of 1500 x 1500 matrices",
    "triad": "peak of memory: `a = b + s c` on 480 MB",
    "evaluate": "residuals and rows of all places; no model",
    "normal": "A^T A without A; operations counted are those of nonzero entries",
    "equilibrate": "reads and writes the envelope once",
    "cholesky": "block columns of 128: DGEMM and DTRSM with one short dimension",
    "solve": "reads the factor twice: memory",
    "apply": "interpolation at each place; operations are those of the sparse matrix",
    "apply_transposed": "the same, gathered by source points",
    "dgels": "QR of the dense matrix, 2 n^2 (m - n/3) operations",
}
GALERKIN = {
    "shape": "neighbours, shape functions and first derivatives at the Gauss points; the search "
    "counts no operations",
    "gradients": "gradients with what is prescribed lifted into them: gathers",
    "moduli": "stress and 81 moduli at each Gauss point; bytes of what is written",
    "stiffness": "`B^T C B` cell by cell, the upper triangle alone",
    "scatter": "upper triangles of groups of cells into the sparse matrix",
    "linearise": "forces, stiffness and the sum of both: all of one assembly",
    "evaluate": "forces alone; operations of gradients and forces without the material",
    "factor": "CHOLMOD with its order known, one solve and its check",
    "solve": "reads the factor twice: memory",
    "product": "the symmetric matrix times a vector: memory",
    "ellipticity": "acoustic tensors in 100 directions a collocation point (80 in the plane); no "
    "model",
}


def main() -> None:
    """Write the parts that are asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("build", type=Path)
    parser.add_argument("--part", choices=("collocation", "galerkin"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--before", nargs=2, metavar=("FOLDER", "DATE"), default=(None, ""))
    arguments = parser.parse_args()
    page = ROOT / "docs/performance.md"
    parts = page.read_text(encoding="utf-8").partition(GALERKIN_HEAD)
    first, second = parts[0], parts[1] + parts[2]
    if arguments.part != "galerkin":
        program = arguments.build / "benchmarks/bench_kernels"
        first = write_collocation(measure(program, DECK, SETTINGS, arguments.repeats))
    if arguments.part != "collocation":
        folder, date = arguments.before
        name = "benchmarks/bench_galerkin"
        runs = [
            [
                measure(Path(place) / name, deck, settings, arguments.repeats) if place else []
                for place in (arguments.build, folder)
            ]
            for _, deck, settings in BODIES
        ]
        second = write_galerkin(runs, date)
    page.write_text(first.rstrip("\n") + "\n\n" + second, encoding="utf-8")


def measure(program: Path, deck: str, settings: tuple[str, ...], repeats: int) -> list[list[str]]:
    """Lines of the program, in words."""
    tuned = {"OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"}
    environment = {key: value for key, value in os.environ.items() if key not in tuned}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "BENCH_SOLVERS": SOLVERS}
    answer = subprocess.run(
        [program, deck, str(repeats), *settings],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [line.split() for line in answer.stdout.splitlines()]


def write_collocation(lines: list[list[str]]) -> str:
    """The part of collocation."""
    m, n = next(line[1:3] for line in lines if line[0] == "size")
    kernels = _kernels(lines)
    solvers = [line[1:] for line in lines if line[0] == "solver"]
    dgels = next(float(words[1]) for words in solvers if words[0] == "dgels")
    kernels["dgels"] = [dgels, 2.0 * float(n) ** 2 * (float(m) - float(n) / 3.0), 0.0]
    table = [
        f"| `{words[0]}` | {float(words[1]):.2f} | {dgels / float(words[1]):.1f} | {words[2]} "
        f"| {words[3]} | {words[4]} | {words[6]} |"
        for words in solvers
    ]
    return COLLOCATION.format(
        deck=DECK, m=m, n=n, processor=machine()["processor"], peaks=_peaks(kernels),
        rows="\n".join(_rows(KERNELS, kernels, kernels)), solvers="\n".join(table),
        cgls=1e3 * kernels["cgls"][0], iterations=int(kernels["cgls"][1]),
    )  # fmt: skip


def write_galerkin(runs: list[list[list[list[str]]]], date: str) -> str:
    """The part of the Galerkin form, from lines of each body now and before."""
    bodies = []
    for (title, deck, settings), (now, before) in zip(BODIES, runs, strict=True):
        points, unknowns = next(line[1:3] for line in now if line[0] == "size")
        kernels, old = _kernels(now), _kernels(before)
        bodies.append(
            f"### {title}\n\n`{deck}` with `{' '.join(settings)}`: {unknowns} unknowns, {points} "
            f"Gauss points. Shares are of {_peaks(kernels)}.\n\n"
            "| kernel | before, ms | ms | GFLOP/s | of peak | GB/s | of peak | what it is |\n"
            "|---|---|---|---|---|---|---|---|\n"
            + "\n".join(_rows(GALERKIN, kernels, kernels, old))
        )
    return GALERKIN_PART.format(
        head=GALERKIN_HEAD, processor=machine()["processor"], bodies="\n\n".join(bodies),
        before=f" Before: the code of {date}, on the same machine." if date else "",
    )  # fmt: skip


def _peaks(kernels: dict[str, list[float]]) -> str:
    """What the machine can do."""
    peak, stream = _limits(kernels)
    return f"{1e-9 * peak:.0f} GFLOP/s (DGEMM) and {1e-9 * stream:.0f} GB/s (triad)"


def _limits(kernels: dict[str, list[float]]) -> tuple[float, float]:
    """Operations and bytes a second that the machine can do."""
    dgemm, triad = kernels["dgemm"], kernels["triad"]
    return dgemm[1] / dgemm[0], triad[2] / triad[0]


def _kernels(lines: list[list[str]]) -> dict[str, list[float]]:
    """Seconds, operations and bytes of each kernel."""
    return {line[1]: [float(word) for word in line[2:5]] for line in lines if line[0] == "kernel"}


def _rows(
    what: dict[str, str],
    kernels: dict[str, list[float]],
    machine: dict[str, list[float]],
    before: dict[str, list[float]] | None = None,
) -> list[str]:
    """Rows of a table of kernels, with a column of times before where there are any."""
    peak, stream = _limits(machine)
    rows = []
    for name, text in what.items():
        seconds, flops, moved = kernels[name]
        rate = f"{1e-9 * flops / seconds:.3g}" if flops else ""
        share = f"{100 * flops / seconds / peak:.0f} %" if flops else ""
        width = f"{1e-9 * moved / seconds:.3g}" if moved else ""
        part = f"{100 * moved / seconds / stream:.0f} %" if moved else ""
        old = "" if before is None else f" {1e3 * before[name][0]:.1f} |" if before else " |"
        rows.append(
            f"| `{name}` |{old} {1e3 * seconds:.1f} | {rate} | {share} | {width} | {part} "
            f"| {text} |"
        )
    return rows


COLLOCATION = """# Performance of a solve

Written by `benchmarks/performance.py`, this part from one run on one core of: {processor}. Deck
`{deck}` in the displacement form: {m} equations, {n} unknowns, first
iteration of a load step.
Times are processor time, the least of several; solvers on dense or sparse matrices ran once.

## Kernels

Shares are of {peaks}. Bytes are those that must
move at least. Hardware counters were not available on the machine of this page, so a limit is
named only where a share shows it.

| kernel | ms | GFLOP/s | of peak | GB/s | of peak | what it is |
|---|---|---|---|---|---|---|
{rows}

Semi-normal equations and CGLS with the factor take {cgls:.0f} ms together, with {iterations}
refinement(s).

## Solvers

The same equations by every method; [solvers](solvers.md) explains the columns.

| solver | s | times `dgels` | backward error | distance | condition | refinements |
|---|---|---|---|---|---|---|
{solvers}
"""

GALERKIN_HEAD = "## Kernels of the Galerkin form"

GALERKIN_PART = """{head}

Written by `benchmarks/performance.py` from a run of its own on one core of: {processor}.
Operations are those that the formulas need, bytes those of arrays that go in and out, once,
whatever caches save or the code does twice.{before}

{bodies}
"""


if __name__ == "__main__":
    main()
