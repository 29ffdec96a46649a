"""Solve the points of a sweep side by side: processes of this machine, or workers of Dask."""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.console import ProgressCallback, silent
from myork.core.deck import deck_key, load_deck
from myork.errors import InputError, InstallationError
from myork.files import claimed
from myork.rom.model import ReducedModel
from myork.rom.probes import probe_columns
from myork.stations.explain import explain_deck
from myork.sweeps.array import gathered, part_folder, share_of, write_script
from myork.sweeps.inputs import Inputs
from myork.sweeps.plan import Plan, make_plan
from myork.sweeps.point import solve_point
from myork.sweeps.store import Store, has_parquet

__all__ = ["sweep"]

#: Threads of the libraries in a worker: one point a core
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: How `myork explain` tells the time of one solution of the equations
_ONCE = r"about ([\d.eE+-]+) s here"
#: Solutions of a load step at least: a step of Newton and those that confirm it
_LEAST_ITERATIONS = 3
#: A reduced model's answer is doubtful above this estimated error
_INDICATOR = 0.01


def sweep(
    deck: str | Path,
    vary: Sequence[str],
    out: str | Path,
    *,
    samples: int = 32,
    seed: int = 0,
    workers: int | None = None,
    dask: str | None = None,
    model: str | Path | None = None,
    overrides: Sequence[str] = (),
    dry_run: bool = False,
    part: str | None = None,
    slurm: str | Path | None = None,
    progress: ProgressCallback = silent,
) -> Path:
    """Solve a deck at many values of its keys.

    Every point is on the disk when it is done; a second call with the same sweep in the same folder
    goes on where the first ended. A point that fails keeps its message and ends nothing.

    Parameters
    ----------
    deck : str or Path
        Deck file.
    vary : sequence of str
        `KEY=LOW:HIGH:N`, `KEY=a,b,c`, `KEY=lhs(LOW,HIGH)` or `KEY=sobol(LOW,HIGH)` each; KEY is
        any key of the deck.
    out : str or Path
        Folder of `sweep.csv`, `sweep.parquet` and `points.jsonl`.
    samples : int
        Number of samples of sampled keys.
    seed : int
        Start of the random numbers.
    workers : int, optional
        Processes; default all cores.
    dask : str, optional
        Address of a scheduler of Dask, or "local" for one of its clusters on this machine.
    model : str or Path, optional
        Reduced model (`.rom.h5`) that answers in place of the full one.
    overrides : sequence of str
        Overrides of the deck for all points.
    dry_run : bool
        Only say what would be solved, and what it costs.
    part : str, optional
        "K/N": only every N-th point from the K-th, in a folder of its own within `out`; a call
        without `part` gathers what parts have found.
    slurm : str or Path, optional
        Write this script of an array of jobs, `workers` of them, and solve nothing.
    progress : callable
        Called with every line of progress.

    Returns
    -------
    Path
        The table `sweep.csv`.

    Raises
    ------
    InputError
        The deck, a key or the plan is wrong, or the folder holds another sweep.
    """
    plan = make_plan(vary, samples, seed)
    deck, out = Path(deck), Path(out)
    full = [deck_key(deck, key, overrides) for key in plan.keys]
    for k, key in enumerate(full):
        if key in full[:k]:
            raise InputError(
                f"--vary: {plan.keys[full.index(key)]} and {plan.keys[k]} are both {key}"
            )
    one = load_deck(deck, [*overrides, *plan.settings(plan.points[0])], "solve")
    for point in (plan.points[-1], plan.points[len(plan.points) // 2]):
        load_deck(deck, [*overrides, *plan.settings(point)], "solve")
    if model is not None and dask is not None:
        raise InputError("a reduced model needs no workers of Dask")
    jobs, workers = workers, workers or os.cpu_count() or 1
    where = "the reduced model" if model else f"Dask at {dask}" if dask else f"{workers} processes"
    progress(f"{len(plan.points)} points of {', '.join(plan.keys)} by {where}")
    if (part or slurm) and (model or dask):
        raise InputError("parts of a sweep are solved by full models, without Dask")
    share = range(len(plan.points)) if part is None else share_of(part, len(plan.points))
    rom = None if model is None else ReducedModel.load(model)
    if rom is not None:
        values = _model_values(plan, rom, Path(model or ""), deck, overrides)
    inputs = Inputs(
        plan, deck, overrides, out,
        None if model is None else Path(model),
        () if rom is None else [probe["name"] for probe in rom.head["probes"]],
    )  # fmt: skip
    if dry_run:
        for line in (*_preview(plan), *_cost(plan, deck, out, overrides)):
            progress(line)
        return out / "sweep.csv"
    if slurm is not None:
        words = _line(deck, vary, samples, seed, overrides, out)
        progress(write_script(Path(slurm), words, len(plan.points), jobs, out))
        return Path(slurm)
    folder = out if part is None else part_folder(out, part)
    about = {
        "title": one["title"],
        "units": _units(one),
        "model": None if model is None else Path(model).name,
    }
    with claimed(folder):
        store = Store(folder, inputs, about)
        for row in gathered(out, inputs) if part is None else ():
            if row["point"] not in store.rows:
                store.add(row)
        left = [number for number in share if number not in store.rows]
        if len(left) < len(share):
            progress(f"{len(share) - len(left)} points are done already")
        try:
            if rom is not None:
                _reduced(rom, values, left, store)
            elif left:
                with _executor(dask, min(workers, len(left))) as pool:
                    _full(plan, left, deck, out, overrides, pool, store, progress)
        finally:
            # a run that found nothing leaves nothing
            if store.rows or not left:
                table = store.write_table(plan.keys, plan.points)
    counts: dict[str, int] = {}
    for row in store.rows.values():
        counts[row["verdict"]] = counts.get(row["verdict"], 0) + 1
    progress(", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items())))
    if not has_parquet():
        progress("no sweep.parquet without pyarrow: pip install 'myork[parquet]'")
    return table


def _units(deck: Mapping[str, Any]) -> dict[str, str]:
    """Unit of each column of the probes."""
    return {
        column: deck["probe_units"][probe["name"]]
        for probe in deck["probe"]
        for column in probe_columns(probe, deck["scene"]["dimension"])
    }


def _line(
    deck: Path, vary: Sequence[str], samples: int, seed: int, overrides: Sequence[str], out: Path
) -> list[str]:
    """Words of the command of this sweep."""
    words = ["sweep", str(deck.resolve())]
    for item in vary:
        words += ["--vary", item]
    for item in overrides:
        words += ["--set", item]
    return [*words, "--samples", str(samples), "--seed", str(seed), "--out", str(out.resolve())]


def _cost(plan: Plan, deck: Path, out: Path, overrides: Sequence[str]) -> list[str]:
    """What all points cost: by those that are finished, else by one solution of the equations."""
    path = out / "points.jsonl"
    count = len(plan.points)
    if path.is_file():
        seconds = [row["cpu_s"] for row in _finished(path)]
        if seconds:
            return [
                f"  {len(seconds)} finished points took {np.mean(seconds):.3g} CPU s each: "
                f"{count * np.mean(seconds) / 3600.0:.3g} CPU hours for all"
            ]
    told: list[str] = []
    middle = plan.settings(plan.points[count // 2])
    explain_deck(deck, out=out, overrides=[*overrides, *middle], progress=told.append)
    once = next((m for line in told if (m := re.search(_ONCE, line))), None)
    if once is None:
        return []
    steps = int(load_deck(deck, [*overrides, *middle], "solve")["load"]["steps"])
    least = _LEAST_ITERATIONS * steps * float(once[1])
    return [
        f"  factors of the equations alone: {once[1]} s each, at least {least:.2g} CPU s a point, "
        f"{count * least / 3600.0:.2g} CPU hours in all; assembly comes on top, and finished "
        "points give a better estimate"
    ]


def _finished(path: Path) -> Iterator[dict[str, Any]]:
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines()[1:]:
        try:
            row = json.loads(line)
            if np.isfinite(row["cpu_s"]):
                yield row
        except (ValueError, KeyError, TypeError):
            continue


def _preview(plan: Plan) -> Iterator[str]:
    shown = plan.points[:5]
    for point in shown:
        yield "  " + ", ".join(plan.settings(point))
    if len(plan.points) > len(shown):
        yield f"  and {len(plan.points) - len(shown)} more"


def _full(
    plan: Plan,
    left: Sequence[int],
    deck: Path,
    out: Path,
    overrides: Sequence[str],
    pool: _Pool,
    store: Store,
    progress: ProgressCallback,
) -> None:
    """Solve points; a worker that dies costs its point a message, not the sweep."""
    begin = time.monotonic()
    waiting = list(reversed(left))
    running: dict[Any, int] = {}
    total, done = len(left), 0
    tries: dict[int, int] = {}
    while waiting or running:
        while waiting and len(running) < pool.size:
            number = waiting.pop()
            items = [*overrides, *plan.settings(plan.points[number])]
            running[pool.submit(solve_point, str(deck.resolve()), items, str(out))] = number
        for future in pool.first(running):
            number = running.pop(future)
            try:
                row = pool.result(future)
            except pool.deaths as died:
                # of several points that ran, the one that killed the worker is not known
                tries[number] = tries.get(number, 0) + 1
                if tries[number] < 2:
                    waiting.append(number)
                    pool.renew(died)
                    continue
                row = {
                    "probes": {}, "errors": {}, "verdict": "failed", "cpu_s": float("nan"),
                    "message": f"the process of this point died: {died}",
                }  # fmt: skip
                pool.renew(died)
            store.add({"point": number, **row})
            done += 1
            rest = (time.monotonic() - begin) / done * (total - done)
            progress(
                f"point {done}/{total}  {row['verdict']}  {rest:.0f} s left  "
                + ", ".join(plan.settings(plan.points[number]))
            )


def _model_values(
    plan: Plan, rom: ReducedModel, path: Path, deck: Path, overrides: Sequence[str]
) -> NDArray[np.float64]:
    """Values of the parameters of a reduced model at all points; it must be of this very deck."""
    trained = list(rom.head["overrides"])
    if load_deck(deck, trained, "solve")["sha256"] != rom.head["deck_sha256"]:
        raise InputError(
            f"{path}: was trained on another deck than {deck}; sweep that one, or train it again"
        )
    fixed = [item.partition("=") for item in overrides if item not in trained]
    values = np.empty((len(plan.points), len(rom.parameters)))
    given = [(rom.key_of(name), j) for j, name in enumerate(plan.keys)]
    alone = {rom.key_of(name.strip()): value for name, _, value in fixed}
    for k, key in enumerate(p.key for p in rom.parameters):
        named = [j for name, j in given if name == key]
        if not named and key not in alone:
            raise InputError(f"the reduced model needs a value: vary {key}, or give it by --set")
        try:
            values[:, k] = [point[named[0]] for point in plan.points] if named else alone[key]
        except ValueError:
            raise InputError(f"{key}: the reduced model takes numbers only") from None
    return values


def _reduced(
    rom: ReducedModel, values: NDArray[np.float64], left: Sequence[int], store: Store
) -> None:
    """Answers of a reduced model, all at once."""
    if not left:
        return
    start = time.process_time()
    answer = rom.batch(values[left], indicator=True)
    cpu = (time.process_time() - start) / len(left)
    for i, number in enumerate(left):
        reasons = []
        if not answer.converged[i]:
            reasons.append("the reduced model found no state")
        if not answer.inside[i]:
            reasons.append("outside the range of the training")
        if not answer.indicator[i] <= _INDICATOR:
            reasons.append(f"estimated error {answer.indicator[i]:.1e}")
        verdict = "doubtful" if reasons else "accepted"
        probes: dict[str, float] = {}
        for name, value in answer.probes.items():
            parts = np.atleast_1d(value[i])
            names = [name] if len(parts) == 1 else [f"{name}_{axis}" for axis in "xyz"]
            probes |= dict(zip(names, parts.tolist(), strict=False))
        store.add(
            {
                "point": number, "probes": probes, "errors": {}, "message": "; ".join(reasons),
                "verdict": verdict if answer.converged[i] else "refused", "cpu_s": cpu,
            }
        )  # fmt: skip


class _Pool:
    """Workers that take a function and its arguments."""

    def __init__(
        self,
        make: Callable[[], Any],
        size: int,
        first: Callable[[Any], Any],
        deaths: tuple[type[Exception], ...] = (OSError, RuntimeError),
        guard: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._make = make
        self._pool = make()
        self.size = size
        self._first = first
        #: What the result of a call raises whose worker died
        self.deaths = deaths
        #: Around all that reaches for the workers
        self._guard = guard

    def submit(self, *call: Any) -> Any:
        """Hand a call to a worker."""
        with self._guard():
            return self._pool.submit(*call)

    def first(self, running: Mapping[Any, int]) -> list[Any]:
        """Calls that are done, at least one."""
        with self._guard():
            return list(self._first(list(running)))

    def result(self, done: Any) -> Any:
        """What a call returned."""
        with self._guard():
            return done.result()

    def renew(self, died: Exception) -> None:
        """Start the processes again where one that died took the pool with it."""
        if isinstance(died, BrokenProcessPool):
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = self._make()

    def close(self) -> None:
        """End the workers; points that have not begun are dropped."""
        if isinstance(self._pool, Executor):
            for process in list(getattr(self._pool, "_processes", {}).values()):
                process.terminate()
            self._pool.shutdown(wait=True, cancel_futures=True)
        else:
            self._pool.close()


@contextmanager
def _executor(dask: str | None, workers: int) -> Iterator[_Pool]:
    """Processes of this machine with one thread each, or workers of Dask."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    cluster = None
    try:
        if dask is None:
            context = multiprocessing.get_context("spawn")
            pool = _Pool(
                lambda: ProcessPoolExecutor(workers, mp_context=context, initializer=_begin),
                workers,
                lambda running: wait(running, return_when=FIRST_COMPLETED).done,
            )
        else:
            pool, cluster = _dask_pool(dask, workers)
        try:
            yield pool
        finally:
            pool.close()
            if cluster is not None:
                cluster.close()
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _begin() -> None:
    """Leave Ctrl-C to the process that shares out the points, and end when that one ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the end of the parent, be it a SIGKILL, and end in the middle of a solve."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGKILL)


def _dask_pool(address: str, workers: int) -> tuple[_Pool, Any]:
    try:
        import distributed
    except ImportError as reason:
        raise InstallationError(
            f"--dask needs Dask distributed, which does not load ({reason}); "
            "pip install 'myork[dask]'"
        ) from None
    cluster = None
    if address == "local":
        cluster = distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        )
        client = distributed.Client(cluster)
    else:
        try:
            client = distributed.Client(address, timeout="10s")
        except OSError as reason:
            raise InputError(f"--dask {address}: no scheduler answers there: {reason}") from None
    size = max(1, sum(client.nthreads().values()))

    def first(running: list[Any]) -> list[Any]:
        distributed.wait(running, return_when="FIRST_COMPLETED")
        return [future for future in running if future.done()]

    @contextmanager
    def guard() -> Iterator[None]:
        try:
            yield
        except (CancelledError, distributed.comm.CommClosedError):
            # that it gives up connecting when it is closed is no news by then
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
            raise InstallationError(
                f"--dask {address}: the scheduler has ended or cannot be reached any more; points "
                "that were finished are kept: start it and its workers again, and run the same "
                "line again"
            ) from None

    deaths = (OSError, RuntimeError, distributed.KilledWorker)
    return _Pool(lambda: client, size, first, deaths, guard), cluster
