"""What the indoor worlds have in common: a small robot with poor odometry and a fair sensor.

Chosen so that dead reckoning is metres off after 100 m, and so that landmarks can be told apart.  What each world sets
of `inflate_r` is said there, with the reason.
"""

from __future__ import annotations

import math

from slam.types import Noise

INDOOR_NOISE = Noise(speed=0.2, turn=math.radians(4.0), range=0.02, bearing=math.radians(0.3))
"""With control every 0.1 s: 0.6 m and 13 degrees after 100 s, so that odometry is metres off after a loop."""
