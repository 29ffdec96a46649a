"""The whole way on one command: phantom images to a muscle force, its reduced model, a report."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from myork.console import ProgressCallback

__all__ = ["run_demo"]

#: Installed copy of inputs/mg_muscle.toml
_DECK = Path(__file__).parent / "inputs" / "mg_muscle.toml"
