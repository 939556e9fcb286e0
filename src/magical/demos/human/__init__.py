"""The published human demonstrations: downloading, safe reading, and import into a dataset."""
