"""How far the force of a muscle depends on the boundary that was drawn around it."""

import sys
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import nibabel
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.special import ndtr

from myork import build, run_deck

SHIFT, NOISE, LENGTH = 0.5, 0.3, 10.0  # global shift, noise along boundary, its length scale [mm]
MUSCLE = {
    "build": {"source_stride": [3, 3, 3]}, "scene": {"dimension": 3}, "geometry": {"kind": "model"},
    "material": [{"name": "m", "model": "muscle", "A10": 2.6, "K": 5000, "fiber": [0, 0, 1]}],
    "boundary": [{"set": end, "u_x": 0, "u_y": 0, "u_z": 0} for end in ("bottom", "top")],
    "load": {"activation": 0.2}, "probe": [{"name": "force", "quantity": "force_z", "set": "top"}],
}  # fmt: skip
rng = np.random.default_rng(0)
x, y, z = np.meshgrid(*(np.arange(n) + 0.5 for n in (22, 22, 24)), indexing="ij")
drawn = np.hypot(x - 11, y - 11) < 5 + 2 * np.sin(np.pi * z / 24)  # voxels of 1 mm
depth = distance_transform_edt(drawn) - distance_transform_edt(~drawn) + 0.5 - drawn
muscle, found = drawn, []
with TemporaryDirectory() as folder:
    MUSCLE["build"]["labels"] = file = f"{folder}/labels.nii.gz"
    for _ in range(9):
        nibabel.save(nibabel.Nifti1Image(muscle.astype(np.int16), np.eye(4)), file)
        build(MUSCLE, folder)
        steps = run_deck(MUSCLE, folder, error=False)["steps"]
        found.append((muscle.sum() / 1000, steps[-1]["probes"]["force"]))
        noises = [gaussian_filter(rng.standard_normal(x.shape), wide) for wide in (LENGTH / 2, 1)]
        smooth, part = (noise / noise.std() for noise in noises)
        # a shift by part of a voxel flips that share of voxels, in random patches
        muscle = depth + SHIFT * rng.standard_normal() + NOISE * smooth + ndtr(part) - 0.5 > 0
print("forces [N], the first as drawn:", *(f"{force:.2f}" for _, force in found))
plt.plot(*np.transpose(found[1:]), "o", *found[0], "k*", ms=9)
plt.gca().set(xlabel="volume [cm$^3$]", ylabel="force [N]", title="star: as drawn")
plt.savefig(sys.argv[1], dpi=100)
