"""The published human demonstrations: download, safe reading, import."""
