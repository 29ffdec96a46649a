"""Pictures of the dissertation's figures: segmentation beside the ground truth, and curves.

Each function draws the records of the runs of a table, given by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from myork.records import Labels
from myork.report.figures import COLOURS, MARKERS, Series, panels_of, probe_figure
from myork.report.image_figures import slice_figure
from myork.types import I32


def agreement(records: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Voxels where the first run finds a tissue correctly, misses it, or finds it in excess."""
    record = next(iter(records.values()))
    truth, found = (record[name].data > 0 for name in ("truth", "found"))
    image = record["anatomy"]
    kinds: I32 = np.where(truth, np.where(found, 1, 2), np.where(found, 3, 0)).astype(np.int32)
    names = {1: "found", 2: "missed", 3: "too much"}
    return slice_figure(Labels(kinds, image.affine, names), image, None)


def young_and_old(records: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Force of both muscles over activation."""
    series = [Series(name, records[name]["history"]) for name in ("young", "old")]
    return probe_figure(series, {"top": "N"})


def both_fields(
    records: Mapping[str, Mapping[str, Any]], axes: tuple[int, int], name: str, exact: float
) -> Figure:
    """A component of the Cauchy stress in the mid-plane of the deformed body, by both methods."""
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    planes = {}
    for form, record in records.items():
        depth = record["ends"][:, 2]
        middle = np.abs(depth - depth.mean()) < 0.01 * np.ptp(depth)
        planes[form] = record["ends"][middle], record["cauchy"][:, axes[0], axes[1]][middle]
    stresses = np.concatenate([stress for _, stress in planes.values()])
    # one scale without the corners (singular stresses); values within 1 % have one colour
    low, high = np.quantile(stresses, [0.05, 0.95])
    low, high = min(low, exact - 0.01 * abs(exact)), max(high, exact + 0.01 * abs(exact))
    panels = figure.subplots(1, len(planes), sharey=True)
    for panel, (form, (ends, stress)) in zip(panels, planes.items(), strict=True):
        shown = panel.scatter(*ends[:, :2].T, c=stress, s=60, vmin=low, vmax=high, cmap="viridis")
        panel.set(
            xlabel="x [cm]", title=f"{form}: {stress.min():.4g} to {stress.max():.4g}, "
            f"median {np.median(stress):.4g}",
        )  # fmt: skip
    panels[0].set(ylabel="y [cm]")
    figure.colorbar(shown, ax=panels, label=f"{name} [N/cm²], exact {exact:g}", extend="both")
    return figure


def both_curves(records: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Stress at the centre and reaction over the load by both methods."""
    series = [Series(form.upper(), record["history"]) for form, record in records.items()]
    return probe_figure(series, {"stress_zz": "N/cm²", "reaction": "N"})


def convergence(records: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Relative errors in L2 and H1 over source spacing and CPU time, by form."""
    figure, panels = panels_of(2, sharey=True)
    spots = {"h": "source spacing [unit of length of the deck]", "cpu_s": "CPU time [s]"}
    forms = (("rates", "collocation, published"), ("auto", "default (Galerkin)"))
    for axes, (key, label) in zip(panels, spots.items(), strict=True):
        for number, ((run, name), norm) in enumerate(product(forms, ("L2", "H1"))):
            cases = records[run]["cases"]
            axes.loglog(
                [case[key] for case in cases], [case["error"][norm] for case in cases],
                color=COLOURS[number], marker=MARKERS[number], label=f"{name}, {norm}",
            )  # fmt: skip
        axes.set_xlabel(label)
    panels[0].set_ylabel("relative error [-]")
    panels[0].legend(frameon=False, fontsize="small")
    return figure
