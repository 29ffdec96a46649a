"""What to do where a shared library of the compiled parts is missing."""

from __future__ import annotations

import re

__all__ = ["cure_of"]

#: Packages of Debian and Ubuntu, by how the names of the libraries begin
_PACKAGES = {
    "libopenblas": "libopenblas-openmp-dev",
    "libblas": "libopenblas-openmp-dev",
    "liblapack": "libopenblas-openmp-dev",
    "libspqr": "libsuitesparse-dev",
    "libcholmod": "libsuitesparse-dev",
    "libumfpack": "libsuitesparse-dev",
    "libsuitesparseconfig": "libsuitesparse-dev",
    "libamd": "libsuitesparse-dev",
    "libcolamd": "libsuitesparse-dev",
    "libhdf5": "libhdf5-dev",
    "libmuparser": "libmuparser-dev",
    "libnifti2": "libnifti2-dev",
    "libznz": "libnifti2-dev",
    "libgfortran": "libgfortran5",
    "libquadmath": "libquadmath0",
    "libgomp": "libgomp1",
    "libstdc++": "libstdc++6",
}
_MISSING = re.compile(r"((lib[\w+]+)[\w.+-]*): cannot open shared object file")


def cure_of(complaint: str) -> str:
    """What to do about a complaint of the loader.

    Parameters
    ----------
    complaint : str
        Text of an exception, or what a program said that did not start.

    Returns
    -------
    str
        A sentence without a full stop.
    """
    found = _MISSING.search(complaint)
    if found is None:
        return "install again (sh setup.sh, or pip install --force-reinstall)"
    library, stem = found.groups()
    package = next((p for name, p in _PACKAGES.items() if stem.startswith(name)), None)
    which = f"apt-get install {package}" if package else f"the package that holds {library}"
    return (
        f"the library {library} is not on this machine, or another version of it: install it "
        f"(Debian, Ubuntu: {which}); if it is there, build again (sh setup.sh)"
    )
