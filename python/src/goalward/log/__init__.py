"""The logs of runs: episodes, steps, updates and scores in NumPy, and trajectories for other tools."""

from goalward.log.lerobot import write_lerobot
from goalward.log.minari import write_minari
from goalward.log.run import IncompleteLog, Log
from goalward.log.tables import Columns, to_pandas, to_polars
from goalward.log.trajectory import Trajectory

__all__ = [
    "Columns",
    "IncompleteLog",
    "Log",
    "Trajectory",
    "to_pandas",
    "to_polars",
    "write_lerobot",
    "write_minari",
]
