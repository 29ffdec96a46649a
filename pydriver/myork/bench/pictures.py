"""Pictures of the dissertation's figures that show images: what was found beside the truth.

Each function draws the records of the runs of a table, by their names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from myork.bench.page import draw_curves
from myork.bench.tables import plot
from myork.records import Labels
from myork.report.figures import COLOURS
from myork.types import F64, I32

#: Muscle, fat, connective tissue, as in the labels 1 to 3
_TISSUES = {"muscle": "#B5524A", "fat": "#EFD27A", "connective tissue": "#3B6FB6"}
#: In truth and found, missed, found beyond the truth
_AGREEMENT = {"found": "#009E73", "missed": "#D55E00", "too much": "#56B4E9"}
#: Force at full activation and mean Dice coefficient that were published
_FORCE = {"young": 68.76, "old": 37.74}  # [N]
_DICE, _DICE_OF_SLICES = 0.8744, {15: 0.90, 30: 0.84}


def gastrocnemius(records: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Two slices with the muscle found and the true one, and the Dice coefficient of each slice."""
    record = records["enriched"]
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    *panels, last = figure.subplots(1, 3, width_ratios=[1, 1, 1.3])
    for axes, number in zip(panels, _DICE_OF_SLICES, strict=True):
        k = record["slices"][number]
        _grey(axes, record["anatomy"], k)
        for name, colour, width in (("truth", "#FFD700", 2.2), ("found", COLOURS[1], 1.0)):
            labels = record[name]
            _outline(axes, labels.data[..., k], labels.spacing, colour, width)
        dice = record[f"dice_{number}"]
        axes.set_title(f"slice at {number}/33 of the height: Dice {dice:.3f}")
    handles = [
        Line2D([], [], color="#FFD700", linewidth=2.2, label="true outline"),
        Line2D([], [], color=COLOURS[1], linewidth=1.0, label="level sets"),
    ]
    panels[0].legend(handles=handles, loc="lower left", fontsize="small")
    slices = np.array(record["dice_by_slice"], float)
    height = (np.arange(slices.size) + 0.5) / slices.size * 33 + 0.5
    last.plot(height, slices, "o-", color=COLOURS[0], label="phantom, level sets")
    last.plot(
        list(_DICE_OF_SLICES), list(_DICE_OF_SLICES.values()), "s", color=COLOURS[1],
        label="published, single slices",
    )  # fmt: skip
    last.axhline(_DICE, color=COLOURS[1], linestyle="--", label="published, mean of 33 slices")
    last.set(
        xlabel="height, as number of the published slice [-]", ylabel="Dice coefficient [-]",
        ylim=(0.8, 1.005),
    )  # fmt: skip
    last.grid(color="#E5E5E5")
    last.legend(frameon=False, fontsize="small", loc="lower left")
    return figure


def connective_tissue(records: Mapping[str, Mapping[str, Any]]) -> Figure:
    """A slice of the image of connective tissue, where it was found, and all materials."""
    record = records["tissue"]
    k = record["image"].data.shape[2] // 2
    figure = Figure(figsize=(14.0, 4.3), layout="constrained")
    panels = figure.subplots(1, 4)
    _grey(panels[0], record["image"], k)
    panels[0].set_title("image of connective tissue")
    spacing = record["labels"].spacing
    truth = record["truth"].data[..., k] == 3
    ways = {
        "fuzzy clusters, as published": (record["clusters"][..., k], record["dice_clusters"]),
        "over muscle around": (record["labels"].data[..., k] == 3, record["connective_tissue"]),
    }
    for axes, (name, (found, dice)) in zip(panels[1:], ways.items(), strict=False):
        kinds = np.where(truth & found, 1, np.where(truth, 2, np.where(found, 3, 0)))
        _kinds(axes, kinds, spacing, list(_AGREEMENT.values()))
        axes.set_title(f"{name}: Dice {dice:.3f}")
    _kinds(panels[3], np.minimum(record["labels"].data[..., k], 4), spacing,
           [*_TISSUES.values(), "#444444"])  # fmt: skip
    panels[3].set_title("materials of the model")
    _patches(figure, {**_AGREEMENT, **_TISSUES, "bone": "#444444"})
    return figure


def young_and_old(records: Mapping[str, Mapping[str, Any]]) -> Figure:
    """The middle slice of both muscles at one scale, and force over activation."""
    figure = Figure(figsize=(12.5, 4.2), layout="constrained")
    panels = figure.subplots(1, 3, width_ratios=[1, 1, 1.4])
    boxes = []
    for axes, name in zip(panels, _FORCE, strict=False):
        labels = records[name]["labels"]
        k = labels.data.shape[2] // 2
        _kinds(axes, labels.data[..., k], labels.spacing, list(_TISSUES.values()))
        boxes.append(_box_of(labels, k))
        axes.set_title(f"{name}: {records[name]['images']['muscle']:.1f} cm³ of muscle")
    # one scale
    size = max(high - low for box in boxes for low, high in box)
    for axes, box in zip(panels, boxes, strict=False):
        middle = [(low + high) / 2 for low, high in box]
        axes.set(
            xlim=(middle[0] - size / 2 - 4, middle[0] + size / 2 + 4),
            ylim=(middle[1] - size / 2 - 4, middle[1] + size / 2 + 4),
        )
    _patches(figure, _TISSUES)
    axes = panels[2]
    for number, (name, published) in enumerate(_FORCE.items()):
        steps = [(0.0, 0.0)] + [
            (step["activation"], step["probes"]["top"]) for step in records[name]["history"]
        ]
        colour = COLOURS[number]
        axes.plot(*zip(*steps, strict=True), "o-", color=colour, label=f"{name}, σ_max 30 N/cm²")
        axes.plot([1.0], [published], "s", color=colour, markerfacecolor="none", markersize=9,
                  label=f"{name}, published: {published:g} N")  # fmt: skip
    ratio = records["old"]["force"] / records["young"]["force"]
    axes.set(
        xlabel="activation [-]", ylabel="force at the fixed end [N]", ylim=(0, None),
        title=f"old over young: {ratio:.3f}, published {_FORCE['old'] / _FORCE['young']:.3f}",
    )  # fmt: skip
    axes.grid(color="#E5E5E5")
    axes.legend(frameon=False, fontsize="small", loc="upper left")
    return figure


def both_fields(
    records: Mapping[str, Mapping[str, Any]], axes: tuple[int, int], name: str, exact: float
) -> Figure:
    """A component of the Cauchy stress in the deformed body, its middle plane, by both methods."""
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    planes = {}
    for form, record in records.items():
        depth = record["ends"][:, 2]
        middle = np.abs(depth - depth.mean()) < 0.01 * np.ptp(depth)
        planes[form] = record["ends"][middle], record["cauchy"][:, axes[0], axes[1]][middle]
    stresses = np.concatenate([stress for _, stress in planes.values()])
    # one scale without the corners, where stresses are singular; what is within 1 % has one colour
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
    """Stress in the middle and reaction over the load by both methods."""
    figure = Figure(figsize=(10.5, 4.0), layout="constrained")
    panels = figure.subplots(1, 2)
    labels = {"stress_zz": "σ_zz in the middle [N/cm²]", "reaction": "reaction [N]"}
    for axes, (probe, label) in zip(panels, labels.items(), strict=True):
        for number, (form, record) in enumerate(records.items()):
            steps = [(0.0, 0.0)] + [
                (step["activation"], abs(step["probes"][probe])) for step in record["history"]
            ]
            axes.plot(*zip(*steps, strict=True), ("o-", "s--")[number], color=COLOURS[number],
                      label=form.upper(), markerfacecolor="none")  # fmt: skip
        axes.set(xlabel="activation [-]", ylabel=label)
        axes.grid(color="#E5E5E5")
        axes.legend(frameon=False)
    return figure


def convergence(records: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Relative errors in L2 and H1 over source spacing and CPU time, by form."""
    cases = [
        {**case, "curve": f"{name}, {norm}", "error": case["errors"][f"relative_{norm}"]}
        for run, name in (("rates", "collocation, published"), ("auto", "default (Galerkin)"))
        for norm in ("L2", "H1")
        for case in records[run]["cases"]
    ]
    axes = {
        "h": "source spacing [unit of length of the deck]",
        "cpu_s": "CPU time of the whole run [s]",
    }
    return draw_curves(
        [plot("", (x, "relative error [-]"), cases, key, "error") for key, x in axes.items()]
    )


def _box_of(labels: Labels, k: int) -> list[tuple[float, float]]:
    """Range of the labels of a slice along both axes [mm]."""
    found = np.nonzero(labels.data[..., k])
    return [
        (float(i.min()) * step, float(i.max() + 1) * step)
        for i, step in zip(found, labels.spacing, strict=False)
    ]


def _extent(shape: Sequence[int], spacing: F64) -> tuple[float, float, float, float]:
    return 0.0, float(shape[0] * spacing[0]), 0.0, float(shape[1] * spacing[1])


def _grey(axes: Axes, image: Any, k: int) -> None:
    """A slice of an image in grey."""
    one = image.data[..., k]
    top = float(np.nanpercentile(image.data, 99.5))
    axes.imshow(one.T, origin="lower", extent=_extent(one.shape, image.spacing), cmap="gray",
                vmin=0.0, vmax=top)  # fmt: skip
    axes.set(xlabel="x [mm]", ylabel="y [mm]")


def _outline(axes: Axes, mask: I32, spacing: F64, colour: str, width: float) -> None:
    x, y = ((np.arange(n) + 0.5) * step for n, step in zip(mask.shape, spacing, strict=False))
    axes.contour(x, y, mask.T, levels=[0.5], colors=[colour], linewidths=width)


def _kinds(axes: Axes, kinds: I32, spacing: F64, colours: list[str]) -> None:
    """Voxels of a slice by their number, 0 is white."""
    axes.imshow(kinds.T, origin="lower", extent=_extent(kinds.shape, spacing),
                cmap=ListedColormap(["white", *colours]), vmin=-0.5, vmax=len(colours) + 0.5,
                interpolation="nearest")  # fmt: skip
    axes.set(xlabel="x [mm]", ylabel="y [mm]")


def _patches(figure: Figure, colours: Mapping[str, str]) -> None:
    """What the colours of areas are, below all panels."""
    handles = [Patch(color=colour, label=name) for name, colour in colours.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
