"""Whether a change of the code changed an answer: hashes of what small runs of all decks give.

    python tests/yardstick.py write before.json          # before the change
    python tests/yardstick.py write after.json           # after it
    python tests/yardstick.py compare before.json after.json

Each case runs on one thread: unknowns of all converged states in memory, fields of the results
file, probes and summary of the executable, labels of a segmentation, errors of reduced models.
Times, memory, versions and paths are left out. Equal hashes are equal bits; sums run in a fixed
order, so a change that only moves code keeps them. Hashes hold on one machine with one set of
libraries only, which is why no table of them is kept with the sources; the probes beside them say
how far two tables are apart.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"  # read once, when numpy and the core are loaded

import argparse  # noqa: E402
import hashlib  # noqa: E402
import json  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
import time  # noqa: E402
from collections.abc import Iterator  # noqa: E402
from contextlib import suppress  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import h5py  # noqa: E402
import numpy as np  # noqa: E402

import myork  # noqa: E402
from myork.errors import RefusedError  # noqa: E402

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from tests.scenes import BODIES  # noqa: E402

INPUTS = ROOT / "inputs"
REFERENCES = Path(__file__).parent / "regression" / "references"

#: A block by the method, weights and curve of the reference, which its deck does not name
_BLOCK = (
    "geometry.source=[5,5,9]", "geometry.collocation=[9,9,17]", "scene.method=rkcm",
    "solver.weight_essential=ns-c4", "solver.weight_traction=1", "material.curve=published",
)  # fmt: skip
_VOXELS = ("build.collocation_stride=[4,4,1]", "build.source_stride=[8,8,2]", "load.steps=2")
_LEG = (
    "phantom.size=[48,48,7]", "phantom.spacing=[2.5,2.5,6]", "build.collocation_stride=[3,3,1]",
    "build.source_stride=[3,3,1]", "load.steps=1", "load.activation=0.2",
)  # fmt: skip

#: Runs from images: deck, overrides
IMAGES = {
    "mg_muscle": ("mg_muscle", (*_VOXELS, "load.activation=0.05")),
    "leg_section": ("leg_section", _LEG),
}
#: Entries of summary.json that differ between two equal runs
VOLATILE = {"timings_s", "memory_peak_bytes", "version", "cpu_s", "seconds", "deck_sha256"}


def main() -> int:
    """Write a table of hashes, or compare two."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    write = commands.add_parser("write", help="run all cases and write their hashes")
    write.add_argument("table", type=Path)
    write.add_argument("--only", metavar="NAME", help="cases with this in their names")
    compare = commands.add_parser("compare", help="list what differs between two tables")
    compare.add_argument("before", type=Path)
    compare.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.command == "compare":
        return _compare(*(json.loads(p.read_text()) for p in (options.before, options.after)))
    table = {}
    for name, run in _runs():
        if options.only is not None and options.only not in name:
            continue
        started = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            table[name] = run(Path(folder))
        print(f"{name:24s} {time.perf_counter() - started:6.1f} s", flush=True)
    options.table.write_text(json.dumps(table, indent=1, sort_keys=True) + "\n")
    return 0


def _runs() -> Iterator[tuple[str, Any]]:
    """Name and function of each case."""
    references = {
        f"regression-{path.stem}": (path.stem, json.loads(path.read_text("utf-8"))["overrides"])
        for path in sorted(REFERENCES.glob("*.json"))
    }
    for run, cases in ((_solved, references | BODIES), (_from_images, IMAGES)):
        for name, (deck, overrides) in cases.items():
            path = INPUTS / f"{deck}.toml"
            yield name, lambda out, r=run, d=path, o=overrides: r(d, o, out)
    yield "leg_muscles", _segmented
    yield "rom", _reduced


def _solved(deck: Path, overrides: Any, out: Path) -> dict[str, Any]:
    """Both ways of a solve: in memory and by the executable."""
    with myork.Scene(deck, overrides, out=out, threads=1) as scene:
        states = scene.solve(error=False)
    # small runs may be refused, their numbers count all the same
    with suppress(RefusedError):
        myork.run_deck(deck, out, overrides=overrides, threads=1, verbosity=-1, error=False)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8").replace(str(out), ""))
    parts = {key: _hash(part) for key, part in _without_times(summary).items()}
    probes = {"probes": summary["steps"][-1]["probes"]}
    return {"states": _hash(states.x), **_datasets(out / "results.vtkhdf"), **parts, **probes}


def _from_images(deck: Path, overrides: Any, out: Path) -> dict[str, Any]:
    """Labels and points of a phantom, then the solves of its model."""
    for station in (myork.segment, myork.build):
        station(deck, out, overrides=overrides, threads=1)
    return {"model": _hash(_datasets(out / "model.h5")), **_solved(deck, overrides, out)}


def _segmented(out: Path) -> dict[str, Any]:
    """Labels of the six muscles."""
    import nibabel

    myork.segment(INPUTS / "leg_muscles.toml", out, threads=1)
    files = sorted(out.glob("*.nii.gz"))
    return {path.name: _hash(np.asarray(nibabel.load(path).dataobj)) for path in files}


def _reduced(out: Path) -> dict[str, Any]:
    """Errors of the reduced models of a small block."""
    overrides = [*_BLOCK, "load.steps=4", "load.activation=0.2", "rom.modes=[1,2]"]
    study = myork.run_rom(INPUTS / "muscle_block.toml", out, overrides=overrides, threads=1)
    named = ("e1", "e2", "stress_error", "force_error", "iterations", "probes")
    models = [{name: model[name] for name in named} for model in study["models"]]
    return {"models": _hash(models), "e1": [model["e1"] for model in models]}


def _datasets(path: Path) -> dict[str, str]:
    """Hash of each dataset of an HDF5 file."""
    found = {}

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found[name] = _hash(item[()])

    with h5py.File(path) as file:
        file.visititems(note)
    return found


def _without_times(part: Any) -> Any:
    """A part of a summary without what no two runs share."""
    if isinstance(part, dict):
        return {key: _without_times(value) for key, value in part.items() if key not in VOLATILE}
    if isinstance(part, list):
        return [_without_times(entry) for entry in part]
    return part


def _hash(value: Any) -> str:
    """First digits of the SHA-256 of an array, or of anything that JSON can hold."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        data = np.ascontiguousarray(value).tobytes()
    elif isinstance(value, (np.ndarray, bytes)):
        data = repr(value).encode()
    else:
        data = json.dumps(value, sort_keys=True).encode()
    return hashlib.sha256(data).hexdigest()[:16]


def _compare(before: dict[str, Any], after: dict[str, Any]) -> int:
    """Say what differs; 1 if anything does."""
    differences = 0
    for name in sorted({*before, *after}):
        old, new = before.get(name, {}), after.get(name, {})
        for part in sorted({*old, *new}):
            if old.get(part) != new.get(part):
                differences += 1
                print(f"{name}, {part}: {old.get(part)} -> {new.get(part)}")
    print(f"{differences} differences")
    return int(differences > 0)


if __name__ == "__main__":
    sys.exit(main())
