"""Solve the points of a sweep in parallel: processes on this machine, or workers of Dask."""

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
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback, silent
from myork.core.cloud import model_of
from myork.core.deck import deck_key, load_deck
from myork.core.scene import Scene
from myork.errors import (
    ConvergenceError,
    FileError,
    InputError,
    InstallationError,
    MyorkError,
    optional,
)
from myork.files import alone_in
from myork.model_file import model_bytes
from myork.rom.model import ReducedModel
from myork.rom.probes import places_of, units_of
from myork.stations.explain import explain_deck
from myork.stations.solve import refuse_other_model
from myork.sweeps.plan import Plan, identity, make_plan
from myork.sweeps.store import Store, has_parquet, read_points
from myork.types import F64

#: Threads of the libraries in a worker: one point per core
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: Possible reasons for the end of a point's process
_DIED = (
    "the process of this point died (out of memory, or a script that calls a sweep outside "
    "`if __name__ == '__main__':`)"
)
#: Number of points that a dry run shows
_SHOWN = 5
#: Format in which `myork explain` prints the time of a solve with its error bars
_TIME = r"about ([\d.eE+-]+) CPU s"


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
    progress: ProgressCallback = silent,
) -> Path:
    """Solve a deck at many values of its keys.

    Every finished point is on disk; a second call with the same sweep in the same folder continues
    where the first ended. A point that fails keeps its message and does not stop the sweep.

    - `deck`: deck file
    - `vary`: `KEY=LOW:HIGH:N`, `KEY=a,b,c` or `KEY=lhs(LOW,HIGH)` each; KEY is any key of the
      deck
    - `out`: folder of `sweep.csv`, `sweep.parquet` and `points.jsonl`. The model file of the deck
      is looked for there, in `out/<deck>`, where `myork build` writes it, and beside the deck.
    - `samples`: number of samples of sampled keys
    - `workers`: number of processes; default all cores
    - `dask`: address of a Dask scheduler, or "local" for a Dask cluster on this machine
    - `model`: reduced model (`.rom.h5`) used in place of the full one
    - `overrides`: overrides of the deck for all points
    - `dry_run`: only report what would be solved, and its cost
    - returns the table `sweep.csv`
    - raises InputError: the deck, a key or the plan is wrong, or the folder has another sweep
    """
    plan = make_plan(vary, samples, seed)._replace(deck=Path(deck), overrides=tuple(overrides))
    out = Path(out)
    full = [deck_key(plan.deck, key, overrides) for key in plan.keys]
    for k, key in enumerate(full):
        if key in full[:k]:
            raise InputError(
                f"--vary: {plan.keys[full.index(key)]} and {plan.keys[k]} are both {key}"
            )
    one, *_ = (plan.tables(number) for number in (0, -1, len(plan.points) // 2))
    if model is not None and dask is not None:
        raise InputError("--model and --dask cannot be combined: a reduced model needs no workers")
    workers = workers or os.cpu_count() or 1
    where = "the reduced model" if model else f"Dask at {dask}" if dask else f"{workers} processes"
    progress(f"{len(plan.points)} points of {', '.join(plan.keys)} by {where}")
    places = out, Path("out", plan.deck.stem)
    file = one["geometry"].get("file", "")
    home = next((folder for folder in places if Path(folder, file).is_file()), places[1])
    rom = None if model is None else ReducedModel.load(model)
    if rom is not None:
        values = _model_values(plan, rom, Path(model or ""), home)
    else:
        refuse_other_model(one, home, plan.overrides)
    head = identity(
        plan, home, None if model is None else Path(model),
        () if rom is None else [probe["name"] for probe in rom.head["probes"]],
    )  # fmt: skip
    if dry_run:
        for point in plan.points[:_SHOWN]:
            progress(f"  {', '.join(plan.settings(point))}")
        if len(plan.points) > _SHOWN:
            progress(f"  and {len(plan.points) - _SHOWN} more")
        for line in _cost(plan, out, home, head):
            progress(line)
        return out / "sweep.csv"
    about = {
        "title": one["title"],
        "units": units_of(one["probe"], one["scene"]["dimension"], one["probe_units"]),
        "model": None if model is None else Path(model).name,
    }
    with alone_in(out):
        store = Store(out, head, about)
        left = [number for number in range(len(plan.points)) if number not in store.rows]
        if store.rows:
            progress(f"{len(store.rows)} points are already done")
        try:
            if rom is not None:
                _reduced(rom, values, left, store)
            elif left:
                with _workers(dask, min(workers, len(left))) as team:
                    _full(plan, left, home, team, store, progress)
        finally:
            # a run without results leaves nothing
            if store.rows or not left:
                table = store.write_table(plan.keys, plan.points)
    counts: dict[str, int] = {}
    for row in store.rows.values():
        counts[row["verdict"]] = counts.get(row["verdict"], 0) + 1
    progress(", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items())))
    for verdict in sorted(counts.keys() - {"accepted"}):
        number, row = next((n, r) for n, r in sorted(store.rows.items()) if r["verdict"] == verdict)
        place = ", ".join(plan.settings(plan.points[number]))
        more = "; for the others see the column message" if counts[verdict] > 1 else ""
        progress(f"{verdict} at {place}: {row['message']}{more}")
    if not has_parquet():
        progress("no sweep.parquet without pyarrow: pip install 'myork[parquet]'")
    return table


def _cost(plan: Plan, out: Path, home: Path, head: Mapping[str, Any]) -> list[str]:
    """Cost of all points: from finished ones, otherwise from the counts of the middle one."""
    count = len(plan.points)
    times = [row["cpu_s"] for row in read_points(out / "points.jsonl", head).values()]
    # a point whose process died has none
    finished = [seconds for seconds in times if np.isfinite(seconds)]
    if finished:
        mean = np.mean(finished)
        return [
            f"  {len(finished)} finished points took {mean:.3g} CPU s each: "
            f"{count * mean / 3600.0:.3g} CPU hours for all"
        ]
    lines: list[str] = []
    middle = plan.items(count // 2)
    explain_deck(plan.deck, out=home, overrides=middle, progress=lines.append)
    found = re.search(_TIME, "\n".join(lines))
    if found is None:
        return []
    hours = count * float(found[1]) / 3600.0
    return [
        f"  about {found[1]} CPU s per point, {hours:.2g} CPU hours in all, estimated from counts "
        "(myork explain); finished points give a better estimate"
    ]


def solve_point(deck: str, overrides: Sequence[str], home: str) -> dict[str, Any]:
    """Solve a deck with overrides; an error is returned as a message, not raised.

    Returns `probes`: values of the last step by name, vectors by components; `errors`: their error
    bars; `verdict`, `message`, `cpu_s`.
    """
    start = time.process_time()
    row: dict[str, Any] = {"probes": {}, "errors": {}, "verdict": "failed", "message": ""}
    try:
        with Scene(deck, overrides, Path(home), threads=1) as scene:
            try:
                states = scene.solve()
                row["verdict"] = states.verdict
                row["message"] = "; ".join(states.reasons)
                values = scene.probes(states.x[-1:], states.load[-1:])[0]
                for name, at in places_of(scene.deck["probe"], scene.dimension).items():
                    row["probes"][name] = float(values[at])
                    row["errors"][name] = float(states.probe_errors[-1][at])
            except ConvergenceError as ended:
                row["message"] = str(ended)
    except (MyorkError, OSError) as wrong:
        row["message"] = str(wrong)
    row["cpu_s"] = time.process_time() - start
    return row


class _Team(NamedTuple):
    """Factory of an executor, its size, and the exception of a call whose worker died."""

    make: Callable[[], Executor]
    size: int
    deaths: tuple[type[Exception], ...]


def _full(
    plan: Plan, left: Sequence[int], home: Path, team: _Team, store: Store,
    progress: ProgressCallback,
) -> None:  # fmt: skip
    """Solve points; a worker that dies costs its point a message, but does not stop the sweep."""
    begin = time.monotonic()
    waiting = list(reversed(left))
    running: dict[Future[Any], tuple[int, Executor]] = {}
    tried: set[int] = set()
    total, done = len(left), 0
    pool = team.make()
    try:
        while waiting or running:
            while waiting and len(running) < team.size:
                number = waiting.pop()
                words = str(plan.deck.resolve()), plan.items(number), str(home)
                running[pool.submit(solve_point, *words)] = number, pool
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                number, own = running.pop(future)
                try:
                    row = future.result()
                except team.deaths as died:
                    # a process that dies breaks its pool
                    if isinstance(died, BrokenProcessPool) and own is pool:
                        pool = team.make()
                    # of several running points, the one that killed the worker is unknown
                    if number not in tried:
                        tried.add(number)
                        waiting.append(number)
                        continue
                    row = {
                        "probes": {}, "errors": {}, "verdict": "failed", "cpu_s": float("nan"),
                        "message": f"{_DIED}: {died}",
                    }  # fmt: skip
                store.add({"point": number, **row})
                done += 1
                rest = (time.monotonic() - begin) / done * (total - done)
                progress(
                    f"point {done}/{total}  {row['verdict']}  {rest:.0f} s left  "
                    + ", ".join(plan.settings(plan.points[number]))
                )
    finally:
        # points that have not begun are dropped, running ones are stopped
        if isinstance(pool, ProcessPoolExecutor):
            for process in list((pool._processes or {}).values()):
                process.terminate()
            pool.shutdown(cancel_futures=True)


def _model_values(plan: Plan, rom: ReducedModel, path: Path, home: Path) -> F64:
    """Values of the parameters of a reduced model at all points; it must belong to this deck."""
    trained = list(rom.head["overrides"])
    deck = load_deck(plan.deck, trained, "solve")
    try:
        points = model_of(deck, Path(deck["folder"]), home)
    except FileError:
        points = None  # a reduced model needs no other file
    own = rom.full_model().cloud
    if points is not None and own is not None and model_bytes(points) != model_bytes(own):
        raise InputError(
            f"{path}: was trained on other points than those of {deck['geometry']['file']} of "
            f"{plan.deck}: train it again"
        )
    if deck["sha256"] != rom.head["deck_sha256"]:
        raise InputError(
            f"{path}: was trained on a deck other than {plan.deck}; sweep that one, or train it "
            "again"
        )
    fixed = [item.partition("=") for item in plan.overrides if item not in trained]
    given = {p.key: value for p in rom.parameters if (value := _of_deck(deck, p.key)) is not None}
    given |= {rom.key_of(name.strip()): value for name, _, value in fixed}
    columns = zip(*plan.points, strict=True)
    given |= {rom.key_of(name): column for name, column in zip(plan.keys, columns, strict=True)}
    return rom.rows(given, len(plan.points))


def _of_deck(deck: Mapping[str, Any], key: str) -> Any:
    """Value of a parameter in its deck, None where there is none."""
    table, *entry, word = key.split(".")
    entries = deck[table] if entry else [deck[table]]
    named = (one for one in entries if not entry or entry[0] in (one.get("name"), one.get("set")))
    return next((one[word] for one in named if word in one), None)


def _reduced(rom: ReducedModel, values: F64, left: Sequence[int], store: Store) -> None:
    """Answers of a reduced model, all at once."""
    if not left:
        return
    start = time.process_time()
    answer = rom.batch(values[left], indicator=True)
    cpu = (time.process_time() - start) / len(left)
    probes, bars = answer.scalars(), rom.certificate.get("probes", {})
    for i, number in enumerate(left):
        verdict, reasons = answer.verdict(i)
        store.add(
            {
                "point": number, "probes": {name: float(v[i]) for name, v in probes.items()},
                "errors": bars if answer.certified[i] else {}, "message": "; ".join(reasons),
                "verdict": verdict, "cpu_s": cpu,
            }
        )  # fmt: skip


@contextmanager
def _workers(dask: str | None, workers: int) -> Iterator[_Team]:
    """Processes with one thread each, or the workers of Dask."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        if dask is None:
            context = multiprocessing.get_context("spawn")
            yield _Team(
                lambda: ProcessPoolExecutor(workers, mp_context=context, initializer=_begin),
                workers,
                (OSError, RuntimeError),
            )
        else:
            with _client(dask, workers) as client:
                size = max(1, sum(client.nthreads().values()))
                from distributed import KilledWorker

                # an error of the system means that the scheduler has ended
                yield _Team(
                    lambda: client.get_executor(pure=False), size, (RuntimeError, KilledWorker)
                )
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _begin() -> None:
    """Leave Ctrl-C to the process that distributes the points, and end when that one ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the end of the parent, even by SIGKILL, and exit even during a solve."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGKILL)


@contextmanager
def _client(address: str, workers: int) -> Iterator[Any]:
    """Client of a Dask scheduler, or of a new one with workers on this machine."""
    distributed = optional("distributed", "dask", "--dask")
    own: dict[str, Any] = {
        "n_workers": workers, "threads_per_worker": 1, "dashboard_address": None,
        "host": "127.0.0.1",
    }  # fmt: skip
    where: dict[str, Any] = {"address": address, "timeout": "10s"}
    try:
        client = distributed.Client(**own if address == "local" else where)
    except OSError as reason:
        raise InputError(f"--dask {address}: no scheduler answers there: {reason}") from None
    with client:
        try:
            yield client
        except (CancelledError, distributed.comm.CommClosedError):
            # failure to connect is irrelevant once it is closed
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
            raise InstallationError(
                f"--dask {address}: the scheduler has ended or cannot be reached any more; points "
                "that were finished are kept: start it and its workers again, and run the same "
                "line again"
            ) from None
