"""Records Zenoh samples as MCAP, and reads the logs.

The end of the telemetry flow::

    zenoh > sample > Recorder > RobotLog > protobuf records in a chunk > MCAP file > review

Its packages, from the file upwards. Pure ones do no I/O: time is an argument, and actions are returned.

- ``mcap``      the MCAP file format both ways, whole or damaged; pure
- ``encoding``  a sample to the protobuf bytes of a log; pure
- ``layouts``   layouts with which viewers open a log; pure
- ``record``    the recorder: begin with ``record.recorder``; pure
- ``disk``      the directory of logs: the writing thread, retention, recovery after a crash
- ``zenoh``     samples in, and remote requests to a recorder
- ``loop``      joins ``record`` to ``zenoh`` and ``disk``, and never waits for the disk
- ``reading``   a log as topics and messages
- ``upload``    finished logs to an object store
- ``replay``    a log published again on Zenoh
- ``view``      robots live in Foxglove and Lichtblick
- ``review``    turns logs into answers: a function for each question
- ``cli``       the commands
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from recorder.review.messages import read_log

__all__ = ["read_log"]


def __getattr__(name: str) -> object:
    """Load ``read_log`` on first use: a recorder needs no reader."""
    if name == "read_log":
        from recorder.review.messages import read_log  # noqa: PLC0415 - see above

        return read_log
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
