"""Fibers of a leg under one label, against those of its muscles."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from myork.imaging.phantom import make_phantom
from myork.model.fibers import fiber_field

#: Phantoms of a half: other noise, septa, sizes and angles
HALVES: dict[str, tuple[dict[str, Any], ...]] = {
    "tuned": (
        {"seed": 1},
        {"seed": 2, "growth": 15, "septum": 0.6},
        {"seed": 4, "growth": 15, "septum": 0.5, "scale": 0.85, "pennation": 1.3, "snr": 40},
    ),
    "other": (
        {"seed": 31, "snr": 18, "pennation": 0.7},
        {"seed": 32, "growth": 15, "septum": 0.0, "snr": 30},
        {"seed": 33, "scale": 0.9, "pennation": 1.4},
        {"seed": 34, "growth": 15, "septum": 0.8, "imat": 0.03, "imct": 0.08},
    ),
}


def families(half: str) -> Iterator[tuple[str, ...]]:
    """Mean angle between computed and true fibers if the six muscles of a phantom share one label.

    With the width and the families that predict tensors best, with Gaussians of 1.5 and 3 mm over
    the label, and with a label for each muscle; 95th percentile in brackets.
    """
    yield ("phantom", "one label", "1.5 mm", "3 mm", "labels of the muscles", "CPU s")
    for keys in HALVES[half]:
        calf = make_phantom(**keys)
        muscle = calf.truth.data > 0
        angles, spent = [], 0.0
        for label, width in ((muscle, None), (muscle, 1.5), (muscle, 3.0), (calf.truth.data, None)):
            start = time.process_time()
            found = fiber_field(calf.tensor, label, width).fibers.data[muscle]
            spent = spent or time.process_time() - start
            cosine = np.abs((found * calf.fiber.data[muscle]).sum(axis=-1))
            angle = np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
            angles.append(f"{angle.mean():.2f}° ({np.quantile(angle, 0.95):.1f}°)")
        name = ", ".join(f"{key} {value:g}" for key, value in keys.items())
        yield (name, *angles, f"{spent:.1f}")
