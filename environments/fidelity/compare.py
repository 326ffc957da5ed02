"""Measures Goalward's rapier tasks against MuJoCo and writes the table into docs/fidelity.md.

Usage: compare.py [--episodes 200] [--out docs/fidelity.md]
"""

import argparse
import datetime
import pathlib
import platform

import ant_measures
import fetch_measures
import mujoco
import table
from policy import ANT_EXPERT, Policy
from speed import speed

HERE = pathlib.Path(__file__).resolve().parent

INTRODUCTION = """\
# How near the physics is to MuJoCo

Goalward steps Fetch Pick, Fetch Push and Ant Reach in rapier; the paper uses MuJoCo. Here both
simulators play the same episodes: Goalward draws every start and goal, MuJoCo is set to them, and
the same actions, or the same expert, act on both sides. Fetch in MuJoCo is the scene of
gymnasium-robotics. The ant is built from the numbers of the authors' model, without the goal
marker, which touches nothing.

Measured {date}, MuJoCo {mujoco}, {machine}, with:

```
{commands}
```
"""

COMMANDS = """\
pip install -r environments/fidelity/requirements.txt
python environments/fidelity/compare.py"""


def sections(arguments):
    """Yields the tables, from the smallest movement to the whole task."""
    yield table.section(
        "Fetch: gripper, fingers and cube",
        "Every row begins at an episode's start, with the cube in the middle of its range. An action of "
        "1 asks for 50 mm. In the push the closed fingers start in front of the cube and are driven "
        "into it.",
        fetch_measures.gripper() + fetch_measures.fingers() + fetch_measures.push() + fetch_measures.press(),
    )
    rows = fetch_measures.hold(arguments.episodes)
    for task in ["fetch-pick", "fetch-push"]:
        rows += fetch_measures.experts(task, arguments.episodes)
    for task in ["fetch-pick", "fetch-push"]:
        rows += fetch_measures.random_actions(task, arguments.episodes)
    yield table.section(
        "Fetch: experts and random actions",
        "Mean and standard deviation over episodes. Differences are between the same episodes on "
        "both sides, ± the standard error of their mean. Goalward's own expert is compared with the "
        "authors' in MuJoCo.",
        rows,
    )
    yield table.section(
        "Ant: passive, and under the same torques",
        f"Errors are distances from MuJoCo's trajectory (RK4, 0.02 s), means over fifty steps and "
        f"{ant_measures.SEQUENCES} sequences of random torques up to the amplitude. The column MuJoCo "
        "has MuJoCo's own error at a timestep of 0.005 s: the effect of the timestep alone on the "
        "same model.",
        ant_measures.settling() + ant_measures.torque_sequences(),
    )
    yield table.section(
        "Ant: a whole episode",
        f"{arguments.episodes} episodes; mean and standard deviation, differences as above. The depth "
        "is how deep the lowest capsule or ball is in the floor, after any step of the episode.",
        ant_measures.random_torques(arguments.episodes)
        + ant_measures.expert(Policy(ANT_EXPERT), arguments.episodes),
    )
    yield table.section(
        "Speed",
        "Processor time of one thread, both sides in turns: median, minimum and maximum of seven "
        "rounds, and the median of their ratios. Goalward's steps write the observation and include "
        "resets; `mj_step` alone does neither. Ant-v5 is Gymnasium's own ant: the same legs and motors "
        "at half the timestep, so 0.05 s a step, with contact forces in its observation.",
        speed(),
    )


def machine():
    with open("/proc/cpuinfo") as file:
        names = [line.split(":")[1].strip() for line in file if line.startswith("model name")]
    return f"{names[0]}, {platform.system()}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--out", type=pathlib.Path, default=HERE.parents[1] / "docs/fidelity.md")
    arguments = parser.parse_args()
    introduction = INTRODUCTION.format(
        date=datetime.date.today(), mujoco=mujoco.__version__, machine=machine(), commands=COMMANDS
    )
    reading = (HERE / "reading.md").read_text()
    arguments.out.write_text("\n".join([introduction, *sections(arguments), reading]))


if __name__ == "__main__":
    main()
