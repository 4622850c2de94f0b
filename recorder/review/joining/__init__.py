"""What ``merge`` and ``cut`` stand on.

- ``source``      one log: where its chunks stand, and its messages chunk by chunk
- ``ordered``     the messages of several logs in the order of their log times
- ``duplicates``  messages that came by before
- ``output``      a new file, which is written beside and named at the end
- ``joining``     all of that together
"""
