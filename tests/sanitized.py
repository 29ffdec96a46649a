"""Small decks and damaged models through a `myork-solve` with sanitizers, for `.ci/sanitize`."""

import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from myork.core.deck import text_of_tables
from myork.files import INPUTS
from myork.model_file import write_model
from tests.faults.damage import ARRAY, BYTES, SETTINGS, Edit, damaged
from tests.unit.test_scene_from_tables import BLOCK, cloud

#: Small lattices by the number of dimensions
SMALL = {
    1: ("geometry.source=[9]", "geometry.collocation=[17]"),
    2: ("geometry.source=[6,5]", "geometry.collocation=[11,9]"),
    3: ("geometry.source=[4,4,5]", "geometry.collocation=[7,7,9]"),
}
_LOW = ("approximation.order=1", "approximation.support=2")
_TUBE = ("geometry.source=[5,12]", "geometry.collocation=[9,24]", "approximation.support=3")

#: Decks that are solved, with their dimensions and changes: no two are alike
SOLVED = (
    ("poisson_1d", 1, ("scene.method=rkcm",)),
    ("poisson_2d", 2, ("scene.method=rkcm",)),
    ("poisson_3d", 3, ("scene.method=rkpm-gauss", *_LOW)),
    ("cantilever", 2, ("scene.method=rkpm-gauss", *_LOW)),
    ("shear_2d", 2, ("scene.method=rkcm",)),
    ("shear_2d", 2, ("scene.method=rkcm-mixed", "solver.linear=spqr")),
    ("shear_2d", 2, ("scene.method=rkpm-gauss",)),
    ("shear_2d", 2, ("scene.method=rkpm-scni", *_LOW)),
    ("shear_3d", 3, ("scene.method=rkcm", "solver.linear=normal")),
    ("shear_3d", 3, ("scene.method=rkpm-gauss", *_LOW)),
    ("uniaxial_tension", 3, ("scene.method=rkcm", "solver.linear=dgels")),
    ("uniaxial_compression", 3, ("scene.method=rkcm-mixed", "load.steps=2")),
    ("uniaxial_compression", 3, ("scene.method=rkpm-gauss", "material.K=inf", *_LOW)),
    ("equibiaxial", 3, ("scene.method=rkcm", "solver.linear=dgelsy")),
    ("dilation", 3, ("scene.method=rkpm-scni", "galerkin.direct_limit=0", *_LOW)),
    ("tube", 2, ("scene.method=rkcm", *_TUBE)),
    ("tube", 2, ("scene.method=rkcm-mixed", *_TUBE)),
    ("muscle_block", 3, ("scene.method=rkcm", "load.activation=0.01",
                         "solver.linear=sparse-normal")),
    ("muscle_fibers", 3, ("scene.method=rkcm-mixed", "load.activation=0.01", "load.steps=1",
                          "approximation.order=2", "approximation.support=3")),
    ("muscle_fibers", 3, ("scene.method=rkpm-scni", "load.activation=0.01", *_LOW)),
)  # fmt: skip


def ends(executable: Path, folder: Path):
    """Name, exit status and message of each run, and whether it must not be refused."""

    def run(*words):
        done = subprocess.run(
            [executable, *words], capture_output=True, text=True, errors="replace", timeout=300
        )
        return done.returncode, done.stderr

    for deck, dimension, changes in SOLVED:
        steps = () if deck.startswith(("poisson", "cantilever")) else ("load.steps=1",)
        # what is named later holds
        words = [w for change in (*SMALL[dimension], *steps, *changes) for w in ("--set", change)]
        out = ["-o", folder / "out", "-t", "1", "-q"]
        name = f"{deck} {' '.join(changes)}"
        yield name, *run(INPUTS / f"{deck}.toml", *out, *words), True
    (folder / "deck.toml").write_text(text_of_tables(BLOCK), encoding="utf-8")
    write_model(folder / "model.h5", cloud())
    content = (folder / "model.h5").read_bytes()
    found: dict[str, bytes] = {}

    @settings(SETTINGS, max_examples=500)
    @given(st.lists(BYTES | ARRAY | ARRAY, min_size=1, max_size=3))
    def damage(edits: list[Edit]) -> None:
        found[str(edits)] = damaged(content, edits)

    damage()
    for name, changed in found.items():
        (folder / "model.h5").write_bytes(changed)
        yield name, *run(folder / "deck.toml", "--explain", "-o", folder), False


def main() -> int:
    """Run all; 1 where a sanitizer has found something or a run ended by a signal."""
    statuses, bad = Counter(), 0
    with tempfile.TemporaryDirectory() as folder:
        for name, status, said, solved in ends(Path(sys.argv[1]).resolve(), Path(folder)):
            statuses["solved" if solved else "models", status] += 1
            if (
                status not in ((0, 1) if solved else (0, 1, 2))
                or "ERROR: AddressSanitizer" in said
                or "runtime error" in said
            ):
                bad += 1
                print(f"{name}: {status}\n{said[:4000]}")
    for (kind, status), number in sorted(statuses.items()):
        print(f"{kind}: {number} ended with {status}")
    print(f"{bad} findings")
    return bad > 0


if __name__ == "__main__":
    sys.exit(main())
