"""Recovery of poses from the frames of the published human demonstrations."""
