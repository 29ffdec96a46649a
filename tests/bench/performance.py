"""Measure the kernels of a solve on this machine and write docs/performance.md.

Usage::

    python tests/bench/performance.py BUILD_FOLDER [--repeats 5] [--before FOLDER DATE]

`bench_kernels` and `bench_galerkin` are built by `ninja -C BUILD_FOLDER tests/bench/bench_kernels
tests/bench/bench_galerkin`. All numbers of the page come from one run of each with one thread, in
processor time. A build folder of an earlier state of the code gives the times before.
"""

import argparse
import os
import platform
import subprocess
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("build", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--before", nargs=2, metavar=("FOLDER", "DATE"), default=(None, ""))
    arguments = parser.parse_args()
    folder, date = arguments.before
    first = [(DECK, SETTINGS), *(body[1:] for body in BODIES)]
    runs = []
    for number, (deck, settings) in enumerate(first):
        name = "tests/bench/bench_galerkin" if number else "tests/bench/bench_kernels"
        now = measure(arguments.build / name, deck, settings, arguments.repeats)
        old = measure(Path(folder) / name, deck, settings, arguments.repeats) if folder else []
        runs.append((now, old))
    (ROOT / "docs/performance.md").write_text(write(runs, date), encoding="utf-8")


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


def write(runs: list[tuple[list[list[str]], list[list[str]]]], date: str) -> str:
    """The page."""
    lines, old = runs[0]
    m, n = next(line[1:3] for line in lines if line[0] == "size")
    kernels = _kernels(lines)
    peak = kernels["dgemm"][1] / kernels["dgemm"][0]
    stream = kernels["triad"][2] / kernels["triad"][0]
    solvers = [line[1:] for line in lines if line[0] == "solver"]
    dgels = next(float(words[1]) for words in solvers if words[0] == "dgels")
    work = 2.0 * float(n) ** 2 * (float(m) - float(n) / 3.0)
    kernels["dgels"] = [dgels, work, 0.0]
    table = [
        f"| `{words[0]}` | {float(words[1]):.2f} | {dgels / float(words[1]):.1f} | {words[2]} "
        f"| {words[3]} | {words[4]} | {words[6]} |"
        for words in solvers
    ]
    bodies = []
    for (title, deck, settings), (now, before) in zip(BODIES, runs[1:], strict=True):
        points, unknowns = next(line[1:3] for line in now if line[0] == "size")
        bodies.append(
            f"### {title}\n\n`{deck}` with `{' '.join(settings)}`: {unknowns} unknowns, {points} "
            f"Gauss points.\n\n{HEAD}\n"
            + "\n".join(_rows(GALERKIN, _kernels(now), _kernels(before), peak, stream))
        )
    return TEMPLATE.format(
        deck=DECK, m=m, n=n, processor=processor(), peak=1e-9 * peak, stream=1e-9 * stream,
        head=HEAD, rows="\n".join(_rows(KERNELS, kernels, _kernels(old), peak, stream)),
        solvers="\n".join(table), bodies="\n\n".join(bodies),
        before=f" `before` is the code of {date}." if date else "",
        cgls=1e3 * kernels["cgls"][0], iterations=int(kernels["cgls"][1]),
    )  # fmt: skip


def _kernels(lines: list[list[str]]) -> dict[str, list[float]]:
    """Seconds, operations and bytes of each kernel."""
    return {line[1]: [float(word) for word in line[2:5]] for line in lines if line[0] == "kernel"}


def _rows(
    what: dict[str, str],
    kernels: dict[str, list[float]],
    before: dict[str, list[float]],
    peak: float,
    stream: float,
) -> list[str]:
    """Rows of a table of kernels."""
    rows = []
    for name, text in what.items():
        seconds, flops, moved = kernels[name]
        rate = f"{1e-9 * flops / seconds:.3g}" if flops else ""
        share = f"{100 * flops / seconds / peak:.0f} %" if flops else ""
        width = f"{1e-9 * moved / seconds:.3g}" if moved else ""
        part = f"{100 * moved / seconds / stream:.0f} %" if moved else ""
        old = f"{1e3 * before[name][0]:.1f}" if name in before else ""
        rows.append(
            f"| `{name}` | {old} | {1e3 * seconds:.1f} | {rate} | {share} | {width} | {part} "
            f"| {text} |"
        )
    return rows


def processor() -> str:
    """Name of the processor."""
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()


HEAD = """| kernel | before, ms | ms | GFLOP/s | of peak | GB/s | of peak | what it is |
|---|---|---|---|---|---|---|---|"""

TEMPLATE = """# Performance of a solve

Written by `tests/bench/performance.py` from one run on one core of: {processor}. Deck
`{deck}` in the displacement form: {m} equations, {n} unknowns, first
iteration of a load step.
Times are processor time, the least of several; solvers on dense or sparse matrices ran once.

## Kernels

Shares are of {peak:.0f} GFLOP/s (DGEMM) and {stream:.0f} GB/s (triad). Operations are those that
the formulas need, bytes those of arrays that go in and out, once, whatever caches save or the code
does twice. Hardware counters were not available on the machine of this page, so a limit is
named only where a share shows it.{before}

{head}
{rows}

Semi-normal equations and CGLS with the factor take {cgls:.0f} ms together, with {iterations}
refinement(s).

## Kernels of the Galerkin form

{bodies}

## Solvers

The same equations by every method; [solvers](solvers.md) explains the columns.

| solver | s | times `dgels` | backward error | distance | condition | refinements |
|---|---|---|---|---|---|---|
{solvers}
"""


if __name__ == "__main__":
    main()
