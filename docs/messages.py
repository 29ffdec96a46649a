"""Every error and warning of the sources, by module: `python docs/messages.py` prints them.

What a message fills in is written as `{name}`. The site has the list below `docs/messages.md`.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
#: Calls that a message is an argument of, in Fortran, in C++ and in Python
_FORTRAN = re.compile(r"\b(?:fatal_error|%?warn|%?note|%?object|%?compare)\((?=.*?['\"])", re.I)
_CPP = re.compile(r"\b(?:complain|refuse|report)\((?=[^;]*\")", re.S)
_PYTHON = re.compile(r"(Error|warn|append|progress|refuse\w*)$")


def _words(pieces: list[str]) -> str:
    """Text of a concatenation of literals and expressions."""
    text = ""
    for piece in pieces:
        piece = piece.strip()
        if re.fullmatch(r"(['\"]).*\1", piece, re.S):
            text += piece[1:-1].replace("''", "'").replace('\\"', '"')
        elif piece:
            # a(b(i)%c(:, k), 2) is c
            piece = re.sub(r"^(to_text|trim|adjustl|repr|str|', '.join)\(", "", piece)
            piece = re.sub(r"\[[^\]]*\]|\([^()]*\)|_wp\b|['\"].*?['\"]", "", piece)
            names = re.findall(r"[A-Za-z]\w*", piece.split(",")[0])
            text += "; " if piece == "new_line" else "{" + (names[-1] if names else "") + "}"
    return re.sub(r"\s+", " ", text).strip()


def _split(text: str, at: str) -> list[str]:
    """Parts of an expression between separators that stand in no bracket and no literal."""
    parts, depth, quote, start, i = [], 0, "", 0, 0
    while i < len(text) and depth >= 0:
        char = text[i]
        if quote:
            i += char == "\\" and at == "+"
            quote = "" if char == quote else quote
        elif char in "'\"":
            quote = char
        elif depth == 0 and text.startswith(at, i):
            parts.append(text[start:i])
            i += len(at) - 1
            start = i + 1
        depth += 0 if quote else (char in "([{") - (char in ")]}")
        i += 1
    return [*parts, text[start : i - (depth < 0)]]


def _compiled(path: Path) -> Iterator[str]:
    fortran = path.suffix == ".f90"
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"^ *!.*\n" if fortran else r"^ *//.*\n", "", text, flags=re.M)
    text = re.sub(r" *&\n *&", "", text) if fortran else re.sub(r'"\s*\n\s*"', "", text)
    for call in (_FORTRAN if fortran else _CPP).finditer(text):
        for argument in _split(text[call.end() :], ","):
            found = _words(_split(argument, "//" if fortran else "+"))
            if " " in re.sub(r"{\w*}", "", found).strip():
                yield found


def _python(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        name = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
        if not (isinstance(node, ast.Call) and _PYTHON.search(name)):
            continue
        for argument in node.args[:1]:
            if isinstance(argument, ast.JoinedStr | ast.Constant):
                parts = argument.values if isinstance(argument, ast.JoinedStr) else [argument]
                text = "".join(
                    str(part.value) if isinstance(part, ast.Constant)
                    else _words([ast.unparse(part.value)]) for part in parts
                    if isinstance(part, ast.Constant | ast.FormattedValue)
                )  # fmt: skip
                if " " in text.strip() and ("progress" not in name or "warning" in text):
                    yield re.sub(r"\s+", " ", text)


def messages() -> dict[str, list[str]]:
    """Messages by the file they are in, in its order."""
    sources = sorted([*ROOT.glob("fortran/**/*.f90"), *ROOT.glob("fortran/**/*.cpp")])
    found = {path: list(dict.fromkeys(_compiled(path))) for path in sources}
    for path in sorted(ROOT.glob("pydriver/myork/**/*.py")):
        found[path] = list(dict.fromkeys(_python(path)))
    return {str(path.relative_to(ROOT)): texts for path, texts in found.items() if texts}


def page() -> str:
    """The list in Markdown, a block for each file."""
    blocks = (f"## {name}\n\n```text\n" + "\n".join(t) + "\n```" for name, t in messages().items())
    return "\n\n".join(blocks) + "\n"


if __name__ == "__main__":
    print(page(), end="")
