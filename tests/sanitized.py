"""Decks and damaged models through a `myork-solve` with sanitizers: `.ci/sanitize` calls this."""

import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from myork.bench.runs import INPUTS
from myork.bench.studies.faults import SEED
from myork.core.deck import text_of_tables
from myork.reference.faults_decks import deck_fault
from myork.reference.faults_models import MODEL_DECK, model_fault

#: Decks that are solved, made small
SMALL = ("geometry.source=[5,5]", "geometry.collocation=[9,9]", "load.steps=1")
FLAT = ("shear_2d", "poisson_2d", "cantilever")
FORMS = ("rkcm", "rkcm-mixed", "rkpm-scni", "rkpm-gauss")


def ends(executable: Path, folder: Path):
    """Name, exit status and message of each run."""

    def run(*words):
        done = subprocess.run(
            [executable, *words], capture_output=True, text=True, errors="replace", timeout=300
        )
        return done.returncode, done.stderr

    out = ["-o", folder / "out", "-t", "1", "-q"]
    small = [word for change in SMALL for word in ("--set", change)]
    for deck in FLAT:
        yield deck, *run(INPUTS / f"{deck}.toml", *out, *small)
    for method in FORMS:
        for deck in ("shear_2d", "uniaxial_tension"):
            change = small if deck == "shear_2d" else ["--set", "load.steps=1"]
            words = [INPUTS / f"{deck}.toml", *out, *change, "--set", f"scene.method={method}"]
            yield f"{deck} {method}", *run(*words)
    for number in range(9):
        name, content = deck_fault(SEED, number, INPUTS)
        (folder / "deck.toml").write_bytes(content)
        yield name, *run(folder / "deck.toml", "--explain")
    (folder / "deck.toml").write_text(text_of_tables(MODEL_DECK), encoding="utf-8")
    for number in range(500):
        name = model_fault(SEED, number, folder / "model.h5")
        yield name, *run(folder / "deck.toml", "--explain", "-o", folder)


def main() -> int:
    """Run all; 1 where a sanitizer has found something or a run ended by a signal."""
    statuses, bad = Counter(), 0
    with tempfile.TemporaryDirectory() as folder:
        for name, status, said in ends(Path(sys.argv[1]).resolve(), Path(folder)):
            statuses[status] += 1
            if (
                status not in (0, 1, 2)
                or "ERROR: AddressSanitizer" in said
                or "runtime error" in said
            ):
                bad += 1
                print(f"{name}: {status}\n{said[:4000]}")
    print(f"exit statuses {dict(statuses)}, {bad} findings")
    return bad > 0


if __name__ == "__main__":
    sys.exit(main())
