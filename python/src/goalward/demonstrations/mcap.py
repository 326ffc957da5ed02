"""Robot recordings: MCAP files, and rosbag2 folders that contain such files.

One bag is one episode. A key is a topic and a field path, such as `/joint_states.position`; a field that is
a message stands for all its numbers. Messages are encoded as CDR of ROS 2, protobuf or JSON. Each message of
the first key's topic gives one observation, which has the newest values of the other topics: those of a
silent topic stay as they are. Observations begin once every key has numbers. From then on, it is an error if
the newest message of a topic lacks those of a key, because older ones would belong to another moment.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

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


class _Message(NamedTuple):
    """The numbers of a message by field; its file, and its number among those of its topic there, from 1."""

    topic: str
    numbers: Numbers
    path: Path
    number: int


@dataclass(frozen=True)
class _Parts:
    """The parts that every bag of a data set has.

    Attributes:
        keys: the observation keys, the first of which sets the rate.
        signal: the key that indicates success; None if none was named.
        lengths: for each key, its fields and how many numbers each has, as in the first observation of all.
    """

    keys: Sequence[str]
    signal: str | None
    lengths: dict[str, dict[str, int]]


def recordings(source: Path, wanted: Wanted) -> Iterator[Recording]:
    """Read bags, each as one episode.

    Args:
        source: an MCAP file; a bag's folder, which has `metadata.yaml`; or a folder of either.
        wanted: the keys, the first of which sets the rate of observations; without keys, every number of the
            only topic that has numbers besides the signal. A signal is 0 before its first message.

    Raises:
        Error: if a file is damaged, its messages cannot be decoded, a bag lacks a key, the numbers of a key
            change, or no bag has the signal.
    """
    if wanted.actions:
        raise Error(f"{source}: actions: expected none, since a bag does not tell which step a command is of")
    parts: _Parts | None = None
    heard: dict[str, None] = {}
    for name, files in _bags(source):
        keys = wanted.keys or _only_keys(name, files, wanted.signal)
        parts = parts or _Parts(keys, wanted.signal, {})
        if set(keys) != set(parts.keys):
            expected, found = ", ".join(parts.keys), ", ".join(keys)
            raise Error(f"episode {name}: keys: expected {expected} as before, found {found}")
        recording, fields = _recording(name, files, parts)
        heard |= fields
        yield recording
    if wanted.signal and not any(_is_of(field, wanted.signal) for field in heard):
        raise Error(f"{source}: success: expected `{wanted.signal}`, found {', '.join(heard) or 'none'}")


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


def _only_keys(name: str, files: Sequence[Path], signal: str | None) -> list[str]:
    """Return the fields of the only topic that has numbers, in the order of its messages.

    Several topics need keys: otherwise the rate and the order would depend on which of them spoke first.
    """
    topics: dict[str, dict[str, int]] = {}
    for message in chain.from_iterable(_messages(path, None) for path in files):
        fields = {field: len(values) for field, values in message.numbers.items() if values}
        observed = {field: fields[field] for field in fields if not (signal and _is_of(field, signal))}
        if observed:
            topics.setdefault(message.topic, {}).update(observed)
    if len(topics) != 1:
        found = ", ".join(_listed(topics[topic]) for topic in sorted(topics)) or "none"
        expected = "some, the first of which sets the rate, unless one topic alone has numbers"
        raise Error(f"episode {name}: keys: expected {expected}, found {found}")
    return [field for fields in topics.values() for field in fields]


def _recording(name: str, files: Sequence[Path], parts: _Parts) -> tuple[Recording, dict[str, None]]:
    """Return the episode of a bag, and the fields that were found in it."""
    keys, signal = parts.keys, parts.signal
    asked = [*keys, signal] if signal else keys
    newest: dict[str, _Message] = {}
    rows: list[list[list[float]]] = []
    told: list[float] = []
    fields: dict[str, None] = {}
    for message in chain.from_iterable(_messages(path, asked) for path in files):
        fields |= dict.fromkeys(message.numbers)
        newest |= {key: message for key in asked if _is_newest(message, key, newest)}
        if newest.get(keys[0]) is message and (rows or all(_has(newest, key) for key in keys)):
            rows.append([_values(newest[key], key, parts.lengths) for key in keys])
            told.append(_told(newest, signal))
    if not rows:
        raise _without_observations(name, keys, newest, fields)
    columns = zip(keys, zip(*rows, strict=True), strict=True)
    arrays = {key: np.array(column, np.float64) for key, column in columns}
    signals = {key: array[:, 0] for key, array in arrays.items() if array.shape[1] == 1}
    if signal:
        # A signal after the last observation counts for that observation.
        signals[signal] = np.array([*told[:-1], _told(newest, signal)])
    return Recording(name, arrays, signals), fields


def _without_observations(
    name: str, keys: Sequence[str], newest: Mapping[str, _Message], fields: Iterable[str]
) -> Error:
    missing = next((key for key in keys if key not in newest), None)
    if missing is not None:
        return Error(f"episode {name}: keys: expected `{missing}`, found {', '.join(fields) or 'none'}")
    pace = newest[keys[0]].topic
    return Error(f"episode {name}: expected a message of {pace} once all keys have numbers, found none")


def _messages(path: Path, asked: Sequence[str] | None) -> Iterator[_Message]:
    """Yield the messages that may have numbers of the keys asked for; of all topics without keys."""
    decoders: dict[int, Callable[[bytes], Any]] = {}
    counts: Counter[str] = Counter()
    damage = expecting(f"{path}: expected a whole MCAP file", OSError, KeyError, *DAMAGE)
    with damage, path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            topic = channel.topic
            if asked is not None and not any(_is_of(key, topic) for key in asked):
                continue
            # A decoder may raise anything for a damaged schema or message.
            with expecting(f"{path}: expected messages of {topic} that can be decoded", Exception):
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(path, channel, schema)
                decoded = decoders[channel.id](message.data)
            counts[topic] += 1
            yield _Message(topic, dict(_leaves(decoded, topic)), path, counts[topic])


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
            # What is not set would be read as zeros.
            if field.has_presence and not value.HasField(field.name):
                continue
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


def _is_newest(message: _Message, key: str, newest: Mapping[str, _Message]) -> bool:
    """Return whether a message is of the key's topic: the first that had numbers of the key."""
    return message.topic == newest[key].topic if key in newest else bool(_part(message, key))


def _has(newest: Mapping[str, _Message], key: str) -> bool:
    return key in newest and bool(_part(newest[key], key))


def _part(message: _Message, key: str) -> Numbers:
    """Return a key's numbers in a message: those of its field, or of all fields within it."""
    fields = [key] if key in message.numbers else [field for field in message.numbers if _is_of(field, key)]
    return {field: message.numbers[field] for field in fields if message.numbers[field]}


def _values(message: _Message, key: str, lengths: dict[str, dict[str, int]]) -> list[float]:
    """Return a key's numbers in the order of its fields in the first observation.

    Raises:
        Error: if they are not as many as there.
    """
    part = _part(message, key)
    found = {field: len(values) for field, values in part.items()}
    expected = lengths.setdefault(key, found)
    if found != expected:
        where = f"{message.path}: message {message.number} of {message.topic}"
        raise Error(f"{where}: expected {_listed(expected)} as before, found {_listed(found)}")
    return [number for field in expected for number in part[field]]


def _told(newest: Mapping[str, _Message], signal: str | None) -> float:
    """Return the newest number of the signal; 0 before its first message."""
    part = _part(newest[signal], signal) if signal and signal in newest else {}
    return next(iter(part.values()))[0] if part else 0.0


def _listed(lengths: Mapping[str, int]) -> str:
    return ", ".join(f"{field} ({length})" for field, length in lengths.items()) or "none"
