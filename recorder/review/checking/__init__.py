"""The parts of ``check``: each module proves one thing of a log, of many messages at once.

- ``findings``   what is wrong
- ``structure``  whether indexes, statistics and summary are true
- ``channel``    one channel, by the modules below
- ``messages``   whether messages are what their schema says
- ``samples``    samples that never came
- ``frames``     raw frames that never came, by their alive counters
"""
