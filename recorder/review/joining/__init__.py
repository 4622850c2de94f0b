"""The reading and writing that ``merge`` and ``cut`` share.

- ``source``   one log: where its chunks stand, and its messages chunk by chunk
- ``ordered``  the messages of several logs in the order of their log times
- ``joining``  all of that into a new file, without messages that came by before
"""
