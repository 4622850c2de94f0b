"""Print a JSON line for each message of a log as rerun reads it.

Usage: PYTHON-WITH-RERUN tests/readers/with_rerun.py LOG
"""

import json
import sys

from rerun.chunk import McapReader

TIMES = ("message_log_time", "message_publish_time")


def main(path: str) -> None:
    for chunk in McapReader(path, decoders=["protobuf"]).stream():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        columns = [name for name in names if name.endswith(":message")]
        if not columns:
            continue
        log_ns, publish_ns = (batch.column(names.index(name)).cast("int64").to_pylist() for name in TIMES)
        for row, found in enumerate(batch.column(names.index(columns[0])).to_pylist()):
            line = {
                "topic": chunk.entity_path.removeprefix("/"),
                "log_ns": log_ns[row],
                "publish_ns": publish_ns[row],
                "fields": found[0],
            }
            print(json.dumps(line, default=bytes.hex))


if __name__ == "__main__":
    main(sys.argv[1])
