"""The machine on which the numbers of `bench.json` were measured."""

import os
import platform
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import myork


def machine() -> dict[str, Any]:
    """Version, date, processor and number of cores."""
    model = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line[:10] == "model name")
    except (OSError, StopIteration):
        pass
    return {
        "version": myork.__version__,
        "date": datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
        "processor": model,
        "cores": os.cpu_count(),
        "load_average": os.getloadavg()[0],
    }
