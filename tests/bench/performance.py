"""Measure the kernels of a solve on this machine and write docs/performance.md.

Usage::

    python tests/bench/performance.py BUILD_FOLDER [--repeats 5]

`bench_kernels` is built by `ninja -C BUILD_FOLDER tests/bench/bench_kernels`. All numbers of the
page come from one run of it with one thread, in processor time.
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

#: What a kernel does, and what is known of its limit
KERNELS = {
    "dgemm": "peak of one core: product of 1500 x 1500 matrices",
    "triad": "peak of memory: `a = b + s c` on 480 MB",
    "evaluate": "residuals and rows of all places; not profiled",
    "normal": "A^T A without A; operations counted are those of nonzero entries",
    "equilibrate": "reads and writes the envelope once",
    "cholesky": "block columns of 128: DGEMM and DTRSM with one short dimension",
    "solve": "reads the factor twice: memory",
    "apply": "interpolation at each place; operations are those of the sparse matrix",
    "apply_transposed": "the same, gathered by source points",
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("build", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    lines = measure(arguments.build / "tests/bench/bench_kernels", arguments.repeats)
    page = write(lines)
    (ROOT / "docs/performance.md").write_text(page, encoding="utf-8")


def measure(program: Path, repeats: int) -> list[list[str]]:
    """Lines of the program, in words."""
    tuned = {"OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"}
    environment = {key: value for key, value in os.environ.items() if key not in tuned}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "BENCH_SOLVERS": SOLVERS}
    answer = subprocess.run(
        [program, DECK, str(repeats), *SETTINGS],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [line.split() for line in answer.stdout.splitlines()]


def write(lines: list[list[str]]) -> str:
    """The page."""
    m, n = next(line[1:3] for line in lines if line[0] == "size")
    kernels = {
        line[1]: [float(word) for word in line[2:5]] for line in lines if line[0] == "kernel"
    }
    peak = kernels["dgemm"][1] / kernels["dgemm"][0]
    stream = kernels["triad"][2] / kernels["triad"][0]
    rows = []
    for name, what in KERNELS.items():
        seconds, flops, moved = kernels[name]
        rate = f"{1e-9 * flops / seconds:.3g}" if flops else ""
        share = f"{100 * flops / seconds / peak:.0f} %" if flops else ""
        width = f"{1e-9 * moved / seconds:.3g}" if moved else ""
        part = f"{100 * moved / seconds / stream:.0f} %" if moved else ""
        rows.append(
            f"| `{name}` | {1e3 * seconds:.1f} | {rate} | {share} | {width} | {part} | {what} |"
        )
    solvers = [line[1:] for line in lines if line[0] == "solver"]
    dgels = next(float(words[1]) for words in solvers if words[0] == "dgels")
    table = [
        f"| `{words[0]}` | {float(words[1]):.2f} | {dgels / float(words[1]):.1f} | {words[2]} "
        f"| {words[3]} | {words[4]} | {words[6]} |"
        for words in solvers
    ]
    return TEMPLATE.format(
        deck=DECK, m=m, n=n, processor=processor(), peak=1e-9 * peak, stream=1e-9 * stream,
        rows="\n".join(rows), solvers="\n".join(table),
        cgls=1e3 * kernels["cgls"][0], iterations=int(kernels["cgls"][1]),
    )  # fmt: skip


def processor() -> str:
    """Name of the processor."""
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()


TEMPLATE = """# Performance of a solve

Written by `tests/bench/performance.py` from one run on one core of: {processor}. Deck
`{deck}` in the displacement form: {m} equations, {n} unknowns, first
iteration of a load step.
Times are processor time, the least of several; solvers on dense or sparse matrices ran once.

## Kernels

Shares are of {peak:.0f} GFLOP/s (DGEMM) and {stream:.0f} GB/s (triad). Bytes are those that must
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


if __name__ == "__main__":
    main()
