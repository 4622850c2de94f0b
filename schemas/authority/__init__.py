"""Signatures and grants: the signed bytes and who may sign them, for robot, operator, recorder and review alike.

``proof`` has the layouts and what an authority signs, ``trust`` who is believed, ``key_files`` a machine's own
keys. Nothing here has a clock or a network.
"""
