"""Importers: files of other tools become recordings."""
