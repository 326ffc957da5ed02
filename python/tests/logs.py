"""Writes logs of runs in Goalward's format with the public MCAP package."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mcap.writer import Writer
from walks import REACH, walk

from goalward import Task, recorded, schema

TOPICS = {
    "/trajectory": "Trajectory",
    "/evaluation/trajectory": "Trajectory",
    "/proximity/score": "Score",
    "/policy/update": "PolicyUpdate",
    "/proximity/update": "RewardUpdate",
}
CONFIG = 'method = "goal-proximity"\nseed = 3\n[ppo]\nclip = 0.2\n'


def trajectory(iteration: int, lane: int, episode: int, steps: int, **changes: Any) -> Any:
    """Make an episode of the task `reach` whose observations are the walk with the seed `episode`."""
    values = {
        "task": REACH.name,
        "iteration": iteration,
        "lane": lane,
        "episode": episode,
        "policy_version": iteration,
        "steps": steps,
        "observation_shape": [3],
        "values": walk(steps, episode).ravel().tolist(),
        "continuous_actions": [0.25 * step for step in range(2 * steps)],
        "log_probs": [-0.5] * steps,
        "environment_rewards": [float(step) for step in range(steps)],
        "ending": schema.TRUNCATED,
    }
    return schema.Trajectory(**{**values, **changes})


def write(
    path: Path,
    messages: Iterable[tuple[str, Any]],
    task: Task = REACH,
    seed: int = 3,
    since: int = 0,
    config: str = CONFIG,
) -> None:
    """Write a log file with these topics and messages, a nanosecond apart from `since` on."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2048)
        writer.start(library="goalward/0.1.0")
        metadata = {"format_version": "1", "task": task.name, "seed": str(seed), "spec": task.to_json()}
        writer.add_metadata(recorded.RUN, {**metadata, "config": config})
        channels = {}
        for topic, name in TOPICS.items():
            kind = writer.register_schema(f"{schema.PACKAGE}.{name}", "protobuf", schema.DESCRIPTORS)
            channels[topic] = writer.register_channel(topic, "protobuf", kind)
        for time, (topic, message) in enumerate(messages, since):
            writer.add_message(channels[topic], time, message.SerializeToString(), time)
        writer.finish()  # type: ignore[no-untyped-call]
