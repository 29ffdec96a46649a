"""The first screen of a report in words: the question, the result, and whether to trust it."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from myork.report.frame import Answer
from myork.report.numbers import fraction, number, plain, probe_units, unit_of, with_error
from myork.report.sources import Deformation, RunFolder
from myork.summary import printed

#: Volume ratios that differ from 1 by more than this are counted
_OFF = 0.1
_VERDICTS = {
    "accepted": "Accepted: no check found a reason to doubt the numerical solution; fibers, "
    "materials and attachments are not checked",
    "doubtful": "Doubtful",
    "refused": "Refused: do not use these numbers",
}


def story(folder: RunFolder) -> list[Answer]:
    """Answers to the first questions of a reader."""
    summary, deformation = folder.summary, folder.deformation
    return [
        Answer("Problem", list(_asked(summary))),
        Answer("Results", list(_came_out(summary, deformation))),
        Answer("Reliability", list(_trust(summary, deformation))),
        Answer("Data", list(_data(summary))),
    ]


def is_phantom(summary: Mapping[str, Any]) -> bool:
    """Whether the images are those of the phantom: computed, not measured."""
    segmentation = summary.get("segmentation", {})
    return bool(segmentation.get("source") == "phantom")


def _asked(summary: Mapping[str, Any]) -> Iterator[str | Markup]:
    deck, units = summary.get("deck", {}), summary.get("units", {})
    length = units.get("length", "?")
    materials = ", ".join(str(own["name"]) for own in deck.get("material", []) if own.get("name"))
    body = _body(deck, summary, length)
    if body:
        yield Markup("{} of {}").format(body, materials) if materials else body
    held, moved = [], []
    for entry in deck.get("boundary", []):
        where = str(entry.get("set", "?"))
        given = {
            key: value
            for key, value in entry.items()
            if key != "set" and not (value == 0 or value == [0.0] * 3)
        }
        if not given:
            held.append(where)
        else:
            values = ", ".join(f"{key} = {plain(value)}" for key, value in given.items())
            moved.append(f"{where}: {values}")
    loads = [f"fixed at {', '.join(held)}"] if held else []
    loads += moved
    common = deck.get("load", {}).get("activation")
    own = {
        str(entry.get("name", "?")): entry["activation"]
        for entry in deck.get("material", [])
        if isinstance(entry.get("activation"), int | float)
    }
    muscles = [entry for entry in deck.get("material", []) if entry.get("model") == "muscle"]
    if isinstance(common, int | float) and common > 0 and (len(own) < len(muscles) or not own):
        loads.append(f"activation up to {fraction(common)}")
    loads += [f"activation of {name} up to {fraction(value)}" for name, value in own.items()]
    if loads:
        yield "; ".join(loads)
    wanted = [
        f"{probe['name']} ({probe['quantity']}{_where(probe, length)})"
        for probe in deck.get("probe", [])
        if probe.get("name") and probe.get("quantity")
    ]
    if wanted:
        yield f"Quantities: {', '.join(wanted)}"


def _body(deck: Mapping[str, Any], summary: Mapping[str, Any], length: str) -> str | Markup:
    geometry = deck.get("geometry", {})
    kind = geometry.get("kind")
    if kind == "box" and geometry.get("size"):
        sides = " × ".join(fraction(side) for side in geometry["size"])
        return f"A {'block' if summary.get('dimension') == 3 else 'sheet'} of {sides} {length}"
    if kind == "annulus" and geometry.get("outer_radius"):
        radii = " to ".join(fraction(geometry.get(f"{end}_radius")) for end in ("inner", "outer"))
        return f"A quarter of a ring, radius {radii} {length}"
    if kind == "model":
        volumes = summary.get("model", {}).get("volume", {})
        total = sum(volumes.values())
        if not total:
            return f"The body of {geometry.get('file', 'a model file')}"
        unit = unit_of(summary.get("units", {}), "volume")
        if len(volumes) == 1:
            return Markup("A body of {} {}").format(number(total, 3), unit)
        shares = ", ".join(f"{name} {100 * own / total:.0f} %" for name, own in volumes.items())
        return Markup("A body of {} {} ({} of the volume)").format(number(total, 3), unit, shares)
    return ""


def _where(probe: Mapping[str, Any], length: str) -> str:
    if probe.get("set"):
        return f" at {probe['set']}"
    if probe.get("point"):
        return f" at ({', '.join(fraction(x) for x in probe['point'])}) {length}"
    return ""


def _came_out(
    summary: Mapping[str, Any], deformation: Deformation | None
) -> Iterator[str | Markup]:
    units = summary.get("units", {})
    steps = summary.get("steps", [])
    if steps:
        last = steps[-1]
        known = probe_units(summary)
        values = [
            Markup("<b>{} {}</b> {}").format(
                name, with_error(value, last.get("probe_errors", {}).get(name)), known[name]
            )
            for name, value in printed(last).items()
            if value is not None
        ]
        if values:
            yield Markup("At load {}: {}").format(
                fraction(last.get("load")), Markup(", ").join(values)
            )
    if estimate := summary.get("pcsa_force"):
        yield Markup("Activation × PCSA × sigma_max: {} {}; {} is {} times that").format(
            number(estimate["value"], 3), units.get("force", "?"), estimate["probe"],
            number(estimate["ratio"], 2),
        )  # fmt: skip
    if deformation is not None:
        size = deformation.size
        stress = np.nan_to_num(deformation.stress, nan=-np.inf)
        most, tense = int(np.argmax(size)), int(np.argmax(stress))
        line = "Largest displacement {} {} at {}, largest principal stress {} {} at {}"
        yield Markup(line).format(
            number(float(size[most]), 3), unit_of(units, "length"), _place(deformation, most),
            number(float(deformation.stress[tense]), 3), unit_of(units, "stress"),
            _place(deformation, tense),
        )  # fmt: skip


def _place(deformation: Deformation, point: int) -> str:
    return f"({', '.join(f'{x:.3g}' for x in deformation.points[point])})"


def _trust(summary: Mapping[str, Any], deformation: Deformation | None) -> Iterator[str | Markup]:
    if "converged" not in summary:
        if summary.get("rom"):
            yield (
                "The error is relative to the full model, at the states from which the modes were "
                "made. The error of the full model adds to it: myork solve estimates it"
            )
        return
    steps = summary.get("steps", [])
    last = steps[-1] if steps else {}
    verdict = summary.get("verdict", {})
    if not summary["converged"] and not steps:
        yield f"No solution: {'; '.join(verdict.get('reasons') or ['no load step converged'])}"
    elif not summary["converged"]:
        yield f"Not converged: the last state is at load {fraction(last.get('load', 0.0))}"
    elif verdict.get("state") in _VERDICTS:
        reasons = "; ".join(verdict.get("reasons", []))
        yield _VERDICTS[verdict["state"]] + (f": {reasons}" if reasons else "")
    else:
        yield "No verdict: no checks were made"
    refined = summary.get("refine", {})
    if refined.get("met"):
        yield str(refined["reason"])
    bars = list(_relative_bars(last, summary.get("probe_units") or {}))
    if bars:
        worst, name = max(bars)
        yield Markup("Error bars: at most {} % of the value ({})").format(
            number(100.0 * worst, 2), name
        )
    if summary.get("force_imbalance") is not None:
        yield Markup("Force imbalance {} of the largest force").format(
            number(summary["force_imbalance"], 2)
        )
    if {"min_J", "max_J"} <= set(last):
        off = ""
        if deformation is not None:
            share = float(np.mean(np.abs(deformation.volume_ratio - 1.0) > _OFF))
            off = f", more than {100 * _OFF:.0f} % away from 1 at {100 * share:.3g} % of the points"
        yield Markup("Volume ratio J {} to {}{}").format(
            number(last["min_J"], 3), number(last["max_J"], 3), off
        )


def _relative_bars(
    step: Mapping[str, Any], units: Mapping[str, str]
) -> Iterator[tuple[float, str]]:
    """Error bars of a step relative to their values, with the name of the probe.

    As in the solver, a value counts at least as a tenth of the largest one of its unit.
    """
    sizes = {name: _largest(value) for name, value in step.get("probes", {}).items()}
    kinds: dict[str | None, float] = {}
    for name, size in sizes.items():
        kinds[units.get(name)] = max(kinds.get(units.get(name), 0.0), size)
    for name, error in step.get("probe_errors", {}).items():
        size = max(sizes.get(name, 0.0), 0.1 * kinds.get(units.get(name), 0.0))
        if size > 0.0 and (bar := _largest(error)) > 0.0:
            yield bar / size, name


def _largest(value: Any) -> float:
    """Largest magnitude among the components that are numbers."""
    return float(np.nanmax(np.abs(np.array(value, float)), initial=0.0))


def _data(summary: Mapping[str, Any]) -> Iterator[str | Markup]:
    segmentation = summary.get("segmentation", {})
    deck = summary.get("deck", {})
    if is_phantom(summary):
        yield Markup("<b>Phantom</b>: the images were computed, not measured on anybody")
    elif segmentation:
        yield f"Images: {segmentation.get('source', 'not named in this folder')}"
    elif deck.get("geometry", {}).get("kind") == "model":
        build = deck.get("build", {})
        source = build.get("labels") or build.get("surface")
        yield f"Body: {source or deck['geometry'].get('file', 'a model file')}"
    elif deck.get("geometry"):
        yield "No images: the body is defined by the deck"
