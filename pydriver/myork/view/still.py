"""States of a reduced model in a page that needs no server."""

import base64
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from myork.console import ProgressCallback, silent
from myork.errors import InputError
from myork.files import check_writable, write_text
from myork.report.frame import render
from myork.rom.parameters import spread_points
from myork.types import F64
from myork.view.answers import FIELDS, Answers

#: Largest size of all states of a page in bytes, and their largest number
MOST_BYTES, _MOST_STATES = 4_000_000, 400
#: States along a parameter: the least for a further parameter to get a slider, and the most
_LEAST, _MOST = 5, 17
#: Kinds of parameters that come first
_FIRST = {"activation": 0, "load": 1}
#: Number of other states at which the interpolation is compared with the model
_TESTS = 16


def still_page(
    path: Path, page: Path, *, threads: int = 1, progress: ProgressCallback = silent
) -> Path:
    """Write a page of a reduced model that opens from the file system, without a server.

    - `path`: reduced model (.rom.h5)
    - `page`: the page (.html), written completely or not at all
    - `threads`: threads of a state
    - `progress`: called with a line of progress
    - raises InputError: the file name is not that of a page, or the states do not fit into it
    """
    if page.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--still {page}: the name must end in .html")
    check_writable(page)
    states = sample(path, threads=threads, progress=progress)
    write_text(page, render("view.html", **states))
    return page


def sample(path: Path, *, threads: int = 1, progress: ProgressCallback = silent) -> dict[str, Any]:
    """Sample states of a reduced model on a grid of its parameters.

    Activations come first, then loads. As many parameters get a slider as `MOST_BYTES` and 400
    states allow with five along each; the others are fixed: loads at zero, others in the middle.

    - returns `about`, data from which the page is built, and `held`: `stops`, the number of states
      along each parameter; `states`, of which the last parameter varies fastest; the conversion of
      bytes to positions and values; the interpolation errors between the states
    - raises InputError: three states of the body are larger than `MOST_BYTES`
    """
    with Answers(path, threads) as answers:
        about, start = answers.about(), answers.start()
        every = range(len(start))
        order = sorted(every, key=lambda k: _FIRST.get(answers.rom.parameters[k].kind, 2))
        stops, axes = _grid(path, order, len(answers.rest))
        chosen = [answers.rom.parameters[k] for k in axes]
        levels = [np.linspace(p.low, p.high, stops) for p in chosen]
        states: list[dict[str, Any]] = []
        places: list[F64] = []
        fields: list[F64] = []
        total = stops ** len(axes)
        row = np.array(start)
        for number, values in enumerate(product(*levels), start=1):
            row[axes] = values
            facts, where, found = answers.fields(row.tolist())
            ranges = [answers.range_of(*one) for one in zip(found, FIELDS, strict=True)]
            states.append({**facts, "ranges": ranges})
            places.append(where)
            fields.append(found)
            if number % 25 == 0 or number == total:
                progress(f"state {number}/{total} of the page")
        found_at = np.array([state["converged"] for state in states])
        if not found_at.any():
            raise InputError(f"{path}: the reduced model has no state in its range: train it again")
        all_places, all_fields = np.array(places), np.array(fields)
        seen = all_places[found_at]
        ends = np.array([seen.min(axis=(0, 1)), seen.max(axis=(0, 1))])
        limits = np.array([answers.ranges[name] for name in FIELDS]).T[:, :, None]
        for state, where, found in zip(states, all_places, all_fields, strict=True):
            packed = _whole(where, ends, "<u2") + _whole(found, limits, "u1")
            state["bytes"] = base64.b64encode(packed).decode() if state["converged"] else ""
        tests = _tests(answers, row, axes, levels, states, all_places)
        if about["bar"] is not None:
            about["bar"] = {**about["bar"], "between": tests["force"] or 0.0}
        about["parameters"] = [
            {**about["parameters"][k], "least": p.low, "most": p.high}
            for k, p in zip(axes, chosen, strict=True)
        ]
        about["start"] = [start[k] for k in axes]
        return {
            "title": about["title"],
            "about": about,
            "held": {
                "model": path.name,
                "stops": stops,
                "fixed": {answers.rom.parameters[k].key: start[k] for k in every if k not in axes},
                "corners": len(answers.rest),
                "ends": ends.tolist(),
                "rest": base64.b64encode(answers.rest.astype("<f4").tobytes()).decode(),
                "triangles": base64.b64encode(answers.triangles.astype("<u4").tobytes()).decode(),
                "tests": tests,
                "states": states,
            },
        }


def _grid(path: Path, order: list[int], corners: int) -> tuple[int, list[int]]:
    """Number of states along each parameter, and the parameters that vary."""
    # base64 has four letters for three bytes
    size = (3 * 2 + len(FIELDS)) * corners * 4 / 3
    most = min(_MOST_STATES, int(MOST_BYTES / size))
    for count in range(len(order), 0, -1):
        stops = min(_MOST, int((most + 0.5) ** (1.0 / count)))
        if stops >= (_LEAST if count > 1 else 3):
            return stops, order[:count]
    raise InputError(
        f"{path}: its surface has {corners} corners: three states are larger than the "
        f"{MOST_BYTES / 1e6:g} MB of a still page; `myork view {path}` shows them"
    )


def _whole(values: F64, ends: F64, kind: str) -> bytes:
    """Values as integers between ends, the largest integer for missing numbers."""
    none, (low, high) = np.iinfo(kind).max, ends
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nan_to_num((values - low) / (high - low), nan=0.0, posinf=1.0, neginf=0.0)
    whole = np.rint(np.clip(share, 0.0, 1.0) * (none - 1))
    return np.where(np.isfinite(values), whole, none).astype(kind).tobytes()


def _tests(
    answers: Answers,
    row: F64,
    axes: list[int],
    levels: list[F64],
    states: list[dict[str, Any]],
    places: F64,
) -> dict[str, Any]:
    """Interpolation errors at values between the sampled states.

    Returns `points`; the largest errors of the first probe, `force`, and of a position, `place`
    [length].
    """
    shape = [len(level) for level in levels]
    force = np.array([np.nan if not s["converged"] else s["probes"][0] for s in states])
    of_force = RegularGridInterpolator(levels, force.reshape(shape))
    of_place = RegularGridInterpolator(levels, places.reshape(*shape, -1))
    wrong: dict[str, list[float]] = {"force": [], "place": []}
    at = spread_points([answers.rom.parameters[k] for k in axes], _TESTS, 0)
    for values in at:
        row[axes] = values
        facts, where, _ = answers.fields(row.tolist(), ["J"])
        between = float(of_force(values)[0])
        if facts["converged"] and np.isfinite(between):
            wrong["force"].append(abs(facts["probes"][0] - between))
            off = of_place(values)[0].reshape(-1, 3) - where
            wrong["place"].append(float(np.linalg.norm(off, axis=1).max()))
    return {
        "points": len(wrong["force"]),
        **{name: max(found, default=None) for name, found in wrong.items()},
    }
