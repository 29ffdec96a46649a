"""The examples of the gallery: right answers, pictures and a page."""

import json

import pytest

from myork.bench import run_benches

pytestmark = pytest.mark.nightly


def test_examples_of_the_gallery(tmp_path):
    run_benches(["gallery"], tmp_path, quick=True)
    bench = json.loads((tmp_path / "bench.json").read_text())["benches"]["gallery"]
    page = (tmp_path / "bench.html").read_text()
    for picture in bench["pictures"]:
        assert (tmp_path / picture["file"]).stat().st_size > 1000
        assert picture["file"] in page
    cases = {case["name"]: case for case in bench["cases"]}
    # Rims are a pixel of noise; the examples have 96 x 96 pixels.
    assert all(case["dice"] > 0.96 for case in cases.values() if "dice" in case)
    assert cases["bias field by level sets"]["correlation"] > 0.98
    areas = [case["area"] for case in cases.values() if "area" in case]
    assert areas == sorted(areas, reverse=True)
    # figures 4.2 and 4.3: a larger weight of the misfit, more homogeneous pieces
    few, many = (cases[f"weight of the misfit, lambda = {x}, circles"] for x in (0.02, 2))
    assert few["pieces"] < many["pieces"] and few["grouped"] < many["grouped"]
    runs = bench["timing"]["runs"]
    ours = [run for run in runs if run["name"] == "MyoRK"][-1]
    rivals = [run for run in runs if run["name"] != "MyoRK"]
    assert ours["iterations"] < 300 and ours["dice"] > 0.96
    for key in ("energy", "one_sided_energy"):
        assert ours[key] < min(run[key] for run in rivals)
