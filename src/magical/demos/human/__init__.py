"""The published human demonstrations: fetched, read safely, and imported into a dataset."""
