"""Evaluated runs in folders, and which scores are missing."""
