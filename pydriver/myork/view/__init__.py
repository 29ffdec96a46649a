"""A reduced model to touch: a local page with sliders, and a small one that needs no server."""

from myork.view.server import serve

__all__ = ["serve"]
