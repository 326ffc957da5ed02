"""Tests whether the standard deviation of a run's ensemble ranks unfamiliar states above demonstrated ones.

For each kind of states it computes the mean standard deviation, and the probability that the deviation is
higher for one of them than for a state of the run's own demonstrations (AUROC): 0.5 if the two are not told
apart, 1 if all of them rank above. It also computes the mean proximity and, for the expert's states, which
have labels (Eq. 1), the mean absolute error of the proximity.

    pip install -r docs/results/requirements.txt ./python[policy]
    python docs/results/uncertainty.py GOALWARD SETTINGS RUN...

SETTINGS are those of the runs' settings that differ from the default, or empty. The rows replace those of the
same runs in `uncertainty.csv`.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy
import onnxruntime
from data import HERE, Row, read, write

from goalward import demonstrations
from goalward.log import Log

DATA = HERE / "uncertainty.csv"
# The columns that name a run.
RUN = ["task", "method", "settings", "steps", "seed"]
EPISODES = 200
# A seed that no run of the results uses.
SEED = 777
# Options that make demonstrations wider than those of the results' runs; they cover what the agent meets.
WIDER = {
    "navigation": ["--coverage", "1.0"],
    "fetch-push": ["--noise", "2.0"],
    "fetch-pick": ["--coverage", "1.0"],
    "ant-reach": ["--noise", "0.05"],
}


class Ensemble:
    """The exported ensemble of a run."""

    def __init__(self, goalward: str, run: Path, folder: Path) -> None:
        subprocess.run([goalward, "export", run, "--out", folder], check=True, capture_output=True)
        self.session = onnxruntime.InferenceSession(folder / "ensemble.onnx")

    def scores(self, episodes) -> tuple[numpy.ndarray, numpy.ndarray]:
        """Returns standard deviation and proximity of all observations of episodes, concatenated."""
        observations = numpy.concatenate([numpy.asarray(episode.observations) for episode in episodes])
        inputs = {self.session.get_inputs()[0].name: observations}
        deviation, proximity = self.session.run(["standard_deviation", "proximity"], inputs)
        return deviation.ravel(), proximity.ravel()


def recorded(goalward: str, task: str, file: Path, options: list[str]) -> list:
    """Records episodes of the task's expert that no run has seen."""
    command = [goalward, "demonstrate", task, "--episodes", str(EPISODES), "--seed", str(SEED), "--out", file]
    subprocess.run([*command, *options], check=True, capture_output=True)
    return demonstrations.read(file).episodes


def labels(reward: dict, episodes) -> numpy.ndarray:
    """Returns the target proximities of the expert's states (Eq. 1), whose episodes end at the goal."""
    lengths = [len(episode.observations) for episode in episodes]
    left = numpy.concatenate([numpy.arange(length)[::-1] for length in lengths])
    if reward["discounting"] == "exponential":
        return reward["delta"] ** left
    return numpy.maximum(1 - reward["delta"] * left, 0)


def auroc(others: numpy.ndarray, own: numpy.ndarray) -> float:
    """Returns the share of pairs in which the first value is larger; equal ones count half."""
    own = numpy.sort(own)
    below, not_above = numpy.searchsorted(own, others, "left"), numpy.searchsorted(own, others, "right")
    return float((below + not_above).mean() / (2 * len(own)))


def rows(goalward: str, settings: str, run: Path):
    """Yields a row for each kind of states."""
    log = Log(run)
    task = log.config["task"]["name"]
    named = [task, log.config["method"], settings, log.config["steps"], log.config["seed"]]
    demonstrated = log.config["demonstrations"]
    setting = [f"--{key}={demonstrated[key]}" for key in ("coverage", "noise") if key in demonstrated]
    training = list(log.trajectories("training"))
    # Runs of an experiment share their demonstrations.
    own = Path(demonstrated.get("file", run / "demonstrations.mcap"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ensemble = Ensemble(goalward, run, folder / "export")
        kinds = {
            "demonstrated": demonstrations.read(own).episodes,
            "expert, held out": recorded(goalward, task, folder / "same.mcap", setting),
            "expert, wider": recorded(goalward, task, folder / "wider.mcap", WIDER[task]),
            "agent, first": training[:EPISODES],
            "agent, last": training[-EPISODES:],
        }
        found = {kind: ensemble.scores(episodes) for kind, episodes in kinds.items()}
    for kind, (deviations, proximities) in found.items():
        row = dict(zip(RUN, map(str, named), strict=True)) | {
            "states": kind,
            "mean_standard_deviation": f"{deviations.mean():.4f}",
            "auroc": f"{auroc(deviations, found['demonstrated'][0]):.3f}",
            "mean_proximity": f"{proximities.mean():.4f}",
            "mean_error": "",
        }
        if not kind.startswith("agent"):
            errors = proximities - labels(log.config["reward"], kinds[kind])
            row["mean_error"] = f"{numpy.abs(errors).mean():.4f}"
        yield row


def place(row: Row) -> tuple:
    """Returns what identifies a run; rows are sorted and replaced by it."""
    task, method, settings, steps, seed = (row[column] for column in RUN)
    return task, method, settings, int(steps), int(seed)


def main(goalward: str, settings: str, *runs: str) -> None:
    """Replaces or adds the rows of all runs."""
    new = [row for run in runs for row in rows(goalward, settings, Path(run))]
    taken = set(map(place, new))
    if len(taken) < len(runs):
        sys.exit(f"expected runs of other tasks, methods, steps or seeds, found {len(taken)} of {len(runs)}")
    others = [row for row in read(DATA) if place(row) not in taken]
    write(DATA, sorted([*others, *new], key=place))


if __name__ == "__main__":
    main(*sys.argv[1:])
