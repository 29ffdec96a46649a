"""Muscle, fat and bone of a phantom calf by level sets, the shading of the coil divided out."""

import sys

import matplotlib.pyplot as plt

from myork.core.deck import table_defaults
from myork.imaging.phantom import make_phantom
from myork.segmentation.images import Images, segment_images

calf = make_phantom((64, 64, 5), (1.9, 1.9, 6.0), septum=0.5, growth=15)
table = {**table_defaults("image"), "regions": 3}
found = segment_images(Images(calf.anatomy), table, bias="auto")
for line in found.warnings:
    print(line)
pictures = {
    "image": calf.anatomy.data,
    "without shading": found.images.anatomy.data,
    "regions": found.labels.data,
}
figure, axes = plt.subplots(1, 3, figsize=(9, 3.3))
for place, (name, data) in zip(axes, pictures.items(), strict=True):
    place.imshow(data[:, :, 2].T, origin="lower", cmap="viridis" if name == "regions" else "gray")
    place.set_title(name)
    place.axis("off")
print(f"{(found.labels.data > 0).sum()} voxels in {found.labels.data.max()} regions")
figure.tight_layout()
figure.savefig(sys.argv[1], dpi=100)
