"""Messages of a log as Arrow columns, without a loop over messages.

- ``shape``     what a class of messages holds: its fields, and the Arrow type of each
- ``layout``    where in a message's bytes each field stands
- ``arrays``    many messages of one layout to columns, by slicing their bytes
- ``parsed``    the others, by the protobuf package, one by one
- ``tables``    the columns of a topic: times, sequence, fields
- ``decoder``    both ways to columns, put together in the order of the file
- ``places``    where the messages of chunks are, by the message indexes, which are proven first
- ``unpacking``  chunks as a recorder packs them
- ``reader``    the record batches of a log
"""
