"""Draws success against environment steps: `overview.svg`, and each panel of the plans that a page shows.

    pip install -r docs/results/requirements.txt && python docs/results/overview.py

A page refers to a panel by the name `FIGURE-PANEL.svg`. The data are in `points.csv` and `runs.csv`. Lines
are means over seeds with 95 % intervals (Student's t). Right of their end each method has a column: a dash is
a seed's success in evaluation, a triangle the authors' published success. A method without environment steps
has only these.
"""

import io
import re

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from data import HERE, OPENING, PAGES, Curve, Row, curves, key, plans, read
from estimates import interval
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, PercentFormatter

# The colors of `goalward report` (deploy/report/src/chart.rs), black and purple.
COLORS = ["#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#6e6e6e", "#000000", "#7d3fb8"]
SETTINGS = {
    "svg.fonttype": "none",
    "svg.hashsalt": "goalward",
    "font.sans-serif": ["DejaVu Sans"],
    "axes.spines.top": False,
    "axes.spines.right": False,
}
# Where curves are interpolated, as shares of their steps; a run has a point at or after each twentieth.
GRID = np.linspace(0.05, 1.0, 20)
# Width of a method's column right of the curves, as a share of the steps.
COLUMN = 0.04

Panel = tuple[str, str]


def colors(panels: list[Panel]) -> dict[str, str]:
    """Assigns a color to each curve of some panels."""
    names = dict.fromkeys(name for panel in panels for name in plans()[panel].curves)
    return {name: COLORS[place % len(COLORS)] for place, name in enumerate(names)}


def draw(axes: Axes, panel: Panel, color: dict[str, str], points: list[Row]) -> None:
    """Draws a panel: every curve, and right of them the seeds' evaluations and the authors' success."""
    shown = curves(*panel)
    last = max(map(length, shown))
    right = (1.06 + COLUMN * len(shown)) * last
    axes.axvspan(1.02 * last, right, color="0.95", linewidth=0)
    for place, curve in enumerate(shown):
        style = {"color": color[curve.name], "clip_on": False}
        line(axes, curve, points, style)
        ends(axes, curve, (1.04 + COLUMN * place) * last, COLUMN * last, style)
    ticks = MaxNLocator(6, steps=[1, 5, 10]).tick_values(0, last)
    axes.set(title=plans()[panel].title, xlabel="million environment steps")
    axes.set(xlim=(0, right), xticks=[tick for tick in ticks if tick <= last])
    axes.set(ylim=(0, 1), yticks=[0, 0.25, 0.5, 0.75, 1])
    axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))


def ends(axes: Axes, curve: Curve, left: float, width: float, style: dict) -> None:
    """Draws a curve's column: a dash for each seed's evaluation, and to its right the authors' triangle."""
    dashes = [(x, share) for share in curve.rates for x in (left, left + 0.45 * width, np.nan)]
    axes.plot(*zip(*dashes, strict=True), linewidth=1, **style)
    if curve.authors is not None:
        axes.plot(left + 0.7 * width, curve.authors, "<", markersize=4.5, markeredgewidth=0, **style)


def line(axes: Axes, curve: Curve, points: list[Row], style: dict) -> None:
    """Draws the mean over seeds and its interval; nothing if there are no seeds."""
    seeds = trained(curve, points)
    if not seeds:
        return
    steps = GRID * length(curve)
    axes.plot(steps, np.mean(seeds, axis=0), **style)
    band = interval(np.array(seeds))
    if band is not None:
        low, high = band
        corners = np.append(steps, steps[::-1]), np.append(low, high[::-1])
        axes.fill(*corners, color=style["color"], alpha=0.2, linewidth=0)


def length(curve: Curve) -> float:
    """Returns the length of a curve in million steps."""
    return max(int(run["environment_steps"]) for run in curve.runs) / 1e6


def trained(curve: Curve, points: list[Row]) -> list[np.ndarray]:
    """Returns success of the last 100 training episodes at the grid's steps, for each seed with points."""
    found = []
    for run in curve.runs:
        own = [row for row in points if key(row) == key(run)]
        steps = [int(row["environment_steps"]) / 1e6 for row in own]
        if own:
            found.append(np.interp(GRID * length(curve), steps, [float(row["success_rate"]) for row in own]))
    return found


def legend(color: dict[str, str]) -> list[Artist]:
    """Returns the legend of colors and marks."""
    lines = [plt.Line2D([], [], color=shade, label=name) for name, shade in color.items()]
    marks = {"_": "evaluation of a seed", "<": "the authors' success"}
    style = {"color": "0.3", "linestyle": "none", "markersize": 5}
    return [*lines, *(plt.Line2D([], [], marker=mark, label=label, **style) for mark, label in marks.items())]


def save(figure: plt.Figure, name: str) -> None:
    """Writes a picture, with the same bytes each time."""
    text = io.StringIO()
    figure.savefig(text, metadata={"Date": None})
    plt.close(figure)
    # One decimal of a point is enough for numbers in tags. Text outside of tags stays as it is.
    text = re.sub(r"(\.\d)\d+(?=[^<]*>)", r"\1", text.getvalue())
    (HERE / name).write_text(re.sub(r" *\n *", "\n", text))


def draw_overview(points: list[Row]) -> None:
    """Draws the picture with which the results begin, with the opening panels."""
    figure, fields = plt.subplots(2, 3, figsize=(12, 6.6), sharey=True, layout="constrained")
    color = colors(OPENING)
    for axes, panel in zip(fields.flat, OPENING, strict=False):
        draw(axes, panel, color, points)
        axes.tick_params(left=axes in fields[:, 0])
    for axes in fields[:, 0]:
        axes.set_ylabel("success")
    fields.flat[-1].axis("off")
    fields.flat[-1].legend(handles=legend(color), loc="center", frameon=False)
    save(figure, "overview.svg")


def draw_panel(panel: Panel, points: list[Row]) -> None:
    """Draws one panel."""
    figure, axes = plt.subplots(figsize=(7.6, 4), layout="constrained")
    color = colors([other for other in plans() if other[0] == panel[0]])
    draw(axes, panel, color, points)
    axes.set_ylabel("success")
    shown = {curve.name: color[curve.name] for curve in curves(*panel)}
    figure.legend(handles=legend(shown), loc="outside right center", frameon=False)
    save(figure, f"{'-'.join(panel)}.svg")


def main() -> None:
    """Draws all pictures."""
    plt.rcParams.update(SETTINGS)
    points = read(HERE / "points.csv")
    draw_overview(points)
    pages = "".join(page.read_text() for page in PAGES)
    for panel in plans():
        if f"{'-'.join(panel)}.svg" in pages:
            draw_panel(panel, points)


if __name__ == "__main__":
    main()
