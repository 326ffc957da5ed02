"""Tests of robot recordings in MCAP: JSON, protobuf and CDR of ROS 2, in files and in folders of bags."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.wrappers_pb2 import BoolValue, FloatValue
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.writer import Writer as RosWriter
from walks import REACH, walk

from goalward import Error, Task, Vector
from goalward.demonstrations import load

Moment = tuple[str, int, Any]
JOINTS, GOAL, DONE = "/joints", "/goal", "/done"
KEYS = ["/joints.position", "/goal.pose.x"]
POSE = "geometry/Pose pose\n================\nMSG: geometry/Pose\nfloat64 x\nfloat64 y"


def moments(seed: int) -> list[Moment]:
    """Make a goal, three joint states, each followed by a new goal, and success after the last of them."""
    states = walk(2, seed)
    heard: list[Moment] = [(GOAL, 0, {"pose": {"x": float(states[0, 2]), "y": 9.0}})]
    for number, state in enumerate(states):
        heard.append((JOINTS, 10 * number + 5, {"position": state[:2].tolist(), "name": ["a", "b"]}))
        heard.append((GOAL, 10 * number + 9, {"pose": {"x": float(states[min(number + 1, 2), 2]), "y": 9.0}}))
    return [*heard, (DONE, 30, {"data": True})]


def write_json(path: Path, heard: list[Moment]) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {topic: writer.register_channel(topic, "json", schema) for topic, *_ in heard}
        for topic, time, values in heard:
            writer.add_message(channels[topic], time, json.dumps(values).encode(), time)
        writer.finish()  # type: ignore[no-untyped-call]


def write_ros(path: Path, heard: list[Moment]) -> None:
    with path.open("wb") as file:
        writer = RosWriter(file)
        schemas = {
            JOINTS: writer.register_msgdef("test/Joints", "string[] name\nfloat64[] position"),
            GOAL: writer.register_msgdef("test/Goal", POSE),
            DONE: writer.register_msgdef("test/Done", "bool data"),
        }
        for topic, time, values in heard:
            writer.write_message(topic, schemas[topic], values, log_time=time)
        writer.finish()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("written", [write_json, write_ros])
def test_a_bag_is_an_episode(tmp_path: Path, written: Callable[[Path, list[Moment]], None]) -> None:
    written(tmp_path / "one.mcap", moments(0))
    loaded = load(tmp_path / "one.mcap", REACH, keys=KEYS, success="/done.data")
    [episode] = loaded.episodes
    np.testing.assert_array_equal(episode.observations, walk(2, 0))


def test_protobuf_messages_are_read(tmp_path: Path) -> None:
    with (tmp_path / "one.mcap").open("wb") as file:
        writer = ProtobufWriter(file)
        for time, (x, done) in enumerate([(1.5, False), (2.5, False), (4.5, True), (5.5, True)]):
            writer.write_message("/done", BoolValue(value=done), log_time=2 * time)
            writer.write_message("/x", FloatValue(value=x), log_time=2 * time + 1)
        writer.finish()  # type: ignore[no-untyped-call]
    task = Task("line", Vector(1), REACH.action, 5)
    [episode] = load(tmp_path / "one.mcap", task, keys=["/x.value"], success="/done.value").episodes
    assert np.asarray(episode.observations).tolist() == [[1.5], [2.5], [4.5]]


def test_a_folder_of_files_has_an_episode_in_each(tmp_path: Path) -> None:
    for number in (10, 9):
        write_json(tmp_path / f"run_{number}.mcap", moments(number))
    loaded = load(tmp_path, REACH, keys=KEYS, success="all")
    assert [episode.name for episode in loaded.episodes] == ["run_9", "run_10"]
    for episode, number in zip(loaded.episodes, (9, 10), strict=True):
        np.testing.assert_array_equal(episode.observations, walk(2, number))


def test_a_bag_may_have_several_files(tmp_path: Path) -> None:
    heard = moments(0)
    for name, part in (("bag_0.mcap", heard[:4]), ("bag_1.mcap", heard[4:])):
        (tmp_path / "bag").mkdir(exist_ok=True)
        write_ros(tmp_path / "bag" / name, part)
    (tmp_path / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n")
    for source in (tmp_path, tmp_path / "bag"):
        [episode] = load(source, REACH, keys=KEYS, success="/done.data").episodes
        np.testing.assert_array_equal(episode.observations, walk(2, 0))


def test_a_message_stands_for_all_its_numbers(tmp_path: Path) -> None:
    write_ros(tmp_path / "one.mcap", moments(0))
    task = Task("wide", Vector(4), REACH.action, 5)
    [episode] = load(
        tmp_path / "one.mcap", task, keys=["/joints.position", "/goal.pose"], success="all"
    ).episodes
    np.testing.assert_array_equal(np.asarray(episode.observations)[:, 3], [9, 9, 9])


def test_without_keys_the_numbers_that_there_are_get_listed(tmp_path: Path) -> None:
    write_ros(tmp_path / "one.mcap", moments(0))
    listed = r"/goal.pose.x \(1\), /goal.pose.y \(1\), /joints.position \(2\)"
    with pytest.raises(Error, match=rf"expected 3 numbers, the observation of reach, found {listed}"):
        load(tmp_path / "one.mcap", REACH, success="all")


def test_a_missing_key_is_refused_with_those_there_are(tmp_path: Path) -> None:
    write_json(tmp_path / "one.mcap", moments(0))
    with pytest.raises(Error, match=r"episode one: keys: expected `/goal.angle`, found"):
        load(tmp_path / "one.mcap", REACH, keys=["/joints.position", "/goal.angle"], success="all")


def test_a_list_that_changes_its_length_is_refused(tmp_path: Path) -> None:
    heard: list[Moment] = [(JOINTS, time, {"position": [0.0] * (3 - time % 2)}) for time in range(4)]
    write_json(tmp_path / "one.mcap", heard)
    with pytest.raises(Error, match=r"/joints.position: expected as many numbers each time, found 2 to 3"):
        load(tmp_path / "one.mcap", REACH, keys=["/joints.position"], success="all")


@pytest.mark.parametrize("keep", [0.2, 0.8])
def test_a_bag_that_lost_its_end_is_refused(tmp_path: Path, keep: float) -> None:
    file = tmp_path / "one.mcap"
    write_ros(file, moments(0))
    data = file.read_bytes()
    file.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(Error, match=r"one.mcap: expected a whole MCAP file") as refusal:
        load(file, REACH, keys=KEYS, success="all")
    assert "\n" not in str(refusal.value)


def test_messages_that_cannot_be_decoded_are_refused(tmp_path: Path) -> None:
    with (tmp_path / "one.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("test/Joints", "ros2msg", b"float64[] 9position")
        channel = writer.register_channel(JOINTS, "cdr", schema)
        writer.add_message(channel, 0, b"", 0)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(Error, match="expected messages of /joints that can be decoded, found .*9position"):
        load(tmp_path / "one.mcap", REACH, keys=KEYS, success="all")


def test_a_bag_of_another_storage_is_refused_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n")
    (tmp_path / "bag_0.db3").write_text("")
    with pytest.raises(Error, match="expected MCAP files, found none; `ros2 bag convert`"):
        load(tmp_path, REACH, keys=KEYS, success="all")


def test_messages_of_another_encoding_are_refused(tmp_path: Path) -> None:
    with (tmp_path / "one.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/x", "cbor", 0)
        writer.add_message(channel, 0, b"", 0)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(Error, match="expected messages of CDR, protobuf or JSON, found cbor on /x"):
        load(tmp_path / "one.mcap", REACH, keys=["/x.y"], success="all")
