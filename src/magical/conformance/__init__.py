"""Holds the package against recordings of the published environments."""
