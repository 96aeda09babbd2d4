"""
A missed step and its gates
===========================

The signal around the first missed step of a real walk, and the value of each gate of the
candidate beside its threshold.
"""

import groundtrace as gt

results = gt.replay("lower-back", "waist-steps")
miss = results.misses[0]
why = results.why(step=miss.step)
why.plot()
print(miss.text)
print(why.remedy)
