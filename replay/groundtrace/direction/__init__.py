"""Where a wave comes from, by the motion of the ground at single stations of three axes."""
