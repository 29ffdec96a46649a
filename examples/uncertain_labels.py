"""How far the force of a muscle depends on the boundary that was drawn around it."""

import csv
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import nibabel
import numpy as np

from myork.studies.uncertainty import Doubt, uncertainty

DECK = Path(__file__).parent / "data" / "muscle.toml"

x, y, z = np.meshgrid(*(np.arange(n) + 0.5 for n in (18, 18, 24)), indexing="ij")
labels = np.hypot(x - 9, y - 9) < 5 + 2 * np.sin(np.pi * z / 24)
with TemporaryDirectory() as folder:
    file = Path(folder, "labels.nii.gz")  # voxels of 1 mm
    nibabel.save(nibabel.Nifti1Image(labels.astype(np.int16), np.eye(4)), file)
    found = uncertainty(
        DECK, folder, doubt=Doubt(shift=0.5, noise=0.3), samples=8, fixed=[f"build.labels={file}"]
    )
    with Path(folder, "uncertainty.csv").open() as file:
        rows = list(csv.DictReader(file))
print(f"force {found['mean']:.2f} N, standard deviation {found['standard_deviation']:.2f} N")
print(f"explained by the volume: {found['explained_by_volume']:.0%}")
plt.plot(*([float(row[key]) for row in rows[1:]] for key in ("volume", "value")), "o")
plt.plot(float(rows[0]["volume"]), float(rows[0]["value"]), "k*", ms=14, label="as drawn")
plt.xlabel("volume of the muscle [cm$^3$]")
plt.ylabel("force [N]")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
