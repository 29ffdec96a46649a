"""The page: sections for whatever a folder holds, in one HTML file without external parts."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from myork.files import write_text
from myork.report import figures, frame, image_figures, tables
from myork.report.numbers import fraction, number, unit_of
from myork.report.sources import RunFolder, read_folder

__all__ = ["make_report"]

_NAME = "report.html"


def make_report(folder: str | Path) -> Path:
    """Write `report.html` from whatever is in an output folder.

    Parameters
    ----------
    folder : str or Path
        Output folder of `solve`, `rom`, `segment` or `demo`.

    Returns
    -------
    Path
        The page; figures are inside it, nothing is loaded from elsewhere.
    """
    content = read_folder(Path(folder))
    page = content.path / _NAME
    write_text(page, _page(content))
    return page


def _page(folder: RunFolder) -> str:
    """All sections that have something to show, behind their headline."""
    summary = folder.summary
    sections = [
        ("images", "From the image to the labels", _images(folder)),
        ("deformation", "Deformation", _deformation(folder)),
        ("probes", "Forces and other probes", _probes(folder)),
        ("rom", "Reduced models", _rom(summary)),
        ("convergence", "Convergence", _convergence(folder)),
        ("run", "The run", _run(folder)),
    ]
    shown = [section for section in sections if section[2]]
    title = escape(str(summary.get("title") or folder.path.resolve().name))
    links = "".join(f'<a href="#{key}">{name}</a>' for key, name, _ in shown)
    body = "\n".join(frame.section(*section) for section in shown)
    version = escape(str(summary.get("version", "")))
    header = f"""<h1>{title}{_state(summary)}</h1>
<p class="about">{_about(summary)}</p>
{_cards(summary)}
{_warnings(folder)}
<nav aria-label="Sections">{links}</nav>"""
    footer = (
        f"MyoRK {version} · made by <code>myork report</code> from the files in\n"
        f"<code>{escape(str(folder.path))}</code>"
    )
    return frame.document(f"{title} – MyoRK report", header, body, footer)


def _state(summary: Mapping[str, Any]) -> str:
    """Whether the solve converged, in words and colour."""
    if "converged" not in summary:
        return ""
    if summary["converged"]:
        return ' <span class="state good">✓ converged</span>'
    steps = summary.get("steps") or [{"load": 0.0}]
    reached = fraction(steps[-1].get("load"))
    return f' <span class="state bad">✗ not converged, last state at load {reached}</span>'


def _about(summary: Mapping[str, Any]) -> str:
    """One line: method and sizes."""
    if "method" not in summary:
        return "Output of MyoRK"
    return (
        f"{escape(str(summary['method']))}, {number(summary.get('dimension'))}-D, "
        f"{number(summary.get('source_points'))} source points, "
        f"{number(summary.get('collocation_points'))} collocation points, "
        f"{number(summary.get('dofs'))} unknowns"
    )


def _cards(summary: Mapping[str, Any]) -> str:
    """The numbers one looks for first: probes at the end, time, best reduced model, scores."""
    cards: list[tuple[str, str, str]] = []
    units = _probe_units(summary)
    steps = summary.get("steps") or [{}]
    last = steps[-1].get("probes", {})
    scalars = [name for name in units if isinstance(last.get(name), (int, float))]
    for name in scalars[:4]:
        value = f"{number(last[name])} <small>{escape(units[name])}</small>"
        cards.append((escape(name), value, f"at load {fraction(steps[-1].get('load'))}"))
    models = [model for model in summary.get("rom", {}).get("models", []) if model.get("e1")]
    if models:
        best = min(models, key=lambda model: model["e1"])
        faster = number(best.get("speedup_vs_full"), 3)
        note = f"r = {best['r']}, error e<sub>1</sub> {number(best['e1'], 2)}"
        cards.append(("reduced model", f"{faster} <small>times faster</small>", note))
    for name, score in summary.get("segmentation", {}).get("scores", {}).items():
        dice = f"{number(score.get('dice'), 3)} <small>Dice</small>"
        cards.append(("segmentation", dice, escape(name)))
    total = summary.get("timings_s", {}).get("total")
    if total is not None:
        threads = number(summary.get("threads"))
        cards.append(
            ("full solution", f"{number(total, 3)} <small>s</small>", f"{threads} threads")
        )
    if not cards:
        return ""
    parts = "".join(
        f"<div><dt>{head}</dt><dd>{value}</dd><dd><small>{note}</small></dd></div>"
        for head, value, note in cards
    )
    return f'<dl class="cards">{parts}</dl>'


def _warnings(folder: RunFolder) -> str:
    """Warnings of the run, and files that could not be read."""
    lines = [
        *folder.summary.get("segmentation", {}).get("warnings", []),
        *folder.summary.get("warnings", []),
        *folder.problems,
    ]
    if not lines:
        return ""
    items = "".join(f"<li>{escape(str(line))}</li>" for line in lines)
    return f'<ul class="warnings" aria-label="Warnings">{items}</ul>'


def _images(folder: RunFolder) -> str:
    """Slices, areas, scores."""
    parts = []
    segmentation = folder.summary.get("segmentation", {})
    if folder.labels is not None:
        image, fibers = (
            None if extra is None or extra.data.shape[:3] != folder.labels.data.shape else extra
            for extra in (folder.image, folder.fibers)
        )
        parts += [
            frame.figure(
                image_figures.slice_figure(folder.labels, image, fibers),
                "Slices of the image with the contour of each label and the fibers in the plane "
                "of the picture; a short stroke is a fiber that leaves the plane.",
            ),
            frame.figure(
                image_figures.area_figure(folder.labels, segmentation.get("energy") or []),
                "Cross-sectional area of each label along the stack, and the energy of the "
                "segmentation where it was recorded.",
            ),
        ]
    if segmentation:
        parts.append(tables.label_table(segmentation, folder.summary.get("units", {})))
    if segmentation.get("orientation"):
        parts.append(tables.orientation_table(segmentation["orientation"]))
    if folder.tissue is not None:
        image = folder.image
        if image is not None and image.data.shape != folder.tissue.data.shape:
            image = None
        parts.append(
            frame.figure(
                image_figures.slice_figure(folder.tissue, image, None),
                "Materials of the leg: contour of each on the image.",
            )
        )
        record = folder.summary.get("tissue", {})
        parts.append(tables.label_table(record, folder.summary.get("units", {})))
    return "\n".join(parts)


def _deformation(folder: RunFolder) -> str:
    """Cloud of the last step."""
    deformation = folder.deformation
    if deformation is None or len(deformation.loads) < 2:
        return ""
    length = folder.summary.get("units", {}).get("length", "?")
    largest = float(np.linalg.norm(deformation.displacement, axis=1).max())
    return frame.figure(
        figures.cloud_figure(deformation, folder.summary.get("units", {})),
        f"Last step, load {fraction(float(deformation.loads[-1]))}, activation "
        f"{fraction(float(deformation.activations[-1]))}: deformed points to scale, largest "
        f"displacement {number(largest)} {escape(length)}; undeformed outline in grey. "
        "Colours span the middle 98 % of the values. All steps open in ParaView: "
        "<code>results.vtkhdf</code>.",
    )


def _probes(folder: RunFolder) -> str:
    """Curves and numbers of the probes, with what they are compared to."""
    summary = folder.summary
    units = _probe_units(summary)
    steps = summary.get("steps", [])
    reference, exact = summary.get("reference", {}), summary.get("exact", {})
    parts = []
    if units and steps:
        figure = figures.probe_figure(steps, units, reference, exact)
        extra = " Open circles: reference values." if reference else ""
        parts.append(frame.figure(figure, f"Probes of the deck in all converged steps.{extra}"))
    if reference:
        parts.append(tables.reference_table(reference, units))
    if exact:
        parts.append(tables.exact_table(exact, units))
    if units and steps:
        values = tables.probe_table(steps, units)
        parts.append(f"<details><summary>Values in all converged steps</summary>{values}</details>")
    return "\n".join(parts)


def _rom(summary: Mapping[str, Any]) -> str:
    """Full against reduced."""
    rom = summary.get("rom")
    if not rom:
        return ""
    models = rom.get("models", [])
    parts = [
        frame.figure(
            figures.rom_figure(rom),
            f"Left: decay of the orthogonal values of {number(rom.get('snapshots'))} "
            "snapshots. Middle: errors of displacement (e<sub>1</sub>) and displacement "
            "gradient (e<sub>2</sub>). Right: what a given speed-up costs in accuracy.",
        ),
        tables.rom_table(models),
    ]
    full, units = rom.get("full", {}), _probe_units(summary)
    if units.keys() & full.get("probes", {}).keys():
        parts.append(
            frame.figure(
                figures.rom_probe_figure(full, models, units),
                "Full solution (line) against the reduced models (markers).",
            )
        )
    return "\n".join(parts)


def _convergence(folder: RunFolder) -> str:
    """Iterations of all steps."""
    if not {"step", "load"} <= set(folder.history):
        return ""
    return frame.figure(
        figures.history_figure(folder.history),
        "Every iteration of every load step; residuals of a least squares solution do not go to "
        "zero, the gradient does.",
    )


def _run(folder: RunFolder) -> str:
    """Method, solver, timings."""
    summary = folder.summary
    parts = []
    if "method" in summary:
        parts.append(f'<div class="facts">{tables.run_table(summary)}</div>')
    timings = summary.get("timings_s", {})
    if timings:
        parts += [
            frame.figure(figures.timing_figure(timings), "Wall time of the full solution."),
            tables.timing_table(timings, summary.get("memory_peak_bytes")),
        ]
    return "\n".join(parts)


def _probe_units(summary: Mapping[str, Any]) -> dict[str, str]:
    """Unit of each probe by its name, from the quantity that the deck asks for."""
    quantities = {
        str(probe.get("name")): str(probe.get("quantity"))
        for probe in summary.get("deck", {}).get("probe", [])
    }
    return {
        name: unit_of(quantity, summary.get("units", {}), summary.get("dimension", 3))
        for name, quantity in quantities.items()
    }
