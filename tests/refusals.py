"""What tests of refusals share."""

from collections.abc import Callable
from typing import Any

import pytest

from myork.errors import InputError


def refuses(
    said: str, call: Callable[..., Any], *args: Any, kind: Any = InputError, **keys: Any
) -> str:
    """A call with these arguments ends in an error of a kind, or of one of some, that says so.

    Returns all that it says.
    """
    with pytest.raises(kind, match=said) as caught:
        call(*args, **keys)
    return str(caught.value)
