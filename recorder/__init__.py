"""Records Zenoh samples as MCAP, and reads the logs.

The end of the telemetry flow::

    zenoh > sample > recording > session > protobuf record in a chunk > MCAP file > review

- ``recording``        no I/O: all logs, samples and orders in, what is to be done out. The page to begin with
- ``robot_log``        one log of it: its files, and its incidents
- ``session``          what goes into that log
- ``fast_path``, ``can_columns``  the fast path of nearly all samples into a chunk
- ``incidents``        the last seconds of a log in memory, and what is kept of them when something happens
- ``gateways``         which gateways have died, of those whose liveliness token is gone
- ``sample``, ``effects``, ``notices``  what goes into it, what comes out, and what became of that
- ``inbox``, ``gaps``, ``completeness``  samples that wait, what was lost, and the account of it
- ``orders``, ``health``  what operators ask of a recorder, and what it says of itself
- ``retention``        which logs go when the disk is full
- ``channels``         the channels of a log, and what is known of each
- ``routes``           which channel a key's samples go to, and how they become records
- ``tally``            what of a key has come in, and what is missing
- ``backlog``          what a gateway still keeps and the log lacks
- ``robots``           what is known of each robot: asked for, kept as metadata and attachments
- ``protobuf_schema``  the messages as protobuf descriptors, built at run time
- ``transcode``        a typed message to its protobuf bytes; ``foxglove_log`` an event as viewers list it
- ``chunk``            messages appended to one buffer, indexed
- ``mcap_file``        the bytes of an MCAP file, on any binary stream; ``mcap_summary`` is its end
- ``prologue``         what a file begins with that continues another
- ``mcap_scan``, ``recovery``  what is whole in a damaged or unfinished file, and making a file of it
- ``backfill``         what another recorder's logs hold and ours lack
- ``loop``             joins them to the ports, and never waits for the disk
- ``ports``            Zenoh, the directory of logs, the thread that writes them, the disk, what others left there
- ``review``           turns a log into answers
- ``cli``              the commands
"""
