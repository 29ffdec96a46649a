"""Seconds of each phase on one and two threads, compared with the gain of the machine itself."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.problems import BY_NAME
from benchmarks.runner import sized_tables
from benchmarks.tables.trained import MODELS
from benchmarks.voxel_bodies import BODIES, body_cloud
from myork.core.deck import text_of_tables
from myork.files import INPUTS
from myork.model_file import write_model
from myork.rom.model import ReducedModel
from myork.stations.solve import run_deck

#: Problems and points along each edge
BOXES = {"inclined block": (9, 9, 17), "tube": (17, 101), "twist": (7, 7, 13)}
#: Body whose tangent is never formed, and the distance of its source points [cm]
VOXELS, DISTANCE = "spindle of voxels", 0.25
#: Seconds of each phase, unknowns, and quantities that must not depend on the number of threads
Found = tuple[dict[str, float], int, object]


def scaling(repeats: str = "3") -> Iterator[tuple[str, ...]]:
    """Wall seconds on one and two threads, the least of some runs in turn, with the same answers.

    The limits are those of the machine in the same minutes: products of matrices, and sums of long
    vectors as in the stream benchmark (a = b + s c), each thread with its own half. `share` is how
    much faster a phase is on two threads, divided by that of the product; for the body of voxels,
    whose tangent is never formed, by that of the sum, which work in the cache may exceed.
    """
    yield "body", "unknowns", "phase", "1 thread [s]", "2 threads [s]", "faster", "share"
    number, faster = int(repeats), {}
    for name, work, amount, unit in _limits():
        one, two = (min(_seconds(work, n) for _ in range(number)) for n in (1, 2))
        faster[name] = one / two
        rates = (f"{amount / seconds:.1f} {unit}" for seconds in (one, two))
        yield name, "", "", *rates, f"{faster[name]:.2f}", ""
    with tempfile.TemporaryDirectory() as folder:
        for name, solve in _bodies(Path(folder)):
            times: dict[int, list[dict[str, float]]] = {1: [], 2: []}
            answers = []
            for threads in (1, 2) * number:
                seconds, unknowns, answer = solve(threads)
                times[threads].append(seconds)
                answers.append(answer)
            assert all(answer == answers[0] for answer in answers), name
            limit = faster["sum" if name == VOXELS else "product"]
            for phase in times[1][0]:
                one, two = (min(run[phase] for run in times[n]) for n in (1, 2))
                if phase != "total" and one < 0.02 * times[1][0]["total"]:
                    continue
                shown = (f"{one:.3g}", f"{two:.3g}", f"{one / two:.2f}", f"{one / two / limit:.2f}")
                yield name, f"{unknowns:,}", phase, *shown


def _bodies(folder: Path) -> Iterator[tuple[str, Callable[[int], Found]]]:
    """Name of each body, and a function that solves it on some threads."""
    decks: dict[str, tuple[Path, list[str]]] = {}
    for name, size in BOXES.items():
        decks[name] = folder / f"{name}.toml", []
        decks[name][0].write_text(text_of_tables(sized_tables(BY_NAME[name].tables, size)))
    body = next(body for body in BODIES if body.name == VOXELS)
    write_model(folder / "model.h5", body_cloud(body, DISTANCE))
    decks[VOXELS] = folder / "voxels.toml", ["galerkin.direct_limit=0"]
    decks[VOXELS][0].write_text(text_of_tables(body.tables))
    for name, (deck, words) in decks.items():

        def solve(threads: int, deck: Path = deck, words: list[str] = words) -> Found:
            found = run_deck(deck, folder, overrides=words, threads=threads, error=False)
            return found["timings_s"], found["dofs"], found["steps"][-1]["probes"]

        yield name, solve
    case = MODELS["muscle block, nodal cells"]
    rom = ReducedModel.train(
        INPUTS / f"{case.deck}.toml", case.varied, full_solves=8, tests=2, out=folder,
        overrides=case.overrides, threads=2,
    )  # fmt: skip
    saved = rom.save(folder / "block.rom.h5")
    middle = {key: sum(ends) / 2 for key, ends in case.varied.items()}

    def reduced(threads: int) -> Found:
        model = ReducedModel.load(saved, threads)
        begin = time.perf_counter()
        state = model.solve(**middle)
        return {"total": time.perf_counter() - begin}, rom.basis.shape[1], state.u().tobytes()

    yield "reduced state", reduced


def _limits() -> Iterator[tuple[str, Callable[[int], object], float, str]]:
    """Name of a limit, its half by number, its operations or bytes, and their unit per second."""
    rng = np.random.default_rng(1)
    a, b = rng.random((2, 1500, 3000)), rng.random((3000, 1500))
    yield "product", lambda half: a[half] @ b, 2 * 2 * 1500**2 * 3000 / 1e9, "Gflop/s"
    x, y, z = rng.random((3, 2, 10_000_000))

    def add(half: int) -> None:
        np.multiply(y[half], 3.0, out=x[half])
        np.add(x[half], z[half], out=x[half])

    yield "sum", add, 5 * x.nbytes / 1e9, "GB/s"


def _seconds(work: Callable[[int], object], threads: int) -> float:
    """Wall time of both halves."""
    with ThreadPoolExecutor(threads) as pool:
        begin = time.perf_counter()
        list(pool.map(work, (0, 1)))
        return time.perf_counter() - begin
