"""Whether a change of the code changed an answer: hashes of the results of small runs of all decks.

    python tests/yardstick.py write before.json          # before the change
    python tests/yardstick.py write after.json           # after it
    python tests/yardstick.py compare before.json after.json

Each case runs on one thread: labels and fibers, the model, unknowns and fields of all converged
states, the summary with probes and errors of reduced models. Times, memory, versions and paths are
left out. Equal hashes mean equal bits. Sums run in a fixed order, so that a change that only moves
code keeps them. Hashes are valid for one machine and one set of libraries, which is why no table
of them is stored with the sources; the probes beside them show how far two tables differ.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"  # read once, when numpy and the core are loaded

import hashlib  # noqa: E402
import json  # noqa: E402
import re  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
from contextlib import suppress  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import h5py  # noqa: E402
import nibabel  # noqa: E402
import numpy as np  # noqa: E402

import myork  # noqa: E402
from myork.errors import RefusedError  # noqa: E402

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from tests.scenes import BODIES  # noqa: E402

REFERENCES = Path(__file__).parent / "references"
STATIONS = {
    "segment": myork.segment, "build": myork.build, "rom": myork.run_rom, "solve": myork.run_deck,
}  # fmt: skip
_LEG = (
    "phantom.size=[48,48,7]", "phantom.spacing=[2.5,2.5,6]", "build.collocation_stride=[3,3,1]",
    "build.source_stride=[3,3,1]", "load.steps=1", "load.activation=0.2",
)  # fmt: skip
_VOXELS = ("build.collocation_stride=[4,4,1]", "build.source_stride=[8,8,2]", "load.steps=2")
#: A block with the method, weights and curve of the reference, which its deck does not name
_BLOCK = (
    "geometry.source=[5,5,9]", "geometry.collocation=[9,9,17]", "scene.method=rkcm",
    "solver.weight_essential=ns-c4", "solver.weight_traction=1", "material.curve=published",
    "load.steps=4", "load.activation=0.2", "rom.modes=[1,2]",
)  # fmt: skip
#: Stations, deck and overrides of each case
CASES = {
    **{f"regression-{path.stem}": ("solve", path.stem, json.loads(path.read_text())["overrides"])
       for path in sorted(REFERENCES.glob("*.json"))},
    **{name: ("solve", *case) for name, case in BODIES.items()},
    "mg_muscle": ("segment build solve", "mg_muscle", (*_VOXELS, "load.activation=0.05")),
    "leg_section": ("segment build solve", "leg_section", _LEG),
    "leg_muscles": ("segment", "leg_muscles", ()),
    "rom": ("rom", "muscle_block", _BLOCK),
}  # fmt: skip
#: Names of entries of summary.json that differ between two equal runs
VOLATILE = r"memory_peak_bytes|version|seconds.*|deck_sha256|speedup.*|.*_s(_per_state)?"


def main(command: str, *tables: str) -> int:
    """Write a table of hashes, or compare two; 1 where they differ."""
    if command == "compare":
        before, after = (json.loads(Path(table).read_text()) for table in tables)
        said = [
            f"{name}, {part}: {old} -> {new}"
            for name in sorted({*before, *after})
            for part in sorted({*before.get(name, {}), *after.get(name, {})})
            for old, new in [[side.get(name, {}).get(part) for side in (before, after)]]
            if old != new
        ]
        print("\n".join([*said, f"{len(said)} differences"]))
        return int(bool(said))
    table = {}
    for name, (stations, deck, overrides) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            for station in stations.split():
                more = {"verbosity": -1, "error": False} if station == "solve" else {}
                words = ROOT / "inputs" / f"{deck}.toml", folder
                # small runs may be refused, but their numbers still count
                with suppress(RefusedError):
                    STATIONS[station](*words, overrides=overrides, threads=1, **more)
            table[name] = _parts(Path(folder))
        print(name, flush=True)
    Path(tables[0]).write_text(json.dumps(table, indent=1, sort_keys=True) + "\n")
    return 0


def _parts(out: Path) -> dict[str, Any]:
    """Hashes of the content of a folder, and the last probes."""
    found: dict[str, Any] = {}

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            values = np.asarray(item[()])
            found[name] = _hash(values.tolist() if values.dtype == object else values)

    for path in (*out.glob("*.h5"), *out.glob("*.vtkhdf")):
        with h5py.File(path) as file:
            file.visititems(note)
    for path in out.glob("*.nii.gz"):
        found[path.name] = _hash(np.asarray(nibabel.load(path).dataobj))
    text = (out / "summary.json").read_text(encoding="utf-8").replace(str(out), "")
    # without entries that differ in every run
    summary = json.loads(text, object_hook=lambda part: {
        key: value for key, value in part.items() if not re.fullmatch(VOLATILE, key)
    })  # fmt: skip
    probes = [step["probes"] for step in summary.get("steps", [])][-1:]
    return found | {key: _hash(part) for key, part in summary.items()} | {"probes": probes}


def _hash(value: Any) -> str:
    """First digits of the SHA-256 of an array, or of anything that JSON can hold."""
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value).tobytes()
    else:
        data = json.dumps(value, sort_keys=True, default=repr).encode()
    return hashlib.sha256(data).hexdigest()[:16]


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
