"""What a layout of sensors can do, told before anyone records."""
