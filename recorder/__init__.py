"""Records Zenoh samples as MCAP, and reads the logs.

The end of the telemetry flow::

    zenoh > sample > session > protobuf record in a chunk > MCAP file > review

- ``session``          no I/O: samples and ticks in, effects out. The page to begin with
- ``sample``, ``effects``  what goes into it, and what comes out
- ``routes``           which channel a key's samples go to, and how they become records
- ``tally``            what of a key has come in, and what is missing
- ``robots``           what is known of each robot: asked for, kept as metadata and attachments
- ``protobuf_schema``  the messages as protobuf descriptors, built at run time
- ``transcode``        a typed message to its protobuf bytes
- ``chunk``            messages appended to one buffer, indexed
- ``mcap_file``        the bytes of an MCAP file, on any binary stream; ``mcap_summary`` is its end
- ``prologue``         what a file begins with that continues another
- ``mcap_scan``, ``recovery``  what is whole in a damaged or unfinished file, and making a file of it
- ``loop``             joins them to the ports, and never waits for the disk
- ``ports``            Zenoh, the directory of logs, the thread that writes them, and what others left there
- ``review``           turns a log into answers
- ``cli``              the commands
"""
