"""Signatures and grants: the signed bytes and who may sign them, for robot, operator, recorder and review alike.

``proof`` has the layouts and the statements, ``trust`` decides which are valid, ``key_files`` reads keys.
Nothing here uses a clock or the network.
"""
