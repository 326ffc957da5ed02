"""Demonstrations: made from data sets, written to files for `goalward train`, and read from them."""

from goalward.demonstrations.episode import Episode
from goalward.demonstrations.file import Demonstrations, read, write
from goalward.demonstrations.formats import FORMATS, Loaded, load

__all__ = ["FORMATS", "Demonstrations", "Episode", "Loaded", "load", "read", "write"]
