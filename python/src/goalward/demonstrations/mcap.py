"""Robot recordings: MCAP files, and rosbag2 folders that contain such files.

One bag is one episode. A key is a topic and a field path, such as `/joint_states.position`; a field that is
a message stands for all its numbers. Messages are encoded as CDR of ROS 2, protobuf or JSON. Each message of
the first key's topic gives one observation, which has the newest values of the other topics. Observations
begin once every topic has had a message.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Schema

from goalward.demonstrations.recordings import Recording, Wanted
from goalward.error import Error, expecting
from goalward.packages import optional
from goalward.recorded import DAMAGE

SUCCESS: tuple[str, ...] = ()
BAG = "metadata.yaml"
_DECODERS = {"cdr": "mcap_ros2.decoder", "protobuf": "mcap_protobuf.decoder"}

Numbers = dict[str, list[float]]


def recordings(source: Path, wanted: Wanted) -> Iterator[Recording]:
    """Read bags, each as one episode.

    Args:
        source: an MCAP file; a bag's folder, which has `metadata.yaml`; or a folder of either.
        wanted: the keys, the first of which sets the rate of observations; without keys, every number of
            every message. A signal is 0 before its first message.

    Raises:
        Error: if a file is damaged, lacks a key, or its messages cannot be decoded.
    """
    for name, files in _bags(source):
        yield _recording(name, files, wanted)


def _bags(source: Path) -> list[tuple[str, list[Path]]]:
    if source.is_file():
        return [(source.stem, [source])]
    if (source / BAG).exists():
        return [(source.name, _files(source))]
    folders = sorted((path.parent for path in source.glob(f"*/{BAG}")), key=_natural)
    if folders:
        return [(folder.name, _files(folder)) for folder in folders]
    return [(path.stem, [path]) for path in _files(source)]


def _files(folder: Path) -> list[Path]:
    files = sorted(folder.glob("*.mcap"), key=_natural)
    if not files:
        raise Error(
            f"{folder}: expected MCAP files, found none; `ros2 bag convert` makes them of other storage"
        )
    return files


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a key for natural sorting, because a bag's files are numbered without leading zeros."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _recording(name: str, files: Sequence[Path], wanted: Wanted) -> Recording:
    rows: dict[str, list[list[float]]] = {}
    told: list[float] = []
    newest: dict[str, Numbers] = {}
    pace: str | None = None
    for topic, numbers in chain.from_iterable(_messages(path, wanted) for path in files):
        newest[topic] = numbers
        pace = pace or (_topic(wanted.keys[0], newest) if wanted.keys else topic)
        if topic == pace:
            told.append(_told(newest, wanted))
            for key, values in _taken(newest, wanted).items():
                rows.setdefault(key, []).append(values)
    missing = next((key for key in wanted.keys or () if key not in rows), None)
    if missing is not None:
        heard = ", ".join(key for numbers in newest.values() for key in numbers) or "none"
        raise Error(f"episode {name}: keys: expected `{missing}`, found {heard}")
    shortest = min(map(len, rows.values()), default=0)
    arrays = {key: _array(name, key, values[-shortest:]) for key, values in rows.items()}
    signals = {key: array[:, 0] for key, array in arrays.items() if array.shape[1] == 1}
    if wanted.signal and _values(newest, wanted.signal):
        # A signal after the last observation counts for that observation.
        signals[wanted.signal] = np.array([*told[-shortest:-1], _told(newest, wanted)])
    return Recording(name, arrays, signals)


def _messages(path: Path, wanted: Wanted) -> Iterator[tuple[str, Numbers]]:
    decoders: dict[int, Callable[[bytes], Any]] = {}
    damage = expecting(f"{path}: expected a whole MCAP file", OSError, KeyError, *DAMAGE)
    with damage, path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if not _is_wanted(channel.topic, wanted):
                continue
            # A decoder may raise anything for a damaged schema or message.
            with expecting(f"{path}: expected messages of {channel.topic} that can be decoded", Exception):
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(path, channel, schema)
                decoded = decoders[channel.id](message.data)
            yield channel.topic, dict(_leaves(decoded, channel.topic))


def _is_wanted(topic: str, wanted: Wanted) -> bool:
    if wanted.keys is None:
        return True
    return any(_is_of(key, topic) for key in (*wanted.keys, wanted.signal or ""))


def _decoder(path: Path, channel: Channel, schema: Schema | None) -> Callable[[bytes], Any]:
    encoding = channel.message_encoding
    if encoding == "json":
        return json.loads
    if encoding not in _DECODERS:
        found = f"{encoding} on {channel.topic}"
        raise Error(f"{path}: expected messages of CDR, protobuf or JSON, found {found}")
    factory = optional(_DECODERS[encoding], "rosbag").DecoderFactory()
    decoder: Callable[[bytes], Any] | None = factory.decoder_for(encoding, schema)
    if decoder is None:
        found = schema.encoding if schema else "none"
        raise Error(f"{path}: {channel.topic}: expected a schema of {encoding}, found {found}")
    return decoder


def _leaves(value: Any, path: str) -> Iterator[tuple[str, list[float]]]:
    """Yield the numbers of a decoded message with their field paths, in the order of the fields."""
    if isinstance(value, (bool, int, float)):
        yield path, [float(value)]
    elif isinstance(value, (str, bytes)) or value is None:
        return
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(inner, f"{path}.{key}")
    elif hasattr(value, "DESCRIPTOR"):
        for field in value.DESCRIPTOR.fields:
            yield from _leaves(getattr(value, field.name), f"{path}.{field.name}")
    elif hasattr(value, "__slots__") and not hasattr(value, "__len__"):
        for name in value.__slots__:
            yield from _leaves(getattr(value, name), f"{path}.{name}")
    else:
        yield from _elements(list(value), path)


def _elements(values: list[Any], path: str) -> Iterator[tuple[str, list[float]]]:
    if all(isinstance(value, (bool, int, float)) for value in values):
        yield path, [float(value) for value in values]
        return
    for index, value in enumerate(values):
        yield from _leaves(value, f"{path}.{index}")


def _is_of(key: str, whole: str) -> bool:
    """Return whether a key is `whole`, a topic or a field, or something within it."""
    return key == whole or key.startswith(f"{whole}.")


def _topic(key: str, newest: Mapping[str, Numbers]) -> str | None:
    return next((topic for topic in newest if _is_of(key, topic)), None)


def _values(newest: Mapping[str, Numbers], key: str) -> list[float] | None:
    """Return the newest numbers of a key: those of its field, or of all fields within it."""
    topic = _topic(key, newest)
    if topic is None:
        return None
    fields = [values for field, values in newest[topic].items() if _is_of(field, key)]
    return [number for values in fields for number in values] if fields else None


def _taken(newest: Mapping[str, Numbers], wanted: Wanted) -> Numbers:
    """Return the newest numbers of every key that has had a message."""
    if wanted.keys is None:
        every = (item for numbers in newest.values() for item in numbers.items())
        return {field: values for field, values in every if field != wanted.signal}
    taken = {key: _values(newest, key) for key in wanted.keys}
    return {key: values for key, values in taken.items() if values is not None}


def _told(newest: Mapping[str, Numbers], wanted: Wanted) -> float:
    """Return the newest number of the signal; 0 before its first message."""
    values = _values(newest, wanted.signal) if wanted.signal else None
    return values[0] if values else 0.0


def _array(name: str, key: str, rows: list[list[float]]) -> Any:
    lengths = sorted({len(row) for row in rows})
    if len(lengths) > 1:
        found = f"{lengths[0]} to {lengths[-1]}"
        raise Error(f"episode {name}: {key}: expected as many numbers each time, found {found}")
    return np.array(rows, np.float64)
