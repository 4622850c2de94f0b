"""What is signed, in which bytes, and who may sign it: the same for robot, operator, recorder and review.

``proof`` has the layouts, ``statement`` what an authority signs, ``trust`` who is believed, ``chain`` the hash
chains over a robot's records. Nothing here reads a file, a clock or a network.
"""
