"""``cruiser ros``: robots on a ROS 2 graph, through its Zenoh middleware.

- ``commands``  which messages of the graph may become drive commands; pure
- ``bridge``    joins the robots' side to the graph's

It is one more operator, in a process of its own: the gateway does not know it, and no rule of the arbiter changes.
"""
