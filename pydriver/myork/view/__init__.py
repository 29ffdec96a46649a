"""A reduced model with sliders: a local page, or a page of sampled states that needs no server."""

from myork.view.server import serve
from myork.view.still import still_page

__all__ = ["serve", "still_page"]
