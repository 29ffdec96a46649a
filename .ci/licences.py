"""Put the licences of bundled libraries into a wheel: licences.py WHEEL FOLDER.

`auditwheel repair` copies libraries of the system into the wheel. Who passes them on passes on
their licences: the copyright file of each library's Debian package goes to `licenses/`, with a
table of versions and sources. MyoRK is under the MIT licence. SuiteSparse's sparse QR, UMFPACK and
supernodal Cholesky are under GPL-2+: the wheel holds them, says so in its metadata and is passed on
under the GPL as a whole; version 3, as METIS and OpenSSL (Apache-2.0) do not go with version 2.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

PLACES = ("/lib/x86_64-linux-gnu", "/usr/lib/x86_64-linux-gnu", "/usr/lib", "/lib")
HEAD = """\
# Libraries in this wheel

Copied from Debian packages, unchanged but for names and search paths. Their licences are the files
beside this one; `apt-get source SOURCE=VERSION` and snapshot.debian.org have their sources.

MyoRK itself is under the MIT licence (LICENSE). This wheel holds SPQR, UMFPACK and the supernodal
Cholesky of SuiteSparse, which are under GPL-2+: as a whole it is passed on under the GNU General
Public License, version 3 or later.

| library | package | version | source |
|---|---|---|---|
"""


def run(*command: str | Path) -> str:
    """Output of a command that must succeed."""
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def system_file(bundled: Path) -> Path:
    """The file of the system that `auditwheel` copied: without the sum in the name."""
    name = re.sub(r"-[0-9a-f]{8}(?=\.)", "", bundled.name)
    for place in PLACES:
        for folder in (Path(place), *sorted(Path(place).glob("*blas*"))):
            if (folder / name).exists():
                return (folder / name).resolve()
    sys.exit(f"{bundled.name}: {name} is in none of {', '.join(PLACES)}")


def package_of(file: Path) -> str:
    """Debian package of a file, whose record may name it without /usr."""
    for name in (str(file), str(file).removeprefix("/usr")):
        found = subprocess.run(["dpkg", "-S", name], capture_output=True, text=True, check=False)
        if found.returncode == 0:
            return found.stdout.split(": ")[0].split(",")[0]
    sys.exit(f"{file} belongs to no package: where is its licence?")


def mark(metadata: Path) -> None:
    """Say in the metadata what the whole is under."""
    text = metadata.read_text(encoding="utf-8")
    marked = re.sub(r"^(License-Expression: MIT)$", r"\1 AND GPL-3.0-or-later", text, flags=re.M)
    if marked == text:
        sys.exit(f"{metadata}: no licence to mark")
    metadata.write_text(marked, encoding="utf-8")


def main(wheel: Path, out: Path) -> None:
    """Write the wheel with its licences into a folder."""
    with tempfile.TemporaryDirectory() as folder:
        run(sys.executable, "-m", "wheel", "unpack", "-d", folder, wheel)
        (tree,) = Path(folder).iterdir()
        (info,) = tree.glob("*.dist-info")
        licences = info / "licenses"
        licences.mkdir(exist_ok=True)
        rows = []
        libraries = sorted(tree.glob("*.libs/*.so*"))
        for library in libraries:
            package = package_of(system_file(library))
            name = package.split(":")[0]
            version, source = run(
                "dpkg-query", "-W", "-f", "${source:Version} ${source:Package}", package
            ).split()
            text = Path(f"/usr/share/doc/{name}/copyright").read_bytes()
            (licences / f"{name}.copyright").write_bytes(text)
            rows.append(f"| {library.name} | {name} | {version} | {source} |\n")
        mark(info / "METADATA")
        for number in (2, 3):
            text = Path(f"/usr/share/common-licenses/GPL-{number}").read_bytes()
            (licences / f"GPL-{number}").write_bytes(text)
        table = HEAD + "".join(rows)
        (licences / "BUNDLED.md").write_text(table, encoding="utf-8")
        out.mkdir(parents=True, exist_ok=True)
        run(sys.executable, "-m", "wheel", "pack", "-d", out, tree)
    print(f"{len(libraries)} libraries, marked GPL-3.0-or-later")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
