"""The page: sections for whatever a folder holds, in one HTML file without external parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

import myork
from myork.errors import FileError, InputError, MyorkError
from myork.files import read_json, write_text
from myork.report import figures, image_figures, pictures, tables
from myork.report.beside import reduced_figure
from myork.report.compare import compare_page
from myork.report.frame import Section, figure, render
from myork.report.numbers import fraction, number, probe_units
from myork.report.sketch import NO_VALUE
from myork.report.sources import RunFolder, read_folder
from myork.report.story import is_phantom, story
from myork.report.sweep_page import SWEEP_FILE, read_sweep, sweep_page
from myork.summary import failures

__all__ = ["compare_runs", "make_report"]

_NAME = "report.html"
#: What arrows and crosses of a picture are
_STROKES = (
    "Arrows: displacement in the plane, each picture with a scale of its own. Crosses: principal "
    "stresses in the plane, white where they pull, black where they press."
)


def make_report(folder: str | Path) -> Path:
    """Write `report.html` from whatever is in an output folder.

    Parameters
    ----------
    folder : str or Path
        Output folder of `solve`, `rom`, `segment`, `demo` or `sweep`.

    Returns
    -------
    Path
        The page; figures are inside it, nothing is loaded from elsewhere.
    """
    path = Path(folder)
    if (path / SWEEP_FILE).is_file():
        text = sweep_page(read_sweep(path), myork.__version__)
    else:
        # what cannot be read is refused there
        content = read_folder(path)
        text = _whole(lambda: _page(content), path)
    write_text(path / _NAME, text)
    return path / _NAME


def compare_runs(folders: Sequence[str | Path], out: str | Path | None = None) -> Path:
    """Write `compare.html`: two or more runs side by side.

    Parameters
    ----------
    folders : sequence of str or Path
        Output folders of `solve`; the first is what the others are compared with.
    out : str or Path, optional
        Folder of the page; default the first of them.
    """
    runs = [read_folder(Path(folder)) for folder in folders]
    if len(runs) < 2:
        raise InputError("a comparison needs two folders or more")
    page = Path(out or folders[0]) / "compare.html"
    page.parent.mkdir(parents=True, exist_ok=True)
    write_text(page, _whole(lambda: compare_page(runs, myork.__version__), page.parent))
    return page


def _whole(make: Callable[[], str], folder: Path) -> str:
    """A page, or an error where the numbers of its files do not fit together."""
    try:
        return make()
    except MyorkError:
        raise
    except Exception as reason:
        raise FileError(
            f"{folder}: summary.json or another file is damaged, or the page has a fault "
            f"of its own: {reason!r}; run the command again"
        ) from reason


def _page(folder: RunFolder) -> str:
    """All sections that have something to show, behind their headline."""
    summary = folder.summary
    sections = [
        Section("images", "From the image to the labels", _images(folder)),
        Section("deformation", "Deformation", _deformation(folder)),
        Section("planes", "Inside the body", _planes(folder)),
        Section("probes", "Forces and other probes", _probes(folder)),
        Section("rom", "Reduced models", _rom(folder)),
        Section("touch", "The reduced model to touch", _touch(folder)),
        Section("convergence", "Convergence", _convergence(folder)),
        Section("run", "The run", _run(folder)),
    ]
    steps = summary.get("steps")
    return render(
        "report.html",
        title=summary.get("title") or folder.path.resolve().name,
        sections=[section for section in sections if section.parts],
        converged=summary.get("converged"),
        verdict=(summary.get("verdict") or {}).get("state"),
        reached=fraction(steps[-1].get("load")) if steps else None,
        about=_about(summary),
        phantom=is_phantom(summary),
        story=story(folder),
        warnings=_warnings(folder),
        version=summary.get("version", ""),
        folder=folder.path,
    )


def _about(summary: Mapping[str, Any]) -> str:
    """One line: method, sizes and time."""
    if "method" not in summary:
        return "Output of MyoRK"
    sizes = ("dimension", "source_points", "collocation_points", "dofs")
    line = Markup("{}, {}-D, {} source points, {} collocation points, {} unknowns").format(
        summary["method"], *(number(summary.get(size)) for size in sizes)
    )
    total, threads = summary.get("timings_s", {}).get("total"), summary.get("threads")
    if total is None:
        return line
    word = "thread" if threads == 1 else "threads"
    return Markup("{}, {} s by {} {}").format(line, number(total, 3), number(threads), word)


def _warnings(folder: RunFolder) -> list[str]:
    """Warnings of the run and of the segmentation, and what is old; reasons stand in the story."""
    warnings = folder.summary.get("warnings", [])
    reasons = (folder.summary.get("verdict") or {}).get("reasons", [])
    refine = folder.summary.get("refine")
    return [
        *failures(folder.summary),
        *folder.summary.get("segmentation", {}).get("warnings", []),
        *(text for text in warnings if not any(text in reason for reason in reasons)),
        *([refine["reason"]] if refine and not refine["met"] else []),
    ]


def _images(folder: RunFolder) -> list[Markup]:
    """Slices, areas, scores."""
    parts = []
    segmentation = folder.summary.get("segmentation", {})
    if folder.labels is not None:
        image, fibers = (
            None if extra is None or extra.data.shape[:3] != folder.labels.data.shape else extra
            for extra in (folder.image, folder.fibers)
        )
        parts += [
            figure(
                image_figures.slice_figure(folder.labels, image, fibers),
                "Slices of the image with the contour of each label and the fibers in the plane "
                "of the picture; a short stroke is a fiber that leaves the plane.",
            ),
            figure(
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
            figure(
                image_figures.slice_figure(folder.tissue, image, None),
                "Materials of the leg: contour of each on the image.",
            )
        )
        record = folder.summary.get("tissue", {})
        parts.append(tables.label_table(record, folder.summary.get("units", {})))
    return parts


def _deformation(folder: RunFolder) -> list[Markup]:
    """The body in the last step."""
    deformation = folder.deformation
    if deformation is None or len(deformation.loads) < 2:
        return []
    units = folder.summary.get("units", {})
    caption = Markup(
        "Load {}, activation {}: the body as it is deformed, to scale, largest displacement {} {}; "
        "undeformed edges in grey. All steps open in ParaView: <code>results.vtkhdf</code>."
    ).format(
        fraction(float(deformation.loads[-1])),
        fraction(float(deformation.activations[-1])),
        number(float(np.linalg.norm(deformation.displacement, axis=1).max())),
        units.get("length", "?"),
    )
    missing = int(np.count_nonzero(np.isnan(deformation.stress)))
    if missing:
        caption = Markup(
            "{} <b>{} of {} points have no stress</b>, for the material is turned inside out there "
            '(J ≤ 0): <span style="color:{}">this colour, or crosses in it</span>.'
        ).format(caption, missing, len(deformation.stress), NO_VALUE)
    if not np.ptp(deformation.points[:, 2]):
        return [figure(pictures.plane_figure(deformation, units), Markup("{} {}").format(
            caption, _STROKES))]  # fmt: skip
    tissues = list(folder.summary.get("model", {}).get("volume", {}))
    if deformation.label is None or len(tissues) != len(np.unique(deformation.label)):
        materials = folder.summary.get("deck", {}).get("material", [])
        tissues = [str(own.get("name", "")) for own in materials]
    if not len(deformation.surface):
        caption = Markup("{} Points in place of the surface, which the file does not have.").format(
            caption
        )
    return [figure(pictures.surface_figure(deformation, units, tissues), caption)]


def _planes(folder: RunFolder) -> list[Markup]:
    """Displacement, fibers and stresses on three planes of a body in space."""
    deformation = folder.deformation
    if deformation is None or len(deformation.loads) < 2 or not np.ptp(deformation.points[:, 2]):
        return []
    if not len(deformation.lattice):
        return [Markup("<p>No planes: the file does not say how its points hang together.</p>")]
    shown = pictures.slices_figure(deformation, folder.summary.get("units", {}))
    return [figure(shown, Markup("Planes through the middle, undeformed. {}").format(_STROKES))]


def _probes(folder: RunFolder) -> list[Markup]:
    """Curves and numbers of the probes, with what they are compared to."""
    summary = folder.summary
    units = probe_units(summary)
    steps = summary.get("steps", [])
    reference, exact = summary.get("reference", {}), summary.get("exact", {})
    parts = []
    if units and steps:
        curves = figures.probe_figure(steps, units, reference, exact)
        extra = " Open circles: reference values." if reference else ""
        if any(step.get("probe_errors") for step in steps):
            extra += " Bands: estimated errors."
        parts.append(figure(curves, f"Probes of the deck in all converged steps.{extra}"))
    if reference:
        parts.append(tables.reference_table(reference, units))
    if exact:
        parts.append(tables.exact_table(exact, units))
    if units and steps:
        values = tables.probe_table(steps, units)
        details = "<details><summary>Values in all converged steps</summary>{}</details>"
        parts.append(Markup(details).format(values))
    return parts


def _rom(folder: RunFolder) -> list[Markup]:
    """Full against reduced."""
    summary = folder.summary
    rom = summary.get("rom")
    if not rom:
        return []
    models = rom.get("models", [])
    parts = [
        figure(
            figures.rom_figure(rom),
            Markup(
                "Left: decay of the orthogonal values of {} snapshots. Middle: errors of "
                "displacement (e<sub>1</sub>) and displacement gradient (e<sub>2</sub>). Right: "
                "what a given speed-up costs in accuracy."
            ).format(number(rom.get("snapshots"))),
        ),
        tables.rom_table(models),
    ]
    full, units = rom.get("full", {}), probe_units(summary)
    if units.keys() & full.get("probes", {}).keys():
        parts.append(
            figure(
                figures.rom_probe_figure(full, models, units),
                "Full solution (line) against the reduced models (markers).",
            )
        )
    return [*parts, *_reduced_fields(folder, models)]


def _reduced_fields(folder: RunFolder, models: Sequence[Mapping[str, Any]]) -> Iterator[Markup]:
    """Fields of the model with the least error, and folded those of the one with fewest modes."""
    fields = folder.reduced
    numbers = {model["r"]: model for model in models}
    own = [] if fields is None else [k for k, r in enumerate(fields.modes) if r in numbers]
    if fields is None or not own:
        return
    known = {k: numbers[fields.modes[k]].get("e1") for k in own}
    errors = {k: np.inf if error is None else float(error) for k, error in known.items()}
    best = min(own, key=errors.__getitem__)
    fewest = min(own, key=lambda k: fields.modes[k])
    for k in dict.fromkeys((best, fewest)):
        model = numbers[fields.modes[k]]
        modes = Markup("{} {}").format(number(model["r"]), "mode" if model["r"] == 1 else "modes")
        caption = Markup(
            "The last state of the full model and of the reduced one with {}, deformed to scale, "
            "in one scale of colours, and their difference, with the largest of it at any point. "
            "Over all {} states the errors are e<sub>1</sub> = {}, e<sub>2</sub> = {}."
        ).format(
            modes,
            number((folder.summary.get("rom") or {}).get("snapshots")),
            number(model.get("e1"), 2),
            number(model.get("e2"), 2),
        )
        shown = figure(reduced_figure(fields, k, folder.summary.get("units", {})), caption)
        folded = "<details><summary>The same with {}</summary>{}</details>"
        yield shown if k == best else Markup(folded).format(modes, shown)


def _touch(folder: RunFolder) -> list[Markup]:
    """States of a reduced model beside the run, with sliders."""
    path = folder.path / "states.json"
    if not path.is_file():
        return []
    return [render("touch.html", about=read_json(path))]


def _convergence(folder: RunFolder) -> list[Markup]:
    """Iterations of all steps."""
    if not {"step", "load"} <= set(folder.history):
        return []
    return [
        figure(
            figures.history_figure(folder.history),
            "Every iteration of every load step."
            if str(folder.summary.get("method")).startswith("rkpm")
            else "Every iteration of every load step; residuals of a least squares solution do not "
            "go to zero, the gradient does.",
        )
    ]


def _run(folder: RunFolder) -> list[Markup]:
    """Method, solver, timings."""
    summary = folder.summary
    parts = []
    if "method" in summary:
        parts.append(Markup('<div class="facts">{}</div>').format(tables.run_table(summary)))
    timings = summary.get("timings_s", {})
    if timings:
        parts += [
            figure(figures.timing_figure(timings), "Wall time of the full solution."),
            tables.timing_table(timings, summary.get("memory_peak_bytes")),
        ]
    return parts
