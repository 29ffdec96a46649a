"""Young and old muscle of three materials, thesis section 4.2.6, in small."""

from pathlib import Path

import pytest

from myork.bench import run_benches
from myork.bench.aging import OLD, YOUNG, labelled


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


def test_quick_study(tmp_path: Path):
    """Blocks of 5 mm: both ends carry the same force to rounding, and the forces of the muscles
    differ about as their muscle tissue does (finer blocks: docs/galerkin.md).
    """
    study = run_benches(["aging"], tmp_path, quick=True)["benches"]["aging"]
    (pair,) = study["pairs"]
    for case in pair["cases"]:
        assert case["outcome"] == "converged" and case["activation"][-1] == 1.0
        bottom, top = case["force"]
        assert all(abs(b + t) < 1e-9 * t for b, t in zip(bottom, top, strict=True))
        assert all(a < b for a, b in zip(top, top[1:], strict=False))
    assert pair["force_drop"] == pytest.approx(pair["volume_drop"], abs=0.05)
    assert (tmp_path / "bench.html").is_file()
