"""Reads a log with the public MCAP packages alone and prints what it found, as JSON lines.

Usage: log_python.py FILE. Run by log_python.rs; needs the packages of tests/requirements.txt.
"""

import json
import sys

from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    for record in reader.iter_metadata():
        print(json.dumps({"metadata": record.name, "entries": record.metadata}))
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        fields = MessageToDict(decoded, preserving_proto_field_name=True)
        print(
            json.dumps(
                {
                    "topic": channel.topic,
                    "schema": schema.name,
                    "fields": fields,
                    "sequence": message.sequence,
                    "log_time": message.log_time,
                }
            )
        )
