"""Scenes as objects: parsed from pixels, related to each other, acted on."""
