"""Plug-ins for magical: one of each kind."""
