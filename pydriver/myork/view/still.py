"""A handful of states of a reduced model beside a run, for a report that needs no server."""

from __future__ import annotations

import base64
from itertools import product
from pathlib import Path

import numpy as np

from myork.files import write_json
from myork.view.answers import Answers

__all__ = ["keep_states"]

#: Values of each of the first two parameters at which the body is kept, and points of their curves
_STOPS, _POINTS = 5, 31
#: Fields that are kept with the places of a state
_KEPT = ("von_mises", "J")
#: Bytes of states above which fewer are kept
_MOST = 1_500_000


def keep_states(path: Path, folder: Path) -> Path:
    """Write `states.json`: states over two parameters, curves between them, errors of all.

    Activation and a load come first; other parameters stay in the middle of their range, loads at
    none.

    Parameters
    ----------
    path : Path
        Reduced model.
    folder : Path
        Output folder of the run.
    """
    order = {"activation": 0, "load": 1}
    with Answers(path) as answers:
        parameters = answers.rom.parameters
        at = np.array(answers.start())
        axes = sorted(range(len(parameters)), key=lambda k: order.get(parameters[k].kind, 2))[:2]
        size = 4 * (3 + len(_KEPT)) * len(answers.rest)
        stops = _STOPS if size * _STOPS ** len(axes) <= _MOST else 3
        about = answers.about()
        levels = [np.linspace(parameters[k].low, parameters[k].high, stops) for k in axes]
        states, curves = [], []
        for values in product(*levels):
            row = at.copy()
            row[axes] = values
            shown = [answers.state(row.tolist(), field) for field in _KEPT]
            arrays = [shown[0].positions, *(np.nan_to_num(s.values, nan=1e38) for s in shown)]
            packed = b"".join(a.astype("<f4").tobytes() for a in arrays)
            facts = shown[0].facts
            kept = base64.b64encode(packed).decode() if facts["converged"] else ""
            states.append({"facts": facts, "values": list(values), "places": kept})
        x = np.linspace(parameters[axes[0]].low, parameters[axes[0]].high, _POINTS)
        for level in levels[1] if len(axes) > 1 else [None]:
            rows = np.tile(at, (_POINTS, 1))
            rows[:, axes[0]] = x
            if level is not None:
                rows[:, axes[1]] = level
            curves.append(answers.along(rows, 0))
        content = {
            "title": about["title"],
            "model": path.name,
            "axes": [about["parameters"][k] for k in axes],
            "stops": [level.tolist() for level in levels],
            "others": {
                p.key: at[k] for k, p in enumerate(parameters) if k not in axes
            },
            "probes": about["probes"],
            "fields": [field for field in about["fields"] if field["name"] in _KEPT],
            "corners": len(answers.rest),
            "rest": base64.b64encode(answers.rest.astype("<f4").tobytes()).decode(),
            "triangles": base64.b64encode(answers.triangles.astype("<u4").tobytes()).decode(),
            "x": x.tolist(),
            "curves": curves,
            "states": states,
        }  # fmt: skip
    write_json(folder / "states.json", content)
    return folder / "states.json"
