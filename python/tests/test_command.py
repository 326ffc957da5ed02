"""Tests of the command line: what it prints, which files it leaves, and its exit status."""

import sys
from pathlib import Path

import numpy as np
import pytest
from walks import REACH, walk

from goalward.demonstrations import read
from goalward.demonstrations.__main__ import main

TASK = """
[task]
name = "reach"
observation = { vector = { len = 3 } }
action = { continuous = { len = 2 } }
horizon_steps = 20
"""
INFO = '{"codebase_version": "v3.0", "features": {}}'


@pytest.fixture
def task(tmp_path: Path) -> Path:
    (tmp_path / "reach.toml").write_text(TASK)
    return tmp_path / "reach.toml"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    states = np.stack([walk(6, number) for number in range(4)])
    np.savez(tmp_path / "walks.npz", states=states, success=[True, True, False, True])
    return tmp_path / "walks.npz"


def test_a_data_set_becomes_a_file_and_the_next_command_is_told(
    source: Path, task: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "reach.mcap"
    assert main(["import", str(source), "--task", str(task), "--out", str(out)]) == 0
    line = capsys.readouterr().out
    assert line.count("\n") == 1
    assert f"{out}: 3 episodes with 18 steps, 1 left out; next: goalward train {task}" in line
    assert f"--demonstrations {out} --set demonstrations.episodes=3" in line
    assert [len(np.asarray(episode.observations)) for episode in read(out).episodes] == [7, 7, 7]


def test_the_task_may_be_json(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "reach.mcap"
    words = ["import", str(source), "--task-json", REACH.to_json(), "--out", str(out), "--success", "all"]
    assert main([*words, "--episodes", "2", "--keys", "states", "--format", "npz"]) == 0
    assert "2 episodes with 12 steps, 0 left out" in capsys.readouterr().out
    assert read(out).task == REACH


def test_actions_are_taken_where_their_key_is_named(
    task: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    states = np.stack([walk(6, number) for number in range(2)])
    moves = np.random.default_rng(1).uniform(-1, 1, (2, 6, 2)).astype(np.float32)
    np.savez(tmp_path / "walks.npz", states=states, moves=moves, success=[[0] * 4 + [1] * 3] * 2)
    out = tmp_path / "reach.mcap"
    words = ["import", str(tmp_path / "walks.npz"), "--task", str(task), "--out", str(out)]
    assert main([*words, "--actions", "moves"]) == 0
    assert "2 episodes with 8 steps and their actions" in capsys.readouterr().out
    for episode, acted in zip(read(out).episodes, moves, strict=True):
        np.testing.assert_array_equal(np.asarray(episode.actions), acted[:4])
    assert main([*words, "--overwrite"]) == 0
    assert read(out).episodes[0].actions is None


def test_info_says_what_a_file_holds(
    source: Path, task: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "reach.mcap"
    main(["import", str(source), "--task", str(task), "--out", str(out)])
    capsys.readouterr()
    assert main(["info", str(out)]) == 0
    expected = "3 episodes of reach with 18 steps (6 to 6 each), observations of 3, states only"
    assert capsys.readouterr().out == f"{out}: {expected}\n"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--keys", "angle"], "episode 0: keys: expected `angle`, found states (3)"),
        (["--success", "won"], "episode 0: success: expected `all` or a success key"),
        (["--format", "lerobot"], "info.json: expected what LeRobot writes there"),
    ],
)
def test_input_that_cannot_be_used_is_told_in_one_line(
    source: Path,
    task: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    expected: str,
) -> None:
    out = tmp_path / "reach.mcap"
    before = sorted(tmp_path.iterdir())
    assert main(["import", str(source), "--task", str(task), "--out", str(out), *words]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("goalward: ") and told.err.count("\n") == 1
    assert expected in told.err
    assert sorted(tmp_path.iterdir()) == before


def test_a_file_that_is_there_is_kept_unless_it_may_be_replaced(
    source: Path, task: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "reach.mcap"
    out.write_text("mine")
    words = ["import", str(source), "--task", str(task), "--out", str(out)]
    assert main(words) == 2
    assert "expected no such file or folder, found one" in capsys.readouterr().err
    assert out.read_text() == "mine"
    assert main([*words, "--overwrite"]) == 0
    assert len(read(out).episodes) == 3


def test_an_episode_of_no_length_is_told_in_one_line(
    task: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "walks.npz"
    np.savez(source, states=np.zeros((3, 5, 3)), success=np.ones(3), lengths=[5, 0, 3])
    assert main(["import", str(source), "--task", str(task), "--out", str(tmp_path / "x.mcap")]) == 2
    expected = f"{source}: episode 1: lengths: expected a number from 1 to 5, found 0"
    assert capsys.readouterr().err == f"goalward: {expected}\n"


@pytest.mark.parametrize("name", ["none.npz", "notes.txt"])
def test_a_source_of_no_format_is_refused(
    task: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / "notes.txt").write_text("")
    words = ["import", str(tmp_path / name), "--task", str(task), "--out", str(tmp_path / "x.mcap")]
    assert main(words) == 2
    assert f"{name}: expected a" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("files", "package", "extra"),
    [
        ({"a.hdf5": ""}, "h5py", "robomimic"),
        ({"metadata.json": "{}"}, "minari", "minari"),
        ({"meta/info.json": INFO, "data/chunk-000/file-000.parquet": ""}, "pyarrow", "lerobot"),
    ],
)
def test_a_missing_package_is_told_with_the_command_that_installs_it(
    task: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    files: dict[str, str],
    package: str,
    extra: str,
) -> None:
    folder = tmp_path / "set"
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    source = folder / "a.hdf5" if "a.hdf5" in files else folder
    monkeypatch.setitem(sys.modules, package, None)
    assert main(["import", str(source), "--task", str(task), "--out", str(tmp_path / "x.mcap")]) == 2
    assert f"pip install 'goalward[{extra}]'" in capsys.readouterr().err
