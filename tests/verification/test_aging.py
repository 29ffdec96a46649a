"""Young and old muscle of three materials, thesis section 4.2.6, in small."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from myork.bench import run_benches
from myork.bench.phantoms import OLD, YOUNG, labelled

pytestmark = pytest.mark.nightly


@pytest.mark.parametrize(
    "muscle, published", [(YOUNG, (98.93, 2.83, 20.86 + 37.3)), (OLD, (61.89, 6.15, 29.15 + 31.2))]
)
def test_volumes_are_those_of_table_4_3(muscle, published):
    """Muscle and fat by the phantom's parameters to their three digits; the layer is as thick as
    one number for both muscles allows: 3 % of all connective tissue.
    """
    labels, fiber = labelled(muscle)
    voxel = labels.spacing.prod() / 1000.0
    found = [float((labels.data == label).sum() * voxel) for label in (1, 2, 3)]
    assert found[:2] == pytest.approx(published[:2], rel=5e-3)
    assert found[2] == pytest.approx(published[2], rel=3e-2)
    assert (fiber.data.any(axis=-1) == (labels.data == 1)).all()


def test_random_arrangements_keep_the_volumes():
    """Each tissue in as many voxels as before, in other places, and the outer layer untouched."""
    (first, _), (second, fiber) = labelled(OLD), labelled(replace(OLD, seed=1))
    count = np.bincount(first.data.ravel())
    assert (np.bincount(second.data.ravel()) == count).all()
    assert ((first.data > 0) == (second.data > 0)).all()
    assert (fiber.data.any(axis=-1) == (second.data == 1)).all()
    bare = labelled(replace(OLD, layer=0.0))[0].data == 0
    assert (second.data == first.data)[bare].all()
    moved = (second.data != first.data).sum() / count[1:].sum()
    assert 0.1 < moved < 0.5


def test_quick_study(tmp_path: Path):
    """Blocks of 5 mm, finer ones in docs/galerkin.md. Both ends carry the same force to rounding.
    Where every point has its own fibers, the old muscle loses more of its force than of its
    volume: it has more interface with tissue that does not contract. Where the muscle's share
    takes the fibers of the nearest muscle, what contracts is the volume of the muscle, but for
    what the body's surface and ends cut off, and force follows it.
    """
    study = run_benches(["aging"], tmp_path, quick=True)["benches"]["aging"]
    own, nearest = study["pairs"]
    for case in [*own["cases"], *nearest["cases"]]:
        assert case["outcome"] == "converged" and case["activation"][-1] == 1.0
        bottom, top = case["force"]
        assert all(abs(b + t) < 1e-9 * t for b, t in zip(bottom, top, strict=True))
        assert all(a < b for a, b in zip(top, top[1:], strict=False))
    young, old = (case["interface"] / case["volume"]["muscle"] for case in own["cases"])
    assert old > 1.4 * young
    assert own["contracting_drop"] > own["volume_drop"] + 0.03
    assert own["force_drop"] > max(own["volume_drop"], own["images_drop"]) + 0.02
    for case in nearest["cases"]:
        assert case["contracting"] == pytest.approx(case["volume"]["muscle"], rel=0.015)
    assert nearest["force_drop"] == pytest.approx(nearest["volume_drop"], abs=0.025)
    assert (tmp_path / "bench.html").is_file()
