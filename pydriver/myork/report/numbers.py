"""Numbers of a report as HTML, and their units."""

import math
from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

DASH = "–"
_MINUS = "\u2212"


def number(value: Any, digits: int = 4) -> Markup:
    """A number with significant digits as HTML, powers of ten written out.

    A list is put in brackets; a missing number becomes a dash.
    """
    if isinstance(value, (list, tuple)):
        return Markup("({})").format(Markup(", ").join(number(part, digits) for part in value))
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return Markup(DASH)
    if isinstance(value, int) or value == 0.0:
        value = int(value)
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
    """A value followed by its estimated error, if there is one."""
    if error is None:
        return number(value)
    return Markup("{} ± {}").format(number(value), number(error, 2))


def fraction(value: Any) -> str:
    """A load or an activation: these are given numbers, so no zeros are added to show precision."""
    return f"{value:.4g}" if isinstance(value, (int, float)) else DASH


def plain(value: Any) -> str:
    """A value of a deck."""
    if value is None:
        return DASH
    if isinstance(value, list):
        return f"({', '.join(plain(part) for part in value)})"
    number_ = isinstance(value, int | float) and not isinstance(value, bool)
    return fraction(value) if number_ else str(value)


def unit_of(units: Mapping[str, str], name: str, missing: str = "?") -> str:
    """A unit written by the solver, by its name, with raised powers."""
    return typeset(units.get(name, missing))


def typeset(text: str) -> str:
    """Text with raised powers in its units."""
    return text.replace("^2", "²").replace("^3", "³")


def probe_units(summary: Mapping[str, Any]) -> dict[str, str]:
    """Unit of each probe of a summary by name; empty for ratios."""
    return {name: typeset(unit) for name, unit in summary.get("probe_units", {}).items()}


def labelled(name: str, unit: str) -> str:
    """Name of a column or an axis with its unit, if it has one."""
    return f"{name} [{unit}]" if unit else name
