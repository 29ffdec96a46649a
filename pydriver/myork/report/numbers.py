"""Numbers of a report as HTML, and their units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

__all__ = ["DASH", "fraction", "number", "unit_of", "with_error"]

DASH = "–"
_MINUS = "\u2212"


def number(value: Any, digits: int = 4) -> Markup:
    """A number as HTML, powers of ten written out; what is not one becomes a dash.

    Parameters
    ----------
    value : Any
        Number, list of numbers (written in brackets) or None.
    digits : int
        Significant digits.

    Returns
    -------
    Markup
        HTML.
    """
    if isinstance(value, (list, tuple)):
        return Markup("({})").format(Markup(", ").join(number(part, digits) for part in value))
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return Markup(DASH)
    if isinstance(value, int):
        return Markup(f"{value:,}".replace(",", "\u202f").replace("-", _MINUS))
    if 10 ** (digits - 1) <= abs(value) < 1e6:
        rounded = round(value, digits - 1 - math.floor(math.log10(abs(value))))
        return number(int(rounded))
    text = f"{value:#.{digits}g}"
    mantissa, _, power = text.partition("e")
    mantissa = mantissa.removesuffix(".").replace("-", _MINUS)
    if not power:
        return Markup(mantissa)
    return Markup(f"{mantissa}·10<sup>{int(power)}</sup>".replace("<sup>-", f"<sup>{_MINUS}"))


def with_error(value: Any, error: Any) -> Markup:
    """A value with its estimated error behind it, where there is one; rounding below it is 0."""
    if error is None:
        return number(value)
    return Markup("{} ± {}").format(number(_resolved(value, error)), number(error, 2))


def _resolved(value: Any, error: Any) -> Any:
    """The value, 0 for each part that is far below its error."""
    if isinstance(value, (list, tuple)) and isinstance(error, (list, tuple)):
        return [_resolved(*pair) for pair in zip(value, error, strict=False)]
    if isinstance(value, float) and isinstance(error, float) and abs(value) < 1e-6 * error:
        return 0
    return value


def fraction(value: Any) -> str:
    """A load or an activation: given numbers, so no zeros are added to show their precision."""
    return f"{value:.4g}" if isinstance(value, (int, float)) else DASH


def unit_of(quantity: str, units: Mapping[str, str], dimension: int = 3) -> str:
    """Unit of a probed quantity as plain text.

    Parameters
    ----------
    quantity : str
        As in the deck: `u_x`, `J`, `cauchy_xy`, `pressure`, `force_z`, `torque_z`, ...
    units : Mapping
        Units of the deck, keys `force` and `length`.
    dimension : int
        2 (plane strain: forces are per unit of thickness) or 3.

    Returns
    -------
    str
        Unit; `?` for a quantity or unit that is not known.
    """
    force, length = units.get("force", "?"), units.get("length", "?")
    if quantity == "u" or quantity.startswith("u_"):
        return length
    if quantity == "J":
        return "-"
    if quantity == "pressure" or quantity.startswith(("cauchy", "principal")):
        return f"{force}/{length}²"
    if quantity.startswith("torque"):
        return f"{force} {length}" if dimension == 3 else force
    if quantity.startswith(("force", "section_force")):
        return force if dimension == 3 else f"{force}/{length}"
    return "?"
