"""Goalward in Python: demonstrations made from data sets, and the logs of runs read into NumPy."""

from goalward.error import Error
from goalward.task import Cells, Continuous, Discrete, Task, Vector
from goalward.version import __version__

__all__ = ["Cells", "Continuous", "Discrete", "Error", "Task", "Vector", "__version__"]
