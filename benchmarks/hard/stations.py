"""What hard cases do besides solving a deck: images, manufactured solutions, restarts, models.

Each takes the case and the time after which what it starts is ended, and returns a record like
that of `solve_case`.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hard.case import Case
from benchmarks.problems import PROBLEMS
from benchmarks.runner import Truths, solve_rivals
from benchmarks.truths.manufactured import Problem as Manufactured
from benchmarks.truths.manufactured import solve as solve_manufactured
from benchmarks.voxel_bodies import BODIES
from myork.bench.runs import Ending, run_command, solve_case
from myork.console import silent
from myork.core.deck import text_of_tables
from myork.errors import ConvergenceError, MyorkError
from myork.rom.model import ReducedModel
from myork.stations.solve import find_executable

__all__ = ["run_station", "truths_of"]

#: Estimated error of the displacement from which on the page of a reduced model doubts [-]
_DOUBTFUL = 0.017
#: Range of the training of the reduced model
_RANGE = {"load.activation": (0.0, 0.5), "boundary.z1.u_z": (0.0, 0.2)}


def run_station(case: Case, limit: float) -> dict[str, Any]:
    """Run a case.

    Parameters
    ----------
    case : Case
        Case.
    limit : float
        Wall time after which it is ended [s].
    """
    if case.station == "solve":
        return solve_case(case.deck, case.overrides, cloud=case.cloud, limit=limit, error=True)
    return _STATIONS[case.station](case, limit)


@cache
def truths_of(name: str) -> Truths:
    """Right values of a problem of `benchmarks.truths`, by two meshes of finite elements."""
    problem: Any = next(problem for problem in (*PROBLEMS, *BODIES) if problem.name == name)
    return solve_rivals(problem._replace(elements=problem.elements[:2]), silent)[0]


def _manufactured(case: Case, limit: float) -> dict[str, Any]:
    """A chosen deformation with the loads that it needs; nobody judges it but its own error."""
    assert isinstance(case.deck, Mapping)
    problem = Manufactured(**case.deck)
    record = solve_manufactured(problem, case.subject, problem.sizes[0], case.overrides)
    record["seconds"] = record.get("seconds", 0.0)
    if "u_error" in record:
        record["error"] = record["u_error"]
    return record


def _restart(case: Case, limit: float) -> dict[str, Any]:
    """A run that goes on: killed behind its third load step, from a state, with other input."""
    assert isinstance(case.deck, Mapping)
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as name:
        folder = Path(name)
        deck, whole, out = folder / "deck.toml", folder / "whole", folder / "out"
        deck.write_text(text_of_tables(case.deck), encoding="utf-8")
        words: list[str | Path] = [find_executable(), deck, "-t", "1", "--no-error"]
        for override in case.overrides:
            words += ["--set", override]
        first = run_command([*words, "-o", whole], limit)
        if case.subject == "from a state":
            state = f"{whole / 'results.vtkhdf'}:3"
            again = [*words, "-o", out, "--start-from", state, "--set", "load.steps=1"]
        else:
            _kill_behind_step_3([*words, "-o", out])
            again = [*words, "-o", out, "--resume"]
        if case.subject == "another deck":
            again += ["--set", "load.steps=7"]
        if case.subject == "cut journal":
            journal = out / "results.journal"
            journal.write_bytes(journal.read_bytes()[: journal.stat().st_size // 2])
        ending = run_command(again, limit)
        record: dict[str, Any] = ending._asdict()
        if first.outcome == ending.outcome == "done":
            ours, right = (_last_probes(place / "summary.json") for place in (out, whole))
            record["error"] = max(abs(ours[name] / right[name] - 1.0) for name in right)
    return record


def _kill_behind_step_3(words: Sequence[str | Path]) -> None:
    child = subprocess.Popen(
        [str(word) for word in words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        encoding="utf-8",
    )
    assert child.stdout is not None
    for line in child.stdout:
        if line.startswith("step   3"):
            child.send_signal(signal.SIGKILL)
            break
    child.communicate()


def _last_probes(path: Path) -> dict[str, float]:
    probes: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))["steps"][-1]["probes"]
    return probes


def _reduced(case: Case, limit: float) -> dict[str, Any]:
    """An answer of a reduced model against the full one at the same values."""
    assert isinstance(case.deck, Mapping)
    text = text_of_tables(case.deck)
    try:
        if case.subject == "train":
            with tempfile.TemporaryDirectory(prefix="myork-bench-") as name:
                _trained(text, Path(name), case.overrides)
        return _answer(_file_of(text, case.subject == "cut"), case, limit)
    except ConvergenceError as error:
        return Ending("not converged", str(error), 0.0)._asdict()
    except MyorkError as error:
        return Ending("refused", str(error), 0.0)._asdict()


def _answer(file: Path, case: Case, limit: float) -> dict[str, Any]:
    assert isinstance(case.deck, Mapping)
    values = dict(word.split("=") for word in case.overrides)
    state = ReducedModel.load(file, threads=1).state(
        {key: float(value) for key, value in values.items()}
    )
    reasons = []
    if not state.converged:
        reasons.append("no state was found for these values")
    if not state.inside:
        reasons.append("outside the range of the training")
    if state.converged and not state.indicator <= _DOUBTFUL:
        reasons.append(f"the estimated error of the displacement is {state.indicator:.2g}")
    full = solve_case(case.deck, case.overrides, limit=limit)
    record = {
        "outcome": "converged",
        "message": "",
        "seconds": full["seconds"],
        "verdict": {"state": "doubtful" if reasons else "accepted", "reasons": reasons},
    }
    if not state.converged or full["outcome"] != "converged":
        return record
    errors = [
        abs(state.probes[name] / full["probes"][name] - 1.0)
        for name in state.probes
        if name in full["probes"]
    ]
    return record | {"error": max(errors)}


@cache
def _file_of(text: str, cut: bool) -> Path:
    """The trained model of a deck, whole or only its first half."""
    if cut:
        whole = _file_of(text, False)
        part = whole.with_name("cut.rom.h5")
        part.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
        return part
    return _trained(text, Path(_FOLDER.name), ())


def _trained(text: str, folder: Path, overrides: tuple[str, ...]) -> Path:
    deck = folder / "deck.toml"
    deck.write_text(text, encoding="utf-8")
    model = ReducedModel.train(
        deck, _RANGE, overrides=overrides, full_solves=10, tests=0, threads=1, seed=1
    )
    return model.save(folder / "model.rom.h5")


#: Of trained models, as long as the process lasts
_FOLDER = tempfile.TemporaryDirectory(prefix="myork-bench-")


def _damaged_image(case: Case, limit: float) -> dict[str, Any]:
    """One station of the pipeline on a damaged image; it has no value to be right about."""
    assert isinstance(case.deck, Mapping)
    if case.station == "build":
        data = np.zeros((12, 12, 8), np.float32 if case.subject == "nan" else np.int16)
        if case.subject != "empty":
            data[2:10, 2:10, :] = 1
    else:
        data = np.random.default_rng(1).uniform(100.0, 110.0, (12, 12, 8)).astype(np.float32)
        data[4:8, 4:8, :] -= 60.0
    if case.subject == "nan":
        data[5, 5, 4] = np.nan
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as name:
        folder = Path(name)
        _write_image(folder / "image.nii.gz", data, singular=case.subject == "affine")
        deck = folder / "deck.toml"
        deck.write_text(text_of_tables(case.deck), encoding="utf-8")
        words = ["-m", "myork", case.station, str(deck), "--out", str(folder / "out"), "-q"]
        return run_command([sys.executable, *words], limit)._asdict()


def _write_image(path: Path, data: Any, singular: bool) -> None:
    """Write an image; nibabel itself refuses to write a singular affine, so it is patched in."""
    import nibabel

    image = nibabel.Nifti1Image(data, np.diag([2.0, 2.0, 3.0, 1.0]))
    if singular:
        header = image.header
        header["sform_code"], header["qform_code"] = 1, 0
        header["srow_x"], header["srow_y"] = (2, 0, 0, 0), (2, 0, 0, 0)
        header["srow_z"] = (0, 0, 3, 0)
        image = nibabel.Nifti1Image(data, None, header)
    nibabel.save(image, path)


_STATIONS: Mapping[str, Callable[[Case, float], dict[str, Any]]] = {
    "build": _damaged_image,
    "segment": _damaged_image,
    "manufactured": _manufactured,
    "restart": _restart,
    "reduced": _reduced,
}
