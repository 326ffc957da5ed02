"""Draws the picture that opens the results: success against environment steps, a field for each panel.

    pip install -r docs/results/requirements.txt && python docs/results/overview.py

Data: `points.csv` and `curves.csv`. Lines are means over seeds with 95 % intervals (Student's), dots each seed's
success in evaluation; a method without environment steps has dots alone.
"""

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from rebuild import HERE, Row, place, read

PANELS = {
    ("figure4", "navigation-25"): "NAVIGATION, 25 % coverage",
    ("figure3", "navigation-50"): "NAVIGATION, 50 % coverage",
    ("figure3", "push-noise-2"): "FETCH PUSH, noise 2",
    ("figure3", "pick-50"): "FETCH PICK, 50 % coverage",
    ("figure3", "ant-noise-0.05"): "ANT REACH, noise 0.05",
}
METHODS = ["goal-proximity", "soft-push-back", "difference", "gaifo-s", "gaifo", "gail", "bco", "bc"]
# Student's 97.5 % quantiles for 2 to 5 seeds.
QUANTILES = {2: 12.706, 3: 4.303, 4: 3.182, 5: 2.776}
# Where a panel's curves are read; a run has a point at or after each twentieth of its steps.
GRID = np.linspace(0.05, 1.0, 20)


def draw(axes: Axes, panel: tuple[str, str], points: list[Row], runs: list[Row]) -> None:
    """A field: every method's curve and its seeds' evaluations."""
    points = [row for row in points if place(row)[:2] == panel]
    runs = [row for row in runs if place(row)[:2] == panel and row["evaluation_success_rate"]]
    last = max(int(row["environment_steps"]) for row in points)
    for index, method in enumerate(METHODS):
        color = f"C{index}"
        seeds = sorted({row["seed"] for row in runs if row["curve"] == method})
        curves = [curve(points, method, seed, last) for seed in seeds]
        curves = [values for values in curves if values is not None]
        if curves:
            mean = np.mean(curves, axis=0)
            axes.plot(GRID * last / 1e6, mean, color=color)
            if len(curves) > 1:
                half = QUANTILES[len(curves)] * np.std(curves, axis=0, ddof=1) / np.sqrt(len(curves))
                low, high = np.clip(mean - half, 0, 100), np.clip(mean + half, 0, 100)
                axes.fill_between(GRID * last / 1e6, low, high, color=color, alpha=0.15, linewidth=0)
        ends = [100 * float(row["evaluation_success_rate"]) for row in runs if row["curve"] == method]
        axes.plot([last / 1e6 * (1.03 + 0.02 * index)] * len(ends), ends, ".", color=color, markersize=4)
    axes.set(title=PANELS[panel], ylim=(0, 101), xlabel="million environment steps")


def curve(points: list[Row], method: str, seed: str, last: int) -> np.ndarray | None:
    """Success of the last 100 training episodes, per cent, at the grid's steps; none without such."""
    own = [row for row in points if row["curve"] == method and row["seed"] == seed]
    if len(own) < len(GRID) // 2:
        return None
    steps = [int(row["environment_steps"]) for row in own]
    return np.interp(GRID * last, steps, [100 * float(row["success_rate"]) for row in own])


def main() -> None:
    """Draws `overview.svg`."""
    points, runs = read("points.csv"), read("runs.csv")
    figure, fields = plt.subplots(2, 3, figsize=(12, 6.6), sharey=True)
    for axes, panel in zip(fields.flat, PANELS, strict=False):
        draw(axes, panel, points, runs)
    for row in fields:
        row[0].set_ylabel("success, %")
    legend = fields.flat[-1]
    legend.axis("off")
    lines = [plt.Line2D([], [], color=f"C{index}", label=method) for index, method in enumerate(METHODS)]
    legend.legend(handles=lines, loc="center", frameon=False)
    figure.tight_layout()
    figure.savefig(HERE / "overview.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
