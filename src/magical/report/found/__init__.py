"""Evaluated runs in folders, which scores are missing, and how each run was made."""
