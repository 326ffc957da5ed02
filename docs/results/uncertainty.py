"""Does the standard deviation of a run's ensemble rank unfamiliar states above demonstrated ones?

For each kind of states: the mean, and the probability that it is higher for one of them than for a state of
the run's own demonstrations (AUROC): 0.5 where the two are not told apart, 1 where all of them are ranked
above.

    pip install ./python[policy] && python docs/results/uncertainty.py GOALWARD OUT.csv RUN...
"""

import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy
import onnxruntime

from goalward import demonstrations
from goalward.log import Log

EPISODES = 200
# A seed that no run of the results has.
SEED = 777
# What demonstrations are wider with than those of the results' runs, which cover what the agent meets.
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

    def standard_deviation(self, episodes) -> numpy.ndarray:
        """Of all observations of episodes, one after another."""
        observations = numpy.concatenate([numpy.asarray(episode.observations) for episode in episodes])
        [found] = self.session.run(["standard_deviation"], {self.session.get_inputs()[0].name: observations})
        return found.ravel()


def recorded(goalward: str, task: str, file: Path, options: list[str]) -> list:
    """Episodes of the task's expert that no run has seen."""
    command = [goalward, "demonstrate", task, "--episodes", str(EPISODES), "--seed", str(SEED), "--out", file]
    subprocess.run([*command, *options], check=True, capture_output=True)
    return demonstrations.read(file).episodes


def auroc(others: numpy.ndarray, own: numpy.ndarray) -> float:
    """The share of pairs in which the first is larger, equal ones counting half."""
    own = numpy.sort(own)
    below, not_above = numpy.searchsorted(own, others, "left"), numpy.searchsorted(own, others, "right")
    return float((below + not_above).mean() / (2 * len(own)))


def rows(goalward: str, run: Path):
    """A row for each kind of states."""
    log = Log(run)
    task = log.config["task"]["name"]
    demonstrated = log.config["demonstrations"]
    setting = [f"--{key}={demonstrated[key]}" for key in ("coverage", "noise") if key in demonstrated]
    training = list(log.trajectories("training"))
    # Runs of an experiment share theirs.
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
        found = {kind: ensemble.standard_deviation(episodes) for kind, episodes in kinds.items()}
    for kind, values in found.items():
        ranked = auroc(values, found["demonstrated"])
        yield task, log.config["seed"], kind, f"{values.mean():.4f}", f"{ranked:.3f}"


def main(goalward: str, out: str, *runs: str) -> None:
    """Writes the rows of all runs."""
    with open(out, "w", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(["task", "seed", "states", "mean_standard_deviation", "auroc"])
        for run in runs:
            lines.writerows(rows(goalward, Path(run)))


main(*sys.argv[1:])
