"""Signatures and grants: the signed bytes and who may sign them, for robot, operator, recorder and review alike.

``proof`` has the layouts, ``statement`` what an authority signs, ``trust`` who is believed, ``chain`` the hash
chains over a robot's records. Nothing here reads a file, a clock or a network.
"""
