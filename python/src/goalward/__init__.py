"""Goalward in Python: demonstrations from data sets, logs in NumPy, exported policies, environments."""

from goalward.error import Error
from goalward.task import Cells, Continuous, Discrete, Task, Vector
from goalward.version import __version__

__all__ = ["Cells", "Continuous", "Discrete", "Error", "Task", "Vector", "__version__"]
