"""Writes down the errors of the hard cases, by which later ones are judged; run by hand.

    myork bench stability --out out/hard && python benchmarks/hard_cases.py out/hard

A case whose error, or whose J, is off by more than twice what stands in `measured.json` is worse.
Look at the page first: what is written down is taken as known.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

TARGET = Path(__file__).parent / "hard/measured.json"


def main(folder: Path) -> None:
    """Write the errors in the record of a folder."""
    record = json.loads((folder / "bench.json").read_text(encoding="utf-8"))
    known = {
        case["name"]: {
            what: float(f"{case[what]:.2g}") for what in ("error", "stray", "way") if what in case
        }
        for case in record["benches"]["stability"]["cases"]
        if "error" in case
    }
    rows = [f"  {json.dumps(name)}: {json.dumps(values)}" for name, values in known.items()]
    TARGET.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
