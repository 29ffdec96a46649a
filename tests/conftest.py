"""Settings shared by all tests."""

import os
from pathlib import Path

# Before numpy and the core are imported: OpenMP and OpenBLAS read these once. One thread is the
# only count whose speed does not collapse on a shared machine; tests of threads ask for two.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest  # noqa: E402


@pytest.fixture(scope="session")
def inputs() -> Path:
    """Folder with the decks of the checkout."""
    return Path(__file__).parent.parent / "inputs"
