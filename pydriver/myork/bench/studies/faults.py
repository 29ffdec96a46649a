"""Damaged input, signals, full disks and small memories: how every command ends.

All input is made anew from numbers of the corpus: a case that is listed here is made again by
`deck_fault`, `model_fault`, `image_faults` or `output_fault` with its seed and number. A command
may do the right thing (`right`), refuse its input with exit status 2 and the name of the place
(`refused`), or end with status 1 and what it had (`ended`). Wrong are a signal (`crash`), an
internal error or a traceback (`internal`), no end (`hang`), a spoilt earlier result (`lost`), and
numbers that are not finite in a good end (`nonsense`).
"""

from __future__ import annotations

import json
import math
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import nibabel
import numpy as np

from myork.bench.isolated import Verdict, isolated
from myork.bench.runs import INPUTS
from myork.console import ProgressCallback
from myork.core.deck import load_deck, text_of_tables
from myork.errors import MyorkError
from myork.files import claimed
from myork.model_file import read_model
from myork.reference.faults import image_deck
from myork.reference.faults_decks import deck_fault
from myork.reference.faults_images import image_faults, sound_image
from myork.reference.faults_models import MODEL_DECK, model_fault
from myork.reference.faults_outputs import output_fault
from myork.report import make_report
from myork.stations.build import build
from myork.stations.segment import segment
from myork.stations.solve import find_executable

__all__ = ["OUTCOMES", "WRONG", "run"]

#: Ends that are no fault, and those that are
OUTCOMES = ("right", "refused", "ended")
WRONG = ("crash", "internal", "hang", "lost", "nonsense")

#: Start of all random numbers
SEED = 11

#: Cases of each kind, of a quick run and of a whole one
_COUNTS = {
    "decks, read": (240, 2400),
    "decks, explained": (24, 300),
    "decks, solved": (6, 60),
    "models, explained": (30, 500),
    "models, read": (60, 500),
    "images": (12, 120),
    "output folders": (18, 180),
    "signals": (1, 20),
    "full disk": (4, 49),
    "no folder": (3, 8),
    "locked folder": (2, 7),
    "two writers": (1, 6),
    "little memory": (5, 24),
}

#: Signals of a command that is shorter or longer than others, as a part of those of the others
_SHARES = {"myork-solve": 2.0, "bench": 0.5, "demo": 0.4}

#: Time in which each ends that ends [s]
_LIMIT = 60.0

_SOLVED = """\
title = "Sheet"
units = {force = "N", length = "cm"}
scene = {dimension = 2, method = "rkcm"}
geometry = {kind = "box", size = [4, 1], source = [9, 3], collocation = [17, 5]}
material = [{name = "rubber", model = "polynomial", A10 = 37.3, K = 1000.0}]
boundary = [{set = "y0", u_x = 0, u_y = 0}, {set = "y1", u_x = 1.0, u_y = 0}]
load = {steps = 4}
probe = [{name = "pull", quantity = "force_x", set = "y1"}]
"""
_VALUES = ("1e300", "-1e300", "1e-300", "9e18", "0", "-1", "2147483647", "1e9", "1e30")
_KEYS = ("material.A10", "material.K", "boundary.u_y", "geometry.size", "load.steps", "probe.set",
         "load.activation", "solver.max_iterations", "solver.tolerance", "approximation.support",
         "geometry.source", "material.A20", "boundary.u_x")  # fmt: skip


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run the study; see `myork.bench` for the result."""
    cases: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="myork-faults-") as folder:

        def find(kind: str) -> tuple[list[tuple[str, Verdict]], float]:
            started = time.perf_counter()
            place = Path(folder, kind.replace(", ", "-").replace(" ", "-"))
            place.mkdir()
            found = []
            for case in _KINDS[kind](place, _COUNTS[kind][0 if quick else 1]):
                if ended.is_set():
                    break
                found.append(case)
            shutil.rmtree(place, ignore_errors=True)
            return found, time.perf_counter() - started

        # two at a time; every command has one thread
        pool, ended = ThreadPoolExecutor(2), threading.Event()
        try:
            kinds = sorted(_COUNTS, key=lambda kind: kind != "signals")  # the longest first
            running = {kind: pool.submit(find, kind) for kind in kinds}
            for kind in _COUNTS:
                found, seconds = running[kind].result()
                cases += [
                    {"kind": kind, "name": name, "outcome": outcome, "message": said[-2000:]}
                    for name, (outcome, said) in found
                ]
                ends = Counter(end.outcome for _, end in found)
                words = ", ".join(f"{number} {name}" for name, number in ends.items())
                progress(f"{kind}: {words} in {seconds:.0f} s")
        finally:
            ended.set()
            pool.shutdown(cancel_futures=True)
    bad = [case for case in cases if case["outcome"] in WRONG]
    head = ("", *OUTCOMES, *WRONG)
    table = Counter((case["kind"], case["outcome"]) for case in cases)
    return {
        "title": "Damaged input and broken machines",
        "about": " ".join(__doc__.split("\n\n")[1].split()),
        "cases": cases,
        "tables": [
            {
                "caption": f"Ends of {len(cases)} runs; seed {SEED}",
                "head": list(head),
                "rows": [[kind, *(table[kind, end] for end in head[1:])] for kind in _COUNTS],
            },
            {
                "caption": "Those that are wrong",
                "head": ["kind", "number and damage", "end", "message"],
                "rows": [[c["kind"], c["name"], c["outcome"], c["message"][-300:]] for c in bad],
            },
        ],
    }


Found = Iterator[tuple[str, Verdict]]


def _read_decks(place: Path, count: int) -> Found:
    items = [(str(place / "deck.toml"), number) for number in range(count)]
    names = [deck_fault(SEED, number, INPUTS)[0] for _, number in items]
    yield from zip(names, isolated(_read_deck, items, _LIMIT), strict=True)


def _read_deck(item: tuple[str, int]) -> Verdict:
    path = Path(item[0])
    path.write_bytes(deck_fault(SEED, item[1], INPUTS)[1])
    deck = load_deck(path)
    for material in deck.get("material", []):
        if material.get("K") == math.inf:  # incompressible
            del material["K"]
    return Verdict("right" if _finite(deck) else "nonsense")


def _explained_decks(place: Path, count: int) -> Found:
    path = place / "deck.toml"
    for number in range(count):
        # from the other end of the corpus, so that these are others than those that are read
        name, content = deck_fault(SEED + 1, number, INPUTS)
        path.write_bytes(content)
        yield name, _command([find_executable(), path, "--explain"], path.name)


def _solved_decks(place: Path, count: int) -> Found:
    path = place / "deck.toml"
    path.write_text(_SOLVED, encoding="utf-8")
    random = np.random.default_rng(SEED)
    for number in range(count):
        out = place / f"out-{number}"
        key, value = (str(random.choice(words)) for words in (_KEYS, _VALUES))
        if key in ("geometry.size", "geometry.source"):
            value = f"[{value}, {3 if key.endswith('source') else 1}]"
        change = f"{key}={value}"
        # a run that goes on is not at fault: many steps take long
        end = _command(
            [find_executable(), path, "-o", out, "-t", "1", "-q", "--set", change],
            (key, path.name),
            20.0,
        )
        if end.outcome == "hang" and any((out / name).exists() for name in _UNFINISHED):
            end = Verdict("ended", "still solving")
        if end.outcome == "right":
            summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
            numbers = [step["probes"] for step in summary["steps"]]
            if not _finite(numbers):
                end = Verdict("nonsense", json.dumps(numbers))
        shutil.rmtree(out, ignore_errors=True)
        yield change, end


_UNFINISHED = ("run.log.part", "history.csv.part", "results.vtkhdf.part")


def _explained_models(place: Path, count: int) -> Found:
    (place / "deck.toml").write_text(text_of_tables(MODEL_DECK), encoding="utf-8")
    words: list[str | Path]
    words = [find_executable(), place / "deck.toml", "--explain", "-o", place]
    for number in range(count):
        name = model_fault(SEED, number, place / "model.h5")
        # what is wrong with points is said of the deck's geometry
        yield name, _command(words, str(place))


def _read_models(place: Path, count: int) -> Found:
    items = [(str(place / "model.h5"), number) for number in range(count)]
    names = [model_fault(SEED, number, place / "model.h5") for _, number in items]
    yield from zip(names, isolated(_read_model, items, _LIMIT), strict=True)


def _read_model(item: tuple[str, int]) -> Verdict:
    path = Path(item[0])
    model_fault(SEED, item[1], path)
    cloud = read_model(path)
    sound = all(np.isfinite(values).all() for values in (cloud.source, cloud.points, cloud.volume))
    return Verdict("right" if sound else "nonsense")


def _images(place: Path, count: int) -> Found:
    faults = [fault for fault in image_faults(place / "files") if not fault.huge]
    some = [faults[i] for i in np.linspace(0, len(faults) - 1, count).astype(int)]
    items = []
    for number, fault in enumerate(some):
        deck = place / f"{number}.toml"
        deck.write_text(text_of_tables(fault.tables), encoding="utf-8")
        # names of labels are read with their map
        # what is segmented by a map that does not fit is said of the image
        names = (fault.path.name, fault.path.with_suffix(".nii.gz").name, "anatomy.nii.gz")
        out = str(place / "out")
        items.append((fault.command, str(deck), out, names, fault.message is not None))
    verdicts = isolated(_read_image, items, 2 * _LIMIT)
    yield from zip([fault.name for fault in some], verdicts, strict=True)


def _read_image(item: tuple[str, str, str, tuple[str, ...], bool]) -> Verdict:
    command, deck, out, names, must = item
    try:
        {"segment": segment, "build": build}[command](deck, out)
    except (MyorkError, OSError) as error:
        # what the system says of a file is bad input to the command as well
        said = str(error)
        if getattr(error, "exit_code", 2) != 2 or not any(name in said for name in names):
            return Verdict("internal", f"names no file: {said}")
        return Verdict("refused", said)
    return Verdict("nonsense", "accepted") if must else Verdict("right")


def _outputs(place: Path, count: int) -> Found:
    """Reports of damaged folders."""
    words, sound = _stations(place), place / "sound"
    for name in ("solve", "rom", "segment"):
        end = _command([*words[name], sound], "")
        if end.outcome != "right":
            raise RuntimeError(f"{name} does not do sound input: {end.said}")
    items = [(str(sound), str(place / "out"), number) for number in range(count)]
    verdicts = isolated(_report_output, items, _LIMIT)
    yield from zip([f"{number}" for number in range(count)], verdicts, strict=True)


def _report_output(item: tuple[str, str, int]) -> Verdict:
    sound, out, number = Path(item[0]), Path(item[1]), item[2]
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(sound, out)
    what, name, must = output_fault(SEED, number, out)
    try:
        make_report(out)
    except MyorkError as error:
        # names of labels are read with their map
        names = (name, Path(name).with_suffix(".nii.gz").name)
        if error.exit_code != 2 or not any(str(out / other) in str(error) for other in names):
            return Verdict("internal", f"{what}: names no file: {error}")
        return Verdict("refused", f"{what}: {error}")
    return Verdict("nonsense" if must else "right", what)


def _stations(place: Path) -> dict[str, list[str | Path]]:
    """Words of each command, on small input; their folder is added."""
    anatomy = place / "anatomy.nii"
    nibabel.save(nibabel.Nifti1Image(sound_image(), np.diag([2.0, 2.0, 5.0, 1.0])), anatomy)
    labels = np.zeros((8, 8, 8), np.int16)
    labels[1:7, 1:7, 1:7] = 1
    nibabel.save(nibabel.Nifti1Image(labels, np.diag([1.0, 1, 1, 1])), place / "labels.nii")
    decks = {
        "segment": text_of_tables(image_deck(anatomy)),
        "build": text_of_tables(
            {"scene": {"dimension": 3}, "build": {"labels": str(place / "labels.nii"), "ids": [1]}}
        ),
        "solve": _SOLVED,
        "rom": _SOLVED + "rom = {modes = [1, 2]}\n",
    }
    words: dict[str, list[str | Path]] = {}
    for name, text in decks.items():
        deck = place / f"{name}.toml"
        deck.write_text(text, encoding="utf-8")
        words[name] = [sys.executable, "-m", "myork", name, deck, "-q", "--threads", "1", "--out"]
    myork: list[str | Path] = [sys.executable, "-m", "myork"]
    return {
        "myork-solve": [find_executable(), place / "solve.toml", "-t", "1", "-q", "-o"],
        **words,
        "report": [*myork, "report", "-q"],
        "bench": [*myork, "bench", "linear", "--quick", "-q", "--out"],
        "demo": [*myork, "demo", "-q", "--threads", "1", "--out"],
        "explain": [*myork, "explain", place / "solve.toml", "--out"],
    }


def _sound_folder(place: Path, name: str, words: Sequence[str | Path]) -> tuple[Path, float]:
    """Folder with a sound result of a command, and how long it took [s]."""
    out = place / f"{name}-sound"
    if name == "report":
        solved, _ = _sound_folder(place, "myork-solve", _stations(place)["myork-solve"])
        shutil.copytree(solved, out)
    out.mkdir(exist_ok=True)
    started = time.perf_counter()
    end = _command([*words, out], "", 10 * _LIMIT)
    if end.outcome != "right":
        raise RuntimeError(f"{name} does not do sound input: {end.said}")
    return out, time.perf_counter() - started


def _signals(place: Path, count: int) -> Found:
    """Signals at random moments of each command, which renews an earlier result of its own."""
    random = np.random.default_rng(SEED)
    for name, words in _stations(place).items():
        signals = int(count * _SHARES.get(name, 1.0))
        if signals == 0:
            continue
        earlier, seconds = _sound_folder(place, name, words)
        for number in range(signals):
            kind = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)[number % 3]
            wait = float(random.uniform(0.02, 1.0)) * seconds
            out = place / f"{name}-{number}"
            shutil.copytree(earlier, out)
            end = _signalled([*words, out], kind, wait)
            if end.outcome in OUTCOMES:
                end = _kept(earlier, out, end)
            shutil.rmtree(out, ignore_errors=True)
            yield f"{name} {number} {kind.name} after {wait:.3f} s", end


def _signalled(words: Sequence[str | Path], kind: signal.Signals, wait: float) -> Verdict:
    """Verdict on a command that gets a signal after a time [s]."""
    child = subprocess.Popen(
        [str(word) for word in words],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        encoding="utf-8", errors="replace",
    )  # fmt: skip
    time.sleep(wait)
    child.send_signal(kind)
    try:
        said = child.communicate(timeout=_LIMIT)[1]
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()
        return Verdict("hang", "no end after the signal")
    # before a handler is there, and by SIGKILL, a signal ends a process; nothing is begun
    begun = re.search(r'cli\.py", line \d+, in main', said)
    early = said.rstrip().endswith("KeyboardInterrupt") and not begun
    # Python may end by SIGINT although the command has caught the interrupt and said so
    codes = (-kind, 128 + kind, -signal.SIGINT)
    by_signal = early or child.returncode in codes
    return Verdict("ended", said) if by_signal else _verdict(child.returncode, said)


def _kept(earlier: Path, out: Path, end: Verdict) -> Verdict:
    """The same end, or `lost` where a file of the earlier result is gone or cannot be read."""
    for path in sorted(earlier.rglob("*")):
        now = out / path.relative_to(earlier)
        if path.is_dir() or path.name == ".lock" or ".part" in path.name:
            continue
        if not now.is_file():
            return Verdict("lost", f"{now.name} is gone")
        if now.read_bytes() != path.read_bytes():
            try:
                _open(now)
            except Exception as reason:
                return Verdict("lost", f"{now.name}: {reason}")
    return end


def _open(path: Path) -> None:
    """Read a result that is new; an exception where it is not whole."""
    if path.stat().st_size == 0:
        raise ValueError("is empty")
    if path.suffix == ".json":
        json.loads(path.read_text(encoding="utf-8"))
    elif path.suffix == ".html":
        if not path.read_text(encoding="utf-8").rstrip().endswith("</html>"):
            raise ValueError("is cut off")
    elif path.suffix in (".h5", ".vtkhdf"):
        with h5py.File(path, "r") as file:
            file.visititems(lambda _, entry: entry[()] if hasattr(entry, "shape") else None)
    elif path.name.endswith((".nii", ".nii.gz")):
        np.asarray(nibabel.Nifti1Image.from_filename(path).dataobj)


def _full_disk(place: Path, count: int) -> Found:
    """Limits on the size of files stand for full disks."""
    stations = _without(place, "demo", "explain")
    sound = {name: _sound_folder(place, name, words)[0] for name, words in stations.items()}
    for number, size in enumerate(np.geomspace(1, 3e5, count).astype(int)):
        name = list(stations)[number % len(stations)]
        out = place / f"out-{number}"
        shutil.copytree(sound[name], out)
        limits = _limits(resource.RLIMIT_FSIZE, int(size))
        end = _command([*stations[name], out], "", before=limits)
        if end.outcome in OUTCOMES:
            end = _kept(sound[name], out, end)
        shutil.rmtree(out, ignore_errors=True)
        yield f"{number} {name} in {size} bytes", end


def _no_folder(place: Path, count: int) -> Found:
    """Folders that cannot be made or written to, for root as well."""
    (place / "file").write_text("no folder", encoding="utf-8")
    for name, words in list(_without(place, "explain").items())[:count]:
        yield name, _refusal(_command([*words, place / "file" / "out"], "file"))


def _without(place: Path, *names: str) -> dict[str, list[str | Path]]:
    return {name: words for name, words in _stations(place).items() if name not in names}


def _locked(place: Path, count: int) -> Found:
    for name, words in list(_without(place, "explain", "report").items())[:count]:
        with claimed(place / "out"):
            yield name, _refusal(_command([*words, place / "out"], "in use"))


def _refusal(end: Verdict) -> Verdict:
    return Verdict("nonsense", "accepted") if end.outcome == "right" else end


def _two_writers(place: Path, count: int) -> Found:
    """Each of two commands that start at once ends well or is refused; the result is whole."""
    words = _stations(place)["myork-solve"]
    for number in range(count):
        out = place / f"out-{number}"
        both = [
            subprocess.Popen(
                [str(word) for word in (*words, out)],
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, encoding="utf-8",
            )
            for _ in range(2)
        ]  # fmt: skip
        said = [child.communicate(timeout=_LIMIT)[1] for child in both]
        ends = [_verdict(child.returncode, text) for child, text in zip(both, said, strict=True)]
        for end in sorted(ends, key=lambda end: end.outcome != "right"):
            yield f"{number}", _kept(out, out, end)
        if not (out / "summary.json").is_file():
            yield f"{number}", Verdict("lost", "neither left a summary")
        else:
            _open(out / "summary.json")
            _open(out / "results.vtkhdf")


def _little_memory(place: Path, count: int) -> Found:
    words = _stations(place)["myork-solve"]
    for number, size in enumerate(np.geomspace(2e7, 1.5e9, count).astype(int)):
        limits = _limits(resource.RLIMIT_AS, int(size))
        yield (
            f"{number} myork-solve in {size / 1e6:.0f} MB",
            _command([*words, place / f"out-{number}"], "", before=limits),
        )


def _limits(what: int, size: int) -> Callable[[], None]:
    def limit() -> None:
        resource.setrlimit(what, (size, size))

    return limit


def _command(
    words: Sequence[str | Path],
    places: str | tuple[str, ...],
    limit: float = _LIMIT,
    before: Callable[[], None] | None = None,
) -> Verdict:
    """Verdict on a command in a process of its own, whose refusal must name one of the places."""
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [str(word) for word in words],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            encoding="utf-8", errors="replace", timeout=limit, preexec_fn=before,
            env={**os.environ, **one},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Verdict("hang", f"no end within {limit:g} s")
    end = _verdict(done.returncode, done.stderr)
    names = (places,) if isinstance(places, str) else places
    if end.outcome == "refused" and not any(name in end.said for name in names):
        return Verdict("internal", f"names no place: {end.said}")
    return end


def _verdict(status: int, said: str) -> Verdict:
    """Verdict on an exit status and what went with it."""
    if status < 0:
        return Verdict("crash", f"{signal.Signals(-status).name} {said}")
    # the system's loader without memory
    if status == 127 and "shared librar" in said:
        return Verdict("refused", said)
    outcome = {0: "right", 1: "ended", 2: "refused"}.get(status, "internal")
    if any(word in said for word in ("internal error", "Traceback", "Error termination")):
        outcome = "internal"
    # the language's own messages have the status of an input error
    if outcome == "refused" and any(w in said for w in ("runtime error", "ERROR STOP")):
        outcome = "internal"
    return Verdict(outcome, said)


def _finite(value: Any) -> bool:
    """Whether all numbers are finite; null stands for one that is not."""
    if isinstance(value, Mapping):
        return all(_finite(entry) for entry in value.values())
    if isinstance(value, list | tuple):
        return all(_finite(entry) for entry in value)
    return value is not None and (not isinstance(value, float) or math.isfinite(value))


_KINDS: dict[str, Callable[[Path, int], Found]] = {
    "decks, read": _read_decks,
    "decks, explained": _explained_decks,
    "decks, solved": _solved_decks,
    "models, explained": _explained_models,
    "models, read": _read_models,
    "images": _images,
    "output folders": _outputs,
    "signals": _signals,
    "full disk": _full_disk,
    "no folder": _no_folder,
    "locked folder": _locked,
    "two writers": _two_writers,
    "little memory": _little_memory,
}
