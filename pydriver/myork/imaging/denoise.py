"""Less noise in diffusion-weighted images, by DIPY.

References
----------
Veraart et al., NeuroImage 142 (2016), doi:10.1016/j.neuroimage.2016.08.016
"""

from __future__ import annotations

from importlib import import_module

import numpy as np

from myork.errors import InputError, InstallationError
from myork.records import Image

__all__ = ["denoised"]

_REACH = 2  # voxels around each one that share its principal components
_LEAST_VOLUMES = 7


def denoised(dwi: Image) -> Image:
    """Images without the principal components that are noise by the Marchenko-Pastur law.

    Parameters
    ----------
    dwi : Image
        Diffusion-weighted images as the scanner gives them, not interpolated, shape
        `(ni, nj, nk, nvolume)`.
    """
    try:
        mppca = import_module("dipy.denoise.localpca").mppca
    except ImportError:
        raise InstallationError(
            "image.denoise = 'mppca' needs DIPY, which is not installed: "
            "pip install 'myork[dti]', or take image.denoise = 'none'"
        ) from None
    shape = dwi.data.shape
    if shape[3] < _LEAST_VOLUMES:
        raise InputError(
            f"{dwi.name}: {shape[3]} volumes are too few to tell noise by; set image.denoise = "
            "'none'"
        )
    usable = np.asarray(np.isfinite(dwi.data).all(axis=-1))
    reach = [min(_REACH, (n - 1) // 2) for n in shape[:3]]
    if not any(reach):
        raise InputError(
            f"{dwi.name}: {shape[:3]} voxels are too few to tell noise by; set image.denoise = "
            "'none'"
        )
    values = np.where(usable[..., np.newaxis], dwi.data, 0.0)
    found = mppca(values, mask=usable, patch_radius=np.array(reach), suppress_warning=True)
    # Rims and patches without any signal are left as they are.
    good = np.asarray(usable & np.isfinite(found).all(axis=-1) & (found != 0).any(axis=-1))
    return Image(np.where(good[..., np.newaxis], found, dwi.data), dwi.affine, dwi.name)
