"""Tests of Gymnasium actions as bytes: what is encoded is decoded to the same action."""

from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete, Space

from goalward.spaces import actions_of


def there_and_back(space: Space[Any], action: Any) -> Any:
    actions = actions_of(space)
    raw = np.frombuffer(actions.encode(action), dtype=np.uint8)
    [decoded] = actions.decode(raw[np.newaxis])
    return decoded


@pytest.mark.parametrize(("low", "high"), [(0, 9), (-7, 5), (0, 255), (3, 3)])
@pytest.mark.parametrize("kind", [np.int16, np.int64])
def test_every_whole_number_comes_back(low: int, high: int, kind: Any) -> None:
    space = Box(low, high, (1,), kind)
    for number in range(low, high + 1):
        found = there_and_back(space, np.array([number], kind))
        assert found == [number]
        assert found.dtype == kind


def test_numbers_are_between_their_bounds() -> None:
    actions = actions_of(Box(np.array([0.0, -1.0]), np.array([0.5, 3.0]), dtype=np.float64))
    raw = np.array([[-1, -1], [0, 0], [1, 1], [2, 0.5]], "<f4").view(np.uint8)
    np.testing.assert_array_equal(actions.decode(raw), [[0, -1], [0.25, 1], [0.5, 3], [0.5, 2]])


@pytest.mark.parametrize(
    "space",
    [
        Discrete(5),
        Discrete(4, start=-2),
        MultiBinary((2, 3)),
        MultiDiscrete([2, 3]),
        MultiDiscrete([2, 3], start=[-1, 5]),
        MultiDiscrete(np.array([[2, 3], [4, 2]]), start=np.array([[1, 2], [3, -4]])),
    ],
    ids=str,
)
def test_every_choice_is_of_its_space_and_comes_back(space: Space[Any]) -> None:
    actions = actions_of(space)
    count = actions.spec["discrete"]["count"]
    decoded = actions.decode(np.arange(count, dtype=np.uint8)[:, np.newaxis])
    assert all(space.contains(action) for action in decoded)
    assert [actions.encode(action) for action in decoded] == [bytes([number]) for number in range(count)]


@pytest.mark.parametrize("action", [[0, 5], [2, 5], [1, 4], [1, 8], [1], [1, 5, 5]])
def test_a_choice_outside_of_its_space_is_refused(action: list[int]) -> None:
    with pytest.raises(ValueError, match=r"action: expected one of MultiDiscrete.*, found \["):
        actions_of(MultiDiscrete([1, 3], start=[1, 5])).encode(action)


@pytest.mark.parametrize("space", [Discrete(3), Box(-1, 1, (2,))], ids=str)
@pytest.mark.parametrize("action", [None, "left", 1 << 70, [[0], [0, 1]], {}, 1j])
def test_what_is_no_number_is_refused(space: Space[Any], action: Any) -> None:
    with pytest.raises(ValueError, match="^action: expected one of"):
        actions_of(space).encode(action)


@pytest.mark.parametrize("action", [0.5, 1.0, np.float32(1)])
def test_a_choice_is_a_whole_number(action: Any) -> None:
    with pytest.raises(ValueError, match=r"^action: expected one of Discrete\(3\), found "):
        actions_of(Discrete(3)).encode(action)
