"""Tests of demonstration files: they are read as written, and what Goalward would refuse is not written."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory
from walks import REACH, ROOMS, rooms, walk

from goalward import Cells, Discrete, Error, Task, Vector, recorded, schema
from goalward.demonstrations import Episode, read, write
from goalward.demonstrations import file as file_of_demonstrations


def test_numbers_are_read_as_they_were_written(tmp_path: Path) -> None:
    file = tmp_path / "reach.mcap"
    actions = np.linspace(-1, 1, 10, dtype=np.float32).reshape(5, 2)
    rewards = np.arange(5, dtype=np.float32)
    write(file, [Episode(walk(5, 0), actions, rewards), Episode(walk(5, 1), actions)], REACH, seed=7)
    found = read(file)
    assert found.task == REACH
    assert found.metadata["seed"] == "7"
    first, second = found.episodes
    np.testing.assert_array_equal(first.observations, walk(5, 0))
    np.testing.assert_array_equal(first.actions, actions)
    np.testing.assert_array_equal(first.rewards, rewards)
    np.testing.assert_array_equal(second.observations, walk(5, 1))
    assert second.rewards is None


def recorded_by_goalward(file: Path, actions: list[float], setting: str) -> None:
    """Write a file as Goalward does: with the numbers before they were scaled, and with the setting."""
    plain = file.with_suffix(".plain")
    write(plain, [Episode(walk(2, 0), np.zeros((2, 2)))], REACH)
    opened = recorded.RecordedFile(plain)
    message = schema.Trajectory.FromString(next(opened.messages()).data)
    message.continuous_actions[:] = actions
    with file.open("wb") as target:
        metadata = {**opened.metadata, "setting": setting}
        file_of_demonstrations._write(target, metadata, [message.SerializeToString()])


@pytest.mark.parametrize(
    ("scale", "acted"),
    [("[0.5, 2.0]", [[0.5, 0.5], [1, -1]]), ("[]", [[1, 0.25], [1, -1]])],
)
def test_actions_that_are_read_and_written_still_act_alike(
    tmp_path: Path, scale: str, acted: list[list[float]]
) -> None:
    file, again = tmp_path / "reach.mcap", tmp_path / "again.mcap"
    recorded_by_goalward(file, [1.0, 0.25, 4.0, -3.0], f'{{"noise": 1.0, "action_scale": {scale}}}')
    found = read(file)
    np.testing.assert_array_equal(found.episodes[0].actions, acted)
    write(again, found.episodes, found.task)
    np.testing.assert_array_equal(read(again).episodes[0].actions, acted)
    assert "setting" not in read(again).metadata


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("{", "reach.mcap: expected metadata `setting` in JSON, found "),
        ("[]", "reach.mcap: setting: expected a JSON object, found list"),
        ('{"action_scale": [0.5]}', "action_scale: expected 2 factors, found 1"),
    ],
)
def test_a_setting_that_does_not_fit_is_refused(tmp_path: Path, setting: str, expected: str) -> None:
    recorded_by_goalward(tmp_path / "reach.mcap", [0.0] * 4, setting)
    with pytest.raises(Error, match=expected):
        read(tmp_path / "reach.mcap")


def test_grids_are_read_as_they_were_written(tmp_path: Path) -> None:
    file = tmp_path / "rooms.mcap"
    choices = np.array([0, 3, 1], np.uint8)
    write(file, [Episode(rooms(3, 0), choices, steps_to_goal=2)], ROOMS)
    episode = read(file).episodes[0]
    np.testing.assert_array_equal(episode.observations, rooms(3, 0))
    np.testing.assert_array_equal(episode.actions, choices)
    assert episode.steps_to_goal == 2


def test_a_demonstration_of_states_ends_at_the_goal(tmp_path: Path) -> None:
    file = tmp_path / "states.mcap"
    write(file, [Episode(walk(5, 0))], REACH)
    with file.open("rb") as opened:
        reader = make_reader(opened, validate_crcs=True, decoder_factories=[DecoderFactory()])
        [message] = [decoded for *_, decoded in reader.iter_decoded_messages()]
    assert (message.task, message.source, message.steps) == ("reach", 2, 5)
    assert (message.success, message.steps_to_goal, message.ending) == (True, 5, 0)
    assert (list(message.observation_shape), len(message.values)) == ([3], 18)
    assert not message.continuous_actions and not message.log_probs


def test_metadata_is_the_first_record(tmp_path: Path) -> None:
    file = tmp_path / "states.mcap"
    write(file, [Episode(walk(5, 0))], REACH)
    with file.open("rb") as opened:
        records = StreamReader(opened).records
        names = [type(next(records)).__name__ for _ in range(2)]
    assert names == ["Header", "Metadata"]
    opened_again = recorded.RecordedFile(file)
    assert opened_again.kind == recorded.DEMONSTRATIONS
    assert Task.from_json(opened_again.metadata["spec"]) == REACH


def test_the_same_demonstrations_are_the_same_file(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(tmp_path / name, [Episode(walk(5, 0))], REACH)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_task_that_does_not_tell_success_has_demonstrations_without(tmp_path: Path) -> None:
    task = Task("drift", Vector(3), Discrete(2), 20, tells_success=False)
    write(tmp_path / "drift.mcap", [Episode(walk(5, 0))], task)
    message = next(recorded.RecordedFile(tmp_path / "drift.mcap").messages())
    decoded = schema.Trajectory.FromString(message.data)
    assert (decoded.success, decoded.steps_to_goal, decoded.ending) == (False, 0, 1)


def changed(rows: Any, place: tuple[int, ...], value: Any) -> Any:
    rows = rows.astype(np.float64)
    rows[place] = value
    return rows


@pytest.mark.parametrize(
    ("task", "episode", "expected"),
    [
        (
            REACH,
            Episode(changed(walk(5, 0), (2, 1), np.nan)),
            "episode 1: observations[2, 1]: expected a finite float32, found nan",
        ),
        (
            REACH,
            Episode(changed(walk(5, 0), (0, 0), 1e300)),
            "episode 1: observations[0, 0]: expected a finite float32, found 1e+300",
        ),
        (
            REACH,
            Episode(walk(5, 0)[:, :2]),
            "episode 1: observations: expected shape (6, 3), found (6, 2)",
        ),
        (
            REACH,
            Episode(walk(0, 0)),
            "episode 1: steps: expected 1 to 20, the horizon of reach, found 0",
        ),
        (
            REACH,
            Episode(walk(21, 0), name="seven"),
            "episode seven: steps: expected 1 to 20, the horizon of reach, found 21",
        ),
        (
            REACH,
            Episode([[1.0, 2.0, 3.0], [1.0]]),
            "episode 1: observations: expected one array, found rows of differing lengths",
        ),
        (
            REACH,
            Episode([["a", "b", "c"]] * 3),
            "episode 1: observations: expected numbers, found values of type <U1",
        ),
        (
            ROOMS,
            Episode(changed(rooms(5, 0), (3, 1, 4), 3)),
            "episode 1: observations[3, 1, 4]: expected a whole number below 3, found 3.0",
        ),
        (
            REACH,
            Episode(walk(5, 0), steps_to_goal=6),
            "episode 1: steps_to_goal: expected 1 to 5, found 6",
        ),
        (
            REACH,
            Episode(walk(5, 0), rewards=[1.0]),
            "episode 1: rewards: expected shape (5,), found (1,)",
        ),
        (
            REACH,
            Episode(walk(5, 0), actions=changed(np.zeros((5, 2)), (2, 1), -1.5)),
            "episode 1: actions[2, 1]: expected a number in [-1, 1], found -1.5",
        ),
        (
            REACH,
            Episode(walk(5, 0), actions=np.zeros((5, 2))),
            "episode 1: expected no actions as before, found some",
        ),
    ],
)
def test_what_does_not_fit_the_task_is_refused_in_one_line(
    tmp_path: Path, task: Task, episode: Episode, expected: str
) -> None:
    fitting = Episode(rooms(5, 0) if isinstance(task.observation, Cells) else walk(5, 0))
    with pytest.raises(Error) as refusal:
        write(tmp_path / "file.mcap", [fitting, episode], task)
    assert str(refusal.value) == expected
    assert list(tmp_path.iterdir()) == []


def test_choices_that_the_task_lacks_are_refused(tmp_path: Path) -> None:
    with pytest.raises(Error, match=r"actions\[2\]: expected a whole number below 4, found 4"):
        write(tmp_path / "file.mcap", [Episode(rooms(3, 0), [0, 1, 4])], ROOMS)


def test_no_demonstration_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Error, match="expected at least one episode, found none"):
        write(tmp_path / "file.mcap", [], REACH)
    assert list(tmp_path.iterdir()) == []


def test_a_demonstration_that_is_too_large_is_refused(tmp_path: Path) -> None:
    task = Task("wide", Vector(200_000), Discrete(2), 60)
    long = Episode(np.zeros((51, 200_000), np.float32))
    with pytest.raises(Error, match="episode 0: expected up to 33554432 bytes, found 408"):
        write(tmp_path / "file.mcap", [long], task)


def test_demonstrations_that_are_too_large_together_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_of_demonstrations, "MOST_BYTES", 2000)
    with pytest.raises(Error, match="episode 2: expected up to 2000 bytes with those before, found 2"):
        write(tmp_path / "file.mcap", [Episode(walk(20, number)) for number in range(9)], REACH)
    assert list(tmp_path.iterdir()) == []


def test_a_seed_that_files_cannot_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Error, match="seed: expected a number from 0 to 18446744073709551615, found -1"):
        write(tmp_path / "file.mcap", [Episode(walk(5, 0))], REACH, seed=-1)


def test_a_file_that_is_there_is_replaced_only_when_asked(tmp_path: Path) -> None:
    file = tmp_path / "file.mcap"
    write(file, [Episode(walk(5, 0))], REACH)
    before = file.read_bytes()
    with pytest.raises(Error, match="expected no such file or folder, found one"):
        write(file, [Episode(walk(6, 1))], REACH)
    assert file.read_bytes() == before
    write(file, [Episode(walk(6, 1))], REACH, overwrite=True)
    np.testing.assert_array_equal(read(file).episodes[0].observations, walk(6, 1))
    assert list(tmp_path.iterdir()) == [file]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(Error, match=r"none/file.mcap: expected to write the file, found .*No such file"):
        write(tmp_path / "none" / "file.mcap", [Episode(walk(5, 0))], REACH)


@pytest.mark.parametrize("keep", [0.1, 0.5, 0.9])
def test_a_file_that_lost_its_end_is_refused(tmp_path: Path, keep: float) -> None:
    file = tmp_path / "file.mcap"
    write(file, [Episode(walk(20, number)) for number in range(50)], REACH)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(keep * len(whole))])
    with pytest.raises(Error) as refusal:
        read(file)
    assert "expected" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_file_with_a_changed_byte_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file.mcap"
    write(file, [Episode(walk(20, number)) for number in range(50)], REACH)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(Error, match="expected a whole file, found it damaged behind byte"):
        read(file)


def test_a_file_of_somebody_else_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file.mcap"
    file.write_bytes(b"not MCAP at all, but long enough to be read as if it were")
    with pytest.raises(Error, match="expected metadata `goalward.run` or `goalward.demonstrations`"):
        read(file)
