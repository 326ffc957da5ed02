"""Measures how often uniformly random actions succeed in the opening panels, into `random_policy.csv`.

pip install -r docs/results/requirements.txt "./python[envs]"
python docs/results/random_policy.py     # with goalward-actor on the path
"""

import gymnasium
from data import HERE, OPENING, Row, plans, write

from goalward.envs import TASKS

EPISODES = 10_000
ENVIRONMENT = "environment."


def measured(figure: str, panel: str) -> Row:
    """Plays the episodes of a panel; their seeds are 0 and on, that of the actions is 1."""
    curves = plans()[figure, panel].curves
    settings = dict(curves["goal-proximity"].settings)
    keywords = {
        key.removeprefix(ENVIRONMENT): value for key, value in settings.items() if key.startswith(ENVIRONMENT)
    }
    task = settings["task.name"]
    name = next(name for name, of in TASKS.items() if of == task)
    environment = gymnasium.make(name, **keywords)
    environment.action_space.seed(1)
    rate = sum(succeeds(environment, seed) for seed in range(EPISODES)) / EPISODES
    print(figure, panel, rate)
    return {
        "panel": panel,
        "task": task,
        "settings": "",
        "seed": "1",
        "episodes": str(EPISODES),
        "success_rate": f"{rate:.4f}",
    }


def succeeds(environment: gymnasium.Env, seed: int) -> bool:
    """Plays an episode of random actions and returns whether it reaches the goal."""
    environment.reset(seed=seed)
    terminated = truncated = reached = False
    while not (terminated or truncated):
        action = environment.action_space.sample()
        _, _, terminated, truncated, info = environment.step(action)
        reached = reached or info["is_success"]
    return reached


if __name__ == "__main__":
    write(HERE / "random_policy.csv", [measured(*panel) for panel in OPENING])
