"""Evaluated runs that folders hold, what is missing among them, and how each was made."""
