"""What to do where a shared library of the compiled parts is missing."""

import re

_MISSING = re.compile(r"(lib[\w.+-]+): cannot open shared object file")


def cure_of(complaint: str) -> str:
    """What to do about a complaint of the loader.

    - `complaint`: text of an exception, or what a program said that did not start
    - returns a sentence without a full stop
    """
    found = _MISSING.search(complaint)
    if found is None:
        return "install again (sh setup.sh, or pip install --force-reinstall)"
    return (
        f"the library {found[1]} is not on this machine, or another version of it: sh setup.sh "
        "installs it and builds again"
    )
