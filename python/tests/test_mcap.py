"""Tests of robot recordings in MCAP: JSON, protobuf and CDR of ROS 2, in files and in folders of bags."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.struct_pb2 import ListValue, Value
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


def test_a_message_that_is_not_set_in_protobuf_has_no_numbers(tmp_path: Path) -> None:
    with (tmp_path / "one.mcap").open("wb") as file:
        writer = ProtobufWriter(file)
        for time in range(3):
            value = Value(list_value=ListValue(values=[Value(number_value=1.0)])) if time != 1 else Value()
            writer.write_message("/x", value, log_time=time)
        writer.finish()  # type: ignore[no-untyped-call]
    task = Task("line", Vector(1), REACH.action, 5)
    with pytest.raises(Error, match=r"message 2 of /x: expected .* as before, found none"):
        load(tmp_path / "one.mcap", task, keys=["/x.list_value.values.0.number_value"], success="all")


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


@pytest.mark.parametrize("first", [0, 1])
def test_several_topics_need_keys_whichever_speaks_first(tmp_path: Path, first: int) -> None:
    write_ros(tmp_path / "one.mcap", moments(0)[first:])
    listed = r"/done.data \(1\), /goal.pose.x \(1\), /goal.pose.y \(1\), /joints.position \(2\)"
    with pytest.raises(
        Error, match=rf"keys: expected some, the first of which sets the rate.* found {listed}$"
    ):
        load(tmp_path / "one.mcap", REACH, success="all")


def state(seed: int, *, fields: str = "xyz") -> list[Moment]:
    """Make three messages with the numbers of a walk, in this order of fields, and success after them."""
    rows = [dict(zip("xyz", numbers, strict=True)) for numbers in walk(2, seed).tolist()]
    heard: list[Moment] = [
        ("/state", time, {field: row[field] for field in fields}) for time, row in enumerate(rows)
    ]
    return [*heard, (DONE, 3, {"data": True})]


def test_a_topic_that_is_alone_but_for_the_signal_needs_no_keys(tmp_path: Path) -> None:
    write_json(tmp_path / "one.mcap", state(0))
    [episode] = load(tmp_path / "one.mcap", REACH, success="/done.data").episodes
    np.testing.assert_array_equal(episode.observations, walk(2, 0))


@pytest.mark.parametrize("keys", [None, ["/state"]])
def test_the_order_of_fields_is_that_of_the_first_bag(tmp_path: Path, keys: list[str] | None) -> None:
    write_json(tmp_path / "run_1.mcap", state(1))
    write_json(tmp_path / "run_2.mcap", state(2, fields="zxy"))
    for number, episode in enumerate(load(tmp_path, REACH, keys=keys, success="/done.data").episodes, 1):
        np.testing.assert_array_equal(episode.observations, walk(2, number))


def test_bags_of_other_keys_are_refused(tmp_path: Path) -> None:
    for name, topic in (("run_1", "/here"), ("run_2", "/there")):
        write_json(tmp_path / f"{name}.mcap", [(topic, time, {"at": [1.0, 2.0, time]}) for time in range(3)])
    expected = "episode run_2: keys: expected /here.at as before, found /there.at"
    with pytest.raises(Error, match=f"^{expected}$"):
        load(tmp_path, REACH, success="all")


def test_bags_whose_keys_have_other_lengths_are_refused(tmp_path: Path) -> None:
    for name, lengths in (("run_1", (1, 2)), ("run_2", (2, 1))):
        parts = dict(zip("ab", ([0.5] * length for length in lengths), strict=True))
        write_json(tmp_path / f"{name}.mcap", [("/state", time, parts) for time in range(3)])
    with pytest.raises(Error, match=r"run_2.mcap: message 1 of /state: expected /state.a \(1\) as before, "):
        load(tmp_path, REACH, keys=["/state.a", "/state.b"], success="all")


TAGS, TAG_KEYS = "/tags", ["/joints.position", "/tags.detections.0.x"]


def tagged(xs: list[float | None]) -> list[Moment]:
    """Make for each x a message with the tag that is seen, or with none, and one of joints."""
    heard: list[Moment] = []
    for time, x in enumerate(xs):
        heard.append((TAGS, 10 * time, {"detections": [] if x is None else [{"x": x}]}))
        heard.append((JOINTS, 10 * time + 5, {"position": [time, -time]}))
    return heard


def test_a_tag_that_is_lost_is_not_joined_with_another_moment(tmp_path: Path) -> None:
    write_json(tmp_path / "one.mcap", tagged([0.0, 1.0, None, None, 4.0, 5.0]))
    expected = r"one.mcap: message 3 of /tags: expected /tags.detections.0.x \(1\) as before, found none$"
    with pytest.raises(Error, match=expected):
        load(tmp_path / "one.mcap", REACH, keys=TAG_KEYS, success="all")


def test_a_number_that_is_null_is_not_joined_with_another_moment(tmp_path: Path) -> None:
    heard: list[Moment] = []
    for time, x in enumerate([0.0, 1.0, None, 3.0]):
        heard += [(GOAL, time, {"x": x}), (JOINTS, time, {"position": [0.0, 1.0]})]
    write_json(tmp_path / "one.mcap", heard)
    with pytest.raises(Error, match=r"message 3 of /goal: expected /goal.x \(1\) as before, found none$"):
        load(tmp_path / "one.mcap", REACH, keys=["/joints.position", "/goal.x"], success="all")


def test_observations_begin_once_every_key_has_numbers(tmp_path: Path) -> None:
    write_json(tmp_path / "one.mcap", tagged([None, 1.0, 2.0, 3.0]))
    [episode] = load(tmp_path / "one.mcap", REACH, keys=TAG_KEYS, success="all").episodes
    assert np.asarray(episode.observations).tolist() == [[1, -1, 1], [2, -2, 2], [3, -3, 3]]


def test_a_silent_topic_keeps_its_newest_numbers(tmp_path: Path) -> None:
    heard = [moment for moment in tagged([1.0, 2.0, 3.0, 4.0]) if moment[:2] not in ((TAGS, 10), (TAGS, 20))]
    write_json(tmp_path / "one.mcap", heard)
    [episode] = load(tmp_path / "one.mcap", REACH, keys=TAG_KEYS, success="all").episodes
    assert np.asarray(episode.observations)[:, 2].tolist() == [1, 1, 1, 4]


def test_a_bag_without_an_observation_is_refused(tmp_path: Path) -> None:
    write_json(tmp_path / "one.mcap", tagged([None, None, None, 4.0])[:-1])
    expected = "episode one: expected a message of /joints once all keys have numbers, found none"
    with pytest.raises(Error, match=expected):
        load(tmp_path / "one.mcap", REACH, keys=TAG_KEYS, success="all")


def test_a_bag_that_never_tells_success_failed(tmp_path: Path) -> None:
    write_json(tmp_path / "run_1.mcap", moments(1)[:-1])
    write_json(tmp_path / "run_2.mcap", moments(2))
    loaded = load(tmp_path, REACH, keys=KEYS, success="/done.data")
    assert [episode.name for episode in loaded.episodes] == ["run_2"]
    assert loaded.left_out == 1


def test_a_signal_that_no_bag_has_is_refused(tmp_path: Path) -> None:
    for number in (1, 2):
        write_json(tmp_path / f"run_{number}.mcap", moments(number))
    with pytest.raises(Error, match="success: expected `/done.won`, found /goal.pose.x, .*, /done.data$"):
        load(tmp_path, REACH, keys=KEYS, success="/done.won")


def test_a_missing_key_is_refused_with_those_there_are(tmp_path: Path) -> None:
    write_json(tmp_path / "one.mcap", moments(0))
    with pytest.raises(Error, match=r"episode one: keys: expected `/goal.angle`, found"):
        load(tmp_path / "one.mcap", REACH, keys=["/joints.position", "/goal.angle"], success="all")


def test_a_list_that_changes_its_length_is_refused(tmp_path: Path) -> None:
    heard: list[Moment] = [(JOINTS, time, {"position": [0.0] * (3 - time % 2)}) for time in range(4)]
    write_json(tmp_path / "one.mcap", heard)
    expected = (
        r"message 2 of /joints: expected /joints.position \(3\) as before, found /joints.position \(2\)"
    )
    with pytest.raises(Error, match=expected):
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
