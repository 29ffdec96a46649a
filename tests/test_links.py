"""What README and docs point to is there: pages, headings, files of the tree, benchmarks."""

import re
from functools import cache
from pathlib import Path

import yaml

from myork.bench import BENCHES

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")])
#: Where what stands in backquotes is a path of the tree
FOLDERS = ["benchmarks", "docs", "examples", "fortran", "inputs", "notebooks", "pydriver", "tests"]
FOLDERS += [".ci", ".github", "conda"]


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def prose(page: Path) -> str:
    """Text without blocks of code and formulas."""
    text = page.read_text(encoding="utf-8")
    return re.sub(r"^(```|~~~).*?^\1$|\$\$.*?\$\$", "", text, flags=re.M | re.S)


@cache
def anchors(page: Path) -> set[str]:
    """Names of the headings, as GitHub and myst make them."""
    heads = re.findall(r"^#+ +(.+?) *$", prose(page), flags=re.M)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", head).lower() for head in heads]
    return {re.sub(r"[^\w\- ]", "", head).replace(" ", "-") for head in plain}


def test_links_resolve() -> None:
    wrong = []
    for page in PAGES:
        for target in re.findall(r"\]\(<?([^)\s>]+)>?\)", prose(page)):
            if re.match(r"[a-z]+:", target):
                if not target.startswith(("https://", "mailto:")):
                    wrong.append(f"{name_of(page)}: {target}")
                continue
            name, _, anchor = target.partition("#")
            path = (page.parent / name).resolve() if name else page
            if not path.exists() or (anchor and anchor not in anchors(path)):
                wrong.append(f"{name_of(page)}: {target}")
    assert not wrong, "\n".join(wrong)


def test_paths_and_benchmarks_are_there() -> None:
    """Paths in backquotes exist, and so do the benchmarks by which numbers are traced."""
    wrong = []
    for page in PAGES:
        text = prose(page)
        named = re.findall(rf"`((?:{'|'.join(map(re.escape, FOLDERS))})/[\w./*-]+)`", text)
        absent = [path for path in named if not any(ROOT.glob(path.rstrip("/")))]
        wrong += [f"{name_of(page)}: {path}" for path in absent]
        whole = page.read_text(encoding="utf-8")
        for names in re.findall(r"myork bench ((?:[a-z_]+ ?)+)[`\n]", whole):
            unknown = {*names.split()} - {*BENCHES, "all"}
            wrong += [f"{name_of(page)}: myork bench {name}" for name in unknown]
    assert not wrong, "\n".join(wrong)


def test_numbers_of_the_readme_are_those_of_the_pages() -> None:
    """What was measured stands on the page that its row names, as it was printed."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = text.split("## What has been measured")[1].split("\n## ")[0].splitlines()
    counted = 0
    for row in (row for row in rows if row.startswith("| ") and "](" in row):
        *_, found, printed, pages = row.strip("| ").split(" | ")
        assert re.search("myork (?:bench|reproduce)|benchmarks/", printed), row
        linked = re.findall(r"\]\(([^)]+)\)", pages)
        there = "".join((ROOT / page).read_text(encoding="utf-8") for page in linked)
        for number in re.findall(r"\d+\.\d+(?:e-?\d+)?", found):
            assert re.search(rf"(?<![\d.]){re.escape(number)}(?!\d)", there), f"{number}: {row}"
            counted += 1
    assert counted > 8


def test_the_citation_is_that_of_this_version() -> None:
    """CITATION.cff, pyproject's licence and meson's version agree; what is cited is complete."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    meson = (ROOT / "meson.build").read_text(encoding="utf-8")
    assert f"version: '{cited['version']}'" in meson
    assert f"license: '{cited['license']}'" in meson
    needed = {"cff-version", "message", "title", "type", "abstract", "keywords", "authors"}
    assert needed <= set(cited) and cited["references"][0]["url"].startswith("https://")


def test_the_recipe_needs_what_the_package_needs() -> None:
    """Run-time needs of the conda recipe are those of pyproject.toml."""
    recipe = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    run = recipe.split("  run:\n")[1].split("\n\n")[0].replace("matplotlib-base", "matplotlib")
    listed = {line.strip("- ").replace(" ", "") for line in run.splitlines()} - {"python"}
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    needs = re.search(r"^dependencies = \[(.*?)\]", project, re.M | re.S)
    assert needs is not None and listed == set(re.findall(r'"([^"]+)"', needs[1]))
