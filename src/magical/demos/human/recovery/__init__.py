"""Poses recovered from the frames of the published human demonstrations."""
