"""Measures steps per second of whole training runs against the number of actors.

Usage: scaling.py [ROUNDS]

    pip install -r docs/results/requirements.txt ./python

It trains short runs of two tasks in turns, with one actor up to twice as many as cores, and measures steps
per second from the first policy update to the last. It checks that all runs of a task end with the same
weights. It writes scaling.csv (every run) and scaling.svg beside this file, and prints a table.
"""

import csv
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt

from goalward.log import Log

HERE = pathlib.Path(__file__).resolve().parent
RUN_LOCAL = HERE.parents[1] / "deploy/run_local.sh"
CORES = len(os.sched_getaffinity(0))
STEPS = {"navigation": 80_000, "ant-reach": 48_000}


def steps_per_second(updates):
    """Returns the environment steps per second from the first policy update of a run to the last."""
    steps, seconds = updates["environment_steps"], updates["wall_s"]
    return (steps[-1] - steps[0]) / (seconds[-1] - seconds[0])


def train(task, actors, folder):
    """Trains a short run; returns its steps per second and its policy's hash."""
    command = [RUN_LOCAL, task, "--steps", str(STEPS[task]), "--actors", str(actors), "--run", folder]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    summary = json.loads((pathlib.Path(folder) / "summary.json").read_text())
    return steps_per_second(Log(folder).updates()), summary["policy_sha256"]


def measure(rounds):
    """Yields rows of task, actors, round and steps per second."""
    hashes = {}
    for number in range(rounds):
        for task in STEPS:
            for actors in range(1, 2 * CORES + 1):
                with tempfile.TemporaryDirectory() as folder:
                    rate, sha256 = train(task, actors, f"{folder}/run")
                if hashes.setdefault(task, sha256) != sha256:
                    sys.exit(f"{task}: {actors} actors made other weights: {sha256}")
                yield [task, actors, number, round(rate)]


def draw(rows):
    figure, axes = plt.subplots(figsize=(6, 3.6))
    for task in STEPS:
        counts = sorted({row[1] for row in rows})
        rates = {n: [row[3] for row in rows if row[:2] == [task, n]] for n in counts}
        means = [statistics.mean(rates[n]) for n in counts]
        (line,) = axes.plot(counts, means, marker="o", label=task)
        for n in counts:
            axes.plot([n] * len(rates[n]), rates[n], ".", color=line.get_color(), alpha=0.4)
            speedup = statistics.mean(rates[n]) / means[0]
            print(f"| {task} | {n} | {statistics.mean(rates[n]):,.0f} | {speedup:.2f} |")
    axes.set(xlabel=f"actors, on {CORES} cores", ylabel="environment steps per second", ylim=(0, None))
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.legend()
    figure.tight_layout()
    figure.savefig(HERE / "scaling.svg")


def main():
    rows = list(measure(int(sys.argv[1]) if len(sys.argv) > 1 else 2))
    with open(HERE / "scaling.csv", "w", newline="") as file:
        csv.writer(file).writerows([["task", "actors", "round", "steps_per_s"], *rows])
    draw(rows)


if __name__ == "__main__":
    main()
