"""A sweep over two keys on the workers of a Dask cluster, here one of this machine."""

import csv
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from myork import sweep

DECK = Path(__file__).parents[1] / "inputs" / "muscle_block.toml"
SMALL = ["geometry.source=[5,5,9]", "scene.method=rkpm-gauss"]
STRONGEST = ("20", "30", "40")
VARY = ["load.activation=0.1,0.2", f"material.muscle.sigma_max={','.join(STRONGEST)}"]

if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        # the address of a scheduler, as tcp://host:8786, in place of "local" takes its workers
        table = sweep(DECK, VARY, folder, overrides=SMALL, dask="local", workers=2)
        rows = list(csv.DictReader(table.open()))
    for stress in STRONGEST:
        mine = [row for row in rows if float(row["material.muscle.sigma_max"]) == float(stress)]
        x, y, bar = ([float(row[key]) for row in mine]
                     for key in ("load.activation", "reaction", "reaction_error"))  # fmt: skip
        plt.errorbar(x, y, bar, fmt="o-", capsize=4, label=f"sigma_max = {stress} N/cm^2")
    print(f"{len(rows)} points, {sum(row['verdict'] == 'accepted' for row in rows)} accepted")
    plt.xlabel("activation")
    plt.ylabel("force on the fixed end [N]")
    plt.legend(loc="lower left")
    plt.savefig(sys.argv[1], dpi=100)
