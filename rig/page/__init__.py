"""The page of a run: served to this computer alone, to whoever has its token."""

from rig.page.server import PageServer

__all__ = ["PageServer"]
