"""The choice of a chassis: ``chassis`` for what drives it, ``frame_layouts`` for what reads its logs.

With a second chassis, a setting chooses here; the review then has to go by what a log says of itself.
"""
