"""What command line, fleets, pages and notebooks share; ``groundtrace.__all__`` is its public part.

Nothing here prints: what a person should know is returned, raised, or given to a ``report``.
"""
