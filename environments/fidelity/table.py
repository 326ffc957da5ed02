"""Rows of the comparison: the measure, MuJoCo, Goalward, and the difference."""

import numpy as np

HEAD = "| measure | MuJoCo | Goalward | difference |\n|---|---|---|---|"


def row(measure, *columns):
    return "| " + " | ".join([measure, *columns]) + " |"


def numbers(measure, mujoco, goalward, digits=1):
    """Returns the row of one number per side."""
    form = f"{{:z.{digits}f}}".format
    return row(measure, form(mujoco), form(goalward), signed(goalward - mujoco, digits))


def samples(measure, mujoco, goalward, digits=2):
    """Returns mean and standard deviation of paired episodes; the difference with its standard error."""
    form = f"{{:.{digits}f}} ({{:.{digits}f}})".format
    apart = np.subtract(goalward, mujoco)
    error = np.std(apart, ddof=1) / np.sqrt(len(apart))
    return row(
        measure,
        form(np.mean(mujoco), np.std(mujoco, ddof=1)),
        form(np.mean(goalward), np.std(goalward, ddof=1)),
        f"{signed(np.mean(apart), digits)} ± {error:.{digits}f}",
    )


def shares(measure, mujoco, goalward):
    """Returns how many episodes of each side have a property, and the difference in percentage points."""
    form = "{} of {}".format
    columns = [form(np.sum(episodes), len(episodes)) for episodes in (mujoco, goalward)]
    points = 100 * (np.mean(goalward) - np.mean(mujoco))
    return row(measure, *columns, f"{signed(points, 1)} points")


def signed(number, digits):
    return f"{number:+z.{digits}f}"


def section(title, text, rows):
    return f"## {title}\n\n{text}\n\n{HEAD}\n" + "\n".join(rows) + "\n"
