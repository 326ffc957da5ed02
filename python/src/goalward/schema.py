"""The protobuf messages of Goalward, made from the compiled schema in the package."""

from importlib import resources
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

PACKAGE = "goalward.v1"

DESCRIPTORS: bytes = resources.files("goalward").joinpath("goalward.bin").read_bytes()
"""The serialized `FileDescriptorSet`, which is also the schema record of an MCAP file."""


def _pool() -> descriptor_pool.DescriptorPool:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(DESCRIPTORS).file:
        pool.Add(file)
    return pool


_POOL = _pool()


def _message(name: str) -> Any:
    descriptor = _POOL.FindMessageTypeByName(f"{PACKAGE}.{name}")
    return message_factory.GetMessageClass(descriptor)


Trajectory = _message("Trajectory")
Score = _message("Score")
PolicyUpdate = _message("PolicyUpdate")
RewardUpdate = _message("RewardUpdate")

TRAINING, EVALUATION, DEMONSTRATION = range(3)
"""Values of `Trajectory.source`."""

GOAL_REACHED, TRUNCATED, FAILED = range(3)
"""Values of `Trajectory.ending`."""
