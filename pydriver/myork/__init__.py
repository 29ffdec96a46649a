"""MyoRK: meshfree image-based muscle mechanics.

Data flow: image -> labels -> points -> scene -> solution -> reduced model -> report.
The names below are loaded on first use, so that ``import myork`` costs nothing.
"""

import importlib
import os
from typing import Any

# libgomp reads these once, when the core is loaded. Waiting threads that soon sleep instead of
# spinning keep threaded BLAS usable on a machine shared with others.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "passive"
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")

_HOME = {
    "Console": "console",
    "MyorkError": "errors",
    "Results": "results",
    "ReducedModel": "rom.model",
    "Scene": "core.scene",
    "__version__": "_version",
    "build": "stations.build",
    "load_deck": "core.deck",
    "make_report": "report",
    "run_deck": "stations.solve",
    "run_demo": "demo",
    "run_rom": "rom",
    "segment": "stations.segment",
    "sweep": "sweeps",
}

__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name from its home module."""
    if name not in _HOME:
        raise AttributeError(f"module 'myork' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"myork.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
