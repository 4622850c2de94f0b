"""Fills the holes of a log out of the logs of another recorder.

    own logs > holes > questions > the other recorder's excerpt > what is missing > a log of its own

- ``log_map``    where the chunks of a log stand, and what one of them holds
- ``excerpt``    the side that is asked: what logs hold of some keys and a time, in pieces
- ``runs``       sequences that are there without a gap, and what lies between them
- ``holes``      what one's own logs lack
- ``questions``  how to ask for it, in few requests
- ``answers``    reads pieces, and asks again until all is answered
- ``filling``    which of the answered messages are missing, and what then is missing still
- ``backfilling``  asks one recorder after the other
- ``ranges``     ranges of time

All of it is free of clocks, sockets and files: those are in ``recorder.disk`` and ``recorder.zenoh``.
"""
