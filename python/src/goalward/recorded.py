"""MCAP files that Goalward or this package recorded."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from goalward.error import Error, expecting, one_line
from goalward.task import Task

RUN = "goalward.run"
DEMONSTRATIONS = "goalward.demonstrations"
FORMAT_VERSION = 1
LONGEST_RECORD = 64 << 20
ACTIVE = ".active"
"""The suffix of a file's name until the file is sealed."""

DAMAGE = (McapError, ValueError, struct.error, zstandard.ZstdError, OverflowError, MemoryError)
"""The exceptions that the readers of MCAP and zstd raise for damaged bytes."""


@dataclass(frozen=True)
class Ending:
    """How a file ends, or where reading it stopped.

    Attributes:
        complete: whether the file is sealed and everything in it was read.
        words: one line that describes the ending.
    """

    complete: bool
    words: str


class BeginningError(Error):
    """The beginning of a file is missing or damaged."""


class Recorded(NamedTuple):
    """A message: its topic, its log time in nanoseconds, and its protobuf bytes."""

    topic: str
    log_time: int
    data: bytes


class RecordedFile:
    """A file of Goalward, read up to its end or the first damage.

    Attributes:
        path: the path of the file; without `.active` once its writer has sealed it.
        kind: `RUN` or `DEMONSTRATIONS`.
        metadata: the file's metadata, by name.
        ending: how the file ends; known once `messages` is exhausted.
    """

    def __init__(self, path: Path) -> None:
        """Read the metadata.

        Raises:
            BeginningError: if the beginning of the file is missing or damaged.
            Error: if the file cannot be read, or is not a file of Goalward in a known format.
        """
        self.path = path
        self.ending = Ending(False, "not read to its end")
        first = next((record for record in self._records() if not isinstance(record, Header)), None)
        if not isinstance(first, Metadata) or first.name not in (RUN, DEMONSTRATIONS):
            expected = f"metadata `{RUN}` or `{DEMONSTRATIONS}` as the first record"
            refusal = Error if isinstance(first, Metadata) else BeginningError
            raise refusal(f"{path}: expected {expected}, found {_name_of(first, self.ending)}")
        self.kind: str = first.name
        self.metadata: Mapping[str, str] = first.metadata
        version = first.metadata.get("format_version", "none")
        if not version.isdecimal() or int(version) > FORMAT_VERSION:
            raise Error(f"{path}: expected format version {FORMAT_VERSION} or older, found {version}")

    def task(self) -> Task:
        """Return the task in which the file was recorded.

        Raises:
            Error: if the file does not say.
        """
        if "spec" not in self.metadata:
            raise Error(f"{self.path}: expected metadata `spec`, the shapes of its task, found none")
        return Task.from_json(self.metadata["spec"])

    def messages(self) -> Iterator[Recorded]:
        """Yield the messages up to the last complete one; `ending` is known afterwards.

        Raises:
            Error: if the system cannot read the file.
        """
        topics: dict[int, str] = {}
        for record in self._records():
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message) and record.channel_id in topics:
                yield Recorded(topics[record.channel_id], record.log_time, record.data)

    def _records(self) -> Iterator[McapRecord]:
        with expecting(f"{self.path}: expected a readable file", OSError), self._open() as file:
            yield from self._records_of(file)

    def _open(self) -> BinaryIO:
        """Open the file, which its writer may have sealed since it was listed or read."""
        try:
            return self.path.open("rb")
        except FileNotFoundError:
            if self.path.suffix != ACTIVE:
                raise
        self.path = self.path.with_suffix("")
        return self.path.open("rb")

    def _records_of(self, file: BinaryIO) -> Iterator[McapRecord]:
        stream = StreamReader(file, emit_chunks=True, record_size_limit=LONGEST_RECORD)
        whole = 0
        try:
            for record in stream.records:
                yield from breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
                whole = file.tell()
            self.ending = Ending(True, "complete")
        except DAMAGE as cause:
            self.ending = self._broken(at_end=not file.read(1), whole=whole, cause=cause)

    def _broken(self, *, at_end: bool, whole: int, cause: Exception) -> Ending:
        if not at_end:
            return Ending(False, f"damaged behind byte {whole}: {one_line(cause)}")
        if self.path.suffix == ACTIVE:
            return Ending(False, f"not sealed: read up to byte {whole}, the last whole record")
        return Ending(False, f"cut off: read up to byte {whole}, the last whole record")


def _name_of(record: McapRecord | None, ending: Ending) -> str:
    if record is None:
        return f"none ({ending.words})"
    return f"metadata `{record.name}`" if isinstance(record, Metadata) else type(record).__name__
