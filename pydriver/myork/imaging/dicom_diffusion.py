"""Diffusion series of a DICOM folder by dcm2niix, an extra of the package.

Makers write b values and gradients in elements and frames of their own, and some put all slices of
a volume into one picture: dcm2niix knows them, and writes FSL's files.
"""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from myork.errors import FileError, InputError
from myork.imaging.dicom import series_files
from myork.imaging.formats import library


@contextmanager
def diffusion_series(folder: Path, choice: str = "") -> Iterator[Path]:
    """A NIfTI file of a diffusion series, its .bval and .bvec beside it, while the context lasts.

    - `folder`: folder of DICOM images
    - `choice`: which of several series, see `chosen_files`
    """
    files = series_files(folder, choice)
    converter = library("dcm2niix", "dicom", folder).bin
    with TemporaryDirectory(prefix="myork-") as place:
        there, made = Path(place, "dicom"), Path(place, "nifti")
        there.mkdir()
        made.mkdir()
        for number, file in enumerate(files):
            (there / f"{number}.dcm").symlink_to(file.path.resolve())
        # the folder is that of one image: what dcm2niix would part, as by echoes, stays together
        command = [converter, "-b", "n", "-z", "n", "-f", "image", "-o", str(made), str(there)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, errors="replace")
        except OSError as reason:
            raise FileError(f"{converter}: does not start: {reason.strerror}") from None
        tables = sorted(made.glob("*.bvec"))
        if len(tables) != 1:
            said = [line for line in done.stdout.splitlines() if line.strip()][-3:]
            raise InputError(
                f"{folder}: dcm2niix found gradients of {len(tables)} series in its "
                f"{len(files)} files, one is needed; it said: {'; '.join(said)}"
            )
        yield tables[0].with_suffix(".nii")
