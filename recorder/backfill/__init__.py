"""Fills the holes of a log out of the logs of another recorder.

    own logs > holes > questions > the other recorder's excerpt > the missing messages > a log of its own

- ``excerpt``      the side that is asked: the messages of some keys and a time, in pieces
- ``runs``         sequences without a gap, and what lies between them
- ``holes``        the messages that one's own logs lack
- ``questions``    few requests for them
- ``answers``      reads pieces, and asks again until all is answered
- ``filling``      which of the answered messages are missing, and what then is missing still
- ``backfilling``  asks one recorder after the other
- ``ranges``       ranges of time

All of it is free of clocks, sockets and files: those are in ``recorder.disk`` and ``recorder.zenoh``. The map of a
log's chunks is ``recorder.mcap.log_map``.
"""
