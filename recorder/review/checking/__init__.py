"""The parts of ``check``: each module proves one thing of a log, and most messages are proven many at once.

- ``findings``         what is wrong, gathered
- ``structure``        whether indexes, statistics and summary are true
- ``channel``          one channel, by the modules below
- ``proofs``           whether messages are what their schema says
- ``sequences``        samples that never came
- ``frames``, ``alive``  raw frames that never came, by their alive counters
"""
