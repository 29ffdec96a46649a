"""A sweep over activation, extended by the values between: force of a block with its error bars."""

import csv
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from myork import sweep

DECK = Path(__file__).parents[1] / "inputs" / "muscle_block.toml"
SMALL = ["geometry.source=[5,5,9]", "scene.method=rkpm-gauss"]

if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        for vary, more in (("0.05,0.15,0.25", False), ("0.1,0.2", True)):
            table = sweep(
                DECK, [f"load.activation={vary}"], folder, overrides=SMALL, extend=more, workers=1
            )
        rows = list(csv.DictReader(table.open()))
    probe = "reaction"
    for call in ("1", "2"):
        mine = [row for row in rows if row["call"] == call]
        x, y, bar = ([float(row[key]) for row in mine]
                     for key in ("load.activation", probe, f"{probe}_error"))  # fmt: skip
        plt.errorbar(x, y, bar, fmt="o", capsize=4, label=f"call {call}")
    print(f"{len(rows)} points, {sum(row['verdict'] == 'accepted' for row in rows)} accepted")
    plt.xlabel("activation")
    plt.ylabel("force on the held end [N]")
    plt.legend()
    plt.savefig(sys.argv[1], dpi=100)
