"""Run a deck through the executable `myork-solve`, in a separate process.

A separate process loses no results when the session that started it dies, and keeps the system's
HDF5 apart from the one inside h5py.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork.console import ProgressCallback, silent
from myork.core.calls import interrupts_held
from myork.core.cloud import model_path
from myork.core.deck import checked_overrides, load_deck, text_of_tables
from myork.errors import (
    ConvergenceError,
    InputError,
    InstallationError,
    MyorkError,
    RefusedError,
    StoppedError,
    cure_of,
)
from myork.files import alone_in, write_text
from myork.model_file import read_model
from myork.summary import ASKED, asked, readable_summary, update_summary

#: Tables of a deck that act on images, before the model that a solve reads is made
BEFORE = ("image", "phantom", "dixon", "bias", "muscle", "tissue", "build")
_NAME = "myork-solve"
#: Exit status of a program that the system's loader cannot start
_DOES_NOT_LOAD = 127
# A computed force that differs from the estimate by more than this factor gives a warning.
_FACTOR = 3.0


def find_executable() -> Path:
    """Find `myork-solve`: in the prefix of the package, beside the Python in use, on the PATH.

    - returns the executable
    - raises InstallationError: if it is in none of these places
    """
    # prefix/lib*/python3*/{site,dist}-packages/myork/stations, Debian: prefix/local/lib/...
    folders = [prefix / "bin" for prefix in Path(__file__).resolve().parents[5:7]]
    for folder in (*folders, Path(sys.executable).parent):
        path = folder / _NAME
        if path.is_file() and os.access(path, os.X_OK):
            return path
    on_path = shutil.which(_NAME)
    if on_path is None:
        raise InstallationError(
            f"the executable {_NAME} is missing: it is neither in the prefix of the package "
            f"({Path(__file__).parents[1]}), nor beside {sys.executable}, nor on the PATH; "
            "install again (sh setup.sh, or pip install .)"
        )
    return Path(on_path)


def run_deck(
    deck: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
    verbosity: int = 0,
    error: bool = True,
    resume: bool = False,
    start: str | Path | None = None,
) -> dict[str, Any]:
    """Solve the full model of a deck.

    Ctrl-C (and SIGTERM) is passed to the executable, which stops after the current iteration with
    the last converged state written; a second one stops it at once.

    - `deck`: deck file, or its tables as data, which are written to `deck.toml` in the folder
    - `overrides`: overrides of the deck, `"table.key=value"`
    - `verbosity`: -1 no progress, 0 one line per load step, 1 one line per iteration
    - `error`: compute a second solution, which gives the probes their error bars
    - `resume`: continue from the last complete load step of an earlier run of this deck in the
      folder. Without such a run it begins at rest.
    - `start`: state from which the iteration begins instead of the state at rest: a result file,
      `"FILE"` for its last step or `"FILE:STEP"`, of the same points and approximation
    - returns content of `summary.json` in the folder
    - raises ConvergenceError: the run stopped without convergence; the last converged state is in
      the folder
    - raises RefusedError: its own checks refuse the answer, which is in the folder with the
      reasons
    - raises StoppedError: it was stopped
    - raises InputError: deck or model are wrong
    - raises InstallationError: the executable is missing or broken
    """
    if isinstance(deck, Mapping):
        text, deck = text_of_tables(deck), Path(out, "deck.toml")
        deck.parent.mkdir(parents=True, exist_ok=True)
        write_text(deck, text)
    try:
        values = load_deck(deck, overrides, "solve")
    except MyorkError:
        values = None  # the executable reports it
    if values is not None:
        with asked(Path(out)):
            refuse_other_model(values, Path(out), overrides)
    options = ["-o", str(out)]
    if threads is not None:
        options += ["-t", str(threads)]
    if verbosity:
        options.append("-q" if verbosity < 0 else "-v")
    if not error:
        options.append("--no-error")
    if resume:
        options.append("--resume")
    if start is not None:
        options += ["--start-from", str(start)]
    try:
        run_executable(deck, [*options, *set_options(overrides)], progress)
    except ConvergenceError as ended:
        # both have exit status 1
        if readable_summary(Path(out)).get("converged"):
            raise RefusedError(str(ended)) from None
        raise
    summary = readable_summary(Path(out))
    if "steps" not in summary:
        raise InstallationError(
            f"{_NAME} reported success but left no summary.json in {out}; does another program "
            "remove files there?"
        )
    return _with_estimate(summary, Path(out), progress)


def refuse_other_model(values: Mapping[str, Any], out: Path, overrides: Sequence[str]) -> None:
    """Refuse a model that was built from other files, or by other overrides, than are given now.

    - `values`: effective deck
    - `out`: folder in which its model is looked for first
    """
    try:
        path = model_path(values, Path(values["folder"]), out)
        cloud = read_model(path) if path else None
    except MyorkError:
        return  # whoever reads the points reports it
    if path is None or cloud is None:
        return
    lines = cloud.source_images.splitlines()
    # images are read with large packages, which other decks do not need
    from myork.stations.build import check_sum

    built_from, checked = {line.rpartition(" ")[0] for line in lines}, set()
    for key in ("labels", "fibers", "fractions", "activation", "surface"):
        if not (name := values["build"].get(key)):
            continue
        file = Path(values["folder"], name)
        if not (file.is_file() and file.name in built_from):
            continue
        checked.add(f"build.{key}")
        if f"{file.name} {check_sum(file)}" not in lines:
            raise InputError(
                f"{values['path']}: build.{key}: {file} is not the file that {path} was built "
                f"from: run `myork build` again, or give that file by --set build.{key}=PATH"
            )
    if cloud.voxels is not None:
        # a solve asks whether the spacing of the model was chosen
        stride = np.rint(cloud.spacing.min(axis=0) / cloud.voxels.size)
        if np.array_equal(stride, values["build"]["source_stride"]):
            checked.add("build.source_stride")
    parts = readable_summary(path.parent).values()
    acted = [word for part in parts if isinstance(part, dict) for word in part.get(ASKED, ())]
    for word in overrides:
        key = word.partition("=")[0].strip()
        if key.partition(".")[0] in BEFORE and key not in checked and word not in acted:
            raise InputError(
                f"--set {word}: acts before {path} is made, which was built without it: give it "
                "to `myork build` (and `myork segment`), or to `myork run`"
            )


def _with_estimate(
    summary: dict[str, Any], out: Path, progress: ProgressCallback
) -> dict[str, Any]:
    """The summary, also written to the folder, with the force from the PCSA where known."""
    estimate = pcsa_force(summary)
    if estimate is None:
        return summary
    entry, warning = estimate
    unit = summary["units"]["force"]
    progress(f"activation x PCSA x sigma_max: {entry['value']:.4g} {unit} ({entry['probe']}: "
             f"{entry['ratio']:.2g} times)")  # fmt: skip
    if warning:
        progress(f"warning: {warning}")
    warnings = [*summary.get("warnings", []), *([warning] if warning else [])]
    with alone_in(out):
        update_summary(out, {"pcsa_force": entry, "warnings": warnings})
    return {**summary, "pcsa_force": entry, "warnings": warnings}


def set_options(overrides: Sequence[str]) -> list[str]:
    """Overrides as options of the executable."""
    return [word for override in checked_overrides(overrides) for word in ("--set", override)]


def run_executable(deck: str | Path, options: Sequence[str], progress: ProgressCallback) -> None:
    """Run the executable, pass on its lines, convert its exit status to an exception."""
    # The child ends with this process, however this process ends.
    environment = {"OMP_WAIT_POLICY": "passive", **os.environ, "MYORK_PARENT": str(os.getpid())}
    executable = find_executable()
    with tempfile.TemporaryFile() as complaints:
        try:
            # A separate session: Ctrl-C reaches the child once, from here, not twice.
            child = subprocess.Popen(
                [executable, str(deck), *options],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=complaints,
                encoding="utf-8",
                errors="replace",
                env=environment,
                start_new_session=True,
            )
        except OSError as error:
            raise InstallationError(f"{executable} does not start: {error}") from error
        stopped = False

        def hand_over(count: int) -> None:
            # not SIGINT: a background process of a shell inherits that it is ignored
            child.kill() if count > 1 else child.send_signal(signal.SIGTERM)

        try:
            with interrupts_held(hand_over, all_handlers=True) as signals:
                assert child.stdout is not None
                for line in child.stdout:
                    progress(line.rstrip("\n"))
                status = child.wait()
                stopped = bool(signals)
        finally:
            if child.poll() is None:
                child.kill()
                child.wait()
        complaints.seek(0)
        message = complaints.read().decode("utf-8", "replace").strip()
    _check_status(status, message, stopped, progress)


def _check_status(status: int, message: str, stopped: bool, progress: ProgressCallback) -> None:
    """Convert an exit status to an exception; warnings of a good run are passed to progress."""
    if status == 0:
        if message:
            progress(message)
        return
    if stopped:
        raise StoppedError(message or "stopped; the last converged state is written")
    if status == 1:
        raise ConvergenceError(message or "the run ended without convergence")
    if status == 2:
        raise InputError(message or "the input was refused")
    if status == -signal.SIGKILL:
        raise MyorkError(f"{_NAME} was killed: out of memory? (myork explain) {message}")
    if status == _DOES_NOT_LOAD:
        raise InstallationError(f"{_NAME} does not start: {message}; {cure_of(message)}")
    ending = f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
    raise InstallationError(f"{_NAME} ended with {ending}: {message}")


def pcsa_force(summary: Mapping[str, Any]) -> tuple[dict[str, Any], str] | None:
    """Final activation times PCSA times `sigma_max`, summed over the muscles of a model.

    It is the force of fibers at their optimal length, without the passive force.

    - `summary`: content of `summary.json` after a solve
    - returns entry `pcsa_force` of the summary: `value` in the deck's unit of force, the `probe` of
      the largest force on a set and the `ratio` of both; a warning where they differ by a factor of
      three, otherwise an empty text. None without activation, without a single muscle material,
      without the PCSA of all active muscles, or without a force probe.
    """
    deck, steps = summary.get("deck", {}), summary.get("steps") or [{}]
    materials = [own for own in deck.get("material", []) if own.get("model") == "muscle"]
    rows = (summary.get("model") or {}).get("muscles", [])
    if deck.get("geometry", {}).get("kind") != "model" or len(materials) != 1:
        return None
    activation = materials[0].get("activation", steps[-1].get("activation", 0.0))
    areas = [value for row in rows for head, value in row.items() if head.startswith("PCSA")]
    areas = [value for value in areas if value is not None]
    whole = len(areas) == 1 or len(areas) == len(rows)
    forces = {
        probe["name"]: float(np.linalg.norm(steps[-1].get("probes", {}).get(probe["name"]) or 0.0))
        for probe in deck.get("probe", [])
        if str(probe.get("quantity")).split("_")[0] == "force" and probe.get("set")
    }
    if not (areas and whole and any(forces.values()) and isinstance(activation, int | float)):
        return None
    value = float(activation * sum(areas) * materials[0]["sigma_max"])
    if not value > 0.0:
        return None
    probe = max(forces, key=lambda name: forces[name])
    ratio = forces[probe] / value
    warning = ""
    if not 1.0 / _FACTOR <= ratio <= _FACTOR:
        warning = (
            f"probe {probe} is {ratio:.2g} times activation x PCSA x sigma_max = {value:.4g} "
            f"{summary.get('units', {}).get('force', '')}: look at fibers, attachments and unit of "
            "sigma_max"
        )
    return {"value": value, "probe": probe, "ratio": ratio}, warning
