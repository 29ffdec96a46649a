"""A single slice extruded to a prism."""

from dataclasses import replace

import numpy as np

from myork.errors import InputError
from myork.imaging.geometry import Grid, canonical


def extruded(image: Grid, length: float) -> Grid:
    """A single slice extruded to a prism of slices about as thick as its pixels are wide.

    - `image`: one slice across the axis nearest to superior, however thick
    - `length`: length of the prism, centred on the slice [mm]
    """
    slice_ = canonical(image)
    if slice_.data.shape[2] != 1:
        raise InputError(
            f"{image.name}: build.extrude makes a prism of a single slice across the axis nearest "
            f"to superior, and this image has {slice_.data.shape[2]} of them; leave it out"
        )
    count = max(2, round(length / float(slice_.spacing[:2].max())))
    affine = slice_.affine.copy()
    affine[:3, 2] *= length / (count * slice_.spacing[2])
    affine[:3, 3] -= 0.5 * (count - 1) * affine[:3, 2]
    return replace(slice_, data=np.repeat(slice_.data, count, axis=2), affine=affine)
