"""What the command line, fleets, pages and notebooks share."""
