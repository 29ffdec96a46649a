"""What README and docs point to is there: pages, headings, files of the tree, benchmarks."""

import re
from functools import cache
from pathlib import Path

import pytest

from myork.bench import BENCHES

ROOT = Path(__file__).parent.parent
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").rglob("*.ipynb")]
)
#: Where what stands in backquotes is a path of the tree
FOLDERS = ("docs", "fortran", "inputs", "notebooks", "pydriver", "tests", ".ci", "conda")


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


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_resolve(page: Path) -> None:
    wrong = []
    for target in re.findall(r"\]\(<?([^)\s>]+)>?\)", prose(page)):
        if re.match(r"[a-z]+:", target):
            assert target.startswith(("https://", "mailto:")), target
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        if not path.exists() or (anchor and anchor not in anchors(path)):
            wrong.append(target)
    assert not wrong, f"links to what is not there: {', '.join(wrong)}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_paths_are_there(page: Path) -> None:
    named = re.findall(rf"`((?:{'|'.join(map(re.escape, FOLDERS))})/[\w./*-]+)`", prose(page))
    wrong = [path for path in named if not any(ROOT.glob(path.rstrip("/")))]
    assert not wrong, f"no such file: {', '.join(wrong)}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_benchmarks_are_there(page: Path) -> None:
    """Numbers are traced by the benchmark that prints them: it must exist."""
    text = page.read_text(encoding="utf-8")
    named = {
        word
        for names in re.findall(r"myork bench ((?:[a-z_]+ ?)+)[`\n]", text)
        for word in names.split()
    }
    assert not named - set(BENCHES)
