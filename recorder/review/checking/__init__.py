"""What ``check`` stands on: each module proves one thing of a log, and most messages are proven many at once.

- ``findings``   what is wrong, gathered
- ``headers``    the messages of a chunk, their headers in columns
- ``proofs``     whether messages are what their schema says
- ``sequences``  samples that never came
- ``frames``     raw frames that never came
- ``structure``  whether indexes, statistics and summary are true
"""
