"""The edge process: telemetry out, commands in.

Two flows, which touch once::

    TELEMETRY  CAN bus > frame > check and decode > message > sample > zenoh > recorder > MCAP > review
                                                       |
                                                       v observe
    COMMAND    zenoh > request > arbiter > decision > encode > gate > frame > CAN bus

The telemetry flow is here; ``core`` has it on one page, ``loop`` is the one thread that runs it, ``ports`` holds
the only importers of python-can and Zenoh. The command flow does not exist yet: the gateway sends nothing on the
bus.
"""
