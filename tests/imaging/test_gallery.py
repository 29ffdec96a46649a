"""The examples of the gallery: right answers, pictures and a page."""

import json

from myork.bench import run_benches


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
    ours = bench["timing"]["runs"][0]
    for rival in bench["timing"]["runs"][1:]:
        # The same minimum, up to a pixel here and there on the rim
        assert ours["energy"] < 1.005 * rival["energy"]
