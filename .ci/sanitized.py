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
from tests.scenes import BODIES
from tests.unit.test_scene_from_tables import BLOCK, cloud


def ends(executable: Path, folder: Path):
    """Name, exit status and message of each run, and whether it must not be refused."""

    def run(*words):
        done = subprocess.run(
            [executable, *words], capture_output=True, text=True, errors="replace", timeout=300
        )
        return done.returncode, done.stderr

    for deck, changes in BODIES.values():
        words = [word for change in changes for word in ("--set", change)]
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
