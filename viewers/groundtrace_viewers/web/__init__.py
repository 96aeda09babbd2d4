"""Pages: annotation server, shared folders, summaries, notebooks."""
