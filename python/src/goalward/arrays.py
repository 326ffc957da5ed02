"""Checks of arrays of numbers that others made: their shape, and the range of their values."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from goalward.error import Error

LARGEST_NUMBER = np.finfo(np.float32).max


def checked_numbers(found: ArrayLike, shape: tuple[int, ...], where: str, what: str) -> NDArray[np.float32]:
    """Return an array of finite numbers.

    Args:
        found: the numbers.
        shape: the shape that they must have.
        where: where they are from, for error messages.
        what: what they are, for error messages.

    Raises:
        Error: if the shape is another, or a number is not a finite float32; names the first such one.
    """
    array = checked_array(found, where, what)
    require(array.shape == shape, where, what, f"shape {shape}", array.shape)
    finite = np.isfinite(array) & (np.abs(array) <= LARGEST_NUMBER)
    require_all(finite, array, where, what, "a finite float32")
    return array.astype(np.float32)


def checked_choices(
    found: ArrayLike, shape: tuple[int, ...], count: int, where: str, what: str
) -> NDArray[np.uint8]:
    """Return an array of choices, such as the classes of cells.

    Args:
        found: the choices.
        shape: the shape that they must have.
        count: how many choices there are, at most 256.
        where: where they are from, for error messages.
        what: what they are, for error messages.

    Raises:
        Error: if the shape is another, or a value is not a whole number below `count`; names the first such
            one.
    """
    array = checked_array(found, where, what)
    require(array.shape == shape, where, what, f"shape {shape}", array.shape)
    whole = (array >= 0) & (array < count) & (array == np.floor(array))
    require_all(whole, array, where, what, f"a whole number below {count}")
    return array.astype(np.uint8)


def checked_array(found: ArrayLike, where: str, what: str) -> NDArray[Any]:
    """Return an array of any shape.

    Raises:
        Error: if its rows have differing lengths, or its values are neither numbers nor booleans.
    """
    try:
        array = np.asarray(found)
    except ValueError as cause:
        raise Error(f"{where}: {what}: expected one array, found rows of differing lengths") from cause
    require(array.dtype.kind in "biuf", where, what, "numbers", f"values of type {array.dtype}")
    return array


def require_all(holds: NDArray[np.bool_], array: NDArray[Any], where: str, what: str, expected: str) -> None:
    """Refuse an array that does not hold everywhere; name the first place where it does not."""
    if not holds.all():
        place = tuple(int(index) for index in np.argwhere(~holds)[0])
        require(False, where, f"{what}{list(place)}", expected, array[place])


def require(holds: object, where: str, what: str, expected: str, found: object) -> None:
    """Refuse what does not hold, with the place, what was expected and what was found."""
    if not holds:
        raise Error(f"{where}: {what}: expected {expected}, found {found}")
