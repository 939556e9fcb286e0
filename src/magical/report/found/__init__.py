"""Evaluated runs in folders."""
