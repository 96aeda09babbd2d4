"""Types of steps: forward, backward, left or right, after the EPFL's pedestrian navigation module.

A stage that finds steps says when; here their types are told from the three accelerations of the
body: :mod:`.axes` (what is up, ahead and aside), :mod:`groundtrace.heading.walking_axis` (the
mounting's rotation), :mod:`.chains` (the patterns of both chains), :mod:`.corrections` (what
neighbours say), :mod:`.type_gates` and :mod:`.classifier` (the tests), :mod:`.follower` (all that
crosses blocks).
"""
