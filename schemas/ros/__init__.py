"""The form of ROS 2: its message types, their bytes, and the conventions of its Zenoh middleware, rmw_zenoh.

- ``types``    the definitions of the messages that are spoken, as ``.msg`` files have them
- ``cdr``      messages to bytes and back, and the hash of a type
- ``wire``     keys, liveliness tokens, QoS and attachments of rmw_zenoh
- ``face``     the gateway's messages as those of ROS, by REP 103 and REP 105

A ROS message is a dict here, with the field names of its definition. Nothing of this needs ROS.
"""
